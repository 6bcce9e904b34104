//! `mvs-eval generate` on files: sets of two sizes, shards, manifests, exports, and being killed.

mod failures;
mod lens;
mod odd_meshes;
mod photographs;
mod sizes;
mod sources;

use crate::support::{mvs_eval, real_data, stderr, text, write};
use glam::DVec2;
use mvs_datasets::format::image::{self, JpegOptions};
use mvs_datasets::layout::blended::{self, BlendedFolder};
use mvs_datasets::layout::cameras::{CamerasOptions, read_scene};
use mvs_datasets::layout::mvsnet::{self, PixelCentre};
use mvs_datasets::layout::{exports, files, mesh_out};
use mvs_datasets::scene::{ColorImage, Distortion, Mesh, Scene, View};
use mvs_datasets::synthetic::{SyntheticOptions, SyntheticScene};
use mvs_eval::generate::scene_id;
use mvs_eval::render::{RenderOptions, Renderer};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::OnceLock;
use std::time::Duration;
use tempfile::TempDir;

const VIEWS: u32 = 6;

fn synthetic() -> SyntheticScene {
    SyntheticScene::new(SyntheticOptions {
        views: VIEWS,
        width: 128,
        height: 96,
        ..SyntheticOptions::default()
    })
    .unwrap()
}

/// A folder with mesh, cams and photographs as a user has them, made once.
fn inputs() -> &'static Path {
    static INPUTS: OnceLock<TempDir> = OnceLock::new();
    let folder = INPUTS.get_or_init(|| {
        let folder = tempfile::tempdir().unwrap();
        let scene = synthetic();
        mesh_out::write_obj(&folder.path().join("mesh.obj"), scene.mesh()).unwrap();
        let cams = folder.path().join("cams");
        mvsnet::write_pairs(&cams.join("pair.txt"), scene.scene()).unwrap();
        let renderer = Renderer::new(scene.mesh()).unwrap();
        for (index, view) in scene.scene().views().iter().enumerate() {
            let cam = cams.join(mvsnet::file_name(view.id, "_cam.txt"));
            mvsnet::write_view(&cam, view, PixelCentre::Half).unwrap();
            let rendering = renderer.render(view, &RenderOptions::default()).unwrap();
            let photograph = scene.photograph(index, &rendering.color);
            let path = folder.path().join("photos");
            let path = path.join(mvsnet::file_name(view.id, ".jpg"));
            files::write_atomically(&path, |out| {
                image::write_jpeg(out, &photograph, JpegOptions::default())
            })
            .unwrap();
        }
        folder
    });
    folder.path()
}

/// `generate` of the inputs into `dataset` of the current folder, with further arguments.
fn arguments(more: &[&str]) -> Vec<String> {
    let mut all = vec!["generate".to_owned()];
    let mut give = |flag: &str, value: &str| {
        if !more.contains(&flag) {
            all.extend([flag.to_owned(), value.to_owned()]);
        }
    };
    let input = |name: &str| text(&inputs().join(name)).to_owned();
    give("--mesh", &input("mesh.obj"));
    give("--cameras", &input("cams"));
    give("--photos", &input("photos"));
    give("--name", "small");
    give("--samples", "1");
    give("--out", "dataset");
    all.extend(more.iter().map(|&argument| argument.to_owned()));
    all
}

fn generate(folder: &Path, more: &[&str]) -> std::process::Output {
    command(folder, more).output().unwrap()
}

fn command(folder: &Path, more: &[&str]) -> Command {
    let mut command = Command::new(assert_cmd::cargo::cargo_bin!("mvs-eval"));
    command.current_dir(folder).args(arguments(more));
    command
}

fn succeed(folder: &Path, more: &[&str]) {
    let output = generate(folder, more);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
}

/// Every file under `root` with its bytes.
fn files_in(root: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut found = BTreeMap::new();
    let mut folders = vec![root.to_path_buf()];
    while let Some(folder) = folders.pop() {
        let Ok(entries) = std::fs::read_dir(folder) else {
            continue;
        };
        for path in entries.map(|entry| entry.unwrap().path()) {
            if path.is_dir() {
                folders.push(path);
            } else {
                let name = path.strip_prefix(root).unwrap().to_path_buf();
                found.insert(name, std::fs::read(&path).unwrap_or_default());
            }
        }
    }
    found
}

fn scene_of(root: &Path) -> BlendedFolder {
    BlendedFolder::new(root.join(scene_id("small")))
}

/// The process is killed when it has written ever more files, and once more at every stage from
/// there on; the last run is left alone. Nothing of that shows in the data set.
#[test]
fn generation_that_is_killed_again_and_again_gives_the_same_bytes() {
    let (whole, killed) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let extras = [
        "--extras",
        "masks,normals,occlusion,covisibility,transforms,colmap",
    ];
    succeed(whole.path(), &extras);
    let dataset = killed.path().join("dataset");
    let mut kills = 0u32;
    loop {
        let mut child = command(killed.path(), &extras)
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let before = files_in(&dataset).len();
        let ended = loop {
            if let Some(status) = child.try_wait().unwrap() {
                break Some(status);
            }
            if files_in(&dataset).len() >= before + 1 + kills as usize % 4 {
                // Somewhere in the next file, or in the ones after it.
                std::thread::sleep(Duration::from_micros(u64::from(kills * 397 % 3001)));
                break None;
            }
            std::thread::sleep(Duration::from_micros(200));
        };
        if let Some(status) = ended {
            assert!(status.success(), "{status} after {kills} kills");
            break;
        }
        child.kill().unwrap();
        child.wait().unwrap();
        kills += 1;
        assert!(kills < 200, "no progress");
    }
    assert!(kills >= 5, "killed only {kills} times");
    let (expected, found) = (files_in(whole.path()), files_in(killed.path()));
    let names = |files: &BTreeMap<PathBuf, Vec<u8>>| files.keys().cloned().collect::<Vec<_>>();
    assert_eq!(names(&found), names(&expected));
    for (name, bytes) in &expected {
        assert!(found[name] == *bytes, "{} differs", name.display());
    }
}

/// Photographs and mesh of the inputs in a folder of their own, to be changed.
fn own_inputs(folder: &Path) {
    for (name, to) in [("mesh.obj", "mesh.obj"), ("mesh.mtl", "mesh.mtl")] {
        std::fs::copy(inputs().join(name), folder.join(to)).unwrap();
    }
    for (name, bytes) in files_in(&inputs().join("photos")) {
        write(&folder.join("photos").join(name), bytes);
    }
}

#[test]
fn what_a_scene_follows_from_is_what_was_read_and_nothing_beside_it() {
    let folder = tempfile::tempdir().unwrap();
    own_inputs(folder.path());
    // The data set lies in the photographs' folder; the mesh is a pattern.
    let own = [
        "--photos",
        "photos",
        "--mesh",
        "m*.obj",
        "--out",
        "photos/dataset",
    ];
    succeed(folder.path(), &own);
    let scene = scene_of(&folder.path().join("photos/dataset"));
    let finished = std::fs::read(scene.record()).unwrap();
    write(&folder.path().join("photos/notes.txt"), "mine");
    write(&scene.path().join("masks/notes.txt"), "mine too");
    write(&scene.path().join("cams/20261126_old_cam.txt"), "mine too");
    write(&scene.path().join("20261126.txt"), "mine too");
    succeed(folder.path(), &own);
    assert_eq!(std::fs::read(scene.record()).unwrap(), finished);
    for kept in [
        "masks/notes.txt",
        "cams/20261126_old_cam.txt",
        "20261126.txt",
    ] {
        assert!(
            scene.path().join(kept).is_file(),
            "{kept} was somebody else's"
        );
    }
    // A material is as much of the scene as the mesh.
    let material = folder.path().join("mesh.mtl");
    let text_of = std::fs::read_to_string(&material).unwrap();
    write(&material, format!("{text_of}# another one\n"));
    let output = generate(folder.path(), &own);
    assert_eq!(output.status.code(), Some(2));
    let said = stderr(&output);
    assert!(said.contains("already exists; give --force"), "{said}");
    succeed(folder.path(), &[&own[..], &["--force"]].concat());
}

#[test]
fn a_set_is_not_made_of_its_own_files() {
    let folder = tempfile::tempdir().unwrap();
    let extras = ["--extras", "input-images"];
    succeed(folder.path(), &extras);
    let scene = scene_of(&folder.path().join("dataset"));
    for photographs in ["input_images", "blended_images"] {
        let photographs = scene.path().join(photographs);
        let before = files_in(&photographs);
        assert!(!before.is_empty());
        let own = [&extras[..], &["--photos", text(&photographs), "--force"]].concat();
        let output = generate(folder.path(), &own);
        assert_eq!(output.status.code(), Some(2));
        let said = stderr(&output);
        assert!(said.contains("give another --out"), "{said}");
        assert!(files_in(&photographs) == before);
    }
    assert!(scene.path().join("run.toml").exists());
}

#[test]
fn bare_options_may_have_a_table_of_that_name() {
    let folder = tempfile::tempdir().unwrap();
    let config = folder.path().join("options.toml");
    write(&config, "[options]\njpeg_quality = 80\n");
    let more = [
        "--config",
        text(&config),
        "--range-margin",
        "0.25",
        "--export-pixel-center",
        "integer",
    ];
    succeed(folder.path(), &more);
    let scene = scene_of(&folder.path().join("dataset"));
    let record = std::fs::read_to_string(scene.record()).unwrap();
    let record: serde_json::Value = serde_json::from_str(&record).unwrap();
    let option = |name: &str| record["options"][name].clone();
    assert_eq!(option("jpeg_quality"), 80);
    assert_eq!(option("range_margin"), 0.25);
    assert_eq!(option("pixel_centre"), "integer");
    assert_eq!(record["pixel_centre"], "integer");
    // Its run.toml is a configuration too.
    let run = scene.path().join("run.toml");
    succeed(folder.path(), &["--config", text(&run), "--out", "second"]);
    let second = scene_of(&folder.path().join("second"));
    assert_eq!(
        std::fs::read(second.record()).unwrap(),
        std::fs::read(scene.record()).unwrap()
    );
}

#[test]
fn a_set_that_is_being_replaced_does_not_look_finished() {
    let folder = tempfile::tempdir().unwrap();
    succeed(folder.path(), &["--name", "first"]);
    succeed(folder.path(), &["--name", "second", "--validation"]);
    let root = folder.path().join("dataset");
    let first = BlendedFolder::new(root.join(scene_id("first")));
    let shard = ["--name", "first", "--range", "full", "--force"];
    succeed(folder.path(), &[&shard[..], &["--shard", "1/2"]].concat());
    assert!(!first.record().exists() && !first.path().join("run.toml").exists());
    assert!(first.path().join(blended::UNFINISHED).is_file());
    let output = mvs_eval(&["verify", text(first.path()), "--format", "json"]);
    assert_eq!(output.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&output.stdout).contains("\"unfinished\""));
    // Another scene that ends meanwhile lists what is finished.
    succeed(folder.path(), &["--name", "second", "--validation"]);
    let list = |name: &str| std::fs::read_to_string(root.join(name)).unwrap();
    assert_eq!(list("all_list.txt"), scene_id("second") + "\n");
    succeed(folder.path(), &[&shard[..4], &["--shard", "2/2"]].concat());
    succeed(folder.path(), &[&shard[..4], &["--merge"]].concat());
    assert_eq!(list("all_list.txt").lines().count(), 2);
    assert_eq!(list("training_list.txt"), scene_id("first") + "\n");
    assert_eq!(list("validation_list.txt"), scene_id("second") + "\n");
    assert!(first.record().is_file());
    // A root is all that is in it, and all that its lists name.
    std::fs::remove_file(first.pairs()).unwrap();
    let gone = "0123456789abcdef01234567";
    write(&root.join("all_list.txt"), format!("{gone}\n"));
    let output = mvs_eval(&["verify", text(&root), "--format", "json"]);
    assert_eq!(output.status.code(), Some(1));
    let answer: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let found = answer["scenes"].as_array().unwrap().iter().map(|scene| {
        let codes = scene[1]["findings"].as_array().unwrap().iter();
        let codes: Vec<&str> = codes.map(|f| f["code"].as_str().unwrap()).collect();
        (scene[0].as_str().unwrap(), codes.join(" "))
    });
    let found: BTreeMap<&str, String> = found.collect();
    assert_eq!(found.len(), 3);
    assert_eq!(found[gone], "missing-scene");
    assert!(found[&scene_id("first")[..]].contains("missing-pairs"));
    assert_eq!(found[&scene_id("second")[..]], "");
}

#[test]
fn two_sets_from_one_run_are_sound_and_differ_in_scale_only() {
    let folder = tempfile::tempdir().unwrap();
    let sizes = ["--size", "128x96", "--size", "64x48", "--extras", "masks"];
    succeed(folder.path(), &sizes);
    let root = |size: &str| folder.path().join("dataset").join(size);
    let (high, low) = (scene_of(&root("128x96")), scene_of(&root("64x48")));
    let scenes = [&high, &low].map(|set| set.read_scene(None).unwrap());
    assert_eq!(scenes[0].views().len(), VIEWS as usize);
    for (index, (large, small)) in scenes[0].views().iter().zip(scenes[1].views()).enumerate() {
        assert_eq!((large.id, large.pose), (small.id, small.pose));
        assert_eq!(large.camera.resized(64, 48).unwrap(), small.camera);
        assert_eq!(scenes[0].sources_of(index), scenes[1].sources_of(index));
        // Rendered there: what a rendering through the small camera gives, to the last bit.
        let mesh = synthetic();
        let renderer = Renderer::new(mesh.mesh()).unwrap();
        let draft = RenderOptions {
            samples: 1,
            ..RenderOptions::default()
        };
        let expected = renderer.render(small, &draft).unwrap().depth;
        assert_eq!(low.read_depth(small.id).unwrap().0, expected);
    }
    for size in ["128x96", "64x48"] {
        let list = std::fs::read_to_string(root(size).join("BlendedMVS_training.txt")).unwrap();
        assert_eq!(list, scene_id("small") + "\n");
        let verified = mvs_eval(&["verify", text(&root(size)), "--format", "table"]);
        assert_eq!(verified.status.code(), Some(0), "{}", stderr(&verified));
        let said = String::from_utf8_lossy(&verified.stdout).into_owned();
        assert!(said.contains("nothing wrong was found; depths"), "{said}");
    }
}

#[test]
fn shards_and_their_merge_are_the_whole() {
    let (whole, shards) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    succeed(whole.path(), &["--extras", "occlusion"]);
    let merge = ["--extras", "occlusion", "--merge"];
    succeed(shards.path(), &["--extras", "occlusion", "--shard", "2/3"]);
    let scene = shards.path().join("dataset").join(scene_id("small"));
    assert!(scene.join("views/00000001.json").is_file());
    assert!(!scene.join("views/00000000.json").exists() && !scene.join("scene.json").exists());
    let early = generate(shards.path(), &merge);
    assert_eq!(early.status.code(), Some(2));
    let said = stderr(&early);
    assert!(said.contains("4 of 6") && said.contains("view 0"), "{said}");
    // The other two at the same time.
    let others = ["1/3", "3/3"].map(|shard| {
        let more = ["--extras", "occlusion", "--shard", shard];
        let mut command = command(shards.path(), &more);
        command
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .unwrap()
    });
    for mut other in others {
        assert!(other.wait().unwrap().success());
    }
    succeed(shards.path(), &merge);
    assert_eq!(files_in(whole.path()), files_in(shards.path()));
    // A shard that is made once more, when all is there, has nothing to do and leaves the scene whole.
    for shard in ["2/3", "7/9"] {
        succeed(shards.path(), &["--extras", "occlusion", "--shard", shard]);
        assert_eq!(files_in(whole.path()), files_in(shards.path()), "{shard}");
    }
    // Where one of its views is damaged it makes that one, and the scene is to be put together again.
    let damaged = scene.join("cams/00000001_cam.txt");
    std::fs::remove_file(&damaged).unwrap();
    succeed(shards.path(), &["--extras", "occlusion", "--shard", "2/3"]);
    assert!(damaged.is_file() && !scene.join("scene.json").exists());
    succeed(shards.path(), &merge);
    assert_eq!(files_in(whole.path()), files_in(shards.path()));
    let wrong = generate(shards.path(), &["--shard", "4/3"]);
    assert_eq!(wrong.status.code(), Some(2));
}

/// Every way to fail before anything is written, with leave to replace.
#[test]
fn a_failing_run_leaves_a_finished_set_as_it_was() {
    let folder = tempfile::tempdir().unwrap();
    succeed(folder.path(), &[]);
    let before = files_in(folder.path());
    let behind = folder.path().join("behind.obj");
    write(&behind, "v 0 0 900\nv 1 0 900\nv 0 1 900\nf 1 2 3\n");
    let unseen = ["--force", "--mesh", text(&behind)];
    for more in [
        &["--force", "--jpeg-quality", "0"][..],
        &["--force", "--samples", "3"],
        &["--force", "--range-margin=-1"],
        &["--force", "--merge", "--jpeg-quality", "50"],
        &unseen,
    ] {
        let output = generate(folder.path(), more);
        assert_eq!(
            output.status.code(),
            Some(2),
            "{more:?} {}",
            stderr(&output)
        );
        let mut after = files_in(folder.path());
        after.remove(Path::new("behind.obj"));
        assert_eq!(
            after.keys().collect::<Vec<_>>(),
            before.keys().collect::<Vec<_>>(),
            "{more:?}"
        );
        assert!(after == before, "{more:?}");
    }
    let output = generate(
        folder.path(),
        &["--jpeg-quality", "50", "--mesh", "nowhere.obj"],
    );
    let said = stderr(&output);
    assert!(
        said.contains("already exists"),
        "before anything is read: {said}"
    );
}

#[test]
fn a_manifest_goes_on_after_a_scene_that_fails() {
    let folder = tempfile::tempdir().unwrap();
    let input = |name: &str| inputs().join(name).display().to_string();
    let (mesh, cams, photos) = (input("mesh.obj"), input("cams"), input("photos"));
    let doubtful = folder.path().join("doubtful");
    std::fs::create_dir(&doubtful).unwrap();
    for photo in std::fs::read_dir(&photos).unwrap() {
        let photo = photo.unwrap().path();
        std::fs::copy(&photo, doubtful.join(photo.file_name().unwrap())).unwrap();
        let stem = photo.file_stem().unwrap().to_str().unwrap();
        for ending in ["png", "jpg"].iter().filter(|_| stem.ends_with('1')) {
            std::fs::copy(&photo, doubtful.join(format!("{stem}.{ending}"))).unwrap();
        }
    }
    let manifest = format!(
        "[defaults]\nout = \"dataset\"\nmesh = [\"{mesh}\"]\ncameras = \"{cams}\"\n\
         options.render.samples = 16\n\
         [[scene]]\nname = \"first\"\nphotos = \"{photos}\"\n\
         [[scene]]\nname = \"broken\"\nphotos = \"nowhere\"\n\
         [[scene]]\nname = \"misspelt\"\nphoto = \"{photos}\"\n\
         [[scene]]\nname = \"first\"\nphotos = \"{photos}\"\n\
         [[scene]]\nname = \"last\"\nphotos = \"doubtful\"\nvalidation = true\n\
         [[scene]]\nname = \"both\"\nphotos = \"{photos}\"\nsizes = [\"64x48\"]\noptions.size = [96, 72]\n"
    );
    let path = folder.path().join("scenes.toml");
    write(&path, manifest);
    let output = mvs_eval(&["generate", "--manifest", text(&path), "--samples", "1"]);
    assert_eq!(output.status.code(), Some(1), "{}", stderr(&output));
    let answer: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let status = |place: usize| answer["scenes"][place]["status"].as_str().unwrap();
    assert_eq!((status(0), status(4)), ("ok", "ok"));
    assert!(status(1).contains("nowhere"), "{}", status(1));
    assert!(status(2).contains("unknown field `photo`"), "{}", status(2));
    assert!(status(3).contains("twice"), "{}", status(3));
    assert!(
        status(5).contains("found both (64x48, 96x72)"),
        "{}",
        status(5)
    );
    assert_eq!(answer["failed"], 4);
    let said = stderr(&output);
    assert!(
        said.contains("[photograph-doubtful]: last: 1 views"),
        "{said}"
    );
    let root = folder.path().join("dataset");
    let list = |name: &str| std::fs::read_to_string(root.join(name)).unwrap();
    assert_eq!(list("validation_list.txt"), scene_id("last") + "\n");
    assert_eq!(list("training_list.txt"), scene_id("first") + "\n");
    assert_eq!(list("all_list.txt").lines().count(), 2);
    let record = std::fs::read_to_string(root.join(scene_id("last")).join("scene.json")).unwrap();
    let record: serde_json::Value = serde_json::from_str(&record).unwrap();
    assert_eq!(record["options"]["render"]["samples"], 1, "flags win");
    assert_eq!(
        record["warnings"],
        serde_json::json!([]),
        "of this scene only"
    );
}

#[test]
fn exports_beside_the_scene_are_its_cameras() {
    let folder = tempfile::tempdir().unwrap();
    let centre = ["--extras", "transforms,colmap"];
    succeed(folder.path(), &centre);
    let scene = scene_of(&folder.path().join("dataset"));
    let cams = scene.read_scene(None).unwrap();
    for path in [scene.transforms(), scene.colmap()] {
        let read = read_scene(&path, &CamerasOptions::default()).unwrap().scene;
        assert_eq!(read.views().len(), cams.views().len());
        for (a, b) in read.views().iter().zip(cams.views()) {
            assert_eq!(a.id, b.id);
            let numbers = |view: &View| {
                let (camera, pose) = (&view.camera, view.pose.matrix().to_cols_array());
                let mut numbers = camera.focal().to_array().to_vec();
                numbers.extend(camera.center().to_array());
                numbers.extend(pose);
                numbers
            };
            for (a, b) in numbers(a).into_iter().zip(numbers(b)) {
                assert!((a - b).abs() <= 1e-12 * b.abs().max(1.0), "{a} {b}");
            }
            assert!(scene.path().join(&a.name).is_file() || scene.image(a.id).is_file());
        }
    }
    // What cannot be verified leaves no folder.
    let out = folder.path().join("verified");
    let few = mvs_eval(&[
        "verify",
        text(scene.path()),
        "--points",
        "199",
        "--out",
        text(&out),
    ]);
    assert_eq!(few.status.code(), Some(2));
    assert!(stderr(&few).contains("expected at least 200, found 199"));
    assert!(!out.exists());
}
