//! Fused points against the surface whose exact depth they come from.

use super::{ExtremesJob, Place, Rows, naive};
use crate::error::Result;
use crate::fuse::{self, Estimate, FuseMode, FuseOptions, Fused};
use crate::progress::Silent;
use glam::{DVec2, DVec3};
use mvs_datasets::scene::{DepthMap, View};
use mvs_datasets::synthetic::{SceneKind, SyntheticOptions, SyntheticScene};

const QUANTITY: &str = "distance from the surface over depth, median";
const PLAIN: &str = "distance of back-projected pixels from their points over depth, largest";
/// What exact depth rounded to f32 and sampled between pixels may cost.
const BOUND: f64 = 2e-5;

pub(super) fn measure(job: &ExtremesJob, rows: &mut Rows<'_>) -> Result<()> {
    let scene = facade(96)?;
    let usual = fused(&scene, Place::USUAL, 1)?.cloud.len();
    for (step, place) in Place::steps() {
        let found = fused(&scene, place, 1)?;
        put(&scene, &found, (step, place), rows)?;
        let off = found.cloud.len().abs_diff(usual) as f64 / usual as f64;
        rows.put(
            step,
            "ours",
            ("points more or fewer, fraction", off),
            Some(1e-3),
        )?;
        plainly(&scene, step, place, rows)?;
    }
    for copies in [1, 4, 16] {
        let found = fused(&scene, Place::USUAL, copies)?;
        put(
            &scene,
            &found,
            (("duplicates", copies as f64), Place::USUAL),
            rows,
        )?;
    }
    for ratio in [1e1, 1e3, 1e6] {
        let error = near_and_far(&scene, ratio)?;
        rows.put(("near-far", ratio), "ours", (QUANTITY, error), Some(BOUND))?;
    }
    let widths = [24u32, 96, 384];
    for width in widths.into_iter().filter(|&width| width <= job.width) {
        let scene = facade(width)?;
        let step = ("image-size", f64::from(width));
        // Edges take up more of a smaller image: what is measured here is sampling, not arithmetic.
        let found = fused(&scene, Place::USUAL, 1)?;
        let error = median_distance(&scene, &found, Place::USUAL);
        rows.put(step, "ours", (QUANTITY, error), None)?;
    }
    Ok(())
}

/// Walls alone: a mesh, and depth between pixels, that formulas know.
fn facade(width: u32) -> Result<SyntheticScene> {
    Ok(SyntheticScene::new(SyntheticOptions {
        kind: SceneKind::Facade,
        views: 6,
        width,
        height: 3 * width / 4,
        ..SyntheticOptions::default()
    })?)
}

/// The exact maps at a place, every view `copies` times.
fn estimates(scene: &SyntheticScene, place: Place, copies: usize) -> Result<Vec<Estimate>> {
    let views = scene.scene().views();
    let count = views.len() * copies;
    let one = |nth: usize| {
        let index = nth / copies;
        let exact = scene.depth(index);
        #[allow(clippy::cast_possible_truncation, reason = "depth is stored as f32")]
        let values = exact
            .values()
            .iter()
            .map(|&d| (f64::from(d) * place.scale) as f32);
        let (width, height) = exact.size();
        Ok(Estimate {
            view: place.view(&views[index])?,
            depth: DepthMap::from_values(width, height, values.collect())?.0,
            confidence: None,
            image: None,
            sources: (0..count).filter(|&other| other != nth).collect(),
        })
    };
    (0..count).map(one).collect()
}

fn fused(scene: &SyntheticScene, place: Place, copies: usize) -> Result<Fused> {
    let options = FuseOptions::of(FuseMode::Geo);
    fuse::fuse(&estimates(scene, place, copies)?, &options, &Silent)
}

/// The facade stands about this far from its cameras.
const DISTANCE: f64 = 6.0;

fn put(
    scene: &SyntheticScene,
    found: &Fused,
    (step, place): ((&str, f64), Place),
    rows: &mut Rows<'_>,
) -> Result<()> {
    let error = median_distance(scene, found, place);
    rows.put(step, "ours", (QUANTITY, error), Some(BOUND))
}

/// Over depth; infinite without points, which is as wrong as can be.
fn median_distance(scene: &SyntheticScene, found: &Fused, place: Place) -> f64 {
    let positions = found.cloud.positions().iter();
    let distances = positions.map(|&p| scene.distance_to_surface(place.back(p)) / DISTANCE);
    let median = mvs_metrics::stats::median(&distances.collect::<Vec<_>>());
    median.unwrap_or(f64::INFINITY)
}

/// The same depth, put into the world by plain arithmetic.
fn plainly(
    scene: &SyntheticScene,
    step: (&str, f64),
    place: Place,
    rows: &mut Rows<'_>,
) -> Result<()> {
    let usual = &scene.scene().views()[2];
    let view = place.view(usual)?;
    let middle = place.put(scene.mesh().bounds().center());
    for arithmetic in naive::ALL {
        let mut worst = 0.0f64;
        for (pixel, depth) in sampled(scene, usual) {
            let exact = place.put(usual.pose.to_world(usual.camera.ray(pixel) * depth));
            let at = (pixel, depth * place.scale);
            let found = naive::back_projected(arithmetic, (&view, middle), at);
            worst = worst.max(found.distance(exact) / (depth * place.scale));
        }
        rows.put(step, arithmetic.name, (PLAIN, worst), None)?;
    }
    Ok(())
}

fn sampled(scene: &SyntheticScene, view: &View) -> Vec<(DVec2, f64)> {
    let (width, height) = (view.camera.width(), view.camera.height());
    let places = (0..height).step_by(3).flat_map(|row| {
        (0..width)
            .step_by(3)
            .map(move |column| (f64::from(column) + 0.5, f64::from(row) + 0.5))
    });
    let pixels = places.map(DVec2::from);
    pixels
        .filter_map(|at| Some((at, scene.depth_at(view, at)?)))
        .collect()
}

/// Half of each image at depth 1, the other half `ratio` times as deep, from cameras side by side:
/// the median distance from its own plane over depth, of the worse half.
fn near_and_far(scene: &SyntheticScene, ratio: f64) -> Result<f64> {
    let usual = &scene.scene().views()[0];
    let (width, height) = (usual.camera.width(), usual.camera.height());
    let one = |index: usize| {
        let mut view = usual.clone();
        let eye = DVec3::new(0.004 * index as f64, 0.0, 0.0);
        view.pose = mvs_datasets::scene::Pose::new(glam::DMat3::IDENTITY, -eye)?;
        view.depth_range = None;
        #[allow(clippy::cast_possible_truncation, reason = "depth is stored as f32")]
        let at = |row: u32| if row < height / 2 { 1.0 } else { ratio as f32 };
        let values = (0..height).flat_map(|row| (0..width).map(move |_| at(row)));
        Ok(Estimate {
            depth: DepthMap::from_values(width, height, values.collect())?.0,
            view,
            confidence: None,
            image: None,
            sources: (0..5).filter(|&other| other != index).collect(),
        })
    };
    let estimates = (0..5).map(one).collect::<Result<Vec<_>>>()?;
    let found = fuse::fuse(&estimates, &FuseOptions::of(FuseMode::Geo), &Silent)?;
    let between = ratio.sqrt();
    let of_half = |far: bool| {
        let depths = found.cloud.positions().iter().map(|p| p.z);
        let own = depths.filter(|&z| (z > between) == far);
        let plane = if far { ratio } else { 1.0 };
        let errors: Vec<f64> = own.map(|z| (z / plane - 1.0).abs()).collect();
        mvs_metrics::stats::median(&errors).unwrap_or(f64::INFINITY)
    };
    Ok(of_half(false).max(of_half(true)))
}
