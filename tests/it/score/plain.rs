//! The plain protocol: two clouds in one frame.

use super::fixture::{Fixture, read, truth};
use super::run;
use glam::DVec3;
use mvs_datasets::layout::files;
use mvs_eval::jobs::score::{Protocol, ScoreJob};
use mvs_eval::report::record;

fn fixture() -> (Fixture, ScoreJob) {
    let fixture = Fixture {
        folder: tempfile::tempdir().unwrap(),
    };
    let points = truth(5000);
    let mut raised: Vec<DVec3> = points
        .iter()
        .map(|&point| point + DVec3::Z * 0.01)
        .collect();
    raised.push(DVec3::NAN);
    fixture.put_cloud("truth.ply", points);
    fixture.put_cloud("raised.ply", raised);
    let job = ScoreJob {
        protocol: Protocol::Plain,
        truth: Some(fixture.path("truth.ply")),
        reconstruction: fixture.path("raised.ply"),
        tau: vec![0.02, 0.001],
        out: fixture.path("out"),
        ..ScoreJob::default()
    };
    (fixture, job)
}

#[test]
fn several_tolerances_give_a_list_and_the_first_stands_on_top() {
    let (fixture, job) = fixture();
    let document = run(&job).unwrap();
    assert_eq!((document.tolerance, document.f_score), (0.02, 1.0));
    assert_eq!(document.by_tolerance.len(), 2);
    assert!(document.by_tolerance[1].f_score < 0.1);
    let counts = document.counts.reconstruction;
    assert_eq!(
        (counts.input, counts.non_finite, counts.evaluated),
        (5001, 1, 5000)
    );
    assert_eq!(document.warnings[0].code, "non-finite-points");
    assert!(document.warnings[0].message.contains("1 of 5001"));
    let rows = record::read(read(&fixture.path("out"), "scores.csv").as_bytes()).unwrap();
    assert_eq!(rows.len(), 2);
    assert_eq!(
        (rows[0].threshold, rows[1].threshold),
        (Some(0.001), Some(0.02))
    );
    assert_eq!((rows[1].fscore, rows[1].status.as_str()), (Some(1.0), "ok"));
}

#[test]
fn curves_and_error_clouds_are_the_toolboxs() {
    let (fixture, job) = fixture();
    let document = run(&job).unwrap();
    let out = fixture.path("out");
    let curve = read(&out, "truth.precision.txt");
    let lines: Vec<f64> = curve.lines().map(|line| line.parse().unwrap()).collect();
    assert_eq!(lines.len(), 499);
    // Bin 99 ends at τ.
    assert_eq!(lines[99], document.precision);
    let summary = read(&out, "truth.prf_tau_plotstr.txt");
    let summary: Vec<f64> = summary.lines().map(|line| line.parse().unwrap()).collect();
    assert_eq!(summary, [1.0, 1.0, 1.0, 0.02, 5.0]);
    let errors = files::read_cloud(&out.join("truth.precision.ply")).unwrap();
    assert_eq!(errors.len(), 5000);
    assert!(errors.colors().is_some());
    for name in ["PR_truth_@d_th_0_0200.png", "PR_truth_@d_th_0_0200.svg"] {
        assert!(out.join(name).is_file(), "{name}");
    }
    let header = std::fs::read(out.join("truth.recall.ply")).unwrap();
    assert!(String::from_utf8_lossy(&header[..400]).contains("property float error"));
}

#[test]
fn rows_name_their_inputs_by_sha256() {
    use mvs_eval::provenance::sha256;
    let fixture = Fixture::new(1000);
    run(&fixture.job("out", 0.05)).unwrap();
    let rows = record::read(read(&fixture.path("out"), "scores.csv").as_bytes()).unwrap();
    let row = &rows[0];
    for (found, file) in [
        (&row.rec_sha256, "rec.ply"),
        (&row.truth_sha256, "Synth/Synth.ply"),
        (&row.crop_sha256, "Synth/Synth.json"),
        (&row.log_sha256, "rec.log"),
        (&row.trans_sha256, "Synth/Synth_trans.txt"),
    ] {
        assert_eq!(*found, sha256(&fixture.path(file)).unwrap(), "{file}");
    }
    let (plain, job) = self::fixture();
    run(&job).unwrap();
    let rows = record::read(read(&plain.path("out"), "scores.csv").as_bytes()).unwrap();
    assert!(rows[0].rec_sha256.len() == 64 && rows[0].log_sha256.is_empty());
}

#[test]
fn what_does_not_go_together_gets_a_sentence() {
    let (_fixture, job) = fixture();
    let said = |job: ScoreJob| run(&job).unwrap_err().to_string();
    let no_tau = ScoreJob {
        tau: Vec::new(),
        ..job.clone()
    };
    assert!(said(no_tau).starts_with("--tau: "));
    let no_truth = ScoreJob {
        truth: None,
        ..job.clone()
    };
    assert!(said(no_truth).starts_with("--truth: "));
    let negative = ScoreJob {
        tau: vec![-1.0],
        ..job.clone()
    };
    assert!(said(negative).contains("above 0, found -1"));
    let missing = ScoreJob {
        reconstruction: "missing.ply".into(),
        ..job.clone()
    };
    assert!(said(missing).contains("missing.ply"));
    let scene = ScoreJob {
        scene: Some("scene".into()),
        ..job
    };
    assert!(said(scene).starts_with("--scene: "));
}

#[test]
fn the_interval_holds_the_score() {
    let (_fixture, job) = fixture();
    let document = run(&ScoreJob {
        tau: vec![0.0105],
        bootstrap: 200,
        ..job
    })
    .unwrap();
    let interval = document.confidence.unwrap();
    assert!(interval.lower <= document.f_score && document.f_score <= interval.upper);
    assert_eq!(interval.resamples, 200);
}
