use super::*;
use crate::format::image::{read_color, read_gray};
use crate::format::jpeg::tests::{all_options, oracle, picture, random};
use ::image::ImageFormat;
use jpeg_encoder::{ColorType, Encoder, SamplingFactor};

/// What the decoder of all other files makes of the bytes.
fn obvious(bytes: &[u8]) -> Option<Vec<u8>> {
    let image = ::image::load_from_memory_with_format(bytes, ImageFormat::Jpeg).ok()?;
    Some(image.into_rgb8().into_raw())
}

fn found(bytes: &[u8]) -> Option<Vec<u8>> {
    let (_, image) = decode(bytes, u64::MAX, Window::whole).ok()??;
    Some(image.values().as_flattened().to_vec())
}

const SIZES: [(u32, u32); 10] = [
    (17, 17),
    (24, 40),
    (33, 31),
    (127, 24),
    (128, 33),
    (129, 47),
    (255, 18),
    (256, 48),
    (257, 50),
    (523, 47),
];

#[test]
fn pixels_are_those_of_the_other_decoder() {
    for size in SIZES {
        for kind in 0..7 {
            let image = picture(size, kind);
            for options in all_options(&[1, 10, 50, 75, 95, 100]) {
                let bytes = oracle(&image, options);
                let found = found(&bytes);
                assert!(
                    found.is_some() && found == obvious(&bytes),
                    "{size:?} {kind} {options:?}"
                );
            }
        }
    }
}

/// Borders of windows on, before and after those of what is coded together; windows of one pixel, too.
#[test]
fn parts_are_those_of_the_whole() {
    let mut seen = 0;
    for (width, height) in [(17, 17), (129, 47), (257, 50), (523, 47), (600, 300)] {
        let image = picture((width, height), 6);
        for options in all_options(&[93]) {
            let bytes = oracle(&image, options);
            let whole = decode(&bytes, u64::MAX, Window::whole).unwrap();
            let (_, whole) = whole.unwrap();
            let ranges = |length: u32, round: u32| {
                let borders = [0, 1, 7, 8, 15, 16, 17, 31, 33, 127, 128, 255, 256, 259, 511];
                let any = |seed| borders[random(round, seed) as usize % borders.len()] % length;
                let (a, b) = (any(length), any(length + 1));
                let end = if round.is_multiple_of(5) {
                    length
                } else {
                    a.max(b) + 1
                };
                a.min(b)..end
            };
            for round in 0..60 {
                let window = Window {
                    columns: ranges(width, round),
                    rows: ranges(height, round + 1000),
                };
                let part = decode(&bytes, u64::MAX, |_| window.clone()).unwrap();
                let part = part.unwrap();
                let expected = ((width, height), whole.cut(&window).unwrap());
                assert!(part == expected, "{width}x{height} {window:?} {options:?}");
                seen += 1;
            }
            let beyond = Window::whole((width + 1, height));
            assert!(decode(&bytes, u64::MAX, |_| beyond).unwrap().is_none());
        }
    }
    assert!(seen >= 300, "{seen}");
}

/// An image encoded in a way that the other tests do not have.
fn encoded(size: (u32, u32), change: impl Fn(&mut Encoder<&mut Vec<u8>>)) -> Vec<u8> {
    let image = picture(size, 6);
    let mut bytes = Vec::new();
    let mut encoder = Encoder::new(&mut bytes, 93);
    change(&mut encoder);
    let pixels = image.values().as_flattened();
    let (width, height) = (size.0 as u16, size.1 as u16);
    encoder
        .encode(pixels, width, height, ColorType::Rgb)
        .unwrap();
    bytes
}

#[test]
fn notes_are_skipped_and_what_is_not_plain_is_left_alone() {
    let size = (211, 103);
    let noted = encoded(size, |encoder| {
        encoder.add_app_segment(11, vec![7; 300]).unwrap();
    });
    assert!(found(&noted).is_some() && found(&noted) == obvious(&noted));
    let others: [fn(&mut Encoder<&mut Vec<u8>>); 4] = [
        |encoder| encoder.set_progressive(true),
        |encoder| encoder.set_restart_interval(5),
        |encoder| encoder.set_sampling_factor(SamplingFactor::F_2_1),
        // Each component in a scan of its own.
        |encoder| encoder.set_optimized_huffman_tables(true),
    ];
    for change in others {
        let bytes = encoded(size, change);
        assert!(obvious(&bytes).is_some() && found(&bytes).is_none());
    }
    let small = encoded((16, 100), |_| {});
    assert!(obvious(&small).is_some() && found(&small).is_none());
    let too_large = decode(&noted, 211 * 103 - 1, Window::whole);
    assert!(too_large.unwrap().is_none());
    let mut png = Vec::new();
    crate::format::image::write_png(&mut png, &picture((40, 40), 0)).unwrap();
    assert!(found(&png).is_none() && found(&[]).is_none());
}

#[test]
fn what_is_cut_short_is_refused_whatever_its_kind() {
    let kinds: [fn(&mut Encoder<&mut Vec<u8>>); 4] = [
        |_| {},
        |encoder| encoder.set_progressive(true),
        |encoder| encoder.set_restart_interval(5),
        // A thumbnail has an end of its own.
        |encoder| {
            let thumbnail = vec![0xff, 0xd8, 1, 0xff, 0xd9];
            encoder.add_app_segment(1, thumbnail).unwrap();
        },
    ];
    for (nth, change) in kinds.into_iter().enumerate() {
        let mut bytes = encoded((211, 103), change);
        assert!(
            read_color(&bytes).is_ok() && read_gray(&bytes).is_ok(),
            "{nth}"
        );
        for part in [10, 30, 50, 70, 90, 99] {
            let error = read_gray(&bytes[..bytes.len() * part / 100]).unwrap_err();
            let said = error.to_string();
            assert!(
                said.contains("cut short") || part == 10,
                "{nth} {part}: {said}"
            );
            assert!(
                read_color(&bytes[..bytes.len() * part / 100]).is_err(),
                "{nth} {part}"
            );
        }
        bytes.extend(b"what a camera adds");
        assert!(read_color(&bytes).is_ok(), "{nth}");
    }
}

/// The end of the coded data is gone, or their middle is no code: the other decoder fills that up.
#[test]
fn what_is_damaged_within_is_refused() {
    let whole = encoded((211, 103), |_| {});
    let scan = whole
        .windows(2)
        .position(|two| two == [0xff, 0xda])
        .unwrap();
    let half = scan + (whole.len() - scan) / 2;
    let mut cut = whole[..half].to_vec();
    cut.extend([0xff, 0xd9]);
    let mut blank = whole.clone();
    for ones in blank[half..half + 60].chunks_mut(2) {
        ones.copy_from_slice(&[0xff, 0]);
    }
    for bytes in [cut, blank] {
        assert!(obvious(&bytes).is_some());
        let error = read_color(&bytes).unwrap_err().to_string();
        assert!(error.contains("end early or are damaged at row"), "{error}");
    }
}

#[test]
fn scans_of_single_components_and_finer_chroma_are_refused() {
    let several = encoded((211, 103), |encoder| {
        encoder.set_optimized_huffman_tables(true);
    });
    let progressive = encoded((211, 103), |encoder| encoder.set_progressive(true));
    let restarted = encoded((211, 103), |encoder| encoder.set_restart_interval(5));
    assert!(read_color(&progressive).is_ok() && read_color(&restarted).is_ok());
    let mut finer = encoded((211, 103), |encoder| {
        encoder.set_sampling_factor(SamplingFactor::F_1_1);
    });
    let frame = finer
        .windows(2)
        .position(|two| two == [0xff, 0xc0])
        .unwrap();
    finer[frame + 14] = 0x22;
    for (bytes, found) in [(several, "scans of their own"), (finer, "finer than")] {
        for error in [
            read_color(&bytes).unwrap_err(),
            read_gray(&bytes).unwrap_err(),
        ] {
            let error = error.to_string();
            assert!(error.contains(found), "{error}");
        }
    }
}

#[test]
fn broken_files_are_left_alone_or_read_as_they_are() {
    let mut read = 0;
    for (seed, options) in (0u32..).zip(all_options(&[1, 60, 95])) {
        let whole = oracle(&picture((83, 61), 2 + seed), options);
        for round in 0..1500 {
            let mut bytes = whole.clone();
            let noise = |index| random(round, 31 * seed + index) as usize;
            match round % 3 {
                0 => bytes.truncate(noise(0) % whole.len()),
                1 => bytes[noise(1) % whole.len()] ^= 1 << (noise(2) % 8),
                _ => {
                    let header = 2 + noise(1) % 620;
                    bytes[header] = noise(2) as u8;
                }
            }
            if let Some(found) = found(&bytes) {
                assert!(Some(found) == obvious(&bytes), "{options:?} {round}");
                read += 1;
            }
        }
    }
    assert!(read > 100, "{read} only");
}

/// Flat and busy blocks under a first step that is made coarser and coarser: the levels grow beyond all
/// pixels.
#[test]
fn levels_beyond_all_pixels_are_left_to_the_other_decoder() {
    let flat = |level| ColorImage::from_values(48, 48, vec![[level; 3]; 48 * 48]).unwrap();
    let mut images = [0, 40, 127, 129, 200, 255].map(flat).to_vec();
    images.extend((0..7).map(|kind| picture((48, 48), kind)));
    let (mut read, mut left) = (0, 0);
    for image in images {
        for options in all_options(&[60, 95, 100]) {
            let mut bytes = oracle(&image, options);
            // The steps of the first table follow its marker, its length and its number.
            let first = 5 + bytes
                .windows(2)
                .position(|two| two == [0xff, 0xdb])
                .unwrap();
            for step in (1..=255).step_by(2) {
                bytes[first] = step;
                match found(&bytes) {
                    Some(found) => {
                        assert!(Some(found) == obvious(&bytes), "{options:?} {step}");
                        read += 1;
                    }
                    None => left += 1,
                }
            }
        }
    }
    assert!(read > 1000 && left > 100, "{read} read, {left} left");
}

#[test]
fn tables_that_cannot_be_are_refused() {
    let symbols = [1; 256];
    let mut counts = [0; 16];
    counts[0] = 2;
    assert!(Table::new(&counts, &symbols[..2], true).is_none());
    counts[0] = 1;
    assert!(Table::new(&counts, &symbols[..1], true).is_some());
    counts[1] = 3;
    assert!(Table::new(&counts, &symbols[..4], false).is_none());
}
