//! A few neighbouring groups of queries searched together.
//!
//! The tree is walked once for all of them, as far as a guess reaches; each group then picks from the
//! blocks met, and each query meets the block that its box puts nearest first. Whoever found nothing
//! within the guess walks the tree alone, so the guess decides on the time and never on the result.
#![allow(
    clippy::needless_range_loop,
    reason = "one index runs over several columns"
)]

use super::asked::{Asked, Group, around_lanes, halves, split};
use super::blocks::{Block, BlockIndex, Corners, FANOUT, LANES};
use super::frame::{FARTHEST, Frame, wider};
use super::packing::{Coordinate, Place as _};
use super::search::{Found, STACK, farthest, gaps_of, larger, smaller, walk};
use super::wide::Width;

/// Groups searched together.
pub(super) const TOGETHER: usize = 8;
/// Blocks that the groups may have near them; where there are more, each group walks alone.
const MOST: usize = 192;
/// Blocks that one group may have near it.
const MOST_OF_GROUP: usize = NUMBER as usize + 1;
/// Parts of a group that are asked for by themselves, at most; where more are needed they walk alone.
const PARTS: usize = 8;
/// The bits of the number of such a block.
const NUMBER: u32 = 31;
/// How much farther than its neighbours found theirs a query is expected to look, squared.
const AHEAD: f64 = 2.0;
/// The share of queries that may find nothing within the guess before it is widened for them.
const STRAY: usize = 8;
/// What one search leaves for the next, nearby one: hints only.
pub(super) struct Neighbourhood {
    /// How far the next queries will have to look, squared.
    reach: f64,
    /// A block near them.
    hint: usize,
    blocks: Boxes,
    near: Near,
}

/// The blocks near one group.
struct Near {
    /// Their places among all.
    places: [u32; MOST_OF_GROUP + LANES],
    /// Their squared gaps from each query in the frame.
    gaps: [[f32; LANES]; MOST_OF_GROUP],
    /// A bit for each query that has met the block.
    met: [u32; MOST_OF_GROUP],
}

/// Blocks as columns: their boxes and numbers.
struct Boxes {
    count: usize,
    numbers: [u32; MOST],
    min: [[f64; MOST]; 3],
    max: [[f64; MOST]; 3],
    frame: Frame,
    /// The boxes in the frame.
    low: [[f32; MOST]; 3],
    high: [[f32; MOST]; 3],
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
                frame: Frame::NOWHERE,
                low: [[0.0; MOST]; 3],
                high: [[0.0; MOST]; 3],
            },
            near: Near {
                places: [0; MOST_OF_GROUP + LANES],
                gaps: [[0.0; LANES]; MOST_OF_GROUP],
                met: [0; MOST_OF_GROUP],
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
                let near = &mut self.near;
                self.blocks
                    .show(width, index, group, (within, reach), (found, near));
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
            let asks = split(found.bounds(), within).1;
            let queries = (group.0, asks);
            self.hint = walk(width, index, queries, asked.corners, self.hint, found);
        }
    }
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
        let Some(frame) = Frame::around(corners, reach) else {
            return false;
        };
        (self.frame, self.count) = (frame, 0);
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
        for axis in 0..3 {
            frame.lower(axis, &self.min[axis][..self.count], &mut self.low[axis]);
            frame.upper(axis, &self.max[axis][..self.count], &mut self.high[axis]);
        }
        // What is left of the last sixteen is near nothing.
        let end = self.count.next_multiple_of(LANES);
        for axis in 0..3 {
            self.low[axis][self.count..end].fill(FARTHEST);
            self.high[axis][self.count..end].fill(-FARTHEST);
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
        (found, near): (&mut F, &mut Near),
    ) {
        let asks = split(found.bounds(), within).1;
        // A group may lie in a few places: each is asked for by itself.
        let mut parts = [(asks, *corners); PARTS];
        let mut waiting = usize::from(asks != 0);
        let mut left = PARTS;
        while waiting > 0 {
            waiting -= 1;
            let (asks, corners) = parts[waiting];
            let reach = smaller(farthest(found.bounds()), reach);
            let count = self.near(width, corners, reach, &mut near.places);
            if count <= MOST_OF_GROUP {
                self.show_near(width, index, (queries, asks), (count, reach), (found, near));
            } else if let Some(halves) = halves(queries, asks).filter(|_| left >= 2) {
                left -= 2;
                [parts[waiting], parts[waiting + 1]] = halves;
                waiting += 2;
            } else {
                let asked = around_lanes(queries, asks);
                let hint = self.numbers[near.places[0] as usize % MOST] as usize;
                walk(width, index, (queries, asks), asked, hint, found);
            }
        }
    }

    /// Shows to `found` the blocks near the queries that ask.
    #[inline(always)]
    fn show_near<C: Coordinate, F: Found>(
        &self,
        width: impl Width,
        index: &BlockIndex<C>,
        (queries, asks): (&Block, u32),
        (count, reach): (usize, f64),
        (found, near): (&mut F, &mut Near),
    ) {
        let at = self.frame.places(queries);
        // Per query the least gap, rounded down, with the block's number in its last bits.
        let mut nearest = [u32::MAX; LANES];
        for (nth, gaps) in (0..).zip(&mut near.gaps[..count]) {
            *gaps = self.gaps(near.places[nth as usize] as usize % MOST, &at);
            for lane in 0..LANES {
                let gap = gaps[lane].to_bits() & !NUMBER | nth;
                nearest[lane] = nearest[lane].min(gap);
            }
        }
        let least = nearest.map(|gap| f32::from_bits(gap & !NUMBER));
        let mut open = asks & width.below(&least, &self.frame.squares(found.bounds(), reach));
        near.met[..count].fill(0);
        while open != 0 {
            let lane = open.trailing_zeros() as usize % LANES;
            open &= open - 1;
            let nth = (nearest[lane] & NUMBER) as usize;
            near.met[nth] |= 1 << lane;
            self.meet(width, index, near.places[nth], (lane, queries), found);
        }
        let bounds = self.frame.squares(found.bounds(), reach);
        for nth in 0..count {
            let mut open = asks & !near.met[nth] & width.below(&near.gaps[nth], &bounds);
            while open != 0 {
                let lane = open.trailing_zeros() as usize % LANES;
                open &= open - 1;
                self.meet(width, index, near.places[nth], (lane, queries), found);
            }
        }
    }

    /// The blocks that may be nearer to a box than `reach`, squared; how many, if they are not too many.
    #[inline(always)]
    fn near(
        &self,
        width: impl Width,
        corners: Corners,
        reach: f64,
        near: &mut [u32; MOST_OF_GROUP + LANES],
    ) -> usize {
        let ([low, high], reach) = (self.frame.corners(corners), self.frame.square(reach));
        let mut count = 0;
        for first in (0..self.count).step_by(LANES) {
            let mut gaps = [0.0; LANES];
            for axis in 0..3 {
                let (mut lows, mut highs) = ([0.0; LANES], [0.0; LANES]);
                lows.copy_from_slice(&self.low[axis][first..first + LANES]);
                highs.copy_from_slice(&self.high[axis][first..first + LANES]);
                for k in 0..LANES {
                    let gap = wider(wider(lows[k] - high[axis], low[axis] - highs[k]), 0.0);
                    gaps[k] += gap * gap;
                }
            }
            let mut open = width.below(&gaps, &[reach; LANES]);
            if count > MOST_OF_GROUP {
                break;
            }
            while open != 0 {
                near[count] = first as u32 + open.trailing_zeros();
                count += 1;
                open &= open - 1;
            }
        }
        count
    }

    /// The squared gaps between a box and sixteen places in the frame.
    #[inline(always)]
    fn gaps(&self, number: usize, at: &[[f32; LANES]; 3]) -> [f32; LANES] {
        let mut gaps = [0.0; LANES];
        for axis in 0..3 {
            let (low, high) = (self.low[axis][number], self.high[axis][number]);
            for lane in 0..LANES {
                let gap = wider(wider(low - at[axis][lane], at[axis][lane] - high), 0.0);
                gaps[lane] += gap * gap;
            }
        }
        gaps
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
