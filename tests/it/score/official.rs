//! The official procedure held to Open3D 0.20: see tests/reference/tnt_open3d.py.

use super::fixture::{
    self, given_poses, reference_poses, truth_from_reference, unregistered, video,
};
use glam::{DMat4, DVec2};
use mvs_datasets::format::log::{self, LogPose};
use mvs_eval::score::cameras::Trajectories;
use mvs_eval::score::tnt::{self, Inputs, Options, Profile, Start};
use mvs_eval::score::{Evaluation, FinitePoints, SideCounts};
use mvs_metrics::crop::Prism;
use mvs_metrics::{Curve, Tolerance};
use serde_json::Value;
use std::sync::LazyLock;

static REFERENCE: LazyLock<Value> = LazyLock::new(|| {
    serde_json::from_str(include_str!("../../reference/tnt_open3d.json")).unwrap()
});

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap()
}

fn count(value: &Value) -> usize {
    usize::try_from(value.as_u64().unwrap()).unwrap()
}

fn matrix(rows: &Value) -> DMat4 {
    let rows = rows.as_array().unwrap().iter();
    let numbers: Vec<f64> = rows
        .flat_map(|row| row.as_array().unwrap())
        .map(number)
        .collect();
    DMat4::from_cols_slice(&numbers).transpose()
}

fn inputs(start: Start) -> Inputs {
    let polygon = fixture::NOTCHED.map(DVec2::from);
    Inputs {
        reconstruction: FinitePoints::new(fixture::reconstruction(30_000)),
        truth: FinitePoints::new(fixture::truth(40_000)),
        crop: Prism::new(2, (-0.5, 0.4375), &polygon).unwrap(),
        tolerance: Tolerance::new(number(&REFERENCE["tau"])).unwrap(),
        start,
    }
}

fn options(seed: u64) -> Options {
    Options {
        profile: Profile::Official,
        camera_distance: 0.2,
        seed,
    }
}

fn check_side(found: SideCounts, curve: &Curve, expected: &Value, place: &str) {
    let counts = [
        ("input", found.input),
        ("cropped", found.cropped),
        ("evaluated", found.evaluated),
        ("within", found.within),
    ];
    for (name, found) in counts {
        assert_eq!(found, count(&expected[name]), "{place} {name}");
    }
    let sampled: Vec<f64> = curve.fractions().into_iter().step_by(50).collect();
    let wanted: Vec<f64> = expected["curve"]
        .as_array()
        .unwrap()
        .iter()
        .map(number)
        .collect();
    assert_eq!(sampled, wanted, "{place}");
}

fn check_score(evaluation: &Evaluation, tolerance: Tolerance, expected: &Value, case: &str) {
    let (reconstruction, truth) = evaluation.counts(tolerance);
    let (precision, recall) = evaluation.curves(tolerance);
    check_side(
        reconstruction,
        &precision,
        &expected["reconstruction"],
        &format!("{case} rec"),
    );
    check_side(truth, &recall, &expected["truth"], &format!("{case} truth"));
    let score = evaluation.score(tolerance);
    assert_eq!(score.precision(), number(&expected["precision"]), "{case}");
    assert_eq!(score.recall(), number(&expected["recall"]), "{case}");
    assert_eq!(score.f_score(), number(&expected["f_score"]), "{case}");
}

#[test]
fn from_the_recorded_start_stages_and_counts_are_open3ds() {
    for case in ["clean", "unregistered", "video"] {
        let expected = &REFERENCE["cases"][case];
        let inputs = inputs(Start::Refined(matrix(&expected["start"])));
        let aligned = tnt::align(&inputs, &options(0)).unwrap();
        let motion = aligned.motion.clone();
        let stages = expected["stages"].as_array().unwrap();
        assert_eq!(motion.stages.len(), stages.len());
        for (found, expected) in motion.stages.iter().zip(stages) {
            assert_eq!(
                found.reconstruction_points,
                count(&expected["source"]),
                "{case}"
            );
            assert_eq!(found.truth_points, count(&expected["target"]), "{case}");
            assert_eq!(found.fitness, number(&expected["fitness"]), "{case}");
            assert!(
                (found.inlier_rmse - number(&expected["rmse"])).abs() < 1e-9,
                "{case}"
            );
            let wanted = matrix(&expected["transform"]);
            assert!(
                found.truth_from_reconstruction.abs_diff_eq(wanted, 1e-9),
                "{case}"
            );
        }
        let evaluation = tnt::evaluate(&inputs, motion.truth_from_reconstruction).unwrap();
        check_score(&evaluation, inputs.tolerance, &expected["score"], case);
        // The same by the truth that ICP left, and by inputs that go as they are used.
        let tolerance = inputs.tolerance;
        assert!(aligned.evaluate().unwrap() == evaluation, "{case}");
        let last = tnt::align_last(inputs, &options(0)).unwrap();
        assert_eq!(last.motion, motion, "{case}");
        let last = last.evaluate().unwrap();
        assert!(last == evaluation, "{case}");
        check_score(&last, tolerance, &expected["score"], case);
    }
}

fn trajectories(case: &str) -> Trajectories {
    let mut given = given_poses();
    let mut mapping = None;
    if case == "unregistered" {
        for index in (0..given.len()).step_by(5) {
            given[index] = unregistered(index);
        }
    }
    if case == "video" {
        let (poses, text) = video();
        given = poses;
        mapping = Some(log::read_mapping(&text).unwrap());
    }
    Trajectories {
        given: reread(&given),
        reference: reread(&reference_poses()),
        mapping,
        named: false,
        truth_from_reference: truth_from_reference(),
    }
}

/// Poses as they come back from a file.
fn reread(poses: &[LogPose]) -> Vec<LogPose> {
    let mut bytes = Vec::new();
    log::write(&mut bytes, poses).unwrap();
    log::read(std::str::from_utf8(&bytes).unwrap()).unwrap()
}

#[test]
fn the_official_pipelines_f_lies_within_the_spread_of_open3ds_over_seeds() {
    for case in ["clean", "unregistered", "video"] {
        let expected = REFERENCE["cases"][case]["f_over_seeds"].as_array().unwrap();
        let spread: Vec<f64> = expected.iter().map(number).collect();
        let inputs = inputs(Start::Trajectories(trajectories(case)));
        let motion = tnt::align(&inputs, &options(0)).unwrap().motion;
        let evaluation = tnt::evaluate(&inputs, motion.truth_from_reconstruction).unwrap();
        let f = evaluation.score(inputs.tolerance).f_score();
        let min = spread.iter().copied().fold(f64::INFINITY, f64::min);
        let max = spread.iter().copied().fold(0.0, f64::max);
        // One draw more may well lie beyond eight others: by half their width at most.
        let margin = (max - min) / 2.0;
        assert!(
            (min - margin..=max + margin).contains(&f),
            "{case}: {f} not in {min} … {max}"
        );
    }
}

/// The patch is smooth, open, noisy and has outliers: nothing but the cameras tells its scale, and a
/// converged ICP that let noise draw the scale would end at 0.83.
#[test]
fn the_strict_profile_keeps_the_scale_of_a_smooth_noisy_patch() {
    for case in ["clean", "unregistered", "video"] {
        let inputs = inputs(Start::Trajectories(trajectories(case)));
        let strict = Options {
            profile: Profile::Strict,
            ..options(0)
        };
        let motion = tnt::align(&inputs, &strict).unwrap().motion;
        let scale = tnt::scale_of(motion.truth_from_reconstruction) / 2.0;
        assert!((scale - 1.0).abs() < 0.003, "{case}: {scale}");
        assert!(motion.stages.iter().all(|stage| stage.converged), "{case}");
        let f_at = |motion| {
            let evaluation = tnt::evaluate(&inputs, motion).unwrap();
            evaluation.score(inputs.tolerance).f_score()
        };
        let (found, exact) = (
            f_at(motion.truth_from_reconstruction),
            f_at(fixture::scan_from_own()),
        );
        assert!((found - exact).abs() < 0.002, "{case}: {found} {exact}");
    }
}
