//! `mvs-eval score`: truth + reconstruction → `score.json`, `scores.csv`, curves, error clouds.

mod document;
mod input;
mod outputs;
mod plan;
mod row;

pub use document::{
    Alignment, AlignmentSource, AtTolerance, Counts, Distances, Protocol, SCHEMA, ScoreDocument,
};

use super::{Context, OutDir};
use crate::error::Result;
use crate::provenance::Run;
use crate::score::plain::{self, Preparation};
use crate::score::tnt::{self, Profile, Start};
use crate::score::{Evaluation, points};
use crate::warning::Warnings;
use glam::DMat4;
use mvs_datasets::layout::files;
use mvs_datasets::layout::tnt::TntFolder;
use mvs_metrics::Tolerance;
use plan::{Plan, Truth};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// How near camera centres must come in the official toolbox, in metres.
const OFFICIAL_CAMERA_DISTANCE: f64 = 0.2;

/// Options of `mvs-eval score`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ScoreJob {
    /// The procedure.
    pub protocol: Protocol,
    /// The scene folder of the Tanks and Temples protocol.
    pub scene: Option<PathBuf>,
    /// The truth of the plain protocol.
    pub truth: Option<PathBuf>,
    /// The reconstruction: a PLY cloud.
    pub reconstruction: PathBuf,
    /// A 4×4 text file, reconstruction frame to truth frame; replaces the alignment.
    pub transform: Option<PathBuf>,
    /// The reconstruction's cameras as a `.log`; Tanks and Temples aligns by them.
    pub trajectory: Option<PathBuf>,
    /// Whether a given transform is only a start for the ICP stages.
    pub refine: bool,
    /// The folder to write.
    pub out: PathBuf,
    /// The variant of the Tanks and Temples protocol.
    pub profile: Profile,
    /// Tolerances in world units. Known Tanks and Temples scenes bring their own.
    pub tau: Vec<f64>,
    /// The scene's name; by default that of the scene folder or of the truth's file.
    pub name: Option<String>,
    /// The method's name; by default that of the reconstruction's file.
    pub method: Option<String>,
    /// The plain protocol's crop volume, an Open3D polygon volume.
    pub crop: Option<PathBuf>,
    /// The plain protocol's voxel edge in world units.
    pub voxel: Option<f64>,
    /// Seed of everything drawn.
    pub seed: u64,
    /// How near a camera must come to its reference to agree, in world units of the truth.
    pub camera_distance: f64,
}

impl Default for ScoreJob {
    fn default() -> Self {
        Self {
            protocol: Protocol::Plain,
            scene: None,
            truth: None,
            reconstruction: PathBuf::new(),
            transform: None,
            trajectory: None,
            refine: false,
            out: PathBuf::new(),
            profile: Profile::Strict,
            tau: Vec::new(),
            name: None,
            method: None,
            crop: None,
            voxel: None,
            seed: 0,
            camera_distance: OFFICIAL_CAMERA_DISTANCE,
        }
    }
}

/// Scores one reconstruction.
pub fn run(job: &ScoreJob, context: &Context<'_>) -> Result<ScoreDocument> {
    let plan = Plan::new(job)?;
    let inputs: Vec<&Path> = plan.inputs.iter().map(PathBuf::as_path).collect();
    let run = Run::new("score", job, &inputs)?;
    let out = OutDir::create(&job.out, run, context.force)?;
    let work = Work {
        job,
        plan: &plan,
        context,
        warnings: Warnings::default(),
    };
    let scored = match &plan.truth {
        Truth::File(truth) => work.score_plain(truth)?,
        Truth::Folder(folder) => work.score_tnt(folder)?,
    };
    context.progress.check()?;
    context.progress.begin("writing", 1);
    let document = work.document(&scored);
    work.write(&out, &scored, &document)?;
    out.finish()?;
    for warning in &document.warnings {
        context.warnings.add(&warning.code, warning.message.clone());
    }
    Ok(document)
}

/// A job under way.
struct Work<'a> {
    job: &'a ScoreJob,
    plan: &'a Plan,
    context: &'a Context<'a>,
    warnings: Warnings,
}

/// A finished comparison, not yet written.
struct Scored {
    evaluation: Evaluation,
    alignment: Alignment,
    voxel: Option<f64>,
}

impl Work<'_> {
    fn score_plain(&self, truth: &Path) -> Result<Scored> {
        let (job, progress) = (self.job, self.context.progress);
        progress.begin("reading", 1);
        let crop = job.crop.as_deref().map(files::read_crop).transpose()?;
        let preparation = Preparation {
            crop: crop.as_ref().map(points::prism).transpose()?,
            voxel: job.voxel,
        };
        let transform = job.transform.as_deref().map(files::read_similarity);
        let transform = transform.transpose()?.map(|transform| transform.matrix());
        let truth = input::read_points(truth, "truth", &self.warnings)?;
        let reconstruction =
            input::read_points(&job.reconstruction, "reconstruction", &self.warnings)?;
        progress.check()?;
        progress.begin("scoring", 1);
        let evaluation = plain::evaluate(&reconstruction, transform, &truth, &preparation)?;
        let source = match transform {
            Some(_) => AlignmentSource::Transform,
            None => AlignmentSource::None,
        };
        Ok(Scored {
            evaluation,
            alignment: Alignment::new(source, transform.unwrap_or(DMat4::IDENTITY)),
            voxel: job.voxel,
        })
    }

    fn score_tnt(&self, folder: &TntFolder) -> Result<Scored> {
        let progress = self.context.progress;
        progress.begin("reading", 1);
        let inputs = self.read_tnt(folder)?;
        let options = tnt::Options {
            profile: self.job.profile,
            camera_distance: self.job.camera_distance,
            seed: self.job.seed,
        };
        progress.check()?;
        progress.begin("aligning", 1);
        let motion = tnt::align(&inputs, &options)?;
        progress.check()?;
        progress.begin("scoring", 1);
        let evaluation = tnt::evaluate(&inputs, motion.truth_from_reconstruction)?;
        let source = match inputs.start {
            Start::Trajectories(_) => AlignmentSource::Trajectory,
            Start::Given(_) | Start::Refined(_) => AlignmentSource::Transform,
        };
        Ok(Scored {
            evaluation,
            alignment: Alignment::new(source, motion.truth_from_reconstruction),
            voxel: Some(inputs.tolerance.get() / 2.0),
        })
    }

    fn read_tnt(&self, folder: &TntFolder) -> Result<tnt::Inputs> {
        let reconstruction = &self.job.reconstruction;
        Ok(tnt::Inputs {
            start: input::read_start(self.job, folder)?,
            crop: points::prism(&folder.read_crop()?)?,
            truth: input::read_points(&folder.truth, "truth", &self.warnings)?,
            reconstruction: input::read_points(reconstruction, "reconstruction", &self.warnings)?,
            tolerance: self.plan.tolerances[0],
        })
    }

    fn document(&self, scored: &Scored) -> ScoreDocument {
        let job = self.job;
        let at = |&tolerance: &Tolerance| AtTolerance::of(&scored.evaluation, tolerance);
        let by_tolerance: Vec<AtTolerance> = self.plan.tolerances.iter().map(at).collect();
        let first = by_tolerance[0];
        let method = || plan::stem_of(&job.reconstruction);
        ScoreDocument {
            schema: SCHEMA.to_owned(),
            protocol: job.protocol,
            profile: (job.protocol == Protocol::Tnt).then_some(job.profile),
            scene: self.plan.scene.clone(),
            method: job.method.clone().unwrap_or_else(method),
            tolerance: first.tolerance,
            precision: first.precision,
            recall: first.recall,
            f_score: first.f_score,
            counts: first.counts,
            by_tolerance,
            distances: Distances::of(&scored.evaluation),
            alignment: scored.alignment.clone(),
            passed: true,
            voxel: scored.voxel,
            seed: job.seed,
            warnings: self.warnings.sorted(),
        }
    }

    fn write(&self, out: &OutDir, scored: &Scored, document: &ScoreDocument) -> Result<()> {
        let first = self.plan.tolerances[0];
        outputs::write_curves(out, &self.plan.scene, &scored.evaluation, first)?;
        row::write(out, document)?;
        out.write_json("score.json", document)
    }
}
