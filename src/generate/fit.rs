//! Resize and crop of the BlendedMVS paper: the smallest scale that covers the wanted size, then
//! the centre of it; cameras change with their images.

use super::{resample, undistort};
use crate::error::{Error, Result};
use mvs_datasets::scene::{Camera, ColorImage, Distortion, View};

/// How a view's image becomes one of the wanted size.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Fit {
    resized: (u32, u32),
    offset: (u32, u32),
    camera: Camera,
    /// The camera that took the photograph, if its lens is to be undone.
    lens: Option<Camera>,
}

impl Fit {
    /// As [`Fit::new`], and the fitted image's camera is a pinhole one with the same focal lengths
    /// and principal point: what the lens did to the photograph is undone.
    pub fn undistorting(camera: &Camera, size: Option<(u32, u32)>) -> Result<Self> {
        let pinhole = camera.with_distortion(Distortion::None)?;
        let bent = camera.distortion() != Distortion::None;
        Ok(Self {
            lens: bent.then_some(*camera),
            ..Self::new(&pinhole, size)?
        })
    }

    /// The fit of an image that `camera` took to `size` (width, height), or to its own size.
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
        let offset = ((resized.0 - size.0) / 2, (resized.1 - size.1) / 2);
        let camera = camera.resized(resized.0, resized.1)?.cropped(
            i64::from(offset.0),
            i64::from(offset.1),
            size.0,
            size.1,
        )?;
        Ok(Self {
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
    /// where its border is repeated. Its shape must be that of the camera it was fitted for to 1 %.
    pub fn image(&self, photograph: ColorImage) -> Result<(ColorImage, usize)> {
        let size = (self.camera.width(), self.camera.height());
        let bent = self.lens.is_some();
        if photograph.size() == self.resized && self.resized == size && !bent {
            return Ok((photograph, 0));
        }
        let shape = |(width, height): (u32, u32)| f64::from(width) / f64::from(height);
        let stretch = shape(photograph.size()) / shape(self.resized);
        if (stretch - 1.0).abs() > 0.01 {
            let (width, height) = photograph.size();
            let problem = format!(
                "expected the shape of the camera's image, a multiple of {} x {}, found {width} x {height}",
                self.resized.0, self.resized.1
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

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec2;

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
}
