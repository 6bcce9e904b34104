//! The real scene: its mesh rendered, its true depth fused, the cloud scored against the mesh.

use super::*;
use crate::support::real_data;
use mvs_datasets::layout::mesh::read_meshes;
use mvs_eval::jobs::render::{self, RenderJob};
use mvs_eval::score::sample::{MeshAs, points_of};
use mvs_metrics::Tolerance;

/// A third of the photographs' size: a pixel covers 0.0036 of the surface on average.
#[test]
fn the_true_depth_of_the_real_scene_fuses_onto_its_mesh() {
    let Some(data) = real_data("scene_saharov") else {
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let warnings = Warnings::default();
    let context = Context {
        progress: &Silent,
        warnings: &warnings,
        force: false,
    };
    let mut rendering = RenderJob {
        mesh: vec![data.join("model")],
        cameras: data.join("cams"),
        out: folder.path().join("rendered"),
        size: Some("364x242".parse().unwrap()),
        pixel_center: mvsnet::PixelCentre::Integer,
        ..RenderJob::default()
    };
    rendering.camera.size = Some("1092x728".parse().unwrap());
    rendering.render.samples = 1;
    assert_eq!(render::run(&rendering, &context).unwrap().views.len(), 32);
    let pairs = "cams/pair.txt";
    std::fs::copy(data.join(pairs), rendering.out.join(pairs)).unwrap();
    let tau = Tolerance::new(0.01).unwrap();
    let mesh = read_meshes(&rendering.mesh).unwrap().mesh;
    let truth = points_of(&mesh, MeshAs::Area, 0.5 * tau.get(), 1).unwrap();
    let truth = FinitePoints::new(truth);
    for mode in [FuseMode::Hkust, FuseMode::Geo, FuseMode::Dynamic] {
        let job = FuseJob {
            scene: rendering.out.clone(),
            depths: rendering.out.join("depth"),
            out: folder.path().join("cloud.ply"),
            fuse: FuseOptions::of(mode),
            ..FuseJob::default()
        };
        fuse(&job, true).unwrap();
        let found = files::read_cloud(&job.out).unwrap();
        let found = FinitePoints::new(found.positions().to_vec());
        let preparation = Preparation {
            crop: None,
            voxel: Some(0.5 * tau.get()),
        };
        let score = evaluate(&found, None, &truth, &preparation)
            .unwrap()
            .score(tau);
        assert!(score.f_score() > 0.99, "{mode:?}: {score:?}");
    }
}
