//! The Tanks and Temples protocol (Knapitsch et al., SIGGRAPH 2017; the official toolbox's
//! `python_toolbox/evaluation`).

use super::cameras::{self, CameraFit, Trajectories};
use super::evaluation::Evaluation;
use super::plain::{self, Preparation};
use super::points::FinitePoints;
use super::refine::{Stage, Truth, refine};
use crate::error::Result;
use glam::{DMat3, DMat4};
use mvs_metrics::Tolerance;
use mvs_metrics::crop::Prism;
use serde::{Deserialize, Serialize};
use std::borrow::Cow;

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

/// What is scored against what.
#[derive(Debug, Clone)]
pub struct Inputs {
    /// The reconstruction in its own frame.
    pub reconstruction: FinitePoints,
    /// The truth.
    pub truth: FinitePoints,
    /// The region in which points are judged, in the frame of the truth.
    pub crop: Prism,
    /// τ.
    pub tolerance: Tolerance,
    /// Where the alignment starts.
    pub start: Start,
}

/// Where the alignment starts.
#[derive(Debug, Clone)]
pub enum Start {
    /// At a known `truth_from_reconstruction`, which is final.
    Given(DMat4),
    /// At a known `truth_from_reconstruction`, which is refined.
    Refined(DMat4),
    /// At the alignment of the camera trajectories, which is refined.
    Trajectories(Trajectories),
}

/// What the alignment may be told.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Options {
    /// The variant of the protocol.
    pub profile: Profile,
    /// How near camera centres must come, in units of the truth.
    pub camera_distance: f64,
    /// Seed of the RANSAC draws.
    pub seed: u64,
}

/// How the reconstruction came into the frame of the truth.
#[derive(Debug, Clone, PartialEq)]
pub struct Motion {
    /// What the trajectories said, if they were asked.
    pub cameras: Option<CameraFit>,
    /// The ICP stages, if any were run.
    pub stages: Vec<Stage>,
    /// The final motion.
    pub truth_from_reconstruction: DMat4,
}

/// A reconstruction that has been aligned, and the truth that it is judged against.
pub struct Aligned<'a> {
    /// How the reconstruction came into the frame of the truth.
    pub motion: Motion,
    /// The reconstruction in its own frame.
    pub reconstruction: Cow<'a, FinitePoints>,
    truth: Truth<'a>,
    preparation: Preparation,
}

/// Finds the motion from the reconstruction's frame to that of the truth.
///
/// # Errors
/// As [`cameras::fit`], where it starts at trajectories, and as [`refine`], where it is refined.
pub fn align<'a>(inputs: &'a Inputs, options: &Options) -> Result<Aligned<'a>> {
    let clouds = [&inputs.reconstruction, &inputs.truth].map(Cow::Borrowed);
    align_clouds(
        clouds,
        &inputs.start,
        (&inputs.crop, inputs.tolerance),
        options,
    )
}

/// As [`align`] for inputs that nothing else asks for: each goes as soon as it can.
///
/// # Errors
/// As [`align`].
pub fn align_last(inputs: Inputs, options: &Options) -> Result<Aligned<'static>> {
    let clouds = [inputs.reconstruction, inputs.truth].map(Cow::Owned);
    align_clouds(
        clouds,
        &inputs.start,
        (&inputs.crop, inputs.tolerance),
        options,
    )
}

fn align_clouds<'a>(
    [reconstruction, truth]: [Cow<'a, FinitePoints>; 2],
    start: &Start,
    (crop, tolerance): (&Prism, Tolerance),
    options: &Options,
) -> Result<Aligned<'a>> {
    let (cameras, start, refined) = match start {
        Start::Given(start) => (None, *start, false),
        Start::Refined(start) => (None, *start, true),
        Start::Trajectories(trajectories) => {
            let fit = cameras::fit(
                trajectories,
                options.profile,
                options.camera_distance,
                options.seed,
            )?;
            let start = fit.fit.target_from_source;
            (Some(fit), start, true)
        }
    };
    let (stages, truth) = if refined {
        let profile = options.profile;
        refine(&reconstruction, truth, crop, tolerance, start, profile)?
    } else {
        (Vec::new(), Truth::Given(truth))
    };
    let last = stages.last().map(|stage| stage.truth_from_reconstruction);
    Ok(Aligned {
        motion: Motion {
            cameras,
            stages,
            truth_from_reconstruction: last.unwrap_or(start),
        },
        reconstruction,
        truth,
        preparation: preparation(crop, tolerance),
    })
}

impl Aligned<'_> {
    /// Judges the reconstruction where it lies: cropped in the frame of the truth, averaged over voxels
    /// of τ/2.
    ///
    /// # Errors
    /// As [`plain::evaluate`].
    pub fn evaluate(self) -> Result<Evaluation> {
        let truth = match self.truth {
            Truth::Given(truth) => self.preparation.apply_to_truth(&truth)?,
            // ICP never moves the truth and thins it alike.
            Truth::Thinned(side) => side,
        };
        let motion = Some(self.motion.truth_from_reconstruction);
        let reconstruction = self.preparation.apply(&self.reconstruction, motion)?;
        drop(self.reconstruction);
        Evaluation::measure(reconstruction, truth)
    }
}

/// The scale at which the alignment starts: the truth's length of a unit of the reconstruction.
///
/// # Errors
/// As [`cameras::fit`], where it starts at trajectories; else none.
pub fn start_scale(start: &Start, options: &Options) -> Result<f64> {
    let motion = match start {
        Start::Given(motion) | Start::Refined(motion) => *motion,
        Start::Trajectories(trajectories) => {
            let Options {
                profile,
                camera_distance,
                seed,
            } = *options;
            cameras::fit(trajectories, profile, camera_distance, seed)?
                .fit
                .target_from_source
        }
    };
    Ok(scale_of(motion))
}

/// The scale of a similarity.
pub fn scale_of(motion: DMat4) -> f64 {
    libm::cbrt(DMat3::from_mat4(motion).determinant())
}

/// Judges the reconstruction at `truth_from_reconstruction`: moved, cropped in the frame of the
/// truth, averaged over voxels of τ/2.
///
/// # Errors
/// As [`plain::evaluate`].
pub fn evaluate(inputs: &Inputs, truth_from_reconstruction: DMat4) -> Result<Evaluation> {
    plain::evaluate(
        &inputs.reconstruction,
        Some(truth_from_reconstruction),
        &inputs.truth,
        &preparation(&inputs.crop, inputs.tolerance),
    )
}
