//! Points as rows of bytes, as a binary file has them.

use super::points::Columns;

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
    let [x, y, z] = points.positions.map(|axis| &axis[..count]);
    let normals = points.normals.map(|axis| &axis[..some(Columns::NORMALS)]);
    let colors = &points.colors[..some(Columns::COLORS)];
    let confidences = &points.confidences[..some(Columns::CONFIDENCES)];
    let violations = &points.violations[..some(Columns::EXTRAS)];
    let scales = &points.scales[..some(Columns::EXTRAS)];
    let rows = to.chunks_exact_mut(const { row_bytes(Columns::of_row_bits(COLUMNS)) });
    for (i, mut row) in rows.take(count).enumerate() {
        let row = &mut row;
        for value in [x[i], y[i], z[i]] {
            field(row, value.to_le_bytes());
        }
        if columns.has(Columns::NORMALS) {
            for axis in normals {
                field(row, axis[i].to_le_bytes());
            }
        }
        if columns.has(Columns::COLORS) {
            field(row, colors[i]);
        }
        field(row, points.view_counts[i].to_le_bytes());
        if columns.has(Columns::CONFIDENCES) {
            field(row, confidences[i].to_le_bytes());
        }
        if columns.has(Columns::EXTRAS) {
            field(row, violations[i].to_le_bytes());
            field(row, scales[i].to_le_bytes());
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
            let mut expected = Vec::new();
            for i in 0..3 {
                expected.extend(axes.iter().flat_map(|axis| axis[i].to_le_bytes()));
                if columns.has(Columns::NORMALS) {
                    expected.extend(normals.iter().flat_map(|axis| axis[i].to_le_bytes()));
                }
                if columns.has(Columns::COLORS) {
                    expected.extend(points.colors[i]);
                }
                expected.extend(points.view_counts[i].to_le_bytes());
                if columns.has(Columns::CONFIDENCES) {
                    expected.extend(points.confidences[i].to_le_bytes());
                }
                if columns.has(Columns::EXTRAS) {
                    expected.extend(points.violations[i].to_le_bytes());
                    expected.extend(points.scales[i].to_le_bytes());
                }
            }
            assert_eq!(expected.len(), 3 * row_bytes(columns));
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
