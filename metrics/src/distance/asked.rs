//! Which queries of which groups still ask, and from where.
#![allow(
    clippy::needless_range_loop,
    reason = "one index runs over several columns"
)]

use super::blocks::{Block, Corners, LANES, NOWHERE, around};
use super::search::{Found, farthest, joined, larger};

/// A bit for each query of a group.
const ALL: u32 = (1 << LANES) - 1;

/// Sixteen queries, and the box around those that ask.
pub(super) type Group<'a> = (&'a Block, Corners);

/// The queries whose bounds are above some square.
pub(super) struct Asked {
    pub(super) count: usize,
    pub(super) corners: Corners,
    pub(super) farthest: f64,
}

impl Asked {
    #[inline(always)]
    pub(super) fn of<F: Found>(groups: &[Group<'_>], found: &[F], within: f64) -> Self {
        let mut asked = Self {
            count: 0,
            corners: NOWHERE,
            farthest: 0.0,
        };
        for (&(queries, corners), found) in groups.iter().zip(found) {
            let mut open = split(found.bounds(), within).1;
            if open == 0 {
                continue;
            }
            asked.count += open.count_ones() as usize;
            asked.farthest = larger(farthest(found.bounds()), asked.farthest);
            if open == ALL {
                asked.corners.0 = asked.corners.0.min(corners.0);
                asked.corners.1 = asked.corners.1.max(corners.1);
                continue;
            }
            while open != 0 {
                let lane = open.trailing_zeros() as usize % LANES;
                asked.corners = around(asked.corners, queries.point(lane));
                open &= open - 1;
            }
        }
        asked
    }
}

/// The box around some of the queries.
#[inline(always)]
pub(super) fn around_lanes(queries: &Block, mut lanes: u32) -> Corners {
    let mut corners = NOWHERE;
    while lanes != 0 {
        let lane = lanes.trailing_zeros() as usize % LANES;
        corners = around(corners, queries.point(lane));
        lanes &= lanes - 1;
    }
    corners
}

/// Some queries parted in the middle of their longest extent, with the boxes around them; `None` where
/// they are in one place.
#[inline(always)]
pub(super) fn halves(queries: &Block, lanes: u32) -> Option<[(u32, Corners); 2]> {
    let (min, max) = around_lanes(queries, lanes);
    let axis = (max - min).max_position();
    let middle = 0.5 * min[axis] + 0.5 * max[axis];
    let column = [&queries.x, &queries.y, &queries.z][axis];
    let mut upper = 0;
    for lane in 0..LANES {
        upper |= u32::from(column[lane] > middle) << lane;
    }
    let parts = [lanes & !upper, lanes & upper];
    let parted = parts.iter().all(|&lanes| lanes != 0);
    parted.then(|| parts.map(|lanes| (lanes, around_lanes(queries, lanes))))
}

/// The farthest bound that is at most `within`, and a bit for each that is above.
#[inline(always)]
pub(super) fn split(bounds: &[f64; LANES], within: f64) -> (f64, u32) {
    let (mut settled, mut bits) = ([0.0; LANES], [0u64; LANES]);
    for lane in 0..LANES {
        let above = bounds[lane] > within;
        settled[lane] = if above { 0.0 } else { bounds[lane] };
        bits[lane] = if above { 1 << lane } else { 0 };
    }
    (farthest(&settled), joined(&bits))
}
