//! Resize and crop of the BlendedMVS paper: the smallest scale that covers the wanted size, then
//! the centre of it; cameras change with their images.

use super::{resample, undistort};
use crate::error::{Error, Result};
use glam::DVec2;
use mvs_datasets::scene::{Camera, ColorImage, Distortion, View};

/// How a view's image becomes one of the wanted size.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Fit {
    /// The size of the image that the camera took.
    own: (u32, u32),
    resized: (u32, u32),
    offset: (u32, u32),
    camera: Camera,
    /// The camera that took the photograph, if its lens is to be undone.
    lens: Option<Camera>,
}

impl Fit {
    /// As [`Fit::new`], and the fitted image's camera is a pinhole one with the same focal lengths
    /// and principal point: what the lens did to the photograph is undone.
    ///
    /// # Errors
    /// As [`Fit::new`].
    pub fn undistorting(camera: &Camera, size: Option<(u32, u32)>) -> Result<Self> {
        let pinhole = camera.with_distortion(Distortion::None)?;
        let bent = camera.distortion() != Distortion::None;
        Ok(Self {
            lens: bent.then_some(*camera),
            ..Self::new(&pinhole, size)?
        })
    }

    /// The fit of an image that `camera` took to `size` (width, height), or to its own size; at most
    /// 65535 pixels a side, before the cut too.
    ///
    /// # Errors
    /// A size without pixels, and one that takes more than 65535 pixels a side or 2²⁹ in all to cover.
    pub fn new(camera: &Camera, size: Option<(u32, u32)>) -> Result<Self> {
        let own = (camera.width(), camera.height());
        let size = size.unwrap_or(own);
        if size.0 == 0 || size.1 == 0 {
            let problem = format!("expected at least 1x1 pixels, found {}x{}", size.0, size.1);
            return Err(Error::invalid("image size", problem));
        }
        let along_width = f64::from(size.0) / f64::from(own.0);
        let along_height = f64::from(size.1) / f64::from(own.1);
        let scale = along_width.max(along_height);
        let scaled =
            |length: u32, wanted: u32| ((f64::from(length) * scale).round() as u32).max(wanted);
        let resized = (scaled(own.0, size.0), scaled(own.1, size.1));
        if resized.0.max(resized.1) > MOST_SIDE {
            let problem = format!(
                "expected at most {MOST_SIDE} pixels a side, found {}x{} to cover {}x{}",
                resized.0, resized.1, size.0, size.1
            );
            return Err(Error::invalid("image size", problem));
        }
        let offset = ((resized.0 - size.0) / 2, (resized.1 - size.1) / 2);
        let camera = camera.resized(resized.0, resized.1)?.cropped(
            i64::from(offset.0),
            i64::from(offset.1),
            size.0,
            size.1,
        )?;
        Ok(Self {
            own,
            resized,
            offset,
            camera,
            lens: None,
        })
    }

    /// The camera of the fitted image.
    pub fn camera(&self) -> &Camera {
        &self.camera
    }

    /// The view with the fitted image's camera.
    pub fn view(&self, view: &View) -> View {
        View {
            camera: self.camera,
            ..view.clone()
        }
    }

    /// The photograph, of whatever size, fitted, and the number of pixels that it does not cover,
    /// where its border is repeated. Its shape must be that of the camera it was fitted for, to the
    /// rounding of its sides.
    ///
    /// # Errors
    /// A photograph of another shape, and one of more than 2²⁹ pixels whose lens is to be undone.
    pub fn image(&self, photograph: ColorImage) -> Result<(ColorImage, usize)> {
        let size = (self.camera.width(), self.camera.height());
        let bent = self.lens.is_some();
        if photograph.size() == self.resized && self.resized == size && !bent {
            return Ok((photograph, 0));
        }
        if !same_shape(self.own, photograph.size()) {
            let (width, height) = photograph.size();
            let problem = format!(
                "expected the shape of the camera's image, a multiple of {} x {}, found {width} x \
                 {height}; is the camera's size (--camera-size) that of the photographs?",
                self.own.0, self.own.1
            );
            return Err(Error::invalid("photograph", problem));
        }
        if let Some(lens) = &self.lens {
            return undistort::undistorted(&photograph, lens, &self.camera);
        }
        let resized = resample::resized(&photograph, self.resized)?;
        Ok((resample::cropped(&resized, self.offset, size)?, 0))
    }
}

/// The image resized by the smallest scale that covers `size` (width, height) and cut to its centre,
/// whatever its shape.
///
/// # Errors
/// An image of more than 2²⁹ pixels; else as [`Fit::new`].
pub fn covering(image: ColorImage, size: (u32, u32)) -> Result<ColorImage> {
    let (width, height) = image.size();
    let center = 0.5 * DVec2::new(f64::from(width), f64::from(height));
    let camera = Camera::new(width, height, DVec2::ONE, center)?;
    Ok(Fit::new(&camera, Some(size))?.image(image)?.0)
}

/// The most pixels on a side that a JPEG can have.
const MOST_SIDE: u32 = 65_535;

/// Whether images of the two sizes (width, height) show the same at two scales: the shorter side is
/// what follows from the longer one, to the rounding of either image to whole pixels.
pub(crate) fn same_shape(own: (u32, u32), other: (u32, u32)) -> bool {
    let sides = |(width, height): (u32, u32)| match own.0 >= own.1 {
        true => (f64::from(width), f64::from(height)),
        false => (f64::from(height), f64::from(width)),
    };
    let ((long, short), (other_long, other_short)) = (sides(own), sides(other));
    let scale = other_long / long;
    (other_short - short * scale).abs() <= scale.max(1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera(width: u32, height: u32) -> Camera {
        let center = DVec2::new(f64::from(width) / 2.0, f64::from(height) / 2.0);
        Camera::new(width, height, DVec2::splat(1000.0), center).unwrap()
    }

    #[test]
    fn the_smallest_covering_scale_then_the_centre() {
        let fit = Fit::new(&camera(4000, 2000), Some((2048, 1536))).unwrap();
        assert_eq!((fit.resized, fit.offset), ((3072, 1536), (512, 0)));
        let fitted = fit.camera();
        assert!((fitted.focal() - DVec2::splat(768.0)).length() < 1e-9);
        assert_eq!(fitted.center(), DVec2::new(1024.0, 768.0));
        let tall = Fit::new(&camera(1092, 1400), Some((768, 576))).unwrap();
        assert_eq!((tall.resized, tall.offset), ((768, 985), (0, 204)));
        // The scale is exact per axis, the offset the one that was really cut.
        let center = 700.0 * 985.0 / 1400.0 - 204.0;
        assert!((tall.camera().center().y - center).abs() < 1e-12);
    }

    #[test]
    fn a_point_of_the_photograph_stays_under_its_ray() {
        let camera = camera(300, 200);
        let fit = Fit::new(&camera, Some((90, 80))).unwrap();
        let ray = camera.ray(DVec2::new(150.0, 100.0));
        let seen = fit.camera().project(ray).unwrap();
        let mut photograph = ColorImage::filled(300, 200, [0; 3]).unwrap();
        for row in 96..104 {
            for column in 146..154 {
                photograph.set(column, row, [200; 3]);
            }
        }
        let (image, _) = fit.image(photograph).unwrap();
        assert_eq!(image.size(), (90, 80));
        let (mut sum, mut at) = (0.0, DVec2::ZERO);
        for row in 0..80 {
            for column in 0..90 {
                let weight = f64::from(image.get(column, row)[0]);
                sum += weight;
                at += weight * DVec2::new(f64::from(column) + 0.5, f64::from(row) + 0.5);
            }
        }
        assert!((at / sum - seen).length() < 0.05, "{} {seen}", at / sum);
    }

    #[test]
    fn without_a_size_nothing_changes_and_another_shape_is_refused() {
        let camera = camera(30, 20);
        let fit = Fit::new(&camera, None).unwrap();
        assert_eq!(fit.camera(), &camera);
        let photograph = ColorImage::filled(30, 20, [7; 3]).unwrap();
        assert_eq!(
            fit.image(photograph.clone()).unwrap(),
            (photograph.clone(), 0)
        );
        let larger = ColorImage::filled(60, 40, [7; 3]).unwrap();
        assert_eq!(fit.image(larger).unwrap().0, photograph);
        let tall = ColorImage::filled(20, 30, [7; 3]).unwrap();
        assert!(fit.image(tall).unwrap_err().to_string().contains("20 x 30"));
        assert!(Fit::new(&camera, Some((0, 3))).is_err());
    }

    #[test]
    fn shapes_are_compared_to_a_pixel_of_rounding() {
        for (own, other, same) in [
            ((3000, 2000), (3000, 2000), true),
            ((3000, 2000), (1000, 667), true), // 666.7
            ((1000, 667), (3000, 2000), true), // of 2001
            ((667, 1000), (2000, 3000), true),
            ((7952, 5304), (249, 166), true),
            ((3000, 2000), (3000, 2002), false), // within 1 %, and another picture
            ((3000, 2000), (1500, 1010), false),
            ((3000, 2000), (2000, 3000), false),
            ((10, 7), (20, 15), true), // rounding of a small image, 1.43 or 1.33
        ] {
            assert_eq!(same_shape(own, other), same, "{own:?} {other:?}");
        }
    }

    #[test]
    fn sizes_that_no_image_has_are_refused_before_any_memory_is_taken() {
        let thin = camera(10_000, 1);
        for (camera, size) in [(camera(30, 20), (70_000, 50)), (thin, (2048, 1536))] {
            let error = Fit::new(&camera, Some(size)).unwrap_err().to_string();
            assert!(error.contains("at most 65535 pixels a side"), "{error}");
        }
        let error = Fit::new(&self::camera(65_536, 8), None).unwrap_err();
        assert!(error.to_string().contains("65536x8"), "{error}");
    }
}
