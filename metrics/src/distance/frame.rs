//! Gaps in 32 bits that are safe to decide by.
#![allow(
    clippy::needless_range_loop,
    reason = "one index runs over several columns"
)]

use super::blocks::{Block, Corners, LANES};
use super::search::{larger, smaller};
use glam::DVec3;

/// Where in its frame a box ends that reaches farther. What asks lies between −1 and 1, but for rounding,
/// and what is looked for at most 1 farther.
pub(super) const FARTHEST: f32 = 8.0;
/// Covers, in a frame, what coordinates lose as f32.
const ROUNDING: f64 = 4e-6;
/// The same for squares, relative.
const SQUARES: f64 = 1.0 + 1e-5;

/// A cube around what asks, as coordinates from −1 to 1 of 32 bits: gaps come out at most as large as
/// they are, bounds at least.
#[derive(Clone, Copy)]
pub(super) struct Frame {
    centre: DVec3,
    scale: f64,
}

impl Frame {
    /// No frame yet.
    pub(super) const NOWHERE: Self = Self {
        centre: DVec3::ZERO,
        scale: 0.0,
    };

    /// Around a box and what is nearer to it than `reach`, squared; `None` where the numbers do not
    /// allow for it.
    pub(super) fn around((min, max): Corners, reach: f64) -> Option<Self> {
        let half = 0.5 * max - 0.5 * min;
        let scale = (half.max_element() + reach.sqrt()).recip();
        let usable = scale.is_finite() && (scale * scale).is_normal();
        usable.then_some(Self {
            centre: 0.5 * min + 0.5 * max,
            scale,
        })
    }

    #[inline(always)]
    pub(super) fn lower(&self, axis: usize, along: &[f64], lows: &mut [f32]) {
        for (low, along) in lows.iter_mut().zip(along) {
            *low = clamped((along - self.centre[axis]) * self.scale - ROUNDING);
        }
    }

    #[inline(always)]
    pub(super) fn upper(&self, axis: usize, along: &[f64], highs: &mut [f32]) {
        for (high, along) in highs.iter_mut().zip(along) {
            *high = clamped((along - self.centre[axis]) * self.scale + ROUNDING);
        }
    }

    #[inline(always)]
    pub(super) fn corners(&self, (min, max): Corners) -> [[f32; 3]; 2] {
        let (mut low, mut high) = ([0.0; 3], [0.0; 3]);
        for axis in 0..3 {
            self.lower(axis, &[min[axis]], &mut low[axis..]);
            self.upper(axis, &[max[axis]], &mut high[axis..]);
        }
        [low, high]
    }

    #[inline(always)]
    pub(super) fn places(&self, queries: &Block) -> [[f32; LANES]; 3] {
        let mut places = [[0.0; LANES]; 3];
        let columns = [&queries.x, &queries.y, &queries.z];
        for axis in 0..3 {
            for lane in 0..LANES {
                places[axis][lane] =
                    ((columns[axis][lane] - self.centre[axis]) * self.scale) as f32;
            }
        }
        places
    }

    /// At least a square.
    #[inline(always)]
    pub(super) fn square(&self, square: f64) -> f32 {
        (square * (self.scale * self.scale) * SQUARES) as f32 + f32::MIN_POSITIVE
    }

    /// The bounds, as far as `reach`.
    #[inline(always)]
    pub(super) fn squares(&self, bounds: &[f64; LANES], reach: f64) -> [f32; LANES] {
        let mut squares = [0.0; LANES];
        for lane in 0..LANES {
            squares[lane] = self.square(smaller(bounds[lane], reach));
        }
        squares
    }
}

/// As 32 bits, and no farther than needed.
#[inline(always)]
fn clamped(along: f64) -> f32 {
    smaller(larger(along, -f64::from(FARTHEST)), f64::from(FARTHEST)) as f32
}

/// The larger; the second where either is NaN.
#[inline(always)]
pub(super) fn wider(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::align::tests::scattered;
    use crate::distance::packing::Place as _;
    use crate::distance::search::square_of;

    /// Boxes of all sizes and places against queries, at offsets and scales up to where there is no frame.
    #[test]
    fn gaps_are_never_larger_nor_bounds_smaller_than_they_are() {
        let (mut near, mut decided) = (0, 0);
        for (offset, size) in [
            (0.0, 1.0),
            (1e7, 1e-3),
            (-5e5, 1e4),
            (0.0, 1e-140),
            (0.0, 1e140),
        ] {
            let random = scattered(80, 3000);
            for some in random.chunks_exact(3) {
                let at = |point: DVec3| DVec3::splat(offset) + point * size;
                let corners = (at(-DVec3::ONE), at(DVec3::ONE));
                let reach = (size * 0.7 * some[2].x.abs()).powi(2);
                let frame = Frame::around(corners, reach).unwrap();
                let mut queries = Block::EMPTY;
                queries.set(3, at(some[0]));
                let place = frame.places(&queries).map(|lanes| lanes[3]);
                let half = some[2].abs() * 10f64.powf(3.0 * some[2].y);
                let (min, max) = (at(some[1] * 2.5 - half), at(some[1] * 2.5 + half));
                let [low, high] = frame.corners((min, max));
                let (mut gap, mut exact) = (0.0f32, [0.0; 3]);
                for axis in 0..3 {
                    let along = wider(
                        wider(low[axis] - place[axis], place[axis] - high[axis]),
                        0.0,
                    );
                    gap += along * along;
                    let query = at(some[0])[axis];
                    exact[axis] = larger(larger(min[axis] - query, query - max[axis]), 0.0);
                }
                let exact = square_of(exact[0], exact[1], exact[2]);
                if exact < reach {
                    near += 1;
                    assert!(gap < frame.square(exact.next_up()), "{gap} {exact}");
                    assert!(gap < frame.square(reach));
                }
                decided += usize::from(exact > 1.01 * reach && gap >= frame.square(reach));
            }
        }
        assert!(near > 500 && decided > 1000, "{near} {decided}");
    }

    #[test]
    fn where_squares_are_no_normal_numbers_there_is_no_frame() {
        for size in [0.0, 1e-310, 1e-160, 1e160, f64::MAX] {
            let corners = (DVec3::splat(-size), DVec3::splat(size));
            assert!(Frame::around(corners, 0.0).is_none(), "{size}");
        }
        assert!(Frame::around((DVec3::ZERO, DVec3::ONE), f64::INFINITY).is_none());
    }
}
