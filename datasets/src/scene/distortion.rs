use glam::DVec2;

/// Radii up to which a lens is searched for the edge of its field: an angle of 89.4°.
const WIDEST: f64 = 100.0;

/// How a lens bends rays: a map of the plane at z-depth 1 (x right, y down) onto itself.
///
/// Coefficients as in OpenCV and COLMAP; all zero is no distortion.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub enum Distortion {
    /// A pinhole.
    #[default]
    None,
    /// Radial and tangential: the factor (1 + k1 r² + k2 r⁴ + k3 r⁶) / (1 + k4 r² + k5 r⁴ + k6 r⁶),
    /// then p1 and p2.
    RadialTangential {
        /// k1 to k6.
        radial: [f64; 6],
        /// p1 and p2.
        tangential: [f64; 2],
    },
    /// Equidistant fisheye: the angle θ to the axis becomes
    /// θ (1 + k1 θ² + k2 θ⁴ + k3 θ⁶ + k4 θ⁸).
    Fisheye {
        /// k1 to k4.
        radial: [f64; 4],
    },
    /// COLMAP's thin-prism fisheye: the plane of an equidistant fisheye, bent there by
    /// 1 + k1 r² + k2 r⁴ + k3 r⁶ + k4 r⁸, then p1 and p2, then (s1, s2) · r².
    ThinPrismFisheye {
        /// k1 to k4.
        radial: [f64; 4],
        /// p1 and p2.
        tangential: [f64; 2],
        /// s1 and s2.
        prism: [f64; 2],
    },
    /// The field-of-view model of Devernay and Faugeras: the radius r becomes
    /// atan(2 r tan(ω / 2)) / ω.
    FieldOfView {
        /// ω in radians, inside (0, π).
        omega: f64,
    },
}

impl Distortion {
    /// Where the ray through `ideal` seems to pass. Meaningful inside [`Distortion::field_radius`].
    pub fn distort(&self, ideal: DVec2) -> DVec2 {
        let radius = ideal.length();
        match self {
            Self::None => ideal,
            Self::RadialTangential { tangential, .. } => {
                ideal * self.factor(radius).0 + Shift(*tangential, [0.0; 2]).at(ideal)
            }
            _ if radius == 0.0 => ideal,
            Self::Fisheye { .. } | Self::FieldOfView { .. } => {
                ideal * (self.profile(radius).0 / radius)
            }
            Self::ThinPrismFisheye {
                tangential, prism, ..
            } => {
                let plane = ideal * (libm::atan(radius) / radius);
                ideal * (self.profile(radius).0 / radius) + Shift(*tangential, *prism).at(plane)
            }
        }
    }

    /// The inverse of [`Distortion::distort`] inside the field, iterated until it fits to 1e-12 where there is no
    /// closed form.
    /// `None` for what no ray inside the field is bent to.
    pub fn undistort(&self, seen: DVec2) -> Option<DVec2> {
        if *self == Self::None {
            return Some(seen);
        }
        self.undistort_within(seen, self.field_radius())
    }

    /// The largest radius up to which radii grow when distorted, so that there is one ray per image
    /// point; infinite when there is no such limit.
    pub fn field_radius(&self) -> f64 {
        let grows = |radius: f64| {
            let (value, slope) = self.profile(radius);
            value.is_finite() && value > 0.0 && slope > 0.0
        };
        let mut inside = 1e-3;
        while inside < WIDEST {
            let mut beyond = inside * 1.01;
            if !grows(beyond) {
                for _ in 0..60 {
                    let middle = 0.5 * (inside + beyond);
                    if grows(middle) {
                        inside = middle;
                    } else {
                        beyond = middle;
                    }
                }
                return inside;
            }
            inside = beyond;
        }
        f64::INFINITY
    }

    /// What a radius becomes without tangential bending, and how fast that grows.
    pub(super) fn profile(&self, radius: f64) -> (f64, f64) {
        match self {
            Self::None => (radius, 1.0),
            Self::RadialTangential { .. } => {
                let (factor, slope) = self.factor(radius);
                (radius * factor, factor + radius * slope)
            }
            Self::FieldOfView { omega } => {
                let scale = 2.0 * libm::tan(0.5 * omega);
                let slope = scale / (omega * (1.0 + (scale * radius).powi(2)));
                (libm::atan(scale * radius) / omega, slope)
            }
            Self::Fisheye { radial } | Self::ThinPrismFisheye { radial, .. } => {
                let angle = libm::atan(radius);
                let a2 = angle * angle;
                let [k1, k2, k3, k4] = *radial;
                let value = angle * (1.0 + a2 * (k1 + a2 * (k2 + a2 * (k3 + a2 * k4))));
                let slope =
                    1.0 + a2 * (3.0 * k1 + a2 * (5.0 * k2 + a2 * (7.0 * k3 + a2 * 9.0 * k4)));
                (value, slope / (1.0 + radius * radius))
            }
        }
    }

    /// The radial factor and its derivative by the radius; NaN where the denominator is not above 0.
    fn factor(&self, radius: f64) -> (f64, f64) {
        let Self::RadialTangential { radial, .. } = self else {
            return (1.0, 0.0);
        };
        let [k1, k2, k3, k4, k5, k6] = *radial;
        let r2 = radius * radius;
        let over = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
        let under = 1.0 + r2 * (k4 + r2 * (k5 + r2 * k6));
        if under <= 0.0 {
            return (f64::NAN, f64::NAN);
        }
        let over_slope = 2.0 * radius * (k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3));
        let under_slope = 2.0 * radius * (k4 + r2 * (2.0 * k5 + r2 * 3.0 * k6));
        let slope = (over_slope * under - over * under_slope) / (under * under);
        (over / under, slope)
    }

    /// Whether all coefficients are finite, and an angle inside its range.
    pub fn is_sound(&self) -> bool {
        match self {
            Self::None => true,
            Self::RadialTangential { radial, tangential } => radial
                .iter()
                .chain(tangential)
                .all(|value| value.is_finite()),
            Self::Fisheye { radial } => radial.iter().all(|value| value.is_finite()),
            Self::ThinPrismFisheye {
                radial,
                tangential,
                prism,
            } => radial
                .iter()
                .chain(tangential)
                .chain(prism)
                .all(|value| value.is_finite()),
            Self::FieldOfView { omega } => 0.0 < *omega && *omega < std::f64::consts::PI,
        }
    }
}

/// Tangential bending by p1 and p2, and thin-prism bending by s1 and s2.
struct Shift([f64; 2], [f64; 2]);

impl Shift {
    fn at(&self, DVec2 { x, y }: DVec2) -> DVec2 {
        let Self([p1, p2], [s1, s2]) = self;
        let r2 = x * x + y * y;
        DVec2::new(
            2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x) + s1 * r2,
            2.0 * p2 * x * y + p1 * (r2 + 2.0 * y * y) + s2 * r2,
        )
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use proptest::prelude::*;

    pub(in crate::scene) fn lenses() -> Vec<Distortion> {
        let lens = |radial, tangential| Distortion::RadialTangential { radial, tangential };
        vec![
            Distortion::None,
            lens([-0.13, 0.1, 0.0, 0.0, 0.0, 0.0], [0.0; 2]),
            lens([-0.28, 0.07, 0.001, 0.0, 0.0, 0.0], [0.002, -0.003]),
            lens([0.4, 0.2, 0.1, 0.7, 0.1, 0.02], [-0.001, 0.001]),
            Distortion::Fisheye { radial: [0.0; 4] },
            Distortion::Fisheye {
                radial: [-0.02, 0.01, -0.005, 0.0005],
            },
            Distortion::ThinPrismFisheye {
                radial: [-0.03, 0.02, -0.004, 0.0003],
                tangential: [0.002, -0.001],
                prism: [0.003, -0.002],
            },
            Distortion::FieldOfView { omega: 0.9 },
        ]
    }

    #[test]
    fn the_formulas_are_opencv_s() {
        // OpenCV 4 projectPoints and fisheye::distortPoints for the point (0.3, -0.2, 1).
        let p = DVec2::new(0.3, -0.2);
        let r2: f64 = 0.13;
        let lens = Distortion::RadialTangential {
            radial: [0.1, -0.2, 0.3, 0.05, 0.02, 0.01],
            tangential: [0.01, -0.02],
        };
        let factor = (1.0 + 0.1 * r2 - 0.2 * r2.powi(2) + 0.3 * r2.powi(3))
            / (1.0 + 0.05 * r2 + 0.02 * r2.powi(2) + 0.01 * r2.powi(3));
        let x = 0.3 * factor + 2.0 * 0.01 * 0.3 * -0.2 - 0.02 * (r2 + 2.0 * 0.09);
        let y = -0.2 * factor + 0.01 * (r2 + 2.0 * 0.04) - 2.0 * 0.02 * 0.3 * -0.2;
        assert!((lens.distort(p) - DVec2::new(x, y)).length() < 1e-15);
        let fisheye = Distortion::Fisheye {
            radial: [0.1, 0.0, 0.0, 0.0],
        };
        let angle = r2.sqrt().atan();
        let expected = p / r2.sqrt() * (angle + 0.1 * angle.powi(3));
        assert!((fisheye.distort(p) - expected).length() < 1e-15);
    }

    proptest! {
        #[test]
        fn undistorting_undoes_distorting(which in 0usize..8, angle in 0.0..6.3f64, part in 0.0..0.95f64) {
            let lens = lenses()[which];
            let radius = part * lens.field_radius().min(3.0);
            let ideal = radius * DVec2::from_angle(angle);
            let back = lens.undistort(lens.distort(ideal)).unwrap();
            prop_assert!((back - ideal).length() < 1e-9, "{lens:?} {ideal} {back}");
        }
    }

    #[test]
    fn outside_the_field_there_is_no_ray() {
        let barrel = Distortion::RadialTangential {
            radial: [-0.3, 0.0, 0.0, 0.0, 0.0, 0.0],
            tangential: [0.0; 2],
        };
        // r − 0.3 r³ grows up to r = 1 / sqrt(0.9).
        let edge = 1.0 / 0.9f64.sqrt();
        assert!((barrel.field_radius() - edge).abs() < 1e-9);
        assert_eq!(barrel.undistort(DVec2::new(0.8, 0.0)), None);
        assert!(barrel.undistort(DVec2::new(0.7, 0.0)).unwrap().x < edge);
        assert_eq!(Distortion::None.field_radius(), f64::INFINITY);
        let fisheye = Distortion::Fisheye { radial: [0.0; 4] };
        assert_eq!(fisheye.undistort(DVec2::new(1.6, 0.0)), None, "beyond 90°");
    }
}
