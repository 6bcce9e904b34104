//! Points on their way through a protocol: finite, moved, cropped, thinned.

use crate::error::Result;
use crate::parallel;
use glam::{DMat4, DVec3};
use mvs_datasets::scene::{CropVolume, PointCloud};
use mvs_metrics::align::transform;
use mvs_metrics::crop::Prism;

/// Points handled by one task.
const BLOCK: usize = 1 << 15;

/// Finite positions, and how many others there were.
#[derive(Debug, Clone, PartialEq)]
pub struct FinitePoints {
    positions: Vec<DVec3>,
    non_finite: usize,
}

impl FinitePoints {
    /// The finite ones of `positions`, in their order.
    pub fn new(mut positions: Vec<DVec3>) -> Self {
        let input = positions.len();
        positions.retain(|position| position.is_finite());
        let non_finite = input - positions.len();
        Self {
            positions,
            non_finite,
        }
    }

    /// The finite positions of a cloud; its other columns are dropped.
    pub fn of_cloud(cloud: PointCloud) -> Self {
        Self::new(cloud.into_positions())
    }

    /// The finite positions, in world units.
    pub fn positions(&self) -> &[DVec3] {
        &self.positions
    }

    /// How many points were given, the dropped ones included.
    pub fn input(&self) -> usize {
        self.positions.len() + self.non_finite
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

/// The points moved by `target_from_source` that lie inside `crop` (all, without one), in their
/// order. Only these are ever in memory.
pub fn moved_and_cropped(
    points: &[DVec3],
    target_from_source: Option<DMat4>,
    crop: Option<&Prism>,
) -> Vec<DVec3> {
    let blocks = parallel::map(points.len().div_ceil(BLOCK), |block| {
        let first = block * BLOCK;
        let last = points.len().min(first + BLOCK);
        let moved = points[first..last]
            .iter()
            .map(|&point| target_from_source.map_or(point, |motion| transform(motion, point)));
        moved
            .filter(|&point| crop.is_none_or(|crop| crop.contains(point)))
            .collect::<Vec<_>>()
    });
    blocks.concat()
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
        let kept = moved_and_cropped(&points, Some(motion), Some(&crop));
        let slow: Vec<DVec3> = points
            .iter()
            .map(|&point| motion.transform_point3(point))
            .filter(|&point| crop.contains(point))
            .collect();
        assert_eq!(kept, slow);
        assert!(kept.len() > 9_000 && kept.len() < 11_000);
        assert_eq!(moved_and_cropped(&points, None, None), points);
    }
}
