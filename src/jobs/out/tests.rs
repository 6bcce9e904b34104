//! Folders for results, replaced, cut short and among their inputs.

use super::file::name_from;
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

/// Two runs at once would mix their files.
#[cfg(unix)]
#[test]
fn a_folder_is_one_runs_until_it_ends() {
    let folder = tempfile::tempdir().unwrap();
    let first = OutDir::create(folder.path(), run_of(4), false).unwrap();
    for (samples, force) in [(4, false), (4, true), (16, true)] {
        let error = OutDir::create(folder.path(), run_of(samples), force);
        let error = error.unwrap_err().to_string();
        assert!(error.contains("another run is writing"), "{error}");
    }
    // What is written inside is another result.
    let inside = OutDir::create(&folder.path().join("inside"), run_of(4), false);
    inside.unwrap().finish().unwrap();
    first.write_json("a.json", &1).unwrap();
    first.finish().unwrap();
    let files = std::fs::read_dir(folder.path()).unwrap().count();
    assert_eq!(files, 3, "nothing but the result is left");
    drop(OutDir::create(folder.path(), run_of(16), true).unwrap());
    OutDir::create(folder.path(), run_of(16), true).unwrap();
    // Shards share theirs.
    let shard = |samples| OutDir::create_shared(folder.path(), run_of(samples), true);
    let shards = [1, 2].map(|_| shard(16));
    assert!(shards.iter().all(Result::is_ok));
    let others = [
        shard(4),
        OutDir::create_again(folder.path(), run_of(16), true),
        OutDir::create(folder.path(), run_of(16), true),
    ];
    for other in others {
        let error = other.unwrap_err().to_string();
        assert!(error.contains("another run is writing"), "{error}");
    }
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
fn what_a_killed_run_left_of_its_files_goes() {
    let folder = tempfile::tempdir().unwrap();
    let left = folder
        .path()
        .join("color")
        .join(".mvs-eval-a.png-Ab12cd.part");
    files::write_atomically(&left, |_| Ok(())).unwrap();
    let out = OutDir::create(folder.path(), run_of(4), true).unwrap();
    assert!(!left.exists());
    out.finish().unwrap();
}

#[test]
fn a_run_file_that_cannot_be_written_says_that_the_result_is_there() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("file");
    files::write_atomically(&file, |_| Ok(())).unwrap();
    let error = write_run_file(run_of(4), &file.join("a.run.toml"), &[]).unwrap_err();
    assert!(error.to_string().contains("the result is there"), "{error}");
}

#[test]
fn a_run_that_failed_before_its_first_file_is_in_nobodys_way() {
    let folder = tempfile::tempdir().unwrap();
    drop(OutDir::create(folder.path(), run_of(4), false).unwrap());
    let out = OutDir::create(folder.path(), run_of(16), false).unwrap();
    assert!(out.is_marked(UNFINISHED));
    // Nor are folders that were made for files which could not be written.
    drop(out);
    fs::create_dir_all(folder.path().join("depth/of")).unwrap();
    drop(OutDir::create(folder.path(), run_of(4), false).unwrap());
    files::write_atomically(&folder.path().join("depth/of/0.pfm"), |out| {
        out.write_all(b"mine")
    })
    .unwrap();
    assert!(OutDir::create(folder.path(), run_of(16), false).is_err());
}

/// Known before the work, not after it.
#[test]
fn a_name_leaves_room_for_that_of_its_run_file() {
    let folder = tempfile::tempdir().unwrap();
    let check = |letters: usize| {
        let name = format!("new/{}.ply", "n".repeat(letters));
        check_out_file(&folder.path().join(name), false)
    };
    check(100).unwrap();
    let error = check(250).unwrap_err().to_string();
    assert!(
        error.contains("one of 250 bytes: give a shorter"),
        "{error}"
    );
}

#[test]
fn a_result_file_has_a_name() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["new/", "new/.", "new/..", ".."] {
        let path = folder.path().join(name);
        let error = check_out_file(&path, true).unwrap_err().to_string();
        assert!(
            error.contains("expected the name of a file") || path.is_dir(),
            "{name}: {error}"
        );
        assert!(!folder.path().join("new").exists());
    }
    check_out_file(&folder.path().join("new/c."), false).unwrap();
}

/// By whatever name; what lies beside it is nobody's concern.
#[cfg(unix)]
#[test]
fn what_is_read_is_not_written_over() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    fs::create_dir_all(path("out/maps")).unwrap();
    for name in ["out/a.csv", "out/maps/0.pfm", "elsewhere"] {
        files::write_atomically(&path(name), |out| out.write_all(b"mine")).unwrap();
    }
    std::os::unix::fs::symlink(path("out/a.csv"), path("link.csv")).unwrap();
    std::os::unix::fs::symlink(path("elsewhere"), path("out/b.csv")).unwrap();
    let write = |input: &str, name: &str| {
        let input = path(input);
        let inputs = Inputs::list(&[&input], &[]).unwrap();
        let run = Run::new("render", &RenderJob::default(), &inputs).unwrap();
        OutDir::create(&path("out"), run, true)?.write(name, |out| out.write_all(b"new"))
    };
    for (input, name) in [
        ("out/a.csv", "a.csv"),
        ("link.csv", "a.csv"),
        ("out/b.csv", "b.csv"),
        ("out/maps", "maps/0.pfm"),
        ("out/maps", "maps/1.pfm"),
        ("out/maps/0.pfm", "maps/0.pfm"),
    ] {
        let error = write(input, name).unwrap_err().to_string();
        assert!(
            error.contains(input) && error.contains("another --out"),
            "{error}"
        );
    }
    for name in ["out/a.csv", "out/maps/0.pfm", "elsewhere"] {
        assert_eq!(fs::read(path(name)).unwrap(), b"mine");
    }
    assert!(!path("out/maps/1.pfm").exists());
    write("out/a.csv", "c.csv").unwrap();
    write("elsewhere", "a.csv").unwrap();
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

#[test]
fn force_does_not_take_another_commands_result() {
    let folder = tempfile::tempdir().unwrap();
    let blend = || Run::new("blend", &RenderJob::default(), &Inputs::default()).unwrap();
    write_all(folder.path(), 4, &["a.json", "maps/0.json"]);
    for mark in [FINISHED, UNFINISHED] {
        if mark == UNFINISHED {
            fs::rename(folder.path().join(FINISHED), folder.path().join(UNFINISHED)).unwrap();
        }
        let before = crate::provenance::hash_path(folder.path()).unwrap();
        for force in [false, true] {
            let said = [
                OutDir::create(folder.path(), blend(), force).err(),
                OutDir::create_again(folder.path(), blend(), force).err(),
                OutDir::check_again(folder.path(), &blend(), force).err(),
            ];
            let expected = format!(
                "{}: expected the {mark} of `blend` or none, found that of `render`, whose result the folder is: \
                 give another --out",
                folder.path().display()
            );
            for said in said {
                assert!(said.unwrap().to_string().ends_with(&expected));
            }
        }
        let after = crate::provenance::hash_path(folder.path()).unwrap();
        assert_eq!(after, before, "{mark}");
    }
    // What another command left before its first file is in nobody's way.
    let empty = tempfile::tempdir().unwrap();
    drop(OutDir::create(empty.path(), run_of(4), false).unwrap());
    assert!(OutDir::create(empty.path(), blend(), false).is_ok());
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

/// Killed while it still reads, hashes and counts, a run has replaced nothing.
#[test]
fn the_mark_of_a_result_goes_with_its_first_file() {
    let folder = tempfile::tempdir().unwrap();
    let there = |name: &str| folder.path().join(name).exists();
    let options = || Run::read(&folder.path().join(FINISHED)).map(|run| run.options);
    write_all(folder.path(), 4, &["a.json"]);
    let killed = |work: &dyn Fn(&mut OutDir)| {
        let mut out = OutDir::create(folder.path(), run_of(16), true).unwrap();
        work(&mut out);
        out._lock = None;
        std::mem::forget(out);
    };
    killed(&|_| {});
    assert_eq!(options().unwrap(), run_of(4).options);
    assert!(there(UNFINISHED));
    killed(&|out| {
        out.file("b.json");
    });
    assert!(!there(FINISHED) && there(UNFINISHED));
    write_all(folder.path(), 4, &["a.json"]);
    killed(&OutDir::begin);
    assert!(!there(FINISHED) && there(UNFINISHED));
    // One that fails beside another that has begun leaves the mark of both.
    write_all(folder.path(), 4, &["a.json"]);
    let shard = || OutDir::create_shared(folder.path(), run_of(16), true).unwrap();
    let (mut first, second) = (shard(), shard());
    first.begin();
    drop(second);
    assert!(!there(FINISHED) && there(UNFINISHED));
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

/// By whatever path: a part of the result before, whole or cut short, is read only for results elsewhere.
#[test]
fn no_result_replaces_files_that_are_read() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let result = path("in/result");
    let put = |name: &str| {
        files::write_atomically(&path(name), |out| out.write_all(b"mine")).unwrap();
    };
    let create = |out: &Path, input: &str| {
        let inputs = OutDir::inputs(out, &[&path(input)])?;
        let run = Run::new("render", &RenderJob::default(), &inputs)?;
        OutDir::create(out, run, true)
    };
    write_all(&result, 4, &["cams/0.txt", "cloud.ply"]);
    put("in/result/mine/0.txt");
    put("in/result/cams.txt");
    for cut_short in [false, true] {
        if cut_short {
            fs::rename(result.join(FINISHED), result.join(UNFINISHED)).unwrap();
        }
        let before = crate::provenance::hash_path(&result).unwrap();
        for input in [
            "in/result/cams",
            "in/result/cams/0.txt",
            "in/result/cloud.ply",
            "in/result/mine/../../result/cams",
        ] {
            let said = create(&result, input).unwrap_err().to_string();
            let expected = format!(
                "{}: expected another folder for the result than that of files that are read, found {}: give \
                 another --out",
                path(input).display(),
                result.display()
            );
            assert!(said.ends_with(&expected), "{said}");
            assert_eq!(crate::provenance::hash_path(&result).unwrap(), before);
        }
        assert!(create(&path("in/other"), "in/result/cams").is_ok());
    }
    for input in ["in/result/mine", "in/result/cams.txt", "in"] {
        assert!(create(&result, input).is_ok(), "{input}");
    }
    #[cfg(unix)]
    for (name, to) in [("cloud", "in/result/cloud.ply"), ("cams", "in/result/cams")] {
        std::os::unix::fs::symlink(path(to), path(name)).unwrap();
        assert!(create(&result, name).is_err(), "{name}");
    }
}

/// Nothing is in the way of the next run, which removes what this one wrote.
#[test]
fn a_run_that_cannot_finish_leaves_its_names() {
    let folder = tempfile::tempdir().unwrap();
    let there = |name: &str| folder.path().join(name).exists();
    write_all(folder.path(), 4, &["a.json", "b.json", "c.json"]);
    let in_the_way = folder.path().join("b.json");
    fs::remove_file(&in_the_way).unwrap();
    fs::create_dir(&in_the_way).unwrap();
    let out = OutDir::create(folder.path(), run_of(16), true).unwrap();
    out.write_json("new.json", &16).unwrap();
    let error = out.finish().unwrap_err().to_string();
    assert!(error.contains("b.json"), "{error}");
    assert!(!there(FINISHED) && there("new.json"));
    fs::remove_dir(&in_the_way).unwrap();
    write_all(folder.path(), 64, &["last.json"]);
    assert!(there("last.json"));
    assert!(!["a.json", "c.json", "new.json"].into_iter().any(there));
}

#[test]
fn what_a_failed_run_did_not_write_is_not_its_own() {
    let folder = tempfile::tempdir().unwrap();
    let put = |name: &str| {
        let path = folder.path().join(name);
        files::write_atomically(&path, |out| out.write_all(b"mine")).unwrap();
        path
    };
    let mine = ["results.csv", "maps/0.pfm"].map(put);
    let over = put("over.json");
    let out = OutDir::create(folder.path(), run_of(4), true).unwrap();
    let full = |_: &mut BlockWriter| Err(std::io::Error::other("no space left"));
    assert!(out.write("results.csv", full).is_err());
    assert_eq!(out.file("maps/0.pfm"), mine[1]);
    out.write_json("over.json", &4).unwrap();
    let new = out.file("maps/1.pfm");
    files::write_atomically(&new, |out| out.write_all(b"its own")).unwrap();
    assert_eq!(out.file("maps/1.pfm"), new, "asked for again");
    drop(out);
    let named = Run::read(&folder.path().join(UNFINISHED)).unwrap().files;
    assert_eq!(Vec::from_iter(named), ["maps/1.pfm", "over.json"]);
    write_all(folder.path(), 16, &["other.json"]);
    assert!(mine.iter().all(|path| fs::read(path).unwrap() == b"mine"));
    assert!(!new.exists() && !over.exists());
    // What a run that finishes has written over is its own.
    let out = OutDir::create(folder.path(), run_of(4), true).unwrap();
    files::write_atomically(&out.file("maps/0.pfm"), |out| out.write_all(b"its own")).unwrap();
    out.finish().unwrap();
    write_all(folder.path(), 16, &["other.json"]);
    assert!(!mine[1].exists() && mine[0].exists());
}

/// Names hold no place of the machine, so that a tree can be moved.
#[test]
fn files_beside_and_above_a_run_file_are_named_from_it() {
    let folder = tempfile::tempdir().unwrap();
    let names = ["one/below/cloud.ply", "one/depths/0.pfm", "one/above.pfm"];
    let paths = |root: &str| names.map(|name| folder.path().join(root).join(name));
    for path in paths("first") {
        files::write_atomically(&path, |out| out.write_all(b"result")).unwrap();
    }
    let run_file = |root: &str| folder.path().join(root).join("one/below/cloud.run.toml");
    let [cloud, depths, above] = paths("first");
    let depths = folder
        .path()
        .join("first/one/below/../depths")
        .join(depths.file_name().unwrap());
    write_run_file(run_of(4), &run_file("first"), &[cloud, depths, above]).unwrap();
    fs::rename(folder.path().join("first"), folder.path().join("moved")).unwrap();
    let run = Run::read(&run_file("moved")).unwrap();
    assert_eq!(
        Vec::from_iter(&run.files),
        ["../above.pfm", "../depths/0.pfm", "cloud.ply"]
    );
    let own = run.own(&run_file("moved"));
    assert_eq!(own.len(), 4);
    assert!(own.iter().all(|path| path.is_file()), "{own:?}");
    let absolute = |path: &str| std::path::absolute(path).unwrap();
    let (here, there) = (absolute("/a/b/c"), absolute("/x/y"));
    assert_eq!(name_from(&here, &there).unwrap(), "../../../x/y");
    // Without a common root, as between drives.
    assert_eq!(name_from(Path::new("b"), &there).as_deref(), there.to_str());
}
