//! MVSNet / BlendedMVS `cam.txt`: extrinsic, intrinsic and depth range of one view.

use super::text::Words;
use crate::error::FormatError;
use glam::{DMat3, DMat4};
use std::io::{Error, ErrorKind, Write};

/// How many depth hypotheses MVSNet takes where a file with two numbers does not say.
const DEFAULT_COUNT: f64 = 192.0;

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
    /// two numbers, min + interval · 192 as MVSNet does. `None` without a tail. Nothing says yet
    /// that min is below max.
    pub fn depth_range(&self) -> Option<(f64, f64)> {
        match self.tail[..] {
            [min, _, _, max, ..] => Some((min, max)),
            [min, interval, count] => Some((min, min + interval * count)),
            [min, interval] => Some((min, min + interval * DEFAULT_COUNT)),
            _ => None,
        }
    }
}

/// Reads a `cam.txt`. Line breaks and blanks may be anywhere between the numbers; all numbers are
/// finite; the last row of K is 0 0 1.
///
/// # Errors
/// A keyword or number that is missing or another, a number that is not finite, another last row of K, one number
/// alone after it, and more than four.
pub fn read(text: &str) -> Result<CamFile, FormatError> {
    let mut words = Words::new(text, None);
    words.keyword("extrinsic")?;
    let extrinsic = words.numbers::<16>("the extrinsic matrix")?;
    words.keyword("intrinsic")?;
    let upper = words.numbers::<6>("the first two rows of the intrinsic matrix")?;
    let place = words.place();
    let last = words.numbers::<3>("the last row of the intrinsic matrix")?;
    if last != [0.0, 0.0, 1.0] {
        let problem = format!("expected a last intrinsic row of 0 0 1, found {last:?}");
        return Err(FormatError::new(place, problem));
    }
    let place = words.place();
    let mut tail = Vec::new();
    while !words.is_done() && tail.len() < 4 {
        tail.push(words.number("a number of the depth line")?);
    }
    words.end("the 4 numbers of the depth line")?;
    if tail.len() == 1 {
        let problem = "expected 2 to 4 numbers (depth_min interval [count [depth_max]]), found 1";
        return Err(FormatError::new(place, problem));
    }
    let [a, b, c, d, e, f] = upper;
    let [g, h, i] = last;
    Ok(CamFile {
        extrinsic: DMat4::from_cols_array(&extrinsic).transpose(),
        intrinsic: DMat3::from_cols_array(&[a, d, g, b, e, h, c, f, i]),
        tail,
    })
}

/// Writes a `cam.txt` in the form that the strictest public loaders accept: four numbers on the
/// last line, no trailing space, shortest decimal digits that read back to the same number.
///
/// A tail of two or three numbers is completed as [`CamFile::depth_range`] reads it.
///
/// # Errors
/// A tail of fewer than two numbers, of which there is nothing to write ([`ErrorKind::InvalidInput`]), and what
/// writing to `out` brings.
pub fn write(out: &mut impl Write, cam: &CamFile) -> std::io::Result<()> {
    let Some((min, max)) = cam.depth_range() else {
        let problem = "a cam.txt needs a depth range";
        return Err(Error::new(ErrorKind::InvalidInput, problem));
    };
    let interval = cam.tail.get(1).copied().unwrap_or_default();
    let count = cam.tail.get(2).copied().unwrap_or(DEFAULT_COUNT);
    writeln!(out, "extrinsic")?;
    super::transform::write(out, &cam.extrinsic)?;
    writeln!(out, "\nintrinsic")?;
    for row in 0..3 {
        let [x, y, z] = cam.intrinsic.row(row).to_array();
        writeln!(out, "{x} {y} {z}")?;
    }
    writeln!(out, "\n{min} {interval} {count:?} {max}")
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const REAL: &str = "extrinsic\n\
        0.996585955 0.06072634493 0.05593518884 0.09660849965 \n\
        0.06986579042 -0.2593094734 -0.9632639142 -1.712046856 \n\
        -0.04399097235 0.963883244 -0.2626668732 1.08569144 \n\
        0 0 0 1 \n\
        \n\
        intrinsic\n\
        1645.197217 0 545.5 \n\
        0 1645.197217 363.5 \n\
        0 0 1 \n\
        \n\
        1.4752043 0.00592964 128 2.2282686\n";

    fn with_tail(tail: &str) -> String {
        REAL.replace("1.4752043 0.00592964 128 2.2282686", tail)
    }

    fn written(cam: &CamFile) -> String {
        let mut text = Vec::new();
        write(&mut text, cam).unwrap();
        String::from_utf8(text).unwrap()
    }

    #[test]
    fn a_real_file_reads_to_its_numbers() {
        let cam = read(REAL).unwrap();
        assert_eq!(cam.extrinsic.row(1).w, -1.712046856);
        assert_eq!(cam.extrinsic.row(1).z, -0.9632639142);
        assert_eq!(cam.intrinsic.row(0).to_array(), [1645.197217, 0.0, 545.5]);
        assert_eq!(cam.intrinsic.row(1).to_array(), [0.0, 1645.197217, 363.5]);
        assert_eq!(cam.depth_range(), Some((1.4752043, 2.2282686)));
        assert_eq!(read(&REAL.replace('\n', "\r\n\r\n")).unwrap(), cam);
        assert_eq!(read(&REAL.replace("\n\n", "\n")).unwrap(), cam);
    }

    #[test]
    fn tails_of_every_length_are_understood() {
        let range = |tail: &str| read(&with_tail(tail)).unwrap().depth_range();
        assert_eq!(range("2 0.5"), Some((2.0, 98.0)));
        assert_eq!(range("2 0.5 4.0"), Some((2.0, 4.0)));
        assert_eq!(range("2 0.5 4 9 "), Some((2.0, 9.0)));
        assert_eq!(range(""), None);
        let error = read(&with_tail("2")).unwrap_err().to_string();
        assert!(
            error.contains("line 12: expected 2 to 4 numbers"),
            "{error}"
        );
        let error = read(&with_tail("1 2 3 4 5")).unwrap_err().to_string();
        assert!(
            error.contains("line 12") && error.contains("found `5`"),
            "{error}"
        );
    }

    #[test]
    fn what_is_written_has_the_strict_form() {
        let text = written(&read(&with_tail("2 0.5 128 66")).unwrap());
        assert!(text.ends_with("\n0 0 1\n\n2 0.5 128.0 66\n"), "{text}");
        assert!(text.lines().all(|line| line.trim_end() == line), "{text}");
        assert_eq!(text.lines().count(), 12);
        assert!(written(&read(&with_tail("2 0.5")).unwrap()).ends_with("\n2 0.5 192.0 98\n"));
        let without = read(&with_tail("")).unwrap();
        let error = write(&mut Vec::new(), &without).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::InvalidInput);
    }

    #[test]
    fn broken_files_are_said_with_their_line() {
        for (text, expected) in [
            (
                String::new(),
                "expected the word `extrinsic`, found nothing more",
            ),
            (
                "intrinsic".into(),
                "line 1: expected the word `extrinsic`, found `intrinsic`",
            ),
            (
                REAL.replace("0 0 1 \n", "0 0 2 \n"),
                "line 10: expected a last intrinsic row of 0 0 1",
            ),
            (
                REAL.replace("1.08569144", "NaN"),
                "line 4: expected number 12 of the 16",
            ),
            (REAL[..120].into(), "expected number"),
            (
                REAL.replace("intrinsic\n1645", "1645"),
                "expected the word `intrinsic`",
            ),
        ] {
            let error = read(&text).unwrap_err().to_string();
            assert!(error.contains(expected), "{error}");
        }
    }

    proptest! {
        #[test]
        fn every_cam_reads_back(
            extrinsic in proptest::array::uniform16(proptest::num::f64::NORMAL),
            upper in proptest::array::uniform6(proptest::num::f64::NORMAL),
            tail in proptest::array::uniform4(proptest::num::f64::NORMAL),
        ) {
            let [a, b, c, d, e, f] = upper;
            let cam = CamFile {
                extrinsic: DMat4::from_cols_array(&extrinsic),
                intrinsic: DMat3::from_cols_array(&[a, d, 0.0, b, e, 0.0, c, f, 1.0]),
                tail: tail.to_vec(),
            };
            prop_assert_eq!(read(&written(&cam)).unwrap(), cam);
        }
    }
}
