//! Thinning a cloud by Open3D's voxel grid.

mod grid;
mod lists;
mod runs;

use crate::distance::Take;
use crate::error::{Error, Result};
use crate::stretches::Stretches;
use glam::DVec3;
use grid::Grid;
use lists::Lists;
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Pieces whose means are held at a time, per thread.
const PIECES: usize = 4;

/// Coordinates of a point.
pub type Point = [f64; 3];

/// Some of the points of a list that exists nowhere as such.
#[derive(Debug, Clone, Copy)]
pub struct Members<'a, P, R> {
    /// Which.
    pub indices: &'a Stretches,
    /// Writes the points from an index on into as much room as it is given. Each is asked for several
    /// times.
    pub points: P,
    /// Where the point of an index stands in the order in which means are accumulated; differs for
    /// each.
    pub rank: R,
    /// The box around them, where it is known and finite.
    pub corners: Option<(DVec3, DVec3)>,
}

/// One point per occupied voxel of edge `size`: the mean of the points in it.
///
/// This is Open3D's rule: the grid starts half a voxel below the cloud's minimum corner, a point's
/// voxel is `floor((p − start) / size)`, the mean is accumulated in input order and divided once.
/// The points come out along a Hilbert curve through the grid: neighbours in the list are neighbours
/// in space. No points give no points.
///
/// # Errors
/// A `size` that is not finite and above 0, a point that is not finite, more than 2³¹ − 1 voxels along an axis, and
/// more than 2³² − 1 points.
pub fn voxel(points: &[DVec3], size: f64) -> Result<Vec<DVec3>> {
    let count = u32::try_from(points.len()).map_err(|_| {
        let problem = format!("expected at most 4294967295 points, found {}", points.len());
        Error::invalid("voxel grid", problem)
    })?;
    let members = Members {
        indices: &Stretches::all(count),
        points: |first: usize, room: &mut [Point]| {
            for (place, point) in room.iter_mut().zip(&points[first..]) {
                *place = point.to_array();
            }
        },
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
///
/// # Errors
/// As [`voxel`], but for the number of points, and points are not looked at where their corners are given; what
/// `take` brings, which ends it.
pub fn voxel_each<P, R>(members: &Members<'_, P, R>, size: f64, take: &mut Take<'_>) -> Result<()>
where
    P: Fn(usize, &mut [Point]) + Sync,
    R: Fn(usize) -> u32 + Sync,
{
    if members.indices.is_empty() {
        return Grid::check_size(size);
    }
    let grid = match members.corners {
        Some(corners) => Grid::between(corners, size)?,
        None => Grid::around(runs::points(members), size)?,
    };
    let grid = grid.for_points(members.indices.len());
    let mut runs = runs::sorted(members, &grid);
    let most = PIECES * rayon::current_num_threads();
    while !runs.is_empty() {
        let (mut pieces, mut rest) = (Vec::new(), &runs[..]);
        while pieces.len() < most && !rest.is_empty() {
            let (left, piece) = rest.split_at(runs::last_piece(rest));
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
        runs.truncate(left);
        runs.shrink_to_fit();
    }
    Ok(())
}

/// The means of the voxels in some cells, whose runs are sorted by cell: from the last cell to the
/// first.
fn means<P, R>(
    piece: &[u64],
    grid: &Grid,
    members: &Members<'_, P, R>,
    lists: &mut Lists,
) -> Vec<DVec3>
where
    P: Fn(usize, &mut [Point]) + Sync,
    R: Fn(usize) -> u32 + Sync,
{
    lists.gather(
        piece.iter().map(|&run| runs::members(run)),
        &members.points,
        grid,
    );
    let points = |runs: &[u64]| -> usize { runs.iter().map(|&run| runs::members(run).len()).sum() };
    let mut end = points(piece);
    let mut means = Vec::with_capacity(end);
    let cells = piece.chunk_by(|&a, &b| runs::cell(a) == runs::cell(b));
    for cell in cells.rev() {
        let first = end - points(cell);
        lists.means(first..end, grid, &members.rank, &mut means);
        end = first;
    }
    means
}

/// As [`voxel`], by an ordered map and one loop, by x, then y, then z: the oracle.
///
/// # Errors
/// As [`voxel`], but for the number of points.
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
        // So few points are sorted by cells an eighth wide; strangers are 1.3 apart on average.
        let mean = steps.sum::<f64>() / thinned.len() as f64;
        assert!(mean < 0.2, "{mean}");
        let finer = voxel(&scattered(51, 500_000), 0.02).unwrap();
        let steps = finer.windows(2).map(|pair| pair[0].distance(pair[1]));
        let mean = steps.sum::<f64>() / finer.len() as f64;
        assert!(mean < 0.05, "{mean}");
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
            points: |first: usize, room: &mut [Point]| {
                for (place, point) in room.iter_mut().zip(&points[first..]) {
                    *place = point.to_array();
                }
            },
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
}
