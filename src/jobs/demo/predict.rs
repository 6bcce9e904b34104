//! What the demo's noise model predicts for its score, before anything is fused.

use glam::DVec3;
use mvs_datasets::synthetic::{DepthNoise, SyntheticScene};
use serde::Serialize;

/// A predicted score, as fractions.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Prediction {
    /// Expected precision.
    pub precision: f64,
    /// Expected recall.
    pub recall: f64,
    /// Their harmonic mean.
    pub f_score: f64,
}

/// Two depths on one ray are the same surface when they differ by less than this fraction.
const SAME_SURFACE: f64 = 1e-6;

/// Predicts the score at `tolerance` (world units) of fusing the scene's noisy depth maps, from
/// `samples` on its exact surface.
///
/// A sample seen by V views is recovered when more than `needed` of them, the sources that must agree, have a
/// usable depth there: a binomial tail with p = (1 − outliers)(1 − holes). The fused depth is the mean of the
/// usable ones, so its error is Gaussian with σ·depth/√n, and right when below the tolerance. Left
/// out: flying pixels, slanted surfaces (whose errors are smaller), pixels that agree by chance, and
/// neighbours that stand in for an unusable pixel: where most surface is seen by hardly more views
/// than must agree, or pixels are much finer than the tolerance, the recall is predicted too low.
pub fn predict(
    scene: &SyntheticScene,
    noise: &DepthNoise,
    needed: usize,
    (samples, tolerance): (&[DVec3], f64),
) -> Prediction {
    let usable = (1.0 - noise.outliers) * (1.0 - noise.holes);
    let (mut recovered, mut right) = (0.0, 0.0);
    for &sample in samples {
        let depths = visible_depths(scene, sample);
        let seen = depths.len();
        if seen == 0 {
            continue;
        }
        #[allow(clippy::cast_precision_loss, reason = "a number of views")]
        let mean_depth = depths.iter().sum::<f64>() / seen as f64;
        for agreeing in needed + 1..=seen {
            let chance = binomial(seen, agreeing, usable);
            #[allow(clippy::cast_precision_loss, reason = "a number of views")]
            let sigma = noise.relative_sigma * mean_depth / (agreeing as f64).sqrt();
            recovered += chance;
            right += chance * within(tolerance, sigma);
        }
    }
    #[allow(clippy::cast_precision_loss, reason = "a number of samples")]
    let recall = right / samples.len().max(1) as f64;
    let precision = if recovered > 0.0 {
        right / recovered
    } else {
        0.0
    };
    Prediction {
        precision,
        recall,
        f_score: mvs_metrics::score::f_score(precision, recall),
    }
}

/// The depths of `sample` in the views that see it, by formula.
fn visible_depths(scene: &SyntheticScene, sample: DVec3) -> Vec<f64> {
    let views = scene.scene().views().iter();
    let depths = views.filter_map(|view| {
        let in_cam = view.pose.to_cam(sample);
        let pixel = view
            .camera
            .project(in_cam)
            .filter(|&pixel| view.camera.contains(pixel))?;
        let first = scene.depth_at(view, pixel)?;
        (first > in_cam.z * (1.0 - SAME_SURFACE)).then_some(in_cam.z)
    });
    depths.collect()
}

/// The probability of `k` successes among `n` at probability `p`.
fn binomial(n: usize, k: usize, p: f64) -> f64 {
    #[allow(clippy::cast_precision_loss, reason = "numbers of views")]
    let ways = (0..k).fold(1.0, |ways, i| ways * (n - i) as f64 / (i + 1) as f64);
    #[allow(
        clippy::cast_possible_truncation,
        clippy::cast_possible_wrap,
        reason = "few views"
    )]
    let (hits, misses) = (k as i32, (n - k) as i32);
    ways * p.powi(hits) * (1.0 - p).powi(misses)
}

/// The probability that a Gaussian of this sigma is within ± `tolerance`.
fn within(tolerance: f64, sigma: f64) -> f64 {
    if sigma > 0.0 {
        libm::erf(tolerance / (sigma * std::f64::consts::SQRT_2))
    } else {
        1.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn binomial_probabilities_sum_to_one() {
        let total: f64 = (0..=12).map(|k| binomial(12, k, 0.93)).sum();
        assert!((total - 1.0).abs() < 1e-12);
        assert!((binomial(4, 2, 0.5) - 0.375).abs() < 1e-15);
    }

    #[test]
    fn one_sigma_holds_68_percent() {
        assert!((within(1.0, 1.0) - 0.682_689_492_137).abs() < 1e-12);
        assert_eq!(within(1.0, 0.0), 1.0);
    }
}
