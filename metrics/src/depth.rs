//! Errors of depth maps, in depth intervals and in world units.

use crate::error::{Error, Result};

/// The planes over which a method sweeps: `count` of them from `min` to `max`, in world units.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DepthPlanes {
    min: f64,
    interval: f64,
    count: f64,
}

impl DepthPlanes {
    /// Planes with 0 < `min` < `max`, both finite, and `count` ≥ 3.
    pub fn new(min: f64, max: f64, count: u32) -> Result<Self> {
        if !(min > 0.0 && min < max && max.is_finite()) || count < 3 {
            let problem =
                format!("expected 0 < min < max and 3 planes, found {min}, {max} and {count}");
            return Err(Error::invalid("depth planes", problem));
        }
        let count = f64::from(count);
        Ok(Self {
            min,
            interval: (max - min) / count,
            count,
        })
    }

    /// Δ = (max − min) / count, in world units.
    pub fn interval(&self) -> f64 {
        self.interval
    }

    /// Whether a true depth counts: min + Δ < depth ≤ min + (count − 2) Δ, and not 0.
    pub fn counts(&self, depth: f64) -> bool {
        let last = self.min + (self.count - 2.0) * self.interval;
        depth != 0.0 && depth > self.min + self.interval && depth <= last
    }
}

/// On which side an error of exactly the limit falls.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Limit {
    /// An error of exactly the limit is good (the paper's code: good is `≤`).
    Good,
    /// It is bad (others: good is `<`).
    Bad,
}

/// The errors of one depth map.
#[derive(Debug, Clone, PartialEq)]
pub struct DepthErrors {
    interval: f64,
    counted: usize,
    /// Per pixel with truth and estimate: |truth − estimate| and the truth, in world units.
    errors: Vec<[f64; 2]>,
    inliers: usize,
}

impl DepthErrors {
    /// Compares two maps of z-depths in world units, pixel by pixel; 0 stands for none on both sides,
    /// and so do NaN, infinite and negative estimates. An error where the lengths differ.
    pub fn new(truth: &[f32], estimate: &[f32], planes: &DepthPlanes) -> Result<Self> {
        if truth.len() != estimate.len() {
            let (t, e) = (truth.len(), estimate.len());
            let problem = format!("expected maps of one size, found {t} and {e} pixels");
            return Err(Error::invalid("depth errors", problem));
        }
        let mut result = Self {
            interval: planes.interval(),
            counted: 0,
            errors: Vec::new(),
            inliers: 0,
        };
        for (&truth, &estimate) in truth.iter().zip(estimate) {
            let (truth, estimate) = (f64::from(truth), f64::from(estimate));
            if !planes.counts(truth) {
                continue;
            }
            result.counted += 1;
            if estimate.is_finite() && estimate > 0.0 {
                result.errors.push([(truth - estimate).abs(), truth]);
                let ratio = (truth / estimate).max(estimate / truth);
                result.inliers += usize::from(ratio < 1.03);
            }
        }
        Ok(result)
    }

    /// Pixels whose true depth counts.
    pub fn counted(&self) -> usize {
        self.counted
    }

    /// The fraction of these with an estimate: without it a sparse map looks perfect. 0 of none.
    pub fn density(&self) -> f64 {
        self.errors.len() as f64 / self.counted.max(1) as f64
    }

    /// Mean |truth − estimate| over pixels with an estimate, in world units; `None` of none.
    pub fn mean_absolute(&self) -> Option<f64> {
        self.mean(|[error, _]| error)
    }

    /// The same in depth intervals: the EPE of the BlendedMVS paper.
    pub fn end_point(&self) -> Option<f64> {
        Some(self.mean_absolute()? / self.interval)
    }

    /// Mean |truth − estimate| / truth.
    pub fn mean_relative(&self) -> Option<f64> {
        self.mean(|[error, truth]| error / truth)
    }

    /// The fraction of estimates off by more than `limit` depth intervals, in [0, 1].
    pub fn above(&self, limit: f64, at: Limit) -> Option<f64> {
        let bad = |&&[error, _]: &&[f64; 2]| match at {
            Limit::Good => error / self.interval > limit,
            Limit::Bad => error / self.interval >= limit,
        };
        self.fraction(self.errors.iter().filter(bad).count())
    }

    /// The fraction of estimates with max(truth / estimate, estimate / truth) < 1.03.
    pub fn inlier_ratio(&self) -> Option<f64> {
        self.fraction(self.inliers)
    }

    fn fraction(&self, count: usize) -> Option<f64> {
        (!self.errors.is_empty()).then(|| count as f64 / self.errors.len() as f64)
    }

    fn mean(&self, value: impl Fn([f64; 2]) -> f64) -> Option<f64> {
        let values: Vec<f64> = self.errors.iter().map(|&error| value(error)).collect();
        crate::stats::mean(&values)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn planes() -> DepthPlanes {
        DepthPlanes::new(1.0, 9.0, 8).unwrap() // Δ = 1: 2 < depth ≤ 7 counts
    }

    #[test]
    fn only_the_inner_range_counts() {
        let counts = |depth| planes().counts(depth);
        assert!(!counts(0.0) && !counts(2.0) && counts(2.0 + 1e-9));
        assert!(counts(7.0) && !counts(7.0 + 1e-9) && !counts(f64::NAN));
    }

    #[test]
    fn closed_forms() {
        let truth = [4.0, 4.0, 4.0, 4.0, 1.5, 0.0];
        let estimate = [4.0, 5.0, 7.5, 0.0, 4.0, 4.0];
        let errors = DepthErrors::new(&truth, &estimate, &planes()).unwrap();
        assert_eq!((errors.counted(), errors.density()), (4, 0.75));
        assert_eq!(errors.end_point(), Some(1.5));
        assert_eq!(errors.mean_relative(), Some(0.375));
        assert_eq!(errors.above(1.0, Limit::Good), Some(1.0 / 3.0));
        assert_eq!(errors.above(1.0, Limit::Bad), Some(2.0 / 3.0));
        assert_eq!(errors.above(3.0, Limit::Good), Some(1.0 / 3.0));
        assert_eq!(errors.inlier_ratio(), Some(1.0 / 3.0));
    }

    #[test]
    fn a_map_without_estimates_has_no_errors_and_no_density() {
        let errors = DepthErrors::new(&[4.0; 3], &[0.0, f32::NAN, -1.0], &planes()).unwrap();
        assert_eq!((errors.density(), errors.end_point()), (0.0, None));
        assert!(DepthErrors::new(&[4.0; 3], &[4.0; 2], &planes()).is_err());
        assert!(DepthPlanes::new(2.0, 1.0, 8).is_err());
        assert!(DepthPlanes::new(f64::NAN, 1.0, 8).is_err());
    }
}
