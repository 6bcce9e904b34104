//! Cumulative curves over distance, as the Tanks and Temples toolbox bins them.

use crate::tolerance::Tolerance;
use rayon::prelude::*;

/// How far past the tolerance the toolbox plots.
const STRETCH: f64 = 5.0;
/// Bins per tolerance.
const BINS_PER_TOLERANCE: f64 = 100.0;

/// Distances that one thread counts at a time.
const COUNTED: usize = 1 << 16;

/// The fraction of points whose nearest distance falls below each of a row of edges.
///
/// The bins are half open, `edge[i] ≤ d < edge[i + 1]`, the last one is closed.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct Curve {
    edges: Vec<f64>,
    counts: Vec<usize>,
    total: usize,
}

impl Curve {
    /// The toolbox's curve: edges from 0 in steps of τ/100 up to, and not including, 5τ.
    ///
    /// The number of edges is NumPy's for `arange(0, 5τ, τ/100)`: 500, or 501 where the division
    /// rounds up.
    pub fn of(distances: &[f64], tolerance: Tolerance) -> Self {
        let stop = tolerance.get() * STRETCH;
        let step = tolerance.get() / BINS_PER_TOLERANCE;
        Self::over(arange(stop, step), distances)
    }

    /// A curve over ascending finite edges, at least two.
    fn over(edges: Vec<f64>, distances: &[f64]) -> Self {
        let none = || vec![0usize; edges.len().saturating_sub(1)];
        let count = |some: &[f64]| {
            let mut counts = none();
            for bin in some.iter().filter_map(|&distance| bin_of(&edges, distance)) {
                counts[bin] += 1;
            }
            counts
        };
        let sum = |a: Vec<usize>, b: Vec<usize>| a.iter().zip(&b).map(|(a, b)| a + b).collect();
        let mut counts = distances.par_chunks(COUNTED).map(count).reduce(none, sum);
        let mut sum = 0;
        for count in &mut counts {
            sum += *count;
            *count = sum;
        }
        Self {
            edges,
            counts,
            total: distances.len(),
        }
    }

    /// The edges of the bins in world units, one more than there are bins.
    pub fn edges(&self) -> &[f64] {
        &self.edges
    }

    /// Per bin, the points in it and in all bins before it.
    pub fn counts(&self) -> &[usize] {
        &self.counts
    }

    /// How many points there are, in or past the bins.
    pub fn total(&self) -> usize {
        self.total
    }

    /// Per bin, [`Curve::counts`] as a fraction of all points; 0 where there are no points.
    pub fn fractions(&self) -> Vec<f64> {
        let total = self.total.max(1) as f64;
        self.counts
            .iter()
            .map(|&count| count as f64 / total)
            .collect()
    }
}

/// NumPy's `arange(0, stop, step)` for positive arguments. A tolerance near the smallest numbers
/// makes the step 0 or the ratio meaningless; the count is held to what any real one gives.
fn arange(stop: f64, step: f64) -> Vec<f64> {
    let count = (stop / step).ceil().clamp(2.0, 1001.0) as usize;
    (0..count).map(|index| index as f64 * step).collect()
}

fn bin_of(edges: &[f64], distance: f64) -> Option<usize> {
    let (first, last) = (*edges.first()?, *edges.last()?);
    if distance == last {
        return Some(edges.len() - 2);
    }
    if !(first..last).contains(&distance) {
        return None;
    }
    // Where the edges are evenly spaced, as the toolbox's, the first guess is off by one at most.
    let bins = edges.len() - 1;
    let along = (distance - first) / (last - first) * bins as f64;
    let mut bin = (along as usize).min(bins - 1);
    while edges[bin] > distance {
        bin -= 1;
    }
    while edges[bin + 1] <= distance {
        bin += 1;
    }
    Some(bin)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bins_are_half_open_and_the_last_is_closed() {
        let edges = vec![0.0, 1.0, 2.0, 3.0];
        let distances = [0.0, 0.5, 1.0, 2.0, 3.0, 3.5, f64::NAN, f64::INFINITY];
        let curve = Curve::over(edges, &distances);
        assert_eq!(curve.counts(), [2, 3, 5]);
        assert_eq!(curve.fractions(), [0.25, 0.375, 0.625]);
        assert_eq!(curve.total(), 8);
    }

    #[test]
    fn every_bin_is_that_of_a_search_through_the_edges() {
        let edges = arange(5.0 * 0.3, 0.3 / 100.0);
        let mut distances: Vec<f64> = (0..20_000).map(|i| f64::from(i) * 1e-4).collect();
        distances.extend(edges.iter().flat_map(|e| [e.next_down(), *e, e.next_up()]));
        let uneven = vec![0.0, 1e-9, 0.1, 0.100_000_1, 1.9];
        for edges in [edges, uneven] {
            for &distance in &distances {
                let above = edges.partition_point(|&edge| edge <= distance);
                let mut expected = (above > 0 && above < edges.len()).then(|| above - 1);
                if Some(&distance) == edges.last() {
                    expected = Some(edges.len() - 2);
                }
                assert_eq!(bin_of(&edges, distance), expected, "{distance}");
            }
        }
    }

    #[test]
    fn edges_stop_before_five_tolerances() {
        let curve = Curve::of(&[0.0], Tolerance::new(1.0).unwrap());
        assert_eq!(curve.edges().len(), 500);
        assert_eq!(curve.edges()[100], 1.0);
        assert_eq!(curve.edges()[499], 499.0 * 0.01);
        assert_eq!(curve.counts().len(), 499);
    }

    #[test]
    fn no_points_and_tiny_tolerances_are_plain_zeros() {
        let curve = Curve::of(&[], Tolerance::new(1e-150).unwrap());
        assert!(curve.fractions().iter().all(|&fraction| fraction == 0.0));
    }
}
