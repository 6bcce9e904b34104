//! Writing meshes with materials and textures.

use super::files::write_atomically;
use crate::error::{Error, Result};
use crate::format::image;
use crate::scene::{Material, Mesh};
use std::io::Write;
use std::path::Path;

/// Writes `mesh` as `<stem>.obj` at `path`, with `<stem>.mtl` and `<stem>_tex<i>.png` beside it.
/// Numbers have the shortest digits that read back to the same value.
///
/// # Errors
/// A name that is none or not in UTF-8, and what [`write_atomically`] brings.
pub fn write_obj(path: &Path, mesh: &Mesh) -> Result<()> {
    let stem = path.file_stem().and_then(|stem| stem.to_str());
    let stem = stem.ok_or_else(|| Error::layout(path, "expected a file name in UTF-8"))?;
    for (index, material) in mesh.materials().iter().enumerate() {
        if let Some(texture) = &material.texture {
            let name = path.with_file_name(texture_name(stem, index));
            write_atomically(&name, |out| image::write_png(out, texture))?;
        }
    }
    write_atomically(&path.with_extension("mtl"), |out| {
        let materials = mesh.materials().iter().enumerate();
        materials
            .into_iter()
            .try_for_each(|(index, m)| write_material(out, stem, index, m))
    })?;
    write_atomically(path, |out| write_geometry(out, stem, mesh))
}

fn texture_name(stem: &str, index: usize) -> String {
    format!("{stem}_tex{index}.png")
}

fn write_material(
    out: &mut impl Write,
    stem: &str,
    index: usize,
    material: &Material,
) -> std::io::Result<()> {
    let [r, g, b] = material.color.map(|level| f64::from(level) / 255.0);
    writeln!(out, "newmtl material{index}\nKd {r} {g} {b}")?;
    match material.texture {
        Some(_) => writeln!(out, "map_Kd {}", texture_name(stem, index)),
        None => Ok(()),
    }
}

fn write_geometry(out: &mut impl Write, stem: &str, mesh: &Mesh) -> std::io::Result<()> {
    writeln!(out, "mtllib {stem}.mtl")?;
    for (index, vertex) in mesh.vertices().iter().enumerate() {
        write!(out, "v {} {} {}", vertex.x, vertex.y, vertex.z)?;
        if let Some(colors) = mesh.vertex_colors() {
            let [r, g, b] = colors[index].map(|level| f64::from(level) / 255.0);
            write!(out, " {r} {g} {b}")?;
        }
        writeln!(out)?;
    }
    for corner in mesh.texture_coords().into_iter().flatten().flatten() {
        writeln!(out, "vt {} {}", corner.x, corner.y)?;
    }
    write_faces(out, mesh)
}

fn write_faces(out: &mut impl Write, mesh: &Mesh) -> std::io::Result<()> {
    let mut current = None;
    for (index, triangle) in mesh.triangles().iter().enumerate() {
        let material = mesh
            .triangle_materials()
            .map_or(0, |materials| materials[index]);
        if current != Some(material) {
            writeln!(out, "usemtl material{material}")?;
            current = Some(material);
        }
        write!(out, "f")?;
        for (corner, vertex) in triangle.iter().enumerate() {
            match mesh.texture_coords() {
                Some(_) => write!(out, " {}/{}", vertex + 1, 3 * index + corner + 1)?,
                None => write!(out, " {}", vertex + 1)?,
            }
        }
        writeln!(out)?;
    }
    Ok(())
}
