//! The slow, obvious renderer that the fast one is held to: one ray at a time through a binary
//! tree, every candidate triangle tested exactly. For tests.

use super::bvh::Bvh;
use super::eye::Eye;
use super::surface::Frame;
use super::triangle::{Crossing, Ray};
use super::{Hit, Pixel, RenderOptions, Rendering, Visible, mean_color};
use crate::error::Result;
use crate::parallel;
use glam::DVec3;
use mvs_datasets::scene::{Aabb, DepthMap, Mesh, Raster, View};

/// Rounding of coordinates, relative to the largest of them, that boxes are enlarged by.
const ROUNDING: f64 = 1e-13;

/// A mesh with a tree for single rays.
#[derive(Debug)]
pub struct Oracle<'m> {
    mesh: &'m Mesh,
    bvh: Bvh,
    center: DVec3,
    radius: f64,
}

impl<'m> Oracle<'m> {
    /// Prepares a mesh with at least one triangle.
    pub fn new(mesh: &'m Mesh) -> Self {
        let center = mesh.bounds().center();
        let boxes: Vec<Aabb> = (0..mesh.triangles().len())
            .map(|triangle| Aabb::around(mesh.corners(triangle).map(|corner| corner - center)))
            .collect();
        Self {
            mesh,
            bvh: Bvh::new(&boxes),
            center,
            radius: 0.5 * mesh.bounds().size().length(),
        }
    }

    /// As [`super::Renderer::render`], to the same bytes.
    pub fn render(&self, view: &View, options: &RenderOptions) -> Result<Rendering> {
        let side = options.grid()?;
        let (width, height) = (view.camera.width(), view.camera.height());
        let frame = Frame::new(self.mesh, self.center, view);
        let rows = parallel::map(height as usize, |row| {
            let pixel = |column| self.pixel((&frame, view), (column, row), (side, options));
            (0..width as usize).map(pixel).collect::<Vec<_>>()
        });
        assembled((width, height), rows.into_iter().flatten())
    }

    /// As [`super::Renderer::first_hit`].
    pub fn first_hit(&self, origin: DVec3, direction: DVec3, range: (f64, f64)) -> Option<Hit> {
        let origin = origin - self.center;
        let ray = Ray::new(origin, direction);
        let cross = |triangle| {
            let corners = self
                .mesh
                .corners(triangle)
                .map(|corner| corner - self.center);
            ray.cross(corners)
                .filter(|c| range.0 < c.distance && c.distance < range.1)
        };
        self.nearest((origin, direction), range.1, cross)
            .map(Hit::from)
    }

    fn pixel(
        &self,
        (frame, view): (&Frame<'_>, &View),
        (column, row): (usize, usize),
        (side, options): (u32, &RenderOptions),
    ) -> Pixel {
        let look = |side: u32, column: usize, row: usize| {
            let direction = Eye::new(*frame, side).direction(column, row);
            let origin = view.pose.direction_to_world(-frame.center_in_cam());
            let ray = (origin, view.pose.direction_to_world(direction));
            let cross = |triangle| frame.cross(triangle, direction);
            (direction, self.nearest(ray, f64::INFINITY, cross))
        };
        let (direction, center) = look(1, column, row);
        let Some(center) = center else {
            return Pixel::empty(options);
        };
        let count = side as usize;
        let samples = (0..count * count).filter_map(|index| {
            let (right, down) = (index % count, index / count);
            let (direction, seen) = look(side, column * count + right, row * count + down);
            Some(frame.patch(seen?.triangle).color(direction))
        });
        let at_center = || frame.patch(center.triangle).color(direction);
        let color = mean_color(samples, at_center);
        let facet = frame.facet(center.triangle);
        Pixel::new(&facet, center.crossing.distance, direction, color)
    }

    fn nearest(
        &self,
        (origin, direction): (DVec3, DVec3),
        limit: f64,
        cross: impl Fn(usize) -> Option<Crossing>,
    ) -> Option<Visible> {
        let margin = ROUNDING * (self.radius + origin.length());
        let mut best: Option<Visible> = None;
        self.bvh
            .walk(origin, direction, margin, limit, |items, limit| {
                let found = items.iter().filter_map(|&item| {
                    let triangle = item as usize;
                    cross(triangle).map(|crossing| Visible { triangle, crossing })
                });
                best = best.into_iter().chain(found).reduce(Visible::nearer);
                best.map_or(limit, |best| best.crossing.distance)
            });
        best
    }
}

/// A rendering from its pixels, row by row.
fn assembled(
    (width, height): (u32, u32),
    pixels: impl Iterator<Item = Pixel>,
) -> Result<Rendering> {
    let count = width as usize * height as usize;
    let mut color = Vec::with_capacity(count);
    let mut depth = Vec::with_capacity(count);
    let mut normals = Vec::with_capacity(count);
    for pixel in pixels {
        color.push(pixel.color);
        depth.push(pixel.depth);
        normals.push(pixel.normal);
    }
    Ok(Rendering {
        color: Raster::from_values(width, height, color)?,
        depth: DepthMap::from_values(width, height, depth)?.0,
        normals: Raster::from_values(width, height, normals)?,
    })
}
