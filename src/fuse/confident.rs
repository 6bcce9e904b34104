//! Bands of a reference's map without what has too little confidence.

use super::inputs::DepthMaps;
use super::options::FuseOptions;
use super::samples::{SIDE, Samples, confidence};
use crate::error::Result;
use std::ops::Range;

/// Rows of a bordered map: all of them, or a band with a row above and one below.
#[derive(Debug, Clone, Copy)]
pub(super) struct Rows<'a> {
    values: &'a [f32],
    /// Values of the whole map before these.
    before: usize,
    samples: &'a Samples,
}

impl<'a> Rows<'a> {
    /// All of a map.
    pub(super) fn all(samples: &'a Samples) -> Self {
        Self {
            values: samples.values(),
            before: 0,
            samples,
        }
    }

    /// The values of `columns`, which are stored, in a row.
    pub(super) fn part(&self, row: usize, columns: Range<usize>) -> &'a [f32] {
        let start = self.samples.place(columns.start, row) - self.before;
        &self.values[start..start + columns.len()]
    }

    /// The stored values from a neighbour on, number 0 to 8 by row, of the pixel at `place` in the bordered
    /// map.
    #[inline(always)]
    pub(super) fn of_neighbour(&self, place: usize, number: usize) -> &'a [f32] {
        let stride = self.samples.stride();
        let first = place - stride - 1 - self.before;
        &self.values[first + number / 3 * stride + number % 3..]
    }
}

/// What leaves out a reference's pixels that have too little confidence, band by band.
#[derive(Debug)]
pub(super) struct Confident {
    /// By pixel; those beyond the map's extents mean nothing.
    pub(super) confidences: Vec<f32>,
    least: f32,
}

impl Confident {
    /// Reads a view's confidence into `room`; `None` if it has none.
    pub(super) fn read(
        (maps, index): (&dyn DepthMaps, usize),
        samples: &Samples,
        options: &FuseOptions,
        mut room: Vec<f32>,
    ) -> Result<Option<Self>> {
        if options.confidence_quantile > 0.0 {
            let known = confidence(maps, index)?;
            return Ok(known.map(|known| {
                let (confidences, width) = (known.into_values(), samples.width());
                let depths = (0..samples.height()).flat_map(|row| {
                    let extent = samples.extent(row);
                    let confidences = &confidences[row * width..][extent.clone()];
                    with_depth(samples.part(row, extent), confidences)
                });
                Self {
                    least: threshold(depths, options),
                    confidences,
                }
            }));
        }
        room.resize(samples.width() * samples.height(), 0.0);
        let wanted = |row: usize| samples.extent(row);
        let known = maps.confidence_parts(index, &wanted, &mut room)?;
        Ok(known.then_some(Self {
            confidences: room,
            least: options.least_confidence(),
        }))
    }

    /// Puts `rows` of the map without what has too little confidence into `room`; how many pixels of them
    /// that were.
    pub(super) fn band<'a>(
        &self,
        samples: &'a Samples,
        rows: Range<usize>,
        room: &'a mut Vec<f32>,
    ) -> (Rows<'a>, u64) {
        let (width, stride) = (samples.width(), samples.stride());
        let first = samples.columns().start;
        let before = rows.start * stride;
        room.clear();
        room.resize((rows.len() + 2) * stride, 0.0);
        let mut unconfident = 0;
        for (at, own) in room.chunks_exact_mut(stride).enumerate() {
            // The first is the row above `rows`.
            let row = (rows.start + at).checked_sub(1);
            let Some(row) = row.filter(|&row| row < samples.height()) else {
                continue;
            };
            let extent = samples.extent(row);
            if extent.is_empty() {
                continue;
            }
            let own = &mut own[SIDE + extent.start - first..][..extent.len()];
            let stored = samples.part(row, extent.clone());
            let confidences = &self.confidences[row * width..][extent];
            let left_out = put_confident((stored, confidences), self.least, own);
            unconfident += if rows.contains(&row) { left_out } else { 0 };
        }
        let values = room.as_slice();
        let rows = Rows {
            values,
            before,
            samples,
        };
        (rows, unconfident)
    }
}

/// Puts stored values into `to`, zeros, but for what has less than the `least` confidence or none (NaN and ∞ are
/// none); how many depths that were.
pub(super) fn put_confident(
    (stored, confidences): (&[f32], &[f32]),
    least: f32,
    to: &mut [f32],
) -> u64 {
    let mut unconfident = 0u64;
    let known = stored.chunks(RUN).zip(confidences.chunks(RUN));
    for ((stored, confidences), to) in known.zip(to.chunks_mut(RUN)) {
        if is_empty(stored) {
            continue;
        }
        let mut some = 0u32;
        for ((&stored, &confidence), to) in stored.iter().zip(confidences).zip(to) {
            let kept = (confidence >= least) & (confidence < f32::INFINITY);
            some += u32::from((stored > 0.0) & !kept);
            *to = if kept { stored } else { 0.0 };
        }
        unconfident += u64::from(some);
    }
    unconfident
}

/// Pixels in a row that are looked at together to see whether there is anything.
const RUN: usize = 64;

/// Whether all values, none of them negative, are 0.
#[inline(always)]
fn is_empty(values: &[f32]) -> bool {
    values.iter().fold(0, |bits, value| bits | value.to_bits()) == 0
}

/// The confidences at depths, which are not 0.
pub(super) fn with_depth<'a>(
    depths: &'a [f32],
    confidences: &'a [f32],
) -> impl Iterator<Item = f32> + use<'a> {
    let both = depths.iter().zip(confidences);
    both.filter(|&(&depth, _)| depth != 0.0)
        .map(|(_, &confidence)| confidence)
}

/// The least confidence that is kept: given, or a quantile of those of the pixels with depth.
pub(super) fn threshold(with_depth: impl Iterator<Item = f32>, options: &FuseOptions) -> f32 {
    if options.confidence_quantile <= 0.0 {
        return options.least_confidence();
    }
    let mut values: Vec<f32> = with_depth.filter(|&c| c < f32::INFINITY).collect();
    if values.is_empty() {
        return f32::INFINITY;
    }
    #[allow(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        clippy::cast_precision_loss,
        reason = "a fraction below 1 of a number of pixels"
    )]
    let rank = (options.confidence_quantile * values.len() as f64) as usize;
    *values.select_nth_unstable_by(rank, f32::total_cmp).1
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fuse::options::FuseMode;
    use crate::fuse::samples::{Filters, prepare};
    use crate::fuse::testing::arc;
    use glam::DVec3;
    use mvs_datasets::scene::{DepthMap, Raster, View};

    /// Band by band it is what it is at once, within extents that are known and without.
    #[test]
    fn bands_leave_out_what_the_whole_map_does() {
        let (width, height) = (150u32, 7u32);
        let depth = |at: u32| match (at % 150 / 64, at / 150) {
            (1.., _) | (_, 5) => 0.0,
            _ => f32::from(u8::from(!at.is_multiple_of(5))) * (1.0 + at as f32),
        };
        let confidence = |at: u32| match at % 7 {
            0 => f32::NAN,
            rest => rest as f32 / 7.0,
        };
        let depths: Vec<f32> = (0..width * height).map(depth).collect();
        let confidences: Vec<f32> = (0..width * height).map(confidence).collect();
        let options = FuseOptions {
            min_confidence: 0.5,
            ..FuseOptions::default()
        };
        let mut estimates = arc(2, (width, height), DVec3::ZERO, |_: &View, _| 1.0);
        estimates[0].depth = DepthMap::from_values(width, height, depths.clone())
            .unwrap()
            .0;
        estimates[0].confidence = Raster::from_values(width, height, confidences.clone()).ok();
        let whole = prepare(&estimates.as_slice(), 0, &options, Filters::All).unwrap();
        for (at, (&depth, &confidence)) in depths.iter().zip(&confidences).enumerate() {
            let kept = if confidence >= 0.5 { depth } else { 0.0 };
            let stored = whole.get(at % 150, at / 150);
            assert_eq!(stored, whole.unit().convert(kept));
        }
        let confident = Confident {
            confidences,
            least: 0.5,
        };
        let narrow = |row: u32| if row == 5 { 0..0 } else { 0..64 };
        let unit = whole.unit();
        let inverse: Vec<f32> = depths.iter().map(|&depth| unit.convert(depth)).collect();
        let samples = Samples::new((width, height), unit, &inverse);
        let samples = samples.within((0..height).map(narrow).collect());
        let mut unconfident = 0;
        for rows in [0..3, 3..4, 4..7] {
            let mut room = vec![9.0; 5];
            let (band, more) = confident.band(&samples, rows.clone(), &mut room);
            unconfident += more;
            for row in rows {
                assert_eq!(band.part(row, 0..64), whole.part(row, 0..64));
                for column in 0..64 {
                    let (_, place) = samples.grid().numbers(column as u32, row as u32);
                    let place = place as usize;
                    for (number, value) in
                        whole.around(column, row).as_flattened().iter().enumerate()
                    {
                        assert_eq!(band.of_neighbour(place, number)[0], *value);
                    }
                }
            }
        }
        assert!(unconfident > 0);
        assert_eq!(unconfident, whole.left_out().unconfident);
    }

    /// `prob < threshold` is left out by the scripts of `gipuma`, `prob > threshold` kept by the others.
    #[test]
    fn what_is_just_as_confident_as_asked_counts_where_the_published_scripts_count_it() {
        let kept = |mode, min_confidence| {
            let options = FuseOptions {
                mode,
                min_confidence,
                ..FuseOptions::default()
            };
            let confidences = [0.0, 0.8f32.next_down(), 0.8, 0.8f32.next_up()];
            let mut to = [0.0; 4];
            put_confident(
                (&[1.0; 4], &confidences),
                options.least_confidence(),
                &mut to,
            );
            to
        };
        for mode in [FuseMode::Hkust, FuseMode::Geo, FuseMode::Dynamic] {
            assert_eq!(kept(mode, 0.8), [0.0, 0.0, 0.0, 1.0], "{mode:?}");
            assert_eq!(kept(mode, 0.0), [1.0; 4], "{mode:?}");
        }
        for mode in [FuseMode::Gipuma, FuseMode::Cluster] {
            assert_eq!(kept(mode, 0.8), [0.0, 0.0, 1.0, 1.0], "{mode:?}");
            assert_eq!(kept(mode, 0.0), [1.0; 4], "{mode:?}");
        }
    }

    #[test]
    fn a_quantile_leaves_out_that_fraction() {
        let values = (0..100u8).map(|i| f32::from((u16::from(i) * 37 % 100) as u8));
        let options = FuseOptions {
            confidence_quantile: 0.25,
            ..FuseOptions::default()
        };
        assert_eq!(threshold(values, &options), 25.0);
        let nothing = [f32::NAN; 3].into_iter();
        assert_eq!(threshold(nothing, &options), f32::INFINITY);
        // What has no depth does not count, whatever its confidence.
        let some = with_depth(&[0.0, 2.0, 0.0, 3.0, 2.5], &[0.0, 0.7, 0.9, 0.2, 0.4]);
        assert_eq!(some.collect::<Vec<_>>(), [0.7, 0.2, 0.4]);
    }
}
