//! Mesh + view → depth, colour, normals.

use crate::error::Result;
use glam::DVec3;
use mvs_datasets::scene::{ColorImage, DepthMap, Mesh, NormalMap, View};
use serde::{Deserialize, Serialize};

/// How a view is rendered.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RenderOptions {
    /// Colour samples per pixel: a square number, 1 to 64.
    pub samples: u32,
    /// Colour where the ray meets no surface, 8-bit sRGB.
    pub background: [u8; 3],
}

impl Default for RenderOptions {
    fn default() -> Self {
        Self {
            samples: 16,
            background: [0; 3],
        }
    }
}

/// One rendered view. Depth and normals belong to the pixel centres.
#[derive(Debug, Clone, PartialEq)]
pub struct Rendering {
    /// 8-bit sRGB.
    pub color: ColorImage,
    /// z-depth, 0 where no surface is met.
    pub depth: DepthMap,
    /// Geometric normals, camera frame, facing the camera.
    pub normals: NormalMap,
}

/// Where a ray meets the surface first.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hit {
    /// Index of the triangle.
    pub triangle: usize,
    /// Distance along the ray in units of its direction's length.
    pub distance: f64,
    /// Barycentric weights of the triangle's second and third corner.
    pub weights: [f64; 2],
}

/// A mesh prepared for rendering from any view.
#[derive(Debug)]
pub struct Renderer {
    _todo: (),
}

impl Renderer {
    /// Prepares `mesh`, which must have triangles.
    pub fn new(_mesh: &Mesh) -> Result<Self> {
        todo!()
    }

    /// Renders `view`.
    pub fn render(&self, _view: &View, _options: &RenderOptions) -> Result<Rendering> {
        todo!()
    }

    /// The first hit of the ray from `origin` (world) along `direction`, with distance in
    /// (`range.0`, `range.1`).
    pub fn first_hit(&self, _origin: DVec3, _direction: DVec3, _range: (f64, f64)) -> Option<Hit> {
        todo!()
    }
}
