//! A sphere, cut off where it stands on the ground.

use super::random::Random;
use super::surface::{Patch, Ray, Sample, Surface, cells};
use glam::{DVec2, DVec3};
use libm::{acos, cos, hypot, sin};
use std::f64::consts::{PI, TAU};

/// Cells around the tessellated sphere, unless said otherwise.
const AROUND: u32 = 192;

/// The part of a sphere at or above z = `floor`; −∞ for all of it. The floor is below the top.
#[derive(Debug, Clone)]
pub(super) struct Sphere {
    center: DVec3,
    radius: f64,
    floor: f64,
    /// Cells around; half as many from top to floor.
    around: u32,
}

impl Sphere {
    pub(super) fn new(center: DVec3, radius: f64, floor: f64) -> Self {
        Self {
            center,
            radius,
            floor,
            around: AROUND,
        }
    }

    /// The same sphere tessellated with `around` cells around it.
    pub(super) fn with_cells(self, around: u32) -> Self {
        Self { around, ..self }
    }

    fn down(&self) -> u32 {
        (self.around / 2).max(1)
    }

    /// The radius of the circle in which the sphere meets its floor.
    pub(super) fn rim(&self) -> f64 {
        let drop = self.center.z - self.floor;
        (self.radius * self.radius - drop * drop).max(0.0).sqrt()
    }

    /// The height of the exposed cap.
    fn height(&self) -> f64 {
        (self.center.z + self.radius - self.floor).min(2.0 * self.radius)
    }

    /// The angle between the top and the floor, seen from the centre.
    fn extent(&self) -> f64 {
        acos((1.0 - self.height() / self.radius).clamp(-1.0, 1.0))
    }

    fn point(&self, azimuth: f64, polar: f64) -> DVec3 {
        let around = sin(polar);
        let unit = DVec3::new(around * cos(azimuth), around * sin(azimuth), cos(polar));
        self.center + self.radius * unit
    }

    /// A cell's four corners lie in one plane; the surface bulges over it by at most the radius
    /// less the plane's distance from the centre.
    fn deviation(&self) -> f64 {
        let half = cos(0.5 * TAU / f64::from(self.around));
        let step = self.extent() / f64::from(self.down());
        let bulge = |row: u32| {
            let (upper, lower) = (step * f64::from(row), step * f64::from(row + 1));
            let across = half * (sin(lower) - sin(upper));
            let along = cos(lower) - cos(upper);
            1.0 - half * sin(step) / hypot(across, along)
        };
        self.radius * (0..self.down()).map(bulge).fold(0.0, f64::max)
    }
}

impl Surface for Sphere {
    fn hit(&self, ray: &Ray) -> Option<f64> {
        let from_center = ray.origin - self.center;
        let a = ray.direction.length_squared();
        let b = from_center.dot(ray.direction);
        // The discriminant from the ray's distance to the centre: no cancellation far away.
        let nearest = from_center - (b / a) * ray.direction;
        let discriminant = a * (self.radius * self.radius - nearest.length_squared());
        if discriminant < 0.0 {
            return None;
        }
        let root = discriminant.sqrt();
        [(-b - root) / a, (-b + root) / a]
            .into_iter()
            .find(|&t| t > 0.0 && ray.at(t).z >= self.floor)
    }

    fn distance(&self, point: DVec3) -> f64 {
        let offset = point - self.center;
        let length = offset.length();
        let nearest_z = self.center.z + offset.z * (self.radius / length);
        if length > 0.0 && nearest_z < self.floor {
            let aside = offset.truncate().length() - self.rim();
            return hypot(aside, point.z - self.floor);
        }
        (length - self.radius).abs()
    }

    /// A spiral: equal steps in height are equal areas, and the golden angle spreads them.
    fn sample(&self, spacing: f64, random: &mut Random) -> Vec<Sample> {
        let golden = PI * (3.0 - 5.0f64.sqrt());
        let count = cells(self.area(), spacing * spacing);
        let phase = random.between(0.0, TAU);
        let (height, extent) = (self.height(), self.extent());
        let sample = |index: u32| {
            let below_top = height * (f64::from(index) + 0.5) / f64::from(count);
            let polar = acos(1.0 - below_top / self.radius);
            let azimuth = (phase + golden * f64::from(index)).rem_euclid(TAU);
            let position = self.point(azimuth, polar);
            Sample {
                position,
                normal: (position - self.center) / self.radius,
                uv: DVec2::new(azimuth / TAU, 1.0 - polar / extent),
            }
        };
        (0..count).map(sample).collect()
    }

    fn area(&self) -> f64 {
        TAU * self.radius * self.height()
    }

    fn outline(&self) -> Vec<DVec3> {
        let corner = |bits: u32| {
            let sign = |bit: u32| if bits & bit == 0 { -1.0 } else { 1.0 };
            let corner = self.center + self.radius * DVec3::new(sign(1), sign(2), sign(4));
            corner.with_z(corner.z.max(self.floor))
        };
        (0..8).map(corner).collect()
    }

    fn patch(&self) -> Patch {
        let extent = self.extent();
        let mut patch = Patch::grid(self.around, self.down(), |uv| {
            // The seam closes exactly.
            self.point(TAU * (uv.x % 1.0), extent * (1.0 - uv.y))
        });
        patch.deviation = self.deviation();
        patch
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn dome() -> Sphere {
        Sphere::new(DVec3::new(1.0, 2.0, 0.3), 0.5, 0.0)
    }

    #[test]
    fn distance_below_the_floor_is_to_the_rim() {
        assert!((dome().rim() - 0.4).abs() < 1e-15);
        let below = DVec3::new(1.0 + 0.4 + 0.03, 2.0, -0.04);
        assert!((dome().distance(below) - 0.05).abs() < 1e-14);
        assert!((dome().distance(DVec3::new(1.0, 2.0, 1.0)) - 0.2).abs() < 1e-15);
        assert!((dome().distance(DVec3::new(1.0, 2.0, 0.3)) - 0.5).abs() < 1e-15);
    }

    #[test]
    fn triangles_stray_no_farther_than_said_and_nearly_as_far() {
        for sphere in [dome(), Sphere::new(DVec3::ZERO, 2.0, f64::NEG_INFINITY)] {
            let patch = sphere.patch();
            let mut worst = 0.0f64;
            for triangle in &patch.triangles {
                let [a, b, c] = triangle.map(|vertex| patch.vertices[vertex as usize]);
                for (u, v) in [(0.5, 0.5), (0.25, 0.5), (1.0 / 3.0, 1.0 / 3.0), (0.0, 0.5)] {
                    let inside = a + u * (b - a) + v * (c - a);
                    worst = worst.max(sphere.radius - (inside - sphere.center).length());
                }
                let outward = (b - a).cross(c - a).dot((a + b + c) / 3.0 - sphere.center);
                assert!(outward > 0.0, "counter-clockwise from outside");
            }
            assert!(worst <= patch.deviation * (1.0 + 1e-9));
            assert!(worst > 0.9 * patch.deviation, "{worst} {}", patch.deviation);
            let rim_gap = patch.vertices.iter().map(|v| v.z - sphere.floor);
            assert!(rim_gap.fold(f64::INFINITY, f64::min) > -1e-12);
        }
    }

    #[test]
    fn a_ray_through_the_cut_meets_the_inside() {
        let up = Ray {
            origin: DVec3::new(1.0, 2.0, -1.0),
            direction: DVec3::Z,
        };
        assert!((dome().hit(&up).unwrap() - 1.8).abs() < 1e-15);
        let aside = Ray {
            origin: DVec3::new(1.6, 2.0, -1.0),
            direction: DVec3::Z,
        };
        assert_eq!(dome().hit(&aside), None);
    }
}
