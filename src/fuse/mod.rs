//! Depth maps → point cloud, keeping what several views agree on.

use crate::error::Result;
use crate::progress::Progress;
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

/// What became of the pixels of all depth maps.
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

/// Fuses the estimates.
pub fn fuse(
    _estimates: &[Estimate],
    _options: &FuseOptions,
    _progress: &dyn Progress,
) -> Result<Fused> {
    todo!()
}
