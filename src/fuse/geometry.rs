//! Two-way consistency of two views in closed form: one sample of the source's depth map tells the
//! reprojected depth, the reprojection error and the relative depth error.
//!
//! With `rho` = sampled depth / depth of the point in the source view and `q = rho − 1`, the point
//! that the source saw lies on the line from the source's centre `C` through the reference's
//! hypothesis, at `C + rho·(X − C)`; everything below follows from that.

use glam::{DMat3, DVec2, DVec3};
use mvs_datasets::scene::View;

/// What is constant between a reference view and one of its sources.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PairGeometry {
    /// Ks · Rs · Rr⁻¹ · Kr⁻¹: reference pixel (u, v, 1) at unit depth to source pixel times depth.
    pub(crate) rotation: DMat3,
    /// Ks · (ts − Rs · Rr⁻¹ · tr): the same for the reference's centre, in pixels × world units.
    pub(crate) translation: DVec3,
    /// Kr · C with C the source's centre in the reference's camera frame: (e_x, e_y, c_z).
    pub(crate) epipole: DVec3,
}

/// A reference pixel's hypothesis as the source sees it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Projected {
    /// Continuous source image coordinates.
    pub pixel: DVec2,
    /// z-depth in the source's camera frame, > 0.
    pub depth: f64,
}

impl PairGeometry {
    /// The constants of (`reference`, `source`).
    pub fn new(reference: &View, source: &View) -> Self {
        let world_axes = [DVec3::X, DVec3::Y, DVec3::Z]
            .map(|axis| source.pose.rotation() * reference.pose.direction_to_world(axis));
        let relative = DMat3::from_cols(world_axes[0], world_axes[1], world_axes[2]);
        let offset = source.pose.translation() - relative * reference.pose.translation();
        let source_intrinsics = source.camera.intrinsics();
        let center = reference.pose.to_cam(source.pose.center_in_world());
        Self {
            rotation: source_intrinsics * relative * unprojection(reference),
            translation: source_intrinsics * offset,
            epipole: reference.camera.intrinsics() * center,
        }
    }

    /// Where the hypothesis of z-depth `depth` at reference `pixel` appears in the source; `None`
    /// unless it lies in front of it.
    pub fn project(&self, pixel: DVec2, depth: f64) -> Option<Projected> {
        let p = depth * (self.rotation * pixel.extend(1.0)) + self.translation;
        (p.z > 0.0).then(|| Projected {
            pixel: p.truncate() / p.z,
            depth: p.z,
        })
    }

    /// z-depth in the reference view of the point that the source saw.
    pub fn reprojected_depth(&self, depth: f64, q: f64) -> f64 {
        depth + q * (depth - self.epipole.z)
    }

    /// Distance in reference pixels between `pixel` and the image of the point the source saw.
    pub fn pixel_error(&self, pixel: DVec2, depth: f64, q: f64) -> f64 {
        let across = pixel * self.epipole.z - self.epipole.truncate();
        q.abs() * across.length() / self.reprojected_depth(depth, q).abs()
    }

    /// |reprojected depth − `depth`| / `depth`.
    pub fn depth_error(&self, depth: f64, q: f64) -> f64 {
        q.abs() * (depth - self.epipole.z).abs() / depth
    }
}

/// K⁻¹ in closed form.
pub(super) fn unprojection(view: &View) -> DMat3 {
    let (focal, center) = (view.camera.focal(), view.camera.center());
    DMat3::from_cols(
        DVec3::new(1.0 / focal.x, 0.0, 0.0),
        DVec3::new(0.0, 1.0 / focal.y, 0.0),
        DVec3::new(-center.x / focal.x, -center.y / focal.y, 1.0),
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fuse::testing::{random_view, rng, uniform};

    /// The same by projecting forth and back: (reprojected depth, pixel error, depth error).
    fn brute(
        reference: &View,
        source: &View,
        pixel: DVec2,
        depth: f64,
        sampled: f64,
    ) -> (f64, f64, f64) {
        let world = reference.pose.to_world(reference.camera.ray(pixel) * depth);
        let seen = source.camera.project(source.pose.to_cam(world)).unwrap();
        let back = source.pose.to_world(source.camera.ray(seen) * sampled);
        let back = reference.pose.to_cam(back);
        let k = reference.camera.intrinsics() * back;
        let error = (k.truncate() / k.z - pixel).length();
        (back.z, error, (back.z - depth).abs() / depth)
    }

    #[test]
    fn closed_form_equals_projection_forth_and_back_on_random_poses() {
        let mut random = rng(7);
        let mut tried = 0;
        for _ in 0..20_000 {
            let (reference, source) = (random_view(&mut random, 0), random_view(&mut random, 1));
            let pixel = DVec2::new(
                uniform(&mut random, 0.0, 640.0),
                uniform(&mut random, 0.0, 480.0),
            );
            let depth = uniform(&mut random, 0.5, 20.0);
            let pair = PairGeometry::new(&reference, &source);
            let Some(projected) = pair.project(pixel, depth) else {
                let world = reference.pose.to_world(reference.camera.ray(pixel) * depth);
                assert!(source.pose.to_cam(world).z <= 1e-9);
                continue;
            };
            if projected.depth < 1e-2 {
                continue;
            }
            let sampled = projected.depth * uniform(&mut random, 0.7, 1.4);
            let q = sampled / projected.depth - 1.0;
            let (z, pixels, relative) = brute(&reference, &source, pixel, depth, sampled);
            if z.abs() < 1e-3 {
                continue;
            }
            tried += 1;
            let close = |a: f64, b: f64| (a - b).abs() <= 1e-8 * (1.0 + b.abs());
            assert!(close(pair.reprojected_depth(depth, q), z));
            assert!(close(
                pair.pixel_error(pixel, depth, q) * z.abs(),
                pixels * z.abs()
            ));
            assert!(close(pair.depth_error(depth, q), relative));
        }
        assert!(tried > 5_000, "{tried}");
    }

    #[test]
    fn identical_cameras_see_depth_errors_only() {
        let view = random_view(&mut rng(1), 0);
        let pair = PairGeometry::new(&view, &view);
        let (pixel, depth) = (DVec2::new(10.5, 20.5), 4.0);
        let projected = pair.project(pixel, depth).unwrap();
        assert!(
            (projected.pixel - pixel).length() < 1e-9 && (projected.depth - depth).abs() < 1e-9
        );
        assert!(pair.pixel_error(pixel, depth, 0.5) < 1e-9);
        assert!((pair.depth_error(depth, 0.5) - 0.5).abs() < 1e-9);
    }
}
