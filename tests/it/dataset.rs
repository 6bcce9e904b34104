//! `mvs-eval generate` on files: sets of two sizes, shards, manifests, exports, and being killed.

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
        let verified = mvs_eval(&["verify", text(&root(size))]);
        assert_eq!(verified.status.code(), Some(0), "{}", stderr(&verified));
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
    let wrong = generate(shards.path(), &["--shard", "4/3"]);
    assert_eq!(wrong.status.code(), Some(2));
}

#[test]
fn a_manifest_goes_on_after_a_scene_that_fails() {
    let folder = tempfile::tempdir().unwrap();
    let input = |name: &str| inputs().join(name).display().to_string();
    let (mesh, cams, photos) = (input("mesh.obj"), input("cams"), input("photos"));
    let manifest = format!(
        "[defaults]\nout = \"dataset\"\nmesh = [\"{mesh}\"]\ncameras = \"{cams}\"\n\
         options.render.samples = 16\n\
         [[scene]]\nname = \"first\"\nphotos = \"{photos}\"\n\
         [[scene]]\nname = \"broken\"\nphotos = \"nowhere\"\n\
         [[scene]]\nname = \"misspelt\"\nphoto = \"{photos}\"\n\
         [[scene]]\nname = \"first\"\nphotos = \"{photos}\"\n\
         [[scene]]\nname = \"last\"\nphotos = \"{photos}\"\nvalidation = true\n"
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
    assert_eq!(answer["failed"], 3);
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
}

/// What a camera behind a lens takes of a large picture that the pinhole camera would take.
fn bent_photograph(large: &ColorImage, pinhole: &View, bent: &View) -> ColorImage {
    let (width, height) = (bent.camera.width(), bent.camera.height());
    let scale = f64::from(large.width()) / f64::from(width);
    let mut photograph = ColorImage::filled(width, height, [0; 3]).unwrap();
    for row in 0..height {
        for column in 0..width {
            let centre = DVec2::new(f64::from(column) + 0.5, f64::from(row) + 0.5);
            let ray = bent.camera.ray(centre);
            let at = scale * pinhole.camera.project(ray).unwrap();
            // The mean of a pixel's worth of the large picture.
            let reach = 0.5 * scale;
            let span = |at: f64, length: u32| {
                let first = (at - reach).round().clamp(0.0, f64::from(length - 1)) as u32;
                let end = (at + reach).round().clamp(0.0, f64::from(length)) as u32;
                first..end.max(first + 1)
            };
            let mut sums = [0u32; 4];
            for y in span(at.y, large.height()) {
                for x in span(at.x, large.width()) {
                    let pixel = large.get(x, y).map(u32::from);
                    for (sum, value) in sums.iter_mut().zip([pixel[0], pixel[1], pixel[2], 1]) {
                        *sum += value;
                    }
                }
            }
            let mean = [0, 1, 2].map(|channel| (sums[channel] / sums[3]) as u8);
            photograph.set(column, row, mean);
        }
    }
    photograph
}

/// The photographs' lens is undone: the data set's cameras are pinhole ones, and what is blended is
/// what a pinhole camera would have taken. The lens is strong enough that leaving it, or doing it once
/// more, would show. Compared is luminance, which the JPEG keeps at full resolution.
#[test]
fn photographs_through_a_lens_are_undistorted() {
    let folder = tempfile::tempdir().unwrap();
    let lens = |sign: f64| Distortion::RadialTangential {
        radial: [-0.35 * sign, 0.1, 0.0, 0.0, 0.0, 0.0],
        tangential: [3e-3 * sign, 0.0],
    };
    let truth = synthetic();
    let renderer = Renderer::new(truth.mesh()).unwrap();
    let through = |lens: Distortion| {
        let bend = |view: &View| View {
            camera: view.camera.with_distortion(lens).unwrap(),
            ..view.clone()
        };
        Scene::new(truth.scene().views().iter().map(bend).collect()).unwrap()
    };
    let bent = through(lens(1.0));
    let photos = folder.path().join("photos");
    let mut straight = Vec::new();
    for (view, bent) in truth.scene().views().iter().zip(bent.views()) {
        let render = |view: &View| renderer.render(view, &RenderOptions::default()).unwrap();
        let large = render(&View {
            camera: view.camera.resized(8 * 128, 8 * 96).unwrap(),
            ..view.clone()
        });
        straight.push(render(view).color);
        let photograph = bent_photograph(&large.color, view, bent);
        let path = photos.join(mvsnet::file_name(view.id, ".png"));
        files::write_atomically(&path, |out| image::write_png(out, &photograph)).unwrap();
    }
    // With the cameras as they are, with their lenses forgotten, and with them the wrong way around.
    let mut off = Vec::new();
    for (name, cameras) in [
        ("undone", &bent),
        ("left", truth.scene()),
        ("doubled", &through(lens(-1.0))),
    ] {
        let (model, out) = (folder.path().join(name), format!("{name}-set"));
        exports::write_colmap(&model, cameras).unwrap();
        let more = ["--cameras", text(&model), "--photos", text(&photos)];
        let extras = ["--extras", "input-images", "--out", &out];
        succeed(folder.path(), &[more, extras].concat());
        let scene = scene_of(&folder.path().join(&out));
        let views = scene.read_scene(None).unwrap();
        for (cam, view) in views.views().iter().zip(truth.scene().views()) {
            assert_eq!(cam.camera, view.camera);
        }
        let differences = views.views().iter().zip(&straight).map(|(view, straight)| {
            let used = files::read_image(&scene.input_image(view.id)).unwrap();
            luminance_difference(&used, straight)
        });
        off.push(differences.fold(0.0, f64::max));
    }
    let [undone, left, doubled] = off[..] else {
        panic!("three ways");
    };
    assert!(undone < 2.0, "{undone} grey levels");
    assert!(
        left > 2.0 * undone && doubled > 3.0 * undone,
        "{undone} {left} {doubled}"
    );
}

/// The mean absolute difference in grey levels.
fn luminance_difference(a: &ColorImage, b: &ColorImage) -> f64 {
    let luminance =
        |[r, g, b]: [u8; 3]| 0.299 * f64::from(r) + 0.587 * f64::from(g) + 0.114 * f64::from(b);
    let pairs = a.values().iter().zip(b.values());
    let sum: f64 = pairs
        .map(|(&a, &b)| (luminance(a) - luminance(b)).abs())
        .sum();
    sum / a.values().len() as f64
}

/// A COLMAP model of the synthetic scene with points, of which each view saw every third that the
/// surface does not hide from it.
fn model_with_points(folder: &Path) {
    let truth = synthetic();
    exports::write_colmap(folder, truth.scene()).unwrap();
    let renderer = Renderer::new(truth.mesh()).unwrap();
    let vertices = truth.mesh().vertices();
    let chosen: Vec<usize> = (0..vertices.len())
        .step_by(vertices.len() / 600 + 1)
        .collect();
    let mut seen = vec![String::new(); truth.scene().views().len()];
    let mut points = String::new();
    for (id, &vertex) in (1..).zip(&chosen) {
        let at = vertices[vertex];
        points += &format!("{id} {} {} {} 9 9 9 0.5 1 0\n", at.x, at.y, at.z);
        for (index, view) in truth.scene().views().iter().enumerate() {
            let center = view.pose.center_in_world();
            let hidden = renderer
                .first_hit(center, at - center, (0.0, 0.999))
                .is_some();
            if let Some(pixel) = view.camera.project(view.pose.to_cam(at))
                && (id + index) % 3 == 0
                && !hidden
                && pixel.cmpge(DVec2::ZERO).all()
                && pixel.cmplt(DVec2::new(128.0, 96.0)).all()
            {
                seen[index] += &format!("{} {} {id} ", pixel.x, pixel.y);
            }
        }
    }
    write(&folder.join("points3D.txt"), &points);
    let images = files::read_text(&folder.join("images.txt")).unwrap();
    let images = images
        .lines()
        .filter(|line| !line.starts_with('#') && !line.is_empty());
    let images: String = images
        .zip(seen)
        .map(|(image, seen)| format!("{image}\n{seen}\n"))
        .collect();
    write(&folder.join("images.txt"), &images);
}

#[test]
fn source_views_come_from_the_mesh_or_from_a_sparse_model() {
    let folder = tempfile::tempdir().unwrap();
    let model = folder.path().join("model");
    model_with_points(&model);
    let alone = folder.path().join("pair.txt");
    let output = mvs_eval(&["pairs", "--cameras", text(&model), "--out", text(&alone)]);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    let with = |more: &[&str]| {
        let cameras = ["--cameras", text(&model), "--force"];
        succeed(folder.path(), &[&cameras[..], more].concat());
        let scene = scene_of(&folder.path().join("dataset"));
        (
            files::read_text(&scene.pairs()).unwrap(),
            std::fs::read(scene.covisibility()).ok(),
        )
    };
    let (exact, table) = with(&["--pairs", "exact", "--extras", "covisibility"]);
    let (colmap, same) = with(&["--pairs", "colmap", "--extras", "covisibility"]);
    assert_eq!(colmap, files::read_text(&alone).unwrap());
    assert_ne!(exact, colmap);
    assert!(table.is_some() && table == same, "the table is the mesh's");
    // What is no longer asked for goes.
    assert_eq!(with(&["--pairs", "colmap"]), (colmap, None));
    // Cams beside the model are taken as the cameras, numbered otherwise.
    let both = folder.path().join("both");
    for (name, bytes) in files_in(&model) {
        write(&both.join("sparse").join(name), bytes);
    }
    for (name, bytes) in files_in(&inputs().join("cams")) {
        write(&both.join("cams").join(name), bytes);
    }
    let more = [
        "--cameras",
        text(&both),
        "--pairs",
        "colmap",
        "--out",
        "mixed",
    ];
    let output = generate(folder.path(), &more);
    assert_eq!(output.status.code(), Some(2));
    let said = stderr(&output);
    assert!(
        said.contains("of a COLMAP model") && said.contains("Cams"),
        "{said}"
    );
    // Without points there is nothing to choose by.
    exports::write_colmap(&model, synthetic().scene()).unwrap();
    let more = [
        "--cameras",
        text(&model),
        "--pairs",
        "colmap",
        "--out",
        "other",
    ];
    let output = generate(folder.path(), &more);
    assert_eq!(output.status.code(), Some(2));
    assert!(stderr(&output).contains("points3D"), "{}", stderr(&output));
}

/// Of the pixels that the occlusion masks of a scene on disk call visible: how many there are, and
/// how many of them, carried into the source by depth and cams, lie on the source's first surface to
/// 1e-4 of their depth.
fn reprojected(scene: &BlendedFolder, mesh: &Mesh) -> (usize, usize) {
    let renderer = Renderer::new(mesh).unwrap();
    let cams = scene.read_scene(None).unwrap();
    let (mut visible, mut agree) = (0, 0);
    for (index, view) in cams.views().iter().enumerate() {
        let (depth, _) = scene.read_depth(view.id).unwrap();
        for source in cams.sources_of(index) {
            let bytes = std::fs::read(scene.occlusion(view.id, source.id)).unwrap();
            let mask = image::read_gray(&bytes).unwrap();
            let source = &cams.views()[cams.index_of(source.id).unwrap()];
            for (i, _) in (0u32..).zip(mask.values()).filter(|(_, seen)| **seen > 200) {
                let (column, row) = (i % depth.width(), i / depth.width());
                let pixel = DVec2::new(f64::from(column) + 0.5, f64::from(row) + 0.5);
                let z = f64::from(depth.get(column, row));
                let in_source = source
                    .pose
                    .to_cam(view.pose.to_world(z * view.camera.ray(pixel)));
                let at = source.camera.project(in_source).unwrap();
                let direction = source.pose.direction_to_world(source.camera.ray(at));
                let eye = source.pose.center_in_world();
                let hit = renderer.first_hit(eye, direction, (0.0, f64::INFINITY));
                visible += 1;
                let there = hit.map_or(f64::INFINITY, |hit| hit.distance);
                agree += usize::from((in_source.z / there - 1.0).abs() <= 1e-4);
            }
        }
    }
    (visible, agree)
}

#[test]
fn what_a_mask_calls_visible_lies_on_the_source_s_surface() {
    let folder = tempfile::tempdir().unwrap();
    succeed(folder.path(), &["--extras", "occlusion"]);
    let scene = scene_of(&folder.path().join("dataset"));
    let (visible, agree) = reprojected(&scene, synthetic().mesh());
    assert!(visible > 20_000, "{visible}");
    assert!(
        agree as f64 >= 0.999 * visible as f64,
        "{agree} of {visible}"
    );
}

#[test]
fn what_a_mask_calls_visible_on_a_real_scene_lies_on_the_source_s_surface() {
    let Some(data) = real_data("scene_saharov") else {
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let part = |name: &str| text(&data.join(name)).to_owned();
    let (mesh, cams, photos) = (part("model"), part("cams"), part("images"));
    let given = ["--mesh", &mesh, "--cameras", &cams, "--photos", &photos];
    let more = [
        "--pixel-center",
        "integer",
        "--size",
        "400x300",
        "--extras",
        "occlusion",
    ];
    succeed(folder.path(), &[&given[..], &more].concat());
    let scene = scene_of(&folder.path().join("dataset"));
    let mesh = mvs_datasets::layout::mesh::read_meshes(&[data.join("model")])
        .unwrap()
        .mesh;
    let (visible, agree) = reprojected(&scene, &mesh);
    assert!(visible > 1_000_000, "{visible}");
    assert!(
        agree as f64 >= 0.999 * visible as f64,
        "{agree} of {visible}"
    );
    let verified = mvs_eval(&["verify", text(scene.path())]);
    assert_eq!(verified.status.code(), Some(0), "{}", stderr(&verified));
}
