//! PFM: float images, rows bottom-up. `Pf` has one channel, `PF` three.

use super::text::shown;
use crate::error::FormatError;
use crate::scene::Raster;
use std::io::Write;
use std::ops::Range;

/// A PFM's content, rows from the top.
#[derive(Debug, Clone, PartialEq)]
pub enum Pfm {
    /// `Pf`.
    Gray(Raster<f32>),
    /// `PF`.
    Color(Raster<[f32; 3]>),
}

/// What stands before the numbers.
struct Header {
    color: bool,
    width: u32,
    height: u32,
    big_endian: bool,
}

/// Reads a PFM of either kind and endianness. The scale's magnitude is not applied. Values are as
/// stored: they may be NaN or infinite.
///
/// # Errors
/// No `Pf` or `PF`, a width, height or scale that is missing or none, a scale that is 0 or not finite, no pixels, and
/// another count of bytes after the header than these say.
pub fn read(bytes: &[u8]) -> Result<Pfm, FormatError> {
    let (header, body) = read_whole(bytes)?;
    if header.big_endian {
        values(&header, body, f32::from_be_bytes)
    } else {
        values(&header, body, f32::from_le_bytes)
    }
}

/// Header and numbers of a file that has all of them.
fn read_whole(bytes: &[u8]) -> Result<(Header, &[u8]), FormatError> {
    let (header, body) = read_header(bytes)?;
    let channels = if header.color { 3 } else { 1 };
    let expected = u128::from(header.width) * u128::from(header.height) * channels * 4;
    if body.len() as u128 != expected {
        let problem = format!(
            "expected {} x {} x {channels} floats = {expected} bytes after the header, found {}",
            header.width,
            header.height,
            body.len()
        );
        return Err(FormatError::new("data", problem));
    }
    Ok((header, body))
}

/// Columns that [`gray_runs`] takes together.
const RUN: usize = 64;

/// Calls `take(row, first column, values)` for the runs of columns, row by row as they are stored, from the
/// bottom, of a one-channel PFM of this size in which there is anything but zeros. Values are as stored; what
/// `take` makes of them is overwritten by the next.
///
/// `passed` is given all bytes of the file, in pieces one after the other, each soon after it was looked at.
///
/// # Errors
/// Three channels, another size, and the headers and counts of bytes that [`read`] refuses.
pub fn gray_runs(
    bytes: &[u8],
    size: (u32, u32),
    mut take: impl FnMut(usize, usize, &mut [f32]),
    passed: impl FnMut(&[u8]),
) -> Result<(), FormatError> {
    let mut values = [0.0; RUN];
    each_row(bytes, size, passed, |header, row, bytes| {
        for (run, bytes) in bytes.chunks(4 * RUN).enumerate() {
            if is_zero(bytes) {
                continue;
            }
            let values = &mut values[..bytes.len() / 4];
            header.convert(bytes.as_chunks().0, values);
            take(row, run * RUN, values);
        }
    })
}

/// Bytes that are passed on together, at least: they are still in the processor's second cache, and a multiple
/// of what hashes are made of.
const PIECE: usize = 1 << 17;

/// Calls `each(header, row, bytes)` with the rows of a one-channel PFM of this size as they are stored, from the
/// bottom; `passed` as [`gray_runs`] says.
fn each_row(
    bytes: &[u8],
    size: (u32, u32),
    mut passed: impl FnMut(&[u8]),
    mut each: impl FnMut(&Header, usize, &[u8]),
) -> Result<(), FormatError> {
    let (header, body) = read_gray_of(bytes, size)?;
    let rows = body.chunks_exact((4 * size.0 as usize).max(1));
    let (mut end, mut waiting) = (bytes.len() - body.len(), bytes);
    for (row, row_bytes) in (0..size.1 as usize).rev().zip(rows) {
        each(&header, row, row_bytes);
        end += row_bytes.len();
        let done = end - (bytes.len() - waiting.len());
        let (piece, rest) = waiting.split_at(done / PIECE * PIECE);
        if !piece.is_empty() {
            passed(piece);
            waiting = rest;
        }
    }
    passed(waiting);
    Ok(())
}

/// Whether all bytes are 0.
fn is_zero(bytes: &[u8]) -> bool {
    let (words, rest) = bytes.as_chunks::<8>();
    let bits = words
        .iter()
        .fold(0, |bits, word| bits | u64::from_ne_bytes(*word));
    bits == 0 && rest.iter().all(|&byte| byte == 0)
}

/// The values of one row in `every` so many of a one-channel PFM of this size, as stored; the others are not looked at.
///
/// # Errors
/// As [`gray_runs`].
pub fn gray_rows(bytes: &[u8], size: (u32, u32), every: usize) -> Result<Vec<f32>, FormatError> {
    let (header, body) = read_gray_of(bytes, size)?;
    let rows = body.chunks_exact((4 * size.0 as usize).max(1));
    let mut values = Vec::new();
    for row in rows.step_by(every.max(1)) {
        let start = values.len();
        values.resize(start + row.len() / 4, 0.0);
        header.convert(row.as_chunks().0, &mut values[start..]);
    }
    Ok(values)
}

/// Puts the `wanted` columns of every row, numbered from the top, of a one-channel PFM of this size where they
/// belong in `to`, which is row-major. Values are as stored; what is not wanted is not looked at. `passed` is as
/// for [`gray_runs`].
///
/// # Errors
/// As [`gray_runs`].
pub fn gray_parts(
    bytes: &[u8],
    size: (u32, u32),
    wanted: impl Fn(usize) -> Range<usize>,
    to: &mut [f32],
    passed: impl FnMut(&[u8]),
) -> Result<(), FormatError> {
    let width = size.0 as usize;
    each_row(bytes, size, passed, |header, row, bytes| {
        let columns = wanted(row);
        let floats = &bytes.as_chunks().0[columns.clone()];
        header.convert(floats, &mut to[row * width..][columns]);
    })
}

impl Header {
    /// Puts numbers as they are stored into `to`.
    fn convert(&self, floats: &[[u8; 4]], to: &mut [f32]) {
        let numbers = to.iter_mut().zip(floats);
        if self.big_endian {
            numbers.for_each(|(to, four)| *to = f32::from_be_bytes(*four));
        } else {
            numbers.for_each(|(to, four)| *to = f32::from_le_bytes(*four));
        }
    }
}

/// As [`read_whole`], of one channel and this size.
fn read_gray_of(bytes: &[u8], size: (u32, u32)) -> Result<(Header, &[u8]), FormatError> {
    let (header, body) = read_whole(bytes)?;
    if header.color || (header.width, header.height) != size {
        let problem = format!(
            "expected one channel of {}x{}, found {} of {}x{}",
            size.0,
            size.1,
            if header.color { "three" } else { "one" },
            header.width,
            header.height
        );
        return Err(FormatError::new("header", problem));
    }
    Ok((header, body))
}

/// The body's numbers; generic, so that `float` is part of the loop.
fn values(
    header: &Header,
    body: &[u8],
    float: impl Fn([u8; 4]) -> f32,
) -> Result<Pfm, FormatError> {
    if header.color {
        let pixel = |at: &[u8; 12]| {
            let mut rgb = [0.0; 3];
            for (value, four) in rgb.iter_mut().zip(at.as_chunks::<4>().0) {
                *value = float(*four);
            }
            rgb
        };
        Ok(Pfm::Color(raster(header, body, pixel)?))
    } else {
        Ok(Pfm::Gray(raster(header, body, |at: &[u8; 4]| float(*at))?))
    }
}

/// The (width, height) that a PFM states, without reading its values.
///
/// # Errors
/// No `Pf` or `PF`, a width, height or scale that is missing or none, and a scale that is 0 or not finite.
pub fn read_size(bytes: &[u8]) -> Result<(u32, u32), FormatError> {
    let (header, _) = read_header(bytes)?;
    Ok((header.width, header.height))
}

/// Turns the rows, which are stored from the bottom, into a raster.
fn raster<T, const N: usize>(
    header: &Header,
    body: &[u8],
    pixel: impl Fn(&[u8; N]) -> T,
) -> Result<Raster<T>, FormatError> {
    let row_bytes = (header.width as usize * N).max(1);
    let mut values = Vec::with_capacity(body.len() / N.max(1));
    for row in body.rchunks_exact(row_bytes) {
        values.extend(row.as_chunks::<N>().0.iter().map(&pixel));
    }
    Raster::from_values(header.width, header.height, values).map_err(FormatError::at("header"))
}

/// Reads a one-channel PFM.
///
/// # Errors
/// As [`read`], and three channels.
pub fn read_gray(bytes: &[u8]) -> Result<Raster<f32>, FormatError> {
    match read(bytes)? {
        Pfm::Gray(raster) => Ok(raster),
        Pfm::Color(_) => Err(FormatError::new(
            "header",
            "expected one channel (`Pf`), found three (`PF`)",
        )),
    }
}

fn read_header(bytes: &[u8]) -> Result<(Header, &[u8]), FormatError> {
    let mut rest = bytes;
    let color = match word(&mut rest, "`Pf` or `PF`")? {
        "Pf" => false,
        "PF" => true,
        other => {
            let problem = format!("expected `Pf` or `PF`, found `{}`", shown(other));
            return Err(FormatError::new("header", problem));
        }
    };
    let width = number(&mut rest, "a width in pixels")?;
    let height = number(&mut rest, "a height in pixels")?;
    let scale: f64 = number(&mut rest, "a scale")?;
    if scale == 0.0 || !scale.is_finite() {
        let problem = format!("expected a scale below 0 (little-endian) or above, found {scale}");
        return Err(FormatError::new("header", problem));
    }
    let header = Header {
        color,
        width,
        height,
        big_endian: scale > 0.0,
    };
    // Blanks behind the scale, if a line ends after them, and one line's end.
    let blanks = rest.iter().take_while(|&&byte| byte == b' ').count();
    let ends = |at: usize| matches!(rest.get(at), Some(b'\r' | b'\n'));
    let rest = if ends(blanks) { &rest[blanks..] } else { rest };
    let body = rest
        .strip_prefix(b"\r\n")
        .unwrap_or(rest.get(1..).unwrap_or_default());
    Ok((header, body))
}

/// The next word of the header; what follows it stays in `rest`.
fn word<'a>(rest: &mut &'a [u8], expected: &str) -> Result<&'a str, FormatError> {
    let trimmed = rest.trim_ascii_start();
    let length = trimmed
        .iter()
        .take(64)
        .position(u8::is_ascii_whitespace)
        .unwrap_or(trimmed.len().min(64));
    let (found, after) = trimmed.split_at(length);
    *rest = after;
    match std::str::from_utf8(found) {
        Ok(text) if !text.is_empty() => Ok(text),
        Ok(_) => Err(FormatError::new(
            "header",
            format!("expected {expected}, found nothing more"),
        )),
        Err(_) => Err(FormatError::new(
            "header",
            format!("expected {expected}, found binary data"),
        )),
    }
}

fn number<T: std::str::FromStr>(rest: &mut &[u8], expected: &str) -> Result<T, FormatError> {
    let text = word(rest, expected)?;
    text.parse().map_err(|_| {
        let problem = format!("expected {expected}, found `{}`", shown(text));
        FormatError::new("header", problem)
    })
}

/// Writes a little-endian `Pf` with scale -1.000000.
///
/// # Errors
/// What writing to `out` brings.
pub fn write_gray(out: &mut impl Write, raster: &Raster<f32>) -> std::io::Result<()> {
    write_rows(out, "Pf", raster, |&value| value.to_le_bytes())
}

/// Writes a little-endian `PF` with scale -1.000000.
///
/// # Errors
/// What writing to `out` brings.
pub fn write_color(out: &mut impl Write, raster: &Raster<[f32; 3]>) -> std::io::Result<()> {
    write_rows(out, "PF", raster, |&[r, g, b]| {
        let mut bytes = [0; 12];
        bytes[..4].copy_from_slice(&r.to_le_bytes());
        bytes[4..8].copy_from_slice(&g.to_le_bytes());
        bytes[8..].copy_from_slice(&b.to_le_bytes());
        bytes
    })
}

/// Bytes that are written at a time, at least.
const AT_A_TIME: usize = 1 << 17;

fn write_rows<T, const N: usize>(
    out: &mut impl Write,
    magic: &str,
    raster: &Raster<T>,
    bytes_of: impl Fn(&T) -> [u8; N],
) -> std::io::Result<()> {
    write!(
        out,
        "{magic}\n{} {}\n-1.000000\n",
        raster.width(),
        raster.height()
    )?;
    let width = raster.width() as usize;
    let some = AT_A_TIME / (width * N) + 1;
    let mut bytes = vec![[0; N]; width * some.min(raster.height() as usize)];
    for rows in raster.values().rchunks(width * some) {
        let upwards = rows.chunks_exact(width).rev();
        for (to, from) in bytes.chunks_exact_mut(width).zip(upwards) {
            for (to, from) in to.iter_mut().zip(from) {
                *to = bytes_of(from);
            }
        }
        out.write_all(bytes[..rows.len()].as_flattened())?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn rows_stand_from_the_bottom_however_many_are_written_at_a_time() {
        for (width, height) in [(700, 401), (1, 70_000), (70_000, 1), (40_000, 3)] {
            let values: Vec<f32> = (0..width * height).map(|i| i as f32).collect();
            let raster = Raster::from_values(width, height, values).unwrap();
            let mut found = Vec::new();
            write_gray(&mut found, &raster).unwrap();
            let mut expected = format!("Pf\n{width} {height}\n-1.000000\n").into_bytes();
            for row in raster.rows().rev() {
                expected.extend(row.iter().flat_map(|value| value.to_le_bytes()));
            }
            assert!(found == expected, "{width} x {height}");
        }
    }

    fn bits(raster: &Raster<f32>) -> Vec<u32> {
        raster
            .values()
            .iter()
            .map(|value| value.to_bits())
            .collect()
    }

    /// A PFM of these numbers of either endianness.
    fn both_ways(raster: &Raster<f32>) -> [Vec<u8>; 2] {
        let mut little = Vec::new();
        write_gray(&mut little, raster).unwrap();
        let (width, height) = raster.size();
        let mut big = format!("Pf\n{width} {height}\n1.0\n").into_bytes();
        let body = &little[little.len() - 4 * raster.values().len()..];
        big.extend(body.as_chunks::<4>().0.iter().flat_map(|four| {
            let [a, b, c, d] = *four;
            [d, c, b, a]
        }));
        [little, big]
    }

    /// 150 columns, so the last run is shorter; a run of zeros, one of a number, −0 and NaN among them.
    fn gappy() -> Raster<f32> {
        let mut raster = Raster::filled(150, 4, 0.0).unwrap();
        for (column, row, value) in [
            (3, 0, 1.5),
            (149, 0, 2.0),
            (64, 1, -0.0),
            (127, 2, f32::NAN),
        ] {
            raster.set(column, row, value);
        }
        raster
    }

    #[test]
    fn runs_are_what_is_not_zero_of_the_whole() {
        for bytes in both_ways(&gappy()) {
            let mut found = Raster::filled(150, 4, 0.0).unwrap();
            let (mut runs, mut passed) = (Vec::new(), Vec::new());
            let take = |row, first, values: &mut [f32]| {
                runs.push((row, first, values.len()));
                for (at, value) in values.iter_mut().enumerate() {
                    found.set((first + at) as u32, row as u32, *value);
                    *value = 7.0; // must not be seen again
                }
            };
            let whole = |piece: &[u8]| passed.extend_from_slice(piece);
            gray_runs(&bytes, (150, 4), take, whole).unwrap();
            assert_eq!(runs, [(2, 64, 64), (1, 64, 64), (0, 0, 64), (0, 128, 22)]);
            assert_eq!(bits(&found), bits(&gappy()));
            assert!(passed == bytes);
        }
        let [little, _] = both_ways(&gappy());
        let refused = |bytes: &[u8], size| {
            let nothing = |_: &[u8]| panic!("nothing was looked at");
            gray_runs(bytes, size, |_, _, _| {}, nothing).unwrap_err()
        };
        let error = refused(&little, (4, 150)).to_string();
        assert!(error.contains("expected one channel of 4x150, found one of 150x4"));
        let error = refused(&little[..50], (150, 4)).to_string();
        assert!(error.contains("bytes after the header, found"));
    }

    #[test]
    fn all_bytes_are_passed_on_in_large_pieces_after_their_rows() {
        for (width, height) in [(100_000, 5), (7, 30_000), (1, 40_000), (32_768, 3)] {
            let raster = Raster::filled(width, height, 1.0).unwrap();
            let mut bytes = Vec::new();
            write_gray(&mut bytes, &raster).unwrap();
            let rows = std::cell::Cell::new(0);
            let mut lengths = Vec::new();
            let mut rest = bytes.as_slice();
            let header = bytes.len() - 4 * (width * height) as usize;
            let passed = |piece: &[u8]| {
                let (expected, more) = rest.split_at(piece.len());
                assert!(piece == expected);
                rest = more;
                lengths.push(piece.len());
                let seen = header + 4 * width as usize * rows.get();
                assert!(bytes.len() - rest.len() <= seen);
            };
            let wanted = |_| {
                rows.set(rows.get() + 1);
                0..width as usize
            };
            let mut found = vec![0.0; (width * height) as usize];
            gray_parts(&bytes, (width, height), wanted, &mut found, passed).unwrap();
            assert!(found == raster.values());
            assert!(rest.is_empty());
            let last = lengths.pop().unwrap();
            assert!(last < PIECE + 4 * width as usize, "{last}");
            assert!(
                lengths
                    .iter()
                    .all(|&length| length.is_multiple_of(PIECE) && length > 0)
            );
        }
    }

    #[test]
    fn parts_are_the_wanted_columns_of_every_row() {
        let values: Vec<f32> = (0..12).map(|value| value as f32 - 3.5).collect();
        let raster = Raster::from_values(4, 3, values).unwrap();
        let wanted = |row: usize| [0..4, 2..2, 1..3][row].clone();
        for bytes in both_ways(&raster) {
            let (mut found, mut passed) = ([9.0; 12], Vec::new());
            let whole = |piece: &[u8]| passed.extend_from_slice(piece);
            gray_parts(&bytes, (4, 3), wanted, &mut found, whole).unwrap();
            let expected = [[-3.5, -2.5, -1.5, -0.5], [9.0; 4], [9.0, 5.5, 6.5, 9.0]];
            assert_eq!(found, expected.as_flattened());
            assert!(passed == bytes);
        }
        let [little, _] = both_ways(&raster);
        let refused =
            |bytes: &[u8], size| gray_parts(bytes, size, |_| 0..3, &mut [0.0; 12], |_| {});
        assert!(refused(&little, (3, 4)).is_err());
        assert!(refused(&little[..50], (4, 3)).is_err());
    }

    #[test]
    fn rows_are_stored_from_the_bottom() {
        let raster = Raster::from_values(2, 2, vec![1.0, 2.0, 3.0, 4.0]).unwrap();
        let mut bytes = Vec::new();
        write_gray(&mut bytes, &raster).unwrap();
        let mut expected = b"Pf\n2 2\n-1.000000\n".to_vec();
        for value in [3.0f32, 4.0, 1.0, 2.0] {
            expected.extend(value.to_le_bytes());
        }
        assert_eq!(bytes, expected);
        assert_eq!(read_gray(&bytes).unwrap(), raster);
    }

    #[test]
    fn big_endian_colour_and_carriage_returns_are_read() {
        let mut bytes = b"PF\r\n1 2\r\n1.0\r\n".to_vec();
        for value in [4.0f32, 5.0, 6.0, 1.0, 2.0, 3.0] {
            bytes.extend(value.to_be_bytes());
        }
        let expected = Raster::from_values(1, 2, vec![[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]).unwrap();
        assert_eq!(read(&bytes).unwrap(), Pfm::Color(expected.clone()));
        let error = read_gray(&bytes).unwrap_err().to_string();
        assert!(error.contains("expected one channel"), "{error}");
        let mut again = Vec::new();
        write_color(&mut again, &expected).unwrap();
        assert_eq!(read(&again).unwrap(), Pfm::Color(expected));
    }

    #[test]
    fn broken_files_get_one_sentence() {
        for (bytes, expected) in [
            (&b""[..], "expected `Pf` or `PF`, found nothing more"),
            (b"P6\n1 1\n255\n", "found `P6`"),
            (b"\xff\xd8\xff\xe0", "found binary data"),
            (
                b"Pf\n2 2\n-1\n\0\0\0\0",
                "2 x 2 x 1 floats = 16 bytes after the header, found 4",
            ),
            (
                b"Pf\n1 1\n-1\n\0\0\0\0\0",
                "= 4 bytes after the header, found 5",
            ),
            (b"Pf\n4294967295 4294967295\n-1\n", "found 0"),
            (
                b"Pf\n99999999999 1\n-1\n",
                "expected a width in pixels, found `99999999999`",
            ),
            (b"Pf\n0 5\n-1\n", "at least one, found 0"),
            (b"Pf\n0 0\n-1\n", "at least one, found 0"),
            (b"Pf\n1 1\n0\n\0\0\0\0", "expected a scale"),
            (b"Pf\n1 1\nnan\n\0\0\0\0", "expected a scale"),
            (b"Pf\n1 1", "expected a scale, found nothing more"),
        ] {
            let error = read(bytes).unwrap_err().to_string();
            assert!(error.contains(expected), "{error}");
        }
    }

    #[test]
    fn blanks_behind_the_scale_are_no_values() {
        for (head, value) in [
            ("-1 \n", *b" \n\0\0"),
            ("-1  \r\n", [1; 4]),
            ("-1 ", [b' ', 1, 2, 3]),
        ] {
            let bytes = [format!("Pf\n1 1\n{head}").as_bytes(), &value].concat();
            let raster = read_gray(&bytes).unwrap();
            assert_eq!(
                raster.values()[0].to_bits(),
                u32::from_le_bytes(value),
                "{head:?}"
            );
        }
    }

    proptest! {
        #[test]
        fn every_value_reads_back_even_nan(
            width in 1u32..5,
            values in proptest::collection::vec(any::<u32>(), 1..6),
        ) {
            let height = u32::try_from(values.len()).unwrap();
            let values: Vec<f32> = values.iter().flat_map(|&b| vec![f32::from_bits(b); width as usize]).collect();
            let raster = Raster::from_values(width, height, values).unwrap();
            let mut bytes = Vec::new();
            write_gray(&mut bytes, &raster).unwrap();
            prop_assert_eq!(bits(&read_gray(&bytes).unwrap()), bits(&raster));
        }
    }
}
