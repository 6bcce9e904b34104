use super::*;
use crate::format::image::read_color;
use crate::scene::Raster;
use jpeg_encoder::{ChromaSubsamplingMethod, ColorType, Encoder, SamplingFactor};

/// The crate that this encoder's bytes are those of.
pub(super) fn oracle(image: &ColorImage, options: JpegOptions) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut encoder = Encoder::new(&mut bytes, options.quality);
    encoder.set_chroma_subsampling_method(ChromaSubsamplingMethod::Average);
    encoder.set_sampling_factor(match options.subsample_chroma {
        true => SamplingFactor::F_2_2,
        false => SamplingFactor::F_1_1,
    });
    let size = (image.width() as u16, image.height() as u16);
    let pixels = image.values().as_flattened();
    encoder
        .encode(pixels, size.0, size.1, ColorType::Rgb)
        .unwrap();
    bytes
}

pub(super) fn random(index: u32, seed: u32) -> u32 {
    let mut state = index.wrapping_mul(2_654_435_761) ^ seed.wrapping_mul(2_246_822_519);
    state ^= state >> 15;
    state = state.wrapping_mul(3_266_489_917);
    state ^ state >> 13
}

/// Pictures of several kinds: smooth, flat, noise, noise in few pixels, black and white, steps.
pub(super) fn picture((width, height): (u32, u32), kind: u32) -> ColorImage {
    let values = (0..width * height).map(|i| {
        let (x, y) = (i % width, i / width);
        [0, 1, 2].map(|channel| {
            let noise = random(i, channel + 7 * kind);
            let phase = f64::from(x) * 0.07 + f64::from(y * (channel + 1)) * 0.05;
            match kind {
                0 => (127.0 + 120.0 * phase.sin()) as u8,
                1 => [0, 90, 255][channel as usize],
                2 => noise as u8,
                3 if noise.is_multiple_of(40) => (noise >> 8) as u8,
                3 => 128,
                4 => 255 * (noise & 1) as u8,
                5 => 255 * ((x / 4 + y / (channel + 1)) & 1) as u8,
                _ => (127.0 + 100.0 * phase.cos()) as u8 + (noise % 20) as u8,
            }
        })
    });
    Raster::from_values(width, height, values.collect()).unwrap()
}

const SIZES: [(u32, u32); 12] = [
    (1, 1),
    (7, 3),
    (8, 8),
    (15, 17),
    (16, 16),
    (33, 9),
    (127, 24),
    (128, 40),
    (129, 31),
    (255, 33),
    (256, 16),
    (523, 47),
];

pub(super) fn all_options(qualities: &[u8]) -> Vec<JpegOptions> {
    let both = |&quality: &u8| {
        [true, false].map(|subsample_chroma| JpegOptions {
            quality,
            subsample_chroma,
        })
    };
    qualities.iter().flat_map(both).collect()
}

#[test]
fn the_bytes_are_those_of_the_crate() {
    for size in SIZES {
        for kind in 0..7 {
            let image = picture(size, kind);
            for options in all_options(&[1, 10, 49, 50, 75, 90, 95, 98, 99, 100]) {
                let (found, expected) = (encode(&image, None, options), oracle(&image, options));
                assert!(found.unwrap() == expected, "{size:?} {kind} {options:?}");
            }
        }
    }
}

/// Shapes of surface: half-planes at several angles, discs, stripes, specks, all and nothing.
fn mask((width, height): (u32, u32), kind: u32) -> Mask {
    let values = (0..width * height).map(|i| {
        let (x, y) = ((i % width) as i32, (i / width) as i32);
        match kind {
            0 => 5 * x + 3 * y < 2 * width as i32 + 11,
            1 => (x - width as i32 / 2).pow(2) + (y - 20).pow(2) < 300,
            2 => x / 24 % 3 == 1,
            3 => random(i, 3).is_multiple_of(900),
            4 => true,
            5 => false,
            _ => y > height as i32 - 12 && x > 130,
        }
    });
    Raster::from_values(width, height, values.collect()).unwrap()
}

fn blackened(image: &ColorImage, mask: &Mask) -> ColorImage {
    let pixels = image.values().iter().zip(mask.values());
    let values = pixels.map(|(&color, &kept)| if kept { color } else { [0; 3] });
    Raster::from_values(image.width(), image.height(), values.collect()).unwrap()
}

#[test]
fn with_a_mask_the_rest_is_black() {
    for size in SIZES {
        for kind in 0..7 {
            let (image, mask) = (picture(size, kind), mask(size, kind));
            for options in all_options(&[95]) {
                let found = encode(&image, Some(&mask), options).unwrap();
                let expected = encode(&blackened(&image, &mask), None, options).unwrap();
                assert!(found == expected, "{size:?} {kind} {options:?}");
            }
        }
    }
    let other = mask((3, 4), 4);
    assert!(encode(&picture((4, 3), 1), Some(&other), JpegOptions::default()).is_err());
}

/// The largest value outside the mask in the decoded whole.
fn brightest(image: &ColorImage, mask: &Mask, options: JpegOptions) -> Option<u8> {
    let decoded = read_color(&encode(image, Some(mask), options).unwrap()).unwrap();
    let pixels = decoded.values().iter().zip(mask.values());
    let outside = pixels.filter(|(_, inside)| !**inside);
    outside.flat_map(|(pixel, _)| *pixel).max()
}

#[test]
fn the_background_comes_back_as_foretold() {
    let mut seen = [0; 256];
    for size in [(40, 40), (300, 37), (523, 90), (600, 111), (1100, 64)] {
        for kind in 0..7 {
            for shape in 0..7 {
                let (image, mask) = (picture(size, kind), mask(size, shape));
                for options in all_options(&[5, 60, 95, 98]) {
                    let stays = |limit| stays_dark(&image, &mask, options, limit).unwrap();
                    let context = format!("{size:?} {kind} {shape} {options:?}");
                    match brightest(&image, &mask, options) {
                        None => assert!(stays(0), "{context}"),
                        Some(level) => {
                            seen[usize::from(level)] += 1;
                            assert!(stays(level), "{context}: at most {level}");
                            assert!(
                                level == 0 || !stays(level - 1),
                                "{context}: {level} is there"
                            );
                        }
                    }
                }
            }
        }
    }
    assert!(
        seen[..40].iter().filter(|&&count| count > 0).count() > 20,
        "{seen:?}"
    );
}

#[test]
fn a_side_that_no_jpeg_has_is_refused() {
    let image = ColorImage::filled(65_536, 1, [1; 3]).unwrap();
    let error = encode(&image, None, JpegOptions::default()).unwrap_err();
    assert!(error.to_string().contains("65536 x 1"), "{error}");
}
