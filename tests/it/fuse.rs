//! The file job on the synthetic scene: streaming, determinism, report, refusals.

use glam::DVec3;
use mvs_datasets::format::{image, pfm};
use mvs_datasets::layout::{files, mvsnet};
use mvs_datasets::scene::ColorImage;
use mvs_datasets::synthetic::{DepthNoise, SyntheticOptions, SyntheticScene};
use mvs_eval::fuse::{FuseMode, FuseOptions, Visibility};
use mvs_eval::jobs::Context;
use mvs_eval::jobs::fuse::{FuseJob, FuseOutcome, run};
use mvs_eval::parallel::with_threads;
use mvs_eval::progress::Silent;
use mvs_eval::warning::Warnings;
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
        confidence: noise.map(|_| folder.join("confidence")),
        out: folder.join("cloud.ply"),
        ..FuseJob::default()
    }
}

fn fuse(job: &FuseJob, force: bool) -> mvs_eval::Result<FuseOutcome> {
    let warnings = Warnings::default();
    let context = Context {
        progress: &Silent,
        warnings: &warnings,
        force,
    };
    run(job, &context)
}

fn median_distance(scene: &SyntheticScene, points: &[DVec3]) -> f64 {
    let distances = points.iter().map(|&point| scene.distance_to_surface(point));
    let mut distances: Vec<f64> = distances.collect();
    distances.sort_by(f64::total_cmp);
    distances[distances.len() / 2]
}

#[test]
fn noisy_maps_fuse_to_the_same_bytes_at_any_number_of_threads() {
    let scene = scene();
    let folder = tempfile::tempdir().unwrap();
    let job = write_scene(&scene, Some(&DepthNoise::default()), folder.path());
    let mut first: Option<Vec<u8>> = None;
    for threads in [1, 2, 8] {
        let outcome = with_threads(threads, || fuse(&job, true)).unwrap().unwrap();
        let bytes = std::fs::read(&job.out).unwrap();
        assert_eq!(outcome.counts.fused, outcome.points as u64);
        assert_eq!(outcome.counts.accounted(), outcome.counts.pixels);
        assert_eq!(
            first.get_or_insert_with(|| bytes.clone()),
            &bytes,
            "{threads}"
        );
    }
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
    let header = String::from_utf8_lossy(&std::fs::read(&job.out).unwrap()[..2000]).into_owned();
    assert!(header.contains("comment max_pixel_error = 1.0"), "{header}");
    let report = files::read_text(&folder.path().join("cloud.json")).unwrap();
    assert!(report.contains("\"unconfident\"") && report.contains("\"mode\": \"hkust\""));
}

#[test]
fn exact_maps_fuse_onto_the_surface_in_every_mode() {
    let scene = scene();
    let folder = tempfile::tempdir().unwrap();
    let mut job = write_scene(&scene, None, folder.path());
    for mode in [
        FuseMode::Hkust,
        FuseMode::Geo,
        FuseMode::Dynamic,
        FuseMode::Gipuma,
        FuseMode::Cluster,
    ] {
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
    assert!(
        message.contains("below the confidence threshold"),
        "{message}"
    );
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
