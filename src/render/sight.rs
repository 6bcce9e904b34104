//! What a pixel shows, beyond a depth and a colour.

use super::surface::Glimpse;
use super::texture::{self, Parts};
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

/// The samples of one pixel.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Samples {
    /// Of the colours of those that see surface.
    pub(crate) sum: Parts,
    /// How many see surface.
    pub(crate) count: u32,
    /// Whether one of them sees none, or another than the pixel's centre does.
    pub(crate) mixed: bool,
}

/// Whether a sample and its pixel's centre see one surface, by their depths.
#[inline(always)]
pub(crate) fn alike(depth: f64, center: f64) -> bool {
    let near = if depth < center { depth } else { center };
    (depth - center).abs() <= MIXED_JUMP * near // NaN is not alike.
}

impl Samples {
    /// Adds what a sample sees; the pixel's centre sees surface at `depth`.
    pub(crate) fn add(&mut self, seen: Option<Glimpse>, depth: f64) {
        let Some(seen) = seen.filter(|seen| !seen.back) else {
            self.mixed = true;
            return;
        };
        self.mixed |= !alike(seen.depth, depth);
        for (sum, part) in self.sum.iter_mut().zip(seen.color) {
            *sum += part;
        }
        self.count += 1;
    }

    /// The mean colour of the samples that see surface, `at_center`'s if none does; and whether the
    /// samples agree.
    pub(crate) fn finish(self, at_center: impl FnOnce() -> Parts) -> ([u8; 3], Sight) {
        let mean = if self.count > 0 {
            #[allow(clippy::cast_precision_loss, reason = "at most 64")]
            let count = self.count as f32;
            texture::whole(self.sum) / count
        } else {
            texture::whole(at_center())
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
