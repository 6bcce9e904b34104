//! Points on their way through a protocol: finite, moved, cropped, thinned.

use crate::error::{Error, Result};
use crate::parallel;
use glam::{DMat4, DVec3, Vec3};
use mvs_datasets::scene::{CropVolume, PointCloud};
use mvs_metrics::align::transform;
use mvs_metrics::crop::Prism;
use mvs_metrics::distance::{Listed, Order};
use mvs_metrics::downsample;
use std::borrow::Cow;

/// Points handled by one task.
const BLOCK: usize = 1 << 15;

/// Finite positions, and how many others there were.
#[derive(Debug, Clone, PartialEq)]
pub struct FinitePoints {
    positions: Positions,
    non_finite: usize,
}

/// Coordinates as narrow as they allow: both give back the very numbers that were given.
#[derive(Debug, Clone, PartialEq)]
enum Positions {
    Single(Vec<Vec3>),
    Double(Vec<DVec3>),
}

impl FinitePoints {
    /// The finite ones of `positions`, in their order.
    pub fn new(mut positions: Vec<DVec3>) -> Self {
        let input = positions.len();
        positions.retain(|position| position.is_finite());
        let non_finite = input - positions.len();
        let is_single = |position: &DVec3| position.as_vec3().as_dvec3() == *position;
        let positions = if positions.iter().all(is_single) {
            Positions::Single(positions.iter().map(|p| p.as_vec3()).collect())
        } else {
            Positions::Double(positions)
        };
        Self {
            positions,
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

    /// The finite point of an index, in world units.
    #[inline]
    pub fn at(&self, index: usize) -> DVec3 {
        match &self.positions {
            Positions::Single(positions) => positions[index].as_dvec3(),
            Positions::Double(positions) => positions[index],
        }
    }

    /// The finite positions, in world units.
    pub fn iter(&self) -> impl Iterator<Item = DVec3> {
        (0..self.len()).map(|index| self.at(index))
    }

    /// The finite positions as a list, in world units.
    pub fn positions(&self) -> Cow<'_, [DVec3]> {
        match &self.positions {
            Positions::Single(_) => self.iter().collect(),
            Positions::Double(positions) => positions.into(),
        }
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
    /// The points moved by `target_from_source` that lie inside `crop` (all, without one), in their
    /// order. An error where there are more points than 32 bits count.
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
            (first..last).filter(inside).collect::<Vec<u32>>()
        });
        let kept = blocks.concat();
        Ok(Self {
            points,
            motion,
            kept,
        })
    }

    /// Only the points at 0, k, 2k, ….
    #[must_use]
    pub fn every_kth(&self, k: usize) -> Self {
        Self {
            kept: self.kept.iter().step_by(k.max(1)).copied().collect(),
            ..*self
        }
    }

    /// How many points.
    pub fn len(&self) -> usize {
        self.kept.len()
    }

    /// Whether there are no points.
    pub fn is_empty(&self) -> bool {
        self.kept.is_empty()
    }

    /// The moved point of an index.
    #[inline]
    pub fn at(&self, index: usize) -> DVec3 {
        moved(self.points.at(self.kept[index] as usize), self.motion)
    }

    /// The moved points.
    pub fn listed(&self) -> Listed<impl Fn(usize) -> DVec3 + Sync> {
        Listed {
            count: self.len(),
            at: |index| self.at(index),
            order: Order::Any,
        }
    }

    /// The mean per voxel of an edge, in spatial order.
    pub fn voxels(&self, size: f64) -> Result<Vec<DVec3>> {
        Ok(downsample::voxel_of(
            self.len(),
            |index| self.at(index),
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
        assert_eq!(*points.positions(), [DVec3::ONE, DVec3::X]);
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
        let all = |moved: &Moved| (0..moved.len()).map(|i| moved.at(i)).collect::<Vec<_>>();
        let kept = Moved::new(&points, Some(motion), Some(&crop)).unwrap();
        assert_eq!(all(&kept), slow);
        assert!(kept.len() > 9_000 && kept.len() < 11_000);
        let thinned: Vec<DVec3> = slow.into_iter().step_by(7).collect();
        assert_eq!(all(&kept.every_kth(7)), thinned);
        assert_eq!(
            all(&Moved::new(&points, None, None).unwrap()),
            *points.positions()
        );
    }

    #[test]
    fn narrow_and_wide_coordinates_come_back_as_given() {
        let narrow = vec![DVec3::new(0.5, f64::from(-1e-3f32), f64::from(1e30f32)); 3];
        let mut wide = narrow.clone();
        wide.push(DVec3::new(0.1, 1e300, -5e-324));
        for points in [narrow, wide] {
            let finite = FinitePoints::new(points.clone());
            assert_eq!(*finite.positions(), points);
            assert!(finite.iter().eq(points));
        }
    }
}
