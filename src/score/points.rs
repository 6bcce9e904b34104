//! Points on their way through a protocol: finite, moved, cropped, thinned.

use crate::error::{Error, Result};
use crate::parallel;
use glam::{DMat4, DVec3, Vec3};
use mvs_datasets::scene::{CropVolume, PointCloud};
use mvs_metrics::Stretches;
use mvs_metrics::align::transform;
use mvs_metrics::crop::Prism;
use mvs_metrics::distance::{self, Take};
use mvs_metrics::downsample::{self, Members};

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

    /// Whether all coordinates are f32.
    pub fn are_narrow(&self) -> bool {
        matches!(self.positions, Positions::Single(_))
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

/// Points of a cloud, moved. Only which they are is in memory.
#[derive(Debug, Clone)]
pub struct Moved<'a> {
    points: &'a FinitePoints,
    motion: Option<DMat4>,
    kept: Stretches,
    /// The box around them, if all are finite.
    corners: Option<(DVec3, DVec3)>,
}

/// The box of nothing.
const NOWHERE: (DVec3, DVec3) = (DVec3::INFINITY, DVec3::NEG_INFINITY);

impl<'a> Moved<'a> {
    /// The points moved by `target_from_source` that lie inside `crop` (all, without one). An error
    /// where there are more points than 32 bits count.
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
        let blocks = parallel::map(points.len().div_ceil(BLOCK), |block| {
            let first = (block * BLOCK) as u32;
            let last = first.saturating_add(BLOCK as u32).min(count);
            let (mut kept, mut corners, mut finite) = (Stretches::default(), NOWHERE, true);
            for index in first..last {
                let point = moved(points.at(index as usize), motion);
                if crop.is_none_or(|crop| crop.contains(point)) {
                    kept.push(index);
                    finite &= point.is_finite();
                    corners = (corners.0.min(point), corners.1.max(point));
                }
            }
            (kept, finite.then_some(corners))
        });
        let (mut kept, mut corners) = (Stretches::default(), Some(NOWHERE));
        for (some, around) in &blocks {
            kept.append(some);
            let both = corners.zip(*around);
            corners = both.map(|(a, b)| (a.0.min(b.0), a.1.max(b.1)));
        }
        Ok(Self {
            points,
            motion,
            kept,
            corners,
        })
    }

    /// Only the points at 0, k, 2k, … of the order given.
    #[must_use]
    pub fn every_kth(self, k: usize) -> Self {
        if k <= 1 {
            return self;
        }
        let mut kept: Vec<u32> = self.given().step_by(k).collect();
        kept.sort_unstable();
        let kept = kept.into_iter().collect();
        // The box may be larger than theirs.
        let corners = None;
        Self {
            kept,
            corners,
            ..self
        }
    }

    /// As [`Moved::every_kth`], where `step` makes k of the number of points.
    #[must_use]
    pub fn every_kth_of(self, step: impl FnOnce(usize) -> usize) -> Self {
        let k = step(self.len());
        self.every_kth(k)
    }

    /// The indices kept, in the order in which their points were given.
    fn given(&self) -> impl Iterator<Item = u32> {
        let entry =
            |index: u32| u64::from(self.points.ranks[index as usize]) << 32 | u64::from(index);
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

    /// Whether all coordinates are f32.
    pub fn are_narrow(&self) -> bool {
        self.motion.is_none() && self.points.are_narrow()
    }

    /// Gives away the moved points, in spatial order.
    pub fn each(&self, take: &mut Take<'_>) -> mvs_metrics::Result<()> {
        let mut some = Vec::with_capacity(BLOCK);
        for index in self.kept.iter() {
            some.push(moved(self.points.at(index as usize), self.motion));
            if some.len() == BLOCK {
                take(&some)?;
                some.clear();
            }
        }
        take(&some)
    }

    /// Gives away the mean per voxel of an edge, accumulated in the order given; in spatial order.
    pub fn voxels(&self, size: f64, take: &mut Take<'_>) -> mvs_metrics::Result<()> {
        let members = Members {
            indices: &self.kept,
            at: |index| moved(self.points.at(index), self.motion),
            rank: |index| self.points.ranks[index],
            corners: self.corners,
        };
        downsample::voxel_each(&members, size, take)
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
        let slow_sorted = slow.clone(); // by x, as made
        let thinned: Vec<DVec3> = slow.into_iter().step_by(7).collect();
        let mut each = Vec::new();
        let mut take = |some: &[DVec3]| {
            each.extend_from_slice(some);
            Ok(())
        };
        kept.each(&mut take).unwrap();
        each.sort_by(|a, b| a.x.total_cmp(&b.x));
        assert_eq!(each, slow_sorted);
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
        let mut found = Vec::new();
        let moved = Moved::new(&finite, None, None).unwrap();
        let mut take = |some: &[DVec3]| {
            found.extend_from_slice(some);
            Ok(())
        };
        moved.voxels(0.15, &mut take).unwrap();
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
