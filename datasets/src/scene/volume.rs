use crate::error::{Error, Result};
use glam::{DVec2, DVec3};

/// One of the three coordinate axes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Axis {
    /// The first coordinate.
    X,
    /// The second coordinate.
    Y,
    /// The third coordinate.
    Z,
}

impl Axis {
    /// The axis as an index: 0, 1 or 2.
    pub fn index(self) -> usize {
        self as usize
    }

    /// The indices (u, v) of the two other axes, ascending, as Open3D pairs them.
    pub fn others(self) -> (usize, usize) {
        match self {
            Self::X => (1, 2),
            Self::Y => (0, 2),
            Self::Z => (0, 1),
        }
    }
}

/// A prism: a polygon in the plane of two axes, between two bounds on the third.
///
/// This is Open3D's `SelectionPolygonVolume`: the region in which Tanks and Temples scores. The
/// polygon has at least three vertices, all finite, and `min ≤ max`.
#[derive(Debug, Clone, PartialEq)]
pub struct CropVolume {
    axis: Axis,
    min: f64,
    max: f64,
    polygon: Vec<DVec2>,
}

impl CropVolume {
    /// A volume from `min ≤ x_axis ≤ max` and a polygon over the two other axes, given as 3-D
    /// points whose `axis` coordinate is ignored.
    ///
    /// # Errors
    /// Bounds that are not finite or are crossed, fewer than three vertices, and vertices that are not finite.
    pub fn new(axis: Axis, min: f64, max: f64, bounding_polygon: &[DVec3]) -> Result<Self> {
        if !(min.is_finite() && max.is_finite() && min <= max) {
            let problem = format!("expected finite axis_min ≤ axis_max, found {min} and {max}");
            return Err(Error::invalid("crop volume", problem));
        }
        if bounding_polygon.len() < 3 {
            let found = bounding_polygon.len();
            let problem = format!("expected a polygon of at least 3 vertices, found {found}");
            return Err(Error::invalid("crop volume", problem));
        }
        let (u, v) = axis.others();
        let polygon: Vec<DVec2> = bounding_polygon
            .iter()
            .map(|vertex| DVec2::new(vertex[u], vertex[v]))
            .collect();
        if let Some(index) = polygon.iter().position(|vertex| !vertex.is_finite()) {
            let problem =
                format!("expected finite polygon vertices, found NaN or infinity at {index}");
            return Err(Error::invalid("crop volume", problem));
        }
        Ok(Self {
            axis,
            min,
            max,
            polygon,
        })
    }

    /// The axis along which the polygon is swept.
    pub fn axis(&self) -> Axis {
        self.axis
    }

    /// The bounds on that axis, in world units.
    pub fn range(&self) -> (f64, f64) {
        (self.min, self.max)
    }

    /// The polygon over the two other axes, in [`Axis::others`] order.
    pub fn polygon(&self) -> &[DVec2] {
        &self.polygon
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_swept_axis_is_dropped_from_the_polygon() {
        let corners = [
            DVec3::new(1.0, 2.0, 3.0),
            DVec3::new(4.0, 5.0, 6.0),
            DVec3::ZERO,
        ];
        let volume = CropVolume::new(Axis::Y, -1.0, 1.0, &corners).unwrap();
        assert_eq!(volume.polygon()[0], DVec2::new(1.0, 3.0));
        assert_eq!(volume.polygon()[1], DVec2::new(4.0, 6.0));
    }

    #[test]
    fn two_corners_or_crossed_bounds_are_no_volume() {
        assert!(CropVolume::new(Axis::Z, 0.0, 1.0, &[DVec3::ZERO; 2]).is_err());
        assert!(CropVolume::new(Axis::Z, 1.0, 0.0, &[DVec3::ZERO; 3]).is_err());
        assert!(CropVolume::new(Axis::Z, 0.0, f64::NAN, &[DVec3::ZERO; 3]).is_err());
    }
}
