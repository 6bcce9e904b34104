//! `mvs-eval tradeoff`: what it says of errors is what the stages say themselves.

use crate::support::{mvs_eval, stderr, text};
use std::collections::BTreeMap;
use std::fs;

type Rows = Vec<BTreeMap<String, String>>;

fn rows_of(csv: &str) -> Rows {
    let mut lines = csv.lines();
    let header: Vec<&str> = lines.next().unwrap().split(',').collect();
    let cells = |line: &str| -> Vec<String> {
        // The only quoted cells are settings with a comma in them.
        let mut cells = vec![String::new()];
        let mut quoted = false;
        for character in line.chars() {
            match character {
                '"' => quoted = !quoted,
                ',' if !quoted => cells.push(String::new()),
                other => cells.last_mut().unwrap().push(other),
            }
        }
        cells
    };
    let row = |line: &str| {
        header
            .iter()
            .map(|&name| name.to_owned())
            .zip(cells(line))
            .collect()
    };
    lines.map(row).collect()
}

fn number(row: &BTreeMap<String, String>, column: &str) -> f64 {
    row[column]
        .parse()
        .unwrap_or_else(|_| panic!("{column} of {row:?}"))
}

#[test]
fn every_stage_is_held_against_its_exact_setting() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let demo = mvs_eval(&[
        "demo",
        "--views",
        "10",
        "--size",
        "128x96",
        "--out",
        text(&at("demo")),
    ]);
    assert!(demo.status.success(), "{}", stderr(&demo));
    let answer: serde_json::Value = serde_json::from_slice(&demo.stdout).unwrap();
    let dataset = answer["dataset"].as_str().unwrap();
    let demo = |name: &str| text(&at("demo").join(name)).to_owned();
    let measured = mvs_eval(&[
        "tradeoff",
        "--truth",
        &demo("input/truth.ply"),
        "--reconstruction",
        &demo("cloud.ply"),
        "--tau",
        "0.01",
        "--scene",
        dataset,
        "--depths",
        &demo("estimates/depth"),
        "--confidence",
        &demo("estimates/confidence"),
        "--fuse-truth",
        &demo("input/truth.ply"),
        "--mesh",
        &demo("input/mesh.obj"),
        "--cameras",
        &demo("input/cams"),
        "--size",
        "128x96",
        "--dataset",
        dataset,
        "--views",
        "1",
        "--repeats",
        "1",
        "--out",
        text(&at("tradeoff")),
    ]);
    assert!(measured.status.success(), "{}", stderr(&measured));
    let rows = rows_of(&fs::read_to_string(at("tradeoff/tradeoff.csv")).unwrap());
    for stage in ["score", "fuse", "render", "blend"] {
        let of_stage: Rows = rows
            .iter()
            .filter(|row| row["stage"] == stage)
            .cloned()
            .collect();
        assert!(of_stage.len() >= 5, "{stage}: {}", of_stage.len());
        assert_eq!(
            of_stage.iter().filter(|row| row["exact"] == "yes").count(),
            1,
            "{stage}"
        );
        assert!(
            of_stage.iter().any(|row| row["default"] == "yes"),
            "{stage}"
        );
        assert!(of_stage.iter().any(|row| row["front"] == "yes"), "{stage}");
        assert!(
            of_stage.iter().all(|row| number(row, "seconds") > 0.0),
            "{stage}"
        );
    }
    let score: serde_json::Value =
        serde_json::from_str(&fs::read_to_string(at("demo/score/score.json")).unwrap()).unwrap();
    for row in &rows {
        let (difference, knob) = (number(row, "difference"), row["knob"].as_str());
        if row["exact"] == "yes" {
            assert_eq!(difference, 0.0);
        }
        match (row["stage"].as_str(), knob) {
            ("score", "exact") => assert_eq!(Some(number(row, "value")), score["f_score"].as_f64()),
            ("score", "search") => assert_eq!(difference, 0.0, "a bound changes no score"),
            ("score", "queries") => {
                let width = number(row, "half_width");
                assert!(difference.abs() < 3.0 * width, "{row:?}");
            }
            ("fuse", "normals") => assert_eq!(difference, 0.0),
            _ => {}
        }
    }
    let samples: Vec<f64> = rows
        .iter()
        .filter(|row| row["knob"] == "samples")
        .map(|row| number(row, "difference"))
        .collect();
    assert!(
        samples.is_sorted_by(|a, b| a > b),
        "more samples, less error: {samples:?}"
    );
    let svg = fs::read_to_string(at("tradeoff/tradeoff.svg")).unwrap();
    assert_eq!(svg.matches("<circle").count(), rows.len());
    let sentences = fs::read_to_string(at("tradeoff/tradeoff.md")).unwrap();
    assert!(sentences.contains("- score, queries: 1/2: "), "{sentences}");
}

#[test]
fn without_the_inputs_of_a_stage_it_says_what_is_missing() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("tradeoff");
    for (inputs, expected) in [
        (&[][..], "expected the inputs of a stage"),
        (&["--scene", "s"], "--scene: goes with --depths, which"),
        (&["--depths", "d"], "--depths: goes with --scene, which"),
        (&["--crop", "c"], "--crop: goes with --truth, which"),
        (
            &["--mesh", "m", "--size", "8x8"],
            "--mesh: goes with --cameras, which",
        ),
    ] {
        let refused = mvs_eval(&[&["tradeoff", "--out", text(&out)], inputs].concat());
        assert_eq!(refused.status.code(), Some(2));
        assert!(stderr(&refused).contains(expected), "{}", stderr(&refused));
        assert!(!out.exists());
    }
}
