//! A COLMAP model with its points: which view saw which.

use super::cameras::{CamerasOptions, model_place, read_model};
use crate::error::{Error, Result};
use crate::scene::View;
use glam::DVec3;
use std::collections::BTreeMap;
use std::path::Path;

/// Views, points and who saw what.
#[derive(Debug, Clone, PartialEq)]
pub struct SparseModel {
    /// The views by ascending id, numbered as by [`super::cameras::read_scene`].
    pub views: Vec<View>,
    /// World positions of the points.
    pub points: Vec<DVec3>,
    /// Per view the places in `points` of those it saw, ascending, each once.
    pub seen: Vec<Vec<usize>>,
    /// Per view its place among the model's images by their COLMAP ids.
    pub places: Vec<u32>,
}

/// Reads the COLMAP model at or under `path`, binary or text, whatever its ids.
///
/// # Errors
/// Files that cannot be read, and a model without points or whose images saw none of them.
pub fn read_sparse(path: &Path, options: &CamerasOptions) -> Result<SparseModel> {
    let Some(place) = model_place(path) else {
        let problem = "expected a COLMAP model (cameras, images and points3D as .bin or .txt; \
             here, in sparse/0, sparse or colmap), found none";
        return Err(Error::layout(path, problem));
    };
    let model = read_model(&place, options)?;
    let places: BTreeMap<u64, usize> = model.points.iter().map(|point| point.id).zip(0..).collect();
    let seen = model.images.iter().map(|image| {
        let known = image.points.iter().filter_map(|id| places.get(id));
        let mut seen: Vec<usize> = known.copied().collect();
        seen.sort_unstable();
        seen.dedup();
        seen
    });
    let mut ids: Vec<u32> = model.images.iter().map(|image| image.id).collect();
    ids.sort_unstable();
    let image_ids = model.images.iter().map(|image| image.id);
    let places_by_id = image_ids.map(|id| ids.partition_point(|&other| other < id));
    let mut rows: Vec<(View, (Vec<usize>, u32))> = model
        .views()?
        .into_iter()
        .zip(seen.zip(places_by_id.map(|place| u32::try_from(place).unwrap_or(u32::MAX))))
        .collect();
    rows.sort_by_key(|(view, _)| view.id);
    if rows.iter().all(|(_, (seen, _))| seen.is_empty()) {
        let problem = format!(
            "expected images that saw points of points3D, found {} points and none seen",
            model.points.len()
        );
        return Err(Error::layout(place, problem));
    }
    let (views, (seen, places)) = rows.into_iter().unzip();
    Ok(SparseModel {
        views,
        points: model.points.iter().map(|point| point.position).collect(),
        seen,
        places,
    })
}
