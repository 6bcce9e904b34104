//! Mesh + view → depth, colour, normals.
//!
//! What is visible at an image position is decided by an exact test in f64 (`triangle`): the
//! nearest triangle, and of two equally near the one with the lower index. Both sides of a triangle
//! are surface. Depth and normals belong to the pixel's centre and are never averaged; colour is the
//! mean of a regular grid of samples, each with its own visibility.

mod bvh;
mod oracle;
mod surface;
mod texture;
mod triangle;

use crate::error::{Error, Result};
use crate::parallel;
use glam::{DVec2, DVec3, Vec3};
use mvs_datasets::scene::{ColorImage, DepthMap, Mesh, NormalMap, Raster, View};
use oracle::Oracle;
use serde::{Deserialize, Serialize};
use surface::Frame;
use triangle::Crossing;

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

/// A mesh prepared for rendering from any view.
#[derive(Debug)]
pub struct Renderer<'m> {
    mesh: &'m Mesh,
    center: DVec3,
    oracle: Oracle,
}

impl<'m> Renderer<'m> {
    /// Prepares `mesh`, which must have triangles.
    pub fn new(mesh: &'m Mesh) -> Result<Self> {
        if mesh.triangles().is_empty() {
            let problem = "expected at least one triangle, found none: nothing can be rendered";
            return Err(Error::invalid("mesh", problem));
        }
        let center = mesh.bounds().center();
        Ok(Self {
            mesh,
            center,
            oracle: Oracle::new(mesh, center),
        })
    }

    /// Renders `view`.
    pub fn render(&self, view: &View, options: &RenderOptions) -> Result<Rendering> {
        let side = options.grid()?;
        let (width, height) = (view.camera.width(), view.camera.height());
        let lens = Lens::new(self, view);
        let rows = parallel::map(height as usize, |row| {
            let pixel =
                |column| lens.pixel(DVec2::new(f64::from(column), row as f64), side, options);
            (0..width).map(pixel).collect::<Vec<_>>()
        });
        let pixels = || rows.iter().flatten();
        let depth = pixels().map(|pixel| pixel.depth).collect();
        Ok(Rendering {
            color: Raster::from_values(width, height, pixels().map(|p| p.color).collect())?,
            depth: DepthMap::from_values(width, height, depth)?.0,
            normals: Raster::from_values(width, height, pixels().map(|p| p.normal).collect())?,
        })
    }

    /// The first hit of the ray from `origin` (world) along `direction`, with distance in
    /// (`range.0`, `range.1`).
    pub fn first_hit(&self, origin: DVec3, direction: DVec3, range: (f64, f64)) -> Option<Hit> {
        self.oracle.first_hit(self.mesh, (origin, direction), range)
    }
}

struct Pixel {
    color: [u8; 3],
    depth: f32,
    normal: [f32; 3],
}

/// A renderer that looks through one view.
struct Lens<'r> {
    renderer: &'r Renderer<'r>,
    view: &'r View,
    frame: Frame<'r>,
    /// The camera, counted from the mesh's centre.
    origin: DVec3,
}

impl<'r> Lens<'r> {
    fn new(renderer: &'r Renderer<'r>, view: &'r View) -> Self {
        let frame = Frame::new(renderer.mesh, renderer.center, view);
        let origin = view.pose.direction_to_world(-frame.center_in_cam());
        Self {
            renderer,
            view,
            frame,
            origin,
        }
    }

    /// What is seen at continuous image coordinates, and along which direction.
    fn look(&self, position: DVec2) -> (DVec3, Option<Visible>) {
        let direction = self.frame.direction(position);
        let in_world = (self.origin, self.view.pose.direction_to_world(direction));
        let visible = self.renderer.oracle.look(&self.frame, direction, in_world);
        (direction, visible)
    }

    /// The pixel whose top-left outer corner is `corner`.
    fn pixel(&self, corner: DVec2, side: u32, options: &RenderOptions) -> Pixel {
        let (direction, center) = self.look(corner + 0.5);
        let Some(center) = center else {
            return Pixel {
                color: options.background,
                depth: 0.0,
                normal: [0.0; 3],
            };
        };
        #[allow(clippy::cast_possible_truncation, reason = "depth maps are f32")]
        Pixel {
            color: self.color(corner, side, &center),
            depth: center.crossing.distance as f32,
            normal: self
                .frame
                .facing_normal(center.triangle, direction)
                .as_vec3()
                .into(),
        }
    }

    /// The mean colour of the samples that meet the surface; the centre's if none does.
    fn color(&self, corner: DVec2, side: u32, center: &Visible) -> [u8; 3] {
        let shade = |seen: &Visible| self.frame.color(seen.triangle, seen.crossing.weights);
        let (mut sum, mut count) = (Vec3::ZERO, 0.0);
        for index in 0..side * side {
            let cell = DVec2::new(f64::from(index % side), f64::from(index / side));
            if let Some(seen) = self.look(corner + (cell + 0.5) / f64::from(side)).1 {
                sum += shade(&seen);
                count += 1.0;
            }
        }
        let mean = if count > 0.0 {
            sum / count
        } else {
            shade(center)
        };
        #[allow(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "a mean of 8-bit values"
        )]
        mean.to_array().map(|value| value.round() as u8)
    }
}
