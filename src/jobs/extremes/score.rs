//! Precision and recall against those of the same clouds where nothing is extreme.

use super::{ExtremesJob, Place, Rows, SCORE_BOUND, naive};
use crate::error::Result;
use crate::score::plain::{self, Preparation};
use crate::score::{Evaluation, FinitePoints};
use glam::DVec3;
use mvs_metrics::Tolerance;

/// τ where the clouds are 2 wide.
const TAU: f64 = 0.01;
const QUANTITY: &str = "change of precision or recall, larger";

pub(super) fn measure(job: &ExtremesJob, rows: &mut Rows<'_>) -> Result<()> {
    let clouds = Clouds::new(u64::from(job.points));
    let usual = clouds.fractions()?;
    for (step, place) in Place::steps() {
        let moved = clouds.at(place);
        let bound = match step {
            ("scale", factor) if is_power_of_two(factor) => 0.0,
            _ => bound_of(job.points),
        };
        let change = usual.largest_change(&moved.fractions()?);
        rows.put(step, "ours", (QUANTITY, change), Some(bound))?;
        let middle = place.put(DVec3::ZERO);
        for arithmetic in naive::ALL {
            let stored = moved.map(|point| arithmetic.stored(point, middle));
            let change = usual.largest_change(&stored.fractions()?);
            rows.put(step, arithmetic.name, (QUANTITY, change), None)?;
        }
    }
    for ratio in [1e3, 1e6, 1e9] {
        // A far point on each side, right on top of each other.
        let mut wide = clouds.clone();
        wide.truth.push(DVec3::splat(ratio));
        wide.reconstruction.push(DVec3::splat(ratio));
        let found = wide.evaluation()?.counts(wide.tolerance()?);
        let usual = clouds.evaluation()?.counts(clouds.tolerance()?);
        let off = found.0.within.abs_diff(usual.0.within + 1)
            + found.1.within.abs_diff(usual.1.within + 1);
        let quantity = ("counts changed beyond the outlier's own", off as f64);
        rows.put(("near-far", ratio), "ours", quantity, Some(0.0))?;
    }
    for copies in [2usize, 10] {
        let repeat = |points: &[DVec3]| -> Vec<DVec3> {
            points
                .iter()
                .flat_map(|&point| std::iter::repeat_n(point, copies))
                .collect()
        };
        let repeated = Clouds {
            truth: repeat(&clouds.truth),
            reconstruction: repeat(&clouds.reconstruction),
            tau: clouds.tau,
        };
        let change = usual.largest_change(&repeated.fractions()?);
        rows.put(
            ("duplicates", copies as f64),
            "ours",
            (QUANTITY, change),
            Some(0.0),
        )?;
    }
    Ok(())
}

/// Change of precision and recall allowed: of fewer than a million points, two of the reconstruction, which has half
/// as many.
fn bound_of(points: u32) -> f64 {
    match points {
        1_000_000.. => SCORE_BOUND,
        _ => 2.0 / f64::from(points / 2),
    }
}

fn is_power_of_two(factor: f64) -> bool {
    factor.to_bits().trailing_zeros() >= 52
}

/// A bumpy sheet and a noisy copy.
#[derive(Clone)]
struct Clouds {
    truth: Vec<DVec3>,
    reconstruction: Vec<DVec3>,
    tau: f64,
}

/// Precision and recall.
struct Fractions([f64; 2]);

impl Fractions {
    fn largest_change(&self, other: &Self) -> f64 {
        let changes = self.0.iter().zip(other.0).map(|(a, b)| (a - b).abs());
        changes.fold(0.0, f64::max)
    }
}

impl Clouds {
    fn new(count: u64) -> Self {
        // Neighbours stand about τ/2 apart at a million points, and more with fewer: the noise is of
        // the same size, so that neither precision nor recall is near 0 or 1.
        let noise = 2.0 * TAU;
        let sheet = |seed: u64, count: u64, noise: f64| -> Vec<DVec3> {
            let point = |i: u64| {
                let [x, y, lift] = std::array::from_fn(|k| unit(seed, 3 * i + k as u64));
                DVec3::new(x, y, 0.25 * x * x - 0.125 * x * y + lift * noise)
            };
            (0..count).map(point).collect()
        };
        Self {
            truth: sheet(1, count, 0.0),
            reconstruction: sheet(2, count / 2, noise),
            tau: TAU,
        }
    }

    fn map(&self, put: impl Fn(DVec3) -> DVec3) -> Self {
        let all = |points: &[DVec3]| points.iter().map(|&point| put(point)).collect();
        Self {
            truth: all(&self.truth),
            reconstruction: all(&self.reconstruction),
            tau: self.tau,
        }
    }

    fn at(&self, place: Place) -> Self {
        Self {
            tau: self.tau * place.scale,
            ..self.map(|point| place.put(point))
        }
    }

    fn tolerance(&self) -> Result<Tolerance> {
        Ok(Tolerance::new(self.tau)?)
    }

    fn evaluation(&self) -> Result<Evaluation> {
        let finite = |points: &[DVec3]| FinitePoints::new(points.to_vec());
        let (truth, reconstruction) = (finite(&self.truth), finite(&self.reconstruction));
        plain::evaluate(&reconstruction, None, &truth, &Preparation::default())
    }

    fn fractions(&self) -> Result<Fractions> {
        let score = self.evaluation()?.score(self.tolerance()?);
        Ok(Fractions([score.precision(), score.recall()]))
    }
}

/// Uniform in [−1, 1), one number per key.
fn unit(seed: u64, key: u64) -> f64 {
    let mut bits =
        key.wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ seed.wrapping_mul(0xd1b5_4a32_d192_ed03);
    bits = (bits ^ (bits >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    bits = (bits ^ (bits >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    ((bits ^ (bits >> 31)) >> 11) as f64 / (1u64 << 52) as f64 - 1.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::progress::Silent;

    /// Of so many, one point that changes sides is more than the change allowed for a million.
    #[test]
    fn the_bound_allows_for_a_point_of_a_small_cloud() {
        for points in [2, 1001, 200_000] {
            let job = ExtremesJob {
                points,
                ..ExtremesJob::default()
            };
            let mut rows = Rows {
                stage: "score",
                all: Vec::new(),
                progress: &Silent,
            };
            measure(&job, &mut rows).unwrap();
            let broken = rows.all.iter().find(|row| !row.holds());
            assert_eq!(broken, None, "{points} points");
        }
        assert_eq!(bound_of(ExtremesJob::default().points), 1e-6);
    }
}
