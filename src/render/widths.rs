//! Whole pictures by every set of instructions.

use super::lanes::{Lanes, Task, dispatch, forced};
use super::{BackFaces, RenderOptions, Renderer, Rendering, Seen};
use glam::DVec3;
use mvs_datasets::scene::{Pose, View};
use mvs_datasets::synthetic::{SyntheticOptions, SyntheticScene};

/// Which set of instructions runs.
struct Name;

impl Task for Name {
    type Output = &'static str;

    fn run<L: Lanes>(self, _: L) -> &'static str {
        std::any::type_name::<L>()
    }
}

/// Two views of each fixture scene, and one from so close that triangles reach behind the camera.
fn pictures() -> Vec<(Rendering, Seen)> {
    let mut pictures = Vec::new();
    for (_, options) in SyntheticOptions::fixtures() {
        let scene = SyntheticScene::new(options).unwrap();
        let renderer = Renderer::new(scene.mesh()).unwrap();
        let views = scene.scene().views();
        let bounds = scene.mesh().bounds();
        let near = bounds.center() + 0.1 * bounds.size();
        let close = View {
            pose: Pose::looking_at(near, bounds.min, DVec3::new(0.3, 0.2, 1.0)).unwrap(),
            ..views[0].clone()
        };
        for view in [&views[0], &views[1], &close] {
            let options = RenderOptions {
                samples: 4,
                back_faces: BackFaces::Valid,
                ..RenderOptions::default()
            };
            let mut seen = Seen::default();
            renderer.see(view, &mut seen).unwrap();
            pictures.push((renderer.render(view, &options).unwrap(), seen));
        }
    }
    pictures
}

#[test]
fn every_set_of_instructions_gives_the_same_pictures() {
    let (best, set) = (pictures(), dispatch(Name));
    forced::plain(true);
    let (plain, plain_set) = (pictures(), dispatch(Name));
    forced::plain(false);
    assert!(plain_set.ends_with("Plain"), "{plain_set}");
    if set == plain_set {
        eprintln!("this machine has plain loops only: nothing was compared");
    }
    let seen = best.iter().flat_map(|(_, seen)| &seen.triangles);
    let hits = seen.filter(|&&triangle| triangle != Seen::NO_TRIANGLE);
    assert!(hits.count() > 300_000);
    for (index, (best, plain)) in best.iter().zip(&plain).enumerate() {
        assert!(best == plain, "picture {index} differs");
    }
}
