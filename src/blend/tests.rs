//! The blend against the paper's formula by plain sums, its identities, and flat light.

use super::*;
use crate::parallel;
use mvs_datasets::scene::Raster;
use std::f64::consts::TAU;

fn image(width: u32, height: u32, seed: u32) -> ColorImage {
    let mut state = seed;
    let mut next = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 24) as u8
    };
    let values = (0..width * height)
        .map(|_| [next(), next(), next()])
        .collect();
    Raster::from_values(width, height, values).unwrap()
}

fn disc(width: u32, height: u32) -> Mask {
    let (cx, cy) = (f64::from(width) / 2.0, f64::from(height) / 2.0);
    let inside = |i: u32| {
        let (x, y) = (f64::from(i % width) + 0.5, f64::from(i / width) + 0.5);
        ((x - cx) / cx).powi(2) + ((y - cy) / cy).powi(2) < 0.5
    };
    Raster::from_values(width, height, (0..width * height).map(inside).collect()).unwrap()
}

fn full(width: u32, height: u32) -> Mask {
    Raster::filled(width, height, true).unwrap()
}

fn options(mode: BlendMode, d0: f64) -> BlendOptions {
    BlendOptions {
        mode,
        d0,
        ..Default::default()
    }
}

const MODES: [BlendMode; 3] = [
    BlendMode::Reference,
    BlendMode::Composite,
    BlendMode::Normalized,
];

/// The two-transform formula for one channel, by the DFT's defining sums.
fn two_transforms(rendered: &[f64], photograph: &[f64], size: (usize, usize), d0: f64) -> Vec<f64> {
    let (width, height) = size;
    let bin = |u: usize, n: usize| {
        if 2 * u > n {
            u as f64 - n as f64
        } else {
            u as f64
        }
    };
    let mut blended = vec![0.0; width * height];
    for v in 0..height {
        for u in 0..width {
            let low = (-(bin(u, width).powi(2) + bin(v, height).powi(2)) / (2.0 * d0)).exp();
            let angle = |x: usize, y: usize| {
                TAU * ((u * x) as f64 / width as f64 + (v * y) as f64 / height as f64)
            };
            let (mut re, mut im) = (0.0, 0.0);
            for i in 0..width * height {
                let value = (1.0 - low) * rendered[i] + low * photograph[i];
                let phase = angle(i % width, i / width);
                re += value * phase.cos();
                im -= value * phase.sin();
            }
            for (i, out) in blended.iter_mut().enumerate() {
                let phase = angle(i % width, i / width);
                *out += (re * phase.cos() - im * phase.sin()) / (width * height) as f64;
            }
        }
    }
    blended
}

#[test]
fn reference_is_the_two_transform_formula() {
    for (width, height) in [(1, 1), (7, 5), (12, 9), (13, 11), (16, 16), (3, 29)] {
        let (rendered, photograph) = (image(width, height, 1), image(width, height, 2));
        let mask = disc(width, height);
        let shown = masked(&rendered, &mask).unwrap();
        for d0 in [0.5, 6.0, 5000.0] {
            let found = Blender::new((width, height), &options(BlendMode::Reference, d0))
                .unwrap()
                .blend_unrounded(&rendered, &photograph, &mask)
                .unwrap();
            for channel in 0..3 {
                let plane = |image: &ColorImage| -> Vec<f64> {
                    let value = |pixel: &[u8; 3]| f64::from(pixel[channel]);
                    image.values().iter().map(value).collect()
                };
                let size = (width as usize, height as usize);
                let expected = two_transforms(&plane(&shown), &plane(&photograph), size, d0);
                for (f, e) in found.values().iter().zip(expected) {
                    assert!(
                        (f64::from(f[channel]) - e).abs() < 2e-4,
                        "{width}x{height} {d0}"
                    );
                }
            }
        }
    }
}

/// `normalized` by its definition: normalised sums over the mirrored plane with a sampled kernel.
#[test]
fn normalized_is_the_quotient_of_two_gaussian_sums() {
    let (width, height) = (61u32, 47u32);
    let sigma = 2.5;
    let (rendered, photograph) = (image(width, height, 3), image(width, height, 4));
    // Touches all borders of the image, and has a slanting edge.
    let values = (0..width * height).map(|i| i % width + 2 * (i / width) > 30);
    let mask = Raster::from_values(width, height, values.collect()).unwrap();
    for far in [1e165, 1e-165] {
        let options = BlendOptions {
            sigma: Some(far),
            ..BlendOptions::default()
        };
        let error = Blender::new((width, height), &options).map(|_| "made");
        let error = error.unwrap_err().to_string();
        assert!(error.contains("1e-150 … 1e150"), "{error}");
    }
    let by_sigma = BlendOptions {
        sigma: Some(sigma),
        ..Default::default()
    };
    let found = Blender::new((width, height), &by_sigma)
        .unwrap()
        .blend_unrounded(&rendered, &photograph, &mask)
        .unwrap();
    let mirror = |i: i64, n: u32| {
        let n = i64::from(n);
        let i = i.rem_euclid(2 * n);
        (if i < n { i } else { 2 * n - 1 - i }) as u32
    };
    for (column, row) in [(30, 23), (31, 0), (60, 46), (0, 16), (20, 6)] {
        assert!(mask.get(column, row));
        let (mut sum, mut weight) = (0.0, 0.0);
        for dy in -20i64..=20 {
            for dx in -20i64..=20 {
                let (x, y) = (i64::from(column) + dx, i64::from(row) + dy);
                let (c, r) = (mirror(x, width), mirror(y, height));
                if mask.get(c, r) {
                    let w = (-((dx * dx + dy * dy) as f64) / (2.0 * sigma * sigma)).exp();
                    let difference =
                        f64::from(photograph.get(c, r)[1]) - f64::from(rendered.get(c, r)[1]);
                    sum += w * difference;
                    weight += w;
                }
            }
        }
        let expected = f64::from(rendered.get(column, row)[1]) + sum / weight;
        let value = f64::from(found.get(column, row)[1]);
        assert!((value - expected).abs() < 5e-3, "{value} {expected}");
    }
}

#[test]
fn a_photograph_equal_to_its_rendering_stays_as_it_is() {
    for (width, height) in [(1, 1), (17, 23), (64, 48)] {
        let photograph = image(width, height, 5);
        for mode in MODES {
            let mask = full(width, height);
            let blended = blend(&photograph, &photograph, &mask, &options(mode, 5000.0)).unwrap();
            assert_eq!(blended, photograph);
        }
    }
}

#[test]
fn a_filter_that_passes_all_gives_the_photograph_and_one_that_passes_nothing_its_mean() {
    let (width, height) = (40, 30);
    let (rendered, photograph) = (image(width, height, 6), image(width, height, 7));
    let mean = |image: &ColorImage| -> f64 {
        let sum: f64 = image.values().iter().map(|p| f64::from(p[0])).sum();
        sum / f64::from(width * height)
    };
    let offset = mean(&photograph) - mean(&rendered);
    for mode in MODES {
        let mask = full(width, height);
        let all = blend(&rendered, &photograph, &mask, &options(mode, 1e12)).unwrap();
        assert_eq!(all, photograph, "{mode:?}");
        let none = Blender::new((width, height), &options(mode, 1e-3))
            .unwrap()
            .blend_unrounded(&rendered, &photograph, &mask)
            .unwrap();
        for (found, before) in none.values().iter().zip(rendered.values()) {
            let expected = f64::from(before[0]) + offset;
            assert!((f64::from(found[0]) - expected).abs() < 1e-3, "{mode:?}");
        }
    }
}

/// A constant lighting offset on a bright background: flat to 0.1 grey levels at the mask's edge
/// and at image borders, where the paper's formula shows its halo and its wrap-around.
#[test]
fn constant_light_is_flat_up_to_every_edge() {
    let (width, height) = (320u32, 240u32);
    let mask = Raster::from_values(
        width,
        height,
        (0..width * height)
            .map(|i| i % width < 100 || i / width > 200)
            .collect(),
    )
    .unwrap();
    let rendered = masked(
        &Raster::filled(width, height, [80, 90, 100]).unwrap(),
        &mask,
    )
    .unwrap();
    let photograph = mask.map(|&inside| if inside { [95, 80, 110] } else { [250; 3] });
    let worst = |mode| {
        let found = Blender::new((width, height), &options(mode, 5000.0))
            .unwrap()
            .blend_unrounded(&rendered, &photograph, &mask)
            .unwrap();
        let off = |(f, e): (&[f32; 3], &[u8; 3])| {
            (0..3)
                .map(|c| (f[c] - f32::from(e[c])).abs())
                .fold(0.0, f32::max)
        };
        let inside = found
            .values()
            .iter()
            .zip(photograph.values())
            .zip(mask.values());
        inside
            .filter(|(_, m)| **m)
            .map(|(pair, _)| off(pair))
            .fold(0.0, f32::max)
    };
    assert!(
        worst(BlendMode::Normalized) < 0.1,
        "{}",
        worst(BlendMode::Normalized)
    );
    assert!(
        worst(BlendMode::Reference) > 50.0,
        "{}",
        worst(BlendMode::Reference)
    );
    assert!(
        worst(BlendMode::Composite) > 3.0,
        "{}",
        worst(BlendMode::Composite)
    );
}

#[test]
fn outside_the_mask_stands_the_photograph() {
    let (width, height) = (50, 38);
    let (rendered, photograph) = (image(width, height, 8), image(width, height, 9));
    let mask = disc(width, height);
    for mode in [BlendMode::Composite, BlendMode::Normalized] {
        let blended = blend(&rendered, &photograph, &mask, &options(mode, 5000.0)).unwrap();
        let pixels = blended.values().iter().zip(photograph.values());
        let outside = pixels.zip(mask.values()).filter(|(_, inside)| !**inside);
        assert!(outside.clone().count() > 100);
        outside.for_each(|((found, expected), _)| assert_eq!(found, expected));
    }
    let none = Raster::filled(width, height, false).unwrap();
    let blended = blend(&rendered, &photograph, &none, &BlendOptions::default()).unwrap();
    assert_eq!(blended, photograph);
}

#[test]
fn one_pixel_of_mask_under_a_wide_filter_takes_the_photograph() {
    let (width, height) = (400, 300);
    let (rendered, photograph) = (image(width, height, 8), image(width, height, 9));
    let mut mask = Raster::filled(width, height, false).unwrap();
    mask.set(200, 150, true);
    let blended = blend(
        &rendered,
        &photograph,
        &mask,
        &options(BlendMode::Normalized, 0.01),
    )
    .unwrap();
    assert_eq!(blended, photograph);
}

#[test]
fn linear_light_differs_and_keeps_the_identity() {
    let (width, height) = (64, 48);
    let (rendered, photograph) = (image(width, height, 10), image(width, height, 11));
    let linear = BlendOptions {
        linear_light: true,
        ..Default::default()
    };
    let mask = full(width, height);
    let same = blend(&photograph, &photograph, &mask, &linear).unwrap();
    assert_eq!(same, photograph);
    let blended = blend(&rendered, &photograph, &mask, &linear).unwrap();
    assert_ne!(
        blended,
        blend(&rendered, &photograph, &mask, &BlendOptions::default()).unwrap()
    );
}

#[test]
fn the_number_of_threads_changes_nothing() {
    let (width, height) = (203, 151);
    let (rendered, photograph) = (image(width, height, 12), image(width, height, 13));
    let mask = disc(width, height);
    let run = |threads| {
        let work = || {
            Blender::new((width, height), &BlendOptions::default())
                .unwrap()
                .blend_unrounded(&rendered, &photograph, &mask)
        };
        parallel::with_threads(threads, work).unwrap().unwrap()
    };
    assert_eq!(run(1), run(4));
}

#[test]
fn bad_input_is_named() {
    let (rendered, photograph) = (image(8, 6, 1), image(8, 7, 2));
    let message = |result: Result<ColorImage>| result.unwrap_err().to_string();
    let mask = full(8, 6);
    let size = message(blend(
        &rendered,
        &photograph,
        &mask,
        &BlendOptions::default(),
    ));
    assert!(
        size.contains("photograph") && size.contains("8 x 7"),
        "{size}"
    );
    let d0 = message(blend(
        &rendered,
        &rendered,
        &mask,
        &options(BlendMode::Reference, 0.0),
    ));
    assert!(d0.contains("d0"), "{d0}");
}

/// The image of `tests/reference/blend_numpy.py`.
fn numpy_image(width: u32, height: u32, seed: u64) -> ColorImage {
    let value = |i: u32| {
        let (x, y) = (u64::from(i % width), u64::from(i / width));
        let noise = ((u64::from(i) * 2_654_435_761 + seed * 40503) % (1 << 32)) >> 13;
        let wave = ((3 + seed) * x + 5 * y) % 256;
        let wave = if wave < 128 { wave } else { 255 - wave };
        [(wave + noise % 128) as u8; 3]
    };
    Raster::from_values(width, height, (0..width * height).map(value).collect()).unwrap()
}

#[derive(serde::Deserialize)]
struct Golden {
    width: u32,
    height: u32,
    d0: f64,
    step: usize,
    sum: f64,
    values: Vec<f64>,
}

#[test]
fn reference_is_numpy_s_two_transform_formula() {
    let text = include_str!("../../tests/reference/blend_numpy.json");
    let file: serde_json::Value = serde_json::from_str(text).unwrap();
    let cases: Vec<Golden> = serde_json::from_value(file["cases"].clone()).unwrap();
    assert_eq!(cases.len(), 12);
    for golden in cases {
        let (width, height) = (golden.width, golden.height);
        let (w, h) = (i64::from(width), i64::from(height));
        let inside = |i: i64| {
            let (x, y) = (2 * (i % w) - w, 2 * (i / w) - h);
            x * x * h * h + y * y * w * w <= w * w * h * h
        };
        let mask = Raster::from_values(width, height, (0..w * h).map(inside).collect()).unwrap();
        let found = Blender::new((width, height), &options(BlendMode::Reference, golden.d0))
            .unwrap()
            .blend_unrounded(
                &numpy_image(width, height, 1),
                &numpy_image(width, height, 2),
                &mask,
            )
            .unwrap();
        let picked = found.values().iter().step_by(golden.step);
        assert_eq!(picked.len(), golden.values.len());
        for (found, expected) in picked.zip(&golden.values) {
            let off = (f64::from(found[0]) - expected).abs();
            assert!(off < 1e-3, "{width}x{height} {}: {off}", golden.d0);
        }
        let sum: f64 = found.values().iter().map(|pixel| f64::from(pixel[2])).sum();
        let mean_off = (sum - golden.sum).abs() / f64::from(width * height);
        assert!(mean_off < 1e-4, "{width}x{height}: {mean_off}");
    }
}

#[test]
fn the_filter_is_as_wide_as_measured_on_the_published_images() {
    let (width, height) = (2048u32, 1536u32);
    let dark = Raster::filled(width, height, [0; 3]).unwrap();
    let mut photograph = dark.clone();
    photograph.set(1024, 768, [255; 3]);
    let mask = full(width, height);
    let found = Blender::new((width, height), &options(BlendMode::Reference, 5000.0))
        .unwrap()
        .blend_unrounded(&dark, &photograph, &mask)
        .unwrap();
    let (mut sum, mut along_x, mut along_y) = (0.0, 0.0, 0.0);
    for (i, pixel) in (0u32..).zip(found.values()) {
        let value = f64::from(pixel[1]);
        sum += value;
        along_x += value * (f64::from(i % width) - 1024.0).powi(2);
        along_y += value * (f64::from(i / width) - 768.0).powi(2);
    }
    let widths = ((along_x / sum).sqrt(), (along_y / sum).sqrt());
    assert!((sum - 255.0).abs() < 1e-3, "{sum}");
    // Predicted 4.61 x 3.46 px; the published set's median is 4.59 x 3.45.
    assert!((widths.0 - 2048.0 / 444.29).abs() < 2e-3, "{widths:?}");
    assert!((widths.1 - 1536.0 / 444.29).abs() < 2e-3, "{widths:?}");
}
