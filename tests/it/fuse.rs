//! The file job on the synthetic scene: streaming, determinism, report, refusals.

mod among;
mod flags;
mod maps;
mod places;
mod real;
mod sweep;

use glam::DVec3;
use mvs_datasets::format::colmap::dense;
use mvs_datasets::format::{image, pfm};
use mvs_datasets::layout::workspace::StereoPass;
use mvs_datasets::layout::{files, mvsnet};
use mvs_datasets::scene::{ColorImage, DepthMap, DepthRange, PointCloud, Raster, View};
use mvs_datasets::synthetic::{DepthNoise, SyntheticOptions, SyntheticScene};
use mvs_eval::fuse::{FuseMode, FuseOptions, Sampling, Visibility};
use mvs_eval::jobs::Context;
use mvs_eval::jobs::fuse::sweep::{self as sweep_job, SweepJob};
use mvs_eval::jobs::fuse::{Coordinates, FuseJob, FuseOutcome, Properties, check_used, run};
use mvs_eval::parallel::with_threads;
use mvs_eval::progress::Silent;
use mvs_eval::provenance::Run;
use mvs_eval::score::FinitePoints;
use mvs_eval::score::plain::{Preparation, evaluate};
use mvs_eval::warning::{Warning, Warnings};
use std::io::Write;
use std::path::Path;

fn scene() -> SyntheticScene {
    let options = SyntheticOptions {
        views: 12,
        width: 160,
        height: 120,
        ..SyntheticOptions::default()
    };
    SyntheticScene::new(options).unwrap()
}

/// Writes cams, pairs, grey images and depth maps; `noise` or the exact depth.
fn write_scene(scene: &SyntheticScene, noise: Option<&DepthNoise>, folder: &Path) -> FuseJob {
    let views = scene.scene().views();
    mvsnet::write_pairs(&folder.join("cams/pair.txt"), scene.scene()).unwrap();
    for (index, view) in views.iter().enumerate() {
        let name = |suffix| mvsnet::file_name(view.id, suffix);
        let cam = folder.join("cams").join(name("_cam.txt"));
        mvsnet::write_view(&cam, view, mvsnet::PixelCentre::Half).unwrap();
        let grey = ColorImage::filled(160, 120, [90, 100, 110]).unwrap();
        files::write_atomically(&folder.join("images").join(name(".png")), |out| {
            image::write_png(out, &grey)
        })
        .unwrap();
        let raster = |folder_name: &str, values: &mvs_datasets::scene::Raster<f32>| {
            files::write_atomically(&folder.join(folder_name).join(name(".pfm")), |out| {
                pfm::write_gray(out, values)
            })
            .unwrap();
        };
        match noise {
            Some(noise) => {
                let (depth, confidence) = scene.estimated_depth(index, noise);
                raster("depths", depth.raster());
                raster("confidence", &confidence);
            }
            None => raster("depths", scene.depth(index).raster()),
        }
    }
    FuseJob {
        scene: folder.to_path_buf(),
        depths: folder.join("depths"),
        confidence: noise.iter().map(|_| folder.join("confidence")).collect(),
        out: folder.join("cloud.ply"),
        ..FuseJob::default()
    }
}

fn fuse(job: &FuseJob, force: bool) -> mvs_eval::Result<FuseOutcome> {
    fuse_and_hear(job, force).0
}

/// What comes of a job, and what it warns of.
fn fuse_and_hear(job: &FuseJob, force: bool) -> (mvs_eval::Result<FuseOutcome>, Vec<Warning>) {
    let warnings = Warnings::default();
    let context = Context {
        progress: &Silent,
        warnings: &warnings,
        force,
    };
    let outcome = run(job, &context);
    (outcome, warnings.sorted())
}

/// The header of a PLY, and some bytes more.
fn header(path: &Path) -> String {
    let bytes = std::fs::read(path).unwrap();
    String::from_utf8_lossy(&bytes[..2500.min(bytes.len())]).into_owned()
}

/// Changes the map of a view in `folder`.
fn change_map(folder: &Path, id: u32, change: impl Fn(usize, f32) -> f32) {
    let path = folder.join(mvsnet::file_name(id, ".pfm"));
    let mut map = files::read_raster(&path).unwrap();
    for (at, value) in map.values_mut().iter_mut().enumerate() {
        *value = change(at, *value);
    }
    files::write_atomically(&path, |out| pfm::write_gray(out, &map)).unwrap();
}

fn median_distance(scene: &SyntheticScene, points: &[DVec3]) -> f64 {
    let distances = points.iter().map(|&point| scene.distance_to_surface(point));
    let mut distances: Vec<f64> = distances.collect();
    distances.sort_by(f64::total_cmp);
    distances[distances.len() / 2]
}

/// Fuses at several numbers of threads, with all maps in memory and with as few as can be.
fn same_bytes(job: &mut FuseJob, mode: FuseMode) {
    job.fuse = FuseOptions::of(mode);
    let mut first: Option<Vec<u8>> = None;
    for (threads, memory) in [(1, None), (2, Some(0)), (8, None), (8, Some(1))] {
        job.memory = memory;
        let outcome = with_threads(threads, || fuse(job, true)).unwrap().unwrap();
        let bytes = std::fs::read(&job.out).unwrap();
        assert_eq!(outcome.counts.fused, outcome.points as u64);
        assert_eq!(outcome.counts.accounted(), outcome.counts.pixels);
        assert_eq!(
            first.get_or_insert_with(|| bytes.clone()),
            &bytes,
            "{mode:?} {threads} {memory:?}"
        );
    }
}

#[test]
fn noisy_maps_fuse_to_the_same_bytes_at_any_number_of_threads_and_budget() {
    let scene = scene();
    let folder = tempfile::tempdir().unwrap();
    let mut job = write_scene(&scene, Some(&DepthNoise::default()), folder.path());
    same_bytes(&mut job, FuseMode::Cluster);
    same_bytes(&mut job, FuseMode::Hkust);
    let cloud = files::read_cloud(&job.out).unwrap();
    assert!(cloud.len() > 20_000, "{}", cloud.len());
    assert!(
        cloud
            .colors()
            .unwrap()
            .iter()
            .all(|&color| color == [90, 100, 110])
    );
    assert!(cloud.normals().is_some() && cloud.confidences().is_some());
    assert!(cloud.view_counts().unwrap().iter().all(|&views| views >= 3));
    let header = header(&job.out);
    assert!(header.contains("comment max_pixel_error = 1.0"), "{header}");
    let report = files::read_text(&folder.path().join("cloud.json")).unwrap();
    assert!(report.contains("\"unconfident\"") && report.contains("\"mode\": \"hkust\""));
}

#[test]
fn exact_maps_fuse_onto_the_surface_in_every_mode() {
    let scene = scene();
    let folder = tempfile::tempdir().unwrap();
    let mut job = write_scene(&scene, None, folder.path());
    for mode in FuseMode::ALL {
        job.fuse = FuseOptions::of(mode);
        let outcome = fuse(&job, true).unwrap();
        let cloud = files::read_cloud(&job.out).unwrap();
        assert_eq!(cloud.len(), outcome.points);
        let median = median_distance(&scene, cloud.positions());
        // `gipuma` samples whole pixels, `cluster` takes medians over a few.
        let bound = match mode {
            FuseMode::Gipuma | FuseMode::Cluster => 5e-3,
            _ => 2e-4,
        };
        assert!(median < bound, "{mode:?} {median:e}");
    }
}

#[test]
fn merrells_rules_run_on_the_noisy_scene() {
    let scene = scene();
    let folder = tempfile::tempdir().unwrap();
    let mut job = write_scene(&scene, Some(&DepthNoise::default()), folder.path());
    fuse(&job, true).unwrap();
    let median = files::read_cloud(&job.out).unwrap();
    for visibility in [Visibility::MerrellConfidence, Visibility::MerrellStability] {
        job.fuse.visibility = visibility;
        let outcome = fuse(&job, true).unwrap();
        let cloud = files::read_cloud(&job.out).unwrap();
        assert!(
            outcome.counts.filled > 0 && cloud.len() > median.len() / 2,
            "{visibility:?}"
        );
        // What was filled in at pixels of too little confidence has none of theirs.
        let confidences = cloud.confidences().unwrap();
        let own = |confidence: &&f32| f64::from(**confidence) > job.fuse.min_confidence;
        let none = confidences.iter().filter(|&&confidence| confidence == 0.0);
        let none = none.count();
        assert!(none > 0, "{visibility:?}");
        assert_eq!(confidences.iter().filter(own).count() + none, cloud.len());
        let error = median_distance(&scene, cloud.positions());
        let bound = 2.0 * median_distance(&scene, median.positions());
        assert!(error < bound, "{visibility:?} {error:e} {bound:e}");
    }
}

#[test]
fn refusals_are_one_sentence_and_leave_nothing_behind() {
    let scene = scene();
    let folder = tempfile::tempdir().unwrap();
    let mut job = write_scene(&scene, Some(&DepthNoise::default()), folder.path());
    job.fuse.min_confidence = 2.0;
    let message = fuse(&job, false).unwrap_err().to_string();
    assert!(message.contains("of too little confidence"), "{message}");
    assert!(!job.out.exists());
    let leftover = |entry: &std::fs::DirEntry| entry.file_name().to_string_lossy().starts_with('.');
    let entries = std::fs::read_dir(folder.path())
        .unwrap()
        .map(Result::unwrap);
    assert_eq!(entries.filter(leftover).count(), 0);
    job.fuse.min_confidence = 0.5;
    fuse(&job, false).unwrap();
    let message = fuse(&job, false).unwrap_err().to_string();
    assert!(message.contains("--force"), "{message}");
    job.fuse.max_depth_error = -1.0;
    let message = fuse(&job, true).unwrap_err().to_string();
    assert!(message.contains("max_depth_error"), "{message}");
}

/// What COLMAP's stereo would leave behind: `write_scene`'s scene as a dense workspace, the depth maps
/// with half the images' pixels.
fn write_workspace(scene: &SyntheticScene, folder: &Path) -> FuseJob {
    let views = scene.scene().views();
    let name = |id: u32| format!("photo_{}.png", 90 - id); // in the opposite order of ids
    let stereo = folder.join("stereo");
    let text = |path: &str, text: &str| {
        files::write_atomically(&folder.join(path), |out| out.write_all(text.as_bytes())).unwrap();
    };
    let (mut cameras, mut images) = (String::new(), String::new());
    let points: Vec<DVec3> = visible_points(scene);
    for (index, view) in views.iter().enumerate() {
        let (focal, center) = (view.camera.focal(), view.camera.center());
        let id = 7 * index + 3;
        cameras += &format!(
            "{id} PINHOLE 160 120 {} {} {} {}\n",
            focal.x, focal.y, center.x, center.y
        );
        let turn = glam::DQuat::from_mat3(&view.pose.rotation());
        let move_by = view.pose.to_cam(DVec3::ZERO);
        images += &format!(
            "{id} {} {} {} {} {} {} {} {id} {}\n",
            turn.w,
            turn.x,
            turn.y,
            turn.z,
            move_by.x,
            move_by.y,
            move_by.z,
            name(view.id)
        );
        let seen = |point: &DVec3| {
            let pixel = view.camera.project(view.pose.to_cam(*point));
            pixel.is_some_and(|pixel| view.camera.contains(pixel))
        };
        let seen = (0..points.len()).filter(|&at| seen(&points[at]));
        images += &(seen
            .map(|at| format!("1 2 {} ", 5 * at))
            .collect::<String>()
            + "\n");
        let file = name(view.id);
        let map = |folder: &str| stereo.join(folder).join(format!("{file}.geometric.bin"));
        let half = view.camera.resized(80, 60).unwrap();
        let depth = depth_of(
            scene,
            &View {
                camera: half,
                ..view.clone()
            },
        );
        files::write_atomically(&map("depth_maps"), |out| {
            dense::write_gray(out, depth.raster())
        })
        .unwrap();
        let normals = Raster::filled(80, 60, [0.0, 0.0, -1.0]).unwrap();
        files::write_atomically(&map("normal_maps"), |out| {
            dense::write_normals(out, &normals)
        })
        .unwrap();
        let grey = ColorImage::filled(160, 120, [90, 100, 110]).unwrap();
        let image_path = folder.join("images").join(&file);
        files::write_atomically(&image_path, |out| image::write_png(out, &grey)).unwrap();
    }
    text("sparse/cameras.txt", &cameras);
    text("sparse/images.txt", &images);
    let line = |(at, p): (usize, &DVec3)| format!("{} {} {} {} 1 2 3 0.5\n", 5 * at, p.x, p.y, p.z);
    text(
        "sparse/points3D.txt",
        &points.iter().enumerate().map(line).collect::<String>(),
    );
    let listed: Vec<String> = views[1..].iter().map(|view| name(view.id)).collect();
    text("stereo/fusion.cfg", &(listed.join("\n") + "\n"));
    FuseJob {
        scene: folder.to_path_buf(),
        out: folder.join("cloud.ply"),
        ..FuseJob::default()
    }
}

fn depth_of(scene: &SyntheticScene, view: &View) -> DepthMap {
    let (width, height) = (view.camera.width(), view.camera.height());
    let at = |pixel: u32| {
        let center = glam::DVec2::new(f64::from(pixel % width), f64::from(pixel / width)) + 0.5;
        scene.depth_at(view, center).unwrap_or(0.0) as f32
    };
    let values = (0..width * height).map(at).collect();
    DepthMap::from_values(width, height, values).unwrap().0
}

/// Points on the surface, as the first view sees them.
fn visible_points(scene: &SyntheticScene) -> Vec<DVec3> {
    let view = &scene.scene().views()[0];
    let depth = scene.depth(0);
    let pixels = (0..120)
        .step_by(9)
        .flat_map(|row| (0..160).step_by(9).map(move |c| (c, row)));
    let point = |(column, row): (u32, u32)| {
        let pixel = glam::DVec2::new(f64::from(column) + 0.5, f64::from(row) + 0.5);
        let depth = f64::from(depth.get(column, row));
        (depth > 0.0).then(|| view.pose.to_world(view.camera.ray(pixel) * depth))
    };
    pixels.filter_map(point).collect()
}

/// The views that see each point of `cloud.ply`.
fn visible_in(folder: &Path, cloud: &PointCloud) -> Vec<Vec<u32>> {
    let bytes = std::fs::read(folder.join("cloud.ply.vis")).unwrap();
    assert_eq!(bytes[..8], (cloud.len() as u64).to_le_bytes());
    let words = bytes[8..].as_chunks::<4>().0.iter();
    let mut words = words.map(|&word| u32::from_le_bytes(word));
    let mut views = |&count: &u32| {
        assert_eq!(words.next(), Some(count));
        words.by_ref().take(count as usize).collect()
    };
    let all = cloud
        .view_counts()
        .unwrap()
        .iter()
        .map(&mut views)
        .collect();
    assert_eq!(words.next(), None);
    all
}

#[test]
fn a_colmap_workspace_with_maps_smaller_than_its_images_fuses_onto_the_surface() {
    let scene = scene();
    let folder = tempfile::tempdir().unwrap();
    let mut job = write_workspace(&scene, folder.path());
    job.vis = true;
    let outcome = fuse(&job, false).unwrap();
    assert_eq!(outcome.views, 11, "fusion.cfg leaves one out");
    let cloud = files::read_cloud(&job.out).unwrap();
    let counts = outcome.counts;
    let with_depth = counts.pixels - counts.empty;
    assert_eq!(
        counts.pixels,
        11 * 80 * 60,
        "the maps' pixels, not the images'"
    );
    assert!(counts.fused > with_depth * 3 / 4, "{counts:?}");
    let median = median_distance(&scene, cloud.positions());
    // A pixel spans 0.05 here; half a pixel in K would show as 1e-2.
    assert!(median < 2e-3, "{median:e}");
    assert!(
        cloud
            .colors()
            .unwrap()
            .iter()
            .all(|&color| color == [90, 100, 110])
    );
    // The given normals face each reference camera, turned into the world.
    let toward = |normal: &glam::Vec3| {
        let faces = |view: &View| {
            (view.pose.to_world(DVec3::ZERO) - view.pose.to_world(DVec3::Z))
                .as_vec3()
                .dot(*normal)
        };
        scene
            .scene()
            .views()
            .iter()
            .map(faces)
            .fold(0.0f32, f32::max)
    };
    assert!(
        cloud
            .normals()
            .unwrap()
            .iter()
            .all(|normal| toward(normal) > 0.999_999)
    );
    // Images are counted as they are listed, the first of which is left out.
    let listed = visible_in(folder.path(), &cloud);
    for views in &listed {
        let mut views = views.clone();
        views.sort_unstable();
        assert!(views.iter().all(|view| (1..12).contains(view)), "{views:?}");
        assert!(views.windows(2).all(|pair| pair[0] < pair[1]), "{views:?}");
    }
    let turned = |views: &Vec<u32>| views.iter().map(|view| 11 - view).collect::<Vec<u32>>();
    let turned: Vec<Vec<u32>> = listed.iter().map(turned).collect();
    // Listed the other way round, they are counted so; where there are frames, as those are listed.
    let images = folder.path().join("sparse/images.txt");
    let text = std::fs::read_to_string(&images).unwrap();
    let mut rows: Vec<&str> = text.lines().collect();
    rows.reverse();
    let rows: Vec<String> = (rows.chunks(2))
        .map(|pair| format!("{}\n{}\n", pair[1], pair[0]))
        .collect();
    crate::support::write(&images, rows.concat().as_bytes());
    fuse(&job, true).unwrap();
    assert_eq!(visible_in(folder.path(), &cloud), turned);
    let frame = |index| format!("{index} 1 1 0 0 0 0 0 0 1 CAMERA 3 {}\n", 7 * index + 3);
    let frames: String = (0..12).map(frame).collect();
    crate::support::write(&folder.path().join("sparse/frames.txt"), frames.as_bytes());
    fuse(&job, true).unwrap();
    assert_eq!(visible_in(folder.path(), &cloud), listed);
    let twice = frames.replacen("CAMERA 3 3", "CAMERA 3 10", 1);
    crate::support::write(&folder.path().join("sparse/frames.txt"), twice.as_bytes());
    let message = fuse(&job, true).unwrap_err().to_string();
    assert!(
        message.contains("frames.txt") && message.contains("once"),
        "{message}"
    );
    std::fs::remove_file(folder.path().join("sparse/frames.txt")).unwrap();
    // Wherever the model lies, all its files are inputs.
    for (from, to) in [("sparse", "colmap"), ("colmap", "")] {
        let (from, to) = (folder.path().join(from), folder.path().join(to));
        std::fs::create_dir_all(&to).unwrap();
        for name in ["cameras.txt", "images.txt", "points3D.txt", "frames.txt"] {
            let moved = std::fs::rename(from.join(name), to.join(name));
            assert!(moved.is_ok() || name == "frames.txt");
        }
        crate::support::write(&to.join("frames.txt"), frames.as_bytes());
        fuse(&job, true).unwrap();
        assert_eq!(visible_in(folder.path(), &cloud), listed);
        let run = Run::read(&folder.path().join("cloud.run.toml")).unwrap();
        for name in ["cameras.txt", "images.txt", "points3D.txt", "frames.txt"] {
            let path = to.join(name).display().to_string();
            assert!(run.inputs.contains_key(&path), "{path}: {:?}", run.inputs);
        }
    }
    job.stereo = StereoPass::Photometric;
    let message = fuse(&job, true).unwrap_err().to_string();
    assert!(message.contains("photometric.bin, found none"), "{message}");
}

#[test]
fn filtered_depths_are_the_fused_pixels_and_several_confidences_the_smallest() {
    let scene = scene();
    let folder = tempfile::tempdir().unwrap();
    let mut job = write_scene(&scene, Some(&DepthNoise::default()), folder.path());
    let filtered = folder.path().join("filtered");
    job.filtered_depths = Some(filtered.clone());
    job.fuse = FuseOptions::of(FuseMode::Geo);
    let outcome = fuse(&job, false).unwrap();
    let mut kept = 0;
    for view in scene.scene().views() {
        let name = mvsnet::file_name(view.id, ".pfm");
        let (found, _) = files::read_depth(&filtered.join(&name)).unwrap();
        let (given, _) = files::read_depth(&job.depths.join(&name)).unwrap();
        kept += found.valid_count();
        for (found, given) in found.values().iter().zip(given.values()) {
            let near = (found / given - 1.0).abs() < 0.01;
            assert!(*found == 0.0 || near, "{found} {given}");
        }
    }
    assert_eq!(kept as u64, outcome.counts.fused);
    // `gipuma` moves points beyond their pixels; each is in the map all the same.
    let geo = std::mem::replace(&mut job.fuse, FuseOptions::of(FuseMode::Gipuma));
    (job.fuse.max_disparity_error, job.fuse.min_sources) = (2.0, 1);
    let outcome = fuse(&job, true).unwrap();
    let depths = scene.scene().views().iter().map(|view| {
        let name = mvsnet::file_name(view.id, ".pfm");
        let (found, _) = files::read_depth(&filtered.join(&name)).unwrap();
        found.valid_count() as u64
    });
    assert_eq!(depths.sum::<u64>(), outcome.counts.fused);
    job.fuse = geo;
    // A second confidence of fewer pixels that forbids the left half.
    let strict = folder.path().join("strict");
    for view in scene.scene().views() {
        let halves = (0..16 * 12).map(|at| if at % 16 < 8 { 0.1 } else { 1.0 });
        let map = Raster::from_values(16, 12, halves.collect()).unwrap();
        let path = strict.join(mvsnet::file_name(view.id, ".pfm"));
        files::write_atomically(&path, |out| pfm::write_gray(out, &map)).unwrap();
    }
    job.confidence.push(strict);
    fuse(&job, true).unwrap();
    for view in scene.scene().views() {
        let path = filtered.join(mvsnet::file_name(view.id, ".pfm"));
        let (found, _) = files::read_depth(&path).unwrap();
        let left = |at: usize| at % 160 < 80;
        let values = found.values().iter().enumerate();
        assert!(values.clone().all(|(at, depth)| !left(at) || *depth == 0.0));
        assert!(values.clone().any(|(at, depth)| !left(at) && *depth > 0.0));
    }
    job.fuse.mode = FuseMode::Cluster;
    let message = fuse(&job, true).unwrap_err().to_string();
    assert!(message.contains("filtered depth maps"), "{message}");
}

#[test]
fn voxels_merge_and_the_fingerprint_stands_in_header_and_report() {
    let scene = scene();
    let folder = tempfile::tempdir().unwrap();
    let mut job = write_scene(&scene, Some(&DepthNoise::default()), folder.path());
    let all = fuse(&job, false).unwrap();
    (job.voxel, job.properties) = (0.05, Properties::Full);
    let before = header(&job.out);
    assert!(!before.contains("violations") && !before.contains("property float scale"));
    let outcome = fuse(&job, true).unwrap();
    let cloud = files::read_cloud(&job.out).unwrap();
    assert_eq!(
        outcome.points + outcome.merged_in_voxels as usize,
        all.points
    );
    assert!(
        outcome.points < all.points / 4,
        "{} {}",
        outcome.points,
        all.points
    );
    let mut voxels: Vec<[i64; 3]> = cloud
        .positions()
        .iter()
        .map(|p| (*p / 0.05).floor().to_array().map(|at| at as i64))
        .collect();
    voxels.sort_unstable();
    assert!(
        voxels.windows(2).all(|pair| pair[0] != pair[1]),
        "one point per voxel"
    );
    let report: serde_json::Value =
        serde_json::from_str(&files::read_text(&folder.path().join("cloud.json")).unwrap())
            .unwrap();
    let print = report["fingerprint"].as_str().unwrap();
    let line = format!("comment fingerprint = {print}");
    assert!(print.len() == 16 && header(&job.out).contains(&line));
    assert!(!before.contains(&line), "other options, other fingerprint");
    assert_eq!(report["counts"]["pixels"], 12 * 160 * 120);
}

#[test]
fn valid_sampling_finds_fifteen_points_more_than_plain_at_equal_precision() {
    let scene = scene();
    let folder = tempfile::tempdir().unwrap();
    let mut exact = write_scene(&scene, None, folder.path());
    exact.out = folder.path().join("truth.ply");
    fuse(&exact, false).unwrap();
    let truth = FinitePoints::new(files::read_cloud(&exact.out).unwrap().positions().to_vec());
    let mut job = write_scene(&scene, Some(&DepthNoise::default()), folder.path());
    // Every fifth pixel or so is gone, as after a confidence filter.
    for view in scene.scene().views() {
        change_map(&job.depths, view.id, |at, depth| {
            let hash = (at as u32 ^ (view.id << 20)).wrapping_mul(2_654_435_761) >> 16;
            if hash.is_multiple_of(5) { 0.0 } else { depth }
        });
    }
    job.fuse.min_sources = 3;
    job.fuse.soften = false;
    // About a pixel: what is missing is surface that no pixel gives.
    let tau = mvs_metrics::Tolerance::new(0.02).unwrap();
    let [valid, plain] = [Sampling::Valid, Sampling::Plain].map(|sampling| {
        job.fuse.sampling = sampling;
        fuse(&job, true).unwrap();
        let found = files::read_cloud(&job.out).unwrap();
        let found = FinitePoints::new(found.positions().to_vec());
        let judged = evaluate(&found, None, &truth, &Preparation::default()).unwrap();
        let score = judged.score(tau);
        (score.precision(), score.recall())
    });
    assert!(valid.1 > plain.1 + 0.15, "{valid:?} {plain:?}");
    assert!((valid.0 - plain.0).abs() < 0.005, "{valid:?} {plain:?}");
}
