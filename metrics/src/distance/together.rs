//! A few neighbouring groups of queries searched together.
//!
//! The tree is walked once for all of them, as far as a guess reaches; each group then picks from the
//! blocks met, and each query meets the block that its box puts nearest first. Whoever found nothing
//! within the guess walks the tree alone, so the guess decides on the time and never on the result.
#![allow(
    clippy::needless_range_loop,
    reason = "one index runs over several columns"
)]

use super::blocks::{Block, BlockIndex, Corners, FANOUT, LANES, NOWHERE, around};
use super::packing::{Coordinate, Place as _};
use super::search::{Found, STACK, farthest, gaps_of, joined, larger, smaller, square_of, walk};
use super::wide::Width;

/// Groups searched together.
pub(super) const TOGETHER: usize = 8;
/// Blocks that the groups may have near them; where there are more, each group walks alone.
const MOST: usize = 192;
/// Blocks that one group may have near it.
const MOST_OF_GROUP: usize = 32;
/// How much farther than its neighbours found theirs a query is expected to look, squared.
const AHEAD: f64 = 2.0;
/// The share of queries that may find nothing within the guess before it is widened for them.
const STRAY: usize = 8;
/// A bit for each query of a group.
const ALL: u32 = (1 << LANES) - 1;
/// No block.
const NONE: u64 = u64::MAX;

/// Sixteen queries, and the box around those that ask.
pub(super) type Group<'a> = (&'a Block, Corners);

/// What one search leaves for the next, nearby one: hints only.
pub(super) struct Neighbourhood {
    /// How far the next queries will have to look, squared.
    reach: f64,
    /// A block near them.
    hint: usize,
    blocks: Boxes,
}

/// Blocks as columns: their boxes and numbers.
struct Boxes {
    count: usize,
    numbers: [u32; MOST],
    min: [[f64; MOST]; 3],
    max: [[f64; MOST]; 3],
}

impl Neighbourhood {
    pub(super) fn new() -> Self {
        Self {
            reach: 0.0,
            hint: 0,
            blocks: Boxes {
                count: 0,
                numbers: [0; MOST],
                min: [[0.0; MOST]; 3],
                max: [[0.0; MOST]; 3],
            },
        }
    }

    /// Shows to each group's `found` every block that its bounds do not rule out.
    #[inline(always)]
    pub(super) fn search<C: Coordinate, F: Found>(
        &mut self,
        width: impl Width,
        index: &BlockIndex<C>,
        groups: &[Group<'_>],
        found: &mut [F],
    ) {
        let asked = Asked::of(groups, found, 0.0);
        if asked.count == 0 {
            return;
        }
        if self.reach == 0.0 {
            self.alone(width, index, &groups[0], &mut found[0], 0.0);
            self.expect(index, farthest(found[0].bounds()));
        }
        let guess = smaller(self.reach, asked.farthest);
        let mut within = 0.0;
        for reach in [guess, f64::INFINITY] {
            let asked = Asked::of(groups, found, within);
            let reach = smaller(reach, asked.farthest);
            let few = asked.count <= 2 || reach == f64::INFINITY;
            if few || !self.blocks.collect(index, asked.corners, reach) {
                break;
            }
            for (group, found) in groups.iter().zip(&mut *found) {
                self.blocks
                    .show(width, index, group, (within, reach), found);
            }
            within = reach;
        }
        for (group, found) in groups.iter().zip(&mut *found) {
            self.alone(width, index, group, found, within);
        }
        let (mut near, mut far, mut strays) = (0.0, 0.0, 0);
        for found in &*found {
            let (settled, open) = split(found.bounds(), guess);
            near = larger(settled, near);
            far = larger(farthest(found.bounds()), far);
            strays += open.count_ones() as usize;
        }
        let expected = if strays * STRAY > asked.count {
            far
        } else {
            near
        };
        self.expect(index, expected);
    }

    fn expect<C: Coordinate>(&mut self, index: &BlockIndex<C>, square: f64) {
        let spacing = index.spacing_at(self.hint);
        self.reach = larger(AHEAD * square, spacing * spacing);
    }

    /// Walks the tree for those queries of a group whose bounds are above `within`.
    #[inline(always)]
    fn alone<C: Coordinate, F: Found>(
        &mut self,
        width: impl Width,
        index: &BlockIndex<C>,
        group: &Group<'_>,
        found: &mut F,
        within: f64,
    ) {
        let asked = Asked::of(&[*group], std::slice::from_ref(found), within);
        if asked.count > 0 {
            self.hint = walk(width, index, group.0, asked.corners, self.hint, found);
        }
    }
}

/// The queries whose bounds are above some square.
struct Asked {
    count: usize,
    corners: Corners,
    farthest: f64,
}

impl Asked {
    #[inline(always)]
    fn of<F: Found>(groups: &[Group<'_>], found: &[F], within: f64) -> Self {
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

/// The farthest bound that is at most `within`, and a bit for each that is above.
#[inline(always)]
fn split(bounds: &[f64; LANES], within: f64) -> (f64, u32) {
    let (mut settled, mut bits) = ([0.0; LANES], [0u64; LANES]);
    for lane in 0..LANES {
        let above = bounds[lane] > within;
        settled[lane] = if above { 0.0 } else { bounds[lane] };
        bits[lane] = if above { 1 << lane } else { 0 };
    }
    (farthest(&settled), joined(&bits))
}

impl Boxes {
    /// Gathers the blocks whose boxes are nearer to a box than `reach`, squared; false where they are
    /// too many.
    #[inline(always)]
    fn collect<C: Coordinate>(
        &mut self,
        index: &BlockIndex<C>,
        corners: Corners,
        reach: f64,
    ) -> bool {
        self.count = 0;
        let mut stack = [(0u32, 0u32); STACK];
        stack[0].0 = index.levels().len() as u32 - 1;
        let mut waiting = 1;
        while waiting > 0 {
            waiting -= 1;
            let (level, number) = stack[waiting];
            let node = &index.levels()[level as usize][number as usize];
            let (_, mut open) = gaps_of(&node.min, &node.max, 0, corners, reach);
            if level == 0 && self.count + FANOUT > MOST {
                return false;
            }
            while open != 0 {
                let k = open.trailing_zeros() as usize % FANOUT;
                let child = number * FANOUT as u32 + k as u32;
                if level == 0 {
                    self.numbers[self.count] = child;
                    for axis in 0..3 {
                        self.min[axis][self.count] = node.min[axis][k];
                        self.max[axis][self.count] = node.max[axis][k];
                    }
                    self.count += 1;
                } else {
                    stack[waiting] = (level - 1, child);
                    waiting += 1;
                }
                open &= open - 1;
            }
        }
        // What is left of the last eight is near nothing.
        let end = self.count.next_multiple_of(FANOUT);
        for k in self.count..end {
            for axis in 0..3 {
                self.min[axis][k] = f64::INFINITY;
                self.max[axis][k] = f64::NEG_INFINITY;
            }
        }
        true
    }

    /// Shows to `found` those of the blocks that may be of interest to queries whose bounds are above
    /// `within`. Where these are too many the group walks alone.
    #[inline(always)]
    fn show<C: Coordinate, F: Found>(
        &self,
        width: impl Width,
        index: &BlockIndex<C>,
        (queries, corners): &Group<'_>,
        (within, reach): (f64, f64),
        found: &mut F,
    ) {
        if split(found.bounds(), within).1 == 0 {
            return;
        }
        let reach = smaller(farthest(found.bounds()), reach);
        let mut near = [0u32; MOST_OF_GROUP + FANOUT];
        let mut count = 0;
        for first in (0..self.count).step_by(FANOUT) {
            let (_, mut open) = gaps_of(&self.min, &self.max, first, *corners, reach);
            if count > MOST_OF_GROUP {
                break;
            }
            while open != 0 {
                near[count] = first as u32 + open.trailing_zeros();
                count += 1;
                open &= open - 1;
            }
        }
        if count > MOST_OF_GROUP {
            let asked = Asked::of(&[(queries, *corners)], std::slice::from_ref(found), within);
            let hint = self.numbers[near[0] as usize % MOST] as usize;
            walk(width, index, queries, asked.corners, hint, found);
            return;
        }
        let mut gaps = [[0.0; LANES]; MOST_OF_GROUP];
        let (mut least, mut nearest) = ([0.0; LANES], [NONE; LANES]);
        let mut asks = [0.0; LANES];
        for lane in 0..LANES {
            let bound = found.bounds()[lane];
            least[lane] = if bound > within { bound } else { 0.0 };
            asks[lane] = if bound > within { f64::INFINITY } else { 0.0 };
        }
        for (nth, gaps) in gaps[..count].iter_mut().enumerate() {
            let number = near[nth] as usize % MOST;
            let (min, max) = self.corners(number);
            for lane in 0..LANES {
                let x = larger(min[0] - queries.x[lane], queries.x[lane] - max[0]);
                let y = larger(min[1] - queries.y[lane], queries.y[lane] - max[1]);
                let z = larger(min[2] - queries.z[lane], queries.z[lane] - max[2]);
                let gap = square_of(larger(x, 0.0), larger(y, 0.0), larger(z, 0.0));
                gaps[lane] = gap;
                let nearer = gap < least[lane];
                least[lane] = if nearer { gap } else { least[lane] };
                nearest[lane] = if nearer { nth as u64 } else { nearest[lane] };
            }
        }
        for lane in 0..LANES {
            if nearest[lane] != NONE {
                let nth = nearest[lane] as usize % MOST_OF_GROUP;
                self.meet(width, index, near[nth], (lane, queries), found);
            }
        }
        for nth in 0..count {
            let (bounds, mut bits) = (found.bounds(), [0u64; LANES]);
            for lane in 0..LANES {
                let bound = smaller(bounds[lane], asks[lane]);
                let open = gaps[nth][lane] < bound && nearest[lane] != nth as u64;
                bits[lane] = if open { 1 << lane } else { 0 };
            }
            let mut open = joined(&bits);
            while open != 0 {
                let lane = open.trailing_zeros() as usize % LANES;
                self.meet(width, index, near[nth], (lane, queries), found);
                open &= open - 1;
            }
        }
    }

    #[inline(always)]
    fn corners(&self, place: usize) -> ([f64; 3], [f64; 3]) {
        let (min, max) = (&self.min, &self.max);
        (
            [min[0][place], min[1][place], min[2][place]],
            [max[0][place], max[1][place], max[2][place]],
        )
    }

    #[inline(always)]
    fn meet<C: Coordinate, F: Found>(
        &self,
        width: impl Width,
        index: &BlockIndex<C>,
        place: u32,
        (lane, queries): (usize, &Block),
        found: &mut F,
    ) {
        let number = self.numbers[place as usize % MOST] as usize;
        let mut room = Block::EMPTY;
        let block = C::widened(index.block(number), &mut room);
        found.meet(width, number, block, lane, queries.point(lane));
    }
}
