//! Points as rows of bytes, as a binary file has them.

use super::finish::{BlockPoints, entries};
use super::points::{Columns, Points, ROW_KINDS};
use std::ops::Range;

/// Bytes of a row of these columns.
pub(super) const fn row_bytes(columns: Columns) -> usize {
    let numbers = if columns.has(Columns::MANY) { 4 } else { 1 };
    let mut bytes = 12 + numbers;
    if columns.has(Columns::DOUBLES) {
        bytes += 12;
    }
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
        bytes += numbers + 4;
    }
    bytes
}

/// Points one by one.
pub(super) trait Entries {
    fn position(&self, i: usize) -> [f64; 3];
    fn normal(&self, i: usize) -> [f32; 3];
    fn color(&self, i: usize) -> [u8; 3];
    fn view_count(&self, i: usize) -> u32;
    fn confidence(&self, i: usize) -> f32;
    /// Violations and scale.
    fn extras(&self, i: usize) -> (u32, f32);
    /// The reference's, row-major.
    fn pixel(&self, i: usize) -> u32;
}

/// Points of some rows of a map, as rows of bytes; the memory is used again.
#[derive(Default)]
pub(super) struct BandBytes {
    bytes: Vec<u8>,
    /// Bytes from one row of the map to the next.
    stride: usize,
    /// Bytes that each row of the map has.
    used: Vec<usize>,
}

/// What is written to in turn lies so many bytes, and some pages, apart: sixteen rows have all of a cache's
/// lines then, where whole pages apart they would share a few.
const APART: usize = 256;
const PAGE: usize = 4096;

impl BandBytes {
    /// Forgets all points, and makes room for up to `most` in each of so many rows of a map.
    pub(super) fn begin(&mut self, rows: usize, most: usize, columns: Columns) {
        self.stride = (most * row_bytes(columns)).next_multiple_of(PAGE) + APART;
        self.used.clear();
        self.used.resize(rows, 0);
        let wanted = self.stride * rows;
        if self.bytes.len() < wanted {
            self.bytes = Vec::new(); // before there is another
            // Where zeros come from the system, pages that are not touched are not made.
            self.bytes = vec![0; wanted.next_power_of_two()];
        }
    }

    /// By row of the map.
    pub(super) fn rows(&self) -> impl Iterator<Item = &[u8]> {
        let starts = (0..).step_by(self.stride.max(1));
        let rows = starts.zip(&self.used);
        rows.map(|(start, &used)| &self.bytes[start..start + used])
    }

    /// Room for some more points; there is, for as many as were foreseen.
    #[inline(always)]
    fn more<const BYTES: usize>(&mut self, row: usize, points: usize) -> &mut [[u8; BYTES]] {
        let used = &mut self.used[row];
        let start = row * self.stride + *used;
        *used += points * BYTES;
        debug_assert!(*used <= self.stride, "more points than were foreseen");
        self.bytes[start..][..points * BYTES].as_chunks_mut().0
    }
}

/// Adds the points whose bits are `kept` to the rows of the map in which they lie, as
/// [`PointSink::take_rows`](super::PointSink::take_rows) has them.
pub(super) fn add_to_rows(
    columns: Columns,
    points: &BlockPoints<'_>,
    kept: u64,
    rows: &mut BandBytes,
) {
    PUT[usize::from(columns.row_bits())](points, kept, rows);
}

type Put = fn(&BlockPoints<'_>, u64, &mut BandBytes);

/// By the bits of the columns, so that each has its own code, in which all places are known.
const PUT: [Put; ROW_KINDS] = {
    macro_rules! puts {
        ($($bits:literal)*) => { [$(put::<$bits, { bytes($bits) }>),*] };
    }
    puts!(
        0 1 2 3 4 5 6 7 8 9 10 11 12 13 14 15
        16 17 18 19 20 21 22 23 24 25 26 27 28 29 30 31
        32 33 34 35 36 37 38 39 40 41 42 43 44 45 46 47
        48 49 50 51 52 53 54 55 56 57 58 59 60 61 62 63
    )
};

const fn bytes(columns: u8) -> usize {
    row_bytes(Columns::of_row_bits(columns))
}

fn put<const COLUMNS: u8, const BYTES: usize>(
    points: &BlockPoints<'_>,
    kept: u64,
    rows: &mut BandBytes,
) {
    let columns = const { Columns::of_row_bits(COLUMNS) };
    const { assert!(BYTES == bytes(COLUMNS)) };
    let mut left = kept;
    while left != 0 {
        let some = points.room.of_one_row(left);
        left &= !some;
        let row = points.row(some.trailing_zeros() as usize);
        let places = rows.more::<BYTES>(row, some.count_ones() as usize);
        for (i, place) in entries(some).zip(places) {
            put_row(columns, points, i, place);
        }
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

    fn pixel(&self, i: usize) -> u32 {
        self.pixels[i]
    }
}

impl Points {
    /// Puts rows of these columns of some points in the place of `rows`, as [`PointSink::take_rows`] has them.
    ///
    /// [`PointSink::take_rows`]: super::PointSink::take_rows
    pub fn to_rows(&self, columns: Columns, some: Range<usize>, rows: &mut Vec<u8>) {
        let bytes = row_bytes(columns);
        rows.resize(some.len() * bytes, 0);
        for (i, row) in some.zip(rows.chunks_exact_mut(bytes)) {
            put_row(columns, self, i, row);
        }
    }
}

/// Puts a point into a row of bytes.
#[inline(always)]
#[allow(
    clippy::cast_possible_truncation,
    reason = "asked for where f32 is exact enough"
)]
fn put_row(columns: Columns, points: &impl Entries, i: usize, mut row: &mut [u8]) {
    let row = &mut row;
    for value in points.position(i) {
        if columns.has(Columns::DOUBLES) {
            field(row, value.to_le_bytes());
        } else {
            field(row, (value as f32).to_le_bytes());
        }
    }
    if columns.has(Columns::NORMALS) {
        for value in points.normal(i) {
            field(row, value.to_le_bytes());
        }
    }
    if columns.has(Columns::COLORS) {
        field(row, points.color(i));
    }
    number(columns, row, points.view_count(i));
    if columns.has(Columns::CONFIDENCES) {
        field(row, points.confidence(i).to_le_bytes());
    }
    if columns.has(Columns::EXTRAS) {
        let (violations, scale) = points.extras(i);
        number(columns, row, violations);
        field(row, scale.to_le_bytes());
    }
}

/// Puts a number of views where `row` begins, in a type that all readers know.
#[inline(always)]
#[allow(
    clippy::cast_possible_truncation,
    clippy::cast_precision_loss,
    reason = "f32 is exact below 2^24, and u8 asked for where there are no more views"
)]
fn number(columns: Columns, row: &mut &mut [u8], views: u32) {
    if columns.has(Columns::MANY) {
        field(row, (views as f32).to_le_bytes());
    } else {
        field(row, [views as u8]);
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
