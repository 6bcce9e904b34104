//! A depth map made ready for sampling: cleaned of what the filters leave out, bordered by one
//! pixel without depth, stored as depth or inverse depth.

use super::counts::FuseCounts;
use super::inputs::{DepthMaps, check_size};
use super::options::{FuseOptions, Sampling};
use crate::error::Result;
use mvs_datasets::scene::{Mask, Raster, View};
use std::ops::Range;
use std::sync::Arc;

/// What the numbers of [`Samples`] are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Unit {
    /// z-depth.
    Depth,
    /// 1 / z-depth.
    Inverse,
}

impl Unit {
    /// The unit that the options' sampling interpolates in.
    pub(super) fn of(options: &FuseOptions) -> Self {
        match options.sampling {
            Sampling::Plain => Self::Depth,
            Sampling::Valid => Self::Inverse,
        }
    }

    /// From a depth to a stored value, or back; 0 for none and for what does not fit.
    pub(super) fn convert(self, value: f32) -> f32 {
        let inverse = 1.0 / value;
        match self {
            Self::Depth => value,
            Self::Inverse if value > 0.0 && inverse.is_finite() => inverse,
            Self::Inverse => 0.0,
        }
    }
}

/// A bordered map of depths or inverse depths, 0 for none.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Samples {
    width: usize,
    height: usize,
    unit: Unit,
    /// (width + 2) × (height + 2), row-major.
    values: Arc<Vec<f32>>,
    /// What the filters left out of it.
    left_out: FuseCounts,
    /// Beyond these columns a row has no depth.
    extents: Arc<Vec<Extent>>,
}

/// Columns of a row.
pub(super) type Extent = Range<u32>;

impl Samples {
    /// From one stored value per pixel, row-major.
    pub(super) fn new(size: (u32, u32), unit: Unit, stored: &[f32]) -> Self {
        let (width, height) = (size.0 as usize, size.1 as usize);
        let mut values = bordered(width, height);
        let rows = inner_rows(&mut values, width).zip(stored.chunks_exact(width));
        rows.for_each(|(to, from)| to.copy_from_slice(from));
        Self::from_bordered(size, unit, Arc::new(values))
    }

    /// From the values of [`Samples::values`].
    pub(super) fn from_bordered(size: (u32, u32), unit: Unit, values: Arc<Vec<f32>>) -> Self {
        Self {
            width: size.0 as usize,
            height: size.1 as usize,
            unit,
            values,
            left_out: FuseCounts::default(),
            extents: Arc::new(vec![0..size.0; size.1 as usize]),
        }
    }

    /// With narrower extents, beyond which there is no depth.
    pub(super) fn within(self, extents: Arc<Vec<Extent>>) -> Self {
        Self { extents, ..self }
    }

    /// By row, the columns beyond which there is no depth.
    pub(super) fn extents(&self) -> &Arc<Vec<Extent>> {
        &self.extents
    }

    /// The columns of `row` beyond which there is no depth.
    pub(super) fn extent(&self, row: usize) -> Range<usize> {
        let Range { start, end } = self.extents[row];
        start as usize..end as usize
    }

    /// The columns and rows beyond which there is no depth; `None` without any depth.
    pub(super) fn filled(&self) -> Option<(Extent, Extent)> {
        let rows = (0u32..).zip(self.extents.iter());
        let mut filled = rows.filter(|(_, extent)| !extent.is_empty());
        let (first, extent) = filled.next()?;
        let mut columns = extent.clone();
        let mut last = first;
        for (row, extent) in filled {
            columns = columns.start.min(extent.start)..columns.end.max(extent.end);
            last = row;
        }
        Some((columns, first..last + 1))
    }

    /// The values with the border, to be kept.
    pub(super) fn into_values(self) -> Vec<f32> {
        Arc::unwrap_or_clone(self.values)
    }

    /// All pixels, and what the filters left out of them, by reason.
    pub(super) fn left_out(&self) -> FuseCounts {
        self.left_out
    }

    pub(super) fn width(&self) -> usize {
        self.width
    }

    pub(super) fn height(&self) -> usize {
        self.height
    }

    pub(super) fn unit(&self) -> Unit {
        self.unit
    }

    /// Distance between rows of [`Samples::values`].
    pub(super) fn stride(&self) -> usize {
        self.width + 2
    }

    /// All values with the border.
    pub(super) fn values(&self) -> &[f32] {
        &self.values
    }

    /// The stored values of row `row`.
    pub(super) fn row(&self, row: usize) -> &[f32] {
        let start = (row + 1) * self.stride() + 1;
        &self.values[start..start + self.width]
    }

    /// The stored values of the 3×3 pixels around one, rows from the top; 0 beyond the map.
    pub(super) fn around(&self, column: usize, row: usize) -> [[f32; 3]; 3] {
        std::array::from_fn(|below| {
            let start = (row + below) * self.stride() + column;
            let three = self.values[start..].first_chunk();
            three.copied().unwrap_or_default()
        })
    }

    /// Bytes held.
    pub(super) fn bytes(&self) -> usize {
        self.values.len() * size_of::<f32>()
    }
}

/// Leaves out what has less than the `least` confidence or none; how many that were.
pub(super) fn leave_out(row: &mut [f32], confidences: &[f32], least: f32) -> u64 {
    let mut unconfident = 0u64;
    for (row, confidences) in row.chunks_mut(RUN).zip(confidences.chunks(RUN)) {
        if is_empty(row) {
            continue;
        }
        let mut some = 0u32;
        for (stored, &confidence) in row.iter_mut().zip(confidences) {
            let kept = confidence >= least;
            some += u32::from((*stored > 0.0) & !kept);
            *stored = if kept { *stored } else { 0.0 };
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

/// Which of a view's pixels a filter of the options leaves out.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Filters {
    /// Mask and depth range.
    Depth,
    /// Those and confidence.
    All,
}

/// Zeros for a map with its border.
pub(super) fn bordered(width: usize, height: usize) -> Vec<f32> {
    vec![0.0; (width + 2) * (height + 2)]
}

/// The rows of a bordered map without the border.
fn inner_rows(values: &mut [f32], width: usize) -> impl Iterator<Item = &mut [f32]> {
    let rows = values.chunks_exact_mut(width + 2).skip(1);
    rows.map(move |row| &mut row[1..=width])
}

/// A view's depth map after the filters.
pub(super) fn prepare(
    maps: &dyn DepthMaps,
    index: usize,
    options: &FuseOptions,
    filters: Filters,
) -> Result<Samples> {
    let view = maps.view(index);
    let mask = maps.mask(index)?;
    if let Some(mask) = &mask {
        check_size(view, mask.size(), "mask")?;
    }
    let filter = PixelFilter::new(view, options, mask);
    let unit = Unit::of(options);
    let size = (view.camera.width(), view.camera.height());
    let (width, height) = (size.0 as usize, size.1 as usize);
    let mut values = bordered(width, height);
    let pixels = (width * height) as u64;
    let mut counts = FuseCounts {
        pixels,
        empty: pixels,
        ..FuseCounts::default()
    };
    let mut extents = vec![0..0; height];
    maps.depth_runs(index, &mut |row, first, from| {
        let to = &mut values[(row + 1) * (width + 2) + 1..][first..first + from.len()];
        counts.empty -= from.len() as u64;
        widen(&mut extents[row], first, from.len());
        if filter.passes_all() {
            counts.empty += convert(unit, from, to);
            return;
        }
        let pixels = row * width + first..;
        for (to, (pixel, &depth)) in to.iter_mut().zip(pixels.zip(from)) {
            *to = filter.keep(pixel, unit, depth, &mut counts);
        }
    })?;
    let mut samples = Samples::from_bordered(size, unit, Arc::new(values));
    samples = samples.within(Arc::new(extents));
    samples.left_out = counts;
    match filters {
        Filters::All => {
            let confidence = confidence(maps, index)?;
            Ok(keep_confident(samples, confidence.as_ref(), options))
        }
        Filters::Depth => Ok(samples),
    }
}

/// Puts the stored values of depths into `to`; how many have none.
fn convert(unit: Unit, from: &[f32], to: &mut [f32]) -> u64 {
    let mut empty = 0u32;
    for (to, &depth) in to.iter_mut().zip(from) {
        let stored = unit.convert(depth);
        empty += u32::from(stored <= 0.0);
        *to = stored;
    }
    u64::from(empty)
}

/// Has `extent` hold a run of columns, too, which come in order.
#[allow(clippy::cast_possible_truncation, reason = "image sizes are u32")]
fn widen(extent: &mut Extent, first: usize, len: usize) {
    let start = if extent.start == extent.end {
        first as u32
    } else {
        extent.start
    };
    *extent = start..(first + len) as u32;
}

/// `samples` of a view of this `confidence` through the last filter: without what has too little of it or
/// none.
pub(super) fn keep_confident(
    mut samples: Samples,
    confidence: Option<&Raster<f32>>,
    options: &FuseOptions,
) -> Samples {
    let Some(confidence) = confidence else {
        return samples;
    };
    let least = threshold(confidence, options);
    let width = samples.width;
    // Copies them where others use them too.
    let values = Arc::make_mut(&mut samples.values);
    let rows = inner_rows(values, width).zip(samples.extents.iter());
    for ((row, extent), confidences) in rows.zip(confidence.rows()) {
        let extent = extent.start as usize..extent.end as usize;
        let unconfident = leave_out(&mut row[extent.clone()], &confidences[extent], least);
        samples.left_out.unconfident += unconfident;
    }
    samples
}

/// A view's confidence, checked.
pub(super) fn confidence(maps: &dyn DepthMaps, index: usize) -> Result<Option<Raster<f32>>> {
    let confidence = maps.confidence(index)?;
    if let Some(confidence) = &confidence {
        check_size(maps.view(index), confidence.size(), "confidence")?;
    }
    Ok(confidence)
}

struct PixelFilter {
    mask: Option<Mask>,
    near: f64,
    far: f64,
}

impl PixelFilter {
    fn new(view: &View, options: &FuseOptions, mask: Option<Mask>) -> Self {
        let mut near = options.min_depth;
        let mut far = if options.max_depth > 0.0 {
            options.max_depth
        } else {
            f64::INFINITY
        };
        if let Some(range) = view.depth_range.filter(|_| options.view_range) {
            near = near.max(range.min());
            far = far.min(range.max());
        }
        Self { mask, near, far }
    }

    /// Whether every depth passes.
    fn passes_all(&self) -> bool {
        self.mask.is_none() && self.near <= 0.0 && self.far.is_infinite()
    }

    /// The stored value, or 0 and a reason counted.
    fn keep(&self, pixel: usize, unit: Unit, depth: f32, counts: &mut FuseCounts) -> f32 {
        if depth <= 0.0 {
            counts.empty += 1;
            return 0.0;
        }
        let stored = unit.convert(depth);
        let reason = if stored <= 0.0 {
            &mut counts.empty
        } else if self.mask.as_ref().is_some_and(|mask| !mask.values()[pixel]) {
            &mut counts.masked
        } else if !(self.near..=self.far).contains(&f64::from(depth)) {
            &mut counts.out_of_range
        } else {
            return stored;
        };
        *reason += 1;
        0.0
    }
}

/// The least confidence that is kept: given, or a quantile of the map's own.
pub(super) fn threshold(confidence: &Raster<f32>, options: &FuseOptions) -> f32 {
    if options.confidence_quantile <= 0.0 {
        return options.min_confidence;
    }
    let mut values: Vec<f32> = confidence
        .values()
        .iter()
        .copied()
        .filter(|c| !c.is_nan())
        .collect();
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
    use crate::fuse::testing::arc;
    use glam::DVec3;
    use mvs_datasets::scene::DepthMap;

    #[test]
    fn samples_have_a_border_without_depth() {
        let samples = Samples::new((2, 1), Unit::Depth, &[3.0, 4.0]);
        assert_eq!(
            samples.values(),
            [0.0, 0.0, 0.0, 0.0, 0.0, 3.0, 4.0, 0.0, 0.0, 0.0, 0.0, 0.0]
        );
        assert_eq!(samples.row(0), [3.0, 4.0]);
        let [above, own, below] = samples.around(0, 0);
        assert_eq!((above, own, below), ([0.0; 3], [0.0, 3.0, 4.0], [0.0; 3]));
    }

    #[test]
    fn rows_know_where_their_depths_end() {
        let filled = [0..0, 70..75, 3..140];
        let depth = |at: usize| f32::from(u8::from(filled[at / 150].contains(&(at % 150))));
        let depths: Vec<f32> = (0..450).map(depth).collect();
        let surface = |_: &View, _| 1.0;
        let mut estimates = arc(2, (150, 3), DVec3::ZERO, surface);
        estimates[0].depth = DepthMap::from_values(150, 3, depths.clone()).unwrap().0;
        let options = FuseOptions::default();
        let samples = prepare(&estimates.as_slice(), 0, &options, Filters::Depth).unwrap();
        assert_eq!(samples.extents().as_slice(), [0..0, 64..128, 0..150]);
        for (row, depths) in depths.chunks(150).enumerate() {
            assert_eq!(samples.row(row), depths);
        }
        assert_eq!(samples.left_out().empty, 450 - 5 - 137);
    }

    #[test]
    fn inverse_depths_that_do_not_fit_are_none() {
        assert_eq!(Unit::Inverse.convert(4.0), 0.25);
        assert_eq!(Unit::Inverse.convert(0.0), 0.0);
        assert_eq!(Unit::Inverse.convert(1e-45), 0.0);
    }

    #[test]
    fn a_quantile_leaves_out_that_fraction() {
        let values = (0..100).map(|i| (i * 37 % 100) as f32).collect();
        let map = Raster::from_values(10, 10, values).unwrap();
        let options = FuseOptions {
            confidence_quantile: 0.25,
            ..FuseOptions::default()
        };
        assert_eq!(threshold(&map, &options), 25.0);
        let nothing = Raster::filled(3, 3, f32::NAN).unwrap();
        assert_eq!(threshold(&nothing, &options), f32::INFINITY);
    }
}
