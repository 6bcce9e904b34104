//! Gates: signs that a score says more about its inputs than about the method.
//!
//! Each gate has a name, a number, bounds and, where it fails, a cause in words. A failed gate does
//! not stop the work: the result is written and marked.

use super::cameras::{CameraFit, MatchedBy};
use super::evaluation::Evaluation;
use super::plain::span;
use super::refine::Stage;
use super::tnt::Profile;
use crate::error::Result;
use crate::warning::Warning;
use glam::DVec3;
use mvs_datasets::scene::Aabb;
use mvs_metrics::align::{IcpOptions, Scale, icp};
use mvs_metrics::{Tolerance, Usual};
use serde::{Deserialize, Serialize};

/// Cameras registered in both trajectories over those of the reference, at least.
pub const MIN_REGISTERED: f64 = 0.5;
/// Cameras near their own reference over those registered, at least.
pub const MIN_INLIERS: f64 = 0.6;
/// The trajectory's scale over what distances between cameras suggest.
pub const SCALE_BOUNDS: (f64, f64) = (0.8, 1.25);
/// The scale of all ICP stages together.
pub const ICP_SCALE_BOUNDS: (f64, f64) = (0.9, 1.1);
/// The last stage's pairs over its points of the reconstruction, at least.
pub const MIN_FITNESS: f64 = 0.2;
/// Points inside the crop volume over all points of the reconstruction, at least.
pub const MIN_CROP_KEPT: f64 = 0.01;
/// F at τ over F at 5 τ, at least, where the latter is high and the cloud drifts.
pub const MIN_F_RATIO: f64 = 0.5;
/// An F-score worth explaining.
const HIGH_F: f64 = 0.5;
/// How far one more ICP update may move the cloud, in τ, before noise is no explanation.
const MAX_DRIFT: f64 = 0.25;
/// Surface in triangles wider than τ over all surface, at most, for a mesh read as points.
pub const MAX_COARSE: f64 = 0.1;
/// Points from which the drift is estimated.
const DRIFT_SAMPLE: usize = 50_000;
/// From this ratio of sizes on, clouds are taken to be in different units.
const OTHER_UNIT: f64 = 30.0;
/// A ratio of sizes within this factor of a unit's is explained by it.
const LIKE_UNIT: f64 = 3.0;
/// Units that reconstructions are found in, per unit of the truth.
const UNITS: [(f64, &str); 4] = [
    (1e3, "millimetres"),
    (1e2, "centimetres"),
    (39.37, "inches"),
    (1e-3, "kilometres"),
];

/// One check of a scoring.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Gate {
    /// Its stable name, e.g. `few-inliers`.
    pub code: String,
    /// Whether the value lies within the bounds.
    pub passed: bool,
    /// The number judged; none where it could not be computed, which fails.
    pub value: Option<f64>,
    /// The smallest value that passes.
    pub min: Option<f64>,
    /// The largest value that passes.
    pub max: Option<f64>,
    /// The numbers in words and, where the gate failed, its likely cause.
    pub message: String,
}

impl Gate {
    fn new(
        code: &str,
        value: f64,
        (min, max): (Option<f64>, Option<f64>),
        message: String,
    ) -> Self {
        let above = min.is_none_or(|min| value >= min);
        let below = max.is_none_or(|max| value <= max);
        Self {
            code: code.to_owned(),
            passed: value.is_finite() && above && below,
            value: Some(value).filter(|value| value.is_finite()),
            min,
            max,
            message,
        }
    }

    /// Adds `cause` to the message if the gate failed.
    fn because(mut self, cause: impl Into<String>) -> Self {
        if !self.passed {
            self.message = format!("{}: {}", self.message, cause.into());
        }
        self
    }
}

fn percent(value: f64) -> String {
    format!("{:.1} %", 100.0 * value)
}

/// What the trajectories say about themselves.
pub fn of_cameras(cameras: &CameraFit, camera_distance: f64) -> Vec<Gate> {
    let matches = &cameras.matches;
    let (registered, reference) = (matches.registered(), matches.reference);
    let share = registered as f64 / reference.max(1) as f64;
    let inliers = cameras.inliers as f64 / registered.max(1) as f64;
    let bound = percent(MIN_INLIERS);
    vec![
        Gate::new(
            "poses-missing",
            share,
            (Some(MIN_REGISTERED), None),
            format!("{registered} of the scene's {reference} cameras have a pose in the log"),
        )
        .because("most images were not registered, or the log is another scene's"),
        pose_count(cameras),
        Gate::new(
            "poses-shifted",
            cameras.shift.unwrap_or(0) as f64,
            (Some(0.0), Some(0.0)),
            match cameras.shift {
                None => "no shift of the log fits much better than none".to_owned(),
                Some(shift) => format!(
                    "the log seems shifted by {shift}: its pose i fits camera i {} {} of the scene",
                    if shift < 0 { '−' } else { '+' },
                    shift.abs()
                ),
            },
        ),
        Gate::new(
            "few-inliers",
            inliers,
            (Some(MIN_INLIERS), None),
            format!(
                "{} of {registered} registered cameras come within {camera_distance} of their own \
                 reference (bound {bound}, median residual {:.4})",
                cameras.inliers, cameras.median_residual
            ),
        )
        .because("the log is another scene's, its order is another one, or its poses are wrong"),
        Gate::new(
            "implausible-scale",
            cameras.scale_ratio,
            (Some(SCALE_BOUNDS.0), Some(SCALE_BOUNDS.1)),
            if cameras.scale_ratio.is_nan() {
                "the distances between cameras suggest no scale".to_owned()
            } else {
                format!(
                    "the alignment's scale is {:.4} times what the distances between cameras suggest",
                    cameras.scale_ratio
                )
            },
        )
        .because(if cameras.scale_ratio.is_nan() {
            "the log's poses, or those registered, lie in one point"
        } else {
            "the alignment collapsed, as it does with many unregistered or wrong poses"
        }),
    ]
}

fn pose_count(cameras: &CameraFit) -> Gate {
    let matches = &cameras.matches;
    let (expected, what) = match (matches.by, matches.video_frames) {
        (MatchedBy::Mapping, Some(frames)) => (frames, "frames of the scene's video"),
        (MatchedBy::Order, _) => (matches.reference, "cameras of the scene"),
        // Its own numbers say which cameras the poses are.
        _ => (matches.log, "numbered cameras of the scene"),
    };
    let off = matches.log as f64 - expected as f64;
    let said = format!(
        "the log has {} poses for the {expected} {what}",
        matches.log
    );
    Gate::new("pose-count", off, (Some(0.0), Some(0.0)), said).because(
        "which ones are missing or extra is not known, so later poses may belong to other cameras; \
         write unregistered images as identity poses with -1 as second number",
    )
}

/// What the ICP stages say.
pub fn of_stages(stages: &[Stage]) -> Vec<Gate> {
    let Some(last) = stages.last() else {
        return Vec::new();
    };
    let scale: f64 = stages.iter().map(|stage| stage.scale).product();
    vec![
        Gate::new(
            "icp-scale",
            scale,
            (Some(ICP_SCALE_BOUNDS.0), Some(ICP_SCALE_BOUNDS.1)),
            format!("the ICP stages change the scale by a factor of {scale:.4}"),
        )
        .because("the start is far off or ICP slid away"),
        Gate::new(
            "low-icp-fitness",
            last.fitness,
            (Some(MIN_FITNESS), None),
            format!(
                "{} of the reconstruction lies within {} of the truth after ICP (bound {})",
                percent(last.fitness),
                last.max_distance,
                percent(MIN_FITNESS)
            ),
        )
        .because("the log, the transform or the reconstruction is another scene's, or ICP failed"),
    ]
}

/// What to say of a `strict` last stage that ran out of updates; `official` never means to converge.
pub fn unconverged(stages: &[Stage], profile: Profile) -> Option<String> {
    let last = stages.last()?;
    let ran_out = profile == Profile::Strict && !last.converged && last.iterations > 0;
    ran_out.then(|| {
        format!(
            "ICP still moved the cloud after {} updates (fitness {}, RMSE {:.3e}): the score depends a \
             little on where it stopped",
            last.iterations,
            percent(last.fitness),
            last.inlier_rmse
        )
    })
}

/// Whether the crop volume keeps enough of the reconstruction. `bounds` are the boxes around the
/// moved reconstruction and the truth. Cameras (`by_cameras`) bring their own scale: units are no
/// explanation then.
pub fn of_crop(
    evaluation: &Evaluation,
    (reconstruction, truth): (&Aabb, &Aabb),
    by_cameras: bool,
) -> Gate {
    let side = &evaluation.reconstruction;
    let kept = side.cropped as f64 / side.input.max(1) as f64;
    let limits = (Some(MIN_CROP_KEPT), None);
    if side.input == 0 {
        let said = "the reconstruction has no points".to_owned();
        return Gate::new("crop-keeps-little", kept, limits, said);
    }
    let said = format!(
        "{} of {} points of the reconstruction are inside the crop volume",
        side.cropped, side.input
    );
    let unit = unit_guess(reconstruction, truth).filter(|_| !by_cameras);
    let why = unit.map_or_else(
        || "the transform or the log seems to be another scene's".to_owned(),
        |unit| format!("units look like {unit}"),
    );
    let cause = format!("{}; {why}", spans(reconstruction, truth));
    Gate::new("crop-keeps-little", kept, limits, said).because(cause)
}

fn spans(reconstruction: &Aabb, truth: &Aabb) -> String {
    let (reconstruction, truth) = (span(reconstruction), span(truth));
    format!("the reconstruction spans {reconstruction}, the truth {truth}")
}

/// Why no point is right, where both sides have points and the score at τ is 0.
pub fn of_nothing_right(
    evaluation: &Evaluation,
    tolerance: Tolerance,
    (reconstruction, truth): (&Aabb, &Aabb),
) -> Option<Warning> {
    let sides = [&evaluation.reconstruction, &evaluation.truth];
    let found = evaluation.score(tolerance).f_score() > 0.0;
    if found || sides.iter().any(|side| side.input == 0) {
        return None;
    }
    let why = unit_guess(reconstruction, truth).map_or_else(
        || "do they share a frame?".to_owned(),
        |unit| format!("units look like {unit}"),
    );
    let (tau, spans) = (tolerance.get(), spans(reconstruction, truth));
    let message = format!("F is 0 at τ = {tau}: {spans}; {why}");
    Some(Warning::new("nothing-right", message))
}

/// The unit that explains how much larger or smaller the reconstruction is than the truth.
pub(crate) fn unit_guess(reconstruction: &Aabb, truth: &Aabb) -> Option<&'static str> {
    let ratio = reconstruction.size().length() / truth.size().length();
    if !ratio.is_finite() || (1.0 / OTHER_UNIT..=OTHER_UNIT).contains(&ratio) {
        return None;
    }
    let far = |unit: f64| libm::log(ratio / unit).abs();
    let best = UNITS.iter().min_by(|a, b| far(a.0).total_cmp(&far(b.0)));
    let near = best.filter(|(unit, _)| far(*unit) < libm::log(LIKE_UNIT));
    near.map(|&(_, name)| name)
}

/// Whether F is low at τ but high at 5 τ because the cloud as a whole is out of place. Noise alone
/// passes: another ICP update would hardly move such a cloud.
///
/// # Errors
/// Never: where no update can be computed, the cloud counts as in its place.
pub fn of_tolerances(evaluation: &Evaluation, tolerance: Tolerance) -> Result<Gate> {
    let wide = tolerance.times(5.0);
    let (at_tau, at_wide) = (
        evaluation.score(tolerance).f_score(),
        evaluation.score(wide).f_score(),
    );
    let ratio = if at_wide > 0.0 { at_tau / at_wide } else { 1.0 };
    let said = format!("F is {at_tau:.3} at τ and {at_wide:.3} at 5 τ");
    let suspicious = at_wide >= HIGH_F && ratio < MIN_F_RATIO;
    let drift = if suspicious {
        drift(evaluation, tolerance) / tolerance.get()
    } else {
        0.0
    };
    let said = if suspicious {
        format!("{said}; one more ICP update would move the cloud by {drift:.2} τ")
    } else {
        said
    };
    let min = Some(MIN_F_RATIO).filter(|_| drift > MAX_DRIFT);
    let cause = "the reconstruction is out of place or of another scale, not just noisy";
    Ok(Gate::new("low-at-tau", ratio, (min, None), said).because(cause))
}

/// How far, root mean square in world units, another ICP update within 5 τ would move the cloud, without what lies
/// far from the rest of the truth: by a rigid motion where its points fix no scale; 0 where they fix nothing.
fn drift(evaluation: &Evaluation, tolerance: Tolerance) -> f64 {
    let reach = 5.0 * tolerance.get();
    let side = &evaluation.reconstruction;
    let near = side.points.iter().zip(&side.distances);
    // A single pair far out would have as much weight in the fit as all others together, and would move farthest.
    // What has its nearest point in reach of the rest of the truth is no such pair.
    let usual = Usual::of(evaluation.truth.points.iter()).grown(reach);
    let near: Vec<DVec3> = near
        .filter(|&(point, &distance)| distance < reach && usual.holds(point))
        .map(|(point, _)| point)
        .collect();
    let step = near.len().div_ceil(DRIFT_SAMPLE).max(1);
    let sample: Vec<DVec3> = near.into_iter().step_by(step).collect();
    if sample.is_empty() {
        return 0.0;
    }
    let options = IcpOptions {
        max_iterations: 1,
        ..IcpOptions::new(reach)
    };
    let truth = evaluation.truth.points.to_vec();
    let by = |scale| icp(&sample, &truth, &IcpOptions { scale, ..options });
    let Ok(found) = by(options.scale).or_else(|_| by(Scale::One)) else {
        return 0.0;
    };
    let update = found.target_from_source;
    let squares = sample
        .iter()
        .map(|&point| update.transform_point3(point).distance_squared(point));
    (squares.sum::<f64>() / sample.len() as f64).sqrt()
}

/// Whether a mesh that was read as points has triangles small enough for that. `coarse` is the
/// fraction of its surface in triangles wider than τ.
pub fn of_mesh(coarse: f64, mesh_as: &str) -> Gate {
    let said = format!(
        "the mesh was read as its {mesh_as}; {} of its surface lies in triangles wider than τ",
        percent(coarse)
    );
    Gate::new("mesh-too-coarse", coarse, (None, Some(MAX_COARSE)), said)
        .because("recall misses the inside of such triangles; sample the surface: --mesh-as area")
}

#[cfg(test)]
mod tests;
