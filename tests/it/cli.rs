//! The command line: exit codes, one sentence per error, nothing lost, replays.

use crate::support::{mvs_eval, stderr, text, write};
use mvs_datasets::format::image;
use mvs_datasets::layout::files::{self, write_atomically};
use mvs_datasets::scene::ColorImage;
use std::fs;
use std::path::Path;

#[cfg(target_os = "linux")] // /dev/full
mod answers;
mod help;
mod inspect;
mod refusals;
mod table;

/// The run fails with exit code 2 and one line of error that says all of `parts`.
fn assert_refused(arguments: &[&str], parts: &[&str]) {
    let output = mvs_eval(arguments);
    let said = stderr(&output);
    assert_eq!(output.status.code(), Some(2), "{arguments:?}: {said}");
    let errors: Vec<&str> = said
        .lines()
        .filter(|line| line.starts_with("error: "))
        .collect();
    assert_eq!(errors.len(), 1, "{arguments:?}: {said}");
    for part in parts {
        assert!(
            errors[0].contains(part),
            "{arguments:?}: expected `{part}` in: {}",
            errors[0]
        );
    }
    assert!(!said.contains("panicked"), "{said}");
}

const CAM: &str = "extrinsic\n1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n\nintrinsic\n40 0 20\n0 40 15\n\
                   0 0 1\n\n1 0.01 128 3\n";
const TRIANGLE: &str = "v -1 -1 2\nv 1 -1 2\nv 0 1 2\nf 1 3 2\n";

/// A folder with a triangle in front of one camera of 40 x 30 pixels.
fn small_scene() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    write(&folder.path().join("mesh.obj"), TRIANGLE);
    write(&folder.path().join("cams/00000000_cam.txt"), CAM);
    folder
}

/// `render` of the small scene with its mesh and cams, and further arguments.
fn render_arguments<'a>(mesh: &'a Path, cams: &'a Path, out: &'a Path) -> [&'a str; 7] {
    [
        "render",
        "--mesh",
        text(mesh),
        "--cameras",
        text(cams),
        "--out",
        text(out),
    ]
}

#[test]
fn help_and_version_answer_on_stdout_and_succeed() {
    for arguments in [
        &["--help"][..],
        &["--version"],
        &["help", "render"],
        &["fuse", "--help"],
    ] {
        let output = mvs_eval(arguments);
        assert_eq!(output.status.code(), Some(0), "{arguments:?}");
        assert!(
            output.stdout.len() > 10 && output.stderr.is_empty(),
            "{arguments:?}"
        );
    }
    assert_eq!(mvs_eval(&["no-such-command"]).status.code(), Some(2));
}

#[test]
fn results_are_kept_and_replayed() {
    let scene = small_scene();
    let path = |name: &str| scene.path().join(name);
    let (mesh, cams, out) = (path("mesh.obj"), path("cams"), path("out"));
    let output = mvs_eval(&render_arguments(&mesh, &cams, &out));
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    let answer: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(answer["views"][0]["width"], 40);
    let depth = fs::read(out.join("depth/00000000.pfm")).unwrap();

    assert_refused(
        &render_arguments(&mesh, &cams, &out),
        &["already exists", "--force"],
    );
    assert_eq!(fs::read(out.join("depth/00000000.pfm")).unwrap(), depth);

    let again = path("again");
    let run = out.join("run.toml");
    let output = mvs_eval(&["replay", text(&run), "--out", text(&again)]);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    assert!(!stderr(&output).contains("input-changed"));
    for name in [
        "depth/00000000.pfm",
        "color/00000000.png",
        "cams/00000000_cam.txt",
    ] {
        assert_eq!(
            fs::read(again.join(name)).unwrap(),
            fs::read(out.join(name)).unwrap(),
            "{name}"
        );
    }

    write(&mesh, TRIANGLE.replace("0 1 2\nf", "0 2 2\nf"));
    let output = mvs_eval(&["replay", text(&run), "--out", text(&path("third"))]);
    assert!(
        stderr(&output).contains("input-changed"),
        "{}",
        stderr(&output)
    );
    // What else may make another result of it is said, and what is wrong with the file by its name.
    let record = fs::read_to_string(&run).unwrap();
    let replayed = |record: String| {
        write(&run, record);
        let output = mvs_eval(&[
            "replay",
            text(&run),
            "--out",
            text(&path("fourth")),
            "--force",
        ]);
        (output.status.code(), stderr(&output))
    };
    let (_, said) = replayed(record.replace("version = \"0.1.0\"", "version = \"9.9.9\""));
    assert!(said.contains("made by mvs-eval 9.9.9, this is"), "{said}");
    let (code, said) = replayed(record.replace("[options]", "[options]\nsmaples = 1"));
    assert_eq!(code, Some(2));
    assert!(
        said.contains("run.toml: ") && said.contains("smaples"),
        "{said}"
    );
    fs::remove_file(&mesh).unwrap();
    let (code, said) = replayed(record);
    assert_eq!(code, Some(2));
    assert!(
        said.contains("mesh.obj is not there, as seen from this folder"),
        "{said}"
    );
}

/// Pairs are wanted beside the cams that they are of, where fusion looks for them.
#[test]
fn a_result_in_the_folder_that_it_was_made_from_does_not_change_it() {
    let scene = small_scene();
    let path = |name: &str| scene.path().join(name);
    let second = CAM.replace("1 0 0 0\n0 1", "1 0 0 -0.2\n0 1");
    write(&path("cams/00000001_cam.txt"), second);
    let (mesh, cams, out) = (path("mesh.obj"), path("cams"), path("cams/pair.txt"));
    let mut arguments = vec!["pairs", "--mesh", text(&mesh), "--cameras", text(&cams)];
    arguments.extend(["--out", text(&out)]);
    let output = mvs_eval(&arguments);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    let run = path("cams/pair.run.toml");
    let first = fs::read(&run).unwrap();
    let copy = path("copy.txt");
    let replay = |more: &[&str]| {
        let all = [&["replay", text(&run), "--force"], more].concat();
        let output = mvs_eval(&all);
        assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
        stderr(&output).contains("input-changed")
    };
    assert!(!replay(&["--out", text(&copy)]));
    assert_eq!(fs::read(&copy).unwrap(), fs::read(&out).unwrap());
    assert!(!replay(&[]), "in place");
    assert_eq!(fs::read(&run).unwrap(), first);
    write(&path("cams/notes"), "mine");
    assert!(replay(&["--out", text(&copy)]));
}

#[test]
fn flags_override_the_configuration_file() {
    let scene = small_scene();
    let path = |name: &str| scene.path().join(name);
    let (mesh, cams, out) = (path("mesh.obj"), path("cams"), path("out"));
    write(
        &path("options.toml"),
        "size = \"44x33\"\nrender.samples = 4\n",
    );
    let config = path("options.toml");
    let mut arguments = render_arguments(&mesh, &cams, &out).to_vec();
    arguments.extend(["--config", text(&config), "--samples", "1"]);
    let output = mvs_eval(&arguments);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    let run = fs::read_to_string(out.join("run.toml")).unwrap();
    assert!(
        run.contains("44x33") && run.contains("samples = 1"),
        "{run}"
    );

    write(&config, "smaples = 1\n");
    assert_refused(&arguments, &["options.toml: ", "unknown field", "smaples"]);
}

fn points_as_ply(points: &[&str]) -> String {
    let properties = "property float x\nproperty float y\nproperty float z\n";
    let head = format!("ply\nformat ascii 1.0\nelement vertex {}\n", points.len());
    format!("{head}{properties}end_header\n{}\n", points.join("\n"))
}

#[test]
fn inspect_understands_a_folder_of_tanks_and_temples() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join("download").join(name);
    write(
        &path("Barn.ply"),
        points_as_ply(&["0 0 0", "2 0 0", "nan 0 0"]),
    );
    write(
        &path("Barn.json"),
        r#"{"class_name": "SelectionPolygonVolume", "orthogonal_axis": "Z", "axis_min": -1, "axis_max": 1,
            "bounding_polygon": [[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]}"#,
    );
    let rows = "1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n";
    write(
        &path("Barn_trans.txt"),
        rows.replace('1', "2.5").replace("0 2.5\n", "0 1\n"),
    );
    write(
        &path("Barn_COLMAP_SfM.log"),
        format!("0 0 0\n{rows}1 1 0\n{rows}"),
    );
    let output = mvs_eval(&["inspect", text(&path("")), "--format", "table"]);
    let said = String::from_utf8(output.stdout.clone()).unwrap();
    assert!(output.status.success(), "{}", stderr(&output));
    let facts = [
        ("scene", "Barn"),
        ("points of the scan", "2"),
        ("inside the crop volume", "1"),
        ("reference poses", "2"),
        ("scale of the transform", "2.5"),
        ("τ", "0.01 m"),
    ];
    for (name, value) in facts {
        let line = |line: &str| line.contains(name) && line.contains(value);
        assert!(said.lines().any(line), "{name} {value}: {said}");
    }
    assert!(said.contains("Tanks and Temples scene"), "{said}");
    // Without one of its files it is no scene, and what it is else is said.
    std::fs::remove_file(path("Barn_trans.txt")).unwrap();
    assert_refused(&["inspect", text(&path(""))], &["download", "expected"]);
}

/// Files are named by ids, which are places where names are no numbers.
#[test]
fn inspect_says_which_image_an_id_is() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("transforms.json");
    let said = |names: [&str; 2]| {
        let frame = |name: &str| {
            let rows = "[[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]";
            format!(r#"{{"file_path": "{name}", "transform_matrix": {rows}}}"#)
        };
        let frames = names.map(frame).join(", ");
        let head = r#""camera_angle_x": 0.7, "w": 40, "h": 30"#;
        write(&path, format!(r#"{{{head}, "frames": [{frames}]}}"#));
        let output = mvs_eval(&["inspect", text(&path), "--format", "table"]);
        assert!(output.status.success(), "{}", stderr(&output));
        String::from_utf8(output.stdout).unwrap()
    };
    let places = said(["r_10.png", "r_2.png"]);
    assert!(places.contains("0 = r_10.png, 1 = r_2.png"), "{places}");
    let numbers = said(["0003.png", "0012.png"]);
    assert!(!numbers.contains("image names"), "{numbers}");
}

/// An image beside the cams tells their size, and that these count from the first pixel's centre.
#[test]
fn inspect_recognises_cams_with_integer_pixel_centres() {
    let folder = tempfile::tempdir().unwrap();
    let image = mvs_datasets::scene::ColorImage::filled(40, 30, [9; 3]).unwrap();
    let mut png = Vec::new();
    mvs_datasets::format::image::write_png(&mut png, &image).unwrap();
    write(&folder.path().join("images/00000000.png"), png);
    let cams = folder.path().join("cams");
    let inspect = |cam: &str, arguments: &[&str]| {
        write(&cams.join("00000000_cam.txt"), cam);
        let output = mvs_eval(&[&["inspect", text(&cams)][..], arguments].concat());
        assert!(output.status.success(), "{}", stderr(&output));
        String::from_utf8(output.stdout).unwrap()
    };
    let integer = CAM
        .replace("40 0 20", "40 0 19.5")
        .replace("40 15", "40 14.5");
    let said = inspect(&integer, &[]);
    assert!(said.contains("40x30 px"), "{said}");
    assert!(said.contains("use --pixel-center integer"), "{said}");
    let said = inspect(&integer, &["--pixel-center", "integer"]);
    assert!(said.contains("principal point (20, 15) px"), "{said}");
    assert!(!said.contains("use --pixel-center"), "{said}");
    assert!(!inspect(CAM, &[]).contains("use --pixel-center"));
}

#[test]
fn patterns_of_meshes_are_taken_and_every_file_behind_them_is_an_input() {
    let scene = small_scene();
    let path = |name: &str| scene.path().join(name);
    write(&path("mesh.mtl"), "newmtl red\nKd 1 0 0\n");
    write(
        &path("mesh.obj"),
        format!("mtllib mesh.mtl\nusemtl red\n{TRIANGLE}"),
    );
    let (pattern, cams) = (path("me?h*.obj"), path("cams"));
    let output = mvs_eval(&render_arguments(&pattern, &cams, &path("out")));
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    let run = fs::read_to_string(path("out/run.toml")).unwrap();
    assert!(
        run.contains("mesh.obj\"") && run.contains("mesh.mtl\""),
        "{run}"
    );
    write(&path("mesh.mtl"), "newmtl red\nKd 0 1 0\n");
    let again = [
        "replay",
        text(&path("out/run.toml")),
        "--out",
        text(&path("again")),
    ]
    .map(str::to_owned);
    let again: Vec<&str> = again.iter().map(String::as_str).collect();
    let output = mvs_eval(&again);
    let said = stderr(&output);
    assert_eq!(output.status.code(), Some(0), "{said}");
    assert!(
        said.contains("input-changed") && said.contains("mesh.mtl"),
        "{said}"
    );
    // Two views, so that there are pairs.
    write(
        &path("cams/00000001_cam.txt"),
        CAM.replace("1 0 0 0\n0 1", "1 0 0 -0.2\n0 1"),
    );
    let pairs = ["pairs", "--mesh", text(&pattern), "--cameras", text(&cams)].map(str::to_owned);
    let mut pairs: Vec<&str> = pairs.iter().map(String::as_str).collect();
    let out = path("pair.txt");
    pairs.extend(["--out", text(&out), "--texture-memory", "10"]);
    let output = mvs_eval(&pairs);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    let run = fs::read_to_string(path("pair.run.toml")).unwrap();
    assert!(run.contains("mesh.obj\""), "{run}");
}

/// A PNG whose left half has one colour and whose right half another one.
fn halves(path: &Path, (width, height): (u32, u32), colors: [[u8; 3]; 2]) {
    let half = |i: u32| colors[usize::from(i % width >= width / 2)];
    let values = (0..width * height).map(half).collect();
    let image = ColorImage::from_values(width, height, values).unwrap();
    write_atomically(path, |out| image::write_png(out, &image)).unwrap();
}

#[test]
fn photographs_of_another_shape_are_cut_not_squashed_and_masked_images_are_dark() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    // Saturated red beside black, which plain JPEG smears across the edge.
    let red = [250, 20, 20];
    halves(&path("rendered/a.png"), (64, 48), [red, [0; 3]]);
    // Twice as wide as its rendering's shape: only the middle half is seen.
    halves(&path("photos/a.png"), (256, 96), [[200, 0, 0], [0, 0, 200]]);
    let (rendered, photos, out) = (path("rendered"), path("photos"), path("out"));
    let arguments = [
        "blend",
        "--rendered",
        text(&rendered),
        "--photos",
        text(&photos),
        "--out",
        text(&out),
    ];
    let output = mvs_eval(&arguments);
    let said = stderr(&output);
    assert_eq!(output.status.code(), Some(0), "{said}");
    assert!(said.contains("[photograph-cut]"), "{said}");
    let answer: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(answer["images"][0]["cut"], true);
    let masked = files::read_image(&out.join("a_masked.jpg")).unwrap();
    let outside = (0..64 * 48).filter(|i| i % 64 >= 32);
    let brightest = outside.flat_map(|i| masked.values()[i]).max().unwrap();
    assert!(brightest <= 8, "{brightest}");
    // Of the same shape nothing is cut.
    halves(&path("photos/a.png"), (128, 96), [[200, 0, 0], [0, 0, 200]]);
    let output = mvs_eval(&[&arguments[..], &["--force"]].concat());
    assert!(
        !stderr(&output).contains("photograph-cut"),
        "{}",
        stderr(&output)
    );
    // Which of two photographs is meant, nobody knows.
    halves(&path("photos/a.jpeg.png"), (128, 96), [red, red]);
    std::fs::rename(path("photos/a.jpeg.png"), path("photos/a.jpg")).unwrap();
    let force = [&arguments[..], &["--force"]].concat();
    assert_refused(&force, &["a.jpg and", "a.png", "remove one"]);
}

#[test]
fn views_that_see_nothing_are_named_in_one_warning() {
    let folder = small_scene();
    // One camera that looks the right way, 25 that look away.
    let away = CAM.replacen(
        "1 0 0 0\n0 1 0 0\n0 0 1 0",
        "-1 0 0 0\n0 1 0 0\n0 0 -1 0",
        1,
    );
    for view in 1..=25 {
        write(
            &folder.path().join(format!("cams/{view:08}_cam.txt")),
            &away,
        );
    }
    let [mesh, cams, out] = ["mesh.obj", "cams", "out"].map(|name| folder.path().join(name));
    let mut arguments = render_arguments(&mesh, &cams, &out).to_vec();
    arguments.extend(["--size", "40x30"]);
    let output = mvs_eval(&arguments);
    let said = stderr(&output);
    assert_eq!(output.status.code(), Some(0), "{said}");
    let warnings: Vec<&str> = said
        .lines()
        .filter(|line| line.starts_with("warning [empty-view]"))
        .collect();
    assert_eq!(warnings.len(), 1, "{said}");
    assert!(
        warnings[0].contains("25 of 26 views see nothing of the mesh")
            && warnings[0].ends_with(
                ": 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16, 17, 18, 19, 20 and others"
            ),
        "{}",
        warnings[0]
    );
}

/// Runs a command, presses Ctrl-C as soon as it says something, twice at once as `timeout` does, and returns what it
/// said.
#[cfg(unix)]
fn interrupted(arguments: &[&str]) -> String {
    use std::io::{BufRead, BufReader, Read};
    use std::process::{Command, Stdio};
    let mut child = Command::new(assert_cmd::cargo::cargo_bin!("mvs-eval"))
        .args(arguments)
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut said = String::new();
    let mut stderr = BufReader::new(child.stderr.take().unwrap());
    stderr.read_line(&mut said).unwrap();
    let id = child.id().to_string();
    for _ in 0..2 {
        let sent = Command::new("kill").args(["-INT", &id]).status().unwrap();
        assert!(sent.success());
    }
    stderr.read_to_string(&mut said).unwrap();
    assert_eq!(
        child.wait().unwrap().code(),
        Some(2),
        "{arguments:?}: {said}"
    );
    said
}

#[cfg(unix)]
#[test]
fn an_interrupted_command_says_what_is_left_of_it() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    for index in 0..60 {
        let grey = ColorImage::filled(400, 300, [90; 3]).unwrap();
        let file = path(&format!("images/{index}.png"));
        write_atomically(&file, |out| image::write_png(out, &grey)).unwrap();
    }
    let (images, out, demo) = (path("images"), path("out"), path("demo"));
    let augment = [
        "augment",
        "--threads",
        "1",
        "--images",
        text(&images),
        "--out",
        text(&out),
    ];
    for (arguments, expected) in [
        (
            &augment[..],
            "what was written stays, but is no finished result",
        ),
        (&["demo", "--out", text(&demo)], "finished views are kept"),
        (
            &["extremes", "--out", text(&path("extremes"))],
            "no result of this run is kept, and one from before is as it was",
        ),
    ] {
        let said = interrupted(arguments);
        assert!(
            said.contains(&format!("error: interrupted; {expected}")),
            "{arguments:?}: {said}"
        );
    }
    assert!(!out.join("run.toml").exists() && !path("extremes/run.toml").exists());
    // It is true: the same command makes the rest.
    let output = mvs_eval(&augment);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
}
