//! One point per voxel: what several views' pixels say of the same place, merged.

use super::points::{Columns, PointSink, Points};
use crate::error::{Error, Result};
use glam::{DVec3, Vec3};
#[allow(
    clippy::disallowed_types,
    reason = "looked up by voxel, never walked through"
)]
use std::collections::HashMap;

/// Merges points as they come.
///
/// The rule: voxels of edge `size` tile the world from its origin; the points in one become one, at
/// their mean. Normals (made unit length again), colours and confidences are means too; a point is
/// seen by all views that any of its points is seen by, `violations` is the largest and `scale` the
/// smallest. Merged points stand in the order in which their first points came. All of them are in
/// memory.
#[derive(Debug)]
pub struct VoxelSink {
    size: f64,
    columns: Columns,
    /// Place in `cells` by voxel; never walked through.
    #[allow(
        clippy::disallowed_types,
        reason = "looked up by voxel, never walked through"
    )]
    places: HashMap<[i64; 3], usize>,
    cells: Vec<Cell>,
    taken: u64,
}

/// What one voxel holds: sums, and what is kept.
#[derive(Debug, Clone)]
struct Cell {
    /// Offset from here keeps sums exact at large coordinates.
    first: DVec3,
    count: u32,
    offset: DVec3,
    normal: Vec3,
    color: [u64; 3],
    confidence: f64,
    violations: u32,
    scale: f32,
    views: Vec<u32>,
    /// How many of `views` are known to be distinct.
    distinct: usize,
}

impl VoxelSink {
    /// Voxels of edge `size` in world units.
    ///
    /// # Errors
    /// A size that is not finite and above 0.
    pub fn new(size: f64, columns: Columns) -> Result<Self> {
        if !(size.is_finite() && size > 0.0) {
            let problem = format!("expected an edge above 0, found {size:?}");
            return Err(Error::invalid("voxel", problem));
        }
        Ok(Self {
            size,
            columns,
            places: Default::default(),
            cells: Vec::new(),
            taken: 0,
        })
    }

    /// The merged points, and how many points became part of another one.
    pub fn finish(self) -> (Points, u64) {
        let mut points = Points::default();
        let merged = self.taken - self.cells.len() as u64;
        for cell in self.cells {
            cell.push(self.columns, &mut points);
        }
        (points, merged)
    }

    fn cell(&mut self, position: DVec3) -> Result<&mut Cell> {
        let index = (position / self.size).floor();
        if index.abs().max_element() > 9e15 {
            let problem = format!(
                "expected an edge that counts the voxels up to {position}, found {:?}",
                self.size
            );
            return Err(Error::invalid("voxel", problem));
        }
        let key = [index.x as i64, index.y as i64, index.z as i64];
        let next = self.cells.len();
        let place = *self.places.entry(key).or_insert(next);
        if place == next {
            self.cells.push(Cell::at(position));
        }
        Ok(&mut self.cells[place])
    }
}

impl Cell {
    fn at(position: DVec3) -> Self {
        Self {
            first: position,
            count: 0,
            offset: DVec3::ZERO,
            normal: Vec3::ZERO,
            color: [0; 3],
            confidence: 0.0,
            violations: 0,
            scale: f32::INFINITY,
            views: Vec::new(),
            distinct: 0,
        }
    }

    /// Adds views; a list that has doubled is thinned to distinct ones, so that it stays short.
    fn see(&mut self, views: &[u32]) {
        self.views.extend(views);
        if self.views.len() > 2 * self.distinct.max(32) {
            self.views.sort_unstable();
            self.views.dedup();
            self.distinct = self.views.len();
        }
    }

    fn push(mut self, columns: Columns, points: &mut Points) {
        self.views.sort_unstable();
        self.views.dedup();
        let count = f64::from(self.count);
        points.positions.push(self.first + self.offset / count);
        if columns.has(Columns::NORMALS) {
            points.normals.push(self.normal.normalize_or_zero());
        }
        if columns.has(Columns::COLORS) {
            let merged = u64::from(self.count);
            let mean = |sum: u64| u8::try_from((sum + merged / 2) / merged);
            points
                .colors
                .push(self.color.map(|sum| mean(sum).unwrap_or(u8::MAX)));
        }
        if columns.has(Columns::CONFIDENCES) {
            #[allow(clippy::cast_possible_truncation, reason = "a mean of f32")]
            points.confidences.push((self.confidence / count) as f32);
        }
        points
            .view_counts
            .push(u32::try_from(self.views.len()).unwrap_or(u32::MAX));
        points.violations.push(self.violations);
        points.scales.push(self.scale);
        points.visible_in.extend(self.views);
    }
}

impl PointSink for VoxelSink {
    fn take(&mut self, points: &Points) -> Result<()> {
        let mut views = points.visible_in.as_slice();
        let columns = self.columns;
        for (at, &position) in points.positions.iter().enumerate() {
            let (own, others) = views.split_at(points.view_counts[at] as usize);
            views = others;
            let cell = self.cell(position)?;
            cell.count += 1;
            cell.offset += position - cell.first;
            if columns.has(Columns::NORMALS) {
                cell.normal += points.normals[at];
            }
            if columns.has(Columns::COLORS) {
                for (sum, value) in cell.color.iter_mut().zip(points.colors[at]) {
                    *sum += u64::from(value);
                }
            }
            if columns.has(Columns::CONFIDENCES) {
                cell.confidence += f64::from(points.confidences[at]);
            }
            cell.violations = cell.violations.max(points.violations[at]);
            cell.scale = cell.scale.min(points.scales[at]);
            cell.see(own);
        }
        self.taken += points.len() as u64;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn points(rows: &[([f64; 3], &[u32])]) -> Points {
        let mut points = Points::default();
        for (index, (position, views)) in (0u8..).zip(rows) {
            points.positions.push(DVec3::from_array(*position));
            points.normals.push(if index.is_multiple_of(2) {
                Vec3::X
            } else {
                Vec3::Y
            });
            points.colors.push([index * 10, 0, 255]);
            points.confidences.push(f32::from(index));
            points.view_counts.push(views.len() as u32);
            points.violations.push(u32::from(index));
            points.scales.push(1.0 + f32::from(index));
            points.visible_in.extend(*views);
        }
        points
    }

    #[test]
    fn a_voxel_of_many_points_keeps_its_colour_and_a_short_list_of_views() {
        let columns = Columns::COLORS;
        let mut voxels = VoxelSink::new(1e3, columns).unwrap();
        let cell = voxels.cell(DVec3::ONE).unwrap();
        // As 17 million white points leave it.
        (cell.count, cell.color) = (17_000_000, [17_000_000 * 255; 3]);
        (0..1000).for_each(|view| cell.see(&[view % 7, 3]));
        assert!(cell.views.len() <= 64, "{}", cell.views.len());
        (cell.violations, cell.scale) = (0, 1.0);
        voxels.taken = 17_000_000;
        let (points, merged) = voxels.finish();
        assert_eq!(points.colors, [[255; 3]]);
        assert_eq!(points.visible_in, [0, 1, 2, 3, 4, 5, 6]);
        assert_eq!(merged, 16_999_999);
    }

    #[test]
    fn points_of_one_voxel_become_one_by_the_stated_rule() {
        let columns = Columns::NORMALS
            .and(Columns::COLORS)
            .and(Columns::CONFIDENCES);
        let mut sink = VoxelSink::new(0.5, columns).unwrap();
        let given = points(&[
            ([0.1, 0.1, 0.1], &[0, 2]),
            ([-0.1, 0.1, 0.1], &[1]),
            ([0.3, 0.2, 0.1], &[2, 1, 4]),
        ]);
        sink.take(&given).unwrap();
        sink.take(&points(&[([0.2, 0.3, 0.4], &[3])])).unwrap();
        let (found, merged) = sink.finish();
        assert_eq!((found.len(), merged), (2, 2));
        let expected = DVec3::new(0.2, 0.2, 0.2);
        assert!(
            (found.positions[0] - expected).length() < 1e-15,
            "{}",
            found.positions[0]
        );
        assert_eq!(found.positions[1], DVec3::new(-0.1, 0.1, 0.1));
        assert_eq!(found.normals, [Vec3::X, Vec3::Y]);
        assert_eq!(found.colors, [[7, 0, 255], [10, 0, 255]]);
        assert_eq!(found.confidences, [2.0 / 3.0, 1.0]);
        assert_eq!(
            (found.view_counts, found.visible_in),
            (vec![5, 1], vec![0, 1, 2, 3, 4, 1])
        );
        assert_eq!(
            (found.violations, found.scales),
            (vec![2, 1], vec![1.0, 2.0])
        );
    }

    #[test]
    fn sizes_that_no_voxel_can_have_are_refused() {
        for size in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert!(VoxelSink::new(size, Columns::default()).is_err());
        }
        let mut sink = VoxelSink::new(1e-12, Columns::default()).unwrap();
        let far = points(&[([1e6, 0.0, 0.0], &[0])]);
        assert!(sink.take(&far).is_err());
    }
}
