//! Depth maps → point cloud, keeping what several views agree on.
//!
//! [`fuse_maps`] streams: it asks [`DepthMaps`] for one view at a time and hands points to a
//! [`PointSink`]. [`fuse`] does the same for maps in memory. Everything that decides which points
//! come out is in [`FuseOptions`].
//!
//! A reference pixel and a source are compared by one sample of the source's depth map, see
//! [`geometry`]. Sources that see through a point contradict it.

mod cache;
mod cluster;
mod confident;
mod consensus;
mod counts;
mod engine;
#[cfg(test)]
mod extremes;
mod finish;
pub mod geometry;
mod inputs;
mod kernel;
mod merrell;
mod near;
mod normals;
mod options;
#[cfg(test)]
mod oracle;
mod packing;
mod points;
pub mod presets;
mod reference;
mod rows;
mod rules;
mod samples;
pub mod sampling;
mod selection;
mod sight;
mod source;
mod steps;
mod taps;
#[cfg(test)]
mod testing;
mod tiles;
mod voxels;

pub use counts::FuseCounts;
pub use engine::{FuseInputs, columns, fuse_maps};
pub use inputs::{DepthMaps, MemoryScratch, Scratch};
pub(crate) use inputs::{put_parts, take_rows};
pub use options::{Colors, FuseMode, FuseOptions, Sampling, Visibility};
pub use points::{Columns, PointSink, Points};
pub use reference::Region;
pub use tiles::CLUSTER_BYTES;
pub use voxels::VoxelSink;

use crate::error::Result;
use crate::progress::Progress;
use crate::warning::Warnings;
use mvs_datasets::scene::{ColorImage, DepthMap, PointCloud, Raster, View};

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

/// Fuses the estimates, all in memory: every view in turn is the reference, tested against its
/// sources.
///
/// Points stand by view and row-major pixel, whatever the number of threads. The cloud has colours
/// where every estimate has an image, confidences where every estimate has them, normals where the
/// options ask for them, and the number of agreeing views, the reference counted.
///
/// # Errors
/// No estimates, options out of range, sizes that differ within an estimate, sources that are no
/// other estimate, and interruption.
pub fn fuse(
    estimates: &[Estimate],
    options: &FuseOptions,
    progress: &dyn Progress,
) -> Result<Fused> {
    let inputs = FuseInputs {
        maps: &estimates,
        region: None,
        scratch: &MemoryScratch::default(),
        memory: MEMORY,
        progress,
        warnings: &Warnings::default(),
    };
    let mut points = Points::default();
    let counts = fuse_maps(&inputs, options, &mut points)?;
    let cloud = points.into_cloud(columns(&estimates, options))?;
    Ok(Fused { cloud, counts })
}

/// Bytes of depth maps and images held at a time unless said otherwise.
pub const MEMORY: usize = 512 << 20;

#[cfg(test)]
mod tests {
    use super::testing::{Plane, arc};
    use super::*;
    use crate::parallel::with_threads;
    use crate::progress::Silent;
    use glam::{DVec2, DVec3};

    fn geo() -> FuseOptions {
        FuseOptions::of(FuseMode::Geo)
    }

    #[test]
    fn a_noise_free_plane_fuses_onto_the_plane() {
        let surface = |view: &View, pixel| Plane::tilted().depth(view, pixel);
        // Bilinear depth on a slope is off by its curvature, which falls with the pixel's size
        // squared: 2e-6 of the depth at 64x48, 8e-8 here.
        let estimates = arc(5, (320, 240), DVec3::ZERO, surface);
        let fused = fuse(&estimates, &geo(), &Silent).unwrap();
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
            let error = Plane::tilted().normal.dot(*position) - Plane::tilted().offset;
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
        let surface = |view: &View, pixel| Plane::tilted().depth(view, pixel);
        let mut estimates = arc(5, (64, 48), DVec3::ZERO, surface);
        for estimate in &mut estimates {
            let camera = estimate.view.camera;
            let center = camera.center() + 0.5;
            let (width, height) = (camera.width(), camera.height());
            estimate.view.camera =
                mvs_datasets::scene::Camera::new(width, height, camera.focal(), center).unwrap();
        }
        let fused = fuse(&estimates, &geo(), &Silent).unwrap();
        let error = |p: &DVec3| (Plane::tilted().normal.dot(*p) - Plane::tilted().offset).abs();
        let mean =
            fused.cloud.positions().iter().map(error).sum::<f64>() / fused.cloud.len() as f64;
        assert!(mean > 1e-3, "{mean:e}");
    }

    #[test]
    fn counts_add_up_and_unconfident_and_lonely_pixels_are_left_out() {
        let surface = |view: &View, pixel| Plane::tilted().depth(view, pixel);
        let mut estimates = arc(5, (32, 24), DVec3::ZERO, surface);
        let mut values = vec![1.0; 32 * 24];
        values[..320].fill(0.5);
        values[320] = f32::NAN;
        estimates[0].confidence = Some(Raster::from_values(32, 24, values).unwrap());
        estimates[1].sources.truncate(2);
        let fused = fuse(&estimates, &geo(), &Silent).unwrap();
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
    fn a_quantile_is_of_the_pixels_with_depth() {
        let mut estimates = arc(5, (32, 24), DVec3::ZERO, |view, pixel| {
            match pixel.x < 8.0 {
                true => Plane::tilted().depth(view, pixel),
                false => 0.0,
            }
        });
        let confidences: Vec<f32> = (0..32 * 24u16)
            .map(|at| match at % 32 {
                column if column < 8 => 0.5 + f32::from(at / 32 * 8 + column) / 512.0,
                _ => 0.0,
            })
            .collect();
        let confidences = Raster::from_values(32, 24, confidences).unwrap();
        estimates[0].confidence = Some(confidences);
        for mode in FuseMode::ALL {
            let options = FuseOptions {
                mode,
                confidence_quantile: 0.25,
                ..geo()
            };
            let counts = fuse(&estimates, &options, &Silent).unwrap().counts;
            assert_eq!(counts.unconfident, 8 * 24 / 4, "{mode:?}");
        }
    }

    #[test]
    fn the_image_colours_the_points_whatever_its_size() {
        let surface = |view: &View, pixel| Plane::tilted().depth(view, pixel);
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
        let fused = fuse(&estimates, &geo(), &Silent).unwrap();
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
        let surface = |view: &View, pixel| Plane::tilted().depth(view, pixel);
        let estimates = arc(4, (40, 50), DVec3::ZERO, surface);
        let at = |threads| {
            with_threads(threads, || fuse(&estimates, &geo(), &Silent))
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
        let surface = |view: &View, pixel| Plane::tilted().depth(view, pixel);
        let estimates = arc(3, (8, 6), DVec3::ZERO, surface);
        let message = |estimates: &[Estimate], options: &FuseOptions| {
            fuse(estimates, options, &Silent).unwrap_err().to_string()
        };
        let defaults = geo();
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
