//! Images at another size: Lanczos with three lobes, the kernel stretched when shrinking, as
//! Pillow's `LANCZOS`. Pixel centres lie at (0.5, 0.5), so that resizing is exact scaling.

use crate::error::Result;
use crate::parallel;
use mvs_datasets::scene::{ColorImage, Raster};

pub(super) const LOBES: f64 = 3.0;

/// The image resized to `size` (width, height), both ≥ 1.
///
/// # Errors
/// A `size` without pixels.
pub fn resized(image: &ColorImage, size: (u32, u32)) -> Result<ColorImage> {
    if image.size() == size {
        return Ok(image.clone());
    }
    let columns = Taps::new(image.width(), size.0);
    let rows = Taps::new(image.height(), size.1);
    let width = size.0 as usize;
    let mut narrow = Raster::filled(size.0, image.height(), [0.0f32; 3])?;
    parallel::for_each_chunk(narrow.values_mut(), width, |row, out| {
        let start = row * image.width() as usize;
        let source = &image.values()[start..start + image.width() as usize];
        for (column, pixel) in out.iter_mut().enumerate() {
            let (first, weights) = columns.of(column);
            for (value, weight) in source[first..].iter().zip(weights) {
                for channel in 0..3 {
                    pixel[channel] += weight * f32::from(value[channel]);
                }
            }
        }
    });
    let mut result = Raster::filled(size.0, size.1, [0u8; 3])?;
    parallel::for_each_chunk(result.values_mut(), width, |row, out| {
        let (first, weights) = rows.of(row);
        let mut sums = vec![[0.0f32; 3]; width];
        for (source, weight) in narrow.values()[first * width..].chunks(width).zip(weights) {
            for (sum, value) in sums.iter_mut().zip(source) {
                for channel in 0..3 {
                    sum[channel] += weight * value[channel];
                }
            }
        }
        for (pixel, sum) in out.iter_mut().zip(&sums) {
            *pixel = sum.map(to_level);
        }
    });
    Ok(result)
}

/// The window of `size` whose top-left pixel is `offset`, both inside the image.
pub(super) fn cropped(
    image: &ColorImage,
    offset: (u32, u32),
    size: (u32, u32),
) -> Result<ColorImage> {
    let rows = (offset.1..offset.1 + size.1)
        .flat_map(|row| (offset.0..offset.0 + size.0).map(move |column| image.get(column, row)));
    Ok(Raster::from_values(size.0, size.1, rows.collect())?)
}

/// Which source pixels each target pixel is made of, along one axis.
struct Taps {
    first: Vec<usize>,
    weights: Vec<Vec<f32>>,
}

impl Taps {
    fn new(source: u32, target: u32) -> Self {
        let scale = f64::from(source) / f64::from(target);
        let stretch = scale.max(1.0);
        let reach = LOBES * stretch;
        let mut taps = Self {
            first: Vec::with_capacity(target as usize),
            weights: Vec::with_capacity(target as usize),
        };
        for index in 0..target {
            let centre = (f64::from(index) + 0.5) * scale;
            let first = (centre - reach).floor().max(0.0) as u32;
            let last = ((centre + reach).ceil() as u32).min(source);
            let raw: Vec<f64> = (first..last)
                .map(|i| lanczos((f64::from(i) + 0.5 - centre) / stretch))
                .collect();
            let sum: f64 = raw.iter().sum();
            taps.first.push(first as usize);
            taps.weights
                .push(raw.iter().map(|w| (w / sum) as f32).collect());
        }
        taps
    }

    fn of(&self, index: usize) -> (usize, &[f32]) {
        (self.first[index], &self.weights[index])
    }
}

/// sinc(x) · sinc(x / 3) inside three lobes.
pub(super) fn lanczos(x: f64) -> f64 {
    if x.abs() >= LOBES {
        return 0.0;
    }
    sinc(x) * sinc(x / LOBES)
}

fn sinc(x: f64) -> f64 {
    let angle = std::f64::consts::PI * x;
    if angle.abs() < 1e-9 {
        1.0
    } else {
        libm::sin(angle) / angle
    }
}

#[allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "clamped to 0 … 255 before the cast"
)]
pub(super) fn to_level(value: f32) -> u8 {
    value.round().clamp(0.0, 255.0) as u8
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ramp(width: u32, height: u32) -> ColorImage {
        let value = |i: u32| [(i % width * 4) as u8, (i / width * 5) as u8, 77];
        Raster::from_values(width, height, (0..width * height).map(value).collect()).unwrap()
    }

    #[test]
    fn a_linear_ramp_stays_where_it_is_in_continuous_coordinates() {
        let image = ramp(60, 45);
        for size in [(30, 15), (120, 135), (40, 60)] {
            let small = resized(&image, size).unwrap();
            let (sx, sy) = (60.0 / f64::from(size.0), 45.0 / f64::from(size.1));
            for (column, row) in [(size.0 / 2, size.1 / 2), (size.0 / 3, size.1 / 3)] {
                let [red, green, blue] = small.get(column, row);
                // The ramp's value at continuous x is 4 · (x − 0.5).
                let expected = 4.0 * ((f64::from(column) + 0.5) * sx - 0.5);
                assert!((f64::from(red) - expected).abs() <= 0.75, "{size:?}");
                let expected = 5.0 * ((f64::from(row) + 0.5) * sy - 0.5);
                assert!((f64::from(green) - expected).abs() <= 0.75, "{size:?}");
                assert_eq!(blue, 77);
            }
        }
    }

    #[test]
    fn the_same_size_is_the_same_image_and_windows_are_cut_where_asked() {
        let image = ramp(20, 10);
        assert_eq!(resized(&image, (20, 10)).unwrap(), image);
        let window = cropped(&image, (3, 2), (5, 4)).unwrap();
        assert_eq!(window.get(0, 0), image.get(3, 2));
        assert_eq!(window.get(4, 3), image.get(7, 5));
    }
}
