//! A piece of an OBJ file, read without what stands before it but for how much that is.

use super::quick;
use super::text::{fields, index, lines, number, rest_of_line};
use crate::error::FormatError;
use glam::{DVec3, Vec2};
use std::collections::BTreeMap;

/// How much of what a face can name stands in some lines.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) struct Counts {
    pub(super) lines: usize,
    pub(super) vertices: usize,
    pub(super) coords: usize,
}

impl Counts {
    /// Those of a piece in which nothing is wrong.
    pub(super) fn of(text: &[u8]) -> Self {
        let mut counts = Self::default();
        for (_, line) in lines(text) {
            match fields(&line).next().unwrap_or_default() {
                b"v" => counts.vertices += 1,
                b"vt" => counts.coords += 1,
                _ => {}
            }
        }
        counts.lines = text.iter().filter(|&&byte| byte == b'\n').count();
        counts
    }

    pub(super) fn plus(self, other: Self) -> Self {
        Self {
            lines: self.lines + other.lines,
            vertices: self.vertices + other.vertices,
            coords: self.coords + other.coords,
        }
    }
}

/// A face, whose corners stand one after another.
#[derive(Debug, Clone, Copy)]
pub(super) struct Face {
    pub(super) corners: u32,
    /// Index into [`Piece::materials`].
    pub(super) slot: u32,
}

/// A material as faces of a piece use it.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct LocalUse {
    /// `None` for the one of the last face before the piece.
    pub(super) name: Option<String>,
    pub(super) textured: bool,
}

/// What stands in a piece.
#[derive(Debug, Default)]
pub(super) struct Piece {
    before: Counts,
    pub(super) lines: usize,
    pub(super) vertices: Vec<DVec3>,
    /// Colours as written, of the vertices up to the last that has one.
    pub(super) colors: Vec<Option<[f64; 3]>>,
    pub(super) coords: Vec<Vec2>,
    /// Of all faces: indices of positions and texture coordinates in the file.
    pub(super) corners: Vec<(u32, Option<u32>)>,
    pub(super) faces: Vec<Face>,
    /// In order of first use.
    pub(super) materials: Vec<LocalUse>,
    /// After the last `usemtl`, if there is one.
    pub(super) material: Option<String>,
    /// Where each material stands in the list.
    slots: BTreeMap<LocalUse, u32>,
    /// Slots of the current material without and with texture coordinates.
    current: [Option<u32>; 2],
    pub(super) libraries: Vec<String>,
    pub(super) skipped_faces: usize,
    pub(super) lost_coords: usize,
}

impl Piece {
    /// Reads a piece that stands behind so much.
    pub(super) fn read(text: &[u8], before: Counts) -> Result<Self, FormatError> {
        let mut piece = Self {
            before,
            ..Self::default()
        };
        let mut lines = lines(text);
        loop {
            while let Some(behind) = piece.quick(lines.rest()) {
                lines.pass(behind);
            }
            let Some((number, line)) = lines.next() else {
                break;
            };
            piece.statement(&line).map_err(|problem| {
                FormatError::new(format!("line {}", before.lines + number), problem)
            })?;
        }
        piece.lines = text.iter().filter(|&&byte| byte == b'\n').count();
        Ok(piece)
    }

    /// Reads the line that `text` begins with, if it is a plain one, and returns what stands behind it.
    #[inline(always)]
    fn quick<'t>(&mut self, text: &'t [u8]) -> Option<&'t [u8]> {
        match text {
            [b'v', b' ', ..] => {
                let (at, behind) = quick::vertex(text)?;
                self.vertices.push(at.into());
                Some(behind)
            }
            [b'v', b't', ..] => {
                let (at, behind) = quick::coord(text)?;
                self.coords.push(coord_of(at));
                Some(behind)
            }
            [b'f', b' ', ..] => {
                let first = self.corners.len();
                let behind = quick::face(text, self.counts(), &mut self.corners);
                if behind.is_none() || self.corners.len() < first + 3 {
                    self.corners.truncate(first);
                    return None;
                }
                self.close_face(first);
                behind
            }
            _ => None,
        }
    }

    /// How many vertices and texture coordinates stand before what is read.
    fn counts(&self) -> (usize, usize) {
        (
            self.before.vertices + self.vertices.len(),
            self.before.coords + self.coords.len(),
        )
    }

    fn statement(&mut self, line: &[u8]) -> Result<(), String> {
        let mut words = fields(line);
        match words.next().unwrap_or_default() {
            b"v" => self.vertex(words),
            b"vt" => self.coord(words),
            b"f" | b"fo" => self.face(words),
            b"usemtl" => {
                self.material = Some(rest_of_line(line));
                self.current = [None; 2];
                Ok(())
            }
            b"mtllib" => {
                self.libraries.push(rest_of_line(line));
                Ok(())
            }
            _ => Ok(()),
        }
    }

    /// `v x y z`, `v x y z w`, `v x y z r g b`, `v x y z r g b a`; the weight has no meaning for
    /// polygons, and the opacity none for vertices.
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
            let color = [values[3], values[4], values[5]];
            self.colors.resize(self.vertices.len(), None);
            self.colors.push(Some(color));
        }
        self.vertices
            .push(DVec3::new(values[0], values[1], values[2]));
        Ok(())
    }

    fn coord<'a>(&mut self, mut words: impl Iterator<Item = &'a [u8]>) -> Result<(), String> {
        let first = words
            .next()
            .ok_or("expected `vt` and a number, found none")?;
        let second = words.next().map_or(Ok(0.0), number)?;
        self.coords.push(coord_of([number(first)?, second]));
        Ok(())
    }

    fn face<'a>(&mut self, words: impl Iterator<Item = &'a [u8]>) -> Result<(), String> {
        let (vertices, coords) = self.counts();
        let first = self.corners.len();
        for word in words {
            let mut parts = word.split(|&byte| byte == b'/');
            let vertex = index(parts.next().unwrap_or_default(), vertices, "vertex")?;
            let coord = match parts.next().unwrap_or_default() {
                b"" => None,
                _ if coords == 0 => {
                    self.lost_coords += 1;
                    None
                }
                part => Some(index(part, coords, "texture coordinate")?),
            };
            self.corners.push((vertex, coord));
        }
        if self.corners.len() < first + 3 {
            self.skipped_faces += 1;
            self.corners.truncate(first);
            return Ok(());
        }
        self.close_face(first);
        Ok(())
    }

    /// Makes a face of the corners from `first` on.
    fn close_face(&mut self, first: usize) {
        let face = &self.corners[first..];
        let corners = u32::try_from(face.len()).unwrap_or(u32::MAX);
        let textured = face.iter().all(|(_, coord)| coord.is_some());
        let slot = self.slot(textured);
        self.faces.push(Face { corners, slot });
    }

    /// Where the current material stands in the list, for faces with or without texture coordinates.
    fn slot(&mut self, textured: bool) -> u32 {
        if let Some(slot) = self.current[usize::from(textured)] {
            return slot;
        }
        let name = self.material.clone();
        let used = LocalUse { name, textured };
        let next = u32::try_from(self.materials.len()).unwrap_or(u32::MAX);
        let slot = *self.slots.entry(used.clone()).or_insert(next);
        if slot == next {
            self.materials.push(used);
        }
        self.current[usize::from(textured)] = Some(slot);
        slot
    }
}

fn coord_of([x, y]: [f64; 2]) -> Vec2 {
    #[allow(
        clippy::cast_possible_truncation,
        reason = "texture coordinates are f32"
    )]
    Vec2::new(x as f32, y as f32)
}
