//! A row of pixels of a tile, from the planes of its triangles.

#![allow(
    clippy::needless_range_loop,
    reason = "columns are walked side by side, and closures would leave the instruction set"
)]

use super::doubles::FOUR;
use super::lanes::{ALL, LANES, Lanes};
use super::maps::ROWS;
use super::planes::Plane;
use super::tile::{NONE, SIZE};
use crate::ahead::WORDS;

/// A row of a tile, map by map. Each begins with room for what lies before it in the maps' memory, and ends
/// with room for what is written beyond. All lie in one page: a store that reaches into the next takes a
/// hundred cycles.
#[repr(align(4096))]
pub(super) struct Line {
    pub(super) triangles: [u32; WORDS + SIZE],
    pub(super) depth: [f32; WORDS + SIZE],
    pub(super) weights: [f32; WORDS + 2 * SIZE],
    pub(super) normals: [f32; 2 * WORDS + 3 * SIZE],
}

impl Line {
    pub(super) const NONE: Self = Self {
        triangles: [NONE; WORDS + SIZE],
        depth: [0.0; WORDS + SIZE],
        weights: [0.0; WORDS + 2 * SIZE],
        normals: [0.0; 2 * WORDS + 3 * SIZE],
    };

    /// Nothing is seen.
    pub(super) fn clear(&mut self) {
        self.triangles[WORDS..].fill(NONE);
        self.depth[WORDS..].fill(0.0);
        self.weights[WORDS..].fill(0.0);
        self.normals[WORDS..].fill(0.0);
    }

    /// A pixel sees nothing.
    pub(super) fn blank(&mut self, column: usize) {
        self.depth[WORDS + column] = 0.0;
        self.weights[WORDS + 2 * column..][..2].fill(0.0);
        self.normals[WORDS + 3 * column..][..3].fill(0.0);
    }
}

/// A row of pixels that see something.
pub(super) struct Cross<'r> {
    /// x and y of the directions, counted from the tile's first pixel.
    pub(super) x: &'r [f64; SIZE],
    pub(super) y: f64,
    pub(super) planes: &'r [Plane],
    pub(super) runs: &'r [u32; ROWS * SIZE],
    /// The first pixels of runs as bits, and the number of the first run.
    pub(super) row: (u64, usize),
}

impl Cross<'_> {
    /// Works out and writes the pixels' depth, normals and weights. Returns, as bits, those that the exact
    /// test has to decide.
    #[inline(always)]
    pub(super) fn write<L: Lanes>(&self, l: L, line: &mut Line) -> u64 {
        let (depths, weights) = (&mut line.depth[WORDS..], &mut line.weights[WORDS..]);
        let normals = &mut line.normals[WORDS..];
        let (starts, first) = self.row;
        let y = l.splat_f64(self.y);
        let one = l.splat_f64(1.0);
        let mut run = first.wrapping_sub(1);
        let mut doubtful = 0;
        for left in (0..SIZE).step_by(LANES) {
            let (mut low, mut high) = ([0.0; LANES], [0.0; LANES]);
            for half in [0, FOUR] {
                let mut values = [y; FOUR];
                for k in 0..FOUR {
                    let column = (left + half + k) % SIZE;
                    run = run.wrapping_add((starts >> column & 1) as usize);
                    let plane = &self.planes[self.runs[run % (ROWS * SIZE)] as usize];
                    let x = l.splat_f64(self.x[column]);
                    let along = l.mul_f64(l.load_f64(&plane.along[0]), x);
                    let down = l.mul_f64(l.load_f64(&plane.along[1]), y);
                    values[k] = l.add_f64(l.add_f64(l.load_f64(&plane.at), along), down);
                    // The fourth number is written over next.
                    normals[3 * column..][..FOUR].copy_from_slice(&plane.normal);
                }
                let [v, w, t, doubt] = l.transpose(values);
                let depth = l.div_f64(one, t);
                let slack = l.mul_f64(depth, doubt);
                low[half..half + FOUR].copy_from_slice(&l.round(l.sub_f64(depth, slack)));
                high[half..half + FOUR].copy_from_slice(&l.round(l.add_f64(depth, slack)));
                let pairs = l.round_pairs(l.mul_f64(v, depth), l.mul_f64(w, depth));
                weights[2 * (left + half)..][..2 * FOUR].copy_from_slice(pairs.as_flattened());
            }
            depths[left..left + LANES].copy_from_slice(&low);
            doubtful |= u64::from(in_doubt(l, &low, &high)) << left;
        }
        doubtful
    }
}

/// The depths that are not known well enough, between which they are given, as bits.
#[inline(always)]
pub(super) fn in_doubt<L: Lanes>(l: L, low: &[f32; LANES], high: &[f32; LANES]) -> u32 {
    let positive = l.less(l.splat(-f32::MIN_POSITIVE), l.load(low));
    let unequal = l.differ(&low.map(f32::to_bits), &high.map(f32::to_bits));
    unequal | ALL & !positive
}

/// The pixels of a row that see another triangle than the one before, as bits.
#[inline(always)]
pub(super) fn starts<L: Lanes>(l: L, ids: &[u32]) -> u64 {
    let mut shifted = [0; SIZE];
    let mut here = [0; SIZE];
    here.copy_from_slice(ids);
    shifted[1..].copy_from_slice(&ids[..SIZE - 1]);
    shifted[0] = !ids[0];
    let mut bits = 0;
    let pairs = here
        .as_chunks::<LANES>()
        .0
        .iter()
        .zip(shifted.as_chunks().0);
    for (index, (here, before)) in pairs.enumerate() {
        bits |= u64::from(l.differ(here, before)) << (LANES * index);
    }
    bits
}
