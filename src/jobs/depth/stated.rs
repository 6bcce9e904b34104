//! The depth interval that a `cam.txt` states, beside the one in which errors are counted.

use super::DepthJob;
use crate::warning::Warning;
use mvs_datasets::format::cam;
use mvs_datasets::layout::blended::BlendedFolder;
use mvs_datasets::layout::files;
use mvs_datasets::scene::{DepthRange, View};

/// Intervals that differ by no more than this share are one: some count planes, some the steps between them.
const SAME: f64 = 0.02;

/// A warning where cams state another interval than the part of their range in which `job` counts errors.
pub(super) fn warning(job: &DepthJob, folder: &BlendedFolder, views: &[View]) -> Option<Warning> {
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
