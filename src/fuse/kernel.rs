//! The inner loop: a block of reference pixels against one source.
//!
//! Plain loops over fixed arrays, which the compiler turns into vector instructions; `pulp` picks
//! the widest set the machine has at run time. Everything below is inlined into the function that
//! `pulp` compiles for each set (a closure would not be: [`super::rules`] hands it a struct).
//! Multiplications are fused with additions only where it says so, everywhere alike, so every set
//! gives the same bits (one without that instruction is slow). Positions are computed in f64
//! (a pixel is found to 1e-10), ratios of depths in f32 (6e-8), and depths only ever as
//! `reference + small difference`.

#![allow(
    clippy::needless_range_loop,
    reason = "columns are walked side by side, and closures would leave the instruction set"
)]

use super::geometry::PairGeometry;
use super::samples::{Samples, Unit};
use crate::ahead::prefetch;
use mvs_datasets::scene::View;

/// Pixels per block: what ten sources say about one stays in the first-level cache.
pub(super) const BLOCK: usize = 64;

/// Reference pixels to test, their depths known. Entries from `len` on are harmless.
pub(super) struct Block {
    pub(super) len: usize,
    /// Index of the pixel in its map, row-major.
    pub(super) pixel: [u32; BLOCK],
    /// Its index in the bordered map.
    pub(super) place: [u32; BLOCK],
    /// Continuous image coordinates of the pixel centre.
    pub(super) u: [f32; BLOCK],
    pub(super) v: [f32; BLOCK],
    /// z-depth, > 0.
    pub(super) depth: [f32; BLOCK],
}

impl Block {
    pub(super) fn new() -> Self {
        Self {
            len: 0,
            pixel: [0; BLOCK],
            place: [0; BLOCK],
            u: [0.5; BLOCK],
            v: [0.5; BLOCK],
            depth: [1.0; BLOCK],
        }
    }

    /// Adds a pixel of a map of this `width`; the block must not be full.
    pub(super) fn push(&mut self, width: u32, column: u32, row: u32, depth: f32) {
        let at = self.len;
        self.pixel[at] = row * width + column;
        self.place[at] = (row + 1) * (width + 2) + column + 1;
        #[allow(clippy::cast_precision_loss, reason = "image sizes are far below 2^23")]
        {
            self.u[at] = column as f32 + 0.5;
            self.v[at] = row as f32 + 0.5;
        }
        self.depth[at] = depth;
        self.len += 1;
    }

    pub(super) fn is_full(&self) -> bool {
        self.len == BLOCK
    }
}

/// What one source says about a block.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Seen {
    /// Where the hypothesis projects to, in the source's continuous image coordinates shifted by
    /// half a pixel (so that whole numbers are pixel centres of the bordered map).
    pub(super) x: [f32; BLOCK],
    pub(super) y: [f32; BLOCK],
    /// z-depth of the hypothesis in the source; 0 where it does not project into the map.
    pub(super) z: [f32; BLOCK],
    /// `z` / sampled depth; 0 without a sample.
    pub(super) ratio: [f32; BLOCK],
    /// `z` / depth of the nearest pixel; 0 where that has none.
    pub(super) near: [f32; BLOCK],
    /// Reprojected depth minus the reference's; 0 without a sample.
    pub(super) delta: [f32; BLOCK],
    /// Square of the reprojection error in pixels; ∞ without a sample.
    pub(super) pixel2: [f32; BLOCK],
    /// Relative depth error; ∞ without a sample.
    pub(super) relative: [f32; BLOCK],
    /// 1 where the source agrees, else 0; filled by a rule.
    pub(super) agrees: [u32; BLOCK],
}

impl Seen {
    pub(super) fn new() -> Self {
        Self {
            x: [0.0; BLOCK],
            y: [0.0; BLOCK],
            z: [0.0; BLOCK],
            ratio: [0.0; BLOCK],
            near: [0.0; BLOCK],
            delta: [0.0; BLOCK],
            pixel2: [0.0; BLOCK],
            relative: [0.0; BLOCK],
            agrees: [0; BLOCK],
        }
    }

    /// Says that nothing projects into the map; the positions stay.
    #[inline(always)]
    fn nothing(&mut self) {
        self.ratio = [0.0; BLOCK];
        self.near = [0.0; BLOCK];
        self.delta = [0.0; BLOCK];
        self.pixel2 = [f32::INFINITY; BLOCK];
        self.relative = [f32::INFINITY; BLOCK];
    }
}

/// How the four pixels around a position are combined.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Taps {
    /// All, by bilinear weights. The source is in [`Unit::Depth`].
    Plain,
    /// Those within the fraction of the expected depth, weights renormalised, if the nearest is
    /// among them. The source is in [`Unit::Inverse`].
    Valid(f32),
    /// The nearest alone.
    Nearest,
}

/// A pair of views, ready for the inner loop.
#[derive(Debug, Clone)]
pub(super) struct Pair {
    /// Columns of the rotation, then the translation of [`PairGeometry`].
    columns: [[f64; 3]; 4],
    /// (e_x, e_y, c_z).
    epipole: [f32; 3],
}

/// Working arrays between the steps.
pub(super) struct Footprint {
    index: [u32; BLOCK],
    fx: [f32; BLOCK],
    fy: [f32; BLOCK],
    /// Left and right of the upper pixels, and of the lower ones.
    top: [[f32; 2]; BLOCK],
    bottom: [[f32; 2]; BLOCK],
}

impl Footprint {
    pub(super) fn new() -> Self {
        Self {
            index: [0; BLOCK],
            fx: [0.0; BLOCK],
            fy: [0.0; BLOCK],
            top: [[0.0; 2]; BLOCK],
            bottom: [[0.0; 2]; BLOCK],
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

    /// Fills `seen`, but for who agrees, for the whole block, after [`Pair::project`].
    #[inline(always)]
    pub(super) fn look(
        &self,
        block: &Block,
        (source, taps): (&Samples, Taps),
        footprint: &mut Footprint,
        seen: &mut Seen,
    ) {
        let seen_at_all = seen.z.iter().fold(false, |any, &z| any | (z > 0.0));
        if !seen_at_all {
            return seen.nothing();
        }
        gather(source, footprint);
        nearest(source.unit(), &seen.z, footprint, &mut seen.near);
        match taps {
            Taps::Plain => plain(&seen.z, footprint, &mut seen.ratio),
            Taps::Valid(similar) => valid(footprint, similar, seen),
            Taps::Nearest => seen.ratio = seen.near,
        }
        self.errors(block, seen);
    }

    /// Positions, source depths and the top-left of the four pixels, which are asked for.
    #[inline(always)]
    pub(super) fn project(
        &self,
        block: &Block,
        source: &Samples,
        seen: &mut Seen,
        to: &mut Footprint,
    ) {
        let [a, b, c, t] = self.columns;
        #[allow(clippy::cast_precision_loss, reason = "image sizes are far below 2^52")]
        let (wide, high, stride) = (
            (source.width() + 1) as f64,
            (source.height() + 1) as f64,
            source.stride() as f64,
        );
        for i in 0..BLOCK {
            let (u, v) = (f64::from(block.u[i]), f64::from(block.v[i]));
            let depth = f64::from(block.depth[i]);
            let along = |axis: usize| {
                let direction = a[axis].mul_add(u, b[axis].mul_add(v, c[axis]));
                depth.mul_add(direction, t[axis])
            };
            let (px, py, pz) = (along(0), along(1), along(2));
            let inverse = 1.0 / pz;
            let (x, y) = (px.mul_add(inverse, 0.5), py.mul_add(inverse, 0.5));
            let inside = (pz > 0.0) & (x >= 0.0) & (y >= 0.0) & (x < wide) & (y < high);
            let x = if inside { x } else { 0.0 };
            let y = if inside { y } else { 0.0 };
            let (column, row) = (x.floor(), y.floor());
            to.index[i] = whole(row.mul_add(stride, column));
            to.fx[i] = (x - column) as f32;
            to.fy[i] = (y - row) as f32;
            seen.x[i] = x as f32;
            seen.y[i] = y as f32;
            seen.z[i] = if inside { pz as f32 } else { 0.0 };
        }
        for &first in &to.index {
            prefetch(source.values(), first as usize);
            prefetch(source.values(), first as usize + source.stride());
        }
    }

    /// Reprojected depth and the two errors from the ratio.
    #[inline(always)]
    fn errors(&self, block: &Block, seen: &mut Seen) {
        let [ex, ey, cz] = self.epipole;
        for i in 0..BLOCK {
            let (depth, ratio) = (block.depth[i], seen.ratio[i]);
            let sampled = ratio > 0.0;
            let q = (1.0 - ratio) / ratio;
            let q = if sampled { q } else { 0.0 };
            let along = depth - cz;
            let delta = q * along;
            let reprojected = depth + delta;
            let across_u = block.u[i] * cz - ex;
            let across_v = block.v[i] * cz - ey;
            let across = q * q * (across_u * across_u + across_v * across_v);
            let pixel2 = across / (reprojected * reprojected);
            seen.delta[i] = delta;
            seen.pixel2[i] = if sampled { pixel2 } else { f32::INFINITY };
            let relative = delta.abs() / depth;
            seen.relative[i] = if sampled { relative } else { f32::INFINITY };
        }
    }
}

/// 2^52: adding and subtracting it rounds an f64 below it to a whole number.
const ROUND: f64 = 4_503_599_627_370_496.0;

/// A whole number ≥ 0 and below 2^32 as an integer: the low bits of its sum with 2^52.
#[inline(always)]
#[allow(
    clippy::cast_possible_truncation,
    reason = "the upper bits are those of 2^52"
)]
fn whole(value: f64) -> u32 {
    (value + ROUND).to_bits() as u32
}

#[inline(always)]
fn gather(source: &Samples, footprint: &mut Footprint) {
    // Two views of the map, a row apart and of one length: one bound is checked per pixel.
    let starts = source.values().len() - source.stride();
    let (above, below) = (
        &source.values()[..starts],
        &source.values()[source.stride()..][..starts],
    );
    for i in 0..BLOCK {
        let start = footprint.index[i] as usize;
        footprint.top[i] = [above[start], above[start + 1]];
        footprint.bottom[i] = [below[start], below[start + 1]];
    }
}

/// Expected depth / depth of the nearest of the four pixels.
#[inline(always)]
fn nearest(unit: Unit, z: &[f32; BLOCK], footprint: &Footprint, near: &mut [f32; BLOCK]) {
    for i in 0..BLOCK {
        let ([a, b], [c, d]) = (footprint.top[i], footprint.bottom[i]);
        let (right, below) = (footprint.fx[i] >= 0.5, footprint.fy[i] >= 0.5);
        let top = if right { b } else { a };
        let bottom = if right { d } else { c };
        near[i] = if below { bottom } else { top };
    }
    match unit {
        Unit::Inverse => {
            for i in 0..BLOCK {
                near[i] *= z[i];
            }
        }
        Unit::Depth => {
            for i in 0..BLOCK {
                let ratio = z[i] / near[i];
                near[i] = if near[i] > 0.0 { ratio } else { 0.0 };
            }
        }
    }
}

/// Expected depth / bilinear depth, pixels without depth as zeros.
#[inline(always)]
fn plain(z: &[f32; BLOCK], footprint: &Footprint, ratio: &mut [f32; BLOCK]) {
    for i in 0..BLOCK {
        let ([a, b], [c, d]) = (footprint.top[i], footprint.bottom[i]);
        let (fx, fy) = (footprint.fx[i], footprint.fy[i]);
        let top = a * (1.0 - fx) + b * fx;
        let bottom = c * (1.0 - fx) + d * fx;
        let depth = top * (1.0 - fy) + bottom * fy;
        let found = z[i] / depth;
        ratio[i] = if depth > 0.0 { found } else { 0.0 };
    }
}

/// Bilinear inverse depth over the pixels near the expected one, times the expected depth. The
/// nearest pixel must be among them: half a pixel is the most that is extrapolated.
#[inline(always)]
fn valid(footprint: &Footprint, similar: f32, seen: &mut Seen) {
    for i in 0..BLOCK {
        let ([a, b], [c, d]) = (footprint.top[i], footprint.bottom[i]);
        let (fx, fy) = (footprint.fx[i], footprint.fy[i]);
        let (gx, gy) = (1.0 - fx, 1.0 - fy);
        let mut weight = 0.0;
        let mut offset = 0.0;
        for (tap, share) in [(a, gx * gy), (b, fx * gy), (c, gx * fy), (d, fx * fy)] {
            // Offsets from 1 are summed, not ratios, so that rounding does not grow.
            let from_one = tap * seen.z[i] - 1.0;
            let share = if from_one.abs() <= similar {
                share
            } else {
                0.0
            };
            weight += share;
            offset += share * from_one;
        }
        let nearest_counts = (seen.near[i] - 1.0).abs() <= similar;
        let found = 1.0 + offset / weight;
        seen.ratio[i] = if nearest_counts { found } else { 0.0 };
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fuse::sampling;
    use crate::fuse::testing::{random_view, rng, uniform};
    use glam::DVec2;
    use mvs_datasets::scene::DepthMap;

    /// A source map of random depths near `around`, a tenth of it without depth.
    fn random_map(random: &mut rand_chacha::ChaCha8Rng, around: f64) -> DepthMap {
        let mut draw = || {
            let depth = around * uniform(random, 0.96, 1.04);
            if uniform(random, 0.0, 1.0) < 0.1 {
                0.0
            } else {
                depth as f32
            }
        };
        let values = (0..640 * 480).map(|_| draw()).collect();
        DepthMap::from_values(640, 480, values).unwrap().0
    }

    fn random_block(random: &mut rand_chacha::ChaCha8Rng) -> Block {
        let mut block = Block::new();
        while !block.is_full() {
            let column = uniform(random, 0.0, 640.0) as u32;
            let row = uniform(random, 0.0, 480.0) as u32;
            block.push(640, column, row, uniform(random, 2.0, 4.0) as f32);
        }
        block
    }

    /// The obvious: validity-aware bilinear sampling in f64. Expected over sampled depth, 0 for none;
    /// `None` where rounding may decide whether a pixel counts.
    fn valid_oracle(map: &DepthMap, pixel: DVec2, z: f64, similar: f64) -> Option<f64> {
        let corner = (pixel - 0.5).floor();
        let (mut weight, mut sum, mut nearest) = (0.0, 0.0, false);
        for (dx, dy) in [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)] {
            let (column, row) = (corner.x + dx, corner.y + dy);
            let inside = column >= 0.0 && row >= 0.0 && column < 640.0 && row < 480.0;
            if !inside {
                continue;
            }
            let depth = f64::from(map.get(column as u32, row as u32));
            if depth > 0.0 && ((z / depth - 1.0).abs() - similar).abs() < 1e-6 {
                return None;
            }
            if depth > 0.0 && (z / depth - 1.0).abs() <= similar {
                let away = (pixel - 0.5 - DVec2::new(column, row)).abs();
                let share = (1.0 - away.x) * (1.0 - away.y);
                weight += share;
                sum += share * z / depth;
                nearest |= away.max_element() < 0.5;
            }
        }
        Some(if nearest { sum / weight } else { 0.0 })
    }

    #[test]
    fn the_loop_agrees_with_the_closed_form_in_f64() {
        let mut random = rng(3);
        let (mut plain_seen, mut valid_seen) = (0, 0);
        for _ in 0..80 {
            let (reference, source) = (random_view(&mut random, 0), random_view(&mut random, 1));
            let pair = Pair::new(&reference, &source);
            let geometry = PairGeometry::new(&reference, &source);
            let block = random_block(&mut random);
            let middle = DVec2::new(320.0, 240.0);
            let around = geometry.project(middle, 3.0).map_or(3.0, |p| p.depth);
            let map = random_map(&mut random, around);
            let inverse: Vec<f32> = map
                .values()
                .iter()
                .map(|&d| Unit::Inverse.convert(d))
                .collect();
            let as_depth = Samples::new(map.size(), Unit::Depth, map.values());
            let as_inverse = Samples::new(map.size(), Unit::Inverse, &inverse);
            let (mut plain, mut valid) = (Seen::new(), Seen::new());
            let room = &mut Footprint::new();
            pair.project(&block, &as_depth, &mut plain, room);
            pair.look(&block, (&as_depth, Taps::Plain), room, &mut plain);
            pair.project(&block, &as_inverse, &mut valid, room);
            pair.look(&block, (&as_inverse, Taps::Valid(0.02)), room, &mut valid);
            for i in 0..BLOCK {
                let pixel = DVec2::new(f64::from(block.u[i]), f64::from(block.v[i]));
                let depth = f64::from(block.depth[i]);
                let projected = geometry.project(pixel, depth);
                let sampled = projected.map_or(0.0, |p| sampling::plain(&map, p.pixel));
                assert_eq!(plain.ratio[i] > 0.0, sampled > 0.0);
                let Some(projected) = projected.filter(|_| sampled > 0.0) else {
                    assert!(plain.relative[i].is_infinite() && plain.pixel2[i].is_infinite());
                    continue;
                };
                plain_seen += 1;
                let q = sampled / projected.depth - 1.0;
                let close = |found: f32, expected: f64| {
                    let bound = 3e-5 * (1.0 + q.abs() + expected.abs());
                    assert!(
                        (f64::from(found) - expected).abs() < bound,
                        "{found} {expected} q {q}"
                    );
                };
                close(plain.delta[i], geometry.reprojected_depth(depth, q) - depth);
                close(plain.relative[i], geometry.depth_error(depth, q));
                let oracle = valid_oracle(&map, projected.pixel, projected.depth, 0.02);
                let Some(oracle) = oracle else { continue };
                valid_seen += usize::from(oracle > 0.0);
                let found = f64::from(valid.ratio[i]);
                assert!((found - oracle).abs() < 1e-6, "{found} {oracle}");
            }
        }
        assert!(
            plain_seen > 500 && valid_seen > 50,
            "{plain_seen} {valid_seen}"
        );
    }
}
