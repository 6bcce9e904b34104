//! Textures drawn by formula: strong at all frequencies, so that matching, blending and rendering
//! have something to see.

use crate::scene::{ColorImage, Raster};
use glam::DVec2;

/// Colours of a texture, 0 to 1.
#[derive(Debug, Clone, Copy)]
pub(super) struct Palette {
    pub(super) dark: [f64; 3],
    pub(super) light: [f64; 3],
    pub(super) accent: [f64; 3],
}

/// A texture of noise at all octaves, crossed by lines, `cells` coarse cells wide and high; it
/// closes on itself from left to right. `size` values are ≥ 1.
pub(super) fn draw(
    mut canvas: ColorImage,
    cells: (u32, u32),
    palette: &Palette,
    seed: u32,
) -> ColorImage {
    let (width, height) = canvas.size();
    for row in 0..height {
        for column in 0..width {
            let uv = DVec2::new(
                (f64::from(column) + 0.5) / f64::from(width),
                (f64::from(row) + 0.5) / f64::from(height),
            );
            canvas.set(column, row, color(uv, cells, palette, seed));
        }
    }
    canvas
}

/// The texel that holds the texture coordinates, (0, 0) bottom left.
pub(super) fn lookup(texture: &ColorImage, uv: DVec2) -> [u8; 3] {
    let texel = |share: f64, size: u32| {
        #[allow(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "clamped to the texture; the cast saturates"
        )]
        let index = (share * f64::from(size)).max(0.0) as u32;
        index.min(size - 1)
    };
    texture.get(
        texel(uv.x, texture.width()),
        texel(1.0 - uv.y, texture.height()),
    )
}

fn color(uv: DVec2, cells: (u32, u32), palette: &Palette, seed: u32) -> [u8; 3] {
    let detail = octaves(uv, cells, 6, 0.8, seed);
    let tint = octaves(uv, cells, 2, 0.5, seed ^ 0x5bd1_e995);
    let contrast = (0.5 + 2.2 * (detail - 0.5)).clamp(0.0, 1.0);
    let accent = ((tint - 0.55) * 6.0).clamp(0.0, 0.85);
    let shade = 1.0 - 0.45 * lines(uv, cells);
    std::array::from_fn(|channel| {
        let base =
            palette.dark[channel] + contrast * (palette.light[channel] - palette.dark[channel]);
        let tinted = base + accent * (palette.accent[channel] * (0.4 + 0.6 * contrast) - base);
        to_byte(shade * tinted)
    })
}

/// 1 on thin lines along the coarse cells, 0 elsewhere, with soft edges.
fn lines(uv: DVec2, cells: (u32, u32)) -> f64 {
    let near = |share: f64, count: u32| {
        let within = (share * f64::from(count)).fract();
        within.min(1.0 - within)
    };
    let nearest = near(uv.x, cells.0).min(near(uv.y, cells.1));
    1.0 - ((nearest - 0.025) / 0.02).clamp(0.0, 1.0)
}

/// Value noise summed over octaves, each twice as fine and `gain` as strong; 0 to 1, mean ½.
fn octaves(uv: DVec2, cells: (u32, u32), count: u32, gain: f64, seed: u32) -> f64 {
    let (mut sum, mut total, mut weight) = (0.0, 0.0, 1.0);
    for octave in 0..count {
        let lattice = (cells.0 << octave, cells.1 << octave);
        sum += weight * value_noise(uv, lattice, seed.wrapping_add(octave));
        total += weight;
        weight *= gain;
    }
    sum / total
}

/// Random values on a lattice of `cells`, smoothly interpolated.
fn value_noise(uv: DVec2, cells: (u32, u32), seed: u32) -> f64 {
    let (left, x) = split(uv.x, cells.0);
    let (top, y) = split(uv.y, cells.1);
    let value = |column: u32, row: u32| unit(column % cells.0, row, seed);
    let upper = mix(value(left, top), value(left + 1, top), smooth(x));
    let lower = mix(value(left, top + 1), value(left + 1, top + 1), smooth(x));
    mix(upper, lower, smooth(y))
}

fn split(share: f64, count: u32) -> (u32, f64) {
    let position = share * f64::from(count);
    #[allow(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "position is 0 to count"
    )]
    let cell = position as u32;
    (cell, position - f64::from(cell))
}

fn smooth(t: f64) -> f64 {
    t * t * (3.0 - 2.0 * t)
}

fn mix(a: f64, b: f64, t: f64) -> f64 {
    a + t * (b - a)
}

/// A hash of a lattice point, 0 to 1.
fn unit(column: u32, row: u32, seed: u32) -> f64 {
    let mut bits = column ^ row.rotate_left(16) ^ seed.wrapping_mul(0x9e37_79b9);
    for factor in [0x7feb_352d_u32, 0x846c_a68b] {
        bits = (bits ^ (bits >> 16)).wrapping_mul(factor);
    }
    f64::from(bits ^ (bits >> 16)) / f64::from(u32::MAX)
}

/// 0 to 1 as a byte, rounded.
pub(super) fn to_byte(value: f64) -> u8 {
    #[allow(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "clamped to 0 to 255"
    )]
    let byte = (255.0 * value).round().clamp(0.0, 255.0) as u8;
    byte
}

/// A black canvas. Sizes are ≥ 1.
pub(super) fn canvas(width: u32, height: u32) -> crate::error::Result<ColorImage> {
    Raster::filled(width, height, [0; 3])
}

#[cfg(test)]
mod tests {
    use super::*;

    const PALETTE: Palette = Palette {
        dark: [0.1, 0.1, 0.1],
        light: [0.9, 0.8, 0.7],
        accent: [0.9, 0.2, 0.1],
    };

    fn texture() -> ColorImage {
        draw(canvas(256, 256).unwrap(), (4, 4), &PALETTE, 3)
    }

    /// Mean absolute difference of the green channel between pixels `step` columns apart.
    fn variation(image: &ColorImage, step: u32) -> f64 {
        let (width, height) = image.size();
        let mut sum = 0.0;
        for row in 0..height {
            for column in 0..width {
                let other = image.get((column + step) % width, row)[1];
                sum += f64::from(image.get(column, row)[1].abs_diff(other));
            }
        }
        sum / f64::from(width * height)
    }

    #[test]
    fn there_is_contrast_at_fine_and_coarse_scales() {
        let image = texture();
        assert!(variation(&image, 1) > 5.0, "{}", variation(&image, 1));
        assert!(variation(&image, 64) > 25.0, "{}", variation(&image, 64));
    }

    #[test]
    fn left_and_right_meet() {
        let image = texture();
        let seam = |a: u32, b: u32| {
            let row = |row: u32| f64::from(image.get(a, row)[1].abs_diff(image.get(b, row)[1]));
            (0..256).map(row).sum::<f64>() / 256.0
        };
        assert!(seam(255, 0) < 3.0 * seam(100, 101) + 1.0);
    }

    #[test]
    fn lookup_counts_rows_from_the_bottom() {
        let image = texture();
        assert_eq!(lookup(&image, DVec2::new(0.0, 0.0)), image.get(0, 255));
        assert_eq!(lookup(&image, DVec2::new(1.0, 1.0)), image.get(255, 0));
        assert_eq!(lookup(&image, DVec2::new(0.5, 0.999)), image.get(128, 0));
    }
}
