//! Normals from depth by a plane in inverse depth.

use super::samples::{Samples, Unit};
use glam::{DVec2, DVec3, Vec3};
use mvs_datasets::scene::Camera;

/// A normal that was given for the pixel at (`column`, `row`), in the camera frame: of length 1 and facing the
/// camera, `None` for one that is zero or not finite.
pub(super) fn given(
    in_cam: [f32; 3],
    camera: &Camera,
    (column, row): (usize, usize),
) -> Option<Vec3> {
    let unit = Vec3::from(in_cam).as_dvec3().try_normalize()?;
    #[allow(clippy::cast_precision_loss, reason = "image sizes are far below 2^52")]
    let pixel = DVec2::new(column as f64 + 0.5, row as f64 + 0.5);
    let ray = ((pixel - camera.center()) / camera.focal()).extend(1.0);
    let facing = if unit.dot(ray) > 0.0 { -unit } else { unit };
    Some(facing.as_vec3())
}

/// As [`from_window`], of the pixel at (`column`, `row`) of a map.
pub(super) fn from_depth(
    map: &Samples,
    camera: &Camera,
    (column, row): (usize, usize),
    similar: f64,
) -> Option<Vec3> {
    let around = (&map.around(column, row), map.unit());
    from_window(around, camera, (column, row), similar)
}

/// The unit normal, in the camera frame and facing the camera, of the plane that fits the 3×3
/// pixels `around` (`column`, `row`) best; `None` where fewer than three of those whose depth is
/// within the fraction `similar` lie off one line.
///
/// A plane n·X = 1 has inverse depth n·K⁻¹(u, v, 1)ᵀ: linear in pixels, so the fit is exact for
/// planes. With 1/d = a·u + b·v + c, n = Kᵀ(a, b, c)ᵀ.
pub(super) fn from_window(
    (around, unit): (&[[f32; 3]; 3], Unit),
    camera: &Camera,
    (column, row): (usize, usize),
    similar: f64,
) -> Option<Vec3> {
    let center = f64::from(around[1][1]);
    if center <= 0.0 {
        return None;
    }
    let from_stored = 1.0 / center;
    let relative = around.map(|row| {
        row.map(|stored| match unit {
            Unit::Inverse => f64::from(stored) * from_stored - 1.0,
            Unit::Depth if stored > 0.0 => center / f64::from(stored) - 1.0,
            Unit::Depth => -1.0,
        })
    });
    let (slope_u, slope_v, offset) = fit(&relative, similar)?;
    #[allow(clippy::cast_precision_loss, reason = "image sizes are far below 2^52")]
    let (u, v) = (column as f64 + 0.5, row as f64 + 0.5);
    // Everything is relative to the centre's inverse depth, which only scales the normal.
    let constant = 1.0 + offset - slope_u * u - slope_v * v;
    let (focal, middle) = (camera.focal(), camera.center());
    let normal = DVec3::new(
        focal.x * slope_u,
        focal.y * slope_v,
        middle.x * slope_u + middle.y * slope_v + constant,
    );
    // n·X = 1 > 0 points away from the camera.
    (-normal).try_normalize().map(|unit| unit.as_vec3())
}

/// (a, b, c) of the plane a·dx + b·dy + c that fits those of the 3×3 values best that are within
/// ± `similar`; `None` where they lie on a line.
fn fit(values: &[[f64; 3]; 3], similar: f64) -> Option<(f64, f64, f64)> {
    let counts = |value: &f64| value.abs() <= similar;
    let [above, own, below] = values;
    if values.as_flattened().iter().all(counts) {
        // The sums of a whole 3×3 are known: 9 values, no first moments, second moments of 6.
        let column = |at: usize| above[at] + own[at] + below[at];
        let row = |row: &[f64; 3]| row[0] + row[1] + row[2];
        let sum = column(0) + column(1) + column(2);
        return Some((
            (column(2) - column(0)) / 6.0,
            (row(below) - row(above)) / 6.0,
            sum / 9.0,
        ));
    }
    let mut fit = PlaneFit::default();
    for (dy, row) in (-1..=1).zip(values) {
        for (dx, value) in (-1..=1).zip(row).filter(|(_, value)| counts(value)) {
            fit.add(dx, dy, *value);
        }
    }
    fit.solve()
}

/// Least squares of value = a·dx + b·dy + c.
#[derive(Default)]
struct PlaneFit {
    count: f64,
    x: f64,
    y: f64,
    xx: f64,
    xy: f64,
    yy: f64,
    value: f64,
    value_x: f64,
    value_y: f64,
}

impl PlaneFit {
    #[allow(clippy::cast_precision_loss, reason = "offsets of one pixel")]
    fn add(&mut self, dx: isize, dy: isize, value: f64) {
        let (dx, dy) = (dx as f64, dy as f64);
        self.count += 1.0;
        self.x += dx;
        self.y += dy;
        self.xx += dx * dx;
        self.xy += dx * dy;
        self.yy += dy * dy;
        self.value += value;
        self.value_x += value * dx;
        self.value_y += value * dy;
    }

    /// (a, b, c); `None` where the pixels lie on a line.
    fn solve(&self) -> Option<(f64, f64, f64)> {
        let n = self.count;
        let (xx, xy, yy) = (
            n * self.xx - self.x * self.x,
            n * self.xy - self.x * self.y,
            n * self.yy - self.y * self.y,
        );
        let (vx, vy) = (
            n * self.value_x - self.value * self.x,
            n * self.value_y - self.value * self.y,
        );
        let determinant = xx * yy - xy * xy;
        if determinant < 0.5 {
            return None;
        }
        let a = (vx * yy - vy * xy) / determinant;
        let b = (vy * xx - vx * xy) / determinant;
        Some((a, b, (self.value - a * self.x - b * self.y) / n))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_whole_window_is_fitted_as_any_other() {
        let values = [
            [0.01, -0.02, 0.03],
            [0.0, 0.005, -0.01],
            [0.02, 0.015, 0.03],
        ];
        let (a, b, c) = fit(&values, 0.05).unwrap();
        let mut general = PlaneFit::default();
        for (dy, row) in (-1..=1).zip(values) {
            (-1..=1)
                .zip(row)
                .for_each(|(dx, value)| general.add(dx, dy, value));
        }
        let (x, y, z) = general.solve().unwrap();
        assert!((a - x).abs() < 1e-15 && (b - y).abs() < 1e-15 && (c - z).abs() < 1e-15);
    }
    use crate::fuse::testing::{Plane, arc};
    use mvs_datasets::scene::View;

    #[test]
    fn a_plane_gives_its_normal_even_at_holes_and_borders() {
        let plane = Plane::tilted();
        let surface = |view: &View, pixel| plane.depth(view, pixel);
        let estimate = arc(3, (32, 24), DVec3::ZERO, surface).remove(0);
        let pose = &estimate.view.pose;
        for unit in [Unit::Depth, Unit::Inverse] {
            let mut stored: Vec<f32> = estimate
                .depth
                .values()
                .iter()
                .map(|&d| unit.convert(d))
                .collect();
            stored[5 * 32 + 5] = 0.0;
            stored[5 * 32 + 7] = unit.convert(100.0);
            let map = Samples::new((32, 24), unit, &stored);
            let normal = |c, r| from_depth(&map, &estimate.view.camera, (c, r), 0.05);
            for (column, row) in [(15, 12), (6, 5), (6, 6), (0, 0), (31, 23)] {
                let found = pose.direction_to_world(normal(column, row).unwrap().as_dvec3());
                assert!(
                    (found - plane.normal).length() < 1e-4,
                    "{found} {column} {row}"
                );
            }
            assert_eq!(normal(5, 5), None);
            assert_eq!(normal(7, 5), None, "alone at its depth");
        }
    }
}
