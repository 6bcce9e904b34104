//! Precision, recall and F-score from nearest distances.

use crate::error::{Error, Result};
use crate::tolerance::Tolerance;
use rayon::prelude::*;

/// How many of a set of points lie within a tolerance of the other set.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
pub struct Count {
    within: usize,
    total: usize,
}

/// Distances that one thread counts at a time.
const COUNTED: usize = 1 << 16;

impl Count {
    /// `within` of `total` points; `within ≤ total`.
    ///
    /// # Errors
    /// More points within than in all.
    pub fn new(within: usize, total: usize) -> Result<Self> {
        if within <= total {
            return Ok(Self { within, total });
        }
        let problem = format!("expected at most the total of {total}, found {within} within");
        Err(Error::invalid("count", problem))
    }

    /// Counts the distances strictly below the tolerance. NaN and infinity are not below it.
    pub fn of(distances: &[f64], tolerance: Tolerance) -> Self {
        let within = distances
            .par_chunks(COUNTED)
            .map(|some| some.iter().filter(|&&d| d < tolerance.get()).count())
            .sum();
        Self {
            within,
            total: distances.len(),
        }
    }

    /// Points strictly within the tolerance.
    pub fn within(self) -> usize {
        self.within
    }

    /// All points that were asked.
    pub fn total(self) -> usize {
        self.total
    }

    /// `within / total` in [0, 1]; 0 for an empty set.
    pub fn fraction(self) -> f64 {
        if self.total == 0 {
            return 0.0;
        }
        self.within as f64 / self.total as f64
    }
}

/// Precision, recall and F-score at one tolerance, with the counts they come from.
///
/// An empty reconstruction has precision 0, and recall 0 as nothing of the truth is near it. Where
/// both are 0 the F-score is 0 (the official toolbox divides by zero there).
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct Score {
    tolerance: Tolerance,
    reconstruction: Count,
    truth: Count,
}

impl Score {
    /// A score from counts taken at `tolerance`.
    pub fn new(tolerance: Tolerance, reconstruction: Count, truth: Count) -> Self {
        Self {
            tolerance,
            reconstruction,
            truth,
        }
    }

    /// The score of a reconstruction: `to_truth` holds one nearest distance per reconstructed
    /// point, `to_reconstruction` one per point of the truth, in world units.
    pub fn from_distances(
        to_truth: &[f64],
        to_reconstruction: &[f64],
        tolerance: Tolerance,
    ) -> Self {
        Self::new(
            tolerance,
            Count::of(to_truth, tolerance),
            Count::of(to_reconstruction, tolerance),
        )
    }

    /// The tolerance of the counts.
    pub fn tolerance(&self) -> Tolerance {
        self.tolerance
    }

    /// Points of the reconstruction, and those within the tolerance of the truth.
    pub fn reconstruction(&self) -> Count {
        self.reconstruction
    }

    /// Points of the truth, and those within the tolerance of the reconstruction.
    pub fn truth(&self) -> Count {
        self.truth
    }

    /// The fraction of the reconstruction that is right, in [0, 1].
    pub fn precision(&self) -> f64 {
        self.reconstruction.fraction()
    }

    /// The fraction of the truth that was reconstructed, in [0, 1].
    pub fn recall(&self) -> f64 {
        self.truth.fraction()
    }

    /// 2PR / (P + R) in [0, 1]; 0 where both are 0.
    pub fn f_score(&self) -> f64 {
        f_score(self.precision(), self.recall())
    }
}

/// The harmonic mean 2PR / (P + R) of a precision and a recall; 0 where both are 0.
pub fn f_score(precision: f64, recall: f64) -> f64 {
    let sum = precision + recall;
    if sum > 0.0 {
        2.0 * precision * recall / sum
    } else {
        0.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(tau: f64) -> Tolerance {
        Tolerance::new(tau).unwrap()
    }

    #[test]
    fn a_distance_of_exactly_the_tolerance_is_outside() {
        let below = f64::from_bits(0.1f64.to_bits() - 1);
        let count = Count::of(&[0.0, below, 0.1, 0.2, f64::NAN, f64::INFINITY], at(0.1));
        assert_eq!((count.within(), count.total()), (2, 6));
    }

    #[test]
    fn closed_form() {
        let score = Score::from_distances(&[0.0, 0.0, 2.0, 2.0], &[0.0, 2.0, 2.0, 2.0], at(1.0));
        assert_eq!((score.precision(), score.recall()), (0.5, 0.25));
        assert_eq!(score.f_score(), 1.0 / 3.0);
    }

    #[test]
    fn empty_sides_and_double_zero_score_zero() {
        let empty = Score::from_distances(&[], &[f64::INFINITY; 3], at(1.0));
        assert_eq!(
            [empty.precision(), empty.recall(), empty.f_score()],
            [0.0; 3]
        );
        let both = Score::from_distances(&[], &[], at(1.0));
        assert_eq!([both.precision(), both.recall(), both.f_score()], [0.0; 3]);
        let far = Score::from_distances(&[5.0], &[5.0], at(1.0));
        assert_eq!(far.f_score(), 0.0);
    }

    #[test]
    fn more_within_than_there_are_is_refused() {
        assert!(Count::new(3, 2).is_err());
        assert_eq!(Count::new(2, 2).unwrap().fraction(), 1.0);
    }
}
