//! `mvs-eval demo`: everything, on a scene that the program makes itself.

mod inputs;
mod predict;
mod sheet;

pub use predict::{Prediction, predict};

use super::fuse::{self, FuseJob};
use super::generate::{self, GenerateJob};
use super::report::{self, ReportJob};
use super::score::{self, ScoreJob};
use super::{Context, OutDir};
use crate::config::Size;
use crate::error::{Error, Result};
use crate::fuse::FuseOptions;
use crate::generate::{Extra, GenerateOptions, Part};
use crate::provenance::{self, Run};
use inputs::Inputs;
use mvs_datasets::layout::blended::BlendedFolder;
use mvs_datasets::synthetic::{DepthNoise, SyntheticOptions, SyntheticScene};
use mvs_metrics::Tolerance;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// Of fewer, none looks from a direction near another's.
const LEAST_VIEWS: u32 = 5;

/// Options of `mvs-eval demo`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct DemoJob {
    /// The folder to write.
    pub out: PathBuf,
    /// Seed of everything drawn.
    pub seed: u64,
    /// Number of cameras.
    pub views: u32,
    /// Image size in pixels.
    pub size: Size,
    /// The distance in world units up to which a point is right; the scene is about 2 units wide.
    pub tau: f64,
}

impl Default for DemoJob {
    fn default() -> Self {
        let size = Size {
            width: 512,
            height: 384,
        };
        Self {
            out: PathBuf::from("demo-out"),
            seed: 1,
            views: 12,
            size,
            tau: 0.01,
        }
    }
}

/// What the demo made.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct DemoOutcome {
    /// The folder with everything.
    pub out: PathBuf,
    /// The data set's scene folder.
    pub dataset: PathBuf,
    /// Points of the fused cloud.
    pub points: usize,
    /// The tolerance in world units.
    pub tolerance: f64,
    /// Fraction of the cloud within the tolerance of the truth.
    pub precision: f64,
    /// Fraction of the truth within the tolerance of the cloud.
    pub recall: f64,
    /// Their harmonic mean.
    pub f_score: f64,
    /// What the noise model predicts for them.
    pub predicted: Prediction,
}

/// Makes the scene, generates, fuses, scores and reports.
///
/// # Errors
/// Fewer than 5 views, a `tau` that is no tolerance, more views or pixels than [`SyntheticScene::new`] takes, an
/// output folder as [`OutDir::create_again`] refuses it, whatever the steps bring, and interruption.
pub fn run(job: &DemoJob, context: &Context<'_>) -> Result<DemoOutcome> {
    if job.views < LEAST_VIEWS {
        let problem = format!(
            "expected at least {LEAST_VIEWS}, found {}: fewer look from directions too far apart to be sources of \
             each other",
            job.views
        );
        return Err(Error::invalid("--views", problem));
    }
    Tolerance::new(job.tau).map_err(|error| Error::invalid("--tau", error.to_string()))?;
    let out = OutDir::create_again(
        &job.out,
        Run::new("demo", job, &provenance::Inputs::default())?,
        context.force,
    )?;
    // Everything below writes into this folder, which is ours to replace.
    let context = &Context {
        force: true,
        ..*context
    };
    let scene = SyntheticScene::new(SyntheticOptions {
        seed: job.seed,
        views: job.views,
        width: job.size.width,
        height: job.size.height,
        ..SyntheticOptions::default()
    })?;
    let noise = DepthNoise::default();
    let truth = scene.sample_surface(0.5 * job.tau)?;
    let inputs = inputs::write(&out, &scene, (&noise, &truth), context.progress)?;
    let generated = generate::run(&generate_job(&out, &inputs), Part::All, context)?;
    let dataset = generated.sets.into_iter().next().map(|set| set.folder);
    let dataset = dataset.unwrap_or_default();
    let fuse_job = fuse_job(&out, &inputs, dataset.clone());
    let fused = fuse::run(&fuse_job, context)?;
    let scored = score::run(&score_job(&out, &inputs, job), context)?;
    sheet::write(&out, scene.scene(), &dataset, &inputs.depths)?;
    report::run(&report_job(&out), context)?;
    let sample: Vec<_> = truth.positions().iter().step_by(16).copied().collect();
    let needed = sources_needed(&fuse_job.fuse, &dataset)?;
    let predicted = predict(&scene, &noise, needed, (&sample, job.tau));
    out.finish()?;
    Ok(DemoOutcome {
        out: job.out.clone(),
        dataset,
        points: fused.points,
        tolerance: job.tau,
        precision: scored.precision,
        recall: scored.recall,
        f_score: scored.f_score,
        predicted,
    })
}

/// How many sources must agree in the middle one of the data set's views, by how many it has.
fn sources_needed(options: &FuseOptions, dataset: &Path) -> Result<usize> {
    let scene = BlendedFolder::new(dataset).read_scene(None)?;
    let sources = |view: usize| scene.sources_of(view).len().min(options.max_sources);
    let mut counts: Vec<usize> = (0..scene.views().len()).map(sources).collect();
    counts.sort_unstable();
    let middle = counts.get(counts.len() / 2).copied().unwrap_or_default();
    Ok(options.sources_needed(middle))
}

fn generate_job(out: &OutDir, inputs: &Inputs) -> GenerateJob {
    GenerateJob {
        mesh: vec![inputs.mesh.clone()],
        cameras: inputs.cameras.clone(),
        photos: inputs.photos.clone(),
        out: out.file("dataset"),
        name: Some("demo".to_owned()),
        options: GenerateOptions {
            extras: [
                Extra::InputImages,
                Extra::RenderedImages,
                Extra::Masks,
                Extra::Normals,
            ]
            .into(),
            ..GenerateOptions::default()
        },
        ..GenerateJob::default()
    }
}

fn fuse_job(out: &OutDir, inputs: &Inputs, scene: PathBuf) -> FuseJob {
    FuseJob {
        scene,
        depths: inputs.depths.clone(),
        confidence: vec![inputs.confidence.clone()],
        out: out.file("cloud.ply"),
        fuse: FuseOptions::default(),
        ..FuseJob::default()
    }
}

fn score_job(out: &OutDir, inputs: &Inputs, job: &DemoJob) -> ScoreJob {
    ScoreJob {
        truth: Some(inputs.truth.clone()),
        reconstruction: out.file("cloud.ply"),
        tau: vec![job.tau],
        out: out.file("score"),
        name: Some("demo".to_owned()),
        method: Some("noisy-depth".to_owned()),
        voxel: Some(0.5 * job.tau),
        ..ScoreJob::default()
    }
}

fn report_job(out: &OutDir) -> ReportJob {
    ReportJob {
        records: vec![out.file("score/scores.csv")],
        out: out.file("report"),
        title: Some("Demo".to_owned()),
        pictures: vec![out.file("contact_sheet.png")],
    }
}
