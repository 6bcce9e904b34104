//! Points into a PLY as they come.

use crate::error::Result;
use crate::fuse::{Columns, FuseCounts, PointSink, Points};
use mvs_datasets::format::ply::stream::{Scalar, StreamWriter};
use std::io::{Seek, Write};
use std::path::PathBuf;

/// Writes points as rows of a PLY.
pub(super) struct PlySink<W> {
    writer: StreamWriter<W>,
    columns: Columns,
    /// For errors.
    path: PathBuf,
}

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
        })
    }

    pub(super) fn count(&self) -> u64 {
        self.writer.count()
    }

    pub(super) fn finish(self) -> std::io::Result<u64> {
        self.writer.finish()
    }

    fn rows(&self, points: &Points) -> Vec<u8> {
        let mut rows = Vec::with_capacity(points.len() * 56);
        for (at, position) in points.positions.iter().enumerate() {
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
        rows
    }
}

impl<W: Write + Seek> PointSink for PlySink<W> {
    fn take(&mut self, points: Points, _counts: &FuseCounts) -> Result<()> {
        let written = self.writer.write(&self.rows(&points));
        Ok(written.map_err(mvs_datasets::Error::io(&self.path, "write"))?)
    }
}
