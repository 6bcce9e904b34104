//! Nearest points by kiddo's tree: the crate's only user of kiddo.

use super::{Order, check_points, listed, squared_distance};
use crate::error::{Error, Result};
use glam::DVec3;
use kiddo::{ImmutableKdTree, SquaredEuclidean};
use rayon::prelude::*;

/// An index over points that answers which one is nearest, exactly, in f64.
pub struct NearestIndex {
    tree: ImmutableKdTree<f64, 3>,
    points: Vec<DVec3>,
}

impl std::fmt::Debug for NearestIndex {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "NearestIndex of {} points", self.points.len())
    }
}

impl NearestIndex {
    /// An index over `points`: at least one, all finite, at most 2³² − 2. Equal points are fine.
    ///
    /// # Errors
    /// No points, more than 2³² − 2, one that is not finite, and what kiddo refuses to index.
    pub fn new(points: &[DVec3]) -> Result<Self> {
        check_points(&listed(points, Order::Any))?;
        let rows: Vec<[f64; 3]> = points.iter().map(|point| point.to_array()).collect();
        let tree = ImmutableKdTree::new_from_slice(&rows)
            .map_err(|error| Error::invalid("nearest-point index", error.to_string()))?;
        Ok(Self {
            tree,
            points: points.to_vec(),
        })
    }

    /// How many points are indexed, at least one.
    #[allow(clippy::len_without_is_empty)] // never empty
    pub fn len(&self) -> usize {
        self.points.len()
    }

    /// The indexed points, in the order given.
    pub fn points(&self) -> &[DVec3] {
        &self.points
    }

    /// The index of a nearest point and the Euclidean distance to it. Nothing is near a query with
    /// NaN or infinity: its distance is infinite, and the index means nothing.
    pub fn nearest(&self, query: DVec3) -> (usize, f64) {
        if !query.is_finite() {
            return (0, f64::INFINITY);
        }
        let found = self
            .tree
            .query(&query.to_array())
            .nearest_one::<SquaredEuclidean<f64>>()
            .execute();
        let index = found.item as usize;
        (index, squared_distance(query, self.points[index]).sqrt())
    }

    /// The distance from each query to its nearest point, in the order of the queries.
    pub fn distances(&self, queries: &[DVec3]) -> Vec<f64> {
        queries
            .par_iter()
            .map(|&query| self.nearest(query).1)
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::align::tests::scattered;

    fn brute(points: &[DVec3], query: DVec3) -> f64 {
        let squares = points.iter().map(|&point| squared_distance(query, point));
        squares.fold(f64::INFINITY, f64::min).sqrt()
    }

    #[test]
    fn distances_are_those_of_trying_every_point() {
        let points = scattered(1, 700);
        let queries = scattered(2, 300);
        let index = NearestIndex::new(&points).unwrap();
        for (&query, distance) in queries.iter().zip(index.distances(&queries)) {
            assert_eq!(distance, brute(&points, query));
            let (nearest, same) = index.nearest(query);
            assert_eq!(same, distance);
            assert_eq!(squared_distance(points[nearest], query).sqrt(), distance);
        }
    }

    #[test]
    fn degenerate_sets_are_indexed() {
        let sets = [
            vec![DVec3::ONE; 5000],
            (0..5000).map(|i| DVec3::X * f64::from(i)).collect(),
            (0..5000)
                .map(|i| DVec3::new(f64::from(i % 70), f64::from(i / 70), 0.0))
                .collect(),
            vec![DVec3::new(5e5, 4e6, 1e2)],
        ];
        for points in sets {
            let index = NearestIndex::new(&points).unwrap();
            for query in scattered(3, 50) {
                assert_eq!(index.nearest(query).1, brute(&points, query));
            }
        }
    }

    #[test]
    fn nothing_and_non_finite_points_are_refused() {
        let none = NearestIndex::new(&[]).unwrap_err().to_string();
        assert!(none.contains("found none"), "{none}");
        let nan = NearestIndex::new(&[DVec3::ZERO, DVec3::NAN]);
        assert!(nan.unwrap_err().to_string().contains("at 1"));
    }

    #[test]
    fn nothing_is_near_a_query_that_is_not_finite() {
        let index = NearestIndex::new(&[DVec3::ZERO]).unwrap();
        for bad in [DVec3::NAN, DVec3::INFINITY, DVec3::new(0.0, f64::NAN, 0.0)] {
            assert_eq!(index.distances(&[bad]), [f64::INFINITY]);
        }
    }
}
