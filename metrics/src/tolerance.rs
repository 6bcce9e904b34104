//! The distance below which a point counts as right.

use crate::error::{Error, Result};

/// A distance threshold τ in world units: finite and above 0.
#[derive(Debug, Clone, Copy, PartialEq, PartialOrd, serde::Serialize)]
#[serde(transparent)]
pub struct Tolerance(f64);

impl Tolerance {
    /// A tolerance of `distance` world units.
    pub fn new(distance: f64) -> Result<Self> {
        if distance.is_finite() && distance > 0.0 {
            return Ok(Self(distance));
        }
        let problem = format!("expected a finite distance above 0, found {distance}");
        Err(Error::invalid("tolerance", problem))
    }

    /// The distance in world units.
    pub fn get(self) -> f64 {
        self.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_finite_distances_above_zero_pass() {
        for bad in [0.0, -1.0, f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            assert!(Tolerance::new(bad).is_err(), "{bad}");
        }
        assert_eq!(Tolerance::new(5e-324).unwrap().get(), 5e-324);
    }
}
