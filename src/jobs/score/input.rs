//! Reading what is scored.

use super::ScoreJob;
use crate::error::{Error, Result};
use crate::score::cameras::Trajectories;
use crate::score::gates::{self, Gate};
use crate::score::points::FinitePoints;
use crate::score::sample::{self, MeshAs};
use crate::score::tnt::Start;
use crate::warning::Warnings;
use mvs_datasets::format::ply;
use mvs_datasets::layout::tnt::{TntFolder, read_trajectory};
use mvs_datasets::layout::{files, mesh};
use mvs_datasets::scene::{Mesh, PointCloud};
use std::path::{Path, PathBuf};

/// The alignment's scale is known to this factor when a mesh is sampled: ICP may still change it.
const SCALE_MARGIN: f64 = 0.9;

/// A cloud or a mesh.
pub(super) enum Surface {
    /// Points.
    Cloud(FinitePoints),
    /// Triangles.
    Mesh(Box<Mesh>),
}

impl Surface {
    /// The points that stand for the surface at a tolerance of `tau` units of its own frame; for a
    /// mesh read as bare points also a gate on whether that does it justice.
    pub(super) fn into_points(
        self,
        how: MeshAs,
        tau: f64,
        seed: u64,
    ) -> Result<(FinitePoints, Option<Gate>)> {
        let mesh = match self {
            Self::Cloud(points) => return Ok((points, None)),
            Self::Mesh(mesh) => mesh,
        };
        let spacing = SCALE_MARGIN * tau / 2.0;
        let points = sample::points_of(&mesh, how, spacing, seed)?;
        let gate = (how != MeshAs::Area)
            .then(|| gates::of_mesh(sample::coarse_fraction(&mesh, tau), &how.to_string()));
        Ok((FinitePoints::new(points), gate))
    }
}

/// Reads a PLY cloud, or a PLY or OBJ mesh: a PLY with faces is a mesh.
pub(super) fn read(path: &Path, side: &str, warnings: &Warnings) -> Result<Surface> {
    if !is_mesh(path)? {
        let cloud = files::read_cloud(path)?;
        return Ok(Surface::Cloud(finite(cloud, path, side, warnings)?));
    }
    let loaded = mesh::read_meshes(&[PathBuf::from(path)])?;
    for note in loaded.notes {
        warnings.add("mesh", note);
    }
    Ok(Surface::Mesh(Box::new(loaded.mesh)))
}

fn is_mesh(path: &Path) -> Result<bool> {
    let extension = path.extension().unwrap_or_default();
    if extension.eq_ignore_ascii_case("obj") {
        return Ok(true);
    }
    Ok(files::read_with(path, ply::read_summary)?.faces > 0)
}

/// The finite points of a cloud; a warning says how many others there were.
pub(super) fn finite(
    cloud: PointCloud,
    path: &Path,
    side: &str,
    warnings: &Warnings,
) -> Result<FinitePoints> {
    let points = FinitePoints::of_cloud(cloud);
    if points.is_empty() {
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

/// Reads where the alignment starts.
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
