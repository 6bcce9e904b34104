//! How the reconstruction came into the frame of the truth, as `score.json` says it.

use crate::score::cameras::{CameraFit, MatchedBy};
use crate::score::refine::Stage;
use crate::score::tnt::{Motion, Profile, scale_of};
use glam::DMat4;
use serde::{Deserialize, Serialize};

/// How the reconstruction came into the frame of the truth.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Alignment {
    /// Where the start came from.
    pub source: AlignmentSource,
    /// The motion applied before counting, row by row.
    pub truth_from_reconstruction: [[f64; 4]; 4],
    /// Its scale.
    pub scale: f64,
    /// What the camera trajectories said, where they were asked.
    pub trajectory: Option<TrajectoryReport>,
    /// The ICP stages, if any were run.
    pub icp: Vec<StageReport>,
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

impl AlignmentSource {
    /// The name as written in records.
    pub fn name(self) -> &'static str {
        match self {
            Self::None => "none",
            Self::Transform => "transform",
            Self::Trajectory => "trajectory",
        }
    }
}

/// How the two trajectories lie on each other. Distances are in world units of the truth.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TrajectoryReport {
    /// What told which camera is which.
    pub matched_by: MatchedBy,
    /// Cameras of the scene.
    pub reference_poses: usize,
    /// Poses of the log, after the mapping of a video log.
    pub given_poses: usize,
    /// Cameras registered in both.
    pub registered: usize,
    /// Registered cameras near their own reference.
    pub inliers: usize,
    /// The fraction of cameras that agree by the profile's own rule.
    pub fitness: f64,
    /// Root mean square distance of these.
    pub rmse: f64,
    /// Median distance of the registered cameras from their own reference.
    pub median_residual: f64,
    /// The scale found over the one that distances between cameras suggest.
    pub scale_ratio: Option<f64>,
    /// By how many poses the log seems shifted.
    pub shift: Option<isize>,
    /// The start that ICP was given, row by row.
    pub truth_from_reconstruction: [[f64; 4]; 4],
    /// Per camera used: its index in the reference, and its distance from its own reference.
    pub residuals: Vec<Residual>,
}

/// One camera's distance from its own reference.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Residual {
    /// Its index in the reference trajectory, from 0.
    pub camera: usize,
    /// In world units of the truth.
    pub distance: f64,
}

/// What one ICP stage did. Distances are in world units of the truth.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct StageReport {
    /// Points of the reconstruction that took part.
    pub reconstruction_points: usize,
    /// Points of the truth that took part.
    pub truth_points: usize,
    /// The maximal correspondence distance.
    pub max_distance: f64,
    /// Pairs over points of the reconstruction.
    pub fitness: f64,
    /// Root mean square distance of the pairs.
    pub rmse: f64,
    /// Updates made.
    pub iterations: usize,
    /// Whether it ended because nothing changed any more.
    pub converged: bool,
    /// The scale of this stage's own motion.
    pub scale: f64,
    /// All motion so far, row by row.
    pub truth_from_reconstruction: [[f64; 4]; 4],
}

impl Alignment {
    /// An alignment without cameras and ICP.
    pub fn new(source: AlignmentSource, truth_from_reconstruction: DMat4) -> Self {
        Self {
            source,
            truth_from_reconstruction: rows_of(truth_from_reconstruction),
            scale: scale_of(truth_from_reconstruction),
            trajectory: None,
            icp: Vec::new(),
        }
    }

    /// What was found by `profile`.
    pub fn found(source: AlignmentSource, motion: &Motion, profile: Profile) -> Self {
        let cameras = motion.cameras.as_ref();
        Self {
            trajectory: cameras.map(|cameras| TrajectoryReport::of(cameras, profile)),
            icp: motion.stages.iter().map(StageReport::of).collect(),
            ..Self::new(source, motion.truth_from_reconstruction)
        }
    }
}

impl TrajectoryReport {
    fn of(cameras: &CameraFit, profile: Profile) -> Self {
        let used = cameras.matches.used_by(profile);
        let residual = |(m, &distance): (&crate::score::cameras::Match, &f64)| Residual {
            camera: m.reference_index,
            distance,
        };
        Self {
            matched_by: cameras.matches.by,
            reference_poses: cameras.matches.reference,
            given_poses: cameras.matches.given,
            registered: cameras.matches.registered(),
            inliers: cameras.inliers,
            fitness: cameras.fit.fitness,
            rmse: cameras.fit.rmse,
            median_residual: cameras.median_residual,
            scale_ratio: Some(cameras.scale_ratio).filter(|ratio| ratio.is_finite()),
            shift: cameras.shift,
            truth_from_reconstruction: rows_of(cameras.fit.target_from_source),
            residuals: used
                .iter()
                .zip(&cameras.fit.residuals)
                .map(residual)
                .collect(),
        }
    }
}

impl StageReport {
    fn of(stage: &Stage) -> Self {
        Self {
            reconstruction_points: stage.reconstruction_points,
            truth_points: stage.truth_points,
            max_distance: stage.max_distance,
            fitness: stage.fitness,
            rmse: stage.inlier_rmse,
            iterations: stage.iterations,
            converged: stage.converged,
            scale: stage.scale,
            truth_from_reconstruction: rows_of(stage.truth_from_reconstruction),
        }
    }
}

/// A matrix as rows.
fn rows_of(matrix: DMat4) -> [[f64; 4]; 4] {
    matrix.transpose().to_cols_array_2d()
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
