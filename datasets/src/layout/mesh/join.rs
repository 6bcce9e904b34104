//! The mesh files of a scene as one mesh.

use super::paint::Surface;
use super::part::Part;
use crate::error::Result;
use crate::layout::materials::Draft;
use crate::scene::{Corner, Material, Mesh, MeshColumns};
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
        let Part { mesh, drafts } = part;
        let mut part = mesh.into_columns();
        self.extend_colors(&mut part)?;
        let first_vertex = count(self.vertices.len())?;
        let first_material = count(self.drafts.len())?;
        let before = self.triangles.len();
        self.vertices.append(&mut part.vertices);
        count(self.vertices.len())?;
        let triangles = part.triangles.iter();
        self.triangles
            .extend(triangles.map(|t| t.map(|index| index + first_vertex)));
        match part.triangle_materials {
            Some(slots) => self
                .triangle_materials
                .extend(slots.iter().map(|m| m + first_material)),
            None => self
                .triangle_materials
                .resize(self.triangles.len(), first_material),
        }
        self.drafts.extend(drafts);
        if let Some(coords) = part.texture_coords {
            let all = self.texture_coords.get_or_insert_default();
            all.resize(before, [Vec2::ZERO; 3]);
            all.extend_from_slice(&coords);
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
    fn extend_colors(&mut self, part: &mut MeshColumns) -> Result<(), String> {
        if self.vertex_colors.is_none() && part.vertex_colors.is_some() {
            let before = Surface {
                vertices: &mut self.vertices,
                triangles: &mut self.triangles,
            };
            let (slots, drafts) = (&self.triangle_materials, &self.drafts);
            let color_of = |triangle: usize| drafts[slots[triangle] as usize].material.color;
            self.vertex_colors = Some(before.paint(&[], Material::default().color, color_of)?);
        }
        let Some(colors) = &mut self.vertex_colors else {
            return Ok(());
        };
        if let Some(own) = &part.vertex_colors {
            colors.extend_from_slice(own);
            return Ok(());
        }
        let alone = Surface {
            vertices: &mut part.vertices,
            triangles: &mut part.triangles,
        };
        let (slots, materials) = (&part.triangle_materials, &part.materials);
        let slot = |triangle: usize| slots.as_ref().map_or(0, |slots| slots[triangle] as usize);
        let color_of = |triangle: usize| materials[slot(triangle)].color;
        colors.extend(alone.paint(&[], Material::default().color, color_of)?);
        Ok(())
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
