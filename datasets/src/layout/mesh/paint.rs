//! Colours of vertices that have none, in a mesh of which others have.

use glam::DVec3;
use std::collections::BTreeMap;

/// Vertices and the triangles between them.
pub(super) struct Surface<'a> {
    pub(super) vertices: &'a mut Vec<DVec3>,
    pub(super) triangles: &'a mut [[u32; 3]],
}

impl Surface<'_> {
    /// A colour for each vertex: its `own`, else that of its triangles. Where these have several, there is a vertex
    /// for each, behind all others, so that no colour runs into the next one. A vertex of no triangle is `unused`.
    pub(super) fn paint(
        self,
        own: &[Option<[u8; 3]>],
        unused: [u8; 3],
        color_of: impl Fn(usize) -> [u8; 3],
    ) -> Result<Vec<[u8; 3]>, String> {
        let mut colors = own.to_vec();
        colors.resize(self.vertices.len(), None);
        let has_own = |vertex: u32| own.get(vertex as usize).is_some_and(Option::is_some);
        let mut split: BTreeMap<(u32, [u8; 3]), u32> = BTreeMap::new();
        for (index, triangle) in self.triangles.iter_mut().enumerate() {
            let color = color_of(index);
            for vertex in triangle.iter_mut().filter(|vertex| !has_own(**vertex)) {
                match &mut colors[*vertex as usize] {
                    Some(other) if *other == color => {}
                    empty @ None => *empty = Some(color),
                    Some(_) => {
                        let next = u32::try_from(self.vertices.len())
                            .map_err(|_| "more than 2^32 vertices".to_owned())?;
                        let copy = *split.entry((*vertex, color)).or_insert(next);
                        if copy == next {
                            self.vertices.push(self.vertices[*vertex as usize]);
                            colors.push(Some(color));
                        }
                        *vertex = copy;
                    }
                }
            }
        }
        Ok(colors
            .into_iter()
            .map(|color| color.unwrap_or(unused))
            .collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_corner_has_its_own_color_or_that_of_its_triangle() {
        let (red, green, blue) = ([255, 0, 0], [0, 255, 0], [0, 0, 255]);
        let mut vertices: Vec<DVec3> = (0..6).map(|x| DVec3::splat(f64::from(x))).collect();
        let before = [[0, 1, 2], [2, 1, 3], [3, 1, 2], [2, 3, 4]];
        let of = [red, blue, blue, red];
        let mut triangles = before;
        let own = [None, None, None, Some(green)];
        let positions = vertices.clone();
        let surface = Surface {
            vertices: &mut vertices,
            triangles: &mut triangles,
        };
        let colors = surface.paint(&own, [9; 3], |index| of[index]).unwrap();
        assert_eq!((vertices.len(), colors.len()), (8, 8));
        for (index, (old, new)) in before.iter().zip(&triangles).enumerate() {
            for (&old, &new) in old.iter().zip(new) {
                assert_eq!(positions[old as usize], vertices[new as usize]);
                let expected = if old == 3 { green } else { of[index] };
                assert_eq!(
                    colors[new as usize], expected,
                    "triangle {index}, vertex {old}"
                );
            }
        }
        assert_eq!(colors[5], [9; 3]);
    }
}
