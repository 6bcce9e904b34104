//! Scoring held to what Open3D 0.20 gave for a real pair of clouds and for scenes from formulas.

mod after;
mod batch;
mod extremes;
mod faults;
mod fixture;
mod official;
mod plain;
mod real;

use crate::support::real_data;
use mvs_datasets::layout::files::write_atomically;
use mvs_eval::jobs::Context;
use mvs_eval::jobs::score::{self, Protocol, ScoreDocument, ScoreJob};
use mvs_eval::progress::Silent;
use mvs_eval::score::tnt::Profile;
use mvs_eval::warning::Warnings;
use serde_json::Value;
use std::fs;
use std::io::Write;
use std::path::Path;

fn run(job: &ScoreJob) -> mvs_eval::Result<ScoreDocument> {
    let warnings = Warnings::default();
    let context = Context {
        progress: &Silent,
        warnings: &warnings,
        force: false,
    };
    score::run(job, &context)
}

/// The names of the failed gates.
fn failed(document: &ScoreDocument) -> Vec<&str> {
    let failed = document.gates.iter().filter(|gate| !gate.passed);
    failed.map(|gate| gate.code.as_str()).collect()
}

fn expected(folder: &Path) -> Value {
    let text = fs::read_to_string(folder.join("expected_o3d020.json")).unwrap();
    serde_json::from_str(&text).unwrap()
}

fn write_transform(path: &Path, rows: &Value) {
    let rows = rows.as_array().unwrap().iter();
    let line = |row: &Value| {
        let numbers = row.as_array().unwrap().iter();
        numbers
            .map(|n| n.as_f64().unwrap().to_string())
            .collect::<Vec<_>>()
            .join(" ")
    };
    let text = rows.map(line).collect::<Vec<_>>().join("\n");
    write_atomically(path, |out| out.write_all(text.as_bytes())).unwrap();
}

fn saharov(folder: &Path, out: &Path) -> ScoreJob {
    ScoreJob {
        protocol: Protocol::Tnt,
        scene: Some(folder.to_path_buf()),
        name: Some("saharov".into()),
        reconstruction: folder.join("rec/saharov_rec.ply"),
        tau: vec![0.03],
        one_profile: true,
        out: out.to_path_buf(),
        ..ScoreJob::default()
    }
}

#[test]
fn saharov_counts_and_scores_are_those_of_open3d_at_both_transforms() {
    let Some(folder) = real_data("pair_saharov") else {
        return;
    };
    let expected = expected(&folder);
    let temporary = tempfile::tempdir().unwrap();
    for state in ["lsq", "icp"] {
        let transform = temporary.path().join(format!("{state}.txt"));
        write_transform(&transform, &expected[format!("T_{state}")]);
        let document = run(&ScoreJob {
            transform: Some(transform),
            ..saharov(&folder, &temporary.path().join(state))
        })
        .unwrap();
        let wanted = &expected[format!("score_{state}")];
        let counts = [
            ("rec", document.counts.reconstruction.input),
            ("rec_crop", document.counts.reconstruction.cropped),
            ("rec_down", document.counts.reconstruction.evaluated),
            ("gt", document.counts.truth.input),
            ("gt_crop", document.counts.truth.cropped),
            ("gt_down", document.counts.truth.evaluated),
        ];
        for (name, count) in counts {
            assert_eq!(
                count as u64,
                wanted[name].as_u64().unwrap(),
                "{state} {name}"
            );
        }
        let number = |name: &str| wanted[name].as_f64().unwrap();
        assert_eq!(document.precision, number("precision"), "{state}");
        assert_eq!(document.recall, number("recall"), "{state}");
        assert!(
            (document.f_score - number("fscore")).abs() < 1e-15,
            "{state}"
        );
        let medians = (
            document.distances.reconstruction_median,
            document.distances.truth_median,
        );
        assert!(
            (medians.0.unwrap() - number("median_d1")).abs() < 1e-12,
            "{state}"
        );
        assert!(
            (medians.1.unwrap() - number("median_d2")).abs() < 1e-12,
            "{state}"
        );
    }
}

#[test]
fn saharov_is_refined_from_f_033_to_f_0966() {
    let Some(folder) = real_data("pair_saharov") else {
        return;
    };
    let expected = expected(&folder);
    let temporary = tempfile::tempdir().unwrap();
    let transform = temporary.path().join("start.txt");
    write_transform(&transform, &expected["T_lsq"]);
    for profile in [Profile::Official, Profile::Strict] {
        let document = run(&ScoreJob {
            transform: Some(transform.clone()),
            refine: true,
            profile,
            ..saharov(&folder, &temporary.path().join(profile.to_string()))
        })
        .unwrap();
        assert!(
            (document.f_score - 0.966).abs() < 0.002,
            "{profile}: {}",
            document.f_score
        );
    }
}

#[test]
fn saharov_is_aligned_from_its_cameras_alone() {
    let Some(folder) = real_data("pair_saharov") else {
        return;
    };
    let temporary = tempfile::tempdir().unwrap();
    let document = run(&ScoreJob {
        trajectory: Some(folder.join("rec/saharov_rec.log")),
        ..saharov(&folder, &temporary.path().join("out"))
    })
    .unwrap();
    assert!(
        (document.f_score - 0.966).abs() < 0.002,
        "{}",
        document.f_score
    );
}
