//! Meshes as points.

use crate::error::{Error, Result};
use glam::DVec3;
use mvs_datasets::scene::Mesh;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};
use serde::{Deserialize, Serialize};

/// More samples than this are a mistake of units.
const MOST_SAMPLES: f64 = 5e8;

/// Which points stand for a mesh.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum MeshAs {
    /// Its vertices, as the official toolbox reads meshes.
    Vertices,
    /// The centres of its triangles.
    Centroids,
    /// Points uniform by area, at least one per (τ/2)².
    #[default]
    Area,
}

impl std::fmt::Display for MeshAs {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Vertices => "vertices",
            Self::Centroids => "centroids",
            Self::Area => "area",
        })
    }
}

/// The points that stand for `mesh`; with [`MeshAs::Area`] one per `spacing`² of surface, seeded.
///
/// # Errors
/// With [`MeshAs::Area`] a mesh without surface, and more than 5 · 10⁸ points: the unit must be another one.
pub fn points_of(mesh: &Mesh, how: MeshAs, spacing: f64, seed: u64) -> Result<Vec<DVec3>> {
    match how {
        MeshAs::Vertices => Ok(mesh.vertices().to_vec()),
        MeshAs::Centroids => Ok(triangles(mesh).map(|[a, b, c]| (a + b + c) / 3.0).collect()),
        MeshAs::Area => by_area(mesh, spacing, seed),
    }
}

/// The fraction of the surface that lies in triangles with an edge longer than `width`, in [0, 1].
pub fn coarse_fraction(mesh: &Mesh, width: f64) -> f64 {
    let (mut coarse, mut all) = (0.0, 0.0);
    for triangle in triangles(mesh) {
        let [a, b, c] = triangle;
        let longest = a.distance(b).max(b.distance(c)).max(c.distance(a));
        let area = area_of(triangle);
        all += area;
        if longest > width {
            coarse += area;
        }
    }
    if all > 0.0 { coarse / all } else { 0.0 }
}

fn triangles(mesh: &Mesh) -> impl Iterator<Item = [DVec3; 3]> {
    (0..mesh.triangles().len()).map(|triangle| mesh.corners(triangle))
}

fn area_of([a, b, c]: [DVec3; 3]) -> f64 {
    0.5 * (b - a).cross(c - a).length()
}

/// Lays all triangles' areas end to end, cuts the line into pieces of `spacing`² and draws one point
/// in each: counts are even, and no triangle is favoured.
fn by_area(mesh: &Mesh, spacing: f64, seed: u64) -> Result<Vec<DVec3>> {
    let total: f64 = triangles(mesh).map(area_of).sum();
    let piece = spacing * spacing;
    let count = (total / piece).ceil();
    if !(1.0..=MOST_SAMPLES).contains(&count) {
        let problem = format!(
            "expected a surface for 1 to {MOST_SAMPLES} samples, found an area of {total} and a \
             sample per {piece}: is τ in the unit of the mesh?"
        );
        return Err(Error::invalid("mesh", problem));
    }
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let piece = total / count;
    let mut points = Vec::with_capacity(count as usize);
    let (mut passed, mut next) = (0.0, unit(&mut rng) * piece);
    for triangle in triangles(mesh) {
        passed += area_of(triangle);
        while next < passed && points.len() < count as usize {
            points.push(inside(triangle, unit(&mut rng), unit(&mut rng)));
            next = (points.len() as f64 + unit(&mut rng)) * piece;
        }
    }
    Ok(points)
}

/// Uniform in [0, 1).
fn unit(rng: &mut ChaCha8Rng) -> f64 {
    (rng.next_u64() >> 11) as f64 / (1u64 << 53) as f64
}

/// A point of the triangle, uniform by area for uniform `u` and `v`.
fn inside([a, b, c]: [DVec3; 3], u: f64, v: f64) -> DVec3 {
    let root = u.sqrt();
    a * (1.0 - root) + b * (root * (1.0 - v)) + c * (root * v)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A rectangle 4 × 1 of one large and many small triangles over the same area each.
    fn rectangle() -> Mesh {
        let mut vertices = vec![DVec3::ZERO, DVec3::X * 4.0, DVec3::new(4.0, 1.0, 0.0)];
        let mut triangles = vec![[0u32, 1, 2]];
        for slice in 0..100 {
            let at = |i: u32| DVec3::new(4.0, 1.0, 0.0) * (f64::from(i) / 100.0);
            let first = vertices.len() as u32;
            vertices.extend([at(slice), at(slice + 1), DVec3::Y]);
            triangles.push([first, first + 1, first + 2]);
        }
        Mesh::new(vertices, triangles).unwrap()
    }

    #[test]
    fn samples_are_uniform_by_area() {
        let points = points_of(&rectangle(), MeshAs::Area, 0.01, 1).unwrap();
        assert!(
            (40_000..=40_001).contains(&points.len()),
            "{}",
            points.len()
        );
        // Every cell of 0.2 × 0.2 should hold 400, with a standard deviation of at most 20.
        let mut counts = [0i32; 100];
        for point in &points {
            assert!(point.z == 0.0 && (0.0..=4.0).contains(&point.x));
            counts[(point.x * 5.0) as usize * 5 + ((point.y * 5.0) as usize).min(4)] += 1;
        }
        assert!(
            counts.iter().all(|count| (count - 400).abs() < 100),
            "{counts:?}"
        );
    }

    #[test]
    fn the_seed_decides() {
        let mesh = rectangle();
        let sample = |seed| points_of(&mesh, MeshAs::Area, 0.1, seed).unwrap();
        assert_eq!(sample(1), sample(1));
        assert_ne!(sample(1), sample(2));
    }

    #[test]
    fn vertices_centroids_and_the_coarse_fraction() {
        let mesh = rectangle();
        assert_eq!(
            points_of(&mesh, MeshAs::Vertices, 1.0, 0).unwrap().len(),
            303
        );
        let centroids = points_of(&mesh, MeshAs::Centroids, 1.0, 0).unwrap();
        assert_eq!(centroids.len(), 101);
        assert!((centroids[0] - DVec3::new(8.0 / 3.0, 1.0 / 3.0, 0.0)).length() < 1e-15);
        assert_eq!(coarse_fraction(&mesh, 5.0), 0.0);
        assert!((coarse_fraction(&mesh, 4.11) - 0.5).abs() < 1e-12); // the large one: √17
        assert_eq!(coarse_fraction(&mesh, 0.1), 1.0);
    }

    #[test]
    fn no_surface_and_too_much_of_it_are_errors() {
        let flat = Mesh::new(vec![DVec3::ZERO; 3], vec![[0, 1, 2]]).unwrap();
        assert!(points_of(&flat, MeshAs::Area, 0.1, 0).is_err());
        let error = points_of(&rectangle(), MeshAs::Area, 1e-7, 0)
            .unwrap_err()
            .to_string();
        assert!(error.contains("area of 4"), "{error}");
    }
}
