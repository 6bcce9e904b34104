//! The pieces of an OBJ file put together.

use super::piece::{Counts, Piece};
use super::{MaterialUse, ObjFile, byte_of_fraction};
use crate::error::FormatError;
use crate::format::polygon::triangulate;
use crate::parallel;
use crate::scene::Corner;
use glam::{DVec3, Vec2};
use std::collections::BTreeMap;

/// What has been read so far.
#[derive(Default)]
pub(super) struct Assembly {
    file: ObjFile,
    lines: usize,
    /// Colours as written, of the vertices up to the last that has one.
    colors: Vec<Option<[f64; 3]>>,
    coords: Vec<Vec2>,
    /// Name after the last `usemtl`.
    material: String,
    /// Where each material stands in the file's list.
    slots: BTreeMap<MaterialUse, u32>,
}

impl Assembly {
    /// What stands before the next piece.
    pub(super) fn counts(&self) -> Counts {
        Counts {
            lines: self.lines,
            vertices: self.file.vertices.len(),
            coords: self.coords.len(),
        }
    }

    /// Adds pieces in their order, up to the first in which something is wrong.
    pub(super) fn add(
        &mut self,
        pieces: Vec<Result<Piece, FormatError>>,
        threads: usize,
    ) -> Result<(), FormatError> {
        let mut placed = Vec::with_capacity(pieces.len());
        for piece in pieces {
            let mut piece = piece?;
            self.take(&mut piece);
            let slots = self.slots_of(&piece);
            placed.push((piece, slots));
        }
        let (vertices, coords) = (&self.file.vertices, &self.coords);
        let all = parallel::map(&placed, threads, |(piece, slots)| {
            Triangles::of(piece, slots, (vertices, coords))
        });
        for triangles in all {
            self.file.triangles.extend(triangles.vertices);
            self.file.texture_coords.extend(triangles.coords);
            self.file.triangle_materials.extend(triangles.materials);
        }
        Ok(())
    }

    /// Takes over everything but the faces.
    fn take(&mut self, piece: &mut Piece) {
        if !piece.colors.is_empty() {
            self.colors.resize(self.file.vertices.len(), None);
            self.colors.append(&mut piece.colors);
        }
        self.file.vertices.append(&mut piece.vertices);
        self.coords.append(&mut piece.coords);
        self.file.libraries.append(&mut piece.libraries);
        self.file.skipped_faces += piece.skipped_faces;
        self.file.lost_coords += piece.lost_coords;
        self.lines += piece.lines;
    }

    /// Where the piece's materials stand in the file's list.
    fn slots_of(&mut self, piece: &Piece) -> Vec<u32> {
        let mut slots = Vec::with_capacity(piece.materials.len());
        for used in &piece.materials {
            let used = MaterialUse {
                name: used.name.as_ref().unwrap_or(&self.material).clone(),
                textured: used.textured,
            };
            let next = u32::try_from(self.file.materials.len()).unwrap_or(u32::MAX);
            let slot = *self.slots.entry(used.clone()).or_insert(next);
            if slot == next {
                self.file.materials.push(used);
            }
            slots.push(slot);
        }
        if let Some(material) = &piece.material {
            self.material.clone_from(material);
        }
        slots
    }

    pub(super) fn finish(mut self) -> ObjFile {
        if !self.colors.is_empty() {
            self.colors.resize(self.file.vertices.len(), None);
            let largest = self
                .colors
                .iter()
                .flatten()
                .flatten()
                .fold(0.0f64, |m, &c| m.max(c));
            // A little above 1 is white by rounding, and no fraction of 255.
            let unit = if largest > 2.0 { 255.0 } else { 1.0 };
            let byte = |color: Option<[f64; 3]>| {
                color.map(|channels| channels.map(|value| byte_of_fraction(value / unit)))
            };
            self.file.vertex_colors = Some(self.colors.into_iter().map(byte).collect());
        }
        self.file
    }
}

/// A piece's faces as triangles.
struct Triangles {
    vertices: Vec<[u32; 3]>,
    coords: Vec<Corner>,
    materials: Vec<u32>,
}

impl Triangles {
    /// All vertices and texture coordinates up to the piece's last are known.
    fn of(piece: &Piece, slots: &[u32], (vertices, coords): (&[DVec3], &[Vec2])) -> Self {
        let mut triangles = Self {
            vertices: Vec::with_capacity(piece.faces.len()),
            coords: Vec::with_capacity(piece.faces.len()),
            materials: Vec::with_capacity(piece.faces.len()),
        };
        let mut left = piece.corners.as_slice();
        for face in &piece.faces {
            let (corners, rest) = left.split_at(face.corners as usize);
            left = rest;
            let textured = piece.materials[face.slot as usize].textured;
            let slot = slots[face.slot as usize];
            let coord = |corner: usize| {
                let index = corners[corner].1.filter(|_| textured);
                index.map_or(Vec2::ZERO, |index| coords[index as usize])
            };
            let mut push = |three: [usize; 3]| {
                triangles
                    .vertices
                    .push(three.map(|corner| corners[corner].0));
                triangles.coords.push(three.map(coord));
                triangles.materials.push(slot);
            };
            if corners.len() == 3 {
                push([0, 1, 2]);
                continue;
            }
            let position = |&(vertex, _): &(u32, _)| vertices[vertex as usize];
            let outline: Vec<DVec3> = corners.iter().map(position).collect();
            triangulate(&outline).into_iter().for_each(push);
        }
        triangles
    }
}
