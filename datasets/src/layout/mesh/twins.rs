//! Faces that are there twice, once each way: one face with two sides.
//!
//! Side by side they lie at the same depth but for rounding, so that which of them a ray meets, the front
//! of one or the back of the other, would be chance.

use crate::error::Result;
use crate::scene::{Corner, Material, Mesh, MeshColumns};
use glam::DVec3;

/// About so many triangles of a mesh are looked at before all are.
const SAMPLE: usize = 1 << 16;

/// A face and one at the same corners that is wound the other way, or is there once more.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct Twin {
    dropped: u32,
    kept: u32,
}

/// The mesh with each face once, those with two sides whose other side was a face of its own, and a note
/// of them. Corners are the same where their positions are.
///
/// Of a large mesh the faces at a sample of its vertices are looked at first: if none of some ten
/// thousand is there both ways, the others are left as they are.
pub(super) fn merged(mesh: Mesh) -> Result<(Mesh, Option<String>)> {
    merged_from(mesh, SAMPLE)
}

fn merged_from(mesh: Mesh, sample: usize) -> Result<(Mesh, Option<String>)> {
    let one_in = match mesh.triangles().len() {
        count if count <= sample => 1,
        // A triangle has three chances to be at a vertex of the sample.
        count => (3 * count / sample).next_power_of_two(),
    };
    let mut twins = twins_among(&mesh, keys(&mesh, one_in as u32));
    if twins.is_empty() {
        return Ok((mesh, None));
    }
    if one_in > 1 {
        twins = twins_among(&mesh, keys(&mesh, 1));
    }
    let note = note_of(&mesh, &twins);
    Ok((without(mesh, &twins)?, Some(note)))
}

/// A number that follows from a position, the same for 0 and -0.
fn hash(position: DVec3) -> u32 {
    let [x, y, z] = (position + 0.0).to_array().map(f64::to_bits);
    let mixed = x.wrapping_mul(0x9e37_79b9_7f4a_7c15)
        ^ y.wrapping_mul(0xc2b2_ae3d_27d4_eb4f).rotate_left(23)
        ^ z.wrapping_mul(0x1656_67b1_9e37_79f9).rotate_left(46);
    let mixed = (mixed ^ (mixed >> 32)).wrapping_mul(0xd6e8_feb8_6659_fd93);
    (mixed >> 32) as u32
}

/// A number by which positions are drawn for the sample; simpler than [`hash`], as every vertex has one.
fn draw(position: DVec3) -> u32 {
    let [x, y, z] = (position + 0.0).to_array().map(f64::to_bits);
    let mixed = x ^ y.rotate_left(23) ^ z.rotate_left(46);
    (mixed.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 32) as u32
}

/// The triangles at one position in `one_in` (at least 1): above, what follows from their corners in
/// whatever order; below, their index.
fn keys(mesh: &Mesh, one_in: u32) -> Vec<u64> {
    let vertices = mesh.vertices();
    let chosen: Vec<bool> = (vertices.iter())
        .map(|&at| draw(at) <= u32::MAX / one_in)
        .collect();
    let is_chosen = |vertex: u32| chosen[vertex as usize];
    let corners = |vertex: u32| hash(vertices[vertex as usize]);
    let mut keys = Vec::new();
    for (index, &[a, b, c]) in (0u64..).zip(mesh.triangles()) {
        if is_chosen(a) | is_chosen(b) | is_chosen(c) {
            let sum = corners(a).wrapping_add(corners(b)).wrapping_add(corners(c));
            keys.push(u64::from(sum) << 32 | index);
        }
    }
    keys
}

/// What is to be dropped of the triangles with these keys, ascending. Of faces at the same corners that
/// are not all wound alike, the first is kept.
fn twins_among(mesh: &Mesh, mut keys: Vec<u64>) -> Vec<Twin> {
    keys.sort_unstable();
    let mut twins = Vec::new();
    for alike in keys.chunk_by(|a, b| a >> 32 == b >> 32) {
        if alike.len() > 1 {
            add_twins(mesh, alike.iter().map(|&key| key as u32), &mut twins);
        }
    }
    twins.sort_unstable();
    twins
}

fn add_twins(mesh: &Mesh, triangles: impl Iterator<Item = u32>, twins: &mut Vec<Twin>) {
    let mut first: Vec<(u32, bool)> = Vec::new(); // of each set of corners, and whether it has two sides
    let mut others: Vec<(usize, u32)> = Vec::new();
    for triangle in triangles {
        let corners = mesh.corners(triangle as usize);
        let same = |&(other, _): &(u32, bool)| turn(mesh.corners(other as usize), corners);
        let mut found = first.iter().enumerate();
        let found = found.find_map(|(place, other)| Some((place, same(other)?)));
        match found {
            Some((place, turn)) => {
                first[place].1 |= !turn.is_even();
                others.push((place, triangle));
            }
            None if turn(corners, corners).is_some() => first.push((triangle, false)),
            None => {} // two corners coincide: no face
        }
    }
    let two_sided = others.into_iter().filter(|&(place, _)| first[place].1);
    twins.extend(two_sided.map(|(place, dropped)| Twin {
        dropped,
        kept: first[place].0,
    }));
}

/// Which corner of another triangle each corner is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Turn([usize; 3]);

impl Turn {
    /// Whether both are wound the same way.
    fn is_even(self) -> bool {
        let [a, b, _] = self.0;
        (a + 1) % 3 == b
    }
}

/// How the corners of `from` lie in `to`, if they are the same three.
fn turn(from: [DVec3; 3], to: [DVec3; 3]) -> Option<Turn> {
    let place = |corner: DVec3| to.iter().position(|&other| other == corner);
    let [a, b, c] = from.map(place);
    let (a, b, c) = (a?, b?, c?);
    (a != b && b != c && c != a).then_some(Turn([a, b, c]))
}

fn note_of(mesh: &Mesh, twins: &[Twin]) -> String {
    let note = format!(
        "{} faces are there both ways round: of each, the first is taken, with two sides",
        twins.len()
    );
    let other_looks = twins.iter().filter(|twin| looks_differ(mesh, **twin));
    match other_looks.count() {
        0 => note,
        count => format!(
            "{note}; {count} of the others look different, which is not shown: to see that side, leave \
             the first ones out of the mesh"
        ),
    }
}

fn looks_differ(mesh: &Mesh, Twin { dropped, kept }: Twin) -> bool {
    let (kept, dropped) = (kept as usize, dropped as usize);
    let Some(Turn(turn)) = turn(mesh.corners(kept), mesh.corners(dropped)) else {
        return false;
    };
    let slot = |triangle: usize| mesh.triangle_materials().map_or(0, |slots| slots[triangle]);
    if slot(kept) != slot(dropped) {
        return true;
    }
    let material = mesh.material_of(kept);
    let differ_at = |mapped: fn(&Mesh, usize, usize) -> Option<[u32; 2]>| {
        (0..3).any(|corner| mapped(mesh, kept, corner) != mapped(mesh, dropped, turn[corner]))
    };
    let textured = material.texture.is_some() || material.cutout.is_some();
    let colored = material.texture.is_none() || material.tinted;
    (textured && differ_at(coords_at)) || (colored && differ_at(color_at))
}

fn coords_at(mesh: &Mesh, triangle: usize, corner: usize) -> Option<[u32; 2]> {
    let coords: &[Corner] = mesh.texture_coords()?;
    Some(coords[triangle][corner].to_array().map(f32::to_bits))
}

fn color_at(mesh: &Mesh, triangle: usize, corner: usize) -> Option<[u32; 2]> {
    let vertex = mesh.triangles()[triangle][corner];
    let [red, green, blue] = mesh.vertex_colors()?[vertex as usize];
    Some([u32::from_be_bytes([0, red, green, blue]), 0])
}

/// The mesh without the dropped faces, the kept ones with two sides.
fn without(mesh: Mesh, twins: &[Twin]) -> Result<Mesh> {
    let mut columns = mesh.into_columns();
    let count = columns.triangles.len();
    let slots = columns.triangle_materials.take();
    let mut slots = slots.unwrap_or_else(|| vec![0; count]);
    let mut two_sided = vec![None; columns.materials.len()];
    let mut stays = vec![true; count];
    for twin in twins {
        stays[twin.dropped as usize] = false;
        let slot = &mut slots[twin.kept as usize];
        if !columns.materials[*slot as usize].double_sided {
            *slot = *two_sided[*slot as usize]
                .get_or_insert_with(|| with_two_sides(&mut columns.materials, *slot));
        }
    }
    drop_rows(&mut columns.triangles, &stays);
    drop_rows(&mut slots, &stays);
    if let Some(coords) = &mut columns.texture_coords {
        drop_rows(coords, &stays);
    }
    columns.triangle_materials = Some(slots);
    from_columns(columns)
}

/// Adds the material with two sides, and gives its place.
fn with_two_sides(materials: &mut Vec<Material>, slot: u32) -> u32 {
    materials.push(Material {
        double_sided: true,
        ..materials[slot as usize].clone()
    });
    materials.len() as u32 - 1
}

fn drop_rows<T>(rows: &mut Vec<T>, stays: &[bool]) {
    let mut stays = stays.iter();
    rows.retain(|_| stays.next().is_some_and(|&stays| stays));
}

fn from_columns(columns: MeshColumns) -> Result<Mesh> {
    let mut mesh = Mesh::new(columns.vertices, columns.triangles)?
        .with_materials(columns.materials, columns.triangle_materials)?;
    if let Some(coords) = columns.texture_coords {
        mesh = mesh.with_texture_coords(coords)?;
    }
    match columns.vertex_colors {
        Some(colors) => mesh.with_vertex_colors(colors),
        None => Ok(mesh),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec2;

    /// A wavy square of 2·n² triangles.
    fn sheet(n: u32) -> (Vec<DVec3>, Vec<[u32; 3]>) {
        let at = |index: u32| {
            let (x, y) = (f64::from(index % (n + 1)), f64::from(index / (n + 1)));
            DVec3::new(x, y, (0.7 * x).sin() + (0.4 * y).cos())
        };
        let vertices = (0..(n + 1) * (n + 1)).map(at).collect();
        let mut triangles = Vec::new();
        for row in 0..n {
            for column in 0..n {
                let a = row * (n + 1) + column;
                let (b, c, d) = (a + 1, a + n + 1, a + n + 2);
                triangles.extend([[a, b, c], [b, d, c]]);
            }
        }
        (vertices, triangles)
    }

    /// Every pair of triangles, compared corner by corner.
    fn slow(mesh: &Mesh) -> Vec<Twin> {
        let count = mesh.triangles().len();
        let relation = |i: usize, j: usize| turn(mesh.corners(i), mesh.corners(j));
        let mut twins = Vec::new();
        for dropped in 0..count {
            let same: Vec<usize> = (0..count)
                .filter(|&other| relation(dropped, other).is_some())
                .collect();
            let ways = |even: bool| {
                same.iter()
                    .any(|&j| relation(dropped, j).unwrap().is_even() == even)
            };
            if !same.is_empty() && ways(true) && ways(false) && same[0] != dropped {
                let [kept, dropped] = [same[0], dropped].map(|index| index as u32);
                twins.push(Twin { dropped, kept });
            }
        }
        twins
    }

    #[test]
    fn twins_are_found_by_their_corners_whoever_wrote_them() {
        let (mut vertices, mut triangles) = sheet(6);
        let own = triangles.clone();
        let count = vertices.len() as u32;
        vertices.extend(vertices.clone()); // once more, for faces with vertices of their own
        vertices[count as usize].x = -0.0;
        triangles.extend(own[3..20].iter().map(|&[a, b, c]| [c, b, a]));
        triangles.extend(
            own[30..44]
                .iter()
                .map(|t| t.map(|v| v + count))
                .map(|[a, b, c]| [a, c, b]),
        );
        triangles.push([own[0][2] + count, own[0][1], own[0][0] + count]);
        triangles.extend([own[50], own[3], own[4]]); // once more, the same way round
        triangles.extend([[7, 7, 8], [8, 7, 7], [7, 8, 7], [9, 9, 9]]); // no faces
        triangles.extend([[0, 1, 2], [2, 1, 0]]); // of no sheet
        let mesh = Mesh::new(vertices, triangles).unwrap();
        let expected = slow(&mesh);
        assert_eq!(expected.len(), 17 + 14 + 1 + 2 + 1);
        assert_eq!(twins_among(&mesh, keys(&mesh, 1)), expected);
        // By a sample first, with the same end.
        let triangles = mesh.triangles().len();
        let (all, note) = merged_from(mesh.clone(), SAMPLE).unwrap();
        let (sampled, _) = merged_from(mesh, 64).unwrap();
        assert_eq!(all.triangles().len(), triangles - expected.len());
        assert_eq!(all, sampled);
        let note = note.unwrap();
        assert!(
            note.starts_with("35 faces are there both ways round"),
            "{note}"
        );
        let two_sided = (0..all.triangles().len()).filter(|&t| all.material_of(t).double_sided);
        assert_eq!(two_sided.count(), 17 + 14 + 1 + 1);
        assert_eq!(twins_among(&all, keys(&all, 1)), []);
    }

    #[test]
    fn a_sound_mesh_stays_as_it_is() {
        let (vertices, mut triangles) = sheet(9);
        triangles.push(triangles[5]); // the same way round
        let mesh = Mesh::new(vertices, triangles).unwrap();
        for sample in [1, 16, SAMPLE] {
            let (same, note) = merged_from(mesh.clone(), sample).unwrap();
            assert_eq!((same, note), (mesh.clone(), None));
        }
        let keys = [1u32, 2, 4, 8].map(|one_in| keys(&mesh, one_in).len());
        assert_eq!(keys[0], mesh.triangles().len());
        assert!(keys.is_sorted_by(|a, b| a > b), "{keys:?}");
    }

    #[test]
    fn every_column_loses_the_same_rows_and_other_looks_are_counted() {
        let (vertices, own) = sheet(2);
        let back = own.iter().map(|&[a, b, c]| [b, a, c]);
        let triangles: Vec<[u32; 3]> = own.iter().copied().chain(back).collect();
        let coords = |v: u32| Vec2::new(v as f32, 1.0);
        let mut corners: Vec<Corner> = triangles.iter().map(|t| t.map(coords)).collect();
        corners[9][0].x += 0.5; // the second's other side
        let picture = crate::scene::ColorImage::filled(2, 2, [9; 3]).unwrap();
        let painted = Material {
            texture: Some(picture.into()),
            ..Material::default()
        };
        let slots = vec![0, 0, 0, 1, 0, 0, 0, 0, 0, 0, 2, 1, 0, 0, 0, 0];
        let mesh = Mesh::new(vertices, triangles).unwrap();
        let mesh = mesh.with_texture_coords(corners.clone()).unwrap();
        let materials = vec![painted.clone(), painted.clone(), painted];
        let mesh = mesh.with_materials(materials, Some(slots)).unwrap();
        let (once, note) = merged(mesh).unwrap();
        assert_eq!(once.triangles(), own);
        assert_eq!(once.texture_coords().unwrap(), &corners[..8]);
        assert_eq!(once.triangle_materials().unwrap(), [3, 3, 3, 4, 3, 3, 3, 3]);
        assert!(
            once.materials()[3..]
                .iter()
                .all(|material| material.double_sided)
        );
        let note = note.unwrap();
        assert!(note.contains("2 of the others look different"), "{note}");
    }
}
