//! Mesh + view → depth, colour, normals.
//!
//! What is visible at an image position is decided by an exact test in f64 (`triangle`): the
//! nearest triangle, and of two equally near the one with the lower index. Both sides of a triangle
//! hide what is behind them; the back is surface only where the material is double-sided or
//! [`BackFaces::Valid`] is asked for. Cut-out parts are not there. Depth and normals belong to the
//! pixel's centre and are never averaged; colour is the mean of a regular grid of samples, each with
//! its own visibility. A camera's lens is gone through by exact inversion, sample by sample.

#[cfg(target_arch = "x86_64")]
mod avx;
mod bent;
mod bulk;
mod bvh;
mod cluster;
mod clusters;
mod dots;
mod doubles;
mod doubts;
mod eye;
mod lanes;
mod lens;
mod light;
mod look;
mod maps;
mod meets;
mod near;
pub mod oracle;
mod packet;
mod pages;
mod paint;
mod palette;
mod picture;
mod planes;
mod raster;
mod rays;
mod row;
mod scan;
mod shade;
mod sieve;
mod sight;
mod strokes;
mod surface;
mod texture;
mod tile;
mod tree;
mod triangle;
#[cfg(test)]
mod widths;

use crate::ahead::in_large_pages;
use crate::error::{Error, Result};
pub use sight::{BackFaces, MIXED_JUMP, Sight};

use bulk::Bundle;
use clusters::Clusters;
use glam::{DVec3, Vec3};
use look::Scenery;
use mvs_datasets::scene::{ColorImage, DepthMap, Distortion, Mesh, NormalMap, Raster, View};
use rays::Probe;
use serde::{Deserialize, Serialize};
use std::sync::OnceLock;
use surface::{Facet, Frame};
use triangle::{Crossing, Ray};

/// How a view is rendered.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RenderOptions {
    /// Colour samples per pixel: a square number, 1 to 64. 16 by default: the fewest that stay at half
    /// an 8-bit level (RMS) from 64 samples, at 3.4 times their speed; see
    /// `reports/2026-11-25-tradeoff`.
    pub samples: u32,
    /// Colour where the ray meets no surface, 8-bit sRGB.
    pub background: [u8; 3],
    /// What the backs of triangles are.
    pub back_faces: BackFaces,
    /// Whether [`Rendering::normals`] are made: more than half of what a rendering without interpolated
    /// ones holds. What is recorded of a job does not depend on it.
    #[serde(skip)]
    pub normals: bool,
    /// Whether [`Rendering::interpolated_normals`] are made.
    pub interpolated_normals: bool,
}

impl Default for RenderOptions {
    fn default() -> Self {
        Self {
            samples: 16,
            background: [0; 3],
            back_faces: BackFaces::Invalid,
            normals: true,
            interpolated_normals: false,
        }
    }
}

impl RenderOptions {
    /// Checks the number of samples.
    pub(crate) fn check(&self) -> Result<()> {
        self.grid().map(|_| ())
    }

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
    /// Geometric normals, camera frame, facing the camera, unless they are not wanted.
    pub normals: Option<NormalMap>,
    /// Normals interpolated between vertices, each the area-weighted mean of its triangles; camera
    /// frame, facing the camera. Made only when asked for.
    pub interpolated_normals: Option<NormalMap>,
    /// What each pixel shows.
    pub sight: Raster<Sight>,
}

impl Rendering {
    /// How many pixels show this.
    pub fn count(&self, sight: Sight) -> usize {
        let all = self.sight.values().iter();
        all.filter(|&&found| found == sight).count()
    }
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

/// What the centres of a view's pixels see, row by row.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Seen {
    /// Indices of the triangles, [`Seen::NO_TRIANGLE`] where there is none.
    pub triangles: Vec<u32>,
    /// z-depth, 0 for nothing.
    pub depth: Vec<f32>,
    /// Geometric unit normals, camera frame, facing the camera; 0 for nothing.
    pub normals: Vec<[f32; 3]>,
    /// Barycentric weights of the triangles' second and third corner; 0 for nothing.
    pub weights: Vec<[f32; 2]>,
}

impl Seen {
    /// Stands for no triangle.
    pub const NO_TRIANGLE: u32 = u32::MAX;

    fn resize(&mut self, count: usize) {
        resize(&mut self.triangles, count, Self::NO_TRIANGLE);
        resize(&mut self.depth, count, 0.0);
        resize(&mut self.normals, count, [0.0; 3]);
        resize(&mut self.weights, count, [0.0; 2]);
    }
}

/// What is new lies in large pages, where there are some.
fn resize<T: Copy>(values: &mut Vec<T>, count: usize, none: T) {
    values.reserve(count.saturating_sub(values.len()));
    in_large_pages(values.spare_capacity_mut());
    values.resize(count, none);
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
    /// Worked out when first wanted.
    vertex_normals: OnceLock<Vec<Vec3>>,
}

impl<'m> Renderer<'m> {
    /// Prepares `mesh`, which must have triangles, and textures of at most 4 GiB each.
    ///
    /// # Errors
    /// A mesh without triangles, and textures of more than 4 GiB.
    pub fn new(mesh: &'m Mesh) -> Result<Self> {
        if mesh.triangles().is_empty() {
            let problem = "expected at least one triangle, found none: nothing can be rendered";
            return Err(Error::invalid("mesh", problem));
        }
        let textures = mesh.materials().iter();
        for texture in textures.filter_map(|material| material.texture.as_ref()) {
            texture::check_size(texture.size())?;
        }
        let bounds = mesh.bounds();
        Ok(Self {
            mesh,
            center: bounds.center(),
            radius: 0.5 * bounds.size().length(),
            clusters: Clusters::new(mesh, bounds.center()),
            vertex_normals: OnceLock::new(),
        })
    }

    fn scenery(&self) -> Scenery<'_> {
        Scenery {
            clusters: &self.clusters,
            radius: self.radius,
        }
    }

    /// Renders `view`.
    ///
    /// # Errors
    /// A number of samples per pixel that is no square from 1 to 64.
    pub fn render(&self, view: &View, options: &RenderOptions) -> Result<Rendering> {
        let side = options.grid()?;
        let normals = options.interpolated_normals.then(|| {
            let all = self
                .vertex_normals
                .get_or_init(|| surface::vertex_normals(self.mesh));
            all.as_slice()
        });
        let frame = Frame::new(self.mesh, self.center, view)
            .with_back_faces(options.back_faces)
            .with_vertex_normals(normals);
        picture::render(self.scenery(), &frame, (side, options))
    }

    /// The first hit of the ray from `origin` (world) along `direction`, with distance in
    /// (`range.0`, `range.1`), on either side of a triangle. A direction that is not finite meets
    /// nothing.
    pub fn first_hit(&self, origin: DVec3, direction: DVec3, range: (f64, f64)) -> Option<Hit> {
        self.first_visible(origin, direction, range).map(Hit::from)
    }

    fn first_visible(&self, origin: DVec3, direction: DVec3, range: (f64, f64)) -> Option<Visible> {
        if !direction.is_finite() {
            return None;
        }
        let probe = Probe::new(origin - self.center, direction);
        let cross = |triangle| self.cross(probe.ray(), triangle, range);
        probe.nearest(&self.clusters, (self.radius, range.1), cross)
    }

    /// Where a ray, counted from the mesh's centre, meets surface of a triangle in a range of distances.
    fn cross(&self, ray: &Ray, triangle: usize, range: (f64, f64)) -> Option<Crossing> {
        let corners = self.mesh.corners(triangle);
        let crossing = ray.cross(corners.map(|corner| corner - self.center));
        crossing.filter(|c| {
            range.0 < c.distance
                && c.distance < range.1
                && surface::is_solid(self.mesh, triangle, c.weights)
        })
    }

    /// As [`Self::first_hit`] for many rays from one point, in their order, on all threads: rays that point
    /// alike are traced together.
    pub fn first_hits(
        &self,
        origin: DVec3,
        directions: &[DVec3],
        range: (f64, f64),
    ) -> Vec<Option<Hit>> {
        let bundle = Bundle {
            origin,
            directions,
            range,
        };
        bundle.first_hits(self)
    }

    /// Whether [`Self::first_hit`] meets something, for many rays from one point, in their order, on all
    /// threads.
    pub fn blocked(&self, origin: DVec3, directions: &[DVec3], range: (f64, f64)) -> Vec<bool> {
        let bundle = Bundle {
            origin,
            directions,
            range,
        };
        bundle.blocked(self)
    }

    /// What the centre of each pixel of `view` sees, into `seen`: depth and normal to the bits that
    /// [`Self::render`] gives, without its colours, and the place on the triangle, worked out in f64.
    /// The camera must have no lens distortion. Both sides of triangles are seen, cut-out parts too.
    ///
    /// # Errors
    /// A camera with a lens.
    pub fn see(&self, view: &View, seen: &mut Seen) -> Result<()> {
        if view.camera.distortion() != Distortion::None {
            let problem = "expected a camera without lens distortion for maps of visibility";
            return Err(Error::invalid(format!("view {}", view.id), problem));
        }
        let frame = Frame::new(self.mesh, self.center, view);
        maps::see(&self.clusters, &frame, seen);
        Ok(())
    }

    /// Whether `hit`, seen along `direction` (world), is the back of a triangle that is no surface
    /// there.
    pub fn is_hollow(&self, hit: &Hit, direction: DVec3, back_faces: BackFaces) -> bool {
        let [a, b, c] = self.mesh.corners(hit.triangle);
        back_faces == BackFaces::Invalid
            && !self.mesh.material_of(hit.triangle).double_sided
            && (b - a).cross(c - a).dot(direction) > 0.0
    }

    /// How many pixels of `view` see the surface: what visibility alone costs.
    pub fn visible_count(&self, view: &View) -> usize {
        let frame = Frame::new(self.mesh, self.center, view);
        picture::visible_count(self.scenery(), &frame)
    }

    /// Bytes that the prepared mesh holds, beside the mesh itself.
    pub fn bytes(&self) -> usize {
        self.clusters.bytes()
    }
}

/// What a rendering has at one pixel, but for its colour.
#[derive(Debug, Clone, Copy)]
struct Pixel {
    depth: f32,
    normal: [f32; 3],
    interpolated: [f32; 3],
    sight: Sight,
}

impl Pixel {
    fn without_surface(sight: Sight) -> Self {
        Self {
            depth: 0.0,
            normal: [0.0; 3],
            interpolated: [0.0; 3],
            sight,
        }
    }

    /// A pixel whose centre, along `direction`, sees `facet` at `distance`.
    fn new(facet: &Facet, distance: f64, direction: DVec3) -> Self {
        let normal = facet.facing_normal(direction).as_vec3().into();
        #[allow(clippy::cast_possible_truncation, reason = "depth maps are f32")]
        Self {
            depth: distance as f32,
            normal,
            interpolated: normal,
            sight: Sight::Surface,
        }
    }
}
