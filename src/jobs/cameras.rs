//! Reading cameras for a job: whatever the files are, and the image size where they have none.

use super::Context;
use crate::config::Size;
use crate::error::Result;
use crate::generate::Fit;
use glam::DVec2;
use mvs_datasets::layout::cameras::{self, CameraSource, CamerasOptions, ReadCameras};
use mvs_datasets::layout::mvsnet::PixelCentre;
use mvs_datasets::scene::{Camera, Distortion, Scene, View};
use serde::{Deserialize, Serialize};
use std::path::Path;

/// What the camera files leave open.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct CameraOptions {
    /// The image size that the intrinsics are for, where the files have none.
    pub size: Option<Size>,
    /// Focal length in pixels, where the files have none.
    pub focal: Option<f64>,
    /// Principal point in pixels, where the files have none; by default the image's centre.
    pub center: Option<[f64; 2]>,
}

/// An image size and twice the principal point that differ by less than this fraction belong
/// together.
const NEAR: f64 = 0.05;

/// Reads the cameras at `path`.
///
/// A `cam.txt` has no image size: without `options.size` it is `likely` where that goes with the
/// principal point, else twice the principal point.
pub fn read(
    path: &Path,
    (pixel_centre, options): (PixelCentre, &CameraOptions),
    likely: Option<Size>,
    context: &Context<'_>,
) -> Result<Scene> {
    let read = read_files(path, pixel_centre, options)?;
    let assumed = likely.filter(|&size| {
        let first = read.scene.views().first();
        options.size.is_none()
            && read.source == CameraSource::Cams
            && first.is_some_and(|view| goes_with(size, &view.camera))
    });
    let read = match assumed {
        Some(size) => read_files(
            path,
            pixel_centre,
            &CameraOptions {
                size: Some(size),
                ..*options
            },
        )?,
        None => read,
    };
    for note in &read.notes {
        context.warnings.add("cameras", note.clone());
    }
    if read.source == CameraSource::Cams && are_half_pixel_off(&read.scene) {
        warn_of_integer_centres(context);
    }
    Ok(read.scene)
}

/// What to say of cams that were read with pixel centres at (0.5, 0.5) and seem to have them at
/// (0, 0).
pub(super) const INTEGER_CENTRES: &str = "the principal point is half a pixel above and left of the image's middle: the cams seem to count \
     from the top-left pixel's centre; if so, use --pixel-center integer";

/// Adds [`INTEGER_CENTRES`] to the warnings.
pub(super) fn warn_of_integer_centres(context: &Context<'_>) {
    context.warnings.add("pixel-centre", INTEGER_CENTRES);
}

/// Whether every principal point is half a pixel above and left of its image's middle.
pub(super) fn are_half_pixel_off(scene: &Scene) -> bool {
    let views = scene.views();
    !views.is_empty() && views.iter().all(|view| is_half_pixel_off(&view.camera))
}

/// Whether the principal point is half a pixel above and left of the image's middle. In a file that
/// was read as having integer pixel centres that would be a whole pixel.
pub(super) fn is_half_pixel_off(camera: &Camera) -> bool {
    let middle = DVec2::new(camera.width().into(), camera.height().into()) / 2.0;
    (camera.center() - middle + 0.5).abs().max_element() < 1e-6
}

fn read_files(
    path: &Path,
    pixel_centre: PixelCentre,
    options: &CameraOptions,
) -> Result<ReadCameras> {
    let options = CamerasOptions {
        pixel_centre,
        size: options.size.map(|size| (size.width, size.height)),
        focal: options.focal.map(DVec2::splat),
        center: options.center.map(DVec2::from_array),
    };
    Ok(cameras::read_scene(path, &options)?)
}

/// Whether the principal point is about the centre of images of this size.
pub(super) fn goes_with(size: Size, camera: &Camera) -> bool {
    let center = camera.center();
    let near = |length: u32, center: f64| (2.0 * center / f64::from(length) - 1.0).abs() < NEAR;
    near(size.width, center.x) && near(size.height, center.y)
}

/// The scene with cameras scaled to cover images of `size` and cropped to their centre.
pub fn fitted(scene: Scene, size: Size) -> Result<Scene> {
    mapped(scene, |view| {
        Ok(Fit::new(&view.camera, Some((size.width, size.height)))?.view(view))
    })
}

/// How many views have a lens, which a `cam.txt` cannot hold.
pub fn lens_count(scene: &Scene) -> usize {
    let views = scene.views().iter();
    views
        .filter(|view| view.camera.distortion() != Distortion::None)
        .count()
}

/// The scene with pinhole cameras of the same focal lengths and principal points in the place of
/// those with a lens.
pub fn without_lenses(scene: Scene) -> Result<Scene> {
    mapped(scene, |view| {
        Ok(View {
            camera: view.camera.with_distortion(Distortion::None)?,
            ..view.clone()
        })
    })
}

/// The scene with its views changed one by one; their ids stay.
fn mapped(scene: Scene, change: impl Fn(&View) -> Result<View>) -> Result<Scene> {
    let views = scene.views().iter().map(change);
    let views = views.collect::<Result<Vec<View>>>()?;
    let sources = (0..views.len())
        .map(|index| scene.sources_of(index).to_vec())
        .collect();
    Ok(Scene::new(views)?.with_sources(sources)?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::progress::Silent;
    use crate::warning::Warnings;

    const CAM: &str = "extrinsic\n1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n\nintrinsic\n40 0 19.6\n\
                       0 40 15.1\n0 0 1\n\n1 0.01 128 3\n";

    fn read_at(size: &str) -> Camera {
        let folder = tempfile::tempdir().unwrap();
        mvs_datasets::layout::files::write_atomically(
            &folder.path().join("00000000_cam.txt"),
            |out| std::io::Write::write_all(out, CAM.as_bytes()),
        )
        .unwrap();
        let (warnings, progress) = (Warnings::default(), Silent);
        let context = Context {
            progress: &progress,
            warnings: &warnings,
            force: false,
        };
        let options = (PixelCentre::Half, &CameraOptions::default());
        let size: Size = size.parse().unwrap();
        let scene = read(folder.path(), options, Some(size), &context).unwrap();
        fitted(scene, size).unwrap().views()[0].camera
    }

    #[test]
    fn a_size_that_goes_with_the_principal_point_is_the_cameras_own() {
        let camera = read_at("40x30");
        assert_eq!((camera.width(), camera.height()), (40, 30));
        assert_eq!((camera.focal().x, camera.center().x), (40.0, 19.6));
    }

    #[test]
    fn another_size_scales_the_camera() {
        let camera = read_at("80x60");
        assert_eq!((camera.width(), camera.height()), (80, 60));
        // Twice the principal point, 39 x 30 pixels, is scaled by 80 / 39 to cover 80 x 60.
        assert!(
            (camera.focal().x - 40.0 * 80.0 / 39.0).abs() < 0.2,
            "{}",
            camera.focal()
        );
    }

    #[test]
    fn lenses_are_counted_and_taken_off() {
        let radial = [0.1, 0.0, 0.0, 0.0, 0.0, 0.0];
        let lens = Distortion::RadialTangential {
            radial,
            tangential: [0.0; 2],
        };
        let camera = read_at("40x30");
        let view = |id, camera| View {
            id,
            name: String::new(),
            camera,
            pose: mvs_datasets::scene::Pose::IDENTITY,
            depth_range: None,
        };
        let plain = Scene::new(vec![view(3, camera)]).unwrap();
        assert_eq!(lens_count(&plain), 0);
        let bent = view(7, camera.with_distortion(lens).unwrap());
        let bent = Scene::new(vec![view(3, camera), bent]).unwrap();
        assert_eq!(lens_count(&bent), 1);
        let straight = without_lenses(bent).unwrap();
        assert_eq!(
            (lens_count(&straight), straight.views()[1].camera),
            (0, camera)
        );
    }
}
