//! Mesh + view → depth, colour, normals.
//!
//! What is visible at an image position is decided by an exact test in f64 (`triangle`): the
//! nearest triangle, and of two equally near the one with the lower index. Both sides of a triangle
//! are surface. Depth and normals belong to the pixel's centre and are never averaged; colour is the
//! mean of a regular grid of samples, each with its own visibility.

mod bvh;
mod cluster;
mod clusters;
mod eye;
mod lanes;
mod lens;
mod maps;
mod near;
pub mod oracle;
mod picture;
mod raster;
mod rays;
mod scan;
mod surface;
mod texture;
mod tile;
mod tree;
mod triangle;

use crate::error::{Error, Result};
use crate::parallel;
use clusters::Clusters;
use glam::{DVec3, Vec3};
use mvs_datasets::scene::{ColorImage, DepthMap, Distortion, Mesh, NormalMap, View};
use rays::Probe;
use serde::{Deserialize, Serialize};
use surface::{Facet, Frame};
use triangle::Crossing;

/// Rays that one thread takes at a time.
const CHUNK: usize = 1024;

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

impl RenderOptions {
    /// Samples along each side of a pixel.
    fn grid(&self) -> Result<u32> {
        let side = (1..=8).find(|side| side * side == self.samples);
        side.ok_or_else(|| {
            let problem = format!(
                "expected a square number from 1 to 64, found {}",
                self.samples
            );
            Error::invalid("color samples per pixel", problem)
        })
    }
}

/// One rendered view. Depth and normals belong to the pixel centres.
#[derive(Debug, Clone, PartialEq)]
pub struct Rendering {
    /// 8-bit sRGB. Where the pixel's centre meets the surface: the mean over those of the samples
    /// that meet it; elsewhere the background.
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

/// What the centre of a pixel sees.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Seen {
    /// Index of the triangle, [`Seen::NO_TRIANGLE`] where there is none.
    pub triangle: u32,
    /// z-depth, 0 for nothing.
    pub depth: f32,
    /// Geometric unit normal, camera frame, facing the camera; 0 for nothing.
    pub normal: [f32; 3],
    /// Barycentric weights of the triangle's second and third corner.
    pub weights: [f32; 2],
}

impl Seen {
    /// Stands for no triangle.
    pub const NO_TRIANGLE: u32 = u32::MAX;
    /// No surface.
    pub const NOTHING: Self = Self {
        triangle: Self::NO_TRIANGLE,
        depth: 0.0,
        normal: [0.0; 3],
        weights: [0.0; 2],
    };
}

/// The triangle that a ray sees, and where on it.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Visible {
    triangle: usize,
    crossing: Crossing,
}

impl Visible {
    /// The one that hides the other.
    fn nearer(self, other: Self) -> Self {
        let key = |visible: &Self| (visible.crossing.distance, visible.triangle);
        if key(&other) < key(&self) {
            other
        } else {
            self
        }
    }
}

impl From<Visible> for Hit {
    fn from(visible: Visible) -> Self {
        Self {
            triangle: visible.triangle,
            distance: visible.crossing.distance,
            weights: visible.crossing.weights,
        }
    }
}

/// A mesh prepared for rendering from any view.
#[derive(Debug)]
pub struct Renderer<'m> {
    mesh: &'m Mesh,
    center: DVec3,
    radius: f64,
    clusters: Clusters,
}

impl<'m> Renderer<'m> {
    /// Prepares `mesh`, which must have triangles.
    pub fn new(mesh: &'m Mesh) -> Result<Self> {
        if mesh.triangles().is_empty() {
            let problem = "expected at least one triangle, found none: nothing can be rendered";
            return Err(Error::invalid("mesh", problem));
        }
        let bounds = mesh.bounds();
        Ok(Self {
            mesh,
            center: bounds.center(),
            radius: 0.5 * bounds.size().length(),
            clusters: Clusters::new(mesh, bounds.center()),
        })
    }

    /// Renders `view`.
    pub fn render(&self, view: &View, options: &RenderOptions) -> Result<Rendering> {
        let side = options.grid()?;
        let frame = Frame::new(self.mesh, self.center, view);
        picture::render(&self.clusters, &frame, (side, options))
    }

    /// The first hit of the ray from `origin` (world) along `direction`, with distance in
    /// (`range.0`, `range.1`).
    pub fn first_hit(&self, origin: DVec3, direction: DVec3, range: (f64, f64)) -> Option<Hit> {
        let probe = Probe::new(origin - self.center, direction);
        let cross = |triangle| {
            let corners = self
                .mesh
                .corners(triangle)
                .map(|corner| corner - self.center);
            let crossing = probe.ray().cross(corners);
            crossing.filter(|c| range.0 < c.distance && c.distance < range.1)
        };
        let visible = probe.nearest(&self.clusters, (self.radius, range.1), cross);
        visible.map(Hit::from)
    }

    /// As [`Self::first_hit`] for many rays from one point, in their order. Rays that lie next to
    /// each other in `directions` should point alike: neighbours are traced together.
    pub fn first_hits(
        &self,
        origin: DVec3,
        directions: &[DVec3],
        range: (f64, f64),
    ) -> Vec<Option<Hit>> {
        let chunks = parallel::map(directions.len().div_ceil(CHUNK), |chunk| {
            let first = chunk * CHUNK;
            let last = directions.len().min(first + CHUNK);
            let hit = |&direction: &DVec3| self.first_hit(origin, direction, range);
            directions[first..last].iter().map(hit).collect::<Vec<_>>()
        });
        chunks.into_iter().flatten().collect()
    }

    /// What the centre of each pixel of `view` sees, row by row, into `pixels`: exact depth, normal
    /// and place on the triangle, to the bits that [`Self::render`] gives, without its colours. The
    /// camera must have no lens distortion.
    pub fn see(&self, view: &View, pixels: &mut Vec<Seen>) -> Result<()> {
        if view.camera.distortion() != Distortion::None {
            let problem = "expected a camera without lens distortion for maps of visibility";
            return Err(Error::invalid(format!("view {}", view.id), problem));
        }
        let frame = Frame::new(self.mesh, self.center, view);
        maps::see(&self.clusters, &frame, pixels);
        Ok(())
    }

    /// How many pixels of `view` see the surface: what visibility alone costs.
    pub fn visible_count(&self, view: &View) -> usize {
        let frame = Frame::new(self.mesh, self.center, view);
        picture::visible_count(&self.clusters, &frame)
    }

    /// Bytes that the prepared mesh holds, beside the mesh itself.
    pub fn bytes(&self) -> usize {
        self.clusters.bytes()
    }
}

/// What a rendering has at one pixel.
#[derive(Debug, Clone, Copy)]
struct Pixel {
    color: [u8; 3],
    depth: f32,
    normal: [f32; 3],
}

impl Pixel {
    fn empty(options: &RenderOptions) -> Self {
        Self {
            color: options.background,
            depth: 0.0,
            normal: [0.0; 3],
        }
    }

    /// A pixel whose centre, along `direction`, sees `facet` at `distance`.
    fn new(facet: &Facet, distance: f64, direction: DVec3, color: [u8; 3]) -> Self {
        #[allow(clippy::cast_possible_truncation, reason = "depth maps are f32")]
        Self {
            color,
            depth: distance as f32,
            normal: facet.facing_normal(direction).as_vec3().into(),
        }
    }
}

/// The mean colour of the samples that meet the surface; `at_center`'s if none does.
fn mean_color(samples: impl Iterator<Item = Vec3>, at_center: impl FnOnce() -> Vec3) -> [u8; 3] {
    let (sum, count) = samples.fold((Vec3::ZERO, 0.0), |(sum, count), color| {
        (sum + color, count + 1.0)
    });
    let mean = if count > 0.0 {
        sum / count
    } else {
        at_center()
    };
    #[allow(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "a mean of 8-bit values"
    )]
    mean.to_array().map(|value| (value + 0.5) as u8)
}
