//! Reading what is scored.

use super::ScoreJob;
use crate::error::{Error, Result};
use crate::score::FinitePoints;
use crate::score::cameras::Trajectories;
use crate::score::tnt::Start;
use crate::warning::Warnings;
use mvs_datasets::layout::files;
use mvs_datasets::layout::tnt::{TntFolder, read_trajectory};
use std::path::Path;

/// The finite points of a PLY; a warning says how many others there were.
pub(super) fn read_points(path: &Path, side: &str, warnings: &Warnings) -> Result<FinitePoints> {
    let points = FinitePoints::of_cloud(files::read_cloud(path)?);
    if points.positions().is_empty() {
        let problem = format!(
            "expected finite points, found {}, all at NaN or infinity",
            points.input()
        );
        return Err(Error::invalid(path.display().to_string(), problem));
    }
    if points.non_finite() > 0 {
        let message = format!(
            "{}: {} of {} points of the {side} are at NaN or infinity; they are dropped",
            path.display(),
            points.non_finite(),
            points.input()
        );
        warnings.add("non-finite-points", message);
    }
    Ok(points)
}

pub(super) fn read_start(job: &ScoreJob, folder: &TntFolder) -> Result<Start> {
    if let Some(path) = &job.transform {
        let transform = files::read_similarity(path)?.matrix();
        return Ok(if job.refine {
            Start::Refined(transform)
        } else {
            Start::Given(transform)
        });
    }
    let path = job.trajectory.as_deref().unwrap_or(Path::new(""));
    Ok(Start::Trajectories(Trajectories {
        given: read_trajectory(path)?,
        reference: folder.read_trajectory()?,
        mapping: folder.read_mapping()?,
        truth_from_reference: folder.read_transform()?.matrix(),
    }))
}
