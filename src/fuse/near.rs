//! Where a small block of reference pixels lies in a source, relative to one of its points.

#![allow(
    clippy::needless_range_loop,
    reason = "columns are walked side by side, and closures would leave the instruction set"
)]

use super::kernel::{BLOCK, Block, Footprint, Pair, Seen};
use super::samples::Samples;

/// A block as seen from one of its points, the anchor, where it is small enough for that.
#[repr(C, align(64))]
pub(super) struct Near {
    /// Depth times coordinates relative to the anchor.
    du: [f32; BLOCK],
    dv: [f32; BLOCK],
    /// Depth minus the anchor's.
    dd: [f32; BLOCK],
    /// Whether it is.
    fits: bool,
    /// The anchor: continuous image coordinates and depth.
    anchor: [f32; 3],
    /// How far coordinates are from the anchor's at most.
    reach: [f32; 2],
    /// The least and the largest depth minus the anchor's, and the largest depth.
    depths: [f32; 3],
}

/// Pixels from the anchor up to which a block is small.
const REACH: f32 = 64.0;
/// Ratio of the anchor's depth to others up to which it is.
const RANGE: f32 = 8.0;
/// Depths that leave products room in an f32.
const USUAL: std::ops::Range<f64> = 1e-25..1e25;

impl Near {
    pub(super) fn new() -> Self {
        Self {
            fits: false,
            anchor: [0.0; 3],
            reach: [0.0; 2],
            depths: [0.0; 3],
            du: [0.0; BLOCK],
            dv: [0.0; BLOCK],
            dd: [0.0; BLOCK],
        }
    }

    #[inline(always)]
    pub(super) fn fill(&mut self, block: &Block) {
        let ((left, right), (top, bottom)) = (ends(&block.u), ends(&block.v));
        let (least, most) = ends(&block.depth);
        let [a, b, c] = [
            block.depth[0],
            block.depth[BLOCK / 2],
            block.depth[BLOCK - 1],
        ];
        let middle = a.min(b).max(a.max(b).min(c));
        let (u, v) = (0.5 * (left + right), 0.5 * (top + bottom));
        self.anchor = [u, v, middle];
        self.reach = [right - u, bottom - v];
        self.depths = [least - middle, most - middle, most];
        self.fits = self.reach[0] <= REACH
            && self.reach[1] <= REACH
            && most <= RANGE * middle
            && middle <= RANGE * least
            && USUAL.contains(&f64::from(middle));
        for i in 0..BLOCK {
            let depth = block.depth[i];
            self.du[i] = depth * (block.u[i] - u);
            self.dv[i] = depth * (block.v[i] - v);
            self.dd[i] = depth - middle;
        }
    }
}

/// The least and the largest value.
#[inline(always)]
fn ends(values: &[f32; BLOCK]) -> (f32, f32) {
    let (mut least, mut most) = (*values, *values);
    for half in [32, 16, 8, 4, 2, 1] {
        for i in 0..half {
            let (a, b) = (least[i], least[i + half]);
            least[i] = if a < b { a } else { b };
            let (a, b) = (most[i], most[i + half]);
            most[i] = if a > b { a } else { b };
        }
    }
    (least[0], most[0])
}

/// Where a small block lies in a source, seen from where its anchor does.
///
/// With the anchor's pixel a, depth d, ray r and source position x: what a pixel a + (du, dv) of depth d + dd
/// adds to the anchor's point is `dd · r + (d + dd) · (du · column 0 + dv · column 1)`, and its position minus
/// x is that sum's part across the anchor's line of sight over the pixel's depth in the source. All of it is
/// small where the pixel is near, so f32 does: with e = 2^-24, the block's own extent S ([`SPREAD`]) and the
/// anchor's depth z0 in the source, numerators are right to 5e of their terms, depths z to 6e of theirs, and
/// positions to about `6e · (S + |x' − x|) · (1 + z0 / z)`: 1e-5 px next to the anchor, 1e-3 px for what lies
/// a thousand pixels from it because its depth is quite another. Between two pixels of very different depth, what
/// is sampled moves by that part of their difference.
///
/// Several sources are set up abreast, by the same steps each: one after the other, each would wait for itself.
#[repr(C, align(64))]
pub(super) struct Relative {
    /// Pixels times depth by [`Near::du`], [`Near::dv`] and [`Near::dd`], to the right and below; then depth.
    x: [[f32; ABREAST]; 3],
    y: [[f32; ABREAST]; 3],
    z: [[f32; ABREAST]; 3],
    /// Depth of the anchor.
    depth: [f32; ABREAST],
    /// How far it lies to the right of its pixel of the bordered map, and below.
    part: [[f32; ABREAST]; 2],
    /// Borders of the map from that pixel: left and top, right and bottom.
    first: [[f32; ABREAST]; 2],
    last: [[f32; ABREAST]; 2],
    /// The first and the last column from there of which values are stored with their right neighbours'.
    stored: [[f32; ABREAST]; 2],
    /// The place of that pixel, which may be none of the map's; and what rounding leaves on top.
    place: [u32; ABREAST],
    /// Whether f32 is long enough.
    fits: [bool; ABREAST],
}

/// Sources that are set up abreast.
pub(super) const ABREAST: usize = 8;

/// What small blocks are set up with in so many sources.
#[repr(C, align(64))]
pub(super) struct Abreast {
    /// Columns of the rotation, then the translation, as in [`Pair`].
    columns: [[[f64; ABREAST]; 3]; 4],
    /// Where the map with its border ends, to the right and below.
    ends: [[f64; ABREAST]; 2],
    /// The column before the first that is stored, and the distance between rows.
    left: [f64; ABREAST],
    stride: [f64; ABREAST],
}

impl Abreast {
    /// From at most [`ABREAST`] sources, and at least one; what is left over is like the last.
    #[allow(clippy::cast_precision_loss, reason = "image sizes are far below 2^52")]
    pub(super) fn new<'a>(sources: impl Iterator<Item = (&'a Pair, &'a Samples)>) -> Self {
        let mut all = Self {
            columns: [[[0.0; ABREAST]; 3]; 4],
            ends: [[0.0; ABREAST]; 2],
            left: [0.0; ABREAST],
            stride: [0.0; ABREAST],
        };
        for (at, (pair, source)) in sources.enumerate() {
            for k in at..ABREAST {
                for (to, column) in all.columns.iter_mut().zip(pair.columns) {
                    for axis in 0..3 {
                        to[axis][k] = column[axis];
                    }
                }
                all.ends[0][k] = (source.width() + 1) as f64;
                all.ends[1][k] = (source.height() + 1) as f64;
                all.left[k] = source.columns().start as f64 - 1.0;
                all.stride[k] = source.stride() as f64;
            }
        }
        all
    }
}

/// Pixels that a small block's own extent may amount to in a source, at the anchor's depth there.
const SPREAD: f64 = 256.0;
/// Part of the anchor's depth in a source that all depths have to have.
const SHALLOW: f64 = 0.125;
/// Pixels up to which positions of the anchor are taken.
const BEYOND: f64 = 1e4;

/// Columns and rows of the largest map in which pixels are found relative to an anchor: what lies on the other
/// side of it from an anchor beyond is still less than 2^22 away, see [`WHOLE`].
const WIDEST: f64 = 2_097_152.0;

impl Relative {
    pub(super) fn new() -> Self {
        Self {
            x: [[0.0; ABREAST]; 3],
            y: [[0.0; ABREAST]; 3],
            z: [[0.0; ABREAST]; 3],
            depth: [0.0; ABREAST],
            part: [[0.0; ABREAST]; 2],
            first: [[0.0; ABREAST]; 2],
            last: [[0.0; ABREAST]; 2],
            stored: [[0.0; ABREAST]; 2],
            place: [0; ABREAST],
            fits: [false; ABREAST],
        }
    }

    /// Whether f32 is long enough in a source.
    #[inline(always)]
    pub(super) fn fits(&self, k: usize) -> bool {
        self.fits[k]
    }

    /// A block set up in one source, number 0.
    #[cfg(test)]
    pub(super) fn alone(near: &Near, source: (&Pair, &Samples)) -> Self {
        let mut relative = Self::new();
        relative.fill(near, &Abreast::new(std::iter::once(source)));
        relative
    }

    /// Sets up a block in each of the sources.
    #[inline(always)]
    pub(super) fn fill(&mut self, near: &Near, sources: &Abreast) {
        let [a, b, c, t] = &sources.columns;
        let [u, v, d] = near.anchor.map(f64::from);
        let [reach_u, reach_v] = near.reach.map(f64::from);
        let [nearer, farther, most] = near.depths.map(f64::from);
        let extent = |by: [f64; 2]| most * by[0].abs().mul_add(reach_u, by[1].abs() * reach_v);
        for k in 0..ABREAST {
            let along = |axis: usize| a[axis][k].mul_add(u, b[axis][k].mul_add(v, c[axis][k]));
            let ray = [along(0), along(1), along(2)];
            let depth = d.mul_add(ray[2], t[2][k]);
            let inverse = 1.0 / depth;
            let at = |axis: usize| d.mul_add(ray[axis], t[axis][k]) * inverse;
            let (x, y) = (at(0), at(1));
            let z = [a[2][k], b[2][k], ray[2]];
            let across = |at: f64, axis: usize| {
                let by = [a[axis][k], b[axis][k], ray[axis]];
                std::array::from_fn(|i| (-at).mul_add(z[i], by[i]))
            };
            let (by_x, by_y): ([f64; 3], [f64; 3]) = (across(x, 0), across(y, 1));
            let least = (nearer * ray[2]).min(farther * ray[2]) + depth - extent([z[0], z[1]]);
            let [right, bottom] = [sources.ends[0][k], sources.ends[1][k]];
            // None of these holds for what is not a number.
            self.fits[k] = near.fits
                & USUAL.contains(&depth)
                & (least >= SHALLOW * depth)
                & (extent([by_x[0], by_x[1]]) <= SPREAD * depth)
                & (extent([by_y[0], by_y[1]]) <= SPREAD * depth)
                & (x.abs() < BEYOND)
                & (y.abs() < BEYOND)
                & (right <= WIDEST + 1.0)
                & (bottom <= WIDEST + 1.0);
            let (left, top) = ((x + 0.5).floor(), (y + 0.5).floor());
            for i in 0..3 {
                self.x[i][k] = by_x[i] as f32;
                self.y[i][k] = by_y[i] as f32;
                self.z[i][k] = z[i] as f32;
            }
            self.depth[k] = depth as f32;
            (self.part[0][k], self.part[1][k]) = ((x + 0.5 - left) as f32, (y + 0.5 - top) as f32);
            (self.first[0][k], self.first[1][k]) = (-left as f32, -top as f32);
            (self.last[0][k], self.last[1][k]) = ((right - left) as f32, (bottom - top) as f32);
            let (before, stride) = (sources.left[k] - left, sources.stride[k]);
            self.stored[0][k] = before as f32;
            self.stored[1][k] = (before + (stride - 2.0)) as f32;
            let (bias, stride) = (WHOLE.to_bits(), whole(stride));
            let place = whole(top).wrapping_mul(stride).wrapping_add(whole(-before));
            self.place[k] = place
                .wrapping_sub(bias.wrapping_mul(stride))
                .wrapping_sub(bias);
        }
    }

    /// See [`Pair::project`]; in one of the sources, which fits.
    #[inline(always)]
    pub(super) fn project<const KEPT: bool>(
        &self,
        k: usize,
        (near, stride): (&Near, usize),
        seen: &mut Seen,
        to: &mut Footprint,
    ) {
        let of = |by: &[[f32; ABREAST]; 3]| [by[0][k], by[1][k], by[2][k]];
        let (by_x, by_y, by_z) = (of(&self.x), of(&self.y), of(&self.z));
        let (depth, place, stride) = (self.depth[k], self.place[k], stride as u32);
        let [part_x, part_y] = [self.part[0][k], self.part[1][k]];
        let [first_x, first_y] = [self.first[0][k], self.first[1][k]];
        let [last_x, last_y] = [self.last[0][k], self.last[1][k]];
        let [first, last] = [self.stored[0][k], self.stored[1][k]];
        for i in 0..BLOCK {
            let (du, dv, dd) = (near.du[i], near.dv[i], near.dd[i]);
            let along = |by: [f32; 3]| by[0].mul_add(du, by[1].mul_add(dv, by[2] * dd));
            let z = by_z[0].mul_add(du, by_z[1].mul_add(dv, by_z[2].mul_add(dd, depth)));
            let inverse = 1.0 / z;
            let x = along(by_x).mul_add(inverse, part_x);
            let y = along(by_y).mul_add(inverse, part_y);
            let inside = (x >= first_x) & (y >= first_y) & (x < last_x) & (y < last_y);
            let x = if inside { x } else { first_x };
            let y = if inside { y } else { first_y };
            let (column, row) = (x.floor(), y.floor());
            let stored = if column > first { column } else { first };
            let stored = if stored < last { stored } else { last };
            let (below, right) = ((row + WHOLE).to_bits(), (stored + WHOLE).to_bits());
            to.index[i] = below
                .wrapping_mul(stride)
                .wrapping_add(right)
                .wrapping_add(place);
            to.fx[i] = x - column;
            to.fy[i] = y - row;
            if KEPT {
                seen.x[i] = x - first_x;
                seen.y[i] = y - first_y;
            }
            to.z[i] = if inside { z } else { 0.0 };
            to.inverse[i] = if inside { inverse } else { 0.0 };
        }
    }
}

/// The low bits of a whole number, of either sign: those of its sum with 1.5 · 2^52.
#[inline(always)]
pub(super) fn whole(value: f64) -> u32 {
    (value + 6_755_399_441_055_744.0).to_bits() as u32
}

/// 1.5 · 2^23: added to a whole number of less than 2^22, its bits are its own plus that number.
const WHOLE: f32 = 12_582_912.0;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fuse::kernel::Pair;
    use crate::fuse::samples::{Grid, Unit};
    use crate::fuse::testing::{random_view, rng, uniform};
    use mvs_datasets::scene::{Pose, View};
    use rand_chacha::ChaCha8Rng;

    /// A view with the world `scale` times as large.
    fn scaled(view: View, scale: f64) -> View {
        let pose = Pose::new(view.pose.rotation(), view.pose.translation() * scale).unwrap();
        View { pose, ..view }
    }

    /// A block within `extent` pixels, of depths that are similar but for one in ten.
    fn block(random: &mut ChaCha8Rng, extent: f64, scale: f64) -> Block {
        let mut draw = |least, most| uniform(random, least, most);
        let (left, top) = (draw(0.0, 640.0 - extent), draw(0.0, 480.0 - extent));
        let around = draw(2.0, 4.0);
        let mut block = Block::new();
        while !block.is_full() {
            let (column, row) = (left + draw(0.0, extent), top + draw(0.0, extent));
            let apart = if draw(0.0, 1.0) < 0.1 { 0.7 } else { 0.03 };
            let depth = scale * around * draw(1.0 - apart, 1.0 + apart);
            block.push(Grid::whole(640), column as u32, row as u32, depth as f32);
        }
        block
    }

    /// The continuous position of an entry in the map, by where its pixels are taken from.
    fn position(to: &Footprint, stride: usize, i: usize) -> [f64; 2] {
        let index = to.index[i] as usize;
        let column = index % stride;
        [
            // Of two zeros left of a row, one is the border.
            column as f64 - 1.0 + f64::from(to.fx[i]),
            (index / stride) as f64 + f64::from(to.fy[i]),
        ]
    }

    #[test]
    fn small_blocks_lie_where_f64_says() {
        let mut random = rng(11);
        let samples = Samples::new((640, 480), Unit::Depth, &vec![1.0; 640 * 480]);
        let (mut compared, mut fitting, mut largest) = (0, 0, 0.0f64);
        for round in 0..6000 {
            let scale = [1.0, 1e-6, 1e6][round % 3];
            let [reference, source] = [0, 1].map(|id| scaled(random_view(&mut random, id), scale));
            let pair = Pair::new(&reference, &source);
            let block = block(&mut random, [16.0, 30.0, 120.0][round % 7 % 3], scale);
            let mut near = Near::new();
            near.fill(&block);
            let (mut short, mut long) = (Footprint::new(), Footprint::new());
            let (mut seen, mut exact) = (Seen::new(), Seen::new());
            pair.project_widely::<true>(&block, &samples, &mut exact, &mut long);
            let relative = Relative::alone(&near, (&pair, &samples));
            if !relative.fits(0) {
                continue;
            }
            fitting += 1;
            relative.project::<true>(0, (&near, samples.stride()), &mut seen, &mut short);
            let anchor = [0, 1]
                .map(|axis| f64::from(relative.part[axis][0]) - f64::from(relative.first[axis][0]));
            for i in 0..BLOCK {
                if (short.z[i] > 0.0) != (long.z[i] > 0.0) {
                    // Only on the border itself.
                    let either = if short.z[i] > 0.0 { &seen } else { &exact };
                    let (x, y) = (f64::from(either.x[i]), f64::from(either.y[i]));
                    let inner = x.min(641.0 - x).min(y).min(481.0 - y);
                    assert!(inner < 1e-3, "{inner}");
                    continue;
                }
                if long.z[i] <= 0.0 {
                    assert!(samples.values()[short.index[i] as usize..].len() > 646);
                    continue;
                }
                compared += 1;
                let z = f64::from(long.z[i]);
                let shallow = 1.0 + f64::from(relative.depth[0]) / z;
                assert!((f64::from(short.z[i]) / z - 1.0).abs() < 6.0 * shallow / 16_777_216.0);
                assert!(
                    (f64::from(short.inverse[i]) * z - 1.0).abs() < 8.0 * shallow / 16_777_216.0
                );
                let [found, expected] = [&short, &long].map(|to| position(to, samples.stride(), i));
                for axis in 0..2 {
                    let off = (found[axis] - expected[axis]).abs();
                    let from = (expected[axis] - anchor[axis]).abs();
                    let bound = 6.0 * (SPREAD + from) * shallow / 16_777_216.0;
                    assert!(off < bound, "{off} {bound} {from} {shallow}");
                    largest = largest.max(if from < 16.0 && shallow < 3.0 {
                        off
                    } else {
                        0.0
                    });
                }
                for (found, exact) in [(seen.x[i], exact.x[i]), (seen.y[i], exact.y[i])] {
                    assert!((found - exact).abs() < 2e-3);
                }
            }
        }
        assert!(compared > 20_000 && fitting > 400, "{compared} {fitting}");
        assert!(largest < 2e-5, "{largest}");
    }

    #[test]
    fn what_f32_is_too_short_for_is_left_to_f64() {
        let mut random = rng(5);
        let view = random_view(&mut random, 0);
        let samples = Samples::new((640, 480), Unit::Depth, &vec![1.0; 640 * 480]);
        let fits = |change: &dyn Fn(&mut Block)| {
            let mut block = Block::new();
            for i in 0..BLOCK as u32 {
                block.push(Grid::whole(640), 300 + i % 16, 200 + i / 16, 3.0);
            }
            change(&mut block);
            let mut near = Near::new();
            near.fill(&block);
            Relative::alone(&near, (&Pair::new(&view, &view), &samples)).fits(0)
        };
        assert!(fits(&|_| ()));
        assert!(fits(&|block| block.depth[7] = 5.0));
        assert!(!fits(&|block| block.depth[7] = 30.0));
        assert!(!fits(&|block| block.depth[7] = 0.2));
        assert!(!fits(&|block| block.u[9] = 500.5));
        assert!(!fits(&|block| block.v[63] = 2.5));
        assert!(!fits(&|block| block.depth = [1e30; BLOCK]));
        assert!(!fits(&|block| block.depth = [1e-30; BLOCK]));
        assert!(!fits(&|block| block.depth[0] = f32::INFINITY));
    }

    /// All that one source is set up with, bit by bit.
    fn bits(relative: &Relative, k: usize) -> Vec<u32> {
        let Relative {
            x,
            y,
            z,
            depth,
            part,
            first,
            last,
            stored,
            place,
            fits,
        } = relative;
        let threes = [x, y, z].into_iter().flatten();
        let twos = [part, first, last, stored].into_iter().flatten();
        let all = threes.chain(twos).chain([depth]);
        let mut bits: Vec<u32> = all.map(|of| of[k].to_bits()).collect();
        bits.extend([place[k], u32::from(fits[k])]);
        bits
    }

    /// Nor does the instruction set matter.
    #[test]
    fn sources_abreast_are_set_up_as_each_alone() {
        struct Fill<'a>(&'a mut Relative, &'a Near, &'a Abreast);
        impl pulp::WithSimd for Fill<'_> {
            type Output = ();
            #[inline(always)]
            fn with_simd<S: pulp::Simd>(self, _: S) {
                self.0.fill(self.1, self.2);
            }
        }
        let mut random = rng(8);
        let maps = [(640, 480), (320, 500), (1, 1)].map(|(width, height): (u32, u32)| {
            let values = vec![1.0; (width * height) as usize];
            Samples::new((width, height), Unit::Depth, &values)
        });
        let narrow = maps[0].within(vec![200..310; 480]);
        let (mut fitting, mut others) = (0, 0);
        for round in 0..600 {
            let reference = random_view(&mut random, 0);
            let pairs: Vec<Pair> = (0..1 + round % ABREAST)
                .map(|_| Pair::new(&reference, &random_view(&mut random, 1)))
                .collect();
            let map = |at: usize| [&maps[0], &maps[1], &maps[2], &narrow][(at + round) % 4];
            let sources = || pairs.iter().enumerate().map(|(at, pair)| (pair, map(at)));
            let mut near = Near::new();
            near.fill(&block(&mut random, 16.0, 1.0));
            let mut abreast = Relative::new();
            let all = Abreast::new(sources());
            pulp::Arch::new().dispatch(Fill(&mut abreast, &near, &all));
            for k in 0..ABREAST {
                let source = sources().nth(k).or(sources().next_back()).unwrap();
                let alone = Relative::alone(&near, source);
                (fitting, others) = match alone.fits(0) {
                    true => (fitting + 1, others),
                    false => (fitting, others + 1),
                };
                // What does not fit is not used: it need not be a number.
                assert_eq!(alone.fits(0), abreast.fits(k));
                if alone.fits(0) {
                    assert_eq!(bits(&abreast, k), bits(&alone, 0));
                }
            }
        }
        assert!(fitting > 300 && others > 300, "{fitting} {others}");
    }
}
