//! A square of samples with what is nearest at each, and how far the farthest of each block is.

use super::Visible;
use super::lanes::{LANES, Lanes};
use std::hint::select_unpredictable;
use std::ops::Range;

/// Most samples along each side: of smaller tiles, each cluster would lie in more.
pub(crate) const SIDE: usize = 2 * SIZE;
/// Samples along each side of the parts in which maps and colours are worked out.
pub(crate) const SIZE: usize = 64;
/// From a row to the next of tiles no wider than [`SIZE`]: a row is followed by samples that are never
/// seen, so that lanes may reach beyond its end.
pub(crate) const STRIDE: usize = SIZE + LANES;
/// Samples along each side of a block.
pub(crate) const BLOCK: usize = 8;
const BLOCKS: usize = SIDE / BLOCK;
/// Stands for no triangle.
pub(crate) const NONE: u32 = u32::MAX;
/// Relative difference of depths above which the fast paths are trusted to know the nearer.
pub(crate) const DOUBT: f32 = 1e-4;

/// A sample of a tile.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Spot {
    pub(crate) column: usize,
    pub(crate) row: usize,
}

impl Spot {
    /// Where it stands in the columns of a tile no wider than [`SIZE`].
    #[inline(always)]
    pub(crate) fn index(self) -> usize {
        self.row * STRIDE + self.column
    }
}

/// Nearness, that is 1 / z-depth, and the visible triangle of each sample.
#[derive(Debug, Clone)]
pub(crate) struct Tile {
    /// 0 where there is no surface, infinite beyond the tile's used part.
    nearness: Vec<f32>,
    triangles: Vec<u32>,
    /// From a row to the next.
    stride: usize,
    /// The least nearness in each block, as of its last visit.
    least: [f32; BLOCKS * BLOCKS],
    /// In each row of blocks, one bit per block whose `least` is out of date.
    dirty: [u16; BLOCKS],
}

impl Tile {
    /// A tile of which `width` × `height` samples are used.
    pub(crate) fn new(width: usize, height: usize) -> Self {
        let stride = if width > SIZE { SIDE + LANES } else { STRIDE };
        let words = stride * height.next_multiple_of(BLOCK);
        let mut nearness = vec![0.0; words];
        for (index, row) in nearness.chunks_exact_mut(stride).enumerate() {
            let used = if index < height { width } else { 0 };
            row[used..].fill(f32::INFINITY);
        }
        Self {
            nearness,
            triangles: vec![NONE; words],
            stride,
            least: [0.0; BLOCKS * BLOCKS],
            dirty: [u16::MAX; BLOCKS],
        }
    }

    /// From a row of its columns to the next.
    #[inline(always)]
    pub(crate) fn stride(&self) -> usize {
        self.stride
    }

    /// Where a sample stands in its columns.
    #[inline(always)]
    pub(crate) fn index(&self, spot: Spot) -> usize {
        spot.row * self.stride + spot.column
    }

    /// Has nothing be seen at some samples, by their place in the columns.
    pub(crate) fn close_where(&mut self, closed: impl Fn(usize) -> bool) {
        for (index, nearness) in self.nearness.iter_mut().enumerate() {
            if *nearness < f32::INFINITY && closed(index) {
                *nearness = f32::INFINITY;
            }
        }
    }

    /// The visible triangle at a sample.
    pub(crate) fn triangle(&self, spot: Spot) -> Option<u32> {
        let triangle = self.triangles[self.index(spot)];
        (triangle != NONE).then_some(triangle)
    }

    /// The visible triangles of [`SIZE`] samples in a row from one on, [`NONE`] where there is none.
    pub(crate) fn row(&self, first: Spot) -> &[u32] {
        &self.triangles[self.index(first)..][..SIZE]
    }

    /// About 1 / z-depth of what a sample sees.
    pub(crate) fn nearness(&self, spot: Spot) -> f32 {
        self.nearness[self.index(spot)]
    }

    /// Whether no sample sees anything.
    pub(crate) fn is_blank(&self) -> bool {
        self.triangles.iter().all(|&triangle| triangle == NONE)
    }

    /// How many samples see something.
    pub(crate) fn count(&self) -> usize {
        let seen = |row: &[u32]| -> u32 { row.iter().map(|&t| u32::from(t != NONE)).sum() };
        let rows = self.triangles.chunks_exact(self.stride);
        rows.map(|row| seen(row) as usize).sum()
    }

    /// Makes visible at a sample what a ray has found there, whatever was there before.
    pub(crate) fn put(&mut self, spot: Spot, seen: Option<Visible>) {
        #[allow(
            clippy::cast_possible_truncation,
            reason = "meshes have fewer than 2^32 triangles; nearness is f32"
        )]
        let (triangle, nearness) = seen.map_or((NONE, 0.0), |seen| {
            let nearness = seen.crossing.distance.recip() as f32;
            (seen.triangle as u32, nearness)
        });
        let index = self.index(spot);
        self.triangles[index] = triangle;
        self.nearness[index] = nearness;
    }

    /// Takes over what `width` × `height` samples from one on see, which were drawn as a tile of their own.
    pub(crate) fn put_part(&mut self, first: Spot, part: &Self, (width, height): (usize, usize)) {
        for row in 0..height {
            let from = part.index(Spot { column: 0, row });
            let to = self.index(first) + row * self.stride;
            self.nearness[to..][..width].copy_from_slice(&part.nearness[from..][..width]);
            self.triangles[to..][..width].copy_from_slice(&part.triangles[from..][..width]);
        }
    }

    /// Notes that samples between two corners, both included, have changed.
    pub(crate) fn touch(&mut self, from: Spot, to: Spot) {
        for row in from.row / BLOCK..=to.row / BLOCK {
            let bits = (2u32 << (to.column / BLOCK - from.column / BLOCK)) - 1;
            #[allow(clippy::cast_possible_truncation, reason = "one bit per block")]
            let bits = (bits << (from.column / BLOCK)) as u16;
            self.dirty[row] |= bits;
        }
    }

    /// Whether all samples between two corners, both included, are nearer than `nearness`.
    pub(crate) fn hides(&mut self, (from, to): (Spot, Spot), nearness: f32) -> bool {
        let bar = nearness * (1.0 + 2.0 * DOUBT);
        (from.row / BLOCK..=to.row / BLOCK).all(|row| {
            (from.column / BLOCK..=to.column / BLOCK).all(|column| self.least(row, column) > bar)
        })
    }

    fn least(&mut self, row: usize, column: usize) -> f32 {
        let block = row * BLOCKS + column;
        if self.dirty[row] >> column & 1 == 1 {
            let corner = row * BLOCK * self.stride + column * BLOCK;
            let mut least = [f32::INFINITY; BLOCK];
            for down in 0..BLOCK {
                let samples = &self.nearness[corner + down * self.stride..][..BLOCK];
                for (least, &sample) in least.iter_mut().zip(samples) {
                    *least = if sample < *least { sample } else { *least };
                }
            }
            let less = |a: f32, b: f32| if a < b { a } else { b };
            let [a, b, c, d, e, f, g, h] = least;
            let (left, right) = (less(less(a, e), less(c, g)), less(less(b, f), less(d, h)));
            self.least[block] = less(left, right);
            self.dirty[row] &= !(1 << column);
        }
        self.least[block]
    }

    /// As [`Self::offer`] for many places, triangles and how near they are, where the difference is clear;
    /// `unsure` is called with the others. Which is nearer cannot be foreseen: nothing branches on it.
    #[inline(always)]
    pub(crate) fn try_offers(
        &mut self,
        offers: impl Iterator<Item = (usize, (u32, f32))>,
        mut unsure: impl FnMut(usize, (u32, f32)),
    ) {
        let (all_near, all_numbers) = (&mut self.nearness[..], &mut self.triangles[..]);
        for (index, (triangle, nearness)) in offers {
            let (Some(near), Some(number)) = (all_near.get_mut(index), all_numbers.get_mut(index))
            else {
                continue;
            };
            let there = *near;
            let wins = nearness > there * (1.0 + DOUBT);
            *near = f32::from_bits(select_unpredictable(
                wins,
                nearness.to_bits(),
                there.to_bits(),
            ));
            *number = select_unpredictable(wins, triangle, *number);
            if !(wins | (nearness < there * (1.0 - DOUBT))) {
                unsure(index, (triangle, nearness));
            }
        }
    }

    /// Whether what is at a sample clearly hides a surface of a nearness that is roughly known.
    #[inline(always)]
    pub(crate) fn surely_hides(&self, index: usize, nearness: f32) -> bool {
        nearness < self.nearness[index] * (1.0 - 2.0 * DOUBT)
    }

    /// What is drawn on, many samples at a time.
    #[inline(always)]
    pub(crate) fn canvas(&mut self) -> Canvas<'_> {
        Canvas {
            nearness: &mut self.nearness,
            triangles: &mut self.triangles,
        }
    }

    /// Makes `triangle` visible at a sample if it is nearer than what is there. Within [`DOUBT`]
    /// the exact distances that `exact` returns decide, then the lower number.
    pub(crate) fn offer(
        &mut self,
        spot: Spot,
        (triangle, nearness): (u32, f32),
        exact: impl Fn(u32) -> Option<f64>,
    ) {
        let index = self.index(spot);
        let there = self.nearness[index];
        if nearness < there * (1.0 - DOUBT) {
            return;
        }
        let old = self.triangles[index];
        if nearness <= there * (1.0 + DOUBT) && old != NONE {
            let Some(new_distance) = exact(triangle) else {
                return;
            };
            let old_distance = exact(old).unwrap_or(f64::INFINITY);
            if (old_distance, old) <= (new_distance, triangle) {
                return;
            }
        }
        self.nearness[index] = nearness;
        self.triangles[index] = triangle;
    }
}

/// The columns of a tile.
pub(crate) struct Canvas<'t> {
    nearness: &'t mut [f32],
    triangles: &'t mut [u32],
}

impl Canvas<'_> {
    /// What lies between two places.
    #[inline(always)]
    pub(crate) fn cut(self, range: Range<usize>) -> Self {
        Self {
            nearness: &mut self.nearness[range.clone()],
            triangles: &mut self.triangles[range],
        }
    }

    /// Samples side by side from a place on, unless the canvas ends before.
    #[inline(always)]
    pub(crate) fn at(&mut self, index: usize) -> Option<Samples<'_>> {
        let lanes = index..index + LANES;
        Some(Samples {
            nearness: self.nearness.get_mut(lanes.clone())?.first_chunk_mut()?,
            triangles: self.triangles.get_mut(lanes)?.first_chunk_mut()?,
        })
    }
}

/// Samples side by side.
pub(crate) struct Samples<'t> {
    nearness: &'t mut [f32; LANES],
    triangles: &'t mut [u32; LANES],
}

impl Samples<'_> {
    /// Offers a triangle: in the lanes of `inside` it is seen, in those of `beside` it is not. Returns the lanes
    /// that something was decided for.
    #[inline(always)]
    pub(crate) fn try_offer<L: Lanes>(
        self,
        l: L,
        (triangle, nearness): (u32, L::V),
        (inside, beside): (L::M, L::M),
    ) -> L::M {
        let old = l.load(self.nearness);
        let wins = l.and(inside, l.below(l.mul(old, l.splat(1.0 + DOUBT)), nearness));
        let hidden = l.below(nearness, l.mul(old, l.splat(1.0 - 2.0 * DOUBT)));
        *self.nearness = l.store(l.choose(wins, nearness, old));
        *self.triangles = l.overwrite(wins, triangle, self.triangles);
        l.or(l.or(beside, hidden), wins)
    }

    /// The lanes that neither show a triangle already nor clearly hide it.
    #[inline(always)]
    pub(crate) fn open<L: Lanes>(&self, l: L, (triangle, nearness): (u32, L::V)) -> u32 {
        let bar = l.mul(l.load(self.nearness), l.splat(1.0 - 2.0 * DOUBT));
        l.differ(self.triangles, &[triangle; LANES]) & !l.less(nearness, bar)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SPOT: Spot = Spot { column: 3, row: 9 };

    #[test]
    fn the_nearer_wins_and_doubt_is_settled_exactly() {
        let mut tile = Tile::new(SIZE, SIZE);
        let never = |_: u32| -> Option<f64> { unreachable!("clear cases need no exact test") };
        tile.offer(SPOT, (5, 1.0), never);
        tile.offer(SPOT, (6, 0.9), never);
        assert_eq!(tile.triangle(SPOT), Some(5));
        tile.offer(SPOT, (7, 1.1), never);
        assert_eq!(tile.triangle(SPOT), Some(7));
        tile.offer(SPOT, (8, 1.1 * (1.0 + 1e-5)), |triangle| {
            Some(f64::from(triangle))
        });
        assert_eq!(tile.triangle(SPOT), Some(7));
        tile.offer(SPOT, (9, 1.1 * (1.0 - 1e-5)), |triangle| {
            Some(-f64::from(triangle))
        });
        assert_eq!(tile.triangle(SPOT), Some(9));
        tile.offer(SPOT, (4, 1.1), |_| Some(1.0));
        assert_eq!(
            tile.triangle(SPOT),
            Some(4),
            "equally near: the lower number"
        );
        tile.offer(SPOT, (3, 1.1), |triangle| (triangle != 3).then_some(1.0));
        assert_eq!(tile.triangle(SPOT), Some(4), "not met at all");
    }

    #[test]
    fn a_block_hides_only_what_is_behind_all_of_it() {
        for (size, side, first) in [(20, SIZE, 0), (100, SIDE, 88)] {
            let mut tile = Tile::new(size, size);
            let spot = |column, row| Spot { column, row };
            let (from, to) = (spot(first, first), spot(first + 7, first + 7));
            for row in first..first + 8 {
                for column in first..first + 8 {
                    assert!(!tile.hides((from, to), 0.5));
                    tile.offer(spot(column, row), (1, 1.0), |_| None);
                    tile.touch(spot(column, row), spot(column, row));
                }
            }
            assert!(tile.hides((from, to), 0.5) && !tile.hides((from, to), 1.0));
            assert!(!tile.hides((from, spot(first + 8, first + 7)), 0.5));
            let beyond = size.next_multiple_of(BLOCK);
            let unused = (spot(beyond, 0), spot(side - 1, beyond - 1));
            assert!(tile.hides(unused, 0.5));
        }
    }
}
