//! Rays against exhaustive searches and the oracle.

use super::*;
use glam::DMat3;
use mvs_eval::render::oracle::Oracle;

#[test]
fn first_hits_agree_with_an_exhaustive_search() {
    let mesh = sphere(12);
    let renderer = Renderer::new(&mesh).unwrap();
    let mut met = 0;
    for i in 0..1500 {
        let t = f64::from(i);
        let origin = DVec3::new((t * 0.7).sin(), (t * 1.1).cos(), (t * 0.3).sin()) * 2.0;
        let direction =
            DVec3::new((t * 3.1).cos(), (t * 2.3).sin(), (t * 1.9).cos()) - origin * 0.3;
        let range = (0.05, 2.5);
        let expected = (0..mesh.triangles().len())
            .filter_map(|triangle| {
                Some((cramer(mesh.corners(triangle), origin, direction)?, triangle))
            })
            .filter(|(distance, _)| range.0 < *distance && *distance < range.1)
            .min_by(|a, b| a.0.total_cmp(&b.0));
        let found = renderer.first_hit(origin, direction, range);
        assert_eq!(found.is_some(), expected.is_some(), "ray {i}");
        if let (Some(hit), Some((distance, _))) = (found, expected) {
            assert!(
                (hit.distance - distance).abs() < 1e-9,
                "ray {i}: {hit:?} for {distance}"
            );
            let [a, b, c] = mesh.corners(hit.triangle);
            let [v, w] = hit.weights;
            let point = a * (1.0 - v - w) + b * v + c * w;
            assert!((point - (origin + hit.distance * direction)).length() < 1e-9);
            met += 1;
        }
    }
    assert!(met > 100, "{met}");
}

/// Distance to a triangle by Cramer's rule, an independent formula.
fn cramer([a, b, c]: [DVec3; 3], origin: DVec3, direction: DVec3) -> Option<f64> {
    let system = DMat3::from_cols(b - a, c - a, -direction);
    let solved = system.inverse() * (origin - a);
    let inside = solved.x >= 0.0 && solved.y >= 0.0 && solved.x + solved.y <= 1.0;
    (system.determinant() != 0.0 && inside).then_some(solved.z)
}

#[test]
fn no_ray_slips_through_edges_or_corners_of_closed_meshes() {
    let mut noise = Noise(3);
    for mesh in [
        sphere(40),
        cuboid(DVec3::ZERO, DVec3::new(0.6, 1.0, 0.3)),
        scaled(&sphere(9), 1e-5),
    ] {
        let renderer = Renderer::new(&mesh).unwrap();
        let size = mesh.bounds().size().min_element();
        let count = mesh.triangles().len();
        for index in 0..60_000 {
            let [a, b, _] = mesh.corners(index * 7919 % count);
            let along = if index % 2 == 0 {
                0.0
            } else {
                0.5 + 0.5 * noise.next()
            };
            let origin = noise.vector() * 0.1 * size;
            let target = a.lerp(b, along);
            let hit = renderer.first_hit(origin, target - origin, (0.0, f64::INFINITY));
            let hit = hit.unwrap_or_else(|| panic!("a leak from {origin} to {target}"));
            assert!((hit.distance - 1.0).abs() < 1e-6, "{hit:?}");
        }
    }
}

#[test]
fn first_hits_are_those_of_the_oracle_to_the_bit() {
    let mesh = soup(4000, 5);
    let (renderer, oracle) = (Renderer::new(&mesh).unwrap(), Oracle::new(&mesh));
    let mut noise = Noise(11);
    let mut hits = 0;
    for index in 0..4000 {
        let origin = noise.vector() * 1.5;
        // Some rays along an axis, some with a limit, some from on a triangle.
        let direction = if index % 10 == 0 {
            DVec3::AXES[index / 10 % 3]
        } else {
            noise.vector()
        };
        let range = if index % 3 == 0 {
            (0.2, 0.9)
        } else {
            (0.0, f64::INFINITY)
        };
        let found = renderer.first_hit(origin, direction, range);
        assert_eq!(
            found,
            oracle.first_hit(origin, direction, range),
            "ray {index}"
        );
        hits += usize::from(found.is_some());
    }
    assert!(hits > 500, "{hits}");
}

#[test]
fn many_rays_from_one_point_are_those_shot_alone() {
    let mesh = soup(2000, 9);
    let renderer = Renderer::new(&mesh).unwrap();
    let mut noise = Noise(31);
    for (index, count) in [0, 1, 17, 3000].into_iter().enumerate() {
        let origin = noise.vector() * 1.2;
        let axis = noise.vector();
        // A fan as a camera's rays are, then rays in all directions.
        let spread = [0.3, 0.3, 5.0, 0.2][index];
        let directions: Vec<DVec3> = (0..count).map(|_| axis + spread * noise.vector()).collect();
        let range = [(0.0, f64::INFINITY), (0.1, 1.0)][index % 2];
        let together = renderer.first_hits(origin, &directions, range);
        let alone = directions
            .iter()
            .map(|&direction| renderer.first_hit(origin, direction, range));
        assert!(alone.eq(together), "{count} rays");
    }
}
