//! `mvs-eval depth` on files: values by hand, boundaries, smaller maps, pictures, refusals.

use crate::support::{mvs_eval, stderr, text};
use mvs_datasets::format::{image, pfm};
use mvs_datasets::layout::{files, mvsnet};
use mvs_datasets::scene::Raster;
use std::fs;
use std::io::Write;
use std::path::Path;

/// 4 x 2 pixels; the sweep from 1 to 9 in 8 intervals: Δ = 1, and 2 < truth ≤ 7 counts.
const CAM: &str = "extrinsic\n1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n\nintrinsic\n4 0 2\n0 4 1\n\
                   0 0 1\n\n1 1 8 9\n";

fn put(folder: &Path, id: u32, (width, height): (u32, u32), values: &[f32]) {
    let raster = Raster::from_values(width, height, values.to_vec()).unwrap();
    let path = folder.join(mvsnet::file_name(id, ".pfm"));
    files::write_atomically(&path, |out| pfm::write_gray(out, &raster)).unwrap();
}

/// Views 0 and 2 with truth, estimates and confidence, view 5 without an estimate.
fn scene() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    for id in [0, 2, 5] {
        let cam = path("cams").join(mvsnet::file_name(id, "_cam.txt"));
        files::write_atomically(&cam, |out| out.write_all(CAM.as_bytes())).unwrap();
    }
    let truth = path("rendered_depth_maps");
    let size = (4, 2);
    // The first four count, then two at the sweep's ends that do not, none, and one without estimate.
    put(&truth, 0, size, &[4.0, 4.0, 4.0, 7.0, 2.0, 8.0, 0.0, 5.0]);
    put(
        &path("estimates"),
        0,
        size,
        &[4.0, 5.0, 7.0, 3.0, 9.0, 9.0, 4.0, 0.0],
    );
    put(
        &path("confidence"),
        0,
        size,
        &[1.0, 0.9, 0.8, 0.7, 0.0, 0.0, 0.0, 0.0],
    );
    put(&truth, 2, size, &[4.0; 8]);
    put(&path("estimates"), 2, size, &[6.0; 8]);
    put(&path("confidence"), 2, size, &[0.5; 8]);
    put(&truth, 5, size, &[4.0; 8]);
    folder
}

fn arguments(folder: &Path, more: &[&str]) -> Vec<String> {
    let path = |name: &str| text(&folder.join(name)).to_owned();
    let mut arguments = vec!["depth".to_owned(), "--truth".into(), text(folder).into()];
    arguments.extend(["--estimates".into(), path("estimates")]);
    arguments.extend(["--planes".into(), "8".into()]);
    arguments.extend(more.iter().map(|&argument| argument.to_owned()));
    arguments
}

fn run(arguments: &[String]) -> std::process::Output {
    mvs_eval(&arguments.iter().map(String::as_str).collect::<Vec<_>>())
}

/// The answer for a scene one of whose views has no estimate.
fn answer(arguments: &[String]) -> serde_json::Value {
    let output = run(arguments);
    assert_eq!(output.status.code(), Some(1), "{}", stderr(&output));
    serde_json::from_slice(&output.stdout).unwrap()
}

#[test]
fn values_are_those_computed_by_hand() {
    let folder = scene();
    let confidence = folder.path().join("confidence");
    let out = folder.path().join("out");
    let more = ["--confidence", text(&confidence), "--out", text(&out)];
    let found = answer(&arguments(folder.path(), &more));
    assert_eq!(found["missing"], serde_json::json!([5]));
    let view = &found["views"][0];
    // Errors 0, 1, 3, 4 of four estimates for five true depths.
    let expected = serde_json::json!({
        "counted": 5, "compared": 4, "interval": 1.0,
        "epe": 2.0, "absolute": 2.0, "density": 0.8, "inlier_1_03": 0.25,
        "above_1": 0.5, "at_least_1": 0.75, "above_3": 0.25, "at_least_3": 0.5,
        "absrel": (1.0 / 4.0 + 3.0 / 4.0 + 4.0 / 7.0) / 4.0, "ause": 0.0,
    });
    for (name, value) in expected.as_object().unwrap() {
        assert_eq!(&view[name], value, "{name}");
    }
    let scene = &found["scene"];
    assert_eq!(scene["mean_over_views"]["epe"], 2.0);
    // View 5 has eight true depths and no estimate.
    let found = [
        &view["missing"],
        &found["views"][2]["missing"],
        &scene["partial"],
    ];
    assert_eq!(
        found,
        [false, true, true].map(serde_json::Value::from).each_ref()
    );
    assert_eq!(scene["mean_over_views"]["density"], (0.8 + 1.0) / 3.0);
    assert_eq!(scene["mean_over_pixels"]["density"], 12.0 / 21.0);
    assert_eq!(scene["mean_over_views"]["above_3"], 0.125);
    assert_eq!(scene["mean_over_pixels"]["above_3"], 1.0 / 12.0);
    let csv = fs::read_to_string(out.join("depth.csv")).unwrap();
    let first: Vec<&str> = csv.lines().nth(1).unwrap().split(',').collect();
    assert_eq!(first[..8], ["0", "1", "1", "0", "5", "4", "2", "0.5"]);
    assert!(
        csv.contains("\n5,1,1,0,8,0,,,,,,,,,0,,missing\npartial_mean_over_views,,"),
        "{csv}"
    );
    let last = csv.lines().last().unwrap();
    assert!(last.starts_with("partial_mean_over_pixels,") && last.ends_with(",partial"));
    let picture = fs::read(out.join("errors/00000000.png")).unwrap();
    let picture = image::read_color(&picture).unwrap();
    let at = |column, row| picture.get(column, row);
    assert_eq!(at(0, 0), [255; 3], "no error is white");
    assert_eq!(at(2, 0), at(3, 0), "three intervals and more look alike");
    assert!(at(1, 0) != at(0, 0) && at(1, 0) != at(2, 0));
    assert_eq!([at(0, 1), at(1, 1), at(2, 1)], [[64; 3]; 3], "not counted");
    assert_eq!(at(3, 1), [40, 70, 200], "no estimate");
    let missing = image::read_color(&fs::read(out.join("errors/00000005.png")).unwrap()).unwrap();
    assert_eq!(missing.values(), [[40, 70, 200]; 8]);
    assert!(out.join("run.toml").exists());
    // Kept unless it may be replaced; made again from its run.toml.
    let again = run(&arguments(folder.path(), &more));
    assert_eq!(again.status.code(), Some(2));
    let copy = folder.path().join("copy");
    let replayed = mvs_eval(&["replay", text(&out.join("run.toml")), "--out", text(&copy)]);
    assert_eq!(replayed.status.code(), Some(1), "{}", stderr(&replayed));
    for name in ["depth.csv", "depth.json", "errors/00000002.png"] {
        assert_eq!(
            fs::read(out.join(name)).unwrap(),
            fs::read(copy.join(name)).unwrap()
        );
    }
}

#[test]
fn leaving_a_view_out_or_empty_is_said_and_cannot_raise_density() {
    let folder = scene();
    let estimates = folder.path().join("estimates");
    let missing = run(&arguments(folder.path(), &[]));
    assert!(
        stderr(&missing).contains("1 of 3 views have no depth map: 5;"),
        "{}",
        stderr(&missing)
    );
    put(&estimates, 5, (4, 2), &[0.0; 8]);
    let output = run(&arguments(folder.path(), &[]));
    assert_eq!(output.status.code(), Some(1));
    assert!(
        stderr(&output)
            .contains("1 of 3 views have a depth map without a depth where the truth counts: 5;"),
        "{}",
        stderr(&output)
    );
    let parse = |output: &std::process::Output| -> serde_json::Value {
        serde_json::from_slice(&output.stdout).unwrap()
    };
    let (empty, missing) = (parse(&output), parse(&missing));
    assert_eq!(empty["missing"], serde_json::json!([]));
    assert_eq!(empty["empty"], serde_json::json!([5]));
    // No map and a map without a depth say the same.
    assert_eq!(empty["scene"], missing["scene"]);
    assert_eq!(empty["scene"]["partial"], true);
    let out = folder.path().join("out");
    run(&arguments(folder.path(), &["--out", text(&out)]));
    let csv = fs::read_to_string(out.join("depth.csv")).unwrap();
    assert!(csv.contains(",empty\npartial_mean_over_views,"), "{csv}");
    put(&estimates, 5, (4, 2), &[3.0; 8]);
    let output = run(&arguments(folder.path(), &["--out", text(&out), "--force"]));
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    let csv = fs::read_to_string(out.join("depth.csv")).unwrap();
    assert!(csv.contains("\nmean_over_views,") && csv.ends_with(",complete\n"));
}

#[test]
fn alignment_is_stated_by_view() {
    let folder = scene();
    put(
        &folder.path().join("estimates"),
        0,
        (4, 2),
        &[2.0, 2.0, 2.0, 3.5, 1.0, 4.0, 0.0, 2.5],
    );
    let found = answer(&arguments(folder.path(), &["--alignment", "median-ratio"]));
    assert_eq!(found["alignment"], "median-ratio");
    assert_eq!(
        found["views"][0]["fit"],
        serde_json::json!({"scale": 2.0, "offset": 0.0})
    );
    assert_eq!(found["views"][0]["epe"], 0.0);
    let found = answer(&arguments(folder.path(), &["--alignment", "least-squares"]));
    assert_eq!(found["views"][0]["epe"], 0.0);
    assert_eq!(
        found["views"][1]["fit"],
        serde_json::json!({"scale": 1.0, "offset": -2.0})
    );
}

#[test]
fn smaller_estimates_meet_the_truth_at_the_nearest_pixel() {
    let folder = scene();
    // Pixel centres 1 and 3 of 4 columns, 1 of 2 rows: the truth's pixels 1 and 3 of row 1.
    let truth = [3.0, 3.0, 3.0, 3.0, 3.0, 4.0, 3.0, 6.0];
    put(
        &folder.path().join("rendered_depth_maps"),
        0,
        (4, 2),
        &truth,
    );
    put(&folder.path().join("estimates"), 0, (2, 1), &[4.0, 6.5]);
    let found = answer(&arguments(folder.path(), &[]));
    assert_eq!(found["views"][0]["epe"], 0.25);
    put(&folder.path().join("estimates"), 0, (3, 3), &[4.0; 9]);
    let output = run(&arguments(folder.path(), &[]));
    assert_eq!(output.status.code(), Some(2));
    assert!(
        stderr(&output).contains("expected the truth's size 4x2"),
        "{}",
        stderr(&output)
    );
}

#[test]
fn a_missing_view_counts_as_many_pixels_as_its_estimate_would_have() {
    let folder = scene();
    let path = |name: &str| folder.path().join(name);
    for id in [0, 2] {
        put(&path("estimates"), id, (2, 1), &[4.0; 2]);
    }
    put(&path("rendered_depth_maps"), 0, (4, 2), &[4.0; 8]);
    let found = answer(&arguments(folder.path(), &[]));
    let counted = |at: usize| found["views"][at]["counted"].as_u64();
    assert_eq!([0, 1, 2].map(counted), [Some(2); 3], "{found}");
    let density = found["scene"]["mean_over_pixels"]["density"]
        .as_f64()
        .unwrap();
    assert!((density - 2.0 / 3.0).abs() < 1e-12, "{found}");

    // What has no truth to count has no estimate to miss.
    put(&path("rendered_depth_maps"), 5, (4, 2), &[0.0; 8]);
    let output = run(&arguments(folder.path(), &[]));
    let found: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(found["scene"]["partial"], false, "{found}");
    assert!(
        stderr(&output).contains("view 5: no true depth"),
        "{}",
        stderr(&output)
    );
}

/// Beside one of another size, of which the estimate's sides are rounded each its own way.
#[test]
fn a_missing_view_of_another_size_counts_too() {
    let folder = scene();
    let path = |name: &str| folder.path().join(name);
    let depths = |(width, height): (u32, u32), depth: f32| vec![depth; (width * height) as usize];
    // An eighth of 764 x 579 is 95.5 x 72.4, of 2048 x 1536 exactly 256 x 192.
    put(
        &path("rendered_depth_maps"),
        0,
        (764, 579),
        &depths((764, 579), 4.0),
    );
    put(&path("estimates"), 0, (96, 72), &depths((96, 72), 4.0));
    put(
        &path("rendered_depth_maps"),
        5,
        (2048, 1536),
        &depths((2048, 1536), 4.0),
    );
    let found = answer(&arguments(folder.path(), &[]));
    let counted = |at: usize| found["views"][at]["counted"].as_u64();
    let expected = [Some(96 * 72), Some(8), Some(256 * 192)];
    assert_eq!([0, 1, 2].map(counted), expected, "{}", found["views"]);
    assert_eq!(found["missing"], serde_json::json!([5]));
    // However long and thin, and however small the estimates.
    put(&path("estimates"), 0, (10, 8), &depths((10, 8), 4.0));
    put(
        &path("rendered_depth_maps"),
        5,
        (7, 2000),
        &depths((7, 2000), 4.0),
    );
    let found = answer(&arguments(folder.path(), &[]));
    assert_eq!(found["views"][2]["counted"], 27, "{}", found["views"]);
}

#[test]
fn what_cannot_be_compared_is_named() {
    let folder = scene();
    let refused = |arguments: &[String], part: &str| {
        let output = run(arguments);
        assert_eq!(output.status.code(), Some(2));
        assert!(stderr(&output).contains(part), "{}", stderr(&output));
    };
    let mut other = arguments(folder.path(), &[]);
    other[4] = text(&folder.path().join("nowhere")).into();
    refused(&other, "expected depth maps named like 00000000.pfm");
    let cams = folder.path().join("cams");
    refused(
        &arguments(folder.path(), &["--confidence", text(&cams)]),
        "00000000.pfm",
    );
    refused(
        &arguments(folder.path(), &["--alignment", "affine"]),
        "affine",
    );
    refused(&arguments(folder.path(), &["--planes", "2"]), "planes");
}

/// Numbers that are no depths are told of in the truth as in estimates; a truth that counts nowhere is no success.
#[test]
fn what_is_wrong_with_the_truth_is_said() {
    let folder = scene();
    let truth = folder.path().join("rendered_depth_maps");
    let values = [f32::NAN, 4.0, f32::INFINITY, 4.0, -1.0, 4.0, 4.0, 4.0];
    for (id, there) in [(0, true), (5, false)] {
        put(&truth, id, (4, 2), &values);
        let output = run(&arguments(folder.path(), &[]));
        let name = mvsnet::file_name(id, ".pfm");
        let said = format!("{name}: 3 NaN, infinite or negative depths");
        assert!(
            stderr(&output).contains(&said),
            "{there} {}",
            stderr(&output)
        );
    }
    // Of one view: no method can do better there, so that the means are whole.
    let estimates = folder.path().join("estimates");
    put(&truth, 0, (4, 2), &[8.5; 8]);
    put(&truth, 2, (4, 2), &[4.0; 8]);
    put(&truth, 5, (4, 2), &[4.0; 8]);
    put(&estimates, 5, (4, 2), &[4.0; 8]);
    let out = folder.path().join("out");
    let output = run(&arguments(folder.path(), &["--out", text(&out)]));
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    assert!(stderr(&output).contains("view 0: no true depth lies in its range"));
    let csv = fs::read_to_string(out.join("depth.csv")).unwrap();
    let status = |line: &str| line.rsplit(',').next().unwrap().to_owned();
    let statuses: Vec<String> = csv.lines().skip(1).map(status).collect();
    let expected = ["no-truth", "compared", "compared", "complete", "complete"];
    assert_eq!(statuses, expected, "{csv}");
    let table = run(&arguments(folder.path(), &["--format", "table"]));
    let table = String::from_utf8(table.stdout).unwrap();
    assert!(table.contains("0 (no truth)"), "{table}");
    // Nor is a map missing there.
    fs::remove_file(estimates.join("00000000.pfm")).unwrap();
    let output = run(&arguments(folder.path(), &[]));
    assert_eq!(output.status.code(), Some(0));
    let said = stderr(&output);
    assert!(
        said.contains("view 0: no true depth") && !said.contains("missing-depth"),
        "{said}"
    );
    for id in [0, 2, 5] {
        put(&truth, id, (4, 2), &[8.5; 8]);
        put(&folder.path().join("estimates"), id, (4, 2), &[8.5; 8]);
    }
    let answer = answer(&arguments(folder.path(), &["--format", "json"]));
    assert_eq!(answer["scene"]["partial"], false);
    assert!(answer["scene"]["mean_over_views"]["epe"].is_null());
}

/// Errors three halves as large in the cam's own intervals are not called smaller without a word.
#[test]
fn an_interval_that_cams_state_and_errors_are_not_counted_in_is_said() {
    let folder = scene();
    let cam = |id: u32, tail: &str| {
        let path = folder
            .path()
            .join("cams")
            .join(mvsnet::file_name(id, "_cam.txt"));
        let text = CAM.replace("1 1 8 9", tail);
        files::write_atomically(&path, |out| out.write_all(text.as_bytes())).unwrap();
    };
    let said = |planes: &str| {
        let mut arguments = arguments(folder.path(), &[]);
        let last = arguments.len() - 1;
        arguments[last] = planes.to_owned();
        stderr(&run(&arguments)).contains("state another depth interval")
    };
    assert!(!said("8"));
    assert!(said("12"));
    // MVSNet's two numbers stand for 192 planes.
    for id in [0, 2, 5] {
        cam(id, "1 0.0625");
    }
    assert!(said("128") && !said("192") && !said("191"));
    cam(2, "1 0.05 128 9");
    let mut given = arguments(folder.path(), &[]);
    *given.last_mut().unwrap() = "192".to_owned();
    let output = run(&given);
    let wanted = "the cams of 1 of 3 views state another depth interval than the 192th part";
    assert!(stderr(&output).contains(wanted), "{}", stderr(&output));
    assert!(stderr(&output).contains("--planes 160 counts in its own"));
    // A map of another scene, or of a view whose cam is missing, is left out, and told of.
    put(&folder.path().join("estimates"), 55, (4, 2), &[4.0; 8]);
    let output = run(&given);
    let wanted = "estimates: 1 depth maps are of views without a cam in the truth and are left out, the first is \
                  00000055.pfm";
    assert!(stderr(&output).contains(wanted), "{}", stderr(&output));
}
