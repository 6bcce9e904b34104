//! COLMAP's dense arrays: depth maps (`*.geometric.bin`, `*.photometric.bin`) and normal maps.
//!
//! ASCII `width&height&channels&`, then little-endian f32: row-major, one channel after the other.

use crate::error::FormatError;
use crate::scene::{NormalMap, Raster};
use std::io::Write;

/// The (width, height) that the header says.
///
/// # Errors
/// A start that is not a width, a height and a number of channels, with `&` after each.
pub fn read_size(bytes: &[u8]) -> Result<(u32, u32), FormatError> {
    let (width, height, _, _) = header(bytes)?;
    Ok((width, height))
}

/// Reads an array of one channel, as it is.
///
/// # Errors
/// A header that [`read_size`] refuses, another number of channels, no pixels, and bytes that are not those of the
/// stated size.
pub fn read_gray(bytes: &[u8]) -> Result<Raster<f32>, FormatError> {
    let (size, mut channels) = read(bytes, 1)?;
    let values = channels.pop().unwrap_or_default();
    Raster::from_values(size.0, size.1, values).map_err(FormatError::at("header"))
}

/// Reads an array of three channels.
///
/// # Errors
/// As [`read_gray`].
pub fn read_normals(bytes: &[u8]) -> Result<NormalMap, FormatError> {
    let (size, channels) = read(bytes, 3)?;
    let values = (0..channels[0].len()).map(|at| [0, 1, 2].map(|channel| channels[channel][at]));
    Raster::from_values(size.0, size.1, values.collect()).map_err(FormatError::at("header"))
}

/// (width, height), and the values of each channel.
type Channels = ((u32, u32), Vec<Vec<f32>>);

/// The values of one row in `every` so many of an array of one channel, as they are; the others are not looked at.
///
/// # Errors
/// As [`read_gray`], but that an array without pixels has no values.
pub fn gray_rows(bytes: &[u8], every: usize) -> Result<Vec<f32>, FormatError> {
    let ((width, _), body) = body_of(bytes, 1)?;
    let rows = body.chunks_exact((4 * width as usize).max(1));
    let rows = rows.step_by(every.max(1)).flat_map(|row| row.as_chunks().0);
    Ok(rows.map(|&value| f32::from_le_bytes(value)).collect())
}

/// (width, height), and the bytes of the values.
fn body_of(bytes: &[u8], expected: u32) -> Result<((u32, u32), &[u8]), FormatError> {
    let (width, height, channels, start) = header(bytes)?;
    if channels != expected {
        let problem = format!("expected {expected} channels, found {channels}");
        return Err(FormatError::new("header", problem));
    }
    let body = &bytes[start..];
    let pixels = u64::from(width) * u64::from(height);
    let length = 4 * u128::from(pixels) * u128::from(channels);
    if body.len() as u128 != length {
        let problem = format!(
            "expected {length} bytes for {width} x {height} x {channels} values, found {}",
            body.len()
        );
        return Err(FormatError::new(format!("byte {start}"), problem));
    }
    Ok(((width, height), body))
}

fn read(bytes: &[u8], expected: u32) -> Result<Channels, FormatError> {
    let ((width, height), body) = body_of(bytes, expected)?;
    let pixels = u64::from(width) * u64::from(height);
    let values: Vec<f32> = body
        .as_chunks::<4>()
        .0
        .iter()
        .map(|&value| f32::from_le_bytes(value))
        .collect();
    // No pixels are refused by the raster.
    let channels = values.chunks((pixels as usize).max(1)).map(<[f32]>::to_vec);
    let mut channels: Vec<Vec<f32>> = channels.collect();
    channels.resize(expected as usize, Vec::new());
    Ok(((width, height), channels))
}

/// Width, height, channels and where the values start.
fn header(bytes: &[u8]) -> Result<(u32, u32, u32, usize), FormatError> {
    let mut at = 0;
    let mut number = |what: &str| {
        let digits = bytes[at..].iter().take(11).position(|&byte| byte == b'&');
        let text = digits.and_then(|end| std::str::from_utf8(&bytes[at..at + end]).ok());
        let value = text.and_then(|text| text.parse::<u32>().ok());
        let (Some(end), Some(value)) = (digits, value) else {
            let found = String::from_utf8_lossy(&bytes[at..bytes.len().min(at + 11)]);
            let problem = format!(
                "expected {what} in digits and `&`, as COLMAP's dense maps start, found `{}`",
                found.escape_debug()
            );
            return Err(FormatError::new(format!("byte {at}"), problem));
        };
        at += end + 1;
        Ok(value)
    };
    let (width, height) = (number("a width")?, number("a height")?);
    let channels = number("a number of channels")?;
    Ok((width, height, channels, at))
}

/// Writes an array of one channel.
///
/// # Errors
/// What writing to `out` brings.
pub fn write_gray(out: &mut impl Write, raster: &Raster<f32>) -> std::io::Result<()> {
    write!(out, "{}&{}&1&", raster.width(), raster.height())?;
    write_values(out, raster.values().iter().copied())
}

/// Writes an array of three channels.
///
/// # Errors
/// What writing to `out` brings.
pub fn write_normals(out: &mut impl Write, normals: &NormalMap) -> std::io::Result<()> {
    write!(out, "{}&{}&3&", normals.width(), normals.height())?;
    for channel in 0..3 {
        write_values(out, normals.values().iter().map(|normal| normal[channel]))?;
    }
    Ok(())
}

fn write_values(
    out: &mut impl Write,
    mut values: impl Iterator<Item = f32>,
) -> std::io::Result<()> {
    values.try_for_each(|value| out.write_all(&value.to_le_bytes()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn maps_read_back_and_lie_as_colmap_writes_them() {
        let depth = Raster::from_values(3, 2, vec![1.0, 2.0, 3.0, 4.0, 0.0, -1.0]).unwrap();
        let mut bytes = Vec::new();
        write_gray(&mut bytes, &depth).unwrap();
        assert_eq!(bytes[..6], *b"3&2&1&");
        assert_eq!(
            bytes[6 + 8..6 + 12],
            3f32.to_le_bytes(),
            "rows from the top"
        );
        assert_eq!(
            (read_size(&bytes).unwrap(), read_gray(&bytes).unwrap()),
            ((3, 2), depth)
        );
        let normals = Raster::from_values(2, 1, vec![[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]).unwrap();
        let mut bytes = Vec::new();
        write_normals(&mut bytes, &normals).unwrap();
        let body: Vec<f32> = [1.0, 4.0, 2.0, 5.0, 3.0, 6.0].to_vec();
        let body: Vec<u8> = body.iter().flat_map(|value| value.to_le_bytes()).collect();
        assert_eq!(bytes, [&b"2&1&3&"[..], &body].concat());
        assert_eq!(read_normals(&bytes).unwrap(), normals);
    }

    #[test]
    fn malformed_maps_get_one_sentence() {
        let said = |bytes: &[u8]| read_gray(bytes).unwrap_err().to_string();
        assert!(said(b"").contains("expected a width"));
        assert!(said(b"3&2").contains("expected a height"));
        assert!(said(b"3&2&x&").contains("expected a number of channels"));
        assert!(said(b"3&2&3&").contains("expected 1 channels, found 3"));
        assert!(said(b"3&2&1&abcd").contains("expected 24 bytes"));
        assert!(said(b"99999999999&2&1&").contains("expected a width"));
        assert!(said(b"4294967295&4294967295&1&").contains("found 0"));
        assert!(read_gray(b"0&2&1&").is_err() && read_normals(b"0&2&3&").is_err());
        assert!(read_normals(b"1&1&3&aaaabbbbcccc").is_ok());
    }
}
