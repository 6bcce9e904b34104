//! What is odd about a truth and its estimates, and passes.

use super::DepthJob;
use crate::error::Result;
use crate::provenance::sorted_entries;
use crate::warning::Warning;
use mvs_datasets::format::cam;
use mvs_datasets::layout::blended::BlendedFolder;
use mvs_datasets::layout::{files, mvsnet};
use mvs_datasets::scene::{DepthRange, View};
use std::collections::BTreeSet;

/// Intervals that differ by no more than this share are one: some count planes, some the steps between them.
const SAME: f64 = 0.02;

/// A warning where cams state another interval than the part of their range in which `job` counts errors.
pub(super) fn intervals(job: &DepthJob, folder: &BlendedFolder, views: &[View]) -> Option<Warning> {
    let others: Vec<(u32, f64, f64)> = views
        .iter()
        .filter_map(|view| {
            let stated = interval_of(folder, view.id)?;
            let used = width(view.depth_range?) / f64::from(job.planes);
            let differs = (stated - used).abs() > SAME * stated.abs();
            (stated > 0.0 && differs).then_some((view.id, stated, used))
        })
        .collect();
    let &(id, stated, used) = others.first()?;
    let planes = (used * f64::from(job.planes) / stated).round();
    let message = format!(
        "the cams of {} of {} views state another depth interval than the {}th part of their range, in which errors \
         are counted: view {id}'s states {stated} and is given {used}; --planes {planes} counts in its own",
        others.len(),
        views.len(),
        job.planes
    );
    Some(Warning::new("depth-interval", message))
}

fn interval_of(folder: &BlendedFolder, id: u32) -> Option<f64> {
    let text = files::read_text(&folder.cam(id)).ok()?;
    cam::read(&text).ok()?.tail.get(1).copied()
}

fn width(range: DepthRange) -> f64 {
    range.max() - range.min()
}

/// A warning where depth maps among the estimates are of no view of the truth.
pub(super) fn strays(job: &DepthJob, views: &[View]) -> Result<Option<Warning>> {
    let wanted: BTreeSet<String> = views
        .iter()
        .map(|view| mvsnet::file_name(view.id, ".pfm"))
        .collect();
    let names = sorted_entries(&job.estimates)?.into_iter();
    let names = names.filter_map(|path| Some(path.file_name()?.to_str()?.to_owned()));
    let is_stray = |name: &String| mvsnet::is_depth_name(name) && !wanted.contains(name);
    let strays: Vec<String> = names.filter(is_stray).collect();
    Ok(strays.first().map(|first| {
        let message = format!(
            "{}: {} depth maps are of views without a cam in the truth and are left out, the first is {first}",
            job.estimates.display(),
            strays.len()
        );
        Warning::new("no-cam", message)
    }))
}
