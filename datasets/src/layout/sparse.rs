//! A COLMAP model with its points: which view saw which.

use super::cameras::CamerasOptions;
use super::files;
use super::model::{self, colmap_ending, model_place, read_images, read_model, read_points};
use crate::error::{Error, Result};
use crate::format::colmap;
use crate::scene::View;
use glam::DVec3;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Views, points and who saw what.
#[derive(Debug, Clone, PartialEq)]
pub struct SparseModel {
    /// The views by ascending id, numbered as by [`super::cameras::read_scene`].
    pub views: Vec<View>,
    /// World positions of the points.
    pub points: Vec<DVec3>,
    /// Per view the places in `points` of those it saw, ascending, each once.
    pub seen: Vec<Vec<usize>>,
}

/// Reads the COLMAP model at or under `path`, binary or text, whatever its ids.
///
/// # Errors
/// Files that cannot be read, and a model without points or whose images saw none of them.
pub fn read_sparse(path: &Path, options: &CamerasOptions) -> Result<SparseModel> {
    let place = place_of(path)?;
    let model = read_model(&place, options, read_points(&place)?)?;
    let places: BTreeMap<u64, usize> = model.points.iter().map(|point| point.id).zip(0..).collect();
    let seen = model.images.iter().map(|image| {
        let known = image.points.iter().filter_map(|id| places.get(id));
        let mut seen: Vec<usize> = known.copied().collect();
        seen.sort_unstable();
        seen.dedup();
        seen
    });
    let mut rows: Vec<(View, Vec<usize>)> = model.views()?.into_iter().zip(seen).collect();
    rows.sort_by_key(|(view, _)| view.id);
    if rows.iter().all(|(_, seen)| seen.is_empty()) {
        let problem = format!(
            "expected images that saw points of points3D, found {} points and none seen",
            model.points.len()
        );
        return Err(Error::layout(place, problem));
    }
    let (views, seen) = rows.into_iter().unzip();
    Ok(SparseModel {
        views,
        points: model.points.iter().map(|point| point.position).collect(),
        seen,
    })
}

/// The names of the images of the model at or under `path`, in the order by which COLMAP's dense files
/// count them: that of the frames' file where the model has one, within a frame by sensor, else that of
/// the images' file.
///
/// # Errors
/// Files that cannot be read, and frames that do not have each image of the model once.
pub fn registered_names(path: &Path) -> Result<Vec<String>> {
    let place = place_of(path)?;
    let images = read_images(&place)?;
    let ending = colmap_ending(&place).unwrap_or("txt");
    let frames_path = frames_file(&place);
    if !frames_path.is_file() {
        return Ok(images.into_iter().map(|image| image.name).collect());
    }
    let order = match ending {
        "bin" => files::read_with(&frames_path, colmap::read_frames_binary)?,
        _ => files::read_text_with(&frames_path, colmap::read_frames_text)?,
    };
    let count = images.len();
    let images = images.into_iter().map(|image| (image.id, image.name));
    let mut names: BTreeMap<u32, String> = images.collect();
    let ordered: Vec<String> = order.iter().filter_map(|id| names.remove(id)).collect();
    if ordered.len() != count || order.len() != count {
        let problem = format!(
            "expected each of the {count} images of images.{ending} once, found {} images, {} of them \
             once: it is of another model; write both anew with COLMAP, or leave it and the rigs' file out",
            order.len(),
            ordered.len()
        );
        return Err(Error::layout(frames_path, problem));
    }
    Ok(ordered)
}

/// The files of the model at or under `path` that are there: those of [`read_sparse`] and
/// [`registered_names`].
///
/// # Errors
/// No COLMAP model there.
pub fn model_files(path: &Path) -> Result<Vec<PathBuf>> {
    let place = place_of(path)?;
    let files = model::model_files(&place).into_iter();
    let files = files.chain([frames_file(&place)]);
    Ok(files.filter(|path| path.is_file()).collect())
}

/// The frames' file of the model in `folder`, which may be missing.
fn frames_file(folder: &Path) -> PathBuf {
    folder.join(format!("frames.{}", colmap_ending(folder).unwrap_or("txt")))
}

/// Where at or under `path` the model lies.
fn place_of(path: &Path) -> Result<PathBuf> {
    model_place(path).ok_or_else(|| {
        let problem = "expected a COLMAP model (cameras, images and points3D as .bin or .txt; \
             here, in sparse/0, sparse or colmap), found none";
        Error::layout(path, problem)
    })
}
