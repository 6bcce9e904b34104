use crate::error::{Error, Result};
use glam::{DMat3, DMat4, DVec3, DVec4};

/// A similarity transform `target_from_source`: x ↦ scale · rotation · x + translation, scale > 0.
///
/// The matrix is kept as read, so that applying it gives what the reference tools give.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Similarity {
    matrix: DMat4,
    scale: f64,
}

impl Similarity {
    /// The transform that changes nothing.
    pub const IDENTITY: Self = Self {
        matrix: DMat4::IDENTITY,
        scale: 1.0,
    };

    /// A similarity from its 4×4 matrix. The last row must be 0 0 0 1; the upper left 3×3 must be a
    /// rotation times a positive scale, to 1e-3 relative (text files round).
    ///
    /// # Errors
    /// NaN and infinity, another last row, a scale that is not above 0, and what is no rotation times a scale.
    pub fn from_matrix(target_from_source: DMat4) -> Result<Self> {
        if !target_from_source.is_finite() {
            let problem = "expected finite numbers, found NaN or infinity";
            return Err(Error::invalid("similarity transform", problem));
        }
        let last = target_from_source.row(3);
        if last != DVec4::W {
            let problem = format!("expected a last row of 0 0 0 1, found {last}");
            return Err(Error::invalid("similarity transform", problem));
        }
        let linear = DMat3::from_mat4(target_from_source);
        let scale = libm::cbrt(linear.determinant());
        if !(scale.is_finite() && scale > 0.0) {
            let problem = format!("expected a scale above 0, found {scale}");
            return Err(Error::invalid("similarity transform", problem));
        }
        let rotation = linear * (1.0 / scale);
        let residual = rotation * rotation.transpose() - DMat3::IDENTITY;
        let worst = residual
            .to_cols_array()
            .into_iter()
            .fold(0.0f64, |w, r| w.max(r.abs()));
        if worst > 2e-3 {
            let problem =
                format!("expected a rotation times a scale, found one off by {worst:.3e}");
            return Err(Error::invalid("similarity transform", problem));
        }
        Ok(Self {
            matrix: target_from_source,
            scale,
        })
    }

    /// The 4×4 matrix `target_from_source`.
    pub fn matrix(&self) -> DMat4 {
        self.matrix
    }

    /// The scale, > 0.
    pub fn scale(&self) -> f64 {
        self.scale
    }

    /// A point of the source frame in the target frame.
    pub fn apply(&self, point_in_source: DVec3) -> DVec3 {
        self.matrix.transform_point3(point_in_source)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scale_is_read_off_the_matrix() {
        let rotation = glam::DQuat::from_rotation_y(0.7);
        let matrix =
            DMat4::from_scale_rotation_translation(DVec3::splat(2.5), rotation, DVec3::ONE);
        let similarity = Similarity::from_matrix(matrix).unwrap();
        assert!((similarity.scale() - 2.5).abs() < 1e-12);
        let moved = similarity.apply(DVec3::X);
        assert!((moved - (2.5 * (rotation * DVec3::X) + DVec3::ONE)).length() < 1e-12);
    }

    #[test]
    fn shear_mirror_and_zero_are_refused() {
        for diagonal in [
            DVec3::new(1.0, 1.0, 1.1),
            DVec3::new(1.0, 1.0, -1.0),
            DVec3::ZERO,
        ] {
            assert!(
                Similarity::from_matrix(DMat4::from_scale(diagonal)).is_err(),
                "{diagonal}"
            );
        }
        let mut projective = DMat4::IDENTITY;
        projective.x_axis.w = 0.1;
        assert!(
            Similarity::from_matrix(projective)
                .unwrap_err()
                .to_string()
                .contains("last row")
        );
    }
}
