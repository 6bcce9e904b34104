//! MVSNet / BlendedMVS `cam.txt`: extrinsic, intrinsic and depth range of one view.

use crate::error::FormatError;
use glam::{DMat3, DMat4};
use std::io::Write;

/// What a `cam.txt` says, with no convention applied: the reader does not know the image size nor
/// where pixel centres are (see [`crate::layout::mvsnet`]).
#[derive(Debug, Clone, PartialEq)]
pub struct CamFile {
    /// `cam_from_world`, OpenCV axes.
    pub extrinsic: DMat4,
    /// K in pixels.
    pub intrinsic: DMat3,
    /// The numbers of the last line, 2 to 4 of them: depth_min, interval[, count[, depth_max]].
    /// Empty when the file ends after the intrinsics.
    pub tail: Vec<f64>,
}

impl CamFile {
    /// (depth_min, depth_max) in world units: the fourth number, or min + interval · count, or, with
    /// two numbers, min + interval · 192 as MVSNet does. `None` without a tail.
    pub fn depth_range(&self) -> Option<(f64, f64)> {
        todo!()
    }
}

/// Reads a `cam.txt`.
pub fn read(_text: &str) -> Result<CamFile, FormatError> {
    todo!()
}

/// Writes a `cam.txt` in the form that the strictest public loaders accept: four numbers on the
/// last line, no trailing space, shortest decimal digits that read back to the same number.
pub fn write(_out: &mut impl Write, _cam: &CamFile) -> std::io::Result<()> {
    todo!()
}
