//! What the element `face` means.

use super::body::{Body, Row};
use super::header::is_scalar;
use crate::error::FormatError;
use crate::format::polygon::triangulate;
use crate::scene::{Corner, are_finite};
use glam::{DVec3, Vec2};
use ply_rs_bw::ply::ElementDef;
use std::ops::Range;

/// Texture coordinates of a face that lists none.
pub(super) const NO_COORDS: Corner = [Vec2::NAN; 3];
/// The number of no texture.
pub(super) const NO_NUMBER: u32 = u32::MAX;

/// Triangles and what each says about its texture.
#[derive(Debug, Default)]
pub(super) struct Faces {
    pub(super) triangles: Vec<[u32; 3]>,
    /// Per triangle, if the faces have texture coordinates; [`NO_COORDS`] of those without.
    pub(super) texture_coords: Option<Vec<Corner>>,
    /// Per triangle, if the faces have texture numbers; [`NO_NUMBER`] of no texture, as numbers below 0 say.
    pub(super) texture_numbers: Option<Vec<u32>>,
    /// The triangles of each face of more than three corners: a fan from its first.
    fans: Vec<Range<usize>>,
}

impl Faces {
    /// Cuts polygons such that concave ones are filled too, now that it is known where vertices are.
    pub(super) fn cut(&mut self, positions: &[DVec3]) {
        for fan in std::mem::take(&mut self.fans) {
            let triangles = &mut self.triangles[fan.clone()];
            let outline = outline_of(triangles);
            let position = |&vertex: &u32| positions[vertex as usize];
            let cut = triangulate(&outline.iter().map(position).collect::<Vec<_>>());
            for (triangle, corners) in triangles.iter_mut().zip(&cut) {
                *triangle = corners.map(|corner| outline[corner]);
            }
            if let Some(coords) = &mut self.texture_coords {
                let coords = &mut coords[fan];
                let outline = outline_of(coords);
                for (triangle, corners) in coords.iter_mut().zip(&cut) {
                    *triangle = corners.map(|corner| outline[corner]);
                }
            }
        }
    }
}

impl Faces {
    /// Texture coordinates of all triangles, a face's own, else those of its vertices. Triangles that have neither,
    /// or none that are finite, where others have some get [`NO_NUMBER`].
    pub(super) fn take_coords(&mut self, of_vertices: Option<&[Vec2]>) -> Option<Vec<Corner>> {
        let at = |all: &[Vec2], triangle: &[u32; 3]| triangle.map(|vertex| all[vertex as usize]);
        let mut coords = match self.texture_coords.take() {
            Some(coords) => coords,
            None => {
                let all = of_vertices?;
                self.triangles.iter().map(|t| at(all, t)).collect()
            }
        };
        let without = coords.iter_mut().enumerate();
        for (index, corner) in without.filter(|(_, corner)| !are_finite(corner)) {
            let others = of_vertices.map(|all| at(all, &self.triangles[index]));
            if let Some(others) = others.filter(are_finite) {
                *corner = others;
                continue;
            }
            *corner = [Vec2::ZERO; 3];
            let count = self.triangles.len();
            let numbers = self.texture_numbers.get_or_insert_with(|| vec![0; count]);
            numbers[index] = NO_NUMBER;
        }
        Some(coords)
    }
}

/// The corners of a polygon that was cut into a fan.
fn outline_of<T: Copy>(fan: &[[T; 3]]) -> Vec<T> {
    let first = fan.iter().take(1).flat_map(|&[a, b, _]| [a, b]);
    first.chain(fan.iter().map(|&[.., c]| c)).collect()
}

/// Where a face's properties are in a [`Row`].
struct FaceLayout {
    indices: usize,
    texcoord: Option<usize>,
    texnumber: Option<usize>,
}

impl FaceLayout {
    fn of(element: &ElementDef) -> Result<Self, FormatError> {
        let place = |name: &str, scalar: bool| {
            let properties = element.properties.values();
            let mut same_kind = properties.filter(|p| is_scalar(&p.data_type) == scalar);
            same_kind.position(|property| property.name == name)
        };
        let indices = place("vertex_indices", false).or_else(|| place("vertex_index", false));
        let Some(indices) = indices else {
            let problem = "expected a list property vertex_indices or vertex_index, found none";
            return Err(FormatError::new("element face", problem));
        };
        Ok(Self {
            indices,
            texcoord: place("texcoord", false),
            texnumber: place("texnumber", true),
        })
    }
}

/// Takes all faces as triangles, polygons as fans until [`Faces::cut`]; fewer than three corners are no face.
pub(super) fn take(
    element: &ElementDef,
    body: &mut Body<'_>,
    vertex_count: usize,
) -> Result<Faces, FormatError> {
    let layout = FaceLayout::of(element)?;
    let mut faces = Faces {
        triangles: Vec::new(),
        texture_coords: layout.texcoord.map(|_| Vec::new()),
        texture_numbers: layout.texnumber.map(|_| Vec::new()),
        fans: Vec::new(),
    };
    body.take_rows(element, |index, row| {
        add_face(&mut faces, &layout, &row, vertex_count)
            .map_err(|problem| FormatError::new(format!("face {index}"), problem))
    })?;
    Ok(faces)
}

fn add_face(
    faces: &mut Faces,
    layout: &FaceLayout,
    row: &Row,
    vertex_count: usize,
) -> Result<(), String> {
    let polygon = &row.lists[layout.indices];
    if let Some(bad) = polygon
        .iter()
        .find(|&&index| !is_below(index, vertex_count))
    {
        return Err(format!(
            "expected vertex indices below {vertex_count}, found {bad}"
        ));
    }
    let fan = 1..polygon.len().saturating_sub(1);
    if fan.len() > 1 {
        let first = faces.triangles.len();
        faces.fans.push(first..first + fan.len());
    }
    for k in fan.clone() {
        faces
            .triangles
            .push([0, k, k + 1].map(|corner| polygon[corner] as u32));
    }
    if let (Some(all), Some(texcoord)) = (&mut faces.texture_coords, layout.texcoord) {
        let coords = &row.lists[texcoord];
        if !coords.is_empty() && coords.len() != 2 * polygon.len() {
            let (expected, found) = (2 * polygon.len(), coords.len());
            return Err(format!(
                "expected {expected} or no texture coordinates, found {found}"
            ));
        }
        let at = |corner: usize| match coords.get(2 * corner..2 * corner + 2) {
            Some(&[u, v]) => Vec2::new(u as f32, v as f32),
            _ => NO_COORDS[0],
        };
        all.extend(fan.clone().map(|k| [at(0), at(k), at(k + 1)]));
    }
    if let (Some(all), Some(texnumber)) = (&mut faces.texture_numbers, layout.texnumber) {
        let number = row.scalars[texnumber];
        let number = match number >= 0.0 {
            true => number as u32,
            false => NO_NUMBER,
        };
        all.extend(fan.map(|_| number));
    }
    Ok(())
}

fn is_below(index: f64, count: usize) -> bool {
    index >= 0.0 && index.fract() == 0.0 && index < count as f64
}
