//! `mvs-eval score`: truth + reconstruction → `score.json`, `scores.csv`, curves, error clouds.

mod alignment;
mod document;
mod input;
mod outputs;
mod plan;
mod row;
mod work;

pub use alignment::{Alignment, AlignmentSource, Residual, StageReport, TrajectoryReport};
pub use document::{
    AtTolerance, Counts, Distances, InputHashes, OtherProfile, Protocol, SCHEMA, ScoreDocument,
    Spread,
};

pub(super) use input::{Draw, read_reconstruction, read_truth};
pub(super) use plan::check_values;

use super::{Context, OutDir};
use crate::error::Result;
use crate::parallel;
use crate::report::record::Record;
use crate::score::sample::MeshAs;
use crate::score::tnt::Profile;
use plan::Plan;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use work::Work;

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
    /// A folder of scene folders that are all scored; takes the place of one scene.
    pub all: Option<PathBuf>,
    /// A folder of method folders to be scored with `all`; by default they lie in the scene folders.
    pub methods: Option<PathBuf>,
    /// The truth of the plain protocol.
    pub truth: Option<PathBuf>,
    /// The reconstruction: a PLY cloud, or a PLY, OBJ, GLB or glTF mesh.
    pub reconstruction: PathBuf,
    /// Which points stand for a mesh.
    pub mesh_as: MeshAs,
    /// A 4×4 text file, reconstruction frame to truth frame; replaces the alignment.
    pub transform: Option<PathBuf>,
    /// The reconstruction's cameras as a `.log`, or a folder with a COLMAP model whose images are named
    /// by their numbers; Tanks and Temples aligns by them.
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
    /// Resamples of the confidence interval of F; none without.
    pub bootstrap: u32,
    /// Seeds over which the F-score's spread is measured; none below 2.
    pub seeds: u32,
    /// Whether the other profile's score is left out.
    pub one_profile: bool,
    /// How near a camera must come to its reference to agree, in world units of the truth.
    pub camera_distance: f64,
}

impl Default for ScoreJob {
    fn default() -> Self {
        Self {
            protocol: Protocol::Plain,
            scene: None,
            all: None,
            methods: None,
            truth: None,
            reconstruction: PathBuf::new(),
            mesh_as: MeshAs::Area,
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
            bootstrap: 0,
            seeds: 0,
            one_profile: false,
            camera_distance: OFFICIAL_CAMERA_DISTANCE,
        }
    }
}

/// Scores one reconstruction.
///
/// # Errors
/// Options that are missing, out of range or do not go together, files that cannot be read or hold only points that
/// are not finite, cameras that give no alignment, no truth to judge against, an output folder as [`OutDir::create`]
/// refuses it, whatever writing brings, and interruption.
pub fn run(job: &ScoreJob, context: &Context<'_>) -> Result<ScoreDocument> {
    let plan = Plan::new(job)?;
    let inputs: Vec<&Path> = plan.inputs.iter().map(PathBuf::as_path).collect();
    context.warn_of_unfinished(&inputs, &job.out);
    let run = context.run("score", job, &OutDir::inputs(&job.out, &inputs)?)?;
    let out = OutDir::create(&job.out, run, context.force)?;
    let work = Work::new(job, &plan, context);
    // Hashes take a second for each two gigabytes, whatever the number of threads.
    let (scored, hashes) = parallel::both(|| work.score(), || plan.hashes(job));
    let scored = scored?;
    context.progress.check()?;
    context.progress.begin("writing", 1);
    let document = work.document(&scored, hashes?)?;
    outputs::write_all(&out, &scored.evaluation, &document)?;
    out.finish()?;
    for warning in &document.warnings {
        context.warnings.add(&warning.code, warning.message.clone());
    }
    Ok(document)
}

/// The unit of a scene's distances.
pub(super) fn unit_of(protocol: Protocol, scene: &str) -> &'static str {
    row::unit_of(protocol, scene)
}

/// The part of a protocol's benchmark that a scene is of; empty where it is not known.
pub(super) fn split_of(protocol: Protocol, scene: &str) -> &'static str {
    row::split_of(protocol, scene)
}

/// The rows of `scores.csv`, one per tolerance.
pub fn records(document: &ScoreDocument) -> Vec<Record> {
    row::records(document)
}
