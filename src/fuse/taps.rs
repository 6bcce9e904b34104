//! The inner loop's middle: a source's depth between its pixels, as a ratio to what is expected.

#![allow(
    clippy::needless_range_loop,
    reason = "columns are walked side by side, and closures would leave the instruction set"
)]

use super::kernel::{BLOCK, Footprint};
use super::samples::{Samples, Unit};

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

/// What is sampled of one source, used again for the next.
pub(super) struct Sampled {
    /// Left and right of the upper pixels, and of the lower ones.
    top: [[f32; 2]; BLOCK],
    bottom: [[f32; 2]; BLOCK],
    /// Expected depth / depth of the nearest pixel; 0 where that has none.
    pub(super) near: [f32; BLOCK],
}

impl Sampled {
    pub(super) fn new() -> Self {
        Self {
            top: [[0.0; 2]; BLOCK],
            bottom: [[0.0; 2]; BLOCK],
            near: [0.0; BLOCK],
        }
    }

    /// Fetches the pixels of `footprint`.
    #[inline(always)]
    pub(super) fn fetch(&mut self, (source, taps): (&Samples, Taps), footprint: &Footprint) {
        match taps {
            Taps::Nearest => self.gather_nearest(source, footprint),
            Taps::Plain | Taps::Valid(_) => self.gather(source, &footprint.index),
        }
    }

    /// Puts expected depth / sampled depth into `ratio`, 0 for none, of the pixels that were fetched.
    #[inline(always)]
    pub(super) fn weigh(
        &mut self,
        (unit, taps): (Unit, Taps),
        footprint: &Footprint,
        ratio: &mut [f32; BLOCK],
    ) {
        match taps {
            Taps::Valid(similar) => self.valid(footprint, similar, ratio),
            Taps::Plain => self.plain(footprint, ratio),
            Taps::Nearest => {
                let z = &footprint.z;
                for i in 0..BLOCK {
                    self.near[i] = match unit {
                        Unit::Inverse => self.near[i] * z[i],
                        Unit::Depth => over(z[i], self.near[i]),
                    };
                }
                *ratio = self.near;
            }
        }
    }

    /// Fetches the nearest pixels alone.
    #[inline(always)]
    fn gather_nearest(&mut self, source: &Samples, footprint: &Footprint) {
        let (values, stride) = (source.values(), source.stride());
        for i in 0..BLOCK {
            let right = usize::from(footprint.fx[i] >= 0.5);
            let below = if footprint.fy[i] >= 0.5 { stride } else { 0 };
            self.near[i] = values[footprint.index[i] as usize + right + below];
        }
    }

    #[inline(always)]
    fn gather(&mut self, source: &Samples, index: &[u32; BLOCK]) {
        // Two views of the map, a row apart and of one length: one bound is checked per pixel.
        let starts = source.values().len() - source.stride();
        let above = &source.values()[..starts];
        let below = &source.values()[source.stride()..][..starts];
        for i in 0..BLOCK {
            let start = index[i] as usize;
            self.top[i] = [above[start], above[start + 1]];
            self.bottom[i] = [below[start], below[start + 1]];
        }
    }

    /// Expected depth / bilinear depth, pixels without depth as zeros.
    #[inline(always)]
    fn plain(&mut self, footprint: &Footprint, ratio: &mut [f32; BLOCK]) {
        let z = &footprint.z;
        for i in 0..BLOCK {
            let ([a, b], [c, d]) = (self.top[i], self.bottom[i]);
            let (fx, fy) = (footprint.fx[i], footprint.fy[i]);
            let top = a * (1.0 - fx) + b * fx;
            let bottom = c * (1.0 - fx) + d * fx;
            let depth = top * (1.0 - fy) + bottom * fy;
            ratio[i] = over(z[i], depth);
            self.near[i] = over(z[i], nearest([a, b], [c, d], footprint, i));
        }
    }

    /// Bilinear inverse depth over the pixels near the expected one, times the expected depth. The
    /// nearest pixel must be among them: half a pixel is the most that is extrapolated.
    #[inline(always)]
    fn valid(&mut self, footprint: &Footprint, similar: f32, ratio: &mut [f32; BLOCK]) {
        let z = &footprint.z;
        for i in 0..BLOCK {
            let ([a, b], [c, d]) = (self.top[i], self.bottom[i]);
            let near = nearest([a, b], [c, d], footprint, i) * z[i];
            let (fx, fy) = (footprint.fx[i], footprint.fy[i]);
            let (gx, gy) = (1.0 - fx, 1.0 - fy);
            let mut weight = 0.0;
            let mut offset = 0.0;
            for (tap, share) in [(a, gx * gy), (b, fx * gy), (c, gx * fy), (d, fx * fy)] {
                // Offsets from 1 are summed, not ratios, so that rounding does not grow.
                let from_one = tap * z[i] - 1.0;
                let share = if from_one.abs() <= similar {
                    share
                } else {
                    0.0
                };
                weight += share;
                offset += share * from_one;
            }
            let nearest_counts = (near - 1.0).abs() <= similar;
            let found = 1.0 + offset / weight;
            ratio[i] = if nearest_counts { found } else { 0.0 };
            self.near[i] = near;
        }
    }
}

/// The nearest of the four pixels' value.
#[inline(always)]
fn nearest([a, b]: [f32; 2], [c, d]: [f32; 2], footprint: &Footprint, i: usize) -> f32 {
    let (right, below) = (footprint.fx[i] >= 0.5, footprint.fy[i] >= 0.5);
    let top = if right { b } else { a };
    let bottom = if right { d } else { c };
    if below { bottom } else { top }
}

/// `z` / `depth`; 0 without a depth.
#[inline(always)]
fn over(z: f32, depth: f32) -> f32 {
    let ratio = z / depth;
    if depth > 0.0 { ratio } else { 0.0 }
}
