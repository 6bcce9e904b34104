//! Folders for results, replaced, cut short and among their inputs.

use super::*;
use crate::jobs::render::RenderJob;

fn run_of(samples: u32) -> Run {
    let mut job = RenderJob::default();
    job.render.samples = samples;
    Run::new("render", &job, &Inputs::default()).unwrap()
}

#[test]
fn a_result_is_not_replaced_without_force() {
    let folder = tempfile::tempdir().unwrap();
    OutDir::create(folder.path(), run_of(4), false)
        .unwrap()
        .finish()
        .unwrap();
    let error = OutDir::create(folder.path(), run_of(4), false)
        .unwrap_err()
        .to_string();
    assert!(error.contains("already exists; give --force"), "{error}");
    assert!(
        folder.path().join(FINISHED).exists(),
        "refusing leaves the result as it is"
    );
    assert!(OutDir::create_again(folder.path(), run_of(16), false).is_err());
    assert!(OutDir::check_again(folder.path(), &run_of(16), false).is_err());
    assert!(OutDir::check_again(folder.path(), &run_of(16), true).is_ok());
    assert!(OutDir::check_again(folder.path(), &run_of(4), false).is_ok());
    assert!(OutDir::check_again(&folder.path().join("new"), &run_of(16), false).is_ok());
    assert!(OutDir::create_again(folder.path(), run_of(4), false).is_ok());
}

#[test]
fn an_interrupted_run_of_the_same_options_goes_on() {
    let folder = tempfile::tempdir().unwrap();
    let out = OutDir::create(folder.path(), run_of(4), false).unwrap();
    out.write_json("half.json", &1).unwrap();
    drop(out);
    assert!(
        OutDir::create(folder.path(), run_of(16), false).is_err(),
        "other options"
    );
    let out = OutDir::create(folder.path(), run_of(4), false).unwrap();
    assert!(out.file("half.json").exists() && !folder.path().join(FINISHED).exists());
    out.finish().unwrap();
    assert!(!folder.path().join(UNFINISHED).exists());
}

#[test]
fn a_run_that_failed_before_its_first_file_is_in_nobodys_way() {
    let folder = tempfile::tempdir().unwrap();
    drop(OutDir::create(folder.path(), run_of(4), false).unwrap());
    let out = OutDir::create(folder.path(), run_of(16), false).unwrap();
    assert!(out.is_marked(UNFINISHED));
}

#[test]
fn force_takes_any_folder() {
    let folder = tempfile::tempdir().unwrap();
    OutDir::create(folder.path(), run_of(4), false)
        .unwrap()
        .finish()
        .unwrap();
    let out = OutDir::create(folder.path(), run_of(16), true).unwrap();
    out.write_json("half.json", &1).unwrap();
    drop(out);
    assert!(
        !folder.path().join(FINISHED).exists(),
        "a half-replaced result is known as such"
    );
}

fn write_all(folder: &Path, samples: u32, names: &[&str]) {
    let out = OutDir::create(folder, run_of(samples), true).unwrap();
    for name in names {
        out.write_json(name, &samples).unwrap();
    }
    out.finish().unwrap();
}

#[test]
fn what_is_replaced_leaves_nothing_and_what_is_others_stays() {
    let folder = tempfile::tempdir().unwrap();
    let there = |name: &str| folder.path().join(name).exists();
    write_all(
        folder.path(),
        4,
        &["a.json", "maps/0.json", "maps/1.json", "old/0.json"],
    );
    let notes = folder.path().join("maps/notes");
    files::write_atomically(&notes, |out| out.write_all(b"mine")).unwrap();
    // One that is cut short and goes on.
    let out = OutDir::create(folder.path(), run_of(16), true).unwrap();
    out.write_json("maps/0.json", &16).unwrap();
    drop(out);
    assert!(there("a.json") && there("old/0.json") && !there(FINISHED));
    write_all(folder.path(), 16, &["maps/0.json", "b.json"]);
    let left = ["maps/0.json", "maps/notes", "b.json", FINISHED];
    assert!(left.into_iter().all(there));
    assert!(
        !["a.json", "maps/1.json", "old", UNFINISHED]
            .into_iter()
            .any(there)
    );
    let files = Run::read(&folder.path().join(FINISHED)).unwrap().files;
    assert_eq!(Vec::from_iter(files), ["b.json", "maps/0.json"]);
    assert!(remove_within(folder.path(), "../x").is_ok());
}

#[test]
fn a_run_that_fails_before_its_first_file_leaves_the_result_before_it() {
    let folder = tempfile::tempdir().unwrap();
    write_all(folder.path(), 4, &["a.json"]);
    let mark = fs::read(folder.path().join(FINISHED)).unwrap();
    drop(OutDir::create(folder.path(), run_of(16), true).unwrap());
    assert_eq!(fs::read(folder.path().join(FINISHED)).unwrap(), mark);
    assert!(!folder.path().join(UNFINISHED).exists());
}

/// A result folder in a folder that is read: cut short, gone on with, replaced, beside another one.
#[test]
fn a_result_among_its_inputs_is_none_of_them() {
    let folder = tempfile::tempdir().unwrap();
    let put = |name: &str| {
        let path = folder.path().join(name);
        files::write_atomically(&path, |out| out.write_all(name.as_bytes())).unwrap();
    };
    put("scene/0.pfm");
    let scene = folder.path().join("scene");
    let path = folder.path().join("scene/new/result");
    let create = |path: &Path, samples, force| {
        let mut job = RenderJob::default();
        job.render.samples = samples;
        let run = Run::new("render", &job, &OutDir::inputs(path, &[&scene])?)?;
        OutDir::create(path, run, force)
    };
    let run_file = path.join(FINISHED);
    let changed = || Run::read(&run_file).unwrap().changed_inputs(&run_file);
    let out = create(&path, 4, false).unwrap();
    let first = out.run.inputs.clone();
    out.write_json("maps/0.json", &4).unwrap();
    out.write_json("maps/1.json", &4).unwrap();
    drop(out);
    assert!(create(&path, 16, false).is_err(), "other options");
    let out = create(&path, 4, false).unwrap();
    out.write_json("maps/0.json", &4).unwrap();
    out.finish().unwrap();
    assert!(!path.join("maps/1.json").exists());
    assert_eq!(changed(), [""; 0]);
    for (samples, name) in [(16, "other.json"), (16, "maps/0.json")] {
        let out = create(&path, samples, true).unwrap();
        assert_eq!(out.run.inputs, first, "{name}");
        out.write_json(name, &samples).unwrap();
        out.finish().unwrap();
        assert_eq!(changed(), [""; 0], "{name}");
    }
    for (name, counts) in [
        ("scene/1.pfm", true),
        ("scene/new/result/notes", true),
        ("scene/new/result/other.json", true),
        ("scene/new/.mvs-eval-0.pfm-Ab12cd.part", false),
    ] {
        put(name);
        assert_eq!(changed().len(), usize::from(counts), "{name}");
        fs::remove_file(folder.path().join(name)).unwrap();
        assert_eq!(changed(), [""; 0], "{name}");
    }
    let other = create(&scene.join("other"), 4, false).unwrap();
    assert_ne!(other.run.inputs, first, "the first result may be read");
    other.finish().unwrap();
    assert_eq!(changed(), [scene.display().to_string()]);
}

#[test]
fn no_result_goes_into_an_input() {
    let folder = tempfile::tempdir().unwrap();
    let photos = folder.path().join("photos");
    fs::create_dir(&photos).unwrap();
    let inputs = Inputs::list(&[&photos], &[]).unwrap();
    let run = Run::new("blend", &RenderJob::default(), &inputs).unwrap();
    let error = OutDir::create(&folder.path().join("photos/../photos"), run, true);
    let said = error.unwrap_err().to_string();
    assert!(said.contains("photos: expected another folder"), "{said}");
}
