//! Points on their way through a protocol: finite, moved, cropped, thinned.

use crate::error::{Error, Result};
use crate::parallel;
use glam::{DMat4, DVec3, Vec3};
use mvs_datasets::scene::{CropVolume, PointCloud};
use mvs_metrics::align::transform;
use mvs_metrics::crop::Prism;
use mvs_metrics::distance::{self, Listed, Order};
use mvs_metrics::downsample;
use std::borrow::Cow;

/// Points handled by one task.
const BLOCK: usize = 1 << 15;

/// Finite positions, and how many others there were. They lie in spatial order, so that whatever
/// follows finds neighbours close in memory; their order as given is kept beside.
#[derive(Debug, Clone, PartialEq)]
pub struct FinitePoints {
    positions: Positions,
    /// Per point, its place among the finite points as given.
    ranks: Vec<u32>,
    non_finite: usize,
}

/// Coordinates as narrow as they allow: both give back the very numbers that were given.
#[derive(Debug, Clone, PartialEq)]
enum Positions {
    Single(Vec<Vec3>),
    Double(Vec<DVec3>),
}

impl FinitePoints {
    /// The finite ones of `positions`.
    pub fn new(mut positions: Vec<DVec3>) -> Self {
        let input = positions.len();
        positions.retain(|position| position.is_finite());
        let non_finite = input - positions.len();
        let is_single = |position: &DVec3| position.as_vec3().as_dvec3() == *position;
        let ranks = distance::spatial_order(&positions);
        let ordered = ranks.iter().map(|&rank| positions[rank as usize]);
        let positions = if positions.iter().all(is_single) {
            Positions::Single(ordered.map(|position| position.as_vec3()).collect())
        } else {
            Positions::Double(ordered.collect())
        };
        Self {
            positions,
            ranks,
            non_finite,
        }
    }

    /// The finite positions of a cloud; its other columns are dropped.
    pub fn of_cloud(cloud: PointCloud) -> Self {
        Self::new(cloud.into_positions())
    }

    /// How many finite points.
    pub fn len(&self) -> usize {
        match &self.positions {
            Positions::Single(positions) => positions.len(),
            Positions::Double(positions) => positions.len(),
        }
    }

    /// Whether there are no finite points.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The finite point of an index in spatial order, in world units.
    #[inline]
    pub fn at(&self, index: usize) -> DVec3 {
        match &self.positions {
            Positions::Single(positions) => positions[index].as_dvec3(),
            Positions::Double(positions) => positions[index],
        }
    }

    /// The finite positions in spatial order, in world units.
    pub fn iter(&self) -> impl Iterator<Item = DVec3> {
        (0..self.len()).map(|index| self.at(index))
    }

    /// The finite positions in the order given, in world units.
    pub fn positions(&self) -> Vec<DVec3> {
        let mut positions = vec![DVec3::ZERO; self.len()];
        for (position, &rank) in self.iter().zip(&self.ranks) {
            positions[rank as usize] = position;
        }
        positions
    }

    /// How many points were given, the dropped ones included.
    pub fn input(&self) -> usize {
        self.len() + self.non_finite
    }

    /// How many points were dropped for NaN or infinity.
    pub fn non_finite(&self) -> usize {
        self.non_finite
    }
}

/// The prism of a crop volume.
pub fn prism(volume: &CropVolume) -> Result<Prism> {
    Ok(Prism::new(
        volume.axis().index(),
        volume.range(),
        volume.polygon(),
    )?)
}

/// Points of a cloud, moved. Only their indices are in memory.
#[derive(Debug, Clone)]
pub struct Moved<'a> {
    points: &'a FinitePoints,
    motion: Option<DMat4>,
    kept: Vec<u32>,
}

impl<'a> Moved<'a> {
    /// The points moved by `target_from_source` that lie inside `crop` (all, without one). An error where there are more points than 32 bits count.
    pub fn new(
        points: &'a FinitePoints,
        target_from_source: Option<DMat4>,
        crop: Option<&Prism>,
    ) -> Result<Self> {
        let count = u32::try_from(points.len()).map_err(|_| {
            let problem = format!("expected at most 4294967295 points, found {}", points.len());
            Error::invalid("cloud", problem)
        })?;
        let motion = target_from_source;
        let inside = |&index: &u32| {
            let point = moved(points.at(index as usize), motion);
            crop.is_none_or(|crop| crop.contains(point))
        };
        let blocks = parallel::map(points.len().div_ceil(BLOCK), |block| {
            let first = (block * BLOCK) as u32;
            let last = first.saturating_add(BLOCK as u32).min(count);
            let mut kept: Vec<u32> = (first..last).filter(inside).collect();
            kept.shrink_to_fit();
            kept
        });
        let kept = blocks.concat();
        Ok(Self {
            points,
            motion,
            kept,
        })
    }

    /// Only the points at 0, k, 2k, … of the order given.
    #[must_use]
    pub fn every_kth(&self, k: usize) -> Cow<'_, Self> {
        if k <= 1 {
            return Cow::Borrowed(self);
        }
        let mut kept: Vec<u32> = self.given().step_by(k).collect();
        kept.sort_unstable();
        Cow::Owned(Self { kept, ..*self })
    }

    /// The indices kept, in the order in which their points were given.
    fn given(&self) -> impl Iterator<Item = u32> {
        let entry =
            |&index: &u32| u64::from(self.points.ranks[index as usize]) << 32 | u64::from(index);
        let mut entries: Vec<u64> = self.kept.iter().map(entry).collect();
        entries.sort_unstable();
        entries.into_iter().map(|entry| entry as u32)
    }

    /// The moved points in the order given.
    pub fn in_given_order(&self) -> Vec<DVec3> {
        let at = |index: u32| moved(self.points.at(index as usize), self.motion);
        self.given().map(at).collect()
    }

    /// How many points.
    pub fn len(&self) -> usize {
        self.kept.len()
    }

    /// Whether there are no points.
    pub fn is_empty(&self) -> bool {
        self.kept.is_empty()
    }

    /// The moved point of an index in spatial order.
    #[inline]
    pub fn at(&self, index: usize) -> DVec3 {
        moved(self.points.at(self.kept[index] as usize), self.motion)
    }

    /// The moved points.
    pub fn listed(&self) -> Listed<impl Fn(usize) -> DVec3 + Sync> {
        Listed {
            count: self.len(),
            at: |index| self.at(index),
            order: Order::Spatial,
        }
    }

    /// The mean per voxel of an edge, accumulated in the order given; in spatial order.
    pub fn voxels(&self, size: f64) -> Result<Vec<DVec3>> {
        Ok(downsample::voxel_of(
            self.len(),
            |index| self.at(index),
            |index| self.points.ranks[self.kept[index] as usize],
            size,
        )?)
    }
}

#[inline]
fn moved(point: DVec3, motion: Option<DMat4>) -> DVec3 {
    motion.map_or(point, |motion| transform(motion, point))
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec2;

    #[test]
    fn non_finite_points_are_counted_and_dropped() {
        let points = vec![DVec3::ONE, DVec3::NAN, DVec3::X, DVec3::INFINITY];
        let points = FinitePoints::new(points);
        assert_eq!(points.positions(), [DVec3::ONE, DVec3::X]);
        assert_eq!((points.input(), points.non_finite()), (4, 2));
    }

    #[test]
    fn cropping_happens_after_the_motion_and_keeps_the_order() {
        let square = [(0.0, 0.0), (10.0, 0.0), (10.0, 10.0), (0.0, 10.0)].map(DVec2::from);
        let crop = Prism::new(2, (-1.0, 1.0), &square).unwrap();
        let points: Vec<DVec3> = (0..100_000)
            .map(|i| DVec3::new(f64::from(i) * 1e-3, 5.0, 0.0))
            .collect();
        let motion = DMat4::from_translation(DVec3::X * -50.0);
        let slow: Vec<DVec3> = points
            .iter()
            .map(|&point| motion.transform_point3(point))
            .filter(|&point| crop.contains(point))
            .collect();
        let points = FinitePoints::new(points);
        let kept = Moved::new(&points, Some(motion), Some(&crop)).unwrap();
        assert_eq!(kept.in_given_order(), slow);
        assert!(kept.len() > 9_000 && kept.len() < 11_000);
        let thinned: Vec<DVec3> = slow.into_iter().step_by(7).collect();
        assert_eq!(kept.every_kth(7).in_given_order(), thinned);
        let all = Moved::new(&points, None, None).unwrap();
        assert_eq!(all.in_given_order(), points.positions());
    }

    #[test]
    fn voxel_means_are_accumulated_in_the_order_given() {
        let hash = |i: u64| (i.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 40) as f64 * 1e-7;
        let point = |i: u64| DVec3::new(hash(3 * i), hash(3 * i + 1), hash(3 * i + 2));
        let points: Vec<DVec3> = (0..20_000).map(point).collect();
        let row = |p: &DVec3| p.to_array();
        let sorted = |mut points: Vec<DVec3>| {
            points.sort_by(|a, b| row(a).partial_cmp(&row(b)).unwrap());
            points
        };
        let expected = downsample::voxel_plain(&points, 0.15).unwrap();
        let finite = FinitePoints::new(points);
        let found = Moved::new(&finite, None, None)
            .unwrap()
            .voxels(0.15)
            .unwrap();
        assert!(found.len() < 5000);
        assert_eq!(sorted(found), sorted(expected));
    }

    #[test]
    fn narrow_and_wide_coordinates_come_back_as_given() {
        let narrow = vec![DVec3::new(0.5, f64::from(-1e-3f32), f64::from(1e30f32)); 3];
        let mut wide = narrow.clone();
        wide.push(DVec3::new(0.1, 1e300, -5e-324));
        for points in [narrow, wide] {
            let finite = FinitePoints::new(points.clone());
            assert_eq!(finite.positions(), points);
        }
    }
}
