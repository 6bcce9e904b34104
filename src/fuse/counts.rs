//! What became of the pixels.

use serde::{Deserialize, Serialize};

/// What became of the pixels of all depth maps; the reasons, `merged` and `fused` less
/// `filled` add up to `pixels`.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct FuseCounts {
    /// All pixels.
    pub pixels: u64,
    /// Pixels without a depth.
    pub empty: u64,
    /// Pixels that a mask leaves out.
    pub masked: u64,
    /// Pixels with a depth outside of the depth range.
    pub out_of_range: u64,
    /// Pixels of too little confidence.
    pub unconfident: u64,
    /// Pixels on which too few sources agree.
    pub inconsistent: u64,
    /// Pixels that more views see through than agree with.
    pub contradicted: u64,
    /// Pixels whose point lies outside of the bounds or the crop volume.
    pub outside: u64,
    /// Pixels that became part of another pixel's point.
    pub merged: u64,
    /// Pixels counted as left out above whose depth was filled in from other views (Merrell).
    pub filled: u64,
    /// Pixels that became points.
    pub fused: u64,
}

impl FuseCounts {
    /// Both together.
    #[must_use]
    pub fn plus(self, other: Self) -> Self {
        Self {
            pixels: self.pixels + other.pixels,
            empty: self.empty + other.empty,
            masked: self.masked + other.masked,
            out_of_range: self.out_of_range + other.out_of_range,
            unconfident: self.unconfident + other.unconfident,
            inconsistent: self.inconsistent + other.inconsistent,
            contradicted: self.contradicted + other.contradicted,
            outside: self.outside + other.outside,
            merged: self.merged + other.merged,
            filled: self.filled + other.filled,
            fused: self.fused + other.fused,
        }
    }

    /// Pixels with a stated fate; equal to `pixels` at the end.
    pub fn accounted(&self) -> u64 {
        let rejected = self.empty + self.masked + self.out_of_range + self.unconfident;
        let late = self.inconsistent + self.contradicted + self.outside;
        rejected + late + self.merged + self.fused - self.filled
    }
}
