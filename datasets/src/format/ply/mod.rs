//! PLY clouds and meshes: ASCII and both endiannesses, any scalar types, lists, unknown properties.

mod body;
mod faces;
mod header;
pub mod stream;
mod table;
mod vertices;
mod write;

use crate::error::FormatError;
use crate::scene::{Material, Mesh, PointCloud};
use body::Body;
use faces::Faces;
use glam::DVec3;
use header::Header;
use ply_rs_bw::ply::ElementDef;
use std::io::Write;
use table::Table;

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
    /// Polygons are cut into triangles; concave ones of up to 16384 corners properly. There is one material per
    /// texture file, in order and of its name; its texture itself is for the caller to read. A last one without a
    /// texture is that of triangles that have none, where there are such.
    pub mesh: Mesh,
    /// Triangles of that last material: their texture number is below 0, or they have no texture coordinates.
    pub untextured: usize,
    /// From `comment TextureFile` (in any case), in order.
    pub texture_files: Vec<String>,
    /// Whether faces have colours (red green blue), which are not read.
    pub face_colors: bool,
    /// Triangle strips (`tristrips`), which are not read.
    pub strips: usize,
}

/// What a PLY's header promises, e.g. to tell a mesh from a cloud.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PlySummary {
    /// Number of vertices.
    pub vertices: usize,
    /// Number of faces.
    pub faces: usize,
}

/// Reads the header alone. The counts are as stated: the file may be cut short.
///
/// # Errors
/// No PLY, and a header without an end or a format, with a line that is not understood, or with a second element
/// `vertex` or `face`.
pub fn read_summary(bytes: &[u8]) -> Result<PlySummary, FormatError> {
    let header = header::read(bytes)?;
    let count = |name| header.element(name).map_or(0, |element| element.count);
    Ok(PlySummary {
        vertices: count("vertex"),
        faces: count("face"),
    })
}

/// Reads the vertices of a PLY: x y z, and where present nx ny nz, red green blue or r g b (integers, or
/// floats up to 1 or up to 255), `views`, `confidence`. Names are taken in any case, everything else is skipped;
/// positions may be NaN, colours that are NaN are black. A file with no vertices gives an empty cloud.
///
/// # Errors
/// As [`read_summary`]; no element `vertex` with x, y and z, a file that is cut short or, where vertices are the
/// last, goes on after all that its header states, lines that do not fit the header, and colours outside black and
/// white.
pub fn read_cloud(bytes: &[u8]) -> Result<PointCloud, FormatError> {
    vertices::cloud(&table_of_cloud(bytes)?)
}

/// As [`read_cloud`], the positions alone: what else the points have is not looked at.
///
/// # Errors
/// As [`read_cloud`], but for colours.
pub fn read_positions(bytes: &[u8]) -> Result<Vec<DVec3>, FormatError> {
    vertices::positions(&table_of_cloud(bytes)?)
}

fn table_of_cloud(bytes: &[u8]) -> Result<Table<'_>, FormatError> {
    let header = header::read(bytes)?;
    let mut body = Body::new(bytes, &header);
    let table = vertices::take(&header, &mut body)?;
    // Faces and the like may come after the points; what they hold is not looked at.
    let last = header.elements.iter().rfind(|element| element.count > 0);
    if last.is_none_or(|element| element.name == "vertex") {
        body.check_end()?;
    }
    Ok(table)
}

/// Reads vertices and faces of a PLY, in whatever order. Texture coordinates are those of the face (`texcoord`), else
/// of its vertices (s t, u v, texture_u texture_v or texture_s texture_t).
///
/// # Errors
/// As [`read_cloud`]; no faces of three corners or more, faces without a list of indices or with an index beyond the
/// vertices, texture coordinates that are not two per corner, texture numbers beyond the files, vertices that are not
/// finite, and a file that goes on after all that its header states.
pub fn read_mesh(bytes: &[u8]) -> Result<PlyMesh, FormatError> {
    let header = header::read(bytes)?;
    let mut body = Body::new(bytes, &header);
    let (mut vertices, mut faces) = (None, None);
    for element in &header.elements {
        match element.name.as_str() {
            "vertex" => vertices = Some(body.take_table(element)?),
            "face" => {
                let count = header.element("vertex").map_or(0, |vertex| vertex.count);
                faces = Some(faces::take(element, &mut body, count)?);
            }
            _ => body.skip(element)?,
        }
    }
    body.check_end()?;
    let (Some(table), Some(faces)) = (vertices, faces) else {
        return Err(no_mesh(&header));
    };
    if faces.triangles.is_empty() {
        return Err(no_mesh(&header));
    }
    let texture_files = texture_files(&header);
    let colored = |face: &ElementDef| face.properties.contains_key("red");
    let (mesh, untextured) = mesh_of(&table, faces, &texture_files)?;
    Ok(PlyMesh {
        face_colors: header.element("face").is_some_and(colored),
        strips: header.element("tristrips").map_or(0, |strips| strips.count),
        mesh,
        untextured,
        texture_files,
    })
}

fn no_mesh(header: &Header) -> FormatError {
    let count = |name| header.element(name).map_or(0, |element| element.count);
    let others = header.elements.iter().filter(|element| element.count > 0);
    let others = others.filter(|element| !matches!(element.name.as_str(), "vertex" | "face"));
    let others: Vec<String> = others
        .map(|element| format!("{} of `{}`", element.count, element.name))
        .collect();
    let rest = match (count("face"), others.is_empty()) {
        (0, true) => ": a cloud is no mesh".to_owned(),
        (0, false) => format!(
            " but {}, which are not read: a mesh has its triangles as the element `face`",
            others.join(", ")
        ),
        (faces, _) => format!(" of three corners or more among {faces}"),
    };
    let problem = format!(
        "expected the elements vertex and face, found {} vertices and no faces{rest}",
        count("vertex")
    );
    FormatError::new("header", problem)
}

fn texture_files(header: &Header) -> Vec<String> {
    let comments = header.comments.iter();
    let names = comments.filter_map(|text| {
        let (word, name) = text.split_once(char::is_whitespace)?;
        word.eq_ignore_ascii_case("TextureFile").then_some(name)
    });
    names.map(|name| name.trim().to_owned()).collect()
}

/// The mesh, and how many of its triangles have no texture where others have one.
fn mesh_of(
    table: &table::Table<'_>,
    mut faces: Faces,
    texture_files: &[String],
) -> Result<(Mesh, usize), FormatError> {
    let wrong = || FormatError::at("elements vertex and face");
    let positions = vertices::positions(table)?;
    faces.cut(&positions);
    let coords = faces.take_coords(vertices::texture_coords(table).as_deref());
    let mut mesh = Mesh::new(positions, faces.triangles).map_err(wrong())?;
    if let Some(coords) = coords {
        mesh = mesh.with_texture_coords(coords).map_err(wrong())?;
    }
    if let Some(colors) = vertices::colors(table)? {
        mesh = mesh.with_vertex_colors(colors).map_err(wrong())?;
    }
    if texture_files.is_empty() {
        return Ok((mesh, 0));
    }
    let mut materials: Vec<Material> = (texture_files.iter())
        .map(|name| Material {
            name: name.clone(),
            ..Material::default()
        })
        .collect();
    let last = materials.len() as u32;
    let mut numbers = faces.texture_numbers;
    let beyond = |&&number: &&u32| number != faces::NO_NUMBER && number >= last;
    if let Some(number) = numbers.iter().flatten().find(beyond) {
        let problem = format!(
            "expected a texnumber below {last}, the number of its comments TextureFile, found {number}"
        );
        return Err(FormatError::new("element face", problem));
    }
    let mut untextured = 0;
    let none = numbers
        .iter_mut()
        .flatten()
        .filter(|number| **number == faces::NO_NUMBER);
    for number in none {
        (*number, untextured) = (last, untextured + 1);
    }
    if untextured > 0 {
        materials.push(Material::default());
    }
    let mesh = mesh.with_materials(materials, numbers).map_err(wrong())?;
    Ok((mesh, untextured))
}

/// Writes a cloud with the columns it has, and `scalars` after them.
///
/// # Errors
/// Scalars of another length, with an impossible name or one that is there already
/// ([`std::io::ErrorKind::InvalidInput`]), and what writing to `out` brings.
pub fn write_cloud(
    out: &mut impl Write,
    cloud: &PointCloud,
    scalars: &[ScalarColumn<'_>],
    options: &PlyOptions,
) -> std::io::Result<()> {
    write::cloud(out, cloud, scalars, options)
}

/// Writes a mesh: vertices with colours if present, faces with texture coordinates if present and,
/// where there are several materials, `texnumber`. Name the texture files in the comments.
///
/// # Errors
/// What writing to `out` brings.
pub fn write_mesh(out: &mut impl Write, mesh: &Mesh, options: &PlyOptions) -> std::io::Result<()> {
    write::mesh(out, mesh, options)
}

#[cfg(test)]
mod tests;
