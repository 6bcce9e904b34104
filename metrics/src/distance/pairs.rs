//! Points that move a little at a time, each kept with its nearest target point.
//!
//! A point is searched for only when its partner may have changed: after a search every target but
//! the partner is known to be at least so far away; while the partner is nearer than that, less the
//! distance moved since, nothing else can be.

use super::blocks::{Block, BlockIndex, LANES};
use super::search::{Found, walk};
use super::squared_distance;
use glam::{DMat4, DVec3};
use rayon::prelude::*;

/// Groups of queries whose sums are taken as one: the same at any number of threads.
const GROUPS: usize = 64;
/// How far past the maximal distance a search looks, so that it need not look again soon.
const BEYOND: f64 = 1.05;
/// Keeps comparisons of sums of rounded distances safe: far above their relative error.
const SAFETY: f64 = 1.0 - 1e-12;
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
    fn add(&mut self, square: f64, source: DVec3, target: DVec3) {
        self.pairs += 1;
        self.squares += square;
        self.source += source;
        self.target += target;
        self.cross[0] += target * source.x;
        self.cross[1] += target * source.y;
        self.cross[2] += target * source.z;
        self.source_squares += source.length_squared();
    }

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
    /// Where they were when last searched for.
    anchor: Block,
    /// The places of their partners in the index's blocks, or [`NONE`].
    partner: [u32; LANES],
    /// No target but the partner was nearer to the anchor than this.
    others: [f64; LANES],
}

impl<'a> Tracker<'a> {
    /// Tracks finite `source` points, at least one; sums are taken about `centre`.
    pub(crate) fn new(
        index: &'a BlockIndex,
        source: &[DVec3],
        max_distance: f64,
        centre: DVec3,
    ) -> Self {
        let group = |at: Block| Group {
            anchor: at.clone(),
            at,
            partner: [NONE; LANES],
            others: [0.0; LANES],
        };
        Self {
            index,
            max_distance,
            centre,
            groups: index.blocks_of(source).into_iter().map(group).collect(),
            asked: source.len(),
        }
    }

    /// Moves all points, finds their partners and sums over the pairs.
    pub(crate) fn moved(&mut self, motion: DMat4) -> PairSums {
        let (index, max_distance, centre) = (self.index, self.max_distance, self.centre);
        let last = self.asked - (self.groups.len() - 1) * LANES;
        let count = self.groups.len();
        let sums: Vec<PairSums> = self
            .groups
            .par_chunks_mut(GROUPS)
            .enumerate()
            .map(|(chunk, groups)| {
                let mut sums = PairSums::default();
                for (k, group) in groups.iter_mut().enumerate() {
                    group.move_by(motion);
                    group.pair(index, max_distance);
                    let lanes = if chunk * GROUPS + k + 1 == count {
                        last
                    } else {
                        LANES
                    };
                    group.sum(index, max_distance, centre, lanes, &mut sums);
                }
                sums
            })
            .collect();
        sums.iter().fold(PairSums::default(), PairSums::join)
    }
}

impl Group {
    fn move_by(&mut self, motion: DMat4) {
        for lane in 0..LANES {
            let at = motion.transform_point3(self.at.point(lane));
            self.at.set(lane, at);
        }
    }

    fn partner_at(&self, index: &BlockIndex, lane: usize) -> Option<DVec3> {
        let place = self.partner[lane] as usize;
        let paired = self.partner[lane] != NONE;
        paired.then(|| index.block(place / LANES).point(place % LANES))
    }

    /// Searches for the lanes whose partner may have changed.
    fn pair(&mut self, index: &BlockIndex, max_distance: f64) {
        let ceiling = (max_distance * BEYOND).powi(2).next_up();
        let mut found = Nearest::NOTHING;
        let mut stale = 0u32;
        for lane in 0..LANES {
            let at = self.at.point(lane);
            let motion = squared_distance(at, self.anchor.point(lane)).sqrt();
            let known = match self.partner_at(index, lane) {
                Some(partner) => squared_distance(at, partner),
                None => f64::INFINITY,
            };
            let reached = known.sqrt().min(max_distance);
            if reached + motion < self.others[lane] * SAFETY {
                continue;
            }
            stale |= 1 << lane;
            found.best[lane] = known;
            found.partner[lane] = self.partner[lane];
            // Far enough to meet all that may be nearer than the partner, and most likely the next
            // one too: the nearest of the others was at `others` and cannot have moved further.
            let reach = ((self.others[lane] + motion) / SAFETY).max(known.sqrt() / SAFETY);
            let searched = self.others[lane] > 0.0;
            let square = if searched {
                (reach * reach).next_up()
            } else {
                ceiling
            };
            found.second[lane] = square.min(ceiling);
        }
        if stale == 0 {
            return;
        }
        walk(index, &self.at, &mut found);
        for lane in (0..LANES).filter(|lane| stale >> lane & 1 == 1) {
            self.anchor.set(lane, self.at.point(lane));
            self.partner[lane] = found.partner[lane];
            self.others[lane] = found.second[lane].sqrt();
        }
    }

    fn sum(
        &self,
        index: &BlockIndex,
        max_distance: f64,
        centre: DVec3,
        lanes: usize,
        sums: &mut PairSums,
    ) {
        for lane in 0..lanes {
            let Some(partner) = self.partner_at(index, lane) else {
                continue;
            };
            let at = self.at.point(lane);
            let square = squared_distance(at, partner);
            if square < max_distance * max_distance {
                sums.add(square, at - centre, partner - centre);
            }
        }
    }
}

/// Per lane the nearest target found, and how far away all others are at least, squared.
struct Nearest {
    best: [f64; LANES],
    partner: [u32; LANES],
    /// 0 where nothing is asked for.
    second: [f64; LANES],
}

impl Nearest {
    const NOTHING: Self = Self {
        best: [0.0; LANES],
        partner: [NONE; LANES],
        second: [0.0; LANES],
    };

    fn take(&mut self, lane: usize, square: f64, place: u32) {
        if place == self.partner[lane] {
            return;
        }
        if square < self.best[lane] {
            self.second[lane] = self.best[lane].min(self.second[lane]);
            self.best[lane] = square;
            self.partner[lane] = place;
        } else if square < self.second[lane] {
            self.second[lane] = square;
        }
    }
}

impl Found for Nearest {
    fn bounds(&self) -> &[f64; LANES] {
        &self.second
    }

    fn meet(&mut self, number: usize, block: &Block, lane: usize, query: DVec3) {
        let mut squares = [0.0; LANES];
        for (k, square) in squares.iter_mut().enumerate() {
            *square = squared_distance(query, block.point(k));
        }
        for (k, &square) in squares.iter().enumerate() {
            if square < self.second[lane] {
                self.take(lane, square, (number * LANES + k) as u32);
            }
        }
    }
}
