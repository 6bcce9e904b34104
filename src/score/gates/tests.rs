use super::super::cameras::{Match, Matches};
use super::super::plain::{self, Preparation};
use super::super::points::{FinitePoints, prism};
use super::*;
use glam::DMat4;
use mvs_datasets::scene::{Axis, CropVolume};
use mvs_metrics::align::trajectory::TrajectoryFit;

fn cameras(registered: usize, inliers: usize) -> CameraFit {
    let camera = |index: usize| Match {
        reference_index: index,
        given: DVec3::ZERO,
        reference: DVec3::ZERO,
        registered: index < registered,
    };
    CameraFit {
        matches: Matches {
            matches: (0..100).map(camera).collect(),
            log: 100,
            video_frames: None,
            given: 100,
            reference: 100,
            by: MatchedBy::Order,
        },
        fit: TrajectoryFit {
            target_from_source: DMat4::IDENTITY,
            fitness: 1.0,
            rmse: 0.01,
            residuals: Vec::new(),
            inliers,
        },
        inliers,
        median_residual: 0.01,
        scale_ratio: 1.0,
        shift: None,
    }
}

/// The gate of this name among `gates`.
fn gate(gates: &[Gate], code: &str) -> Gate {
    gates.iter().find(|gate| gate.code == code).unwrap().clone()
}

fn failed(gates: &[Gate]) -> Vec<&str> {
    let failed = gates.iter().filter(|gate| !gate.passed);
    failed.map(|gate| gate.code.as_str()).collect()
}

#[test]
fn good_cameras_pass() {
    assert!(failed(&of_cameras(&cameras(100, 100), 0.2)).is_empty());
    assert!(
        failed(&of_cameras(&cameras(50, 30), 0.2)).is_empty(),
        "at the bounds"
    );
}

#[test]
fn each_fault_of_the_cameras_has_its_gate() {
    let gates = of_cameras(&cameras(40, 40), 0.2);
    assert_eq!(failed(&gates), ["poses-missing"]);
    let gate_of_missing = gate(&gates, "poses-missing");
    assert_eq!(
        (gate_of_missing.value, gate_of_missing.min),
        (Some(0.4), Some(0.5))
    );
    assert!(
        gate_of_missing
            .message
            .contains("40 of the scene's 100 cameras")
    );

    assert_eq!(failed(&of_cameras(&cameras(100, 59), 0.2)), ["few-inliers"]);

    let collapsed = CameraFit {
        scale_ratio: 0.1,
        ..cameras(100, 100)
    };
    assert_eq!(failed(&of_cameras(&collapsed, 0.2)), ["implausible-scale"]);
    let unknown = CameraFit {
        scale_ratio: f64::NAN,
        ..cameras(100, 100)
    };
    assert_eq!(failed(&of_cameras(&unknown, 0.2)), ["implausible-scale"]);

    for (shift, words) in [
        (3, "shifted by 3: its pose i fits camera i + 3"),
        (-2, "i − 2"),
    ] {
        let shifted = CameraFit {
            shift: Some(shift),
            ..cameras(100, 100)
        };
        let gates = of_cameras(&shifted, 0.2);
        assert_eq!(failed(&gates), ["poses-shifted"]);
        let message = gate(&gates, "poses-shifted").message;
        assert!(message.contains(words), "{message}");
    }
}

#[test]
fn a_count_of_poses_matters_where_only_their_order_is_known() {
    let mut fit = cameras(97, 97);
    (fit.matches.given, fit.matches.log) = (97, 97);
    assert_eq!(failed(&of_cameras(&fit, 0.2)), ["pose-count"]);
    fit.matches.by = MatchedBy::Number;
    assert!(failed(&of_cameras(&fit, 0.2)).is_empty());
}

fn stage(fitness: f64, scale: f64) -> Stage {
    Stage {
        reconstruction_points: 100,
        truth_points: 100,
        max_distance: 0.02,
        fitness,
        inlier_rmse: 0.01,
        iterations: 5,
        converged: true,
        scale,
        truth_from_reconstruction: DMat4::IDENTITY,
    }
}

#[test]
fn stages_are_judged_by_their_last_fitness_and_their_scale() {
    assert!(of_stages(&[]).is_empty());
    assert!(failed(&of_stages(&[stage(0.1, 1.04), stage(0.9, 1.0)])).is_empty());
    assert_eq!(
        failed(&of_stages(&[stage(0.9, 1.0), stage(0.1, 1.0)])),
        ["low-icp-fitness"]
    );
    assert_eq!(
        failed(&of_stages(&[stage(0.9, 1.2), stage(0.9, 1.0)])),
        ["icp-scale"]
    );
}

/// A bumpy square of 100 × 100 points, one unit apart, moved and roughened.
fn surface(offset: DVec3, roughness: f64) -> FinitePoints {
    let point = |i: u32| {
        let (x, y) = (f64::from(i % 100), f64::from(i / 100));
        let noise = f64::from((i * 7919) % 1000) / 500.0 - 1.0;
        let z = 10.0 * (x / 15.0).sin() * (y / 12.0).cos() + roughness * noise;
        DVec3::new(x, y, z) + offset
    };
    FinitePoints::new((0..10_000).map(point).collect())
}

fn compared(reconstruction: &FinitePoints, crop: bool) -> Evaluation {
    let corner = |x, y| DVec3::new(x, y, 0.0);
    let corners = [
        corner(-1.0, -1.0),
        corner(101.0, -1.0),
        corner(101.0, 101.0),
        corner(-1.0, 101.0),
    ];
    let volume = CropVolume::new(Axis::Z, -50.0, 50.0, &corners).unwrap();
    let preparation = Preparation {
        crop: crop.then(|| prism(&volume).unwrap()),
        voxel: None,
    };
    plain::evaluate(
        reconstruction,
        None,
        &surface(DVec3::ZERO, 0.0),
        &preparation,
    )
    .unwrap()
}

#[test]
fn a_cloud_out_of_place_is_told_from_a_noisy_one() {
    let tolerance = Tolerance::new(0.8).unwrap();
    let gate_at = |offset, roughness| {
        let evaluation = compared(&surface(offset, roughness), false);
        of_tolerances(&evaluation, tolerance).unwrap()
    };
    let right = gate_at(DVec3::ZERO, 0.1);
    assert!(right.passed && right.value == Some(1.0), "{right:?}");
    let noisy = gate_at(DVec3::ZERO, 3.5);
    assert!(noisy.passed && noisy.value.unwrap() < 0.5, "{noisy:?}");
    let displaced = gate_at(DVec3::new(0.5, 0.5, 1.6), 0.1);
    assert!(
        !displaced.passed && displaced.value.unwrap() < 0.5,
        "{displaced:?}"
    );
    assert!(displaced.message.contains("out of place"), "{displaced:?}");
}

/// One point far out, in both clouds: a motion that follows noise moves it as far as all others together.
#[test]
fn a_point_far_out_in_both_clouds_does_not_turn_noise_into_drift() {
    let tolerance = Tolerance::new(0.8).unwrap();
    let with_far = |offset: DVec3, roughness: f64, far: DVec3| {
        let points = surface(offset, roughness).positions();
        FinitePoints::new(points.iter().copied().chain([far]).collect())
    };
    for far in [1e3, 1e6, 1e12, 1e80, 1e150].map(|far| DVec3::X * far) {
        let gate_at = |offset, roughness| {
            let reconstruction = with_far(offset, roughness, far);
            let truth = with_far(DVec3::ZERO, 0.0, far);
            let compared = plain::evaluate(&reconstruction, None, &truth, &Preparation::default());
            of_tolerances(&compared.unwrap(), tolerance).unwrap()
        };
        let noisy = gate_at(DVec3::ZERO, 3.5);
        assert!(noisy.passed && noisy.value.unwrap() < 0.5, "{noisy:?}");
        let displaced = gate_at(DVec3::new(0.5, 0.5, 1.6), 0.1);
        assert!(!displaced.passed, "{displaced:?}");
    }
}

#[test]
fn a_cloud_farther_off_than_the_truth_is_long_is_out_of_place() {
    let sheet = |z: f64| {
        let at = |i: u32| DVec3::new(f64::from(i % 50) / 50.0, f64::from(i / 50) / 50.0, z);
        FinitePoints::new((0..2500).map(at).collect())
    };
    let compared = plain::evaluate(&sheet(1.2), None, &sheet(0.0), &Preparation::default());
    let gate = of_tolerances(&compared.unwrap(), Tolerance::new(0.3).unwrap()).unwrap();
    assert!(
        !gate.passed && gate.message.contains("out of place"),
        "{gate:?}"
    );
}

fn crop_gate(reconstruction: &FinitePoints) -> Gate {
    let bounds = |points: &FinitePoints| Aabb::around(points.positions().iter().copied());
    let evaluation = compared(reconstruction, true);
    of_crop(
        &evaluation,
        (&bounds(reconstruction), &bounds(&surface(DVec3::ZERO, 0.0))),
        false,
    )
}

#[test]
fn a_crop_that_keeps_nothing_names_boxes_and_units() {
    assert!(crop_gate(&surface(DVec3::X * 50.0, 0.0)).passed);
    let far = crop_gate(&surface(DVec3::X * 500.0, 0.0));
    assert!(
        !far.passed && far.message.contains("0 of 10000 points"),
        "{far:?}"
    );
    assert!(
        far.message.contains("(500.0000") && far.message.contains("another scene"),
        "{far:?}"
    );
    for (scale, unit) in [(1000.0, "millimetres"), (100.0, "centimetres")] {
        let points = surface(DVec3::new(120.0, 3.0, 3.0), 0.0);
        let points = points.positions().iter().map(|&p| p * scale).collect();
        let gate = crop_gate(&FinitePoints::new(points));
        assert!(!gate.passed && gate.message.contains(unit), "{gate:?}");
    }
    // No unit is like that.
    let points = surface(DVec3::new(120.0, 3.0, 3.0), 0.0);
    let points = points.positions().iter().map(|&p| p * 1e5).collect();
    let gate = crop_gate(&FinitePoints::new(points));
    assert!(!gate.passed && !gate.message.contains("units"), "{gate:?}");
}

#[test]
fn cameras_in_one_point_suggest_no_scale() {
    let cameras = CameraFit {
        scale_ratio: f64::NAN,
        ..cameras(100, 100)
    };
    let gates = of_cameras(&cameras, 0.2);
    assert_eq!(failed(&gates), ["implausible-scale"]);
    let message = gate(&gates, "implausible-scale").message;
    assert!(
        message.contains("lie in one point") && !message.contains("NaN"),
        "{message}"
    );
}

#[test]
fn a_coarse_mesh_read_as_points_fails() {
    assert!(of_mesh(0.05, "vertices").passed);
    let gate = of_mesh(0.93, "vertices");
    assert!(!gate.passed && gate.message.contains("93.0 %"), "{gate:?}");
    assert!(gate.message.contains("--mesh-as area"));
}

#[test]
fn a_strict_alignment_that_ran_out_of_updates_is_named() {
    let stage = |iterations: usize, converged: bool| Stage {
        iterations,
        converged,
        ..stage(0.9, 1.0)
    };
    let said = |last: Stage, profile| unconverged(&[stage(100, false), last], profile);
    let ran_out = said(stage(100, false), Profile::Strict).unwrap();
    assert!(ran_out.contains("after 100 updates"), "{ran_out}");
    assert_eq!(said(stage(7, true), Profile::Strict), None);
    assert_eq!(said(stage(30, false), Profile::Official), None);
    assert_eq!(
        said(stage(0, false), Profile::Strict),
        None,
        "nothing to align"
    );
    assert_eq!(unconverged(&[], Profile::Strict), None);
}
