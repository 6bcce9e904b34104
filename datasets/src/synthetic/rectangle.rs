//! A flat rectangle, with places where something stands on it.

use super::random::Random;
use super::surface::{Patch, Ray, Sample, Surface, cells, jittered_grid};
use glam::{DVec2, DVec3};
use libm::{cos, hypot, sin};

/// Where a solid stands on a rectangle, in the rectangle's own coordinates in world units. That part
/// is covered.
#[derive(Debug, Clone, Copy)]
pub(super) enum Footprint {
    Disc {
        center: DVec2,
        radius: f64,
    },
    /// A rectangle turned by `yaw` radians.
    Quad {
        center: DVec2,
        half: DVec2,
        yaw: f64,
    },
}

impl Footprint {
    /// How far inside the footprint `point` is: distance to its border, `None` outside.
    fn depth_inside(&self, point: DVec2) -> Option<f64> {
        let depth = match *self {
            Self::Disc { center, radius } => radius - (point - center).length(),
            Self::Quad { center, half, yaw } => {
                let local = DVec2::from_angle(-yaw).rotate(point - center);
                (half - local.abs()).min_element()
            }
        };
        (depth > 0.0).then_some(depth)
    }
}

/// A rectangle from a corner and two orthogonal edges; its outside is where edge_u × edge_v points.
/// Footprints do not overlap and lie inside.
#[derive(Debug, Clone)]
pub(super) struct Rectangle {
    corner: DVec3,
    edge_u: DVec3,
    edge_v: DVec3,
    footprints: Vec<Footprint>,
}

impl Rectangle {
    pub(super) fn new(corner: DVec3, edge_u: DVec3, edge_v: DVec3) -> Self {
        Self {
            corner,
            edge_u,
            edge_v,
            footprints: Vec::new(),
        }
    }

    /// The same rectangle with something standing on it.
    pub(super) fn under(mut self, footprint: Footprint) -> Self {
        self.footprints.push(footprint);
        self
    }

    fn size(&self) -> DVec2 {
        DVec2::new(self.edge_u.length(), self.edge_v.length())
    }

    fn normal(&self) -> DVec3 {
        self.edge_u.cross(self.edge_v).normalize()
    }

    /// Coordinates along the edges and above the plane, in world units.
    fn local(&self, point: DVec3) -> (DVec2, f64) {
        let offset = point - self.corner;
        let along = DVec2::new(offset.dot(self.edge_u), offset.dot(self.edge_v)) / self.size();
        (along, offset.dot(self.normal()))
    }

    fn covered(&self, along: DVec2) -> Option<f64> {
        self.footprints
            .iter()
            .find_map(|footprint| footprint.depth_inside(along))
    }
}

impl Surface for Rectangle {
    fn hit(&self, ray: &Ray) -> Option<f64> {
        let normal = self.edge_u.cross(self.edge_v);
        let t = normal.dot(self.corner - ray.origin) / normal.dot(ray.direction);
        if !(t.is_finite() && t > 0.0) {
            return None;
        }
        let offset = ray.at(t) - self.corner;
        let u = offset.dot(self.edge_u) / self.edge_u.length_squared();
        let v = offset.dot(self.edge_v) / self.edge_v.length_squared();
        let inside = (0.0..=1.0).contains(&u) && (0.0..=1.0).contains(&v);
        inside.then_some(t)
    }

    fn distance(&self, point: DVec3) -> f64 {
        let (along, height) = self.local(point);
        let nearest = along.clamp(DVec2::ZERO, self.size());
        let aside = (along - nearest).length();
        hypot(aside.max(self.covered(nearest).unwrap_or(0.0)), height)
    }

    fn sample(&self, spacing: f64, random: &mut Random) -> Vec<Sample> {
        let size = self.size();
        let (columns, rows) = (cells(size.x, spacing), cells(size.y, spacing));
        let normal = self.normal();
        jittered_grid(columns, rows, random)
            .into_iter()
            .filter(|&uv| self.covered(uv * size).is_none())
            .map(|uv| Sample {
                position: self.corner + uv.x * self.edge_u + uv.y * self.edge_v,
                normal,
                uv,
            })
            .collect()
    }

    fn area(&self) -> f64 {
        self.edge_u.cross(self.edge_v).length()
    }

    fn outline(&self) -> Vec<DVec3> {
        let (a, u, v) = (self.corner, self.edge_u, self.edge_v);
        vec![a, a + u, a + u + v, a + v]
    }

    fn patch(&self) -> Patch {
        Patch::grid(1, 1, |uv| {
            self.corner + uv.x * self.edge_u + uv.y * self.edge_v
        })
    }
}

/// Five faces of a box that stands on a plane: `base` is a corner of the covered face, `x` and `y`
/// its edges, `up` the edge that leads away from the plane; x × y points along `up`.
pub(super) fn standing_box(base: DVec3, x: DVec3, y: DVec3, up: DVec3) -> Vec<Rectangle> {
    vec![
        Rectangle::new(base, x, up),
        Rectangle::new(base + x, y, up),
        Rectangle::new(base + x + y, -x, up),
        Rectangle::new(base + y, -y, up),
        Rectangle::new(base + up, x, y),
    ]
}

/// The four walls and the top of an upright box: `center` is the middle of its bottom, `size` its
/// edge lengths, `yaw` its turn about +Z in radians.
pub(super) fn upright_box(center: DVec3, size: DVec3, yaw: f64) -> Vec<Rectangle> {
    let x = DVec3::new(cos(yaw), sin(yaw), 0.0) * size.x;
    let y = DVec3::new(-sin(yaw), cos(yaw), 0.0) * size.y;
    standing_box(center - 0.5 * (x + y), x, y, DVec3::Z * size.z)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ground() -> Rectangle {
        let corner = DVec3::new(-2.0, -1.0, 0.0);
        Rectangle::new(corner, 4.0 * DVec3::X, 2.0 * DVec3::Y).under(Footprint::Disc {
            center: DVec2::new(1.0, 1.0),
            radius: 0.5,
        })
    }

    #[test]
    fn distance_is_to_the_exposed_part() {
        let distance = |x, y, z| ground().distance(DVec3::new(x, y, z));
        assert_eq!(distance(1.0, 0.0, 0.25), 0.25);
        assert_eq!(
            distance(5.0, 5.0, 0.0),
            5.0,
            "3 aside and 4 aside of a corner"
        );
        assert_eq!(
            distance(-1.0, 0.0, 0.0),
            0.5,
            "the middle of the covered disc"
        );
        assert!((distance(-1.2, 0.0, 0.4) - 0.5).abs() < 1e-15);
    }

    #[test]
    fn walls_of_a_box_face_outward() {
        let center = DVec3::new(1.0, 2.0, 0.0);
        let sides = upright_box(center, DVec3::new(1.0, 2.0, 3.0), 0.4);
        let middle = center + 1.5 * DVec3::Z;
        for side in &sides {
            let face = side.corner + 0.5 * (side.edge_u + side.edge_v);
            assert!(side.normal().dot(face - middle) > 0.4);
        }
        let area: f64 = sides.iter().map(Surface::area).sum();
        assert!((area - (2.0 * 3.0 * (1.0 + 2.0) + 2.0)).abs() < 1e-12);
    }

    #[test]
    fn a_ray_meets_the_plane_inside_the_edges_only() {
        let down = |x: f64, y: f64| {
            ground().hit(&Ray {
                origin: DVec3::new(x, y, 3.0),
                direction: DVec3::NEG_Z,
            })
        };
        assert_eq!(down(1.9, 0.9), Some(3.0));
        assert_eq!(down(2.1, 0.0), None);
        let sideways = Ray {
            origin: DVec3::new(-9.0, 0.0, 1.0),
            direction: DVec3::X,
        };
        assert_eq!(ground().hit(&sideways), None);
    }
}
