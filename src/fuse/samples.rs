//! A depth map made ready for sampling: cleaned of what the filters leave out, bordered by
//! pixels without depth (two left and right, a row above and below), stored as depth or inverse depth.

use super::confident::{put_confident, threshold, with_depth};
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

/// A bordered map of depths or inverse depths, 0 for none. Columns beyond all depths are not stored.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Samples {
    width: usize,
    height: usize,
    unit: Unit,
    shape: Arc<Shape>,
    /// By row, between a row of zeros above and one below, two zeros, the stored columns and two zeros: then
    /// some two neighbours are beyond the depths on either side.
    values: Arc<Vec<f32>>,
    /// What the filters left out of it.
    left_out: FuseCounts,
}

/// Where a map has depths.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Shape {
    /// The columns that are stored.
    columns: Range<usize>,
    /// By row, the columns beyond which there is no depth.
    extents: Vec<Extent>,
}

/// Columns of a row.
pub(super) type Extent = Range<u32>;

/// Zeros on either side of a row.
pub(super) const SIDE: usize = 2;

impl Shape {
    /// With all columns stored.
    fn whole(size: (u32, u32)) -> Self {
        Self {
            columns: 0..size.0 as usize,
            extents: vec![0..size.0; size.1 as usize],
        }
    }

    /// With the columns of these extents stored.
    fn of(extents: Vec<Extent>) -> Self {
        let filled = || extents.iter().filter(|extent| !extent.is_empty());
        let first = filled().map(|extent| extent.start).min().unwrap_or(0);
        let end = filled().map(|extent| extent.end).max().unwrap_or(0);
        Self {
            columns: first as usize..end as usize,
            extents,
        }
    }

    fn stride(&self) -> usize {
        self.columns.len() + 2 * SIDE
    }

    /// Zeros for a map of this shape.
    pub(super) fn zeros(&self) -> Vec<f32> {
        vec![0.0; self.stride() * (self.extents.len() + 2)]
    }

    /// The place among the values of a pixel whose column is stored.
    fn place(&self, column: usize, row: usize) -> usize {
        (row + 1) * self.stride() + SIDE + column - self.columns.start
    }
}

/// How the pixels of a map are numbered.
#[derive(Debug, Clone, Copy)]
pub(super) struct Grid {
    width: u32,
    stride: u32,
    /// The first column that is stored.
    left: u32,
}

impl Grid {
    /// Of a map of this width with all columns stored.
    #[cfg(test)]
    pub(super) fn whole(width: u32) -> Self {
        Self {
            width,
            stride: width + 2 * SIDE as u32,
            left: 0,
        }
    }

    /// The row-major number of a pixel, and its place among the stored values.
    #[inline(always)]
    #[allow(clippy::cast_possible_truncation, reason = "two")]
    pub(super) fn numbers(self, column: u32, row: u32) -> (u32, u32) {
        let place = (row + 1) * self.stride + SIDE as u32 + column - self.left;
        (row * self.width + column, place)
    }
}

impl Samples {
    /// From one stored value per pixel, row-major.
    pub(super) fn new(size: (u32, u32), unit: Unit, stored: &[f32]) -> Self {
        let shape = Shape::whole(size);
        let mut values = shape.zeros();
        for (row, from) in stored.chunks_exact(size.0 as usize).enumerate() {
            values[shape.place(0, row)..][..from.len()].copy_from_slice(from);
        }
        Self::of_shape(size, unit, Arc::new(shape), Arc::new(values))
    }

    /// From the values of [`Samples::values`]; their shape is that of whole rows unless it is known.
    pub(super) fn of_values(
        size: (u32, u32),
        unit: Unit,
        shape: Option<Arc<Shape>>,
        values: Arc<Vec<f32>>,
    ) -> Self {
        let shape = shape.unwrap_or_else(|| Arc::new(Shape::whole(size)));
        Self::of_shape(size, unit, shape, values)
    }

    fn of_shape(size: (u32, u32), unit: Unit, shape: Arc<Shape>, values: Arc<Vec<f32>>) -> Self {
        Self {
            width: size.0 as usize,
            height: size.1 as usize,
            unit,
            shape,
            values,
            left_out: FuseCounts::default(),
        }
    }

    /// Stored in these extents only, beyond which there is no depth.
    #[cfg(test)]
    pub(super) fn within(&self, extents: Vec<Extent>) -> Self {
        let shape = Shape::of(extents);
        let mut values = shape.zeros();
        for row in 0..self.height {
            for column in shape.columns.clone() {
                values[shape.place(column, row)] = self.get(column, row);
            }
        }
        Self {
            shape: Arc::new(shape),
            values: Arc::new(values),
            ..self.clone()
        }
    }

    /// Where there are depths.
    pub(super) fn shape(&self) -> &Arc<Shape> {
        &self.shape
    }

    /// The columns of `row` beyond which there is no depth.
    pub(super) fn extent(&self, row: usize) -> Range<usize> {
        let Range { start, end } = self.shape.extents[row];
        start as usize..end as usize
    }

    /// The columns that are stored.
    pub(super) fn columns(&self) -> Range<usize> {
        self.shape.columns.clone()
    }

    /// The columns and rows beyond which there is no depth; `None` without any depth.
    pub(super) fn filled(&self) -> Option<(Extent, Extent)> {
        let rows = (0u32..).zip(self.shape.extents.iter());
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
        self.shape.stride()
    }

    /// How pixels are numbered.
    #[allow(clippy::cast_possible_truncation, reason = "image sizes are u32")]
    pub(super) fn grid(&self) -> Grid {
        Grid {
            width: self.width as u32,
            stride: self.stride() as u32,
            left: self.shape.columns.start as u32,
        }
    }

    /// All values with the border.
    pub(super) fn values(&self) -> &[f32] {
        &self.values
    }

    /// The stored value of a pixel; 0 for none.
    pub(super) fn get(&self, column: usize, row: usize) -> f32 {
        match self.shape.columns.contains(&column) {
            true => self.values[self.shape.place(column, row)],
            false => 0.0,
        }
    }

    /// The place among the values of a pixel whose column is stored.
    pub(super) fn place(&self, column: usize, row: usize) -> usize {
        self.shape.place(column, row)
    }

    /// The values of `columns`, which are stored, in a row.
    pub(super) fn part(&self, row: usize, columns: Range<usize>) -> &[f32] {
        &self.values[self.shape.place(columns.start, row)..][..columns.len()]
    }

    /// The stored values of the 3×3 pixels around one that is stored, rows from the top; 0 beyond the map.
    pub(super) fn around(&self, column: usize, row: usize) -> [[f32; 3]; 3] {
        let first = self.shape.place(column, row) - self.stride() - 1;
        std::array::from_fn(|below| {
            let three = self.values[first + below * self.stride()..].first_chunk();
            three.copied().unwrap_or_default()
        })
    }

    /// Bytes held.
    pub(super) fn bytes(&self) -> usize {
        self.values.len() * size_of::<f32>()
    }
}

/// Which of a view's pixels a filter of the options leaves out.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Filters {
    /// Mask and depth range.
    Depth,
    /// Those and confidence.
    All,
}

/// A view's depth map after the filters.
pub(super) fn prepare(
    maps: &dyn DepthMaps,
    index: usize,
    options: &FuseOptions,
    filters: Filters,
) -> Result<Samples> {
    let view = maps.view(index);
    let filter = PixelFilter::read(maps, index, options)?;
    let unit = Unit::of(options);
    let size = (view.camera.width(), view.camera.height());
    let (width, height) = (size.0 as usize, size.1 as usize);
    let pixels = (width * height) as u64;
    let mut counts = FuseCounts {
        pixels,
        empty: pixels,
        ..FuseCounts::default()
    };
    let mut extents = vec![0..0; height];
    // What has depth, run by run: where the first and the last columns are shows at the end.
    let (mut runs, mut found) = (Vec::new(), Vec::new());
    maps.depth_runs(index, &mut |row, first, from| {
        counts.empty -= from.len() as u64;
        widen(&mut extents[row], first, from.len());
        runs.push((row, first, from.len()));
        if found.capacity() == 0 {
            found.reserve_exact(width * height); // by now the file is known to be as long
        }
        if filter.passes_all() {
            counts.empty += convert(unit, from, &mut found);
            return;
        }
        let pixels = row * width + first..;
        let kept = pixels.zip(from);
        found.extend(kept.map(|(pixel, &depth)| filter.keep(pixel, unit, depth, &mut counts)));
    })?;
    let known = match filters {
        Filters::All => confidence(maps, index)?,
        Filters::Depth => None,
    };
    let known = known.as_ref().map(|known| {
        let known = known.values();
        let mut rest = found.as_slice();
        let with_depth = runs.iter().flat_map(|&(row, first, len)| {
            let (run, more) = rest.split_at(len);
            rest = more;
            with_depth(run, &known[row * width + first..][..len])
        });
        (known, threshold(with_depth, options))
    });
    let shape = Shape::of(extents);
    let mut values = shape.zeros();
    let mut rest = found.as_slice();
    for (row, first, len) in runs {
        let (run, more) = rest.split_at(len);
        let to = &mut values[shape.place(first, row)..][..len];
        match known {
            Some((known, least)) => {
                let known = &known[row * width + first..][..len];
                counts.unconfident += put_confident((run, known), least, to);
            }
            None => to.copy_from_slice(run),
        }
        rest = more;
    }
    let mut samples = Samples::of_shape(size, unit, Arc::new(shape), Arc::new(values));
    samples.left_out = counts;
    Ok(samples)
}

/// Adds the stored values of depths to `found`; how many have none.
fn convert(unit: Unit, from: &[f32], found: &mut Vec<f32>) -> u64 {
    let start = found.len();
    found.extend(from.iter().map(|&depth| unit.convert(depth)));
    let empty = found[start..]
        .iter()
        .map(|&stored| u32::from(stored <= 0.0));
    u64::from(empty.sum::<u32>())
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

/// A view's confidence, checked.
pub(super) fn confidence(maps: &dyn DepthMaps, index: usize) -> Result<Option<Raster<f32>>> {
    let confidence = maps.confidence(index)?;
    if let Some(confidence) = &confidence {
        check_size(maps.view(index), confidence.size(), "confidence")?;
    }
    Ok(confidence)
}

/// A view's mask and depth range.
pub(super) struct PixelFilter {
    mask: Option<Mask>,
    near: f64,
    far: f64,
}

impl PixelFilter {
    pub(super) fn read(maps: &dyn DepthMaps, index: usize, options: &FuseOptions) -> Result<Self> {
        let mask = maps.mask(index)?;
        if let Some(mask) = &mask {
            check_size(maps.view(index), mask.size(), "mask")?;
        }
        Ok(Self::new(maps.view(index), options, mask))
    }

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

    /// Whether the mask wants a pixel.
    pub(super) fn wants(&self, pixel: usize) -> bool {
        self.mask.as_ref().is_none_or(|mask| mask.values()[pixel])
    }

    /// Whether a depth lies in the range.
    pub(super) fn reaches(&self, depth: f32) -> bool {
        (self.near..=self.far).contains(&f64::from(depth))
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
        } else if !self.wants(pixel) {
            &mut counts.masked
        } else if !self.reaches(depth) {
            &mut counts.out_of_range
        } else {
            return stored;
        };
        *reason += 1;
        0.0
    }
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
        let none = [0.0; 6];
        assert_eq!(
            samples.values(),
            [none, [0.0, 0.0, 3.0, 4.0, 0.0, 0.0], none].as_flattened()
        );
        assert_eq!(samples.part(0, 0..2), [3.0, 4.0]);
        let [above, own, below] = samples.around(0, 0);
        assert_eq!((above, own, below), ([0.0; 3], [0.0, 3.0, 4.0], [0.0; 3]));
    }

    #[test]
    fn columns_beyond_all_depths_are_not_stored() {
        let stored: Vec<f32> = (0..20)
            .map(|at| f32::from(u8::from(at % 5 == 3)) * at as f32)
            .collect();
        let whole = Samples::new((5, 4), Unit::Depth, &stored);
        let narrow = whole.within(vec![0..0, 3..4, 2..4, 3..4]);
        assert_eq!(narrow.columns(), 2..4);
        assert_eq!(narrow.filled(), Some((2..4, 1..4)));
        assert_eq!(narrow.values().len(), 6 * 6);
        for (row, column) in (0..4).flat_map(|row| (0..5).map(move |column| (row, column))) {
            assert_eq!(narrow.get(column, row), whole.get(column, row));
            if (2..4).contains(&column) {
                assert_eq!(narrow.around(column, row), whole.around(column, row));
                let (pixel, place) = narrow.grid().numbers(column as u32, row as u32);
                assert_eq!(pixel as usize, row * 5 + column);
                assert_eq!(narrow.values()[place as usize], whole.get(column, row));
            }
        }
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
        let extents: Vec<_> = (0..3).map(|row| samples.extent(row)).collect();
        assert_eq!(extents, [0..0, 64..128, 0..150]);
        for (row, depths) in depths.chunks(150).enumerate() {
            assert_eq!(samples.part(row, 0..150), depths);
        }
        assert_eq!(samples.left_out().empty, 450 - 5 - 137);
    }

    #[test]
    fn inverse_depths_that_do_not_fit_are_none() {
        assert_eq!(Unit::Inverse.convert(4.0), 0.25);
        assert_eq!(Unit::Inverse.convert(0.0), 0.0);
        assert_eq!(Unit::Inverse.convert(1e-45), 0.0);
    }
}
