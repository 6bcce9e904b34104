//! Inputs at the ends of what occurs: the fast index beside kiddo's, with numbers.
#![allow(clippy::unwrap_used, reason = "helpers of tests may fail like tests")]

use glam::DVec3;
use mvs_metrics::align::{IcpOptions, icp, icp_plain};
use mvs_metrics::distance::{BlockIndex, NearestIndex};
use mvs_metrics::{Count, Tolerance, distance, downsample};

fn mixed(bits: u64) -> u64 {
    let bits = (bits ^ (bits >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let bits = (bits ^ (bits >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    bits ^ (bits >> 31)
}

/// A bumpy sheet over [0, 1)² whose coordinates are multiples of 2⁻²⁰.
fn sheet(seed: u64, count: u64) -> Vec<DVec3> {
    let unit = |key: u64| (mixed(key ^ seed << 40) >> 44) as f64 / f64::from(1 << 20);
    let point = |i: u64| {
        let (x, y) = (unit(2 * i), unit(2 * i + 1));
        DVec3::new(x, y, (x * y * 1024.0).floor() / 1024.0)
    };
    (0..count).map(point).collect()
}

fn within(truth: &[DVec3], queries: &[DVec3], tau: f64) -> usize {
    let fast = BlockIndex::new(truth).unwrap().distances(queries);
    let oracle = NearestIndex::new(truth).unwrap().distances(queries);
    assert_eq!(fast, oracle);
    Count::of(&fast, Tolerance::new(tau).unwrap()).within()
}

#[test]
fn map_offsets_change_no_count() {
    // Sums of multiples of 2⁻²⁰ and these offsets are exact.
    let (truth, queries) = (sheet(1, 5000), sheet(2, 3000));
    let count = within(&truth, &queries, 0.01);
    assert!((500..2900).contains(&count), "{count}");
    for offset in [
        DVec3::new(448_262.0, 5_427_700.0, 120.0),
        DVec3::splat(-1e7),
    ] {
        let moved = |points: &[DVec3]| points.iter().map(|p| *p + offset).collect::<Vec<_>>();
        assert_eq!(within(&moved(&truth), &moved(&queries), 0.01), count);
    }
}

#[test]
fn scales_change_no_count() {
    let (truth, queries) = (sheet(3, 5000), sheet(4, 3000));
    let count = within(&truth, &queries, 0.01);
    for exponent in [-60, -20, 20, 60] {
        let scale = 2f64.powi(exponent);
        let scaled = |points: &[DVec3]| points.iter().map(|p| *p * scale).collect::<Vec<_>>();
        assert_eq!(
            within(&scaled(&truth), &scaled(&queries), 0.01 * scale),
            count
        );
        let voxels = downsample::voxel(&truth, 0.0625).unwrap();
        let larger = downsample::voxel(&scaled(&truth), 0.0625 * scale).unwrap();
        assert_eq!(larger, scaled(&voxels));
    }
}

#[test]
fn a_million_identical_points() {
    let point = DVec3::new(0.1, 0.2, 0.3);
    let truth = vec![point; 1_000_000];
    let index = BlockIndex::new(&truth).unwrap();
    let distances = index.distances(&truth);
    assert!(distances.iter().all(|&distance| distance == 0.0));
    let far = index.distances(&[DVec3::new(0.1, 0.2, 1.3), DVec3::splat(1e9)]);
    assert_eq!(far[0], 1.0);
    assert_eq!(far[1], DVec3::splat(1e9).distance(point));
    assert_eq!(downsample::voxel(&truth, 1e-3).unwrap().len(), 1);
}

/// As failed pixels at the origin are, beside a surface: the tree has nodes of one place at several levels.
#[test]
fn places_that_many_points_share_are_as_far_as_each_of_them() {
    let places = [DVec3::ZERO, DVec3::new(0.5, 0.5, 2.0), DVec3::ONE];
    let mut truth = sheet(11, 4000);
    for (place, count) in places.into_iter().zip([20_000, 3000, 130]) {
        truth.extend(std::iter::repeat_n(place, count));
    }
    let near = |spread: f64| {
        let about = sheet(12, 600).into_iter().enumerate();
        about.map(move |(i, p)| places[i % 3] + (p - DVec3::splat(0.5)) * spread)
    };
    let queries: Vec<DVec3> = sheet(13, 3000)
        .into_iter()
        .chain(near(1e-3))
        .chain(near(1.0))
        .chain(near(100.0))
        .collect();
    let count = within(&truth, &queries, 0.01);
    assert!((600..queries.len()).contains(&count), "{count}");
    within(&queries, &truth, 0.01);
    // Two whole nodes of 512 blocks; and as queries, whole groups that are searched together.
    let two = |count: usize| {
        [places[0], places[2]]
            .map(|place| vec![place; count])
            .concat()
    };
    within(&two(8192), &queries, 0.01);
    within(&queries, &two(128 * 65), 0.01);
    let moved: Vec<DVec3> = truth.iter().map(|p| *p + DVec3::splat(0.004)).collect();
    let options = IcpOptions {
        max_iterations: 8,
        ..IcpOptions::new(0.05)
    };
    let fast = icp(&moved, &truth, &options).unwrap();
    let plain = icp_plain(&moved, &truth, &options).unwrap();
    assert_eq!(
        (fast.pairs, fast.iterations),
        (plain.pairs, plain.iterations)
    );
    let (fast, plain) = (fast.target_from_source, plain.target_from_source);
    assert!(fast.abs_diff_eq(plain, 1e-11), "{fast} {plain}");
}

#[test]
fn lines_planes_grids_and_single_points() {
    let line: Vec<DVec3> = (0..4000).map(|i| DVec3::X * f64::from(i)).collect();
    let grid: Vec<DVec3> = (0..4000)
        .map(|i| DVec3::new(f64::from(i % 64), f64::from(i / 64), 0.0))
        .collect();
    let one = vec![DVec3::new(7.0, -3.0, 2.0)];
    let sets = [line, grid, one, sheet(5, 3000)];
    for truth in &sets {
        for queries in &sets {
            within(truth, queries, 1.0);
        }
    }
    // Every query of the grid is exactly 1 from the grid one step above it: none is within 1.
    let raised: Vec<DVec3> = sets[1].iter().map(|p| *p + DVec3::Z).collect();
    assert_eq!(within(&sets[1], &raised, 1.0), 0);
    assert_eq!(within(&sets[1], &raised, 1.0f64.next_up()), 4000);
}

#[test]
fn disjoint_clouds_and_outliers() {
    let truth = sheet(6, 5000);
    let far: Vec<DVec3> = sheet(7, 500)
        .iter()
        .map(|p| *p + DVec3::splat(1e6))
        .collect();
    assert_eq!(within(&truth, &far, 1e6), 0);
    let bounded = BlockIndex::new(&truth).unwrap().distances_below(&far, 0.05);
    assert!(bounded.iter().all(|&distance| distance == f64::INFINITY));
    let mut with_outliers = truth.clone();
    with_outliers.extend([DVec3::splat(1e9), DVec3::splat(-1e300), DVec3::X * 1e150]);
    assert_eq!(within(&with_outliers, &truth, 1e-9), 5000);
    within(&truth, &with_outliers, 1e-9);
}

#[test]
fn queries_that_are_not_finite_are_near_nothing() {
    let truth = sheet(8, 100);
    let mut queries = truth.clone();
    queries[3] = DVec3::NAN;
    queries[99] = DVec3::new(0.0, f64::NEG_INFINITY, 0.0);
    assert_eq!(within(&truth, &queries, 1e-9), 98);
    assert_eq!(within(&truth, &[DVec3::NAN], 1.0), 0);
    assert_eq!(within(&truth, &[], 1.0), 0);
}

#[test]
fn both_indices_give_the_distances_of_their_points() {
    let (a, b) = (sheet(9, 3000), sheet(10, 1001));
    let (index_a, index_b) = (BlockIndex::new(&a).unwrap(), BlockIndex::new(&b).unwrap());
    assert_eq!(index_a.distances_from(&index_b), index_a.distances(&b));
    assert_eq!(index_b.distances_from(&index_a), index_b.distances(&a));
    let both = (index_b.distances(&a), index_a.distances(&b));
    assert_eq!(distance::both_ways(&a, &b).unwrap(), both);
    let none = distance::both_ways(&a, &[]).unwrap();
    assert_eq!(none, (vec![f64::INFINITY; 3000], vec![]));
}
