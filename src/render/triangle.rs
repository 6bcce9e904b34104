//! The exact ray/triangle test that decides every hit.
//!
//! Woop, Benthin and Wald, "Watertight Ray/Triangle Intersection" (JCGT 2013), in f64: the ray is
//! sheared onto a coordinate axis, which leaves a point-in-triangle test in the plane. A sheared
//! corner depends on the ray and the corner alone, and the sign of a difference of two rounded
//! products is never wrong, only zero, which counts as inside; so no ray slips between triangles
//! that share an edge or a corner.

use glam::DVec3;

/// A ray in the form in which triangles are tested against it. Distances are counted in the
/// length of its direction.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Ray {
    /// Where it starts.
    origin: DVec3,
    axes: [usize; 3],
    shear: [f64; 2],
    scale: f64,
}

/// The axis along which a direction reaches farthest.
pub(crate) fn longest_axis(direction: DVec3) -> usize {
    let size = direction.abs();
    if size.x > size.y.max(size.z) {
        0
    } else if size.y > size.z {
        1
    } else {
        2
    }
}

/// Where a line meets a triangle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Crossing {
    /// In units of the ray's direction; negative behind the origin.
    pub(crate) distance: f64,
    /// Barycentric weights of the second and third corner.
    pub(crate) weights: [f64; 2],
}

impl Ray {
    /// A ray in any direction but zero.
    pub(crate) fn new(origin: DVec3, direction: DVec3) -> Self {
        Self::along_axis(origin, direction, longest_axis(direction))
    }

    /// A ray of a pinhole camera, in the camera's frame: through the point `direction` at depth 1.
    pub(crate) fn of_pixel(direction: DVec3) -> Self {
        Self::along_axis(DVec3::ZERO, direction, 2)
    }

    fn along_axis(origin: DVec3, direction: DVec3, along: usize) -> Self {
        let axes = [(along + 1) % 3, (along + 2) % 3, along];
        let scale = 1.0 / direction[along];
        Self {
            origin,
            axes,
            shear: [direction[axes[0]] * scale, direction[axes[1]] * scale],
            scale,
        }
    }

    /// The axes (two across, one along) and how much of the last is taken from the first two.
    pub(crate) fn shearing(&self) -> ([usize; 3], [f64; 2]) {
        (self.axes, self.shear)
    }

    /// Where the line through the ray meets the triangle, borders included; `None` also for
    /// triangles seen edge-on or without area.
    pub(crate) fn cross(&self, corners: [DVec3; 3]) -> Option<Crossing> {
        let [a, b, c] = corners.map(|corner| self.sheared(corner));
        let u = c.x * b.y - c.y * b.x;
        let v = a.x * c.y - a.y * c.x;
        let w = b.x * a.y - b.y * a.x;
        if (u < 0.0 || v < 0.0 || w < 0.0) && (u > 0.0 || v > 0.0 || w > 0.0) {
            return None;
        }
        let total = u + v + w;
        if total == 0.0 {
            return None;
        }
        let weights = thin_weights([a, b, c], total).unwrap_or([v / total, w / total]);
        let depth = (1.0 - weights[0] - weights[1]) * a.z + weights[0] * b.z + weights[1] * c.z;
        Some(Crossing {
            distance: self.scale * depth,
            weights,
        })
    }

    fn sheared(&self, corner: DVec3) -> DVec3 {
        let relative = corner - self.origin;
        let along = relative[self.axes[2]];
        DVec3::new(
            relative[self.axes[0]] - self.shear[0] * along,
            relative[self.axes[1]] - self.shear[1] * along,
            along,
        )
    }
}

/// Twice the area over the longest edge squared, on the plane across the ray, below which a triangle
/// counts as its longest edge: weights from areas would be rounding noise.
pub(crate) const THIN: f64 = 1e-9;

/// Weights of the second and third corner where the ray passes closest to the longest edge, if the
/// triangle is thin as the ray sees it.
#[inline]
fn thin_weights(corners: [DVec3; 3], total: f64) -> Option<[f64; 2]> {
    let flat = corners.map(DVec3::truncate);
    let length = |edge: usize| flat[edge].distance_squared(flat[(edge + 1) % 3]);
    let lengths = [length(0), length(1), length(2)];
    let longest = lengths[0].max(lengths[1]).max(lengths[2]);
    if total.abs() >= THIN * longest {
        return None;
    }
    let first = lengths
        .iter()
        .position(|&length| length == longest)
        .unwrap_or_default();
    let second = (first + 1) % 3;
    let along = flat[second] - flat[first];
    let mut weights = [0.0; 3];
    weights[second] = (-flat[first].dot(along) / longest).clamp(0.0, 1.0);
    weights[first] = 1.0 - weights[second];
    Some([weights[1], weights[2]])
}

#[cfg(test)]
mod tests {
    use super::*;

    const CORNERS: [DVec3; 3] = [
        DVec3::new(0.0, 0.0, 4.0),
        DVec3::new(2.0, 0.0, 4.0),
        DVec3::new(0.0, 2.0, 8.0),
    ];

    #[test]
    fn distance_and_weights_follow_from_the_plane() {
        let target = 0.5 * CORNERS[0] + 0.2 * CORNERS[1] + 0.3 * CORNERS[2];
        for origin in [DVec3::ZERO, DVec3::new(3.0, -5.0, 1.0), DVec3::splat(50.0)] {
            let ray = Ray::new(origin, (target - origin) / 7.0);
            let crossing = ray.cross(CORNERS).unwrap();
            assert!((crossing.distance - 7.0).abs() < 1e-12, "{crossing:?}");
            assert!((crossing.weights[0] - 0.2).abs() < 1e-12, "{crossing:?}");
            assert!((crossing.weights[1] - 0.3).abs() < 1e-12, "{crossing:?}");
        }
    }

    #[test]
    fn behind_is_negative_and_beside_is_nothing() {
        let inside = (CORNERS[0] + CORNERS[1] + CORNERS[2]) / 3.0;
        let crossing = Ray::new(DVec3::ZERO, -inside).cross(CORNERS).unwrap();
        assert!((crossing.distance + 1.0).abs() < 1e-12);
        let beside = DVec3::new(-0.01, 1.0, 6.0);
        assert_eq!(Ray::new(DVec3::ZERO, beside).cross(CORNERS), None);
    }

    #[test]
    fn corners_and_edges_belong_to_the_triangle() {
        for corner in CORNERS {
            assert!(
                Ray::new(DVec3::ONE, corner - DVec3::ONE)
                    .cross(CORNERS)
                    .is_some()
            );
        }
    }

    #[test]
    fn without_area_there_is_no_crossing() {
        let line = [
            DVec3::new(-1.0, 0.0, 3.0),
            DVec3::new(0.0, 0.0, 3.0),
            DVec3::new(1.0, 0.0, 3.0),
        ];
        assert_eq!(Ray::of_pixel(DVec3::Z).cross(line), None);
    }

    #[test]
    fn a_triangle_thinner_than_rounding_is_its_longest_edge() {
        for seed in 1..200 {
            let t = f64::from(seed);
            let (a, b) = (
                DVec3::new(t.sin(), t.cos(), 2.0),
                DVec3::new(-t.sin(), 0.3, 4.0),
            );
            let middle = a.lerp(b, 0.5) + DVec3::new(1e-16, -1e-16, 1e-16);
            let along = 0.5 + 0.4 * (3.0 * t).sin();
            let ray = Ray::new(DVec3::ZERO, a.lerp(b, along));
            if let Some(crossing) = ray.cross([a, b, middle]) {
                assert!(
                    (crossing.distance - 1.0).abs() < 1e-12,
                    "{seed}: {crossing:?}"
                );
            }
        }
    }

    #[test]
    fn both_sides_are_met_alike() {
        let ray = Ray::of_pixel(DVec3::new(0.1, 0.1, 1.0));
        let [a, b, c] = CORNERS;
        let front = ray.cross([a, b, c]).unwrap();
        let back = ray.cross([a, c, b]).unwrap();
        assert!((front.distance - back.distance).abs() < 1e-15);
        assert_eq!(front.weights[0], back.weights[1]);
    }
}
