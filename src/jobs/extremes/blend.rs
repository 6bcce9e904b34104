//! Blended images whose result is known: a rendering blended with itself, and with itself under an even
//! light. Coordinates, scales and depths do not reach the blend.

use super::{ExtremesJob, Rows};
use crate::blend::{BlendMode, BlendOptions, blend};
use crate::error::Result;
use mvs_datasets::scene::{ColorImage, Raster};

const NORMALIZED: &str = "grey levels off, largest, normalized";

pub(super) fn measure(job: &ExtremesJob, rows: &mut Rows<'_>) -> Result<()> {
    // Powers of two, primes and images of hardly a pixel.
    let sizes = [
        (1, 1),
        (2, 1),
        (7, 5),
        (64, 48),
        (251, 127),
        (640, 480),
        (1021, 769),
    ];
    for size in sizes.into_iter().filter(|size| size.0 <= job.width) {
        let image = pattern(size)?;
        let step = ("image-size", f64::from(size.0));
        for (quantity, mode) in [
            ("grey levels off, largest, reference", BlendMode::Reference),
            ("grey levels off, largest, composite", BlendMode::Composite),
            (NORMALIZED, BlendMode::Normalized),
        ] {
            let off = largest_difference(&blended(&image, &image, mode)?, &image);
            rows.put(step, "ours", (quantity, off), Some(0.0))?;
        }
    }
    let image = pattern((160, 120))?;
    for light in [1u8, 10, 100] {
        let lit = image.map(|pixel| pixel.map(|value| value + light));
        let found = blended(&image, &lit, BlendMode::Normalized)?;
        let off = largest_difference(&found, &lit);
        let step = ("light", f64::from(light));
        rows.put(step, "ours", (NORMALIZED, off), Some(0.0))?;
    }
    Ok(())
}

fn blended(rendered: &ColorImage, photograph: &ColorImage, mode: BlendMode) -> Result<ColorImage> {
    let (width, height) = rendered.size();
    let mask = Raster::filled(width, height, true)?;
    let options = BlendOptions {
        mode,
        ..BlendOptions::default()
    };
    blend(rendered, photograph, &mask, &options)
}

/// Values from 0 to 150 with every frequency in them.
fn pattern((width, height): (u32, u32)) -> Result<ColorImage> {
    let value = |index: u32| {
        let mixed = index.wrapping_mul(0x9e37_79b9) ^ (index >> 3).wrapping_mul(0x85eb_ca6b);
        [0, 8, 16].map(|shift| ((mixed >> shift) & 0xff) as u8 % 151)
    };
    let values = (0..width * height).map(value).collect();
    Ok(Raster::from_values(width, height, values)?)
}

fn largest_difference(a: &ColorImage, b: &ColorImage) -> f64 {
    let pairs = a
        .values()
        .as_flattened()
        .iter()
        .zip(b.values().as_flattened());
    pairs
        .map(|(&a, &b)| f64::from(a.abs_diff(b)))
        .fold(0.0, f64::max)
}
