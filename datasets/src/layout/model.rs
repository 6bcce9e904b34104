//! A COLMAP model where it lies, as text or binary.

use super::cameras::CamerasOptions;
use super::files;
use super::mvsnet::PixelCentre;
use super::numbers::number_names;
use crate::error::{Error, FormatError, Result};
use crate::format::colmap::{self, ColmapCamera, ColmapImage, ColmapPoint};
use crate::scene::{Camera, DepthRange, View};
use glam::DVec3;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Where under a folder a COLMAP model may lie, first come first served.
const COLMAP_PLACES: [&str; 5] = ["", "sparse/0", "sparse", "colmap", "colmap/sparse/0"];

/// The place at or under `path` that holds a COLMAP model.
pub(super) fn model_place(path: &Path) -> Option<PathBuf> {
    let mut places = COLMAP_PLACES.iter().map(|place| path.join(place));
    places.find(|place| colmap_ending(place).is_some())
}

/// `bin` or `txt`, if the folder has a model of that kind.
pub(super) fn colmap_ending(folder: &Path) -> Option<&'static str> {
    let has = |name: &str, ending: &str| folder.join(format!("{name}.{ending}")).is_file();
    ["bin", "txt"]
        .into_iter()
        .find(|ending| has("cameras", ending) && has("images", ending))
}

/// The files of the COLMAP model in `folder`: cameras, images, and points, which may be missing.
pub(super) fn model_files(folder: &Path) -> [PathBuf; 3] {
    let ending = colmap_ending(folder).unwrap_or("txt");
    ["cameras", "images", "points3D"].map(|name| folder.join(format!("{name}.{ending}")))
}

/// A COLMAP model as it lies in its files, cameras in this crate's convention.
pub(super) struct Model {
    cameras: BTreeMap<u32, Camera>,
    pub(super) images: Vec<ColmapImage>,
    pub(super) points: Vec<ColmapPoint>,
    pub(super) images_path: PathBuf,
}

impl Model {
    /// The views in the images' order.
    pub(super) fn views(&self) -> Result<Vec<View>> {
        colmap_views(&self.cameras, &self.images, &self.points)
            .map_err(Error::in_file(&self.images_path))
    }
}

/// Says so where the model in `folder` is there as text too.
pub(super) fn text_beside(folder: &Path) -> Vec<String> {
    let has = |name: &str| folder.join(name).is_file();
    let both = colmap_ending(folder) == Some("bin") && has("cameras.txt") && has("images.txt");
    let note = format!(
        "took the .bin files; {} holds the model as .txt too",
        folder.display()
    );
    both.then_some(note).into_iter().collect()
}

/// Reads the points of the model in `folder`; none where there is no such file.
pub(super) fn read_points(folder: &Path) -> Result<Vec<ColmapPoint>> {
    let [_, _, path] = model_files(folder);
    match (path.is_file(), colmap_ending(folder) == Some("bin")) {
        (false, _) => Ok(Vec::new()),
        (true, true) => files::read_with(&path, colmap::read_points_binary),
        (true, false) => files::read_text_with(&path, colmap::read_points_text),
    }
}

/// Reads the model in `folder` beside its points.
///
/// # Errors
/// Files that cannot be read, and options that would shift cameras whose convention is known.
pub(super) fn read_model(
    folder: &Path,
    options: &CamerasOptions,
    points: Vec<ColmapPoint>,
) -> Result<Model> {
    if options.pixel_centre == PixelCentre::Integer {
        let problem = "expected pixel centres as COLMAP's models have them, found integer ones asked \
             for: COLMAP defines pixel centres at (0.5, 0.5), and all views would shift by half a \
             pixel; leave --pixel-center out";
        return Err(Error::layout(folder, problem));
    }
    let binary = colmap_ending(folder) == Some("bin");
    let [cameras_path, images_path, _] = model_files(folder);
    let images = read_images(folder)?;
    let cameras = match binary {
        true => files::read_with(&cameras_path, colmap::read_cameras_binary)?,
        false => files::read_text_with(&cameras_path, colmap::read_cameras_text)?,
    };
    Ok(Model {
        cameras: cameras_by_id(&cameras).map_err(Error::in_file(&cameras_path))?,
        images,
        points,
        images_path,
    })
}

/// The images of the model in `folder`, as they are listed.
pub(super) fn read_images(folder: &Path) -> Result<Vec<ColmapImage>> {
    let [_, path, _] = model_files(folder);
    match colmap_ending(folder) == Some("bin") {
        true => files::read_with(&path, colmap::read_images_binary),
        false => files::read_text_with(&path, colmap::read_images_text),
    }
}

fn cameras_by_id(cameras: &[ColmapCamera]) -> Result<BTreeMap<u32, Camera>, FormatError> {
    let mut by_id = BTreeMap::new();
    for camera in cameras {
        let place = || format!("camera {}", camera.id);
        let read = camera.to_camera().map_err(FormatError::at(place()))?;
        if by_id.insert(camera.id, read).is_some() {
            let problem = "expected distinct camera ids, found this one twice";
            return Err(FormatError::new(place(), problem));
        }
    }
    Ok(by_id)
}

fn colmap_views(
    cameras: &BTreeMap<u32, Camera>,
    images: &[ColmapImage],
    points: &[ColmapPoint],
) -> Result<Vec<View>, FormatError> {
    if images.is_empty() {
        return Err(FormatError::new(
            "images",
            "expected at least one image, found none",
        ));
    }
    let mut by_name: BTreeMap<&str, u32> = BTreeMap::new();
    for image in images {
        if let Some(other) = by_name.insert(&image.name, image.id) {
            let place = format!("images {other} and {}", image.id);
            let problem = format!("expected distinct names, found {} for both", image.name);
            return Err(FormatError::new(place, problem));
        }
    }
    let names: Vec<&str> = images.iter().map(|image| image.name.as_str()).collect();
    let ids = number_names(&names);
    let positions: BTreeMap<u64, DVec3> = points.iter().map(|p| (p.id, p.position)).collect();
    let views = images.iter().zip(ids).map(|(image, id)| {
        let place = format!("image {} ({})", image.id, image.name);
        let Some(&camera) = cameras.get(&image.camera) else {
            let problem = format!(
                "expected a camera of the model, found camera {}",
                image.camera
            );
            return Err(FormatError::new(place, problem));
        };
        let pose = image.to_pose().map_err(FormatError::at(place))?;
        let seen = image.points.iter().filter_map(|id| positions.get(id));
        let depth_range = range_of(seen.map(|&point| pose.to_cam(point).z));
        Ok(View {
            id,
            name: image.name.clone(),
            camera,
            pose,
            depth_range,
        })
    });
    views.collect()
}

/// The 1 % and 99 % places of the sorted depths, as BlendedMVS takes them from a view's own points.
fn range_of(depths: impl Iterator<Item = f64>) -> Option<DepthRange> {
    let mut depths: Vec<f64> = depths.filter(|&depth| depth > 0.0).collect();
    depths.sort_by(f64::total_cmp);
    let at = |part: f64| depths.get((part * depths.len() as f64) as usize).copied();
    DepthRange::new(at(0.01)?, at(0.99)?).ok()
}
