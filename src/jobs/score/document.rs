//! What `score.json` says: the wire type of a score.

use crate::score::tnt::Profile;
use crate::score::{Evaluation, SideCounts};
use crate::warning::Warning;
use glam::DMat4;
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
    /// Edge of the voxels over which both clouds were averaged, in world units.
    pub voxel: Option<f64>,
    /// Seed of everything drawn.
    pub seed: u64,
    /// What the user should know.
    pub warnings: Vec<Warning>,
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

/// How the reconstruction came into the frame of the truth.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Alignment {
    /// Where the start came from.
    pub source: AlignmentSource,
    /// The motion applied before counting, row by row.
    pub truth_from_reconstruction: [[f64; 4]; 4],
    /// Its scale.
    pub scale: f64,
}

/// Where the alignment's start came from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum AlignmentSource {
    /// Both clouds share a frame.
    None,
    /// A transform given by the user.
    Transform,
    /// The camera trajectories.
    Trajectory,
}

impl Alignment {
    /// An alignment by `truth_from_reconstruction`.
    pub fn new(source: AlignmentSource, truth_from_reconstruction: DMat4) -> Self {
        Self {
            source,
            truth_from_reconstruction: rows_of(truth_from_reconstruction),
            scale: scale_of(truth_from_reconstruction),
        }
    }
}

/// A matrix as rows.
pub(super) fn rows_of(matrix: DMat4) -> [[f64; 4]; 4] {
    matrix.transpose().to_cols_array_2d()
}

/// The scale of a similarity.
pub(super) fn scale_of(matrix: DMat4) -> f64 {
    glam::DMat3::from_mat4(matrix).determinant().cbrt()
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
        }
    }
}

impl Distances {
    /// The summaries of an evaluation.
    pub fn of(evaluation: &Evaluation) -> Self {
        Self {
            reconstruction_mean: evaluation.reconstruction.mean_distance(),
            reconstruction_median: evaluation.reconstruction.median_distance(),
            truth_mean: evaluation.truth.mean_distance(),
            truth_median: evaluation.truth.median_distance(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{DQuat, DVec3};

    #[test]
    fn a_matrix_is_written_row_by_row_with_its_scale() {
        let rotation = DQuat::from_rotation_z(0.3);
        let translation = DVec3::new(1.0, 2.0, 3.0);
        let matrix =
            DMat4::from_scale_rotation_translation(DVec3::splat(2.0), rotation, translation);
        let alignment = Alignment::new(AlignmentSource::Transform, matrix);
        let rows = alignment.truth_from_reconstruction;
        assert_eq!([rows[0][3], rows[1][3], rows[2][3]], [1.0, 2.0, 3.0]);
        assert_eq!(rows[3], [0.0, 0.0, 0.0, 1.0]);
        assert!((alignment.scale - 2.0).abs() < 1e-15);
        assert!(rows[1][0] > 0.0 && rows[0][1] < 0.0);
    }
}
