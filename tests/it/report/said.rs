//! What is said of records that are not what they seem.

use super::*;
use crate::support::{mvs_eval, stderr, text as arg, write};
use std::path::Path;
use std::process::Output;

fn put(path: &Path, records: &[Record]) {
    let mut bytes = Vec::new();
    mvs_eval::report::record::write(&mut bytes, records).unwrap();
    write(path, bytes);
}

fn compared(before: &[Record], after: &[Record], more: &[&str]) -> Output {
    let folder = tempfile::tempdir().unwrap();
    let [old, new] = ["old.csv", "new.csv"].map(|name| folder.path().join(name));
    put(&old, before);
    put(&new, after);
    mvs_eval(&[&["compare", arg(&old), arg(&new)][..], more].concat())
}

/// A gate that is given another method's folder is not to pass in silence.
#[test]
fn methods_of_other_names_are_compared_with_a_word() {
    let other = compared(
        &[record("mine", "Barn", 0.5)],
        &[record("other", "Barn", 0.5)],
        &[],
    );
    let said = stderr(&other);
    assert_eq!(other.status.code(), Some(0), "{said}");
    assert!(
        said.contains("[other-method]: mine before") && said.contains("other after"),
        "{said}"
    );
    let same = compared(
        &[record("mine", "Barn", 0.5)],
        &[record("mine", "Barn", 0.5)],
        &[],
    );
    assert!(!stderr(&same).contains("[other-method]"));
}

#[test]
fn cells_with_distances_alone_are_counted_as_not_compared() {
    let of_distance = |overall| Record {
        fscore: None,
        overall: Some(overall),
        ..record("a", "Truck", 0.0)
    };
    let set = |overall| [record("a", "Barn", 0.5), of_distance(overall)];
    let output = compared(&set(0.3), &set(0.9), &[]);
    let said = stderr(&output);
    assert!(
        said.contains("[no-f-score]: 1 cells") && said.contains("Truck"),
        "{said}"
    );
}

/// .8 − .7 is a little more than .1 in binary.
#[test]
fn a_difference_of_the_tolerance_is_none() {
    for (before, after, tolerance, code) in [
        (0.8, 0.7, "0.1", 0),
        (0.3, 0.1, "0.2", 0),
        (0.8, 0.7, "0.0999", 1),
    ] {
        let sets = [before, after].map(|f| [record("a", "Barn", f)]);
        let output = compared(&sets[0], &sets[1], &["--tolerance", tolerance]);
        assert_eq!(
            output.status.code(),
            Some(code),
            "{before} {after} {tolerance}"
        );
    }
}

/// A failure that does not say its threshold, beside a score of the same cell, in one file.
#[test]
fn the_file_of_two_records_is_named_once_and_no_threshold_is_left_blank() {
    let folder = tempfile::tempdir().unwrap();
    let [records, out] = ["r.csv", "out"].map(|name| folder.path().join(name));
    let failed = Record {
        threshold: None,
        fscore: None,
        status: "no-points".into(),
        ..record("a", "Barn", 0.0)
    };
    put(&records, &[record("a", "Barn", 0.5), failed]);
    let output = mvs_eval(&["report", arg(&records), "--out", arg(&out)]);
    let said = stderr(&output);
    assert_eq!(output.status.code(), Some(2), "{said}");
    assert!(
        said.contains("r.csv: ") && !said.contains("r.csv and"),
        "{said}"
    );
    assert!(
        said.contains("two for a on Barn") && !said.contains("threshold  ("),
        "{said}"
    );
}

#[test]
fn blanks_around_names_are_none() {
    let text = |method: &str, scene: &str| {
        let mut bytes = Vec::new();
        mvs_eval::report::record::write(&mut bytes, &[record(method, scene, 0.5)]).unwrap();
        bytes
    };
    let read = |method, scene| {
        let bytes = text(method, scene);
        mvs_eval::report::record::read(bytes.as_slice()).unwrap()
    };
    assert_eq!(
        format!("{:?}", read("a ", " Barn")),
        format!("{:?}", read("a", "Barn"))
    );
}

#[test]
fn one_distance_of_nothing_gives_no_table_many_digits() {
    let of = |scene: &str, overall| Record {
        overall: Some(overall),
        ..record("a", scene, 0.5)
    };
    let boards = boards(&[of("Barn", 0.0057), of("Truck", 3e-17)]).unwrap();
    let tables = site_tables(&boards);
    let cells = tables.iter().flat_map(|table| table.rows.iter().flatten());
    let shown: Vec<&str> = cells.map(|cell| cell.text.as_str()).collect();
    assert!(
        shown.contains(&"0.0057") && shown.contains(&"0.0000"),
        "{shown:?}"
    );
}

/// A folder into which another method came since is not the first run's.
#[test]
fn what_a_replay_reads_beside_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    put(&at("in/a/scores.csv"), &[record("a", "Barn", 0.5)]);
    let first = mvs_eval(&["report", arg(&at("in")), "--out", arg(&at("out"))]);
    assert_eq!(first.status.code(), Some(0), "{}", stderr(&first));
    let again = |out: &str| {
        let run = at("out/run.toml");
        stderr(&mvs_eval(&["replay", arg(&run), "--out", arg(&at(out))]))
    };
    let said = again("again");
    assert!(!said.contains("[input-changed]"), "{said}");
    put(&at("in/b/scores.csv"), &[record("b", "Barn", 0.6)]);
    let said = again("more");
    let new = at("in/b/scores.csv");
    assert!(
        said.contains("[input-changed]") && said.contains(arg(&new)),
        "{said}"
    );
}

/// The page would show another name, or another score, in its tables than on its curves.
#[test]
fn records_that_are_not_those_of_their_score_folder_are_told_of() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let (cloud, score) = (at("cloud.ply"), at("score"));
    let header = "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\n\
                  property float z\nend_header\n";
    write(&cloud, format!("{header}0 0 0\n1 0 0\n"));
    let clouds = ["--truth", arg(&cloud), "--reconstruction", arg(&cloud)];
    let rest = ["--tau", "0.1", "--method", "good", "--out", arg(&score)];
    let scored = mvs_eval(&[&["score"][..], &clouds, &rest].concat());
    assert_eq!(scored.status.code(), Some(0), "{}", stderr(&scored));
    let reported = |out: &str| {
        let output = mvs_eval(&["report", arg(&score), "--out", arg(&at(out))]);
        assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
        stderr(&output)
    };
    let said = reported("whole");
    assert!(!said.contains("[other-score]"), "{said}");
    let records = score.join("scores.csv");
    let text = std::fs::read_to_string(&records).unwrap();
    assert_ne!(text, text.replace("good", "renamed"));
    write(&records, text.replace("good", "renamed"));
    let said = reported("renamed");
    assert!(
        said.contains("[other-score]") && said.contains("F 1.0000 for good"),
        "{said}"
    );
}
