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

/// What rays from one point meet together is what each meets alone.
fn check_bundle(renderer: &Renderer<'_>, origin: DVec3, directions: &[DVec3], what: &str) -> usize {
    let mut met = 0;
    for range in [(0.0, f64::INFINITY), (0.3, 1.1), (0.0, 0.999)] {
        let together = renderer.first_hits(origin, directions, range);
        let blocked = renderer.blocked(origin, directions, range);
        assert_eq!(together.len(), directions.len());
        for (index, &direction) in directions.iter().enumerate() {
            let alone = renderer.first_hit(origin, direction, range);
            assert_eq!(together[index], alone, "{what}, ray {index}, {direction}");
            assert_eq!(blocked[index], alone.is_some(), "{what}, ray {index}");
            met += usize::from(alone.is_some());
        }
    }
    met
}

#[test]
fn packets_meet_what_single_rays_meet() {
    let mut noise = Noise(77);
    let mut met = 0;
    for (name, mesh) in [
        ("terrain", terrain(150)),
        ("coarse terrain", terrain(3)),
        ("soup", soup(5000, 8)),
        ("sphere", sphere(30)),
        ("small sphere", scaled(&sphere(30), 1e-6)),
        (
            "far sphere",
            moved(&sphere(30), DVec3::new(5e5, 4e6, -300.0)),
        ),
    ] {
        let renderer = Renderer::new(&mesh).unwrap();
        let (center, size) = (mesh.bounds().center(), mesh.bounds().size().max_element());
        for distance in [0.02, 0.3, 2.0, 50.0] {
            let origin = center + noise.vector().normalize() * distance * size;
            let ahead = center - origin;
            // A camera's rays, then to corners and points on edges in no order, then all around.
            let (right, down) = ahead.normalize().any_orthonormal_pair();
            let place = |index: u32, steps: u32| size * (f64::from(index) / f64::from(steps) - 0.5);
            let camera =
                (0..60 * 40).map(|i| ahead + right * place(i % 60, 60) + down * place(i / 60, 40));
            let aimed = (0..2000).map(|_| {
                let triangle = (noise.next().abs() * 1e9) as usize % mesh.triangles().len();
                let [a, b, _] = mesh.corners(triangle);
                let along = if noise.next() < 0.0 {
                    0.0
                } else {
                    noise.next().abs()
                };
                a.lerp(b, along) - origin
            });
            let aimed: Vec<DVec3> = aimed.collect();
            let around = (0..1000).map(|_| noise.vector() * size);
            let mut directions: Vec<DVec3> = camera.chain(around).collect();
            directions.extend(aimed);
            met += check_bundle(&renderer, origin, &directions, name);
        }
    }
    assert!(met > 50_000, "{met}");
}

#[test]
fn packets_take_any_direction_and_any_number_of_threads() {
    let mesh = soup(3000, 4);
    let renderer = Renderer::new(&mesh).unwrap();
    let odd = [
        DVec3::ZERO,
        DVec3::NAN,
        DVec3::new(f64::INFINITY, 0.0, 1.0),
        DVec3::splat(1e-300),
        DVec3::splat(1e300),
        DVec3::new(1e-170, -1e-170, 1e-160),
        DVec3::NEG_X,
        DVec3::new(0.0, -0.0, 1.0),
    ];
    let mut noise = Noise(5);
    let origin = DVec3::new(0.1, 0.2, -0.1);
    let mut directions: Vec<DVec3> = (0..40_000).map(|_| noise.vector()).collect();
    for (index, direction) in directions.iter_mut().enumerate() {
        // Alike ones too: many of a packet's rays are one.
        if index % 50 < odd.len() {
            *direction = odd[index % 50];
        }
    }
    assert!(check_bundle(&renderer, origin, &directions[..20_000], "odd") > 3000);
    let range = (0.0, f64::INFINITY);
    let at = |threads| {
        mvs_eval::parallel::with_threads(threads, || {
            renderer.first_hits(origin, &directions, range)
        })
    };
    let alone = at(1).unwrap();
    for threads in [2, 8] {
        assert!(at(threads).unwrap() == alone, "{threads} threads");
    }
    check_bundle(&renderer, origin, &odd, "only odd ones");
    check_bundle(&renderer, origin, &[DVec3::X; 100], "all alike");
}
