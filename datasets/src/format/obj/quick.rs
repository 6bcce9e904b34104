//! The lines that nearly all of an OBJ file consists of, in one pass over their letters: numbers of few
//! digits, one space between words, nothing else. Whatever differs is left to the reader of all lines.

use super::text::{MOST_DIGITS, TENS};

/// `v x y z`, and what stands behind the line.
pub(super) fn vertex(line: &[u8]) -> Option<([f64; 3], &[u8])> {
    let (x, rest) = decimal(line.strip_prefix(b"v ")?)?;
    let (y, rest) = decimal(rest.strip_prefix(b" ")?)?;
    let (z, rest) = decimal(rest.strip_prefix(b" ")?)?;
    Some(([x, y, z], end(rest)?))
}

/// `vt x y`, and what stands behind the line.
pub(super) fn coord(line: &[u8]) -> Option<([f64; 2], &[u8])> {
    let (x, rest) = decimal(line.strip_prefix(b"vt ")?)?;
    let (y, rest) = decimal(rest.strip_prefix(b" ")?)?;
    Some(([x, y], end(rest)?))
}

/// Appends the corners of `f a/b a/b a/b`, of as many corners and with or without a third number, and returns
/// what stands behind the line. Indices are counted from 0, below so many (vertices, coordinates).
pub(super) fn face<'t>(
    line: &'t [u8],
    (vertices, coords): (usize, usize),
    corners: &mut Vec<(u32, Option<u32>)>,
) -> Option<&'t [u8]> {
    let mut rest = line.strip_prefix(b"f")?;
    while let Some(word) = rest.strip_prefix(b" ") {
        let (vertex, after) = index(word, vertices)?;
        let (coord, after) = index(after.strip_prefix(b"/")?, coords)?;
        rest = after;
        if let Some(normal) = rest.strip_prefix(b"/") {
            (_, rest) = index(normal, usize::MAX)?;
        }
        corners.push((vertex, Some(coord)));
    }
    end(rest)
}

/// What stands behind the end of a line.
fn end(rest: &[u8]) -> Option<&[u8]> {
    match rest {
        [b'\n', after @ ..] | [b'\r', b'\n', after @ ..] => Some(after),
        _ => None,
    }
}

/// The value of leading digits behind `value`, and how many they are. It wraps around when they are many.
#[inline(always)]
fn digits(text: &[u8], mut value: u64) -> (u64, usize) {
    let mut count = 0;
    for &byte in text {
        let digit = byte.wrapping_sub(b'0');
        if digit > 9 {
            break;
        }
        value = value.wrapping_mul(10).wrapping_add(u64::from(digit));
        count += 1;
    }
    (value, count)
}

/// A number as [`super::text::number`] reads it.
#[inline(always)]
fn decimal(text: &[u8]) -> Option<(f64, &[u8])> {
    let (text, negative) = match text {
        [b'-', rest @ ..] => (rest, true),
        _ => (text, false),
    };
    let (mut whole, mut count) = digits(text, 0);
    let mut rest = &text[count..];
    let mut behind = 0;
    if let [b'.', fraction @ ..] = rest {
        (whole, behind) = digits(fraction, whole);
        count += behind;
        rest = &fraction[behind..];
    }
    if count == 0 || count > MOST_DIGITS {
        return None;
    }
    let value = whole as f64 / TENS[behind];
    Some((if negative { -value } else { value }, rest))
}

/// A whole number from 1 to `limit`, less one.
#[inline(always)]
fn index(text: &[u8], limit: usize) -> Option<(u32, &[u8])> {
    let (value, count) = digits(text, 0);
    // Nine digits are below 2^32.
    let fits = (1..=9).contains(&count) && 0 < value && value <= limit as u64;
    fits.then(|| (value as u32 - 1, &text[count..]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::format::obj::text::number;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn numbers_are_those_of_the_reader_of_all_lines(word in "-?[0-9]{0,10}[.]?[0-9]{0,9}") {
            match decimal(word.as_bytes()) {
                Some((value, rest)) => {
                    prop_assert!(rest.is_empty());
                    prop_assert_eq!(number(word.as_bytes()).unwrap().to_bits(), value.to_bits());
                }
                None => prop_assert!(word.len() > MOST_DIGITS || number(word.as_bytes()).is_err()),
            }
        }
    }

    #[test]
    fn plain_lines_are_read_and_others_left() {
        let (at, rest) = vertex(b"v 1 -2.5 .25\nv").unwrap();
        assert_eq!((at, rest), ([1.0, -2.5, 0.25], &b"v"[..]));
        assert_eq!(coord(b"vt 0.5 1\r\n").unwrap(), ([0.5, 1.0], &b""[..]));
        for line in [
            "v 1 2\n",
            "v 1 2 3",
            "v 1 2 3 4\n",
            "v  1 2 3\n",
            "v 1 2 3 \n",
            "v 1 2 3\\\n",
            "v 1 2 3e1\n",
            "v 1 2 3#\n",
            "v 1 2 +3\n",
            "v 1 2 1.2.3\n",
            "v 1 2 1234567890123456\n",
            "vn 1 2 3\n",
        ] {
            assert_eq!(vertex(line.as_bytes()), None, "{line:?}");
        }
        let mut corners = Vec::new();
        let rest = face(b"f 1/2 3/1/7 2/2\nrest", (3, 2), &mut corners);
        assert_eq!(rest, Some(&b"rest"[..]));
        assert_eq!(corners, [(0, Some(1)), (2, Some(0)), (1, Some(1))]);
        for line in [
            "f 1 2 3\n",
            "f 1//2 2//1 3//1\n",
            "f 1/1 2/1 4/1\n",
            "f 1/1 2/1 3/3\n",
            "f 1/1 2/1 -1/1\n",
            "f 1/1 2/1 0/1\n",
            "f 1/1 2/1 3/1 \n",
            "f 1/1 2/1 3/1",
            "f 1/1 2/1 0000000001/1\n",
            "fo 1/1 2/1 3/1\n",
        ] {
            assert_eq!(
                face(line.as_bytes(), (3, 2), &mut corners),
                None,
                "{line:?}"
            );
        }
    }
}
