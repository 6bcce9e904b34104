//! Plainer arithmetic, for comparison: what a program gives that computes in world coordinates, or in
//! f32, or both.

use glam::{DVec2, DVec3, Vec3};
use mvs_datasets::scene::{Mesh, View};

/// Where and how precisely a plain program computes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Arithmetic {
    pub(super) name: &'static str,
    /// Coordinates are taken about the middle of the scene first, in f64.
    recentred: bool,
    single: bool,
}

impl Arithmetic {
    const fn new(name: &'static str, precision: Precision, origin: Origin) -> Self {
        Self {
            name,
            recentred: matches!(origin, Origin::Scene),
            single: matches!(precision, Precision::Single),
        }
    }

    /// The origin of coordinates for a scene around `middle`.
    fn origin(self, middle: DVec3) -> DVec3 {
        if self.recentred { middle } else { DVec3::ZERO }
    }

    /// A point as it is stored, about the origin of coordinates.
    pub(super) fn stored(self, point: DVec3, middle: DVec3) -> DVec3 {
        let point = point - self.origin(middle);
        if self.single {
            point.as_vec3().as_dvec3()
        } else {
            point
        }
    }
}

enum Precision {
    Single,
    Double,
}

enum Origin {
    World,
    Scene,
}

/// The four ways.
pub(super) const ALL: [Arithmetic; 4] = [
    Arithmetic::new("f64", Precision::Double, Origin::World),
    Arithmetic::new("f64 recentred", Precision::Double, Origin::Scene),
    Arithmetic::new("f32", Precision::Single, Origin::World),
    Arithmetic::new("f32 recentred", Precision::Single, Origin::Scene),
];

/// Möller and Trumbore's test against every triangle in one precision: the smallest distance along
/// the ray, in units of its direction's length.
macro_rules! nearest_hit {
    ($name:ident, $vector:ty, $number:ty) => {
        fn $name(origin: $vector, direction: $vector, triangles: &[[$vector; 3]]) -> $number {
            let mut nearest = <$number>::INFINITY;
            for [a, b, c] in triangles {
                let (ab, ac) = (*b - *a, *c - *a);
                let p = direction.cross(ac);
                let inverse = 1.0 / ab.dot(p);
                let from_a = origin - *a;
                let u = from_a.dot(p) * inverse;
                let q = from_a.cross(ab);
                let v = direction.dot(q) * inverse;
                let t = ac.dot(q) * inverse;
                if u >= 0.0 && v >= 0.0 && u + v <= 1.0 && t > 0.0 {
                    nearest = nearest.min(t);
                }
            }
            nearest
        }
    };
}

nearest_hit!(nearest_double, DVec3, f64);
nearest_hit!(nearest_single, Vec3, f32);

/// The z-depths at these pixels of `view`, infinite where there is no surface.
pub(super) fn depths(
    arithmetic: Arithmetic,
    (mesh, middle): (&Mesh, DVec3),
    view: &View,
    pixels: &[DVec2],
) -> Vec<f64> {
    let corners = (0..mesh.triangles().len()).map(|triangle| mesh.corners(triangle));
    let triangles: Vec<[DVec3; 3]> = corners
        .map(|corners| corners.map(|corner| arithmetic.stored(corner, middle)))
        .collect();
    let single: Vec<[Vec3; 3]> = triangles
        .iter()
        .map(|corners| corners.map(|corner| corner.as_vec3()))
        .collect();
    let eye = arithmetic.stored(view.pose.center_in_world(), middle);
    let depth = |&pixel: &DVec2| {
        let ray = view.pose.direction_to_world(view.camera.ray(pixel));
        if arithmetic.single {
            f64::from(nearest_single(eye.as_vec3(), ray.as_vec3(), &single))
        } else {
            nearest_double(eye, ray, &triangles)
        }
    };
    pixels.iter().map(depth).collect()
}

/// The world point at z-depth `depth` of a pixel, as a plain program computes it: R ᵀ (K⁻¹ x d − t).
pub(super) fn back_projected(
    arithmetic: Arithmetic,
    (view, middle): (&View, DVec3),
    (pixel, depth): (DVec2, f64),
) -> DVec3 {
    let origin = arithmetic.origin(middle);
    let rotation = view.pose.rotation();
    let translation = -(rotation * (view.pose.center_in_world() - origin));
    let in_cam = view.camera.ray(pixel) * depth;
    if arithmetic.single {
        let rotation = rotation.as_mat3();
        let moved = in_cam.as_vec3() - translation.as_vec3();
        (rotation.transpose() * moved).as_dvec3() + origin
    } else {
        rotation.transpose() * (in_cam - translation) + origin
    }
}
