//! Shapes and numbers that the renderer's tests and `examples/render_visibility.rs` share.

use glam::DVec3;
use mvs_datasets::scene::Mesh;

/// Numbers between -1 and 1 that look random and never change.
pub(crate) struct Noise(pub(crate) u64);

impl Noise {
    pub(crate) fn next(&mut self) -> f64 {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    }

    pub(crate) fn vector(&mut self) -> DVec3 {
        DVec3::new(self.next(), self.next(), self.next())
    }
}

/// Hills over a square, `side` × `side` cells of two triangles.
pub(crate) fn terrain(side: u32) -> Mesh {
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

/// Triangles of all shapes, thrown into a cube: large and tiny ones, slivers, copies.
pub(crate) fn soup(count: u32, seed: u64) -> Mesh {
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
