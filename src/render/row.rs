//! A row of pixels of a tile, from the planes of its triangles.

#![allow(
    clippy::needless_range_loop,
    reason = "columns are walked side by side, and closures would leave the instruction set"
)]

use super::doubles::FOUR;
use super::lanes::{ALL, LANES, Lanes, Task};
use super::maps::ROWS;
use super::planes::Plane;
use super::tile::SIZE;

/// A row of a tile.
pub(super) struct Line {
    pub(super) depth: [f32; SIZE],
    pub(super) normals: [[f32; 3]; SIZE],
    pub(super) weights: [[f32; 2]; SIZE],
}

impl Line {
    pub(super) const NONE: Self = Self {
        depth: [0.0; SIZE],
        normals: [[0.0; 3]; SIZE],
        weights: [[0.0; 2]; SIZE],
    };
}

/// Works out and writes a row of pixels. Returns, as bits, those that the exact test has to decide.
pub(super) struct Cross<'r, 'm> {
    /// x and y of the directions, counted from the tile's first pixel.
    pub(super) x: &'r [f64; SIZE],
    pub(super) y: f64,
    pub(super) planes: &'r [Plane],
    pub(super) runs: &'r [u32; ROWS * SIZE],
    /// The first pixels of runs as bits, and the number of the first run.
    pub(super) row: (u64, usize),
    pub(super) out: (
        &'m mut [f32; SIZE],
        &'m mut [[f32; 3]; SIZE],
        &'m mut [[f32; 2]; SIZE],
    ),
}

impl Task for Cross<'_, '_> {
    type Output = u64;

    #[inline(always)]
    fn run<L: Lanes>(self, l: L) -> u64 {
        let (depths, normals, weights) = self.out;
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
                    normals[column] = plane.normal;
                }
                let [v, w, t, doubt] = l.transpose(values);
                let depth = l.div_f64(one, t);
                let slack = l.mul_f64(depth, doubt);
                low[half..half + FOUR].copy_from_slice(&l.round(l.sub_f64(depth, slack)));
                high[half..half + FOUR].copy_from_slice(&l.round(l.add_f64(depth, slack)));
                let pairs = l.round_pairs(l.mul_f64(v, depth), l.mul_f64(w, depth));
                weights[left + half..][..FOUR].copy_from_slice(&pairs);
            }
            depths[left..left + LANES].copy_from_slice(&low);
            let positive = l.less(l.splat(-f32::MIN_POSITIVE), l.load(&low));
            let unequal = l.differ(&low.map(f32::to_bits), &high.map(f32::to_bits));
            doubtful |= u64::from(unequal | ALL & !positive) << left;
        }
        doubtful
    }
}
