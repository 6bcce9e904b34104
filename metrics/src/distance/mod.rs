//! Nearest distances between point sets, exact in f64.
//!
//! [`BlockIndex`] is the fast way for many queries at once; [`NearestIndex`] is kiddo's tree, for
//! single queries and as the oracle that the fast way is held to, bit by bit.

mod blocks;
mod hilbert;
mod oracle;
mod pairs;
mod search;
mod wide;

pub use blocks::BlockIndex;
pub use oracle::NearestIndex;
pub(crate) use pairs::{PairSums, Tracker};

use crate::error::{Error, Result};
use glam::DVec3;

/// Per point of `a` the distance to its nearest point of `b`, and the reverse, in the order given:
/// one index per cloud serves both. Everything is infinitely far from an empty cloud. An error
/// where a point is not finite and the other cloud is not empty.
pub fn both_ways(a: &[DVec3], b: &[DVec3]) -> Result<(Vec<f64>, Vec<f64>)> {
    if a.is_empty() || b.is_empty() {
        return Ok((vec![f64::INFINITY; a.len()], vec![f64::INFINITY; b.len()]));
    }
    let (a, b) = rayon::join(|| BlockIndex::new(a), || BlockIndex::new(b));
    let (a, b) = (a?, b?);
    Ok((b.distances_from(&a), a.distances_from(&b)))
}

/// dx² + dy² + dz², rounded after each operation in this order: every search here ends in this.
pub(crate) fn squared_distance(a: DVec3, b: DVec3) -> f64 {
    let (dx, dy, dz) = (a.x - b.x, a.y - b.y, a.z - b.z);
    dx * dx + dy * dy + dz * dz
}

/// That there is at least one point, no more than indices reach, and all are finite.
fn check_points(points: &[DVec3]) -> Result<()> {
    let what = "nearest-point index";
    if points.is_empty() {
        return Err(Error::invalid(
            what,
            "expected at least one point, found none",
        ));
    }
    if points.len() >= u32::MAX as usize {
        let problem = format!("expected at most 4294967294 points, found {}", points.len());
        return Err(Error::invalid(what, problem));
    }
    if let Some(index) = points.iter().position(|point| !point.is_finite()) {
        let point = points[index];
        let problem =
            format!("expected finite points, found {point} at {index}: drop such points first");
        return Err(Error::invalid(what, problem));
    }
    Ok(())
}
