//! Making exact depth worse, in ways whose frequencies are known.

use super::DepthNoise;
use super::random::Random;
use crate::scene::{DepthMap, DepthRange, Raster};

/// Neighbouring depths that differ by more than this fraction of the nearer one are an edge.
const EDGE: f64 = 0.05;
/// No more than this fraction of the surface is made into holes.
const MOST_HOLES: f64 = 0.95;

/// What one pixel's depth is.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Kind {
    /// The true depth with Gaussian noise of so many standard deviations.
    Noisy(f64),
    Outlier,
    Flying,
}

/// Estimated depth and confidence. Per pixel the same number of draws is used whatever becomes of
/// it, so that changing one kind of noise leaves the others where they are.
pub(super) fn estimate(
    truth: &DepthMap,
    range: DepthRange,
    noise: &DepthNoise,
    random: &mut Random,
) -> (DepthMap, Raster<f32>) {
    let holes = holes(truth, noise.holes, &mut random.clone());
    let mut depths = truth.raster().clone();
    let mut confidences = truth.raster().map(|_| 0.0f32);
    for row in 0..truth.height() {
        for column in 0..truth.width() {
            let draws: [f64; 4] = std::array::from_fn(|_| random.unit());
            let normal = random.normal();
            let true_depth = f64::from(truth.get(column, row));
            if true_depth <= 0.0 {
                continue;
            }
            let partner = across_edge(truth, column, row);
            let kind = kind_of(draws, normal, partner.is_some(), noise);
            let depth = match (kind, partner) {
                (Kind::Outlier, _) => range.min() + draws[2] * (range.max() - range.min()),
                (Kind::Flying, Some(other)) => {
                    true_depth + (0.2 + 0.6 * draws[2]) * (other - true_depth)
                }
                _ => true_depth * (1.0 + noise.relative_sigma * normal),
            };
            let kept = !holes.get(column, row);
            #[allow(clippy::cast_possible_truncation, reason = "depth is stored as f32")]
            if kept {
                depths.set(column, row, depth.max(0.0) as f32);
                confidences.set(column, row, confidence(kind, draws[3]) as f32);
            } else {
                depths.set(column, row, 0.0);
            }
        }
    }
    (DepthMap::clean(depths).0, confidences)
}

fn kind_of(draws: [f64; 4], normal: f64, at_edge: bool, noise: &DepthNoise) -> Kind {
    if draws[0] < noise.outliers {
        Kind::Outlier
    } else if at_edge && draws[1] < noise.flying {
        Kind::Flying
    } else {
        Kind::Noisy(normal.abs())
    }
}

/// Informative but not an oracle: good depths lie mostly above 0.8, bad ones mostly below, and the
/// two overlap. `draw` is uniform over 0 to 1.
fn confidence(kind: Kind, draw: f64) -> f64 {
    match kind {
        Kind::Noisy(deviations) => (1.0 - 0.04 * deviations - 0.08 * draw).max(0.0),
        Kind::Flying => 0.25 + 0.65 * draw,
        Kind::Outlier => 0.05 + 0.85 * draw * draw,
    }
}

/// The depth of the 4-neighbour farthest away in depth, if there is an edge between it and the
/// pixel.
fn across_edge(truth: &DepthMap, column: u32, row: u32) -> Option<f64> {
    let own = f64::from(truth.get(column, row));
    let neighbours = [
        (column.wrapping_sub(1), row),
        (column + 1, row),
        (column, row.wrapping_sub(1)),
        (column, row + 1),
    ];
    neighbours
        .into_iter()
        .filter(|&(column, row)| column < truth.width() && row < truth.height())
        .map(|(column, row)| f64::from(truth.get(column, row)))
        .filter(|&other| other > 0.0 && (other - own).abs() > EDGE * own.min(other))
        .max_by(|a, b| (a - own).abs().total_cmp(&(b - own).abs()))
}

/// Round holes over `fraction` of the pixels that have a depth; the last disc may overshoot.
fn holes(truth: &DepthMap, fraction: f64, random: &mut Random) -> Raster<bool> {
    let mut holes = truth.raster().map(|_| false);
    let (width, height) = truth.size();
    let valid = truth.valid_count();
    #[allow(clippy::cast_precision_loss, reason = "pixel counts are below 2^53")]
    let wanted = fraction.clamp(0.0, MOST_HOLES) * valid as f64;
    let (mut covered, longest) = (0.0, f64::from(width.max(height)));
    while covered < wanted {
        let radius = (longest * random.between(0.008, 0.03)).max(1.0);
        let center = (
            random.between(0.0, f64::from(width)),
            random.between(0.0, f64::from(height)),
        );
        covered += punch(&mut holes, truth, center, radius);
    }
    holes
}

/// Marks a disc; how many pixels with a depth it newly covers.
fn punch(holes: &mut Raster<bool>, truth: &DepthMap, center: (f64, f64), radius: f64) -> f64 {
    let span = |middle: f64, size: u32| {
        #[allow(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "clamped to the image; the cast saturates"
        )]
        let bounds = (
            (middle - radius).max(0.0) as u32,
            ((middle + radius).ceil() as u32).min(size),
        );
        bounds.0..bounds.1
    };
    let mut covered = 0.0;
    for row in span(center.1, truth.height()) {
        for column in span(center.0, truth.width()) {
            let dx = f64::from(column) + 0.5 - center.0;
            let dy = f64::from(row) + 0.5 - center.1;
            if libm::hypot(dx, dy) <= radius && !holes.get(column, row) {
                holes.set(column, row, true);
                covered += f64::from(u8::from(truth.get(column, row) > 0.0));
            }
        }
    }
    covered
}

#[cfg(test)]
mod tests {
    use super::*;

    const NOISE: DepthNoise = DepthNoise {
        relative_sigma: 0.002,
        outliers: 0.03,
        flying: 0.4,
        holes: 0.05,
    };

    /// A step from depth 2 to depth 3 in the middle of the image.
    fn step() -> (DepthMap, DepthRange) {
        let values = (0..400 * 300).map(|i| if i % 400 < 200 { 2.0 } else { 3.0 });
        let (map, _) = DepthMap::from_values(400, 300, values.collect()).unwrap();
        (map, DepthRange::new(1.0, 5.0).unwrap())
    }

    fn noisy(noise: &DepthNoise) -> (DepthMap, Raster<f32>) {
        let (truth, range) = step();
        estimate(&truth, range, noise, &mut Random::new(7, 0))
    }

    /// Whether `count` of `n` is within five standard deviations of probability `p`.
    fn binomial(count: usize, n: usize, p: f64) -> bool {
        let (count, n) = (count as f64, n as f64);
        (count - n * p).abs() <= 5.0 * (n * p * (1.0 - p)).sqrt()
    }

    #[test]
    fn frequencies_are_those_asked_for() {
        let (truth, _) = step();
        let (depth, _) = noisy(&NOISE);
        let holes = depth.values().iter().filter(|&&d| d == 0.0).count();
        let one_disc = std::f64::consts::PI * (0.03f64 * 400.0).powi(2);
        assert!((holes as f64) < 0.05 * 120_000.0 + one_disc);
        assert!(holes as f64 >= 0.05 * 120_000.0);
        let mut far = (0, 0);
        let mut flying = (0, 0);
        for row in 0..300 {
            for column in 0..400 {
                let (true_depth, found) = (truth.get(column, row), depth.get(column, row));
                if found == 0.0 {
                    continue;
                }
                let off = f64::from((found - true_depth).abs() / true_depth) > 6.0 * 0.002;
                let count = if column == 199 || column == 200 {
                    &mut flying
                } else {
                    &mut far
                };
                *count = (count.0 + usize::from(off), count.1 + 1);
            }
        }
        // Outliers are uniform over 1 to 5 and land within 6 sigma of 2 or 3 by chance.
        let noticed = 0.03 * (1.0 - 12.0 * 0.002 * 2.5 / 4.0);
        assert!(binomial(far.0, far.1, noticed), "{far:?}");
        let either = noticed + (1.0 - 0.03) * 0.4;
        assert!(binomial(flying.0, flying.1, either), "{flying:?}");
    }

    #[test]
    fn the_noise_has_the_sigma_asked_for() {
        let (truth, _) = step();
        let only_noise = DepthNoise {
            outliers: 0.0,
            flying: 0.0,
            holes: 0.0,
            ..NOISE
        };
        let (depth, _) = noisy(&only_noise);
        let squares = depth
            .values()
            .iter()
            .zip(truth.values())
            .map(|(&found, &exact)| (f64::from(found) / f64::from(exact) - 1.0).powi(2));
        let sigma = (squares.sum::<f64>() / 120_000.0).sqrt();
        // The relative standard error of a standard deviation is 1 / sqrt(2 n).
        assert!(
            (sigma / 0.002 - 1.0).abs() < 5.0 / 240_000.0f64.sqrt(),
            "{sigma}"
        );
    }

    #[test]
    fn flying_pixels_lie_between_the_surfaces() {
        let only_flying = DepthNoise {
            relative_sigma: 0.0,
            outliers: 0.0,
            flying: 1.0,
            holes: 0.0,
        };
        let (depth, _) = noisy(&only_flying);
        for row in 0..300 {
            for column in [199, 200] {
                assert!((2.2 - 1e-6..=2.8 + 1e-6).contains(&depth.get(column, row)));
            }
            assert_eq!((depth.get(198, row), depth.get(201, row)), (2.0, 3.0));
        }
    }

    #[test]
    fn confidence_tells_good_from_bad_but_not_perfectly() {
        let (truth, _) = step();
        let (depth, confidence) = noisy(&NOISE);
        let (mut good, mut bad) = ((0, 0), (0, 0));
        for ((&found, &exact), &confidence) in depth
            .values()
            .iter()
            .zip(truth.values())
            .zip(confidence.values())
        {
            if found == 0.0 {
                assert_eq!(confidence, 0.0);
                continue;
            }
            assert!((0.0..=1.0).contains(&confidence));
            let is_good = (found - exact).abs() < 6.0 * 0.002 * exact;
            let count = if is_good { &mut good } else { &mut bad };
            *count = (count.0 + usize::from(confidence >= 0.8), count.1 + 1);
        }
        let share = |(high, all): (usize, usize)| high as f64 / all as f64;
        assert!(share(good) > 0.97, "{}", share(good));
        assert!((0.01..0.2).contains(&share(bad)), "{}", share(bad));
    }

    #[test]
    fn no_noise_is_the_truth() {
        let none = DepthNoise {
            relative_sigma: 0.0,
            outliers: 0.0,
            flying: 0.0,
            holes: 0.0,
        };
        assert_eq!(noisy(&none).0, step().0);
    }
}
