//! What a pixel shows, beyond a depth and a colour.

use super::surface::Glimpse;
use glam::Vec3;
use serde::{Deserialize, Serialize};

/// What is behind a pixel. Pixels without surface have depth 0.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Sight {
    /// The centre's ray meets nothing.
    Nothing,
    /// The lens bends no ray to the pixel's centre.
    NoRay,
    /// The centre's ray meets the back of a one-sided triangle first.
    BackFace,
    /// Surface, but not all samples see it: some see nothing, a back, or a depth that differs by
    /// more than [`MIXED_JUMP`] of the nearer one.
    Mixed,
    /// Surface.
    Surface,
}

/// Samples whose depths differ by more than this fraction of the nearer make a pixel mixed.
pub const MIXED_JUMP: f64 = 0.01;

impl Sight {
    /// As a grey level: 0, 32, 64, 192, 255; surface from 128 on.
    pub fn level(self) -> u8 {
        match self {
            Self::Nothing => 0,
            Self::NoRay => 32,
            Self::BackFace => 64,
            Self::Mixed => 192,
            Self::Surface => 255,
        }
    }
}

/// What the back of a triangle is, where its material is not double-sided.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum BackFaces {
    /// It hides what is behind it and is no surface: no depth, no colour.
    #[default]
    Invalid,
    /// Surface like the front.
    Valid,
}

/// The samples of one pixel whose centre sees surface at `depth`.
pub(crate) struct Samples {
    depth: f64,
    sum: Vec3,
    count: f32,
    mixed: bool,
}

impl Samples {
    pub(crate) fn new(depth: f64) -> Self {
        Self {
            depth,
            sum: Vec3::ZERO,
            count: 0.0,
            mixed: false,
        }
    }

    /// Adds what a sample sees.
    pub(crate) fn add(&mut self, seen: Option<Glimpse>) {
        let Some(seen) = seen.filter(|seen| !seen.back) else {
            self.mixed = true;
            return;
        };
        let near = seen.depth.min(self.depth);
        let same = (seen.depth - self.depth).abs() <= MIXED_JUMP * near;
        self.mixed |= !same; // NaN is not the same
        self.sum += seen.color;
        self.count += 1.0;
    }

    /// The mean colour of the samples that see surface, `at_center`'s if none does; and whether the
    /// samples agree.
    pub(crate) fn finish(self, at_center: impl FnOnce() -> Vec3) -> ([u8; 3], Sight) {
        let mean = if self.count > 0.0 {
            self.sum / self.count
        } else {
            at_center()
        };
        #[allow(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "a mean of 8-bit values"
        )]
        let color = mean.to_array().map(|value| (value + 0.5) as u8);
        let sight = if self.mixed {
            Sight::Mixed
        } else {
            Sight::Surface
        };
        (color, sight)
    }
}
