//! Lines of a table as editors count them.

use mvs_datasets::FormatError;
use std::io::Read;

/// All bytes of a table.
pub(super) fn whole(mut source: impl Read) -> Result<Vec<u8>, FormatError> {
    let mut bytes = Vec::new();
    let unreadable = |error: std::io::Error| FormatError::new("table", error.to_string());
    source.read_to_end(&mut bytes).map_err(unreadable)?;
    Ok(bytes)
}

/// Says so where a header is of one cell that holds other separators than commas.
pub(super) fn check_separator(header: &csv::StringRecord) -> Result<(), FormatError> {
    let only = header.get(0).filter(|_| header.len() == 1);
    let found = only.and_then(|cell| cell.chars().find(|c| [';', '\t'].contains(c)));
    found.map_or(Ok(()), |separator| {
        let problem =
            format!("expected cells separated by commas, found {separator:?}: save it with commas");
        Err(FormatError::new("header", problem))
    })
}

/// A table's bytes. The reader's own count is one short where lines end in CR LF, and is of what lies before
/// a row: empty lines and comments.
pub(super) struct Lines<'a> {
    /// The whole table.
    pub(super) bytes: &'a [u8],
    /// What lines that are passed over begin with.
    pub(super) comment: Option<u8>,
}

impl Lines<'_> {
    /// The line, from 1, that the row begins at. It is counted from the table's start: to be asked for errors alone.
    pub(super) fn of(&self, row: &csv::StringRecord) -> usize {
        row.position().map_or(1, |position| self.at(position))
    }

    /// The line, from 1, that the row there begins at.
    fn at(&self, position: &csv::Position) -> usize {
        let start = usize::try_from(position.byte()).unwrap_or(usize::MAX);
        let mut start = start.min(self.bytes.len());
        while let Some(&byte) = self.bytes.get(start) {
            if Some(byte) == self.comment {
                let rest = self.bytes[start..].iter();
                start += rest.take_while(|&&byte| byte != b'\n').count();
            } else if matches!(byte, b'\r' | b'\n') {
                start += 1;
            } else {
                break;
            }
        }
        let before = self.bytes[..start].iter();
        1 + before.filter(|&&byte| byte == b'\n').count()
    }

    /// What is wrong with the table's form, and where.
    pub(super) fn broken(&self) -> impl Fn(csv::Error) -> FormatError {
        |error| {
            let line = error.position().map_or(1, |position| self.at(position));
            let problem = match error.kind() {
                csv::ErrorKind::UnequalLengths {
                    expected_len, len, ..
                } => {
                    format!("expected {expected_len} cells, found {len}")
                }
                csv::ErrorKind::Utf8 { .. } => {
                    "expected text in UTF-8, found other bytes".to_owned()
                }
                _ => error.to_string(),
            };
            FormatError::new(format!("line {line}"), problem)
        }
    }
}
