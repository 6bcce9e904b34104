//! Points on their way through a protocol: finite, moved, cropped, thinned.

use crate::error::{Error, Result};
use crate::parallel;
use glam::{DMat3, DMat4, DVec3, Vec3};
use mvs_datasets::scene::{Aabb, CropVolume};
use mvs_metrics::Stretches;
use mvs_metrics::align::transform;
use mvs_metrics::crop::Prism;
use mvs_metrics::distance::{self, Take};
use mvs_metrics::downsample::{self, Members, Point};
use std::ops::Range;

/// Points handled by one task.
const BLOCK: usize = 1 << 15;
/// Neighbours with a box around them.
const BOX: usize = 128;
/// Covers the rounding of a moved box and of the points in it, relative to their coordinates.
const ROUNDING: f64 = 1e-12;

/// The lower and the upper corner of a box.
type Corners = (DVec3, DVec3);
/// The box of nothing.
const NOWHERE: Corners = (DVec3::INFINITY, DVec3::NEG_INFINITY);

/// Finite positions, and how many others there were. They lie in spatial order, so that whatever
/// follows finds neighbours close in memory; their order as given is kept beside.
#[derive(Debug, Clone, PartialEq)]
pub struct FinitePoints {
    positions: Positions,
    /// The boxes around each [`BOX`] neighbours.
    boxes: Vec<Corners>,
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
        if !parallel::all(input, |index| positions[index].is_finite()) {
            positions.retain(|position| position.is_finite());
        }
        let count = positions.len();
        let non_finite = input - count;
        let ranks = distance::spatial_order(&positions);
        let ordered = |index: usize| positions[ranks[index] as usize];
        let is_single = |index: usize| {
            let position = positions[index];
            position.as_vec3().as_dvec3() == position
        };
        let positions = if parallel::all(count, is_single) {
            Positions::Single(parallel::map_each(count, |index| ordered(index).as_vec3()))
        } else {
            Positions::Double(parallel::map_each(count, ordered))
        };
        let mut points = Self {
            positions,
            boxes: Vec::new(),
            ranks,
            non_finite,
        };
        points.boxes = parallel::map(points.len().div_ceil(BOX), |nth| {
            let indices = nth * BOX..points.len().min((nth + 1) * BOX);
            indices.fold(NOWHERE, |corners, index| around(corners, points.at(index)))
        });
        points
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

    /// The box around the finite points.
    pub fn bounds(&self) -> Aabb {
        let (min, max) = self.boxes.iter().fold(NOWHERE, joined);
        Aabb { min, max }
    }

    /// The box around the finite points once each is moved.
    pub fn moved_bounds(&self, motion: DMat4) -> Aabb {
        let boxes = parallel::map(self.len().div_ceil(BLOCK), |block| {
            let indices = block * BLOCK..self.len().min((block + 1) * BLOCK);
            indices.fold(NOWHERE, |corners, index| {
                around(corners, motion.transform_point3(self.at(index)))
            })
        });
        let (min, max) = boxes.iter().fold(NOWHERE, joined);
        Aabb { min, max }
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
///
/// # Errors
/// Never: a [`CropVolume`] has what [`Prism::new`] asks for.
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
    corners: Option<Corners>,
}

/// What is kept of a block.
struct Part {
    kept: Stretches,
    /// Boxes kept as a whole: their numbers, and where all of their points are once moved.
    whole: Vec<(usize, Corners)>,
    /// The box around the other points, if all are finite.
    corners: Option<Corners>,
}

impl<'a> Moved<'a> {
    /// The points moved by `target_from_source` that lie inside `crop` (all, without one).
    ///
    /// # Errors
    /// More points than 32 bits count.
    pub fn new(
        points: &'a FinitePoints,
        target_from_source: Option<DMat4>,
        crop: Option<&Prism>,
    ) -> Result<Self> {
        u32::try_from(points.len()).map_err(|_| {
            let problem = format!("expected at most 4294967295 points, found {}", points.len());
            Error::invalid("cloud", problem)
        })?;
        let mut moved = Self {
            points,
            motion: target_from_source,
            kept: Stretches::default(),
            corners: None,
        };
        let blocks = points.len().div_ceil(BLOCK);
        let parts = parallel::map(blocks, |block| moved.part(block, crop));
        parts.iter().for_each(|part| moved.kept.append(&part.kept));
        moved.corners = moved.corners_of(&parts);
        Ok(moved)
    }

    /// What a crop keeps of a block.
    fn part(&self, block: usize, crop: Option<&Prism>) -> Part {
        let (mut kept, mut corners, mut finite) = (Stretches::default(), NOWHERE, true);
        let mut whole = Vec::new();
        let boxes = BLOCK / BOX;
        for nth in block * boxes..self.points.boxes.len().min((block + 1) * boxes) {
            let indices = self.box_indices(nth);
            let moved = self.moved_box(nth);
            let holds = match crop {
                Some(crop) => crop.holds(moved),
                None => (moved.0.is_finite() && moved.1.is_finite()).then_some(true),
            };
            match holds {
                Some(true) => {
                    kept.push_all(indices.start as u32, indices.len() as u32);
                    whole.push((nth, moved));
                }
                Some(false) => {}
                None => {
                    for index in indices {
                        let point = self.at(index);
                        if crop.is_none_or(|crop| crop.contains(point)) {
                            kept.push(index as u32);
                            finite &= point.is_finite();
                            corners = around(corners, point);
                        }
                    }
                }
            }
        }
        Part {
            kept,
            whole,
            corners: finite.then_some(corners),
        }
    }

    fn box_indices(&self, nth: usize) -> Range<usize> {
        nth * BOX..self.points.len().min((nth + 1) * BOX)
    }

    /// A box that all points of one are in once they are moved.
    fn moved_box(&self, nth: usize) -> Corners {
        let (min, max) = self.points.boxes[nth];
        let Some(motion) = self.motion else {
            return (min, max);
        };
        let (centre, half) = (0.5 * min + 0.5 * max, 0.5 * max - 0.5 * min);
        let sizes = DMat3::from_mat4(motion).abs();
        let middle = transform(motion, centre);
        let rounding = ROUNDING * (sizes * (centre.abs() + half) + motion.w_axis.truncate().abs());
        let half = sizes * half + rounding;
        (middle - half, middle + half)
    }

    /// The box around all that is kept, if all is finite. Of the boxes kept as a whole only those are
    /// looked into that may reach farther than what is known.
    fn corners_of(&self, parts: &[Part]) -> Option<Corners> {
        let mut corners = NOWHERE;
        for part in parts {
            let (min, max) = part.corners?;
            corners = (corners.0.min(min), corners.1.max(max));
        }
        let whole = || parts.iter().flat_map(|part| &part.whole);
        let mut look_into = |&(nth, (min, max)): &(usize, Corners)| {
            if min.cmplt(corners.0).any() || max.cmpgt(corners.1).any() {
                let points = self.box_indices(nth).map(|index| self.at(index));
                corners = points.fold(corners, around);
            }
        };
        for axis in 0..3 {
            whole()
                .min_by(|a, b| a.1.0[axis].total_cmp(&b.1.0[axis]))
                .map(&mut look_into);
            whole()
                .max_by(|a, b| a.1.1[axis].total_cmp(&b.1.1[axis]))
                .map(&mut look_into);
        }
        whole().for_each(look_into);
        Some(corners)
    }

    /// The moved point of an index.
    #[inline]
    fn at(&self, index: usize) -> DVec3 {
        moved(self.points.at(index), self.motion)
    }

    /// Writes the moved points from an index on into as much room as there is.
    fn write(&self, first: usize, room: &mut [Point]) {
        let end = first + room.len();
        match (&self.points.positions, self.motion) {
            (Positions::Single(positions), Some(motion)) => {
                for (place, position) in room.iter_mut().zip(&positions[first..end]) {
                    *place = transform(motion, position.as_dvec3()).to_array();
                }
            }
            (Positions::Single(positions), None) => {
                for (place, position) in room.iter_mut().zip(&positions[first..end]) {
                    *place = position.as_dvec3().to_array();
                }
            }
            (Positions::Double(positions), motion) => {
                for (place, &position) in room.iter_mut().zip(&positions[first..end]) {
                    *place = moved(position, motion).to_array();
                }
            }
        }
    }

    /// Only the points at 0, k, 2k, … of the order given.
    #[must_use]
    pub fn every_kth(self, k: usize) -> Self {
        if k <= 1 {
            return self;
        }
        let kept = self.given().into_iter().step_by(k);
        let mut kept: Vec<u32> = kept.map(|entry| entry as u32).collect();
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

    /// The indices kept in the low halves, in the order in which their points were given.
    fn given(&self) -> Vec<u64> {
        let entry =
            |index: u32| u64::from(self.points.ranks[index as usize]) << 32 | u64::from(index);
        let mut entries: Vec<u64> = self.kept.iter().map(entry).collect();
        parallel::sort(&mut entries);
        entries
    }

    /// The moved points in the order given.
    pub fn in_given_order(&self) -> Vec<DVec3> {
        let given = self.given();
        parallel::map_each(given.len(), |nth| self.at(given[nth] as u32 as usize))
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
    ///
    /// # Errors
    /// What `take` brings.
    pub fn each(&self, take: &mut Take<'_>) -> mvs_metrics::Result<()> {
        let mut some = Vec::with_capacity(BLOCK);
        for nth in (0..self.len()).step_by(BLOCK) {
            for stretch in self.kept.stretches(nth, BLOCK) {
                some.extend(stretch.map(|index| self.at(index as usize)));
            }
            take(&some)?;
            some.clear();
        }
        Ok(())
    }

    /// Gives away the mean per voxel of an edge, accumulated in the order given; in spatial order.
    ///
    /// # Errors
    /// An edge that is not finite and above 0, points that are not finite where they are moved to, more than 2³¹ − 1
    /// voxels along an axis, and what `take` brings.
    pub fn voxels(&self, size: f64, take: &mut Take<'_>) -> mvs_metrics::Result<()> {
        let members = Members {
            indices: &self.kept,
            points: |first: usize, room: &mut [Point]| self.write(first, room),
            rank: |index| self.points.ranks[index],
            corners: self.corners,
        };
        downsample::voxel_each(&members, size, take)
    }
}

/// The box around both.
fn joined((min, max): Corners, other: &Corners) -> Corners {
    (min.min(other.0), max.max(other.1))
}

/// The box and a point that is not NaN.
#[inline]
fn around((min, max): Corners, point: DVec3) -> Corners {
    (min.min(point), max.max(point))
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

    /// Boxes inside, outside and across the border, turned and scaled, against a look at every point.
    #[test]
    fn a_turned_cloud_is_cropped_point_by_point() {
        let hash =
            |i: u64| (i.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 40) as f64 / f64::from(1 << 23);
        let points: Vec<DVec3> = (0..60_000u64)
            .map(|i| {
                let along = DVec3::new(hash(3 * i), hash(3 * i + 1), hash(3 * i + 2));
                DVec3::new(5e5, 4e6, 100.0) + 10.0 * along
            })
            .collect();
        let star =
            |k: u32| (3.0 + 4.0 * f64::from(k * 3 % 5)) * DVec2::from_angle(f64::from(k) * 0.6);
        let star: Vec<DVec2> = (0..10).map(star).collect();
        let crop = Prism::new(0, (-8.0, 11.0), &star).unwrap();
        let turn = DMat4::from_scale_rotation_translation(
            DVec3::splat(2.0),
            glam::DQuat::from_rotation_z(0.7) * glam::DQuat::from_rotation_x(-0.4),
            DVec3::ZERO,
        );
        let middle = transform(turn, DVec3::new(500_010.0, 4_000_010.0, 110.0));
        let motion = DMat4::from_translation(-middle) * turn;
        let finite = FinitePoints::new(points.clone());
        for motion in [Some(motion), None] {
            let at = |&point: &DVec3| moved(point, motion);
            let expected: Vec<DVec3> = points
                .iter()
                .map(at)
                .filter(|&p| crop.contains(p))
                .collect();
            let kept = Moved::new(&finite, motion, Some(&crop)).unwrap();
            assert_eq!(kept.in_given_order(), expected);
            if motion.is_some() {
                assert!(kept.len() > 1_000 && kept.len() < 50_000, "{}", kept.len());
                let corners = expected.into_iter().fold(NOWHERE, around);
                assert_eq!(kept.corners, Some(corners));
            }
            let all = Moved::new(&finite, motion, None).unwrap();
            let corners = points.iter().map(at).fold(NOWHERE, around);
            assert_eq!((all.len(), all.corners), (points.len(), Some(corners)));
        }
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
