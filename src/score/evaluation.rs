//! Distances between two prepared clouds, and what follows from them.

use crate::error::Result;
use glam::DVec3;
use mvs_metrics::distance::{self, BlockIndex};
use mvs_metrics::{Curve, Score, Tolerance, stats};
use serde::{Deserialize, Serialize};

/// The points of a side, in their order.
#[derive(Debug, Clone)]
pub enum Judged {
    /// As they are.
    Listed(Vec<DVec3>),
    /// In the index that their distances need anyway.
    Indexed(BlockIndex),
}

impl Judged {
    /// How many.
    pub fn len(&self) -> usize {
        match self {
            Self::Listed(points) => points.len(),
            Self::Indexed(index) => index.len(),
        }
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// All of them.
    pub fn iter(&self) -> impl Iterator<Item = DVec3> + '_ {
        let (listed, indexed) = match self {
            Self::Listed(points) => (&points[..], None),
            Self::Indexed(index) => (&[][..], Some(index)),
        };
        let pieces = indexed.into_iter().flat_map(BlockIndex::pieces);
        listed.iter().copied().chain(pieces.flatten())
    }

    /// All of them in a list.
    pub fn to_vec(&self) -> Vec<DVec3> {
        self.iter().collect()
    }
}

/// The same points in the same order.
impl PartialEq for Judged {
    fn eq(&self, other: &Self) -> bool {
        self.len() == other.len() && self.iter().eq(other.iter())
    }
}

/// One side of a comparison: the points that were judged and how far each is from the other side.
#[derive(Debug, Clone, PartialEq)]
pub struct Side {
    /// Points given, non-finite ones included.
    pub input: usize,
    /// Points dropped for NaN or infinity.
    pub non_finite: usize,
    /// Points inside the crop volume; all finite ones where there is none.
    pub cropped: usize,
    /// The points judged: after cropping and thinning.
    pub points: Judged,
    /// Per judged point the distance to the nearest one of the other side, in world units; infinite
    /// where the other side is empty.
    pub distances: Vec<f64>,
}

/// How many points of one side got how far.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct SideCounts {
    /// Points given, non-finite ones included.
    pub input: usize,
    /// Points dropped for NaN or infinity.
    pub non_finite: usize,
    /// Points inside the crop volume.
    pub cropped: usize,
    /// Points judged.
    pub evaluated: usize,
    /// Points judged whose nearest distance is below the tolerance.
    pub within: usize,
}

impl Side {
    fn counts(&self, within: usize) -> SideCounts {
        SideCounts {
            input: self.input,
            non_finite: self.non_finite,
            cropped: self.cropped,
            evaluated: self.points.len(),
            within,
        }
    }

    /// The mean distance in world units; `None` without points or where one is infinite.
    pub fn mean_distance(&self) -> Option<f64> {
        stats::mean(&self.distances).filter(|mean| mean.is_finite())
    }

    /// The median distance in world units; `None` without points or where it is infinite.
    pub fn median_distance(&self) -> Option<f64> {
        stats::median(&self.distances).filter(|median| median.is_finite())
    }
}

/// Two clouds in one frame with the distances between them.
#[derive(Debug, Clone, PartialEq)]
pub struct Evaluation {
    /// The reconstruction; its distances make the precision.
    pub reconstruction: Side,
    /// The truth; its distances make the recall.
    pub truth: Side,
}

impl Evaluation {
    /// Measures the distances both ways. An empty reconstruction is allowed: all truth is then
    /// infinitely far from it.
    ///
    /// # Errors
    /// Points of a list that are not finite, and 2³² − 1 of them or more, unless the other side is empty.
    pub fn measure(mut reconstruction: Side, mut truth: Side) -> Result<Self> {
        (reconstruction.distances, truth.distances) =
            both_ways(&reconstruction.points, &truth.points)?;
        Ok(Self {
            reconstruction,
            truth,
        })
    }

    /// Precision, recall and F-score at a tolerance.
    pub fn score(&self, tolerance: Tolerance) -> Score {
        Score::from_distances(
            &self.reconstruction.distances,
            &self.truth.distances,
            tolerance,
        )
    }

    /// The counts of (reconstruction, truth) at a tolerance.
    pub fn counts(&self, tolerance: Tolerance) -> (SideCounts, SideCounts) {
        let score = self.score(tolerance);
        (
            self.reconstruction.counts(score.reconstruction().within()),
            self.truth.counts(score.truth().within()),
        )
    }

    /// The cumulative curves of (precision, recall) up to 5 τ.
    pub fn curves(&self, tolerance: Tolerance) -> (Curve, Curve) {
        (
            Curve::of(&self.reconstruction.distances, tolerance),
            Curve::of(&self.truth.distances, tolerance),
        )
    }
}

fn both_ways(a: &Judged, b: &Judged) -> Result<(Vec<f64>, Vec<f64>)> {
    Ok(match (a, b) {
        (Judged::Indexed(a), Judged::Indexed(b)) => (b.distances_from(a), a.distances_from(b)),
        (Judged::Listed(a), Judged::Listed(b)) => distance::both_ways(a, b)?,
        // One of them came to nothing, or they came by different ways.
        _ => distance::both_ways(&a.to_vec(), &b.to_vec())?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn side(points: Vec<DVec3>) -> Side {
        Side {
            input: points.len(),
            non_finite: 0,
            cropped: points.len(),
            points: Judged::Listed(points),
            distances: Vec::new(),
        }
    }

    #[test]
    fn a_line_against_its_half() {
        let truth: Vec<DVec3> = (0..100).map(|i| DVec3::X * f64::from(i)).collect();
        let half = truth[..50].to_vec();
        let evaluation = Evaluation::measure(side(half), side(truth)).unwrap();
        let tolerance = Tolerance::new(10.0).unwrap();
        let score = evaluation.score(tolerance);
        // Points 50 … 58 of the truth are less than 10 from point 49.
        assert_eq!((score.precision(), score.recall()), (1.0, 0.59));
        let (reconstruction, truth) = evaluation.counts(tolerance);
        assert_eq!((reconstruction.within, reconstruction.evaluated), (50, 50));
        assert_eq!((truth.within, truth.evaluated), (59, 100));
        let (_, recall) = evaluation.curves(tolerance);
        assert_eq!(recall.fractions().last(), Some(&0.99)); // 498 bins cover 0 … 49.9
        assert_eq!(evaluation.truth.mean_distance(), Some(12.75));
    }

    #[test]
    fn an_empty_reconstruction_scores_zero() {
        let evaluation = Evaluation::measure(side(vec![]), side(vec![DVec3::ZERO])).unwrap();
        let score = evaluation.score(Tolerance::new(1.0).unwrap());
        assert_eq!(
            (score.precision(), score.recall(), score.f_score()),
            (0.0, 0.0, 0.0)
        );
        assert_eq!(evaluation.truth.mean_distance(), None);
        assert_eq!(evaluation.reconstruction.median_distance(), None);
    }
}
