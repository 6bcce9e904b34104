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
    assert_eq!(rendering.normals.get(0, 0), [0.0; 3]);
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
