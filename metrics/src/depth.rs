//! Errors of depth maps, in depth intervals and in world units.

use crate::error::{Error, Result};
use crate::stats;

/// The planes over which a method sweeps, in world units: `count` of them from `min` on, Δ = (`max` − `min`) / `count`
/// apart, so that the last is at `max` − Δ.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DepthPlanes {
    min: f64,
    interval: f64,
    count: f64,
}

impl DepthPlanes {
    /// Planes with 0 < `min` < `max`, both finite, and `count` ≥ 3.
    ///
    /// # Errors
    /// A `min` that is not above 0, a `max` that is not finite and above it, and fewer than 3 planes.
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

    fn counted(&self, depth: f32) -> Option<f64> {
        let depth = f64::from(depth);
        self.counts(depth).then_some(depth)
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

/// How estimates are brought to the truth's scale before they are compared.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Alignment {
    /// Not at all: multi-view depth has the scene's scale.
    #[default]
    None,
    /// Estimates are multiplied by the median of the truth over the median of the estimates.
    MedianRatio,
    /// Estimates are multiplied and shifted so that the sum of squared errors is least.
    LeastSquares,
}

/// What aligned an estimate: `scale` · estimate + `offset`, in world units.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct DepthFit {
    /// The factor.
    pub scale: f64,
    /// What is added, world units.
    pub offset: f64,
}

impl DepthFit {
    /// Leaves estimates as they are.
    pub const IDENTITY: Self = Self {
        scale: 1.0,
        offset: 0.0,
    };

    /// Fits two maps of z-depths over the pixels whose truth counts and that have an estimate; the
    /// identity where there is none. Estimates that are all the same are shifted, not scaled.
    ///
    /// # Errors
    /// Maps of different lengths.
    pub fn new(
        truth: &[f32],
        estimate: &[f32],
        planes: &DepthPlanes,
        alignment: Alignment,
    ) -> Result<Self> {
        check_lengths(truth, estimate)?;
        let maps = truth.iter().zip(estimate);
        let pairs = maps.filter_map(|(&t, &e)| Some((planes.counted(t)?, estimate_of(e)?)));
        let (truths, estimates): (Vec<f64>, Vec<f64>) = pairs.unzip();
        let fit = match alignment {
            Alignment::None => None,
            Alignment::MedianRatio => {
                let medians = stats::median(&truths).zip(stats::median(&estimates));
                medians.map(|(truth, estimate)| Self {
                    scale: truth / estimate,
                    offset: 0.0,
                })
            }
            Alignment::LeastSquares => least_squares(&truths, &estimates),
        };
        Ok(fit.unwrap_or(Self::IDENTITY))
    }

    fn apply(&self, depth: f64) -> f64 {
        self.scale * depth + self.offset
    }
}

fn least_squares(truths: &[f64], estimates: &[f64]) -> Option<DepthFit> {
    let (truth, estimate) = (stats::mean(truths)?, stats::mean(estimates)?);
    let products = |left: &[f64], right: &[f64], about: (f64, f64)| {
        let products = left.iter().zip(right);
        let products: Vec<f64> = products
            .map(|(l, r)| (l - about.0) * (r - about.1))
            .collect();
        stats::sum(&products)
    };
    let spread = products(estimates, estimates, (estimate, estimate));
    let scale = if spread > 0.0 {
        products(estimates, truths, (estimate, truth)) / spread
    } else {
        1.0
    };
    Some(DepthFit {
        scale,
        offset: truth - scale * estimate,
    })
}

fn check_lengths(truth: &[f32], other: &[f32]) -> Result<()> {
    if truth.len() == other.len() {
        return Ok(());
    }
    let (t, e) = (truth.len(), other.len());
    let problem = format!("expected maps of one size, found {t} and {e} pixels");
    Err(Error::invalid("depth errors", problem))
}

/// NaN, infinite and negative estimates are none, as 0 is.
fn estimate_of(value: f32) -> Option<f64> {
    (value.is_finite() && value > 0.0).then(|| f64::from(value))
}

/// The errors of one depth map.
#[derive(Debug, Clone, PartialEq)]
pub struct DepthErrors {
    /// Pixels of the map.
    size: usize,
    interval: f64,
    counted: usize,
    /// Per pixel with truth and estimate: |truth − estimate| and the truth, in world units.
    errors: Vec<[f64; 2]>,
    /// Their positions in the map.
    pixels: Vec<usize>,
    inliers: usize,
}

impl DepthErrors {
    /// Compares two maps of z-depths in world units, pixel by pixel; 0 stands for none on both sides,
    /// and so do NaN, infinite and negative estimates.
    ///
    /// # Errors
    /// Maps of different lengths.
    pub fn new(truth: &[f32], estimate: &[f32], planes: &DepthPlanes) -> Result<Self> {
        Self::aligned(truth, estimate, planes, &DepthFit::IDENTITY)
    }

    /// As [`DepthErrors::new`], of estimates that `fit` has aligned.
    ///
    /// # Errors
    /// Maps of different lengths.
    pub fn aligned(
        truth: &[f32],
        estimate: &[f32],
        planes: &DepthPlanes,
        fit: &DepthFit,
    ) -> Result<Self> {
        check_lengths(truth, estimate)?;
        let mut result = Self {
            size: truth.len(),
            interval: planes.interval(),
            counted: 0,
            errors: Vec::new(),
            pixels: Vec::new(),
            inliers: 0,
        };
        for (pixel, (&truth, &estimate)) in truth.iter().zip(estimate).enumerate() {
            let Some(truth) = planes.counted(truth) else {
                continue;
            };
            result.counted += 1;
            if let Some(estimate) = estimate_of(estimate) {
                let estimate = fit.apply(estimate);
                result.errors.push([(truth - estimate).abs(), truth]);
                result.pixels.push(pixel);
                let ratio = (truth / estimate).max(estimate / truth);
                result.inliers += usize::from(estimate > 0.0 && ratio < 1.03);
            }
        }
        Ok(result)
    }

    /// Pixels whose true depth counts and that have an estimate.
    pub fn compared(&self) -> usize {
        self.errors.len()
    }

    /// (position in the map, |truth − estimate| in depth intervals) of the compared pixels, in order.
    pub fn in_intervals(&self) -> impl Iterator<Item = (usize, f64)> + '_ {
        let errors = self.errors.iter().map(|[error, _]| error / self.interval);
        self.pixels.iter().copied().zip(errors)
    }

    /// The area under the sparsification error (AUSE), in depth intervals: leave out the least
    /// confident pixels one after another and average the errors of the rest; the same with the
    /// largest errors left out first; the mean difference of the two curves over 0 to all but one
    /// pixel left out. 0 is a confidence that orders pixels as their errors do. Equally confident
    /// pixels stand for their mean error, so their order does not matter; NaN is least confident.
    ///
    /// `confidence` has the maps' length; larger is surer. `None` where no pixel was compared.
    ///
    /// Ilg et al. 2018 (Uncertainty Estimates and Multi-Hypotheses Networks for Optical Flow),
    /// with depth errors and not normalised.
    ///
    /// # Errors
    /// A `confidence` of another length than the maps'.
    pub fn ause(&self, confidence: &[f32]) -> Result<Option<f64>> {
        if self.size != confidence.len() {
            let (expected, found) = (self.size, confidence.len());
            let problem = format!("expected the maps' {expected} pixels, found {found}");
            return Err(Error::invalid("confidence", problem));
        }
        let mut by_confidence: Vec<(f32, f64)> = self
            .in_intervals()
            .map(|(pixel, error)| (surest_last(confidence[pixel]), error))
            .collect();
        by_confidence.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.total_cmp(&b.1)));
        for equal in by_confidence.chunk_by_mut(|a, b| a.0 == b.0) {
            let errors: Vec<f64> = equal.iter().map(|&(_, error)| error).collect();
            let mean = stats::mean(&errors).unwrap_or(0.0);
            equal.iter_mut().for_each(|(_, error)| *error = mean);
        }
        let mut by_error: Vec<f64> = self.in_intervals().map(|(_, error)| error).collect();
        by_error.sort_by(f64::total_cmp);
        let by_confidence = by_confidence.into_iter().map(|(_, error)| error);
        Ok(mean_of_means(by_confidence)
            .zip(mean_of_means(by_error.into_iter()))
            .map(|(found, best)| found - best))
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
        stats::mean(&values)
    }
}

/// NaN sorts below every number.
fn surest_last(confidence: f32) -> f32 {
    if confidence.is_nan() {
        f32::NEG_INFINITY
    } else {
        confidence + 0.0 // -0 is 0
    }
}

/// The mean over k ≥ 1 of the mean of the first k values; `None` of nothing.
fn mean_of_means(values: impl Iterator<Item = f64>) -> Option<f64> {
    let mut sum = 0.0;
    let means = values.enumerate().map(|(before, value)| {
        sum += value;
        sum / (before as f64 + 1.0)
    });
    stats::mean(&means.collect::<Vec<f64>>())
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

    #[test]
    fn the_boundaries_of_one_and_three_intervals_fall_as_named() {
        // Errors of exactly 1 and 3 intervals, and one step of f32 beyond each.
        let beyond = |value: f32| f32::from_bits(value.to_bits() + 1);
        let truth = [4.0; 5];
        let estimate = [4.0, 5.0, beyond(5.0), 7.0, beyond(7.0)];
        let errors = DepthErrors::new(&truth, &estimate, &planes()).unwrap();
        let above = |limit, at| errors.above(limit, at).unwrap() * 5.0;
        assert_eq!(
            (above(1.0, Limit::Good), above(1.0, Limit::Bad)),
            (3.0, 4.0)
        );
        assert_eq!(
            (above(3.0, Limit::Good), above(3.0, Limit::Bad)),
            (1.0, 2.0)
        );
        // 1.03 is strict: 3.09 / 3 is 1.03 up to f32.
        let at = |estimate: f32| {
            DepthErrors::new(&[3.0], &[estimate], &planes())
                .unwrap()
                .inlier_ratio()
        };
        assert_eq!((at(3.0899), at(3.0901)), (Some(1.0), Some(0.0)));
        assert_eq!((at(3.0 / 1.0299), at(3.0 / 1.0301)), (Some(1.0), Some(0.0)));
    }

    #[test]
    fn ause_is_the_area_between_the_curves() {
        // Errors 0, 1, 2, 3 intervals. Sorted by error the curve's means of the first k are
        // 0, .5, 1, 1.5; sorted the wrong way 3, 2.5, 2, 1.5.
        let errors = DepthErrors::new(&[4.0; 5], &[4.0, 5.0, 6.0, 7.0, 0.0], &planes()).unwrap();
        let ause = |confidence: [f32; 5]| errors.ause(&confidence).unwrap().unwrap();
        assert_eq!(ause([4.0, 3.0, 2.0, 1.0, 9.0]), 0.0);
        assert_eq!(ause([1.0, 2.0, 3.0, 4.0, 9.0]), (2.25 - 0.75));
        // All alike: the curve is flat at the mean 1.5.
        assert_eq!(ause([0.5, 0.5, 0.5, 0.5, 9.0]), 0.75);
        // NaN is left out first: 0, .5, 1 and then 3 is the right order here.
        assert_eq!(ause([3.0, 2.0, 1.0, f32::NAN, 9.0]), 0.0);
        // Two ties: 1 and 2 stand for 1.5 each: means 0, .75, 1, 1.5.
        assert_eq!(ause([3.0, 2.0, 2.0, 1.0, 9.0]), 0.25 / 4.0);
        assert!(errors.ause(&[1.0; 4]).is_err() && errors.ause(&[1.0; 6]).is_err());
        let none = DepthErrors::new(&[4.0], &[0.0], &planes()).unwrap();
        assert_eq!(none.ause(&[1.0]).unwrap(), None);
    }

    #[test]
    fn ause_equals_sums_by_removal() {
        let count: usize = 200;
        let estimate: Vec<f32> = (0..count)
            .map(|i| 3.0 + (i * 37 % 101) as f32 / 60.0)
            .collect();
        let confidence: Vec<f32> = (0..count).map(|i| (i * 61 % 211) as f32).collect();
        let errors = DepthErrors::new(&vec![4.0; count], &estimate, &planes()).unwrap();
        // Plainly: remove the worst of the rest, average, again and again.
        let curve = |key: &dyn Fn(usize) -> f64| {
            let mut left: Vec<usize> = (0..count).collect();
            let mut area = 0.0;
            while !left.is_empty() {
                let error = |&i: &usize| (f64::from(estimate[i]) - 4.0).abs();
                area += left.iter().map(error).sum::<f64>() / left.len() as f64;
                let worst = (0..left.len()).min_by(|&a, &b| key(left[a]).total_cmp(&key(left[b])));
                left.remove(worst.unwrap());
            }
            area / count as f64
        };
        let expected = curve(&|i| f64::from(confidence[i]))
            - curve(&|i| -(f64::from(estimate[i]) - 4.0).abs());
        let found = errors.ause(&confidence).unwrap().unwrap();
        assert!((found - expected).abs() < 1e-12, "{found} {expected}");
    }

    #[test]
    fn alignments_undo_what_they_are_for() {
        let truth = [3.0, 4.0, 5.0, 6.0, 0.0, 1.0];
        let halved = truth.map(|depth| depth / 2.0);
        let bent = truth.map(|depth| 2.0 * depth - 1.0);
        let fit = |estimate: &[f32], how| DepthFit::new(&truth, estimate, &planes(), how).unwrap();
        assert_eq!(fit(&halved, Alignment::None), DepthFit::IDENTITY);
        let doubled = DepthFit {
            scale: 2.0,
            offset: 0.0,
        };
        assert_eq!(fit(&halved, Alignment::MedianRatio), doubled);
        let straight = DepthFit {
            scale: 0.5,
            offset: 0.5,
        };
        assert_eq!(fit(&bent, Alignment::LeastSquares), straight);
        let errors = DepthErrors::aligned(&truth, &bent, &planes(), &straight).unwrap();
        assert_eq!(
            (errors.end_point(), errors.inlier_ratio()),
            (Some(0.0), Some(1.0))
        );
        let flat = fit(&[2.0; 6], Alignment::LeastSquares);
        assert_eq!(
            flat,
            DepthFit {
                scale: 1.0,
                offset: 2.5
            }
        );
        assert_eq!(fit(&[0.0; 6], Alignment::MedianRatio), DepthFit::IDENTITY);
        // An estimate that alignment turns negative is far off, and no inlier.
        let turned = DepthFit {
            scale: -1.0,
            offset: 0.0,
        };
        let errors = DepthErrors::aligned(&truth, &truth, &planes(), &turned).unwrap();
        assert_eq!(
            (errors.inlier_ratio(), errors.mean_relative()),
            (Some(0.0), Some(2.0))
        );
    }
}
