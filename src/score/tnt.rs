//! The Tanks and Temples protocol (Knapitsch et al., SIGGRAPH 2017; the official toolbox's
//! `python_toolbox/evaluation`).

use super::evaluation::Evaluation;
use super::plain::{self, Preparation};
use super::points::FinitePoints;
use crate::error::Result;
use glam::DMat4;
use mvs_metrics::Tolerance;
use mvs_metrics::crop::Prism;
use serde::{Deserialize, Serialize};

/// A named variant of the protocol's alignment. The counting is the same in both.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Profile {
    /// The toolbox as shipped, but seeded: RANSAC judged by nearest neighbours over all poses, and
    /// ICP that stops after its first update with little change of fitness, because the toolbox's
    /// iteration limit of 20 arrives as an RMSE tolerance of 20.
    Official,
    /// What the toolbox meant: RANSAC judged by correspondence and refined on its inliers,
    /// unregistered poses dropped, ICP run until it has converged.
    #[default]
    Strict,
}

impl std::fmt::Display for Profile {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Official => "official",
            Self::Strict => "strict",
        })
    }
}

/// Crop by the scene's volume, then voxels of τ/2.
pub fn preparation(crop: &Prism, tolerance: Tolerance) -> Preparation {
    Preparation {
        crop: Some(crop.clone()),
        voxel: Some(tolerance.get() / 2.0),
    }
}

/// Judges a reconstruction at a given `truth_from_reconstruction`: moved, cropped in the frame of
/// the truth, averaged over voxels of τ/2.
pub fn evaluate(
    reconstruction: &FinitePoints,
    truth_from_reconstruction: DMat4,
    truth: &FinitePoints,
    crop: &Prism,
    tolerance: Tolerance,
) -> Result<Evaluation> {
    let motion = Some(truth_from_reconstruction);
    plain::evaluate(reconstruction, motion, truth, &preparation(crop, tolerance))
}
