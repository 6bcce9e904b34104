//! Depth against Open3D's RaycastingScene: the numbers are made by `tests/reference/render_open3d.py`.

use super::*;
use serde_json::Value;

const NUMBERS: &str = include_str!("../../reference/render_open3d.json");

/// The mesh with its vertices rounded to f32, as Open3D holds them.
fn rounded(mesh: &Mesh) -> Mesh {
    let vertices = mesh.vertices().iter();
    let vertices = vertices.map(|vertex| vertex.as_vec3().as_dvec3()).collect();
    Mesh::new(vertices, mesh.triangles().to_vec()).unwrap()
}

#[test]
fn depth_is_that_of_open3d_but_for_its_rounding() {
    let numbers: Value = serde_json::from_str(NUMBERS).unwrap();
    let camera = Camera::new(512, 384, DVec2::splat(400.0), DVec2::new(256.0, 192.0)).unwrap();
    let (terrain, sphere) = (rounded(&terrain(316)), rounded(&sphere(60)));
    let (mut worst, mut compared, mut disagreeing) = (0.0f64, 0, 0);
    for expected in numbers["views"].as_array().unwrap() {
        let mesh = match expected["mesh"].as_str().unwrap() {
            "terrain" => &terrain,
            _ => &sphere,
        };
        let list = |name: &str| -> Vec<f64> {
            let values = expected[name].as_array().unwrap().iter();
            values.map(|value| value.as_f64().unwrap()).collect()
        };
        let eye = DVec3::from_slice(&list("eye"));
        let view = View {
            camera,
            pose: Pose::looking_at(eye, DVec3::ZERO, DVec3::new(0.1, 0.0, 1.0)).unwrap(),
            ..view(Pose::IDENTITY, 512, 384)
        };
        let renderer = Renderer::new(mesh).unwrap();
        let hits = renderer
            .visible_count(&view)
            .abs_diff(expected["hits"].as_u64().unwrap() as usize);
        // Open3D's rays are rounded to f32: some at the silhouette pass on the other side.
        assert!(hits <= 3, "{hits} pixels more or less than Open3D's");
        // The very rays that Open3D was given, so that only its arithmetic differs.
        let sample = |index: u32| direction(&view, index % 32 * 16, index / 32 * 16);
        let world = |index| view.pose.direction_to_world(sample(index));
        let rays: Vec<DVec3> = (0..32 * 24)
            .map(|i| world(i).as_vec3().as_dvec3())
            .collect();
        let found = renderer.first_hits(eye.as_vec3().as_dvec3(), &rays, (0.0, f64::INFINITY));
        for (hit, open3d) in found.into_iter().zip(list("depth")) {
            let depth = hit.map_or(0.0, |hit| hit.distance);
            if (depth > 0.0) != (open3d > 0.0) {
                disagreeing += 1;
            } else if depth > 0.0 {
                worst = worst.max((depth / open3d - 1.0).abs());
                compared += 1;
            }
        }
    }
    assert!(
        compared > 1500 && disagreeing == 0,
        "{compared}, {disagreeing}"
    );
    assert!(worst < 1e-6, "{worst}");
}
