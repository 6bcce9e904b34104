//! `mvs-eval tradeoff`: what it says of errors is what the stages say themselves.

use crate::support::{mvs_eval, stderr, text, write};
use mvs_datasets::layout::files;
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Output;
use std::sync::OnceLock;

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
    let small = mvs_eval(&[
        "tradeoff",
        "--mesh",
        &demo("input/mesh.obj"),
        "--cameras",
        &demo("input/cams"),
        "--size",
        "64x48",
        "--views",
        "1",
        "--repeats",
        "1",
        "--out",
        text(&at("small")),
    ]);
    assert!(small.status.success(), "{}", stderr(&small));
    let small = rows_of(&fs::read_to_string(at("small/tradeoff.csv")).unwrap());
    let of_one_sample = |rows: &Rows| {
        let of_one =
            |row: &&BTreeMap<String, String>| row["knob"] == "samples" && row["setting"] == "1";
        rows.iter().find(of_one).unwrap()["value"].clone()
    };
    let values = [&small, &rows].map(of_one_sample);
    assert_ne!(values[0], values[1], "images of another size");
}

#[test]
fn without_the_inputs_of_a_stage_it_says_what_is_missing() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("tradeoff");
    for (inputs, expected) in [
        (&[][..], "expected the inputs of a stage"),
        (&["--scene", "s"], "--scene: goes with --depths, which"),
        (&["--depths", "d"], "--depths: goes with --scene, which"),
        (
            &["--camera-size", "8x8"],
            "--camera-size: goes with --scene, which",
        ),
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

/// A small demo, made once, and the folder of its scene.
fn demo() -> (&'static Path, &'static Path) {
    static DEMO: OnceLock<(tempfile::TempDir, PathBuf)> = OnceLock::new();
    let (folder, dataset) = DEMO.get_or_init(|| {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("demo");
        let made = mvs_eval(&[
            "demo",
            "--views",
            "8",
            "--size",
            "128x96",
            "--out",
            text(&out),
        ]);
        assert!(made.status.success(), "{}", stderr(&made));
        let answer: serde_json::Value = serde_json::from_slice(&made.stdout).unwrap();
        let dataset = PathBuf::from(answer["dataset"].as_str().unwrap());
        (folder, dataset)
    });
    (folder.path(), dataset)
}

/// A file of the demo.
fn of_demo(name: &str) -> String {
    text(&demo().0.join("demo").join(name)).to_owned()
}

/// `tradeoff` of fusing the demo's estimates, with further options.
fn fusion(options: &[&str], out: &Path) -> Output {
    let (depths, dataset) = (of_demo("estimates/depth"), text(demo().1));
    let fixed = [
        "tradeoff",
        "--scene",
        dataset,
        "--depths",
        &depths,
        "--repeats",
        "1",
    ];
    mvs_eval(&[&fixed[..], &["--out", text(out)], options].concat())
}

/// The values by knob and setting of a stage.
fn values(out: &Path, stage: &str) -> Vec<(String, String, f64)> {
    let rows = rows_of(&fs::read_to_string(out.join("tradeoff.csv")).unwrap());
    let of_stage = rows.iter().filter(|row| row["stage"] == stage);
    let value = |row: &BTreeMap<String, String>| {
        (
            row["knob"].clone(),
            row["setting"].clone(),
            number(row, "value"),
        )
    };
    of_stage.map(value).collect()
}

fn cloud(points: &[[f64; 3]]) -> String {
    let rows = points.iter().map(|[x, y, z]| format!("{x} {y} {z}\n"));
    format!(
        "ply\nformat ascii 1.0\nelement vertex {}\nproperty double x\nproperty double y\n\
         property double z\nend_header\n{}",
        points.len(),
        rows.collect::<String>()
    )
}

/// A unit square as a PLY of two triangles, `side` long, in the plane z = `height`.
fn square(side: f64, height: f64) -> String {
    format!(
        "ply\nformat ascii 1.0\nelement vertex 4\nproperty double x\nproperty double y\nproperty double z\n\
         element face 2\nproperty list uchar int vertex_indices\nend_header\n\
         0 0 {height}\n{side} 0 {height}\n{side} {side} {height}\n0 {side} {height}\n3 0 1 2\n3 0 2 3\n"
    )
}

#[test]
fn meshes_are_scored_by_their_area_as_by_score() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    write(&at("truth.ply"), square(1.0, 0.0));
    write(&at("half.ply"), square(0.5, 0.004));
    // The reconstruction's unit is two of the truth's.
    write(&at("twice.txt"), "2 0 0 0.3\n0 2 0 0.3\n0 0 2 0\n0 0 0 1\n");
    let paths = ["truth.ply", "half.ply", "twice.txt"].map(|name| text(&at(name)).to_owned());
    let [truth, half, twice] = &paths;
    let inputs = [
        "--truth",
        truth,
        "--reconstruction",
        half,
        "--transform",
        twice,
        "--seed",
        "3",
    ];
    let run = |command: &[&str], out: &str| {
        let ran = mvs_eval(
            &[
                command,
                &inputs[..],
                &["--tau", "0.02", "--out", text(&at(out))],
            ]
            .concat(),
        );
        assert!(ran.status.success(), "{}", stderr(&ran));
        stderr(&ran)
    };
    let warned = run(&["tradeoff", "--repeats", "1"], "tradeoff");
    run(&["score", "--voxel", "0.01"], "score");
    let score = fs::read_to_string(at("score/score.json")).unwrap();
    let score: serde_json::Value = serde_json::from_str(&score).unwrap();
    let exact = values(&at("tradeoff"), "score")[0].2;
    assert_eq!(Some(exact), score["f_score"].as_f64());
    // Half of either lies on the other, less what is lost of corners: 0.7² of the area.
    assert!((exact - 0.5).abs() < 0.03, "{exact}");
    assert!(
        warned.contains("the truth is a mesh, turned into points by area"),
        "{warned}"
    );
}

#[test]
fn fused_clouds_are_scored_against_a_mesh_by_its_area_and_a_scan_by_its_finite_points() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let scan = files::read_positions(Path::new(&of_demo("input/truth.ply"))).unwrap();
    let mut points: Vec<[f64; 3]> = scan.iter().map(|point| point.to_array()).collect();
    points.push([f64::NAN, 0.0, 0.0]);
    write(&at("nan.ply"), cloud(&points));
    let of = |truth: &str, out: &str| {
        let ran = fusion(&["--tau", "0.05", "--fuse-truth", truth], &at(out));
        assert!(ran.status.success(), "{}", stderr(&ran));
        (values(&at(out), "fuse")[0].2, stderr(&ran))
    };
    let (scan, told) = of(text(&at("nan.ply")), "scan");
    let dropped = format!(
        "1 of {} points of the truth are at NaN or infinity; they are dropped",
        points.len()
    );
    assert!(told.contains(&dropped), "{told}");
    let (mesh, told) = of(&of_demo("input/mesh.obj"), "mesh");
    assert!(scan > 0.5 && (scan - mesh).abs() < 0.1, "{scan} {mesh}");
    assert!(told.contains("the truth is a mesh"), "{told}");
}

/// Cams of images that are cut on the left and at the top: nothing but the option says how large they are.
#[test]
fn fusion_takes_the_size_that_cams_are_for() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let (depths, scene) = (at("depth"), at("scene"));
    fs::create_dir_all(scene.join("cams")).unwrap();
    fs::create_dir_all(&depths).unwrap();
    for id in 0..6 {
        let cam = format!(
            "extrinsic\n1 0 0 {}\n0 1 0 0\n0 0 1 0\n0 0 0 1\n\nintrinsic\n60 0 12\n0 60 8\n0 0 1\n\n1 0.01 192 4\n",
            -0.05 * f64::from(id)
        );
        write(&scene.join(format!("cams/{id:08}_cam.txt")), cam);
        let mut map = b"Pf\n64 48\n-1\n".to_vec();
        map.extend((0..64 * 48).flat_map(|_| 2.0f32.to_le_bytes()));
        write(&depths.join(format!("{id:08}.pfm")), map);
    }
    let pairs = (0..6).map(|id| {
        let others: String = (0..6)
            .filter(|&other| other != id)
            .map(|other| format!(" {other} 1"))
            .collect();
        format!("{id}\n5{others}\n")
    });
    write(
        &scene.join("cams/pair.txt"),
        format!("6\n{}", pairs.collect::<String>()),
    );
    let run = |options: &[&str], out: &str| {
        let out = at(out);
        let fixed = [
            "tradeoff",
            "--scene",
            text(&scene),
            "--depths",
            text(&depths),
            "--repeats",
            "1",
        ];
        mvs_eval(&[&fixed[..], &["--out", text(&out)], options].concat())
    };
    let asked = run(&[], "without");
    assert_eq!(asked.status.code(), Some(2));
    assert!(
        stderr(&asked).contains("give the images' size, --camera-size"),
        "{}",
        stderr(&asked)
    );
    let ran = run(&["--camera-size", "64x48"], "with");
    assert!(ran.status.success(), "{}", stderr(&ran));
    assert_eq!(values(&at("with"), "fuse")[0].2, 1.0);
}

/// A confidence map of squares of one pixel that are kept and left out by turns: of four neighbours the least is
/// never kept, so smaller maps keep nothing.
fn checkerboard((width, height): (usize, usize)) -> Vec<u8> {
    let mut map = format!("Pf\n{width} {height}\n-1\n").into_bytes();
    let value = |index: usize| {
        if (index % width + index / width).is_multiple_of(2) {
            1.0f32
        } else {
            0.0
        }
    };
    map.extend((0..width * height).flat_map(|index| value(index).to_le_bytes()));
    map
}

#[test]
fn a_setting_that_keeps_no_point_is_a_row_with_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let (confidence, out) = (folder.path().join("confidence"), folder.path().join("out"));
    fs::create_dir(&confidence).unwrap();
    for id in 0..8 {
        write(
            &confidence.join(format!("{id:08}.pfm")),
            checkerboard((128, 96)),
        );
    }
    let given = ["--confidence", text(&confidence), "--min-confidence", "0.5"];
    let ran = fusion(&given, &out);
    assert!(ran.status.success(), "{}", stderr(&ran));
    let rows = values(&out, "fuse");
    assert_eq!(rows[0].2, 1.0);
    let told = stderr(&ran);
    for size in ["a half", "a quarter"] {
        let row = rows.iter().find(|(_, setting, _)| setting == size);
        assert_eq!(row.unwrap().2, 0.0, "{rows:?}");
        let expected = format!("fusing with map size {size}: no pixel of 8 depth maps passed");
        assert!(told.contains(&expected), "{told}");
    }
    assert!(!told.contains("scratch"), "{told}");
    // Where even the exact setting keeps nothing, so that there is no truth either.
    let none = [
        "--confidence",
        text(&confidence),
        "--min-confidence",
        "2",
        "--force",
    ];
    let ran = fusion(&none, &out);
    assert!(ran.status.success(), "{}", stderr(&ran));
    assert!(
        stderr(&ran).contains("which are held against it: give --fuse-truth"),
        "{}",
        stderr(&ran)
    );
    assert!(values(&out, "fuse").iter().all(|row| row.2 == 0.0));
}

#[test]
fn what_a_stage_lacks_is_said_before_the_first_is_measured() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let (truth, depths) = (of_demo("input/truth.ply"), of_demo("estimates/depth"));
    let scored = [
        "tradeoff",
        "--truth",
        &truth,
        "--reconstruction",
        &truth,
        "--out",
        text(&out),
    ];
    let refused = |inputs: &[&str], expected: &str| {
        let ran = mvs_eval(&[&scored[..], inputs].concat());
        assert_eq!(ran.status.code(), Some(2), "{}", stderr(&ran));
        assert!(stderr(&ran).contains(expected), "{}", stderr(&ran));
        let left: Vec<_> = fs::read_dir(folder.path()).unwrap().collect();
        assert!(left.is_empty(), "{left:?}");
    };
    let dataset = tempfile::tempdir().unwrap();
    for part in [
        "cams",
        "rendered_depth_maps",
        "blended_images",
        "input_images",
    ] {
        let (from, to) = (demo().1.join(part), dataset.path().join(part));
        fs::create_dir(&to).unwrap();
        for file in fs::read_dir(from).unwrap() {
            let file = file.unwrap();
            fs::copy(file.path(), to.join(file.file_name())).unwrap();
        }
    }
    let extras = "`mvs-eval generate --extras input-images,rendered-images`";
    refused(&["--dataset", text(dataset.path())], extras);
    // A map that is cut short, and one of confidence that is missing.
    let broken = tempfile::tempdir().unwrap();
    for file in fs::read_dir(&depths).unwrap() {
        let file = file.unwrap();
        fs::copy(file.path(), broken.path().join(file.file_name())).unwrap();
    }
    let last = broken.path().join("00000007.pfm");
    let whole = fs::read(&last).unwrap();
    write(&last, &whole[..whole.len() - 4]);
    let scene = text(demo().1);
    refused(
        &["--scene", scene, "--depths", text(broken.path())],
        "00000007.pfm",
    );
    fs::remove_file(&last).unwrap();
    let confidence = [
        "--scene",
        scene,
        "--depths",
        &depths,
        "--confidence",
        text(broken.path()),
    ];
    refused(&confidence, "00000007.pfm");
    let mesh = broken.path().join("mesh.obj");
    write(&mesh, "v 0 0 0\n");
    let cameras = of_demo("input/cams");
    refused(
        &["--mesh", text(&mesh), "--cameras", &cameras],
        "expected a mesh",
    );
}
