//! The slow, obvious renderer that the fast one is held to: one ray at a time through a binary
//! tree, every candidate triangle tested exactly. For tests.

use super::bvh::Bvh;
use super::eye::Eye;
use super::picture::Maps;
use super::sight::{Samples, Sight};
use super::surface::{self, Frame};
use super::texture::Parts;
use super::triangle::{Crossing, Ray};
use super::{Hit, Pixel, RenderOptions, Rendering, Visible};
use crate::error::Result;
use crate::parallel;
use glam::DVec3;
use mvs_datasets::scene::{Aabb, Mesh, View};

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
    ///
    /// # Errors
    /// As [`super::Renderer::render`].
    pub fn render(&self, view: &View, options: &RenderOptions) -> Result<Rendering> {
        let side = options.grid()?;
        let (width, height) = (view.camera.width(), view.camera.height());
        let normals = options
            .interpolated_normals
            .then(|| surface::vertex_normals(self.mesh));
        let frame = Frame::new(self.mesh, self.center, view)
            .with_back_faces(options.back_faces)
            .with_vertex_normals(normals.as_deref());
        let rows = parallel::map(height as usize, |row| {
            let pixel = |column| self.pixel((&frame, view), (column, row), side);
            (0..width as usize).map(pixel).collect::<Vec<_>>()
        });
        let count = width as usize * height as usize;
        let mut maps = Maps::empty((width as usize, count), options);
        for (index, (pixel, painted)) in rows.into_iter().flatten().enumerate() {
            maps.set(index, &pixel);
            if let Some((samples, center)) = painted {
                maps.paint(index, samples, || center);
            }
        }
        maps.finish((width, height))
    }

    /// As [`super::Renderer::first_hit`].
    pub fn first_hit(&self, origin: DVec3, direction: DVec3, range: (f64, f64)) -> Option<Hit> {
        if !direction.is_finite() {
            return None;
        }
        let origin = origin - self.center;
        let ray = Ray::new(origin, direction);
        let cross = |triangle| {
            let corners = self
                .mesh
                .corners(triangle)
                .map(|corner| corner - self.center);
            ray.cross(corners)
                .filter(|c| range.0 < c.distance && c.distance < range.1)
                .filter(|c| surface::is_solid(self.mesh, triangle, c.weights))
        };
        self.nearest((origin, direction), range.1, cross)
            .map(Hit::from)
    }

    /// A pixel; if it shows surface, its samples, and the colour at its centre.
    fn pixel(
        &self,
        (frame, view): (&Frame<'_>, &View),
        (column, row): (usize, usize),
        side: u32,
    ) -> (Pixel, Option<(Samples, Parts)>) {
        let look = |side: u32, column: usize, row: usize| {
            let direction = Eye::new(*frame, side).direction(column, row);
            if !direction.is_finite() {
                return (direction, None);
            }
            let origin = view.pose.direction_to_world(-frame.center_in_cam());
            let ray = (origin, view.pose.direction_to_world(direction));
            let cross = |triangle| {
                let crossing = frame.cross(triangle, direction);
                crossing.filter(|c| frame.is_solid(triangle, c.weights))
            };
            (direction, self.nearest(ray, f64::INFINITY, cross))
        };
        let (direction, center) = look(1, column, row);
        let Some(center) = center else {
            let sight = match direction.is_finite() {
                true => Sight::Nothing,
                false => Sight::NoRay,
            };
            return (Pixel::without_surface(sight), None);
        };
        let facet = frame.facet(center.triangle);
        if facet.is_hollow() {
            return (Pixel::without_surface(Sight::BackFace), None);
        }
        let mut pixel = Pixel::new(&facet, center.crossing.distance, direction);
        let (of, weights) = ((center.triangle, &facet), center.crossing.weights);
        let normal = frame.interpolated_normal(of, weights, direction);
        pixel.interpolated = normal.as_vec3().into();
        let count = side as usize;
        let mut samples = Samples::default();
        for index in 0..count * count {
            let (right, down) = (index % count, index / count);
            let (direction, seen) = look(side, column * count + right, row * count + down);
            let seen = seen.map(|seen| frame.patch(seen.triangle).glimpse(direction));
            samples.add(seen, f64::from(pixel.depth));
        }
        let at_center = frame.patch(center.triangle).glimpse(direction).color;
        (pixel, Some((samples, at_center)))
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
