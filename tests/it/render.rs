//! The renderer against closed forms and against an exhaustive search.

use glam::{DMat3, DVec2, DVec3, Vec2};
use mvs_datasets::scene::{Camera, ColorImage, Corner, Material, Mesh, Pose, Raster, View};
use mvs_eval::render::oracle::Oracle;
use mvs_eval::render::{RenderOptions, Renderer, Rendering};
use std::sync::Arc;

fn view(pose: Pose, width: u32, height: u32) -> View {
    let focal = f64::from(width);
    let center = DVec2::new(f64::from(width) * 0.5 + 0.3, f64::from(height) * 0.5 - 0.2);
    View {
        id: 0,
        name: String::new(),
        camera: Camera::new(width, height, DVec2::new(focal, focal * 1.01), center).unwrap(),
        pose,
        depth_range: None,
    }
}

fn draft(mesh: &Mesh, view: &View) -> Rendering {
    let options = RenderOptions {
        samples: 1,
        ..RenderOptions::default()
    };
    Renderer::new(mesh).unwrap().render(view, &options).unwrap()
}

/// The direction of pixel (column, row)'s centre, in the camera frame with z = 1.
fn direction(view: &View, column: u32, row: u32) -> DVec3 {
    view.camera
        .ray(DVec2::new(f64::from(column), f64::from(row)) + 0.5)
}

/// A unit sphere of latitude and longitude, `rings` from pole to pole.
fn sphere(rings: u32) -> Mesh {
    let around = 2 * rings;
    let mut vertices = Vec::new();
    for ring in 0..=rings {
        let polar = std::f64::consts::PI * f64::from(ring) / f64::from(rings);
        for step in 0..around {
            let turn = std::f64::consts::TAU * f64::from(step) / f64::from(around);
            let (sin, cos) = polar.sin_cos();
            vertices.push(DVec3::new(sin * turn.cos(), sin * turn.sin(), cos));
        }
    }
    let mut triangles = Vec::new();
    for ring in 0..rings {
        for step in 0..around {
            let (a, b) = (ring * around + step, ring * around + (step + 1) % around);
            triangles.extend([[a, a + around, b], [b, a + around, b + around]]);
        }
    }
    Mesh::new(vertices, triangles).unwrap()
}

/// An axis-aligned box around `center`, its faces outwards.
fn cuboid(center: DVec3, half: DVec3) -> Mesh {
    let corner = |i: u32| {
        let sign = |bit: u32| if i >> bit & 1 == 1 { 1.0 } else { -1.0 };
        center + half * DVec3::new(sign(0), sign(1), sign(2))
    };
    let quads = [
        [0, 4, 6, 2],
        [1, 3, 7, 5],
        [0, 1, 5, 4],
        [2, 6, 7, 3],
        [0, 2, 3, 1],
        [4, 5, 7, 6],
    ];
    let triangles = quads
        .iter()
        .flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]])
        .collect();
    Mesh::new((0..8).map(corner).collect(), triangles).unwrap()
}

/// Two triangles with corners `corners` in order around; texture coordinates (0,0), (1,0), (1,1),
/// (0,1).
fn quad(corners: [DVec3; 4]) -> Mesh {
    let [a, b, c, d] = [Vec2::ZERO, Vec2::X, Vec2::ONE, Vec2::Y];
    let coords: Vec<Corner> = vec![[a, b, c], [a, c, d]];
    Mesh::new(corners.to_vec(), vec![[0, 1, 2], [0, 2, 3]])
        .unwrap()
        .with_texture_coords(coords)
        .unwrap()
}

fn facing_quad(depth: f64) -> Mesh {
    quad([
        DVec3::new(-1.0, 1.0, depth),
        DVec3::new(1.0, 1.0, depth),
        DVec3::new(1.0, -1.0, depth),
        DVec3::new(-1.0, -1.0, depth),
    ])
}

#[test]
fn a_tilted_plane_has_the_depth_of_its_equation() {
    let normal = DVec3::new(0.3, -0.5, -1.0).normalize();
    let anchor = DVec3::new(0.1, 0.2, 4.0);
    let (along, across) = normal.any_orthonormal_pair();
    let mesh = quad(
        [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)]
            .map(|(s, t)| anchor + 1e3 * (s * along + t * across)),
    );
    let view = view(Pose::IDENTITY, 64, 48);
    let rendering = draft(&mesh, &view);
    for row in 0..48 {
        for column in 0..64 {
            let exact = normal.dot(anchor) / normal.dot(direction(&view, column, row));
            let found = f64::from(rendering.depth.get(column, row));
            assert!(
                (found / exact - 1.0).abs() < 1e-7,
                "({column}, {row}): {found} for {exact}"
            );
            let facing = DVec3::from(rendering.normals.get(column, row).map(f64::from));
            assert!((facing - normal).length() < 1e-6, "{facing}");
        }
    }
}

#[test]
fn a_sphere_is_met_within_its_tessellation_and_only_there() {
    let rings = 200;
    let mesh = sphere(rings);
    let eye = DVec3::new(2.0, -1.5, 1.0);
    let view = view(
        Pose::looking_at(eye, DVec3::ZERO, DVec3::Z).unwrap(),
        120,
        100,
    );
    let rendering = draft(&mesh, &view);
    // Facets lie inside the sphere by at most the sagitta of their longer diagonal.
    let step = std::f64::consts::PI / f64::from(rings);
    let sagitta = 1.0 - (step * std::f64::consts::SQRT_2 / 2.0).cos();
    let (mut hits, mut edge) = (0, 0);
    for row in 0..100 {
        for column in 0..120 {
            let towards = view.pose.direction_to_world(direction(&view, column, row));
            let along = -eye.dot(towards) / towards.length_squared();
            let closest = (eye + along * towards).length();
            let depth = f64::from(rendering.depth.get(column, row));
            if depth == 0.0 {
                assert!(closest > 1.0 - sagitta, "hole at ({column}, {row})");
                continue;
            }
            hits += 1;
            let point = eye + depth * towards;
            assert!(closest <= 1.0 && depth < along, "({column}, {row})");
            assert!(point.length() > 1.0 - sagitta - 1e-6 && point.length() < 1.0 + 1e-6);
            let normal = DVec3::from(rendering.normals.get(column, row).map(f64::from));
            let outwards = view.pose.rotation() * point.normalize();
            edge += usize::from(normal.dot(outwards) < (1.5 * step).cos());
        }
    }
    assert!(
        hits > 2000 && edge == 0,
        "{hits} hits, {edge} wrong normals"
    );
}

#[test]
fn a_box_at_a_large_offset_has_slab_depths() {
    for offset in [DVec3::ZERO, DVec3::new(4.5e5, 5.1e6, 1e6)] {
        let half = DVec3::new(1.0, 2.0, 0.5);
        let eye = offset + DVec3::new(5.0, -4.0, 3.0);
        let mesh = cuboid(offset, half);
        let view = view(Pose::looking_at(eye, offset, DVec3::Z).unwrap(), 80, 60);
        let rendering = draft(&mesh, &view);
        // The pose itself is rounded at this offset: the camera is where the pose says.
        let eye = view.pose.to_cam(offset);
        let from = view.pose.direction_to_world(-eye);
        let mut hits = 0;
        for row in 0..60 {
            for column in 0..80 {
                let towards = view.pose.direction_to_world(direction(&view, column, row));
                let (one, two) = ((-half - from) / towards, (half - from) / towards);
                let (near, far) = (one.min(two).max_element(), one.max(two).min_element());
                let depth = f64::from(rendering.depth.get(column, row));
                if (near - far).abs() < 1e-9 {
                    continue;
                }
                assert_eq!(depth > 0.0, near < far, "({column}, {row}) at {offset}");
                if depth > 0.0 {
                    assert!((depth / near - 1.0).abs() < 1e-7, "{depth} for {near}");
                    hits += 1;
                }
            }
        }
        assert!(hits > 400, "{hits}");
    }
}

#[test]
fn scale_changes_nothing_but_the_unit() {
    for scale in [1e-6, 1e6] {
        let view = view(
            Pose::looking_at(DVec3::X * 3.0 * scale, DVec3::ZERO, DVec3::Z).unwrap(),
            64,
            64,
        );
        let large = sphere(20);
        let vertices = large.vertices().iter().map(|v| *v * scale).collect();
        let mesh = Mesh::new(vertices, large.triangles().to_vec()).unwrap();
        let rendering = draft(&mesh, &view);
        let depth = f64::from(rendering.depth.get(32, 32));
        assert!((depth / scale - 2.0).abs() < 0.01, "{depth} at {scale}");
    }
}

#[test]
fn a_texture_lies_the_right_way_up_and_is_filtered() {
    // Texel centres fall on pixel centres: 8x8 texels over 8x8 pixels.
    let texels: Vec<[u8; 3]> = (0..64u8).map(|i| [i % 8 * 30, i / 8 * 30, i]).collect();
    let texture = ColorImage::from_values(8, 8, texels).unwrap();
    let material = Material {
        texture: Some(Arc::new(texture.clone())),
        ..Material::default()
    };
    let mesh = facing_quad(2.0)
        .with_materials(vec![material], None)
        .unwrap();
    let mut view = view(Pose::IDENTITY, 8, 8);
    view.camera = Camera::new(8, 8, DVec2::splat(8.0), DVec2::splat(4.0)).unwrap();
    assert_eq!(draft(&mesh, &view).color, texture);
    // 16 samples spread over half a texel to each side: linear inside, so the mean stays.
    let fine = Renderer::new(&mesh)
        .unwrap()
        .render(&view, &RenderOptions::default())
        .unwrap();
    for row in 1..7 {
        for column in 1..7 {
            assert_eq!(fine.color.get(column, row), texture.get(column, row));
        }
    }
}

#[test]
fn supersampling_averages_what_one_sample_misses() {
    // Stripes two texels wide in one pixel: one sample sees a stripe, sixteen see grey.
    let stripes = (0..64u32)
        .map(|column| [if column % 4 < 2 { 0 } else { 200 }; 3])
        .collect();
    let texture = Arc::new(ColorImage::from_values(64, 1, stripes).unwrap());
    let material = Material {
        texture: Some(texture),
        ..Material::default()
    };
    let mesh = facing_quad(2.0)
        .with_materials(vec![material], None)
        .unwrap();
    let mut view = view(Pose::IDENTITY, 16, 16);
    view.camera = Camera::new(16, 16, DVec2::splat(16.0), DVec2::splat(8.0)).unwrap();
    let fine = Renderer::new(&mesh)
        .unwrap()
        .render(&view, &RenderOptions::default())
        .unwrap();
    for value in &fine.color.values()[17..30] {
        assert!(
            value.iter().all(|channel| (95..=105).contains(channel)),
            "{value:?}"
        );
    }
}

#[test]
fn every_face_shows_its_own_material_and_the_nearest_wins() {
    let paint = |color| Material {
        color,
        ..Material::default()
    };
    let colors = [[255, 0, 0], [0, 255, 0], [0, 0, 255], [9, 8, 7]];
    let (near, far) = (facing_quad(2.0), facing_quad(3.0));
    let vertices: Vec<DVec3> = far
        .vertices()
        .iter()
        .chain(near.vertices())
        .copied()
        .collect();
    let shifted = near.triangles().iter().map(|t| t.map(|i| i + 4));
    let triangles: Vec<[u32; 3]> = far.triangles().iter().copied().chain(shifted).collect();
    let mesh = Mesh::new(vertices, triangles)
        .unwrap()
        .with_materials(colors.map(paint).to_vec(), Some(vec![3, 3, 1, 2]))
        .unwrap();
    let rendering = draft(&mesh, &view(Pose::IDENTITY, 16, 16));
    assert_eq!(rendering.color.get(13, 10), colors[1], "below the diagonal");
    assert_eq!(rendering.color.get(3, 4), colors[2], "above the diagonal");
    assert!(
        !rendering.color.values().contains(&colors[3]),
        "the far quad is hidden"
    );
}

#[test]
fn of_two_equal_triangles_the_first_is_seen() {
    let mesh = facing_quad(2.0);
    let twice: Vec<[u32; 3]> = mesh.triangles().repeat(2);
    let materials = [[1; 3], [2; 3], [3; 3], [4; 3]].map(|color| Material {
        color,
        ..Material::default()
    });
    let mesh = Mesh::new(mesh.vertices().to_vec(), twice)
        .unwrap()
        .with_materials(materials.to_vec(), Some(vec![3, 2, 1, 0]))
        .unwrap();
    let rendering = draft(&mesh, &view(Pose::IDENTITY, 33, 33));
    assert!(
        rendering
            .color
            .values()
            .iter()
            .all(|color| *color == [4; 3] || *color == [3; 3] || *color == [0; 3])
    );
    assert!(
        rendering.color.values().contains(&[4; 3]) && rendering.color.values().contains(&[3; 3])
    );
}

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
fn a_camera_inside_a_closed_mesh_sees_no_hole() {
    let mesh = sphere(30);
    for (index, target) in [DVec3::X, DVec3::NEG_Y, DVec3::new(0.1, 0.2, 1.0)]
        .iter()
        .enumerate()
    {
        let eye = DVec3::new(0.1, 0.0, -0.2) * index as f64;
        let pose = Pose::looking_at(eye, *target, DVec3::new(0.0, 0.6, 0.8)).unwrap();
        let rendering = draft(&mesh, &view(pose, 200, 200));
        assert_eq!(rendering.depth.valid_count(), 200 * 200);
    }
}

#[test]
fn the_background_and_the_number_of_samples_are_as_asked() {
    let mesh = facing_quad(4.0);
    let renderer = Renderer::new(&mesh).unwrap();
    let view = view(Pose::IDENTITY, 32, 32);
    let options = RenderOptions {
        samples: 4,
        background: [1, 2, 3],
    };
    let rendering = renderer.render(&view, &options).unwrap();
    assert_eq!(
        (rendering.color.get(0, 0), rendering.depth.get(0, 0)),
        ([1, 2, 3], 0.0)
    );
    assert_eq!(rendering.normals.get(0, 0), [0.0; 3]);
    assert_eq!(rendering.color.get(16, 16), Material::default().color);
    for samples in [0, 2, 3, 81] {
        let wrong = RenderOptions { samples, ..options };
        let error = renderer.render(&view, &wrong).unwrap_err().to_string();
        assert!(error.contains(&format!("found {samples}")), "{error}");
    }
    assert!(Renderer::new(&Mesh::new(vec![DVec3::ZERO], vec![]).unwrap()).is_err());
}

#[test]
fn threads_do_not_change_a_byte() {
    let mesh = sphere(15);
    let view = view(
        Pose::looking_at(DVec3::splat(2.0), DVec3::ZERO, DVec3::Z).unwrap(),
        90,
        70,
    );
    let renderer = Renderer::new(&mesh).unwrap();
    let render = || renderer.render(&view, &RenderOptions::default()).unwrap();
    let one = mvs_eval::parallel::with_threads(1, render).unwrap();
    let four = mvs_eval::parallel::with_threads(4, render).unwrap();
    assert!(one == four);
    let _: &Raster<[u8; 3]> = &one.color;
}

/// Numbers between -1 and 1 that look random and never change.
struct Noise(u64);

impl Noise {
    fn next(&mut self) -> f64 {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    }

    fn vector(&mut self) -> DVec3 {
        DVec3::new(self.next(), self.next(), self.next())
    }
}

/// Triangles of all shapes, thrown into a cube: large and tiny ones, slivers, copies.
fn soup(count: u32, seed: u64) -> Mesh {
    let mut noise = Noise(seed);
    let mut vertices = Vec::new();
    for index in 0..count {
        let anchor = noise.vector();
        let size = 10f64.powf(1.5 * noise.next() - 1.5);
        let sliver = if index % 5 == 0 { 1e-6 } else { 1.0 };
        let (along, across) = (noise.vector() * size, noise.vector() * size * sliver);
        vertices.extend([anchor, anchor + along, anchor + across + 0.3 * along]);
        if index % 7 == 0 {
            let copy = vertices[vertices.len() - 3..].to_vec();
            vertices.extend(copy);
        }
    }
    let count = u32::try_from(vertices.len()).unwrap();
    let triangles = (0..count / 3)
        .map(|t| [3 * t, 3 * t + 1, 3 * t + 2])
        .collect();
    let colors = (0..count).map(|_| noise.vector().to_array().map(|v| (100.0 * v + 120.0) as u8));
    let colors = colors.collect();
    Mesh::new(vertices, triangles)
        .unwrap()
        .with_vertex_colors(colors)
        .unwrap()
}

/// Hills over the unit square, `side` x `side` cells.
fn terrain(side: u32) -> Mesh {
    let at = |i: u32| f64::from(i) / f64::from(side) * 2.0 - 1.0;
    let height =
        |x: f64, y: f64| 0.1 * (7.0 * x).sin() * (5.0 * y).cos() + 0.02 * (40.0 * x * y).sin();
    let vertices = (0..=side)
        .flat_map(|j| (0..=side).map(move |i| DVec3::new(at(i), at(j), height(at(i), at(j)))));
    let cell = |i: u32, j: u32| {
        let a = j * (side + 1) + i;
        [[a, a + 1, a + side + 2], [a, a + side + 2, a + side + 1]]
    };
    let triangles = (0..side)
        .flat_map(|j| (0..side).flat_map(move |i| cell(i, j)))
        .collect();
    Mesh::new(vertices.collect(), triangles).unwrap()
}

#[test]
fn the_fast_renderer_agrees_with_the_oracle_to_the_byte() {
    let meshes = [
        ("sphere", sphere(40), 1.0),
        ("cuboid", cuboid(DVec3::ZERO, DVec3::splat(0.6)), 1.0),
        ("soup", soup(3000, 1), 1.0),
        ("terrain", terrain(120), 1.0),
        (
            "terrain far away",
            moved(&terrain(60), DVec3::new(5e5, -4e6, 1e3)),
            1.0,
        ),
        ("small soup", scaled(&soup(500, 2), 1e-6), 1e-6),
        ("large soup", scaled(&soup(500, 3), 1e6), 1e6),
    ];
    let mut noise = Noise(7);
    for (name, mesh, scale) in &meshes {
        let renderer = Renderer::new(mesh).unwrap();
        let oracle = Oracle::new(mesh);
        let middle = mesh.bounds().center();
        for index in 0..6 {
            // From outside, from inside, and so close that triangles reach behind the camera.
            let reach = [3.0, 1.3, 0.5, 0.2, 0.05, 2.0][index];
            let eye = middle + noise.vector().normalize() * reach * *scale;
            let target = middle + noise.vector() * 0.3 * *scale;
            let pose = Pose::looking_at(eye, target, noise.vector()).unwrap();
            let view = view(pose, 90 + index as u32, 51);
            let options = RenderOptions {
                samples: [1, 4, 9][index % 3],
                ..RenderOptions::default()
            };
            let fast = renderer.render(&view, &options).unwrap();
            let slow = oracle.render(&view, &options).unwrap();
            let differing = |a: &[f32], b: &[f32]| {
                a.iter()
                    .zip(b)
                    .filter(|(a, b)| a.to_bits() != b.to_bits())
                    .count()
            };
            assert_eq!(
                differing(fast.depth.values(), slow.depth.values()),
                0,
                "depth of {name} {index}"
            );
            assert!(fast.normals == slow.normals, "normals of {name} {index}");
            assert!(fast.color == slow.color, "colors of {name} {index}");
        }
    }
}

fn moved(mesh: &Mesh, offset: DVec3) -> Mesh {
    let vertices = mesh
        .vertices()
        .iter()
        .map(|vertex| *vertex + offset)
        .collect();
    Mesh::new(vertices, mesh.triangles().to_vec()).unwrap()
}

fn scaled(mesh: &Mesh, scale: f64) -> Mesh {
    let vertices = mesh
        .vertices()
        .iter()
        .map(|vertex| *vertex * scale)
        .collect();
    Mesh::new(vertices, mesh.triangles().to_vec()).unwrap()
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

/// Two bumpy sheets, closer to each other than f32 can tell, whose every vertex lies behind the
/// centre of a pixel of `view`: all decisions are about roundings.
fn sheets_behind_pixels(view: &View) -> Mesh {
    let (width, height) = (view.camera.width(), view.camera.height());
    let mut noise = Noise(23);
    let mut vertices = Vec::new();
    let mut triangles = Vec::new();
    for _ in 0..2 {
        let first = u32::try_from(vertices.len()).unwrap();
        for row in 0..height {
            for column in 0..width {
                let bump = 0.1 * f64::from(column * row).sin();
                let depth = (2.0 + bump) * (1.0 + 1e-7 * noise.next());
                vertices.push(view.pose.to_world(direction(view, column, row) * depth));
                let at = first + row * width + column;
                if column + 1 < width && row + 1 < height {
                    triangles.extend([
                        [at, at + 1, at + width + 1],
                        [at, at + width + 1, at + width],
                    ]);
                }
            }
        }
    }
    Mesh::new(vertices, triangles).unwrap()
}

#[test]
fn what_f32_cannot_tell_is_decided_exactly() {
    let pose = Pose::looking_at(DVec3::new(3.0, 1.0, 2.0), DVec3::ZERO, DVec3::Z).unwrap();
    let view = view(pose, 80, 60);
    let mesh = sheets_behind_pixels(&view);
    let (renderer, oracle) = (Renderer::new(&mesh).unwrap(), Oracle::new(&mesh));
    let options = RenderOptions {
        samples: 1,
        ..RenderOptions::default()
    };
    // Through the vertices, then through the insides of the triangles.
    for offset in [0.0, 0.3] {
        let mut view = view.clone();
        let center = view.camera.center() + DVec2::new(offset, 0.4 * offset);
        view.camera = Camera::new(80, 60, view.camera.focal(), center).unwrap();
        let fast = renderer.render(&view, &options).unwrap();
        let slow = oracle.render(&view, &options).unwrap();
        assert!(
            fast.normals == slow.normals,
            "another triangle is seen at {offset}"
        );
        assert!(fast.depth == slow.depth, "another depth at {offset}");
    }
}
