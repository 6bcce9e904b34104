//! Whole pictures by every set of instructions.

#[path = "../../tests/it/render/shapes.rs"]
#[allow(dead_code, reason = "shared with the integration tests")]
pub(super) mod shapes;

use super::lanes::forced::{self, Width};
use super::lanes::{Lanes, Task, dispatch};
use super::{BackFaces, Hit, RenderOptions, Renderer, Rendering, Seen};
use glam::{DVec2, DVec3};
use mvs_datasets::scene::{Camera, Distortion, Pose, View};
use shapes::{soup, terrain};

/// Which set of instructions runs.
struct Name;

impl Task for Name {
    type Output = &'static str;

    fn run<L: Lanes>(self, _: L) -> &'static str {
        std::any::type_name::<L>()
    }
}

/// Views from outside, from inside, and from so close that triangles reach behind the camera; every
/// third through a lens.
fn pictures() -> Vec<(Rendering, Seen, Vec<Option<Hit>>)> {
    let mut pictures = Vec::new();
    for mesh in [terrain(90), terrain(400), soup(3000, 6)] {
        let renderer = Renderer::new(&mesh).unwrap();
        for (index, reach) in [2.5, 0.9, 0.3, 0.04].into_iter().enumerate() {
            let eye = DVec3::new(0.3, -0.7, 0.6).normalize() * reach;
            let pose = Pose::looking_at(eye, DVec3::ZERO, DVec3::new(0.1, 0.2, 1.0)).unwrap();
            let camera = Camera::new(300, 200, DVec2::splat(250.0), DVec2::new(150.0, 100.0));
            let mut view = View {
                id: 0,
                name: String::new(),
                camera: camera.unwrap(),
                pose,
                depth_range: None,
            };
            let options = RenderOptions {
                samples: 4,
                back_faces: BackFaces::Valid,
                ..RenderOptions::default()
            };
            let mut seen = Seen::default();
            renderer.see(&view, &mut seen).unwrap();
            let pixels = (0..300 * 200).map(|index| {
                let pixel = DVec2::new(f64::from(index % 300), f64::from(index / 300));
                view.pose.direction_to_world(view.camera.ray(pixel + 0.5))
            });
            let rays: Vec<DVec3> = pixels.step_by(3).collect();
            let hits = renderer.first_hits(eye, &rays, (0.0, f64::INFINITY));
            let blocked = renderer.blocked(eye, &rays, (0.0, f64::INFINITY));
            assert!(hits.iter().map(Option::is_some).eq(blocked));
            if index % 3 == 1 {
                let radial = [-0.2, 0.05, 0.0, 0.0, 0.0, 0.0];
                let tangential = [2e-3, -1e-3];
                let lens = Distortion::RadialTangential { radial, tangential };
                view.camera = view.camera.with_distortion(lens).unwrap();
            }
            pictures.push((renderer.render(&view, &options).unwrap(), seen, hits));
        }
    }
    pictures
}

#[test]
fn every_set_of_instructions_gives_the_same_pictures() {
    let (best, set) = (pictures(), dispatch(Name));
    for width in [Width::Avx2, Width::Plain] {
        forced::force(Some(width));
        let (other, other_set) = (pictures(), dispatch(Name));
        forced::force(None);
        assert!(
            width != Width::Plain || other_set.ends_with("Plain"),
            "{other_set}"
        );
        if set == other_set {
            eprintln!("this machine's best is {set}: nothing was compared");
        }
        for (index, (best, other)) in best.iter().zip(&other).enumerate() {
            assert!(best == other, "picture {index} differs, {width:?}");
        }
    }
    let seen = best.iter().flat_map(|(_, seen, _)| &seen.triangles);
    let hits = seen.filter(|&&triangle| triangle != Seen::NO_TRIANGLE);
    assert!(hits.count() > 300_000);
}
