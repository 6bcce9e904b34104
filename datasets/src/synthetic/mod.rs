//! Scenes whose truth has a closed form.

use crate::error::Result;
use crate::scene::{ColorImage, DepthMap, Mesh, PointCloud, Raster, Scene};

/// What a synthetic scene is made of. Deterministic from `seed`.
#[derive(Debug, Clone, PartialEq)]
pub struct SyntheticOptions {
    /// Seed of everything drawn.
    pub seed: u64,
    /// Number of cameras on the ring.
    pub views: u32,
    /// Image width in pixels.
    pub width: u32,
    /// Image height in pixels.
    pub height: u32,
}

impl Default for SyntheticOptions {
    fn default() -> Self {
        Self {
            seed: 0,
            views: 12,
            width: 320,
            height: 240,
        }
    }
}

/// How estimated depth maps differ from the truth.
#[derive(Debug, Clone, PartialEq)]
pub struct DepthNoise {
    /// Standard deviation of the Gaussian noise as a fraction of the depth.
    pub relative_sigma: f64,
    /// Fraction of pixels whose depth is drawn anew, uniformly over the view's range.
    pub outliers: f64,
    /// Fraction of pixels at depth edges whose depth lies between the two surfaces.
    pub flying: f64,
    /// Fraction of the area without a depth, in round holes.
    pub holes: f64,
}

/// A box and a sphere on a plane, seen by a ring of cameras.
#[derive(Debug, Clone)]
pub struct SyntheticScene {
    options: SyntheticOptions,
}

impl SyntheticScene {
    /// Builds the scene.
    pub fn new(_options: SyntheticOptions) -> Result<Self> {
        todo!()
    }

    /// The cameras, with depth ranges and source views.
    pub fn scene(&self) -> &Scene {
        let _ = &self.options;
        todo!()
    }

    /// The textured mesh. Its sphere is a polyhedron: see `mesh_deviation`.
    pub fn mesh(&self) -> &Mesh {
        todo!()
    }

    /// The largest distance between the mesh and the exact surface, in world units.
    pub fn mesh_deviation(&self) -> f64 {
        todo!()
    }

    /// Exact z-depth at the pixel centres of the view at `index`, by formula.
    pub fn depth(&self, _index: usize) -> DepthMap {
        todo!()
    }

    /// The photograph that view `index` takes, given the scene's render: a smooth, known lighting
    /// field and a camera response applied to it.
    pub fn photograph(&self, _index: usize, _rendered: &ColorImage) -> ColorImage {
        todo!()
    }

    /// Estimated depth and confidence of view `index`: the exact depth made worse.
    pub fn estimated_depth(&self, _index: usize, _noise: &DepthNoise) -> (DepthMap, Raster<f32>) {
        todo!()
    }

    /// Points on the exact surface, uniform by area with about `spacing` world units between
    /// neighbours, normals and colours included; only surface that can be seen from outside.
    pub fn sample_surface(&self, _spacing: f64) -> PointCloud {
        todo!()
    }

    /// Distance from a point to the exact surface, in world units.
    pub fn distance_to_surface(&self, _point: glam::DVec3) -> f64 {
        todo!()
    }
}
