//! Open3D's `SelectionPolygonVolume` as JSON.

use crate::error::FormatError;
use crate::scene::CropVolume;
use std::io::Write;

/// Reads a polygon volume. Where Open3D turns a bad file into an empty crop, this is an error.
pub fn read(_json: &str) -> Result<CropVolume, FormatError> {
    todo!()
}

/// Writes a polygon volume that Open3D reads.
pub fn write(_out: &mut impl Write, _volume: &CropVolume) -> std::io::Result<()> {
    todo!()
}
