//! Colours: textures, materials, samples, background.

use super::*;
use mvs_datasets::scene::{ColorImage, Material};
use std::sync::Arc;

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
fn the_background_and_the_number_of_samples_are_as_asked() {
    let mesh = facing_quad(4.0);
    let renderer = Renderer::new(&mesh).unwrap();
    let view = view(Pose::IDENTITY, 32, 32);
    let options = RenderOptions {
        samples: 4,
        background: [1, 2, 3],
        ..RenderOptions::default()
    };
    let rendering = renderer.render(&view, &options).unwrap();
    assert_eq!(
        (rendering.color.get(0, 0), rendering.depth.get(0, 0)),
        ([1, 2, 3], 0.0)
    );
    assert_eq!(normal_at(&rendering, 0, 0), [0.0; 3]);
    assert_eq!(rendering.color.get(16, 16), Material::default().color);
    for samples in [0, 2, 3, 81] {
        let wrong = RenderOptions {
            samples,
            ..options.clone()
        };
        let error = renderer.render(&view, &wrong).unwrap_err().to_string();
        assert!(error.contains(&format!("found {samples}")), "{error}");
    }
    assert!(Renderer::new(&Mesh::new(vec![DVec3::ZERO], vec![]).unwrap()).is_err());
}

/// A bilinear texture in f64, straight from its definition; `repeats` beyond its border or goes on.
fn looked_up(texture: &ColorImage, at: [f64; 2], repeats: bool) -> [f64; 3] {
    let size = [texture.width(), texture.height()].map(i64::from);
    let place = [
        at[0] * size[0] as f64 - 0.5,
        (1.0 - at[1]) * size[1] as f64 - 0.5,
    ];
    let mut sum = [0.0; 3];
    for (right, down) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
        let texel = [
            place[0].floor() as i64 + right,
            place[1].floor() as i64 + down,
        ];
        let mut weight = 1.0;
        let mut inside = [0; 2];
        for axis in 0..2 {
            weight *= 1.0 - (place[axis] - texel[axis] as f64).abs();
            inside[axis] = match repeats {
                true => texel[axis].rem_euclid(size[axis]),
                false => texel[axis].clamp(0, size[axis] - 1),
            } as u32;
        }
        let color = texture.get(inside[0], inside[1]);
        for channel in 0..3 {
            sum[channel] += weight * f64::from(color[channel]);
        }
    }
    sum
}

/// The mean over a pixel's samples that meet the surface, ray by ray in f64.
fn mean_color(
    renderer: &Renderer,
    (mesh, view): (&Mesh, &View),
    (column, row): (u32, u32),
    side: u32,
) -> [f64; 3] {
    let (mut sum, mut count) = ([0.0; 3], 0.0);
    let material = &mesh.materials()[0];
    for index in 0..side * side {
        let inside = [index % side, index / side].map(|k| (f64::from(k) + 0.5) / f64::from(side));
        let pixel = DVec2::new(f64::from(column), f64::from(row)) + DVec2::from(inside);
        let direction = view.pose.direction_to_world(view.camera.ray(pixel));
        let center = view.pose.center_in_world();
        let Some(hit) = renderer.first_hit(center, direction, (0.0, f64::INFINITY)) else {
            continue;
        };
        let [v, w] = hit.weights;
        let between = |[a, b, c]: [f64; 3]| a * (1.0 - v - w) + b * v + c * w;
        let color =
            if let (Some(texture), Some(coords)) = (&material.texture, mesh.texture_coords()) {
                let corners = coords[hit.triangle];
                let repeats = corners
                    .iter()
                    .any(|c| c.min_element() < 0.0 || c.max_element() > 1.0);
                let at = [0, 1].map(|axis| between(corners.map(|corner| f64::from(corner[axis]))));
                looked_up(texture, at, repeats)
            } else {
                let colors = mesh.vertex_colors().unwrap();
                let corners = mesh.triangles()[hit.triangle].map(|vertex| colors[vertex as usize]);
                let mixed = |k: usize| between(corners.map(|color| f64::from(color[k])));
                let light = |k: usize| between(corners.map(|color| light_of(color[k])));
                match material.tinted {
                    false => [0, 1, 2].map(mixed),
                    true => [0, 1, 2].map(|k| level_of(light(k))),
                }
            };
        for channel in 0..3 {
            sum[channel] += color[channel];
        }
        count += 1.0;
    }
    sum.map(|value| value / count)
}

/// Linear light of an sRGB level, and back.
fn light_of(level: u8) -> f64 {
    match f64::from(level) / 255.0 {
        value if value <= 0.040_45 => value / 12.92,
        value => ((value + 0.055) / 1.055).powf(2.4),
    }
}

fn level_of(light: f64) -> f64 {
    match light {
        light if light <= 0.003_130_8 => 255.0 * 12.92 * light,
        light => 255.0 * (1.055 * light.powf(1.0 / 2.4) - 0.055),
    }
}

/// Every byte is the nearest to the mean in f64, but for what f32 rounds before.
#[test]
fn colours_are_the_means_of_what_rays_see() {
    let mut noise = Noise(91);
    let mut pixels = 0;
    for (index, size) in [(64, 64), (37, 53), (1, 9), (5, 1)].into_iter().enumerate() {
        let texels =
            (0..size.0 * size.1).map(|_| [0; 3].map(|_| (noise.next() * 127.9 + 128.0) as u8));
        let texture = ColorImage::from_values(size.0, size.1, texels.collect()).unwrap();
        for (stretch, textured, tinted) in [
            (1.0, true, false),
            (2.7, true, false),
            (1.0, false, false),
            (1.0, false, true),
        ] {
            let mesh = terrain(12);
            let coords = mesh.triangles().iter().map(|triangle| {
                triangle.map(|vertex| {
                    let at = mesh.vertices()[vertex as usize];
                    let unit = (glam::Vec2::new(at.x as f32, at.y as f32) * 0.5 + 0.5)
                        .clamp(glam::Vec2::ZERO, glam::Vec2::ONE);
                    (unit - 0.5) * stretch + 0.5
                })
            });
            let coords: Vec<_> = coords.collect();
            let colors = mesh.vertices().iter();
            let colors = colors
                .map(|_| [0; 3].map(|_| (noise.next() * 127.9 + 128.0) as u8))
                .collect();
            let material = Material {
                texture: textured.then(|| Arc::new(texture.clone())),
                tinted,
                ..Material::default()
            };
            let mesh = match textured {
                true => mesh.with_texture_coords(coords).unwrap(),
                false => mesh.with_vertex_colors(colors).unwrap(),
            };
            let mesh = mesh.with_materials(vec![material], None).unwrap();
            let renderer = Renderer::new(&mesh).unwrap();
            let eye = DVec3::new(0.6, -0.9, 1.4) + noise.vector() * 0.2;
            let pose = Pose::looking_at(eye, DVec3::ZERO, DVec3::Z).unwrap();
            let view = view(pose, 60, 44);
            let side = [1, 2, 3, 4][index];
            let options = RenderOptions {
                samples: side * side,
                back_faces: BackFaces::Valid,
                ..RenderOptions::default()
            };
            let rendering = renderer.render(&view, &options).unwrap();
            for row in 0..view.camera.height() {
                for column in 0..view.camera.width() {
                    if rendering.depth.get(column, row) == 0.0 {
                        continue;
                    }
                    let mean = mean_color(&renderer, (&mesh, &view), (column, row), side);
                    let found = rendering.color.get(column, row);
                    for channel in 0..3 {
                        let off = (f64::from(found[channel]) - mean[channel]).abs();
                        assert!(
                            off < 0.5 + 1e-3,
                            "{size:?} {column} {row}: {found:?} {mean:?}"
                        );
                    }
                    pixels += 1;
                }
            }
        }
    }
    assert!(pixels > 8000, "{pixels}");
}
