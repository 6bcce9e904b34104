//! The low-pass of `spectrum` as a weighted sum over neighbouring pixels, where the filter is narrow:
//! the weights are the filter's own response to an impulse, cut where what is left out of a unit
//! signal stays below 1e-6.

use super::frame::Edge;
use crate::parallel;
use pulp::{Arch, Simd, WithSimd};
use std::f64::consts::TAU;

/// What is filtered, row by row, and what becomes of it.
pub(super) trait Work: Sync {
    /// A pixel of the result.
    type Pixel: Send;
    /// What is known of a row of the image.
    fn extent(&self, row: usize) -> Extent;
    /// Whether weights are wanted.
    fn is_weighted(&self) -> bool;
    /// Writes what is filtered in a row: three differences of colour a pixel, and its weight. Called
    /// for any row from any thread.
    fn fill(&self, row: usize, colors: &mut [f32], weights: &mut [f32]);
    /// Writes a row of the result from the filtered colours, which may be overwritten, and weights.
    fn take(&self, row: usize, low: (&mut [f32], &[f32]), out: &mut [Self::Pixel]);
}

/// How much of a row, or of rows, is to be filtered.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Extent {
    /// Nothing: all values are 0.
    Nothing,
    /// Some of it.
    Some,
    /// All of it: weights are 1.
    All,
}

/// What may be left out of the weights, whose sum is 1.
const NEGLIGIBLE: f64 = 1e-6;
/// Filters that reach further are quicker through their spectrum.
const FARTHEST: usize = 128;
/// Values that are summed side by side; what the compiler turns into vector instructions.
const BLOCK: usize = 64;
/// Rows of the result that share their source rows.
const STRIP: usize = 64;
/// Values of a row that are filtered along columns before the next ones: what all of a strip's
/// source rows hold of them stays in the second-level cache.
const TILE: usize = 4 * BLOCK;

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
            .map(|at| libm::cos(TAU * at as f64 / period as f64))
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

/// Rows of values, each followed by room for whole blocks.
struct Rows {
    /// Values in a row.
    length: usize,
    /// Values from one row to the next: whole tiles, and a little so that rows fall on different
    /// places in the cache.
    stride: usize,
    /// Values before the first row, which begins with a line of the cache, so that no block of it lies in
    /// more lines than it must.
    before: usize,
    values: Vec<f32>,
}

/// Bytes of a line of the cache.
const LINE: usize = 64;

impl Rows {
    fn new(count: usize, length: usize) -> Self {
        let stride = length.next_multiple_of(TILE) + BLOCK;
        let values = vec![0.0; stride * count + LINE / size_of::<f32>()];
        Self {
            length,
            stride,
            before: values.as_ptr().align_offset(LINE) % (LINE / size_of::<f32>()),
            values,
        }
    }

    fn row(&mut self, index: usize) -> &mut [f32] {
        &mut self.values[self.before + index * self.stride..][..self.length]
    }

    /// The values from the first row on.
    fn all(&self) -> &[f32] {
        &self.values[self.before..]
    }

    fn all_mut(&mut self) -> &mut [f32] {
        &mut self.values[self.before..]
    }
}

/// Values of one kind in a strip, so many a pixel.
struct Layer {
    channels: usize,
    source: Rows,
    columns_done: Rows,
    padded: Vec<f32>,
    /// One row, filtered, with room for whole blocks.
    filtered: Vec<f32>,
}

impl Layer {
    fn new(of: &Neighbours, channels: usize) -> Self {
        let length = channels * of.width;
        let beyond = 2 * channels * of.along_rows.reach();
        Self {
            channels,
            source: Rows::new(STRIP + 2 * of.along_columns.reach(), length),
            columns_done: Rows::new(STRIP, length),
            padded: vec![0.0; length + beyond + BLOCK],
            filtered: vec![0.0; length.next_multiple_of(BLOCK)],
        }
    }

    /// Filters the first `rows` rows along columns.
    fn along_columns(&mut self, of: &Neighbours, rows: usize) {
        Arch::new().dispatch(AlongColumns {
            weights: &of.along_columns.0,
            source: &self.source,
            out: &mut self.columns_done,
            rows,
        });
    }

    /// Filters one row, filtered along columns, along itself.
    fn along_row(&mut self, of: &Neighbours, index: usize) {
        let (channels, reach) = (self.channels, of.along_rows.reach());
        let row = self.columns_done.row(index);
        let first = channels * reach;
        self.padded[first..first + row.len()].copy_from_slice(row);
        for index in (0..reach).chain(reach + of.width..of.width + 2 * reach) {
            let from = channels * of.edge.source(index, reach, of.width);
            self.padded[channels * index..][..channels].copy_from_slice(&row[from..][..channels]);
        }
        Arch::new().dispatch(AlongRow {
            weights: &of.along_rows.0,
            source: &self.padded,
            step: channels,
            out: &mut self.filtered,
        });
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

    /// Filters what `work` fills in and hands it the result, a strip of rows at a time.
    pub(super) fn filter<W: Work>(&self, work: &W, out: &mut [W::Pixel]) {
        let (width, reach) = (self.width, self.along_columns.reach());
        let room = || (Layer::new(self, 3), Layer::new(self, 1));
        let size = width * STRIP;
        parallel::for_each_chunk_with((out, size), room, |(colors, weights), strip, out| {
            let (first, rows) = (strip * STRIP, out.len() / width);
            let source = |index: usize| self.edge.source(first + index, reach, self.height);
            let sources = rows + 2 * reach;
            let extent = |index| work.extent(source(index));
            let nothing = (0..sources).all(|index| extent(index) == Extent::Nothing);
            let all = nothing || (0..sources).all(|index| extent(index) == Extent::All);
            let ones = all || !work.is_weighted();
            if !nothing {
                for index in 0..sources {
                    work.fill(
                        source(index),
                        colors.source.row(index),
                        weights.source.row(index),
                    );
                }
                colors.along_columns(self, rows);
            }
            if ones {
                weights.filtered.fill(self.unit());
            } else {
                weights.along_columns(self, rows);
            }
            for (index, out) in out.chunks_exact_mut(width).enumerate() {
                if nothing {
                    colors.filtered.fill(0.0);
                } else {
                    colors.along_row(self, index);
                }
                if !ones {
                    weights.along_row(self, index);
                }
                let low = (
                    &mut colors.filtered[..3 * width],
                    &weights.filtered[..width],
                );
                work.take(first + index, low, out);
            }
        });
    }

    /// What the filter makes of ones, in the order of its sums.
    fn unit(&self) -> f32 {
        let filtered = |value: f32, weights: &Weights| {
            let ahead = weights.0[1..].iter().rev();
            let sum = ahead.fold(0.0, |sum, weight| sum + weight * (value + value));
            sum + weights.0[0] * value
        };
        filtered(filtered(1.0, &self.along_columns), &self.along_rows)
    }
}

/// Filters all rows of `out` along columns; `source` starts the filter's reach earlier. (A struct,
/// because `pulp` compiles what [`WithSimd::with_simd`] inlines for each set, and no closure.)
struct AlongColumns<'a> {
    weights: &'a [f32],
    source: &'a Rows,
    out: &'a mut Rows,
    rows: usize,
}

impl WithSimd for AlongColumns<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let stride = self.source.stride;
        let source = self.source.all();
        for tile in (0..stride - BLOCK).step_by(TILE) {
            let rows = self.out.all_mut().chunks_exact_mut(stride).take(self.rows);
            for (index, row) in rows.enumerate() {
                let above = &source[index * stride + tile..];
                weigh(&mut row[tile..tile + TILE], above, stride, self.weights);
            }
        }
    }
}

/// Filters a row of pixels with `step` values each; `source` starts the filter's reach earlier.
struct AlongRow<'a> {
    weights: &'a [f32],
    source: &'a [f32],
    step: usize,
    out: &'a mut [f32],
}

impl WithSimd for AlongRow<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        weigh(self.out, self.source, self.step, self.weights);
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
            for extent in [Extent::Some, Extent::All] {
                let mut found = vec![[0.0; 4]; width * height];
                filter.filter(&NoiseOf { width, extent }, &mut found);
                for channel in 0..4 {
                    let value = |i| match (channel, extent) {
                        (3, Extent::All) => 1.0,
                        _ => noise(4 * i + channel),
                    };
                    let mut expected: Vec<f32> = (0..width * height).map(value).collect();
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
    }

    /// Noise in all channels; where the extent is all, weights of 1 instead.
    struct NoiseOf {
        width: usize,
        extent: Extent,
    }

    impl Work for NoiseOf {
        type Pixel = [f32; 4];

        fn extent(&self, _: usize) -> Extent {
            self.extent
        }

        fn is_weighted(&self) -> bool {
            true
        }

        fn fill(&self, row: usize, colors: &mut [f32], weights: &mut [f32]) {
            for column in 0..self.width {
                let at = 4 * (row * self.width + column);
                for channel in 0..3 {
                    colors[3 * column + channel] = noise(at + channel);
                }
                weights[column] = noise(at + 3);
            }
        }

        fn take(&self, _: usize, (colors, weights): (&mut [f32], &[f32]), out: &mut [[f32; 4]]) {
            let colors = colors.as_chunks::<3>().0;
            for ((out, &[r, g, b]), &weight) in out.iter_mut().zip(colors).zip(weights) {
                *out = [r, g, b, weight];
            }
        }
    }

    #[test]
    fn ones_become_what_is_filled_in_for_them() {
        for (edge, size, d0) in [
            (Edge::Circular, (251, 151), (900.0, 400.0)),
            (Edge::Reflected, (128, 96), (50.0, 60.0)),
        ] {
            let (columns, rows) = (edge.axis(size.0, d0.0), edge.axis(size.1, d0.1));
            let along_rows = Weights::new(columns.length(), columns.d0).unwrap();
            let along_columns = Weights::new(rows.length(), rows.d0).unwrap();
            let filter = Neighbours::new(size, edge, (along_rows, along_columns));
            struct Ones;
            impl Work for Ones {
                type Pixel = f32;
                fn extent(&self, _: usize) -> Extent {
                    Extent::Some
                }
                fn is_weighted(&self) -> bool {
                    true
                }
                fn fill(&self, _: usize, _: &mut [f32], weights: &mut [f32]) {
                    weights.fill(1.0);
                }
                fn take(&self, _: usize, (_, weights): (&mut [f32], &[f32]), out: &mut [f32]) {
                    out.copy_from_slice(weights);
                }
            }
            let mut found = vec![0.0; size.0 * size.1];
            filter.filter(&Ones, &mut found);
            assert!(
                found
                    .iter()
                    .all(|&one| one.to_bits() == filter.unit().to_bits())
            );
            assert!((filter.unit() - 1.0).abs() < 4e-6);
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
