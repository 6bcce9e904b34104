//! What `score.json` says: the wire type of a score.

use super::alignment::Alignment;
use crate::parallel;
use crate::score::bootstrap::Interval;
use crate::score::gates::Gate;
use crate::score::sample::MeshAs;
use crate::score::tnt::Profile;
use crate::score::{Evaluation, Side, SideCounts};
use crate::warning::Warning;
use mvs_metrics::Tolerance;
use serde::{Deserialize, Serialize};

/// The format's name and version, first key of the file.
pub const SCHEMA: &str = "mvs-eval score 1";

/// Which procedure turns clouds into scores.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Protocol {
    /// Two clouds in one frame, judged as they are or after a crop and a voxel grid.
    #[default]
    Plain,
    /// Tanks and Temples.
    Tnt,
}

impl std::fmt::Display for Protocol {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Plain => "plain",
            Self::Tnt => "tnt",
        })
    }
}

/// A score with all that is known about how it came to be: the content of `score.json`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ScoreDocument {
    /// [`SCHEMA`].
    pub schema: String,
    /// The procedure.
    pub protocol: Protocol,
    /// Its variant; none for the plain protocol.
    pub profile: Option<Profile>,
    /// The scene's name.
    pub scene: String,
    /// The name of the method that made the reconstruction.
    pub method: String,
    /// The tolerance in world units; the first where several were asked for.
    pub tolerance: f64,
    /// Fraction of the reconstruction within the tolerance of the truth.
    pub precision: f64,
    /// Fraction of the truth within the tolerance of the reconstruction.
    pub recall: f64,
    /// 2PR / (P + R); 0 where both are 0.
    pub f_score: f64,
    /// How many points got how far, at the first tolerance.
    pub counts: Counts,
    /// The scores at every tolerance asked for, the first one included.
    pub by_tolerance: Vec<AtTolerance>,
    /// Mean and median distances in world units.
    pub distances: Distances,
    /// How the reconstruction came into the frame of the truth.
    pub alignment: Alignment,
    /// Whether every gate was passed.
    pub passed: bool,
    /// The gates, passed and failed; none in the plain protocol, which only warns.
    pub gates: Vec<Gate>,
    /// What the protocol's other profile gives from the same inputs.
    pub other_profile: Option<OtherProfile>,
    /// Confidence interval of F at the first tolerance, where asked for.
    pub confidence: Option<Interval>,
    /// F-scores of the same procedure over seeds, where asked for.
    pub spread: Option<Spread>,
    /// How a mesh was turned into points; none where both sides were clouds.
    pub mesh_sampling: Option<MeshAs>,
    /// Edge of the voxels over which both clouds were averaged, in world units.
    pub voxel: Option<f64>,
    /// Seed of everything drawn.
    pub seed: u64,
    /// SHA-256 of the input files.
    #[serde(default)]
    pub inputs: InputHashes,
    /// What the user should know.
    pub warnings: Vec<Warning>,
}

/// SHA-256 of the input files in hexadecimal, as `sha256sum` prints it; none where there was no such
/// file.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct InputHashes {
    /// The reconstruction.
    pub reconstruction: Option<String>,
    /// The truth.
    pub truth: Option<String>,
    /// The crop volume.
    pub crop: Option<String>,
    /// The reconstruction's trajectory.
    pub log: Option<String>,
    /// The transform: the one given, or the scene's own where cameras align.
    pub transform: Option<String>,
}

/// The score by the profile that was not asked for.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct OtherProfile {
    /// That profile.
    pub profile: Profile,
    /// Its precision.
    pub precision: f64,
    /// Its recall.
    pub recall: f64,
    /// Its F-score.
    pub f_score: f64,
}

/// How much the F-score depends on the seed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Spread {
    /// F by seed, from the job's seed on.
    pub f_scores: Vec<f64>,
    /// The smallest.
    pub min: f64,
    /// The mean.
    pub mean: f64,
    /// The largest.
    pub max: f64,
}

/// Counts of both sides.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Counts {
    /// Points of the reconstruction.
    pub reconstruction: SideCounts,
    /// Points of the truth.
    pub truth: SideCounts,
}

/// A score at one tolerance.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct AtTolerance {
    /// In world units.
    pub tolerance: f64,
    /// Fraction of the reconstruction within the tolerance.
    pub precision: f64,
    /// Fraction of the truth within the tolerance.
    pub recall: f64,
    /// 2PR / (P + R).
    pub f_score: f64,
    /// How many points got how far.
    pub counts: Counts,
    /// Confidence interval of F, where asked for.
    #[serde(default)]
    pub confidence: Option<Interval>,
}

/// Summaries of the nearest distances, in world units; none where a side is empty.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Distances {
    /// Mean over the reconstruction of the distance to the truth.
    pub reconstruction_mean: Option<f64>,
    /// Median of the same.
    pub reconstruction_median: Option<f64>,
    /// Mean over the truth of the distance to the reconstruction.
    pub truth_mean: Option<f64>,
    /// Median of the same.
    pub truth_median: Option<f64>,
}

impl AtTolerance {
    /// What an evaluation says at a tolerance.
    pub fn of(evaluation: &Evaluation, tolerance: Tolerance) -> Self {
        let score = evaluation.score(tolerance);
        let (reconstruction, truth) = evaluation.counts(tolerance);
        Self {
            tolerance: tolerance.get(),
            precision: score.precision(),
            recall: score.recall(),
            f_score: score.f_score(),
            counts: Counts {
                reconstruction,
                truth,
            },
            confidence: None,
        }
    }
}

impl Distances {
    /// The summaries of an evaluation.
    pub fn of(evaluation: &Evaluation) -> Self {
        let of = |side: &Side| (side.mean_distance(), side.median_distance());
        let (reconstruction, truth) =
            parallel::both(|| of(&evaluation.reconstruction), || of(&evaluation.truth));
        Self {
            reconstruction_mean: reconstruction.0,
            reconstruction_median: reconstruction.1,
            truth_mean: truth.0,
            truth_median: truth.1,
        }
    }
}
