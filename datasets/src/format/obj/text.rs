//! The lines, words and numbers of OBJ and MTL files.

use crate::error::FormatError;
use std::borrow::Cow;

pub(super) fn number(word: &[u8]) -> Result<f64, String> {
    short_decimal(word)
        .or_else(|| std::str::from_utf8(word).ok()?.parse().ok())
        .filter(|value: &f64| value.is_finite())
        .ok_or_else(|| format!("expected a finite number, found {:?}", shown(word)))
}

/// Powers of ten that f64 holds exactly, as whole numbers up to 10^15 too.
pub(super) const TENS: [f64; MOST_DIGITS + 1] = [
    1.0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9, 1e10, 1e11, 1e12, 1e13, 1e14, 1e15,
];
pub(super) const MOST_DIGITS: usize = 15;

/// A number of few digits without an exponent, to the same bits as any: a quotient of two exact numbers is
/// rounded once. `None` for whatever else.
fn short_decimal(word: &[u8]) -> Option<f64> {
    let (digits, negative) = match word {
        [b'-', digits @ ..] => (digits, true),
        digits => (digits, false),
    };
    if digits.len() > MOST_DIGITS + 1 {
        return None;
    }
    let (mut whole, mut count, mut point) = (0u64, 0, None);
    for &byte in digits {
        match byte {
            b'0'..=b'9' => {
                whole = 10 * whole + u64::from(byte - b'0');
                count += 1;
            }
            b'.' if point.is_none() => point = Some(count),
            _ => return None,
        }
    }
    if count == 0 || count > MOST_DIGITS {
        return None;
    }
    let value = whole as f64 / TENS[count - point.unwrap_or(count)];
    Some(if negative { -value } else { value })
}

/// A whole number of few digits without a sign.
fn short_whole(word: &[u8]) -> Option<i64> {
    if word.is_empty() || word.len() > 9 {
        return None;
    }
    word.iter().try_fold(0, |whole, byte| {
        let digit = byte.wrapping_sub(b'0');
        (digit < 10).then(|| 10 * whole + i64::from(digit))
    })
}

/// An index of a face, counted from 1 or, negative, from the end.
#[inline]
pub(super) fn index(word: &[u8], count: usize, what: &str) -> Result<u32, String> {
    let stated = short_whole(word).or_else(|| std::str::from_utf8(word).ok()?.parse().ok());
    let limit = i64::try_from(count).unwrap_or(i64::MAX);
    let zero_based = match stated {
        Some(stated) if 0 < stated && stated <= limit => Some(stated - 1),
        Some(stated) if stated < 0 && -limit <= stated => Some(limit + stated),
        _ => None,
    };
    zero_based
        .and_then(|index| u32::try_from(index).ok())
        .ok_or_else(|| wrong_index(word, count, what))
}

#[cold]
fn wrong_index(word: &[u8], count: usize, what: &str) -> String {
    let known = if count == 0 {
        "none are defined before this line".to_owned()
    } else {
        format!("1 to {count} or -{count} to -1 are defined before this line")
    };
    format!(
        "expected the index of a {what} ({known}), found {:?}",
        shown(word)
    )
}

/// The beginning of a word, for a message.
fn shown(word: &[u8]) -> Cow<'_, str> {
    String::from_utf8_lossy(&word[..word.len().min(40)])
}

/// Words of a line, without a comment.
pub(in crate::format) fn fields(line: &[u8]) -> impl Iterator<Item = &[u8]> {
    line.split(u8::is_ascii_whitespace)
        .filter(|word| !word.is_empty())
        .take_while(|word| !word.starts_with(b"#"))
}

/// What stands after the first word, without spaces around it.
pub(in crate::format) fn rest_of_line(line: &[u8]) -> String {
    let line = line.trim_ascii();
    let end = line
        .iter()
        .position(u8::is_ascii_whitespace)
        .unwrap_or(line.len());
    String::from_utf8_lossy(line[end..].trim_ascii()).into_owned()
}

/// The text of a file, which must not be UTF-16 or binary, without its byte-order mark. Where carriage returns
/// alone end its lines, they are line feeds.
pub(in crate::format) fn plain(bytes: &[u8]) -> Result<Cow<'_, [u8]>, FormatError> {
    let utf16 = bytes.starts_with(&[0xff, 0xfe]) || bytes.starts_with(&[0xfe, 0xff]);
    if utf16 || bytes[..bytes.len().min(1024)].contains(&0) {
        let found = if utf16 { "UTF-16" } else { "zero bytes" };
        let problem = format!("expected plain text, found {found}: save the file as UTF-8");
        return Err(FormatError::new("byte 0", problem));
    }
    let text = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
    if text.contains(&b'\n') || !text.contains(&b'\r') {
        return Ok(Cow::Borrowed(text));
    }
    let ended = |&byte: &u8| if byte == b'\r' { b'\n' } else { byte };
    Ok(Cow::Owned(text.iter().map(ended).collect()))
}

/// Lines with their numbers from 1. Lines but comments that end in a backslash are joined with the
/// next.
pub(in crate::format) fn lines(text: &[u8]) -> Lines<'_> {
    Lines {
        rest: Some(text),
        number: 0,
    }
}

/// See [`lines`].
pub(in crate::format) struct Lines<'t> {
    /// What stands behind the last line, if that had an end.
    rest: Option<&'t [u8]>,
    number: usize,
}

impl<'t> Lines<'t> {
    /// What has not been looked at.
    pub(super) fn rest(&self) -> &'t [u8] {
        self.rest.unwrap_or_default()
    }

    /// Goes on behind one line.
    pub(super) fn pass(&mut self, behind: &'t [u8]) {
        self.rest = Some(behind);
        self.number += 1;
    }

    /// The next line as it is.
    fn one(&mut self) -> Option<&'t [u8]> {
        let rest = self.rest?;
        self.number += 1;
        let end = rest.iter().position(|&byte| byte == b'\n');
        self.rest = end.map(|end| &rest[end + 1..]);
        Some(&rest[..end.unwrap_or(rest.len())])
    }
}

impl<'t> Iterator for Lines<'t> {
    type Item = (usize, Cow<'t, [u8]>);

    fn next(&mut self) -> Option<Self::Item> {
        let first = self.one()?;
        let (number, mut line) = (self.number, Cow::Borrowed(first));
        if first.trim_ascii_start().starts_with(b"#") {
            return Some((number, line));
        }
        while let Some(front) = line.trim_ascii_end().strip_suffix(b"\\") {
            let mut joined = front.to_vec();
            joined.push(b' ');
            let Some(next) = self.one() else {
                return Some((number, Cow::Owned(joined)));
            };
            joined.extend_from_slice(next);
            line = Cow::Owned(joined);
        }
        Some((number, line))
    }
}

/// Cuts a text into pieces of about `size` bytes, none within what [`lines`] joins: behind lines of
/// which the last letter is no backslash.
pub(super) fn pieces(text: &[u8], size: usize) -> impl Iterator<Item = &[u8]> {
    let mut rest = text;
    std::iter::from_fn(move || {
        if rest.is_empty() {
            return None;
        }
        let (piece, after) = rest.split_at(end_of_piece(rest, size));
        rest = after;
        Some(piece)
    })
}

fn end_of_piece(text: &[u8], size: usize) -> usize {
    let mut start = 0;
    if let Some(newline) = text[..size.min(text.len())]
        .iter()
        .rposition(|&byte| byte == b'\n')
    {
        start = newline + 1;
    }
    while let Some(length) = text[start..].iter().position(|&byte| byte == b'\n') {
        let end = start + length;
        let closes = |last: &u8| *last != b'\\';
        if end >= size && text[start..end].trim_ascii_end().last().is_some_and(closes) {
            return end + 1;
        }
        start = end + 1;
    }
    text.len()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn numbers_are_those_of_the_standard_library(word in "-?[0-9]{0,12}[.]?[0-9]{0,9}(e-?[0-9])?") {
            let expected = word.parse::<f64>().ok().map(f64::to_bits);
            prop_assert_eq!(number(word.as_bytes()).ok().map(f64::to_bits), expected);
            if let Some(short) = short_decimal(word.as_bytes()) {
                prop_assert_eq!(Some(short.to_bits()), expected);
            }
            let whole = short_whole(word.as_bytes());
            prop_assert!(whole.is_none() || whole == word.parse().ok());
        }
    }

    #[test]
    fn short_numbers_are_taken_the_short_way() {
        for word in [
            "0",
            "-0",
            "-0.",
            ".5",
            "123456789.123456",
            "-100000000000000",
        ] {
            let short = short_decimal(word.as_bytes()).map(f64::to_bits);
            assert_eq!(short, word.parse().ok().map(f64::to_bits), "{word}");
        }
        for word in [
            "",
            "-",
            ".",
            "1..2",
            "+1",
            "1e3",
            "1234567890123456",
            "nan",
            "--1",
        ] {
            assert_eq!(short_decimal(word.as_bytes()), None, "{word}");
        }
        assert_eq!(index(b"-9223372036854775808", 5, "vertex").ok(), None);
    }
}
