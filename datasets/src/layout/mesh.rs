//! Meshes with their materials and textures, from one or many files.

use super::files::read_with;
use super::materials::Library;
use crate::error::{Error, Result};
use crate::format::obj::{ObjFile, read_obj};
use crate::format::ply::{PlyMesh, read_mesh};
use crate::scene::{Corner, Material, Mesh};
use glam::{DVec3, Vec2};
use std::path::{Path, PathBuf};

/// A mesh, and what was odd about its files (a missing texture, say), one sentence each.
#[derive(Debug, Clone)]
pub struct LoadedMesh {
    /// All files as one mesh.
    pub mesh: Mesh,
    /// Sentences for the user.
    pub notes: Vec<String>,
}

/// Reads meshes (`.obj` with its materials, `.ply`) and joins them into one. A folder stands for
/// all its meshes, in name order. Textures are found beside the file that names them; one that
/// cannot be read is noted, and its material's colour shows instead.
pub fn read_meshes(paths: &[PathBuf]) -> Result<LoadedMesh> {
    let mut joined = Joined::default();
    let mut library = Library::default();
    for path in &mesh_files(paths)? {
        let part = if has_extension(path, "ply") {
            read_ply_part(path, &mut library)?
        } else {
            read_obj_part(path, &mut library)?
        };
        joined
            .add(part)
            .map_err(|problem| Error::layout(path, problem))?;
    }
    let mesh = joined.finish()?;
    if mesh.triangles().is_empty() {
        let found = mesh.vertices().len();
        let problem = format!("expected a mesh, found {found} vertices and no faces");
        return Err(Error::layout(
            paths.first().map_or(Path::new(""), PathBuf::as_path),
            problem,
        ));
    }
    let notes = library.into_notes();
    Ok(LoadedMesh { mesh, notes })
}

fn has_extension(path: &Path, extension: &str) -> bool {
    path.extension()
        .is_some_and(|found| found.eq_ignore_ascii_case(extension))
}

/// The files behind `paths`: folders are replaced by the meshes in them.
fn mesh_files(paths: &[PathBuf]) -> Result<Vec<PathBuf>> {
    if paths.is_empty() {
        return Err(Error::layout("", "expected at least one mesh, found none"));
    }
    let mut files = Vec::new();
    for path in paths {
        if path.is_dir() {
            files.extend(meshes_in(path)?);
        } else if has_extension(path, "obj") || has_extension(path, "ply") {
            files.push(path.clone());
        } else {
            let problem = "expected a mesh that ends in .obj or .ply, or a folder of them";
            return Err(Error::layout(path, problem));
        }
    }
    Ok(files)
}

fn meshes_in(folder: &Path) -> Result<Vec<PathBuf>> {
    let mut files = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(Error::io(folder, "list"))? {
        let path = entry.map_err(Error::io(folder, "list"))?.path();
        if path.is_file() && (has_extension(&path, "obj") || has_extension(&path, "ply")) {
            files.push(path);
        }
    }
    files.sort();
    if files.is_empty() {
        return Err(Error::layout(
            folder,
            "expected .obj or .ply files in this folder, found none",
        ));
    }
    Ok(files)
}

fn read_obj_part(path: &Path, library: &mut Library) -> Result<Mesh> {
    let file = read_with(path, read_obj)?;
    if file.skipped_faces > 0 {
        let skipped = file.skipped_faces;
        library.note(
            path,
            format!("{skipped} faces with fewer than three corners are left out"),
        );
    }
    if file.lost_coords > 0 {
        library.note(
            path,
            "its faces name texture coordinates that it does not have",
        );
    }
    let known = library.read(path, &file.libraries, !file.materials.is_empty())?;
    let mut materials = Vec::with_capacity(file.materials.len());
    let mut placements = Vec::with_capacity(file.materials.len());
    for used in &file.materials {
        let (material, placement) = library.material(path, &known, used);
        materials.push(material);
        placements.push(placement);
    }
    if materials.is_empty() {
        materials.push(Material::default());
    }
    let ObjFile {
        vertices,
        vertex_colors,
        triangles,
        mut texture_coords,
        triangle_materials,
        ..
    } = file;
    for (corners, &slot) in texture_coords.iter_mut().zip(&triangle_materials) {
        placements[slot as usize].apply(corners);
    }
    let textured = materials.iter().any(|material| material.texture.is_some());
    let build = || {
        let mut mesh =
            Mesh::new(vertices, triangles)?.with_materials(materials, Some(triangle_materials))?;
        if textured {
            mesh = mesh.with_texture_coords(texture_coords)?;
        }
        match vertex_colors {
            Some(colors) => mesh.with_vertex_colors(colors),
            None => Ok(mesh),
        }
    };
    build().map_err(|error| Error::layout(path, error.to_string()))
}

fn read_ply_part(path: &Path, library: &mut Library) -> Result<Mesh> {
    let PlyMesh {
        mesh,
        texture_files,
    } = read_with(path, read_mesh)?;
    if mesh.texture_coords().is_none() || texture_files.is_empty() {
        return Ok(mesh);
    }
    let slots = mesh.triangle_materials().map(<[u32]>::to_vec);
    let material = |(index, file): (usize, &String)| Material {
        texture: library.texture(path, file),
        ..mesh.materials().get(index).cloned().unwrap_or_default()
    };
    let mut materials: Vec<Material> = texture_files.iter().enumerate().map(material).collect();
    let needed = slots
        .iter()
        .flatten()
        .max()
        .map_or(1, |&slot| slot as usize + 1);
    if needed > materials.len() {
        let found = materials.len();
        library.note(
            path,
            format!("its faces use {needed} textures, {found} are named"),
        );
        materials.resize(needed, Material::default());
    }
    mesh.with_materials(materials, slots)
        .map_err(|error| Error::layout(path, error.to_string()))
}

/// Several meshes one after another.
#[derive(Default)]
struct Joined {
    vertices: Vec<DVec3>,
    triangles: Vec<[u32; 3]>,
    texture_coords: Option<Vec<Corner>>,
    vertex_colors: Option<Vec<[u8; 3]>>,
    triangle_materials: Vec<u32>,
    materials: Vec<Material>,
}

impl Joined {
    fn add(&mut self, part: Mesh) -> Result<(), String> {
        let count =
            |all: usize| u32::try_from(all).map_err(|_| "more than 2^32 vertices".to_owned());
        let first_vertex = count(self.vertices.len())?;
        count(self.vertices.len() + part.vertices().len())?;
        let first_material = count(self.materials.len())?;
        let before = self.triangles.len();
        self.extend_colors(&part);
        self.vertices.extend_from_slice(part.vertices());
        self.triangles.extend(
            part.triangles()
                .iter()
                .map(|t| t.map(|index| index + first_vertex)),
        );
        match part.triangle_materials() {
            Some(slots) => self
                .triangle_materials
                .extend(slots.iter().map(|m| m + first_material)),
            None => self
                .triangle_materials
                .resize(self.triangles.len(), first_material),
        }
        self.materials.extend_from_slice(part.materials());
        if let Some(coords) = part.texture_coords() {
            let all = self.texture_coords.get_or_insert_default();
            all.resize(before, [Vec2::ZERO; 3]);
            all.extend_from_slice(coords);
        }
        Ok(())
    }

    /// Vertices of a part without colours get those of its materials, as soon as another part has
    /// colours.
    fn extend_colors(&mut self, part: &Mesh) {
        if self.vertex_colors.is_none() && part.vertex_colors().is_some() {
            let before = Painted {
                triangles: &self.triangles,
                vertices: self.vertices.len(),
            };
            self.vertex_colors =
                Some(before.colors(|t| &self.materials[self.triangle_materials[t] as usize]));
        }
        let Some(colors) = &mut self.vertex_colors else {
            return;
        };
        match part.vertex_colors() {
            Some(own) => colors.extend_from_slice(own),
            None => {
                let part_only = Painted {
                    triangles: part.triangles(),
                    vertices: part.vertices().len(),
                };
                colors.extend(part_only.colors(|t| part.material_of(t)));
            }
        }
    }

    fn finish(mut self) -> Result<Mesh> {
        if self.materials.is_empty() {
            self.materials.push(Material::default());
        }
        let count = self.triangles.len();
        let mut mesh = Mesh::new(self.vertices, self.triangles)?
            .with_materials(self.materials, Some(self.triangle_materials))?;
        if let Some(mut coords) = self.texture_coords {
            coords.resize(count, [Vec2::ZERO; 3]);
            mesh = mesh.with_texture_coords(coords)?;
        }
        match self.vertex_colors {
            Some(colors) => mesh.with_vertex_colors(colors),
            None => Ok(mesh),
        }
    }
}

/// Triangles whose vertices are to be painted in their materials' colours.
struct Painted<'a> {
    triangles: &'a [[u32; 3]],
    vertices: usize,
}

impl Painted<'_> {
    fn colors<'m>(&self, material_of: impl Fn(usize) -> &'m Material) -> Vec<[u8; 3]> {
        let mut colors = vec![Material::default().color; self.vertices];
        for (index, triangle) in self.triangles.iter().enumerate() {
            for &vertex in triangle {
                colors[vertex as usize] = material_of(index).color;
            }
        }
        colors
    }
}
