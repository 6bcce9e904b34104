//! The renderer against scenes whose depth is known by formula.

use glam::DVec2;
use mvs_datasets::synthetic::{SyntheticOptions, SyntheticScene};
use mvs_eval::render::{RenderOptions, Renderer};

/// The mesh of every fixture scene, rendered, lies as deep as the formulas say, but for pixels at
/// the edges of polyhedra that stand for round things.
#[test]
fn rendered_depth_is_the_exact_depth() {
    for (name, options) in SyntheticOptions::fixtures() {
        let options = SyntheticOptions {
            width: 160,
            height: 120,
            ..options
        };
        let scene = SyntheticScene::new(options).unwrap();
        let renderer = Renderer::new(scene.mesh()).unwrap();
        let view = &scene.scene().views()[0];
        let render = RenderOptions {
            samples: 1,
            ..RenderOptions::default()
        };
        let rendered = renderer.render(view, &render).unwrap().depth;
        let exact = scene.depth(0);
        let (mut off, mut all) = (0, 0);
        for row in 0..120 {
            for column in 0..160 {
                let (found, expected) = (rendered.get(column, row), exact.get(column, row));
                all += usize::from(expected > 0.0);
                let pixel = DVec2::new(f64::from(column) + 0.5, f64::from(row) + 0.5);
                // Along a slanted ray the deviation shows enlarged; ten times is a grazing angle.
                let slant = view.camera.ray(pixel).length();
                let bound = 10.0 * slant * scene.mesh_deviation() + 1e-6 * f64::from(expected);
                off += usize::from(f64::from((found - expected).abs()) > bound);
            }
        }
        assert!(all > 2_000, "{name}: {all}");
        // Silhouettes of tessellated spheres and tubes: under one pixel in two hundred.
        assert!(off * 200 <= all, "{name}: {off} of {all}");
    }
}
