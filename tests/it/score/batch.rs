//! Batches: every scene and method, going on after failures.

use super::fixture::{
    Fixture, bumpy_reconstruction, given_centres, given_poses, read, scan_from_own,
};
use crate::support::{mvs_eval, stderr, text};
use assert_cmd::Command;
use glam::DVec3;
use mvs_eval::report::record;
use std::fs;

#[test]
fn a_batch_goes_on_after_failures_and_says_why() {
    let fixture = Fixture::new(3000);
    let methods = [
        "a_good",
        "b_without_cameras",
        "c_broken",
        "d_by_transform",
        "e_by_model",
    ];
    for method in methods {
        fixture.put_cloud(
            &format!("Synth/{method}/cloud.ply"),
            bumpy_reconstruction(3000),
        );
    }
    let mut points = bumpy_reconstruction(3000);
    points.push(DVec3::NAN);
    fixture.put_cloud("Synth/d_by_transform/cloud.ply", points);
    fixture.put_log("Synth/a_good/cams.log", &given_poses());
    fixture.put_log("Synth/c_broken/cams.log", &given_poses());
    fixture.put_text("Synth/c_broken/cloud.ply", "not a ply");
    fixture.put_transform("Synth/d_by_transform/t.txt", scan_from_own());
    let own_cameras = given_centres();
    fixture.put_model("Synth/e_by_model", &own_cameras);
    fixture.put_text("Synth/images/readme", "no method");
    let output = Command::cargo_bin("mvs-eval")
        .unwrap()
        .current_dir(fixture.folder.path())
        .args([
            "score",
            "--all",
            ".",
            "--tau",
            "0.05",
            "--one-profile",
            "--quiet",
        ])
        .args(["--out", "results"])
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(1), "{said}");
    let rows = record::read(read(&fixture.path("results"), "scores.csv").as_bytes()).unwrap();
    let status: Vec<(&str, &str)> = rows
        .iter()
        .map(|row| (row.method.as_str(), row.status.as_str()))
        .collect();
    assert_eq!(rows.len(), 5, "{status:?}");
    assert_eq!(
        [status[0], status[3], status[4]],
        [
            ("a_good", "ok"),
            ("d_by_transform", "ok"),
            ("e_by_model", "ok")
        ]
    );
    assert_eq!(rows[4].fscore, rows[0].fscore, "the same cameras");
    assert!(
        status[1]
            .1
            .contains("found no .log of its cameras, no COLMAP model"),
        "{status:?}"
    );
    assert!(status[2].1.starts_with("failed: "), "{status:?}");
    assert!(rows[0].fscore.unwrap() > 0.8 && rows[1].fscore.is_none());
    let warned = "warning [non-finite-points]: Synth/d_by_transform: ";
    assert!(said.contains(warned), "{said}");
    assert!(fixture.path("results/Synth/a_good/score.json").is_file());
}

#[test]
fn a_batch_that_is_replaced_leaves_no_result_of_what_failed_or_is_gone() {
    let fixture = Fixture::new(3000);
    for method in ["breaks", "goes", "stays"] {
        let cloud = format!("Synth/{method}/cloud.ply");
        fixture.put_cloud(&cloud, bumpy_reconstruction(3000));
        fixture.put_log(&format!("Synth/{method}/cams.log"), &given_poses());
    }
    let out = fixture.path("results");
    let root = fixture.folder.path();
    let score = || {
        let arguments = ["score", "--all", text(root), "--out", text(&out), "--force"];
        let more = ["--tau", "0.05", "--one-profile", "--quiet"];
        mvs_eval(&[&arguments[..], &more].concat())
    };
    let there = |method: &str| out.join("Synth").join(method).exists();
    let first = score();
    assert_eq!(first.status.code(), Some(0), "{}", stderr(&first));
    assert!(["breaks", "goes", "stays"].into_iter().all(there));
    fixture.put_text("results/Synth/goes/mine.txt", "mine");
    fs::remove_dir_all(fixture.path("Synth/goes")).unwrap();
    fixture.put_text("Synth/breaks/cloud.ply", "not a ply");
    let second = score();
    assert_eq!(second.status.code(), Some(1), "{}", stderr(&second));
    assert!(!there("breaks") && out.join("Synth/stays/score.json").is_file());
    let left = fs::read_dir(out.join("Synth/goes")).unwrap();
    let left: Vec<_> = left.map(|entry| entry.unwrap().file_name()).collect();
    assert_eq!(left, ["mine.txt"]);
}

#[test]
fn submissions_lie_by_method_and_scene() {
    let fixture = Fixture::new(3000);
    fixture.put_cloud("methods/ours/Synth.ply", bumpy_reconstruction(3000));
    fixture.put_log("methods/ours/Synth.log", &given_poses());
    fixture.put_log("methods/theirs/Synth.log", &given_poses());
    fixture.put_cloud("methods/their_model/Synth.ply", bumpy_reconstruction(3000));
    fixture.put_model("methods/their_model/Synth", &given_centres());
    let output = Command::cargo_bin("mvs-eval")
        .unwrap()
        .current_dir(fixture.folder.path())
        .args([
            "score",
            "--all",
            ".",
            "--methods",
            "methods",
            "--tau",
            "0.05",
        ])
        .args(["--one-profile", "--quiet", "--out", "results"])
        .output()
        .unwrap();
    assert_eq!(output.status.code(), Some(1));
    let rows = record::read(read(&fixture.path("results"), "scores.csv").as_bytes()).unwrap();
    assert_eq!(
        (rows[0].method.as_str(), rows[0].status.as_str()),
        ("ours", "ok")
    );
    assert_eq!(
        (rows[1].method.as_str(), rows[1].status.as_str()),
        ("their_model", "ok")
    );
    assert_eq!(rows[1].fscore, rows[0].fscore);
    let model = read(&fixture.path("results"), "run.toml");
    assert!(model.contains("methods/their_model/Synth/sparse/0/images.txt"));
    assert!(model.contains("protocol = \"tnt\""), "{model}");
    assert_eq!(rows[2].method, "theirs");
    assert!(
        rows[2].status.contains("found no Synth.ply"),
        "{}",
        rows[2].status
    );
}

#[test]
fn the_order_in_which_files_were_made_changes_no_byte() {
    let methods = ["a", "b", "c"];
    let scores = |order: &[&str]| {
        let fixture = Fixture::new(1500);
        for method in order {
            fixture.put_log(&format!("Synth/{method}/cams.log"), &given_poses());
            fixture.put_cloud(
                &format!("Synth/{method}/cloud.ply"),
                bumpy_reconstruction(1500),
            );
        }
        let job = mvs_eval::jobs::score::ScoreJob {
            all: Some(fixture.path("")),
            tau: vec![0.05],
            one_profile: true,
            out: fixture.path("results"),
            ..Default::default()
        };
        let warnings = mvs_eval::warning::Warnings::default();
        let context = mvs_eval::jobs::Context {
            progress: &mvs_eval::progress::Silent,
            warnings: &warnings,
            force: false,
        };
        mvs_eval::jobs::score_all::run(&job, &context).unwrap();
        let names = [
            "scores.csv",
            "Synth/a/score.json",
            "Synth/c/Synth.recall.ply",
        ];
        names.map(|name| std::fs::read(fixture.path("results").join(name)).unwrap())
    };
    let mut reversed = methods;
    reversed.reverse();
    assert!(scores(&methods) == scores(&reversed));
}

#[test]
fn what_a_batch_cannot_take_apart_is_named() {
    let fixture = Fixture::new(1500);
    for method in ["logs", "notes", "transforms"] {
        let cloud = bumpy_reconstruction(1500);
        fixture.put_cloud(&format!("Synth/{method}/cloud.ply"), cloud);
    }
    fixture.put_log("Synth/logs/one.log", &given_poses());
    fixture.put_log("Synth/logs/two.log", &given_poses());
    fixture.put_text("Synth/notes/readme.txt", "made on a Tuesday");
    fixture.put_transform("Synth/transforms/t.txt", scan_from_own());
    fixture.put_text("Synth/transforms/readme.txt", "made on a Monday");
    let run = |more: &[&str]| {
        let root = fixture.path("");
        let arguments = [
            "score",
            "--all",
            text(&root),
            "--tau",
            "0.05",
            "--one-profile",
        ];
        mvs_eval(&[&arguments, more].concat())
    };
    let out = fixture.path("results");
    let scored = run(&["--out", text(&out)]);
    assert_eq!(scored.status.code(), Some(1), "{}", stderr(&scored));
    let rows = record::read(read(&out, "scores.csv").as_bytes()).unwrap();
    let status: Vec<&str> = rows.iter().map(|row| row.status.as_str()).collect();
    assert!(
        status[0].contains("expected one .log, found one.log, two.log"),
        "{status:?}"
    );
    assert!(status[1].contains("no .txt with its transform (") && status[1].contains("readme.txt"));
    assert_eq!(status[2], "ok", "the readme beside it is no transform");
    assert!(
        rows.iter()
            .all(|row| row.threshold == Some(0.05) && row.unit == "world")
    );
    let hashes = read(&out, "run.toml");
    for name in [
        "Synth/Synth.ply",
        "Synth/transforms/t.txt",
        "Synth/transforms/cloud.ply",
    ] {
        assert!(hashes.contains(&format!("{name}\" = ")), "{name}: {hashes}");
    }

    let foreign = run(&["--name", "x", "--out", text(&fixture.path("x"))]);
    assert!(stderr(&foreign).contains("--name: does not go with --all"));
    for suffix in [".ply", ".json", "_COLMAP_SfM.log", "_trans.txt"] {
        let bytes = std::fs::read(fixture.path(&format!("Synth/Synth{suffix}"))).unwrap();
        crate::support::write(&fixture.path(&format!("Synth_backup/Synth{suffix}")), bytes);
    }
    let twice = run(&["--out", text(&fixture.path("twice"))]);
    assert_eq!(twice.status.code(), Some(2));
    let said = stderr(&twice);
    assert!(
        said.contains("Synth and ") && said.contains("Synth_backup with the files"),
        "{said}"
    );
}

/// One method of one scene, and how it is scored with further arguments.
fn batch_of_one() -> (Fixture, impl Fn(&[&str]) -> std::process::Output) {
    let fixture = Fixture::new(1500);
    fixture.put_cloud("Synth/ours/cloud.ply", bumpy_reconstruction(1500));
    fixture.put_log("Synth/ours/cams.log", &given_poses());
    let root = fixture.path("");
    let score = move |more: &[&str]| {
        let arguments = ["score", "--all", text(&root), "--one-profile", "--quiet"];
        mvs_eval(&[&arguments[..], more].concat())
    };
    (fixture, score)
}

#[test]
fn a_value_that_no_scene_can_be_scored_with_leaves_the_batch_before_it() {
    let (fixture, score) = batch_of_one();
    let out = fixture.path("results");
    let first = score(&["--tau", "0.05", "--out", text(&out)]);
    assert_eq!(first.status.code(), Some(0), "{}", stderr(&first));
    let names = ["run.toml", "scores.csv", "Synth/ours/score.json"];
    let bytes = || names.map(|name| read(&out, name));
    let before = bytes();
    for (wrong, said) in [
        (
            &["--tau", "0.05", "--bootstrap", "20"][..],
            "--bootstrap: expected at least 40",
        ),
        (&["--tau", "0.01,0.02"], "--tau: expected one τ, found 2"),
        (
            &["--tau", "0.01,0.01"],
            "--tau: expected distinct distances",
        ),
        (&["--tau", "nan"], "expected a distance above 0"),
        (
            &["--tau", "0.05", "--camera-distance", "-1"],
            "--camera-distance: expected a distance above 0",
        ),
    ] {
        let refused = score(&[wrong, &["--out", text(&out), "--force"]].concat());
        assert_eq!(
            refused.status.code(),
            Some(2),
            "{wrong:?}: {}",
            stderr(&refused)
        );
        assert!(
            stderr(&refused).contains(said),
            "{wrong:?}: {}",
            stderr(&refused)
        );
        assert!(bytes() == before, "{wrong:?}");
    }
}

#[test]
fn no_result_lies_in_its_method_s_folder_and_a_batch_is_no_unfinished_input_of_its_own() {
    let (fixture, score) = batch_of_one();
    let tau = ["--tau", "0.05", "--force", "--out"];
    let refused = score(&[&tau[..], &[text(&fixture.path(""))]].concat());
    assert_eq!(refused.status.code(), Some(2), "{}", stderr(&refused));
    let said = "Synth/ours: expected another folder for the result than the method's own";
    assert!(stderr(&refused).contains(said), "{}", stderr(&refused));
    assert!(!fixture.path("Synth/ours/run.partial.toml").exists());
    let within = score(&[&tau[..], &[text(&fixture.path("Synth"))]].concat());
    assert_eq!(within.status.code(), Some(0), "{}", stderr(&within));
    assert!(
        !stderr(&within).contains("[unfinished]"),
        "{}",
        stderr(&within)
    );
    assert!(fixture.path("Synth/Synth/ours/score.json").is_file());
}
