//! Photographs that do not show what their views' renderings show, and how they are found.

use super::{arguments, files_in, generate, inputs, own_inputs, scene_of, succeed};
use crate::support::{mvs_eval, stderr, text, write};
use mvs_datasets::layout::mvsnet;
use mvs_eval::generate::scene_id;
use std::path::Path;
use std::process::Command;

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

/// The scene is called as the folder that holds the photographs' folder, however that is reached.
#[test]
fn a_scene_has_one_name_however_its_photographs_are_reached() {
    let folder = tempfile::tempdir().unwrap();
    let statue = folder.path().join("statue");
    std::fs::create_dir_all(statue.join("work")).unwrap();
    own_inputs(&statue);
    let unnamed = arguments(&["--photos", "../photos", "--size", "64x48"]);
    let unnamed = unnamed
        .iter()
        .filter(|part| !["--name", "small"].contains(&part.as_str()));
    let output = Command::new(assert_cmd::cargo::cargo_bin!("mvs-eval"))
        .current_dir(statue.join("work"))
        .args(unnamed)
        .output()
        .unwrap();
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    let made = statue.join("work/dataset").join(scene_id("statue"));
    assert!(made.is_dir(), "{}", String::from_utf8_lossy(&output.stdout));
}

/// What `--camera-size` said is not asked for once more.
#[test]
fn a_camera_size_that_was_given_is_not_asked_for() {
    let folder = tempfile::tempdir().unwrap();
    let said = stderr(&generate(folder.path(), &["--camera-size", "256x192"]));
    assert!(said.contains("give another --camera-size"), "{said}");
}

/// What `generate` made of several sizes is verified whole, each scene named by its place.
#[test]
fn a_folder_of_data_sets_is_verified_as_all_of_them() {
    let folder = tempfile::tempdir().unwrap();
    succeed(folder.path(), &["--size", "64x48", "--size", "128x96"]);
    let dataset = folder.path().join("dataset");
    let output = mvs_eval(&["verify", text(&dataset)]);
    let said = String::from_utf8(output.stdout).unwrap();
    for size in ["64x48", "128x96"] {
        let scene = format!("{size}/{}", scene_id("small"));
        assert!(said.contains(&scene), "{said}");
        let root = dataset.join(size);
        let output = mvs_eval(&["inspect", text(&root)]);
        let said = String::from_utf8(output.stdout).unwrap();
        assert!(said.contains("data set"), "{said}");
    }
    let empty = folder.path().join("empty");
    std::fs::create_dir(&empty).unwrap();
    let said = stderr(&mvs_eval(&["verify", text(&empty)]));
    assert!(
        said.contains("expected a scene folder") && said.contains("found neither"),
        "{said}"
    );
}
