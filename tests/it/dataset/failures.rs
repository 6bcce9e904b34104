//! Scenes that cannot be made, and going on when the reason is gone.

use super::*;

#[test]
fn a_manifest_of_which_nothing_can_be_made_is_an_error() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scenes.toml");
    let scene =
        "[[scene]]\nmesh = [\"a.obj\"]\ncameras = \"cams\"\nphotos = \"nowhere\"\nout = \"set\"\n";
    write(&path, scene.repeat(2));
    let output = mvs_eval(&["generate", "--manifest", text(&path)]);
    let said = stderr(&output);
    assert_eq!(output.status.code(), Some(2), "{said}");
    assert!(said.contains("all 2 failed"), "{said}");
    let answer: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(answer["failed"], 2, "the answer has the reasons");
}

/// A photograph stops a run and is repaired: the inputs are others than those of the run that stopped, and
/// what is finished is used again.
#[test]
fn a_run_that_failed_on_an_input_goes_on_when_it_is_mended() {
    let folder = tempfile::tempdir().unwrap();
    own_inputs(folder.path());
    let photograph = folder.path().join("photos/00000004.jpg");
    let whole = std::fs::read(&photograph).unwrap();
    write(&photograph, &whole[..whole.len() / 2]);
    let own = ["--photos", "photos", "--threads", "1"];
    assert_eq!(generate(folder.path(), &own).status.code(), Some(2));
    let scene = scene_of(&folder.path().join("dataset"));
    let first = scene.depth(0);
    let made = |path: &Path| std::fs::metadata(path).unwrap().modified().unwrap();
    let before = made(&first);
    write(&photograph, whole);
    let output = generate(folder.path(), &own);
    let said = stderr(&output);
    assert_eq!(output.status.code(), Some(2), "{said}");
    assert!(
        said.contains("an unfinished result") && said.contains("--force to go on"),
        "{said}"
    );
    succeed(folder.path(), &[&own[..], &["--force"]].concat());
    assert_eq!(made(&first), before, "a finished view is made again");
    let fresh = tempfile::tempdir().unwrap();
    succeed(fresh.path(), &[]);
    let files = |root: &Path| {
        let mut files = files_in(scene_of(&root.join("dataset")).path());
        files.remove(Path::new("run.toml"));
        files
    };
    assert!(files(folder.path()) == files(fresh.path()));
}
