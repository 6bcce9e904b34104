use super::*;
use crate::fuse::confident::Rows;
use crate::fuse::normals::from_depth;
use crate::fuse::points::{Columns, Points, ROW_KINDS};
use crate::fuse::rows::{BandBytes, add_to_rows};
use crate::fuse::samples::{Grid, Samples};
use crate::fuse::testing::{as_bytes, random_view, rng, uniform};
use glam::DVec2;
use mvs_datasets::scene::ColorImage;
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
            room.copy_windows(&block, Rows::all(&map));
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
        assert_eq!(plain.whole(), wide.whole());
        for i in 0..BLOCK {
            if wide.whole() >> i & 1 == 1 {
                fitted += 1;
                let normal = |room: &Room| Vec3::from(room.normal.map(|axis| axis[i]));
                let found = normal(&wide);
                assert_eq!(found, normal(&plain));
                let expected = from_depth(&map, &view.camera, block.at(i), similar).unwrap();
                let expected = view.pose.direction_to_world(expected.as_dvec3());
                assert!((found.as_dvec3() - expected).length() < 1e-6);
            }
        }
        assert!((20..BLOCK).contains(&fitted), "{fitted}");
    }
}

/// Stretches of all lengths, gaps between them, up to the end of the block and of the map.
#[test]
fn windows_are_copied_stretch_by_stretch() {
    let stored: Vec<f32> = (0..130 * 3).map(|at| at as f32 + 1.0).collect();
    let map = Samples::new((130, 3), Unit::Depth, &stored);
    let view = random_view(&mut rng(3), 0);
    let cases = [
        (1, 64),
        (3, 64),
        (15, 50),
        (16, 64),
        (17, 64),
        (40, 64),
        (64, 9),
    ];
    let cases = cases.into_iter().flat_map(|case| [(case, 1), (case, 2)]);
    for ((length, len), row) in cases {
        let (mut block, mut room) = (Block::new(), Room::new(0));
        let mut column = 129 - BLOCK as u32 - (BLOCK / length) as u32;
        for i in 0..BLOCK {
            column += u32::from(i % length == 0);
            block.push(map.grid(), column, row, 1.0);
            column += 1;
        }
        block.len = len;
        Arch::new().dispatch(Place {
            frame: &Frame::new(&view),
            block: &block,
            consensus: &Consensus::new(),
            room: &mut room,
        });
        room.copy_windows(&block, Rows::all(&map));
        for i in 0..len {
            let (column, row) = block.at(i);
            assert_eq!(room.window(i), map.around(column, row), "{length}");
        }
    }
}

#[test]
fn bits_are_numbered_in_order() {
    for bits in [0, 1, 1 << 63, u64::MAX, 0x8000_0100_0000_0013] {
        let expected: Vec<usize> = (0..BLOCK).filter(|i| bits >> i & 1 == 1).collect();
        assert_eq!(entries(bits).collect::<Vec<_>>(), expected);
    }
    assert_eq!([0, 1, 64].map(first), [0, 1, u64::MAX]);
}

/// As many points as were foreseen, in rows that lie as near as any do.
#[test]
fn full_rows_of_bytes_lie_side_by_side() {
    let (mut block, mut room, consensus) = (Block::new(), Room::new(0), Consensus::new());
    let most = 4096; // times 25 bytes: whole pages
    let mut bytes = BandBytes::default();
    bytes.begin(3, most, Columns::DOUBLES);
    for row in [1, 0, 2] {
        for first in (0..most).step_by(BLOCK) {
            block.len = 0;
            for i in 0..BLOCK {
                block.push(Grid::whole(5000), (first + i) as u32, row, 1.0);
                room.position[0][i] = (first + i) as f64 + 10_000.0 * f64::from(row);
            }
            let points = BlockPoints {
                block: &block,
                consensus: &consensus,
                room: &room,
                first_row: 0,
                confidences: None,
                photo: None,
            };
            add_to_rows(Columns::DOUBLES, &points, u64::MAX, &mut bytes);
        }
    }
    for (row, bytes) in bytes.rows().enumerate() {
        let (points, rest) = bytes.as_chunks::<25>();
        assert_eq!((points.len(), rest.len()), (most, 0));
        for (at, point) in points.iter().enumerate() {
            let x = f64::from_le_bytes(*point.first_chunk().unwrap());
            assert_eq!(x, at as f64 + 10_000.0 * row as f64);
        }
    }
}

#[test]
fn entries_are_taken_row_by_row() {
    let mut room = Room::new(0);
    let kept: u64 = 0xf0f1_8000_ffff_0001;
    let rows = [
        kept & 0xffff,
        kept & 0xffff << 16,
        kept & 0xffff << 32,
        kept & 0xffff << 48,
    ];
    for (beside, expected) in [
        (!0x0001_0001_0001_0001, rows.to_vec()),
        (0, entries(kept).map(|i| 1 << i).collect()),
        (u64::MAX, vec![kept]),
    ] {
        room.beside = beside;
        let (mut left, mut found) = (kept, Vec::new());
        while left != 0 {
            found.push(room.of_one_row(left));
            left &= !found[found.len() - 1];
        }
        assert_eq!(found, expected);
    }
}

/// Every choice of columns, in the rows of a map in which the points lie.
#[test]
fn rows_of_bytes_are_those_of_columns() {
    let mut random = rng(17);
    let mut draw = || uniform(&mut random, -9.0, 9.0);
    let (mut block, mut room, mut consensus) = (Block::new(), Room::new(0), Consensus::new());
    for i in 0..BLOCK {
        let row = [30, 31, 33, 30][i / 16];
        block.push(Grid::whole(40), (i % 16) as u32 + 3, row, 1.0);
        room.position.iter_mut().for_each(|axis| axis[i] = draw());
        room.normal
            .iter_mut()
            .for_each(|axis| axis[i] = draw() as f32);
        room.colors[i] = [i as u8, 7, 200 - i as u8];
        room.views[i] = 70_000 + i as u32;
        room.scale[i] = draw() as f32;
        consensus.violations[i] = i as u32 * 3;
    }
    let confidences: Vec<f32> = (0..40 * 40).map(|at| at as f32).collect();
    let pixels: Vec<[u8; 3]> = (0..40 * 40u32)
        .map(|at| [at as u8, (at / 7) as u8, 9])
        .collect();
    let photo = Photo {
        size: (40, 50),
        corner: (2, 10),
        part: ColorImage::from_values(40, 40, pixels).unwrap(),
    };
    let kept = 0xf0f1_8000_ffff_0001;
    room.beside = !0x0001_0001_0001_0001;
    for (confidences, photo) in [(Some(confidences.as_slice()), Some(&photo)), (None, None)] {
        let points = BlockPoints {
            block: &block,
            consensus: &consensus,
            room: &room,
            first_row: 30,
            confidences,
            photo,
        };
        let mut bytes = BandBytes::default();
        for bits in 0..ROW_KINDS as u8 {
            let columns = Columns::of_row_bits(bits);
            let mut expected = vec![Points::default(); 4];
            bytes.begin(4, 2 * 34, columns);
            for _ in 0..2 {
                for i in (0..BLOCK).filter(|i| kept >> i & 1 == 1) {
                    expected[block.row[i] as usize - 30].add(columns, &points, i);
                }
                // What is read by the views that see points is none of a row's.
                add_to_rows(columns.and(Columns::VISIBLE), &points, kept, &mut bytes);
            }
            assert_eq!(bytes.rows().count(), 4);
            for (found, expected) in bytes.rows().zip(&expected) {
                assert!(found == as_bytes(expected, columns), "{bits}");
                let mut rows = vec![7; 5];
                expected.to_rows(columns, 0..expected.len(), &mut rows);
                assert!(found == rows, "{bits}");
                if expected.len() > 2 {
                    expected.to_rows(columns, 1..2, &mut rows);
                    assert_eq!(rows, found[rows.len()..2 * rows.len()]);
                }
            }
            assert_eq!(expected.iter().map(Points::len).collect::<Vec<_>>()[2], 0);
        }
        let first = kept.trailing_zeros() as usize;
        let color = photo.map_or([0, 7, 200], |photo| photo.part.get(3 - 2, 30 - 10));
        assert_eq!((first, points.color(first)), (0, color));
        let confidence = if confidences.is_some() { 1203.0 } else { 1.0 };
        assert_eq!(points.confidence(first), confidence);
        bytes.begin(2, 5, Columns::default());
        assert!(bytes.rows().count() == 2 && bytes.rows().all(<[u8]>::is_empty));
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
        room.own_colors(0b1111, |_| [1, 2, 3]);
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
