//! Points that move a little at a time, each kept with its nearest target point.
//!
//! A point is searched for only when its partner may have changed: after a search every target but
//! the partner is known to be at least so far away; while the partner is nearer than that, less the
//! way gone since, nothing else can be. The first motions are too large for that: they look for the
//! partner alone.
#![allow(
    clippy::needless_range_loop,
    reason = "one index runs over several columns"
)]

use super::blocks::{Block, BlockIndex, Corners, LANES, NOWHERE, around};
use super::packing::{Coordinate, Keep, Packing, Place, pack};
use super::partners::{Closest, NONE, Nearest};
use super::search::{Found, smaller, square_of};
use super::sums::{LaneSums, PairSums, squared_distance_at};
use super::together::{Neighbourhood, TOGETHER};
use super::wide::{self, Registers, Width};
use super::{Listed, Take};
use crate::error::Result;
use glam::{DMat4, DVec3};
use rayon::prelude::*;

/// Groups of queries whose sums are taken as one: the same at any number of threads.
const GROUPS: usize = 64;
/// How far past the maximal distance a search looks, so that it need not look again soon.
const BEYOND: f64 = 1.05;
/// Keeps comparisons of sums of distances safe that are kept as f32: far above their relative error.
const SAFETY: f64 = 1.0 - 1e-6;
/// Motions before the distance of all others is kept too.
const COARSE: usize = 2;

/// Source points on their way, and the targets that they are paired with.
pub(crate) struct Tracker<'a, C> {
    index: &'a BlockIndex<C>,
    max_distance: f64,
    centre: DVec3,
    groups: Vec<Group>,
    /// Per point, no target but the partner is nearer than this. Nothing before the first fine search,
    /// 0 before that of the point.
    others: Vec<[f32; LANES]>,
    asked: usize,
    moves: usize,
    registers: Registers,
}

/// Sixteen neighbouring source points.
#[derive(Clone)]
struct Group {
    /// Where they are.
    at: Block,
    /// The places of their partners in the index's blocks, or [`NONE`].
    partner: [u32; LANES],
}

impl Place for Group {
    const EMPTY: Self = Self {
        at: Block::EMPTY,
        partner: [NONE; LANES],
    };

    fn set(&mut self, lane: usize, at: DVec3) {
        self.at.set(lane, at);
    }
}

/// Points that [`crate::align::icp_onto`] moves.
pub struct Source {
    groups: Vec<Group>,
    count: usize,
    /// Their sum, added up in the order given.
    sum: DVec3,
}

impl Source {
    /// Of finite points.
    pub(crate) fn of<F: Fn(usize) -> DVec3 + Sync>(points: &Listed<F>) -> Self {
        let mut groups = vec![Group::EMPTY; points.count.div_ceil(LANES)];
        pack(points, &mut groups);
        let sum = (0..points.count).fold(DVec3::ZERO, |sum, index| sum + (points.at)(index));
        let count = points.count;
        Self { groups, count, sum }
    }

    /// Points in spatial order, `most` or fewer, that `feed` brings in stretches of any length: no list
    /// of all of them need exist.
    ///
    /// # Errors
    /// What `feed` returns: its own errors, and those that it is given for points that are not finite.
    pub fn gathered(most: usize, feed: impl FnOnce(&mut Take<'_>) -> Result<()>) -> Result<Self> {
        let mut packing = Packing::new(Keep::Nothing, most);
        let mut sum = DVec3::ZERO;
        feed(&mut |points| {
            sum = points.iter().fold(sum, |sum, &point| sum + point);
            packing.take(points)
        })?;
        let (groups, _, count) = packing.finish();
        Ok(Self { groups, count, sum })
    }

    /// How many points.
    pub fn len(&self) -> usize {
        self.count
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// The mean of the points.
    pub(crate) fn centre(&self) -> DVec3 {
        self.sum / self.count as f64
    }
}

impl<'a, C: Coordinate> Tracker<'a, C> {
    /// Tracks points, at least one; sums are taken about their mean.
    pub(crate) fn new(index: &'a BlockIndex<C>, source: Source, max_distance: f64) -> Self {
        Self {
            index,
            max_distance,
            centre: source.centre(),
            groups: source.groups,
            others: Vec::new(),
            asked: source.count,
            moves: 0,
            registers: Registers::widest(),
        }
    }

    /// What the sums are taken about.
    pub(crate) fn centre(&self) -> DVec3 {
        self.centre
    }

    /// How many points are tracked.
    pub(crate) fn len(&self) -> usize {
        self.asked
    }

    /// Moves all points, finds their partners and sums over the pairs.
    pub(crate) fn moved(&mut self, motion: DMat4) -> PairSums {
        let (index, max_distance, centre) = (self.index, self.max_distance, self.centre);
        let (asked, chunk_size) = (self.asked, GROUPS * LANES);
        let (fine, registers) = (self.moves >= COARSE, self.registers);
        self.moves += 1;
        if fine {
            self.others.resize(self.groups.len(), [0.0; LANES]);
        }
        let mut others: Vec<&mut [[f32; LANES]]> = self.others.chunks_mut(GROUPS).collect();
        others.resize_with(self.groups.len().div_ceil(GROUPS), Default::default);
        let sums: Vec<PairSums> = self
            .groups
            .par_chunks_mut(GROUPS)
            .zip(others)
            .enumerate()
            .map(|(chunk, (groups, others))| {
                registers.run(Step {
                    index,
                    max_distance,
                    centre,
                    motion,
                    others,
                    asked: (asked - chunk * chunk_size).min(chunk_size),
                    groups,
                })
            })
            .collect();
        sums.iter().fold(PairSums::default(), PairSums::join)
    }
}

/// One motion of neighbouring groups.
struct Step<'a, C> {
    index: &'a BlockIndex<C>,
    max_distance: f64,
    centre: DVec3,
    motion: DMat4,
    /// Where the distance of all targets but the partners is kept too, or nothing.
    others: &'a mut [[f32; LANES]],
    groups: &'a mut [Group],
    /// Points in the groups.
    asked: usize,
}

impl<C: Coordinate> wide::Task for Step<'_, C> {
    type Output = PairSums;

    #[inline(always)]
    fn run(self, width: impl Width) -> PairSums {
        let mut sums = LaneSums::default();
        let mut near = Neighbourhood::new();
        for (nth, groups) in self.groups.chunks_mut(TOGETHER).enumerate() {
            let mut steps = [[0.0; LANES]; TOGETHER];
            let mut lanes = [0; TOGETHER];
            for (k, group) in groups.iter_mut().enumerate() {
                steps[k] = group.move_by(self.motion);
                lanes[k] = (self.asked - (nth * TOGETHER + k) * LANES).min(LANES);
            }
            if let Some(others) = self.others.chunks_mut(TOGETHER).nth(nth) {
                let margins = (&lanes, &steps, others);
                fine(
                    width,
                    self.index,
                    self.max_distance,
                    groups,
                    margins,
                    &mut near,
                );
            } else {
                coarse(
                    width,
                    self.index,
                    self.max_distance,
                    groups,
                    &lanes,
                    &mut near,
                );
            }
            for (group, lanes) in groups.iter().zip(lanes) {
                let partners = group.partners(self.index);
                let bound = self.max_distance * self.max_distance;
                sums.add(&group.at, &partners, lanes, bound, self.centre);
            }
        }
        sums.total()
    }
}

/// Searches for groups that ask from within their corners.
#[inline(always)]
fn search<C: Coordinate, F: Found>(
    width: impl Width,
    index: &BlockIndex<C>,
    (groups, corners): (&[Group], &[Corners; TOGETHER]),
    found: &mut [F; TOGETHER],
    near: &mut Neighbourhood,
) {
    let asking: [_; TOGETHER] = std::array::from_fn(|k| {
        let k = k.min(groups.len() - 1);
        (&groups[k].at, corners[k])
    });
    near.search(
        width,
        index,
        &asking[..groups.len()],
        &mut found[..groups.len()],
    );
}

/// Searches for all partners.
#[inline(always)]
fn coarse<C: Coordinate>(
    width: impl Width,
    index: &BlockIndex<C>,
    max_distance: f64,
    groups: &mut [Group],
    lanes: &[usize; TOGETHER],
    near: &mut Neighbourhood,
) {
    let mut found = [Closest::NOTHING; TOGETHER];
    let mut corners = [NOWHERE; TOGETHER];
    for (k, group) in groups.iter().enumerate() {
        let partners = group.partners(index);
        for lane in 0..LANES {
            let known = squared_distance_at(&group.at, &partners, lane);
            let bound = smaller(known, max_distance * max_distance);
            found[k].best[lane] = if lane < lanes[k] { bound } else { 0.0 };
        }
        corners[k] = group.at.bounds();
    }
    search(width, index, (groups, &corners), &mut found, near);
    for (group, found) in groups.iter_mut().zip(&found) {
        for lane in 0..LANES {
            if found.partner[lane] != NONE {
                group.partner[lane] = found.partner[lane];
            }
        }
    }
}

/// Searches for the partners that may have changed, and how far away all others are.
#[inline(always)]
fn fine<C: Coordinate>(
    width: impl Width,
    index: &BlockIndex<C>,
    max_distance: f64,
    groups: &mut [Group],
    (lanes, steps, others): (
        &[usize; TOGETHER],
        &[[f64; LANES]; TOGETHER],
        &mut [[f32; LANES]],
    ),
    near: &mut Neighbourhood,
) {
    let mut found = [Nearest::NOTHING; TOGETHER];
    let mut corners = [NOWHERE; TOGETHER];
    let mut stale = [0; TOGETHER];
    for (k, group) in groups.iter_mut().enumerate() {
        let margin = (&steps[k], &mut others[k]);
        stale[k] = group.stale(index, max_distance, lanes[k], margin, &mut found[k]);
        for lane in (0..LANES).filter(|lane| stale[k] >> lane & 1 == 1) {
            corners[k] = around(corners[k], group.at.point(lane));
        }
    }
    search(width, index, (groups, &corners), &mut found, near);
    let results = groups.iter_mut().zip(others).zip(&found).zip(stale);
    for (((group, others), found), stale) in results {
        for lane in (0..LANES).filter(|lane| stale >> lane & 1 == 1) {
            group.partner[lane] = found.partner[lane];
            let second = found.second[lane].sqrt() * SAFETY;
            others[lane] = smaller(second, f64::from(f32::MAX)) as f32;
        }
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
    fn partners<C: Coordinate>(&self, index: &BlockIndex<C>) -> Block {
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

    /// A bit for each lane whose partner may have changed, with what to ask for it.
    #[inline(always)]
    fn stale<C: Coordinate>(
        &self,
        index: &BlockIndex<C>,
        max_distance: f64,
        lanes: usize,
        (steps, others): (&[f64; LANES], &mut [f32; LANES]),
        found: &mut Nearest,
    ) -> u32 {
        let partners = self.partners(index);
        let mut known = [0.0; LANES];
        let mut stale = 0u32;
        for lane in 0..LANES {
            known[lane] = squared_distance_at(&self.at, &partners, lane).sqrt();
            let second = (f64::from(others[lane]) - steps[lane]) * SAFETY;
            others[lane] = second as f32;
            let kept = smaller(known[lane], max_distance) < second;
            stale |= u32::from(!kept) << lane;
        }
        stale &= (1 << lanes) - 1;
        let ceiling = (max_distance * BEYOND).powi(2).next_up();
        for lane in (0..LANES).filter(|lane| stale >> lane & 1 == 1) {
            found.second[lane] = ceiling;
            if self.partner[lane] != NONE {
                // Far enough to meet what may be nearer than the partner, and most likely the next.
                let spacing = index.spacing_at(self.partner[lane] as usize / LANES);
                let reach = known[lane] / SAFETY + steps[lane] + spacing;
                found.second[lane] = smaller((reach * reach).next_up(), ceiling);
            }
        }
        stale
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::align::tests::scattered;
    use crate::distance::{Order, listed};

    fn sheet(seed: u64, count: u64) -> Vec<DVec3> {
        let bump = |p: &DVec3| DVec3::new(p.x, p.y, 0.3 * p.x * p.x - 0.2 * p.x * p.y);
        scattered(seed, count).iter().map(bump).collect()
    }

    /// Pairs and sums at every width, over motions of falling size: the coarse and the fine search.
    #[test]
    fn every_width_pairs_and_sums_alike() {
        let target = sheet(70, 5_000);
        let source = sheet(71, 3_001);
        let index = BlockIndex::new(&target).unwrap();
        let source = listed(&source, Order::Any);
        let run = |registers| moves(Tracker::new(&index, Source::of(&source), 0.3), registers);
        let expected = run(Registers::Baseline);
        assert!(expected.iter().all(|sums| sums.pairs > 2_900));
        for registers in [Registers::Avx2, Registers::Avx512] {
            if registers.are_there() {
                assert_eq!(run(registers), expected, "{registers:?}");
            }
        }
    }

    fn moves<C: Coordinate>(mut tracker: Tracker<'_, C>, registers: Registers) -> Vec<PairSums> {
        tracker.registers = registers;
        let step = |k: i32| DMat4::from_translation(DVec3::new(0.02, 0.01, 0.05) * 0.3f64.powi(k));
        (0..7).map(|k| tracker.moved(step(k))).collect()
    }

    /// Targets kept as f32, and a source that came in stretches, at every width.
    #[test]
    fn narrow_targets_and_gathered_sources_pair_alike() {
        let spatial = |points: Vec<DVec3>| -> Vec<DVec3> {
            let order = super::super::spatial_order(&points);
            order.iter().map(|&index| points[index as usize]).collect()
        };
        let narrow = sheet(72, 5_000).into_iter().map(|p| p.as_vec3().as_dvec3());
        let target = spatial(narrow.collect());
        let source = spatial(sheet(73, 3_001));
        let wide = BlockIndex::of(&listed(&target, Order::Spatial)).unwrap();
        let narrow = BlockIndex::gathered_narrow(0, |take| target.chunks(999).try_for_each(take));
        let narrow = narrow.unwrap().unwrap();
        let gathered = || {
            Source::gathered(source.len(), |take| source.chunks(777).try_for_each(take)).unwrap()
        };
        let listed = || Source::of(&listed(&source, Order::Spatial));
        for registers in [Registers::Baseline, Registers::Avx2, Registers::Avx512] {
            if registers.are_there() {
                let expected = moves(Tracker::new(&wide, listed(), 0.3), registers);
                assert!(expected.iter().all(|sums| sums.pairs > 2_900));
                assert_eq!(
                    moves(Tracker::new(&wide, gathered(), 0.3), registers),
                    expected
                );
                assert_eq!(
                    moves(Tracker::new(&narrow, gathered(), 0.3), registers),
                    expected
                );
            }
        }
    }
}
