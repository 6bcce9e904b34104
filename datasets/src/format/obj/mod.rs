//! OBJ: vertices, faces, texture coordinates, and the names of materials.
//!
//! An own reader, because the general ones lose what a renderer needs: which faces have texture
//! coordinates at all, concave polygons, several material libraries on one line, line numbers.

mod assembly;
mod piece;
mod quick;
#[cfg(test)]
mod tests;
mod text;

use crate::error::FormatError;
use crate::parallel;
use crate::scene::Corner;
use assembly::Assembly;
use glam::DVec3;
use piece::{Counts, Piece};
pub(super) use text::{fields, lines, plain, rest_of_line};

/// An OBJ file's geometry and what it says about materials.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ObjFile {
    /// Positions in world units.
    pub vertices: Vec<DVec3>,
    /// 8-bit sRGB of each vertex that has a colour, if any has: numbers up to 1 are fractions, else all of the file
    /// count up to 255.
    pub vertex_colors: Option<Vec<Option<[u8; 3]>>>,
    /// Polygons are cut into triangles; concave ones of up to 16384 corners properly.
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

/// Bytes of text that one thread takes at a time, and how many of these are read before they are put
/// together, for each thread. What is kept beside the result is a few times as much.
const PIECE: usize = 1 << 20;
const PIECES: usize = 4;

/// [`read_obj_with`] on one thread.
///
/// # Errors
/// As [`read_obj_with`].
pub fn read_obj(bytes: &[u8]) -> Result<ObjFile, FormatError> {
    read_obj_with(bytes, 1)
}

/// Reads an OBJ file on several threads; the result does not depend on how many. Lines, points, curves,
/// normals, groups and objects are skipped.
///
/// # Errors
/// UTF-16, zero bytes in the first 1024, and, naming the line, numbers of `v` and `vt` that are missing or not finite
/// and indices of faces that nothing before the line has (but see [`ObjFile::lost_coords`]).
pub fn read_obj_with(bytes: &[u8], threads: usize) -> Result<ObjFile, FormatError> {
    read_in_pieces(&plain(bytes)?, PIECE, threads)
}

/// Reads some pieces at a time, side by side: what stands before each is counted first, so that each is
/// read as if all before it had been.
fn read_in_pieces(text: &[u8], size: usize, threads: usize) -> Result<ObjFile, FormatError> {
    let mut assembly = Assembly::default();
    let mut pieces = text::pieces(text, size);
    let at_a_time = if threads > 1 { PIECES * threads } else { 1 };
    loop {
        let some: Vec<&[u8]> = pieces.by_ref().take(at_a_time).collect();
        let Some((_, all_but_last)) = some.split_last() else {
            return Ok(assembly.finish());
        };
        let counts = parallel::map(all_but_last, threads, |piece| Counts::of(piece));
        let mut before = assembly.counts();
        let mut starts = vec![before];
        for counts in counts {
            before = before.plus(counts);
            starts.push(before);
        }
        let placed: Vec<(&[u8], Counts)> = some.into_iter().zip(starts).collect();
        let read = parallel::map(&placed, threads, |(text, before)| {
            Piece::read(text, *before)
        });
        assembly.add(read, threads)?;
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
