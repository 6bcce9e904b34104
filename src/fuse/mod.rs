//! Depth maps → point cloud, keeping what several views agree on.

mod geo;
pub mod geometry;
pub mod sampling;
#[cfg(test)]
mod testing;

use crate::error::{Error, Result};
use crate::parallel;
use crate::progress::Progress;
use geo::{Band, Reference};
use mvs_datasets::scene::{ColorImage, DepthMap, PointCloud, Raster, View};
use serde::{Deserialize, Serialize};

/// How depth maps are fused.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FuseOptions {
    /// Which procedure.
    pub mode: FuseMode,
    /// At most so many source views per reference view.
    pub max_sources: usize,
    /// Pixels below this confidence are left out, where there is confidence.
    pub min_confidence: f32,
    /// Largest reprojection error in pixels, strict.
    pub max_pixel_error: f64,
    /// Largest relative depth error, strict.
    pub max_depth_error: f64,
    /// A point needs so many source views that agree, the reference view not counted.
    pub min_sources: usize,
}

/// The fusion procedure.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum FuseMode {
    /// Two-way geometric consistency and averaging, as MVSNet-family evaluation scripts do.
    #[default]
    Geo,
}

impl Default for FuseOptions {
    fn default() -> Self {
        Self {
            mode: FuseMode::Geo,
            max_sources: 10,
            min_confidence: 0.8,
            max_pixel_error: 1.0,
            max_depth_error: 0.01,
            min_sources: 3,
        }
    }
}

/// One view's estimate.
#[derive(Debug, Clone)]
pub struct Estimate {
    /// Camera (for the size of the depth map) and pose.
    pub view: View,
    /// Estimated z-depth.
    pub depth: DepthMap,
    /// Confidence per pixel, of the depth map's size.
    pub confidence: Option<Raster<f32>>,
    /// The image that colours the points; any size.
    pub image: Option<ColorImage>,
    /// Indices of the source views among the estimates, best first.
    pub sources: Vec<usize>,
}

/// A fused cloud, and what became of the pixels.
#[derive(Debug, Clone, PartialEq)]
pub struct Fused {
    /// The points, by view and row-major pixel; colours where images were given; view counts.
    pub cloud: PointCloud,
    /// Pixels that became points or did not, by reason.
    pub counts: FuseCounts,
}

/// What became of the pixels of all depth maps; the reasons and `fused` add up to `pixels`.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct FuseCounts {
    /// All pixels.
    pub pixels: u64,
    /// Pixels without a depth.
    pub empty: u64,
    /// Pixels below the confidence threshold.
    pub unconfident: u64,
    /// Pixels on which too few sources agree.
    pub inconsistent: u64,
    /// Pixels that became points.
    pub fused: u64,
}

/// Rows of a reference view that one task works on.
const BAND_ROWS: u32 = 16;

/// Fuses the estimates: every view in turn is the reference, tested against its sources.
///
/// Points stand by view and row-major pixel, whatever the number of threads. The cloud has colours
/// where every estimate has an image, confidences where every estimate has them, and the number of
/// agreeing views, the reference counted.
///
/// # Errors
/// No estimates, options out of range, sizes that differ within an estimate, sources that are no
/// other estimate, and interruption.
pub fn fuse(
    estimates: &[Estimate],
    options: &FuseOptions,
    progress: &dyn Progress,
) -> Result<Fused> {
    check_options(options)?;
    check_estimates(estimates)?;
    progress.begin("fusing depth maps", estimates.len() as u64);
    let mut bands = Vec::new();
    for (index, estimate) in estimates.iter().enumerate() {
        progress.check()?;
        let reference = Reference::new(estimates, index, options);
        let height = estimate.depth.height();
        bands.extend(parallel::map(height.div_ceil(BAND_ROWS) as usize, |band| {
            let first = u32::try_from(band).unwrap_or(u32::MAX) * BAND_ROWS;
            reference.fuse_rows(first..(first + BAND_ROWS).min(height))
        }));
        progress.advance(1);
    }
    join(estimates, &bands)
}

fn check_options(options: &FuseOptions) -> Result<()> {
    let bounds = [
        ("max_pixel_error", options.max_pixel_error),
        ("max_depth_error", options.max_depth_error),
    ];
    for (name, bound) in bounds {
        if !(bound.is_finite() && bound > 0.0) {
            let problem = format!("expected a finite bound above 0, found {bound}");
            return Err(Error::invalid(name, problem));
        }
    }
    if options.min_confidence.is_nan() {
        let problem = "expected a number, found NaN";
        return Err(Error::invalid("min_confidence", problem));
    }
    Ok(())
}

fn check_estimates(estimates: &[Estimate]) -> Result<()> {
    if estimates.is_empty() {
        let problem = "expected at least one, found none: nothing to fuse";
        return Err(Error::invalid("depth maps", problem));
    }
    for (index, estimate) in estimates.iter().enumerate() {
        let what = || format!("view {}", estimate.view.id);
        let camera = (estimate.view.camera.width(), estimate.view.camera.height());
        check_size(estimate.depth.size(), camera, "depth map")
            .map_err(|problem| Error::invalid(what(), problem))?;
        if let Some(confidence) = &estimate.confidence {
            check_size(confidence.size(), camera, "confidence")
                .map_err(|problem| Error::invalid(what(), problem))?;
        }
        let odd = |&&source: &&usize| source >= estimates.len() || source == index;
        if let Some(source) = estimate.sources.iter().find(odd) {
            let problem = format!(
                "expected its sources to be other estimates (below {}), found {source}",
                estimates.len()
            );
            return Err(Error::invalid(what(), problem));
        }
    }
    Ok(())
}

fn check_size(found: (u32, u32), camera: (u32, u32), map: &str) -> Result<(), String> {
    if found == camera {
        return Ok(());
    }
    Err(format!(
        "expected a {map} of the camera's size {}x{}, found {}x{}: scale the camera to the map",
        camera.0, camera.1, found.0, found.1
    ))
}

/// The bands as one cloud, in order.
fn join(estimates: &[Estimate], bands: &[Band]) -> Result<Fused> {
    let points = || bands.iter().flat_map(|band| &band.points);
    let mut cloud = PointCloud::new(points().map(|point| point.position).collect())
        .with_view_counts(points().map(|point| point.view_count).collect())?;
    if estimates.iter().all(|estimate| estimate.image.is_some()) {
        cloud = cloud.with_colors(points().map(|point| point.color).collect())?;
    }
    if estimates
        .iter()
        .all(|estimate| estimate.confidence.is_some())
    {
        cloud = cloud.with_confidences(points().map(|point| point.confidence).collect())?;
    }
    let counts = bands
        .iter()
        .fold(FuseCounts::default(), |sum, band| sum.plus(band.counts));
    Ok(Fused { cloud, counts })
}

impl FuseCounts {
    /// Both together.
    #[must_use]
    pub fn plus(self, other: Self) -> Self {
        Self {
            pixels: self.pixels + other.pixels,
            empty: self.empty + other.empty,
            unconfident: self.unconfident + other.unconfident,
            inconsistent: self.inconsistent + other.inconsistent,
            fused: self.fused + other.fused,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::testing::{Plane, arc};
    use super::*;
    use crate::parallel::with_threads;
    use crate::progress::Silent;
    use glam::{DVec2, DVec3};

    fn plane() -> Plane {
        Plane {
            normal: DVec3::new(0.2, -0.3, 1.0).normalize(),
            offset: 0.1,
        }
    }

    #[test]
    fn a_noise_free_plane_fuses_onto_the_plane() {
        let surface = |view: &View, pixel| plane().depth(view, pixel);
        // Bilinear depth on a slope is off by its curvature, which falls with the pixel's size
        // squared: 2e-6 of the depth at 64x48, 8e-8 here.
        let estimates = arc(5, (320, 240), DVec3::ZERO, surface);
        let fused = fuse(&estimates, &FuseOptions::default(), &Silent).unwrap();
        assert!(
            fused.counts.fused > fused.counts.pixels / 2,
            "{:?}",
            fused.counts
        );
        // Samples at a map's border mix in zeros, as in the scripts: look at the others.
        let at_border = |view: &View, position: DVec3| {
            let pixel = view.camera.project(view.pose.to_cam(position)).unwrap();
            let margin = pixel.min(DVec2::new(320.0, 240.0) - pixel).min_element();
            margin.abs() < 1.5
        };
        let inside = |position: &&DVec3| !estimates.iter().any(|e| at_border(&e.view, **position));
        let mut seen = 0;
        for position in fused.cloud.positions().iter().filter(inside) {
            let error = plane().normal.dot(*position) - plane().offset;
            assert!(error.abs() < 1e-6 * 3.5, "{error:e}");
            seen += 1;
        }
        assert!(seen > 9 * fused.cloud.len() / 10, "{seen}");
        assert!(
            fused
                .cloud
                .view_counts()
                .unwrap()
                .iter()
                .all(|&n| (4..=5).contains(&n))
        );
    }

    #[test]
    fn half_a_pixel_in_the_intrinsics_moves_the_cloud() {
        let surface = |view: &View, pixel| plane().depth(view, pixel);
        let mut estimates = arc(5, (64, 48), DVec3::ZERO, surface);
        for estimate in &mut estimates {
            let camera = estimate.view.camera;
            let center = camera.center() + 0.5;
            let (width, height) = (camera.width(), camera.height());
            estimate.view.camera =
                mvs_datasets::scene::Camera::new(width, height, camera.focal(), center).unwrap();
        }
        let fused = fuse(&estimates, &FuseOptions::default(), &Silent).unwrap();
        let error = |p: &DVec3| (plane().normal.dot(*p) - plane().offset).abs();
        let mean =
            fused.cloud.positions().iter().map(error).sum::<f64>() / fused.cloud.len() as f64;
        assert!(mean > 1e-3, "{mean:e}");
    }

    #[test]
    fn counts_add_up_and_unconfident_and_lonely_pixels_are_left_out() {
        let surface = |view: &View, pixel| plane().depth(view, pixel);
        let mut estimates = arc(5, (32, 24), DVec3::ZERO, surface);
        let mut values = vec![1.0; 32 * 24];
        values[..320].fill(0.5);
        values[320] = f32::NAN;
        estimates[0].confidence = Some(Raster::from_values(32, 24, values).unwrap());
        estimates[1].sources.truncate(2);
        let fused = fuse(&estimates, &FuseOptions::default(), &Silent).unwrap();
        let counts = fused.counts;
        assert_eq!(counts.unconfident, 321);
        assert!(counts.inconsistent >= 32 * 24);
        assert_eq!(
            counts.pixels,
            counts.empty + counts.unconfident + counts.inconsistent + counts.fused
        );
        assert_eq!(counts.fused, fused.cloud.len() as u64);
        assert_eq!(counts.pixels, 5 * 32 * 24);
    }

    #[test]
    fn the_image_colours_the_points_whatever_its_size() {
        let surface = |view: &View, pixel| plane().depth(view, pixel);
        let mut estimates = arc(5, (32, 24), DVec3::ZERO, surface);
        let two_halves = |index: u32| {
            if index % 64 < 32 {
                [250, 0, 0]
            } else {
                [0, 0, 250]
            }
        };
        for estimate in &mut estimates {
            let values = (0..64 * 48).map(two_halves).collect();
            estimate.image = Some(ColorImage::from_values(64, 48, values).unwrap());
        }
        let fused = fuse(&estimates, &FuseOptions::default(), &Silent).unwrap();
        let view = &estimates[0].view;
        let mut seen = 0;
        for (position, color) in fused
            .cloud
            .positions()
            .iter()
            .zip(fused.cloud.colors().unwrap())
        {
            let pixel = view.camera.project(view.pose.to_cam(*position)).unwrap();
            // Points of the first view project onto its pixel centres.
            let off_centre = (pixel - pixel.floor() - 0.5).abs().max_element();
            if off_centre < 1e-6 {
                seen += 1;
                assert_eq!(color[0] > 0, pixel.x < 16.0, "{pixel}");
            }
        }
        assert!(seen > 32 * 24 / 2, "{seen}");
    }

    #[test]
    fn the_same_cloud_at_any_number_of_threads() {
        let surface = |view: &View, pixel| plane().depth(view, pixel);
        let estimates = arc(4, (40, 50), DVec3::ZERO, surface);
        let at = |threads| {
            with_threads(threads, || {
                fuse(&estimates, &FuseOptions::default(), &Silent)
            })
            .unwrap()
            .unwrap()
        };
        let one = at(1);
        assert!(!one.cloud.is_empty());
        assert_eq!(one, at(2));
        assert_eq!(one, at(8));
    }

    #[test]
    fn misfits_are_named() {
        let surface = |view: &View, pixel| plane().depth(view, pixel);
        let estimates = arc(3, (8, 6), DVec3::ZERO, surface);
        let message = |estimates: &[Estimate], options: &FuseOptions| {
            fuse(estimates, options, &Silent).unwrap_err().to_string()
        };
        let defaults = FuseOptions::default();
        assert!(message(&[], &defaults).contains("nothing to fuse"));
        let mut odd = estimates.clone();
        odd[1].sources[0] = 1;
        assert!(message(&odd, &defaults).contains("view 1: expected its sources"));
        let mut odd = estimates.clone();
        odd[2].depth = DepthMap::from_values(6, 8, vec![1.0; 48]).unwrap().0;
        assert!(message(&odd, &defaults).contains("size 8x6, found 6x8"));
        let mut odd = estimates.clone();
        odd[0].confidence = Some(Raster::filled(2, 2, 1.0).unwrap());
        assert!(message(&odd, &defaults).contains("found 2x2"));
        let loose = FuseOptions {
            max_pixel_error: f64::NAN,
            ..defaults
        };
        assert!(message(&estimates, &loose).contains("max_pixel_error"));
    }
}
