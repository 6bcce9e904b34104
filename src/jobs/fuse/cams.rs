//! A folder of cams as depth maps to fuse: which views, and the size that each camera is for.

use super::FuseJob;
use super::coordinates::usual_depth;
use super::find::{camera_for, check_present, find_image, find_mask};
use super::maps::{Encoding, Entry};
use crate::config::Size;
use crate::error::{Error, Result};
use crate::generate;
use crate::jobs::{Context, cameras};
use glam::DVec2;
use mvs_datasets::format::{image, pfm};
use mvs_datasets::layout::files;
use mvs_datasets::layout::mvsnet::{self, CamsOptions};
use mvs_datasets::scene::{Camera, Scene, View};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// Shapes that differ by less than this fraction are the same but for rounding.
const SAME_SHAPE: f64 = 0.05;

/// The views of a folder of cams that have a depth map in the job's folder.
pub(super) fn entries(job: &FuseJob, context: &Context<'_>) -> Result<Vec<Entry>> {
    if job.depths.as_os_str().is_empty() {
        let problem = "expected the folder of depth maps (--depths), or a COLMAP dense workspace as the \
                       scene, found neither";
        return Err(Error::invalid(job.scene.display().to_string(), problem));
    }
    let options = CamsOptions {
        pixel_centre: job.pixel_center,
        size: None,
    };
    let scene = mvsnet::read_scene(&job.scene, &options)?;
    let present = present_views(job, &scene, context)?;
    let mut sizes = Sizes::default();
    let entry = |&index: &usize| entry(job, (&scene, &present), index, &mut sizes);
    let entries = present.iter().map(entry).collect::<Result<Vec<_>>>()?;
    sizes.warn(present.len(), context);
    warn_of_repeats(&scene, context);
    warn_of_no_pairs(job, &scene, context);
    warn_of_ranges(job, &entries, context);
    Ok(entries)
}

/// Says so where depths are to be kept inside the cams' ranges and some have none.
fn warn_of_ranges(job: &FuseJob, entries: &[Entry], context: &Context<'_>) {
    let without = entries
        .iter()
        .filter(|entry| entry.view.depth_range.is_none());
    let without: Vec<u32> = without.map(|entry| entry.view.id).collect();
    if let (true, Some(first)) = (job.fuse.view_range, without.first()) {
        let message = format!(
            "{} views have no depth range above 0 in their cam.txt, the first is view {first}: all their \
             depths count",
            without.len()
        );
        context.warnings.add("no-depth-range", message);
    }
}

/// Positions in `scene` of the views that have a depth map.
fn present_views(job: &FuseJob, scene: &Scene, context: &Context<'_>) -> Result<Vec<usize>> {
    let all = 0..scene.views().len();
    let there = |&index: &usize| depth_path(job, &scene.views()[index]).exists();
    let present: Vec<usize> = all.filter(there).collect();
    let first = scene.views().first().map_or(0, |view| view.id);
    let example = job.depths.join(mvsnet::file_name(first, ".pfm"));
    check_present((present.len(), scene.views().len()), &example, context)?;
    Ok(present)
}

/// Says so where depth maps among the files have no cam.
pub(super) fn warn_of_strays(
    job: &FuseJob,
    (files, entries): (&[&Path], &[Entry]),
    context: &Context<'_>,
) {
    let known: BTreeSet<&Path> = entries.iter().map(|entry| entry.depth.as_path()).collect();
    let is_stray = |path: &&Path| {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        mvsnet::is_depth_name(&name) && path.parent() == Some(&*job.depths) && !known.contains(path)
    };
    let strays: BTreeSet<&Path> = files.iter().copied().filter(is_stray).collect();
    if let Some(first) = strays.first() {
        let message = format!(
            "{}: {} depth maps are of views without a cam and are left out, the first is {}",
            job.depths.display(),
            strays.len(),
            first.file_name().unwrap_or_default().display()
        );
        context.warnings.add("no-cam", message);
    }
}

fn depth_path(job: &FuseJob, view: &View) -> PathBuf {
    job.depths.join(mvsnet::file_name(view.id, ".pfm"))
}

fn entry(
    job: &FuseJob,
    (scene, present): (&Scene, &[usize]),
    index: usize,
    sizes: &mut Sizes,
) -> Result<Entry> {
    let view = &scene.views()[index];
    let depth = depth_path(job, view);
    let (size, usual_depth) = files::read_with(&depth, |bytes| {
        let size = pfm::read_size(bytes)?;
        let rows = |every| pfm::gray_rows(bytes, size, every);
        Ok((size, usual_depth(size, rows)))
    })?;
    let image = image_of(&job.scene, view.id);
    let camera = sizes.camera(job, (view, size), image.as_deref())?;
    sizes.note_shape(view.id, (camera.width(), camera.height()), size);
    let position_of = |id: u32| present.binary_search(&scene.index_of(id)?).ok();
    let mut listed = BTreeSet::new();
    let sources = scene.sources_of(index).iter();
    let sources = sources.filter(|source| listed.insert(source.id));
    let mask = job.masks.as_ref().map(|folder| find_mask(folder, view.id));
    Ok(Entry {
        sources: sources
            .filter_map(|source| position_of(source.id))
            .collect(),
        number: u32::try_from(index).unwrap_or(u32::MAX),
        encoding: Encoding::Pfm,
        usual_depth,
        normals: None,
        confidence: job.confidence_paths(view.id),
        mask: mask.transpose()?,
        image,
        view: View {
            camera: camera_for(&camera, size, &depth)?,
            ..view.clone()
        },
        depth,
    })
}

/// The view's image: in the scene's folder, or beside it where that is the folder of cams.
fn image_of(scene: &Path, id: u32) -> Option<PathBuf> {
    find_image(scene, id).or_else(|| find_image(&mvsnet::above(scene)?, id))
}

/// Without any source views nothing can agree.
fn warn_of_no_pairs(job: &FuseJob, scene: &Scene, context: &Context<'_>) {
    let count = scene.views().len();
    if count > 1 && (0..count).all(|index| scene.sources_of(index).is_empty()) {
        let message = format!(
            "{}: expected a pair.txt that lists source views, beside the cams or beside their folder cams/, \
             found none: mvs-eval pairs writes one from a COLMAP model or a mesh",
            job.scene.display()
        );
        context.warnings.add("no-pairs", message);
    }
}

/// A source that is listed twice is one view, and counts once.
fn warn_of_repeats(scene: &Scene, context: &Context<'_>) {
    let repeated = |index: &usize| {
        let mut listed = BTreeSet::new();
        let mut sources = scene.sources_of(*index).iter();
        sources.any(|source| !listed.insert(source.id))
    };
    let repeated: Vec<usize> = (0..scene.views().len()).filter(repeated).collect();
    if let Some(&first) = repeated.first() {
        let message = format!(
            "pair.txt: {} views list a source view twice, the first is view {}: it counts once",
            repeated.len(),
            scene.views()[first].id
        );
        context.warnings.add("repeated-source", message);
    }
}

/// What image sizes the intrinsics are taken for, since a `cam.txt` does not say.
#[derive(Default)]
struct Sizes {
    /// Views whose size is no image's, and the first one's id, size and reason.
    assumed: Vec<(u32, Size, &'static str)>,
    /// The view whose depth map is the first of another shape than its camera's image, and how many are.
    reshaped: Option<(u32, Size, Size)>,
    reshaped_count: usize,
    /// Cameras as taken, but for views where `--pixel-center` cannot be judged.
    half_pixel_off: usize,
}

impl Sizes {
    /// The view's camera with the image size that its intrinsics are for: `--camera-size`, or as [`Found::size`] says.
    fn camera(
        &mut self,
        job: &FuseJob,
        (view, depth): (&View, (u32, u32)),
        image: Option<&Path>,
    ) -> Result<Camera> {
        let of = |(width, height): (u32, u32)| Size { width, height };
        let image = image.map(|path| files::read_with(path, image::read_size));
        let found = Found {
            camera: &view.camera,
            image: image.transpose()?.map(of),
            depth: of(depth),
        };
        let given = job.camera_size.map(|size| (size, None));
        let Some((size, assumed)) = given.or_else(|| found.size()) else {
            let problem = format!(
                "expected a principal point near the middle of an image or of the depth map of {} \
                 pixels, found ({:.1}, {:.1}): give the images' size, --camera-size",
                found.depth,
                view.camera.center().x,
                view.camera.center().y
            );
            return Err(Error::invalid(format!("view {}", view.id), problem));
        };
        self.assumed.extend(assumed.map(|why| (view.id, size, why)));
        let camera = view.camera.cropped(0, 0, size.width, size.height)?;
        self.half_pixel_off += usize::from(cameras::is_half_pixel_off(&camera));
        Ok(camera)
    }

    /// Maps may be scaled by two factors, but what is cut looks the same.
    fn note_shape(&mut self, id: u32, camera: (u32, u32), depth: (u32, u32)) {
        if !generate::same_shape(camera, depth) {
            let of = |(width, height): (u32, u32)| Size { width, height };
            self.reshaped.get_or_insert((id, of(camera), of(depth)));
            self.reshaped_count += 1;
        }
    }

    fn warn(&self, views: usize, context: &Context<'_>) {
        if let Some((id, camera, depth)) = self.reshaped {
            let message = format!(
                "the depth maps of {} views are of another shape than what their cams are for, view {id}'s has \
                 {depth} pixels instead of {camera}, and are taken for scaled by two factors: if they are cut, \
                 give cams of the cut images and --camera-size",
                self.reshaped_count
            );
            context.warnings.add("depth-shape", message);
        }
        if self.half_pixel_off == views {
            cameras::warn_of_integer_centres(context);
        }
        if let Some((id, size, why)) = self.assumed.first() {
            let message = format!(
                "the cams of {} views do not tell for sure what image size they are for, view {id}'s is taken to be \
                 for {size} pixels ({why}): if that is wrong, give --camera-size",
                self.assumed.len()
            );
            context.warnings.add("camera-size", message);
        }
    }
}

/// What tells the image size that a view's intrinsics are for.
struct Found<'a> {
    /// Its size is twice the principal point.
    camera: &'a Camera,
    image: Option<Size>,
    depth: Size,
}

impl Found<'_> {
    /// The size, with what is said where it is not sure: twice the principal point, where that is a whole number and
    /// the image's or the depth map's size is that, so many times that or such a part of it; the image's where that
    /// goes with the principal point; the depth map's where that does; the image's; twice the principal point, which
    /// has the depth map's shape, where it is a whole number; a multiple of the depth map's; twice the principal point
    /// where it is none.
    fn size(&self) -> Option<(Size, Option<&'static str>)> {
        let (image, depth, camera) = (self.image, self.depth, self.camera);
        let (width, height) = (camera.width(), camera.height());
        let twice = Size { width, height };
        let fits = |size: &Size| cameras::goes_with(*size, camera);
        let is_depth =
            image.map(|_| "the depth maps', which the principal point fits, not the images'");
        let by_twice = Some("twice the principal point");
        let whole = Some(twice).filter(|_| is_a_middle(camera));
        let related = |of: Size| is_times(twice, of) || is_times(of, twice);
        let sure = whole.filter(|_| image.is_some_and(related) || related(depth));
        let how_sure = match image.unwrap_or(depth) {
            size if size == twice => None,
            _ if depth == twice => is_depth,
            _ => by_twice,
        };
        let of_both = Some("the images', though the principal point fits the depth maps', too")
            .filter(|_| image.is_some_and(|image| image != depth) && fits(&depth));
        let of_shape = Some(twice).filter(|twice| same_shape(*twice, depth));
        let sizes = [
            (sure, how_sure),
            (image.filter(fits), of_both),
            (Some(depth).filter(fits), is_depth),
            (
                image,
                Some("the images', whose middle is far from the principal point"),
            ),
            (of_shape.and(whole), by_twice),
            (
                times(depth, camera),
                Some("so many times the depth maps', whose middle is near the principal point"),
            ),
            (of_shape, by_twice),
        ];
        let mut sizes = sizes.into_iter();
        sizes.find_map(|(size, why)| Some((size?, why)))
    }
}

/// Whether a size is the other, or so many times that along both sides.
fn is_times(size: Size, part: Size) -> bool {
    let times = size.width / part.width.max(1);
    let whole = [(size.width, part.width), (size.height, part.height)]
        .iter()
        .all(|&(size, part)| part.checked_mul(times) == Some(size));
    whole && (1..=MOST_TIMES).contains(&times)
}

/// Whether the principal point is the middle of an image of whole pixels, as that of rendered and undistorted ones often
/// is and a calibrated one is not.
fn is_a_middle(camera: &Camera) -> bool {
    let twice = 2.0 * camera.center();
    (twice - twice.round()).abs().max_element() < WHOLE
}

/// How far twice the principal point of a `cam.txt` may be from a whole number that it stands for.
const WHOLE: f64 = 1e-4;

/// So many times the depth maps' size, from twice on, if the principal point is near the middle then: of several the
/// one whose middle is nearest.
fn times(depth: Size, camera: &Camera) -> Option<Size> {
    let size = |times: u32| {
        let (width, height) = (
            depth.width.checked_mul(times)?,
            depth.height.checked_mul(times)?,
        );
        Some(Size { width, height })
    };
    let off = |size: &Size| {
        let middle = 0.5 * DVec2::new(f64::from(size.width), f64::from(size.height));
        ((camera.center() - middle) / middle).abs().max_element()
    };
    let sizes = (2..=MOST_TIMES).filter_map(size);
    let nearest = sizes.min_by(|a, b| off(a).total_cmp(&off(b)))?;
    (off(&nearest) < NEAR_MIDDLE).then_some(nearest)
}

/// How much smaller depth maps are than images at most.
const MOST_TIMES: u32 = 8;
/// How far the principal point may lie from the middle, in halves of the image: less than half the way to the middle
/// of the next size.
const NEAR_MIDDLE: f64 = 0.05;

/// Whether two sizes have about the same ratio of width to height.
fn same_shape(a: Size, b: Size) -> bool {
    let ratio = |size: Size| f64::from(size.width) / f64::from(size.height);
    (ratio(a) / ratio(b) - 1.0).abs() < SAME_SHAPE
}

#[cfg(test)]
mod tests {
    use super::*;
    use mvs_datasets::scene::Pose;

    /// A view as a `cam.txt` gives it: its size is twice the principal point.
    fn view(center: (f64, f64)) -> View {
        let center = DVec2::new(center.0, center.1);
        let size = (2.0 * center).round();
        let camera = Camera::new(size.x as u32, size.y as u32, DVec2::splat(500.0), center);
        View {
            id: 7,
            name: String::new(),
            camera: camera.unwrap(),
            pose: Pose::IDENTITY,
            depth_range: None,
        }
    }

    fn size_of(job: &FuseJob, center: (f64, f64), depth: (u32, u32)) -> Result<(u32, u32)> {
        let camera = Sizes::default().camera(job, (&view(center), depth), None)?;
        assert_eq!(
            camera.focal(),
            DVec2::splat(500.0),
            "the focal length is as given"
        );
        assert_eq!(camera.center().to_array(), <[f64; 2]>::from(center));
        Ok((camera.width(), camera.height()))
    }

    #[test]
    fn without_images_the_depth_maps_size_counts_where_it_goes_with_the_principal_point() {
        let mut job = FuseJob::default();
        assert_eq!(
            size_of(&job, (330.0, 238.0), (640, 480)).unwrap(),
            (640, 480)
        );
        assert_eq!(
            size_of(&job, (320.0, 240.0), (160, 120)).unwrap(),
            (640, 480)
        );
        let error = size_of(&job, (100.0, 240.0), (640, 480))
            .unwrap_err()
            .to_string();
        assert!(
            error.contains("view 7") && error.contains("--camera-size"),
            "{error}"
        );
        job.camera_size = Some("640x480".parse().unwrap());
        assert_eq!(
            size_of(&job, (100.0, 240.0), (640, 480)).unwrap(),
            (640, 480)
        );
    }

    #[test]
    fn whole_numbers_of_pixels_count_before_sizes_that_are_near() {
        let size = |(width, height): (u32, u32)| Size { width, height };
        let found = |twice: (f64, f64), depth, image| {
            let view = view((0.5 * twice.0, 0.5 * twice.1));
            let found = Found {
                camera: &view.camera,
                image: Some(size(image)),
                depth: size(depth),
            };
            let (size, why) = found.size().unwrap();
            ((size.width, size.height), why.unwrap_or_default())
        };
        // Photographs for colours alone, a little larger or quite another size than the cams are for.
        let (cams, whole) = ((320.0, 240.0), (320, 240));
        let (taken, why) = found(cams, whole, (333, 250));
        assert!(taken == whole && why.starts_with("the depth maps'"));
        for (depth, image) in [
            ((160, 120), (640, 480)),
            ((160, 120), (160, 120)),
            ((160, 120), (333, 250)),
            ((118, 88), (640, 480)),
        ] {
            let twice = (whole, "twice the principal point");
            assert_eq!(found(cams, depth, image), twice);
        }
        assert_eq!(found((80.0, 60.0), whole, whole).0, (80, 60));
        assert_eq!(found(cams, (80, 60), whole), (whole, ""));
        // No whole number, no multiple, too large a one: as before.
        let (photo, half) = ((640, 480), (320, 240));
        assert_eq!(found((647.3, 474.9), half, photo), (photo, ""));
        let (taken, why) = found((600.0, 450.0), half, photo);
        assert!(taken == photo && why.contains("far from"));
        assert_eq!(found((1.0, 1.0), (512, 512), (512, 512)).0, (512, 512));
        // Both are near.
        let (taken, why) = found((1646.41, 1238.14), (1600, 1184), (1600, 1200));
        assert!(taken == (1600, 1200) && why.contains("too"));
    }

    #[test]
    fn a_multiple_of_the_depth_maps_size_is_that_whose_middle_is_near() {
        let depth = Size {
            width: 192,
            height: 144,
        };
        let found = |x, y| times(depth, &view((x, y)).camera).map(|size| (size.width, size.height));
        assert_eq!(found(381.87, 285.56), Some((768, 576)));
        assert_eq!(found(192.0, 144.0), Some((384, 288)));
        assert_eq!(found(768.0, 590.0), Some((1536, 1152)));
        // The depth maps' own size is asked about before; no multiple; another shape.
        assert_eq!(found(96.0, 72.0), None);
        assert_eq!(found(240.0, 180.0), None);
        assert_eq!(found(384.0, 200.0), None);
    }

    #[test]
    fn twice_the_principal_point_counts_where_it_is_a_middle() {
        let found = |center, depth| size_of(&FuseJob::default(), center, depth).unwrap();
        for (size, depth) in [
            ((400u32, 300u32), (96, 72)),
            ((384, 216), (200, 112)),
            ((130, 97), (64, 48)),
            ((480, 270), (120, 66)),
            ((228, 171), (32, 24)),
        ] {
            let center = (0.5 * f64::from(size.0), 0.5 * f64::from(size.1));
            assert_eq!(found(center, depth), size);
        }
        // Of photographs, whose middle is another; twice the second is 764x572, which has the maps' shape.
        assert_eq!(found((381.87, 285.56), (192, 144)), (768, 576));
        assert_eq!(found((382.1, 286.0), (192, 144)), (768, 576));
        assert_eq!(found((823.205, 619.071), (400, 300)), (1600, 1200));
        // Of no multiple.
        assert_eq!(found((240.3, 180.2), (192, 144)), (481, 360));
    }
}
