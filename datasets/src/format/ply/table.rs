//! Columns of numbers: read from rows of fixed size where they lie, or collected by the crate.

use super::header::{is_scalar, size_of};
use ply_rs_bw::ply::{ElementDef, PropertyType, ScalarType};

/// One scalar property.
#[derive(Debug, Clone)]
struct Field {
    name: String,
    scalar: ScalarType,
    /// Where it starts in a row of fixed size.
    offset: usize,
}

/// Where the values are.
#[derive(Debug)]
enum Data<'a> {
    /// Rows as they lie in the file; `rows` holds a whole number of them.
    Fixed {
        rows: &'a [u8],
        stride: usize,
        big_endian: bool,
    },
    /// One vector per field.
    Parsed(Vec<Vec<f64>>),
}

/// The scalars of one element, by column.
#[derive(Debug)]
pub(super) struct Table<'a> {
    fields: Vec<Field>,
    data: Data<'a>,
}

impl<'a> Table<'a> {
    /// A table over `element.count` rows in place. All its properties are scalars.
    pub(super) fn fixed(element: &ElementDef, rows: &'a [u8], big_endian: bool) -> Self {
        let fields = fields_of(element);
        let stride = fields
            .last()
            .map_or(0, |last| last.offset + size_of(&last.scalar));
        Self {
            fields,
            data: Data::Fixed {
                rows,
                stride,
                big_endian,
            },
        }
    }

    /// An empty table to be filled row by row.
    pub(super) fn parsed(element: &ElementDef) -> Self {
        let fields = fields_of(element);
        let data = Data::Parsed(vec![Vec::new(); fields.len()]);
        Self { fields, data }
    }

    /// Adds a row of scalars in header order. Tables in place take none.
    pub(super) fn push(&mut self, scalars: &[f64]) {
        if let Data::Parsed(columns) = &mut self.data {
            for (column, &value) in columns.iter_mut().zip(scalars) {
                column.push(value);
            }
        }
    }

    /// The names of all columns, in file order.
    pub(super) fn names(&self) -> Vec<&str> {
        self.fields
            .iter()
            .map(|field| field.name.as_str())
            .collect()
    }

    /// The columns with these names, if all are there.
    pub(super) fn find<const N: usize>(&self, names: [&str; N]) -> Option<[usize; N]> {
        let mut columns = [0; N];
        for (column, name) in columns.iter_mut().zip(names) {
            *column = self.fields.iter().position(|field| field.name == name)?;
        }
        Some(columns)
    }

    /// The type that the header gives a column.
    pub(super) fn scalar(&self, column: usize) -> &ScalarType {
        &self.fields[column].scalar
    }

    /// Makes one value per row from some of its columns, which all exist.
    pub(super) fn map<const N: usize, T>(
        &self,
        columns: [usize; N],
        mut make: impl FnMut(usize, [f64; N]) -> T,
    ) -> Vec<T> {
        match &self.data {
            Data::Parsed(parsed) => {
                let picked = columns.map(|column| &parsed[column]);
                let rows = 0..picked.first().map_or(0, |column| column.len());
                rows.map(|row| make(row, picked.map(|column| column[row])))
                    .collect()
            }
            Data::Fixed {
                rows,
                stride,
                big_endian,
            } => {
                let picked = columns.map(|column| &self.fields[column]);
                let first = &picked[0].scalar;
                let one_type = picked.iter().all(|field| field.scalar == *first);
                let offsets = picked.map(|field| field.offset);
                let rows = rows.chunks_exact((*stride).max(1)).enumerate();
                match first {
                    ScalarType::Float if one_type && !big_endian => rows
                        .map(|(at, row)| make(at, offsets.map(|offset| float(row, offset))))
                        .collect(),
                    ScalarType::Double if one_type && !big_endian => rows
                        .map(|(at, row)| make(at, offsets.map(|offset| double(row, offset))))
                        .collect(),
                    ScalarType::UChar if one_type => rows
                        .map(|(at, row)| make(at, offsets.map(|offset| f64::from(row[offset]))))
                        .collect(),
                    _ => rows
                        .map(|(at, row)| {
                            make(at, picked.map(|field| value_of(row, field, *big_endian)))
                        })
                        .collect(),
                }
            }
        }
    }
}

fn fields_of(element: &ElementDef) -> Vec<Field> {
    let mut offset = 0;
    let mut fields = Vec::new();
    for property in element.properties.values() {
        if let PropertyType::Scalar(scalar) = &property.data_type {
            fields.push(Field {
                name: property.name.clone(),
                scalar: scalar.clone(),
                offset,
            });
            offset += size_of(scalar);
        }
    }
    debug_assert!(
        fields.len()
            <= element
                .properties
                .values()
                .filter(|p| is_scalar(&p.data_type))
                .count()
    );
    fields
}

/// `N` bytes of a row from `offset` on, which lie inside it.
#[inline]
fn bytes<const N: usize>(row: &[u8], offset: usize) -> [u8; N] {
    let mut taken = [0; N];
    taken.copy_from_slice(&row[offset..offset + N]);
    taken
}

#[inline]
fn float(row: &[u8], offset: usize) -> f64 {
    f32::from_le_bytes(bytes(row, offset)).into()
}

#[inline]
fn double(row: &[u8], offset: usize) -> f64 {
    f64::from_le_bytes(bytes(row, offset))
}

/// A value of any type and byte order.
fn value_of(row: &[u8], field: &Field, big_endian: bool) -> f64 {
    fn in_order<const N: usize>(row: &[u8], offset: usize, big_endian: bool) -> [u8; N] {
        let mut taken = bytes(row, offset);
        if big_endian {
            taken.reverse();
        }
        taken
    }
    let at = field.offset;
    match field.scalar {
        ScalarType::Char => i8::from_le_bytes(bytes(row, at)).into(),
        ScalarType::UChar => row[at].into(),
        ScalarType::Short => i16::from_le_bytes(in_order(row, at, big_endian)).into(),
        ScalarType::UShort => u16::from_le_bytes(in_order(row, at, big_endian)).into(),
        ScalarType::Int => i32::from_le_bytes(in_order(row, at, big_endian)).into(),
        ScalarType::UInt => u32::from_le_bytes(in_order(row, at, big_endian)).into(),
        ScalarType::Float => f32::from_le_bytes(in_order(row, at, big_endian)).into(),
        ScalarType::Double => f64::from_le_bytes(in_order(row, at, big_endian)),
    }
}

#[cfg(test)]
mod tests {
    use super::super::body::Body;
    use super::super::header;
    use super::*;
    use proptest::prelude::*;

    const TYPES: [&str; 8] = [
        "char", "uchar", "short", "ushort", "int", "uint", "float", "double",
    ];

    /// A file of `count` random rows with these types; names are a, b, c, …
    fn file(types: &[usize], count: usize, noise: &[u8], big_endian: bool) -> Vec<u8> {
        let endian = if big_endian { "big" } else { "little" };
        let mut head = format!("ply\nformat binary_{endian}_endian 1.0\nelement vertex {count}\n");
        for (name, &kind) in ('a'..).zip(types) {
            head.push_str(&format!("property {} {name}\n", TYPES[kind]));
        }
        head.push_str("element tail 1\nproperty uchar mark\nend_header\n");
        let stride: usize = types
            .iter()
            .map(|&kind| [1, 1, 2, 2, 4, 4, 4, 8][kind])
            .sum();
        let mut bytes = head.into_bytes();
        bytes.extend(noise.iter().cycle().take(stride * count));
        bytes.push(77);
        bytes
    }

    fn columns(table: &Table<'_>, wanted: [usize; 3]) -> Vec<[u64; 3]> {
        // NaN payloads may change on the way through floats; NaN itself may not.
        let bits = |value: f64| {
            if value.is_nan() {
                f64::NAN.to_bits()
            } else {
                value.to_bits()
            }
        };
        table.map(wanted, |_, values| values.map(bits))
    }

    proptest! {
        #[test]
        fn rows_in_place_are_what_the_crate_reads(
            types in prop_oneof![
                proptest::collection::vec(0usize..8, 3..9),
                (0usize..8, 3usize..6).prop_map(|(kind, count)| vec![kind; count]),
            ],
            count in 0usize..20,
            noise in proptest::collection::vec(any::<u8>(), 97),
            big_endian: bool,
            picks in proptest::array::uniform3(any::<prop::sample::Index>()),
        ) {
            let bytes = file(&types, count, &noise, big_endian);
            let header = header::read(&bytes).unwrap();
            let wanted = picks.map(|pick| pick.index(types.len()));
            let mut body = Body::new(&bytes, &header);
            let fast = body.take_table(&header.elements[0]).unwrap();
            let in_place = matches!(fast.data, Data::Fixed { .. });
            prop_assert!(in_place);
            prop_assert_eq!(body.rest(), [77]);
            let mut body = Body::new(&bytes, &header);
            let slow = body.take_parsed_table(&header.elements[0]).unwrap();
            prop_assert_eq!(body.rest(), [77]);
            prop_assert_eq!(columns(&fast, wanted), columns(&slow, wanted));
            prop_assert_eq!(columns(&fast, wanted).len(), count);
        }
    }

    #[test]
    fn columns_are_found_by_name() {
        let bytes = file(&[6, 7, 1], 1, &[0], false);
        let header = header::read(&bytes).unwrap();
        let table = Body::new(&bytes, &header)
            .take_table(&header.elements[0])
            .unwrap();
        assert_eq!(table.find(["c", "a"]), Some([2, 0]));
        assert_eq!(table.find(["c", "z"]), None);
        assert_eq!(
            (table.names(), table.scalar(1)),
            (vec!["a", "b", "c"], &ScalarType::Double)
        );
    }
}
