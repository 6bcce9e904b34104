//! A view as a regular grid of samples, and what the fast paths need to project onto it.

use super::surface::Frame;
use glam::{DMat3, DVec2, DVec3};
use mvs_datasets::scene::Distortion;

/// A view whose pixels are cut into `side` × `side` samples, numbered in one grid.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Eye<'m> {
    pub(crate) frame: Frame<'m>,
    side: u32,
    bent: bool,
    /// Of the grid: pixels times `side`.
    pub(crate) focal: DVec2,
    pub(crate) principal: DVec2,
    pub(crate) rotation: DMat3,
    pub(crate) center_in_cam: DVec3,
}

impl<'m> Eye<'m> {
    pub(crate) fn new(frame: Frame<'m>, side: u32) -> Self {
        let camera = frame.camera();
        Self {
            frame,
            side,
            bent: camera.distortion() != Distortion::None,
            focal: camera.focal() * f64::from(side),
            principal: camera.center() * f64::from(side),
            rotation: frame.rotation(),
            center_in_cam: frame.center_in_cam(),
        }
    }

    /// Samples along each side of a pixel.
    pub(crate) fn side(&self) -> u32 {
        self.side
    }

    /// Whether a lens bends the rays.
    pub(crate) fn is_bent(&self) -> bool {
        self.bent
    }

    /// The direction in which a sample looks, in the camera frame at depth 1; NaN where a lens has
    /// none.
    pub(crate) fn direction(&self, column: usize, row: usize) -> DVec3 {
        let sample = DVec2::new(column as f64, row as f64) + 0.5;
        if self.bent {
            return self.frame.camera().ray(sample / f64::from(self.side));
        }
        ((sample - self.principal) / self.focal).extend(1.0)
    }

    /// x and y of the directions of `count` samples in a row behind a lens, from one on.
    pub(crate) fn directions(&self, column: usize, row: usize, count: usize) -> Vec<DVec2> {
        let center = |column: usize| DVec2::new(column as f64, row as f64) + 0.5;
        let samples = (column..column + count).map(center);
        let mut found: Vec<_> = samples.map(|at| at / f64::from(self.side)).collect();
        self.frame.camera().rays(&mut found);
        found
    }
}
