//! The header: cleaned line by line of what writers get wrong, then read by the crate.

use crate::error::FormatError;
use crate::format::text::shown;
use ply_rs_bw::parser::{Parser, Reader};
use ply_rs_bw::ply::{DefaultElement, ElementDef, Encoding, PropertyType, ScalarType};
use std::collections::BTreeSet;

/// What is put behind a name that is there before.
const AGAIN: &str = "_again";

/// A header that has not ended by then is none.
const MOST_BYTES: usize = 1 << 20;

/// What a PLY says it holds.
#[derive(Debug)]
pub(super) struct Header {
    pub(super) encoding: Encoding,
    /// In file order; names and property names are lower case and distinct.
    pub(super) elements: Vec<ElementDef>,
    /// The texts after `comment`, without surrounding blanks.
    pub(super) comments: Vec<String>,
    /// How many bytes and lines the header takes, `end_header` and its line break included.
    pub(super) bytes: usize,
    pub(super) lines: usize,
}

impl Header {
    /// The element with this name.
    pub(super) fn element(&self, name: &str) -> Option<&ElementDef> {
        self.elements.iter().find(|element| element.name == name)
    }
}

/// Bytes that a value of this type takes in a binary file.
pub(super) fn size_of(scalar: &ScalarType) -> usize {
    match scalar {
        ScalarType::Char | ScalarType::UChar => 1,
        ScalarType::Short | ScalarType::UShort => 2,
        ScalarType::Int | ScalarType::UInt | ScalarType::Float => 4,
        ScalarType::Double => 8,
    }
}

/// Whether a property has as many values in every row.
pub(super) fn is_scalar(data_type: &PropertyType) -> bool {
    matches!(data_type, PropertyType::Scalar(_))
}

/// Reads the header at the start of `bytes`. A byte-order mark and blanks before `ply`, carriage
/// returns, trailing blanks and, before the first element, lines with unknown keywords are no obstacle.
pub(super) fn read(bytes: &[u8]) -> Result<Header, FormatError> {
    let lines = Lines::find(bytes)?;
    let mut cleaner = Cleaner::default();
    let clean: Vec<String> = lines.texts.iter().map(|line| cleaner.line(line)).collect();
    if let Some(index) = clean.iter().position(|line| is_second(line)) {
        let place = format!("header line {}", index + 1);
        let problem = format!(
            "expected one `{}`, found a second",
            shown(&lines.texts[index])
        );
        return Err(FormatError::new(place, problem));
    }
    let text = clean.join("\n") + "\n";
    let parser = Parser::<DefaultElement>::new();
    let header = parser
        .read_header(&mut Reader::new(text.as_bytes()))
        .map_err(|error| match error.line() {
            Some(number) => misunderstood(number, &lines.texts),
            None => FormatError::new(
                "header",
                "expected a line `format <encoding> 1.0`, found none",
            ),
        })?;
    Ok(Header {
        encoding: header.encoding,
        elements: header.elements.into_values().collect(),
        comments: cleaner.comments,
        bytes: lines.bytes,
        lines: lines.texts.len(),
    })
}

fn misunderstood(number: usize, lines: &[String]) -> FormatError {
    let found = number.checked_sub(1).and_then(|index| lines.get(index));
    let problem = format!(
        "expected `format`, `element <name> <count>` or `property <type> <name>`, found `{}`",
        shown(found.map_or("", |line| line.as_str()))
    );
    FormatError::new(format!("header line {number}"), problem)
}

/// The header's lines, trimmed, from `ply` to `end_header`.
struct Lines {
    texts: Vec<String>,
    bytes: usize,
}

impl Lines {
    fn find(bytes: &[u8]) -> Result<Self, FormatError> {
        let start = bytes
            .strip_prefix(b"\xef\xbb\xbf")
            .unwrap_or(bytes)
            .trim_ascii_start();
        let window = &start[..start.len().min(MOST_BYTES)];
        let mut at = bytes.len() - start.len();
        let line_break = line_break_of(window)?;
        let mut texts = Vec::new();
        for line in window.split_inclusive(|&byte| byte == line_break) {
            at += line.len();
            texts.push(String::from_utf8_lossy(line.trim_ascii()).into_owned());
            if line.trim_ascii() == b"end_header" {
                return Ok(Self { texts, bytes: at });
            }
        }
        let problem = format!(
            "expected a line `end_header`, found none in the first {} bytes",
            window.len()
        );
        Err(FormatError::new("header", problem))
    }
}

/// The byte that ends lines, judged by the first one, which must be `ply`.
fn line_break_of(start: &[u8]) -> Result<u8, FormatError> {
    let no_ply = |found: String| {
        let problem = format!("expected a PLY, which starts with `ply`, found {found}");
        Err(FormatError::new("byte 0", problem))
    };
    if start.is_empty() {
        return no_ply("nothing".into());
    }
    let first_break = start
        .iter()
        .position(|&byte| byte == b'\n' || byte == b'\r');
    let (first, after) = start.split_at(first_break.unwrap_or(start.len()));
    if first.trim_ascii() != b"ply" {
        return no_ply(format!("`{}`", shown(&String::from_utf8_lossy(first))));
    }
    Ok(match after {
        [b'\r', b'\n', ..] | [b'\n', ..] | [] => b'\n',
        _ => b'\r',
    })
}

/// Rewrites header lines in the form that the crate's grammar takes, one for one.
#[derive(Default)]
struct Cleaner {
    comments: Vec<String>,
    elements: BTreeSet<String>,
    properties: BTreeSet<String>,
}

impl Cleaner {
    fn line(&mut self, line: &str) -> String {
        let words: Vec<&str> = line.split_whitespace().collect();
        match words[..] {
            ["ply"] | ["end_header"] | ["format", ..] => words.join(" "),
            ["element", name, count, ..] => {
                self.properties.clear();
                format!("element {} {count}", distinct(&mut self.elements, &[name]))
            }
            ["property", "list", count, item, ..] if words.len() > 4 => {
                let name = distinct(&mut self.properties, &words[4..]);
                format!("property list {count} {item} {name}").to_lowercase()
            }
            ["property", scalar, ..] if words.len() > 2 && scalar != "list" => {
                let name = distinct(&mut self.properties, &words[2..]);
                format!("property {scalar} {name}").to_lowercase()
            }
            ["element" | "property", ..] => line.to_owned(),
            // A property that was misspelt would move all values behind it: the crate refuses the line.
            [word, ..] if !self.elements.is_empty() && !is_remark(word) => line.to_owned(),
            _ => {
                let text = line.strip_prefix("comment").unwrap_or_default();
                self.comments.push(text.trim().to_owned());
                "comment".into()
            }
        }
    }
}

/// Whether a cleaned line begins vertices or faces a second time: rows of the second would be lost.
fn is_second(line: &str) -> bool {
    let mut words = line.split(' ');
    let name = words.next().filter(|&word| word == "element");
    let name = name.and_then(|_| words.next()?.strip_suffix(AGAIN));
    name.is_some_and(|name| ["vertex", "face"].contains(&name))
}

/// Whether a line that begins so says nothing of the data.
fn is_remark(word: &str) -> bool {
    let word = word.to_ascii_lowercase();
    ["comment", "obj_info", "#"]
        .iter()
        .any(|remark| word.starts_with(remark))
}

/// A lower-case name of letters, digits and underscores that `taken` does not hold yet, so that no
/// two properties share a name and none is lost.
fn distinct(taken: &mut BTreeSet<String>, words: &[&str]) -> String {
    let mut name: String = words
        .join("_")
        .chars()
        .map(|c| {
            if c.is_ascii_alphanumeric() {
                c.to_ascii_lowercase()
            } else {
                '_'
            }
        })
        .collect();
    if !name.starts_with(|first: char| first.is_ascii_lowercase()) {
        name.insert_str(0, "p_");
    }
    while !taken.insert(name.clone()) {
        name.push_str(AGAIN);
    }
    name
}

#[cfg(test)]
mod tests {
    use super::*;

    const PLAIN: &str = "ply\nformat ascii 1.0\ncomment a b\nelement vertex 2\nproperty float x\nproperty list uchar int k\nend_header\n";

    fn names(header: &Header) -> Vec<String> {
        header
            .elements
            .iter()
            .flat_map(|element| element.properties.keys().cloned())
            .collect()
    }

    #[test]
    fn vertices_and_faces_are_there_once() {
        let with =
            |name: &str| PLAIN.replace("end_header", &format!("element {name} 3\nend_header"));
        for (text, place) in [
            (
                with("Vertex"),
                "header line 7: expected one `element Vertex 3`",
            ),
            (
                with("face").replace("end_header", "element face 3\nend_header"),
                "header line 8: expected one `element face 3`",
            ),
        ] {
            let error = read(text.as_bytes()).unwrap_err().to_string();
            assert_eq!(error, format!("{place}, found a second"));
        }
        let other = with("k").replace("end_header", "element k 3\nend_header");
        assert_eq!(read(other.as_bytes()).unwrap().elements.len(), 3);
    }

    #[test]
    fn odd_spellings_mean_the_same() {
        let body = |text: &str| text.len();
        for text in [
            PLAIN.to_owned(),
            PLAIN.replace('\n', "\r\n"),
            PLAIN.replace('\n', "\r"),
            PLAIN.replace('\n', "  \n"),
            format!("\u{feff}{PLAIN}"),
            format!("\n  {PLAIN}"),
            PLAIN.replace(
                "comment a b",
                "obj_info who\nWritten by nobody\ncomment  a b",
            ),
            PLAIN.replace("float x", "Float32  X"),
            PLAIN.replace("end_header\n", "end_header\r\n"),
        ] {
            let header = read(text.as_bytes()).unwrap();
            assert_eq!(header.bytes, body(&text), "{text:?}");
            assert_eq!((header.elements.len(), header.elements[0].count), (1, 2));
            assert_eq!(names(&header), ["x", "k"]);
            assert!(header.comments.contains(&"a b".to_owned()), "{text:?}");
        }
    }

    #[test]
    fn the_data_may_start_with_a_line_break() {
        let header = read(format!("{PLAIN}\n\r\nrest").as_bytes()).unwrap();
        assert_eq!((header.bytes, header.lines), (PLAIN.len(), 7));
    }

    #[test]
    fn repeated_and_foreign_names_keep_their_place() {
        let text = PLAIN.replace(
            "property float x",
            "property float x\nproperty float x\nproperty int scalar_C2C (Z)\nproperty uchar 3d",
        );
        let header = read(text.as_bytes()).unwrap();
        assert_eq!(
            names(&header),
            ["x", "x_again", "scalar_c2c__z_", "p_3d", "k"]
        );
    }

    #[test]
    fn what_is_no_header_is_said() {
        for (text, expected) in [
            ("", "expected a PLY, which starts with `ply`, found nothing"),
            ("solid cube\n", "found `solid cube`"),
            ("plymouth\n", "found `plymouth`"),
            (
                "ply\nformat ascii 1.0\n",
                "expected a line `end_header`, found none in the first 21 bytes",
            ),
            (
                "ply\nend_header\n",
                "expected a line `format <encoding> 1.0`",
            ),
            (
                "ply\nformat klingon 1.0\nend_header\n",
                "header line 2: expected `format`",
            ),
            (
                "ply\nformat ascii 1.0\nelement vertex -1\nend_header\n",
                "header line 3: expected `format`, `element <name> <count>` or `property <type> <name>`, found `element vertex -1`",
            ),
            (
                "ply\nformat ascii 1.0\nelement vertex 99999999999999999999999\nend_header\n",
                "header line 3",
            ),
            (
                "ply\nformat ascii 1.0\nproperty float x\nend_header\n",
                "header line 3",
            ),
            (
                "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\npropertx float c\nend_header\n",
                "header line 5: expected `format`, `element <name> <count>` or `property <type> <name>`, found `propertx float c`",
            ),
            (
                "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\n\nComment c\nobj_info c\ncomment: c\n# c\nend_header\n",
                "",
            ),
            (
                "ply\nformat ascii 1.0\nelement vertex 1\nproperty string x\nend_header\n",
                "header line 4",
            ),
            (
                "ply\nformat ascii 1.0\nelement vertex 1\nproperty float\nend_header\n",
                "header line 4",
            ),
            (
                "ply\nformat ascii 1.0\nelement vertex 1\nproperty list float float x\nend_header\n",
                "",
            ),
        ] {
            match read(text.as_bytes()) {
                Err(error) => assert!(error.to_string().contains(expected), "{error}"),
                Ok(header) => assert!(expected.is_empty(), "{header:?}"),
            }
        }
        assert!(read(&vec![b' '; 3 << 20]).is_err());
        assert!(read(format!("ply\n{}", "x\n".repeat(1 << 20)).as_bytes()).is_err());
    }
}
