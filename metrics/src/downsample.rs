//! Thinning a cloud: Open3D's voxel grid, and every k-th point.

use crate::distance::hilbert;
use crate::error::{Error, Result};
use glam::DVec3;
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Entries of which one task takes the means.
const PIECE: usize = 1 << 14;

/// One point per occupied voxel of edge `size`: the mean of the points in it.
///
/// This is Open3D's rule: the grid starts half a voxel below the cloud's minimum corner, a point's
/// voxel is `floor((p − start) / size)`, the mean is accumulated in input order and divided once.
/// The points come out along a Hilbert curve through the grid: neighbours in the list are neighbours
/// in space. No points give no points. An error where `size` is not above 0, a point is not finite,
/// or the grid would have more than 2³¹ − 1 voxels along an axis.
pub fn voxel(points: &[DVec3], size: f64) -> Result<Vec<DVec3>> {
    voxel_of(
        points.len(),
        |index| points[index],
        |index| index as u32,
        size,
    )
}

/// As [`voxel`], for `count` points that `at` gives by their index, each several times; means are
/// accumulated in the order of what `rank` gives, which differs for each index.
pub fn voxel_of(
    count: usize,
    at: impl Fn(usize) -> DVec3 + Sync,
    rank: impl Fn(usize) -> u32 + Sync,
    size: f64,
) -> Result<Vec<DVec3>> {
    let Some(grid) = Grid::around(count, &at, size)? else {
        return Ok(Vec::new());
    };
    if u32::try_from(count).is_err() {
        let problem = format!("expected at most 4294967295 points, found {count}");
        return Err(Error::invalid("voxel grid", problem));
    }
    let cell = |index: usize| u64::from(grid.cell_of(at(index))) << 32 | index as u64;
    let mut entries: Vec<u64> = (0..count).into_par_iter().map(cell).collect();
    hilbert::radix_sort(&mut entries, &mut Vec::new());
    let mut all = vec![DVec3::ZERO; count];
    let (mut work, mut rest) = (Vec::new(), &mut all[..]);
    for piece in pieces(&entries) {
        let (room, left) = rest.split_at_mut(piece.len());
        work.push((piece, room));
        rest = left;
    }
    let found: Vec<(usize, usize)> = work
        .into_par_iter()
        .map(|(piece, room)| (piece.len(), means(piece, &grid, (&at, &rank), room)))
        .collect();
    drop(entries);
    let (mut first, mut end) = (0, 0);
    for (room, found) in found {
        all.copy_within(first..first + found, end);
        (first, end) = (first + room, end + found);
    }
    all.truncate(end);
    all.shrink_to_fit();
    Ok(all)
}

/// As [`voxel`], by an ordered map and one loop, by x, then y, then z: the oracle.
pub fn voxel_plain(points: &[DVec3], size: f64) -> Result<Vec<DVec3>> {
    let Some(grid) = Grid::around(points.len(), &|index| points[index], size)? else {
        return Ok(Vec::new());
    };
    let mut voxels: BTreeMap<[i32; 3], (DVec3, usize)> = BTreeMap::new();
    for &point in points {
        let (sum, count) = voxels.entry(grid.voxel_of(point)).or_default();
        *sum += point;
        *count += 1;
    }
    let mean = |(sum, count): (DVec3, usize)| sum / count as f64;
    Ok(voxels.into_values().map(mean).collect())
}

/// Stretches of sorted entries that end where cells do.
fn pieces(mut entries: &[u64]) -> Vec<&[u64]> {
    let mut pieces = Vec::with_capacity(entries.len() / PIECE + 1);
    while entries.len() > PIECE {
        let cell = entries[PIECE] >> 32;
        let end = entries.partition_point(|entry| entry >> 32 <= cell);
        let (piece, rest) = entries.split_at(end);
        pieces.push(piece);
        entries = rest;
    }
    pieces.push(entries);
    pieces
}

/// Writes the means of the voxels in some cells, whose entries are sorted by cell, from the front on;
/// how many.
fn means(
    entries: &[u64],
    grid: &Grid,
    (at, rank): (&impl Fn(usize) -> DVec3, &impl Fn(usize) -> u32),
    means: &mut [DVec3],
) -> usize {
    let mut count = 0;
    let mut put = |mean: DVec3| {
        means[count] = mean;
        count += 1;
    };
    let mut members: Vec<DVec3> = Vec::new();
    let mut voxels: Vec<u64> = Vec::new();
    for cell in entries.chunk_by(|a, b| a >> 32 == b >> 32) {
        let index = |place: u64| cell[place as u32 as usize] as u32 as usize;
        members.clear();
        members.extend((0..cell.len() as u64).map(|place| at(index(place))));
        let Some(number) = grid.number_in_cell() else {
            means_of_wide_cell(&members, grid, |place| rank(index(place as u64)), &mut put);
            continue;
        };
        voxels.clear();
        let member = |(&point, place): (&DVec3, u64)| number(point) << 32 | place;
        voxels.extend(members.iter().zip(0..).map(member));
        voxels.sort_unstable();
        for voxel in voxels.chunk_by_mut(|a, b| a >> 32 == b >> 32) {
            if voxel.len() > 1 {
                voxel.sort_unstable_by_key(|&place| rank(index(place)));
            }
            let add = |sum, &place: &u64| sum + members[place as u32 as usize];
            put(voxel.iter().fold(DVec3::ZERO, add) / voxel.len() as f64);
        }
    }
    count
}

/// As [`means`] for one cell of more voxels than 32 bits count.
fn means_of_wide_cell(
    members: &[DVec3],
    grid: &Grid,
    rank: impl Fn(usize) -> u32,
    mut put: impl FnMut(DVec3),
) {
    let mut voxels: Vec<([i32; 3], u32, DVec3)> = members
        .iter()
        .enumerate()
        .map(|(place, &point)| (grid.voxel_of(point), rank(place), point))
        .collect();
    voxels.sort_unstable_by_key(|&(voxel, rank, _)| (voxel, rank));
    for voxel in voxels.chunk_by(|a, b| a.0 == b.0) {
        let sum = voxel.iter().fold(DVec3::ZERO, |sum, member| sum + member.2);
        put(sum / voxel.len() as f64);
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
    /// The grid around the points; `None` without points.
    fn around(count: usize, at: &impl Fn(usize) -> DVec3, size: f64) -> Result<Option<Self>> {
        if !(size.is_finite() && size > 0.0) {
            let problem = format!("expected a finite size above 0, found {size}");
            return Err(Error::invalid("voxel size", problem));
        }
        if count == 0 {
            return Ok(None);
        }
        let (mut min, mut max) = (at(0), at(0));
        for index in 0..count {
            let point = at(index);
            if !point.is_finite() {
                let problem = format!(
                    "expected finite points, found {point} at {index}: drop such points first"
                );
                return Err(Error::invalid("voxel grid", problem));
            }
            (min, max) = (min.min(point), max.max(point));
        }
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
        Ok(Some(grid))
    }

    /// The cast rounds to 0, which is down: nothing is below the start.
    #[inline]
    fn voxel_of(&self, point: DVec3) -> [i32; 3] {
        let scaled = (point - self.start) / self.size;
        scaled.to_array().map(|along| along as i32)
    }

    /// The number of a point's voxel within its cell, by x, then y, then z; `None` where 32 bits are
    /// not enough.
    fn number_in_cell(&self) -> Option<impl Fn(DVec3) -> u64 + '_> {
        let (shift, mask) = (self.shift, (1u64 << self.shift) - 1);
        (3 * shift <= u32::BITS).then_some(move |point| {
            let [x, y, z] = self.voxel_of(point).map(|along| along as u64 & mask);
            x << (2 * shift) | y << shift | z
        })
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
