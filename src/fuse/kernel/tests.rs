use super::*;
use crate::fuse::consensus::{Error, Errors};
use crate::fuse::options::FuseOptions;
use crate::fuse::rules::Bounds;
use crate::fuse::samples::{Grid, Unit};
use crate::fuse::sampling;
use crate::fuse::taps::{Look, Looks, PlainLooks, Sampled, Sight, Taps, ValidLooks};
use crate::fuse::testing::{random_view, rng, uniform};
use glam::DVec2;
use mvs_datasets::scene::DepthMap;

/// A source map of random depths near `around`, a tenth of it without depth.
fn random_map(random: &mut rand_chacha::ChaCha8Rng, around: f64) -> DepthMap {
    let mut draw = || {
        let depth = around * uniform(random, 0.96, 1.04);
        if uniform(random, 0.0, 1.0) < 0.1 {
            0.0
        } else {
            depth as f32
        }
    };
    let values = (0..640 * 480).map(|_| draw()).collect();
    DepthMap::from_values(640, 480, values).unwrap().0
}

fn random_block(random: &mut rand_chacha::ChaCha8Rng) -> Block {
    let mut block = Block::new();
    while !block.is_full() {
        let column = uniform(random, 0.0, 640.0) as u32;
        let row = uniform(random, 0.0, 480.0) as u32;
        block.push(
            Grid::whole(640),
            column,
            row,
            uniform(random, 2.0, 4.0) as f32,
        );
    }
    block
}

/// The obvious: validity-aware bilinear sampling in f64. Expected over sampled depth, 0 for none;
/// `None` where rounding may decide whether a pixel counts.
fn valid_oracle(map: &DepthMap, pixel: DVec2, z: f64, similar: f64) -> Option<f64> {
    let corner = (pixel - 0.5).floor();
    let (mut weight, mut sum, mut nearest) = (0.0, 0.0, false);
    for (dx, dy) in [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)] {
        let (column, row) = (corner.x + dx, corner.y + dy);
        let inside = column >= 0.0 && row >= 0.0 && column < 640.0 && row < 480.0;
        if !inside {
            continue;
        }
        let depth = f64::from(map.get(column as u32, row as u32));
        if depth > 0.0 && ((z / depth - 1.0).abs() - similar).abs() < 1e-6 {
            return None;
        }
        if depth > 0.0 && (z / depth - 1.0).abs() <= similar {
            let away = (pixel - 0.5 - DVec2::new(column, row)).abs();
            let share = (1.0 - away.x) * (1.0 - away.y);
            weight += share;
            sum += share * z / depth;
            nearest |= away.max_element() < 0.5;
        }
    }
    Some(if nearest { sum / weight } else { 0.0 })
}

/// What a source's pixels say about a block, and the errors that follow.
fn looked(
    pair: &Pair,
    (reference, block): (&View, &Block),
    (map, taps): (&Samples, Taps),
) -> [(Look, Error); BLOCK] {
    let (mut seen, mut footprint) = (Seen::new(), Footprint::new());
    let (mut near, mut sampled) = (Near::new(), Sampled::new());
    near.fill(block);
    let relative = Relative::alone(&near, (pair, map));
    let from = (block, &near, (&relative, 0));
    pair.project::<true>(from, map, &mut seen, &mut footprint);
    sampled.fetch((map, taps), &footprint);
    let bounds = &Bounds::new(reference, &FuseOptions::default());
    let errors = Errors {
        epipole: pair.epipole,
        block,
        bounds,
    };
    let sight = Sight {
        sampled: &sampled,
        footprint: &footprint,
        bounds,
    };
    std::array::from_fn(|i| {
        let look = match taps {
            Taps::Valid(similar) => ValidLooks(sight, similar).at(i),
            _ => PlainLooks(sight).at(i),
        };
        (look, errors.at(i, look.q))
    })
}

#[test]
fn the_loop_agrees_with_the_closed_form_in_f64() {
    let mut random = rng(3);
    let (mut plain_seen, mut valid_seen) = (0, 0);
    for _ in 0..80 {
        let (reference, source) = (random_view(&mut random, 0), random_view(&mut random, 1));
        let pair = Pair::new(&reference, &source);
        let geometry = PairGeometry::new(&reference, &source);
        let block = random_block(&mut random);
        let middle = DVec2::new(320.0, 240.0);
        let around = geometry.project(middle, 3.0).map_or(3.0, |p| p.depth);
        let map = random_map(&mut random, around);
        let inverse: Vec<f32> = map
            .values()
            .iter()
            .map(|&d| Unit::Inverse.convert(d))
            .collect();
        let as_depth = Samples::new(map.size(), Unit::Depth, map.values());
        let as_inverse = Samples::new(map.size(), Unit::Inverse, &inverse);
        let plain = looked(&pair, (&reference, &block), (&as_depth, Taps::Plain));
        let valid = looked(
            &pair,
            (&reference, &block),
            (&as_inverse, Taps::Valid(0.02)),
        );
        for i in 0..BLOCK {
            let pixel = DVec2::new(f64::from(block.u[i]), f64::from(block.v[i]));
            let depth = f64::from(block.depth[i]);
            let projected = geometry.project(pixel, depth);
            let sampled = projected.map_or(0.0, |p| sampling::plain(&map, p.pixel));
            let (look, error) = plain[i];
            assert_eq!(look.sampled, sampled > 0.0);
            let Some(projected) = projected.filter(|_| sampled > 0.0) else {
                continue;
            };
            plain_seen += 1;
            let q = sampled / projected.depth - 1.0;
            let close = |found: f32, expected: f64| {
                let bound = 3e-5 * (1.0 + q.abs() + expected.abs());
                assert!(
                    (f64::from(found) - expected).abs() < bound,
                    "{found} {expected} q {q}"
                );
            };
            close(error.delta, geometry.reprojected_depth(depth, q) - depth);
            close(
                error.delta.abs() / block.depth[i],
                geometry.depth_error(depth, q),
            );
            let reprojected = geometry.reprojected_depth(depth, q);
            close(error.reprojected2.sqrt(), reprojected.abs());
            // In pixels times depth: a hundred times as large.
            let across = f64::from(error.across2).sqrt() / 640.0;
            let expected = geometry.pixel_error(pixel, depth, q) * reprojected.abs() / 640.0;
            close(across as f32, expected);
            let oracle = valid_oracle(&map, projected.pixel, projected.depth, 0.02);
            let Some(oracle) = oracle else { continue };
            let (look, _) = valid[i];
            assert_eq!(look.sampled, oracle > 0.0);
            if oracle > 0.0 {
                valid_seen += 1;
                let found = 1.0 / (1.0 + f64::from(look.q));
                assert!((found - oracle).abs() < 1e-6, "{found} {oracle}");
            }
        }
    }
    assert!(
        plain_seen > 500 && valid_seen > 50,
        "{plain_seen} {valid_seen}"
    );
}

/// A map so wide that its columns are no whole numbers of the short way, with depths on its far side only.
#[test]
fn in_very_wide_maps_pixels_are_found_in_f64() {
    let mut random = rng(3);
    let view = random_view(&mut random, 0);
    let width = 5_000_000;
    let samples = Samples::new((width, 1), Unit::Depth, &vec![0.0; width as usize]);
    let far_side = 4_600_000..4_600_200;
    let samples = samples.within(vec![far_side]);
    let mut block = Block::new();
    for i in 0..BLOCK as u32 {
        block.push(Grid::whole(width), 100 + i, 0, 2.0);
    }
    let pair = Pair::new(&view, &view);
    let mut near = Near::new();
    near.fill(&block);
    let narrow = Samples::new((640, 1), Unit::Depth, &[0.0; 640]);
    assert!(Relative::alone(&near, (&pair, &narrow)).fits(0));
    let relative = Relative::alone(&near, (&pair, &samples));
    assert!(!relative.fits(0));
    let (mut seen, mut found) = (Seen::new(), Footprint::new());
    let from = (&block, &near, (&relative, 0));
    pair.project::<false>(from, &samples, &mut seen, &mut found);
    let mut expected = Footprint::new();
    pair.project_widely::<false>(&block, &samples, &mut seen, &mut expected);
    assert_eq!(found.index, expected.index);
    let last = samples.values().len() - samples.stride();
    assert!(found.any && found.index.iter().all(|&index| (index as usize + 1) < last));
}
