//! Depth and normals against planes, spheres and boxes.

use super::*;

#[test]
fn a_tilted_plane_has_the_depth_of_its_equation() {
    let (normal, anchor, mesh) = tilted_plane();
    let view = view(Pose::IDENTITY, 64, 48);
    let rendering = draft(&mesh, &view);
    for row in 0..48 {
        for column in 0..64 {
            let exact = normal.dot(anchor) / normal.dot(direction(&view, column, row));
            let found = f64::from(rendering.depth.get(column, row));
            assert!(
                (found / exact - 1.0).abs() < 1e-7,
                "({column}, {row}): {found} for {exact}"
            );
            let facing = DVec3::from(normal_at(&rendering, column, row).map(f64::from));
            assert!((facing - normal).length() < 1e-6, "{facing}");
        }
    }
}

#[test]
fn a_sphere_is_met_within_its_tessellation_and_only_there() {
    let rings = 200;
    let mesh = sphere(rings);
    let eye = DVec3::new(2.0, -1.5, 1.0);
    let view = view(
        Pose::looking_at(eye, DVec3::ZERO, DVec3::Z).unwrap(),
        120,
        100,
    );
    let rendering = draft(&mesh, &view);
    // Facets lie inside the sphere by at most the sagitta of their longer diagonal.
    let step = std::f64::consts::PI / f64::from(rings);
    let sagitta = 1.0 - (step * std::f64::consts::SQRT_2 / 2.0).cos();
    let (mut hits, mut edge) = (0, 0);
    for row in 0..100 {
        for column in 0..120 {
            let towards = view.pose.direction_to_world(direction(&view, column, row));
            let along = -eye.dot(towards) / towards.length_squared();
            let closest = (eye + along * towards).length();
            let depth = f64::from(rendering.depth.get(column, row));
            if depth == 0.0 {
                assert!(closest > 1.0 - sagitta, "hole at ({column}, {row})");
                continue;
            }
            hits += 1;
            let point = eye + depth * towards;
            assert!(closest <= 1.0 && depth < along, "({column}, {row})");
            assert!(point.length() > 1.0 - sagitta - 1e-6 && point.length() < 1.0 + 1e-6);
            let normal = DVec3::from(normal_at(&rendering, column, row).map(f64::from));
            let outwards = view.pose.rotation() * point.normalize();
            edge += usize::from(normal.dot(outwards) < (1.5 * step).cos());
        }
    }
    assert!(
        hits > 2000 && edge == 0,
        "{hits} hits, {edge} wrong normals"
    );
}

#[test]
fn a_box_has_slab_depths_at_any_offset_and_scale() {
    let far = DVec3::new(4.5e5, 5.1e6, 1e6);
    for (offset, scale) in [
        (DVec3::ZERO, 1.0),
        (far, 1.0),
        (DVec3::ZERO, 1e-6),
        (far, 1e6),
    ] {
        let half = DVec3::new(1.0, 2.0, 0.5) * scale;
        let eye = offset + DVec3::new(5.0, -4.0, 3.0) * scale;
        let mesh = cuboid(offset, half);
        let view = view(Pose::looking_at(eye, offset, DVec3::Z).unwrap(), 80, 60);
        let rendering = draft(&mesh, &view);
        // The pose itself is rounded at this offset: the camera is where the pose says.
        let eye = view.pose.to_cam(offset);
        let from = view.pose.direction_to_world(-eye);
        let mut hits = 0;
        for row in 0..60 {
            for column in 0..80 {
                let towards = view.pose.direction_to_world(direction(&view, column, row));
                let (one, two) = ((-half - from) / towards, (half - from) / towards);
                let (near, far) = (one.min(two).max_element(), one.max(two).min_element());
                let depth = f64::from(rendering.depth.get(column, row));
                if (near - far).abs() < 1e-9 * scale {
                    continue;
                }
                assert_eq!(depth > 0.0, near < far, "({column}, {row}) at {offset}");
                if depth > 0.0 {
                    assert!((depth / near - 1.0).abs() < 1e-7, "{depth} for {near}");
                    hits += 1;
                }
            }
        }
        assert!(hits > 400, "{hits}");
    }
}

#[test]
fn one_picture_holds_depths_a_million_apart() {
    // A small quad close by before a huge one far away, both facing the camera.
    let near = [(-1.0, 1.0), (0.5, 1.0), (0.5, -1.0), (-1.0, -1.0)];
    let far = [(-1.0, 1.0), (1.0, 1.0), (1.0, -1.0), (-1.0, -1.0)];
    let corners = |outline: [(f64, f64); 4], size: f64, depth: f64| {
        outline.map(|(x, y)| DVec3::new(x * size, y * size, depth))
    };
    let vertices = [corners(near, 2e-4, 1e-3), corners(far, 1e3, 1e3)].concat();
    let triangles = vec![[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]];
    let mesh = Mesh::new(vertices, triangles).unwrap();
    let view = view(Pose::IDENTITY, 96, 64);
    let rendering = draft(&mesh, &view);
    let mut counts = [0, 0];
    for row in 0..64 {
        for column in 0..96 {
            let towards = direction(&view, column, row);
            let hides = towards.x > -0.2 && towards.x < 0.1 && towards.y.abs() < 0.2;
            let expected = if hides { 1e-3 } else { 1e3 };
            let depth = f64::from(rendering.depth.get(column, row));
            assert!(
                (depth / expected - 1.0).abs() < 1e-7,
                "({column}, {row}): {depth}"
            );
            counts[usize::from(hides)] += 1;
        }
    }
    assert!(counts[0] > 1000 && counts[1] > 500, "{counts:?}");
}

#[test]
fn a_ground_that_passes_below_and_behind_the_camera_is_cut_at_the_camera() {
    // The plane y = 1 as two triangles of a huge quad around the camera: depth 1 / y.
    let size = 1e4;
    let mesh = quad(
        [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)]
            .map(|(x, z)| DVec3::new(size * x, 1.0, size * z)),
    );
    let view = view(Pose::IDENTITY, 160, 120);
    let rendering = draft(&mesh, &view);
    for row in 0..120 {
        for column in 0..160 {
            let towards = direction(&view, column, row);
            let depth = f64::from(rendering.depth.get(column, row));
            if towards.y * size > 1.0 {
                assert!(
                    (depth * towards.y - 1.0).abs() < 1e-7,
                    "({column}, {row}): {depth}"
                );
            } else {
                assert!(depth == 0.0, "({column}, {row}): {depth} behind the camera");
            }
        }
    }
}

#[test]
fn triangles_without_area_are_not_there_and_hide_nothing() {
    // Points, lines and a folded sliver before a quad.
    let mut vertices = facing_quad(2.0).vertices().to_vec();
    vertices.extend([
        DVec3::new(0.1, 0.1, 1.0),
        DVec3::new(-0.5, 0.0, 1.0),
        DVec3::new(0.0, 0.0, 1.0),
        DVec3::new(0.5, 0.0, 1.0),
    ]);
    let degenerate = [[4, 4, 4], [5, 6, 7], [5, 7, 5], [6, 5, 7]];
    let triangles = [&[[0, 1, 2], [0, 2, 3]], &degenerate[..]].concat();
    let mesh = Mesh::new(vertices, triangles).unwrap();
    let mut view = view(Pose::IDENTITY, 64, 64);
    // Pixel centres lie on the line y = 0.
    view.camera = Camera::new(64, 64, DVec2::splat(64.0), DVec2::splat(32.5)).unwrap();
    let (with, without) = (draft(&mesh, &view), draft(&facing_quad(2.0), &view));
    assert!(with.depth == without.depth && with.depth.valid_count() > 1000);
}

#[test]
fn scale_changes_nothing_but_the_unit() {
    for scale in [1e-6, 1e6] {
        let view = view(
            Pose::looking_at(DVec3::X * 3.0 * scale, DVec3::ZERO, DVec3::Z).unwrap(),
            64,
            64,
        );
        let large = sphere(20);
        let vertices = large.vertices().iter().map(|v| *v * scale).collect();
        let mesh = Mesh::new(vertices, large.triangles().to_vec()).unwrap();
        let rendering = draft(&mesh, &view);
        let depth = f64::from(rendering.depth.get(32, 32));
        assert!((depth / scale - 2.0).abs() < 0.01, "{depth} at {scale}");
    }
}

#[test]
fn a_camera_inside_a_closed_mesh_sees_no_hole() {
    let mesh = sphere(30);
    for (index, target) in [DVec3::X, DVec3::NEG_Y, DVec3::new(0.1, 0.2, 1.0)]
        .iter()
        .enumerate()
    {
        let eye = DVec3::new(0.1, 0.0, -0.2) * index as f64;
        let pose = Pose::looking_at(eye, *target, DVec3::new(0.0, 0.6, 0.8)).unwrap();
        let rendering = draft(&mesh, &view(pose, 200, 200));
        assert_eq!(rendering.depth.valid_count(), 200 * 200);
    }
}
