//! From a render to a photograph: light, a backdrop and a camera's response, all known.

use super::texture::to_byte;
use glam::{DVec2, DVec3};
use libm::{cos, exp, sin};
use std::f64::consts::{PI, TAU};

/// The largest value of [`lighting`] times [`TINT`].
const BRIGHTEST: f64 = 1.3 * 1.05;
/// The colour of the light.
const TINT: [f64; 3] = [1.05, 1.0, 0.93];

/// How strongly view number `index` is lit at `place` (image coordinates from 0 to 1, (0, 0) the
/// top-left corner): 0.7 to 1.3, less than one wave over the image.
pub fn lighting(index: usize, place: DVec2) -> f64 {
    #[allow(clippy::cast_precision_loss, reason = "view indices are small")]
    let phase = TAU * (index as f64 * 0.381_966).fract();
    let across = 0.18 * sin(PI * place.x + phase);
    let down = 0.12 * cos(1.3 * PI * place.y - 0.7 * phase);
    1.0 + across + down
}

/// What the camera makes of an exposure: smooth, rising, 0 to 0 and the brightest light to 1.
pub fn camera_response(exposure: f64) -> f64 {
    let knee = 2.0;
    exposure * (BRIGHTEST + knee) / (BRIGHTEST * (exposure + knee))
}

/// A lit pixel as the camera records it; `light` from [`lighting`].
pub(super) fn photographed(rendered: [u8; 3], light: f64) -> [f64; 3] {
    std::array::from_fn(|channel| {
        camera_response(f64::from(rendered[channel]) / 255.0 * light * TINT[channel])
    })
}

/// What is seen where there is no surface, by the direction of sight: sky that brightens towards
/// the horizon, and haze below it.
pub(super) fn backdrop(direction: DVec3) -> [f64; 3] {
    let (zenith, horizon, below) = ([0.33, 0.52, 0.80], [0.88, 0.90, 0.90], [0.42, 0.40, 0.37]);
    let height = direction.normalize_or_zero().z;
    let away = 1.0 - exp(-4.0 * height.abs());
    let far = if height > 0.0 { zenith } else { below };
    std::array::from_fn(|channel| horizon[channel] + away * (far[channel] - horizon[channel]))
}

/// Recorded surface over backdrop, the surface already weighted by its share of the pixel.
pub(super) fn composed(surface: [f64; 3], backdrop: [f64; 3], share: f64) -> [u8; 3] {
    std::array::from_fn(|channel| to_byte(surface[channel] + (1.0 - share) * backdrop[channel]))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn response_rises_from_black_to_white() {
        assert_eq!(camera_response(0.0), 0.0);
        assert!((camera_response(BRIGHTEST) - 1.0).abs() < 1e-12);
        let values: Vec<f64> = (0..=100)
            .map(|step| camera_response(f64::from(step) * 0.013))
            .collect();
        assert!(values.windows(2).all(|pair| pair[0] < pair[1]));
    }

    #[test]
    fn light_is_smooth_and_differs_between_views() {
        for index in 0..12 {
            for step in 0..100 {
                let place = DVec2::new(f64::from(step) / 100.0, 1.0 - f64::from(step) / 100.0);
                let light = lighting(index, place);
                let next = lighting(index, place + DVec2::splat(0.01));
                assert!((0.7..=1.3).contains(&light));
                assert!((light - next).abs() < 0.011 + 1e-3);
            }
        }
        let center = DVec2::splat(0.5);
        assert!((lighting(0, center) - lighting(1, center)).abs() > 0.05);
    }
}
