//! Meshes with their materials and textures, from one or many files.

use super::files::read_with;
use super::materials::{self, Draft, Library};
use super::textures::Use;
use crate::error::{Error, Result};
use crate::format::gltf::{self, GltfImage};
use crate::format::obj::{ObjFile, read_obj};
use crate::format::ply::{PlyMesh, read_mesh};
use crate::scene::{Corner, Material, Mesh};
use glam::{DVec3, Vec2};
use std::cell::RefCell;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// A mesh, and what was odd about its files (a missing texture, say), one sentence each.
#[derive(Debug, Clone)]
pub struct LoadedMesh {
    /// All files as one mesh.
    pub mesh: Mesh,
    /// Sentences for the user.
    pub notes: Vec<String>,
    /// Every file that the result follows from: meshes, material libraries, textures, buffers; by
    /// path, each once.
    pub files: Vec<PathBuf>,
}

/// The memory that decoded textures may take unless said otherwise: 6 GiB.
pub const TEXTURE_BYTES: u64 = 6 << 30;

/// How meshes are read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ReadOptions {
    /// The most bytes that decoded textures may take; more are refused before any is decoded.
    pub texture_bytes: u64,
    /// Threads that decode textures; the result does not depend on it.
    pub threads: usize,
}

impl Default for ReadOptions {
    fn default() -> Self {
        Self {
            texture_bytes: TEXTURE_BYTES,
            threads: std::thread::available_parallelism().map_or(1, usize::from),
        }
    }
}

/// [`read_meshes_with`] by default options.
pub fn read_meshes(paths: &[PathBuf]) -> Result<LoadedMesh> {
    read_meshes_with(paths, &ReadOptions::default())
}

/// Reads meshes (`.obj` with its materials, `.ply`, `.gltf`, `.glb`) and joins them into one. A
/// folder stands for all its meshes, and a last name with `*` or `?` for all that fit, in name order.
/// Textures are found beside the file that names them, and only those that faces use are read; one
/// that cannot be is noted, and its material's colour shows instead.
pub fn read_meshes_with(paths: &[PathBuf], options: &ReadOptions) -> Result<LoadedMesh> {
    let mut joined = Joined::default();
    let mut library = Library::default();
    for path in &mesh_files(paths)? {
        library.uses(path);
        let part = match extension_of(path).as_str() {
            "ply" => read_ply_part(path, &mut library)?,
            "gltf" | "glb" => read_gltf_part(path, &mut library)?,
            _ => read_obj_part(path, &mut library)?,
        };
        joined
            .add(part)
            .map_err(|problem| Error::layout(path, problem))?;
    }
    if joined.triangles.is_empty() {
        let found = joined.vertices.len();
        let problem = format!("expected a mesh, found {found} vertices and no faces");
        return Err(Error::layout(
            paths.first().map_or(Path::new(""), PathBuf::as_path),
            problem,
        ));
    }
    let drafts = std::mem::take(&mut joined.drafts);
    let finished = library.finish(drafts, options)?;
    let mesh = joined.finish(finished.materials)?;
    Ok(LoadedMesh {
        mesh,
        notes: finished.notes,
        files: finished.files,
    })
}

/// The ending in small letters.
fn extension_of(path: &Path) -> String {
    let extension = path.extension().unwrap_or_default();
    extension.to_string_lossy().to_ascii_lowercase()
}

/// Whether the file's name ends like a mesh's.
pub fn is_mesh(path: &Path) -> bool {
    matches!(extension_of(path).as_str(), "obj" | "ply" | "gltf" | "glb")
}

/// The files behind `paths`: folders and patterns are replaced by the meshes that they stand for.
fn mesh_files(paths: &[PathBuf]) -> Result<Vec<PathBuf>> {
    if paths.is_empty() {
        return Err(Error::layout("", "expected at least one mesh, found none"));
    }
    let mut files = Vec::new();
    for path in paths {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        if path.is_dir() {
            files.extend(meshes_in(path, "*")?);
        } else if name.contains(['*', '?']) && !path.exists() {
            let folder = path
                .parent()
                .filter(|parent| !parent.as_os_str().is_empty());
            files.extend(meshes_in(folder.unwrap_or(Path::new(".")), &name)?);
        } else if is_mesh(path) {
            files.push(path.clone());
        } else {
            let problem =
                "expected a mesh that ends in .obj, .ply, .gltf or .glb, or a folder of them";
            return Err(Error::layout(path, problem));
        }
    }
    Ok(files)
}

/// The meshes in a folder whose names fit the pattern.
fn meshes_in(folder: &Path, pattern: &str) -> Result<Vec<PathBuf>> {
    let mut files = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(Error::io(folder, "list"))? {
        let path = entry.map_err(Error::io(folder, "list"))?.path();
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        if is_mesh(&path) && fits(name.as_bytes(), pattern.as_bytes()) && path.is_file() {
            files.push(path);
        }
    }
    files.sort();
    if files.is_empty() {
        let which = match pattern {
            "*" => String::new(),
            pattern => format!(" that fit {pattern}"),
        };
        let problem =
            format!("expected .obj, .ply, .gltf or .glb files{which} in this folder, found none");
        return Err(Error::layout(folder, problem));
    }
    Ok(files)
}

/// Whether a name fits a pattern in which `*` stands for any letters and `?` for one.
fn fits(name: &[u8], pattern: &[u8]) -> bool {
    match (name, pattern) {
        ([], []) => true,
        (_, [b'*', rest @ ..]) => (0..=name.len()).any(|skip| fits(&name[skip..], rest)),
        ([_, name @ ..], [b'?', rest @ ..]) => fits(name, rest),
        ([letter, name @ ..], [wanted, rest @ ..]) => letter == wanted && fits(name, rest),
        _ => false,
    }
}

/// A mesh whose materials still lack their textures.
struct Part {
    mesh: Mesh,
    /// One per material.
    drafts: Vec<Draft>,
}

impl Part {
    /// A part whose materials need no files.
    fn plain(mesh: Mesh) -> Self {
        let drafts = mesh.materials().iter().cloned().map(Draft::from).collect();
        Self { mesh, drafts }
    }

    fn new(mesh: Mesh, drafts: Vec<Draft>, slots: Option<Vec<u32>>) -> Result<Self> {
        let materials = drafts.iter().map(|draft| draft.material.clone()).collect();
        let mesh = mesh.with_materials(materials, slots)?;
        Ok(Self { mesh, drafts })
    }
}

fn read_gltf_part(path: &Path, library: &mut Library) -> Result<Part> {
    let loaded = RefCell::new(Vec::new());
    let load = |name: &str| {
        let found = materials::find(&[path], name)
            .ok_or_else(|| format!("expected the file {name:?} beside it, found none"))?;
        loaded.borrow_mut().push(found.clone());
        std::fs::read(&found).map_err(|error| format!("cannot read {}: {error}", found.display()))
    };
    let file = read_with(path, |bytes| gltf::read_gltf(bytes, &load))?;
    for buffer in loaded.into_inner() {
        library.uses(&buffer);
    }
    for note in &file.notes {
        library.note(path, note);
    }
    let mut texture = |image: usize, used: Use| match file.images.get(&image)? {
        GltfImage::Bytes(bytes) => Some(library.inner_texture((path, image), bytes, used)),
        GltfImage::File(name) => library.texture(path, name, used),
    };
    let mut drafts = Vec::with_capacity(file.materials.len());
    for material in &file.materials {
        let image = material.texture.as_ref().map(|texture| texture.image);
        let cutoff = image.zip(material.cutoff);
        drafts.push(Draft {
            texture: image.and_then(|image| texture(image, Use::scaled(material.factor))),
            opacity: cutoff
                .and_then(|(image, cutoff)| Some((texture(image, Use::Opacity)?, cutoff))),
            material: Material {
                name: material.name.clone(),
                color: material.color,
                tinted: material.tinted,
                double_sided: material.double_sided,
                ..Material::default()
            },
        });
    }
    let textured = drafts.iter().any(|draft| draft.texture.is_some());
    let build = || {
        let mut mesh = Mesh::new(file.vertices, file.triangles)?;
        if textured {
            mesh = mesh.with_texture_coords(file.texture_coords)?;
        }
        if let Some(colors) = file.vertex_colors {
            mesh = mesh.with_vertex_colors(colors)?;
        }
        Part::new(mesh, drafts, Some(file.triangle_materials))
    };
    build().map_err(|error| Error::layout(path, error.to_string()))
}

fn read_obj_part(path: &Path, library: &mut Library) -> Result<Part> {
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
    let mut drafts = Vec::with_capacity(file.materials.len());
    let mut placements = Vec::with_capacity(file.materials.len());
    for used in &file.materials {
        let (draft, placement) = library.material(path, &known, used);
        drafts.push(draft);
        placements.push(placement);
    }
    if drafts.is_empty() {
        drafts.push(Draft::default());
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
    let textured = drafts
        .iter()
        .any(|draft| draft.texture.is_some() || draft.opacity.is_some());
    let build = || {
        let mut mesh = Mesh::new(vertices, triangles)?;
        if textured {
            mesh = mesh.with_texture_coords(texture_coords)?;
        }
        if let Some(colors) = vertex_colors {
            mesh = mesh.with_vertex_colors(colors)?;
        }
        Part::new(mesh, drafts, Some(triangle_materials))
    };
    build().map_err(|error| Error::layout(path, error.to_string()))
}

fn read_ply_part(path: &Path, library: &mut Library) -> Result<Part> {
    let PlyMesh {
        mesh,
        texture_files,
    } = read_with(path, read_mesh)?;
    if mesh.texture_coords().is_none() || texture_files.is_empty() {
        return Ok(Part::plain(mesh));
    }
    let slots = mesh.triangle_materials().map(<[u32]>::to_vec);
    let used: BTreeSet<u32> = match &slots {
        Some(slots) => slots.iter().copied().collect(),
        None => BTreeSet::from([0]),
    };
    let draft = |(index, file): (u32, &String)| Draft {
        texture: match used.contains(&index) {
            true => library.texture(path, file, Use::Color),
            false => None,
        },
        ..Draft::from(
            mesh.materials()
                .get(index as usize)
                .cloned()
                .unwrap_or_default(),
        )
    };
    let drafts = (0u32..).zip(&texture_files).map(draft).collect();
    Part::new(mesh, drafts, slots).map_err(|error| Error::layout(path, error.to_string()))
}

/// Several meshes one after another.
#[derive(Default)]
struct Joined {
    vertices: Vec<DVec3>,
    triangles: Vec<[u32; 3]>,
    texture_coords: Option<Vec<Corner>>,
    vertex_colors: Option<Vec<[u8; 3]>>,
    triangle_materials: Vec<u32>,
    drafts: Vec<Draft>,
}

impl Joined {
    fn add(&mut self, Part { mesh: part, drafts }: Part) -> Result<(), String> {
        let count =
            |all: usize| u32::try_from(all).map_err(|_| "more than 2^32 vertices".to_owned());
        let first_vertex = count(self.vertices.len())?;
        count(self.vertices.len() + part.vertices().len())?;
        let first_material = count(self.drafts.len())?;
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
        self.drafts.extend(drafts);
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
                Some(before.colors(|t| &self.drafts[self.triangle_materials[t] as usize].material));
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

    /// The mesh, with a material for each draft.
    fn finish(self, materials: Vec<Material>) -> Result<Mesh> {
        let count = self.triangles.len();
        let mut mesh = Mesh::new(self.vertices, self.triangles)?
            .with_materials(materials, Some(self.triangle_materials))?;
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

#[cfg(test)]
mod tests {
    use super::fits;

    #[test]
    fn patterns_stand_for_names() {
        for (name, pattern, expected) in [
            ("tile_1_2.obj", "tile_*.obj", true),
            ("tile_1_2.obj", "tile_?_?.obj", true),
            ("tile_1_12.obj", "tile_?_?.obj", false),
            ("tile.obj", "*.ply", false),
            ("a", "a*", true),
            ("", "?", false),
        ] {
            assert_eq!(
                fits(name.as_bytes(), pattern.as_bytes()),
                expected,
                "{name} {pattern}"
            );
        }
    }
}
