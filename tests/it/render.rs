//! The renderer: shapes and views for the tests below.

mod closed_forms;
mod exact;
mod lens;
mod looks;
mod masks;
mod rays;
mod reference;
mod shapes;

use glam::{DVec2, DVec3, Vec2};
use mvs_datasets::scene::{Camera, Corner, Mesh, Pose, View};
use mvs_eval::render::{BackFaces, RenderOptions, Renderer, Rendering};
use shapes::{Noise, soup, terrain};

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

/// The normal of a pixel.
fn normal_at(rendering: &Rendering, column: u32, row: u32) -> [f32; 3] {
    rendering.normals.as_ref().unwrap().get(column, row)
}

/// One sample, both sides of triangles.
fn draft(mesh: &Mesh, view: &View) -> Rendering {
    let options = RenderOptions {
        samples: 1,
        back_faces: BackFaces::Valid,
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

/// A plane across the view along +z: its unit normal, a point of it, and a large piece.
fn tilted_plane() -> (DVec3, DVec3, Mesh) {
    let normal = DVec3::new(0.3, -0.5, -1.0).normalize();
    let anchor = DVec3::new(0.1, 0.2, 4.0);
    let (along, across) = normal.any_orthonormal_pair();
    let mesh = quad(
        [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)]
            .map(|(s, t)| anchor + 1e3 * (s * along + t * across)),
    );
    (normal, anchor, mesh)
}

fn facing_quad(depth: f64) -> Mesh {
    quad([
        DVec3::new(-1.0, 1.0, depth),
        DVec3::new(1.0, 1.0, depth),
        DVec3::new(1.0, -1.0, depth),
        DVec3::new(-1.0, -1.0, depth),
    ])
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
