//! Blocks of pixels from the rows of a map.

#![allow(
    clippy::needless_range_loop,
    reason = "columns are walked side by side, and closures would leave the instruction set"
)]

use super::kernel::{BLOCK, Block};
use super::samples::{Grid, Unit};
use pulp::{Simd, WithSimd};

/// Columns of a strip.
pub(super) const STRIP: usize = 16;

/// Room for a block and what is left of a row when it is full.
const ROOM: usize = BLOCK + STRIP;

/// Pixels that have a depth, on their way into blocks.
pub(super) struct Packing {
    len: usize,
    column: [u32; ROOM],
    row: [u32; ROOM],
    /// As it is stored in the map, > 0.
    stored: [f32; ROOM],
}

impl Packing {
    pub(super) fn new() -> Self {
        Self {
            len: 0,
            column: [0; ROOM],
            row: [0; ROOM],
            stored: [1.0; ROOM],
        }
    }

    pub(super) fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// Whether there is enough for a block.
    pub(super) fn is_full(&self) -> bool {
        self.len >= BLOCK
    }

    /// Adds those of a row's `values` from a column on, at most [`STRIP`], that are depths; it must not be
    /// full.
    #[inline(always)]
    pub(super) fn add(&mut self, (column, row): (u32, u32), values: &[f32]) {
        let first = self.len;
        self.row[first..first + STRIP].fill(row);
        if let Ok(values) = <&[f32; STRIP]>::try_from(values)
            && values.iter().fold(true, |all, &value| all & (value > 0.0))
        {
            self.stored[first..first + STRIP].copy_from_slice(values);
            let columns = self.column[first..first + STRIP].iter_mut();
            for (to, column) in columns.zip(column..) {
                *to = column;
            }
            self.len += STRIP;
            return;
        }
        let mut at = first;
        for (column, &value) in (column..).zip(values) {
            // What is no depth is written over by what comes next.
            (self.column[at], self.stored[at]) = (column, value);
            at += usize::from(value > 0.0);
        }
        self.len = at;
    }

    /// Forgets what was put into a block.
    fn shift(&mut self) {
        self.len = self.len.saturating_sub(BLOCK);
        self.column.copy_within(BLOCK.., 0);
        self.row.copy_within(BLOCK.., 0);
        self.stored.copy_within(BLOCK.., 0);
    }
}

/// Takes a block out of what is there, which must be something.
pub(super) struct Take<'a> {
    pub(super) packing: &'a mut Packing,
    pub(super) block: &'a mut Block,
    pub(super) grid: Grid,
    pub(super) unit: Unit,
}

impl WithSimd for Take<'_> {
    type Output = ();

    #[inline(always)]
    #[allow(clippy::cast_precision_loss, reason = "image sizes are far below 2^23")]
    fn with_simd<S: Simd>(self, _: S) {
        let Self {
            packing,
            block,
            grid,
            unit,
        } = self;
        block.len = packing.len.min(BLOCK);
        let last = packing.len - 1;
        // Entries beyond the last are like it.
        for i in packing.len..BLOCK {
            packing.column[i] = packing.column[last];
            packing.row[i] = packing.row[last];
            packing.stored[i] = packing.stored[last];
        }
        for i in 0..BLOCK {
            let (column, row) = (packing.column[i], packing.row[i]);
            (block.pixel[i], block.place[i]) = grid.numbers(column, row);
            (block.column[i], block.row[i]) = (column, row);
            block.u[i] = column as i32 as f32 + 0.5;
            block.v[i] = row as i32 as f32 + 0.5;
            block.depth[i] = unit.convert(packing.stored[i]);
        }
        packing.shift();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fuse::testing::{rng, uniform};
    use pulp::Arch;

    fn same(block: &Block, other: &Block) -> bool {
        let numbers = |block: &Block| {
            let places = (block.pixel, block.place);
            (block.len, places, block.column, block.row)
        };
        let values =
            |block: &Block| [block.u, block.v, block.depth].map(|all| all.map(f32::to_bits));
        numbers(block) == numbers(other) && values(block) == values(other)
    }

    /// Rows without depths, with all, with some, and short ones at the end, pixel by pixel.
    #[test]
    fn blocks_hold_the_depths_of_rows_one_after_the_other() {
        let mut random = rng(9);
        for unit in [Unit::Depth, Unit::Inverse] {
            let grid = Grid::whole(90);
            let (mut packing, mut blocks, mut expected) = (Packing::new(), 0, Block::new());
            for row in 0..500u32 {
                let column = 16 * (row * 7 % 5);
                let length = if column == 64 { 11 } else { STRIP };
                let filled = [0.0, 0.5, 0.97, 1.0, 1.0][row as usize * 3 % 5];
                let mut draw = || {
                    let value = uniform(&mut random, 0.1, 9.0) as f32;
                    if uniform(&mut random, 0.0, 1.0) < filled {
                        value
                    } else {
                        0.0
                    }
                };
                let values: Vec<f32> = (0..length).map(|_| draw()).collect();
                packing.add((column, row), &values);
                let mut left = Vec::new();
                for (column, &value) in (column..).zip(&values).filter(|(_, value)| **value > 0.0) {
                    if expected.is_full() {
                        left.push((column, value));
                    } else {
                        expected.push(grid, column, row, unit.convert(value));
                    }
                }
                assert_eq!(packing.is_full(), expected.is_full());
                if packing.is_full() {
                    assert!(same(&take(&mut packing, unit), &expected));
                    blocks += 1;
                    expected.len = 0;
                    for (column, value) in left {
                        expected.push(grid, column, row, unit.convert(value));
                    }
                }
            }
            assert!(blocks > 50 && !packing.is_empty());
            // What is left is filled up with its last pixel.
            let rest = take(&mut packing, unit);
            let last = expected.len - 1;
            let (u, v, depth) = (expected.u[last], expected.v[last], expected.depth[last]);
            for i in expected.len..BLOCK {
                (expected.u[i], expected.v[i], expected.depth[i]) = (u, v, depth);
                (expected.column[i], expected.row[i]) = (expected.column[last], expected.row[last]);
                (expected.pixel[i], expected.place[i]) =
                    (expected.pixel[last], expected.place[last]);
            }
            assert!(same(&rest, &expected) && packing.is_empty());
        }
    }

    fn take(packing: &mut Packing, unit: Unit) -> Block {
        let mut block = Block::new();
        Arch::new().dispatch(Take {
            packing,
            block: &mut block,
            grid: Grid::whole(90),
            unit,
        });
        block
    }
}
