//! Reading what is scored.

use super::ScoreJob;
use crate::error::{Error, Result};
use crate::jobs::meshes::check_surface;
use crate::score::cameras::Trajectories;
use crate::score::gates::{self, Gate};
use crate::score::points::FinitePoints;
use crate::score::sample::{self, MeshAs};
use crate::score::tnt::Start;
use crate::warning::Warnings;
use glam::DVec3;
use mvs_datasets::format::ply;
use mvs_datasets::layout::tnt::{TntFolder, model_images, read_model_trajectory, read_trajectory};
use mvs_datasets::layout::{files, mesh};
use mvs_datasets::scene::Mesh;
use std::path::{Path, PathBuf};

/// The alignment's scale is known to this factor when a mesh is sampled: ICP may still change it.
const SCALE_MARGIN: f64 = 0.9;

/// One vertex in so many may be a corner of no face without a word.
const LOOSE_OF: usize = 20;

/// The side that may be empty.
const RECONSTRUCTION: &str = "reconstruction";

/// A cloud or a mesh.
enum Surface {
    /// Points.
    Cloud(FinitePoints),
    /// Triangles, and the file they are from.
    Mesh(Box<Mesh>, PathBuf),
}

impl Surface {
    /// The points that stand for the surface at a tolerance of `tau` units of its own frame; for a
    /// mesh read as bare points also a gate on whether that does it justice.
    fn into_points(
        self,
        (how, tau, seed): (MeshAs, f64, u64),
        warnings: &Warnings,
    ) -> Result<(FinitePoints, Option<Gate>)> {
        let (mesh, path) = match self {
            Self::Cloud(points) => return Ok((points, None)),
            Self::Mesh(mesh, path) => (mesh, path),
        };
        if how != MeshAs::Vertices {
            warn_of_loose(&mesh, &path, warnings);
        }
        if how == MeshAs::Area {
            check_surface(&mesh, std::slice::from_ref(&path))?;
        }
        let spacing = SCALE_MARGIN * tau / 2.0;
        let points = sample::points_of(&mesh, how, spacing, seed).map_err(|error| match error {
            Error::Invalid { problem, .. } => Error::invalid(path.display().to_string(), problem),
            error => error,
        })?;
        let gate = (how != MeshAs::Area)
            .then(|| gates::of_mesh(sample::coarse_fraction(&mesh, tau), &how.to_string()));
        Ok((FinitePoints::new(points), gate))
    }
}

/// Warns of a mesh whose vertices many faces leave out, as they do in a cloud that is triangulated in part.
fn warn_of_loose(mesh: &Mesh, path: &Path, warnings: &Warnings) {
    let mut in_face = vec![false; mesh.vertices().len()];
    for &vertex in mesh.triangles().as_flattened() {
        in_face[vertex as usize] = true;
    }
    let loose = in_face.iter().filter(|in_face| !**in_face).count();
    if loose * LOOSE_OF > in_face.len() {
        let message = format!(
            "{}: {loose} of {} vertices are corners of no face and count for nothing, as a mesh's faces are judged; \
             --mesh-as vertices judges all of them",
            path.display(),
            in_face.len()
        );
        warnings.add("loose-vertices", message);
    }
}

/// Reads a PLY cloud or a mesh: a PLY with faces, OBJ, GLB or glTF.
fn read(path: &Path, side: &str, warnings: &Warnings) -> Result<Surface> {
    if !is_mesh(path)? {
        let positions = files::read_with(path, ply::read_positions)?;
        return Ok(Surface::Cloud(finite(positions, path, side, warnings)?));
    }
    let loaded = mesh::read_meshes(&[PathBuf::from(path)])?;
    for note in loaded.notes {
        warnings.add("mesh", note);
    }
    Ok(Surface::Mesh(Box::new(loaded.mesh), path.to_path_buf()))
}

/// How the points that stand for a mesh are drawn.
#[derive(Debug, Clone, Copy)]
pub(in crate::jobs) struct Draw {
    /// Which points.
    pub(in crate::jobs) how: MeshAs,
    /// The tolerance that they are dense enough for, in world units of the truth.
    pub(in crate::jobs) tau: f64,
    /// The seed.
    pub(in crate::jobs) seed: u64,
}

/// Points; of a mesh also how they were chosen, and a gate on that.
pub(in crate::jobs) type ReadPoints = (FinitePoints, Option<MeshAs>, Option<Gate>);

/// The reconstruction's points. `scale` is asked for the truth's length of a unit of a mesh.
pub(in crate::jobs) fn read_reconstruction(
    path: &Path,
    draw: Draw,
    scale: impl FnOnce() -> Result<f64>,
    warnings: &Warnings,
) -> Result<ReadPoints> {
    match read(path, RECONSTRUCTION, warnings)? {
        Surface::Cloud(points) => Ok((points, None, None)),
        mesh @ Surface::Mesh(..) => {
            let (points, gate) =
                mesh.into_points((draw.how, draw.tau / scale()?, draw.seed), warnings)?;
            Ok((points, Some(draw.how), gate))
        }
    }
}

/// The truth's points; a warning says so where it is a mesh.
pub(in crate::jobs) fn read_truth(
    path: &Path,
    draw: Draw,
    warnings: &Warnings,
) -> Result<ReadPoints> {
    let surface = read(path, "truth", warnings)?;
    let how = matches!(surface, Surface::Mesh(..)).then_some(draw.how);
    if let Some(how) = how {
        let file = path.display();
        let message = format!("{file}: the truth is a mesh, turned into points by {how}");
        warnings.add("truth-is-mesh", message);
    }
    let (points, gate) = surface.into_points((draw.how, draw.tau, draw.seed), warnings)?;
    let gate = gate.map(|gate| Gate {
        message: format!("truth: {}", gate.message),
        ..gate
    });
    Ok((points, how, gate))
}

/// Whether a file holds triangles.
pub(super) fn is_mesh(path: &Path) -> Result<bool> {
    let extension = path.extension().unwrap_or_default();
    if mesh::is_mesh(path) && !extension.eq_ignore_ascii_case("ply") {
        return Ok(true);
    }
    Ok(files::read_with(path, ply::read_summary)?.faces > 0)
}

/// The finite points of a cloud; a warning says how many others there were. A reconstruction that has
/// no points at all scores 0, with a warning; all else without finite points is an error.
pub(super) fn finite(
    positions: Vec<DVec3>,
    path: &Path,
    side: &str,
    warnings: &Warnings,
) -> Result<FinitePoints> {
    let points = FinitePoints::new(positions);
    if points.input() == 0 && side == RECONSTRUCTION {
        let message = format!("{}: the reconstruction has no points", path.display());
        warnings.add("empty-reconstruction", message);
        return Ok(points);
    }
    if points.is_empty() {
        let problem = match points.input() {
            0 => format!("expected points of the {side}, found none"),
            input => format!("expected finite points, found {input}, all at NaN or infinity"),
        };
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

/// The file that holds the reconstruction's cameras: a log, or the images of a COLMAP model.
pub(super) fn trajectory_file(job: &ScoreJob) -> Result<Option<PathBuf>> {
    let Some(path) = job.trajectory.as_deref().filter(|path| path.is_dir()) else {
        return Ok(job.trajectory.clone());
    };
    let images = model_images(path).ok_or_else(|| {
        let problem =
            "expected a .log, or a COLMAP model in this folder or its sparse/0, found none";
        Error::invalid(path.display().to_string(), problem)
    })?;
    Ok(Some(images))
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
    let path = trajectory_file(job)?.unwrap_or_default();
    let named = job.trajectory.as_ref() != Some(&path);
    let reference = folder.read_trajectory()?;
    let given = match named {
        true => read_model_trajectory(&path, reference.len())?,
        false => read_trajectory(&path)?,
    };
    Ok(Start::Trajectories(Trajectories {
        given,
        reference,
        named,
        mapping: folder.read_mapping()?,
        truth_from_reference: folder.read_transform()?.matrix(),
    }))
}
