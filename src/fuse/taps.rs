//! The inner loop's middle: a source's depth between its pixels, as a ratio to what is expected.

#![allow(
    clippy::needless_range_loop,
    reason = "columns are walked side by side, and closures would leave the instruction set"
)]

use super::kernel::{BLOCK, Footprint};
use super::rules::Bounds;
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
#[repr(C, align(64))]
pub(super) struct Sampled {
    /// Left and right of the upper pixels, and of the lower ones: pairs take fewer steps to part into columns
    /// than the four together would.
    above: [[f32; 2]; BLOCK],
    below: [[f32; 2]; BLOCK],
    /// The nearest pixel's value; where that alone is fetched.
    nearest: [f32; BLOCK],
}

impl Sampled {
    pub(super) fn new() -> Self {
        Self {
            above: [[0.0; 2]; BLOCK],
            below: [[0.0; 2]; BLOCK],
            nearest: [0.0; BLOCK],
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

    /// Puts expected depth / depth of the nearest pixel into `ratio`, 0 for none, where it was fetched alone.
    #[inline(always)]
    pub(super) fn weigh_nearest(
        &self,
        unit: Unit,
        footprint: &Footprint,
        ratio: &mut [f32; BLOCK],
    ) {
        let z = &footprint.z;
        for i in 0..BLOCK {
            ratio[i] = match unit {
                Unit::Inverse => self.nearest[i] * z[i],
                Unit::Depth => over(z[i], self.nearest[i]),
            };
        }
    }

    /// Fetches the nearest pixels alone.
    #[inline(always)]
    fn gather_nearest(&mut self, source: &Samples, footprint: &Footprint) {
        let (values, stride) = (source.values(), source.stride());
        for i in 0..BLOCK {
            let right = usize::from(footprint.fx[i] >= 0.5);
            let below = if footprint.fy[i] >= 0.5 { stride } else { 0 };
            self.nearest[i] = values[footprint.index[i] as usize + right + below];
        }
    }

    #[inline(always)]
    fn gather(&mut self, source: &Samples, index: &[u32; BLOCK]) {
        // Two views of the map, a row apart and of one length: one bound is checked per pixel.
        let starts = source.values().len() - source.stride();
        let above = &source.values()[..starts];
        let below = &source.values()[source.stride()..][..starts];
        for i in 0..BLOCK {
            let two = index[i] as usize..index[i] as usize + 2;
            let (above, below) = (&above[two.clone()], &below[two]);
            self.above[i] = [above[0], above[1]];
            self.below[i] = [below[0], below[1]];
        }
    }
}

/// What a source's pixels say about one hypothesis.
#[derive(Clone, Copy)]
pub(super) struct Look {
    /// Whether the source has a depth there.
    pub(super) sampled: bool,
    /// Sampled depth / expected depth − 1; means nothing without a sample.
    pub(super) q: f32,
    /// Whether the nearest pixel's depth is beyond the hypothesis.
    pub(super) through: bool,
    /// Whether the nearest pixel has a depth that is not in front of the hypothesis.
    pub(super) judges: bool,
    /// Whether the hypothesis projects into the map, or less than half a pixel beyond it, where the nearest pixel
    /// has no depth.
    pub(super) silent: bool,
}

/// A way to combine the four pixels.
pub(super) trait Looks {
    /// At entry `i` of the block.
    fn at(&self, i: usize) -> Look;
}

/// What there is to look at.
#[derive(Clone, Copy)]
pub(super) struct Sight<'a> {
    pub(super) sampled: &'a Sampled,
    pub(super) footprint: &'a Footprint,
    pub(super) bounds: &'a Bounds,
}

impl Sight<'_> {
    /// The four pixels at an entry, how far to the right and below it lies, and the nearest of them.
    #[inline(always)]
    fn at(&self, i: usize) -> ([f32; 4], [f32; 2], f32) {
        let ([a, b], [c, d]) = (self.sampled.above[i], self.sampled.below[i]);
        let (fx, fy) = (self.footprint.fx[i], self.footprint.fy[i]);
        let top = if fx >= 0.5 { b } else { a };
        let bottom = if fx >= 0.5 { d } else { c };
        let nearest = if fy >= 0.5 { bottom } else { top };
        ([a, b, c, d], [fx, fy], nearest)
    }
}

/// Bilinear depth, pixels without depth as zeros.
pub(super) struct PlainLooks<'a>(pub(super) Sight<'a>);

impl Looks for PlainLooks<'_> {
    #[inline(always)]
    fn at(&self, i: usize) -> Look {
        let sight = self.0;
        let ([a, b, c, d], [fx, fy], nearest) = sight.at(i);
        let (bounds, inverse) = (sight.bounds, sight.footprint.inverse[i]);
        let top = fx.mul_add(b - a, a);
        let bottom = fx.mul_add(d - c, c);
        let depth = fy.mul_add(bottom - top, top);
        let beyond = nearest * inverse;
        Look {
            sampled: depth * inverse > 0.0,
            q: depth.mul_add(inverse, -1.0),
            through: beyond * bounds.through > 1.0,
            judges: beyond * bounds.occluded >= 1.0,
            silent: (inverse > 0.0) & (beyond <= 0.0),
        }
    }
}

/// Bilinear inverse depth over the pixels within a fraction of the expected one. The nearest pixel must be
/// among them: half a pixel is the most that is extrapolated.
pub(super) struct ValidLooks<'a>(pub(super) Sight<'a>, pub(super) f32);

impl Looks for ValidLooks<'_> {
    #[inline(always)]
    fn at(&self, i: usize) -> Look {
        let Self(sight, similar) = *self;
        let ([a, b, c, d], [fx, fy], nearest) = sight.at(i);
        let (bounds, z) = (sight.bounds, sight.footprint.z[i]);
        let near = nearest * z;
        let (gx, gy) = (1.0 - fx, 1.0 - fy);
        let mut weight = 0.0f32;
        let mut offset = 0.0f32;
        for (tap, share) in [(a, gx * gy), (b, fx * gy), (c, gx * fy), (d, fx * fy)] {
            // Offsets from 1 are summed, not ratios, so that rounding does not grow.
            let from_one = tap.mul_add(z, -1.0);
            let share = if from_one.abs() <= similar {
                share
            } else {
                0.0
            };
            weight += share;
            offset = share.mul_add(from_one, offset);
        }
        let ratio = weight + offset;
        Look {
            sampled: ((near - 1.0).abs() <= similar) & (ratio > 0.0),
            q: -offset / ratio,
            through: (near > 0.0) & (near < bounds.through),
            judges: (near > 0.0) & (near <= bounds.occluded),
            silent: (z > 0.0) & (near <= 0.0),
        }
    }
}

/// `z` / `depth`; 0 without a depth.
#[inline(always)]
fn over(z: f32, depth: f32) -> f32 {
    let ratio = z / depth;
    if depth > 0.0 { ratio } else { 0.0 }
}
