//! `mvs-eval pairs`: source views from a COLMAP model, against `tests/reference/pairs_colmap.py`.

use crate::support::{mvs_eval, stderr, text, write};
use mvs_datasets::format::colmap;
use mvs_datasets::format::pair;
use mvs_datasets::layout::{exports, files, mesh_out};
use mvs_datasets::scene::Mesh;
use mvs_datasets::synthetic::{SyntheticOptions, SyntheticScene};
use mvs_eval::provenance::Run;
use serde_json::Value;
use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

fn golden() -> Value {
    serde_json::from_str(include_str!("../reference/pairs_colmap.json")).unwrap()
}

fn model_text(folder: &Path) {
    for (name, content) in golden()["files"].as_object().unwrap() {
        let content = content.as_str().unwrap();
        write(&folder.join(name), content);
    }
}

/// The same model in COLMAP's binary layout.
fn model_binary(folder: &Path) {
    let golden = golden();
    let file = |name: &str| golden["files"][name].as_str().unwrap().to_owned();
    let count = |count: usize| (count as u64).to_le_bytes().to_vec();
    let cameras = colmap::read_cameras_text(&file("cameras.txt")).unwrap();
    let mut bytes = count(cameras.len());
    for camera in &cameras {
        let model: i32 = if camera.model == "PINHOLE" { 1 } else { 2 };
        bytes.extend(camera.id.to_le_bytes());
        bytes.extend(model.to_le_bytes());
        bytes.extend(u64::from(camera.width).to_le_bytes());
        bytes.extend(u64::from(camera.height).to_le_bytes());
        bytes.extend(camera.params.iter().flat_map(|value| value.to_le_bytes()));
    }
    write(&folder.join("cameras.bin"), &bytes);
    let images = colmap::read_images_text(&file("images.txt")).unwrap();
    let mut bytes = count(images.len());
    for image in &images {
        bytes.extend(image.id.to_le_bytes());
        let pose = image.rotation.iter().chain(image.translation.as_ref());
        bytes.extend(pose.flat_map(|value| value.to_le_bytes()));
        bytes.extend(image.camera.to_le_bytes());
        bytes.extend(image.name.as_bytes());
        bytes.push(0);
        bytes.extend(count(image.points.len()));
        for point in &image.points {
            bytes.extend([0; 16]);
            bytes.extend(point.to_le_bytes());
        }
    }
    write(&folder.join("images.bin"), &bytes);
    let points = colmap::read_points_text(&file("points3D.txt")).unwrap();
    let mut bytes = count(points.len());
    for point in &points {
        bytes.extend(point.id.to_le_bytes());
        bytes.extend(
            point
                .position
                .to_array()
                .iter()
                .flat_map(|value| value.to_le_bytes()),
        );
        bytes.extend(point.color);
        bytes.extend([0; 16]);
    }
    write(&folder.join("points3D.bin"), &bytes);
}

fn read_pairs(path: &Path) -> BTreeMap<u32, Vec<(u32, f64)>> {
    let entries = pair::read(&files::read_text(path).unwrap()).unwrap();
    let sources = |entry: &pair::PairEntry| {
        entry
            .sources
            .iter()
            .map(|source| (source.id, source.score))
            .collect()
    };
    entries
        .iter()
        .map(|entry| (entry.id, sources(entry)))
        .collect()
}

#[test]
fn a_sparse_model_gives_the_pairs_of_the_plain_script() {
    for write in [model_text, model_binary] {
        let folder = tempfile::tempdir().unwrap();
        write(folder.path());
        let out = folder.path().join("pair.txt");
        let arguments = [
            "pairs",
            "--cameras",
            text(folder.path()),
            "--out",
            text(&out),
        ];
        let output = mvs_eval(&arguments);
        assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
        let said = stderr(&output);
        assert!(
            said.contains("[lens]: 2 views") && said.contains("[view-left-out]: 1"),
            "{said}"
        );
        let found = read_pairs(&out);
        for (id, expected) in golden()["sources"].as_object().unwrap() {
            let id: u32 = id.parse().unwrap();
            let expected: Vec<(u32, f64)> = serde_json::from_value(expected.clone()).unwrap();
            if expected.is_empty() {
                assert!(!found.contains_key(&id));
                continue;
            }
            let found = &found[&id];
            assert_eq!(found.len(), expected.len(), "{id}");
            for (found, expected) in found.iter().zip(&expected) {
                assert_eq!(found.0, expected.0, "{id}");
                let off = (found.1 / expected.1 - 1.0).abs();
                assert!(off < 1e-9, "{id} {found:?} {expected:?}");
            }
        }
        let listed = |id: u32| found.values().flatten().any(|&(source, _)| source == id);
        assert!(
            found
                .iter()
                .all(|(id, sources)| sources.iter().all(|(source, _)| source != id))
        );
        assert!(
            found.keys().all(|&id| listed(id)),
            "every reference is a source"
        );
        assert!(!said.contains("unused-option"), "{said}");
        let more = ["--sources", "2", "--force", "--focal", "100"];
        let few = mvs_eval(&[&arguments[..], &more].concat());
        assert_eq!(few.status.code(), Some(0), "{}", stderr(&few));
        assert!(stderr(&few).contains("[unused-option]"), "{}", stderr(&few));
        for (id, sources) in read_pairs(&out) {
            assert_eq!(sources[..], found[&id][..sources.len()], "{id}");
            assert!(sources.len() <= 2);
        }
    }
}

#[test]
fn models_that_say_nothing_of_points_are_named() {
    let folder = tempfile::tempdir().unwrap();
    model_text(folder.path());
    let out = folder.path().join("pair.txt");
    let refused = |part: &str| {
        let arguments = [
            "pairs",
            "--cameras",
            text(folder.path()),
            "--out",
            text(&out),
        ];
        let output = mvs_eval(&arguments);
        assert_eq!(output.status.code(), Some(2));
        assert!(stderr(&output).contains(part), "{}", stderr(&output));
        assert!(!out.exists());
    };
    fs::remove_file(folder.path().join("points3D.txt")).unwrap();
    refused("found 0 points and none seen");
    fs::remove_file(folder.path().join("images.txt")).unwrap();
    refused("expected a COLMAP model");
}

#[test]
fn pairs_replace_pairs_and_nothing_that_is_read() {
    let folder = tempfile::tempdir().unwrap();
    model_text(folder.path());
    let elsewhere = tempfile::tempdir().unwrap();
    let mesh = elsewhere.path().join("mesh.obj");
    write(&mesh, "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n");
    let run = |name: &str, with: &[&str]| {
        let out = folder.path().join(name);
        let always = ["pairs", "--cameras", text(folder.path()), "--force"];
        mvs_eval(&[&always[..], &["--out", text(&out)], with].concat())
    };
    // The run.toml of another command does not make what lies beside it a result of this one.
    let other = folder.path().join("images.run.toml");
    let of_fuse = Run {
        command: "fuse".to_owned(),
        version: String::new(),
        revision: String::new(),
        options: toml::Table::new(),
        inputs: BTreeMap::new(),
        files: ["images.txt".to_owned()].into(),
    };
    of_fuse.write(&other).unwrap();
    let with_mesh = ["--mesh", text(&mesh)];
    for (input, with) in [
        ("images.txt", &[][..]),
        ("cameras.txt", &[]),
        ("points3D.txt", &[]),
        ("images.txt", &with_mesh),
        (text(&mesh), &with_mesh),
    ] {
        let path = folder.path().join(input);
        let before = fs::read(&path).unwrap();
        let output = run(input, with);
        let said = stderr(&output);
        assert_eq!(output.status.code(), Some(2), "{said}");
        assert!(
            said.contains(text(&path)) && said.contains("found an input"),
            "{said}"
        );
        assert_eq!(fs::read(&path).unwrap(), before);
    }
    // Nor does a result of this one take its place.
    let (far, list) = (
        elsewhere.path().join("cloud.run.toml"),
        elsewhere.path().join("cloud.txt"),
    );
    of_fuse.write(&far).unwrap();
    let before = fs::read(&far).unwrap();
    let refused = run(text(&list), &[]);
    assert_eq!(refused.status.code(), Some(2));
    let said = stderr(&refused);
    assert!(
        said.contains("expected the run.toml of `pairs` or none, found that of `fuse`"),
        "{said}"
    );
    assert!(fs::read(&far).unwrap() == before && !list.exists());
    fs::remove_file(other).unwrap();
    // Pairs from elsewhere are not read.
    write(&folder.path().join("pair.txt"), "0\n");
    for _ in 0..2 {
        let output = run("pair.txt", &[]);
        assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
        assert!(!read_pairs(&folder.path().join("pair.txt")).is_empty());
        let run_file = folder.path().join("pair.run.toml");
        let run = Run::read(&run_file).unwrap();
        assert_eq!(run.changed_inputs(&run_file), [""; 0]);
    }
}

/// A scene of so many views of so many pixels, with its cameras as a COLMAP model.
fn scene_of((views, width, height): (u32, u32, u32), model: &Path) -> SyntheticScene {
    let options = SyntheticOptions {
        views,
        width,
        height,
        ..SyntheticOptions::default()
    };
    let scene = SyntheticScene::new(options).unwrap();
    exports::write_colmap(model, scene.scene()).unwrap();
    scene
}

/// A mesh whose faces are all wound the other way has no surface: that is said, not only that nothing is
/// shared.
#[test]
fn a_mesh_that_is_wound_the_other_way_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let scene = scene_of((6, 128, 96), &path("model"));
    let mesh = scene.mesh();
    let turned = mesh.triangles().iter().map(|&[a, b, c]| [a, c, b]);
    let turned = Mesh::new(mesh.vertices().to_vec(), turned.collect()).unwrap();
    for (name, mesh, code) in [("as it is", mesh, 0), ("turned", &turned, 2)] {
        let (file, out) = (path(&format!("{name}.obj")), path(&format!("{name}.txt")));
        mesh_out::write_obj(&file, mesh).unwrap();
        let (model, file, out) = (path("model"), text(&file), text(&out));
        let arguments = [
            "pairs",
            "--cameras",
            text(&model),
            "--mesh",
            file,
            "--out",
            out,
        ];
        let output = mvs_eval(&arguments);
        let said = stderr(&output);
        assert_eq!(output.status.code(), Some(code), "{said}");
        let named = said.contains("6 of them see only the backs of triangles");
        assert_eq!(named, code == 2, "{said}");
    }
}

/// Views that see the same from too far apart are not told that they see nothing in common.
#[test]
fn views_too_far_apart_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let scene = scene_of((2, 64, 48), &path("model"));
    mesh_out::write_obj(&path("mesh.obj"), scene.mesh()).unwrap();
    let (model, mesh, out) = (path("model"), path("mesh.obj"), path("pair.txt"));
    let far = "from directions near each other, found none among 2";
    let of_mesh = [
        "pairs",
        "--cameras",
        text(&model),
        "--mesh",
        text(&mesh),
        "--out",
        text(&out),
    ];
    // Two images, each with a point of its own.
    let sparse = path("sparse");
    write(&sparse.join("cameras.txt"), "1 PINHOLE 40 30 40 40 20 15\n");
    let of_points = ["pairs", "--cameras", text(&sparse), "--out", text(&out)];
    let said_of = |arguments: &[&str]| {
        let output = mvs_eval(arguments);
        assert_eq!(output.status.code(), Some(2), "{}", stderr(&output));
        assert!(!out.exists());
        stderr(&output)
    };
    let said = said_of(&of_mesh);
    assert!(said.contains(far), "{said}");
    write(
        &sparse.join("images.txt"),
        "1 1 0 0 0 0 0 0 1 a.png\n1 2 1\n2 0 0 1 0 0 0 10 1 b.png\n1 2 2\n",
    );
    let points = "1 0 0 5 1 2 3 0.5 1 0\n2 0 0 5 1 2 3 0.5 2 0\n";
    write(&sparse.join("points3D.txt"), points);
    let said = said_of(&of_points);
    assert!(
        said.contains("see the same points, found none among 2"),
        "{said}"
    );
}
