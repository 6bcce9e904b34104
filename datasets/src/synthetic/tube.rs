//! The side of an upright cylinder.

use super::random::Random;
use super::surface::{Patch, Ray, Sample, Surface, cells, jittered_grid};
use glam::{DVec2, DVec3};
use libm::{cos, hypot};
use std::f64::consts::{PI, TAU};

/// Cells around the tessellated tube.
const AROUND: u32 = 64;

/// The side of a cylinder about a vertical axis; its ends are open, something else closes them.
#[derive(Debug, Clone)]
pub(super) struct Tube {
    foot: DVec3,
    height: f64,
    radius: f64,
}

impl Tube {
    /// A tube from the middle of its lower end.
    pub(super) fn new(foot: DVec3, height: f64, radius: f64) -> Self {
        Self {
            foot,
            height,
            radius,
        }
    }

    fn point(&self, uv: DVec2) -> DVec3 {
        let around = DVec2::from_angle(TAU * (uv.x % 1.0)) * self.radius;
        self.foot + around.extend(uv.y * self.height)
    }
}

impl Surface for Tube {
    fn hit(&self, ray: &Ray) -> Option<f64> {
        let (from, along) = (
            (ray.origin - self.foot).truncate(),
            ray.direction.truncate(),
        );
        let (a, b) = (along.length_squared(), from.dot(along));
        let nearest = from - (b / a) * along;
        let discriminant = a * (self.radius * self.radius - nearest.length_squared());
        if discriminant.is_nan() || discriminant < 0.0 {
            return None;
        }
        let root = discriminant.sqrt();
        [(-b - root) / a, (-b + root) / a].into_iter().find(|&t| {
            let above = ray.at(t).z - self.foot.z;
            t > 0.0 && (0.0..=self.height).contains(&above)
        })
    }

    fn distance(&self, point: DVec3) -> f64 {
        let offset = point - self.foot;
        let aside = offset.truncate().length() - self.radius;
        let beyond = offset.z - offset.z.clamp(0.0, self.height);
        hypot(aside, beyond)
    }

    fn sample(&self, spacing: f64, random: &mut Random) -> Vec<Sample> {
        let columns = cells(TAU * self.radius, spacing);
        let rows = cells(self.height, spacing);
        jittered_grid(columns, rows, random)
            .into_iter()
            .map(|uv| Sample {
                position: self.point(uv),
                normal: DVec2::from_angle(TAU * uv.x).extend(0.0),
                uv,
            })
            .collect()
    }

    fn area(&self) -> f64 {
        TAU * self.radius * self.height
    }

    fn outline(&self) -> Vec<DVec3> {
        let r = self.radius;
        let at = |x: f64, y: f64, z: f64| self.foot + DVec3::new(x, y, z);
        [0.0, self.height]
            .into_iter()
            .flat_map(|z| [at(-r, -r, z), at(r, -r, z), at(-r, r, z), at(r, r, z)])
            .collect()
    }

    fn patch(&self) -> Patch {
        let mut patch = Patch::grid(AROUND, 1, |uv| self.point(uv));
        patch.deviation = self.radius * (1.0 - cos(PI / f64::from(AROUND)));
        patch
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rays_and_distances_by_hand() {
        let tube = Tube::new(DVec3::new(1.0, 0.0, 0.0), 2.0, 0.5);
        let ray = |z: f64, slope: f64| Ray {
            origin: DVec3::new(-2.0, 0.0, z),
            direction: DVec3::new(1.0, 0.0, slope),
        };
        assert_eq!(tube.hit(&ray(1.0, 0.0)), Some(2.5));
        assert_eq!(tube.hit(&ray(2.5, 0.0)), None, "above");
        let through = tube.hit(&ray(4.75, -1.0)).unwrap();
        assert!(
            (through - 3.5).abs() < 1e-15,
            "over the near rim, onto the far inside"
        );
        let up = Ray {
            origin: DVec3::new(1.0, 0.0, -1.0),
            direction: DVec3::Z,
        };
        assert_eq!(tube.hit(&up), None);
        assert_eq!(tube.distance(DVec3::new(1.0, 0.0, 1.0)), 0.5);
        let beyond = tube.distance(DVec3::new(1.8, 0.0, 2.4));
        assert!((beyond - 0.5).abs() < 1e-15, "0.3 aside and 0.4 above");
    }

    #[test]
    fn triangles_face_outward_and_stray_no_farther_than_said() {
        let tube = Tube::new(DVec3::ZERO, 2.0, 0.5);
        let patch = tube.patch();
        for triangle in &patch.triangles {
            let [a, b, c] = triangle.map(|vertex| patch.vertices[vertex as usize]);
            let middle = (a + b + c) / 3.0;
            assert!((b - a).cross(c - a).dot(middle.with_z(0.0)) > 0.0);
            for point in [middle, 0.5 * (a + b), 0.5 * (a + c)] {
                assert!(tube.distance(point) <= patch.deviation * (1.0 + 1e-9));
            }
        }
    }
}
