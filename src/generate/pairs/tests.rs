//! Source views of cameras before walls, where sight and angle have closed forms.

use super::*;
use crate::generate::GenerateOptions;
use crate::progress::Silent;
use mvs_datasets::scene::{Camera, Pose};

fn view(id: u32, eye: DVec3, target: DVec3) -> View {
    View {
        id,
        name: String::new(),
        camera: Camera::new(64, 48, DVec2::splat(60.0), DVec2::new(32.0, 24.0)).unwrap(),
        pose: Pose::looking_at(eye, target, DVec3::Y).unwrap(),
        depth_range: None,
    }
}

/// Squares in planes of constant z, as (centre, half edge).
fn walls(squares: &[(DVec3, f64)]) -> Mesh {
    let mut vertices = Vec::new();
    let mut triangles = Vec::new();
    for (center, half) in squares {
        let first = vertices.len() as u32;
        for (x, y) in [(-1.0, -1.0), (-1.0, 1.0), (1.0, 1.0), (1.0, -1.0)] {
            vertices.push(*center + *half * DVec3::new(x, y, 0.0));
        }
        triangles.push([first, first + 1, first + 2]);
        triangles.push([first, first + 2, first + 3]);
    }
    Mesh::new(vertices, triangles).unwrap()
}

fn measure(mesh: &Mesh, views: &[View]) -> Covisibility {
    let renderer = Renderer::new(mesh).unwrap();
    Covisibility::measure(
        (&renderer, mesh),
        views,
        (&PairOptions::default(), BackFaces::Invalid),
        &Silent,
    )
    .unwrap()
}

/// An eye at `degrees` around the origin, 10 away, in the plane y = 0.
fn around(degrees: f64) -> DVec3 {
    let angle = degrees.to_radians();
    10.0 * DVec3::new(angle.sin(), 0.0, -angle.cos())
}

#[test]
fn weights_are_one_at_the_best_angle_and_fall_as_the_formula_says() {
    let options = PairOptions::default();
    assert_eq!(options.weight(5.0), 1.0);
    assert!((options.weight(4.0) - (-0.5f64).exp()).abs() < 1e-15);
    assert!((options.weight(15.0) - (-0.5f64).exp()).abs() < 1e-15);
    assert!(options.weight(0.0) < 4e-6);
}

#[test]
fn angles_are_right_where_arccos_is_not() {
    let point = DVec3::new(1.0, 2.0, 3.0);
    let eye = DVec3::new(1.0, 2.0, 13.0);
    assert_eq!(angle_at(point, (eye, eye)), 0.0);
    let beside = eye + DVec3::new(1e-7, 0.0, 0.0);
    assert!((angle_at(point, (eye, beside)).to_radians() - 1e-8).abs() < 1e-16);
    assert!((angle_at(point, (eye, point + DVec3::Y)) - 90.0).abs() < 1e-12);
}

#[test]
fn two_views_share_the_same_whoever_else_is_looked_at() {
    let mesh = walls(&[
        (DVec3::new(0.5, 0.1, 0.0), 2.0),
        (DVec3::new(-0.7, 0.3, -1.5), 0.6),
        (DVec3::new(0.9, -0.4, 1.2), 1.5),
    ]);
    let views: Vec<View> = (0..TOGETHER as u32 + 9)
        .map(|id| view(id, around(1.7 * f64::from(id) - 60.0), DVec3::ZERO))
        .collect();
    let all = measure(&mesh, &views);
    let mut partly = 0;
    for (first, second) in [
        (3, 5),
        (3, TOGETHER + 2),
        (TOGETHER + 2, TOGETHER - 1),
        (30, 40),
    ] {
        let two = measure(&mesh, &[views[first].clone(), views[second].clone()]);
        assert_eq!(all.score(first, second), two.score(0, 1));
        for (row, column) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
            let at = |place: usize| if place == 0 { first } else { second };
            let shared = two.shared()[2 * row + column];
            assert_eq!(all.shared()[at(row) * views.len() + at(column)], shared);
            partly += usize::from(0.0 < shared && shared < 1.0);
        }
    }
    assert!(partly >= 4, "{partly}");
}

#[test]
fn a_small_wall_scores_the_weight_of_its_angle() {
    // Small enough that every point is seen under the same angle to 0.2 degrees.
    let mesh = walls(&[(DVec3::ZERO, 0.25)]);
    let views: Vec<View> = [0.0, 5.0, 15.0, 40.0]
        .iter()
        .enumerate()
        .map(|(id, &degrees)| view(id as u32, around(degrees), DVec3::ZERO))
        .collect();
    let found = measure(&mesh, &views);
    assert!(found.shared().iter().all(|&fraction| fraction == 1.0));
    let options = PairOptions::default();
    // Both are sums over the same few points seen by view 0, and over those seen by the other; taken
    // relative to the score at the best angle it drops out, foreshortening aside.
    let ratio = found.score(0, 2) / found.score(0, 1);
    assert!((ratio - options.weight(15.0)).abs() < 0.02, "{ratio}");
    let sources = found.sources(&views, 10);
    let order: Vec<u32> = sources[0].iter().map(|source| source.id).collect();
    assert_eq!(order, [1, 2, 3]);
    assert_eq!(found.sources(&views, 2)[0].len(), 2);
}

#[test]
fn scores_are_the_same_in_both_directions() {
    let mesh = walls(&[(DVec3::ZERO, 3.0), (DVec3::new(1.0, 0.0, -2.0), 0.7)]);
    let views: Vec<View> = (0..6)
        .map(|id| view(id, around(f64::from(id) * 7.0 - 15.0), DVec3::ZERO))
        .collect();
    let found = measure(&mesh, &views);
    for i in 0..6 {
        for j in 0..6 {
            assert_eq!(found.score(i, j), found.score(j, i));
        }
        assert_eq!(found.shared()[i * 6 + i], 1.0);
    }
}

#[test]
fn what_stands_between_or_is_seen_from_behind_does_not_count() {
    // A wall; a screen that hides it from the second view only; a third view behind the wall.
    let second = around(30.0);
    let mesh = walls(&[(DVec3::ZERO, 0.5), (0.9 * second, 0.3)]);
    let views = [
        view(0, around(0.0), DVec3::ZERO),
        view(1, second, DVec3::ZERO),
        view(2, DVec3::new(0.0, 0.0, 10.0), DVec3::ZERO),
        view(3, around(-4.0), DVec3::ZERO),
    ];
    let found = measure(&mesh, &views);
    let shared = |row: usize, column: usize| found.shared()[row * 4 + column];
    assert!(shared(0, 1) < 0.2, "hidden: {}", shared(0, 1));
    assert_eq!(shared(0, 2), 0.0, "behind");
    assert!(shared(0, 3) > 0.9, "seen: {}", shared(0, 3));
    let sources = found.sources(&views, 10);
    assert!(sources[2].is_empty());
    assert!(sources.iter().flatten().all(|source| source.id != 2));
}

#[test]
fn bad_options_are_named() {
    let mesh = walls(&[(DVec3::ZERO, 1.0)]);
    let renderer = Renderer::new(&mesh).unwrap();
    for options in [
        PairOptions {
            points: 0,
            ..PairOptions::default()
        },
        PairOptions {
            sigma_above: 0.0,
            ..PairOptions::default()
        },
    ] {
        let result = Covisibility::measure(
            (&renderer, &mesh),
            &[],
            (&options, BackFaces::Invalid),
            &Silent,
        );
        assert!(result.unwrap_err().to_string().contains("view selection"));
    }
}

/// A wall of a few pixels between the grid's points, seen by three views; turned round, it is none.
#[test]
fn a_surface_that_the_grid_misses_is_seen() {
    let mesh = walls(&[(DVec3::ZERO, 0.3)]);
    let views: Vec<View> = (0..3u32)
        .map(|id| view(id, around(5.0 * f64::from(id)), DVec3::ZERO))
        .collect();
    let renderer = Renderer::new(&mesh).unwrap();
    let few = PairOptions {
        points: 4,
        ..PairOptions::default()
    };
    for back_faces in [BackFaces::Invalid, BackFaces::Valid] {
        let look = (&few, back_faces);
        assert!(
            on_grid((&renderer, &mesh), &views[0], (16.0, back_faces))
                .0
                .is_empty()
        );
        assert!(sees_surface((&renderer, &mesh), &views[0], look));
        let shared = Covisibility::measure((&renderer, &mesh), &views, look, &Silent).unwrap();
        assert!(shared.shared().iter().all(|&part| part > 0.9), "{shared:?}");
        // Of all pixels some 13 see it, at the best angle or twice that.
        let [near, far] = [1, 2].map(|other| shared.score(0, other));
        let pixels = 64.0 * 48.0 / 1000.0;
        assert!((near * pixels - 13.0).abs() < 4.0, "{near}");
        assert!((far / near - few.weight(10.0)).abs() < 0.2, "{far} {near}");
    }
    let turned = mesh.triangles().iter().map(|&[a, b, c]| [a, c, b]);
    let turned = Mesh::new(mesh.vertices().to_vec(), turned.collect()).unwrap();
    let renderer = Renderer::new(&turned).unwrap();
    let look = (&few, BackFaces::Invalid);
    assert!(!sees_surface((&renderer, &turned), &views[0], look));
}

#[test]
fn a_data_set_has_no_more_sources_than_its_readers_take() {
    let with = |sources| GenerateOptions {
        pairs: PairOptions {
            sources,
            ..PairOptions::default()
        },
        ..GenerateOptions::default()
    };
    assert!(with(10).check().is_ok());
    let message = with(11).check().unwrap_err().to_string();
    assert!(message.contains("at most 10 source views") && message.contains("found 11"));
}
