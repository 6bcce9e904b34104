//! Photographs that do not show what their views' renderings show, and how they are found.

use super::{files_in, generate, inputs, own_inputs, scene_of};
use crate::support::{mvs_eval, stderr, text, write};
use mvs_datasets::layout::mvsnet;
use std::path::Path;

const CODE: &str = "photograph-does-not-match";

/// Photographs of the inputs, each under the name of the view before.
fn put_moved(folder: &Path) {
    let photos = files_in(&inputs().join("photos"));
    let bytes: Vec<&Vec<u8>> = photos.values().collect();
    for id in 0..bytes.len() {
        let path = folder.join(mvsnet::file_name(id as u32, ".jpg"));
        write(&path, bytes[(id + 1) % bytes.len()]);
    }
}

#[test]
fn photographs_of_other_views_are_told_by_generate_and_by_verify_afterwards() {
    let folder = tempfile::tempdir().unwrap();
    let verify = |folder: &Path| {
        let scene = scene_of(&folder.join("dataset"));
        let output = mvs_eval(&["verify", text(scene.path())]);
        String::from_utf8(output.stdout).unwrap()
    };
    let sound = generate(folder.path(), &[]);
    assert!(!stderr(&sound).contains(CODE), "{}", stderr(&sound));
    let found = verify(folder.path());
    assert!(!found.contains(CODE), "{found}");

    put_moved(&folder.path().join("moved"));
    let output = generate(folder.path(), &["--photos", "moved", "--force"]);
    let said = stderr(&output);
    assert_eq!(output.status.code(), Some(0), "{said}");
    assert!(
        said.contains(&format!("[{CODE}]: 6 of 6 photographs")),
        "{said}"
    );
    let found = verify(folder.path());
    assert_eq!(found.matches(CODE).count(), 6, "{found}");
}

#[test]
fn one_photograph_of_another_view_is_named() {
    let folder = tempfile::tempdir().unwrap();
    own_inputs(folder.path());
    let photos = folder.path().join("photos");
    std::fs::copy(photos.join("00000000.jpg"), photos.join("00000003.jpg")).unwrap();
    let said = stderr(&generate(folder.path(), &["--photos", "photos"]));
    assert!(
        said.contains("1 of 6 photographs") && said.contains("that of view 3"),
        "{said}"
    );
}

#[test]
fn blend_tells_of_photographs_of_other_views() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let (mesh, cams) = (inputs().join("mesh.obj"), inputs().join("cams"));
    let rendered = path("rendered");
    let render = [
        "render",
        "--mesh",
        text(&mesh),
        "--cameras",
        text(&cams),
        "--out",
        text(&rendered),
    ];
    assert_eq!(mvs_eval(&render).status.code(), Some(0));
    put_moved(&path("moved"));
    let blend = |photos: &Path, out: &str| {
        let out = path(out);
        let photos = ["--photos", text(photos), "--out", text(&out)];
        stderr(&mvs_eval(
            &[&["blend", "--rendered", text(&rendered)][..], &photos].concat(),
        ))
    };
    let said = blend(&inputs().join("photos"), "right");
    assert!(!said.contains(CODE), "{said}");
    let said = blend(&path("moved"), "wrong");
    assert!(
        said.contains(&format!("[{CODE}]: 6 of 6 photographs")),
        "{said}"
    );
}
