//! The inner loop's first half: where a block of reference pixels lies in one source.
//!
//! Plain loops over fixed arrays, which the compiler turns into vector instructions; `pulp` picks
//! the widest set the machine has at run time. Everything here, in [`super::taps`] and in
//! [`super::rules`] is inlined into the function that `pulp` compiles for each set (a closure would
//! not be: `rules` hands it a struct).
//! Multiplications are fused with additions only where it says so, everywhere alike, so every set
//! gives the same bits (one without that instruction is slow). Positions are computed in f64
//! (a pixel is found to 1e-10), ratios of depths in f32 (6e-8), and depths only ever as
//! `reference + small difference`.

#![allow(
    clippy::needless_range_loop,
    reason = "columns are walked side by side, and closures would leave the instruction set"
)]

use super::geometry::PairGeometry;
use super::near::{Near, Relative, whole};
#[cfg(test)]
use super::samples::Grid;
use super::samples::Samples;
use crate::ahead::prefetch;
use mvs_datasets::scene::View;

/// Pixels per block: what ten sources say about one stays in the first-level cache.
pub(super) const BLOCK: usize = 64;

/// Reference pixels to test, their depths known. Entries from `len` on are harmless.
///
/// As nearly all that the loop goes over, laid out so that vectors of entries begin where cache lines do: the
/// widest are as long as a line, and each would be fetched from two.
#[repr(C, align(64))]
pub(super) struct Block {
    /// Index of the pixel in its map, row-major.
    pub(super) pixel: [u32; BLOCK],
    /// Its index in the bordered map.
    pub(super) place: [u32; BLOCK],
    pub(super) column: [u32; BLOCK],
    pub(super) row: [u32; BLOCK],
    /// Continuous image coordinates of the pixel centre.
    pub(super) u: [f32; BLOCK],
    pub(super) v: [f32; BLOCK],
    /// z-depth, > 0.
    pub(super) depth: [f32; BLOCK],
    pub(super) len: usize,
}

impl Block {
    pub(super) fn new() -> Self {
        Self {
            len: 0,
            pixel: [0; BLOCK],
            place: [0; BLOCK],
            column: [0; BLOCK],
            row: [0; BLOCK],
            u: [0.5; BLOCK],
            v: [0.5; BLOCK],
            depth: [1.0; BLOCK],
        }
    }

    /// Adds a pixel of a map; the block must not be full.
    #[cfg(test)]
    pub(super) fn push(&mut self, grid: Grid, column: u32, row: u32, depth: f32) {
        let at = self.len;
        (self.pixel[at], self.place[at]) = grid.numbers(column, row);
        (self.column[at], self.row[at]) = (column, row);
        #[allow(clippy::cast_precision_loss, reason = "image sizes are far below 2^23")]
        {
            self.u[at] = column as f32 + 0.5;
            self.v[at] = row as f32 + 0.5;
        }
        self.depth[at] = depth;
        self.len += 1;
    }

    /// The column and row of a pixel.
    pub(super) fn at(&self, i: usize) -> (usize, usize) {
        (self.column[i] as usize, self.row[i] as usize)
    }

    #[cfg(test)]
    pub(super) fn is_full(&self) -> bool {
        self.len == BLOCK
    }
}

/// What one source says about a block.
#[derive(Clone, Debug, PartialEq)]
#[repr(C, align(64))]
pub(super) struct Seen {
    /// Where the hypothesis projects to, in the source's continuous image coordinates shifted by
    /// half a pixel (so that whole numbers are pixel centres of the bordered map); if that is kept.
    pub(super) x: [f32; BLOCK],
    pub(super) y: [f32; BLOCK],
    /// `z` / sampled depth; 0 without a sample.
    pub(super) ratio: [f32; BLOCK],
    /// Reprojected depth minus the reference's; 0 without a sample.
    pub(super) delta: [f32; BLOCK],
    /// 1 where the source agrees, else 0; filled by a rule.
    pub(super) agrees: [u32; BLOCK],
}

impl Seen {
    pub(super) fn new() -> Self {
        Self {
            x: [0.0; BLOCK],
            y: [0.0; BLOCK],
            ratio: [0.0; BLOCK],
            delta: [0.0; BLOCK],
            agrees: [0; BLOCK],
        }
    }

    /// Says that nothing projects into the map; the positions stay.
    #[inline(always)]
    pub(super) fn nothing(&mut self) {
        self.ratio = [0.0; BLOCK];
        self.delta = [0.0; BLOCK];
        self.agrees = [0; BLOCK];
    }
}

/// A pair of views, ready for the inner loop.
#[derive(Debug, Clone)]
pub(super) struct Pair {
    /// Columns of the rotation, then the translation of [`PairGeometry`].
    pub(super) columns: [[f64; 3]; 4],
    /// (e_x, e_y, c_z).
    pub(super) epipole: [f32; 3],
}

/// The four pixels of the source around each position.
#[repr(C, align(64))]
pub(super) struct Footprint {
    /// z-depth of the hypothesis in the source; 0 where it does not project into the map.
    pub(super) z: [f32; BLOCK],
    /// 1 / `z`, or 0.
    pub(super) inverse: [f32; BLOCK],
    /// The place in the bordered map of the upper left one.
    pub(super) index: [u32; BLOCK],
    /// How far the position lies to the right of it, and below.
    pub(super) fx: [f32; BLOCK],
    pub(super) fy: [f32; BLOCK],
    /// Whether anything projects into the map.
    pub(super) any: bool,
}

impl Footprint {
    pub(super) fn new() -> Self {
        Self {
            z: [0.0; BLOCK],
            inverse: [0.0; BLOCK],
            index: [0; BLOCK],
            fx: [0.0; BLOCK],
            fy: [0.0; BLOCK],
            any: false,
        }
    }
}

impl Pair {
    pub(super) fn new(reference: &View, source: &View) -> Self {
        let geometry = PairGeometry::new(reference, source);
        let rotation = geometry.rotation;
        #[allow(
            clippy::cast_possible_truncation,
            reason = "f32 is what the loop works in"
        )]
        let epipole = geometry.epipole.to_array().map(|value| value as f32);
        Self {
            columns: [
                rotation.x_axis.to_array(),
                rotation.y_axis.to_array(),
                rotation.z_axis.to_array(),
                geometry.translation.to_array(),
            ],
            epipole,
        }
    }

    /// Source depths and the four pixels, which are asked for; and positions, if they are `KEPT`. The block was
    /// set up in this source as `relative`'s number k.
    #[inline(always)]
    pub(super) fn project<const KEPT: bool>(
        &self,
        (block, near, (relative, k)): (&Block, &Near, (&Relative, usize)),
        source: &Samples,
        seen: &mut Seen,
        to: &mut Footprint,
    ) {
        if relative.fits(k) {
            relative.project::<KEPT>(k, (near, source.stride()), seen, to);
        } else {
            self.project_widely::<KEPT>(block, source, seen, to);
        }
        to.any = to.z.iter().fold(false, |any, &z| any | (z > 0.0));
        // All of them: one in two let more of the others wait than it saved, a twenty-fifth of the loop at
        // 1920x1080.
        for &first in &to.index {
            prefetch(source.values(), first as usize);
            prefetch(source.values(), first as usize + source.stride());
        }
    }

    /// The same for any block.
    #[inline(always)]
    pub(super) fn project_widely<const KEPT: bool>(
        &self,
        block: &Block,
        source: &Samples,
        seen: &mut Seen,
        to: &mut Footprint,
    ) {
        let [a, b, c, t] = self.columns;
        #[allow(clippy::cast_precision_loss, reason = "image sizes are far below 2^52")]
        let (right, bottom, stride) = (
            (source.width() + 1) as f64,
            (source.height() + 1) as f64,
            source.stride() as f64,
        );
        // From a column of the map with a border of one pixel to one of the values, of which the first and the
        // last two are 0: what lies beyond the stored columns.
        let left = source.columns().start as f64 - 1.0;
        let last = stride - 2.0;
        for i in 0..BLOCK {
            let (u, v, depth) = (
                f64::from(block.u[i]),
                f64::from(block.v[i]),
                f64::from(block.depth[i]),
            );
            let along = |axis: usize| {
                let direction = a[axis].mul_add(u, b[axis].mul_add(v, c[axis]));
                depth.mul_add(direction, t[axis])
            };
            let (px, py, pz) = (along(0), along(1), along(2));
            let inverse = 1.0 / pz;
            let (x, y) = (px.mul_add(inverse, 0.5), py.mul_add(inverse, 0.5));
            let inside = (pz > 0.0) & (x >= 0.0) & (y >= 0.0) & (x < right) & (y < bottom);
            let x = if inside { x } else { 0.0 };
            let y = if inside { y } else { 0.0 };
            let (column, row) = (x.floor(), y.floor());
            let stored = column - left;
            let stored = if stored > 0.0 { stored } else { 0.0 };
            let stored = if stored < last { stored } else { last };
            to.index[i] = whole(row.mul_add(stride, stored));
            to.fx[i] = (x - column) as f32;
            to.fy[i] = (y - row) as f32;
            if KEPT {
                seen.x[i] = x as f32;
                seen.y[i] = y as f32;
            }
            to.z[i] = if inside { pz as f32 } else { 0.0 };
            to.inverse[i] = if inside { inverse as f32 } else { 0.0 };
        }
    }
}

#[cfg(test)]
mod tests;
