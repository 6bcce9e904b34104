//! How sure a score is: a confidence interval of F by resampling blocks of space.

use super::evaluation::Evaluation;
use crate::parallel;
use glam::DVec3;
use mvs_datasets::scene::Aabb;
use mvs_metrics::Tolerance;
use mvs_metrics::score::f_score;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Blocks along the longest side of the truth.
const BLOCKS_ALONG: f64 = 16.0;
/// The part of the resamples that the interval holds.
const LEVEL: f64 = 0.95;

/// A confidence interval of the F-score.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Interval {
    /// The lower end.
    pub lower: f64,
    /// The upper end.
    pub upper: f64,
    /// The part of the resamples inside.
    pub level: f64,
    /// How many resamples were drawn.
    pub resamples: u32,
    /// Occupied blocks of space.
    pub blocks: usize,
    /// Edge of a block in world units.
    pub block_size: f64,
}

/// Points, and points within the tolerance, of both sides.
type Tally = [usize; 4];

/// The percentile interval of F over `resamples` draws, with replacement, of cubic blocks of space.
/// Errors of neighbouring points go together, so points must not be drawn one by one (block
/// bootstrap, Künsch, Annals of Statistics 1989). Where errors hang together over as much as a block or more
/// the interval is too narrow: measured, one of 95 % held the true F in 79 of 100 cases with errors that hang
/// together over a block, in 46 over two. `None` without points or resamples.
pub fn interval(
    evaluation: &Evaluation,
    tolerance: Tolerance,
    resamples: u32,
    seed: u64,
) -> Option<Interval> {
    if resamples == 0 {
        return None;
    }
    let bounds = Aabb::around(evaluation.truth.points.iter());
    // A little more than a part, so that the farthest point is in the last block.
    let size = bounds.size().max_element() / BLOCKS_ALONG * (1.0 + 1e-9);
    let size = if size > 0.0 { size } else { tolerance.get() };
    let blocks = tallies(evaluation, tolerance, bounds.min, size);
    if blocks.is_empty() {
        return None;
    }
    let mut scores = parallel::map(resamples as usize, |resample| {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(resample as u64);
        resampled(&blocks, &mut rng)
    });
    scores.sort_by(f64::total_cmp);
    let at = |part: f64| scores[((scores.len() - 1) as f64 * part).round() as usize];
    Some(Interval {
        lower: at((1.0 - LEVEL) / 2.0),
        upper: at((1.0 + LEVEL) / 2.0),
        level: LEVEL,
        resamples,
        blocks: blocks.len(),
        block_size: size,
    })
}

fn tallies(evaluation: &Evaluation, tolerance: Tolerance, start: DVec3, size: f64) -> Vec<Tally> {
    let mut blocks: BTreeMap<[i64; 3], Tally> = BTreeMap::new();
    for (side, first) in [(&evaluation.reconstruction, 0), (&evaluation.truth, 2)] {
        for (point, &distance) in side.points.iter().zip(&side.distances) {
            let block = ((point - start) / size)
                .to_array()
                .map(|along| along.floor() as i64);
            let tally = blocks.entry(block).or_default();
            tally[first] += 1;
            tally[first + 1] += usize::from(distance < tolerance.get());
        }
    }
    blocks.into_values().collect()
}

fn resampled(blocks: &[Tally], rng: &mut ChaCha8Rng) -> f64 {
    let mut sum: Tally = [0; 4];
    for _ in 0..blocks.len() {
        // The bias of the remainder is below 2⁻⁴⁰ for fewer than 2²⁴ blocks.
        let block = blocks[(rng.next_u64() % blocks.len() as u64) as usize];
        for (sum, count) in sum.iter_mut().zip(block) {
            *sum += count;
        }
    }
    let fraction = |total: usize, within: usize| within as f64 / total.max(1) as f64;
    f_score(fraction(sum[0], sum[1]), fraction(sum[2], sum[3]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::score::plain::{self, Preparation};
    use crate::score::points::FinitePoints;

    /// A line of 1600 points; every `period`-th stretch of 100 of the reconstruction is off.
    fn evaluation(period: u32) -> Evaluation {
        let truth = (0..1600).map(|i| DVec3::X * f64::from(i));
        let reconstruction = (0..1600).map(|i| {
            let off = (i / 100) % period == 0;
            DVec3::new(f64::from(i), if off { 10.0 } else { 0.0 }, 0.0)
        });
        plain::evaluate(
            &FinitePoints::new(reconstruction.collect()),
            None,
            &FinitePoints::new(truth.collect()),
            &Preparation::default(),
        )
        .unwrap()
    }

    #[test]
    fn the_interval_is_that_of_drawing_blocks() {
        let tolerance = Tolerance::new(1.0).unwrap();
        let evaluation = evaluation(2);
        let f = evaluation.score(tolerance).f_score();
        assert!((f - 0.5).abs() < 0.01, "{f}");
        let interval = interval(&evaluation, tolerance, 2000, 0).unwrap();
        assert_eq!((interval.blocks, interval.resamples), (16, 2000));
        // The half-width for 16 coin flips is 1.96 · 0.5 / √16 = 0.245.
        assert!((interval.lower - (f - 0.245)).abs() < 0.06, "{interval:?}");
        assert!((interval.upper - (f + 0.245)).abs() < 0.06, "{interval:?}");
        // Drawing points one by one would claim 0.035.
    }

    #[test]
    fn equal_blocks_leave_no_doubt_and_the_seed_decides() {
        let tolerance = Tolerance::new(20.0).unwrap();
        let sure = interval(&evaluation(2), tolerance, 100, 0).unwrap();
        assert_eq!((sure.lower, sure.upper), (1.0, 1.0));
        let tolerance = Tolerance::new(1.0).unwrap();
        let drawn = |seed| interval(&evaluation(3), tolerance, 50, seed);
        assert_eq!(drawn(1), drawn(1));
        assert_ne!(drawn(1), drawn(2));
        assert_eq!(interval(&evaluation(3), tolerance, 0, 0), None);
    }
}
