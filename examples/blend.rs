//! Times the blend of two made-up images of 2048 x 1536; one line of JSON.
//!
//! usage: `cargo run --release --example blend -- [REPEATS]`, with `RAYON_NUM_THREADS=1` for one thread.
//! `benches/blend.py` runs this beside scipy.

use mvs_datasets::scene::{ColorImage, Raster};
use mvs_eval::blend::{BlendMode, BlendOptions, Blender};
use std::time::Instant;

const SIZE: (u32, u32) = (2048, 1536);

/// As `image` of `tests/reference/blend_numpy.py`.
fn image(seed: u64) -> Option<ColorImage> {
    let value = |i: u32| {
        let (x, y) = (u64::from(i % SIZE.0), u64::from(i / SIZE.0));
        let noise = ((u64::from(i) * 2_654_435_761 + seed * 40503) % (1 << 32)) >> 13;
        let wave = ((3 + seed) * x + 5 * y) % 256;
        let wave = if wave < 128 { wave } else { 255 - wave };
        [(wave + noise % 128) as u8; 3]
    };
    Raster::from_values(SIZE.0, SIZE.1, (0..SIZE.0 * SIZE.1).map(value).collect()).ok()
}

fn median(mut seconds: Vec<f64>) -> f64 {
    seconds.sort_by(f64::total_cmp);
    seconds[seconds.len() / 2]
}

#[allow(clippy::print_stdout, reason = "the answer")]
fn main() {
    let repeats = std::env::args().nth(1).and_then(|text| text.parse().ok());
    let (Some(rendered), Some(photograph)) = (image(1), image(2)) else {
        return;
    };
    // An ellipse of surface, as the peer's.
    let (w, h) = (i64::from(SIZE.0), i64::from(SIZE.1));
    let inside = |i: i64| {
        let (x, y) = (2 * (i % w) - w, 2 * (i / w) - h);
        x * x * h * h + y * y * w * w <= w * w * h * h
    };
    let mask = Raster::from_values(SIZE.0, SIZE.1, (0..w * h).map(inside).collect());
    let Ok(mask) = mask else { return };
    for (name, mode) in [
        ("reference", BlendMode::Reference),
        ("composite", BlendMode::Composite),
        ("normalized", BlendMode::Normalized),
    ] {
        let options = BlendOptions {
            mode,
            ..BlendOptions::default()
        };
        let Ok(blender) = Blender::new(SIZE, &options) else {
            return;
        };
        let time = |_| {
            let start = Instant::now();
            let blended = blender.blend(&rendered, &photograph, &mask);
            blended.is_ok().then(|| start.elapsed().as_secs_f64())
        };
        let seconds: Vec<f64> = (0..repeats.unwrap_or(5)).filter_map(time).collect();
        let unrounded = blender.blend_unrounded(&rendered, &photograph, &mask);
        let values: Vec<f32> = unrounded.map_or(Vec::new(), |image| {
            let picked = image.values().iter().step_by(9973);
            picked.map(|pixel| pixel[0]).collect()
        });
        println!(
            "{{\"mode\": \"{name}\", \"seconds\": {}, \"values\": {values:?}}}",
            median(seconds)
        );
    }
}
