//! Inputs at the ends of what occurs, through the whole job: counts by closed form, or those of the
//! same scene where nothing is extreme.

use super::fixture::{self, Fixture, bumps, read, unit};
use super::{failed, run};
use glam::{DMat4, DVec3};
use mvs_eval::jobs::score::{Counts, ScoreDocument, ScoreJob};

/// Multiples of 2⁻²⁰: sums with multiples of it below 2³² are exact.
fn dyadic(value: f64) -> f64 {
    (value * f64::from(1 << 20)).floor() / f64::from(1 << 20)
}

/// A bumpy sheet over [−1, 1)², its points lifted by up to `noise`.
fn sheet(seed: u64, count: u64, noise: f64) -> Vec<DVec3> {
    let point = |i: u64| {
        let [x, y, lift] = std::array::from_fn(|k| unit(seed, 3 * i + k as u64));
        DVec3::from([x, y, bumps(x, y) + lift * noise].map(dyadic))
    };
    (0..count).map(point).collect()
}

fn moved(points: &[DVec3], motion: impl Fn(DVec3) -> DVec3) -> Vec<DVec3> {
    points.iter().map(|&point| motion(point)).collect()
}

fn empty() -> Fixture {
    Fixture {
        folder: tempfile::tempdir().unwrap(),
    }
}

/// The plain protocol on two clouds at τ = 0.01 with voxels of τ/2, unless changed.
fn plain(fixture: &Fixture, truth: Vec<DVec3>, reconstruction: Vec<DVec3>) -> ScoreJob {
    fixture.put_cloud("truth.ply", truth);
    fixture.put_cloud("rec.ply", reconstruction);
    ScoreJob {
        truth: Some(fixture.path("truth.ply")),
        reconstruction: fixture.path("rec.ply"),
        tau: vec![0.01],
        voxel: Some(0.005),
        out: fixture.path("out"),
        ..ScoreJob::default()
    }
}

fn square(from: f64, to: f64, [low, high]: [f64; 2]) -> String {
    let corners = [[from, from], [to, from], [to, to], [from, to]];
    let corners = corners.map(|[x, y]| format!("[{x:?}, {y:?}, 0.0]"));
    format!(
        "{{\"class_name\": \"SelectionPolygonVolume\", \"orthogonal_axis\": \"Z\", \"axis_min\": {low:?}, \
         \"axis_max\": {high:?}, \"bounding_polygon\": [{}], \"version_major\": 1, \"version_minor\": 0}}",
        corners.join(", ")
    )
}

fn pair(counts: &Counts) -> [(usize, usize, usize); 2] {
    [&counts.reconstruction, &counts.truth].map(|side| (side.cropped, side.evaluated, side.within))
}

#[test]
fn map_offsets_keep_precision_and_recall_to_a_millionth() {
    let (truth, reconstruction) = (sheet(1, 1_000_000, 0.0), sheet(2, 500_000, 0.02));
    let score_at = |offset: DVec3| {
        let fixture = empty();
        let shift = |points: &[DVec3]| moved(points, |point| point + offset);
        run(&ScoreJob {
            voxel: None,
            ..plain(&fixture, shift(&truth), shift(&reconstruction))
        })
        .unwrap()
    };
    let usual = score_at(DVec3::ZERO);
    assert!(
        (0.5..0.75).contains(&usual.precision),
        "{}",
        usual.precision
    );
    assert!((0.6..1.0).contains(&usual.recall), "{}", usual.recall);
    // UTM as it is, and ECEF where the input's own rounding moves points by up to 1e-9.
    let exact = score_at(DVec3::new(448_262.5, 5_427_700.25, 120.0));
    assert_eq!(exact.counts, usual.counts);
    let rounded = score_at(DVec3::new(-9_999_999.1, 4_711_234.7, 6_378_137.3));
    assert!((rounded.precision - usual.precision).abs() <= 1e-6);
    assert!((rounded.recall - usual.recall).abs() <= 1e-6);
}

/// The whole Tanks and Temples job with everything multiplied by a power of two.
fn aligned_at_scale(scale: f64) -> ScoreDocument {
    let fixture = Fixture::scaled(6000, scale);
    let job = ScoreJob {
        camera_distance: 0.2 * scale,
        one_profile: false,
        ..fixture.job("out", 0.05 * scale)
    };
    run(&job).unwrap()
}

#[test]
fn scales_by_powers_of_two_change_no_count_and_no_gate() {
    let usual = aligned_at_scale(1.0);
    assert!(usual.passed && usual.f_score > 0.85, "{}", usual.f_score);
    for exponent in [-20, -7, 9, 20] {
        let scale = 2f64.powi(exponent);
        let found = aligned_at_scale(scale);
        assert_eq!(found.counts, usual.counts, "2^{exponent}");
        // The toolbox's RMSE tolerance of 20 is in world units: it ends every stage at first where
        // the scene is small beside it.
        if exponent < 10 {
            assert_eq!(found.other_profile, usual.other_profile, "2^{exponent}");
        }
        assert_eq!(failed(&found), failed(&usual), "2^{exponent}");
        let steps = |document: &ScoreDocument| {
            let stages = document.alignment.icp.iter();
            stages
                .map(|stage| (stage.iterations, stage.fitness.to_bits()))
                .collect::<Vec<_>>()
        };
        assert_eq!(steps(&found), steps(&usual), "2^{exponent}");
        let distance = found.distances.truth_median.unwrap() / scale;
        assert_eq!(Some(distance), usual.distances.truth_median, "2^{exponent}");
    }
}

#[test]
fn two_million_identical_points_are_one_voxel_and_all_near() {
    let fixture = empty();
    let point = DVec3::new(0.5, 0.25, -0.125);
    let mut truth = vec![point; 2_000_000];
    truth.push(point + DVec3::X);
    let job = plain(&fixture, truth, vec![point; 2_000_000]);
    let thinned = run(&job).unwrap();
    assert_eq!(
        pair(&thinned.counts),
        [(2_000_000, 1, 1), (2_000_001, 2, 1)]
    );
    let all = run(&ScoreJob {
        voxel: None,
        out: fixture.path("all"),
        ..job
    })
    .unwrap();
    assert_eq!(
        pair(&all.counts),
        [
            (2_000_000, 2_000_000, 2_000_000),
            (2_000_001, 2_000_001, 2_000_000)
        ]
    );
}

#[test]
fn planes_lines_and_points_have_the_counts_of_their_formulas() {
    let steps = |count: u32| (0..count).map(f64::from);
    let line: Vec<DVec3> = steps(1000).map(|i| DVec3::X * i).collect();
    let plane: Vec<DVec3> = (0..1000u32)
        .map(|i| DVec3::new(f64::from(i % 100), f64::from(i / 100), 0.0))
        .collect();
    let one = vec![DVec3::new(3.0, 0.0, 0.0)];
    // At τ = 1.5 a point of a grid reaches its neighbours and the diagonal ones.
    for (truth, reconstruction, within) in [
        (&line, &line, [1000, 1000]),
        (&line, &one, [1, 3]),
        (&one, &line, [3, 1]),
        (&plane, &one, [1, 6]),
        // The line runs on far past the plane's first row.
        (&plane, &line, [101, 200]),
        (&one, &one, [1, 1]),
    ] {
        let fixture = empty();
        let job = ScoreJob {
            tau: vec![1.5],
            voxel: None,
            ..plain(&fixture, truth.clone(), reconstruction.clone())
        };
        let counts = run(&job).unwrap().counts;
        assert_eq!([counts.reconstruction.within, counts.truth.within], within);
    }
}

#[test]
fn degenerate_clouds_through_the_alignment_are_written_with_failed_gates() {
    let line = |count: u32| (0..count).map(|i| DVec3::X * (0.25 + f64::from(i) * 1e-3) * 0.5);
    for (name, points) in [
        ("a point", vec![DVec3::splat(0.05)]),
        ("one point many times", vec![DVec3::splat(0.05); 1000]),
        ("a line", line(500).collect()),
    ] {
        let fixture = Fixture::new(3000);
        fixture.put_cloud("rec.ply", points);
        let document = run(&fixture.job("out", 0.05)).unwrap();
        assert!(!document.passed, "{name}: {:?}", document.gates);
        assert!(document.recall < 0.1, "{name}: {}", document.recall);
        assert!(fixture.path("out/score.json").is_file(), "{name}");
    }
}

#[test]
fn clouds_that_coincide_and_lie_beside_the_truth_are_named_not_refused() {
    let truth = DVec3::new(1.0, 2.0, 3.0);
    let beside = truth + DVec3::X * 0.03;
    let many = vec![beside; 200_000];
    for (name, points) in [("one point", vec![beside]), ("the same many times", many)] {
        let fixture = empty();
        let job = ScoreJob {
            voxel: None,
            ..plain(&fixture, vec![truth], points)
        };
        let document = run(&job).unwrap();
        assert_eq!((document.precision, document.recall), (0.0, 0.0), "{name}");
        let warned = document.warnings.iter().find(|w| w.code == "low-at-tau");
        let said = &warned.unwrap_or_else(|| panic!("{name}")).message;
        assert!(
            said.contains("would move the cloud by 3.00 τ"),
            "{name}: {said}"
        );
    }
}

#[test]
fn disjoint_clouds_score_zero_and_say_how_far_apart_they_are() {
    let fixture = empty();
    let (truth, far) = (sheet(3, 5000, 0.0), sheet(4, 3000, 0.0));
    let far = moved(&far, |point| point + DVec3::X * 1e6);
    let document = run(&plain(&fixture, truth, far)).unwrap();
    let counts = document.counts;
    assert_eq!((counts.reconstruction.within, counts.truth.within), (0, 0));
    assert_eq!(
        (document.precision, document.recall, document.f_score),
        (0.0, 0.0, 0.0)
    );
    let median = document.distances.reconstruction_median.unwrap();
    assert!((median - 1e6).abs() < 3.0, "{median}");
}

#[test]
fn points_that_are_nowhere_are_counted_dropped_and_named_on_both_sides() {
    let fixture = empty();
    let good = sheet(5, 2000, 0.0);
    let with = |bad: &[DVec3]| {
        let mut all = good.clone();
        all.splice(700..700, bad.iter().copied());
        all
    };
    let nan = DVec3::new(f64::NAN, 0.0, 0.0);
    let infinite = DVec3::new(0.0, f64::NEG_INFINITY, 0.0);
    let job = plain(
        &fixture,
        with(&[infinite]),
        with(&[nan, DVec3::INFINITY, DVec3::NAN]),
    );
    let document = run(&job).unwrap();
    let (reconstruction, truth) = (document.counts.reconstruction, document.counts.truth);
    assert_eq!((reconstruction.input, reconstruction.non_finite), (2003, 3));
    assert_eq!((truth.input, truth.non_finite), (2001, 1));
    assert_eq!(document.f_score, 1.0);
    let said: Vec<&str> = document
        .warnings
        .iter()
        .map(|w| w.message.as_str())
        .collect();
    assert_eq!(said.len(), 2, "{said:?}");
    assert!(
        said.iter()
            .any(|text| text.contains("3 of 2003 points of the reconstruction"))
    );
    assert!(
        said.iter()
            .any(|text| text.contains("1 of 2001 points of the truth"))
    );
    let nothing = ScoreJob {
        out: fixture.path("nothing"),
        ..plain(&fixture, good.clone(), vec![nan; 5])
    };
    let error = run(&nothing).unwrap_err().to_string();
    assert!(
        error.contains("rec.ply") && error.contains("found 5, all at NaN"),
        "{error}"
    );
}

#[test]
fn an_empty_crop_is_an_error_for_the_truth_and_a_zero_for_the_reconstruction() {
    let fixture = empty();
    let points = sheet(6, 2000, 0.0);
    let job = |out: &str, crop: String| {
        fixture.put_text("crop.json", &crop);
        ScoreJob {
            crop: Some(fixture.path("crop.json")),
            out: fixture.path(out),
            ..plain(
                &fixture,
                points.clone(),
                moved(&points, |p| p + DVec3::Z * 50.0),
            )
        }
    };
    let nothing = run(&job("nothing", square(7.0, 8.0, [-1.0, 1.0])))
        .unwrap_err()
        .to_string();
    assert!(nothing.contains("none of 2000"), "{nothing}");
    let document = run(&job("zero", square(-1.0, 1.0, [-1.0, 1.0]))).unwrap();
    assert_eq!(
        (document.counts.reconstruction.cropped, document.f_score),
        (0, 0.0)
    );
    let warned = document
        .warnings
        .iter()
        .find(|w| w.code == "crop-keeps-little");
    assert!(warned.unwrap().message.contains("0 of 2000 points"));
}

#[test]
fn polygon_edges_voxel_borders_and_distances_of_exactly_tau() {
    // A lattice of step 1/16 over [0, 2]²; the reconstruction lies one step above it.
    let step = 0.0625;
    let lattice: Vec<DVec3> = (0..33 * 33u32)
        .map(|i| DVec3::new(f64::from(i % 33), f64::from(i / 33), 0.0) * step)
        .collect();
    let raised = moved(&lattice, |point| point + DVec3::Z * step);
    let fixture = empty();
    // Open3D's rule: the lower edges are outside, the upper ones inside; both ends of the axis are.
    fixture.put_text("crop.json", &square(0.5, 1.5, [0.0, step]));
    let base = ScoreJob {
        crop: Some(fixture.path("crop.json")),
        voxel: None,
        tau: vec![step, step.next_up()],
        ..plain(&fixture, lattice, raised)
    };
    let document = run(&base).unwrap();
    assert_eq!(pair(&document.counts), [(256, 256, 0), (256, 256, 0)]);
    let beyond = document.by_tolerance[1];
    assert_eq!(pair(&beyond.counts), [(256, 256, 256), (256, 256, 256)]);
    // The curve's last edge of the first τ is open: no point is nearer than τ.
    let name = "truth.precision.txt";
    let curve: Vec<f64> = read(&fixture.path("out"), name)
        .lines()
        .map(|line| line.parse().unwrap())
        .collect();
    assert_eq!((curve[98], curve[498]), (0.0, 1.0));
    // Voxels of 2 steps from half a voxel below the first point: points lie on every other border
    // and belong to the voxel above, so the first voxel holds 1 column, the next 2, the last 1.
    let thinned = run(&ScoreJob {
        voxel: Some(2.0 * step),
        out: fixture.path("thinned"),
        ..base
    })
    .unwrap();
    assert_eq!(pair(&thinned.counts), [(256, 81, 0), (256, 81, 0)]);
}

#[test]
fn every_file_is_the_same_at_1_2_and_8_threads() {
    let fixture = Fixture::new(20_000);
    fixture.put_cloud("rec.ply", fixture::bumpy_reconstruction(30_000));
    let score = |threads: usize| {
        let out = format!("threads{threads}");
        let job = ScoreJob {
            one_profile: false,
            bootstrap: 50,
            seeds: 2,
            ..fixture.job(&out, 0.05)
        };
        mvs_eval::parallel::with_threads(threads, || run(&job))
            .unwrap()
            .unwrap();
        files_of(&fixture, &out)
    };
    let one = score(1);
    assert!(
        one.len() == 9,
        "{:?}",
        one.iter().map(|file| &file.0).collect::<Vec<_>>()
    );
    for threads in [2, 8] {
        for (one, other) in one.iter().zip(&score(threads)) {
            assert!(one == other, "{} differs at {threads} threads", one.0);
        }
    }
}

/// Every file's name and bytes but `run.toml`, which names the folder itself.
fn files_of(fixture: &Fixture, out: &str) -> Vec<(String, Vec<u8>)> {
    let entries = std::fs::read_dir(fixture.path(out)).unwrap();
    let mut files: Vec<(String, Vec<u8>)> = entries
        .map(|entry| entry.unwrap())
        .filter(|entry| entry.file_name() != "run.toml")
        .map(|entry| {
            let name = entry.file_name().to_string_lossy().into_owned();
            (name, std::fs::read(entry.path()).unwrap())
        })
        .collect();
    files.sort();
    files
}

#[test]
fn the_order_of_points_moves_voxel_means_by_rounding_alone() {
    let fixture = Fixture::new(6000);
    let usual = run(&fixture.job("usual", 0.05)).unwrap();
    let turned = |mut points: Vec<DVec3>| {
        points.reverse();
        points
    };
    fixture.put_cloud("rec.ply", turned(fixture::bumpy_reconstruction(6000)));
    fixture.put_cloud("Synth/Synth.ply", turned(fixture::bumpy_truth(6000)));
    let other = run(&fixture.job("other", 0.05)).unwrap();
    assert_eq!(pair(&other.counts), pair(&usual.counts));
    let at = |document: &ScoreDocument| {
        let rows = document.alignment.truth_from_reconstruction;
        DMat4::from_cols_array_2d(&rows)
    };
    assert!(at(&usual).abs_diff_eq(at(&other), 1e-9));
}
