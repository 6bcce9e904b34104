//! OBJ: vertices, faces, texture coordinates, and the names of materials.
//!
//! An own reader, because the general ones lose what a renderer needs: which faces have texture
//! coordinates at all, concave polygons, several material libraries on one line, line numbers.

use super::polygon::triangulate;
use crate::error::FormatError;
use crate::scene::{Corner, Material};
use glam::{DVec3, Vec2};
use std::borrow::Cow;
use std::collections::BTreeMap;

/// An OBJ file's geometry and what it says about materials.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ObjFile {
    /// Positions in world units.
    pub vertices: Vec<DVec3>,
    /// 8-bit sRGB per vertex, if any vertex has a colour.
    pub vertex_colors: Option<Vec<[u8; 3]>>,
    /// Polygons are cut into triangles; concave ones properly.
    pub triangles: Vec<[u32; 3]>,
    /// Texture coordinates of each triangle; zeros where it has none.
    pub texture_coords: Vec<Corner>,
    /// Index into `materials` of each triangle.
    pub triangle_materials: Vec<u32>,
    /// What the triangles are made of, in order of first use.
    pub materials: Vec<MaterialUse>,
    /// What stands after each `mtllib`: one file name, with or without spaces, or several.
    pub libraries: Vec<String>,
    /// Faces with fewer than three corners, which are left out.
    pub skipped_faces: usize,
    /// Face corners that name a texture coordinate before the file has any: taken as without.
    pub lost_coords: usize,
}

/// A material as faces use it.
#[derive(Debug, Clone, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct MaterialUse {
    /// After `usemtl`; empty for faces before the first.
    pub name: String,
    /// Whether these faces have texture coordinates.
    pub textured: bool,
}

/// Reads an OBJ file. Lines, points, curves, normals, groups and objects are skipped.
pub fn read_obj(bytes: &[u8]) -> Result<ObjFile, FormatError> {
    let mut reader = Reader::default();
    for (number, line) in lines(bytes)? {
        reader
            .statement(&line)
            .map_err(|problem| FormatError::new(format!("line {number}"), problem))?;
    }
    Ok(reader.finish())
}

/// What has been read so far.
#[derive(Default)]
struct Reader {
    file: ObjFile,
    /// Colours as written, of the vertices up to the last that has one.
    colors: Vec<Option<[f64; 3]>>,
    coords: Vec<Vec2>,
    /// Name after the last `usemtl`.
    material: String,
    /// Where each material stands in the file's list.
    slots: BTreeMap<MaterialUse, u32>,
    /// Slots of the current material without and with texture coordinates.
    current: [Option<u32>; 2],
    /// The face being read: indices of positions and texture coordinates.
    face: Vec<(u32, Option<u32>)>,
}

impl Reader {
    fn statement(&mut self, line: &[u8]) -> Result<(), String> {
        let mut words = fields(line);
        match words.next().unwrap_or_default() {
            b"v" => self.vertex(words),
            b"vt" => self.coord(words),
            b"f" | b"fo" => self.face(words),
            b"usemtl" => {
                self.material = rest_of_line(line);
                self.current = [None; 2];
                Ok(())
            }
            b"mtllib" => {
                self.file.libraries.push(rest_of_line(line));
                Ok(())
            }
            _ => Ok(()),
        }
    }

    /// `v x y z`, `v x y z w`, `v x y z r g b`, `v x y z w r g b`; the weight has no meaning for
    /// polygons.
    fn vertex<'a>(&mut self, words: impl Iterator<Item = &'a [u8]>) -> Result<(), String> {
        let mut values = [0.0; 7];
        let mut count = 0;
        for (value, word) in values.iter_mut().zip(words) {
            *value = number(word)?;
            count += 1;
        }
        if count < 3 {
            return Err(format!("expected `v` and three numbers, found {count}"));
        }
        if count >= 6 {
            let color = [values[count - 3], values[count - 2], values[count - 1]];
            self.colors.resize(self.file.vertices.len(), None);
            self.colors.push(Some(color));
        }
        self.file
            .vertices
            .push(DVec3::new(values[0], values[1], values[2]));
        Ok(())
    }

    fn coord<'a>(&mut self, mut words: impl Iterator<Item = &'a [u8]>) -> Result<(), String> {
        let first = words
            .next()
            .ok_or("expected `vt` and a number, found none")?;
        let second = words.next().map_or(Ok(0.0), number)?;
        #[allow(
            clippy::cast_possible_truncation,
            reason = "texture coordinates are f32"
        )]
        self.coords
            .push(Vec2::new(number(first)? as f32, second as f32));
        Ok(())
    }

    fn face<'a>(&mut self, words: impl Iterator<Item = &'a [u8]>) -> Result<(), String> {
        let mut face = std::mem::take(&mut self.face);
        face.clear();
        for word in words {
            let mut parts = word.split(|&byte| byte == b'/');
            let vertex = parts.next().unwrap_or_default();
            let vertex = index(vertex, self.file.vertices.len(), "vertex")?;
            let coord = match parts.next().unwrap_or_default() {
                b"" => None,
                _ if self.coords.is_empty() => {
                    self.file.lost_coords += 1;
                    None
                }
                part => Some(index(part, self.coords.len(), "texture coordinate")?),
            };
            face.push((vertex, coord));
        }
        if face.len() < 3 {
            self.file.skipped_faces += 1;
        } else {
            self.add(&face);
        }
        self.face = face;
        Ok(())
    }

    fn add(&mut self, face: &[(u32, Option<u32>)]) {
        let textured = face.iter().all(|(_, coord)| coord.is_some());
        let slot = self.slot(textured);
        let coord = |corner: usize| {
            let index = face[corner].1.filter(|_| textured);
            index.map_or(Vec2::ZERO, |index| self.coords[index as usize])
        };
        let mut push = |corners: [usize; 3]| {
            self.file
                .triangles
                .push(corners.map(|corner| face[corner].0));
            self.file.texture_coords.push(corners.map(coord));
            self.file.triangle_materials.push(slot);
        };
        if face.len() == 3 {
            return push([0, 1, 2]);
        }
        let position = |&(vertex, _): &(u32, _)| self.file.vertices[vertex as usize];
        let outline: Vec<DVec3> = face.iter().map(position).collect();
        triangulate(&outline).into_iter().for_each(push);
    }

    /// Where the current material stands in the file's list, for faces with or without texture
    /// coordinates.
    fn slot(&mut self, textured: bool) -> u32 {
        if let Some(slot) = self.current[usize::from(textured)] {
            return slot;
        }
        let name = self.material.clone();
        let used = MaterialUse { name, textured };
        let next = u32::try_from(self.file.materials.len()).unwrap_or(u32::MAX);
        let slot = *self.slots.entry(used.clone()).or_insert(next);
        if slot == next {
            self.file.materials.push(used);
        }
        self.current[usize::from(textured)] = Some(slot);
        slot
    }

    fn finish(mut self) -> ObjFile {
        if !self.colors.is_empty() {
            self.colors.resize(self.file.vertices.len(), None);
            let largest = self
                .colors
                .iter()
                .flatten()
                .flatten()
                .fold(0.0f64, |m, &c| m.max(c));
            let unit = if largest > 1.0 { 255.0 } else { 1.0 };
            let byte = |color: Option<[f64; 3]>| {
                color.map_or(Material::default().color, |c| {
                    c.map(|v| byte_of_fraction(v / unit))
                })
            };
            self.file.vertex_colors = Some(self.colors.into_iter().map(byte).collect());
        }
        self.file
    }
}

/// A colour channel in 0…1 as 8 bits.
pub(super) fn byte_of_fraction(value: f64) -> u8 {
    #[allow(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "clamped; NaN becomes 0"
    )]
    let byte = (value.clamp(0.0, 1.0) * 255.0).round() as u8;
    byte
}

fn number(word: &[u8]) -> Result<f64, String> {
    let value = std::str::from_utf8(word)
        .ok()
        .and_then(|word| word.parse().ok());
    value
        .filter(|value: &f64| value.is_finite())
        .ok_or_else(|| format!("expected a finite number, found {:?}", shown(word)))
}

/// An index of a face, counted from 1 or, negative, from the end.
fn index(word: &[u8], count: usize, what: &str) -> Result<u32, String> {
    let stated = std::str::from_utf8(word)
        .ok()
        .and_then(|word| word.parse::<i64>().ok());
    let limit = i64::try_from(count).unwrap_or(i64::MAX);
    let zero_based = match stated {
        Some(stated) if 0 < stated && stated <= limit => Some(stated - 1),
        Some(stated) if stated < 0 && -stated <= limit => Some(limit + stated),
        _ => None,
    };
    zero_based
        .and_then(|index| u32::try_from(index).ok())
        .ok_or_else(|| {
            let known = if count == 0 {
                "none are defined before this line".to_owned()
            } else {
                format!("1 to {count} or -{count} to -1 are defined before this line")
            };
            format!(
                "expected the index of a {what} ({known}), found {:?}",
                shown(word)
            )
        })
}

/// The beginning of a word, for a message.
fn shown(word: &[u8]) -> Cow<'_, str> {
    String::from_utf8_lossy(&word[..word.len().min(40)])
}

/// Words of a line, without a comment.
pub(super) fn fields(line: &[u8]) -> impl Iterator<Item = &[u8]> {
    line.split(u8::is_ascii_whitespace)
        .filter(|word| !word.is_empty())
        .take_while(|word| !word.starts_with(b"#"))
}

/// What stands after the first word, without spaces around it.
pub(super) fn rest_of_line(line: &[u8]) -> String {
    let line = line.trim_ascii();
    let end = line
        .iter()
        .position(u8::is_ascii_whitespace)
        .unwrap_or(line.len());
    String::from_utf8_lossy(line[end..].trim_ascii()).into_owned()
}

/// Lines with their numbers from 1. Lines but comments that end in a backslash are joined with the
/// next.
pub(super) fn lines(
    bytes: &[u8],
) -> Result<impl Iterator<Item = (usize, Cow<'_, [u8]>)>, FormatError> {
    let utf16 = bytes.starts_with(&[0xff, 0xfe]) || bytes.starts_with(&[0xfe, 0xff]);
    if utf16 || bytes[..bytes.len().min(1024)].contains(&0) {
        let found = if utf16 { "UTF-16" } else { "zero bytes" };
        let problem = format!("expected plain text, found {found}: save the file as UTF-8");
        return Err(FormatError::new("byte 0", problem));
    }
    let text = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
    let mut raw = text.split(|&byte| byte == b'\n').enumerate();
    Ok(std::iter::from_fn(move || {
        let (index, first) = raw.next()?;
        let mut line = Cow::Borrowed(first);
        if first.trim_ascii_start().starts_with(b"#") {
            return Some((index + 1, line));
        }
        while let Some(front) = line.trim_ascii_end().strip_suffix(b"\\") {
            let mut joined = front.to_vec();
            joined.push(b' ');
            let Some((_, next)) = raw.next() else {
                return Some((index + 1, Cow::Owned(joined)));
            };
            joined.extend_from_slice(next);
            line = Cow::Owned(joined);
        }
        Some((index + 1, line))
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    const TRIANGLE: &str = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\n";

    fn read(text: &str) -> ObjFile {
        read_obj(text.as_bytes()).unwrap()
    }

    fn complaint(text: &str) -> String {
        read_obj(format!("{TRIANGLE}{text}").as_bytes())
            .unwrap_err()
            .to_string()
    }

    #[test]
    fn indices_count_from_both_ends() {
        let file = read(&format!(
            "{TRIANGLE}f 1/1 2/2 3/3\nf -3/-3/1 -2/-2/1 -1/-1/1"
        ));
        assert_eq!(file.triangles, [[0, 1, 2]; 2]);
        assert_eq!(file.texture_coords, [[Vec2::ZERO, Vec2::X, Vec2::Y]; 2]);
        assert_eq!(
            file.materials,
            [MaterialUse {
                name: String::new(),
                textured: true
            }]
        );
    }

    #[test]
    fn wrong_indices_say_what_is_there() {
        let error = complaint("f 1 2 4");
        assert!(
            error.contains("line 7") && error.contains("1 to 3") && error.contains("\"4\""),
            "{error}"
        );
        for wrong in [
            "f 0 1 2",
            "f 1 2 -4",
            "f 1/4 2/1 3/1",
            "f 1.5 2 3",
            "f a b c",
            "f 1 2 99999999999999999999",
        ] {
            assert!(
                complaint(wrong).starts_with("line 7: expected the index"),
                "{wrong}"
            );
        }
        assert!(
            read_obj(b"f 1 2 3")
                .unwrap_err()
                .to_string()
                .contains("none are defined")
        );
    }

    #[test]
    fn materials_follow_their_faces() {
        let file = read(&format!(
            "mtllib a b.mtl\n{TRIANGLE}f 1 2 3\nusemtl  red \ng x\nf 1/1 2/2 3/3\nf 1 2 3\n\
             usemtl blue\no y\nf 1/1 2/2 3/3\nusemtl red\nf 3/1 2/2 1/3"
        ));
        let used: Vec<(&str, bool)> = file
            .materials
            .iter()
            .map(|m| (m.name.as_str(), m.textured))
            .collect();
        assert_eq!(
            used,
            [("", false), ("red", true), ("red", false), ("blue", true)]
        );
        assert_eq!(file.triangle_materials, [0, 1, 2, 3, 1]);
        assert_eq!(file.libraries, ["a b.mtl"]);
    }

    #[test]
    fn vertices_may_have_weights_and_colours() {
        let file = read("v 1 2 3 0.5\nv 1 2 3 1 0.5 0\nv 1 2 3\n");
        assert_eq!(
            file.vertex_colors.unwrap(),
            [[200; 3], [255, 128, 0], [200; 3]]
        );
        assert_eq!(
            read("v 1 2 3 255 128 0").vertex_colors.unwrap(),
            [[255, 128, 0]]
        );
        assert_eq!(
            read("v 1 2 3 1 0 0 1").vertex_colors.unwrap(),
            [[0, 0, 255]]
        );
        assert_eq!(read(TRIANGLE).vertex_colors, None);
    }

    #[test]
    fn text_may_be_untidy() {
        let file =
            read("\u{feff}v 0 0 0 # origin\r\n\tv +1. .5e0 -0\r\nv 0 \\\r\n1 0\r\nf 1 2\\\n 3");
        assert_eq!(
            file.vertices,
            [DVec3::ZERO, DVec3::new(1.0, 0.5, -0.0), DVec3::Y]
        );
        assert_eq!(file.triangles.len(), 1);
    }

    #[test]
    fn numbers_are_finite() {
        for wrong in [
            "v nan 0 0",
            "v 0 inf 0",
            "v 0 0 1.#IND",
            "v 1 2",
            "vt",
            "vt x",
        ] {
            assert!(complaint(wrong).starts_with("line 7: expected"), "{wrong}");
        }
    }

    #[test]
    fn utf16_is_named() {
        let utf16: Vec<u8> = "v 0 0 0"
            .encode_utf16()
            .flat_map(u16::to_be_bytes)
            .collect();
        assert!(read_obj(&utf16).unwrap_err().to_string().contains("UTF-8"));
        assert!(
            read_obj(b"\xff\xfev\0")
                .unwrap_err()
                .to_string()
                .contains("UTF-16")
        );
    }

    #[test]
    fn faces_without_area_of_corners_are_counted() {
        assert_eq!(
            read(&format!("{TRIANGLE}f 1\nf 1 2\nf 1 2 3")).skipped_faces,
            2
        );
    }
}
