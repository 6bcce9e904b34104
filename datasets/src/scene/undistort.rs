//! The inverse of a lens: of one image point, or of many side by side to the same bits.
//!
//! On the plane on which a lens's formula is a polynomial (of a fisheye that of angles, else that at z-depth 1)
//! Newton's method takes a few products and two divisions a step.

#![allow(
    clippy::needless_range_loop,
    reason = "points are worked out side by side, and closures would leave the instruction set"
)]

use super::distortion::Distortion;
use glam::DVec2;
use pulp::{Arch, Simd, WithSimd};
use std::f64::consts::FRAC_PI_2;

/// Points that are worked out side by side.
const SIDE: usize = 16;

/// Steps of Newton's method; a mild lens takes three to six.
const MOST_STEPS: usize = 20;

/// The widest angle at which a search begins.
const WIDEST_START: f64 = 1.5;

/// How far the image of the result may lie from the point, per unit of its distance from the axis.
const FITS: f64 = 1e-12;

impl Distortion {
    /// [`Distortion::undistort`] with the field's radius already known.
    pub(super) fn undistort_within(&self, seen: DVec2, field_radius: f64) -> Option<DVec2> {
        let lens = match self {
            Self::None => return Some(seen),
            Self::FieldOfView { omega } => return unfold(*omega, seen, field_radius),
            _ => Bend::of(self),
        };
        let start = self.start(seen);
        let (found, [fits]) = lens.solve([[start.x], [start.y]], [[seen.x], [seen.y]]);
        let near = DVec2::new(found[0][0], found[1][0]);
        let near = self.confirmed(near, field_radius).filter(|_| fits);
        near.or_else(|| match length(seen.x, seen.y) > self.reach(field_radius) {
            true => None,
            false => self.search(&lens, seen, field_radius),
        })
    }

    /// A distance from the axis beyond which no ray inside the field is bent; infinite or NaN where none is
    /// known. The radial part grows up to the field's edge.
    fn reach(&self, field_radius: f64) -> f64 {
        let (edge, slope) = self.profile(field_radius);
        if !(edge > 0.0 && slope >= 0.0) {
            return f64::INFINITY;
        }
        let (plane, shifts) = match *self {
            Self::None | Self::FieldOfView { .. } => (field_radius, [0.0; 4]),
            Self::RadialTangential { tangential, .. } => {
                (field_radius, [tangential[0], tangential[1], 0.0, 0.0])
            }
            Self::Fisheye { .. } => (libm::atan(field_radius), [0.0; 4]),
            Self::ThinPrismFisheye {
                tangential: [p1, p2],
                prism: [s1, s2],
                ..
            } => (libm::atan(field_radius), [p1, p2, s1, s2]),
        };
        let shift: f64 = shifts.iter().map(|shift| 4.0 * shift.abs()).sum();
        // Room for the last half degree, in which a wide field's edge is not searched for.
        1.05 * edge + shift * plane * plane
    }

    /// [`Distortion::undistort_within`] of many points, in place; NaN where there is none.
    pub(super) fn undistort_all(&self, field_radius: f64, points: &mut [DVec2]) {
        match self {
            Self::None => {}
            Self::FieldOfView { omega } => {
                for point in points {
                    *point = unfold(*omega, *point, field_radius).unwrap_or(DVec2::NAN);
                }
            }
            _ => Arch::new().dispatch(SideBySide {
                lens: self,
                bend: Bend::of(self),
                field_radius,
                points,
            }),
        }
    }

    /// Where Newton's method starts: a fisheye shows nothing farther from the axis than 90°, and its formula may
    /// turn back soon after.
    #[inline(always)]
    fn start(&self, seen: DVec2) -> DVec2 {
        let most = match self {
            Self::Fisheye { .. } | Self::ThinPrismFisheye { .. } => WIDEST_START,
            _ => f64::INFINITY,
        };
        let angle = length(seen.x, seen.y);
        let shorter = seen * (most / angle);
        if angle > most { shorter } else { seen }
    }

    /// The point at z-depth 1 for one of the plane on which the lens is a polynomial, if it is inside the field.
    #[inline(always)]
    fn confirmed(&self, found: DVec2, field_radius: f64) -> Option<DVec2> {
        let ideal = match self {
            Self::Fisheye { .. } | Self::ThinPrismFisheye { .. } => {
                let angle = length(found.x, found.y);
                match angle > 0.0 {
                    true if angle < FRAC_PI_2 => found * (libm::tan(angle) / angle),
                    true => return None,
                    false => found,
                }
            }
            _ => found,
        };
        (length(ideal.x, ideal.y) <= field_radius * (1.0 + 1e-9)).then_some(ideal)
    }

    /// What a slower search finds, which starts from where the radial part alone leads.
    #[cold]
    fn search(&self, bend: &Bend, seen: DVec2, field_radius: f64) -> Option<DVec2> {
        let mut start = self.undo_radial(seen, field_radius)?;
        if let Self::Fisheye { .. } | Self::ThinPrismFisheye { .. } = self {
            let radius = start.length();
            if radius > 0.0 {
                start *= libm::atan(radius) / radius;
            }
        }
        let ([x, y], [fits]) = bend.solve([[start.x], [start.y]], [[seen.x], [seen.y]]);
        let found = self.confirmed(DVec2::new(x[0], y[0]), field_radius);
        found.filter(|_| fits)
    }

    /// The radial part alone, undone by Newton's method inside a bracket that halves when in doubt.
    fn undo_radial(&self, seen: DVec2, field_radius: f64) -> Option<DVec2> {
        let target = seen.length();
        if target == 0.0 {
            return Some(seen);
        }
        let (mut low, mut high) = (0.0, field_radius.min(2.0 * target + 1.0));
        while self.profile(high).0 < target {
            if high >= field_radius || high > 1e6 {
                // Beyond the field radially; tangential bending may still reach it from the edge.
                return (self.profile(high).0 * 1.05 > target).then(|| seen * (high / target));
            }
            high = (2.0 * high).min(field_radius);
        }
        let mut radius = target.min(0.5 * (low + high));
        for _ in 0..100 {
            let (value, slope) = self.profile(radius);
            if value > target {
                high = radius;
            } else {
                low = radius;
            }
            let newton = radius - (value - target) / slope;
            let next = if newton > low && newton < high {
                newton
            } else {
                0.5 * (low + high)
            };
            if (next - radius).abs() <= 1e-14 * radius {
                break;
            }
            radius = next;
        }
        Some(seen * (radius / target))
    }
}

/// The inverse of [`Distortion::FieldOfView`], which has a closed form.
fn unfold(omega: f64, seen: DVec2, field_radius: f64) -> Option<DVec2> {
    let (radius, angle) = (seen.length(), omega * seen.length());
    let scale = 2.0 * libm::tan(0.5 * omega);
    let ideal = match radius > 0.0 {
        true => seen * (libm::tan(angle) / (scale * radius)),
        false => seen * (omega / scale),
    };
    (angle < FRAC_PI_2 && ideal.length() <= field_radius * (1.0 + 1e-9)).then_some(ideal)
}

#[inline(always)]
fn length(x: f64, y: f64) -> f64 {
    (x * x + y * y).sqrt()
}

/// A lens where it is a polynomial, or a quotient of two, and its derivative, without branches.
struct Bend {
    /// Coefficients of r², r⁴, … of the radial factor above and below the bar.
    over: [f64; 4],
    under: [f64; 3],
    tangential: [f64; 2],
    prism: [f64; 2],
}

/// Where a point is bent to, and the derivative: of x by x and by y, of y by x and by y.
struct Bent {
    to: [f64; 2],
    slope: [f64; 4],
}

impl Bend {
    /// The formula of a lens that has such a plane; else of a pinhole.
    fn of(lens: &Distortion) -> Self {
        let plain = Self {
            over: [0.0; 4],
            under: [0.0; 3],
            tangential: [0.0; 2],
            prism: [0.0; 2],
        };
        match *lens {
            Distortion::None | Distortion::FieldOfView { .. } => plain,
            Distortion::RadialTangential {
                radial: [k1, k2, k3, k4, k5, k6],
                tangential,
            } => Self {
                over: [k1, k2, k3, 0.0],
                under: [k4, k5, k6],
                tangential,
                ..plain
            },
            Distortion::Fisheye { radial } => Self {
                over: radial,
                ..plain
            },
            Distortion::ThinPrismFisheye {
                radial,
                tangential,
                prism,
            } => Self {
                over: radial,
                tangential,
                prism,
                ..plain
            },
        }
    }

    #[inline(always)]
    fn at(&self, x: f64, y: f64) -> Bent {
        let ([k1, k2, k3, k4], [d1, d2, d3]) = (self.over, self.under);
        let ([p1, p2], [s1, s2]) = (self.tangential, self.prism);
        let r2 = x * x + y * y;
        let over = 1.0 + r2 * (k1 + r2 * (k2 + r2 * (k3 + r2 * k4)));
        let under = 1.0 + r2 * (d1 + r2 * (d2 + r2 * d3));
        let inverse = 1.0 / if under > 0.0 { under } else { f64::NAN };
        let factor = over * inverse;
        let over_slope = k1 + r2 * (2.0 * k2 + r2 * (3.0 * k3 + r2 * (4.0 * k4)));
        let under_slope = d1 + r2 * (2.0 * d2 + r2 * (3.0 * d3));
        // Twice the derivative by r².
        let steep = 2.0 * (over_slope - factor * under_slope) * inverse;
        let (xy, cross) = (x * y, steep * x * y);
        let (px, py) = (2.0 * p1, 2.0 * p2);
        let (sx, sy) = (2.0 * s1, 2.0 * s2);
        Bent {
            to: [
                x * factor + (px * xy + p2 * (r2 + 2.0 * x * x) + s1 * r2),
                y * factor + (py * xy + p1 * (r2 + 2.0 * y * y) + s2 * r2),
            ],
            slope: [
                factor + steep * x * x + (px * y + (3.0 * py + sx) * x),
                cross + (px * x + (py + sx) * y),
                cross + (py * y + (px + sy) * x),
                factor + steep * y * y + (py * x + (3.0 * px + sy) * y),
            ],
        }
    }

    /// Newton's method from `start` for the points that are bent to `seen` (x of all, y of all), and whether
    /// the results fit. A point that is good stays as it is while others go on, so each has the bits that it
    /// has alone.
    #[inline(always)]
    fn solve<const N: usize>(
        &self,
        start: [[f64; N]; 2],
        seen: [[f64; N]; 2],
    ) -> ([[f64; N]; 2], [bool; N]) {
        let [mut x, mut y] = start;
        let (mut unit, mut size, mut open) = ([0.0; N], [f64::INFINITY; N], [true; N]);
        for i in 0..N {
            unit[i] = 1.0 + length(seen[0][i], seen[1][i]);
        }
        for _ in 0..MOST_STEPS {
            let mut any = false;
            for i in 0..N {
                let bent = self.at(x[i], y[i]);
                let [ex, ey] = [bent.to[0] - seen[0][i], bent.to[1] - seen[1][i]];
                let (last, unit) = (size[i], unit[i]);
                size[i] = length(ex, ey);
                // Rounding keeps the last bits moving: no better than before is good enough.
                let still = (size[i] <= 1e-14 * unit) & (size[i] >= last);
                open[i] &= !((size[i] <= 1e-16 * unit) | still);
                let [xx, xy, yx, yy] = bent.slope;
                let inverse = 1.0 / (xx * yy - xy * yx);
                let moved_x = x[i] - (yy * ex - xy * ey) * inverse;
                let moved_y = y[i] - (xx * ey - yx * ex) * inverse;
                x[i] = if open[i] { moved_x } else { x[i] };
                y[i] = if open[i] { moved_y } else { y[i] };
                any |= open[i];
            }
            if !any {
                break;
            }
        }
        let mut fits = [false; N];
        for i in 0..N {
            fits[i] = size[i] <= FITS * unit[i];
        }
        for i in 0..N {
            // It has moved since.
            if open[i] {
                let [bx, by] = self.at(x[i], y[i]).to;
                fits[i] = length(bx - seen[0][i], by - seen[1][i]) <= FITS * unit[i];
            }
        }
        ([x, y], fits)
    }
}

/// Points to be undistorted. `pulp` compiles [`WithSimd::with_simd`], and what is inlined into it, once per
/// instruction set.
struct SideBySide<'p> {
    lens: &'p Distortion,
    bend: Bend,
    field_radius: f64,
    points: &'p mut [DVec2],
}

impl WithSimd for SideBySide<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let reach = self.lens.reach(self.field_radius);
        for points in self.points.chunks_mut(SIDE) {
            if points.iter().all(|point| length(point.x, point.y) > reach) {
                points.fill(DVec2::NAN);
                continue;
            }
            let mut seen = [[points[0].x; SIDE], [points[0].y; SIDE]];
            for (i, point) in points.iter().enumerate() {
                (seen[0][i], seen[1][i]) = (point.x, point.y);
            }
            let mut start = seen;
            for i in 0..SIDE {
                let at = self.lens.start(DVec2::new(seen[0][i], seen[1][i]));
                (start[0][i], start[1][i]) = (at.x, at.y);
            }
            let ([x, y], fits) = self.bend.solve(start, seen);
            for (i, point) in points.iter_mut().enumerate() {
                let near = DVec2::new(x[i], y[i]);
                let near = self.lens.confirmed(near, self.field_radius);
                *point = match near.filter(|_| fits[i]) {
                    Some(ideal) => ideal,
                    None if length(point.x, point.y) > reach => DVec2::NAN,
                    None => {
                        let ideal = self.lens.search(&self.bend, *point, self.field_radius);
                        ideal.unwrap_or(DVec2::NAN)
                    }
                };
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::distortion::tests::lenses;
    use super::*;
    use proptest::prelude::*;

    /// Lenses that bend more than any that is sold.
    fn strong() -> Vec<Distortion> {
        let lens = |radial, tangential| Distortion::RadialTangential { radial, tangential };
        let prism = |radial, tangential, prism| Distortion::ThinPrismFisheye {
            radial,
            tangential,
            prism,
        };
        vec![
            lens([-0.5, 0.0, 0.0, 0.0, 0.0, 0.0], [0.0; 2]),
            lens([2.0, 0.0, 0.0, 0.0, 0.0, 0.0], [0.01, 0.02]),
            lens([0.1, 0.0, 0.0, -0.4, 0.0, 0.0], [0.0; 2]),
            Distortion::Fisheye {
                radial: [-0.1, 0.02, 0.0, 0.0],
            },
            prism(
                [-0.011, -0.0015, -0.0005, -0.0003],
                [-0.058, 0.126],
                [0.035, 0.023],
            ),
            prism([-0.03, 0.02, 0.03, -0.05], [-0.004, 0.0003], [0.05, -0.03]),
            Distortion::FieldOfView { omega: 2.5 },
        ]
    }

    #[test]
    fn strong_lenses_give_back_what_they_bend() {
        let mut wide = 0;
        for lens in strong() {
            let edge = lens.field_radius();
            for step in 0..4000 {
                let angle = 0.618 * f64::from(step);
                // To a hundredth of the field's edge, or to 83 degrees.
                let radius = f64::from(step) / 4000.0 * (0.99 * edge).min(8.0);
                let ideal = radius * DVec2::from_angle(angle);
                // Beyond where a point, moved outwards, is seen farther in, there may be two.
                let (inner, outer) = (lens.distort(0.999 * ideal), lens.distort(1.001 * ideal));
                if (outer - inner).dot(ideal) < 1e-4 * ideal.length_squared() {
                    continue;
                }
                let found = lens.undistort_within(lens.distort(ideal), edge);
                let found = found.unwrap_or(DVec2::NAN);
                assert!(
                    (found - ideal).length() < 1e-7 * (1.0 + radius * radius),
                    "{lens:?} {ideal} {found}"
                );
                wide += usize::from(radius > 2.0);
            }
        }
        assert!(wide > 4000, "{wide}");
    }

    #[test]
    fn many_side_by_side_have_the_bits_of_one_alone() {
        let (mut rays, mut none) = (0, 0);
        for lens in lenses().into_iter().chain(strong()) {
            let edge = lens.field_radius();
            for row in 0..90 {
                // Beyond the field, too, and not a multiple of what is worked out together.
                let seen = |column: usize| {
                    (DVec2::new(column as f64, f64::from(row)) - DVec2::new(50.0, 40.0)) / 25.0
                };
                let mut points: Vec<DVec2> = (0..101).map(seen).collect();
                lens.undistort_all(edge, &mut points);
                for (column, point) in points.iter().enumerate() {
                    match lens.undistort_within(seen(column), edge) {
                        Some(alone) => {
                            let bits = |point: DVec2| point.to_array().map(f64::to_bits);
                            assert_eq!(bits(*point), bits(alone), "{lens:?}");
                            let error = (lens.distort(alone) - seen(column)).length();
                            assert!(error <= 1e-11, "{lens:?} {alone} {error}");
                            rays += 1;
                        }
                        None => {
                            assert!(point.is_nan(), "{lens:?}");
                            none += 1;
                        }
                    }
                }
            }
        }
        assert!(rays > 40_000 && none > 4_000, "{rays} {none}");
    }

    /// What no bound cuts short.
    fn searched(lens: &Distortion, seen: DVec2, edge: f64) -> Option<DVec2> {
        let bend = Bend::of(lens);
        let start = lens.start(seen);
        let (found, [fits]) = bend.solve([[start.x], [start.y]], [[seen.x], [seen.y]]);
        let near = lens.confirmed(DVec2::new(found[0][0], found[1][0]), edge);
        near.filter(|_| fits)
            .or_else(|| lens.search(&bend, seen, edge))
    }

    #[test]
    fn beyond_a_lens_s_reach_a_search_finds_nothing() {
        let tiny = Distortion::RadialTangential {
            radial: [-9e5, 0.0, 0.0, 0.0, 0.0, 0.0],
            tangential: [0.0; 2],
        };
        let (mut beyond, mut rays) = (0, 0);
        for lens in lenses().into_iter().chain(strong()).chain([tiny]) {
            if matches!(lens, Distortion::None | Distortion::FieldOfView { .. }) {
                continue;
            }
            let edge = lens.field_radius();
            let reach = lens.reach(edge);
            for step in 0..3000 {
                let part = f64::from(step) / 1000.0;
                let radius = part * if reach < f64::INFINITY { reach } else { 4e-4 };
                let seen = radius * DVec2::from_angle(0.618 * f64::from(step));
                let found = searched(&lens, seen, edge);
                assert_eq!(lens.undistort_within(seen, edge), found, "{lens:?} {seen}");
                assert!(found.is_none() || radius <= reach, "{lens:?} {seen}");
                beyond += usize::from(radius > reach);
                rays += usize::from(found.is_some());
            }
        }
        assert!(beyond > 15_000 && rays > 8_000, "{beyond} {rays}");
    }

    proptest! {
        #[test]
        fn the_formula_is_that_of_the_lens(which in 0usize..7, x in -0.7..0.7f64, y in -0.7..0.7f64) {
            let lens = lenses()[which];
            let on_plane = DVec2::new(x, y);
            let angle = on_plane.length();
            let ideal = match lens {
                Distortion::Fisheye { .. } | Distortion::ThinPrismFisheye { .. } => {
                    on_plane * (angle.tan() / angle)
                }
                _ => on_plane,
            };
            let expected = lens.distort(ideal);
            let found = DVec2::from(Bend::of(&lens).at(x, y).to);
            prop_assert!((found - expected).length() < 1e-14, "{lens:?} {found} {expected}");
        }

        #[test]
        fn the_slope_is_the_derivative(which in 0usize..7, x in -0.7..0.7f64, y in -0.7..0.7f64) {
            let bend = Bend::of(&lenses()[which]);
            let step = 1e-6;
            let to = |x, y| DVec2::from(bend.at(x, y).to);
            let by_x = (to(x + step, y) - to(x - step, y)) / (2.0 * step);
            let by_y = (to(x, y + step) - to(x, y - step)) / (2.0 * step);
            let [xx, xy, yx, yy] = bend.at(x, y).slope;
            prop_assert!((DVec2::new(xx, yx) - by_x).length() < 1e-8);
            prop_assert!((DVec2::new(xy, yy) - by_y).length() < 1e-8);
        }
    }
}
