//! The fast renderer against the exact one, to the byte.

use super::*;
use glam::Vec2;
use mvs_datasets::scene::{ColorImage, Material, Raster};
use mvs_eval::render::Seen;
use mvs_eval::render::oracle::Oracle;
use std::sync::Arc;

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
    // Exact maps too, of triangles smaller than pixels.
    let mesh = terrain(400);
    let view = super::view(view.pose, 300, 200);
    let renderer = Renderer::new(&mesh).unwrap();
    let see = || {
        let mut seen = Seen::default();
        renderer.see(&view, &mut seen).map(|()| seen).unwrap()
    };
    let one = mvs_eval::parallel::with_threads(1, see).unwrap();
    let four = mvs_eval::parallel::with_threads(4, see).unwrap();
    assert!(one == four);
    let hits = one.depth.iter().filter(|&&depth| depth > 0.0).count();
    assert!(hits > 10_000, "{hits}");
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
    let (mut hits, mut seen) = (0, Seen::default());
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
            // One of them in several bands.
            let rows = if index == 3 { 140 } else { 51 };
            let view = view(pose, 90 + index as u32, rows);
            let options = RenderOptions {
                samples: [1, 4, 9][index % 3],
                back_faces: BackFaces::Valid,
                interpolated_normals: index % 2 == 0,
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
            renderer.see(&view, &mut seen).unwrap();
            hits += agree(mesh, &view, &seen, &slow);
            assert!(fast == slow, "masks or smooth normals of {name} {index}");
            let fronts = RenderOptions {
                back_faces: BackFaces::Invalid,
                ..options
            };
            let fast = renderer.render(&view, &fronts).unwrap();
            assert!(
                fast == oracle.render(&view, &fronts).unwrap(),
                "{name} {index}"
            );
        }
    }
    assert!(hits > 20_000, "{hits}");
}

/// A terrain of two materials whose textures have odd sizes, one of them repeating.
fn textured_terrain() -> Mesh {
    let mesh = terrain(60);
    let texture = |width: u32, height: u32, seed: u64| {
        let mut noise = Noise(seed);
        let texel = |_| noise.vector().to_array().map(|v| (v * 127.0 + 128.0) as u8);
        let texels = (0..width * height).map(texel).collect();
        Some(Arc::new(
            ColorImage::from_values(width, height, texels).unwrap(),
        ))
    };
    let material = |texture| Material {
        texture,
        ..Material::default()
    };
    let coords = |scale: f32| -> Vec<[Vec2; 3]> {
        let at = |corner: u32| {
            let at = mesh.vertices()[corner as usize];
            Vec2::new(at.x as f32, at.y as f32) * scale + Vec2::splat(0.5)
        };
        let triangles = mesh.triangles().iter();
        triangles.map(|corners| corners.map(at)).collect()
    };
    let (near, far) = (coords(0.3), coords(2.5));
    let mixed = near.iter().zip(&far).enumerate();
    let coords = mixed.map(|(k, (near, far))| if k / 40 % 2 == 0 { *near } else { *far });
    let slots = (0..mesh.triangles().len()).map(|k| (k / 40 % 2) as u32);
    let materials = vec![material(texture(64, 64, 3)), material(texture(37, 53, 4))];
    let (coords, slots) = (coords.collect(), slots.collect());
    let mesh = mesh.clone().with_texture_coords(coords).unwrap();
    mesh.with_materials(materials, Some(slots)).unwrap()
}

#[test]
fn textures_and_left_out_normals_change_nothing_but_what_they_say() {
    let mesh = textured_terrain();
    let (renderer, oracle) = (Renderer::new(&mesh).unwrap(), Oracle::new(&mesh));
    let middle = mesh.bounds().center();
    let mut noise = Noise(17);
    for (nth, samples) in [1, 4, 9, 16, 64].into_iter().enumerate() {
        for reach in [2.5, 0.6] {
            let eye = middle + (noise.vector() * 0.3 + DVec3::Z).normalize() * reach;
            let pose = Pose::looking_at(eye, middle, DVec3::Y).unwrap();
            let view = view(pose, 83 + nth as u32, 45);
            let options = RenderOptions {
                samples,
                back_faces: BackFaces::Valid,
                interpolated_normals: nth % 2 == 0,
                ..RenderOptions::default()
            };
            let mut fast = renderer.render(&view, &options).unwrap();
            assert!(
                fast == oracle.render(&view, &options).unwrap(),
                "{samples} {reach}"
            );
            let without = RenderOptions {
                normals: false,
                ..options
            };
            fast.normals = None;
            assert!(
                fast == renderer.render(&view, &without).unwrap(),
                "{samples} {reach}"
            );
            let colors: std::collections::BTreeSet<_> = fast.color.values().iter().collect();
            assert!(colors.len() > 500, "{}", colors.len());
        }
    }
}

/// Holds maps of visibility to a rendering: depth and normals to the bit, and the point that the
/// weights stand for to the ray. Returns how many pixels see something.
fn agree(mesh: &Mesh, view: &View, seen: &Seen, slow: &Rendering) -> usize {
    let mut hits = 0;
    for row in 0..view.camera.height() {
        for column in 0..view.camera.width() {
            let index = (row * view.camera.width() + column) as usize;
            let (triangle, depth) = (seen.triangles[index], seen.depth[index]);
            assert_eq!(depth.to_bits(), slow.depth.get(column, row).to_bits());
            assert_eq!(seen.normals[index], normal_at(slow, column, row));
            if triangle == Seen::NO_TRIANGLE {
                assert_eq!((depth, seen.weights[index]), (0.0, [0.0; 2]));
                continue;
            }
            hits += 1;
            let [a, b, c] = mesh.corners(triangle as usize);
            let [v, w] = seen.weights[index].map(f64::from);
            let point = view.pose.to_cam(a + v * (b - a) + w * (c - a));
            let expected = direction(view, column, row) * f64::from(depth);
            let size = (b - a).length() + (c - a).length() + point.length();
            assert!(
                (point - expected).length() < 3e-7 * size,
                "({column}, {row}): {point} for {expected}"
            );
        }
    }
    hits
}

/// Thin triangles parallel to the image, each about the centre of a pixel, before a sheet that is hardly behind
/// them: their edge functions are roundings for the most part, and what they make of the depth must not show.
#[test]
fn slivers_hide_what_is_just_behind_them() {
    let pose = Pose::looking_at(DVec3::new(3.0, -2.0, 1.0), DVec3::ZERO, DVec3::Z).unwrap();
    let view = view(pose, 192, 160);
    let at = |pixel: DVec2, depth: f64| view.pose.to_world(view.camera.ray(pixel) * depth);
    let (mut noise, mut hits) = (Noise(11), 0);
    for width in [0.003, 0.006, 0.02] {
        for depth in [0.37, 3.052_687] {
            let behind = depth * (1.0 + 2.5e-4);
            let corners = [(-9.0, -9.0), (400.0, -9.0), (-9.0, 400.0)];
            let mut vertices = corners.map(|(x, y)| at(DVec2::new(x, y), behind)).to_vec();
            for (column, row) in (0..12).flat_map(|row| (0..12).map(move |column| (column, row))) {
                let center = DVec2::new(f64::from(column), f64::from(row)) * 13.0 + 8.5;
                let along = DVec2::from_angle(noise.next() * 3.0);
                let across = along.perp() * width;
                let [before, after] = [0, 1].map(|_| 22.0 + 14.0 * noise.next());
                // At the centre it is as wide as that part of it which lies before.
                let tip = center - along * before - across * 0.2;
                let ends = [0.0, 1.0].map(|side| center + along * after + across * (side - 0.2));
                vertices.extend([tip, ends[0], ends[1]].map(|pixel| at(pixel, depth)));
            }
            let count = vertices.len() as u32 / 3;
            let triangles = (0..count).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect();
            let mesh = Mesh::new(vertices, triangles).unwrap();
            let options = RenderOptions {
                samples: 1,
                back_faces: BackFaces::Valid,
                ..RenderOptions::default()
            };
            let slow = Oracle::new(&mesh).render(&view, &options).unwrap();
            let mut seen = Seen::default();
            Renderer::new(&mesh).unwrap().see(&view, &mut seen).unwrap();
            agree(&mesh, &view, &seen, &slow);
            let is_sliver = |&&triangle: &&u32| triangle > 0 && triangle != Seen::NO_TRIANGLE;
            hits += seen.triangles.iter().filter(is_sliver).count();
        }
    }
    assert!(hits > 600, "{hits}");
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
        back_faces: BackFaces::Valid,
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
