//! Random numbers that depend on a seed and a stream only, not on any library's distributions.

use libm::{cos, log};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

/// One stream of random numbers.
#[derive(Debug, Clone)]
pub(super) struct Random(ChaCha8Rng);

impl Random {
    /// Stream number `stream` of `seed`; streams are independent.
    pub(super) fn new(seed: u64, stream: u64) -> Self {
        let mut generator = ChaCha8Rng::seed_from_u64(seed);
        generator.set_stream(stream);
        Self(generator)
    }

    /// Uniform over [0, 1), in steps of 2⁻⁵³.
    pub(super) fn unit(&mut self) -> f64 {
        #[allow(clippy::cast_precision_loss, reason = "53 bits fit")]
        let bits = (self.0.next_u64() >> 11) as f64;
        bits * (0.5f64).powi(53)
    }

    /// Uniform over [`low`, `high`).
    pub(super) fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.unit()
    }

    /// Standard normal, by Box and Muller; always consumes two draws.
    pub(super) fn normal(&mut self) -> f64 {
        let radius = (-2.0 * log(1.0 - self.unit())).sqrt();
        radius * cos(std::f64::consts::TAU * self.unit())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn moments_are_those_of_the_distributions() {
        let mut random = Random::new(5, 1);
        let n = 200_000;
        let units: Vec<f64> = (0..n).map(|_| random.unit()).collect();
        let normals: Vec<f64> = (0..n).map(|_| random.normal()).collect();
        let mean = |values: &[f64]| values.iter().sum::<f64>() / f64::from(n);
        let square = |values: &[f64]| values.iter().map(|v| v * v).sum::<f64>() / f64::from(n);
        // Five standard errors of each estimate.
        assert!((mean(&units) - 0.5).abs() < 5.0 * (1.0 / 12.0 / f64::from(n)).sqrt());
        assert!(mean(&normals).abs() < 5.0 * (1.0 / f64::from(n)).sqrt());
        assert!((square(&normals) - 1.0).abs() < 5.0 * (2.0 / f64::from(n)).sqrt());
        assert!(units.iter().all(|&u| (0.0..1.0).contains(&u)));
    }

    #[test]
    fn streams_differ_and_repeat() {
        let draw = |seed, stream| Random::new(seed, stream).unit();
        assert_eq!(draw(1, 2), draw(1, 2));
        assert_ne!(draw(1, 2), draw(1, 3));
        assert_ne!(draw(1, 2), draw(2, 2));
    }
}
