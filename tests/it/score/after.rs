//! What follows scores: `report` and `compare` of batches, with and without failures.

use super::fixture::{Fixture, bumpy_reconstruction, given_poses, read};
use crate::support::{mvs_eval, stderr, text, write};
use mvs_eval::report::leaderboard::{boards, site_tables};
use mvs_eval::report::record::{self, Record};
use mvs_eval::report::table_md;
use serde_json::Value;
use std::process::Output;

/// A scene with a sound method, one whose log is shifted and one without cameras.
fn three_methods() -> Fixture {
    let fixture = Fixture::new(3000);
    for method in ["a_good", "b_shifted", "c_broken"] {
        let cloud = bumpy_reconstruction(3000);
        fixture.put_cloud(&format!("Synth/{method}/cloud.ply"), cloud);
    }
    fixture.put_log("Synth/a_good/cams.log", &given_poses());
    let mut shifted = given_poses();
    shifted.rotate_left(3);
    fixture.put_log("Synth/b_shifted/cams.log", &shifted);
    fixture
}

fn batch(fixture: &Fixture, out: &str) -> Output {
    mvs_eval(&[
        "score",
        "--all",
        text(&fixture.path("")),
        "--tau",
        "0.05",
        "--one-profile",
        "--quiet",
        "--out",
        text(&fixture.path(out)),
    ])
}

fn json(output: &Output) -> Value {
    serde_json::from_slice(&output.stdout).unwrap_or_else(|_| panic!("{}", stderr(output)))
}

#[test]
fn a_batch_becomes_a_report_that_hides_no_failure_and_is_compared() {
    let fixture = three_methods();
    assert_eq!(batch(&fixture, "results").status.code(), Some(1));
    let (results, out) = (fixture.path("results"), fixture.path("results/report"));
    let report = |more: &[&str]| {
        let arguments = ["report", text(&results), "--out", text(&out)];
        mvs_eval(&[&arguments, more].concat())
    };
    let first = report(&[]);
    assert_eq!(first.status.code(), Some(0), "{}", stderr(&first));
    assert_eq!(
        json(&first)["records"],
        3,
        "rows of a batch stand in two files"
    );
    let table = read(&out, "leaderboard.md");
    assert!(table.contains("| a\\_good | 1 | 1.00 | **"), "{table}");
    assert!(table.contains("| b\\_shifted | – | – | – | "), "{table}");
    assert!(table.contains("† b\\_shifted, Synth: gate: "), "{table}");
    assert!(table.contains("poses-shifted"), "{table}");
    assert!(table.contains("| c\\_broken | – | – | – | – |"), "{table}");
    assert!(
        table.contains("c\\_broken has no score for Synth (failed: "),
        "{table}"
    );
    assert!(read(&out, "leaderboard.tex").contains("\\dag{}"));
    // A second time, and into another folder: its own results are not read, nor counted twice.
    let again = report(&["--force"]);
    assert_eq!(again.status.code(), Some(0), "{}", stderr(&again));
    assert_eq!(table, read(&out, "leaderboard.md"));
    let beside = mvs_eval(&[
        "report",
        text(&results),
        "--out",
        text(&fixture.path("beside")),
    ]);
    assert_eq!(json(&beside)["records"], 3, "{}", stderr(&beside));

    let compare = |before: &str, after: &str| {
        let (before, after) = (fixture.path(before), fixture.path(after));
        mvs_eval(&["compare", text(&before), text(&after)])
    };
    let same = compare("results", "results");
    assert_eq!(same.status.code(), Some(0), "{}", stderr(&same));
    fixture.put_text("Synth/a_good/cloud.ply", "not a ply");
    assert_eq!(batch(&fixture, "later").status.code(), Some(1));
    let failed = compare("results", "later");
    assert_eq!(failed.status.code(), Some(1), "{}", stderr(&failed));
    let lost = json(&failed)["lost"][0].as_str().unwrap().to_owned();
    assert!(
        lost.starts_with("a_good · Synth · τ 0.05 (failed: "),
        "{lost}"
    );
    let mended = compare("later", "results");
    assert_eq!(mended.status.code(), Some(0), "{}", stderr(&mended));
    assert_eq!(json(&mended)["gained"][0], "a_good · Synth · τ 0.05");
    let nothing = compare("results", "methods");
    assert_eq!(nothing.status.code(), Some(2), "{}", stderr(&nothing));
}

#[test]
fn compare_says_0_1_or_2() {
    let folder = tempfile::tempdir().unwrap();
    let put = |name: &str, profile: &str, f: f64| {
        let record = Record {
            protocol: "tnt".into(),
            profile: profile.into(),
            fscore: Some(f),
            ..row("a", "Barn", 0.01)
        };
        let mut bytes = Vec::new();
        record::write(&mut bytes, &[record]).unwrap();
        write(&folder.path().join(name), bytes);
        folder.path().join(name)
    };
    let (old, better) = (
        put("old.csv", "strict", 0.5),
        put("better.csv", "strict", 0.6),
    );
    let other = put("other.csv", "official", 0.6);
    let code = |arguments: &[&str]| mvs_eval(&[&["compare"], arguments].concat()).status.code();
    assert_eq!(code(&[text(&old), text(&better)]), Some(0));
    assert_eq!(code(&[text(&better), text(&old)]), Some(1));
    assert_eq!(
        code(&[text(&better), text(&old), "--tolerance", "0.2"]),
        Some(0)
    );
    assert_eq!(code(&[text(&old), text(&other)]), Some(2));
    assert_eq!(code(&[text(&old), text(&other), "--mix"]), Some(0));
}

#[test]
fn report_check_says_0_1_or_2_of_our_own_tables_and_of_others() {
    let fixture = three_methods();
    batch(&fixture, "results");
    let out = fixture.path("report");
    let made = mvs_eval(&[
        "report",
        text(&fixture.path("results")),
        "--out",
        text(&out),
    ]);
    assert!(made.status.success(), "{}", stderr(&made));
    let check = |name: &str| mvs_eval(&["report", "--check", text(&out.join(name))]);
    for name in ["leaderboard.csv", "leaderboard_paper.csv"] {
        let checked = check(name);
        assert_eq!(
            checked.status.code(),
            Some(0),
            "{name}: {}",
            stderr(&checked)
        );
        assert!(json(&checked)["averages"].as_u64() > Some(0), "{name}");
    }
    let paper = "method,metric,A,B,Average\nm,recall,0.6,0.7,0.75\n";
    write(&out.join("slip.csv"), paper);
    let slip = check("slip.csv");
    assert_eq!(slip.status.code(), Some(1));
    let said = json(&slip)["slips"][0].as_str().unwrap().to_owned();
    assert_eq!(
        said,
        "m, recall, Average: printed 0.75, its scenes average 0.6500"
    );
    assert_eq!(check("index.html").status.code(), Some(2));
    assert_eq!(check("missing.csv").status.code(), Some(2));
}

fn row(method: &str, scene: &str, threshold: f64) -> Record {
    Record {
        protocol: "tnt".into(),
        unit: "m".into(),
        method: method.into(),
        scene: scene.into(),
        threshold: Some(threshold),
        fscore: Some(0.5),
        ..Record::default()
    }
}

#[test]
fn a_further_threshold_of_one_scene_leaves_the_main_board_whole() {
    let mut records: Vec<Record> = [
        ("Barn", 0.01),
        ("Caterpillar", 0.005),
        ("Church", 0.025),
        ("Courthouse", 0.025),
        ("Ignatius", 0.003),
        ("Meetingroom", 0.01),
        ("Truck", 0.005),
    ]
    .into_iter()
    .flat_map(|(scene, tau)| ["a", "b"].map(|method| row(method, scene, tau)))
    .collect();
    let further = ["a", "b", "c"].map(|method| row(method, "Barn", 0.02));
    records.extend(further);
    let boards = boards(&records).unwrap();
    let shape = |index: usize| {
        let board = &boards[index];
        let common = board.common.threshold.as_str();
        (common, board.scenes.len(), board.entries.len())
    };
    assert_eq!(boards.len(), 2);
    assert_eq!((shape(0), shape(1)), (("", 7, 2), ("0.02", 1, 3)));
    assert_eq!(boards[0].thresholds[0], Some(0.01));
    let mut markdown = Vec::new();
    table_md::write(&mut markdown, &site_tables(&boards)).unwrap();
    let markdown = String::from_utf8(markdown).unwrap();
    assert!(markdown.contains("| a | 1 | 1.00 | 50.00 |"), "{markdown}");

    // No scene says which of its thresholds is the main one.
    let plain = [0.1, 0.2].map(|tau| row("a", "x", tau));
    let named = mvs_eval::report::leaderboard::boards(&plain).unwrap();
    let named: Vec<&str> = named.iter().map(|b| b.common.threshold.as_str()).collect();
    assert_eq!(named, ["0.1", "0.2"]);
}

/// 450 score folders: more curves than a page holds.
#[test]
fn a_page_that_cannot_hold_all_curves_says_so() {
    let fixture = Fixture::new(200);
    let points = super::fixture::truth(200);
    fixture.put_cloud("truth.ply", points.clone());
    fixture.put_cloud("cloud.ply", points);
    let scored = mvs_eval(&[
        "score",
        "--truth",
        text(&fixture.path("truth.ply")),
        "--reconstruction",
        text(&fixture.path("cloud.ply")),
        "--method",
        "METHOD",
        "--tau",
        "0.05",
        "--out",
        text(&fixture.path("one")),
    ]);
    assert!(scored.status.success(), "{}", stderr(&scored));
    let one = fixture.path("one");
    for nth in 0..450 {
        let folder = fixture.path(&format!("all/{nth}"));
        for name in ["score.json", "scores.csv"] {
            let named = read(&one, name).replace("METHOD", &format!("m{nth}"));
            write(&folder.join(name), named);
        }
        for name in ["truth.precision.ply", "truth.recall.ply"] {
            write(&folder.join(name), std::fs::read(one.join(name)).unwrap());
        }
    }
    let out = fixture.path("report");
    let made = mvs_eval(&["report", text(&fixture.path("all")), "--out", text(&out)]);
    assert_eq!(made.status.code(), Some(0), "{}", stderr(&made));
    assert!(
        stderr(&made).contains("[page-plots-left-out]"),
        "{}",
        stderr(&made)
    );
    let page = read(&out, "index.html");
    assert!(
        page.len() < 10_000_000 && page.len() > 9_800_000,
        "{}",
        page.len()
    );
    assert!(page.contains("score folders are left out: the page would exceed 10 MB"));
}

#[test]
fn a_missing_out_is_one_sentence() {
    let fixture = three_methods();
    let mut bytes = Vec::new();
    record::write(&mut bytes, &[row("a", "Barn", 0.01)]).unwrap();
    write(&fixture.path("r.csv"), bytes);
    let (root, records) = (fixture.path(""), fixture.path("r.csv"));
    for arguments in [
        ["report", text(&records)].as_slice(),
        &["score", "--all", text(&root)],
    ] {
        let refused = mvs_eval(arguments);
        assert_eq!(refused.status.code(), Some(2), "{arguments:?}");
        let said = stderr(&refused);
        assert!(said.contains("--out: needed"), "{said}");
    }
}
