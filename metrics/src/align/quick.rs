//! The similarity of least squares nearly, and quickly: enough to see that a candidate is hopeless.

use glam::{DMat3, DMat4, DQuat, DVec3, DVec4};

/// Newton's steps at most; from above they never pass the largest root.
const STEPS: usize = 20;
/// How clearly the points must fix the rotation, from 0 to about 1. The rotation is then right to
/// about 1e-9.
const CLEAR: f64 = 1e-3;

/// The similarity that moves `source[i]` onto `target[i]` with nearly the least sum of squares (Horn,
/// JOSA A 1987, by the largest root of the characteristic polynomial). `None` where the points do not
/// fix one clearly.
pub(super) fn similarity(source: &[DVec3], target: &[DVec3]) -> Option<(DMat4, f64)> {
    let over_n = 1.0 / source.len() as f64;
    let source_mean = source.iter().sum::<DVec3>() * over_n;
    let target_mean = target.iter().sum::<DVec3>() * over_n;
    let mut cross = [DVec3::ZERO; 3];
    let (mut source_squares, mut target_squares) = (0.0, 0.0);
    for (&s, &t) in source.iter().zip(target) {
        let (s, t) = (s - source_mean, t - target_mean);
        cross[0] += t * s.x;
        cross[1] += t * s.y;
        cross[2] += t * s.z;
        source_squares += s.length_squared();
        target_squares += t.length_squared();
    }
    let unit = (source_squares * target_squares).sqrt().recip();
    if !unit.is_finite() {
        return None;
    }
    let [x, y, z] = cross.map(|column| column * unit);
    let columns = [
        DVec4::new(x.x + y.y + z.z, y.z - z.y, z.x - x.z, x.y - y.x),
        DVec4::new(y.z - z.y, x.x - y.y - z.z, x.y + y.x, z.x + x.z),
        DVec4::new(z.x - x.z, x.y + y.x, y.y - x.x - z.z, y.z + z.y),
        DVec4::new(x.y - y.x, z.x + x.z, y.z + z.y, z.z - x.x - y.y),
    ];
    let root = largest_root(&[x, y, z], &columns)?;
    let rotation = DMat3::from_quat(eigenvector(columns, root)?);
    let scale = root * (target_squares / source_squares).sqrt();
    let linear = rotation * scale;
    let translation = target_mean - linear * source_mean;
    let motion = DMat4::from_mat3_translation(linear, translation);
    (scale > 0.0 && motion.is_finite()).then_some((motion, scale))
}

/// The largest eigenvalue of a symmetric matrix without trace that is at most 1.
fn largest_root(cross: &[DVec3; 3], columns: &[DVec4; 4]) -> Option<f64> {
    let squares: f64 = cross.iter().map(|column| column.length_squared()).sum();
    let (c2, c1) = (
        -2.0 * squares,
        -8.0 * DMat3::from_cols(cross[0], cross[1], cross[2]).determinant(),
    );
    let c0 = DMat4::from_cols(columns[0], columns[1], columns[2], columns[3]).determinant();
    let mut root = 1.0f64;
    for _ in 0..STEPS {
        let value = ((root * root + c2) * root + c1) * root + c0;
        let slope = (4.0 * root * root + 2.0 * c2) * root + c1;
        let step = value / slope;
        if !step.is_finite() {
            return None;
        }
        root -= step;
        if step.abs() < 1e-13 {
            return Some(root);
        }
    }
    None
}

/// The unit quaternion that belongs to an eigenvalue: a column of the adjugate.
fn eigenvector(mut columns: [DVec4; 4], root: f64) -> Option<DQuat> {
    for (k, column) in columns.iter_mut().enumerate() {
        column[k] -= root;
    }
    for skipped in 0..4 {
        let rows = columns;
        let rest: Vec3Of4 = match skipped {
            0 => [rows[1], rows[2], rows[3]],
            1 => [rows[0], rows[2], rows[3]],
            2 => [rows[0], rows[1], rows[3]],
            _ => [rows[0], rows[1], rows[2]],
        };
        let found = across(&rest);
        let length = found.length();
        if length > CLEAR {
            let q = found / length;
            return Some(DQuat::from_xyzw(q.y, q.z, q.w, q.x));
        }
    }
    None
}

type Vec3Of4 = [DVec4; 3];

/// A vector at right angles to three.
fn across([a, b, c]: &Vec3Of4) -> DVec4 {
    let minor = |i: usize, j: usize, k: usize| {
        let row = |v: &DVec4| DVec3::new(v[i], v[j], v[k]);
        row(a).dot(row(b).cross(row(c)))
    };
    DVec4::new(
        minor(1, 2, 3),
        -minor(0, 2, 3),
        minor(0, 1, 3),
        -minor(0, 1, 2),
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::align::tests::scattered;
    use crate::align::transformed;
    use crate::align::umeyama::tests::similarity as motion_of;
    use crate::align::umeyama::{Scale, umeyama};

    #[test]
    fn nearly_umeyamas_or_nothing() {
        let mut found = 0;
        for case in 0..400u64 {
            let source = scattered(case, if case % 2 == 0 { 3 } else { 6 });
            let noise = scattered(case + 1000, source.len() as u64);
            let angle = case as f64 * 0.1;
            let truth = motion_of(0.01 + case as f64, angle, DVec3::new(1e3, -2e3, 5.0));
            let amount = [0.0, 1e-3, 0.3][case as usize % 3] * (0.01 + case as f64);
            let target: Vec<DVec3> = transformed(&source, truth)
                .iter()
                .zip(&noise)
                .map(|(t, n)| *t + *n * amount)
                .collect();
            let exact = umeyama(&source, &target, Scale::Free).unwrap();
            if let Some((nearly, scale)) = similarity(&source, &target) {
                for &point in &source {
                    let gap = nearly.transform_point3(point) - exact.transform_point3(point);
                    assert!(
                        gap.length() < 1e-7 * scale,
                        "{case}: {}",
                        gap.length() / scale
                    );
                }
                found += 1;
            }
        }
        assert!(found > 300, "{found}");
    }

    #[test]
    fn half_turns_are_found_and_points_on_a_line_are_not() {
        let source = scattered(2000, 6);
        for turned in [DVec3::X, DVec3::Y, DVec3::Z] {
            let half = DMat4::from_quat(DQuat::from_axis_angle(turned, std::f64::consts::PI));
            let (found, _) = similarity(&source, &transformed(&source, half)).unwrap();
            assert!(found.abs_diff_eq(half, 1e-8));
        }
        let line: Vec<DVec3> = (0..6).map(|k| DVec3::ONE * f64::from(k)).collect();
        assert!(similarity(&line, &line).is_none());
        assert!(similarity(&[DVec3::ONE; 6], &line).is_none());
    }
}
