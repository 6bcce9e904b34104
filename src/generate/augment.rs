//! Augmentation of training images: brightness, contrast and motion blur in random order, as the
//! BlendedMVS training does.

use crate::error::Result;
use mvs_datasets::scene::{ColorImage, Raster};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};
use serde::{Deserialize, Serialize};

/// The direction of a motion blur.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum BlurDirection {
    /// Along rows.
    Horizontal,
    /// Along columns.
    Vertical,
    /// From the top left to the bottom right.
    DiagonalDown,
    /// From the bottom left to the top right.
    DiagonalUp,
}

/// One step of an augmentation, with what was drawn for it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Step {
    /// Adds this many grey levels to all channels.
    Brightness(f64),
    /// Multiplies each channel's difference from its mean.
    Contrast(f64),
    /// Averages three pixels in a direction; `None` leaves the image as it is.
    MotionBlur(Option<BlurDirection>),
}

/// Draws the three steps and their order for one view: brightness in [−50, 50), contrast in
/// [0.3, 1.5), a blur of size 1 or 3 with equal chance in one of four directions. The same seed and
/// view give the same steps.
pub fn draw(seed: u64, view: u32) -> [Step; 3] {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    random.set_stream(u64::from(view));
    let mut uniform = |low: f64, high: f64| {
        #[allow(clippy::cast_precision_loss, reason = "53 bits")]
        let unit = (random.next_u64() >> 11) as f64 / (1u64 << 53) as f64;
        low + (high - low) * unit
    };
    let brightness = Step::Brightness(uniform(-50.0, 50.0));
    let contrast = Step::Contrast(uniform(0.3, 1.5));
    let blurs = uniform(0.0, 1.0) < 0.5;
    let direction = match uniform(0.0, 4.0) as u32 {
        0 => BlurDirection::Horizontal,
        1 => BlurDirection::Vertical,
        2 => BlurDirection::DiagonalDown,
        _ => BlurDirection::DiagonalUp,
    };
    let mut steps = [
        brightness,
        contrast,
        Step::MotionBlur(blurs.then_some(direction)),
    ];
    for last in (1..steps.len()).rev() {
        let chosen = uniform(0.0, last as f64 + 1.0) as usize;
        steps.swap(last, chosen.min(last));
    }
    steps
}

/// Applies steps in order. Values stay fractional between steps, are clipped to 0 … 255 after
/// brightness and contrast, and are rounded at the end.
///
/// # Errors
/// Never: steps keep the image's size.
pub fn apply(image: &ColorImage, steps: &[Step]) -> Result<ColorImage> {
    let mut values = image.map(|pixel| pixel.map(f32::from));
    for step in steps {
        match *step {
            Step::Brightness(added) => brighten(&mut values, added),
            Step::Contrast(factor) => stretch(&mut values, factor),
            Step::MotionBlur(Some(direction)) => values = blurred(&values, direction)?,
            Step::MotionBlur(None) => {}
        }
    }
    Ok(values.map(|pixel| pixel.map(|value| value.round().clamp(0.0, 255.0) as u8)))
}

fn brighten(values: &mut Raster<[f32; 3]>, added: f64) {
    for value in values.values_mut().as_flattened_mut() {
        *value = (*value + added as f32).clamp(0.0, 255.0);
    }
}

fn stretch(values: &mut Raster<[f32; 3]>, factor: f64) {
    #[allow(
        clippy::cast_precision_loss,
        reason = "pixel counts are far below 2^53"
    )]
    let count = values.values().len() as f64;
    for channel in 0..3 {
        let sum: f64 = values
            .values()
            .iter()
            .map(|pixel| f64::from(pixel[channel]))
            .sum();
        let mean = sum / count;
        for pixel in values.values_mut() {
            let stretched = (f64::from(pixel[channel]) - mean) * factor + mean;
            pixel[channel] = stretched.clamp(0.0, 255.0) as f32;
        }
    }
}

/// Three pixels in a row, weighted by a Gaussian of variance 9/16; borders are mirrored without
/// repeating the border pixel.
fn blurred(values: &Raster<[f32; 3]>, direction: BlurDirection) -> Result<Raster<[f32; 3]>> {
    let (width, height) = values.size();
    let (dx, dy) = match direction {
        BlurDirection::Horizontal => (1i64, 0i64),
        BlurDirection::Vertical => (0, 1),
        BlurDirection::DiagonalDown => (1, 1),
        BlurDirection::DiagonalUp => (1, -1),
    };
    #[allow(clippy::cast_precision_loss, reason = "1 or 2")]
    let side = libm::expf(-((dx * dx + dy * dy) as f32) / (2.0 * 9.0 / 16.0));
    let centre = 1.0 / (1.0 + 2.0 * side);
    let at =
        |column: i64, row: i64| values.get(reflect_101(column, width), reflect_101(row, height));
    let mut result = Vec::with_capacity(values.values().len());
    for row in 0..i64::from(height) {
        for column in 0..i64::from(width) {
            let here = at(column, row);
            let before = at(column - dx, row - dy);
            let after = at(column + dx, row + dy);
            result.push(std::array::from_fn(|c| {
                centre * (here[c] + side * (before[c] + after[c]))
            }));
        }
    }
    Ok(Raster::from_values(width, height, result)?)
}

/// The pixel at `index` ≥ −1 of an image mirrored at the centres of its border pixels.
fn reflect_101(index: i64, length: u32) -> u32 {
    let last = i64::from(length) - 1;
    let index = if index < 0 { -index } else { index };
    let index = if index > last {
        2 * last - index
    } else {
        index
    };
    u32::try_from(index.clamp(0, last)).unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn image(width: u32, height: u32, values: &[u8]) -> ColorImage {
        let values = values.iter().map(|&v| [v, v / 2, 10]).collect();
        Raster::from_values(width, height, values).unwrap()
    }

    #[test]
    fn brightness_and_contrast_are_clipped() {
        let given = image(2, 1, &[100, 250]);
        let brighter = apply(&given, &[Step::Brightness(20.0)]).unwrap();
        assert_eq!(brighter.values(), [[120, 70, 30], [255, 145, 30]]);
        // The means are 175, 87.5 and 10.
        let flatter = apply(&given, &[Step::Contrast(0.5)]).unwrap();
        assert_eq!(flatter.values(), [[138, 69, 10], [213, 106, 10]]);
        let steeper = apply(&given, &[Step::Contrast(1.5)]).unwrap();
        assert_eq!(steeper.values()[1], [255, 144, 10]);
        // Clipped between steps: the order matters.
        let one = apply(&given, &[Step::Brightness(50.0), Step::Contrast(0.5)]).unwrap();
        let other = apply(&given, &[Step::Contrast(0.5), Step::Brightness(50.0)]).unwrap();
        assert_ne!(one, other);
    }

    #[test]
    fn blurs_have_the_published_weights_and_mirrored_borders() {
        let mut impulse = vec![0u8; 25];
        impulse[12] = 250;
        let given = image(5, 5, &impulse);
        let blur = |direction| apply(&given, &[Step::MotionBlur(Some(direction))]).unwrap();
        let weights = |found: &ColorImage, at: [(u32, u32); 3]| {
            at.map(|(column, row)| f64::from(found.get(column, row)[0]) / 250.0)
        };
        let close = |found: [f64; 3], expected: [f64; 3]| {
            found
                .iter()
                .zip(expected)
                .all(|(f, e)| (f - e).abs() < 0.0021)
        };
        let straight = [0.2256, 0.5488, 0.2256];
        let slanted = [0.1263, 0.7474, 0.1263];
        let horizontal = blur(BlurDirection::Horizontal);
        assert!(close(
            weights(&horizontal, [(1, 2), (2, 2), (3, 2)]),
            straight
        ));
        assert_eq!(horizontal.get(2, 1)[0], 0);
        let vertical = blur(BlurDirection::Vertical);
        assert!(close(
            weights(&vertical, [(2, 1), (2, 2), (2, 3)]),
            straight
        ));
        let down = blur(BlurDirection::DiagonalDown);
        assert!(close(weights(&down, [(1, 1), (2, 2), (3, 3)]), slanted));
        let up = blur(BlurDirection::DiagonalUp);
        assert!(close(weights(&up, [(1, 3), (2, 2), (3, 1)]), slanted));
        // At the border the neighbour inside counts twice.
        let edge = image(3, 1, &[0, 100, 0]);
        let found = apply(&edge, &[Step::MotionBlur(Some(BlurDirection::Horizontal))]).unwrap();
        assert_eq!([found.get(0, 0)[0], found.get(1, 0)[0]], [45, 55]);
        let single = image(1, 1, &[77]);
        let found = apply(
            &single,
            &[Step::MotionBlur(Some(BlurDirection::DiagonalUp))],
        )
        .unwrap();
        assert_eq!(found, single);
    }

    /// The published formulas, one after the other on one channel: U added, (x − mean) · U + mean, and a
    /// full 3×3 convolution with the published weights; clipped; borders by reflect-101.
    fn plainly(values: &[f64], (width, height): (usize, usize), step: Step) -> Vec<f64> {
        let clip = |value: f64| value.clamp(0.0, 255.0);
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        let kernel = match step {
            Step::Brightness(added) => return values.iter().map(|v| clip(v + added)).collect(),
            Step::Contrast(factor) => {
                let stretched = values.iter().map(|v| clip((v - mean) * factor + mean));
                return stretched.collect();
            }
            Step::MotionBlur(None) => return values.to_vec(),
            Step::MotionBlur(Some(BlurDirection::Horizontal)) => {
                [[0.0; 3], [0.2256, 0.5488, 0.2256], [0.0; 3]]
            }
            Step::MotionBlur(Some(BlurDirection::Vertical)) => {
                [[0.0, 0.2256, 0.0], [0.0, 0.5488, 0.0], [0.0, 0.2256, 0.0]]
            }
            Step::MotionBlur(Some(BlurDirection::DiagonalDown)) => {
                [[0.1263, 0.0, 0.0], [0.0, 0.7474, 0.0], [0.0, 0.0, 0.1263]]
            }
            Step::MotionBlur(Some(BlurDirection::DiagonalUp)) => {
                [[0.0, 0.0, 0.1263], [0.0, 0.7474, 0.0], [0.1263, 0.0, 0.0]]
            }
        };
        let mirrored = |index: usize, step: usize, length: usize| {
            // index + step − 1, mirrored at the first and the last.
            match index + step {
                0 => 1,
                at if at == length + 1 => length - 2,
                at => at - 1,
            }
        };
        let at = |index: usize| {
            let (column, row) = (index % width, index / width);
            let tap = |(j, i): (usize, usize)| {
                let (x, y) = (mirrored(column, i, width), mirrored(row, j, height));
                kernel[j][i] * values[y * width + x]
            };
            (0..3)
                .flat_map(|j| (0..3).map(move |i| (j, i)))
                .map(tap)
                .sum()
        };
        (0..values.len()).map(at).collect()
    }

    #[test]
    fn drawn_steps_equal_the_plain_formulas() {
        let (width, height) = (23, 17);
        let level = |index: usize, channel: usize| ((index * 7919 + channel * 104_729) % 251) as u8;
        let pixels = (0..width * height).map(|i| [level(i, 0), level(i, 1), level(i, 2)]);
        let given = Raster::from_values(23, 17, pixels.collect()).unwrap();
        for view in 0..40 {
            let steps = draw(11, view);
            let found = apply(&given, &steps).unwrap();
            for channel in 0..3 {
                let values = given.values().iter().map(|pixel| f64::from(pixel[channel]));
                let expected = steps
                    .iter()
                    .fold(values.collect::<Vec<f64>>(), |values, &step| {
                        plainly(&values, (width, height), step)
                    });
                for (pixel, expected) in found.values().iter().zip(expected) {
                    // Half a level by rounding, 255 · 1e-4 by the weights' four digits.
                    let off = (f64::from(pixel[channel]) - expected).abs();
                    assert!(off <= 0.5 + 0.03, "{view} {steps:?} {off}");
                }
            }
        }
    }

    #[test]
    fn draws_are_seeded_and_have_the_published_distributions() {
        assert_eq!(draw(7, 3), draw(7, 3));
        assert_ne!(draw(7, 3), draw(7, 4));
        assert_ne!(draw(7, 3), draw(8, 3));
        let (mut first_is_blur, mut blurs, mut directions) = (0, 0, [0; 4]);
        let (mut low, mut high) = ((0.0f64, 9.0f64), (0.0f64, 0.0f64));
        for view in 0..4000 {
            let steps = draw(1, view);
            first_is_blur += u32::from(matches!(steps[0], Step::MotionBlur(_)));
            for step in steps {
                match step {
                    Step::Brightness(b) => (low.0, high.0) = (low.0.min(b), high.0.max(b)),
                    Step::Contrast(c) => (low.1, high.1) = (low.1.min(c), high.1.max(c)),
                    Step::MotionBlur(None) => {}
                    Step::MotionBlur(Some(direction)) => {
                        blurs += 1;
                        directions[direction as usize] += 1;
                    }
                }
            }
        }
        assert!((-50.0..-49.5).contains(&low.0) && (49.5..50.0).contains(&high.0));
        assert!((0.3..0.302).contains(&low.1) && (1.498..1.5).contains(&high.1));
        // Four standard deviations of the counts.
        assert!((1214..=1453).contains(&first_is_blur), "{first_is_blur}");
        assert!((1873..=2127).contains(&blurs), "{blurs}");
        assert!(
            directions.iter().all(|&count| (422..=578).contains(&count)),
            "{directions:?}"
        );
    }
}
