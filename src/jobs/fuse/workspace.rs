//! A COLMAP dense workspace as depth maps to fuse.

use super::FuseJob;
use super::coordinates::usual_depth;
use super::find::{camera_for, check_present};
use super::maps::{Encoding, Entry};
use crate::error::{Error, Result};
use crate::generate::{PairOptions, sparse_sources};
use crate::jobs::Context;
use mvs_datasets::format::colmap::dense;
use mvs_datasets::layout::cameras::CamerasOptions;
use mvs_datasets::layout::files;
use mvs_datasets::layout::sparse::{self, SparseModel};
use mvs_datasets::layout::workspace::Workspace;
use mvs_datasets::scene::{Distortion, View};
use std::collections::BTreeMap;
use std::path::PathBuf;

/// The views that `fusion.cfg` lists (all of the model where there is none) and that have a depth
/// map. Source views are chosen by the model's points.
pub(super) fn entries(
    job: &FuseJob,
    workspace: &Workspace,
    context: &Context<'_>,
) -> Result<Vec<Entry>> {
    let options = CamerasOptions {
        pixel_centre: job.pixel_center,
        ..CamerasOptions::default()
    };
    let model = sparse::read_sparse(workspace.path(), &options)?;
    let wanted = wanted(workspace, &model)?;
    let depth = |index: usize| workspace.depth(&model.views[index].name, job.stereo);
    let present: Vec<usize> = wanted
        .iter()
        .copied()
        .filter(|&i| depth(i).exists())
        .collect();
    let example = depth(wanted.first().copied().unwrap_or(0));
    check_present((present.len(), wanted.len()), &example, context)?;
    let all = PairOptions {
        sources: usize::MAX,
        ..PairOptions::default()
    };
    let sources = sparse_sources(&model.views, (&model.points, &model.seen), &all)?;
    let place: BTreeMap<u32, usize> = present
        .iter()
        .map(|&index| model.views[index].id)
        .zip(0..)
        .collect();
    let order = match job.vis {
        true => sparse::registered_names(workspace.path())?,
        false => Vec::new(),
    };
    let numbers: BTreeMap<&str, u32> = order.iter().map(String::as_str).zip(0..).collect();
    let entry = |&index: &usize| {
        let view = &model.views[index];
        let listed = sources[index].iter();
        let sources = listed.filter_map(|source| place.get(&source.id).copied());
        let number = match job.vis {
            true => number_of(view, &numbers)?,
            false => 0,
        };
        entry(job, workspace, view, (sources.collect(), number))
    };
    present.iter().map(entry).collect()
}

/// Where COLMAP counts a view.
fn number_of(view: &View, numbers: &BTreeMap<&str, u32>) -> Result<u32> {
    numbers.get(view.name.as_str()).copied().ok_or_else(|| {
        let problem = "expected it among the images that the model lists, found it no longer: the model \
                       has changed while it was read";
        Error::invalid(format!("image {}", view.name), problem)
    })
}

/// Places in the model of the views to fuse, ascending.
fn wanted(workspace: &Workspace, model: &SparseModel) -> Result<Vec<usize>> {
    let Some(names) = workspace.listed()? else {
        return Ok((0..model.views.len()).collect());
    };
    let places: BTreeMap<&str, usize> = model
        .views
        .iter()
        .map(|view| view.name.as_str())
        .zip(0..)
        .collect();
    let place = |name: &String| {
        places.get(name.as_str()).copied().ok_or_else(|| {
            let path = workspace.path().join("stereo/fusion.cfg");
            let problem = format!("expected names of the model's images, found `{name}`");
            Error::invalid(path.display().to_string(), problem)
        })
    };
    let mut wanted = names.iter().map(place).collect::<Result<Vec<usize>>>()?;
    wanted.sort_unstable();
    wanted.dedup();
    Ok(wanted)
}

fn entry(
    job: &FuseJob,
    workspace: &Workspace,
    view: &View,
    (sources, number): (Vec<usize>, u32),
) -> Result<Entry> {
    if view.camera.distortion() != Distortion::None {
        let problem = "expected cameras of undistorted images, found one with a lens: run COLMAP's \
                       image_undistorter";
        return Err(Error::invalid(format!("image {}", view.name), problem));
    }
    let depth = workspace.depth(&view.name, job.stereo);
    let (size, usual_depth) = files::read_with(&depth, |bytes| {
        let size = dense::read_size(bytes)?;
        Ok((
            size,
            usual_depth(size, |every| dense::gray_rows(bytes, every)),
        ))
    })?;
    let existing = |path: PathBuf| path.exists().then_some(path);
    let mask = job.masks.as_ref().map(|folder| {
        let path = folder.join(format!("{}.png", view.name));
        let missing = || {
            let problem = format!("expected a mask {}.png, found none", view.name);
            Error::invalid(folder.display().to_string(), problem)
        };
        existing(path).ok_or_else(missing)
    });
    Ok(Entry {
        sources,
        number,
        encoding: Encoding::Dense,
        usual_depth,
        normals: existing(workspace.normals(&view.name, job.stereo)),
        confidence: job.confidence_paths(view.id),
        mask: mask.transpose()?,
        image: existing(workspace.image(&view.name)),
        view: View {
            camera: camera_for(&view.camera, size, &depth)?,
            ..view.clone()
        },
        depth,
    })
}
