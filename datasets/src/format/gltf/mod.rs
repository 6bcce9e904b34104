//! glTF 2.0, text or binary (GLB): the triangles of its scene and what they look like.
//!
//! An own reader over serde, because node transforms must be f64: georeferenced models keep their
//! place in a translation, which the `gltf` crate reads as f32. Only base colours are read: textures,
//! factors, vertex colours, masks.

mod data;
mod materials;
mod nodes;
mod skins;
mod wire;

use crate::error::FormatError;
use crate::scene::Corner;
use data::Document;
use glam::{DMat4, DVec3, Vec2};
pub(crate) use materials::byte_of_linear;
use materials::material_of;
pub use materials::{GltfMaterial, GltfTexture};
use nodes::{MOST_INSTANCED, check_instances, placed_nodes};
use std::borrow::Cow;
use std::collections::{BTreeMap, BTreeSet};
use wire::{Primitive, Root};

/// A glTF's triangles in its own frame: right-handed, +Y up, metres.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct GltfFile {
    /// Positions in world units.
    pub vertices: Vec<DVec3>,
    /// 8-bit sRGB per vertex, if any primitive has colours. Where a triangle's material is `tinted`
    /// they are light: mixed as such between vertices, and multiplied with its texture, if it has one.
    pub vertex_colors: Option<Vec<[u8; 3]>>,
    /// Vertex indices, counter-clockwise seen from outside.
    pub triangles: Vec<[u32; 3]>,
    /// Texture coordinates of each triangle, (0, 0) at the bottom-left corner; zeros where it has none.
    pub texture_coords: Vec<Corner>,
    /// Index into `materials` of each triangle.
    pub triangle_materials: Vec<u32>,
    /// What the triangles are made of, in order of first use.
    pub materials: Vec<GltfMaterial>,
    /// The images that the materials use, by their index in the file.
    pub images: BTreeMap<usize, GltfImage>,
    /// What was left out or is shown otherwise, one sentence each.
    pub notes: Vec<String>,
}

/// An image's file content, or where it lies.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum GltfImage {
    /// The bytes of a JPEG or PNG.
    Bytes(Vec<u8>),
    /// A path relative to the glTF file.
    File(String),
}

/// Extensions that change nothing of what is read here, or are read.
const UNDERSTOOD: [&str; 3] = [
    "KHR_texture_transform",
    "KHR_lights_punctual",
    "KHR_mesh_quantization",
];

/// Reads a `.gltf` or `.glb`. Meshes that nodes show several times are there several times, up to 2^26 vertices and
/// corners in all. `load` gives the content of a file that a buffer names, relative to the
/// glTF file, or says why it cannot.
///
/// # Errors
/// Another text or version, a file that is cut short, extensions that it cannot be read without, numbers of things
/// that are not there or do not fit, compressed or sparse data, positions that are not finite, a node in two places,
/// too many instances, 2^32 vertices or more, and no triangles; and what `load` says.
pub fn read_gltf(
    bytes: &[u8],
    load: &dyn Fn(&str) -> Result<Vec<u8>, String>,
) -> Result<GltfFile, FormatError> {
    let (json, binary) = data::chunks(bytes)?;
    let root: Root = serde_json::from_slice(json).map_err(|error| {
        let said = error.to_string();
        let problem = said.split(" at line ").next().unwrap_or_default();
        FormatError::new(
            format!("JSON line {} column {}", error.line(), error.column()),
            format!("expected a glTF, found another text ({problem})"),
        )
    })?;
    check(&root)?;
    let buffers = buffers(&root, binary, load)?;
    let document = Document { root, buffers };
    let nodes = placed_nodes(&document.root)?;
    check_instances(&document.root, &nodes, MOST_INSTANCED)?;
    let places = nodes.iter().copied().collect();
    let mut reader = Reader::new(&document, &places);
    let root = &document.root;
    if root.scene.is_some_and(|scene| scene >= root.scenes.len()) {
        reader.note("the scene that the file names is not in it: all its nodes are shown");
    }
    for (node, matrix) in nodes {
        reader
            .node(node, matrix)
            .map_err(|problem| FormatError::new(format!("node {node}"), problem))?;
    }
    reader.finish()
}

/// Refuses versions and extensions that the file cannot be read without.
fn check(root: &Root) -> Result<(), FormatError> {
    let version = &root.asset.version;
    if !version.starts_with("2.") {
        let found = match version.as_str() {
            "" => "a JSON without asset.version".to_owned(),
            other => format!("version {}", super::text::shown(other)),
        };
        let problem = format!("expected glTF 2.0, found {found}");
        return Err(FormatError::new("asset", problem));
    }
    let needed = root.extensions_required.iter();
    let unknown = needed
        .filter(|name| !UNDERSTOOD.contains(&name.as_str()) && !name.starts_with("KHR_materials_"));
    match unknown.into_iter().next() {
        None => Ok(()),
        Some(name) => {
            let problem = format!(
                "expected a glTF that can be read without extensions, found that it requires {}: \
                 export it without (no Draco, meshopt or KTX2 compression)",
                super::text::shown(name)
            );
            Err(FormatError::new("extensionsRequired", problem))
        }
    }
}

fn buffers<'b>(
    root: &Root,
    binary: Option<&'b [u8]>,
    load: &dyn Fn(&str) -> Result<Vec<u8>, String>,
) -> Result<Vec<Cow<'b, [u8]>>, FormatError> {
    let content = |uri: &str| match data::data_uri(uri) {
        Some(decoded) => decoded,
        None => load(&data::unescaped(uri)),
    };
    let buffers = root.buffers.iter().enumerate();
    buffers
        .map(|(index, buffer)| {
            let wrong = |problem| FormatError::new(format!("buffer {index}"), problem);
            match (&buffer.uri, binary) {
                (Some(uri), _) => content(uri).map(Cow::Owned).map_err(wrong),
                (None, Some(binary)) if index == 0 => Ok(Cow::Borrowed(binary)),
                (None, _) => Err(wrong(
                    "expected a uri or a binary chunk, found neither".into(),
                )),
            }
        })
        .collect()
}

/// What has been read so far.
struct Reader<'d> {
    document: &'d Document<'d>,
    /// The nodes of the scene with their `world_from_node`.
    nodes: &'d BTreeMap<usize, DMat4>,
    file: GltfFile,
    /// Colours of the vertices up to the last that has one.
    colors: Vec<Option<[u8; 3]>>,
    /// The colour of vertices without one.
    plain: Vec<[u8; 3]>,
    /// Where each (material, with texture coordinates, with colours) stands in the file's list.
    slots: BTreeMap<(Option<usize>, bool, bool), u32>,
    /// Materials that give off light.
    shining: BTreeSet<usize>,
}

/// The columns of a primitive.
struct Columns {
    positions: Vec<DVec3>,
    colors: Option<Vec<[f64; 3]>>,
    coords: Option<Vec<Vec2>>,
    triangles: Vec<[usize; 3]>,
    /// Indices that the triangles are made of.
    corners: usize,
}

impl<'d> Reader<'d> {
    fn new(document: &'d Document<'d>, nodes: &'d BTreeMap<usize, DMat4>) -> Self {
        Self {
            document,
            nodes,
            file: GltfFile::default(),
            colors: Vec::new(),
            plain: Vec::new(),
            slots: BTreeMap::new(),
            shining: BTreeSet::new(),
        }
    }

    fn note(&mut self, note: &str) {
        if !self.file.notes.iter().any(|known| known == note) {
            self.file.notes.push(note.to_owned());
        }
    }

    fn node(&mut self, index: usize, matrix: DMat4) -> Result<(), String> {
        let document = self.document;
        let node = &document.root.nodes[index];
        if node.extensions.contains_key("EXT_mesh_gpu_instancing") {
            return Err(
                "expected plain nodes, found EXT_mesh_gpu_instancing, which is not supported"
                    .into(),
            );
        }
        let Some(mesh) = node.mesh else {
            return Ok(());
        };
        let matrix = match node.skin {
            Some(skin) => match skins::placed(document, self.nodes, skin)? {
                Some(matrix) => matrix,
                None => {
                    self.note(skins::LEFT);
                    DMat4::IDENTITY
                }
            },
            None => matrix,
        };
        let list = document.root.meshes.get(mesh);
        let list = list.ok_or_else(|| format!("expected mesh {mesh}, found none"))?;
        for (number, primitive) in list.primitives.iter().enumerate() {
            self.primitive(primitive, matrix)
                .map_err(|problem| format!("mesh {mesh} primitive {number}: {problem}"))?;
        }
        Ok(())
    }

    fn primitive(&mut self, primitive: &Primitive, matrix: DMat4) -> Result<(), String> {
        if let Some(name) = primitive
            .extensions
            .keys()
            .find(|name| name.contains("compression"))
        {
            return Err(format!(
                "expected plain data, found {}, which is not supported",
                super::text::shown(name)
            ));
        }
        if !primitive.targets.is_empty() {
            self.note("morph targets are left out");
        }
        if !matches!(primitive.mode, None | Some(4..=6)) {
            self.note("points and lines are left out");
            return Ok(());
        }
        let index = primitive.material;
        let material = match index {
            None => Default::default(),
            Some(index) => material_of(self.document, index)?,
        };
        material.notes.iter().for_each(|note| self.note(note));
        if material.is_absent {
            self.note("what a mask's constant opacity hides altogether is left out");
            return Ok(());
        }
        self.shining.extend(index.filter(|_| material.shines));
        let set = material
            .material
            .texture
            .as_ref()
            .map(|texture| texture.set);
        let columns = self.columns(primitive, set, matrix)?;
        if matches!(primitive.mode, None | Some(4)) && !columns.corners.is_multiple_of(3) {
            self.note("the last corners of primitives whose corners are no multiple of three are left out");
        }
        if material.material.cutoff.is_some() && self.has_opacity(primitive) {
            self.note(
                "the opacity of vertices (COLOR_0) is passed over: masks (MASK) cut by textures alone",
            );
        }
        if set.is_some() && columns.coords.is_none() {
            self.note("primitives that have a texture but lack its coordinates show their color");
        }
        self.add(columns, (index, material.material))
    }

    fn columns(
        &self,
        primitive: &Primitive,
        set: Option<u32>,
        matrix: DMat4,
    ) -> Result<Columns, String> {
        let attribute = |name: &str| primitive.attributes.get(name).copied();
        let positions = attribute("POSITION").ok_or("expected POSITION, found none")?;
        let positions: Vec<DVec3> = self
            .document
            .elements::<3>(positions)?
            .into_iter()
            .map(|position| matrix.transform_point3(DVec3::from_array(position)))
            .collect();
        if let Some(index) = positions.iter().position(|position| !position.is_finite()) {
            return Err(format!(
                "expected finite positions, found {} at {index}",
                positions[index]
            ));
        }
        let count = positions.len();
        let complete = |name: &str, found: usize| match found == count {
            true => Ok(()),
            false => Err(format!("expected {count} of {name}, found {found}")),
        };
        let colors = attribute("COLOR_0")
            .map(|index| self.document.elements::<3>(index))
            .transpose()?;
        complete("COLOR_0", colors.as_ref().map_or(count, Vec::len))?;
        let name = format!("TEXCOORD_{}", set.unwrap_or(0));
        let coords = match set {
            None => None,
            Some(_) => attribute(&name)
                .map(|index| self.document.elements::<2>(index))
                .transpose()?,
        };
        complete(&name, coords.as_ref().map_or(count, Vec::len))?;
        let order: Vec<usize> = match primitive.indices {
            None => (0..count).collect(),
            Some(index) => {
                let indices = self.document.indices(index)?.into_iter();
                indices
                    .map(|index| vertex(index, count))
                    .collect::<Result<_, _>>()?
            }
        };
        let coord = |[u, v]: [f64; 2]| Vec2::new(u as f32, v as f32);
        Ok(Columns {
            positions,
            colors,
            coords: coords.map(|all| all.into_iter().map(coord).collect()),
            triangles: triangles(&order, primitive.mode, matrix.determinant() < 0.0),
            corners: order.len(),
        })
    }

    /// Whether the colour of any vertex is not wholly opaque.
    fn has_opacity(&self, primitive: &Primitive) -> bool {
        let colors = primitive.attributes.get("COLOR_0");
        let colors = colors.and_then(|&index| self.document.elements::<4>(index).ok());
        colors.is_some_and(|colors| colors.iter().any(|color| color[3] < 1.0))
    }

    fn add(
        &mut self,
        columns: Columns,
        (index, mut material): (Option<usize>, GltfMaterial),
    ) -> Result<(), String> {
        let first = self.file.vertices.len();
        if u32::try_from(first + columns.positions.len()).is_err() {
            return Err("expected at most 2^32 vertices, found more".into());
        }
        let textured = columns.coords.is_some();
        let colored = columns.colors.is_some();
        if !textured {
            material.texture = None;
        }
        material.tinted = colored;
        let factor = match textured {
            true => [1.0; 3],
            false => material.factor,
        };
        if let Some(colors) = columns.colors {
            self.colors.resize(first, None);
            let shown =
                |color: [f64; 3]| std::array::from_fn(|k| byte_of_linear(color[k] * factor[k]));
            self.colors
                .extend(colors.into_iter().map(|color| Some(shown(color))));
        }
        self.plain
            .resize(first + columns.positions.len(), material.color);
        self.file.vertices.extend(columns.positions);
        let lay = material.texture.as_ref().map(GltfTexture::placement);
        let coords = columns.coords.unwrap_or_default();
        let at = |corner: usize| match (&lay, coords.get(corner)) {
            (Some(lay), Some(coord)) => lay(*coord),
            _ => Vec2::ZERO,
        };
        let corners: Vec<Corner> = columns.triangles.iter().map(|t| t.map(at)).collect();
        if let Some(texture) = &material.texture {
            self.note_wrapping(texture, &corners);
        }
        let slot = self.slot((index, textured, colored), material)?;
        for (triangle, corners) in columns.triangles.iter().zip(corners) {
            #[allow(clippy::cast_possible_truncation, reason = "checked above")]
            self.file
                .triangles
                .push(triangle.map(|vertex| (first + vertex) as u32));
            self.file.texture_coords.push(corners);
            self.file.triangle_materials.push(slot);
        }
        Ok(())
    }

    /// Textures are repeated beyond their borders; a file that asks for something else there says so.
    fn note_wrapping(&mut self, texture: &GltfTexture, corners: &[Corner]) {
        let inside = |coord: &Vec2| coord.cmpge(Vec2::ZERO).all() && coord.cmple(Vec2::ONE).all();
        if texture.repeats || corners.iter().flatten().all(inside) {
            return;
        }
        self.note(
            "a texture that is to be clamped or mirrored beyond its border is repeated there",
        );
    }

    /// Where the material stands in the file's list.
    fn slot(
        &mut self,
        key: (Option<usize>, bool, bool),
        material: GltfMaterial,
    ) -> Result<u32, String> {
        if let Some(slot) = self.slots.get(&key) {
            return Ok(*slot);
        }
        if let Some(texture) = &material.texture {
            let image = materials::image_of(self.document, texture.image)?;
            self.file.images.insert(texture.image, image);
        }
        let slot = u32::try_from(self.file.materials.len()).unwrap_or(u32::MAX);
        self.file.materials.push(material);
        self.slots.insert(key, slot);
        Ok(slot)
    }

    /// Says so where materials give off light.
    fn note_shining(&mut self) {
        if let Some(&first) = self.shining.first() {
            let count = self.shining.len();
            let first = match self.document.root.materials[first].name.as_str() {
                "" => format!("material {first}, without a name"),
                name => format!("{name:?}"),
            };
            self.note(&format!(
                "{count} materials give off light (emissiveFactor, emissiveTexture), which is left out: they show \
                 their base colors alone; the first is {first}"
            ));
        }
    }

    fn finish(mut self) -> Result<GltfFile, FormatError> {
        if self.file.triangles.is_empty() {
            let problem = "expected triangles in the scene, found none";
            return Err(FormatError::new("scene", problem));
        }
        self.note_shining();
        if !self.colors.is_empty() {
            self.colors.resize(self.file.vertices.len(), None);
            let colors = self.colors.iter().zip(&self.plain);
            self.file.vertex_colors =
                Some(colors.map(|(own, plain)| own.unwrap_or(*plain)).collect());
        }
        Ok(self.file)
    }
}

fn vertex(index: f64, count: usize) -> Result<usize, String> {
    #[allow(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "a whole number from 0 on, checked on the next line"
    )]
    let whole = index as usize;
    if index >= 0.0 && index.fract() == 0.0 && whole < count {
        return Ok(whole);
    }
    Err(format!(
        "expected vertex indices below {count}, found {index}"
    ))
}

/// Triangles of a list (mode 4), strip (5) or fan (6); `mirrored` ones are turned around.
fn triangles(order: &[usize], mode: Option<u32>, mirrored: bool) -> Vec<[usize; 3]> {
    let cut: Vec<[usize; 3]> = match mode {
        Some(5) => {
            let windows = order.windows(3).enumerate();
            windows
                .map(|(k, w)| {
                    if k % 2 == 0 {
                        [w[0], w[1], w[2]]
                    } else {
                        [w[1], w[0], w[2]]
                    }
                })
                .collect()
        }
        Some(6) => order
            .windows(2)
            .skip(1)
            .map(|w| [order[0], w[0], w[1]])
            .collect(),
        _ => order.as_chunks::<3>().0.to_vec(),
    };
    match mirrored {
        true => cut.into_iter().map(|[a, b, c]| [a, c, b]).collect(),
        false => cut,
    }
}

#[cfg(test)]
mod tests;
