//! `mvs-eval pairs`: source views from a sparse model or a mesh, as a `pair.txt`.

use super::cameras::{self, CameraOptions};
use super::meshes::{MeshOptions, read_mesh};
use super::out::{
    check_no_input, check_run_file, check_still_free, replaced, write_out_file, write_run_file,
};
use super::{Context, check_out_file, run_file_beside};
use crate::error::{Error, Result};
use crate::generate::{Covisibility, PairOptions, count_behind, sparse_sources, too_far_apart};
use crate::provenance::{Inputs, Run};
use crate::render::{BackFaces, Renderer};
use mvs_datasets::format::pair::{self, PairEntry};
use mvs_datasets::layout::cameras::CamerasOptions;
use mvs_datasets::layout::mvsnet::PixelCentre;
use mvs_datasets::layout::sparse::{self, SparseModel};
use mvs_datasets::scene::{Distortion, SourceScore, View};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// Options of `mvs-eval pairs`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PairsJob {
    /// A COLMAP model with points; with a mesh, cameras of any kind.
    pub cameras: PathBuf,
    /// Mesh files: what they hide is not seen. Without, the model's points say who sees what.
    pub mesh: Vec<PathBuf>,
    /// The `pair.txt` to write.
    pub out: PathBuf,
    /// What the camera files leave open.
    pub camera: CameraOptions,
    /// Where the cams put the centre of the top-left pixel.
    pub pixel_center: PixelCentre,
    /// How the mesh is read.
    pub meshes: MeshOptions,
    /// How source views are chosen.
    pub pairs: PairOptions,
}

/// What was chosen.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PairsOutcome {
    /// The views with their sources, by id.
    pub views: Vec<ViewSources>,
    /// Ids of the views whose scores with all others round to 0; they are not in the file.
    pub alone: Vec<u32>,
}

/// One view's sources.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ViewSources {
    /// The view's id in the file.
    pub id: u32,
    /// Its image's name, where known.
    pub name: String,
    /// (id, score), best first.
    pub sources: Vec<(u32, f64)>,
}

/// Chooses source views and writes them.
///
/// # Errors
/// Paths not given, a file that is there without `force` or would replace what is read or another command's, cameras,
/// points or meshes that cannot be read, options out of range, views of which no two are each other's sources,
/// whatever writing brings, and interruption.
pub fn run(job: &PairsJob, context: &Context<'_>) -> Result<PairsOutcome> {
    super::require(
        "pairs",
        &[
            ("--cameras", &[&job.cameras], "a COLMAP model, or cameras"),
            ("--out", &[&job.out], "a pair.txt to write"),
        ],
    )?;
    let run_file = run_file_beside(&job.out);
    context.warn_of_unfinished(&[&job.cameras], &job.out);
    if !context.force {
        check_run_file(&run_file, "pairs")?;
    }
    check_out_file(&job.out, context.force)?;
    check_out_file(&run_file, context.force)?;
    let (views, sources, run) = match job.mesh.is_empty() {
        true => sparse(job, context)?,
        false => exact(job, context)?,
    };
    let outcome = outcome(&views, sources);
    if let Some(first) = outcome.alone.first() {
        let message = format!(
            "{} views are left out, the first is view {first}: they share no point with another one, or \
             only under angles so far from the best that all scores round to 0",
            outcome.alone.len()
        );
        context.warnings.add("view-left-out", message);
    }
    let entry = |view: &ViewSources| PairEntry {
        id: view.id,
        sources: view
            .sources
            .iter()
            .map(|&(id, score)| SourceScore { id, score })
            .collect(),
    };
    let entries: Vec<PairEntry> = outcome.views.iter().map(entry).collect();
    check_still_free(&[&job.out, &run_file], context.force)?;
    write_out_file(&job.out, context.force, |out| pair::write(out, &entries))?;
    write_run_file(run, &run_file, std::slice::from_ref(&job.out))?;
    Ok(outcome)
}

/// Views, the sources of each, and the run that chose them.
type Chosen = (Vec<View>, Vec<Vec<SourceScore>>, Run);

/// The run on the cameras and these mesh files. None of them may be replaced; a `pair.txt` among the cameras
/// may, whoever wrote it: sources are chosen anew.
fn run_of(job: &PairsJob, meshes: &[PathBuf], context: &Context<'_>) -> Result<Run> {
    let run_file = run_file_beside(&job.out);
    let own = [job.out.clone(), run_file.clone()];
    let mut inputs: Vec<&Path> = vec![&job.cameras];
    inputs.extend(meshes.iter().map(PathBuf::as_path));
    let listed = Inputs::list(&inputs, replaced(&own, &run_file, "pairs"))?;
    let read = listed.files().into_iter();
    let read = read.filter(|file| !file.ends_with("pair.txt"));
    check_no_input(&[&job.out, &run_file], read)?;
    check_run_file(&run_file, "pairs")?;
    context.run("pairs", job, &Inputs::list(&inputs, &own)?)
}

/// Views with their sources by the points that they saw.
fn sparse(job: &PairsJob, context: &Context<'_>) -> Result<Chosen> {
    let model = read_model(job, context)?;
    let run = run_of(job, &[], context)?;
    let sources = sparse_sources(&model.views, (&model.points, &model.seen), &job.pairs)?;
    if sources.iter().all(Vec::is_empty) {
        return Err(no_pair(job, model.views.len(), false, ("points", "")));
    }
    Ok((model.views, sources, run))
}

fn read_model(job: &PairsJob, context: &Context<'_>) -> Result<SparseModel> {
    let options = CamerasOptions {
        pixel_centre: job.pixel_center,
        ..CamerasOptions::default()
    };
    let model = sparse::read_sparse(&job.cameras, &options)?;
    if job.camera != CameraOptions::default() || job.meshes != MeshOptions::default() {
        let message = "without a mesh the model's own cameras and points count: --camera-size, --focal, --center \
                       and --texture-memory do not";
        context.warnings.add("unused-option", message.to_owned());
    }
    let has_lens = |view: &&View| view.camera.distortion() != Distortion::None;
    let lenses = model.views.iter().filter(has_lens).count();
    if lenses > 0 {
        let message = format!(
            "{lenses} views have a lens; source views do not depend on it, but whoever reads them \
             with cams must undistort the images"
        );
        context.warnings.add("lens", message);
    }
    Ok(model)
}

/// Views with their sources by what the mesh lets them see.
fn exact(job: &PairsJob, context: &Context<'_>) -> Result<Chosen> {
    let options = (job.pixel_center, &job.camera);
    let scene = cameras::read(&job.cameras, options, None, context)?;
    let loaded = read_mesh(&job.mesh, &job.meshes, context)?;
    let run = run_of(job, &loaded.files, context)?;
    let renderer = Renderer::new(&loaded.mesh)?;
    let surface = (&renderer, &loaded.mesh);
    let views = scene.views().to_vec();
    let shared = {
        let look = (&job.pairs, BackFaces::default());
        Covisibility::measure(surface, &views, look, context.progress)?
    };
    let sources = shared.sources(&views, job.pairs.sources);
    if sources.iter().all(Vec::is_empty) {
        let behind = count_behind(surface, &views, (&job.pairs, BackFaces::default()));
        let backs = format!(
            "; {behind} of them see only the backs of triangles: turn the faces of the mesh if they are \
             wound the other way"
        );
        let why = match behind {
            0 => "; are mesh and cameras in the same frame, and poses world-to-camera?",
            _ => &backs,
        };
        return Err(no_pair(
            job,
            views.len(),
            shared.any_share(),
            ("surface", why),
        ));
    }
    Ok((views, sources, run))
}

/// No two of `count` views are each other's sources, though some `share` what they see, or because none sees
/// the same.
fn no_pair(job: &PairsJob, count: usize, share: bool, (what, why): (&str, &str)) -> Error {
    let problem = match share {
        true => too_far_apart(count),
        false => format!(
            "expected at least two views that see the same {what}, found none among {count}{why}"
        ),
    };
    Error::invalid(job.cameras.display().to_string(), problem)
}

fn outcome(views: &[View], sources: Vec<Vec<SourceScore>>) -> PairsOutcome {
    let mut outcome = PairsOutcome {
        views: Vec::new(),
        alone: Vec::new(),
    };
    for (view, sources) in views.iter().zip(sources) {
        if sources.is_empty() {
            outcome.alone.push(view.id);
            continue;
        }
        outcome.views.push(ViewSources {
            id: view.id,
            name: view.name.clone(),
            sources: sources
                .iter()
                .map(|source| (source.id, source.score))
                .collect(),
        });
    }
    outcome
}
