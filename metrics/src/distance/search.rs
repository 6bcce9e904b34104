//! Sixteen neighbouring queries at once down the tree of boxes.
//!
//! Lower bounds are exact: a box's gap is computed by the operations of a distance, in their order,
//! and rounding keeps order. So nothing is skipped that could be nearer, not by one bit.
#![allow(
    clippy::needless_range_loop,
    reason = "one index runs over several columns"
)]

use super::blocks::{Block, BlockIndex, Corners, FANOUT, LANES, Node};
use super::wide;
use glam::DVec3;

/// Points of a block that are looked at side by side.
pub(super) const COLUMNS: usize = 4;
/// Deepest stack: a node leaves at most seven siblings waiting on each of its levels.
const STACK: usize = FANOUT * 12;

/// A child still to be visited: its gap from the group's box squared, its level and its number.
#[derive(Clone, Copy)]
struct Visit {
    gap: f64,
    level: u32,
    index: u32,
}

/// What a search has found for each of its queries.
pub(super) trait Found {
    /// Per lane the squared distance from which on points are of no interest.
    fn bounds(&self) -> &[f64; LANES];

    /// Takes note of a block that may hold a point of interest for a lane.
    fn meet(&mut self, number: usize, block: &Block, lane: usize, query: DVec3);
}

/// Per lane of `queries` the squared distance of the nearest point, or the bound that it came with.
pub(super) fn search(index: &BlockIndex, queries: &Block, bounds: [f64; LANES]) -> [f64; LANES] {
    wide::search(index, queries, bounds)
        .unwrap_or_else(|| search_with(index, queries, bounds, lower_portable))
}

/// The search, with the innermost loop given: it is compiled once per kind of processor.
#[inline(always)]
pub(super) fn search_with(
    index: &BlockIndex,
    queries: &Block,
    bounds: [f64; LANES],
    lower: impl Fn(&Block, DVec3, &mut [f64; COLUMNS]),
) -> [f64; LANES] {
    let mut found = Squares {
        best: bounds,
        lower,
    };
    walk(index, queries, &mut found);
    found.best
}

/// The least squared distances, and the innermost loop.
struct Squares<F> {
    best: [f64; LANES],
    lower: F,
}

impl<F: Fn(&Block, DVec3, &mut [f64; COLUMNS])> Found for Squares<F> {
    #[inline(always)]
    fn bounds(&self) -> &[f64; LANES] {
        &self.best
    }

    #[inline(always)]
    fn meet(&mut self, _: usize, block: &Block, lane: usize, query: DVec3) {
        let mut columns = [self.best[lane]; COLUMNS];
        (self.lower)(block, query, &mut columns);
        let (a, b) = (
            smaller(columns[0], columns[1]),
            smaller(columns[2], columns[3]),
        );
        self.best[lane] = smaller(a, b);
    }
}

/// A block near the middle of the queries, on their stretch of the curve.
#[inline(always)]
fn first_look(index: &BlockIndex, (min, max): Corners) -> usize {
    let middle = min * 0.5 + max * 0.5;
    let chunk = index.chunk_at(middle);
    if index.levels().len() == 1 {
        return closest(&index.levels()[0][0], middle);
    }
    let node = chunk * FANOUT + closest(&index.levels()[1][chunk], middle);
    node * FANOUT + closest(&index.levels()[0][node], middle)
}

#[inline(always)]
fn closest(node: &Node, point: DVec3) -> usize {
    let gaps = gaps(node, (point, point));
    (1..FANOUT).fold(0, |best, k| if gaps[k] < gaps[best] { k } else { best })
}

/// Shows to `found` every block that its bounds do not rule out.
#[inline(always)]
pub(super) fn walk(index: &BlockIndex, queries: &Block, found: &mut impl Found) {
    let corners = queries.bounds();
    scan(index, first_look(index, corners), queries, found);
    let mut reach = farthest(found.bounds());
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
        let child = visit.index as usize;
        if visit.level == 0 {
            scan(index, child, queries, found);
            reach = farthest(found.bounds());
            continue;
        }
        let level = visit.level - 1;
        let gaps = gaps(&index.levels()[level as usize][child], corners);
        let siblings = waiting;
        for (k, &gap) in gaps.iter().enumerate() {
            if gap < reach {
                let mut place = waiting;
                while place > siblings && stack[place - 1].gap < gap {
                    stack[place] = stack[place - 1];
                    place -= 1;
                }
                stack[place] = Visit {
                    gap,
                    level,
                    index: (child * FANOUT + k) as u32,
                };
                waiting += 1;
            }
        }
    }
}

#[inline(always)]
fn farthest(best: &[f64; LANES]) -> f64 {
    best.iter().fold(0.0, |a, &b| if b > a { b } else { a })
}

/// The larger; the second where either is NaN. One machine instruction.
#[inline(always)]
fn larger(a: f64, b: f64) -> f64 {
    if a > b { a } else { b }
}

#[inline(always)]
fn smaller(a: f64, b: f64) -> f64 {
    if a < b { a } else { b }
}

/// The squared gaps between a box and the boxes of a node's children.
#[inline(always)]
fn gaps(node: &Node, (min, max): Corners) -> [f64; FANOUT] {
    let mut gaps = [0.0; FANOUT];
    for k in 0..FANOUT {
        let x = larger(node.min[0][k] - max.x, min.x - node.max[0][k]);
        let y = larger(node.min[1][k] - max.y, min.y - node.max[1][k]);
        let z = larger(node.min[2][k] - max.z, min.z - node.max[2][k]);
        gaps[k] = square_of(larger(x, 0.0), larger(y, 0.0), larger(z, 0.0));
    }
    gaps
}

/// Shows a block to `found` for the lanes that may be near enough.
#[inline(always)]
fn scan(index: &BlockIndex, number: usize, queries: &Block, found: &mut impl Found) {
    let block = index.block(number);
    let (min, max) = index.levels()[0][number / FANOUT].child(number % FANOUT);
    let mut gaps = [0.0; LANES];
    for lane in 0..LANES {
        let x = larger(min.x - queries.x[lane], queries.x[lane] - max.x);
        let y = larger(min.y - queries.y[lane], queries.y[lane] - max.y);
        let z = larger(min.z - queries.z[lane], queries.z[lane] - max.z);
        gaps[lane] = square_of(larger(x, 0.0), larger(y, 0.0), larger(z, 0.0));
    }
    let mut open = 0u32;
    let bounds = found.bounds();
    for lane in 0..LANES {
        open |= u32::from(gaps[lane] < bounds[lane]) << lane;
    }
    while open != 0 {
        let lane = open.trailing_zeros() as usize % LANES;
        found.meet(number, block, lane, queries.point(lane));
        open &= open - 1;
    }
}

/// Lowers column k by the points k, k + 4, k + 8, … of a block.
#[inline(always)]
pub(super) fn lower(block: &Block, query: DVec3, columns: &mut [f64; COLUMNS]) {
    let mut least = *columns;
    for first in (0..LANES).step_by(COLUMNS) {
        for column in 0..COLUMNS {
            let k = first + column;
            let (x, y, z) = (
                block.x[k] - query.x,
                block.y[k] - query.y,
                block.z[k] - query.z,
            );
            least[column] = smaller(square_of(x, y, z), least[column]);
        }
    }
    *columns = least;
}

/// Never inlined: fused with the search for the least column, it is cut into narrower operations.
#[inline(never)]
fn lower_portable(block: &Block, query: DVec3, columns: &mut [f64; COLUMNS]) {
    lower(block, query, columns);
}

/// As [`super::squared_distance`] adds it.
#[inline(always)]
fn square_of(x: f64, y: f64, z: f64) -> f64 {
    x * x + y * y + z * z
}
