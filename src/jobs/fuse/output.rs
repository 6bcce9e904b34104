//! Points into a PLY as they come.

use crate::error::Result;
use crate::fuse::{Columns, FuseCounts, PointSink, Points};
use mvs_datasets::format::ply::stream::{Scalar, StreamWriter};
use std::io::{Seek, Write};
use std::ops::Range;
use std::path::PathBuf;

/// Writes points as rows of a PLY.
pub(super) struct PlySink<W> {
    writer: StreamWriter<W>,
    columns: Columns,
    /// For errors.
    path: PathBuf,
    /// Room for rows.
    rows: Vec<u8>,
}

/// How many rows are written at a time.
const ROWS: usize = 4096;

/// The vertex's properties.
fn properties(columns: Columns) -> Vec<(&'static str, Scalar)> {
    // Doubles, because scenes may lie at large offsets.
    let mut all = vec![
        ("x", Scalar::Double),
        ("y", Scalar::Double),
        ("z", Scalar::Double),
    ];
    if columns.has(Columns::NORMALS) {
        all.extend(["nx", "ny", "nz"].map(|name| (name, Scalar::Float)));
    }
    if columns.has(Columns::COLORS) {
        all.extend(["red", "green", "blue"].map(|name| (name, Scalar::Uchar)));
    }
    all.push(("views", Scalar::Uint));
    if columns.has(Columns::CONFIDENCES) {
        all.push(("confidence", Scalar::Float));
    }
    all.extend([("violations", Scalar::Uint), ("scale", Scalar::Float)]);
    all
}

impl<W: Write + Seek> PlySink<W> {
    pub(super) fn new(
        out: W,
        columns: Columns,
        comments: &[String],
        path: PathBuf,
    ) -> std::io::Result<Self> {
        Ok(Self {
            writer: StreamWriter::new(out, &properties(columns), comments)?,
            columns,
            path,
            rows: Vec::new(),
        })
    }

    pub(super) fn count(&self) -> u64 {
        self.writer.count()
    }

    pub(super) fn finish(self) -> std::io::Result<u64> {
        self.writer.finish()
    }

    /// The rows of the points in `range`.
    fn fill(&self, points: &Points, range: Range<usize>, rows: &mut Vec<u8>) {
        for at in range {
            let position = points.positions[at];
            rows.extend(
                position
                    .to_array()
                    .iter()
                    .flat_map(|value| value.to_le_bytes()),
            );
            if self.columns.has(Columns::NORMALS) {
                let normal = points.normals[at].to_array();
                rows.extend(normal.iter().flat_map(|value| value.to_le_bytes()));
            }
            if self.columns.has(Columns::COLORS) {
                rows.extend(points.colors[at]);
            }
            rows.extend(points.view_counts[at].to_le_bytes());
            if self.columns.has(Columns::CONFIDENCES) {
                rows.extend(points.confidences[at].to_le_bytes());
            }
            rows.extend(points.violations[at].to_le_bytes());
            rows.extend(points.scales[at].to_le_bytes());
        }
    }
}

impl<W: Write + Seek> PointSink for PlySink<W> {
    fn take(&mut self, points: &Points, _counts: &FuseCounts) -> Result<()> {
        let mut rows = std::mem::take(&mut self.rows);
        for start in (0..points.len()).step_by(ROWS) {
            rows.clear();
            self.fill(points, start..(start + ROWS).min(points.len()), &mut rows);
            let written = self.writer.write(&rows);
            written.map_err(mvs_datasets::Error::io(&self.path, "write"))?;
        }
        self.rows = rows;
        Ok(())
    }
}
