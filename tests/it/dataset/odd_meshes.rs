//! Meshes that are read and are not what is meant.

use super::{files_in, generate, inputs, own_inputs, scene_of};
use crate::support::{mvs_eval, stderr, text, write};
use std::path::Path;

/// The inputs' mesh in `model/`, with more at its end.
fn put_mesh(folder: &Path, more: &str) {
    own_inputs(folder);
    let model = folder.join("model");
    std::fs::create_dir_all(&model).unwrap();
    for (name, bytes) in files_in(inputs()) {
        if name.parent() == Some(Path::new("")) {
            write(&model.join(name), bytes);
        }
    }
    let path = model.join("mesh.obj");
    let whole = std::fs::read_to_string(&path).unwrap();
    write(&path, whole + more);
}

const TRIANGLE: &str = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n\
    element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n";

#[test]
fn one_model_in_two_formats_is_not_joined() {
    let folder = tempfile::tempdir().unwrap();
    put_mesh(folder.path(), "");
    let model = folder.path().join("model");
    write(&model.join("._mesh.obj"), [0, 5, 22, 7]);
    let made = generate(folder.path(), &["--mesh", "model"]);
    let said = stderr(&made);
    assert_eq!(
        made.status.code(),
        Some(0),
        "what macOS keeps beside a file is no mesh: {said}"
    );
    assert!(!said.contains("several formats"), "{said}");
    write(&model.join("other.ply"), TRIANGLE);
    let said = stderr(&generate(folder.path(), &["--mesh", "model", "--force"]));
    assert!(
        said.contains("2 files of several formats are joined"),
        "{said}"
    );
    write(&model.join("mesh.ply"), TRIANGLE);
    let refused = generate(folder.path(), &["--mesh", "model", "--force"]);
    let said = stderr(&refused);
    assert_eq!(refused.status.code(), Some(2), "{said}");
    assert!(
        said.contains("expected each mesh once") && said.contains("mesh.ply"),
        "{said}"
    );
}

#[test]
fn a_mesh_without_colors_is_told_of() {
    let folder = tempfile::tempdir().unwrap();
    put_mesh(folder.path(), "");
    let of = || stderr(&generate(folder.path(), &["--mesh", "model", "--force"]));
    let said = of();
    assert!(!said.contains("mesh-without-colors"), "{said}");
    let path = folder.path().join("model/mesh.obj");
    let whole = std::fs::read_to_string(&path).unwrap();
    let plain = whole
        .lines()
        .filter(|line| !line.starts_with("mtllib") && !line.starts_with("usemtl"));
    write(
        &path,
        plain.fold(String::new(), |all, line| all + line + "\n"),
    );
    let said = of();
    assert!(said.contains("[mesh-without-colors]"), "{said}");
}

#[test]
fn a_vertex_that_no_triangle_uses_moves_nothing_and_one_far_off_is_told_of() {
    let folder = tempfile::tempdir().unwrap();
    let depths = |more: &str| {
        put_mesh(folder.path(), more);
        let made = generate(folder.path(), &["--mesh", "model", "--force"]);
        assert_eq!(made.status.code(), Some(0), "{}", stderr(&made));
        let scene = scene_of(&folder.path().join("dataset"));
        (
            files_in(&scene.path().join("rendered_depth_maps")),
            stderr(&made),
        )
    };
    let (expected, said) = depths("");
    assert!(!said.contains("mesh-far"), "{said}");
    let (found, _) = depths("v 1e15 0 0\n");
    assert!(found == expected, "depths moved");
    put_mesh(
        folder.path(),
        "v 1e12 0 0\nv 1e12 1 0\nv 1e12 0 1\nf -3 -2 -1\n",
    );
    let path = |name: &str| folder.path().join(name);
    let said = stderr(&mvs_eval(&[
        "render",
        "--mesh",
        text(&path("model")),
        "--cameras",
        text(&inputs().join("cams")),
        "--out",
        text(&path("far")),
        "--samples",
        "1",
        "--size",
        "64x48",
    ]));
    assert!(said.contains("[mesh-far]"), "{said}");
}

#[test]
fn inspect_says_what_is_wrong_with_what_lies_there() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    write(
        &path("mesh/bad.obj"),
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n",
    );
    let inspected = |name: &str| mvs_eval(&["inspect", text(&path(name))]);
    let said = stderr(&inspected("mesh"));
    assert!(
        said.contains("bad.obj") && !said.contains("cameras"),
        "{said}"
    );
    write(
        &path("both/good.obj"),
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n",
    );
    write(&path("both/cams/00000000_cam.txt"), "extrinsic\n1 0 0\n");
    let output = inspected("both");
    let said = stderr(&output);
    assert_eq!(output.status.code(), Some(2), "{said}");
    assert!(said.contains("00000000_cam.txt"), "{said}");
}
