//! Points in Hilbert order, packed in blocks of sixteen under a tree of boxes.

use super::hilbert::CHUNK;
use super::packing::{Coordinate, Given, Keep, Packing, Place, pack};
use super::search::{Squares, larger, smaller, square_of};
use super::together::{Neighbourhood, TOGETHER};
use super::wide::{self, Registers};
use super::{Listed, Order, Take, check_points, listed};
use crate::error::Result;
use glam::DVec3;
use rayon::prelude::*;

/// Points of a block, and queries searched together.
pub(super) const LANES: usize = 16;
/// Boxes of a tree node.
pub(super) const FANOUT: usize = 8;
/// Query groups that one thread searches at a time, each with a hint from the one before.
const GROUPS: usize = 256;

/// The lower and the upper corner of a box.
pub(super) type Corners = (DVec3, DVec3);
/// The box of nothing.
pub(super) const NOWHERE: Corners = (DVec3::INFINITY, DVec3::NEG_INFINITY);

/// The box around both.
pub(super) fn wider(a: Corners, b: Corners) -> Corners {
    (a.0.min(b.0), a.1.max(b.1))
}

/// The least and the largest of a column.
#[allow(
    clippy::needless_range_loop,
    reason = "one index runs over three arrays"
)]
#[inline(always)]
fn range(column: &[f64; LANES]) -> (f64, f64) {
    let (mut least, mut largest) = ([column[0]; 4], [column[0]; 4]);
    for first in (0..LANES).step_by(4) {
        for k in 0..4 {
            least[k] = smaller(column[first + k], least[k]);
            largest[k] = larger(column[first + k], largest[k]);
        }
    }
    (
        smaller(smaller(least[0], least[1]), smaller(least[2], least[3])),
        larger(
            larger(largest[0], largest[1]),
            larger(largest[2], largest[3]),
        ),
    )
}

/// The box and a point that is not NaN.
#[inline(always)]
pub(super) fn around((min, max): Corners, point: DVec3) -> Corners {
    (
        DVec3::new(
            smaller(point.x, min.x),
            smaller(point.y, min.y),
            smaller(point.z, min.z),
        ),
        DVec3::new(
            larger(point.x, max.x),
            larger(point.y, max.y),
            larger(point.z, max.z),
        ),
    )
}

/// Sixteen neighbouring points as columns. A last, short block repeats its last point.
#[derive(Debug, Clone)]
#[repr(align(64))]
pub(crate) struct Block<C = f64> {
    pub(super) x: [C; LANES],
    pub(super) y: [C; LANES],
    pub(super) z: [C; LANES],
}

impl<C: Coordinate> Place for Block<C> {
    const EMPTY: Self = Self {
        x: [C::ZERO; LANES],
        y: [C::ZERO; LANES],
        z: [C::ZERO; LANES],
    };

    fn set(&mut self, lane: usize, at: DVec3) {
        (self.x[lane], self.y[lane], self.z[lane]) = (C::of(at.x), C::of(at.y), C::of(at.z));
    }
}

impl<C: Coordinate> Block<C> {
    #[inline(always)]
    pub(super) fn point(&self, lane: usize) -> DVec3 {
        DVec3::new(
            self.x[lane].wide(),
            self.y[lane].wide(),
            self.z[lane].wide(),
        )
    }
}

impl Block {
    /// The corners of the box around the points, all finite.
    #[inline(always)]
    pub(super) fn bounds(&self) -> Corners {
        let (x, y, z) = (range(&self.x), range(&self.y), range(&self.z));
        (DVec3::new(x.0, y.0, z.0), DVec3::new(x.1, y.1, z.1))
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
    /// Whether all points of a child are in one place, so that any of its blocks says all.
    #[inline(always)]
    pub(super) fn is_place(&self, k: usize) -> bool {
        (0..3).all(|axis| self.min[axis][k] == self.max[axis][k])
    }

    fn over(children: &[Corners]) -> Self {
        let child = |k: usize| children.get(k).copied().unwrap_or(NOWHERE);
        Self {
            min: std::array::from_fn(|axis| std::array::from_fn(|k| child(k).0[axis])),
            max: std::array::from_fn(|axis| std::array::from_fn(|k| child(k).1[axis])),
        }
    }
}

impl Node {
    /// The corners of a child's box.
    #[inline(always)]
    pub(super) fn child(&self, k: usize) -> Corners {
        (
            DVec3::from(self.min.map(|column| column[k])),
            DVec3::from(self.max.map(|column| column[k])),
        )
    }
}

/// Points in blocks of neighbours.
#[derive(Debug, Clone)]
struct Packed<C = f64> {
    blocks: Vec<Block<C>>,
    given: Given,
    count: usize,
}

impl<C: Coordinate> Packed<C> {
    fn new<F: Fn(usize) -> DVec3 + Sync>(points: &Listed<F>) -> Self {
        let mut blocks = vec![Block::EMPTY; points.count.div_ceil(LANES)];
        let given = pack(points, &mut blocks);
        let count = points.count;
        Self {
            blocks,
            given,
            count,
        }
    }
}

/// An index over points for many queries at once.
///
/// Points and queries are put in Hilbert order; sixteen neighbouring queries walk a tree of boxes
/// together and meet blocks of sixteen points. Distances are those of [`super::NearestIndex`], bit
/// by bit, at any number of threads. Coordinates that are f32 can be kept as such.
#[derive(Debug, Clone)]
pub struct BlockIndex<C = f64> {
    points: Packed<C>,
    /// The boxes of the blocks first, the root last.
    levels: Vec<Vec<Node>>,
}

impl BlockIndex {
    /// An index over `points`: at least one, all finite, at most 2³² − 2. Equal points are fine.
    ///
    /// # Errors
    /// No points, more than 2³² − 2, and one that is not finite.
    pub fn new(points: &[DVec3]) -> Result<Self> {
        Self::of(&listed(points, Order::Any))
    }

    /// As [`BlockIndex::new`]. Of points in spatial order the order is taken over, not made.
    ///
    /// # Errors
    /// As [`BlockIndex::new`].
    pub fn of<F: Fn(usize) -> DVec3 + Sync>(points: &Listed<F>) -> Result<Self> {
        check_points(points)?;
        Ok(Self::over(Packed::new(points)))
    }

    /// As [`BlockIndex::of`], for points in spatial order, `most` or fewer, that `feed` brings in
    /// stretches of any length: no list of all of them need exist. `None` without points.
    ///
    /// # Errors
    /// What `feed` returns: its own errors, and those that it is given for points that are not finite.
    pub fn gathered(
        most: usize,
        feed: impl FnOnce(&mut Take<'_>) -> Result<()>,
    ) -> Result<Option<Self>> {
        Self::gather(Packing::new(Keep::Order, most), feed)
    }

    /// The points in the order given, piece by piece.
    pub fn pieces(&self) -> impl Iterator<Item = Vec<DVec3>> + '_ {
        let Packed {
            blocks,
            given,
            count,
        } = &self.points;
        let piece = match given {
            Given::InChunk(_) => CHUNK,
            _ => *count,
        };
        (0..*count).step_by(piece).map(move |first| {
            let end = (first + piece).min(*count);
            let place = |place: usize| blocks[place / LANES].point(place % LANES);
            given.order_piece(first, (first..end).map(place).collect())
        })
    }

    /// The distance from each query to its nearest point, in the order of the queries. Nothing is
    /// near a query with NaN or infinity: its distance is infinite.
    pub fn distances(&self, queries: &[DVec3]) -> Vec<f64> {
        self.distances_below(queries, f64::INFINITY)
    }

    /// As [`BlockIndex::distances`], but where the nearest point is not nearer than `bound` the
    /// distance is infinite: the search stops there.
    pub fn distances_below(&self, queries: &[DVec3], bound: f64) -> Vec<f64> {
        if u32::try_from(queries.len()).is_err() {
            let parts = queries.chunks(u32::MAX as usize);
            return parts
                .flat_map(|part| self.distances_below(part, bound))
                .collect();
        }
        let is_finite = |&index: &u32| queries[index as usize].is_finite();
        let kept: Vec<u32> = (0..queries.len() as u32).filter(is_finite).collect();
        if kept.len() == queries.len() {
            return self.search(&Packed::new(&listed(queries, Order::Any)), bound);
        }
        let finite = Listed {
            count: kept.len(),
            at: |index| queries[kept[index] as usize],
            order: Order::Any,
        };
        let found = self.search(&Packed::new(&finite), bound);
        let mut distances = vec![f64::INFINITY; queries.len()];
        for (index, found) in kept.into_iter().zip(found) {
            distances[index as usize] = found;
        }
        distances
    }

    /// The distance from each point of `queries` to the nearest of these points, in the order in
    /// which the queries were given to their index: cheaper than [`BlockIndex::distances`] where
    /// both clouds have an index anyway.
    pub fn distances_from(&self, queries: &Self) -> Vec<f64> {
        self.search(&queries.points, f64::INFINITY)
    }

    /// As [`BlockIndex::distances_from`], bounded as by [`BlockIndex::distances_below`].
    pub fn distances_from_below(&self, queries: &Self, bound: f64) -> Vec<f64> {
        self.search(&queries.points, bound)
    }

    fn search(&self, queries: &Packed, bound: f64) -> Vec<f64> {
        self.search_by(Registers::widest(), queries, bound)
    }

    fn search_by(&self, registers: Registers, queries: &Packed, bound: f64) -> Vec<f64> {
        // One rounding above the bound's square: no distance below the bound is missed.
        let bound_square = (bound * bound).next_up();
        let mut found = vec![[bound_square; LANES]; queries.blocks.len()];
        queries
            .blocks
            .par_chunks(GROUPS)
            .zip(found.par_chunks_mut(GROUPS))
            .for_each(|(blocks, found)| {
                let index = self;
                registers.run(Search {
                    index,
                    blocks,
                    found,
                });
                for square in found.as_flattened_mut() {
                    let distance = square.sqrt();
                    *square = if distance < bound {
                        distance
                    } else {
                        f64::INFINITY
                    };
                }
            });
        queries.given.order(found.into_flattened())
    }
}

impl BlockIndex<f32> {
    /// As [`BlockIndex::gathered`], for coordinates that are f32 all. It does not know in which order
    /// the points came.
    ///
    /// # Errors
    /// As [`BlockIndex::gathered`].
    pub fn gathered_narrow(
        most: usize,
        feed: impl FnOnce(&mut Take<'_>) -> Result<()>,
    ) -> Result<Option<Self>> {
        Self::gather(Packing::new(Keep::Nothing, most), feed)
    }
}

impl<C: Coordinate> BlockIndex<C> {
    fn gather(
        mut packing: Packing<Block<C>>,
        feed: impl FnOnce(&mut Take<'_>) -> Result<()>,
    ) -> Result<Option<Self>> {
        feed(&mut |points| packing.take(points))?;
        let (blocks, given, count) = packing.finish();
        let points = Packed {
            blocks,
            given,
            count,
        };
        Ok((count > 0).then(|| Self::over(points)))
    }

    fn over(points: Packed<C>) -> Self {
        let bounds = |block: &Block<C>| {
            let mut room = Block::EMPTY;
            C::widened(block, &mut room).bounds()
        };
        let mut boxes: Vec<Corners> = points.blocks.par_iter().map(bounds).collect();
        let mut levels = Vec::new();
        while levels.is_empty() || boxes.len() > 1 {
            levels.push(boxes.par_chunks(FANOUT).map(Node::over).collect());
            boxes = boxes.par_chunks(FANOUT).map(union).collect();
        }
        Self { points, levels }
    }

    /// How many points are indexed, at least one.
    #[allow(clippy::len_without_is_empty, reason = "never empty")]
    pub fn len(&self) -> usize {
        self.points.count
    }

    #[inline(always)]
    pub(super) fn block(&self, number: usize) -> &Block<C> {
        &self.points.blocks[number]
    }

    /// About the distance between the points of a block.
    #[inline(always)]
    pub(super) fn spacing_at(&self, number: usize) -> f64 {
        let (node, k) = (&self.levels[0][number / FANOUT], number % FANOUT);
        let side = |axis: usize| node.max[axis][k] - node.min[axis][k];
        0.25 * square_of(side(0), side(1), side(2)).sqrt()
    }

    #[inline(always)]
    pub(super) fn levels(&self) -> &[Vec<Node>] {
        &self.levels
    }
}

/// Neighbouring groups of queries, searched one after the other.
struct Search<'a> {
    index: &'a BlockIndex,
    blocks: &'a [Block],
    /// Per group the bounds, and in the end the least squared distances.
    found: &'a mut [[f64; LANES]],
}

impl wide::Task for Search<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self, width: impl wide::Width) {
        let mut neighbourhood = Neighbourhood::new();
        // Where many queries share a place, it and its answer: all come with the same bound.
        let mut answered: Option<(DVec3, f64)> = None;
        let several = self.blocks.chunks(TOGETHER);
        for (blocks, found) in several.zip(self.found.chunks_mut(TOGETHER)) {
            let group = |k: usize| {
                let block = &blocks[k.min(blocks.len() - 1)];
                (block, block.bounds())
            };
            let groups: [_; TOGETHER] = std::array::from_fn(group);
            let (min, max) = union(&groups.map(|(_, corners)| corners));
            let is_place = min == max;
            if let Some((_, square)) = answered.filter(|&(place, _)| is_place && place == min) {
                found.as_flattened_mut().fill(square);
                continue;
            }
            let squares = |k: usize| Squares {
                best: found[k.min(found.len() - 1)],
            };
            let mut squares: [_; TOGETHER] = std::array::from_fn(squares);
            let some = blocks.len();
            neighbourhood.search(width, self.index, &groups[..some], &mut squares[..some]);
            for (found, squares) in found.iter_mut().zip(squares) {
                *found = squares.best;
            }
            answered = is_place.then(|| (min, found[0][0]));
        }
    }
}

fn union(boxes: &[Corners]) -> Corners {
    boxes.iter().copied().fold(NOWHERE, wider)
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
        if queries.iter().all(|query| query.is_finite()) {
            let queries = BlockIndex::new(queries).unwrap();
            assert_eq!(
                index.distances_from_below(&queries, bound),
                below,
                "{place}"
            );
        }
        for (below, expected) in below.into_iter().zip(expected) {
            let wanted = if expected < bound {
                expected
            } else {
                f64::INFINITY
            };
            assert_eq!(below, wanted, "{place} below {bound}");
        }
    }

    /// Every width that this processor has, not the widest only, against kiddo and against trying
    /// every point.
    #[test]
    fn every_width_finds_the_same_bits() {
        let points = flattened(&scattered(32, 6_001));
        let mut queries = scattered(33, 1_003);
        queries.extend(flattened(&scattered(34, 1_500)));
        let index = BlockIndex::new(&points).unwrap();
        let expected = NearestIndex::new(&points).unwrap().distances(&queries);
        let least = |&query: &DVec3| {
            let squares = points
                .iter()
                .map(|&p| super::super::squared_distance(query, p));
            squares.fold(f64::INFINITY, f64::min).sqrt()
        };
        assert_eq!(queries.iter().map(least).collect::<Vec<_>>(), expected);
        let packed = Packed::<f64>::new(&listed(&queries, Order::Any));
        let mut seen = 0;
        for registers in [Registers::Baseline, Registers::Avx2, Registers::Avx512] {
            if registers.are_there() {
                let found = index.search_by(registers, &packed, f64::INFINITY);
                assert_eq!(found, expected, "{registers:?}");
                let below = index.search_by(registers, &packed, 0.01);
                let capped = |&d: &f64| if d < 0.01 { d } else { f64::INFINITY };
                assert_eq!(below, expected.iter().map(capped).collect::<Vec<_>>());
                seen += 1;
            }
        }
        let wider = usize::from(std::env::consts::ARCH == "x86_64" && Registers::Avx2.are_there());
        assert!(
            seen > wider,
            "the baseline, and what is wider where there is any"
        );
    }

    /// Distances that jump, so that guesses from neighbours are wrong both ways, and queries far
    /// from everything.
    #[test]
    fn wrong_guesses_change_nothing() {
        let points = flattened(&scattered(35, 9_000));
        let lift = |(k, p): (usize, &DVec3)| match k % 97 {
            0 => *p + DVec3::Z * 50.0,
            1..40 => *p,
            _ => *p + DVec3::Z * 1e-5 * (k % 7) as f64,
        };
        let jumping: Vec<DVec3> = points.iter().enumerate().map(lift).collect();
        assert_as_oracle(&points, &jumping, "jumping");
        assert_as_oracle(&jumping, &points, "jumping, the other way");
        let far: Vec<DVec3> = points.iter().map(|p| *p * 0.01 + DVec3::X * 9.0).collect();
        assert_as_oracle(&points, &far, "far");
        let twice = [&points[..], &points[..]].concat();
        assert_as_oracle(&twice, &twice, "twins");
        assert_as_oracle(&vec![DVec3::ONE; 5000], &points, "one place");
        let mixed = [&far[..], &jumping[..], &points[..]].concat();
        assert_as_oracle(&points, &mixed, "mixed");
    }

    /// Points that come in stretches of any length.
    #[test]
    fn gathered_points_are_those_of_a_list() {
        for count in [1, 15, 1024, 1025, 40_000, 600_001] {
            let points = flattened(&scattered(36, count));
            let order = super::super::spatial_order(&points);
            let points: Vec<DVec3> = order.iter().map(|&index| points[index as usize]).collect();
            let mut lengths = [1, 1023, 0, 70_000, 300_000, 5].into_iter().cycle();
            let gathered = BlockIndex::gathered(points.len(), |take| {
                let mut rest = &points[..];
                while !rest.is_empty() {
                    let (some, left) = rest.split_at(lengths.next().unwrap().min(rest.len()));
                    take(some)?;
                    rest = left;
                }
                Ok(())
            });
            let gathered = gathered.unwrap().unwrap();
            assert_eq!(gathered.len(), points.len());
            assert!(gathered.pieces().flatten().eq(points.iter().copied()));
            let listed = BlockIndex::of(&listed(&points, Order::Spatial)).unwrap();
            assert!(listed.pieces().flatten().eq(points.iter().copied()));
            let any = BlockIndex::new(&points).unwrap();
            assert!(any.pieces().flatten().eq(points.iter().copied()));
            let queries = flattened(&scattered(37, 3_001));
            let expected = any.distances(&queries);
            assert_eq!(gathered.distances(&queries), expected);
            assert_eq!(
                gathered.distances_from(&BlockIndex::new(&queries).unwrap()),
                expected
            );
            let back = BlockIndex::new(&queries).unwrap();
            assert_eq!(back.distances_from(&gathered), back.distances(&points));
            assert_eq!(back.distances_from(&listed), back.distances(&points));
        }
        assert!(BlockIndex::gathered(0, |_| Ok(())).unwrap().is_none());
        assert!(BlockIndex::gathered(1, |take| take(&[DVec3::NAN])).is_err());
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
        let surface = flattened(&points);
        let larger: Vec<DVec3> = flattened(&queries).iter().map(|&p| p * 100.0).collect();
        assert_as_oracle(&surface, &larger, "a larger unit");
        assert_as_oracle(&larger, &surface, "a smaller unit");
    }
}
