//! Values between pixel centres.

use glam::DVec2;
use mvs_datasets::scene::{ColorImage, DepthMap};

/// Bilinear depth at continuous coordinates as OpenCV's `remap` with a border of zeros gives it:
/// pixels without depth and beyond the map count as 0. 0 where no tap lies in the map.
pub fn plain(map: &DepthMap, pixel: DVec2) -> f64 {
    let (width, height) = (f64::from(map.width()), f64::from(map.height()));
    let at = pixel - 0.5;
    let inside = at.x > -1.0 && at.y > -1.0 && at.x < width && at.y < height;
    if !inside {
        return 0.0;
    }
    let (column, row) = (at.x.floor(), at.y.floor());
    let (fx, fy) = (at.x - column, at.y - row);
    #[allow(
        clippy::cast_possible_truncation,
        reason = "whole numbers between -1 and the size of a map"
    )]
    let (column, row) = (column as i64, row as i64);
    let tap = |dx: i64, dy: i64| depth_or_zero(map, column + dx, row + dy);
    let top = tap(0, 0) * (1.0 - fx) + tap(1, 0) * fx;
    let bottom = tap(0, 1) * (1.0 - fx) + tap(1, 1) * fx;
    top * (1.0 - fy) + bottom * fy
}

fn depth_or_zero(map: &DepthMap, column: i64, row: i64) -> f64 {
    match (u32::try_from(column), u32::try_from(row)) {
        (Ok(column), Ok(row)) if column < map.width() && row < map.height() => {
            f64::from(map.get(column, row))
        }
        _ => 0.0,
    }
}

/// Bilinear colour at continuous coordinates; beyond the outermost pixel centres that of the
/// nearest border.
pub fn color(image: &ColorImage, pixel: DVec2) -> [u8; 3] {
    let (x0, x1, fx) = taps(pixel.x, image.width());
    let (y0, y1, fy) = taps(pixel.y, image.height());
    if (fx, fy) == (0.0, 0.0) {
        return image.get(x0, y0);
    }
    let [a, b, c, d] = [
        image.get(x0, y0),
        image.get(x1, y0),
        image.get(x0, y1),
        image.get(x1, y1),
    ];
    std::array::from_fn(|channel| {
        let value = |tap: [u8; 3]| f64::from(tap[channel]);
        let top = value(a) * (1.0 - fx) + value(b) * fx;
        let bottom = value(c) * (1.0 - fx) + value(d) * fx;
        to_byte(top * (1.0 - fy) + bottom * fy)
    })
}

/// The two pixels around `at` on an axis of `size` pixels, and the weight of the second.
#[allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "clamped to the axis first"
)]
fn taps(at: f64, size: u32) -> (u32, u32, f64) {
    let last = f64::from(size - 1);
    let at = (at - 0.5).clamp(0.0, last);
    let first = at.floor();
    (first as u32, (first + 1.0).min(last) as u32, at - first)
}

#[allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "`as` saturates, and the value is a mean of bytes"
)]
pub(crate) fn to_byte(value: f64) -> u8 {
    (value + 0.5) as u8
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_linear_ramp_is_sampled_exactly_and_fades_beyond_the_outer_centres() {
        let values = (0..12).map(|i| (10 + 2 * (i % 4) + 3 * (i / 4)) as f32);
        let (map, _) = DepthMap::from_values(4, 3, values.collect()).unwrap();
        let ramp = |x: f64, y: f64| 10.0 + 2.0 * (x - 0.5) + 3.0 * (y - 0.5);
        for (x, y) in [(0.5, 0.5), (3.5, 2.5), (1.75, 2.125), (3.25, 0.5)] {
            assert!((plain(&map, DVec2::new(x, y)) - ramp(x, y)).abs() < 1e-12);
        }
        assert!((plain(&map, DVec2::new(0.0, 0.5)) - 5.0).abs() < 1e-12);
        for (x, y) in [(-0.5, 1.0), (4.5, 1.0), (1.0, 3.5), (f64::NAN, 1.0)] {
            assert_eq!(plain(&map, DVec2::new(x, y)), 0.0);
        }
    }

    #[test]
    fn colours_are_bilinear_and_clamped() {
        let image = ColorImage::from_values(2, 1, vec![[0, 10, 255], [100, 20, 255]]).unwrap();
        assert_eq!(color(&image, DVec2::new(1.0, 0.5)), [50, 15, 255]);
        assert_eq!(color(&image, DVec2::new(0.5, 0.5)), [0, 10, 255]);
        assert_eq!(color(&image, DVec2::new(-7.0, 9.0)), [0, 10, 255]);
        assert_eq!(color(&image, DVec2::new(7.0, 9.0)), [100, 20, 255]);
    }
}
