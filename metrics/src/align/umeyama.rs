//! The similarity of least squares between corresponding points (Umeyama, PAMI 1991).

use crate::distance::PairSums;
use crate::error::{Error, Result};
use glam::{DMat4, DVec3};
use nalgebra::{Matrix3, Vector3};

/// The similarity `target_from_source` that moves `source[i]` onto `target[i]` with the least sum of
/// squares; with `Scale::One` the rigid motion. Sums run in fixed order.
///
/// Fewer than three points, or points on a line, leave the rotation partly free: one of the best is
/// returned.
///
/// # Errors
/// Lengths that differ, no points, coordinates that are not finite or so large that products overflow, and points
/// that no scale above 0 fits where one is asked: those of either side coincide, say.
pub fn umeyama(source: &[DVec3], target: &[DVec3], scale: Scale) -> Result<DMat4> {
    if source.len() != target.len() || source.is_empty() {
        let (s, t) = (source.len(), target.len());
        let problem =
            format!("expected as many source as target points, at least one, found {s} and {t}");
        return Err(Error::invalid("similarity fit", problem));
    }
    Moments::of(source, target).solve(scale)
}

/// Whether a fit may change the size.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
pub enum Scale {
    /// Rotation and translation only.
    One,
    /// Rotation, translation and the scale of least squares in the frame of the target: Umeyama's.
    /// Noise of the source draws it towards 0, as in any regression on a noisy variable.
    Free,
    /// Rotation, translation and the scale of least squares in the frame of the source: that of the
    /// fit from target to source, inverted. Noise of the source leaves it where it is.
    FreeInSource,
}

/// What the fit needs to know of the correspondences.
pub(crate) struct Moments {
    /// Mean of the source points.
    pub(crate) source_mean: DVec3,
    /// Mean of the target points.
    pub(crate) target_mean: DVec3,
    /// Mean of (target − mean)(source − mean)ᵀ, by columns of the source axis.
    pub(crate) covariance: [DVec3; 3],
    /// Mean of |source − mean|².
    pub(crate) variance: f64,
    /// Mean of |target − mean|².
    pub(crate) target_variance: f64,
}

impl Moments {
    fn of(source: &[DVec3], target: &[DVec3]) -> Self {
        let over_n = 1.0 / source.len() as f64;
        let source_mean = source.iter().sum::<DVec3>() * over_n;
        let target_mean = target.iter().sum::<DVec3>() * over_n;
        let mut covariance = [DVec3::ZERO; 3];
        let (mut squares, mut target_squares) = (DVec3::ZERO, 0.0);
        for (&s, &t) in source.iter().zip(target) {
            let (s, t) = (s - source_mean, t - target_mean);
            covariance[0] += t * s.x;
            covariance[1] += t * s.y;
            covariance[2] += t * s.z;
            squares += s * s;
            target_squares += t.length_squared();
        }
        Self {
            source_mean,
            target_mean,
            covariance: covariance.map(|column| column * over_n),
            variance: (squares.x + squares.y + squares.z) * over_n,
            target_variance: target_squares * over_n,
        }
    }

    /// The moments of pairs whose sums were taken about a centre near their means.
    pub(crate) fn of_sums(sums: &PairSums, centre: DVec3) -> Self {
        let over_n = 1.0 / sums.pairs as f64;
        let (source, target) = (sums.source * over_n, sums.target * over_n);
        let column = |k: usize| sums.cross[k] * over_n - target * source[k];
        // |t|² = |t − s|² + 2 t·s − |s|²
        let dots: f64 = (0..3).map(|k| sums.cross[k][k]).sum();
        let target_squares = sums.squares + 2.0 * dots - sums.source_squares;
        Self {
            source_mean: centre + source,
            target_mean: centre + target,
            covariance: [column(0), column(1), column(2)],
            variance: sums.source_squares * over_n - source.length_squared(),
            target_variance: target_squares * over_n - target.length_squared(),
        }
    }

    /// The similarity of least squares.
    pub(crate) fn solve(&self, scale: Scale) -> Result<DMat4> {
        let columns = self.covariance.map(|c| Vector3::new(c.x, c.y, c.z));
        let sigma = Matrix3::from_columns(&columns);
        if !sigma.iter().all(|entry| entry.is_finite()) {
            let problem = "expected finite points, found NaN, infinity or overflow";
            return Err(Error::invalid("similarity fit", problem));
        }
        let svd = sigma.svd(true, true);
        let (Some(u), Some(v_t)) = (svd.u, svd.v_t) else {
            return Err(Error::invalid(
                "similarity fit",
                "no singular vectors found",
            ));
        };
        let mut signs = Vector3::repeat(1.0);
        if u.determinant() * v_t.determinant() < 0.0 {
            signs[2] = -1.0;
        }
        let rotation = u * Matrix3::from_diagonal(&signs) * v_t;
        let explained = svd.singular_values.dot(&signs);
        let c = match scale {
            Scale::One => 1.0,
            Scale::Free => explained / self.variance,
            Scale::FreeInSource => self.target_variance / explained,
        };
        if !(c.is_finite() && c > 0.0) {
            let problem = format!("expected points that differ, found a scale of {c}");
            return Err(Error::invalid("similarity fit", problem));
        }
        let found = self.compose(rotation * c);
        if !found.is_finite() {
            let problem = "expected points whose products are finite, found overflow";
            return Err(Error::invalid("similarity fit", problem));
        }
        Ok(found)
    }

    fn compose(&self, linear: Matrix3<f64>) -> DMat4 {
        let column = |k: usize| DVec3::new(linear[(0, k)], linear[(1, k)], linear[(2, k)]);
        let (x, y, z) = (column(0), column(1), column(2));
        let mean = self.source_mean;
        let translation = self.target_mean - (x * mean.x + y * mean.y + z * mean.z);
        DMat4::from_cols(
            x.extend(0.0),
            y.extend(0.0),
            z.extend(0.0),
            translation.extend(1.0),
        )
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::align::tests::scattered;
    use crate::align::transformed;
    use glam::DQuat;

    pub(crate) fn similarity(scale: f64, angle: f64, translation: DVec3) -> DMat4 {
        let axis = DVec3::new(0.36, 0.48, 0.8);
        let rotation = DQuat::from_axis_angle(axis, angle);
        DMat4::from_scale_rotation_translation(DVec3::splat(scale), rotation, translation)
    }

    #[test]
    fn a_similarity_is_found_again() {
        let source = scattered(4, 200);
        for truth in [
            similarity(2.5, 0.7, DVec3::new(1.0, -2.0, 3.0)),
            similarity(1e-3, 3.1, DVec3::ZERO),
        ] {
            let found = umeyama(&source, &transformed(&source, truth), Scale::Free).unwrap();
            assert!(found.abs_diff_eq(truth, 1e-12), "{found} {truth}");
        }
    }

    #[test]
    fn planar_points_give_a_rotation_not_a_mirror() {
        let flat: Vec<DVec3> = scattered(5, 50)
            .iter()
            .map(|p| DVec3::new(p.x, p.y, 0.0))
            .collect();
        let truth = similarity(1.5, 1.1, DVec3::ONE);
        let found = umeyama(&flat, &transformed(&flat, truth), Scale::Free).unwrap();
        assert!(found.abs_diff_eq(truth, 1e-12), "{found}");
        let mirrored: Vec<DVec3> = scattered(5, 50)
            .iter()
            .map(|p| *p * DVec3::new(1.0, 1.0, -1.0))
            .collect();
        let best = umeyama(&scattered(5, 50), &mirrored, Scale::One).unwrap();
        assert!((best.determinant() - 1.0).abs() < 1e-12);
    }

    #[test]
    fn bad_correspondences_are_refused() {
        let points = scattered(6, 4);
        assert!(umeyama(&points, &points[..3], Scale::Free).is_err());
        assert!(umeyama(&[], &[], Scale::Free).is_err());
        assert!(umeyama(&[DVec3::ONE; 4], &points, Scale::Free).is_err());
        assert!(umeyama(&[DVec3::NAN; 4], &points, Scale::Free).is_err());
    }

    /// From about 1e77 on the covariance's own products overflow, from 1e154 on the covariance.
    #[test]
    fn a_fit_of_points_far_out_is_finite_or_refused() {
        for exponent in (60..160).chain([200, 300]) {
            let far: Vec<DVec3> = scattered(6, 20)
                .iter()
                .map(|p| *p * 10f64.powi(exponent))
                .collect();
            for scale in [Scale::One, Scale::Free, Scale::FreeInSource] {
                let found = umeyama(&far, &far, scale);
                assert!(found.is_err() || found.unwrap().is_finite(), "{exponent}");
            }
        }
    }

    #[test]
    fn the_scale_in_the_source_is_the_inverse_of_the_fit_the_other_way() {
        let source = scattered(8, 300);
        let noise = scattered(9, 300);
        let truth = similarity(1.7, 0.4, DVec3::new(3.0, 1.0, -2.0));
        let noisy: Vec<DVec3> = source
            .iter()
            .zip(&noise)
            .map(|(s, n)| *s + *n * 0.2)
            .collect();
        let target = transformed(&source, truth);
        let found = umeyama(&noisy, &target, Scale::FreeInSource).unwrap();
        let back = umeyama(&target, &noisy, Scale::Free).unwrap();
        assert!(found.abs_diff_eq(back.inverse(), 1e-12), "{found} {back}");
        // Noise of variance v on points of variance V shrinks the one by V / (V + v), not the other.
        let scale = |m: DMat4| glam::DMat3::from_mat4(m).determinant().cbrt() / 1.7;
        let free = scale(umeyama(&noisy, &target, Scale::Free).unwrap());
        assert!((scale(found) - 1.0).abs() < 0.01, "{}", scale(found));
        assert!((free - 1.0 / 1.04).abs() < 0.01, "{free}");
    }
}
