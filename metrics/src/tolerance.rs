//! The distance below which a point counts as right.

use crate::error::{Error, Result};

/// A distance threshold τ in world units: above 0, from 1e-150 to 1e150, so that its square and what few
/// times it makes are plain numbers.
#[derive(Debug, Clone, Copy, PartialEq, PartialOrd, serde::Serialize)]
#[serde(transparent)]
pub struct Tolerance(f64);

impl Tolerance {
    /// A tolerance of `distance` world units.
    ///
    /// # Errors
    /// A distance that is not from 1e-150 to 1e150.
    pub fn new(distance: f64) -> Result<Self> {
        if (1e-150..=1e150).contains(&distance) {
            return Ok(Self(distance));
        }
        let problem =
            format!("expected a distance above 0, from 1e-150 to 1e150, found {distance:?}");
        Err(Error::invalid("tolerance", problem))
    }

    /// A tolerance so many times as far, which may lie a little beyond what [`Self::new`] takes.
    pub fn times(self, factor: f64) -> Self {
        Self(factor * self.0)
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
        for end in [1e-150, 1e150] {
            assert_eq!(Tolerance::new(end).unwrap().get(), end);
            // What is worked out from it is a plain number: squares, voxels, curves.
            assert!((end * end).is_normal() && (25.0 * end * end).is_normal());
        }
        for bad in [9e-151, 1.1e150, 5e-324, 1e308] {
            let said = Tolerance::new(bad).unwrap_err().to_string();
            let expected = "a distance above 0, from 1e-150 to 1e150, found";
            assert!(said.contains(expected) && said.len() < 100, "{said}");
        }
    }
}
