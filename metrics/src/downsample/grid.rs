//! Where voxels lie.
#![allow(
    clippy::needless_range_loop,
    reason = "one index runs over several columns"
)]

use super::Point;
use crate::distance::hilbert::hilbert;
use crate::distance::wide::{Registers, Task, Width};
use crate::error::{Error, Result};
use glam::DVec3;

/// Where the voxels lie.
pub(super) struct Grid {
    start: DVec3,
    size: f64,
    /// Voxels are sorted by cells of 2 to this power voxels along each axis.
    pub(super) shift: u32,
    /// Bits of the number of a cell along an axis.
    cell_bits: u32,
    /// The power of 2 by which cells are wider than the finest that can be sorted by.
    wider: u32,
}

impl Grid {
    pub(super) fn check_size(size: f64) -> Result<()> {
        if !(size.is_finite() && size > 0.0) {
            let problem = format!("expected a finite size above 0, found {size:?}");
            return Err(Error::invalid("voxel size", problem));
        }
        Ok(())
    }

    /// The grid around points, at least one.
    pub(super) fn around(points: impl Iterator<Item = DVec3>, size: f64) -> Result<Self> {
        let (mut min, mut max) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        for (index, point) in points.enumerate() {
            if !point.is_finite() {
                let problem = format!(
                    "expected finite points, found {point} at {index}: drop such points first"
                );
                return Err(Error::invalid("voxel grid", problem));
            }
            (min, max) = (min.min(point), max.max(point));
        }
        Self::between((min, max), size)
    }

    /// The grid around a finite box.
    pub(super) fn between((min, max): (DVec3, DVec3), size: f64) -> Result<Self> {
        Self::check_size(size)?;
        let half = DVec3::splat(size * 0.5);
        let (start, end) = (min - half, max + half);
        let extent = (end - start).max_element();
        if size * f64::from(i32::MAX) < extent {
            let problem = format!(
                "expected at most 2147483647 voxels along an axis, found a cloud {extent:?} wide \
                 and voxels of {size:?}: enlarge the voxels or remove outliers"
            );
            return Err(Error::invalid("voxel size", problem));
        }
        let mut grid = Self {
            start,
            size,
            shift: 0,
            cell_bits: 0,
            wider: 0,
        };
        let last = grid.voxel_of(max).into_iter().fold(0, i32::max);
        let bits = u32::BITS - last.unsigned_abs().leading_zeros();
        grid.cell_bits = bits.min(CELL_BITS);
        grid.shift = bits - grid.cell_bits;
        Ok(grid)
    }

    /// The same with cells that hold some points each, so that neighbours in the list are mostly in one
    /// cell: a surface goes through about twice as many of them as lie on one side of the grid.
    pub(super) fn for_points(mut self, count: usize) -> Self {
        let cells = |bits: u32| 2usize << (2 * bits);
        while self.cell_bits > 0
            && self.shift < LISTED_SHIFT
            && count < POINTS_OF_CELL * cells(self.cell_bits)
        {
            self.cell_bits -= 1;
            self.shift += 1;
            self.wider += 1;
        }
        self
    }

    /// The cast rounds to 0, which is down: nothing is below the start.
    #[inline]
    pub(super) fn voxel_of(&self, point: DVec3) -> [i32; 3] {
        let scaled = (point - self.start) / self.size;
        scaled.to_array().map(|along| along as i32)
    }

    /// [`Grid::voxel_of`] each of as many points, and the same.
    #[inline]
    pub(super) fn voxels_of(&self, points: &[Point], voxels: &mut [[i32; 3]]) {
        Registers::widest().run(Voxels {
            grid: self,
            points,
            voxels,
        });
    }

    /// The cell of a voxel.
    #[inline]
    pub(super) fn cell_of(&self, voxel: [i32; 3]) -> [u32; 3] {
        voxel.map(|along| along as u32 >> self.shift)
    }

    /// A cell's place along the curve: that of the first of the finest cells in it.
    #[inline]
    pub(super) fn place_of(&self, cell: [u32; 3]) -> u32 {
        let [x, y, z] = cell.map(|along| along << self.wider);
        hilbert::<CELL_BITS>(x, y, z) >> (3 * self.wider) << (3 * self.wider)
    }

    /// The number of a voxel within its cell, by x, then y, then z.
    #[inline]
    pub(super) fn number_in_cell(&self, voxel: [i32; 3]) -> usize {
        let mask = (1 << self.shift) - 1;
        let [x, y, z] = voxel.map(|along| along as usize & mask);
        (x << self.shift | y) << self.shift | z
    }
}

/// The voxels of some points.
struct Voxels<'a> {
    grid: &'a Grid,
    points: &'a [Point],
    voxels: &'a mut [[i32; 3]],
}

/// Bits of the number of a cell along an axis at most.
pub(super) const CELL_BITS: u32 = 8;
/// Cells are widened to hold about this many points, as long as
const POINTS_OF_CELL: usize = 32;
/// they are at most 2 to this power voxels wide: the voxels of larger ones have no lists.
pub(super) const LISTED_SHIFT: u32 = 6;
/// Points of which the voxels are made at a time: coordinates in whole registers.
const TOGETHER: usize = 8;

impl Task for Voxels<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self, _: impl Width) {
        let start: [f64; 3 * TOGETHER] = std::array::from_fn(|k| self.grid.start[k % 3]);
        let size = self.grid.size;
        let mut points = self.points.as_flattened().chunks_exact(3 * TOGETHER);
        let mut voxels = self
            .voxels
            .as_flattened_mut()
            .chunks_exact_mut(3 * TOGETHER);
        for (points, voxels) in points.by_ref().zip(voxels.by_ref()) {
            let mut along = [0.0; 3 * TOGETHER];
            along.copy_from_slice(points);
            for k in 0..3 * TOGETHER {
                along[k] = (along[k] - start[k]) / size;
            }
            voxels.copy_from_slice(&along.map(|along| along as i32));
        }
        let rest = points.remainder().iter().zip(voxels.into_remainder());
        for ((along, voxel), start) in rest.zip(start) {
            *voxel = ((along - start) / size) as i32;
        }
    }
}
