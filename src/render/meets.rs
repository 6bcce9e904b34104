//! Which of eight triangles a ray may meet, both seen among a packet's samples.

#![allow(
    clippy::needless_range_loop,
    reason = "columns are walked side by side, and closures would leave the instruction set"
)]

use super::lanes::{ALL, Lanes};
use super::lens::ULP;
use super::raster::spread;

/// Eight triangles among the samples.
pub(super) struct Group<L: Lanes> {
    xs: [L::V; 3],
    ys: [L::V; 3],
    /// The boxes around them, enlarged by what they may be off.
    low: [L::V; 2],
    high: [L::V; 2],
    /// How far edge functions may be off within those, and the same below 0.
    doubt: L::V,
    below: L::V,
}

impl<L: Lanes> Group<L> {
    /// Triangles whose corners may be off by `error` from a ray's place.
    #[inline(always)]
    pub(super) fn new(l: L, xs: [L::V; 3], ys: [L::V; 3], error: f32) -> Self {
        let off = l.splat(error);
        let (left, right) = spread(l, xs);
        let (top, bottom) = spread(l, ys);
        let (low, high) = (
            [l.sub(left, off), l.sub(top, off)],
            [l.add(right, off), l.add(bottom, off)],
        );
        // A function is a difference of two products of a distance across and one down, neither larger
        // than the box: each distance may be off by the error, each product by a few roundings.
        let (width, height) = (l.sub(high[0], low[0]), l.sub(high[1], low[1]));
        let moved = l.mul(l.add(l.add(width, height), off), l.splat(2.0 * error));
        let rounded = l.mul(l.mul(width, height), l.splat(8.0 * ULP));
        let doubt = l.add(moved, rounded);
        Self {
            xs,
            ys,
            low,
            high,
            doubt,
            below: l.sub(l.splat(0.0), doubt),
        }
    }

    /// Those that a ray may meet, as bits.
    #[inline(always)]
    pub(super) fn may_meet(&self, l: L, x: f32, y: f32) -> u32 {
        let (x, y) = (l.splat(x), l.splat(y));
        let beside = l.or(l.below(x, self.low[0]), l.below(self.high[0], x));
        let above = l.or(l.below(y, self.low[1]), l.below(self.high[1], y));
        let out = l.bits(l.or(beside, above));
        if out == ALL {
            return 0;
        }
        let (mut across, mut down) = (self.xs, self.ys);
        for corner in 0..3 {
            across[corner] = l.sub(self.xs[corner], x);
            down[corner] = l.sub(self.ys[corner], y);
        }
        let mut sides = across;
        for (corner, (from, to)) in [(1, 2), (2, 0), (0, 1)].into_iter().enumerate() {
            let one = l.mul(across[from], down[to]);
            sides[corner] = l.sub(one, l.mul(across[to], down[from]));
        }
        let (least, greatest) = spread(l, sides);
        ALL & !out & !(l.less(least, self.below) & l.less(self.doubt, greatest))
    }
}
