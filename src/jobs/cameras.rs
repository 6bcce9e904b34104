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
use std::collections::BTreeSet;
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

/// So far apart they may be where the cams are for that size in other views.
const NOT_FAR: f64 = 0.2;

/// Reads the cameras at `path`.
///
/// A `cam.txt` has no image size: without `options.size` a view's is `likely` where that goes with its
/// principal point, else twice the principal point; if some views have the one and some the other, a
/// warning says so.
///
/// # Errors
/// No cameras there, files that cannot be read, and what they leave open and `options` does not say.
pub fn read(
    path: &Path,
    (pixel_centre, options): (PixelCentre, &CameraOptions),
    likely: Option<Size>,
    context: &Context<'_>,
) -> Result<Scene> {
    let read = read_files(path, pixel_centre, options)?;
    let sizes = likely.filter(|_| lack_sizes(&read, options));
    let sizes = sizes.map(|size| at_size(read.scene.views(), size, context));
    finished(read, &sizes.unwrap_or_default(), context)
}

/// Reads the cameras at `path` for images of the sizes that `images` gives, one for each view.
///
/// Without `options.size` the sizes that cams are for are as [`of_images`] says, and a `transforms.json` that states
/// no size is for its images'. Returned are also the images' sizes.
pub(super) fn read_for(
    path: &Path,
    (pixel_centre, options): (PixelCentre, &CameraOptions),
    images: impl FnOnce(&[View]) -> Result<Vec<Size>>,
    context: &Context<'_>,
) -> Result<(Scene, Vec<Size>)> {
    if options.size.is_none() && cameras::left_open(path)?.size {
        return read_at_images(path, (pixel_centre, options), images, context);
    }
    let read = read_files(path, pixel_centre, options)?;
    let images = images(read.scene.views())?;
    let sizes = match lack_sizes(&read, options) {
        true => of_images(read.scene.views(), &some(&images)),
        false => Vec::new(),
    };
    warn_of_far(read.scene.views(), &sizes, context);
    Ok((finished(read, &sizes, context)?, images))
}

/// Reads a `transforms.json` that states no image size as being for its images'.
fn read_at_images(
    path: &Path,
    (pixel_centre, options): (PixelCentre, &CameraOptions),
    images: impl FnOnce(&[View]) -> Result<Vec<Size>>,
    context: &Context<'_>,
) -> Result<(Scene, Vec<Size>)> {
    let at = |size: Size| {
        let size = Some(size);
        read_files(path, pixel_centre, &CameraOptions { size, ..*options })
    };
    // At any size the views have their names, by which their images are found.
    let nominal = at(NOMINAL)?;
    let images = images(nominal.scene.views())?;
    let size = images.first().copied().unwrap_or(NOMINAL);
    if let Some(other) = images.iter().find(|other| **other != size) {
        let problem = format!(
            "expected w and h in the file, or photographs of one size, found neither, but {size} and {other}: \
             give --camera-size"
        );
        return Err(mvs_datasets::Error::layout(&nominal.path, problem).into());
    }
    let message = format!(
        "the cameras state no image size (w, h): they are taken to be for {size}, the photographs' size; if that is \
         wrong, give --camera-size"
    );
    context.warnings.add("camera-size", message);
    Ok((finished(at(size)?, &[], context)?, images))
}

/// An image size that stands for one that is not known.
pub(super) const NOMINAL: Size = Size {
    width: 1,
    height: 1,
};

fn lack_sizes(read: &ReadCameras, options: &CameraOptions) -> bool {
    options.size.is_none() && read.source == CameraSource::Cams
}

fn some(sizes: &[Size]) -> Vec<Option<Size>> {
    sizes.iter().copied().map(Some).collect()
}

/// The size that each view's cam is for: its image's, if that goes with the principal point of this view or
/// of another one with such an image, or if it seems cut: twice the principal point has another shape, and is
/// no multiple. `None` for twice the principal point.
pub(super) fn of_images(views: &[View], images: &[Option<Size>]) -> Vec<Option<Size>> {
    let known = fitting(views, images);
    let is_for =
        |view: &View, size: &Size| known.contains(&pair(*size)) || is_cut(*size, &view.camera);
    let own = views.iter().zip(images);
    own.map(|(view, size)| size.filter(|size| is_for(view, size)))
        .collect()
}

/// The sizes that go with the principal point of a view with an image of that size.
fn fitting(views: &[View], images: &[Option<Size>]) -> BTreeSet<(u32, u32)> {
    let own = views.iter().zip(images);
    let fits = own.filter_map(|(view, size)| size.filter(|&size| goes_with(size, &view.camera)));
    fits.map(pair).collect()
}

fn pair(size: Size) -> (u32, u32) {
    (size.width, size.height)
}

/// Whether the principal point is in the inner half of images of this size, and farther from the middle along
/// one axis than along the other, so that no scale explains it.
fn is_cut(size: Size, camera: &Camera) -> bool {
    let twice = 2.0 * camera.center() / DVec2::new(size.width.into(), size.height.into());
    (twice.x / twice.y - 1.0).abs() >= NEAR && is_within(0.5, size, camera)
}

/// Says so where cams are taken to be for images whose middle is far from the principal point, or from those
/// of all views with such images.
fn warn_of_far(views: &[View], sizes: &[Option<Size>], context: &Context<'_>) {
    let known = fitting(views, sizes);
    let is_sure = |view: &View, size: Size| {
        known.contains(&pair(size)) && is_within(NOT_FAR, size, &view.camera)
    };
    let far = |(view, size): (&View, &Option<Size>)| {
        let size = size.filter(|&size| !is_sure(view, size))?;
        Some((view.id, size))
    };
    let mut far = views.iter().zip(sizes).filter_map(far);
    if let Some((id, size)) = far.next() {
        let message = format!(
            "the cams of {} views are taken to be for images of their photographs' sizes, whose middle is far \
             from the principal point, the first is view {id}'s for {size}: if that is wrong, give --camera-size",
            1 + far.count()
        );
        context.warnings.add("camera-size", message);
    }
}

/// `size` for the views whose cam is for it. Says so if some are and some are not.
fn at_size(views: &[View], size: Size, context: &Context<'_>) -> Vec<Option<Size>> {
    let some_are = views.iter().any(|view| goes_with(size, &view.camera));
    let is_for = |view: &View| some_are && is_within(NOT_FAR, size, &view.camera);
    let sizes: Vec<Option<Size>> = (views.iter())
        .map(|view| is_for(view).then_some(size))
        .collect();
    let others = || {
        views
            .iter()
            .zip(&sizes)
            .filter(|(_, taken)| taken.is_none())
    };
    if let (true, Some((first, _))) = (some_are, others().next()) {
        let message = format!(
            "the cams of {} of {} views are taken to be for images of another size than {size}, the first \
             is view {}'s for {}x{} (twice its principal point), and scaled to it: if that is wrong, give \
             --camera-size",
            others().count(),
            views.len(),
            first.id,
            first.camera.width(),
            first.camera.height()
        );
        context.warnings.add("camera-size", message);
    }
    warn_of_centred(views, &sizes, context);
    sizes
}

/// Says so where cams are taken to be for images a little larger or smaller than those whose middle is exactly
/// the principal point.
fn warn_of_centred(views: &[View], sizes: &[Option<Size>], context: &Context<'_>) {
    let other = |(view, size): (&View, &Option<Size>)| {
        let (size, twice) = ((*size)?, 2.0 * view.camera.center());
        let is_centred = (twice - twice.round()).abs().max_element() < 1e-6;
        let own = (view.camera.width(), view.camera.height());
        (is_centred && own != pair(size)).then_some((own, size))
    };
    let mut others = views.iter().zip(sizes).filter_map(other);
    if let Some(((width, height), size)) = others.next() {
        let message = format!(
            "{} cams, whose principal points are the middle of images of {width}x{height}, say, are taken to be \
             for images of {size}, and not scaled: if they are to be, give --camera-size {width}x{height}",
            1 + others.count()
        );
        context.warnings.add("camera-size", message);
    }
}

/// The scene with cams for these sizes, where there are any; what is to be known of it becomes warnings.
fn finished(read: ReadCameras, sizes: &[Option<Size>], context: &Context<'_>) -> Result<Scene> {
    for note in &read.notes {
        context.warnings.add("cameras", note.clone());
    }
    let source = read.source;
    let scene = with_sizes(read.scene, sizes)?;
    if source == CameraSource::Cams && are_half_pixel_off(&scene) {
        warn_of_integer_centres(context);
    }
    Ok(scene)
}

/// The scene with cameras for images of these sizes, focal lengths and principal points as they are;
/// views without a size keep theirs.
pub(super) fn with_sizes(scene: Scene, sizes: &[Option<Size>]) -> Result<Scene> {
    let mut sizes = sizes.iter().copied();
    mapped(scene, |view| {
        let size = sizes.next().flatten();
        let camera = size.map(|size| view.camera.cropped(0, 0, size.width, size.height));
        Ok(View {
            camera: camera.unwrap_or(Ok(view.camera))?,
            ..view.clone()
        })
    })
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
    is_within(NEAR, size, camera)
}

fn is_within(fraction: f64, size: Size, camera: &Camera) -> bool {
    let center = camera.center();
    let near = |length: u32, center: f64| (2.0 * center / f64::from(length) - 1.0).abs() < fraction;
    near(size.width, center.x) && near(size.height, center.y)
}

/// The scene with cameras scaled to cover images of `size` and cropped to their centre.
///
/// # Errors
/// As [`Fit::new`].
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
///
/// # Errors
/// Never: every camera is one without its lens too.
pub fn without_lenses(scene: Scene) -> Result<Scene> {
    mapped(scene, |view| {
        Ok(View {
            camera: view.camera.with_distortion(Distortion::None)?,
            ..view.clone()
        })
    })
}

/// The scene with its views changed one by one; their ids stay.
fn mapped(scene: Scene, change: impl FnMut(&View) -> Result<View>) -> Result<Scene> {
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

    fn view_at(id: u32, center: (f64, f64)) -> View {
        let center = DVec2::new(center.0, center.1);
        let size = (2.0 * center).round();
        let camera = Camera::new(size.x as u32, size.y as u32, DVec2::splat(50.0), center);
        View {
            id,
            name: String::new(),
            camera: camera.unwrap(),
            pose: mvs_datasets::scene::Pose::IDENTITY,
            depth_range: None,
        }
    }

    fn sizes(texts: &[&str]) -> Vec<Option<Size>> {
        texts.iter().map(|text| text.parse().ok()).collect()
    }

    #[test]
    fn each_view_has_its_own_images_size_where_cams_are_for_the_images() {
        let views = [(64.0, 48.0), (32.0, 24.0), (24.0, 32.0), (70.0, 48.0)];
        let views = (0..).zip(views).map(|(id, center)| view_at(id, center));
        let views: Vec<View> = views.collect();
        // The last one's middle is far from its principal point, as others' of that size are not.
        let images = sizes(&["128x96", "64x48", "48x64", "128x96"]);
        assert_eq!(of_images(&views, &images), images);
        // Cut images, whose middle is elsewhere: all of them are said.
        let cut = sizes(&["90x96", "64x34", "40x64", "128x70"]);
        assert_eq!(of_images(&views, &cut), cut);
        let (warnings, progress) = (Warnings::default(), Silent);
        let context = Context {
            progress: &progress,
            warnings: &warnings,
            force: false,
        };
        warn_of_far(&views, &images, &context);
        assert!(warnings.sorted().is_empty());
        warn_of_far(&views, &cut, &context);
        let said = &warnings.sorted()[0].message;
        assert!(
            said.starts_with("the cams of 4 views") && said.contains("view 0's for 90x96"),
            "{said}"
        );
        // Images of half the size that the cams are for.
        let halves = sizes(&["64x48", "16x12", "12x16", "none"]);
        assert_eq!(of_images(&views, &halves), [None; 4]);
    }

    #[test]
    fn a_size_is_that_of_the_views_whose_principal_point_it_goes_with() {
        let (warnings, progress) = (Warnings::default(), Silent);
        let context = Context {
            progress: &progress,
            warnings: &warnings,
            force: false,
        };
        let views = [(64.0, 48.0), (70.0, 48.0), (128.0, 96.0), (48.0, 64.0)];
        let views = (0..).zip(views).map(|(id, center)| view_at(id, center));
        let views: Vec<View> = views.collect();
        let size: Size = "128x96".parse().unwrap();
        let of = |views: &[View]| at_size(views, size, &context);
        assert_eq!(of(&views[1..2]), [None]);
        assert_eq!(of(&[view_at(5, (62.3, 47.9))]), [Some(size)]);
        assert!(warnings.sorted().is_empty());
        assert_eq!(of(&[view_at(5, (62.0, 47.5))]), [Some(size)]);
        let said = &warnings.sorted()[0].message;
        assert!(
            said.starts_with("1 cams") && said.ends_with("--camera-size 124x95"),
            "{said}"
        );
        let warnings = Warnings::default();
        let context = Context {
            warnings: &warnings,
            ..context
        };
        let of = |views: &[View]| at_size(views, size, &context);
        assert_eq!(of(&views), [Some(size), Some(size), None, None]);
        let said = warnings.sorted();
        let has = |parts: [&str; 2]| {
            let mut said = said.iter().map(|warning| &warning.message);
            said.any(|message| parts.iter().all(|part| message.contains(part)))
        };
        assert!(has(["2 of 4 views", "view 2's for 256x192"]), "{said:?}");
        assert!(has(["1 cams", "--camera-size 140x96"]), "{said:?}");
    }

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
