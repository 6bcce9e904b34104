//! Views through lenses, against closed forms and the oracle.

use super::*;
use mvs_datasets::scene::{Distortion, Material};
use mvs_eval::render::Sight;
use mvs_eval::render::oracle::Oracle;

fn lenses() -> Vec<Distortion> {
    let lens = |radial, tangential| Distortion::RadialTangential { radial, tangential };
    vec![
        lens([-0.2, 0.05, 0.0, 0.0, 0.0, 0.0], [2e-3, -1e-3]),
        lens([0.4, 0.2, 0.1, 0.7, 0.1, 0.02], [-1e-3, 1e-3]),
        Distortion::Fisheye {
            radial: [-0.02, 0.01, -0.005, 0.0005],
        },
        Distortion::ThinPrismFisheye {
            radial: [-0.03, 0.02, -0.004, 0.0003],
            tangential: [2e-3, -1e-3],
            prism: [3e-3, -2e-3],
        },
        Distortion::FieldOfView { omega: 0.9 },
    ]
}

fn bent(lens: Distortion, pose: Pose) -> View {
    let mut view = view(pose, 70, 53);
    view.camera = view.camera.with_distortion(lens).unwrap();
    view
}

#[test]
fn a_plane_through_a_lens_has_the_depth_of_its_equation() {
    let (normal, anchor, mesh) = tilted_plane();
    for lens in lenses() {
        let view = bent(lens, Pose::IDENTITY);
        let rendering = draft(&mesh, &view);
        for row in 0..53 {
            for column in 0..70 {
                let ray = direction(&view, column, row);
                let back = view.camera.project(ray).unwrap();
                let centre = DVec2::new(f64::from(column), f64::from(row)) + 0.5;
                assert!(
                    (back - centre).length() < 1e-9,
                    "{lens:?}: the ray is not of its pixel"
                );
                let exact = normal.dot(anchor) / normal.dot(ray);
                let found = f64::from(rendering.depth.get(column, row));
                assert!(
                    (found / exact - 1.0).abs() < 1e-7,
                    "{lens:?} ({column}, {row})"
                );
            }
        }
    }
}

#[test]
fn views_through_lenses_agree_with_the_oracle_to_the_byte() {
    let mut noise = Noise(5);
    for (name, mesh) in [("soup", soup(1500, 4)), ("terrain", terrain(60))] {
        let (renderer, oracle) = (Renderer::new(&mesh).unwrap(), Oracle::new(&mesh));
        for (index, lens) in lenses().into_iter().enumerate() {
            let eye = noise.vector().normalize() * [2.5, 1.0, 0.3][index % 3];
            let pose = Pose::looking_at(eye, DVec3::ZERO, noise.vector()).unwrap();
            let options = RenderOptions {
                samples: [4, 1, 9][index % 3],
                interpolated_normals: index % 2 == 0,
                ..RenderOptions::default()
            };
            let view = bent(lens, pose);
            let fast = renderer.render(&view, &options).unwrap();
            let slow = oracle.render(&view, &options).unwrap();
            assert!(fast == slow, "{name} {lens:?}");
            let seen = |sight: &&Sight| !matches!(sight, Sight::Nothing | Sight::NoRay);
            let count = fast.sight.values().iter().filter(seen).count();
            assert!(count > 100, "{name} {lens:?}: {count}");
        }
    }
}

/// Fisheyes whose images end, 90° from the axis, inside the view.
#[test]
fn views_that_reach_to_the_rim_agree_with_the_oracle_to_the_byte() {
    let fisheye = |first| Distortion::Fisheye {
        radial: [first, 0.0, 0.0, 0.0],
    };
    let prism = Distortion::ThinPrismFisheye {
        radial: [-0.01, 0.0, 0.0, 0.0],
        tangential: [2e-3, -1e-3],
        prism: [3e-3, -2e-3],
    };
    let mut noise = Noise(8);
    for (name, mesh) in [("soup", soup(1500, 4)), ("terrain", terrain(60))] {
        let (renderer, oracle) = (Renderer::new(&mesh).unwrap(), Oracle::new(&mesh));
        for (index, lens) in [fisheye(0.0), fisheye(-0.02), prism]
            .into_iter()
            .enumerate()
        {
            let eye = noise.vector().normalize() * [0.6, 0.3, 0.1][index];
            let pose = Pose::looking_at(eye, noise.vector(), noise.vector()).unwrap();
            let mut view = view(pose, 130, 110);
            let camera = Camera::new(130, 110, DVec2::splat(30.0), DVec2::new(66.3, 53.8));
            view.camera = camera.unwrap().with_distortion(lens).unwrap();
            let options = RenderOptions {
                samples: [4, 1, 1][index],
                ..RenderOptions::default()
            };
            let fast = renderer.render(&view, &options).unwrap();
            assert!(
                fast == oracle.render(&view, &options).unwrap(),
                "{name} {lens:?}"
            );
            let surface = fast.count(Sight::Surface) + fast.count(Sight::Mixed);
            assert!(surface > 500, "{name} {lens:?}: {surface}");
            assert!(fast.count(Sight::NoRay) > 3000, "{name} {lens:?}");
        }
    }
}

/// A lens so weak that nothing moves by a thousandth of a pixel: the rays' way and the rasteriser's
/// must then see the same.
#[test]
fn a_lens_that_does_nothing_changes_nothing() {
    let mesh = terrain(80);
    let pose = Pose::looking_at(DVec3::new(1.5, 1.0, 1.2), DVec3::ZERO, DVec3::Z).unwrap();
    let radial = [1e-14, 0.0, 0.0, 0.0, 0.0, 0.0];
    let weak = Distortion::RadialTangential {
        radial,
        tangential: [0.0; 2],
    };
    let renderer = Renderer::new(&mesh).unwrap();
    let render = |view: &View| renderer.render(view, &RenderOptions::default()).unwrap();
    let (plain, through) = (render(&view(pose, 70, 53)), render(&bent(weak, pose)));
    assert!(plain.depth.valid_count() > 1000);
    let pairs = plain.depth.values().iter().zip(through.depth.values());
    let differing = pairs.filter(|(a, b)| (*a - *b).abs() > 1e-5 * a.max(**b));
    assert_eq!(differing.count(), 0);
    let pairs = plain.color.values().iter().zip(through.color.values());
    let worst = pairs.flat_map(|(a, b)| (0..3).map(|k| a[k].abs_diff(b[k])));
    assert!(worst.max() <= Some(1));
}

#[test]
fn beyond_the_field_of_a_lens_pixels_have_no_ray() {
    let barrel = Distortion::RadialTangential {
        radial: [-0.9, 0.0, 0.0, 0.0, 0.0, 0.0],
        tangential: [0.0; 2],
    };
    let view = bent(barrel, Pose::IDENTITY);
    let rendering = draft(&quad_behind_everything(), &view);
    // r − 0.9 r³ grows up to r² = 1 / 2.7, where it is 2/3 of r.
    let edge = (1.0f64 / 2.7).sqrt() * 2.0 / 3.0;
    let (mut inside, mut outside) = (0, 0);
    for row in 0..53 {
        for column in 0..70 {
            let centre = DVec2::new(f64::from(column), f64::from(row)) + 0.5;
            let radius = ((centre - view.camera.center()) / view.camera.focal()).length();
            let found = rendering.sight.get(column, row);
            if radius < edge {
                inside += 1;
                assert_eq!(found, Sight::Surface, "({column}, {row})");
            } else {
                outside += 1;
                assert_eq!(found, Sight::NoRay, "({column}, {row})");
                assert_eq!(rendering.depth.get(column, row), 0.0);
            }
        }
    }
    assert!(inside > 500 && outside > 500 && rendering.count(Sight::NoRay) == outside);
}

fn quad_behind_everything() -> Mesh {
    quad(
        [(-1.0, 1.0), (1.0, 1.0), (1.0, -1.0), (-1.0, -1.0)]
            .map(|(x, y)| DVec3::new(50.0 * x, 50.0 * y, 3.0)),
    )
    .with_materials(vec![Material::default()], None)
    .unwrap()
}
