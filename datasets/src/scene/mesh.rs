use super::aabb::Aabb;
use super::raster::{ColorImage, Raster};
use crate::error::{Error, Result};
use glam::{DVec3, Vec2};
use std::sync::Arc;

/// Texture coordinates of a triangle's three corners.
///
/// (0, 0) is the bottom-left outer corner of the texture image and (1, 1) the top-right one, as in
/// OBJ files.
pub type Corner = [Vec2; 3];

/// Whether all of a triangle's texture coordinates are finite numbers.
pub(crate) fn are_finite(corners: &Corner) -> bool {
    corners.iter().all(|corner| corner.is_finite())
}

/// What a triangle's surface looks like.
#[derive(Debug, Clone, PartialEq)]
pub struct Material {
    /// The material's name in its file; empty when it has none.
    pub name: String,
    /// The colour where there is no texture, 8-bit sRGB.
    pub color: [u8; 3],
    /// The texture, if any.
    pub texture: Option<Arc<ColorImage>>,
    /// Whether vertex colours, where the mesh has them, are light, as in glTF: mixed as such between
    /// vertices, and multiplied with the texture if there is one. Else they are mixed as sRGB values, and
    /// a texture hides them.
    pub tinted: bool,
    /// Where the surface is cut out, if it is.
    pub cutout: Option<Cutout>,
    /// Whether both sides of the triangles are surface.
    pub double_sided: bool,
}

/// A mask that lies on a surface like a texture: where its value is below `cutoff` there is none.
#[derive(Debug, Clone, PartialEq)]
pub struct Cutout {
    /// 8-bit opacity, interpolated like a texture.
    pub opacity: Arc<Raster<u8>>,
    /// The least opacity that is surface, in 8-bit units.
    pub cutoff: f32,
}

impl Default for Material {
    /// An unnamed light grey material.
    fn default() -> Self {
        Self {
            name: String::new(),
            color: [200; 3],
            texture: None,
            tinted: false,
            cutout: None,
            double_sided: false,
        }
    }
}

/// A triangle mesh in world units.
///
/// Triangle indices lie inside the vertices; every column present is complete; material indices lie
/// inside the materials, of which there is at least one. Vertex positions are finite.
#[derive(Debug, Clone, PartialEq)]
pub struct Mesh {
    vertices: Vec<DVec3>,
    triangles: Vec<[u32; 3]>,
    texture_coords: Option<Vec<Corner>>,
    vertex_colors: Option<Vec<[u8; 3]>>,
    triangle_materials: Option<Vec<u32>>,
    materials: Vec<Material>,
}

/// What a [`Mesh`] is made of, column by column.
#[derive(Debug, Clone, PartialEq)]
pub struct MeshColumns {
    /// See [`Mesh::vertices`].
    pub vertices: Vec<DVec3>,
    /// See [`Mesh::triangles`].
    pub triangles: Vec<[u32; 3]>,
    /// See [`Mesh::texture_coords`].
    pub texture_coords: Option<Vec<Corner>>,
    /// See [`Mesh::vertex_colors`].
    pub vertex_colors: Option<Vec<[u8; 3]>>,
    /// See [`Mesh::triangle_materials`].
    pub triangle_materials: Option<Vec<u32>>,
    /// See [`Mesh::materials`].
    pub materials: Vec<Material>,
}

impl Mesh {
    /// A mesh of bare triangles with one default material. Corners are counter-clockwise seen from
    /// outside.
    ///
    /// # Errors
    /// Vertices that are not finite, and indices beyond them.
    pub fn new(vertices: Vec<DVec3>, triangles: Vec<[u32; 3]>) -> Result<Self> {
        if let Some(index) = vertices.iter().position(|vertex| !vertex.is_finite()) {
            let problem = format!(
                "expected finite vertices, found {} at {index}",
                vertices[index]
            );
            return Err(Error::invalid("mesh", problem));
        }
        let count = vertices.len();
        for (index, triangle) in triangles.iter().enumerate() {
            if let Some(&vertex) = triangle.iter().find(|&&vertex| vertex as usize >= count) {
                let problem = format!(
                    "expected vertex indices below {count}, found {vertex} in triangle {index}"
                );
                return Err(Error::invalid("mesh", problem));
            }
        }
        Ok(Self {
            vertices,
            triangles,
            texture_coords: None,
            vertex_colors: None,
            triangle_materials: None,
            materials: vec![Material::default()],
        })
    }

    /// The same mesh with texture coordinates, three per triangle.
    ///
    /// # Errors
    /// A count of triples that is not that of the triangles.
    pub fn with_texture_coords(mut self, texture_coords: Vec<Corner>) -> Result<Self> {
        self.check(
            "texture coordinate triples",
            texture_coords.len(),
            self.triangles.len(),
        )?;
        self.texture_coords = Some(texture_coords);
        Ok(self)
    }

    /// The same mesh with 8-bit sRGB colours, one per vertex.
    ///
    /// # Errors
    /// A count of colours that is not that of the vertices.
    pub fn with_vertex_colors(mut self, vertex_colors: Vec<[u8; 3]>) -> Result<Self> {
        self.check("vertex colors", vertex_colors.len(), self.vertices.len())?;
        self.vertex_colors = Some(vertex_colors);
        Ok(self)
    }

    /// The same mesh with `materials` and, per triangle, the index of its material. One material
    /// may be given with no indices: it is everybody's.
    ///
    /// # Errors
    /// No materials, a count of indices that is not that of the triangles, and an index beyond the materials.
    pub fn with_materials(
        mut self,
        materials: Vec<Material>,
        triangle_materials: Option<Vec<u32>>,
    ) -> Result<Self> {
        if let Some(indices) = &triangle_materials {
            self.check("material indices", indices.len(), self.triangles.len())?;
        }
        let worst = triangle_materials
            .as_ref()
            .and_then(|m| m.iter().copied().max())
            .unwrap_or_default();
        if worst as usize >= materials.len() {
            let found = materials.len();
            let needed = u64::from(worst) + 1;
            let problem = format!("expected at least {needed} materials, found {found}");
            return Err(Error::invalid("mesh", problem));
        }
        self.materials = materials;
        self.triangle_materials = triangle_materials;
        Ok(self)
    }

    fn check(&self, column: &str, found: usize, expected: usize) -> Result<()> {
        if found == expected {
            return Ok(());
        }
        Err(Error::invalid(
            "mesh",
            format!("expected {expected} {column}, found {found}"),
        ))
    }

    /// Vertex positions in world units.
    #[inline]
    pub fn vertices(&self) -> &[DVec3] {
        &self.vertices
    }

    /// Vertex indices of each triangle.
    #[inline]
    pub fn triangles(&self) -> &[[u32; 3]] {
        &self.triangles
    }

    /// Positions of a triangle's corners.
    #[inline]
    pub fn corners(&self, triangle: usize) -> [DVec3; 3] {
        self.triangles[triangle].map(|vertex| self.vertices[vertex as usize])
    }

    /// Texture coordinates per triangle corner, if any.
    pub fn texture_coords(&self) -> Option<&[Corner]> {
        self.texture_coords.as_deref()
    }

    /// 8-bit sRGB colours per vertex, if any.
    pub fn vertex_colors(&self) -> Option<&[[u8; 3]]> {
        self.vertex_colors.as_deref()
    }

    /// All materials; at least one.
    pub fn materials(&self) -> &[Material] {
        &self.materials
    }

    /// Index into [`Mesh::materials`] of each triangle; `None` when all use material 0.
    pub fn triangle_materials(&self) -> Option<&[u32]> {
        self.triangle_materials.as_deref()
    }

    /// The material of a triangle.
    pub fn material_of(&self, triangle: usize) -> &Material {
        let index = self.triangle_materials.as_ref().map_or(0, |m| m[triangle]);
        &self.materials[index as usize]
    }

    /// Its columns, without copying them.
    pub fn into_columns(self) -> MeshColumns {
        MeshColumns {
            vertices: self.vertices,
            triangles: self.triangles,
            texture_coords: self.texture_coords,
            vertex_colors: self.vertex_colors,
            triangle_materials: self.triangle_materials,
            materials: self.materials,
        }
    }

    /// The box around all vertices that triangles use.
    pub fn bounds(&self) -> Aabb {
        let corners = self.triangles.as_flattened().iter();
        Aabb::around(corners.map(|&corner| self.vertices[corner as usize]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn triangle() -> Mesh {
        Mesh::new(vec![DVec3::ZERO, DVec3::X, DVec3::Y], vec![[0, 1, 2]]).unwrap()
    }

    #[test]
    fn indices_stay_inside() {
        let error = Mesh::new(vec![DVec3::ZERO; 3], vec![[0, 1, 3]])
            .unwrap_err()
            .to_string();
        assert!(error.contains("below 3, found 3 in triangle 0"), "{error}");
        assert!(Mesh::new(vec![DVec3::splat(f64::NAN)], vec![]).is_err());
        assert!(triangle().with_materials(vec![], None).is_err());
        assert!(
            triangle()
                .with_materials(vec![Material::default()], Some(vec![1]))
                .is_err()
        );
    }

    #[test]
    fn bounds_are_those_of_what_is_used() {
        let vertices = vec![DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::splat(1e15)];
        let bounds = Mesh::new(vertices, vec![[0, 1, 2]]).unwrap().bounds();
        assert_eq!(
            (bounds.min, bounds.max),
            (DVec3::ZERO, DVec3::new(1.0, 1.0, 0.0))
        );
    }

    #[test]
    fn a_triangle_without_a_material_index_uses_the_first() {
        let red = Material {
            name: "red".into(),
            color: [255, 0, 0],
            ..Material::default()
        };
        let mesh = triangle().with_materials(vec![red.clone()], None).unwrap();
        assert_eq!(mesh.material_of(0), &red);
    }
}
