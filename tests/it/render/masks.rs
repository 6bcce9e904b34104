//! Back faces, cut-out surface, mixed pixels, normals.

use super::*;
use mvs_datasets::scene::{ColorImage, Cutout, Material, Raster};
use mvs_eval::render::oracle::Oracle;
use mvs_eval::render::{BackFaces, Sight};
use std::sync::Arc;

/// A facing square 2 wide at depth 2 whose left half shows its back, before a facing one at depth 4.
fn half_turned() -> Mesh {
    let corner = |x: f64, y: f64, z: f64| DVec3::new(x, y, z);
    let mut vertices = Vec::new();
    let mut triangles = Vec::new();
    for (left, right, depth, turned) in [
        (-1.0, 0.0, 2.0, true),
        (0.0, 1.0, 2.0, false),
        (-9.0, 9.0, 4.0, false),
    ] {
        let first = vertices.len() as u32;
        let reach = if depth > 3.0 { 9.0 } else { 1.0 };
        vertices.extend([
            corner(left, reach, depth),
            corner(right, reach, depth),
            corner(right, -reach, depth),
            corner(left, -reach, depth),
        ]);
        let quad = [[0, 1, 2], [0, 2, 3]].map(|t: [u32; 3]| t.map(|i| first + i));
        triangles.extend(quad.map(|[a, b, c]| if turned { [a, c, b] } else { [a, b, c] }));
    }
    Mesh::new(vertices, triangles).unwrap()
}

fn straight(width: u32, height: u32) -> View {
    let mut view = view(Pose::IDENTITY, width, height);
    let center = DVec2::new(f64::from(width), f64::from(height)) * 0.5;
    view.camera = Camera::new(width, height, DVec2::splat(f64::from(width)), center).unwrap();
    view
}

#[test]
fn back_faces_hide_what_is_behind_and_are_no_surface() {
    let mesh = half_turned();
    let renderer = Renderer::new(&mesh).unwrap();
    let view = straight(40, 40);
    let rendering = renderer.render(&view, &RenderOptions::default()).unwrap();
    let at = |column: u32| {
        (
            rendering.sight.get(column, 20),
            rendering.depth.get(column, 20),
        )
    };
    assert_eq!(at(10), (Sight::BackFace, 0.0));
    assert_eq!(at(30), (Sight::Surface, 2.0));
    assert_eq!(rendering.color.get(10, 20), [0; 3]);
    assert_eq!(normal_at(&rendering, 10, 20), [0.0; 3]);
    assert_eq!(rendering.count(Sight::BackFace), 20 * 40);
    let both = RenderOptions {
        back_faces: BackFaces::Valid,
        ..RenderOptions::default()
    };
    let rendering = renderer.render(&view, &both).unwrap();
    assert_eq!(rendering.depth.get(10, 20), 2.0);
    assert_eq!(rendering.count(Sight::BackFace), 0);
    assert_eq!(
        normal_at(&rendering, 10, 20),
        [0.0, 0.0, -1.0],
        "faces the camera"
    );
    let two_sided = Material {
        double_sided: true,
        ..Material::default()
    };
    let mesh = half_turned().with_materials(vec![two_sided], None).unwrap();
    let rendering = draft_as_asked(&mesh, &view);
    assert_eq!(rendering.depth.get(10, 20), 2.0);
}

fn draft_as_asked(mesh: &Mesh, view: &View) -> Rendering {
    let options = RenderOptions {
        samples: 1,
        ..RenderOptions::default()
    };
    Renderer::new(mesh).unwrap().render(view, &options).unwrap()
}

/// Opacity in 8 columns over the square: 0 in the first four.
fn half_cut() -> Cutout {
    let values = (0..8u8)
        .map(|column| if column < 4 { 0 } else { 255 })
        .collect();
    Cutout {
        opacity: Arc::new(Raster::from_values(8, 1, values).unwrap()),
        cutoff: 127.5,
    }
}

#[test]
fn a_cutout_lets_the_surface_behind_be_seen() {
    let paint = |color, cutout| Material {
        color,
        cutout,
        ..Material::default()
    };
    let (near, far) = (facing_quad(2.0), facing_quad(3.0));
    let vertices = [near.vertices(), far.vertices()].concat();
    let shifted = far.triangles().iter().map(|t| t.map(|i| i + 4));
    let triangles: Vec<_> = near.triangles().iter().copied().chain(shifted).collect();
    let coords = near.texture_coords().unwrap();
    let mesh = Mesh::new(vertices, triangles)
        .unwrap()
        .with_texture_coords([coords, coords].concat())
        .unwrap()
        .with_materials(
            vec![
                paint([250, 0, 0], Some(half_cut())),
                paint([0, 0, 250], None),
            ],
            Some(vec![0, 0, 1, 1]),
        )
        .unwrap();
    let view = straight(48, 48);
    let rendering = draft_as_asked(&mesh, &view);
    // At depth 2 the square covers the middle; its cut begins where opacity crosses one half.
    assert_eq!(
        (rendering.depth.get(20, 24), rendering.color.get(20, 24)),
        (3.0, [0, 0, 250])
    );
    assert_eq!(
        (rendering.depth.get(27, 24), rendering.color.get(27, 24)),
        (2.0, [250, 0, 0])
    );
    for samples in [1, 4] {
        let options = RenderOptions {
            samples,
            ..RenderOptions::default()
        };
        let fast = Renderer::new(&mesh)
            .unwrap()
            .render(&view, &options)
            .unwrap();
        assert!(fast == Oracle::new(&mesh).render(&view, &options).unwrap());
    }
    let renderer = Renderer::new(&mesh).unwrap();
    let hit = |x: f64| renderer.first_hit(DVec3::ZERO, DVec3::new(x, 0.0, 1.0), (0.0, 9.0));
    assert_eq!(hit(-0.1).unwrap().distance, 3.0);
    assert_eq!(hit(0.1).unwrap().distance, 2.0);
    let rays = [-0.1, 0.1].map(|x| DVec3::new(x, 0.0, 1.0));
    let both = renderer.first_hits(DVec3::ZERO, &rays, (0.0, 9.0));
    assert_eq!(both, [hit(-0.1), hit(0.1)]);
    let blocked = renderer.blocked(DVec3::ZERO, &rays, (0.0, 2.5));
    assert_eq!(blocked, [false, true]);
    // Nothing behind the cut: nothing is seen.
    let alone = facing_quad(2.0).with_materials(vec![paint([9; 3], Some(half_cut()))], None);
    let alone = draft_as_asked(&alone.unwrap(), &view);
    assert_eq!(alone.sight.get(15, 24), Sight::Nothing);
    assert_eq!(alone.sight.get(30, 24), Sight::Surface);
}

#[test]
fn mixed_pixels_are_those_that_an_edge_cuts() {
    // The square's edges lie at half pixels: 2 · 40 / 4 px wide around 20, shifted by a quarter.
    let mesh = facing_quad(2.0);
    let mut view = straight(40, 40);
    let center = DVec2::new(20.25, 20.0);
    view.camera = Camera::new(40, 40, DVec2::splat(10.0), center).unwrap();
    let rendering = Renderer::new(&mesh)
        .unwrap()
        .render(&view, &RenderOptions::default())
        .unwrap();
    let row: Vec<Sight> = (14..27)
        .map(|column| rendering.sight.get(column, 20))
        .collect();
    // It covers 15.25 to 25.25: the centre of pixel 15 is inside, a quarter of it is not; the centre
    // of pixel 25 is outside.
    let mut expected = vec![Sight::Surface; 13];
    expected[0] = Sight::Nothing;
    expected[1] = Sight::Mixed;
    expected[11] = Sight::Nothing;
    expected[12] = Sight::Nothing;
    assert_eq!(row, expected);
}

#[test]
fn a_jump_in_depth_makes_a_pixel_mixed_and_a_slope_does_not() {
    let view = straight(40, 40);
    let slope = quad([
        DVec3::new(-30.0, 10.0, 50.0),
        DVec3::new(30.0, 10.0, 70.0),
        DVec3::new(30.0, -10.0, 70.0),
        DVec3::new(-30.0, -10.0, 50.0),
    ]);
    let sloped = Renderer::new(&slope).unwrap();
    let sloped = sloped.render(&view, &RenderOptions::default()).unwrap();
    assert_eq!(sloped.sight.get(20, 20), Sight::Surface);
    // The square at depth 2 ends inside pixel (30, ·) where the wall at depth 4 begins.
    let mesh = half_turned();
    let mut shifted = view;
    shifted.camera = Camera::new(40, 40, DVec2::splat(20.0), DVec2::new(20.4, 20.0)).unwrap();
    let renderer = Renderer::new(&mesh).unwrap();
    let rendering = renderer
        .render(&shifted, &RenderOptions::default())
        .unwrap();
    let row: Vec<Sight> = (28..33)
        .map(|column| rendering.sight.get(column, 20))
        .collect();
    use Sight::{Mixed, Surface};
    assert_eq!(row, [Surface, Surface, Mixed, Surface, Surface]);
}

#[test]
fn interpolated_normals_of_a_sphere_are_its_radii() {
    let mesh = sphere(24);
    let eye = DVec3::new(2.0, -1.5, 1.0);
    let view = view(
        Pose::looking_at(eye, DVec3::ZERO, DVec3::Z).unwrap(),
        60,
        50,
    );
    let options = RenderOptions {
        samples: 1,
        interpolated_normals: true,
        ..RenderOptions::default()
    };
    let rendering = Renderer::new(&mesh)
        .unwrap()
        .render(&view, &options)
        .unwrap();
    let smooth = rendering.interpolated_normals.as_ref().unwrap();
    let (mut hits, mut worst, mut worst_flat) = (0, 1.0f64, 1.0f64);
    for row in 0..50 {
        for column in 0..60 {
            let depth = f64::from(rendering.depth.get(column, row));
            let ray = direction(&view, column, row);
            let vector = |map: &Raster<[f32; 3]>| DVec3::from(map.get(column, row).map(f64::from));
            let normal = vector(smooth);
            if depth == 0.0 {
                assert_eq!(normal, DVec3::ZERO);
                continue;
            }
            assert!((normal.length() - 1.0).abs() < 1e-6 && normal.dot(ray) < 0.0);
            let point = view.pose.to_world(depth * ray);
            if ray.normalize().dot(view.pose.rotation() * point) > -0.3 {
                continue; // Near the silhouette the flat normal may stand in.
            }
            hits += 1;
            let radius = view.pose.rotation() * point.normalize();
            worst = worst.min(normal.dot(radius));
            worst_flat = worst_flat.min(vector(rendering.normals.as_ref().unwrap()).dot(radius));
        }
    }
    assert!(
        hits > 300 && worst > 1f64.to_radians().cos(),
        "{hits} {worst}"
    );
    assert!(
        worst_flat < 3f64.to_radians().cos(),
        "flat ones are farther off: {worst_flat}"
    );
}

#[test]
fn vertex_colours_tint_a_texture_in_linear_light() {
    let texture = Arc::new(ColorImage::filled(2, 2, [188, 255, 100]).unwrap());
    let material = |tinted| Material {
        texture: Some(Arc::clone(&texture)),
        tinted,
        ..Material::default()
    };
    let mesh = |tinted| {
        let mesh = facing_quad(2.0)
            .with_vertex_colors(vec![[188, 0, 255]; 4])
            .unwrap();
        mesh.with_materials(vec![material(tinted)], None).unwrap()
    };
    let at = |tinted| {
        draft_as_asked(&mesh(tinted), &straight(8, 8))
            .color
            .get(4, 4)
    };
    assert_eq!(at(false), [188, 255, 100]);
    // sRGB 188 is half the light of white (0.5029), 138 a quarter (0.2529).
    assert_eq!(at(true), [138, 0, 100]);
}
