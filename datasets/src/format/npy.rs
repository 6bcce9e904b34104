//! NumPy's `.npy`, version 1.0: tables of little-endian f32 in row order.

use crate::error::FormatError;
use std::io::Write;

const MAGIC: &[u8] = b"\x93NUMPY\x01\x00";

/// Writes a table of `rows` × `columns` values, row-major. Their count must be the product.
///
/// # Errors
/// Another count of values ([`std::io::ErrorKind::InvalidInput`]), and what writing to `out` brings.
pub fn write_f32(
    out: &mut impl Write,
    (rows, columns): (usize, usize),
    values: &[f32],
) -> std::io::Result<()> {
    if rows * columns != values.len() {
        let problem = format!("{rows} x {columns} values promised, {} given", values.len());
        return Err(std::io::Error::new(
            std::io::ErrorKind::InvalidInput,
            problem,
        ));
    }
    let mut header =
        format!("{{'descr': '<f4', 'fortran_order': False, 'shape': ({rows}, {columns}), }}");
    // Magic, length and header together fill a multiple of 64 bytes, as the format asks for.
    let unpadded = MAGIC.len() + 2 + header.len() + 1;
    header.push_str(&" ".repeat(unpadded.next_multiple_of(64) - unpadded));
    header.push('\n');
    let length = u16::try_from(header.len()).map_err(std::io::Error::other)?;
    out.write_all(MAGIC)?;
    out.write_all(&length.to_le_bytes())?;
    out.write_all(header.as_bytes())?;
    for value in values {
        out.write_all(&value.to_le_bytes())?;
    }
    Ok(())
}

/// Reads what [`write_f32`] writes: ((rows, columns), values).
///
/// # Errors
/// Another version, a header that is cut short or no text, numbers that are not little-endian f32 in row order, a
/// shape that is not two numbers, and another length than these say.
pub fn read_f32(bytes: &[u8]) -> Result<((usize, usize), Vec<f32>), FormatError> {
    let bad = |problem: &str| FormatError::new("header", problem);
    let rest = bytes
        .strip_prefix(MAGIC)
        .ok_or_else(|| bad("expected a .npy file of version 1.0"))?;
    let (length, rest) = rest
        .split_first_chunk::<2>()
        .ok_or_else(|| bad("expected a header, found the end of the file"))?;
    let length = usize::from(u16::from_le_bytes(*length));
    let (header, data) = rest
        .split_at_checked(length)
        .ok_or_else(|| bad("expected a whole header, found the end of the file"))?;
    let header = std::str::from_utf8(header).map_err(|_| bad("expected text"))?;
    if !header.contains("'<f4'") || !header.contains("'fortran_order': False") {
        return Err(bad("expected little-endian 4-byte floats in row order"));
    }
    let shape = shape(header).ok_or_else(|| bad("expected a shape of two numbers"))?;
    let expected = shape.0.checked_mul(shape.1).and_then(|n| n.checked_mul(4));
    if expected != Some(data.len()) {
        let problem = format!("expected {shape:?} values, found {} bytes", data.len());
        return Err(FormatError::new("data", problem));
    }
    let (chunks, _) = data.as_chunks::<4>();
    Ok((
        shape,
        chunks.iter().map(|c| f32::from_le_bytes(*c)).collect(),
    ))
}

/// The two numbers after `'shape':`.
fn shape(header: &str) -> Option<(usize, usize)> {
    let (_, after) = header.split_once("'shape':")?;
    let (inside, _) = after.trim_start().strip_prefix('(')?.split_once(')')?;
    let (rows, columns) = inside.split_once(',')?;
    Some((rows.trim().parse().ok()?, columns.trim().parse().ok()?))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tables_come_back_and_headers_are_aligned() {
        let values = [1.5, -2.0, 0.0, 3.25, f32::MIN_POSITIVE, 7.0];
        let mut bytes = Vec::new();
        write_f32(&mut bytes, (2, 3), &values).unwrap();
        assert_eq!(bytes.len(), 128 + 24);
        assert_eq!(bytes[127], b'\n');
        assert_eq!(read_f32(&bytes).unwrap(), ((2, 3), values.to_vec()));
    }

    #[test]
    fn wrong_counts_and_broken_files_are_refused() {
        assert!(write_f32(&mut Vec::new(), (2, 2), &[0.0; 3]).is_err());
        let mut bytes = Vec::new();
        write_f32(&mut bytes, (2, 2), &[0.0; 4]).unwrap();
        for length in [0, 5, 9, 40, bytes.len() - 1] {
            assert!(read_f32(&bytes[..length]).is_err(), "{length}");
        }
        let huge =
            String::from_utf8_lossy(&bytes[10..128]).replace("(2, 2)", "(9999999999, 9999999999)");
        let mut promise = MAGIC.to_vec();
        promise.extend((huge.len() as u16).to_le_bytes());
        promise.extend(huge.as_bytes());
        assert!(read_f32(&promise).unwrap_err().to_string().contains("data"));
    }
}
