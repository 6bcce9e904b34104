//! Thinning a cloud: Open3D's voxel grid, and every k-th point.

use crate::error::{Error, Result};
use glam::DVec3;
use std::collections::BTreeMap;

/// One point per occupied voxel of edge `size`: the mean of the points in it.
///
/// This is Open3D's rule: the grid starts half a voxel below the cloud's minimum corner, a point's
/// voxel is `floor((p − start) / size)`, the mean is accumulated in input order and divided once.
/// The points come out in the order of their voxels, by x, then y, then z. No points give no
/// points. An error where `size` is not above 0, a point is not finite, or the grid would have
/// more than 2³¹ − 1 voxels along an axis.
pub fn voxel(points: &[DVec3], size: f64) -> Result<Vec<DVec3>> {
    let Some(start) = grid_start(points, size)? else {
        return Ok(Vec::new());
    };
    let mut voxels: BTreeMap<[i32; 3], (DVec3, usize)> = BTreeMap::new();
    for &point in points {
        let (sum, count) = voxels.entry(voxel_of(point, start, size)).or_default();
        *sum += point;
        *count += 1;
    }
    let mean = |(sum, count): (DVec3, usize)| sum / count as f64;
    Ok(voxels.into_values().map(mean).collect())
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

fn voxel_of(point: DVec3, start: DVec3, size: f64) -> [i32; 3] {
    let scaled = (point - start) / size;
    scaled.to_array().map(|along| along.floor() as i32)
}

/// The corner at which the grid starts; `None` without points.
fn grid_start(points: &[DVec3], size: f64) -> Result<Option<DVec3>> {
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
    let (min, max) = points
        .iter()
        .fold((first, first), |(min, max), &p| (min.min(p), max.max(p)));
    let half = DVec3::splat(size * 0.5);
    let (start, end) = (min - half, max + half);
    let extent = (end - start).max_element();
    if size * f64::from(i32::MAX) < extent {
        let problem = format!(
            "expected at most 2147483647 voxels along an axis, found a cloud {extent} wide and \
             voxels of {size}: enlarge the voxels or remove outliers"
        );
        return Err(Error::invalid("voxel size", problem));
    }
    Ok(Some(start))
}

#[cfg(test)]
mod tests {
    use super::*;

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
