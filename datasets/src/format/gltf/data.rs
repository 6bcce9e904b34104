//! Bytes behind a glTF's numbers: the GLB container, data URIs, buffers, accessors.

use super::wire::{Accessor, Root};
use crate::error::FormatError;

/// Component types of unsigned integers of 1, 2 and 4 bytes.
const UNSIGNED: [u32; 3] = [5121, 5123, 5125];

/// The JSON and, in a GLB, the binary chunk.
pub(super) fn chunks(bytes: &[u8]) -> Result<(&[u8], Option<&[u8]>), FormatError> {
    if !bytes.starts_with(b"glTF") {
        return Ok((bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes), None));
    }
    let word = |at: usize| {
        let four = bytes.get(at..at + 4)?;
        Some(u32::from_le_bytes([four[0], four[1], four[2], four[3]]))
    };
    let cut = |at: usize| {
        let problem = format!(
            "expected a chunk, found the end of the file: it is cut short ({} bytes)",
            bytes.len()
        );
        FormatError::new(format!("byte {at}"), problem)
    };
    let version = word(4).ok_or_else(|| cut(4))?;
    if version != 2 {
        let problem = format!("expected glTF 2, found version {version}: export it as glTF 2.0");
        return Err(FormatError::new("byte 4", problem));
    }
    let (mut json, mut binary) = (None, None);
    let mut at = 12;
    // What follows the length that the file states is none of it.
    let stated = word(8).map_or(bytes.len(), |stated| stated as usize);
    let end = if (13..bytes.len()).contains(&stated) {
        stated
    } else {
        bytes.len()
    };
    while at < end {
        let (length, kind) = word(at).zip(word(at + 4)).ok_or_else(|| cut(at))?;
        let content = bytes
            .get(at + 8..)
            .and_then(|rest| rest.get(..length as usize));
        let content = content.ok_or_else(|| cut(at))?;
        match kind {
            0x4e4f_534a => json = json.or(Some(content)),
            0x004e_4942 => binary = binary.or(Some(content)),
            _ => {}
        }
        at += 8 + (length as usize).next_multiple_of(4);
    }
    let json =
        json.ok_or_else(|| FormatError::new("byte 12", "expected a JSON chunk, found none"))?;
    Ok((json, binary))
}

/// The bytes of a `data:` URI; `None` for any other URI.
pub(super) fn data_uri(uri: &str) -> Option<Result<Vec<u8>, String>> {
    let rest = uri.strip_prefix("data:")?;
    let decoded = rest
        .split_once(";base64,")
        .ok_or_else(|| "expected base64 data, found a data URI of another kind".to_owned())
        .and_then(|(_, text)| base64(text.as_bytes()));
    Some(decoded)
}

fn base64(text: &[u8]) -> Result<Vec<u8>, String> {
    let mut bytes = Vec::with_capacity(text.len() / 4 * 3);
    let (mut bits, mut held) = (0u32, 0u32);
    for &letter in text.iter().take_while(|&&letter| letter != b'=') {
        let value = match letter {
            b'A'..=b'Z' => letter - b'A',
            b'a'..=b'z' => letter - b'a' + 26,
            b'0'..=b'9' => letter - b'0' + 52,
            b'+' | b'-' => 62,
            b'/' | b'_' => 63,
            b'\r' | b'\n' => continue,
            _ => return Err(format!("expected base64, found byte {letter:#04x}")),
        };
        bits = bits << 6 | u32::from(value);
        held += 6;
        if held >= 8 {
            held -= 8;
            #[allow(clippy::cast_possible_truncation, reason = "the lowest eight bits")]
            bytes.push((bits >> held) as u8);
        }
    }
    Ok(bytes)
}

/// `%20` and the like undone; bytes that are no UTF-8 are replaced.
pub(super) fn unescaped(uri: &str) -> String {
    let digit = |byte: u8| char::from(byte).to_digit(16);
    let mut bytes = Vec::with_capacity(uri.len());
    let mut rest = uri.as_bytes();
    while let Some((&first, after)) = rest.split_first() {
        let escaped = match after {
            [high, low, ..] if first == b'%' => digit(*high).zip(digit(*low)),
            _ => None,
        };
        match escaped {
            Some((high, low)) => {
                #[allow(clippy::cast_possible_truncation, reason = "two hexadecimal digits")]
                bytes.push((high << 4 | low) as u8);
                rest = &after[2..];
            }
            None => {
                bytes.push(first);
                rest = after;
            }
        }
    }
    String::from_utf8_lossy(&bytes).into_owned()
}

/// The document with its buffers at hand.
pub(super) struct Document<'b> {
    pub(super) root: Root,
    pub(super) buffers: Vec<std::borrow::Cow<'b, [u8]>>,
}

impl Document<'_> {
    /// The bytes of a buffer view, and its stride.
    pub(super) fn view(&self, index: usize) -> Result<(&[u8], Option<usize>), String> {
        let view = self.root.buffer_views.get(index);
        let view = view.ok_or_else(|| format!("expected buffer view {index}, found none"))?;
        let buffer = self.buffers.get(view.buffer);
        let buffer =
            buffer.ok_or_else(|| format!("expected buffer {}, found none", view.buffer))?;
        let bytes = buffer
            .get(view.byte_offset..)
            .and_then(|rest| rest.get(..view.byte_length));
        let bytes = bytes.ok_or_else(|| {
            format!(
                "expected {} bytes from byte {} of buffer {}, found {} in all",
                view.byte_length,
                view.byte_offset,
                view.buffer,
                buffer.len()
            )
        })?;
        Ok((bytes, view.byte_stride))
    }

    /// The numbers of an accessor of vertex indices.
    pub(super) fn indices(&self, index: usize) -> Result<Vec<f64>, String> {
        if let Some(accessor) = self.root.accessors.get(index) {
            let kind = accessor.component_type;
            if accessor.shape != "SCALAR" || !UNSIGNED.contains(&kind) {
                let shape = super::super::text::shown(&accessor.shape);
                return Err(format!(
                    "accessor {index}: expected vertex indices (unsigned scalars), found {shape:?} of component type {kind}"
                ));
            }
        }
        let values = self.elements::<1>(index)?;
        Ok(values.into_iter().map(|[value]| value).collect())
    }

    /// The elements of an accessor, `N` or more numbers each of which the first `N` are kept.
    /// Normalised integers become 0…1, signed ones -1…1.
    pub(super) fn elements<const N: usize>(&self, index: usize) -> Result<Vec<[f64; N]>, String> {
        let accessor = self.root.accessors.get(index);
        let accessor = accessor.ok_or_else(|| format!("expected accessor {index}, found none"))?;
        self.elements_of(accessor)
            .map_err(|problem| format!("accessor {index}: {problem}"))
    }

    fn elements_of<const N: usize>(&self, accessor: &Accessor) -> Result<Vec<[f64; N]>, String> {
        if accessor.sparse.is_some() {
            return Err("expected plain data, found a sparse accessor, which is not supported: export without it".into());
        }
        let numbers = match accessor.shape.as_str() {
            "SCALAR" => 1,
            "VEC2" => 2,
            "VEC3" => 3,
            "VEC4" => 4,
            "MAT4" => 16,
            other => {
                return Err(format!(
                    "expected a scalar, vector or 4x4 matrix, found {:?}",
                    super::super::text::shown(other)
                ));
            }
        };
        if numbers < N {
            return Err(format!(
                "expected {N} numbers each, found {}",
                accessor.shape
            ));
        }
        let kind = Component::of(accessor)?;
        let Some(view) = accessor.buffer_view else {
            return Err(
                "expected a buffer view, found none: its data is compressed or missing".into(),
            );
        };
        let (bytes, stride) = self.view(view)?;
        let size = numbers * kind.size();
        let stride = stride.unwrap_or(size);
        let end = accessor.count.checked_sub(1).map_or(Some(0), |last| {
            last.checked_mul(stride)?
                .checked_add(size)?
                .checked_add(accessor.byte_offset)
        });
        if stride < size || end.is_none_or(|end| end > bytes.len()) {
            return Err(format!(
                "expected {} elements of {size} bytes every {stride} from byte {}, found {} bytes",
                accessor.count,
                accessor.byte_offset,
                bytes.len()
            ));
        }
        let element = |index: usize| {
            let at = accessor.byte_offset + index * stride;
            std::array::from_fn(|k| kind.read(&bytes[at + k * kind.size()..]))
        };
        Ok((0..accessor.count).map(element).collect())
    }
}

/// How a number is stored.
#[derive(Clone, Copy)]
enum Component {
    SignedByte { normalized: bool },
    Byte { normalized: bool },
    SignedShort { normalized: bool },
    Short { normalized: bool },
    Int,
    Float,
}

impl Component {
    fn of(accessor: &Accessor) -> Result<Self, String> {
        let normalized = accessor.normalized;
        match accessor.component_type {
            5120 => Ok(Self::SignedByte { normalized }),
            5121 => Ok(Self::Byte { normalized }),
            5122 => Ok(Self::SignedShort { normalized }),
            5123 => Ok(Self::Short { normalized }),
            5125 => Ok(Self::Int),
            5126 => Ok(Self::Float),
            other => Err(format!(
                "expected integers or floats, found component type {other}"
            )),
        }
    }

    fn size(self) -> usize {
        match self {
            Self::SignedByte { .. } | Self::Byte { .. } => 1,
            Self::SignedShort { .. } | Self::Short { .. } => 2,
            Self::Int | Self::Float => 4,
        }
    }

    /// The number at the front of `bytes`, which are enough.
    fn read(self, bytes: &[u8]) -> f64 {
        let scaled = |value: f64, most: f64, normalized: bool| match normalized {
            true => (value / most).max(-1.0),
            false => value,
        };
        match (self, bytes) {
            (Self::SignedByte { normalized }, [a, ..]) => {
                scaled(f64::from(i8::from_le_bytes([*a])), 127.0, normalized)
            }
            (Self::SignedShort { normalized }, [a, b, ..]) => {
                scaled(f64::from(i16::from_le_bytes([*a, *b])), 32767.0, normalized)
            }
            (Self::Byte { normalized }, [a, ..]) => scaled(f64::from(*a), 255.0, normalized),
            (Self::Short { normalized }, [a, b, ..]) => {
                scaled(f64::from(u16::from_le_bytes([*a, *b])), 65535.0, normalized)
            }
            (Self::Int, [a, b, c, d, ..]) => f64::from(u32::from_le_bytes([*a, *b, *c, *d])),
            (Self::Float, [a, b, c, d, ..]) => f64::from(f32::from_le_bytes([*a, *b, *c, *d])),
            _ => 0.0,
        }
    }
}
