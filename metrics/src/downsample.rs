//! Thinning a cloud: Open3D's voxel grid, and every k-th point.

use crate::distance::{Take, hilbert};
use crate::error::{Error, Result};
use crate::stretches::Stretches;
use glam::DVec3;
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Entries of which one task takes the means, at least.
const PIECE: usize = 1 << 13;
/// Pieces whose means are held at a time, per thread.
const PIECES: usize = 4;
/// Entries that one task makes.
const ENTRIES: usize = 1 << 14;
/// No point, where points are listed by their voxels.
const NONE: u32 = u32::MAX;

/// Some of the points that a function gives by their index, each several times.
#[derive(Debug, Clone, Copy)]
pub struct Members<'a, A, R> {
    /// Which.
    pub indices: &'a Stretches,
    /// The point of an index.
    pub at: A,
    /// Where the point stands in the order in which means are accumulated; differs for each index.
    pub rank: R,
    /// The box around them, where it is known and finite.
    pub corners: Option<(DVec3, DVec3)>,
}

/// One point per occupied voxel of edge `size`: the mean of the points in it.
///
/// This is Open3D's rule: the grid starts half a voxel below the cloud's minimum corner, a point's
/// voxel is `floor((p − start) / size)`, the mean is accumulated in input order and divided once.
/// The points come out along a Hilbert curve through the grid: neighbours in the list are neighbours
/// in space. No points give no points. An error where `size` is not above 0, a point is not finite,
/// or the grid would have more than 2³¹ − 1 voxels along an axis, or there are more than 2³² − 1
/// points.
pub fn voxel(points: &[DVec3], size: f64) -> Result<Vec<DVec3>> {
    let count = u32::try_from(points.len()).map_err(|_| {
        let problem = format!("expected at most 4294967295 points, found {}", points.len());
        Error::invalid("voxel grid", problem)
    })?;
    let members = Members {
        indices: &Stretches::all(count),
        at: |index| points[index],
        rank: |index| index as u32,
        corners: None,
    };
    let mut means = Vec::new();
    voxel_each(&members, size, &mut |some| {
        means.extend_from_slice(some);
        Ok(())
    })?;
    Ok(means)
}

/// As [`voxel`]; `take` gets the points stretch by stretch, so that no list of all of them need exist.
/// An error of `take` ends it.
pub fn voxel_each<A, R>(members: &Members<'_, A, R>, size: f64, take: &mut Take<'_>) -> Result<()>
where
    A: Fn(usize) -> DVec3 + Sync,
    R: Fn(usize) -> u32 + Sync,
{
    if members.indices.is_empty() {
        return Grid::check_size(size);
    }
    let at = |index: u32| (members.at)(index as usize);
    let grid = match members.corners {
        Some(corners) => Grid::between(corners, size)?,
        None => Grid::around(members.indices.iter().map(at), size)?,
    };
    let mut entries = entries(members, &grid);
    let most = PIECES * rayon::current_num_threads();
    while !entries.is_empty() {
        let (mut pieces, mut rest) = (Vec::new(), &entries[..]);
        while pieces.len() < most && !rest.is_empty() {
            let (left, piece) = rest.split_at(last_piece(rest));
            pieces.push(piece);
            rest = left;
        }
        let left = rest.len();
        let means: Vec<Vec<DVec3>> = pieces
            .into_par_iter()
            .map_init(
                || Lists::new(&grid),
                |lists, piece| means(piece, &grid, members, lists),
            )
            .collect();
        means.iter().try_for_each(|means| take(means))?;
        // What is done makes room.
        entries.truncate(left);
        entries.shrink_to_fit();
    }
    Ok(())
}

/// Per point its cell, counted from the curve's end, over its index; sorted.
fn entries<A, R>(members: &Members<'_, A, R>, grid: &Grid) -> Vec<u64>
where
    A: Fn(usize) -> DVec3 + Sync,
    R: Sync,
{
    let mut entries = vec![0; members.indices.len()];
    let at = &members.at;
    let chunks = entries.par_chunks_mut(ENTRIES).enumerate();
    let indices = members.indices;
    chunks.for_each(|(chunk, entries)| {
        for (entry, index) in entries.iter_mut().zip(indices.from(chunk * ENTRIES)) {
            let cell = hilbert::LAST - grid.cell_of(at(index as usize));
            *entry = u64::from(cell) << 32 | u64::from(index);
        }
    });
    hilbert::radix_sort(&mut entries, &mut Vec::new());
    entries
}

/// As [`voxel`], by an ordered map and one loop, by x, then y, then z: the oracle.
pub fn voxel_plain(points: &[DVec3], size: f64) -> Result<Vec<DVec3>> {
    if points.is_empty() {
        return Grid::check_size(size).map(|()| Vec::new());
    }
    let grid = Grid::around(points.iter().copied(), size)?;
    let mut voxels: BTreeMap<[i32; 3], (DVec3, usize)> = BTreeMap::new();
    for &point in points {
        let (sum, count) = voxels.entry(grid.voxel_of(point)).or_default();
        *sum += point;
        *count += 1;
    }
    let mean = |(sum, count): (DVec3, usize)| sum / count as f64;
    Ok(voxels.into_values().map(mean).collect())
}

/// Where a last piece of sorted entries starts, which begins where a cell does.
fn last_piece(entries: &[u64]) -> usize {
    let Some(latest) = entries.len().checked_sub(PIECE) else {
        return 0;
    };
    let cell = entries[latest] >> 32;
    entries.partition_point(|entry| entry >> 32 < cell)
}

/// The means of the voxels in some cells, whose entries are sorted by cell: from the last one to the
/// first.
fn means<A, R>(
    entries: &[u64],
    grid: &Grid,
    members: &Members<'_, A, R>,
    lists: &mut Lists,
) -> Vec<DVec3>
where
    A: Fn(usize) -> DVec3 + Sync,
    R: Fn(usize) -> u32 + Sync,
{
    let mut means = Vec::with_capacity(entries.len());
    for cell in entries.chunk_by(|a, b| a >> 32 == b >> 32).rev() {
        let at = |place: u32| (members.at)(cell[place as usize] as u32 as usize);
        let rank = |place: u32| (members.rank)(cell[place as usize] as u32 as usize);
        if lists.suit(cell.len()) {
            lists.means((0..cell.len() as u32).map(at), rank, grid, &mut means);
        } else {
            means_by_sorting((0..cell.len() as u32).map(at), rank, grid, &mut means);
        }
    }
    means
}

/// The means of one cell's voxels, by x, then y, then z, whatever the size of cells.
fn means_by_sorting(
    points: impl Iterator<Item = DVec3>,
    rank: impl Fn(u32) -> u32,
    grid: &Grid,
    means: &mut Vec<DVec3>,
) {
    let member = |(place, point)| (grid.voxel_of(point), rank(place), point);
    let mut voxels: Vec<([i32; 3], u32, DVec3)> = (0..).zip(points).map(member).collect();
    voxels.sort_unstable_by_key(|&(voxel, rank, _)| (voxel, rank));
    for voxel in voxels.chunk_by(|a, b| a.0 == b.0) {
        let sum = voxel.iter().fold(DVec3::ZERO, |sum, member| sum + member.2);
        means.push(sum / voxel.len() as f64);
    }
}

/// The points of one cell, listed by their voxels.
struct Lists {
    /// Per voxel of a cell the point listed last.
    last: Vec<u32>,
    /// A bit per voxel that has points.
    occupied: Vec<u64>,
    /// Per point the one listed before it in its voxel.
    before: Vec<u32>,
    points: Vec<DVec3>,
    /// The points of one voxel and their ranks.
    voxel: Vec<(u32, u32)>,
}

impl Lists {
    /// Bits of the number of a voxel in its cell at most.
    const MOST: u32 = 18;

    fn new(grid: &Grid) -> Self {
        let bits = 3 * grid.shift;
        let voxels = if bits <= Self::MOST { 1 << bits } else { 0 };
        Self {
            last: vec![NONE; voxels],
            occupied: vec![0; voxels.div_ceil(64)],
            before: Vec::new(),
            points: Vec::new(),
            voxel: Vec::new(),
        }
    }

    /// Whether there are lists, and points enough to look through all of them.
    fn suit(&self, points: usize) -> bool {
        !self.last.is_empty() && points * 16 >= self.occupied.len()
    }

    /// As [`means_by_sorting`], and the same.
    fn means(
        &mut self,
        points: impl Iterator<Item = DVec3>,
        rank: impl Fn(u32) -> u32,
        grid: &Grid,
        means: &mut Vec<DVec3>,
    ) {
        self.points.clear();
        self.before.clear();
        for (place, point) in (0..).zip(points) {
            let voxel = grid.number_in_cell(point);
            self.before
                .push(std::mem::replace(&mut self.last[voxel], place));
            self.occupied[voxel / 64] |= 1 << (voxel % 64);
            self.points.push(point);
        }
        for word in 0..self.occupied.len() {
            let mut bits = std::mem::take(&mut self.occupied[word]);
            while bits != 0 {
                let voxel = word * 64 + bits.trailing_zeros() as usize;
                bits &= bits - 1;
                let last = std::mem::replace(&mut self.last[voxel], NONE);
                means.push(self.mean(last, &rank));
            }
        }
    }

    /// The mean of a voxel, whose last point this is.
    fn mean(&mut self, last: u32, rank: &impl Fn(u32) -> u32) -> DVec3 {
        let sum = DVec3::ZERO;
        if self.before[last as usize] == NONE {
            return (sum + self.points[last as usize]) / 1.0;
        }
        self.voxel.clear();
        let mut place = last;
        while place != NONE {
            self.voxel.push((rank(place), place));
            place = self.before[place as usize];
        }
        self.voxel.sort_unstable();
        let add = |sum, &(_, place): &(u32, u32)| sum + self.points[place as usize];
        self.voxel.iter().fold(sum, add) / self.voxel.len() as f64
    }
}

/// The points at 0, k, 2k, …; an error where `k` is 0.
pub fn every_kth(points: &[DVec3], k: usize) -> Result<Vec<DVec3>> {
    if k == 0 {
        return Err(Error::invalid(
            "every k-th point",
            "expected k ≥ 1, found 0",
        ));
    }
    Ok(points.iter().step_by(k).copied().collect())
}

/// Where the voxels lie.
struct Grid {
    start: DVec3,
    size: f64,
    /// Voxels are sorted by cells of 2 to this power voxels along each axis.
    shift: u32,
}

impl Grid {
    fn check_size(size: f64) -> Result<()> {
        if !(size.is_finite() && size > 0.0) {
            let problem = format!("expected a finite size above 0, found {size}");
            return Err(Error::invalid("voxel size", problem));
        }
        Ok(())
    }

    /// The grid around points, at least one.
    fn around(points: impl Iterator<Item = DVec3>, size: f64) -> Result<Self> {
        let (mut min, mut max) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        for (index, point) in points.enumerate() {
            if !point.is_finite() {
                let problem = format!(
                    "expected finite points, found {point} at {index}: drop such points first"
                );
                return Err(Error::invalid("voxel grid", problem));
            }
            (min, max) = (min.min(point), max.max(point));
        }
        Self::between((min, max), size)
    }

    /// The grid around a finite box.
    fn between((min, max): (DVec3, DVec3), size: f64) -> Result<Self> {
        Self::check_size(size)?;
        let half = DVec3::splat(size * 0.5);
        let (start, end) = (min - half, max + half);
        let extent = (end - start).max_element();
        if size * f64::from(i32::MAX) < extent {
            let problem = format!(
                "expected at most 2147483647 voxels along an axis, found a cloud {extent} wide \
                 and voxels of {size}: enlarge the voxels or remove outliers"
            );
            return Err(Error::invalid("voxel size", problem));
        }
        let mut grid = Self {
            start,
            size,
            shift: 0,
        };
        let last = grid.voxel_of(max).into_iter().fold(0, i32::max);
        let bits = u32::BITS - last.unsigned_abs().leading_zeros();
        grid.shift = bits.saturating_sub(hilbert::BITS);
        Ok(grid)
    }

    /// The cast rounds to 0, which is down: nothing is below the start.
    #[inline]
    fn voxel_of(&self, point: DVec3) -> [i32; 3] {
        let scaled = (point - self.start) / self.size;
        scaled.to_array().map(|along| along as i32)
    }

    /// The number of a point's voxel within its cell, by x, then y, then z.
    #[inline]
    fn number_in_cell(&self, point: DVec3) -> usize {
        let mask = (1 << self.shift) - 1;
        let [x, y, z] = self.voxel_of(point).map(|along| along as usize & mask);
        (x << self.shift | y) << self.shift | z
    }

    /// The number of a point's cell along the curve.
    #[inline]
    fn cell_of(&self, point: DVec3) -> u32 {
        let [x, y, z] = self.voxel_of(point).map(|along| along as u32 >> self.shift);
        hilbert::hilbert(x, y, z)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::align::tests::scattered;

    fn sorted(mut points: Vec<DVec3>) -> Vec<DVec3> {
        let row = |p: &DVec3| p.to_array();
        points.sort_by(|a, b| row(a).partial_cmp(&row(b)).unwrap());
        points
    }

    #[test]
    fn neighbours_in_the_list_are_neighbours_in_space() {
        let thinned = voxel(&scattered(51, 20_000), 0.02).unwrap();
        let steps = thinned.windows(2).map(|pair| pair[0].distance(pair[1]));
        // Strangers are 1.3 apart on average.
        assert!(steps.sum::<f64>() < 0.1 * thinned.len() as f64);
    }

    #[test]
    fn voxels_are_the_oracles_bit_by_bit() {
        let points = scattered(50, 20_000);
        let line: Vec<DVec3> = points.iter().map(|p| DVec3::Y * p.x).collect();
        let mut outlier = points.clone();
        outlier.push(DVec3::new(1e6, -2e6, 3e6));
        let offset: Vec<DVec3> = points
            .iter()
            .map(|p| *p + DVec3::new(5e5, 4e6, 0.0))
            .collect();
        for cloud in [points, line, outlier, offset, vec![DVec3::ONE; 5000]] {
            for size in [10.0, 0.5, 0.1, 0.013, 0.002] {
                let expected = sorted(voxel_plain(&cloud, size).unwrap());
                assert_eq!(sorted(voxel(&cloud, size).unwrap()), expected, "{size}");
            }
        }
    }

    /// Cells of many voxels, with many points and with few, and of more voxels than are listed.
    #[test]
    fn fine_voxels_are_the_oracles_bit_by_bit() {
        let mut dense: Vec<DVec3> = scattered(53, 30_000).iter().map(|p| *p * 0.02).collect();
        dense.extend_from_within(..500);
        dense.extend(scattered(54, 2_000));
        for size in [3e-3, 3e-4, 1.5e-4, 6e-5] {
            let expected = sorted(voxel_plain(&dense, size).unwrap());
            assert_eq!(sorted(voxel(&dense, size).unwrap()), expected, "{size}");
        }
    }

    #[test]
    fn some_points_in_another_order_are_those_points_in_that_order() {
        let points = scattered(52, 70_000);
        let kept = |&index: &u32| index % 1000 < 900 || index % 7 == 0;
        let indices: Stretches = (0..70_000).filter(kept).collect();
        let members = Members {
            indices: &indices,
            at: |index| points[index],
            rank: |index| u32::MAX - index as u32,
            corners: None,
        };
        let backwards: Vec<DVec3> = (0..70_000)
            .rev()
            .filter(kept)
            .map(|i| points[i as usize])
            .collect();
        for size in [0.3, 0.04, 0.001] {
            let (mut found, mut stretches) = (Vec::new(), 0);
            let mut take = |some: &[DVec3]| {
                found.extend_from_slice(some);
                stretches += 1;
                Ok(())
            };
            voxel_each(&members, size, &mut take).unwrap();
            assert_eq!(
                sorted(found),
                sorted(voxel_plain(&backwards, size).unwrap())
            );
            assert!(stretches > 3);
        }
        let stop = &mut |_: &[DVec3]| Err(Error::invalid("test", "stop"));
        assert!(voxel_each(&members, 0.1, stop).is_err());
    }

    #[test]
    fn points_on_a_border_belong_to_the_upper_voxel() {
        // The grid starts at −0.5; the border between the first two voxels is at 0.5.
        let points = [0.0, 0.5, 0.25, 1.25].map(|x| DVec3::new(x, 0.0, 0.0));
        let thinned = voxel(&points, 1.0).unwrap();
        assert_eq!(thinned, [DVec3::X * 0.125, DVec3::X * 0.875]);
    }

    #[test]
    fn means_are_accumulated_in_input_order() {
        let (a, b, c) = (1.0, 1e-16, 1e-16);
        let forward = voxel(&[DVec3::splat(a), DVec3::splat(b), DVec3::splat(c)], 10.0).unwrap();
        let backward = voxel(&[DVec3::splat(c), DVec3::splat(b), DVec3::splat(a)], 10.0).unwrap();
        assert_eq!(forward, [DVec3::splat((a + b + c) / 3.0)]);
        assert_eq!(backward, [DVec3::splat((c + b + a) / 3.0)]);
        assert_ne!(forward, backward);
    }

    #[test]
    fn identical_points_become_one() {
        let point = DVec3::new(5e5, 4e6, 100.0);
        assert_eq!(voxel(&[point; 1000], 1e-3).unwrap(), [point]);
    }

    #[test]
    fn impossible_grids_are_refused() {
        let points = [DVec3::ZERO, DVec3::splat(1e9)];
        let error = voxel(&points, 1e-3).unwrap_err().to_string();
        assert!(
            error.contains("1000000000") && error.contains("0.001"),
            "{error}"
        );
        for size in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert!(voxel(&points, size).is_err(), "{size}");
        }
        let error = voxel(&[DVec3::ZERO, DVec3::NAN], 1.0)
            .unwrap_err()
            .to_string();
        assert!(error.contains("at 1"), "{error}");
        assert_eq!(voxel(&[], 1.0).unwrap(), []);
    }

    #[test]
    fn every_kth_takes_the_first() {
        let points: Vec<DVec3> = (0..7).map(|i| DVec3::splat(f64::from(i))).collect();
        let xs = |k| {
            every_kth(&points, k)
                .unwrap()
                .iter()
                .map(|p| p.x)
                .collect::<Vec<_>>()
        };
        assert_eq!(xs(3), [0.0, 3.0, 6.0]);
        assert_eq!(xs(1).len(), 7);
        assert!(every_kth(&points, 0).is_err());
    }
}
