//! The data after the header, element by element. The crate reads text, lists and whatever else is
//! odd; rows of a fixed size are left where they are, see [`super::table`].

use super::header::{Header, is_scalar, size_of};
use super::table::Table;
use crate::error::FormatError;
use crate::format::text::shown;
use ply_rs_bw::parser::Parser;
use ply_rs_bw::ply::{
    ElementDef, Encoding, Property, PropertyAccess, PropertyAccessResult, PropertyType, ScalarType,
};

/// The crate's grammar has no `nan` and `inf`: they travel as these numbers, which no file holds.
const STAND_INS: [(f64, f64); 3] = [
    (f64::NAN, 1.797_693_134_862_312e308),
    (f64::INFINITY, 1.797_693_134_862_313e308),
    (f64::NEG_INFINITY, -1.797_693_134_862_313e308),
];

/// One element as numbers: scalars and lists, each in header order.
#[derive(Debug, Default)]
pub(super) struct Row {
    pub(super) scalars: Vec<f64>,
    pub(super) lists: Vec<Vec<f64>>,
}

impl Row {
    /// Refuses numbers of the row's line that the header does not name: which are which is not known then.
    fn all_of(self, line: &str) -> Result<Self, String> {
        let of_lists = self.lists.iter().map(|list| 1 + list.len());
        let expected = self.scalars.len() + of_lists.sum::<usize>();
        let found = line.split_ascii_whitespace().count();
        match found > expected {
            true => Err(format!(
                "expected {expected} numbers as the header says, found {found}"
            )),
            false => Ok(self),
        }
    }
}

impl PropertyAccess for Row {
    fn new() -> Self {
        Self::default()
    }

    fn set_property(&mut self, _name: &str, property: Property) -> PropertyAccessResult {
        fn list<T: Into<f64>>(values: Vec<T>) -> Vec<f64> {
            values.into_iter().map(Into::into).collect()
        }
        match property {
            Property::Char(value) => self.scalars.push(value.into()),
            Property::UChar(value) => self.scalars.push(value.into()),
            Property::Short(value) => self.scalars.push(value.into()),
            Property::UShort(value) => self.scalars.push(value.into()),
            Property::Int(value) => self.scalars.push(value.into()),
            Property::UInt(value) => self.scalars.push(value.into()),
            Property::Float(value) => self.scalars.push(value.into()),
            Property::Double(value) => self.scalars.push(value),
            Property::ListChar(values) => self.lists.push(list(values)),
            Property::ListUChar(values) => self.lists.push(list(values)),
            Property::ListShort(values) => self.lists.push(list(values)),
            Property::ListUShort(values) => self.lists.push(list(values)),
            Property::ListInt(values) => self.lists.push(list(values)),
            Property::ListUInt(values) => self.lists.push(list(values)),
            Property::ListFloat(values) => self.lists.push(list(values)),
            Property::ListDouble(values) => self.lists.push(values),
        }
        PropertyAccessResult::Set
    }
}

/// What is not read yet.
pub(super) struct Body<'a> {
    encoding: Encoding,
    rest: &'a [u8],
    /// The 1-based line at the start of `rest`, in text files.
    line: usize,
}

impl<'a> Body<'a> {
    /// Everything after the header of `bytes`.
    pub(super) fn new(bytes: &'a [u8], header: &Header) -> Self {
        Self {
            encoding: header.encoding,
            rest: &bytes[header.bytes..],
            line: header.lines + 1,
        }
    }

    /// The bytes not read yet.
    #[cfg(test)]
    pub(super) fn rest(&self) -> &'a [u8] {
        self.rest
    }

    /// Takes an element's scalars as columns: in place where rows have a fixed size.
    pub(super) fn take_table(&mut self, element: &ElementDef) -> Result<Table<'a>, FormatError> {
        match self.take_fixed(element)? {
            Some(table) => Ok(table),
            None => self.take_parsed_table(element),
        }
    }

    /// The rows in place, if they have a fixed size.
    fn take_fixed(&mut self, element: &ElementDef) -> Result<Option<Table<'a>>, FormatError> {
        self.check_room(element)?;
        let fixed = element
            .properties
            .values()
            .all(|property| is_scalar(&property.data_type));
        if self.encoding == Encoding::Ascii || !fixed {
            return Ok(None);
        }
        let (rows, rest) = self.rest.split_at(element.count * least_bytes(element));
        self.rest = rest;
        let big_endian = self.encoding == Encoding::BinaryBigEndian;
        Ok(Some(Table::fixed(element, rows, big_endian)))
    }

    /// Takes an element's scalars as columns by way of the crate.
    pub(super) fn take_parsed_table(
        &mut self,
        element: &ElementDef,
    ) -> Result<Table<'a>, FormatError> {
        let mut table = Table::parsed(element);
        self.take_rows(element, |_, row| {
            table.push(&row.scalars);
            Ok(())
        })?;
        Ok(table)
    }

    /// Passes over an element.
    pub(super) fn skip(&mut self, element: &ElementDef) -> Result<(), FormatError> {
        match self.take_fixed(element)? {
            Some(_) => Ok(()),
            None => self.take_rows(element, |_, _| Ok(())),
        }
    }

    /// Takes an element row by row by way of the crate.
    pub(super) fn take_rows(
        &mut self,
        element: &ElementDef,
        mut each: impl FnMut(usize, Row) -> Result<(), FormatError>,
    ) -> Result<(), FormatError> {
        self.check_room(element)?;
        if element.properties.is_empty() {
            return Ok(());
        }
        let parser = Parser::<Row>::new();
        if self.encoding == Encoding::Ascii {
            let wide = widened(element);
            for index in 0..element.count {
                each(index, self.take_text_row(&parser, &wide, index)?)?;
            }
            return Ok(());
        }
        for index in 0..element.count {
            let row = match self.encoding {
                Encoding::BinaryBigEndian => {
                    parser.read_big_endian_element(&mut self.rest, element)
                }
                _ => parser.read_little_endian_element(&mut self.rest, element),
            };
            each(index, row.map_err(|_| cut_short(element, index))?)?;
        }
        Ok(())
    }

    /// The next line that is not blank, as a row.
    fn take_text_row(
        &mut self,
        parser: &Parser<Row>,
        element: &ElementDef,
        index: usize,
    ) -> Result<Row, FormatError> {
        while let Some(line) = self.take_line() {
            if line.trim_ascii().is_empty() {
                continue;
            }
            let line = String::from_utf8_lossy(line);
            let row = match parser.read_ascii_element(&line, element) {
                Ok(row) => Ok(row),
                Err(_) => repaired(parser, element, &line),
            };
            return row.and_then(|row| row.all_of(&line)).map_err(|problem| {
                let place = format!("{} {index} (line {})", element.name, self.line - 1);
                FormatError::new(place, problem)
            });
        }
        Err(cut_short(element, index))
    }

    fn take_line(&mut self) -> Option<&'a [u8]> {
        if self.rest.is_empty() {
            return None;
        }
        let end = self
            .rest
            .iter()
            .position(|&byte| byte == b'\n' || byte == b'\r');
        let (line, rest) = self.rest.split_at(end.unwrap_or(self.rest.len()));
        let rest = rest.strip_prefix(b"\r").unwrap_or(rest);
        self.rest = rest.strip_prefix(b"\n").unwrap_or(rest);
        self.line += 1;
        Some(line)
    }

    /// Refuses what is left after all elements but for blanks and zeros: the header states too little, or the file
    /// was put together wrongly.
    pub(super) fn check_end(&self) -> Result<(), FormatError> {
        // 0x1a is how old editors end a text.
        let blank = |byte: &u8| byte.is_ascii_whitespace() || [0, 0x1a].contains(byte);
        if self.rest.iter().all(blank) {
            return Ok(());
        }
        let place = match self.encoding {
            Encoding::Ascii => format!("line {}", self.line),
            _ => "after the last element".to_owned(),
        };
        let problem = format!(
            "expected the end of the file after all that its header states, found {} more bytes: the header \
             states too few elements, or something else was added",
            self.rest.len()
        );
        Err(FormatError::new(place, problem))
    }

    /// Refuses a count that the rest of the file cannot hold, before anything is allocated for it.
    fn check_room(&self, element: &ElementDef) -> Result<(), FormatError> {
        let each = match self.encoding {
            Encoding::Ascii => 2 * element.properties.len(), // a digit and a blank or line break
            _ => least_bytes(element),
        };
        let left = self.rest.len() + usize::from(self.encoding == Encoding::Ascii);
        if each == 0 || element.count <= left / each {
            return Ok(());
        }
        let problem = format!(
            "expected {} of at least {each} bytes each as the header says, found {} bytes, \
             enough for {}: the file is cut short or its header is wrong",
            element.count,
            self.rest.len(),
            left / each
        );
        Err(FormatError::new(
            format!("element {}", element.name),
            problem,
        ))
    }
}

/// What the smallest possible row takes in a binary file.
fn least_bytes(element: &ElementDef) -> usize {
    let sizes = element
        .properties
        .values()
        .map(|property| match &property.data_type {
            PropertyType::Scalar(scalar) | PropertyType::List(scalar, _) => size_of(scalar),
        });
    sizes.sum()
}

fn cut_short(element: &ElementDef, index: usize) -> FormatError {
    let problem = format!(
        "expected {} of them, found the file's end or a list of impossible length",
        element.count
    );
    FormatError::new(format!("{} {index}", element.name), problem)
}

/// The same element with all values `double`: text keeps the digits it has.
fn widened(element: &ElementDef) -> ElementDef {
    let mut wide = element.clone();
    for property in wide.properties.values_mut() {
        property.data_type = match property.data_type {
            PropertyType::Scalar(_) => PropertyType::Scalar(ScalarType::Double),
            PropertyType::List(..) => PropertyType::List(ScalarType::UInt, ScalarType::Double),
        };
    }
    wide
}

/// Reads a line that the crate's grammar refuses for `nan`, `inf`, `.5` or `5.`; else says why not.
fn repaired(parser: &Parser<Row>, element: &ElementDef, line: &str) -> Result<Row, String> {
    let mut words = Vec::new();
    for word in line.split_whitespace() {
        let Ok(number) = word.parse::<f64>() else {
            return Err(format!("expected a number, found `{}`", shown(word)));
        };
        let stand_in = STAND_INS
            .iter()
            .find(|(special, _)| *special == number || (special.is_nan() && number.is_nan()));
        let number = stand_in.map_or(number, |&(_, stand_in)| stand_in);
        words.push(number.to_string());
    }
    let count = words.len();
    let mut row = parser
        .read_ascii_element(&words.join(" "), element)
        .map_err(|_| {
            let expected = element.properties.len();
            format!("expected the values of {expected} properties, found {count} numbers")
        })?;
    for value in row.scalars.iter_mut().chain(row.lists.iter_mut().flatten()) {
        if let Some((special, _)) = STAND_INS.iter().find(|(_, stand_in)| stand_in == value) {
            *value = *special;
        }
    }
    Ok(row)
}

#[cfg(test)]
mod tests {
    use super::super::header;
    use super::*;

    fn body(text: &str) -> (Header, Body<'_>) {
        let header = header::read(text.as_bytes()).unwrap();
        let body = Body::new(text.as_bytes(), &header);
        (header, body)
    }

    fn rows(text: &str) -> Result<Vec<Row>, FormatError> {
        let (header, mut body) = body(text);
        let mut rows = Vec::new();
        body.take_rows(&header.elements[0], |_, row| {
            rows.push(row);
            Ok(())
        })?;
        Ok(rows)
    }

    fn text(count: usize, body: &str) -> String {
        format!(
            "ply\nformat ascii 1.0\nelement e {count}\nproperty uchar a\nproperty list uchar int k\nproperty float b\nend_header\n{body}"
        )
    }

    #[test]
    fn text_keeps_its_digits_and_special_numbers() {
        let rows = rows(&text(
            4,
            "1 2 7 8 0.1\n\n .5 0 5.\r\n2 1 nan -inf\nNaN 0 +Inf",
        ))
        .unwrap();
        assert_eq!(
            (&rows[0].scalars[..], &rows[0].lists[0][..]),
            (&[1.0, 0.1][..], &[7.0, 8.0][..])
        );
        assert_eq!(
            (&rows[1].scalars[..], rows[1].lists[0].len()),
            (&[0.5, 5.0][..], 0)
        );
        assert!(rows[2].lists[0][0].is_nan() && rows[2].scalars[1] == f64::NEG_INFINITY);
        assert!(rows[3].scalars[0].is_nan() && rows[3].scalars[1] == f64::INFINITY);
    }

    #[test]
    fn broken_lines_are_said_with_row_and_line() {
        for (count, lines, expected) in [
            (
                2,
                "1 0 2\n1 0 x\n",
                "e 1 (line 9): expected a number, found `x`",
            ),
            (
                2,
                "1 0 2\n\n1 1 2 \n",
                "e 1 (line 10): expected the values of 3 properties, found 3 numbers",
            ),
            (1, "1 4000000000 3 2", "expected the values of 3 properties"),
            (
                2,
                "1 1 2.0000000 3\n",
                "e 1: expected 2 of them, found the file's end",
            ),
            (1, "1 -1 3 2", "expected the values of 3 properties"),
            (
                usize::MAX,
                "1 0 2\n",
                "element e: expected 18446744073709551615 of at least 6 bytes each as the header says, found 6 bytes, enough for 1",
            ),
            (1, "", "found 0 bytes, enough for 0"),
        ] {
            let error = rows(&text(count, lines)).unwrap_err().to_string();
            assert!(error.contains(expected), "{error}");
        }
    }

    #[test]
    fn the_crate_agrees_that_the_stand_ins_are_needed() {
        let (header, _) = body(&text(1, "1 0 nan"));
        let parser = Parser::<Row>::new();
        let element = widened(&header.elements[0]);
        assert!(parser.read_ascii_element("1 0 nan", &element).is_err());
        assert!(parser.read_ascii_element("1 0 2", &element).is_ok());
    }

    #[test]
    fn elements_are_passed_over_whatever_they_hold() {
        let head = "ply\nformat binary_little_endian 1.0\nelement a 2\nproperty short s\nelement b 2\nproperty list uchar short l\nelement none 9999999999\nelement c 1\nproperty uchar last\nend_header\n";
        let mut bytes = head.as_bytes().to_vec();
        bytes.extend([1, 0, 2, 0, 1, 5, 5, 0, 42]);
        let header = header::read(&bytes).unwrap();
        let mut body = Body::new(&bytes, &header);
        for element in &header.elements[..3] {
            body.skip(element).unwrap();
        }
        assert_eq!(body.rest(), [42]);
        bytes.truncate(bytes.len() - 5);
        let mut body = Body::new(&bytes, &header);
        body.skip(&header.elements[0]).unwrap();
        let error = body.skip(&header.elements[1]).unwrap_err().to_string();
        assert!(
            error.contains("element b: expected 2") || error.contains("b 0: expected 2"),
            "{error}"
        );
    }
}
