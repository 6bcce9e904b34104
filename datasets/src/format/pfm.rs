//! PFM: float images, rows bottom-up. `Pf` has one channel, `PF` three.

use crate::error::FormatError;
use crate::scene::Raster;
use std::io::Write;

/// A PFM's content, rows from the top.
#[derive(Debug, Clone, PartialEq)]
pub enum Pfm {
    /// `Pf`.
    Gray(Raster<f32>),
    /// `PF`.
    Color(Raster<[f32; 3]>),
}

/// Reads a PFM of either kind and endianness. The scale's magnitude is not applied.
pub fn read(_bytes: &[u8]) -> Result<Pfm, FormatError> {
    todo!()
}

/// Reads a one-channel PFM.
pub fn read_gray(_bytes: &[u8]) -> Result<Raster<f32>, FormatError> {
    todo!()
}

/// Writes a little-endian `Pf` with scale -1.000000.
pub fn write_gray(_out: &mut impl Write, _raster: &Raster<f32>) -> std::io::Result<()> {
    todo!()
}

/// Writes a little-endian `PF` with scale -1.000000.
pub fn write_color(_out: &mut impl Write, _raster: &Raster<[f32; 3]>) -> std::io::Result<()> {
    todo!()
}
