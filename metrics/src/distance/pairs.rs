//! Points that move a little at a time, each kept with its nearest target point.
//!
//! A point is searched for only when its partner may have changed: after a search every target but
//! the partner is known to be at least so far away; while the partner is nearer than that, less the
//! way gone since, nothing else can be.
#![allow(
    clippy::needless_range_loop,
    reason = "one index runs over several columns"
)]

use super::blocks::{Block, BlockIndex, LANES, NOWHERE, around};
use super::search::{Found, joined, smaller, square_of, squares, walk};
use super::{Listed, wide};
use glam::{DMat4, DVec3};
use rayon::prelude::*;

/// Groups of queries whose sums are taken as one: the same at any number of threads.
const GROUPS: usize = 64;
/// How far past the maximal distance a search looks, so that it need not look again soon.
const BEYOND: f64 = 1.05;
/// Keeps comparisons of sums of distances safe that are kept as f32: far above their relative error.
const SAFETY: f64 = 1.0 - 1e-6;
/// No partner.
const NONE: u32 = u32::MAX;

/// Sums over pairs; positions are taken about a centre.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(crate) struct PairSums {
    /// Pairs nearer than the maximal distance.
    pub(crate) pairs: usize,
    /// Σ |target − source|².
    pub(crate) squares: f64,
    /// Σ source.
    pub(crate) source: DVec3,
    /// Σ target.
    pub(crate) target: DVec3,
    /// Σ target sourceᵀ, by columns of the source axis.
    pub(crate) cross: [DVec3; 3],
    /// Σ |source|².
    pub(crate) source_squares: f64,
}

impl PairSums {
    fn join(mut self, other: &Self) -> Self {
        self.pairs += other.pairs;
        self.squares += other.squares;
        self.source += other.source;
        self.target += other.target;
        for (column, other) in self.cross.iter_mut().zip(other.cross) {
            *column += other;
        }
        self.source_squares += other.source_squares;
        self
    }
}

/// Source points on their way, and the targets that they are paired with.
pub(crate) struct Tracker<'a> {
    index: &'a BlockIndex,
    max_distance: f64,
    centre: DVec3,
    groups: Vec<Group>,
    asked: usize,
}

/// Sixteen neighbouring source points.
#[derive(Clone)]
struct Group {
    /// Where they are.
    at: Block,
    /// The places of their partners in the index's blocks, or [`NONE`].
    partner: [u32; LANES],
    /// No target but the partner is nearer than this; 0 before the first search.
    others: [f32; LANES],
}

impl<'a> Tracker<'a> {
    /// Tracks finite `source` points, at least one; sums are taken about `centre`.
    pub(crate) fn new<F: Fn(usize) -> DVec3 + Sync>(
        index: &'a BlockIndex,
        source: &Listed<F>,
        max_distance: f64,
        centre: DVec3,
    ) -> Self {
        let group = |at: Block| Group {
            at,
            partner: [NONE; LANES],
            others: [0.0; LANES],
        };
        let blocks = BlockIndex::blocks_of(source);
        Self {
            index,
            max_distance,
            centre,
            groups: blocks.into_iter().map(group).collect(),
            asked: source.count,
        }
    }

    /// Moves all points, finds their partners and sums over the pairs.
    pub(crate) fn moved(&mut self, motion: DMat4) -> PairSums {
        let (index, max_distance, centre) = (self.index, self.max_distance, self.centre);
        let (asked, chunk_size) = (self.asked, GROUPS * LANES);
        let sums: Vec<PairSums> = self
            .groups
            .par_chunks_mut(GROUPS)
            .enumerate()
            .map(|(chunk, groups)| {
                wide::run(Step {
                    index,
                    max_distance,
                    centre,
                    motion,
                    asked: (asked - chunk * chunk_size).min(chunk_size),
                    groups,
                })
            })
            .collect();
        sums.iter().fold(PairSums::default(), PairSums::join)
    }
}

/// One motion of neighbouring groups.
struct Step<'a> {
    index: &'a BlockIndex,
    max_distance: f64,
    centre: DVec3,
    motion: DMat4,
    groups: &'a mut [Group],
    /// Points in the groups.
    asked: usize,
}

impl wide::Task for Step<'_> {
    type Output = PairSums;

    #[inline(always)]
    fn run(self) -> PairSums {
        let mut sums = LaneSums::default();
        let mut hint = 0;
        for (number, group) in self.groups.iter_mut().enumerate() {
            let steps = group.move_by(self.motion);
            let lanes = (self.asked - number * LANES).min(LANES);
            hint = group.pair(self.index, self.max_distance, lanes, &steps, hint);
            let partners = group.partners(self.index);
            let bound = self.max_distance * self.max_distance;
            sums.add(&group.at, &partners, lanes, bound, self.centre);
        }
        sums.total()
    }
}

impl Group {
    /// Moves the points; the distances moved.
    #[inline(always)]
    fn move_by(&mut self, motion: DMat4) -> [f64; LANES] {
        let mut steps = [0.0; LANES];
        let (a, b, c, d) = (motion.x_axis, motion.y_axis, motion.z_axis, motion.w_axis);
        let at = &mut self.at;
        for lane in 0..LANES {
            let (x, y, z) = (at.x[lane], at.y[lane], at.z[lane]);
            // As `transform_point3` adds them.
            let moved_x = a.x * x + b.x * y + c.x * z + d.x;
            let moved_y = a.y * x + b.y * y + c.y * z + d.y;
            let moved_z = a.z * x + b.z * y + c.z * z + d.z;
            steps[lane] = square_of(moved_x - x, moved_y - y, moved_z - z).sqrt();
            (at.x[lane], at.y[lane], at.z[lane]) = (moved_x, moved_y, moved_z);
        }
        steps
    }

    /// The partners' positions; at infinity where there is none.
    #[inline(always)]
    fn partners(&self, index: &BlockIndex) -> Block {
        let mut partners = Block::EMPTY;
        for lane in 0..LANES {
            let place = self.partner[lane] as usize;
            let partner = if self.partner[lane] == NONE {
                DVec3::INFINITY
            } else {
                index.block(place / LANES).point(place % LANES)
            };
            partners.set(lane, partner);
        }
        partners
    }

    /// Searches for the lanes whose partner may have changed, from the block `hint` on; a hint for
    /// the next group.
    #[inline(always)]
    fn pair(
        &mut self,
        index: &BlockIndex,
        max_distance: f64,
        lanes: usize,
        steps: &[f64; LANES],
        hint: usize,
    ) -> usize {
        let partners = self.partners(index);
        let mut known = [0.0; LANES];
        let mut stale = 0u32;
        for lane in 0..LANES {
            known[lane] = squared_distance_at(&self.at, &partners, lane).sqrt();
            let others = (f64::from(self.others[lane]) - steps[lane]) * SAFETY;
            self.others[lane] = others as f32;
            let kept = smaller(known[lane], max_distance) < others;
            stale |= u32::from(!kept) << lane;
        }
        stale &= (1 << lanes) - 1;
        if stale == 0 {
            return hint;
        }
        let ceiling = (max_distance * BEYOND).powi(2).next_up();
        let mut found = Nearest::NOTHING;
        let (mut corners, mut start) = (NOWHERE, hint);
        for lane in (0..LANES).filter(|lane| stale >> lane & 1 == 1) {
            corners = around(corners, self.at.point(lane));
            found.second[lane] = ceiling;
            if self.partner[lane] != NONE {
                // Far enough to meet what may be nearer than the partner, and most likely the next.
                start = self.partner[lane] as usize / LANES;
                let reach = known[lane] / SAFETY + steps[lane] + index.spacing_at(start);
                found.second[lane] = smaller((reach * reach).next_up(), ceiling);
            }
        }
        let next = walk(index, &self.at, corners, start, &mut found);
        for lane in (0..LANES).filter(|lane| stale >> lane & 1 == 1) {
            let second = found.second[lane];
            self.partner[lane] = found.partner[lane];
            self.others[lane] = smaller(second.sqrt() * SAFETY, f64::from(f32::MAX)) as f32;
        }
        next
    }
}

#[inline(always)]
fn squared_distance_at(a: &Block, b: &Block, lane: usize) -> f64 {
    square_of(
        a.x[lane] - b.x[lane],
        a.y[lane] - b.y[lane],
        a.z[lane] - b.z[lane],
    )
}

/// [`PairSums`], lane by lane: the same at any width of registers.
#[derive(Default)]
struct LaneSums {
    pairs: usize,
    squares: [f64; LANES],
    source: Block3,
    target: Block3,
    cross: [Block3; 3],
    source_squares: [f64; LANES],
}

/// Three columns of sums.
type Block3 = [[f64; LANES]; 3];

impl LaneSums {
    /// Adds the pairs of the first lanes whose square is below the bound.
    #[inline(always)]
    fn add(&mut self, at: &Block, partners: &Block, lanes: usize, bound: f64, centre: DVec3) {
        for lane in 0..LANES {
            let square = squared_distance_at(at, partners, lane);
            let paired = square < bound && lane < lanes;
            let or_zero = |value: f64| if paired { value } else { 0.0 };
            self.pairs += usize::from(paired);
            self.squares[lane] += or_zero(square);
            let source = [
                or_zero(at.x[lane] - centre.x),
                or_zero(at.y[lane] - centre.y),
                or_zero(at.z[lane] - centre.z),
            ];
            let target = [
                or_zero(partners.x[lane] - centre.x),
                or_zero(partners.y[lane] - centre.y),
                or_zero(partners.z[lane] - centre.z),
            ];
            for row in 0..3 {
                self.source[row][lane] += source[row];
                self.target[row][lane] += target[row];
                for column in 0..3 {
                    self.cross[column][row][lane] += target[row] * source[column];
                }
            }
            self.source_squares[lane] += square_of(source[0], source[1], source[2]);
        }
    }

    fn total(&self) -> PairSums {
        let sum = |lanes: &[f64; LANES]| lanes.iter().sum::<f64>();
        let vector = |rows: &Block3| DVec3::new(sum(&rows[0]), sum(&rows[1]), sum(&rows[2]));
        PairSums {
            pairs: self.pairs,
            squares: sum(&self.squares),
            source: vector(&self.source),
            target: vector(&self.target),
            cross: [
                vector(&self.cross[0]),
                vector(&self.cross[1]),
                vector(&self.cross[2]),
            ],
            source_squares: sum(&self.source_squares),
        }
    }
}

/// Per lane the nearest target found, and how far away all others are at least, squared.
struct Nearest {
    best: [f64; LANES],
    /// Its place in the index's blocks.
    partner: [u32; LANES],
    /// 0 where nothing is asked for.
    second: [f64; LANES],
}

impl Nearest {
    const NOTHING: Self = Self {
        best: [f64::INFINITY; LANES],
        partner: [NONE; LANES],
        second: [0.0; LANES],
    };
}

impl Found for Nearest {
    #[inline(always)]
    fn bounds(&self) -> &[f64; LANES] {
        &self.second
    }

    #[inline(always)]
    fn meet(&mut self, number: usize, block: &Block, lane: usize, query: DVec3) {
        let squares = squares(block, query);
        let (mut best, mut second) = (self.best[lane], self.second[lane]);
        let mut bits = [0u64; LANES];
        for k in 0..LANES {
            bits[k] = if squares[k] < second { 1 << k } else { 0 };
        }
        let mut near = joined(&bits);
        while near != 0 {
            let k = near.trailing_zeros() as usize % LANES;
            let square = squares[k];
            if square < best {
                second = smaller(best, second);
                best = square;
                self.partner[lane] = (number * LANES + k) as u32;
            } else {
                second = smaller(square, second);
            }
            near &= near - 1;
        }
        (self.best[lane], self.second[lane]) = (best, second);
    }
}
