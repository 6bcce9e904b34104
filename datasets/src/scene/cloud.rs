use super::aabb::Aabb;
use crate::error::{Error, Result};
use glam::{DVec3, Vec3};

/// A point cloud, one column per attribute. Every column present has one entry per point.
///
/// Positions are as read: they may be NaN or infinite, see [`PointCloud::without_non_finite`].
#[derive(Debug, Clone, Default, PartialEq)]
pub struct PointCloud {
    positions: Vec<DVec3>,
    normals: Option<Vec<Vec3>>,
    colors: Option<Vec<[u8; 3]>>,
    view_counts: Option<Vec<u32>>,
    confidences: Option<Vec<f32>>,
}

impl PointCloud {
    /// A cloud of bare positions, in world units.
    pub fn new(positions: Vec<DVec3>) -> Self {
        Self {
            positions,
            ..Self::default()
        }
    }

    /// The same cloud with unit normals in the world frame.
    ///
    /// # Errors
    /// A count of normals that is not that of the points.
    pub fn with_normals(mut self, normals: Vec<Vec3>) -> Result<Self> {
        self.check("normals", normals.len())?;
        self.normals = Some(normals);
        Ok(self)
    }

    /// The same cloud with 8-bit sRGB colours.
    ///
    /// # Errors
    /// A count of colours that is not that of the points.
    pub fn with_colors(mut self, colors: Vec<[u8; 3]>) -> Result<Self> {
        self.check("colors", colors.len())?;
        self.colors = Some(colors);
        Ok(self)
    }

    /// The same cloud with, per point, the number of distinct views that agree on it.
    ///
    /// # Errors
    /// A count of numbers that is not that of the points.
    pub fn with_view_counts(mut self, view_counts: Vec<u32>) -> Result<Self> {
        self.check("view counts", view_counts.len())?;
        self.view_counts = Some(view_counts);
        Ok(self)
    }

    /// The same cloud with a confidence per point.
    ///
    /// # Errors
    /// A count of confidences that is not that of the points.
    pub fn with_confidences(mut self, confidences: Vec<f32>) -> Result<Self> {
        self.check("confidences", confidences.len())?;
        self.confidences = Some(confidences);
        Ok(self)
    }

    fn check(&self, column: &str, found: usize) -> Result<()> {
        let expected = self.positions.len();
        if found == expected {
            return Ok(());
        }
        let problem = format!("expected {expected} {column}, one per point, found {found}");
        Err(Error::invalid("point cloud", problem))
    }

    /// How many points.
    pub fn len(&self) -> usize {
        self.positions.len()
    }

    /// Whether there are no points.
    pub fn is_empty(&self) -> bool {
        self.positions.is_empty()
    }

    /// Positions in world units.
    pub fn positions(&self) -> &[DVec3] {
        &self.positions
    }

    /// The positions alone, taken out of the cloud.
    pub fn into_positions(self) -> Vec<DVec3> {
        self.positions
    }

    /// Unit normals in the world frame.
    pub fn normals(&self) -> Option<&[Vec3]> {
        self.normals.as_deref()
    }

    /// 8-bit sRGB colours.
    pub fn colors(&self) -> Option<&[[u8; 3]]> {
        self.colors.as_deref()
    }

    /// Distinct views that agree on each point.
    pub fn view_counts(&self) -> Option<&[u32]> {
        self.view_counts.as_deref()
    }

    /// Confidence of each point.
    pub fn confidences(&self) -> Option<&[f32]> {
        self.confidences.as_deref()
    }

    /// The box around all positions.
    pub fn bounds(&self) -> Aabb {
        Aabb::around(self.positions.iter().copied())
    }

    /// The points at `indices`, in that order, with all their attributes.
    #[must_use]
    pub fn select(&self, indices: &[usize]) -> Self {
        fn pick<T: Copy>(column: &[T], indices: &[usize]) -> Vec<T> {
            indices.iter().map(|&index| column[index]).collect()
        }
        Self {
            positions: pick(&self.positions, indices),
            normals: self.normals.as_ref().map(|column| pick(column, indices)),
            colors: self.colors.as_ref().map(|column| pick(column, indices)),
            view_counts: self
                .view_counts
                .as_ref()
                .map(|column| pick(column, indices)),
            confidences: self
                .confidences
                .as_ref()
                .map(|column| pick(column, indices)),
        }
    }

    /// The cloud without its points at NaN or infinity, and how many those were.
    #[must_use]
    pub fn without_non_finite(self) -> (Self, usize) {
        if self.positions.iter().all(|position| position.is_finite()) {
            return (self, 0);
        }
        let kept: Vec<usize> = (0..self.len())
            .filter(|&index| self.positions[index].is_finite())
            .collect();
        let dropped = self.len() - kept.len();
        (self.select(&kept), dropped)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_have_one_entry_per_point() {
        let cloud = PointCloud::new(vec![DVec3::ZERO, DVec3::ONE]);
        let error = cloud
            .clone()
            .with_colors(vec![[0; 3]])
            .unwrap_err()
            .to_string();
        assert!(
            error.contains("expected 2 colors") && error.contains("found 1"),
            "{error}"
        );
        assert!(cloud.with_normals(vec![Vec3::X, Vec3::Y]).is_ok());
    }

    #[test]
    fn non_finite_points_leave_with_their_attributes() {
        let positions = vec![
            DVec3::ONE,
            DVec3::new(f64::NAN, 0.0, 0.0),
            DVec3::X,
            DVec3::splat(f64::INFINITY),
        ];
        let cloud = PointCloud::new(positions)
            .with_view_counts(vec![1, 2, 3, 4])
            .unwrap();
        let (cloud, dropped) = cloud.without_non_finite();
        assert_eq!(
            (cloud.positions(), dropped),
            (&[DVec3::ONE, DVec3::X][..], 2)
        );
        assert_eq!(cloud.view_counts(), Some(&[1, 3][..]));
    }
}
