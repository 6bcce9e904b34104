//! Where a scene lies and how large it is.

use crate::error::Result;
use glam::DVec3;
use mvs_datasets::scene::{Mesh, Pose, View};

/// A scene multiplied by a factor, then moved.
#[derive(Debug, Clone, Copy)]
pub(super) struct Place {
    pub(super) scale: f64,
    pub(super) offset: DVec3,
}

/// The axis, how extreme it is along it, and the place.
pub(super) type Step = ((&'static str, f64), Place);

impl Place {
    /// Where nothing is extreme.
    pub(super) const USUAL: Self = Self {
        scale: 1.0,
        offset: DVec3::ZERO,
    };

    /// Offsets up to 1e7, along no axis and no round number, and scales from 1e-6 to 1e6.
    pub(super) fn steps() -> Vec<Step> {
        let direction = DVec3::new(1.0, -0.712_345_678_9, 0.387_654_321);
        let offsets = [0.0, 1e3, 1e5, 1e6, 1e7].map(|size| {
            let offset = size * direction;
            (
                ("offset", size),
                Self {
                    offset,
                    ..Self::USUAL
                },
            )
        });
        let twentieth = 2f64.powi(20);
        let scales = [1e-6, 1.0 / twentieth, 1.0 / 128.0, 128.0, twentieth, 1e6];
        let scales = scales.map(|scale| {
            (
                ("scale", scale),
                Self {
                    scale,
                    ..Self::USUAL
                },
            )
        });
        offsets.into_iter().chain(scales).collect()
    }

    pub(super) fn put(&self, point: DVec3) -> DVec3 {
        point * self.scale + self.offset
    }

    /// The inverse of [`Place::put`].
    pub(super) fn back(&self, point: DVec3) -> DVec3 {
        (point - self.offset) / self.scale
    }

    pub(super) fn mesh(&self, mesh: &Mesh) -> Result<Mesh> {
        let vertices = mesh.vertices().iter().map(|&vertex| self.put(vertex));
        Ok(Mesh::new(vertices.collect(), mesh.triangles().to_vec())?)
    }

    pub(super) fn view(&self, view: &View) -> Result<View> {
        let rotation = view.pose.rotation();
        let centre = self.put(view.pose.center_in_world());
        Ok(View {
            pose: Pose::new(rotation, -(rotation * centre))?,
            depth_range: None,
            ..view.clone()
        })
    }
}
