//! Where a point appears in many views, eight at a time in plain loops over fixed arrays, of which the compiler
//! makes vector instructions; `pulp` picks the widest set the machine has. The same bits as one by one.

#![allow(
    clippy::needless_range_loop,
    reason = "columns are walked side by side, and closures would leave the instruction set"
)]

use glam::DVec3;
use mvs_datasets::scene::View;
use pulp::{Arch, Simd, WithSimd};

/// Views that are worked out side by side.
pub(super) const EIGHT: usize = 8;

/// Views that look at the same points.
pub(super) struct Onlookers {
    eights: Vec<Cameras>,
}

/// Cameras side by side. Their images are of no size where there is none.
struct Cameras {
    /// Columns of the rotation, then the translation: x, y and z of each.
    columns: [[[f64; EIGHT]; 3]; 4],
    /// Of x and y: focal length, principal point and size of the image.
    focal: [[f64; EIGHT]; 2],
    principal: [[f64; EIGHT]; 2],
    size: [[f64; EIGHT]; 2],
}

/// Where a point appears in eight views.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sightings {
    /// Image coordinates; x is below 0 where the point does not lie on the image.
    pub(super) x: [f64; EIGHT],
    pub(super) y: [f64; EIGHT],
    /// z-depth.
    pub(super) depth: [f64; EIGHT],
}

impl Sightings {
    pub(super) const NONE: Self = Self {
        x: [-1.0; EIGHT],
        y: [0.0; EIGHT],
        depth: [0.0; EIGHT],
    };
}

impl Onlookers {
    /// These views, whose cameras are pinholes.
    pub(super) fn new<'v>(views: impl Iterator<Item = &'v View>) -> Self {
        let views: Vec<&View> = views.collect();
        Self {
            eights: views.chunks(EIGHT).map(Cameras::new).collect(),
        }
    }

    /// Where `point` (world) appears in the views, eight by eight.
    pub(super) fn see(&self, point: DVec3, to: &mut Vec<Sightings>) {
        to.resize(self.eights.len(), Sightings::NONE);
        Arch::new().dispatch(Look {
            eights: &self.eights,
            point: point.to_array(),
            to,
        });
    }
}

impl Cameras {
    fn new(views: &[&View]) -> Self {
        let mut all = Self {
            columns: [[[0.0; EIGHT]; 3]; 4],
            focal: [[1.0; EIGHT]; 2],
            principal: [[0.0; EIGHT]; 2],
            size: [[0.0; EIGHT]; 2],
        };
        for (at, view) in views.iter().enumerate() {
            let rotation = view.pose.rotation();
            let columns = [
                rotation.x_axis,
                rotation.y_axis,
                rotation.z_axis,
                view.pose.translation(),
            ];
            for (to, column) in all.columns.iter_mut().zip(columns) {
                for axis in 0..3 {
                    to[axis][at] = column[axis];
                }
            }
            let camera = &view.camera;
            let size = [camera.width(), camera.height()].map(f64::from);
            for axis in 0..2 {
                all.focal[axis][at] = camera.focal()[axis];
                all.principal[axis][at] = camera.center()[axis];
                all.size[axis][at] = size[axis];
            }
        }
        all
    }
}

/// `pulp` compiles [`WithSimd::with_simd`], and what is inlined into it, once per instruction set.
struct Look<'l> {
    eights: &'l [Cameras],
    point: [f64; 3],
    to: &'l mut [Sightings],
}

impl WithSimd for Look<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let [px, py, pz] = self.point;
        for (cameras, to) in self.eights.iter().zip(self.to) {
            let [a, b, c, t] = &cameras.columns;
            for i in 0..EIGHT {
                let along =
                    |axis: usize| a[axis][i] * px + b[axis][i] * py + c[axis][i] * pz + t[axis][i];
                let (x, y, depth) = (along(0), along(1), along(2));
                let x = cameras.focal[0][i] * (x / depth) + cameras.principal[0][i];
                let y = cameras.focal[1][i] * (y / depth) + cameras.principal[1][i];
                let right = (x >= 0.0) & (x < cameras.size[0][i]);
                let inside = right & (y >= 0.0) & (y < cameras.size[1][i]) & (depth > 0.0);
                to.x[i] = if inside { x } else { -1.0 };
                (to.y[i], to.depth[i]) = (y, depth);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fuse::testing::{random_view, rng, uniform};
    use glam::DVec2;

    #[test]
    fn eight_by_eight_is_one_by_one_to_the_bit() {
        let mut random = rng(11);
        let views: Vec<View> = (0..13).map(|id| random_view(&mut random, id)).collect();
        let onlookers = Onlookers::new(views.iter());
        let (mut to, mut inside, mut behind) = (Vec::new(), 0, 0);
        for _ in 0..2000 {
            let point = DVec3::from_array([0; 3].map(|_| uniform(&mut random, -6.0, 6.0)));
            onlookers.see(point, &mut to);
            assert_eq!(to.len(), 2);
            for (at, view) in views.iter().enumerate() {
                let (seen, i) = (&to[at / EIGHT], at % EIGHT);
                let in_cam = view.pose.to_cam(point);
                let pixel = view.camera.project(in_cam);
                behind += usize::from(pixel.is_none());
                let size = DVec2::new(view.camera.width().into(), view.camera.height().into());
                let on_image = |at: &DVec2| at.cmpge(DVec2::ZERO).all() && at.cmplt(size).all();
                match pixel.filter(on_image) {
                    None => assert_eq!(seen.x[i], -1.0),
                    Some(pixel) => {
                        let found = [seen.x[i], seen.y[i], seen.depth[i]].map(f64::to_bits);
                        assert_eq!(found, [pixel.x, pixel.y, in_cam.z].map(f64::to_bits));
                        inside += 1;
                    }
                }
            }
            assert!(to[1].x[views.len() - EIGHT..].iter().all(|&x| x == -1.0));
        }
        assert!(inside > 1000 && behind > 1000, "{inside} {behind}");
    }
}
