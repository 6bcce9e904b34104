use super::*;
use crate::fuse::testing::{Plane, arc, as_bytes, spoil};
use crate::fuse::{Estimate, MEMORY, MemoryScratch, Points, Sampling, fuse, oracle};
use crate::progress::Silent;
use glam::{DVec2, DVec3};
use mvs_datasets::scene::{DepthMap, Distortion, View};

fn noisy(views: usize, size: (u32, u32)) -> Vec<Estimate> {
    let surface = |view: &View, pixel| Plane::tilted().depth(view, pixel);
    let mut estimates = arc(views, size, DVec3::ZERO, surface);
    for (index, estimate) in estimates.iter_mut().enumerate() {
        spoil(estimate, index as u64, 1e-3, 0.03, 12);
    }
    estimates
}

fn off(points: &[DVec3]) -> Vec<f64> {
    let error = |p: &DVec3| (Plane::tilted().normal.dot(*p) - Plane::tilted().offset).abs();
    let mut errors: Vec<f64> = points.iter().map(error).collect();
    errors.sort_by(f64::total_cmp);
    errors
}

#[test]
fn modes_of_one_pass_equal_the_pixel_by_pixel_oracle() {
    for mode in [FuseMode::Geo, FuseMode::Dynamic, FuseMode::Gipuma] {
        check_against_oracle(mode);
    }
}

fn check_against_oracle(mode: FuseMode) {
    let estimates = noisy(6, (160, 120));
    let options = FuseOptions::of(mode);
    let fused = fuse(&estimates, &options, &Silent).unwrap();
    let mut expected = Vec::new();
    for index in 0..estimates.len() {
        let reference = oracle::Reference::new(&estimates, index, &options);
        expected.extend(reference.fuse_rows(0..120).points);
    }
    // A handful of pixels stands so near to a bound that f32 decides otherwise.
    let (found, wanted) = (fused.cloud.len(), expected.len());
    assert!(
        found.abs_diff(wanted) <= 6 * 160 * 120 / 20_000,
        "{mode:?} {found} {wanted}"
    );
    assert!(wanted > 6 * 160 * 120 / 2, "{mode:?} {wanted}");
    let mut cursor = 0;
    let (mut unmatched, mut odd) = (0, 0);
    for point in &expected {
        let near = fused.cloud.positions()[cursor..]
            .iter()
            .take(4)
            .position(|p| (*p - point.position).length() < 4e-6);
        match near {
            Some(skipped) => {
                cursor += skipped + 1;
                let views = fused.cloud.view_counts().unwrap()[cursor - 1];
                odd += usize::from(views != point.view_count);
            }
            None => unmatched += 1,
        }
    }
    let few = 6 * 160 * 120 / 20_000;
    assert!(unmatched <= few && odd <= few, "{mode:?} {unmatched} {odd}");
}

#[test]
fn hkust_is_exact_on_a_noise_free_plane_up_to_the_borders() {
    let surface = |view: &View, pixel| Plane::tilted().depth(view, pixel);
    let estimates = arc(5, (64, 48), DVec3::ZERO, surface);
    let fused = fuse(&estimates, &FuseOptions::default(), &Silent).unwrap();
    assert!(
        fused.counts.fused > fused.counts.pixels * 3 / 4,
        "{:?}",
        fused.counts
    );
    // Within a pixel of a map's border samples are extrapolated by up to half a pixel.
    let at_border = |view: &View, position: DVec3| {
        let pixel = view.camera.project(view.pose.to_cam(position)).unwrap();
        let margin = pixel.min(DVec2::new(64.0, 48.0) - pixel).min_element();
        margin.abs() < 1.5
    };
    let inside = |position: &&DVec3| !estimates.iter().any(|e| at_border(&e.view, **position));
    let inside: Vec<DVec3> = fused
        .cloud
        .positions()
        .iter()
        .filter(inside)
        .copied()
        .collect();
    assert!(inside.len() > fused.cloud.len() / 2);
    let worst = off(&inside).pop().unwrap();
    assert!(worst < 1e-6 * 3.5, "{worst:e}");
    let turned = |n: &glam::Vec3| (n.as_dvec3() - Plane::tilted().normal).length();
    let mut turned: Vec<f64> = fused.cloud.normals().unwrap().iter().map(turned).collect();
    turned.sort_by(f64::total_cmp);
    assert!(
        turned[turned.len() / 2] < 1e-4,
        "{:e}",
        turned[turned.len() / 2]
    );
}

#[test]
fn valid_sampling_keeps_what_plain_sampling_loses_at_holes() {
    let estimates = noisy(7, (160, 120));
    let with = |sampling| {
        let options = FuseOptions {
            sampling,
            min_sources: 5,
            soften: false,
            ..FuseOptions::default()
        };
        fuse(&estimates, &options, &Silent).unwrap()
    };
    let (valid, plain) = (with(Sampling::Valid), with(Sampling::Plain));
    let kept = |fused: &crate::fuse::Fused| fused.counts.fused;
    assert!(
        kept(&valid) > kept(&plain) * 6 / 5,
        "{} {}",
        kept(&valid),
        kept(&plain)
    );
    let median = |points: &[DVec3]| off(points)[points.len() / 2];
    let (of_valid, of_plain) = (
        median(valid.cloud.positions()),
        median(plain.cloud.positions()),
    );
    assert!(of_valid < 1.1 * of_plain, "{of_valid:e} {of_plain:e}");
    // Far below the noise of one map: 1e-3 of about 4 units, median of a Gaussian 0.67 of that.
    assert!(of_valid < 0.5 * 0.67 * 4e-3, "{of_valid:e}");
}

#[test]
fn every_pixel_is_accounted_for_in_every_mode() {
    let mut estimates = noisy(5, (64, 48));
    for estimate in &mut estimates {
        let mut confidence = vec![1.0; 64 * 48];
        confidence[..500].fill(0.2);
        estimate.confidence =
            Some(mvs_datasets::scene::Raster::from_values(64, 48, confidence).unwrap());
    }
    for mode in FuseMode::ALL {
        let options = FuseOptions {
            bounds: Some([[-0.5; 3], [0.5; 3]]),
            max_depth: 4.4,
            ..FuseOptions::of(mode)
        };
        let counts = fuse(&estimates, &options, &Silent).unwrap().counts;
        assert_eq!(counts.pixels, 5 * 64 * 48, "{mode:?}");
        assert_eq!(counts.accounted(), counts.pixels, "{mode:?} {counts:?}");
        assert!(
            counts.fused > 100 && counts.outside > 0,
            "{mode:?} {counts:?}"
        );
        assert!(
            counts.unconfident > 0 && counts.out_of_range > 0,
            "{mode:?} {counts:?}"
        );
    }
}

#[test]
fn merrells_rules_fill_holes_and_stay_on_the_surface() {
    let estimates = noisy(7, (160, 120));
    let with = |visibility| {
        let options = FuseOptions {
            visibility,
            ..FuseOptions::default()
        };
        fuse(&estimates, &options, &Silent).unwrap()
    };
    let median = with(Visibility::Median);
    let middle = |points: &[DVec3]| off(points)[points.len() / 2];
    for visibility in [Visibility::MerrellConfidence, Visibility::MerrellStability] {
        let fused = with(visibility);
        assert!(
            fused.counts.filled > 300,
            "{visibility:?} {:?}",
            fused.counts
        );
        assert_eq!(
            fused.counts.accounted(),
            fused.counts.pixels,
            "{visibility:?}"
        );
        // The nearest stable depth may be one in front of the surface, which is filtered later.
        let least = match visibility {
            Visibility::MerrellConfidence => median.counts.fused,
            _ => median.counts.fused * 9 / 10,
        };
        assert!(
            fused.counts.fused > least,
            "{visibility:?} {:?}",
            fused.counts
        );
        let (error, bound) = (
            middle(fused.cloud.positions()),
            2.0 * middle(median.cloud.positions()),
        );
        assert!(error < bound, "{visibility:?} {error:e} {bound:e}");
    }
}

#[test]
fn clusters_merge_what_views_share() {
    let surface = |view: &View, pixel| Plane::tilted().depth(view, pixel);
    let estimates = arc(6, (64, 48), DVec3::ZERO, surface);
    let fused = fuse(&estimates, &FuseOptions::of(FuseMode::Cluster), &Silent).unwrap();
    let counts = fused.counts;
    assert_eq!(counts.accounted(), counts.pixels);
    // Two pixels of tolerance let neighbours join: about 4 × 4 pixels of one view's size become
    // a point, from all six views.
    assert!(
        counts.fused > 500 && counts.merged > 10 * counts.fused,
        "{counts:?}"
    );
    // Medians by component of points up to two pixels of 0.05 units apart.
    let middle = off(fused.cloud.positions())[fused.cloud.len() / 2];
    assert!(middle < 0.1 * 0.05, "{middle:e}");
    assert!(
        fused
            .cloud
            .view_counts()
            .unwrap()
            .iter()
            .all(|&views| views <= 6)
    );
}

#[test]
fn the_same_points_under_any_budget_of_memory_and_number_of_threads() {
    let estimates = noisy(5, (64, 50));
    let with = |mode, memory, threads| {
        let scratch = MemoryScratch::default();
        let inputs = FuseInputs {
            maps: &estimates.as_slice(),
            region: None,
            scratch: &scratch,
            memory,
            progress: &Silent,
            warnings: &Warnings::default(),
        };
        let fused = parallel::with_threads(threads, || {
            let mut sink = Points::default();
            let counts = fuse_maps(&inputs, &FuseOptions::of(mode), &mut sink).unwrap();
            (counts, sink)
        });
        assert!(scratch.fetch(0).is_err(), "{mode:?} leaves nothing behind");
        fused.unwrap()
    };
    for mode in [FuseMode::Hkust, FuseMode::Geo, FuseMode::Cluster] {
        let reference = with(mode, MEMORY, 1);
        assert!(!reference.1.is_empty());
        assert_eq!(reference, with(mode, MEMORY, 8), "{mode:?}");
        assert_eq!(reference, with(mode, 0, 2), "{mode:?}");
        assert_eq!(reference, with(mode, 0, 8), "{mode:?}");
    }
}

#[test]
fn views_without_enough_sources_are_warned_of() {
    let mut estimates = noisy(4, (32, 24));
    estimates[2].sources.clear();
    let warnings = Warnings::default();
    let inputs = FuseInputs {
        maps: &estimates.as_slice(),
        region: None,
        scratch: &MemoryScratch::default(),
        memory: MEMORY,
        progress: &Silent,
        warnings: &warnings,
    };
    fuse_maps(&inputs, &FuseOptions::default(), &mut Points::default()).unwrap();
    let mut found = warnings.sorted();
    // Three of four views are left with three sources, of which two are enough.
    found.retain(|warning| warning.code == "few-sources");
    assert_eq!(found.len(), 1);
    assert!(
        found[0].message.starts_with("1 of 4 views"),
        "{}",
        found[0].message
    );
}

#[test]
fn the_gate_is_angle_aware() {
    let wall = Plane {
        normal: DVec3::Z,
        offset: 0.0,
    };
    // What becomes of the middle 21 x 21 pixels of the first of eight views 0.12 rad apart, their
    // depths off by `error`, when the view at `source` judges them.
    let fused = |source: usize, error: f32, wide_angle: f64| {
        let mut estimates = arc(8, (160, 120), DVec3::ZERO, |view, pixel| {
            wall.depth(view, pixel)
        });
        estimates.iter_mut().for_each(|e| e.sources.clear());
        estimates[0].sources = vec![source];
        let values = estimates[0].depth.values().iter();
        let middle = |at: usize| (at % 160).abs_diff(80) <= 10 && (at / 160).abs_diff(60) <= 10;
        let off = |(at, depth)| {
            if middle(at) {
                depth * (1.0 + error)
            } else {
                0.0
            }
        };
        let values = values.copied().enumerate().map(off).collect();
        estimates[0].depth = DepthMap::from_values(160, 120, values).unwrap().0;
        let options = FuseOptions {
            wide_angle,
            min_sources: 1,
            soften: false,
            ..FuseOptions::of(FuseMode::Geo)
        };
        fuse(&estimates, &options, &Silent).unwrap().counts.fused
    };
    // 0.8 % of the depth is 192 px · tan(48°) · 0.008 = 1.7 px for the farthest view.
    assert_eq!(fused(7, 0.008, 0.0), 0);
    assert_eq!(fused(7, 0.008, 20.0), 21 * 21);
    // For the nearest it is 0.2 px.
    assert_eq!(fused(1, 0.008, 0.0), 21 * 21);
    // 4 % move the surface that the farthest view sees by 0.04 · cos(48°) of the depth: beyond the
    // gate's 1 %, and no angle helps.
    assert_eq!(fused(7, 0.04, 20.0), 0);
}

/// The plane z = `offset`.
fn level(offset: f64) -> Plane {
    Plane {
        normal: DVec3::Z,
        offset,
    }
}

#[test]
fn what_only_three_views_see_needs_no_fourth() {
    let (wall, screen) = (level(0.0), level(0.5));
    // The first three of seven views see the wall, the others a screen before it, or `behind` a
    // hole in it.
    let fused = |soften, behind: Option<Plane>, empty: &[u32]| {
        let surface = |view: &View, pixel: DVec2| match view.id {
            0..3 => wall.depth(view, pixel),
            id if empty.contains(&id) => 0.0,
            3 if behind.is_some() => behind.map_or(0.0, |plane| plane.depth(view, pixel)),
            _ => screen.depth(view, pixel),
        };
        let estimates = arc(7, (160, 120), DVec3::ZERO, surface);
        let options = FuseOptions {
            min_sources: 3,
            soften,
            ..FuseOptions::of(FuseMode::Geo)
        };
        let fused = fuse(&estimates, &options, &Silent).unwrap();
        assert_eq!(fused.counts.accounted(), fused.counts.pixels);
        let middle = |p: &&DVec3| p.truncate().abs().max_element() < 0.3 && p.z < 0.25;
        fused.cloud.positions().iter().filter(middle).count()
    };
    let all = fused(true, None, &[]);
    assert!(all > 1000, "{all}");
    assert_eq!(fused(false, None, &[]), 0);
    // One that sees through the wall objects; two without a depth there do not, three do.
    let far = level(-0.5);
    assert_eq!(fused(true, Some(far), &[]), 0);
    assert_eq!(fused(true, None, &[3, 4]), all);
    assert_eq!(fused(true, None, &[3, 4, 5]), 0);
}

#[test]
fn points_that_more_views_see_through_than_agree_with_are_left_out() {
    let (wall, ghost) = (level(0.0), level(0.5));
    // Three of seven views have a patch half a unit in front of the wall; four see the wall there.
    let surface = |view: &View, pixel: DVec2| {
        let near = ghost.depth(view, pixel);
        let point = view.pose.to_world(view.camera.ray(pixel) * near);
        if view.id < 3 && point.truncate().abs().max_element() < 0.3 {
            near
        } else {
            wall.depth(view, pixel)
        }
    };
    let estimates = arc(7, (160, 120), DVec3::ZERO, surface);
    let with = |guard| {
        let options = FuseOptions {
            guard,
            min_sources: 2,
            ..FuseOptions::of(FuseMode::Geo)
        };
        let fused = fuse(&estimates, &options, &Silent).unwrap();
        let ghosts = fused.cloud.positions().iter().filter(|p| p.z > 0.25);
        (ghosts.count() as u64, fused.counts.contradicted)
    };
    let (ghosts, contradicted) = with(false);
    assert!(
        ghosts > 1000 && contradicted == 0,
        "{ghosts} {contradicted}"
    );
    let (left, contradicted) = with(true);
    assert_eq!(left, 0);
    assert!(contradicted >= ghosts, "{contradicted} {ghosts}");
}

/// Takes rows of these columns.
struct AsBytes(Columns, Vec<u8>);

impl PointSink for AsBytes {
    fn take(&mut self, _: &Points) -> Result<()> {
        panic!("rows are wanted");
    }

    fn wants_rows(&self) -> Option<Columns> {
        Some(self.0)
    }

    fn take_rows(&mut self, rows: &[u8]) -> Result<()> {
        self.1.extend_from_slice(rows);
        Ok(())
    }
}

/// With images of the maps' size, of another and without, with confidences and without; of both kinds of
/// columns.
#[test]
fn rows_of_bytes_are_the_points_in_every_mode() {
    let (width, height) = (70, 40);
    let mut estimates = noisy(5, (width, height));
    let give = |estimates: &mut Vec<Estimate>, size: Option<(u32, u32)>, confident: bool| {
        for (view, estimate) in (0u32..).zip(estimates) {
            let color = |at: u32| [(at * 7 + view) as u8, (at / 3) as u8, (at ^ view) as u8];
            estimate.image = size.map(|(width, height)| {
                let values = (0..width * height).map(color).collect();
                mvs_datasets::scene::ColorImage::from_values(width, height, values).unwrap()
            });
            let value = |at: u32| (at % 11) as f32 / 11.0;
            estimate.confidence = confident.then(|| {
                Raster::from_values(width, height, (0..width * height).map(value).collect())
                    .unwrap()
            });
        }
    };
    let mut seen = 0;
    for mode in [
        FuseMode::Hkust,
        FuseMode::Geo,
        FuseMode::Gipuma,
        FuseMode::Dynamic,
    ] {
        for (at, image) in [None, Some((width, height)), Some((97, 61))]
            .into_iter()
            .enumerate()
        {
            for colors in [Colors::Reference, Colors::Mean] {
                give(&mut estimates, image, at != 1);
                let options = FuseOptions {
                    normals: mode == FuseMode::Hkust,
                    colors,
                    min_confidence: 0.2,
                    ..FuseOptions::of(mode)
                };
                seen += check_rows(&estimates, &options);
            }
        }
    }
    assert!(seen > 100_000, "{seen}");
}

/// How many points were compared.
fn check_rows(estimates: &[Estimate], options: &FuseOptions) -> usize {
    let inputs = FuseInputs {
        maps: &estimates,
        region: None,
        scratch: &MemoryScratch::default(),
        memory: MEMORY,
        progress: &Silent,
        warnings: &Warnings::default(),
    };
    let mut points = Points::default();
    let counts = fuse_maps(&inputs, options, &mut points).unwrap();
    let all = columns(&estimates, options);
    for columns in [all, all.and(Columns::EXTRAS)] {
        let mut rows = AsBytes(columns, Vec::new());
        assert_eq!(fuse_maps(&inputs, options, &mut rows).unwrap(), counts);
        assert!(rows.1 == as_bytes(&points, columns), "{options:?}");
    }
    points.len()
}

#[test]
fn cameras_behind_a_lens_are_refused() {
    let surface = |view: &View, pixel| level(0.0).depth(view, pixel);
    let mut estimates = arc(3, (40, 30), DVec3::ZERO, surface);
    let lens = Distortion::RadialTangential {
        radial: [-0.1, 0.0, 0.0, 0.0, 0.0, 0.0],
        tangential: [0.0; 2],
    };
    estimates[1].view.camera = estimates[1].view.camera.with_distortion(lens).unwrap();
    let error = fuse(&estimates, &FuseOptions::default(), &Silent).unwrap_err();
    assert_eq!(
        error.to_string(),
        "view 1: expected a pinhole camera, found a lens: undistort depth map and image first"
    );
}
