//! Binary PLY clouds whose number of points is known only at the end.

use std::io::{Error, Result, Seek, SeekFrom, Write};

/// A scalar type of a vertex property.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Scalar {
    /// 64-bit.
    Double,
    /// 32-bit.
    Float,
    /// Unsigned 8-bit.
    Uchar,
}

impl Scalar {
    fn name(self) -> &'static str {
        match self {
            Self::Double => "double",
            Self::Float => "float",
            Self::Uchar => "uchar",
        }
    }

    /// Bytes of one value.
    pub fn size(self) -> usize {
        match self {
            Self::Double => 8,
            Self::Float => 4,
            Self::Uchar => 1,
        }
    }
}

/// Writes little-endian rows as they come. The header's count is filled in by
/// [`StreamWriter::complete`]; until then it says 0.
#[derive(Debug)]
pub struct StreamWriter<W> {
    out: W,
    count_at: u64,
    row: usize,
    count: u64,
}

/// Room for the count: a comment of spaces shrinks as the count grows.
const ROOM: usize = 20;

impl<W: Write + Seek> StreamWriter<W> {
    /// Writes the header: `comments` (without line breaks) and the vertex's properties in order.
    ///
    /// # Errors
    /// What writing to `out` and asking for its place bring.
    pub fn new(mut out: W, properties: &[(&str, Scalar)], comments: &[String]) -> Result<Self> {
        write!(out, "ply\nformat binary_little_endian 1.0\n")?;
        for comment in comments {
            writeln!(out, "comment {}", comment.replace(['\n', '\r'], " "))?;
        }
        let count_at = out.stream_position()?;
        out.write_all(count_lines(0).as_bytes())?;
        for (name, scalar) in properties {
            writeln!(out, "property {} {name}", scalar.name())?;
        }
        writeln!(out, "end_header")?;
        let row = properties.iter().map(|(_, scalar)| scalar.size()).sum();
        Ok(Self {
            out,
            count_at,
            row,
            count: 0,
        })
    }

    /// Writes whole rows, the properties' bytes in order without gaps.
    ///
    /// # Errors
    /// Bytes that are no whole number of rows, and what the file brings.
    pub fn write(&mut self, rows: &[u8]) -> Result<()> {
        if self.row == 0 || !rows.len().is_multiple_of(self.row) {
            let problem = format!("expected rows of {} bytes, found {}", self.row, rows.len());
            return Err(Error::other(problem));
        }
        self.count += (rows.len() / self.row) as u64;
        self.out.write_all(rows)
    }

    /// Points written so far.
    pub fn count(&self) -> u64 {
        self.count
    }

    /// Fills in the count and writes what is left.
    ///
    /// # Errors
    /// What seeking in the file and writing to it bring.
    pub fn complete(&mut self) -> Result<u64> {
        self.out.seek(SeekFrom::Start(self.count_at))?;
        self.out.write_all(count_lines(self.count).as_bytes())?;
        self.out.seek(SeekFrom::End(0))?;
        self.out.flush()?;
        Ok(self.count)
    }
}

/// The line with the count, and a comment before it that makes up for its length.
fn count_lines(count: u64) -> String {
    let digits = count.to_string();
    let room = "-".repeat(ROOM + 1 - digits.len().min(ROOM));
    format!("comment {room}\nelement vertex {digits}\n")
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;
    use std::io::Cursor;

    #[test]
    fn streamed_rows_read_back_with_the_final_count() {
        let properties = [
            ("x", Scalar::Float),
            ("y", Scalar::Float),
            ("z", Scalar::Double),
        ];
        let mut bytes = Vec::new();
        let comments = vec!["two\nlines".to_owned()];
        let mut writer =
            StreamWriter::new(Cursor::new(&mut bytes), &properties, &comments).unwrap();
        let row = |x: f32| {
            let mut row = x.to_le_bytes().to_vec();
            row.extend(2f32.to_le_bytes());
            row.extend(3f64.to_le_bytes());
            row
        };
        for x in 0..12 {
            writer.write(&row(x as f32)).unwrap();
        }
        assert!(writer.write(&[0; 15]).is_err());
        assert_eq!(writer.complete().unwrap(), 12);
        let cloud = super::super::read_cloud(&bytes).unwrap();
        assert_eq!(cloud.len(), 12);
        assert_eq!(cloud.positions()[11], DVec3::new(11.0, 2.0, 3.0));
        assert!(String::from_utf8_lossy(&bytes).contains("comment two lines\n"));
    }

    #[test]
    fn the_header_keeps_its_length_for_any_count() {
        let length = count_lines(0).len();
        for count in [9, 10, 123_456, u64::MAX] {
            assert_eq!(count_lines(count).len(), length);
        }
    }
}
