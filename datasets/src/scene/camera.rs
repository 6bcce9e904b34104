use super::distortion::Distortion;
use crate::error::{Error, Result};
use glam::{DMat3, DMat4, DVec2, DVec3};

/// The most pixels that an image can have here, as the image readers': what a camera sees can be
/// allocated.
const MAX_PIXELS: u64 = 1 << 29;

/// A camera: image size and intrinsics in pixels, and what its lens does, if anything.
///
/// Continuous image coordinates: the centre of pixel (column, row) is (column + 0.5, row + 0.5).
/// Sizes are ≥ 1, focal lengths are finite and > 0, the principal point is finite.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Camera {
    width: u32,
    height: u32,
    fx: f64,
    fy: f64,
    cx: f64,
    cy: f64,
    distortion: Distortion,
    /// [`Distortion::field_radius`], found once.
    field_radius: f64,
}

impl Camera {
    /// A camera of `width` × `height` pixels with focal lengths `focal` and principal point
    /// `center`, all in pixels.
    ///
    /// # Errors
    /// No pixels, more than 2²⁹ of them, focal lengths that are not finite and above 0, and a principal point that is
    /// not finite.
    pub fn new(width: u32, height: u32, focal: DVec2, center: DVec2) -> Result<Self> {
        if focal.is_finite() && focal.min_element() < 0.0 {
            let problem = format!(
                "expected focal lengths above 0 px, found {} and {}: where +Y goes down and +Z ahead, as here, none is \
                 negative",
                focal.x, focal.y
            );
            return Err(Error::invalid("camera", problem));
        }
        if width == 0 || height == 0 {
            let problem = format!("expected at least 1x1 pixels, found {width}x{height}");
            return Err(Error::invalid("camera", problem));
        }
        if u64::from(width) * u64::from(height) > MAX_PIXELS {
            let problem = format!("expected at most {MAX_PIXELS} pixels, found {width}x{height}");
            return Err(Error::invalid("camera", problem));
        }
        if !(focal.is_finite() && focal.x > 0.0 && focal.y > 0.0) {
            let problem = format!(
                "expected focal lengths above 0 px, found {} and {}: the intrinsics are singular",
                focal.x, focal.y
            );
            return Err(Error::invalid("camera", problem));
        }
        if !center.is_finite() {
            let problem = format!(
                "expected a finite principal point, found ({}, {})",
                center.x, center.y
            );
            return Err(Error::invalid("camera", problem));
        }
        Ok(Self {
            width,
            height,
            fx: focal.x,
            fy: focal.y,
            cx: center.x,
            cy: center.y,
            distortion: Distortion::None,
            field_radius: f64::INFINITY,
        })
    }

    /// The same camera behind a lens. [`Camera::project`] and [`Camera::ray`] go through it.
    ///
    /// # Errors
    /// Coefficients that are not finite, and a field-of-view lens whose ω is not inside (0, π).
    pub fn with_distortion(mut self, distortion: Distortion) -> Result<Self> {
        if !distortion.is_sound() {
            let problem = format!(
                "expected finite distortion coefficients and angles inside 0 to 180 degrees, found \
                 {distortion:?}"
            );
            return Err(Error::invalid("camera", problem));
        }
        self.distortion = distortion;
        self.field_radius = distortion.field_radius();
        Ok(self)
    }

    /// What the lens does.
    pub fn distortion(&self) -> Distortion {
        self.distortion
    }

    /// Image width in pixels.
    #[inline]
    pub fn width(&self) -> u32 {
        self.width
    }

    /// Image height in pixels.
    #[inline]
    pub fn height(&self) -> u32 {
        self.height
    }

    /// Focal lengths (fx, fy) in pixels.
    pub fn focal(&self) -> DVec2 {
        DVec2::new(self.fx, self.fy)
    }

    /// Principal point (cx, cy) in pixels.
    pub fn center(&self) -> DVec2 {
        DVec2::new(self.cx, self.cy)
    }

    /// The matrix K.
    pub fn intrinsics(&self) -> DMat3 {
        DMat3::from_cols(
            DVec3::new(self.fx, 0.0, 0.0),
            DVec3::new(0.0, self.fy, 0.0),
            DVec3::new(self.cx, self.cy, 1.0),
        )
    }

    /// Image coordinates of a point in the camera frame; `None` unless it lies in front (z > 0) and
    /// inside the lens's field.
    #[inline]
    pub fn project(&self, point_in_cam: DVec3) -> Option<DVec2> {
        if point_in_cam.z <= 0.0 || point_in_cam.z.is_nan() {
            return None;
        }
        let ideal = point_in_cam.truncate() / point_in_cam.z;
        let seen = match self.distortion {
            Distortion::None => ideal,
            _ if ideal.length() > self.field_radius => return None,
            lens => lens.distort(ideal),
        };
        Some(DVec2::new(
            self.fx * seen.x + self.cx,
            self.fy * seen.y + self.cy,
        ))
    }

    /// The point in the camera frame at z-depth 1 that projects to `pixel`; multiply by a z-depth
    /// to reach any other point of the ray. Without distortion every pixel has one; where a lens
    /// has none, x and y are NaN.
    #[inline]
    pub fn ray(&self, pixel: DVec2) -> DVec3 {
        let seen = DVec2::new((pixel.x - self.cx) / self.fx, (pixel.y - self.cy) / self.fy);
        self.distortion
            .undistort_within(seen, self.field_radius)
            .unwrap_or(DVec2::NAN)
            .extend(1.0)
    }

    /// Puts x and y of [`Camera::ray`] in the place of each pixel, to the same bits; many at once are up to ten
    /// times as fast as one by one.
    pub fn rays(&self, pixels: &mut [DVec2]) {
        let (focal, center) = (self.focal(), self.center());
        for pixel in &mut *pixels {
            *pixel = (*pixel - center) / focal;
        }
        self.distortion.undistort_all(self.field_radius, pixels);
    }

    /// Whether continuous coordinates lie on the image, borders included.
    pub fn contains(&self, pixel: DVec2) -> bool {
        pixel.x >= 0.0
            && pixel.y >= 0.0
            && pixel.x <= f64::from(self.width)
            && pixel.y <= f64::from(self.height)
    }

    /// The same camera with its image resized to `width` × `height`: exact scaling per axis.
    ///
    /// # Errors
    /// As [`Camera::new`], of the new size and what it makes of focal lengths and principal point.
    pub fn resized(&self, width: u32, height: u32) -> Result<Self> {
        let scale = DVec2::new(
            f64::from(width) / f64::from(self.width),
            f64::from(height) / f64::from(self.height),
        );
        let (focal, center) = (self.focal() * scale, self.center() * scale);
        Ok(self.behind_same_lens(Self::new(width, height, focal, center)?))
    }

    fn behind_same_lens(&self, other: Self) -> Self {
        Self {
            distortion: self.distortion,
            field_radius: self.field_radius,
            ..other
        }
    }

    /// The same camera seeing only the window of `width` × `height` pixels whose top-left pixel is
    /// (`left`, `top`). The window may reach beyond the image.
    ///
    /// # Errors
    /// No pixels, and more than 2²⁹ of them.
    pub fn cropped(&self, left: i64, top: i64, width: u32, height: u32) -> Result<Self> {
        #[allow(
            clippy::cast_precision_loss,
            reason = "pixel offsets are far below 2^53"
        )]
        let offset = DVec2::new(left as f64, top as f64);
        let center = self.center() - offset;
        Ok(self.behind_same_lens(Self::new(width, height, self.focal(), center)?))
    }
}

/// Where a camera is: `x_in_cam = rotation · x_in_world + translation`, OpenCV axes, world units.
///
/// The rotation is proper and orthonormal to 1e-3 per entry (text files round); it is kept as
/// given and inverted exactly, so that there and back is the identity.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pose {
    rotation: DMat3,
    translation: DVec3,
    inverse_rotation: DMat3,
}

impl Pose {
    /// The camera at the world's origin, looking along +Z.
    pub const IDENTITY: Self = Self {
        rotation: DMat3::IDENTITY,
        translation: DVec3::ZERO,
        inverse_rotation: DMat3::IDENTITY,
    };

    /// A pose from the rotation and translation of `cam_from_world`.
    ///
    /// # Errors
    /// NaN and infinity, a matrix whose product with its transpose is off the identity by more than 2e-3 in an entry,
    /// and a mirror image.
    pub fn new(rotation: DMat3, translation: DVec3) -> Result<Self> {
        if !rotation.is_finite() || !translation.is_finite() {
            return Err(Error::invalid(
                "pose",
                "expected finite numbers, found NaN or infinity",
            ));
        }
        let residual = rotation * rotation.transpose() - DMat3::IDENTITY;
        let worst = residual
            .to_cols_array()
            .into_iter()
            .fold(0.0f64, |w, r| w.max(r.abs()));
        if worst > 2e-3 {
            let problem =
                format!("expected an orthonormal rotation, found one that is off by {worst:.3e}");
            return Err(Error::invalid("pose", problem));
        }
        if rotation.determinant() < 0.0 {
            return Err(Error::invalid(
                "pose",
                "expected a rotation, found a mirror image",
            ));
        }
        Ok(Self {
            rotation,
            translation,
            inverse_rotation: rotation.inverse(),
        })
    }

    /// A pose from a 4×4 `cam_from_world` whose last row is 0 0 0 1, to 1e-6 per entry (programs invert matrices
    /// in floats).
    ///
    /// # Errors
    /// Another last row, and what [`Pose::new`] refuses.
    pub fn from_matrix(cam_from_world: DMat4) -> Result<Self> {
        let last = cam_from_world.row(3);
        let off = (last - glam::DVec4::W).abs();
        if !off.cmple(glam::DVec4::splat(1e-6)).all() {
            let problem = format!("expected a last row of 0 0 0 1, found {last}");
            return Err(Error::invalid("pose", problem));
        }
        Self::new(
            DMat3::from_mat4(cam_from_world),
            cam_from_world.w_axis.truncate(),
        )
    }

    /// The pose of a camera at `eye` that looks at `target`, image upright with respect to `up`
    /// (all in world units). `up` must not be parallel to the line of sight.
    ///
    /// # Errors
    /// An `eye` at the `target`, an `up` that is 0 or parallel to the line of sight, and NaN or infinity.
    pub fn looking_at(eye: DVec3, target: DVec3, up: DVec3) -> Result<Self> {
        let forward = (target - eye).normalize_or_zero();
        let right = forward.cross(up).normalize_or_zero();
        let down = forward.cross(right);
        let rotation = DMat3::from_cols(right, down, forward).transpose();
        Self::new(rotation, -(rotation * eye))
    }

    /// The rotation of `cam_from_world`.
    pub fn rotation(&self) -> DMat3 {
        self.rotation
    }

    /// The translation of `cam_from_world`, in world units.
    pub fn translation(&self) -> DVec3 {
        self.translation
    }

    /// The 4×4 matrix `cam_from_world`.
    pub fn matrix(&self) -> DMat4 {
        let mut matrix = DMat4::from_mat3(self.rotation);
        matrix.w_axis = self.translation.extend(1.0);
        matrix
    }

    /// The camera centre in the world.
    pub fn center_in_world(&self) -> DVec3 {
        self.inverse_rotation * -self.translation
    }

    /// A world point in the camera frame.
    #[inline]
    pub fn to_cam(&self, point_in_world: DVec3) -> DVec3 {
        self.rotation * point_in_world + self.translation
    }

    /// A point of the camera frame in the world.
    #[inline]
    pub fn to_world(&self, point_in_cam: DVec3) -> DVec3 {
        self.inverse_rotation * (point_in_cam - self.translation)
    }

    /// A direction of the camera frame in the world.
    #[inline]
    pub fn direction_to_world(&self, direction_in_cam: DVec3) -> DVec3 {
        self.inverse_rotation * direction_in_cam
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera() -> Camera {
        Camera::new(640, 480, DVec2::new(600.0, 610.0), DVec2::new(321.5, 239.0)).unwrap()
    }

    #[test]
    fn a_last_row_may_be_rounded() {
        let with = |entry: f64| {
            let mut matrix = glam::DMat4::from_translation(DVec3::ONE);
            matrix.x_axis.w = entry;
            Pose::from_matrix(matrix)
        };
        let exact = with(0.0).unwrap();
        assert_eq!(with(-1e-7).unwrap(), exact);
        for entry in [1e-5, f64::NAN, 1.0] {
            let error = with(entry).unwrap_err().to_string();
            assert!(error.contains("expected a last row of 0 0 0 1"), "{error}");
        }
    }

    #[test]
    fn images_that_nobody_can_hold_are_refused() {
        let camera = |width, height| Camera::new(width, height, DVec2::ONE, DVec2::ZERO);
        assert!(camera(65_535, 8_192).is_ok());
        let error = camera(2_000_000_000, 2_000_000_000)
            .unwrap_err()
            .to_string();
        assert!(error.contains("2000000000x2000000000"), "{error}");
    }

    #[test]
    fn projecting_a_ray_returns_its_pixel() {
        let pixel = DVec2::new(17.25, 402.5);
        let back = camera().project(camera().ray(pixel) * 7.5).unwrap();
        assert!((back - pixel).length() < 1e-12);
        assert_eq!(camera().project(DVec3::new(0.0, 0.0, -1.0)), None);
        assert_eq!(camera().project(DVec3::ZERO), None);
    }

    #[test]
    fn a_lens_bends_rays_and_stays_when_resized() {
        let lens = Distortion::RadialTangential {
            radial: [-0.2, 0.05, 0.0, 0.0, 0.0, 0.0],
            tangential: [1e-3, -2e-3],
        };
        let bent = camera().with_distortion(lens).unwrap();
        let point = DVec3::new(0.3, -0.2, 2.0);
        let pixel = bent.project(point).unwrap();
        assert!((pixel - camera().project(point).unwrap()).length() > 0.1);
        assert!((bent.ray(pixel) * 2.0 - point).length() < 1e-12);
        let half = bent
            .resized(320, 240)
            .unwrap()
            .cropped(3, 4, 50, 60)
            .unwrap();
        let expected = pixel * 0.5 - DVec2::new(3.0, 4.0);
        assert!((half.project(point).unwrap() - expected).length() < 1e-12);
        assert_eq!(half.distortion(), lens);
        let broken = Distortion::Fisheye {
            radial: [f64::NAN; 4],
        };
        assert!(camera().with_distortion(broken).is_err());
    }

    #[test]
    fn beyond_a_lens_s_field_nothing_is_seen() {
        let barrel = Distortion::RadialTangential {
            radial: [-0.3, 0.0, 0.0, 0.0, 0.0, 0.0],
            tangential: [0.0; 2],
        };
        let bent = camera().with_distortion(barrel).unwrap();
        assert_eq!(bent.project(DVec3::new(1.5, 0.0, 1.0)), None);
        assert!(bent.ray(DVec2::new(2000.0, 240.0)).x.is_nan());
    }

    #[test]
    fn resizing_scales_the_image_of_every_point() {
        let point = DVec3::new(0.3, -0.2, 2.0);
        let half = camera().resized(320, 240).unwrap();
        let expected = camera().project(point).unwrap() * 0.5;
        assert!((half.project(point).unwrap() - expected).length() < 1e-12);
    }

    #[test]
    fn cropping_shifts_the_image_of_every_point() {
        let point = DVec3::new(0.3, -0.2, 2.0);
        let window = camera().cropped(100, -20, 64, 64).unwrap();
        let expected = camera().project(point).unwrap() - DVec2::new(100.0, -20.0);
        assert!((window.project(point).unwrap() - expected).length() < 1e-12);
    }

    #[test]
    fn singular_intrinsics_are_refused_by_name() {
        let error = Camera::new(4, 4, DVec2::new(0.0, 1.0), DVec2::ONE)
            .unwrap_err()
            .to_string();
        assert!(
            error.contains("singular") && error.contains("found 0 and 1"),
            "{error}"
        );
        assert!(Camera::new(0, 4, DVec2::ONE, DVec2::ONE).is_err());
        assert!(Camera::new(4, 4, DVec2::ONE, DVec2::new(f64::NAN, 0.0)).is_err());
    }

    #[test]
    fn looking_at_puts_the_target_on_the_axis_and_up_up() {
        let eye = DVec3::new(3.0, 2.0, 1.0);
        let pose = Pose::looking_at(eye, DVec3::ZERO, DVec3::Z).unwrap();
        let target = pose.to_cam(DVec3::ZERO);
        assert!(target.truncate().length() < 1e-12 && target.z > 0.0);
        assert!((pose.center_in_world() - eye).length() < 1e-12);
        assert!(
            pose.to_cam(DVec3::Z).y < 0.0,
            "up in the world is -Y in the image"
        );
        assert!((pose.to_world(pose.to_cam(eye * 0.3)) - eye * 0.3).length() < 1e-12);
    }

    #[test]
    fn mirrors_and_shears_are_no_poses() {
        let mirror = DMat3::from_diagonal(DVec3::new(1.0, 1.0, -1.0));
        assert!(
            Pose::new(mirror, DVec3::ZERO)
                .unwrap_err()
                .to_string()
                .contains("mirror")
        );
        assert!(Pose::new(DMat3::from_diagonal(DVec3::splat(1.01)), DVec3::ZERO).is_err());
        assert!(Pose::new(DMat3::IDENTITY, DVec3::splat(f64::NAN)).is_err());
    }
}
