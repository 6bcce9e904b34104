//! A 4×4 matrix as text, as in `<Scene>_trans.txt`.

use crate::error::FormatError;
use glam::DMat4;
use std::io::Write;

/// Reads sixteen numbers, row by row. Blank lines and lines starting with `#` are skipped.
pub fn read(_text: &str) -> Result<DMat4, FormatError> {
    todo!()
}

/// Writes four lines of four numbers with the shortest digits that read back to the same number.
pub fn write(_out: &mut impl Write, _matrix: &DMat4) -> std::io::Result<()> {
    todo!()
}
