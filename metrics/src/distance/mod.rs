//! Nearest distances between point sets, exact in f64.
//!
//! [`BlockIndex`] is the fast way for many queries at once; [`NearestIndex`] is kiddo's tree, for
//! single queries and as the oracle that the fast way is held to, bit by bit.

mod asked;
mod blocks;
mod frame;
pub(crate) mod hilbert;
mod oracle;
mod packing;
mod pairs;
mod partners;
mod search;
mod split;
mod sums;
mod together;
pub(crate) mod wide;

pub use blocks::BlockIndex;
pub use oracle::NearestIndex;
pub use packing::Coordinate;
pub use pairs::Source;
pub(crate) use pairs::Tracker;
pub(crate) use sums::PairSums;

use crate::error::{Error, Result};
use glam::DVec3;
use rayon::prelude::*;

/// What is known of the order of points in a list.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Order {
    /// Nothing.
    Any,
    /// Neighbours in space are mostly neighbours in the list too, as [`crate::downsample::voxel`]
    /// leaves them.
    Spatial,
}

/// Points that a function gives by their index, each several times: no list of them need exist.
#[derive(Debug, Clone, Copy)]
pub struct Listed<F> {
    /// How many.
    pub count: usize,
    /// The point of an index below the count.
    pub at: F,
    /// What is known of their order.
    pub order: Order,
}

/// Takes points stretch by stretch.
pub type Take<'a> = dyn FnMut(&[DVec3]) -> Result<()> + 'a;

/// The points of a slice.
pub fn listed(points: &[DVec3], order: Order) -> Listed<impl Fn(usize) -> DVec3 + Sync> {
    Listed {
        count: points.len(),
        at: |index| points[index],
        order,
    }
}

/// The indices of finite points, at most 2³² − 1, along a curve on which neighbours are neighbours
/// in space. Points in the same place stay in order.
pub fn spatial_order(points: &[DVec3]) -> Vec<u32> {
    hilbert::order(points.len(), &|index| points[index])
}

/// Per point of `a` the distance to its nearest point of `b`, and the reverse, in the order given:
/// one index per cloud serves both. Everything is infinitely far from an empty cloud.
///
/// # Errors
/// A point that is not finite and more than 2³² − 2 points, where neither cloud is empty.
pub fn both_ways(a: &[DVec3], b: &[DVec3]) -> Result<(Vec<f64>, Vec<f64>)> {
    if a.is_empty() || b.is_empty() {
        let far = |points: &[DVec3]| vec![f64::INFINITY; points.len()];
        return Ok((far(a), far(b)));
    }
    let [a, b] = indices(Order::Any, [a, b])?;
    Ok((b.distances_from(&a), a.distances_from(&b)))
}

/// As [`both_ways`], for lists in a known order, which come back beside the distances of their
/// points. Between, only the indices are in memory.
///
/// # Errors
/// As [`both_ways`].
pub fn both_ways_in(order: Order, lists: [Vec<DVec3>; 2]) -> Result<[(Vec<DVec3>, Vec<f64>); 2]> {
    if lists.iter().any(Vec::is_empty) {
        return Ok(lists.map(|points| {
            let distances = vec![f64::INFINITY; points.len()];
            (points, distances)
        }));
    }
    let [a, b] = indices(order, lists)?;
    let (from_a, from_b) = (b.distances_from(&a), a.distances_from(&b));
    let points = |index: BlockIndex| index.pieces().flatten().collect();
    Ok([(points(a), from_a), (points(b), from_b)])
}

/// The indices of two lists, each of which goes when its index is there.
fn indices<P: AsRef<[DVec3]> + Send>(order: Order, [a, b]: [P; 2]) -> Result<[BlockIndex; 2]> {
    let index = |points: P| BlockIndex::of(&listed(points.as_ref(), order));
    let (a, b) = rayon::join(|| index(a), || index(b));
    Ok([a?, b?])
}

/// Points that one thread checks at a time.
const CHECKED: usize = 1 << 14;

/// dx² + dy² + dz², rounded after each operation in this order: every search here ends in this.
pub(crate) fn squared_distance(a: DVec3, b: DVec3) -> f64 {
    let (dx, dy, dz) = (a.x - b.x, a.y - b.y, a.z - b.z);
    dx * dx + dy * dy + dz * dz
}

/// That there is at least one point, no more than indices reach, and all are finite.
fn check_points(points: &Listed<impl Fn(usize) -> DVec3 + Sync>) -> Result<()> {
    let what = "nearest-point index";
    if points.count == 0 {
        return Err(Error::invalid(
            what,
            "expected at least one point, found none",
        ));
    }
    if points.count >= u32::MAX as usize {
        let problem = format!("expected at most 4294967294 points, found {}", points.count);
        return Err(Error::invalid(what, problem));
    }
    let is_wrong = |index: &usize| !(points.at)(*index).is_finite();
    let chunks = (0..points.count.div_ceil(CHECKED)).into_par_iter();
    let found = chunks.find_map_first(|chunk| {
        let first = chunk * CHECKED;
        (first..points.count.min(first + CHECKED)).find(is_wrong)
    });
    if let Some(index) = found {
        let point = (points.at)(index);
        let problem =
            format!("expected finite points, found {point} at {index}: drop such points first");
        return Err(Error::invalid(what, problem));
    }
    Ok(())
}
