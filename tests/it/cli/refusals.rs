//! What is refused: one sentence that says which file or option, and what was expected.

use super::*;

/// A one-channel PFM of ones.
fn pfm(width: usize, height: usize) -> Vec<u8> {
    let mut bytes = format!("Pf\n{width} {height}\n-1.000000\n").into_bytes();
    bytes.extend(std::iter::repeat_n(1.0f32.to_le_bytes(), width * height).flatten());
    bytes
}

#[test]
fn missing_files_are_named() {
    let scene = small_scene();
    let (mesh, cams, out) = (
        scene.path().join("mesh.obj"),
        scene.path().join("cams"),
        scene.path().join("out"),
    );
    let missing = scene.path().join("missing");
    assert_refused(&render_arguments(&missing, &cams, &out), &["missing"]);
    assert_refused(&render_arguments(&mesh, &missing, &out), &["missing"]);
    assert_refused(
        &["inspect", text(&missing.with_extension("ply"))],
        &["missing.ply", "found nothing there"],
    );
    assert_refused(
        &["inspect", text(&missing)],
        &["missing", "found nothing there"],
    );
    #[cfg(unix)]
    {
        let link = scene.path().join("link");
        std::os::unix::fs::symlink("nowhere", &link).unwrap();
        let said = "found a link that leads to none";
        assert_refused(&["inspect", text(&link)], &["link", said]);
    }
    assert!(
        !out.join("run.toml").exists(),
        "a refused run leaves no finished result"
    );
}

#[test]
fn singular_intrinsics_and_cameras_behind_the_mesh_are_named() {
    let scene = small_scene();
    let path = |name: &str| scene.path().join(name);
    let places = [
        (
            "flat",
            ["40 0 20", "0 0 20"],
            ["00000000_cam.txt", "singular"],
        ),
        (
            "behind",
            ["0 0 1 0\n0 0 0 1", "0 0 1 -9\n0 0 0 1"],
            ["views that see the mesh", "world-to-camera"],
        ),
    ];
    for (cameras, [from, to], error) in places {
        let cams = path(cameras);
        write(&cams.join("00000000_cam.txt"), CAM.replace(from, to));
        let out = path(&format!("{cameras}-out"));
        assert_refused(&render_arguments(&path("mesh.obj"), &cams, &out), &error);
    }
}

const EMPTY_CLOUD: &str = "ply\nformat ascii 1.0\nelement vertex 0\nproperty float x\n\
                           property float y\nproperty float z\nend_header\n";
const ONE_POINT: &str = "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\n\
                         property float y\nproperty float z\nend_header\n0 0 1\n";

#[test]
fn empty_clouds_and_wrong_formats_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    write(&path("empty.ply"), EMPTY_CLOUD);
    write(&path("point.ply"), ONE_POINT);
    write(&path("text.ply"), "this is no cloud\n");
    let (point, out) = (path("point.ply"), path("out"));
    let score = |truth: &Path, reconstruction: &Path, parts: &[&str]| {
        let arguments = [
            "score",
            "--truth",
            text(truth),
            "--reconstruction",
            text(reconstruction),
        ];
        let mut arguments = arguments.to_vec();
        arguments.extend(["--tau", "0.1", "--out", text(&out)]);
        assert_refused(&arguments, parts);
        assert!(!out.join("run.toml").exists());
    };
    let empty = ["empty.ply", "expected points of the truth"];
    score(&path("empty.ply"), &point, &empty);
    score(&point, &path("text.ply"), &["text.ply"]);
    score(&point, &path("none.ply"), &["none.ply"]);
    let arguments = [
        "score",
        "--truth",
        text(&point),
        "--reconstruction",
        text(&point),
    ];
    let mut arguments = arguments.to_vec();
    arguments.extend(["--tau", "-1", "--out", text(&out)]);
    assert_eq!(mvs_eval(&arguments).status.code(), Some(2));
}

#[test]
fn depth_and_confidence_of_different_size_and_missing_depths_are_named() {
    let scene = small_scene();
    let path = |name: &str| scene.path().join(name);
    let write_map = |name: &str, bytes: &[u8]| {
        write(&path(name), bytes);
    };
    write_map("depth/00000000.pfm", &pfm(40, 30));
    write_map("confidence/00000000.pfm", &pfm(20, 15));
    let (root, depths, out) = (path(""), path("depth"), path("cloud.ply"));
    let confidence = path("confidence");
    let arguments = [
        "fuse",
        text(&root),
        "--depths",
        text(&depths),
        "--out",
        text(&out),
    ];
    let with_confidence = [&arguments[..], &["--confidence", text(&confidence)]].concat();
    let at_fault = format!(
        "depth map {}, which is 40x30",
        depths.join("00000000.pfm").display()
    );
    assert_refused(
        &with_confidence,
        &["confidence/00000000.pfm", &at_fault, "20x15"],
    );
    let nothing = path("cams");
    let arguments = [
        "fuse",
        text(&root),
        "--depths",
        text(&nothing),
        "--out",
        text(&out),
    ];
    assert_refused(&arguments, &["cams", "00000000.pfm"]);
    assert!(!out.exists());
}

/// A value below 0 is the command's to refuse: `-1` is no unknown argument.
#[test]
fn values_without_sense_are_refused_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let out = ["--out", text(&out)];
    for (arguments, parts) in [
        (
            &["compare", "a", "b", "--tolerance", "inf"][..],
            &["--tolerance", "found inf"],
        ),
        (
            &["compare", "a", "b", "--tolerance", "-1"],
            &["--tolerance", "found -1"],
        ),
        (
            &["demo", "--threads", "100000", out[0], out[1]],
            &["--threads", "to 1024"],
        ),
        (
            &["demo", "--threads", "-1", out[0], out[1]],
            &[
                "--threads",
                "expected a whole number from 0 (all cores) to 1024",
            ],
        ),
        (
            &["extremes", "--width", "0", out[0], out[1]],
            &["--width", "at least 1"],
        ),
        (
            &["tradeoff", "--views", "0", out[0], out[1]],
            &["--views", "at least 1"],
        ),
        (
            &[
                "fuse",
                "--depths",
                "x",
                "--confidence-quantile",
                "0.5",
                "a",
                out[0],
                out[1],
            ],
            &["--confidence-quantile", "needs --confidence"],
        ),
    ] {
        assert_refused(arguments, parts);
        assert!(!folder.path().join("out").exists(), "{arguments:?}");
    }
}

#[test]
fn options_that_would_do_nothing_are_refused() {
    let fuse = |more: &[&'static str]| {
        [
            &["fuse", "scene", "--depths", "d", "--out", "c.ply"][..],
            more,
        ]
        .concat()
    };
    assert_refused(
        &fuse(&["--min-confidence", "0.5"]),
        &["--min-confidence", "--confidence"],
    );
    assert_refused(
        &fuse(&["--mode", "geo", "--visibility", "none"]),
        &["--visibility", "mode geo"],
    );
    assert_refused(
        &fuse(&["--mode", "dynamic", "--min-sources", "4"]),
        &["--min-sources"],
    );
    assert_refused(
        &fuse(&["--stereo", "photometric"]),
        &["--stereo", "workspace"],
    );
    assert_refused(
        &["score", "--all", "x", "--protocol", "plain", "--out", "o"],
        &["--protocol", "tnt"],
    );
    assert_refused(&["demo", "--tau", "0"], &["--tau"]);
    let config = ["--config", "options.toml"];
    for (command, said) in [
        (
            &["replay", "run.toml"][..],
            "replay takes the options of the run.toml",
        ),
        (&["report", "--check", "t.csv"], "--check and --folder"),
        (&["report", "--folder", "d"], "--check and --folder"),
    ] {
        assert_refused(
            &[command, &config].concat(),
            &["--config: expected none", said],
        );
    }
    for (flag, value) in [("--title", "x"), ("--picture", "p.png")] {
        for instead in ["--check", "--folder"] {
            assert_refused(&["report", instead, "x", flag, value], &[instead, flag]);
        }
    }
    assert_refused(
        &[
            "score",
            "--truth",
            "t.ply",
            "--reconstruction",
            "r.ply",
            "--tau",
            "1",
            "--bootstrap",
            "1",
            "--out",
            "o",
        ],
        &["--bootstrap", "40"],
    );
}

#[test]
fn a_negative_value_is_refused_by_its_own_name() {
    let folder = tempfile::tempdir().unwrap();
    let cloud = folder.path().join("cloud.ply");
    write(&cloud, points_as_ply(&["0 0 0"]));
    let out = folder.path().join("out");
    let arguments = [
        "score",
        "--truth",
        text(&cloud),
        "--reconstruction",
        text(&cloud),
        "--tau",
        "-1",
        "--out",
        text(&out),
    ];
    assert_refused(&arguments, &["tolerance", "-1"]);
}

/// Distances whose squares no number holds, in every command that takes a τ.
#[test]
fn distances_beyond_what_squares_hold_are_refused_with_the_range() {
    let scene = small_scene();
    let cloud = scene.path().join("cloud.ply");
    write(&cloud, points_as_ply(&["0 0 0", "1 0 0"]));
    let path = |name: &str| text(&scene.path().join(name)).to_owned();
    let (cloud, mesh, cams, out) = (text(&cloud), path("mesh.obj"), path("cams"), path("out"));
    let clouds = ["--truth", cloud, "--reconstruction", cloud];
    for tau in ["5e-324", "1e-151", "1e151", "1e308"] {
        for command in [
            [&["score"][..], &clouds].concat(),
            vec!["demo"],
            vec!["tradeoff", "--mesh", &mesh, "--cameras", &cams],
        ] {
            let arguments = [&command[..], &["--tau", tau, "--out", &out]].concat();
            assert_refused(
                &arguments,
                &["from 1e-150 to 1e150", &format!("found {tau}")],
            );
            assert!(!scene.path().join("out").exists(), "{arguments:?}");
        }
    }
}

#[test]
fn seeds_that_no_record_can_hold_are_refused_with_the_range() {
    let range = "expected a whole number from 0 to 9223372036854775807";
    for command in ["augment", "score", "demo", "tradeoff"] {
        for seed in ["18446744073709551616", "9223372036854775808", "-1", "1.5"] {
            assert_refused(&[command, "--seed", seed], &[seed, "--seed", range]);
        }
    }
}

#[test]
fn meshes_without_an_area_are_named() {
    let scene = small_scene();
    let path = |name: &str| scene.path().join(name);
    let flat = path("flat.obj");
    let (cams, photos, out) = (path("cams"), path("photos"), path("out"));
    write(&path("cloud.ply"), points_as_ply(&["0 0 0", "1 0 0"]));
    let grey = ColorImage::filled(40, 30, [90; 3]).unwrap();
    write_atomically(&photos.join("00000000.png"), |out| {
        image::write_png(out, &grey)
    })
    .unwrap();
    let cloud = path("cloud.ply");
    for corners in ["1 1 1\nv 1 1 1\nv 1 1 1", "0 0 2\nv 1 1 2\nv 3 3 2"] {
        write(&flat, format!("v {corners}\nf 1 2 3\n"));
        let said = ["flat.obj: expected a surface, found 1 triangles without an area"];
        assert_refused(&render_arguments(&flat, &cams, &out), &said);
        let seen = ["--mesh", text(&flat), "--cameras", text(&cams), "--out"];
        let generate = ["generate", "--photos", text(&photos), text(&out)];
        assert_refused(&[&generate[..3], &seen, &generate[3..]].concat(), &said);
        let pairs = path("pair.txt");
        assert_refused(&[&["pairs"], &seen[..], &[text(&pairs)]].concat(), &said);
        assert_refused(&[&["tradeoff"], &seen[..], &[text(&out)]].concat(), &said);
        for (truth, reconstruction) in [(&flat, &cloud), (&cloud, &flat)] {
            let score = [
                "score",
                "--truth",
                text(truth),
                "--reconstruction",
                text(reconstruction),
                "--tau",
                "0.1",
                "--out",
                text(&out),
            ];
            assert_refused(&score, &said);
        }
    }
}

#[test]
fn paths_that_were_not_given_are_named_before_any_work() {
    let scene = small_scene();
    let path = |name: &str| text(&scene.path().join(name)).to_owned();
    let (mesh, cams, photos) = (path("mesh.obj"), path("cams"), path("photos"));
    let given = ["--mesh", &mesh, "--cameras", &cams];
    for (arguments, missing) in [
        ([&["render"], &given[..]].concat(), "render: --out"),
        ([&["render"], &given[..2]].concat(), "render: --cameras"),
        ([&["render"], &given[2..]].concat(), "render: --mesh"),
        (
            [&["generate", "--photos", &photos], &given[..]].concat(),
            "generate: --out",
        ),
        ([&["generate"], &given[..]].concat(), "generate: --photos"),
        ([&["pairs"], &given[..]].concat(), "pairs: --out"),
        (vec!["pairs"], "pairs: --cameras"),
        (
            vec!["blend", "--rendered", &cams, "--photos", &photos],
            "blend: --out",
        ),
        (vec!["augment", "--images", &photos], "augment: --out"),
        (vec!["augment"], "augment: --images"),
        (vec!["verify"], "verify: SCENE"),
    ] {
        assert_refused(&arguments, &[missing, "found none"]);
    }
}

#[cfg(unix)]
#[test]
fn a_path_that_is_no_utf_8_is_named() {
    use std::ffi::OsStr;
    use std::os::unix::ffi::OsStrExt;
    let output = std::process::Command::new(env!("CARGO_BIN_EXE_mvs-eval"))
        .args([
            OsStr::new("inspect"),
            OsStr::from_bytes(b"scene\xff/mesh.obj"),
        ])
        .output()
        .unwrap();
    assert_eq!(output.status.code(), Some(2));
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(
        said.starts_with("error: scene\u{fffd}/mesh.obj: expected arguments in UTF-8"),
        "{said}"
    );
}

/// `cams/` is written beside the maps.
#[test]
fn rendering_does_not_write_over_its_cams() {
    let scene = small_scene();
    let path = |name: &str| scene.path().join(name);
    let (mesh, cams) = (path("mesh.obj"), path("cams"));
    let arguments = render_arguments(&mesh, &cams, scene.path());
    let arguments = [&arguments[..], &["--force"]].concat();
    assert_refused(
        &arguments,
        &["cams: expected another folder", "another --out"],
    );
    let cam = std::fs::read_to_string(path("cams/00000000_cam.txt")).unwrap();
    assert_eq!(cam, CAM);
    assert!(!path("depth").exists());
}
