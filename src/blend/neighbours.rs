//! The low-pass of `spectrum` as a weighted sum over neighbouring pixels, where the filter is narrow:
//! the weights are the filter's own response to an impulse, cut where what is left out of a unit
//! signal stays below 1e-6.

use super::frame::Edge;
use crate::parallel;
use pulp::{Arch, Simd, WithSimd};
use std::f64::consts::TAU;

/// Three differences of colour and the mask's weight, filtered together.
pub(super) type Sample = [f32; 4];

/// What may be left out of the weights, whose sum is 1.
const NEGLIGIBLE: f64 = 1e-6;
/// Filters that reach further are quicker through their spectrum.
const FARTHEST: usize = 128;
/// Values that are summed side by side; what the compiler turns into vector instructions.
const BLOCK: usize = 32;
/// Rows of the result that share their source rows.
const STRIP: usize = 64;
/// Values of a row that are filtered along columns before the next ones: what all of a strip's
/// source rows hold of them stays in the second-level cache.
const TILE: usize = 8 * BLOCK;

/// The filter along one axis: the weight of the pixel itself, of both its neighbours, and so on.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Weights(Vec<f32>);

impl Weights {
    /// The response to an impulse on a circle of `period` pixels of the gain exp(−u² / (2·d0)) at
    /// bin u. `None` where it reaches too far.
    pub(super) fn new(period: usize, d0: f64) -> Option<Self> {
        let farthest = FARTHEST.min((period - 1) / 2);
        let gains: Vec<f64> = (1..=period / 2)
            .map(|u| super::spectrum::gain(u, d0))
            .take_while(|&gain| gain > 1e-12)
            .collect();
        let cosines: Vec<f64> = (0..period)
            .map(|at| (TAU * at as f64 / period as f64).cos())
            .collect();
        #[allow(
            clippy::cast_precision_loss,
            reason = "pixel counts are far below 2^53"
        )]
        let weight = |x: usize| {
            let wave = |(index, gain): (usize, &f64)| {
                let u = index + 1;
                let twice = if 2 * u == period { 1.0 } else { 2.0 };
                twice * gain * cosines[(u * x) % period]
            };
            (1.0 + gains.iter().enumerate().map(wave).sum::<f64>()) / period as f64
        };
        let weights: Vec<f64> = (0..=period / 2).map(weight).collect();
        // From the far end: what is cut off on both sides.
        let mut left_out = 0.0;
        let reach = (0..weights.len()).rev().find(|&x| {
            left_out += 2.0 * weights[x].abs();
            left_out > NEGLIGIBLE
        })?;
        (reach <= farthest).then(|| Self(weights[..=reach].iter().map(|&w| w as f32).collect()))
    }

    fn reach(&self) -> usize {
        self.0.len() - 1
    }
}

/// A low-pass for images of one size.
#[derive(Debug)]
pub(super) struct Neighbours {
    width: usize,
    height: usize,
    edge: Edge,
    along_rows: Weights,
    along_columns: Weights,
}

/// Rows of samples as plain values, each row followed by room for whole blocks.
struct Rows {
    /// Values from one row to the next: whole tiles, and a little so that rows fall on different
    /// places in the cache.
    stride: usize,
    values: Vec<f32>,
}

impl Rows {
    fn new(count: usize, width: usize) -> Self {
        let stride = (4 * width).next_multiple_of(TILE) + BLOCK;
        Self {
            stride,
            values: vec![0.0; stride * count],
        }
    }

    fn row(&mut self, index: usize, width: usize) -> &mut [Sample] {
        let start = index * self.stride;
        self.values[start..start + 4 * width].as_chunks_mut().0
    }
}

impl Neighbours {
    /// A low-pass for images of `size` (width, height) with these weights along (rows, columns).
    pub(super) fn new(size: (usize, usize), edge: Edge, weights: (Weights, Weights)) -> Self {
        Self {
            width: size.0,
            height: size.1,
            edge,
            along_rows: weights.0,
            along_columns: weights.1,
        }
    }

    /// Filters the image whose rows `fill` writes; `take` gets each filtered row with the same row
    /// of `out`. Both are called for any row from any thread.
    pub(super) fn filter<T: Send>(
        &self,
        out: &mut [T],
        fill: impl Fn(usize, &mut [Sample]) + Sync + Send,
        take: impl Fn(usize, &[Sample], &mut [T]) + Sync + Send,
    ) {
        let (width, reach) = (self.width, self.along_columns.reach());
        parallel::for_each_chunk(out, width * STRIP, |strip, out| {
            let (first, rows) = (strip * STRIP, out.len() / width);
            let mut source = Rows::new(rows + 2 * reach, width);
            for index in 0..rows + 2 * reach {
                let row = self.edge.source(first + index, reach, self.height);
                fill(row, source.row(index, width));
            }
            let mut columns_done = Rows::new(rows, width);
            Arch::new().dispatch(AlongColumns {
                weights: &self.along_columns.0,
                source: &source,
                out: &mut columns_done,
            });
            let mut padded = vec![[0.0; 4]; width + 2 * self.along_rows.reach() + BLOCK];
            let mut filtered = Rows::new(1, width);
            for (index, out) in out.chunks_exact_mut(width).enumerate() {
                self.pad(columns_done.row(index, width), &mut padded);
                let values = padded.as_flattened();
                let length = (4 * width).next_multiple_of(BLOCK);
                let target = &mut filtered.values[..length];
                Arch::new().dispatch(AlongRow {
                    weights: &self.along_rows.0,
                    source: values,
                    out: target,
                });
                take(first + index, filtered.row(0, width), out);
            }
        });
    }

    /// The row with what lies beyond its ends on both sides.
    fn pad(&self, row: &[Sample], padded: &mut [Sample]) {
        let reach = self.along_rows.reach();
        padded[reach..reach + self.width].copy_from_slice(row);
        for index in (0..reach).chain(reach + self.width..self.width + 2 * reach) {
            padded[index] = row[self.edge.source(index, reach, self.width)];
        }
    }
}

/// Filters all rows of `out` along columns; `source` starts the filter's reach earlier. (A struct,
/// because `pulp` compiles what [`WithSimd::with_simd`] inlines for each set, and no closure.)
struct AlongColumns<'a> {
    weights: &'a [f32],
    source: &'a Rows,
    out: &'a mut Rows,
}

impl WithSimd for AlongColumns<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let stride = self.source.stride;
        for tile in (0..stride - BLOCK).step_by(TILE) {
            for (index, row) in self.out.values.chunks_exact_mut(stride).enumerate() {
                let above = &self.source.values[index * stride + tile..];
                weigh(&mut row[tile..tile + TILE], above, stride, self.weights);
            }
        }
    }
}

/// Filters a row, whose samples have four values; `source` starts the filter's reach earlier.
struct AlongRow<'a> {
    weights: &'a [f32],
    source: &'a [f32],
    out: &'a mut [f32],
}

impl WithSimd for AlongRow<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        weigh(self.out, self.source, 4, self.weights);
    }
}

/// `out[i]` = the weighted sum of the values around `source[i + reach · step]` that lie `step` apart.
/// `out` is of whole blocks.
#[inline(always)]
fn weigh(out: &mut [f32], source: &[f32], step: usize, weights: &[f32]) {
    let reach = weights.len() - 1;
    let block_at = |start: usize| source[start..].first_chunk::<BLOCK>();
    for (block, out) in out.as_chunks_mut::<BLOCK>().0.iter_mut().enumerate() {
        let start = block * BLOCK;
        let mut sums = [0.0f32; BLOCK];
        for distance in (1..=reach).rev() {
            let before = block_at(start + (reach - distance) * step);
            let behind = block_at(start + (reach + distance) * step);
            let (Some(before), Some(behind)) = (before, behind) else {
                continue;
            };
            let weight = weights[distance];
            for i in 0..BLOCK {
                sums[i] += weight * (before[i] + behind[i]);
            }
        }
        if let Some(here) = block_at(start + reach * step) {
            for i in 0..BLOCK {
                sums[i] += weights[0] * here[i];
            }
        }
        *out = sums;
    }
}

#[cfg(test)]
mod tests {
    use super::super::spectrum::LowPass;
    use super::*;

    fn noise(index: usize) -> f32 {
        let mut state = (index as u32).wrapping_mul(2_654_435_761);
        state ^= state >> 15;
        (state.wrapping_mul(1_664_525) >> 8) as f32 / 65536.0 - 128.0
    }

    #[test]
    fn equals_the_spectral_filter_at_odd_and_prime_sizes() {
        for (size, d0) in [
            ((251, 151), (900.0, 400.0)),
            ((128, 96), (50.0, 60.0)),
            ((601, 97), (1500.0, 60.0)),
            ((1031, 523), (5000.0, 2500.0)),
        ] {
            let (width, height) = size;
            let weights = (Weights::new(width, d0.0), Weights::new(height, d0.1));
            let (Some(rows), Some(columns)) = weights else {
                panic!("{size:?} {d0:?} reaches too far");
            };
            let filter = Neighbours::new(size, Edge::Circular, (rows, columns));
            let mut found = vec![[0.0; 4]; width * height];
            let fill = |row: usize, out: &mut [Sample]| {
                for (column, sample) in out.iter_mut().enumerate() {
                    let value = |channel| noise(4 * (row * width + column) + channel);
                    *sample = std::array::from_fn(value);
                }
            };
            let take = |_, row: &[Sample], out: &mut [Sample]| out.copy_from_slice(row);
            filter.filter(&mut found, fill, take);
            for channel in 0..4 {
                let mut expected: Vec<f32> = (0..width * height)
                    .map(|i| noise(4 * i + channel))
                    .collect();
                LowPass::new(size, d0).apply(&mut expected).unwrap();
                for (f, e) in found.iter().zip(&expected) {
                    assert!(
                        (f[channel] - e).abs() < 2e-4,
                        "{size:?}: {} {e}",
                        f[channel]
                    );
                }
            }
        }
    }

    #[test]
    fn the_weights_are_those_of_a_gaussian_where_its_spectrum_fits() {
        let weights = Weights::new(2048, 5000.0).unwrap();
        let sigma: f64 = 2048.0 / 444.29;
        assert_eq!(weights.reach(), 23);
        for (x, &weight) in weights.0.iter().enumerate() {
            let expected = (-(x as f64 / sigma).powi(2) / 2.0).exp() / (sigma * TAU.sqrt());
            assert!((f64::from(weight) - expected).abs() < 2e-6, "{x}");
        }
    }

    #[test]
    fn wide_filters_and_ringing_ones_are_left_to_the_spectrum() {
        assert_eq!(Weights::new(2048, 4.0), None, "as wide as the image");
        assert_eq!(
            Weights::new(576, 5000.0),
            None,
            "cut off at the highest frequency"
        );
        assert_eq!(Weights::new(1, 5000.0), Some(Weights(vec![1.0])));
        assert!(Weights::new(728, 5000.0).is_some());
    }
}
