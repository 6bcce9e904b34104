//! Points in Hilbert order, packed in blocks of sixteen under a tree of boxes.

use super::hilbert::{CHUNK, Frame, Placed};
use super::search::search;
use super::{check_points, hilbert};
use crate::error::Result;
use glam::DVec3;
use rayon::prelude::*;

/// Points of a block, and queries searched together.
pub(super) const LANES: usize = 16;
/// Boxes of a tree node.
pub(super) const FANOUT: usize = 8;
/// Query groups that one thread searches at a time.
const GROUPS: usize = 64;

/// The lower and the upper corner of a box.
pub(super) type Corners = (DVec3, DVec3);
/// The box of nothing.
const NOWHERE: Corners = (DVec3::INFINITY, DVec3::NEG_INFINITY);

/// Sixteen neighbouring points as columns. A last, short block repeats its last point.
#[derive(Debug, Clone)]
#[repr(align(64))]
pub(super) struct Block {
    pub(super) x: [f64; LANES],
    pub(super) y: [f64; LANES],
    pub(super) z: [f64; LANES],
}

impl Block {
    const EMPTY: Self = Self {
        x: [0.0; LANES],
        y: [0.0; LANES],
        z: [0.0; LANES],
    };

    pub(super) fn set(&mut self, lane: usize, at: DVec3) {
        (self.x[lane], self.y[lane], self.z[lane]) = (at.x, at.y, at.z);
    }

    pub(super) fn point(&self, lane: usize) -> DVec3 {
        DVec3::new(self.x[lane], self.y[lane], self.z[lane])
    }

    /// The corners of the box around the points.
    pub(super) fn bounds(&self) -> Corners {
        let points = || (0..LANES).map(|lane| self.point(lane));
        (
            points().fold(DVec3::INFINITY, DVec3::min),
            points().fold(DVec3::NEG_INFINITY, DVec3::max),
        )
    }
}

/// The boxes of eight neighbouring children as columns: blocks, or nodes of the level below.
/// A missing child has a box that nothing is near: its minimum is ∞, its maximum −∞.
#[derive(Debug, Clone)]
#[repr(align(64))]
pub(super) struct Node {
    pub(super) min: [[f64; FANOUT]; 3],
    pub(super) max: [[f64; FANOUT]; 3],
}

impl Node {
    fn over(children: &[Corners]) -> Self {
        let child = |k: usize| children.get(k).copied().unwrap_or(NOWHERE);
        Self {
            min: std::array::from_fn(|axis| std::array::from_fn(|k| child(k).0[axis])),
            max: std::array::from_fn(|axis| std::array::from_fn(|k| child(k).1[axis])),
        }
    }

    /// The corners of a child's box.
    pub(super) fn child(&self, k: usize) -> Corners {
        (
            DVec3::from(self.min.map(|column| column[k])),
            DVec3::from(self.max.map(|column| column[k])),
        )
    }
}

/// Points in blocks of neighbours.
#[derive(Debug)]
struct Packed {
    blocks: Vec<Block>,
    /// Per place in the blocks, the index of the point as given.
    order: Vec<u32>,
    /// Per chunk of 64 blocks the frame's number of a point in it, ascending.
    keys: Vec<u32>,
}

impl Packed {
    /// The `points`, all finite, on the curve through `frame`, and each chunk of them as a tree.
    fn new(points: &[DVec3], frame: &Frame) -> Self {
        let mut order = hilbert::order(points, frame);
        let mut blocks = vec![Block::EMPTY; order.len().div_ceil(LANES)];
        let keys = order
            .par_chunks_mut(CHUNK)
            .zip(blocks.par_chunks_mut(CHUNK / LANES))
            .map_init(Vec::new, |placed, (order, blocks)| {
                let key = frame.key(points[order[0] as usize]);
                pack(points, order, blocks, placed);
                key
            })
            .collect();
        Self {
            blocks,
            order,
            keys,
        }
    }

    /// One value per place in the blocks, brought to the order of the points as given.
    fn as_given(&self, values: &[[f64; LANES]], value: impl Fn(f64) -> f64) -> Vec<f64> {
        let mut given = vec![0.0; self.order.len()];
        for (&index, &found) in self.order.iter().zip(values.as_flattened()) {
            given[index as usize] = value(found);
        }
        given
    }
}

/// Splits one chunk of the order as a tree and fills its blocks.
fn pack(points: &[DVec3], order: &mut [u32], blocks: &mut [Block], placed: &mut Vec<Placed>) {
    placed.clear();
    placed.extend(order.iter().map(|&index| Placed {
        at: points[index as usize],
        index,
    }));
    hilbert::split(placed);
    for (index, placed) in order.iter_mut().zip(placed.iter()) {
        *index = placed.index;
    }
    for (block, points) in blocks.iter_mut().zip(placed.chunks(LANES)) {
        for lane in 0..LANES {
            block.set(lane, points[lane.min(points.len() - 1)].at);
        }
    }
}

/// An index over points for many queries at once.
///
/// Points and queries are put in Hilbert order; sixteen neighbouring queries walk a tree of boxes
/// together and meet blocks of sixteen points. Distances are those of [`super::NearestIndex`], bit
/// by bit, at any number of threads.
#[derive(Debug)]
pub struct BlockIndex {
    points: Packed,
    /// The boxes of the blocks first, the root last.
    levels: Vec<Vec<Node>>,
    frame: Frame,
}

impl BlockIndex {
    /// An index over `points`: at least one, all finite, at most 2³² − 2. Equal points are fine.
    pub fn new(points: &[DVec3]) -> Result<Self> {
        check_points(points)?;
        let frame = Frame::of(points);
        let points = Packed::new(points, &frame);
        let mut boxes: Vec<Corners> = points.blocks.par_iter().map(Block::bounds).collect();
        let mut levels = Vec::new();
        while levels.is_empty() || boxes.len() > 1 {
            levels.push(boxes.par_chunks(FANOUT).map(Node::over).collect());
            boxes = boxes.par_chunks(FANOUT).map(union).collect();
        }
        Ok(Self {
            points,
            levels,
            frame,
        })
    }

    /// How many points are indexed, at least one.
    #[allow(clippy::len_without_is_empty, reason = "never empty")]
    pub fn len(&self) -> usize {
        self.points.order.len()
    }

    /// The distance from each query to its nearest point, in the order of the queries. Nothing is
    /// near a query with NaN or infinity: its distance is infinite.
    pub fn distances(&self, queries: &[DVec3]) -> Vec<f64> {
        self.distances_below(queries, f64::INFINITY)
    }

    /// As [`BlockIndex::distances`], but where the nearest point is not nearer than `bound` the
    /// distance is infinite: the search stops there.
    pub fn distances_below(&self, queries: &[DVec3], bound: f64) -> Vec<f64> {
        if queries.iter().all(|query| query.is_finite()) {
            return self.search(&Packed::new(queries, &self.frame), bound);
        }
        let is_finite = |&index: &usize| queries[index].is_finite();
        let kept: Vec<usize> = (0..queries.len()).filter(is_finite).collect();
        let finite: Vec<DVec3> = kept.iter().map(|&index| queries[index]).collect();
        let found = self.search(&Packed::new(&finite, &self.frame), bound);
        let mut distances = vec![f64::INFINITY; queries.len()];
        for (index, found) in kept.into_iter().zip(found) {
            distances[index] = found;
        }
        distances
    }

    /// The distance from each point of `queries` to the nearest of these points, in the order in
    /// which the queries were given to their index: cheaper than [`BlockIndex::distances`] where
    /// both clouds have an index anyway.
    pub fn distances_from(&self, queries: &Self) -> Vec<f64> {
        self.search(&queries.points, f64::INFINITY)
    }

    fn search(&self, queries: &Packed, bound: f64) -> Vec<f64> {
        // One rounding above the bound's square: no distance below the bound is missed.
        let square = (bound * bound).next_up();
        let found: Vec<[f64; LANES]> = queries
            .blocks
            .par_iter()
            .with_min_len(GROUPS)
            .map(|group| search(self, group, [square; LANES]))
            .collect();
        queries.as_given(&found, |square| {
            let distance = square.sqrt();
            if distance < bound {
                distance
            } else {
                f64::INFINITY
            }
        })
    }

    /// The points in blocks along this index's curve; of a short last block as many as there are.
    pub(super) fn blocks_of(&self, points: &[DVec3]) -> Vec<Block> {
        Packed::new(points, &self.frame).blocks
    }

    pub(super) fn block(&self, number: usize) -> &Block {
        &self.points.blocks[number]
    }

    pub(super) fn levels(&self) -> &[Vec<Node>] {
        &self.levels
    }

    /// The chunk of 64 blocks, a node of the second level, in which the curve passes a place.
    pub(super) fn chunk_at(&self, place: DVec3) -> usize {
        let key = self.frame.key(place);
        let after = self.points.keys.partition_point(|&first| first <= key);
        after.saturating_sub(1)
    }
}

fn union(boxes: &[Corners]) -> Corners {
    let wider = |a: Corners, b: &Corners| (a.0.min(b.0), a.1.max(b.1));
    boxes.iter().fold(NOWHERE, wider)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::align::tests::scattered;
    use crate::distance::NearestIndex;

    fn assert_as_oracle(points: &[DVec3], queries: &[DVec3], place: &str) {
        let expected = NearestIndex::new(points).unwrap().distances(queries);
        let index = BlockIndex::new(points).unwrap();
        assert_eq!(index.distances(queries), expected, "{place}");
        let bound = expected[expected.len() / 2];
        let below = index.distances_below(queries, bound);
        for (below, expected) in below.into_iter().zip(expected) {
            let wanted = if expected < bound {
                expected
            } else {
                f64::INFINITY
            };
            assert_eq!(below, wanted, "{place} below {bound}");
        }
    }

    fn flattened(points: &[DVec3]) -> Vec<DVec3> {
        points
            .iter()
            .map(|p| DVec3::new(p.x, p.y, p.x * 0.25))
            .collect()
    }

    #[test]
    fn distances_are_the_oracles_bit_by_bit() {
        let points = scattered(30, 20_001);
        let queries = scattered(31, 7_003);
        assert_as_oracle(&points, &queries, "volume");
        assert_as_oracle(&flattened(&points), &flattened(&queries), "surface");
        assert_as_oracle(&flattened(&points), &queries, "volume on surface");
        assert_as_oracle(&points[..1], &queries, "one point");
        assert_as_oracle(&points[..17], &queries[..1], "one query");
        assert_as_oracle(&points, &points, "itself");
    }
}
