//! MVSNet / BlendedMVS `pair.txt`: source views per reference view.

use crate::error::FormatError;
use crate::scene::SourceScore;
use std::io::Write;

/// One reference view's id and its source views, best first.
#[derive(Debug, Clone, PartialEq)]
pub struct PairEntry {
    /// The reference view's id.
    pub id: u32,
    /// Its source views.
    pub sources: Vec<SourceScore>,
}

/// Reads a `pair.txt`.
pub fn read(_text: &str) -> Result<Vec<PairEntry>, FormatError> {
    todo!()
}

/// Writes a `pair.txt` without trailing blanks.
pub fn write(_out: &mut impl Write, _pairs: &[PairEntry]) -> std::io::Result<()> {
    todo!()
}
