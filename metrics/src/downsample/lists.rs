//! Points listed by their voxels.

use super::Point;
use super::grid::{Grid, LISTED_SHIFT};
use glam::DVec3;
use std::ops::Range;

/// No point.
const NONE: u32 = u32::MAX;

/// The points of some cells, and lists of those of one cell by voxel.
pub(super) struct Lists {
    points: Vec<Point>,
    indices: Vec<u32>,
    voxels: Vec<[i32; 3]>,
    /// Per voxel of a cell the point listed last.
    last: Vec<u32>,
    /// A bit per voxel that has points.
    occupied: Vec<u64>,
    /// Per point the one listed before it in its voxel.
    before: Vec<u32>,
    /// The points of one voxel and their ranks.
    voxel: Vec<(u32, u32)>,
}

impl Lists {
    pub(super) fn new(grid: &Grid) -> Self {
        let listed = grid.shift <= LISTED_SHIFT;
        let voxels = if listed { 1 << (3 * grid.shift) } else { 0 };
        Self {
            points: Vec::new(),
            indices: Vec::new(),
            voxels: Vec::new(),
            last: vec![NONE; voxels],
            occupied: vec![0; voxels.div_ceil(64)],
            before: Vec::new(),
            voxel: Vec::new(),
        }
    }

    /// Takes points instead of those before.
    pub(super) fn gather(
        &mut self,
        runs: impl Iterator<Item = Range<usize>>,
        points: &impl Fn(usize, &mut [Point]),
        grid: &Grid,
    ) {
        self.points.clear();
        self.indices.clear();
        for run in runs {
            let from = self.points.len();
            self.points.resize(from + run.len(), [0.0; 3]);
            points(run.start, &mut self.points[from..]);
            self.indices.extend(run.map(|index| index as u32));
        }
        self.before.resize(self.points.len(), NONE);
        self.voxels.resize(self.points.len(), [0; 3]);
        grid.voxels_of(&self.points, &mut self.voxels);
    }

    /// Adds the means of the voxels of some gathered points, all those in one cell: by x, then y, then
    /// z.
    pub(super) fn means(
        &mut self,
        cell: Range<usize>,
        grid: &Grid,
        rank: &impl Fn(usize) -> u32,
        means: &mut Vec<DVec3>,
    ) {
        // To look through all lists takes points enough.
        if self.last.is_empty() || cell.len() * 16 < self.occupied.len() {
            return self.means_by_sorting(cell, rank, means);
        }
        for place in cell {
            let number = grid.number_in_cell(self.voxels[place]);
            self.before[place] = std::mem::replace(&mut self.last[number], place as u32);
            self.occupied[number / 64] |= 1 << (number % 64);
        }
        for word in 0..self.occupied.len() {
            let mut bits = std::mem::take(&mut self.occupied[word]);
            while bits != 0 {
                let number = word * 64 + bits.trailing_zeros() as usize;
                bits &= bits - 1;
                let last = std::mem::replace(&mut self.last[number], NONE);
                means.push(self.mean(last, rank));
            }
        }
    }

    /// The mean of a voxel, whose last point this is.
    #[inline]
    fn mean(&mut self, last: u32, rank: &impl Fn(usize) -> u32) -> DVec3 {
        let sum = DVec3::ZERO + self.point(last);
        let before = self.before[last as usize];
        if before == NONE {
            return sum;
        }
        if self.before[before as usize] == NONE {
            // Whichever comes first.
            return (sum + self.point(before)) / 2.0;
        }
        self.voxel.clear();
        let mut place = last;
        while place != NONE {
            self.voxel
                .push((rank(self.indices[place as usize] as usize), place));
            place = self.before[place as usize];
        }
        self.voxel.sort_unstable();
        let add = |sum, &(_, place): &(u32, u32)| sum + self.point(place);
        self.voxel.iter().fold(DVec3::ZERO, add) / self.voxel.len() as f64
    }

    #[inline]
    fn point(&self, place: u32) -> DVec3 {
        DVec3::from(self.points[place as usize])
    }

    /// As [`Lists::means`], whatever the size of cells.
    fn means_by_sorting(
        &self,
        cell: Range<usize>,
        rank: &impl Fn(usize) -> u32,
        means: &mut Vec<DVec3>,
    ) {
        let point = |place: usize| DVec3::from(self.points[place]);
        let member = |place| {
            (
                self.voxels[place],
                rank(self.indices[place] as usize),
                point(place),
            )
        };
        let mut sorted: Vec<([i32; 3], u32, DVec3)> = cell.map(member).collect();
        sorted.sort_unstable_by_key(|&(voxel, rank, _)| (voxel, rank));
        for voxel in sorted.chunk_by(|a, b| a.0 == b.0) {
            let sum = voxel.iter().fold(DVec3::ZERO, |sum, member| sum + member.2);
            means.push(sum / voxel.len() as f64);
        }
    }
}
