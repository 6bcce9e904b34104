use super::*;
use crate::fuse::confident::Rows;
use crate::fuse::normals::from_depth;
use crate::fuse::samples::{Grid, Samples};
use crate::fuse::testing::{random_view, rng, uniform};
use glam::DVec2;
use pulp::Arch;

/// A block of pixels of a 640×480 view at random depths, its consensus and what a source says.
fn random_case(random: &mut rand_chacha::ChaCha8Rng) -> (Block, Consensus, Seen) {
    let (mut block, mut consensus, mut seen) = (Block::new(), Consensus::new(), Seen::new());
    for i in 0..BLOCK {
        let column = uniform(random, 0.0, 640.0) as u32;
        let row = uniform(random, 0.0, 480.0) as u32;
        block.push(
            Grid::whole(640),
            column,
            row,
            uniform(random, 2.0, 4.0) as f32,
        );
        consensus.delta[i] = uniform(random, -0.01, 0.01) as f32;
        seen.agrees[i] = u32::from(uniform(random, 0.0, 1.0) < 0.7);
        consensus.count[i] = seen.agrees[i];
        seen.ratio[i] = uniform(random, 0.99, 1.01) as f32;
        seen.x[i] = uniform(random, 0.0, 641.0) as f32;
        seen.y[i] = uniform(random, 0.0, 481.0) as f32;
    }
    (block, consensus, seen)
}

#[test]
fn positions_are_those_of_camera_and_pose_and_gathered_ones_the_means() {
    let mut random = rng(11);
    let view = random_view(&mut random, 0);
    let frame = Frame::new(&view);
    let (block, consensus, seen) = random_case(&mut random);
    let (mut plain, mut wide) = (Room::new(1), Room::new(1));
    let place = |room| Place {
        frame: &frame,
        block: &block,
        consensus: &consensus,
        room,
    };
    place(&mut plain).with_simd(pulp::Scalar::new());
    Arch::new().dispatch(place(&mut wide));
    let point = |i: usize| {
        let pixel = DVec2::new(f64::from(block.u[i]), f64::from(block.v[i]));
        let depth = f64::from(block.depth[i]) + f64::from(consensus.delta[i]);
        view.pose.to_world(view.camera.ray(pixel) * depth)
    };
    for i in 0..BLOCK {
        assert_eq!(plain.position(i), wide.position(i));
        assert!((wide.position(i) - point(i)).length() < 1e-12);
    }
    let center = DVec3::new(0.3, -2.0, 5.0);
    let centers = [center];
    let gather = |room| Gather {
        centers: &centers,
        seen: std::slice::from_ref(&seen),
        consensus: &consensus,
        room,
    };
    gather(&mut plain).with_simd(pulp::Scalar::new());
    Arch::new().dispatch(gather(&mut wide));
    for i in 0..BLOCK {
        assert_eq!(plain.position(i), wide.position(i));
        let other = center + (point(i) - center) / f64::from(seen.ratio[i]);
        let mean = match seen.agrees[i] {
            1 => 0.5 * (point(i) + other),
            _ => point(i),
        };
        assert!((wide.position(i) - mean).length() < 1e-12);
    }
}

#[test]
fn normals_of_whole_windows_are_those_of_the_general_fit() {
    let mut random = rng(12);
    let view = random_view(&mut random, 0);
    let frame = Frame::new(&view);
    let (block, _, _) = random_case(&mut random);
    let runs: Vec<Run> = (0..BLOCK).map(|i| i..i + 1).collect();
    for unit in [Unit::Depth, Unit::Inverse] {
        let mut depth = |_| match uniform(&mut random, 0.0, 1.0) {
            gone if gone < 0.02 => 0.0,
            _ => unit.convert(uniform(&mut random, 2.99, 3.01) as f32),
        };
        let stored: Vec<f32> = (0..640 * 480).map(&mut depth).collect();
        let map = Samples::new((640, 480), unit, &stored);
        let (mut plain, mut wide) = (Room::new(1), Room::new(1));
        let similar = 0.006;
        for room in [&mut plain, &mut wide] {
            room.copy_windows(&runs, &block, Rows::all(&map));
        }
        let face = |room| Face {
            frame: &frame,
            block: &block,
            unit,
            similar,
            room,
        };
        face(&mut plain).with_simd(pulp::Scalar::new());
        Arch::new().dispatch(face(&mut wide));
        let mut fitted = 0;
        for i in 0..BLOCK {
            assert_eq!(plain.is_whole(i), wide.is_whole(i));
            let pixel = (block.u[i] as usize, block.v[i] as usize);
            if wide.is_whole(i) {
                fitted += 1;
                let normal = |room: &Room| Vec3::from(room.normal.map(|axis| axis[i]));
                let found = normal(&wide);
                assert_eq!(found, normal(&plain));
                let expected = from_depth(&map, &view.camera, pixel, similar).unwrap();
                let expected = view.pose.direction_to_world(expected.as_dvec3());
                assert!((found.as_dvec3() - expected).length() < 1e-6);
            }
        }
        assert!((20..BLOCK).contains(&fitted), "{fitted}");
    }
}

/// Runs of all lengths, gaps between them, up to the end of the block and of the map.
#[test]
fn windows_are_copied_run_by_run() {
    let stored: Vec<f32> = (0..100 * 3).map(|at| at as f32 + 1.0).collect();
    let map = Samples::new((100, 3), Unit::Depth, &stored);
    for length in [1, 3, 15, 16, 17, 40, 64] {
        let (mut block, mut room, mut runs) = (Block::new(), Room::new(0), Vec::new());
        for i in 0..BLOCK {
            block.push(map.grid(), 36 + i as u32, 1 + u32::from(length > 20), 1.0);
        }
        for first in (0..BLOCK).step_by(length + 1) {
            runs.push(first..(first + length).min(BLOCK));
        }
        room.copy_windows(&runs, &block, Rows::all(&map));
        for i in runs.iter().cloned().flatten() {
            let around = map.around(36 + i, block.row(i));
            assert_eq!(room.window(i), around, "{length}");
        }
    }
}

#[test]
fn colours_are_fetched_at_the_nearest_pixel_and_their_means_are_rounded() {
    let mut random = rng(13);
    let (_, _, seen) = random_case(&mut random);
    // All of an image of 1280×240 but the outermost pixels.
    let (corner, size) = ((1, 1), (1278, 238));
    let (mut plain, mut wide) = (Room::new(1), Room::new(1));
    let locate = |room| Locate {
        seen: &seen,
        scale: [2.0, 0.5],
        corner,
        size,
        to: (0, room),
    };
    locate(&mut plain).with_simd(pulp::Scalar::new());
    Arch::new().dispatch(locate(&mut wide));
    assert_eq!(plain.texels, wide.texels);
    for i in 0..BLOCK {
        let nearest = |at: f32, last| (at as u32).clamp(1, last) - 1;
        let column = nearest((seen.x[i] - 0.5) * 2.0, size.0);
        let row = nearest((seen.y[i] - 0.5) * 0.5, size.1);
        assert_eq!(wide.texels[0][i], seen.agrees[i] * (row * size.0 + column));
    }
    for count in 1..300u32 {
        let (mut plain, mut wide) = (Room::new(1), Room::new(1));
        let sum = |i: usize, channel: usize| {
            let i = i as u32;
            (i * 4 * count + i % count + channel as u32).min(255 * count)
        };
        for room in [&mut plain, &mut wide] {
            room.colored = [count; BLOCK];
            room.sums = std::array::from_fn(|channel| std::array::from_fn(|i| sum(i, channel)));
        }
        Mean(&mut plain).with_simd(pulp::Scalar::new());
        Arch::new().dispatch(Mean(&mut wide));
        plain.keep_colors();
        wide.keep_colors();
        assert_eq!(plain.colors, wide.colors);
        for i in 0..BLOCK {
            let mean = |channel| ((sum(i, channel) + count / 2) / count) as u8;
            assert_eq!(wide.colors[i], [mean(0), mean(1), mean(2)]);
        }
    }
}

#[test]
fn texels_are_added_where_the_source_agrees() {
    let (mut plain, mut wide) = (Room::new(1), Room::new(1));
    let agrees = std::array::from_fn(|i| u32::from(i % 3 == 0));
    for room in [&mut plain, &mut wide] {
        room.texels[0] = std::array::from_fn(|i| 0x30_20_10 + i as u32);
        room.own_colors(&[0..1, 1..4], |_| [1, 2, 3]);
    }
    let add = |room| Add {
        agrees: &agrees,
        to: (0, room),
    };
    add(&mut plain).with_simd(pulp::Scalar::new());
    Arch::new().dispatch(add(&mut wide));
    assert_eq!((plain.sums, plain.colored), (wide.sums, wide.colored));
    assert_eq!(wide.sums.map(|channel| channel[3]), [0x14, 0x22, 0x33]);
    assert_eq!(wide.sums.map(|channel| channel[1]), [1, 2, 3]);
    assert_eq!(wide.colored[..4], [2, 1, 1, 2]);
}
