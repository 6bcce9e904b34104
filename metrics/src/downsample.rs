//! Thinning a cloud: Open3D's voxel grid, and every k-th point.

use crate::error::{Error, Result};
use glam::DVec3;
use rayon::prelude::*;
use std::collections::BTreeMap;

/// One point per occupied voxel of edge `size`: the mean of the points in it.
///
/// This is Open3D's rule: the grid starts half a voxel below the cloud's minimum corner, a point's
/// voxel is `floor((p − start) / size)`, the mean is accumulated in input order and divided once.
/// The points come out in the order of their voxels, by x, then y, then z. No points give no
/// points. An error where `size` is not above 0, a point is not finite, or the grid would have
/// more than 2³¹ − 1 voxels along an axis.
pub fn voxel(points: &[DVec3], size: f64) -> Result<Vec<DVec3>> {
    let Some(grid) = Grid::around(points, size)? else {
        return Ok(Vec::new());
    };
    let Some(numbers) = grid.numbers(points) else {
        return Ok(means_by_map(points, &grid));
    };
    let entries = sorted(numbers, grid.bits());
    let mut ends: Vec<usize> = entries
        .windows(2)
        .enumerate()
        .filter_map(|(place, pair)| (pair[0].0 != pair[1].0).then_some(place + 1))
        .collect();
    ends.push(entries.len());
    let mean = |voxel: usize| {
        let start = if voxel == 0 { 0 } else { ends[voxel - 1] };
        let members = &entries[start..ends[voxel]];
        let add = |sum: DVec3, entry: &(u64, u32)| sum + points[entry.1 as usize];
        members.iter().fold(DVec3::ZERO, add) / members.len() as f64
    };
    Ok((0..ends.len()).into_par_iter().map(mean).collect())
}

/// As [`voxel`], by an ordered map and one loop: the oracle.
pub fn voxel_plain(points: &[DVec3], size: f64) -> Result<Vec<DVec3>> {
    let grid = Grid::around(points, size)?;
    Ok(grid.map_or_else(Vec::new, |grid| means_by_map(points, &grid)))
}

fn means_by_map(points: &[DVec3], grid: &Grid) -> Vec<DVec3> {
    let mut voxels: BTreeMap<[i32; 3], (DVec3, usize)> = BTreeMap::new();
    for &point in points {
        let (sum, count) = voxels.entry(grid.voxel_of(point)).or_default();
        *sum += point;
        *count += 1;
    }
    let mean = |(sum, count): (DVec3, usize)| sum / count as f64;
    voxels.into_values().map(mean).collect()
}

/// Entries of a voxel's number and a point's index, by number and then by index: least significant
/// digits first.
fn sorted(mut entries: Vec<(u64, u32)>, bits: u32) -> Vec<(u64, u32)> {
    const DIGIT: u32 = 11;
    let mut spare = vec![(0, 0); entries.len()];
    for shift in (0..bits).step_by(DIGIT as usize) {
        let digit = |entry: &(u64, u32)| (entry.0 >> shift) as usize % (1 << DIGIT);
        let mut starts = [0usize; 1 << DIGIT];
        for entry in &entries {
            starts[digit(entry)] += 1;
        }
        let mut sum = 0;
        for start in &mut starts {
            sum += std::mem::replace(start, sum);
        }
        for entry in &entries {
            let slot = &mut starts[digit(entry)];
            spare[*slot] = *entry;
            *slot += 1;
        }
        std::mem::swap(&mut entries, &mut spare);
    }
    entries
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
    /// The last voxel along each axis.
    last: [i32; 3],
}

impl Grid {
    /// The grid around the points; `None` without points.
    fn around(points: &[DVec3], size: f64) -> Result<Option<Self>> {
        if !(size.is_finite() && size > 0.0) {
            let problem = format!("expected a finite size above 0, found {size}");
            return Err(Error::invalid("voxel size", problem));
        }
        if let Some(index) = points.iter().position(|point| !point.is_finite()) {
            let problem = format!(
                "expected finite points, found {} at {index}: drop such points first",
                points[index]
            );
            return Err(Error::invalid("voxel grid", problem));
        }
        let Some(&first) = points.first() else {
            return Ok(None);
        };
        let wider = |(min, max): (DVec3, DVec3), &p: &DVec3| (min.min(p), max.max(p));
        let (min, max) = points.iter().fold((first, first), wider);
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
            last: [0; 3],
        };
        grid.last = grid.voxel_of(max);
        Ok(Some(grid))
    }

    fn voxel_of(&self, point: DVec3) -> [i32; 3] {
        let scaled = (point - self.start) / self.size;
        scaled.to_array().map(|along| along.floor() as i32)
    }

    /// Bits of a voxel's number.
    fn bits(&self) -> u32 {
        self.last.map(bits).iter().sum()
    }

    /// Per point the number of its voxel, ordered as its three indices are; `None` where it would
    /// not fit into 64 bits, or there are more points than indices.
    fn numbers(&self, points: &[DVec3]) -> Option<Vec<(u64, u32)>> {
        if self.bits() > u64::BITS || u32::try_from(points.len()).is_err() {
            return None;
        }
        let (y, z) = (bits(self.last[1]), bits(self.last[2]));
        let number = |index: usize| {
            let voxel = self.voxel_of(points[index]).map(|along| along as u64);
            ((voxel[0] << y | voxel[1]) << z | voxel[2], index as u32)
        };
        Some((0..points.len()).into_par_iter().map(number).collect())
    }
}

/// Bits of the largest index along an axis, at least 0.
fn bits(last: i32) -> u32 {
    u32::BITS - last.unsigned_abs().leading_zeros()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::align::tests::scattered;

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
                let expected = voxel_plain(&cloud, size).unwrap();
                assert_eq!(voxel(&cloud, size).unwrap(), expected, "{size}");
            }
        }
    }

    #[test]
    fn numbers_past_64_bits_fall_back() {
        let points = [DVec3::ZERO, DVec3::splat(1e9), DVec3::splat(1e9), DVec3::X];
        let grid = Grid::around(&points, 1.0).unwrap().unwrap();
        assert!(grid.numbers(&points).is_none());
        let expected = [DVec3::ZERO, DVec3::X, DVec3::splat(1e9)];
        assert_eq!(voxel(&points, 1.0).unwrap(), expected);
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
