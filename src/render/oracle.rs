//! The slow, obvious way to find what is visible: one ray at a time through a binary tree, every
//! candidate triangle tested exactly.

use super::bvh::Bvh;
use super::surface::Frame;
use super::triangle::{Crossing, Ray};
use super::{Hit, Visible};
use glam::DVec3;
use mvs_datasets::scene::{Aabb, Mesh};

/// Rounding of coordinates, relative to the largest of them, that boxes are enlarged by.
const ROUNDING: f64 = 1e-13;

/// A mesh with a tree for single rays.
#[derive(Debug)]
pub(crate) struct Oracle {
    bvh: Bvh,
    center: DVec3,
    radius: f64,
}

impl Oracle {
    /// Prepares a mesh with at least one triangle.
    pub(crate) fn new(mesh: &Mesh, center: DVec3) -> Self {
        let boxes: Vec<Aabb> = (0..mesh.triangles().len())
            .map(|triangle| Aabb::around(mesh.corners(triangle).map(|corner| corner - center)))
            .collect();
        Self {
            bvh: Bvh::new(&boxes),
            center,
            radius: 0.5 * mesh.bounds().size().length(),
        }
    }

    /// What is seen along `direction` of the camera frame: the nearest triangle, the lower index
    /// where two are equally near. `origin` and `direction_in_world` are the same ray in the world,
    /// counted from the mesh's centre.
    pub(crate) fn look(
        &self,
        frame: &Frame<'_>,
        direction: DVec3,
        (origin, direction_in_world): (DVec3, DVec3),
    ) -> Option<Visible> {
        self.nearest((origin, direction_in_world), f64::INFINITY, |triangle| {
            frame.cross(triangle, direction)
        })
    }

    /// The first hit of a ray in the world with distance in (`range.0`, `range.1`).
    pub(crate) fn first_hit(
        &self,
        mesh: &Mesh,
        (origin, direction): (DVec3, DVec3),
        range: (f64, f64),
    ) -> Option<Hit> {
        let origin = origin - self.center;
        let ray = Ray::new(origin, direction);
        let cross = |triangle| {
            let corners = mesh.corners(triangle).map(|corner| corner - self.center);
            ray.cross(corners)
                .filter(|c| range.0 < c.distance && c.distance < range.1)
        };
        self.nearest((origin, direction), range.1, cross)
            .map(|visible| Hit {
                triangle: visible.triangle,
                distance: visible.crossing.distance,
                weights: visible.crossing.weights,
            })
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
