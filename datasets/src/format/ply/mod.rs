//! PLY clouds and meshes: ASCII and both endiannesses, any scalar types, lists, unknown properties.

use crate::error::FormatError;
use crate::scene::{Mesh, PointCloud};
use std::io::Write;

/// How a PLY is written.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct PlyOptions {
    /// Positions as `double` instead of `float`.
    pub double: bool,
    /// As text instead of little-endian binary.
    pub ascii: bool,
    /// Lines of `comment` in the header, without line breaks.
    pub comments: Vec<String>,
}

/// A further `float` property of every vertex, e.g. an error, which viewers show as a colour scale.
#[derive(Debug, Clone, Copy)]
pub struct ScalarColumn<'a> {
    /// The property's name: letters, digits, underscores.
    pub name: &'a str,
    /// One value per point.
    pub values: &'a [f32],
}

/// A mesh and what its PLY says about textures.
#[derive(Debug, Clone, PartialEq)]
pub struct PlyMesh {
    /// Polygons are cut into fans of triangles.
    pub mesh: Mesh,
    /// From `comment TextureFile`, in order.
    pub texture_files: Vec<String>,
}

/// Reads the vertices of a PLY: x y z, and where present nx ny nz, red green blue (integers, or
/// floats in 0…1), `views`, `confidence`.
pub fn read_cloud(_bytes: &[u8]) -> Result<PointCloud, FormatError> {
    todo!()
}

/// Reads vertices and faces of a PLY.
pub fn read_mesh(_bytes: &[u8]) -> Result<PlyMesh, FormatError> {
    todo!()
}

/// Writes a cloud with the columns it has, and `scalars` after them.
pub fn write_cloud(
    _out: &mut impl Write,
    _cloud: &PointCloud,
    _scalars: &[ScalarColumn<'_>],
    _options: &PlyOptions,
) -> std::io::Result<()> {
    todo!()
}

/// Writes a mesh: vertices with colours if present, faces with texture coordinates if present.
pub fn write_mesh(
    _out: &mut impl Write,
    _mesh: &Mesh,
    _options: &PlyOptions,
) -> std::io::Result<()> {
    todo!()
}
