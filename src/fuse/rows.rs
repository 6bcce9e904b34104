//! Points as rows of bytes, as a binary file has them.

use super::points::{Columns, Points};
use std::ops::Range;

/// Bytes of a row of these columns.
pub(super) const fn row_bytes(columns: Columns) -> usize {
    let mut bytes = 24 + 4;
    if columns.has(Columns::NORMALS) {
        bytes += 12;
    }
    if columns.has(Columns::COLORS) {
        bytes += 3;
    }
    if columns.has(Columns::CONFIDENCES) {
        bytes += 4;
    }
    if columns.has(Columns::EXTRAS) {
        bytes += 8;
    }
    bytes
}

/// Columns of some points; those that are left out mean nothing.
pub(super) struct Described<'a> {
    pub(super) positions: [&'a [f64]; 3],
    pub(super) normals: [&'a [f32]; 3],
    pub(super) colors: &'a [[u8; 3]],
    pub(super) view_counts: &'a [u32],
    pub(super) confidences: &'a [f32],
    pub(super) violations: &'a [u32],
    pub(super) scales: &'a [f32],
}

/// Rows of bytes, whose memory is used again.
#[derive(Default)]
pub(super) struct RowBytes {
    bytes: Vec<u8>,
    used: usize,
}

impl RowBytes {
    /// All rows.
    pub(super) fn bytes(&self) -> &[u8] {
        &self.bytes[..self.used]
    }

    pub(super) fn clear(&mut self) {
        self.used = 0;
    }

    /// Adds points as [`PointSink::take_rows`](super::PointSink::take_rows) has them.
    #[inline]
    pub(super) fn add(&mut self, columns: Columns, points: &Described<'_>) {
        let (start, count) = (self.used, points.view_counts.len());
        self.used += count * row_bytes(columns);
        if self.bytes.len() < self.used {
            self.bytes.resize(self.used.next_power_of_two(), 0);
        }
        let to = &mut self.bytes[start..self.used];
        PUT[usize::from(columns.row_bits())](points, to);
    }
}

type Put = fn(&Described<'_>, &mut [u8]);

/// By the bits of the columns, so that each has its own code, in which all places are known.
const PUT: [Put; 16] = [
    put::<0>, put::<1>, put::<2>, put::<3>, put::<4>, put::<5>, put::<6>, put::<7>, put::<8>,
    put::<9>, put::<10>, put::<11>, put::<12>, put::<13>, put::<14>, put::<15>,
];

fn put<const COLUMNS: u8>(points: &Described<'_>, to: &mut [u8]) {
    let columns = const { Columns::of_row_bits(COLUMNS) };
    let count = points.view_counts.len();
    let some = |wanted: Columns| if columns.has(wanted) { count } else { 0 };
    // Their lengths are known here, so no place is checked one by one.
    let points = Described {
        positions: points.positions.map(|axis| &axis[..count]),
        normals: points.normals.map(|axis| &axis[..some(Columns::NORMALS)]),
        colors: &points.colors[..some(Columns::COLORS)],
        view_counts: &points.view_counts[..count],
        confidences: &points.confidences[..some(Columns::CONFIDENCES)],
        violations: &points.violations[..some(Columns::EXTRAS)],
        scales: &points.scales[..some(Columns::EXTRAS)],
    };
    put_rows(columns, &points, 0..count, to);
}

/// Points one by one.
trait Entries {
    fn position(&self, i: usize) -> [f64; 3];
    fn normal(&self, i: usize) -> [f32; 3];
    fn color(&self, i: usize) -> [u8; 3];
    fn view_count(&self, i: usize) -> u32;
    fn confidence(&self, i: usize) -> f32;
    /// Violations and scale.
    fn extras(&self, i: usize) -> (u32, f32);
}

impl Entries for Described<'_> {
    #[inline(always)]
    fn position(&self, i: usize) -> [f64; 3] {
        self.positions.map(|axis| axis[i])
    }

    #[inline(always)]
    fn normal(&self, i: usize) -> [f32; 3] {
        self.normals.map(|axis| axis[i])
    }

    #[inline(always)]
    fn color(&self, i: usize) -> [u8; 3] {
        self.colors[i]
    }

    #[inline(always)]
    fn view_count(&self, i: usize) -> u32 {
        self.view_counts[i]
    }

    #[inline(always)]
    fn confidence(&self, i: usize) -> f32 {
        self.confidences[i]
    }

    #[inline(always)]
    fn extras(&self, i: usize) -> (u32, f32) {
        (self.violations[i], self.scales[i])
    }
}

impl Entries for Points {
    fn position(&self, i: usize) -> [f64; 3] {
        self.positions[i].to_array()
    }

    fn normal(&self, i: usize) -> [f32; 3] {
        self.normals[i].to_array()
    }

    fn color(&self, i: usize) -> [u8; 3] {
        self.colors[i]
    }

    fn view_count(&self, i: usize) -> u32 {
        self.view_counts[i]
    }

    fn confidence(&self, i: usize) -> f32 {
        self.confidences[i]
    }

    fn extras(&self, i: usize) -> (u32, f32) {
        (self.violations[i], self.scales[i])
    }
}

impl Points {
    /// Puts rows of these columns of some points in the place of `rows`, as [`PointSink::take_rows`] has them.
    ///
    /// [`PointSink::take_rows`]: super::PointSink::take_rows
    pub fn to_rows(&self, columns: Columns, some: Range<usize>, rows: &mut Vec<u8>) {
        rows.resize(some.len() * row_bytes(columns), 0);
        put_rows(columns, self, some, rows);
    }
}

/// Puts some points into rows of bytes.
#[inline(always)]
fn put_rows(columns: Columns, points: &impl Entries, some: Range<usize>, to: &mut [u8]) {
    for (i, mut row) in some.zip(to.chunks_exact_mut(row_bytes(columns))) {
        let row = &mut row;
        for value in points.position(i) {
            field(row, value.to_le_bytes());
        }
        if columns.has(Columns::NORMALS) {
            for value in points.normal(i) {
                field(row, value.to_le_bytes());
            }
        }
        if columns.has(Columns::COLORS) {
            field(row, points.color(i));
        }
        field(row, points.view_count(i).to_le_bytes());
        if columns.has(Columns::CONFIDENCES) {
            field(row, points.confidence(i).to_le_bytes());
        }
        if columns.has(Columns::EXTRAS) {
            let (violations, scale) = points.extras(i);
            field(row, violations.to_le_bytes());
            field(row, scale.to_le_bytes());
        }
    }
}

/// Puts `bytes` where `row` begins, which then begins after them.
#[inline(always)]
fn field<const N: usize>(row: &mut &mut [u8], bytes: [u8; N]) {
    if let Some((to, rest)) = std::mem::take(row).split_first_chunk_mut() {
        *to = bytes;
        *row = rest;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fuse::testing::as_bytes;

    #[test]
    fn every_choice_of_columns_has_its_rows() {
        let axes = [[1.5, -2.5, 3.5], [4.0, 5.0, 6.0], [7.0, 8.0, 9.0]];
        let normals = axes.map(|axis| axis.map(|value| value as f32 + 20.0));
        let points = Described {
            positions: axes.each_ref().map(|axis| axis.as_slice()),
            normals: normals.each_ref().map(|axis| axis.as_slice()),
            colors: &[[1, 2, 3], [4, 5, 6], [7, 8, 9]],
            view_counts: &[70_000, 2, 3],
            confidences: &[0.25, f32::NAN, 0.75],
            violations: &[9, 8, 7],
            scales: &[0.5, 1.5, 2.5],
        };
        let mut rows = RowBytes::default();
        for bits in 0..16 {
            let columns = Columns::of_row_bits(bits);
            let mut columnwise = Points::default();
            columnwise.add(columns, &points);
            let expected = as_bytes(&columnwise, columns);
            assert_eq!(expected.len(), 3 * row_bytes(columns));
            let mut of_columns = vec![7; 5];
            columnwise.to_rows(columns, 0..3, &mut of_columns);
            assert_eq!(of_columns, expected);
            columnwise.to_rows(columns, 1..2, &mut of_columns);
            let row = row_bytes(columns);
            assert_eq!(of_columns, expected[row..2 * row]);
            rows.clear();
            for _ in 0..50 {
                // What is read by the views that see points is none of a row's.
                rows.add(columns.and(Columns::VISIBLE), &points);
            }
            assert!(rows.bytes() == expected.repeat(50), "{bits}");
        }
        rows.clear();
        assert!(rows.bytes().is_empty());
    }
}
