//! Points in the order of the grid's cells.
//!
//! Points that are neighbours in their list mostly lie in one cell: they are sorted as one.

use super::grid::{CELL_BITS, Grid};
use super::{Members, Point};
use crate::distance::hilbert;
use glam::DVec3;
use rayon::prelude::*;
use std::ops::Range;

/// Points whose runs one task makes.
const POINTS: usize = 1 << 14;
/// Points looked at together.
const BATCH: usize = 256;
/// Runs of which one task takes the means, at least.
const PIECE: usize = 1 << 9;

/// The last cell on the curve.
const LAST: u32 = (1 << (3 * CELL_BITS)) - 1;
/// A run packed: its cell, counted from the curve's end, its first index, and how many more indices
/// follow.
const CELL: u32 = 40;
/// See [`CELL`].
const FIRST: u32 = 8;
/// Points of a run at most.
const LONGEST: u32 = 1 << FIRST;

/// The cell of a run, counted from the curve's end.
pub(super) fn cell(run: u64) -> u64 {
    run >> CELL
}

/// The indices of a run.
pub(super) fn members(run: u64) -> Range<usize> {
    let first = (run >> FIRST) as u32 as usize;
    first..first + (run % u64::from(LONGEST)) as usize + 1
}

/// Where a last piece of sorted runs starts, which begins where a cell does.
pub(super) fn last_piece(runs: &[u64]) -> usize {
    let Some(latest) = runs.len().checked_sub(PIECE) else {
        return 0;
    };
    let cell = cell(runs[latest]);
    runs.partition_point(|&run| self::cell(run) < cell)
}

/// All runs, sorted by cell and then by index.
pub(super) fn sorted<P, R>(members: &Members<'_, P, R>, grid: &Grid) -> Vec<u64>
where
    P: Fn(usize, &mut [Point]) + Sync,
    R: Sync,
{
    let tasks = members.indices.len().div_ceil(POINTS);
    let some: Vec<Vec<u64>> = (0..tasks)
        .into_par_iter()
        .map(|task| unsorted(members, grid, task * POINTS))
        .collect();
    let mut runs = Vec::with_capacity(some.iter().map(Vec::len).sum());
    some.into_iter().for_each(|some| runs.extend(some));
    hilbert::radix_sort::<CELL, { 3 * CELL_BITS / 2 }, 2>(&mut runs, &mut Vec::new());
    runs
}

/// The runs among the points from the n-th on.
fn unsorted<P, R>(members: &Members<'_, P, R>, grid: &Grid, nth: usize) -> Vec<u64>
where
    P: Fn(usize, &mut [Point]),
{
    let (mut room, mut voxels) = ([[0.0; 3]; BATCH], [[0; 3]; BATCH]);
    let mut runs = Vec::with_capacity(POINTS / 2);
    let mut open = Open::default();
    for stretch in members.indices.stretches(nth, POINTS) {
        for first in stretch.clone().step_by(BATCH) {
            let count = BATCH.min((stretch.end - first) as usize);
            (members.points)(first as usize, &mut room[..count]);
            grid.voxels_of(&room[..count], &mut voxels[..count]);
            for (&voxel, index) in voxels[..count].iter().zip(first..) {
                let cell = grid.cell_of(voxel);
                if !open.goes_on(cell, index) {
                    runs.extend(open.packed(grid));
                    open = Open::at(cell, index);
                }
                open.count += 1;
            }
        }
    }
    runs.extend(open.packed(grid));
    runs
}

/// A run that may go on.
#[derive(Default)]
struct Open {
    cell: [u32; 3],
    first: u32,
    count: u32,
}

impl Open {
    fn at(cell: [u32; 3], first: u32) -> Self {
        let count = 0;
        Self { cell, first, count }
    }

    #[inline]
    fn goes_on(&self, cell: [u32; 3], index: u32) -> bool {
        cell == self.cell && index.wrapping_sub(self.first) == self.count && self.count < LONGEST
    }

    /// The run, if it has points.
    #[inline]
    fn packed(&self, grid: &Grid) -> Option<u64> {
        let more = self.count.checked_sub(1)?;
        let cell = u64::from(LAST - grid.place_of(self.cell));
        Some(cell << CELL | u64::from(self.first) << FIRST | u64::from(more))
    }
}

/// All points, one by one.
pub(super) fn points<P, R>(members: &Members<'_, P, R>) -> impl Iterator<Item = DVec3>
where
    P: Fn(usize, &mut [Point]),
{
    members.indices.iter().map(|index| {
        let mut room = [[0.0; 3]];
        (members.points)(index as usize, &mut room);
        DVec3::from(room[0])
    })
}
