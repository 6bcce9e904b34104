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
