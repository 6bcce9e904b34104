//! Sixteen neighbouring queries at once down the tree of boxes.
//!
//! Lower bounds are exact: a box's gap is computed by the operations of a distance, in their order,
//! and rounding keeps order. So nothing is skipped that could be nearer, not by one bit.
#![allow(
    clippy::needless_range_loop,
    reason = "one index runs over several columns"
)]

use super::blocks::{Block, BlockIndex, Corners, FANOUT, LANES};
use super::packing::{Coordinate, Place as _};
use super::wide::Width;
use glam::DVec3;

/// Deepest stack: a node leaves at most seven siblings waiting on each of its levels.
pub(super) const STACK: usize = FANOUT * 12;

/// A child still to be visited: its gap from the group's box squared, its level and its number.
#[derive(Clone, Copy)]
struct Visit {
    gap: f64,
    level: u32,
    index: u32,
}

/// What a search has found for each of its queries.
pub(super) trait Found {
    /// Per query the squared distance from which on points are of no interest.
    fn bounds(&self) -> &[f64; LANES];

    /// Takes note of a block that may hold a point of interest for the query of a lane.
    fn meet(&mut self, width: impl Width, number: usize, block: &Block, lane: usize, query: DVec3);
}

/// Per query the squared distance of its nearest point, or the bound that it came with.
pub(super) struct Squares {
    pub(super) best: [f64; LANES],
}

impl Found for Squares {
    #[inline(always)]
    fn bounds(&self) -> &[f64; LANES] {
        &self.best
    }

    #[inline(always)]
    fn meet(&mut self, width: impl Width, _: usize, block: &Block, lane: usize, query: DVec3) {
        self.best[lane] = width.least(block, query, self.best[lane]);
    }
}

/// The squared distances from a query to the points of a block.
#[inline(always)]
pub(super) fn squares(block: &Block, query: DVec3) -> [f64; LANES] {
    let mut squares = [0.0; LANES];
    for k in 0..LANES {
        squares[k] = square_of(
            block.x[k] - query.x,
            block.y[k] - query.y,
            block.z[k] - query.z,
        );
    }
    squares
}

/// Blocks that a group of queries looks at together in any case. Where from there on less than one
/// query is near enough to a block, on average, the group is wide beside the boxes, as among points of
/// another unit, and says little of what each query needs.
const SHARED: usize = 64;

/// Shows to `found` every block that its bounds do not rule out for the queries of `asks`. `corners`
/// is the box around the queries that have a bound above 0.
///
/// The block of number `hint` is looked at first: one near the queries saves detours. Returns the
/// nearest block, a good hint for neighbouring queries.
#[inline(always)]
pub(super) fn walk<C: Coordinate>(
    width: impl Width,
    index: &BlockIndex<C>,
    (queries, asks): (&Block, u32),
    corners: Corners,
    hint: usize,
    found: &mut impl Found,
) -> usize {
    scan(width, index, hint, queries, found);
    let (mut nearest, mut blocks, mut met) = (None, 0, 0);
    let reach = farthest(found.bounds());
    let all = descend(index, corners, reach, |number, reach| {
        nearest = nearest.or(Some(number));
        if number == hint {
            return Some(reach);
        }
        let lanes = scan(width, index, number, queries, found);
        blocks += 1;
        met += lanes;
        match lanes {
            _ if blocks > SHARED && met < blocks => None,
            0 => Some(reach),
            _ => Some(farthest(found.bounds())),
        }
    });
    let nearest = nearest.unwrap_or(hint);
    if all {
        return nearest;
    }
    walk_apart(width, index, (queries, asks), nearest, found)
}

/// As [`walk`], each query by itself.
#[inline(never)]
fn walk_apart<C: Coordinate>(
    width: impl Width,
    index: &BlockIndex<C>,
    (queries, asks): (&Block, u32),
    mut hint: usize,
    found: &mut impl Found,
) -> usize {
    for lane in (0..LANES).filter(|lane| asks >> lane & 1 == 1) {
        let query = queries.point(lane);
        let mut meet = |number| {
            let mut room = Block::EMPTY;
            let block = C::widened(index.block(number), &mut room);
            found.meet(width, number, block, lane, query);
            found.bounds()[lane]
        };
        let (reach, mut nearest) = (meet(hint), hint);
        descend(index, (query, query), reach, |number, reach| {
            let closer = if number == hint { reach } else { meet(number) };
            if closer < reach {
                nearest = number;
            }
            Some(closer)
        });
        hint = nearest;
    }
    hint
}

/// Gives the blocks nearer to a box than a squared reach, mostly the nearest first, to `scan`, which
/// returns the reach from there on, or nothing to stop; whether it was not stopped.
#[inline(always)]
fn descend<C: Coordinate>(
    index: &BlockIndex<C>,
    corners: Corners,
    mut reach: f64,
    mut scan: impl FnMut(usize, f64) -> Option<f64>,
) -> bool {
    let root = Visit {
        gap: 0.0,
        level: index.levels().len() as u32,
        index: 0,
    };
    let mut stack = [root; STACK];
    let mut waiting = 1;
    while waiting > 0 {
        waiting -= 1;
        let visit = stack[waiting];
        if visit.gap >= reach {
            continue;
        }
        let number = visit.index as usize;
        if visit.level == 0 {
            match scan(number, reach) {
                Some(closer) => reach = closer,
                None => return false,
            }
            continue;
        }
        let level = visit.level - 1;
        let node = &index.levels()[level as usize][number];
        let (gaps, mut open) = gaps_of(&node.min, &node.max, 0, corners, reach);
        let siblings = waiting;
        while open != 0 {
            let k = open.trailing_zeros() as usize % FANOUT;
            let gap = gaps[k];
            let mut place = waiting;
            while place > siblings && stack[place - 1].gap < gap {
                stack[place] = stack[place - 1];
                place -= 1;
            }
            let child = (number * FANOUT + k) as u32;
            let (level, index) = match node.is_place(k) {
                true => (0, child * (FANOUT as u32).pow(level)),
                false => (level, child),
            };
            stack[place] = Visit { gap, level, index };
            waiting += 1;
            open &= open - 1;
        }
    }
    true
}

/// Shows a block to `found` for the queries that may be near enough; how many these are.
#[inline(always)]
fn scan<C: Coordinate>(
    width: impl Width,
    index: &BlockIndex<C>,
    number: usize,
    queries: &Block,
    found: &mut impl Found,
) -> usize {
    let (min, max) = index.levels()[0][number / FANOUT].child(number % FANOUT);
    let bounds = found.bounds();
    let mut bits = [0u64; LANES];
    for lane in 0..LANES {
        let x = larger(min.x - queries.x[lane], queries.x[lane] - max.x);
        let y = larger(min.y - queries.y[lane], queries.y[lane] - max.y);
        let z = larger(min.z - queries.z[lane], queries.z[lane] - max.z);
        let gap = square_of(larger(x, 0.0), larger(y, 0.0), larger(z, 0.0));
        bits[lane] = if gap < bounds[lane] { 1 << lane } else { 0 };
    }
    let mut open = joined(&bits);
    let lanes = open.count_ones() as usize;
    if lanes == 0 {
        return 0;
    }
    let mut room = Block::EMPTY;
    let block = C::widened(index.block(number), &mut room);
    while open != 0 {
        let lane = open.trailing_zeros() as usize % LANES;
        found.meet(width, number, block, lane, queries.point(lane));
        open &= open - 1;
    }
    lanes
}

/// All bits of the lanes. Lanes are as wide as distances, for their masks.
#[inline(always)]
pub(super) fn joined<const N: usize>(lanes: &[u64; N]) -> u32 {
    let mut joined = [0; 4];
    for first in (0..N).step_by(4) {
        for k in 0..4 {
            joined[k] |= lanes[first + k];
        }
    }
    (joined[0] | joined[1] | joined[2] | joined[3]) as u32
}

/// The largest of sixteen numbers that are not NaN, at least 0.
#[inline(always)]
pub(super) fn farthest(best: &[f64; LANES]) -> f64 {
    let mut largest = [0.0; 4];
    for first in (0..LANES).step_by(4) {
        for k in 0..4 {
            largest[k] = larger(best[first + k], largest[k]);
        }
    }
    larger(
        larger(largest[0], largest[1]),
        larger(largest[2], largest[3]),
    )
}

/// The larger; the second where either is NaN. One machine instruction.
#[inline(always)]
pub(super) fn larger(a: f64, b: f64) -> f64 {
    if a > b { a } else { b }
}

/// The smaller; the second where either is NaN.
#[inline(always)]
pub(super) fn smaller(a: f64, b: f64) -> f64 {
    if a < b { a } else { b }
}

/// The squared gaps between a box and eight boxes of two columns, from `first` on, and a bit for each
/// that is below the reach.
#[inline(always)]
pub(super) fn gaps_of<const N: usize>(
    mins: &[[f64; N]; 3],
    maxs: &[[f64; N]; 3],
    first: usize,
    (min, max): Corners,
    reach: f64,
) -> ([f64; FANOUT], u32) {
    let eight = |columns: &[[f64; N]; 3]| {
        columns.each_ref().map(|column| {
            let mut eight = [0.0; FANOUT];
            eight.copy_from_slice(&column[first..first + FANOUT]);
            eight
        })
    };
    let (mins, maxs) = (eight(mins), eight(maxs));
    let mut gaps = [0.0; FANOUT];
    let mut bits = [0u64; FANOUT];
    for k in 0..FANOUT {
        let x = larger(mins[0][k] - max.x, min.x - maxs[0][k]);
        let y = larger(mins[1][k] - max.y, min.y - maxs[1][k]);
        let z = larger(mins[2][k] - max.z, min.z - maxs[2][k]);
        gaps[k] = square_of(larger(x, 0.0), larger(y, 0.0), larger(z, 0.0));
        bits[k] = if gaps[k] < reach { 1 << k } else { 0 };
    }
    (gaps, joined(&bits))
}

/// As [`super::squared_distance`] adds it.
#[inline(always)]
pub(super) fn square_of(x: f64, y: f64, z: f64) -> f64 {
    x * x + y * y + z * z
}
