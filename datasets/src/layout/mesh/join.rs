//! The mesh files of a scene as one mesh.

use super::part::Part;
use crate::error::Result;
use crate::layout::materials::Draft;
use crate::scene::{Corner, Material, Mesh};
use glam::{DVec3, Vec2};

/// Several meshes one after another.
#[derive(Default)]
pub(super) struct Joined {
    vertices: Vec<DVec3>,
    triangles: Vec<[u32; 3]>,
    texture_coords: Option<Vec<Corner>>,
    vertex_colors: Option<Vec<[u8; 3]>>,
    triangle_materials: Vec<u32>,
    drafts: Vec<Draft>,
}

impl Joined {
    /// Takes a mesh over, as the first.
    fn first(Part { mesh, drafts }: Part) -> Self {
        let columns = mesh.into_columns();
        let count = columns.triangles.len();
        Self {
            vertices: columns.vertices,
            triangles: columns.triangles,
            texture_coords: columns.texture_coords,
            vertex_colors: columns.vertex_colors,
            triangle_materials: columns.triangle_materials.unwrap_or_else(|| vec![0; count]),
            drafts,
        }
    }

    pub(super) fn add(&mut self, part: Part) -> Result<(), String> {
        let count =
            |all: usize| u32::try_from(all).map_err(|_| "more than 2^32 vertices".to_owned());
        count(self.vertices.len() + part.mesh.vertices().len())?;
        if self.drafts.is_empty() {
            *self = Self::first(part);
            return Ok(());
        }
        let Part { mesh: part, drafts } = part;
        let first_vertex = count(self.vertices.len())?;
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

    pub(super) fn vertex_count(&self) -> usize {
        self.vertices.len()
    }

    pub(super) fn triangle_count(&self) -> usize {
        self.triangles.len()
    }

    /// What the materials of all meshes are made from.
    pub(super) fn take_drafts(&mut self) -> Vec<Draft> {
        std::mem::take(&mut self.drafts)
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
    pub(super) fn finish(self, materials: Vec<Material>) -> Result<Mesh> {
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
