//! The whole path, from a mesh to a leaderboard.

use crate::support::{stderr, text};
use assert_cmd::Command;
use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

/// A quarter of what a thread has in bytes: on machines with many, one may be in the midst of several things.
const STACK: &str = "524288";

/// Runs the demo in `folder`; what it answers.
fn demo(folder: &Path, arguments: &[&str]) -> serde_json::Value {
    let mut command = Command::new(assert_cmd::cargo::cargo_bin!("mvs-eval"));
    let output = command
        .current_dir(folder)
        .env("RUST_MIN_STACK", STACK)
        .arg("demo")
        .args(arguments)
        .output()
        .unwrap();
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    // Its parts lie in a folder that is being made, by itself.
    assert!(
        !stderr(&output).contains("[unfinished]"),
        "{}",
        stderr(&output)
    );
    serde_json::from_slice(&output.stdout).unwrap()
}

/// The demo made small.
fn small_demo(folder: &Path, threads: &str) -> serde_json::Value {
    let size = ["--size", "160x120", "--views", "8", "--tau", "0.03"];
    demo(folder, &[&size[..], &["--threads", threads]].concat())
}

/// Every file below `folder` by its path.
fn files(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut found = BTreeMap::new();
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        if path.is_dir() {
            let below = files(&path).into_iter();
            found.extend(below.map(|(below, bytes)| (format!("{name}/{below}"), bytes)));
        } else {
            found.insert(name, fs::read(&path).unwrap());
        }
    }
    found
}

#[test]
fn the_demo_makes_the_same_bytes_at_any_thread_count_and_again() {
    let (one, four) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let answer = small_demo(one.path(), "1");
    assert_eq!(small_demo(four.path(), "4"), answer);
    let (at_one, at_four) = (files(one.path()), files(four.path()));
    assert!(at_one.len() > 100, "{} files", at_one.len());
    assert!(at_one.keys().eq(at_four.keys()));
    for (name, bytes) in &at_one {
        assert!(at_four[name] == *bytes, "{name} differs");
    }
    assert_eq!(
        small_demo(one.path(), "2"),
        answer,
        "a finished demo is made again without --force"
    );
    assert!(files(one.path()) == at_one);
}

#[test]
fn the_least_number_of_views_works_and_fewer_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let small = ["--size", "160x120", "--tau", "0.03"];
    demo(folder.path(), &[&small[..], &["--views", "5"]].concat());
    let mut command = Command::new(assert_cmd::cargo::cargo_bin!("mvs-eval"));
    let output = command
        .current_dir(folder.path())
        .args(["demo", "--views", "4", "--out", "other"])
        .output()
        .unwrap();
    assert_eq!(output.status.code(), Some(2));
    let said = stderr(&output);
    assert!(
        said.contains("--views: expected at least 5, found 4"),
        "{said}"
    );
    assert!(!folder.path().join("other").exists());
}

#[test]
fn a_demo_with_fewer_views_leaves_none_of_the_one_before() {
    let (again, anew) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let with = |views, folder: &Path| {
        let size = ["--size", "160x120", "--tau", "0.03", "--force"];
        demo(folder, &[&size[..], &["--views", views]].concat())
    };
    with("10", again.path());
    assert_eq!(with("8", again.path()), with("8", anew.path()));
    assert!(files(again.path()) == files(anew.path()));
}

#[test]
fn the_demo_scores_about_what_its_noise_predicts() {
    let folder = tempfile::tempdir().unwrap();
    let answer = demo(folder.path(), &["--threads", "32"]);
    let number = |value: &serde_json::Value| value.as_f64().unwrap();
    // The model knows nothing of pixels that lie between surfaces: they cost some recall.
    let (precision, recall) = (number(&answer["precision"]), number(&answer["recall"]));
    let predicted = &answer["predicted"];
    assert!(
        (precision - number(&predicted["precision"])).abs() < 0.01,
        "{answer}"
    );
    assert!(
        (recall - number(&predicted["recall"])).abs() < 0.05,
        "{answer}"
    );

    let board = fs::read_to_string(folder.path().join("demo-out/report/leaderboard.csv")).unwrap();
    assert!(board.contains("noisy-depth"), "{board}");
    let svg = files(&folder.path().join("demo-out/score"));
    assert!(
        svg.keys().any(|name| name.ends_with(".svg")),
        "{:?}",
        svg.keys()
    );
    let sheet = folder.path().join("demo-out/contact_sheet.png");
    let sheet = mvs_datasets::layout::files::read_image(&sheet).unwrap();
    assert!(
        sheet.width() > 900 && sheet.height() > 400,
        "{}",
        text(folder.path())
    );
}
