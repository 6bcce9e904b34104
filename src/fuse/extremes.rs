//! Inputs at the edge of what can be fused: none may panic, and what can be known comes out right.

use super::testing::{Plane, arc, depth_map, view};
use super::{Estimate, FuseMode, FuseOptions, Fused, fuse};
use crate::progress::Silent;
use glam::{DVec2, DVec3};
use mvs_datasets::scene::{Camera, DepthMap, Pose, Raster, View};

fn plane(offset: f64) -> Plane {
    Plane {
        normal: DVec3::new(0.2, -0.3, 1.0).normalize(),
        offset,
    }
}

fn fused(estimates: &[Estimate], mode: FuseMode) -> Fused {
    let fused = fuse(estimates, &FuseOptions::of(mode), &Silent).unwrap();
    assert_eq!(fused.counts.accounted(), fused.counts.pixels, "{mode:?}");
    assert!(
        fused.cloud.positions().iter().all(|p| p.is_finite()),
        "{mode:?}"
    );
    fused
}

/// The median distance to the plane, relative to `scale`.
fn median_error(fused: &Fused, plane: Plane, scale: f64) -> f64 {
    let error = |p: &DVec3| (plane.normal.dot(*p) - plane.offset).abs() / scale;
    let mut errors: Vec<f64> = fused.cloud.positions().iter().map(error).collect();
    errors.sort_by(f64::total_cmp);
    errors[errors.len() / 2]
}

/// The arc of views with everything multiplied by `scale` and moved by `offset`.
fn scaled(scale: f64, offset: DVec3) -> (Vec<Estimate>, Plane) {
    let at_origin = plane(0.1);
    let surface = |view: &View, pixel| at_origin.depth(view, pixel);
    let mut estimates = arc(6, (64, 48), DVec3::ZERO, surface);
    for estimate in &mut estimates {
        let eye = estimate.view.pose.center_in_world() * scale + offset;
        let rotation = estimate.view.pose.rotation();
        estimate.view.pose = Pose::new(rotation, -(rotation * eye)).unwrap();
        let values = estimate
            .depth
            .values()
            .iter()
            .map(|d| (f64::from(*d) * scale) as f32);
        estimate.depth = DepthMap::from_values(64, 48, values.collect()).unwrap().0;
    }
    let moved = at_origin.offset * scale + at_origin.normal.dot(offset);
    (estimates, plane(moved))
}

#[test]
fn tiny_and_huge_scales_and_large_offsets_change_nothing() {
    for mode in FuseMode::ALL {
        let usual = fused(&scaled(1.0, DVec3::ZERO).0, mode).cloud.len();
        assert!(usual > 500, "{mode:?} {usual}");
        for (scale, offset) in [
            (1e-6, DVec3::ZERO),
            (1e6, DVec3::ZERO),
            (1.0, DVec3::new(4e5, 5e6, -1e3)),
        ] {
            let (estimates, plane) = scaled(scale, offset);
            let found = fused(&estimates, mode);
            let count = found.cloud.len();
            assert!(
                count.abs_diff(usual) <= usual / 100,
                "{mode:?} {scale} {count} {usual}"
            );
            let error = median_error(&found, plane, 4.0 * scale);
            // Whole pixels and medians by component are off by parts of a pixel of 1/77.
            let bound = match mode {
                FuseMode::Gipuma | FuseMode::Cluster => 0.1 / 77.0,
                _ => 2e-5,
            };
            assert!(error < bound, "{mode:?} {scale} {error:e}");
        }
    }
}

#[test]
fn near_and_far_a_million_apart_fuse_together() {
    let camera = Camera::new(33, 33, DVec2::splat(30.0), DVec2::splat(16.5)).unwrap();
    let estimates: Vec<Estimate> = (0..5)
        .map(|index| {
            let eye = DVec3::new(0.01 * f64::from(index), 0.0, 0.0);
            let view = view(
                index,
                camera,
                Pose::new(glam::DMat3::IDENTITY, -eye).unwrap(),
            );
            // The upper half is 1 unit away, the lower half a million.
            let step = |_: &View, pixel: DVec2| if pixel.y < 16.0 { 1.0 } else { 1e6 };
            Estimate {
                depth: depth_map(&view, step),
                view,
                confidence: None,
                image: None,
                sources: (0..5).filter(|&other| other != index as usize).collect(),
            }
        })
        .collect();
    for mode in FuseMode::ALL {
        let found = fused(&estimates, mode);
        let far = found.cloud.positions().iter().filter(|p| p.z > 9e5).count();
        let near = found
            .cloud
            .positions()
            .iter()
            .filter(|p| (p.z - 1.0).abs() < 1e-5)
            .count();
        assert_eq!(far + near, found.cloud.len(), "{mode:?}");
        assert!(far > 500 / 6 && near > 400 / 6, "{mode:?} {far} {near}");
    }
}

#[test]
fn identical_cameras_agree_with_themselves() {
    let surface = |view: &View, pixel| plane(0.1).depth(view, pixel);
    let mut estimates = arc(5, (32, 24), DVec3::ZERO, surface);
    for index in 1..5 {
        estimates[index].view.pose = estimates[0].view.pose;
        estimates[index].depth = estimates[0].depth.clone();
    }
    for mode in [
        FuseMode::Hkust,
        FuseMode::Geo,
        FuseMode::Dynamic,
        FuseMode::Cluster,
    ] {
        let found = fused(&estimates, mode);
        assert!(median_error(&found, plane(0.1), 4.0) < 1e-6);
    }
    // Without a baseline all disparities are 0 and agree.
    assert_eq!(fused(&estimates, FuseMode::Gipuma).cloud.len(), 5 * 32 * 24);
}

#[test]
fn moving_along_the_line_of_sight_puts_the_epipole_inside_the_image() {
    let camera = Camera::new(64, 48, DVec2::splat(70.0), DVec2::new(32.0, 24.0)).unwrap();
    let estimates: Vec<Estimate> = (0..6)
        .map(|index| {
            let eye = DVec3::new(0.0, 0.0, 4.0 + 0.2 * f64::from(index));
            let pose = Pose::looking_at(eye, DVec3::ZERO, DVec3::Y).unwrap();
            let view = view(index, camera, pose);
            Estimate {
                depth: depth_map(&view, |view, pixel| plane(0.1).depth(view, pixel)),
                view,
                confidence: None,
                image: None,
                sources: (0..6).filter(|&other| other != index as usize).collect(),
            }
        })
        .collect();
    for mode in [FuseMode::Hkust, FuseMode::Geo] {
        let found = fused(&estimates, mode);
        assert!(
            found.counts.fused > found.counts.pixels / 2,
            "{:?}",
            found.counts
        );
        assert!(median_error(&found, plane(0.1), 5.0) < 1e-5);
    }
}

#[test]
fn a_source_that_looks_the_other_way_says_nothing() {
    let surface = |view: &View, pixel| plane(0.1).depth(view, pixel);
    let mut estimates = arc(5, (32, 24), DVec3::ZERO, surface);
    let before = fused(&estimates, FuseMode::Geo).cloud.len();
    let eye = DVec3::new(0.0, 0.0, 4.0);
    let mut turned = estimates[0].clone();
    turned.view.id = 9;
    turned.view.pose = Pose::looking_at(eye, 2.0 * eye, DVec3::Y).unwrap();
    turned.depth = depth_map(&turned.view, |_, _| 4.0);
    turned.sources = vec![0, 1, 2];
    for estimate in &mut estimates {
        estimate.sources.push(5);
    }
    estimates.push(turned);
    assert_eq!(fused(&estimates, FuseMode::Geo).cloud.len(), before);
}

#[test]
fn one_view_and_empty_maps_give_no_points() {
    let surface = |view: &View, pixel| plane(0.1).depth(view, pixel);
    let mut one = arc(1, (16, 12), DVec3::ZERO, surface);
    for mode in FuseMode::ALL {
        assert_eq!(fused(&one, mode).cloud.len(), 0, "{mode:?}");
    }
    one[0].sources.clear();
    let nothing = arc(5, (16, 12), DVec3::ZERO, |_, _| f64::NAN);
    for mode in FuseMode::ALL {
        let found = fused(&nothing, mode);
        assert_eq!(
            (found.cloud.len(), found.counts.empty),
            (0, 5 * 16 * 12),
            "{mode:?}"
        );
    }
}

#[test]
fn images_of_one_pixel_are_fused() {
    let surface = |view: &View, pixel| plane(0.0).depth(view, pixel);
    let mut estimates = arc(5, (1, 1), DVec3::ZERO, surface);
    for estimate in &mut estimates {
        estimate.view.camera = Camera::new(1, 1, DVec2::splat(1.0), DVec2::splat(0.5)).unwrap();
        estimate.depth = depth_map(&estimate.view, surface);
    }
    for mode in FuseMode::ALL {
        fused(&estimates, mode);
    }
    assert_eq!(fused(&estimates, FuseMode::Hkust).cloud.len(), 5);
}

#[test]
fn a_thousand_views_are_fused() {
    let surface = |view: &View, pixel| plane(0.1).depth(view, pixel);
    let five = arc(5, (6, 4), DVec3::ZERO, surface);
    let estimates: Vec<Estimate> = (0..1000)
        .map(|index| {
            let mut estimate = five[index % 5].clone();
            estimate.view.id = index as u32;
            estimate.sources = (0..1000).filter(|&other| other != index).take(40).collect();
            estimate
        })
        .collect();
    for mode in [FuseMode::Hkust, FuseMode::Geo] {
        let found = fused(&estimates, mode);
        assert!(found.counts.fused > 10_000, "{mode:?} {:?}", found.counts);
    }
}

#[test]
fn infinite_negative_and_undefined_depths_and_confidences_count_as_none() {
    let surface = |view: &View, pixel| plane(0.1).depth(view, pixel);
    let mut estimates = arc(5, (32, 24), DVec3::ZERO, surface);
    for estimate in &mut estimates {
        let mut values = estimate.depth.values().to_vec();
        for (at, bad) in [f32::NAN, f32::INFINITY, -1.0, f32::NEG_INFINITY]
            .iter()
            .enumerate()
        {
            values[40 + at] = *bad;
        }
        estimate.depth = DepthMap::from_values(32, 24, values).unwrap().0;
        let mut confidence = vec![1.0; 32 * 24];
        confidence[100] = f32::NAN;
        confidence[101] = f32::NEG_INFINITY;
        confidence[102] = f32::INFINITY;
        estimate.confidence = Some(Raster::from_values(32, 24, confidence).unwrap());
    }
    for mode in FuseMode::ALL {
        let found = fused(&estimates, mode);
        assert_eq!(
            (found.counts.empty, found.counts.unconfident),
            (5 * 4, 5 * 3),
            "{mode:?}"
        );
        assert!(found.cloud.len() > 100, "{mode:?}");
    }
}

#[test]
fn a_point_at_a_source_s_centre_and_behind_it_is_not_seen_by_it() {
    // Source 4 stands on the surface itself: every point there has depth 0 or below in it.
    let surface = |view: &View, pixel| plane(0.0).depth(view, pixel);
    let mut estimates = arc(5, (32, 24), DVec3::ZERO, surface);
    let eye = DVec3::ZERO;
    estimates[4].view.pose = Pose::looking_at(eye, -plane(0.0).normal, DVec3::Y).unwrap();
    estimates[4].depth = depth_map(&estimates[4].view, |_, _| 1.0);
    for estimate in &mut estimates[..4] {
        estimate.sources.retain(|&source| source != 4);
    }
    let modes = [FuseMode::Geo, FuseMode::Dynamic, FuseMode::Gipuma];
    let without = modes.map(|mode| fused(&estimates[..4], mode).cloud.len());
    for estimate in &mut estimates[..4] {
        estimate.sources.push(4);
    }
    estimates[4].sources.clear();
    for (mode, without) in modes.into_iter().zip(without) {
        assert!(without > 100, "{mode:?} {without}");
        assert_eq!(fused(&estimates, mode).cloud.len(), without, "{mode:?}");
    }
}

#[test]
fn images_of_one_row_or_one_column_are_fused() {
    let surface = |view: &View, pixel| plane(0.0).depth(view, pixel);
    for size in [(64, 1), (1, 48)] {
        let mut estimates = arc(5, size, DVec3::ZERO, surface);
        for estimate in &mut estimates {
            let center = DVec2::new(0.5 * f64::from(size.0), 0.5 * f64::from(size.1));
            estimate.view.camera = Camera::new(size.0, size.1, DVec2::splat(60.0), center).unwrap();
            // All on one line of sight's plane: the same eye height.
            let eye = estimate.view.pose.center_in_world() * DVec3::new(1.0, 0.0, 1.0);
            estimate.view.pose = Pose::looking_at(eye, DVec3::ZERO, DVec3::Y).unwrap();
            estimate.depth = depth_map(&estimate.view, surface);
        }
        for mode in FuseMode::ALL {
            fused(&estimates, mode);
        }
        let found = fused(&estimates, FuseMode::Hkust);
        assert!(found.cloud.len() > 5, "{size:?} {}", found.cloud.len());
        // A row of pixels has no slope across it: the surface's own shows as depth error.
        assert!(median_error(&found, plane(0.0), 4.0) < 5e-3, "{size:?}");
    }
}
