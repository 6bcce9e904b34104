//! `inspect` on what is not whole.

use super::*;
use mvs_datasets::format::pfm;
use mvs_datasets::scene::Raster;

/// A model of one camera and one image that saw points 1 and 2, with this `points3D.txt`.
fn put_model(folder: &Path, points: &str) {
    write(&folder.join("cameras.txt"), "1 PINHOLE 40 30 40 40 20 15\n");
    write(
        &folder.join("images.txt"),
        "1 1 0 0 0 0 0 0 1 00000003.png\n1 2 1 3 4 2\n",
    );
    write(&folder.join("points3D.txt"), points);
}

#[test]
fn a_model_whose_points_cannot_be_read_is_shown_without_them() {
    let folder = tempfile::tempdir().unwrap();
    let inspected = |points: &str| {
        put_model(folder.path(), points);
        let output = mvs_eval(&["inspect", text(folder.path()), "--format", "table"]);
        assert!(output.status.success(), "{}", stderr(&output));
        String::from_utf8(output.stdout).unwrap()
    };
    let points = "1 0 0 5 1 2 3 0.5\n2 0 0 6 1 2 3 0.5\n";
    let whole = inspected(points);
    assert!(
        whole.contains("depth ranges") && !whole.contains("points3D"),
        "{whole}"
    );
    let head = "# Number of points: 7, mean track length: 1\n";
    for (broken, problem) in [
        (format!("{head}{points}"), "expected 7 points"),
        ("1 0 zero 5 1 2 3\n".to_owned(), "zero"),
    ] {
        let said = inspected(&broken);
        assert!(said.contains("40x30 px"), "{said}");
        let mut facts = said.lines().map(str::trim_start);
        assert!(
            !facts.any(|fact| fact.starts_with("depth ranges")),
            "{said}"
        );
        assert!(
            said.contains("points3D.txt") && said.contains(problem),
            "{said}"
        );
        assert!(said.contains("no depth ranges"), "{said}");
    }
    // Whoever needs depth ranges is refused.
    let mesh = folder.path().join("mesh.obj");
    write(&mesh, TRIANGLE);
    let photos = folder.path().join("photos");
    halves(&photos.join("00000003.png"), (40, 30), [[9; 3]; 2]);
    put_model(folder.path(), &format!("{head}{points}"));
    let out = folder.path().join("out");
    let generate = [
        "generate",
        "--mesh",
        text(&mesh),
        "--cameras",
        text(folder.path()),
        "--photos",
        text(&photos),
        "--out",
        text(&out),
    ];
    assert_refused(&generate, &["points3D.txt", "expected 7 points"]);
}

#[test]
fn cams_beside_depth_maps_are_for_their_size() {
    let folder = tempfile::tempdir().unwrap();
    let cams = folder.path().join("mvs_depth");
    let cam = "extrinsic\n1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n\nintrinsic\n40 0 26\n0 40 17.5\n0 0 1\n\n1 0.1\n";
    write(&cams.join("00000000_cam.txt"), cam);
    let depth = Raster::from_values(53, 36, vec![2.0; 53 * 36]).unwrap();
    let file = cams.join("00000000.pfm");
    write_atomically(&file, |out| pfm::write_gray(out, &depth)).unwrap();
    // Photographs of four times the size beside the folder.
    halves(
        &folder.path().join("images/00000000.png"),
        (212, 144),
        [[9; 3]; 2],
    );
    let output = mvs_eval(&["inspect", text(&cams)]);
    let said = String::from_utf8(output.stdout).unwrap();
    assert!(said.contains("53x36 px"), "{said}");
    assert!(said.contains("--pixel-center integer"), "{said}");
    assert!(!said.contains("do not go with"), "{said}");
}

/// NeRF's own form: an angle of view and no image size. Wide enough that 40 pixels have a focal length of 40.
#[test]
fn transforms_without_an_image_size_are_for_their_photographs() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let frame = |id: usize| {
        let x = 0.1 * id as f64;
        format!(
            "{{\"file_path\": \"./train/r_{id}\", \"transform_matrix\": \
             [[1,0,0,{x}],[0,-1,0,0],[0,0,-1,0],[0,0,0,1]]}}"
        )
    };
    let frames: Vec<String> = (0..3).map(frame).collect();
    let put = |angle: &str| {
        let json = format!("{{{angle}\"frames\": [{}]}}", frames.join(","));
        write(&path("transforms.json"), &json);
    };
    put("");
    let output = mvs_eval(&["inspect", text(folder.path())]);
    let said = String::from_utf8(output.stdout).unwrap();
    for part in ["0 = train/r_0", "--camera-size", "--focal"] {
        assert!(said.contains(part), "{said}");
    }
    put("\"camera_angle_x\": 0.9272952180016122, ");
    let output = mvs_eval(&["inspect", text(folder.path())]);
    assert!(output.status.success(), "{}", stderr(&output));
    let said = String::from_utf8(output.stdout).unwrap();
    assert!(
        said.contains("--camera-size") && !said.contains("--focal"),
        "{said}"
    );
    write(&path("mesh.obj"), TRIANGLE);
    let (mesh, photos, out) = (path("mesh.obj"), path("train"), path("out"));
    let render = render_arguments(&mesh, folder.path(), &out);
    assert_refused(&render, &["transforms.json", "--camera-size"]);
    for id in 0..3 {
        halves(
            &photos.join(format!("r_{id}.png")),
            (40, 30),
            [[9; 3], [90; 3]],
        );
    }
    let generate = [&["generate", "--photos", text(&photos)][..], &render[1..]].concat();
    let output = mvs_eval(&generate);
    let said = stderr(&output);
    assert!(output.status.success(), "{said}");
    assert!(said.contains("40x30, the photographs' size"), "{said}");
    let answer: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let scene = Path::new(answer["sets"][0]["folder"].as_str().unwrap());
    let cam = std::fs::read_to_string(scene.join("cams/00000000_cam.txt")).unwrap();
    let row = cam.lines().skip_while(|line| *line != "intrinsic").nth(1);
    let row = row
        .unwrap()
        .split(' ')
        .map(|text| text.parse::<f64>().unwrap());
    let row: Vec<f64> = row.collect();
    assert!(
        (row[0] - 40.0).abs() < 1e-9 && row[1..] == [0.0, 20.0],
        "{cam}"
    );
    halves(&photos.join("r_2.png"), (80, 60), [[9; 3], [90; 3]]);
    let again = [&generate[..], &["--force"]].concat();
    assert_refused(&again, &["40x30 and 80x60", "--camera-size"]);
}

#[test]
fn a_mesh_that_is_textured_throughout_has_no_other_triangles() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    halves(&path("t.png"), (4, 4), [[9; 3], [90; 3]]);
    write(&path("m.mtl"), "newmtl a\nmap_Kd t.png\n");
    let vertices = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\n";
    let textured = format!("mtllib m.mtl\n{vertices}usemtl a\nf 1/1 2/2 3/3\n");
    for (more, others) in [("", false), ("v 1 1 0\nf 2 4 3\n", true)] {
        write(&path("m.obj"), format!("{textured}{more}"));
        let output = mvs_eval(&["inspect", text(&path("m.obj"))]);
        let said = String::from_utf8(output.stdout).unwrap();
        assert!(said.contains("show a texture (1 materials)"), "{said}");
        assert_eq!(said.contains("the others"), others, "{said}");
    }
}
