//! A 4×4 matrix as text, as in `<Scene>_trans.txt`.

use super::text::Words;
use crate::error::FormatError;
use glam::DMat4;
use std::io::Write;

/// Reads sixteen finite numbers, row by row. Blank lines and lines starting with `#` are skipped.
///
/// # Errors
/// Fewer or more than sixteen numbers, and one that is not finite.
pub fn read(text: &str) -> Result<DMat4, FormatError> {
    let mut words = Words::new(text, Some('#'));
    let rows = words.numbers::<16>("a 4x4 matrix")?;
    words.end("the 16 numbers of a 4x4 matrix")?;
    Ok(DMat4::from_cols_array(&rows).transpose())
}

/// Writes four lines of four numbers with the shortest digits that read back to the same number.
///
/// # Errors
/// What writing to `out` brings.
pub fn write(out: &mut impl Write, matrix: &DMat4) -> std::io::Result<()> {
    for row in 0..4 {
        let [x, y, z, w] = matrix.row(row).to_array();
        writeln!(out, "{x} {y} {z} {w}")?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn every_matrix_reads_back_as_it_was(numbers in proptest::array::uniform16(
            proptest::num::f64::NORMAL | proptest::num::f64::SUBNORMAL | proptest::num::f64::ZERO,
        )) {
            let matrix = DMat4::from_cols_array(&numbers);
            let mut text = Vec::new();
            write(&mut text, &matrix).unwrap();
            let back = read(std::str::from_utf8(&text).unwrap()).unwrap();
            prop_assert_eq!(back.to_cols_array().map(f64::to_bits), numbers.map(f64::to_bits));
        }
    }

    #[test]
    fn rows_are_rows() {
        let text = "# from the toolbox\n1 2 3 4\r\n5 6 7 8\n\n9 10 11 12 \n0 0 0 1";
        let matrix = read(text).unwrap();
        assert_eq!(matrix.row(0).to_array(), [1.0, 2.0, 3.0, 4.0]);
        assert_eq!(matrix.row(3).to_array(), [0.0, 0.0, 0.0, 1.0]);
    }

    #[test]
    fn what_is_no_matrix_is_said_with_its_line() {
        for (text, expected) in [
            ("", "expected number 1 of the 16"),
            (
                "1 2 3 4\n5 6 7",
                "line 2 (end of the file): expected number 8",
            ),
            ("1 2 nan 4", "line 1: expected number 3"),
            ("1 2 3 inf", "line 1: expected number 4"),
            (
                "1 2 3 4\n1 2 3 4\n1 2 3 4\n1 2 3 4\n5",
                "line 5: expected the end",
            ),
            ("\u{0}\u{1}garbage", "found `\\0\\u{1}garbage`"),
        ] {
            let error = read(text).unwrap_err().to_string();
            assert!(error.contains(expected), "{error}");
        }
    }
}
