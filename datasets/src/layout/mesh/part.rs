//! One mesh file of a scene.

use super::extension_of;
use super::paint::Surface;
use crate::error::{Error, Result};
use crate::format::gltf::{self, GltfFile, GltfImage, GltfMaterial};
use crate::format::obj::{ObjFile, read_obj_with};
use crate::format::ply::{PlyMesh, read_mesh};
use crate::layout::files::read_with;
use crate::layout::materials::{self, Draft, Library};
use crate::layout::textures::Use;
use crate::scene::{ColorImage, Corner, Material, Mesh, are_finite};
use std::cell::RefCell;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// A mesh whose materials still lack their textures.
pub(super) struct Part {
    pub(super) mesh: Mesh,
    /// One per material.
    pub(super) drafts: Vec<Draft>,
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

/// Gives triangles of which a texture coordinate is no finite number their materials without textures; how many
/// those are.
fn untexture(coords: &[Corner], drafts: &mut Vec<Draft>, slots: &mut [u32]) -> usize {
    let mut plain = BTreeMap::new();
    let mut count = 0;
    let both = coords.iter().zip(slots);
    for (_, slot) in both.filter(|(corners, _)| !are_finite(corners)) {
        let draft = &drafts[*slot as usize];
        if draft.texture.is_none() && draft.opacity.is_none() && draft.material.texture.is_none() {
            continue;
        }
        let color = Draft::from(Material {
            texture: None,
            ..draft.material.clone()
        });
        let number = plain.entry(*slot).or_insert_with(|| {
            drafts.push(color);
            u32::try_from(drafts.len() - 1).unwrap_or(u32::MAX)
        });
        (*slot, count) = (*number, count + 1);
    }
    count
}

/// What one mesh file says, before the files that it names are looked at.
pub(super) enum Contents {
    Obj(ObjFile),
    Ply(PlyMesh),
    /// With the files of its buffers.
    Gltf(GltfFile, Vec<PathBuf>),
}

impl Contents {
    /// Reads a file, an OBJ on several threads.
    pub(super) fn read(path: &Path, threads: usize) -> Result<Self> {
        match extension_of(path).as_str() {
            "ply" => read_with(path, read_mesh).map(Self::Ply),
            "gltf" | "glb" => read_gltf(path),
            _ => read_with(path, |bytes| read_obj_with(bytes, threads)).map(Self::Obj),
        }
    }

    /// What was read from `path`, with the materials that it uses.
    pub(super) fn finish(self, path: &Path, library: &mut Library) -> Result<Part> {
        library.uses(path);
        match self {
            Self::Obj(file) => obj_part(path, file, library),
            Self::Ply(file) => ply_part(path, file, library),
            Self::Gltf(file, buffers) => gltf_part(path, (file, buffers), library),
        }
    }
}

fn read_gltf(path: &Path) -> Result<Contents> {
    let loaded = RefCell::new(Vec::new());
    let load = |name: &str| {
        let found = materials::find(&[path], name)
            .ok_or_else(|| format!("expected the file {name:?} beside it, found none"))?;
        loaded.borrow_mut().push(found.clone());
        std::fs::read(&found).map_err(|error| format!("cannot read {}: {error}", found.display()))
    };
    let file = read_with(path, |bytes| gltf::read_gltf(bytes, &load))?;
    Ok(Contents::Gltf(file, loaded.into_inner()))
}

fn gltf_part(
    path: &Path,
    (file, buffers): (GltfFile, Vec<PathBuf>),
    library: &mut Library,
) -> Result<Part> {
    for buffer in &buffers {
        library.uses(buffer);
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
                texture: stand_in(material),
                ..Material::default()
            },
        });
    }
    let has_texture = |draft: &Draft| draft.texture.is_some() || draft.material.texture.is_some();
    let textured = drafts.iter().any(has_texture);
    let mut slots = file.triangle_materials;
    let odd = untexture(&file.texture_coords, &mut drafts, &mut slots);
    if odd > 0 {
        let problem = format!(
            "{odd} triangles have texture coordinates that are no finite numbers: they have their materials' colors"
        );
        library.note(path, problem);
    }
    let build = || {
        let mut mesh = Mesh::new(file.vertices, file.triangles)?;
        if textured {
            mesh = mesh.with_texture_coords(file.texture_coords)?;
        }
        if let Some(colors) = file.vertex_colors {
            mesh = mesh.with_vertex_colors(colors)?;
        }
        Part::new(mesh, drafts, Some(slots))
    };
    build().map_err(|error| Error::layout(path, error.to_string()))
}

/// What a texture that cannot be read leaves of a material whose vertices have colours: those times its factor.
fn stand_in(material: &GltfMaterial) -> Option<Arc<ColorImage>> {
    let multiplies = material.tinted && material.texture.is_some() && material.color != [255; 3];
    let pixel = multiplies.then(|| ColorImage::filled(1, 1, material.color));
    pixel?.ok().map(Arc::new)
}

fn obj_part(path: &Path, file: ObjFile, library: &mut Library) -> Result<Part> {
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
        mut vertices,
        vertex_colors,
        mut triangles,
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
    let color_of = |triangle: usize| drafts[triangle_materials[triangle] as usize].material.color;
    let colors = vertex_colors.map(|own| {
        let surface = Surface {
            vertices: &mut vertices,
            triangles: &mut triangles,
        };
        surface.paint(&own, Material::default().color, color_of)
    });
    let colors = colors
        .transpose()
        .map_err(|problem| Error::layout(path, problem))?;
    let build = || {
        let mut mesh = Mesh::new(vertices, triangles)?;
        if textured {
            mesh = mesh.with_texture_coords(texture_coords)?;
        }
        if let Some(colors) = colors {
            mesh = mesh.with_vertex_colors(colors)?;
        }
        Part::new(mesh, drafts, Some(triangle_materials))
    };
    build().map_err(|error| Error::layout(path, error.to_string()))
}

fn ply_part(path: &Path, file: PlyMesh, library: &mut Library) -> Result<Part> {
    let PlyMesh {
        mesh,
        untextured,
        texture_files,
        face_colors,
        strips,
    } = file;
    if strips > 0 {
        let problem = format!(
            "{strips} triangle strips (tristrips) beside its faces are left out: write all triangles as faces"
        );
        library.note(path, problem);
    }
    if face_colors {
        library.note(
            path,
            "its faces have colors, which are not shown: give them to the vertices",
        );
    }
    if mesh.texture_coords().is_none() && !texture_files.is_empty() {
        let problem = "it names a texture file but has no texture coordinates (texcoord of the faces, or s t, u v, \
                       texture_u texture_v or texture_s texture_t of the vertices): no texture is shown";
        library.note(path, problem);
    }
    if mesh.texture_coords().is_none() || texture_files.is_empty() {
        return Ok(Part::plain(mesh));
    }
    if untextured > 0 {
        let problem = format!(
            "{untextured} triangles have no texture (a texnumber below 0, or no finite texture coordinates): they have \
             the colors of their vertices, if any"
        );
        library.note(path, problem);
    }
    let slots = mesh.triangle_materials().map(<[u32]>::to_vec);
    let used: BTreeSet<u32> = match &slots {
        Some(slots) => slots.iter().copied().collect(),
        None => BTreeSet::from([0]),
    };
    let draft = |(index, material): (u32, &Material)| Draft {
        texture: texture_files
            .get(index as usize)
            .filter(|_| used.contains(&index))
            .and_then(|file| library.texture(path, file, Use::Color)),
        ..Draft::from(material.clone())
    };
    let drafts = (0u32..).zip(mesh.materials()).map(draft).collect();
    Part::new(mesh, drafts, slots).map_err(|error| Error::layout(path, error.to_string()))
}

#[cfg(test)]
mod tests;
