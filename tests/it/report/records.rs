//! Which records stand together, in which files they lie, and what of them is refused.

use super::*;
use crate::support::{mvs_eval, stderr, text as arg};
use mvs_datasets::layout::files::write_atomically;
use std::io::Write;
use std::path::{Path, PathBuf};

/// Puts a record into `name` under `folder`.
fn put_record(folder: &Path, name: &str, record: Record) -> PathBuf {
    let path = folder.join(name);
    let write = |out: &mut _| mvs_eval::report::record::write(out, &[record]);
    write_atomically(&path, write).unwrap();
    path
}

#[cfg(unix)]
#[test]
fn linked_folders_are_searched_each_once_and_circles_end() {
    use std::os::unix::fs::symlink;
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    put_record(folder.path(), "in/a/scores.csv", record("a", "Barn", 0.5));
    put_record(
        folder.path(),
        "elsewhere/scores.csv",
        record("b", "Barn", 0.6),
    );
    symlink(at("elsewhere"), at("in/b")).unwrap();
    symlink(at("elsewhere"), at("in/b_again")).unwrap();
    symlink(at("in"), at("in/a/circle")).unwrap();
    let output = mvs_eval(&["report", arg(&at("in")), "--out", arg(&at("out"))]);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    let said: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(said["records"], 2);
    assert_eq!(said["files"].as_array().unwrap().len(), 2, "{said}");
}

#[test]
fn records_of_an_unfinished_result_are_warned_of() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    put_record(folder.path(), "in/a/scores.csv", record("a", "Barn", 0.5));
    let report = || {
        mvs_eval(&[
            "report",
            arg(&at("in")),
            "--out",
            arg(&at("out")),
            "--force",
        ])
    };
    assert!(!stderr(&report()).contains("[unfinished]"));
    // A batch has its mark two folders above its records.
    for mark in ["in/a/run.partial.toml", "run.partial.toml"] {
        let mark = at(mark);
        write_atomically(&mark, |out| out.write_all(b"")).unwrap();
        let compared = mvs_eval(&["compare", arg(&at("in")), arg(&at("in/a/scores.csv"))]);
        let marked = mark.parent().unwrap().canonicalize().unwrap();
        for output in [report(), compared] {
            let said = stderr(&output);
            assert_eq!(output.status.code(), Some(0), "{said}");
            let expected = format!("[unfinished]: {}: has a run.partial.toml", marked.display());
            assert!(said.contains(&expected), "{said}");
        }
        std::fs::remove_file(&mark).unwrap();
    }
}

#[test]
fn boards_of_other_units_are_named_by_them_and_pass_our_own_check() {
    let mut records = duel();
    records.extend(duel().into_iter().map(|record| Record {
        unit: "mm".into(),
        ..record
    }));
    let boards = boards(&records).unwrap();
    let tables = site_tables(&boards);
    let titles: Vec<&str> = tables.iter().map(|table| table.title.as_str()).collect();
    assert_eq!(titles[0], "F-score · tnt · official · training · m");
    assert_eq!(titles[3], "F-score · tnt · official · training · mm");
    for tables in [tables, paper_tables(&boards)] {
        let csv = text(|out| table_csv::write(out, &tables));
        let checked = mvs_eval::report::check::check(csv.as_bytes()).unwrap();
        assert!(checked.slips.is_empty() && checked.averages > 0, "{csv}");
    }
}

/// A scene in other units is not a column of zeros; what looks alike and ranks apart is explained.
#[test]
fn small_distances_keep_two_digits_and_ranks_their_reason() {
    let of = |method: &str, accuracy: f64| Record {
        acc_mean: Some(accuracy),
        comp_mean: Some(accuracy),
        ..record(method, "Barn", 0.5 + accuracy)
    };
    let tables = |records: &[Record]| site_tables(&boards(records).unwrap());
    let shown = |tables: &[mvs_eval::report::table::Table], metric: &str| {
        let table = tables.iter().find(|table| table.title.starts_with(metric));
        let table = table.unwrap();
        let means: Vec<String> = table.rows.iter().map(|row| row[3].text.clone()).collect();
        (means, table.notes.join(" "))
    };
    let said = "Ranks come from all digits";
    let small = tables(&[of("a", 3.12e-6), of("b", 6.5e-6)]);
    let (means, _) = shown(&small, "accuracy");
    assert_eq!(means, ["0.0000031", "0.0000065"]);
    let (means, notes) = shown(&small, "F-score");
    assert_eq!(means, ["50.00", "50.00"]);
    assert!(notes.contains(said), "{notes}");
    let (means, notes) = shown(&tables(&[of("a", 0.0043), of("b", 2.5)]), "accuracy");
    assert_eq!(means, ["0.0043", "2.5000"]);
    assert!(!notes.contains(said), "{notes}");
}

#[test]
fn scores_without_a_threshold_do_not_stand_beside_those_with_one() {
    let without = |method: &str, scene: &str| Record {
        threshold: None,
        ..record(method, scene, 0.9)
    };
    let failed = Record {
        fscore: None,
        status: "failed: no cameras".into(),
        ..without("failed", "Barn")
    };
    let records = [record("a", "Barn", 0.5), without("b", "Barn"), failed];
    let found = boards(&records).unwrap();
    let shape = |nth: usize| {
        let labels = found[nth].entries.iter().map(|entry| entry.label.as_str());
        (
            found[nth].common.threshold.as_str(),
            labels.collect::<Vec<_>>(),
        )
    };
    assert_eq!(found.len(), 2);
    assert_eq!(shape(0), ("", vec!["a", "failed"]));
    assert_eq!(shape(1), ("none", vec!["b"]));
    assert!(
        site_tables(&found)[1]
            .title
            .ends_with(" · no threshold given")
    );
    // Written by hand, a status may be in capitals.
    let ok = |status: &str| Record {
        status: status.into(),
        ..record("a", "Barn", 0.5)
    };
    for (status, rank) in [("OK ", Some(1.0)), ("not ok", None)] {
        let board = boards(&[ok(status)]).unwrap().remove(0);
        assert_eq!(board.ranking(Metric::FScore)[0].mean_rank, rank, "{status}");
    }
    // Where no score of a scene names one, nothing is told apart.
    let one = boards(&[
        record("a", "Barn", 0.5),
        without("a", "Truck"),
        without("b", "Truck"),
    ])
    .unwrap();
    assert_eq!(one.len(), 1);
}

#[test]
fn scenes_with_the_names_of_other_columns_stand_in_columns_of_their_own() {
    let scenes = [
        "Barn", "Rank", "average", "mean", "method", "metric", "profile",
    ];
    let values = (0..).map(|nth| f64::from(nth) / 16.0);
    let records: Vec<Record> = scenes
        .into_iter()
        .zip(values)
        .map(|(scene, f)| record("a", scene, f))
        .collect();
    let boards = boards(&records).unwrap();
    let site = text(|out| table_csv::write(out, &site_tables(&boards)));
    let expected = "\
protocol,profile,split,threshold,metric,method,rank,mean rank,mean,Barn,scene Rank,scene average,scene mean,\
scene method,scene metric,scene profile
tnt,official,training,,F-score,a,1,1.00,18.75,0.00,6.25,12.50,18.75,25.00,31.25,37.50
";
    assert_eq!(site, expected);
    let paper = text(|out| table_csv::write(out, &paper_tables(&boards)));
    for csv in [site, paper] {
        let checked = mvs_eval::report::check::check(csv.as_bytes()).unwrap();
        assert_eq!((checked.averages, checked.slips.len()), (1, 0), "{csv}");
    }
}

/// No column is another's, and no board either.
#[test]
fn names_that_collide_with_those_of_columns_and_boards_are_told_apart() {
    let scenes = ["mean", "scene mean", "scene scene mean"];
    let of = |scene: &'static str, f: f64| record("a", scene, f);
    let mut records: Vec<Record> = scenes
        .into_iter()
        .zip([0.25, 0.5, 0.75])
        .map(|(s, f)| of(s, f))
        .collect();
    for (profile, split) in [("", "strict"), ("strict", "")] {
        let board = scenes.map(|scene| Record {
            profile: profile.into(),
            split: split.into(),
            ..of(scene, 0.5)
        });
        records.extend(board);
    }
    let boards = boards(&records).unwrap();
    let site = text(|out| table_csv::write(out, &site_tables(&boards)));
    let columns = "mean,scene scene scene mean,scene mean,scene scene mean";
    assert!(site.lines().next().unwrap().ends_with(columns), "{site}");
    let paper = text(|out| table_csv::write(out, &paper_tables(&boards)));
    for csv in [&site, &paper] {
        let checked = mvs_eval::report::check::check(csv.as_bytes()).unwrap();
        assert_eq!((checked.averages, checked.slips.len()), (3, 0), "{csv}");
    }
    assert!(site.contains("50.00,25.00,50.00,75.00"), "{site}");
}

#[test]
fn two_methods_with_one_label_are_refused() {
    let grouped = Record {
        group: "d".into(),
        ..record("X", "Truck", 0.6)
    };
    let alike = [record("X (d)", "Barn", 0.5), grouped];
    let error = boards(&alike).unwrap_err().to_string();
    assert!(
        error.contains("found two that look like X (d): "),
        "{error}"
    );
}

#[test]
fn another_truth_is_shown_and_takes_no_part_in_ranks() {
    let of = |method: &str, truth: &str, f: f64| Record {
        truth_sha256: truth.into(),
        ..record(method, "Barn", f)
    };
    let records = [of("a", "t1", 0.5), of("b", "t2", 0.9), of("c", "t1", 0.6)];
    let boards = boards(&records).unwrap();
    let ranking = boards[0].ranking(Metric::FScore);
    let ranks: Vec<(&str, Option<usize>)> = ranking
        .iter()
        .map(|row| (row.label.as_str(), row.rank))
        .collect();
    assert_eq!(ranks, [("c", Some(1)), ("a", Some(2)), ("b", None)]);
    let tables = site_tables(&boards);
    let said = "† b, Barn: not comparable: truth t2, most have t1; no mean, no rank.";
    assert!(
        tables[0].notes.iter().any(|note| note == said),
        "{:?}",
        tables[0].notes
    );
    let warned = boards[0].not_comparable();
    assert_eq!(warned.len(), 1);
    assert!(
        warned[0].starts_with("scores of Barn are ") && warned[0].contains(": b "),
        "{warned:?}"
    );
}

#[test]
fn two_records_for_one_cell_are_refused() {
    let error = boards(&[record("a", "Barn", 0.5), record("a", "Barn", 0.6)])
        .unwrap_err()
        .to_string();
    assert!(
        error.contains("found two for a on Barn at threshold 0.01"),
        "{error}"
    );
    let nan = boards(&[record("a", "Barn", f64::NAN)])
        .unwrap_err()
        .to_string();
    assert!(
        nan.contains("F-score of a on Barn: expected a number"),
        "{nan}"
    );
}

#[test]
fn records_for_one_cell_name_their_files_and_a_bad_picture_leaves_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    for (name, fscore) in [("one", 0.5), ("two", 0.6)] {
        put_record(&at(name), "scores.csv", record("a", "Barn", fscore));
    }
    let (one, two, out) = (at("one"), at("two"), at("out"));
    let output = mvs_eval(&["report", arg(&one), arg(&two), "--out", arg(&out)]);
    let said = stderr(&output);
    assert_eq!(output.status.code(), Some(2), "{said}");
    for part in [
        "one/scores.csv and ",
        "two/scores.csv: ",
        "two for a on Barn at threshold 0.01",
    ] {
        assert!(said.contains(part), "{said}");
    }
    let picture = at("picture.png");
    write_atomically(&picture, |out| out.write_all(b"no picture")).unwrap();
    let arguments = [
        "report",
        arg(&one),
        "--picture",
        arg(&picture),
        "--out",
        arg(&out),
    ];
    let output = mvs_eval(&arguments);
    assert_eq!(output.status.code(), Some(2), "{}", stderr(&output));
    assert!(!out.join("leaderboard.csv").exists() && !out.join("results.csv").exists());
    let output = mvs_eval(&["report", arg(&one), "--into", "README.md"]);
    assert_eq!(output.status.code(), Some(2), "{}", stderr(&output));
}

/// Scores a small cloud beside a plane of the same points, moved by `off`, into `K/score`.
fn put_score(folder: &Path, off: f64) {
    let cloud = |off: f64| {
        let points = (0..100).map(|nth| format!("{} {} {off}\n", nth % 10, nth / 10));
        let header = "ply\nformat ascii 1.0\nelement vertex 100\nproperty float x\nproperty float y\n\
                      property float z\nend_header\n";
        header.to_owned() + &points.collect::<String>()
    };
    let at = |name: &str| folder.join(name);
    crate::support::write(&at("truth.ply"), cloud(0.0));
    crate::support::write(&at("rec.ply"), cloud(off));
    let scored = mvs_eval(&[
        "score",
        "--truth",
        arg(&at("truth.ply")),
        "--reconstruction",
        arg(&at("rec.ply")),
        "--tau",
        "0.5",
        "--out",
        arg(&at("K/score")),
        "--force",
    ]);
    assert_eq!(scored.status.code(), Some(0), "{}", stderr(&scored));
}

/// A report within the folder that it was made from is not among what the next one is made from, and what its page
/// shows are its inputs.
#[test]
fn a_report_in_the_folder_that_it_is_of_is_made_again() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let done = |arguments: &[&str]| {
        let output = mvs_eval(arguments);
        assert_eq!(
            output.status.code(),
            Some(0),
            "{arguments:?}: {}",
            stderr(&output)
        );
        stderr(&output)
    };
    let read = |name: &str| std::fs::read_to_string(at(name)).unwrap();
    put_score(folder.path(), 0.25);
    done(&["report", arg(&at("K")), "--out", arg(&at("K/report"))]);
    let replay = |out: &str| {
        done(&[
            "replay",
            arg(&at("K/report/run.toml")),
            "--out",
            arg(&at(out)),
        ])
    };
    let said = replay("again");
    assert!(!said.contains("[input-changed]"), "{said}");
    for name in ["index.html", "results.csv"] {
        assert!(
            read(&format!("K/report/{name}")) == read(&format!("again/{name}")),
            "{name}"
        );
    }
    // What a report has joined may be reported, where it is named.
    done(&[
        "report",
        arg(&at("K/report")),
        "--out",
        arg(&at("of the report")),
    ]);
    put_score(folder.path(), 0.375);
    let said = replay("of the new score");
    for name in ["scores.csv", "score.json", "truth.precision.ply"] {
        let said: Vec<&str> = said
            .lines()
            .filter(|line| line.contains("[input-changed]"))
            .collect();
        assert!(
            said.iter().any(|line| line.contains(name)),
            "{name}: {said:?}"
        );
    }
    done(&["report", arg(&at("K")), "--out", arg(&at("new"))]);
    assert!(read("new/results.csv") != read("again/results.csv"));
}

/// What methods and notes begin with and consist of is text, in Markdown and in LaTeX.
#[test]
fn names_are_no_markup() {
    let mut rows = Vec::new();
    for name in [
        "R&D &copy; v2",
        "~~old~~",
        "[ours] a<b|c>d",
        "*star",
        "# d",
        "- dash",
        "+ plus",
        "> q",
        "1. ours",
    ] {
        // Without a record for Truck there is a note that begins with the name.
        rows.push(record(name, "Barn", 0.5));
    }
    rows.push(record("whole", "Barn", 0.5));
    rows.push(record("whole", "Truck", 0.5));
    let tables = site_tables(&boards(&rows).unwrap());
    let markdown = text(|out| table_md::write(out, &tables));
    for line in [
        r"| R\&D \&copy; v2 |",
        r"| \~\~old\~\~ |",
        "\n\\# d has no",
        "\n\\- dash has no",
        "\n\\+ plus has no",
        "\n\\> q has no",
        "\n1\\. ours has no",
    ] {
        assert!(markdown.contains(line), "{line}: {markdown}");
    }
    let latex = text(|out| table_tex::write(out, &tables));
    for line in [
        r"{}[ours] a\textless{}b\textbar{}c\textgreater{}d & ",
        "\n{}*star & ",
        "\nwhole & ",
    ] {
        assert!(latex.contains(line), "{line}: {latex}");
    }
}
