//! Point-to-point ICP with scale, as Open3D's `registration_icp` runs it.

use super::transformed;
use super::umeyama::{Scale, umeyama};
use crate::distance::{NearestIndex, squared_distance};
use crate::error::{Error, Result};
use glam::{DMat4, DVec3};

/// When ICP pairs points and when it stops.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct IcpOptions {
    /// Points further apart than this, in world units, are no pair. Above 0.
    pub max_distance: f64,
    /// Stop when the fitness changes by less than this, and
    pub relative_fitness: f64,
    /// the RMSE of the pairs, in world units, by less than this.
    pub relative_rmse: f64,
    /// Updates at most.
    pub max_iterations: usize,
}

impl IcpOptions {
    /// Open3D's own criteria: 1e-6, 1e-6, 30 updates.
    pub fn new(max_distance: f64) -> Self {
        Self {
            max_distance,
            relative_fitness: 1e-6,
            relative_rmse: 1e-6,
            max_iterations: 30,
        }
    }
}

/// How well the moved source lies on the target, and the motion found.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Icp {
    /// The similarity that moves the source onto the target.
    pub target_from_source: DMat4,
    /// Pairs over source points, in [0, 1].
    pub fitness: f64,
    /// Root of the mean squared distance of the pairs, in world units; 0 without pairs.
    pub inlier_rmse: f64,
    /// Pairs closer than the maximal distance.
    pub pairs: usize,
    /// Updates made.
    pub iterations: usize,
    /// Whether the last update changed fitness and RMSE by less than the criteria.
    pub converged: bool,
}

/// Moves `source` onto `target` by similarities, starting from where it is.
///
/// An error where either cloud is empty or not finite, or the pairs of some update coincide so that
/// no scale fits. Without any pair the result is the identity with fitness 0.
pub fn icp(source: &[DVec3], target: &[DVec3], options: &IcpOptions) -> Result<Icp> {
    check(source, options)?;
    let index = NearestIndex::new(target)?;
    let mut moved = source.to_vec();
    let mut pairing = Pairing::find(&moved, &index, options.max_distance);
    let mut result = pairing.result(DMat4::IDENTITY, 0);
    while result.iterations < options.max_iterations && !result.converged {
        let update = pairing.update()?;
        moved = transformed(&moved, update);
        pairing = Pairing::find(&moved, &index, options.max_distance);
        let next = pairing.result(update * result.target_from_source, result.iterations + 1);
        result = Icp {
            converged: close(&result, &next, options),
            ..next
        };
    }
    Ok(result)
}

fn close(before: &Icp, after: &Icp, options: &IcpOptions) -> bool {
    (before.fitness - after.fitness).abs() < options.relative_fitness
        && (before.inlier_rmse - after.inlier_rmse).abs() < options.relative_rmse
}

fn check(source: &[DVec3], options: &IcpOptions) -> Result<()> {
    if source.is_empty() {
        return Err(Error::invalid("ICP", "expected source points, found none"));
    }
    if let Some(index) = source.iter().position(|point| !point.is_finite()) {
        let problem = format!(
            "expected finite source points, found {} at {index}",
            source[index]
        );
        return Err(Error::invalid("ICP", problem));
    }
    if !(options.max_distance.is_finite() && options.max_distance > 0.0) {
        let found = options.max_distance;
        let problem = format!("expected a finite maximal distance above 0, found {found}");
        return Err(Error::invalid("ICP", problem));
    }
    Ok(())
}

/// The source points that have a target point near enough, beside it.
struct Pairing {
    source: Vec<DVec3>,
    target: Vec<DVec3>,
    squares: f64,
    asked: usize,
}

impl Pairing {
    fn find(moved: &[DVec3], index: &NearestIndex, max_distance: f64) -> Self {
        let mut pairing = Self {
            source: Vec::new(),
            target: Vec::new(),
            squares: 0.0,
            asked: moved.len(),
        };
        for &point in moved {
            let nearest = index.points()[index.nearest(point).0];
            let square = squared_distance(point, nearest);
            if square < max_distance * max_distance {
                pairing.source.push(point);
                pairing.target.push(nearest);
                pairing.squares += square;
            }
        }
        pairing
    }

    fn result(&self, target_from_source: DMat4, iterations: usize) -> Icp {
        let pairs = self.source.len();
        Icp {
            target_from_source,
            fitness: pairs as f64 / self.asked as f64,
            inlier_rmse: (self.squares / pairs.max(1) as f64).sqrt(),
            pairs,
            iterations,
            converged: false,
        }
    }

    fn update(&self) -> Result<DMat4> {
        if self.source.is_empty() {
            return Ok(DMat4::IDENTITY);
        }
        umeyama(&self.source, &self.target, Scale::Free)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::align::tests::scattered;
    use crate::align::umeyama::tests::similarity;

    #[test]
    fn a_small_motion_is_undone() {
        let target = scattered(7, 2000);
        let truth = similarity(1.01, 0.01, DVec3::new(0.01, -0.005, 0.0));
        let source = transformed(&target, truth.inverse());
        let options = IcpOptions {
            relative_fitness: 1e-12,
            relative_rmse: 1e-12,
            max_iterations: 200,
            ..IcpOptions::new(0.2)
        };
        let found = icp(&source, &target, &options).unwrap();
        assert!(found.converged && found.pairs == 2000 && found.fitness == 1.0);
        assert!(found.target_from_source.abs_diff_eq(truth, 1e-12));
        assert!(found.inlier_rmse < 1e-12);
    }

    #[test]
    fn clouds_without_pairs_stay_where_they_are() {
        let source = scattered(8, 100);
        let target: Vec<DVec3> = source.iter().map(|p| *p + DVec3::X * 100.0).collect();
        let found = icp(&source, &target, &IcpOptions::new(0.1)).unwrap();
        assert_eq!(found.target_from_source, DMat4::IDENTITY);
        assert_eq!(
            (found.fitness, found.inlier_rmse, found.pairs),
            (0.0, 0.0, 0)
        );
    }

    #[test]
    fn a_pair_at_exactly_the_maximal_distance_is_none() {
        let found = icp(&[DVec3::X], &[DVec3::ZERO], &IcpOptions::new(1.0)).unwrap();
        assert_eq!(found.pairs, 0);
    }

    #[test]
    fn bad_input_is_refused() {
        let points = scattered(9, 10);
        let options = IcpOptions::new(1.0);
        assert!(icp(&[], &points, &options).is_err());
        assert!(icp(&points, &[], &options).is_err());
        assert!(icp(&[DVec3::NAN], &points, &options).is_err());
        assert!(icp(&points, &points, &IcpOptions::new(0.0)).is_err());
    }
}
