//! A score job under way: read, align, judge, check.

use super::ScoreJob;
use super::alignment::{Alignment, AlignmentSource};
use super::document::{
    AtTolerance, Distances, InputHashes, OtherProfile, Protocol, SCHEMA, ScoreDocument, Spread,
};
use super::input::{self, Draw, ReadPoints};
use super::plan::{self, Plan, Truth};
use crate::error::Result;
use crate::jobs::Context;
use crate::parallel;
use crate::score::gates::{self, Gate};
use crate::score::plain::{self, Preparation};
use crate::score::points::{self, FinitePoints};
use crate::score::sample::MeshAs;
use crate::score::tnt::{self, Motion, Profile, Start};
use crate::score::{Evaluation, bootstrap};
use crate::warning::{Warning, Warnings};
use glam::DMat4;
use mvs_datasets::layout::files;
use mvs_datasets::layout::tnt::TntFolder;
use mvs_datasets::scene::Aabb;
use mvs_metrics::Tolerance;
use std::path::Path;

/// Profiles whose F-scores differ by more than this are both reported.
const PROFILES_DIFFER: f64 = 0.002;

/// A job under way.
pub(super) struct Work<'a> {
    job: &'a ScoreJob,
    plan: &'a Plan,
    context: &'a Context<'a>,
    warnings: Warnings,
}

/// A finished comparison, not yet written.
pub(super) struct Scored {
    pub(super) evaluation: Evaluation,
    alignment: Alignment,
    gates: Vec<Gate>,
    other_profile: Option<OtherProfile>,
    spread: Option<Spread>,
    mesh_sampling: Option<MeshAs>,
    voxel: Option<f64>,
}

/// Where the clouds lie in the frame of the truth.
struct Boxes {
    moved: Aabb,
    truth: Aabb,
}

impl Boxes {
    fn around(reconstruction: &FinitePoints, motion: DMat4, truth: Aabb) -> Self {
        let moved = reconstruction.moved_bounds(motion);
        Self { moved, truth }
    }
}

impl<'a> Work<'a> {
    pub(super) fn new(job: &'a ScoreJob, plan: &'a Plan, context: &'a Context<'a>) -> Self {
        Self {
            job,
            plan,
            context,
            warnings: Warnings::default(),
        }
    }

    /// Reads everything and judges it.
    pub(super) fn score(&self) -> Result<Scored> {
        self.context.progress.begin("reading", 1);
        match &self.plan.truth {
            Truth::File(truth) => self.score_plain(truth),
            Truth::Folder(folder) => self.score_tnt(folder),
        }
    }

    fn score_plain(&self, truth: &Path) -> Result<Scored> {
        let job = self.job;
        let crop = job.crop.as_deref().map(files::read_crop).transpose()?;
        let preparation = Preparation {
            crop: crop.as_ref().map(points::prism).transpose()?,
            voxel: job.voxel,
        };
        let transform = job.transform.as_deref().map(files::read_similarity);
        let transform = transform.transpose()?.map(|transform| transform.matrix());
        let scale = || Ok(transform.map_or(1.0, tnt::scale_of));
        let (truth, reconstruction) = parallel::both(
            || input::read_truth(truth, self.draw(), &self.warnings),
            || self.read_reconstruction(scale),
        );
        let (truth, truth_sampling, truth_gate) = truth?;
        let (reconstruction, mesh_sampling, mesh_gate) = reconstruction?;
        let motion = transform.unwrap_or(DMat4::IDENTITY);
        let boxes = Boxes::around(&reconstruction, motion, truth.bounds());
        // Neighbours of clouds that lie far apart take long to find: the user hears now what it may be.
        match gates::unit_guess(&boxes.moved, &boxes.truth) {
            Some(unit) => self.next(&format!("scoring; units look like {unit}"))?,
            None => self.next("scoring")?,
        }
        let evaluation = plain::evaluate(&reconstruction, transform, &truth, &preparation)?;
        let mut checks: Vec<Gate> = mesh_gate.into_iter().chain(truth_gate).collect();
        checks.extend(self.gates_of_place(&evaluation, &boxes)?);
        // The user says that the clouds share a frame: what looks wrong is advice here.
        self.warn_of(&checks);
        let widest = self.plan.tolerances.iter().copied();
        let widest = widest.max_by(|a, b| a.get().total_cmp(&b.get()));
        let nothing = widest.and_then(|tolerance| {
            let boxes = (&boxes.moved, &boxes.truth);
            gates::of_nothing_right(&evaluation, tolerance, boxes)
        });
        if let Some(Warning { code, message }) = nothing {
            self.warnings.add(&code, message);
        }
        let source = match transform {
            Some(_) => AlignmentSource::Transform,
            None => AlignmentSource::None,
        };
        Ok(Scored {
            evaluation,
            alignment: Alignment::new(source, motion),
            gates: Vec::new(),
            other_profile: None,
            spread: None,
            mesh_sampling: mesh_sampling.or(truth_sampling),
            voxel: job.voxel,
        })
    }

    fn score_tnt(&self, folder: &TntFolder) -> Result<Scored> {
        let profile = self.job.profile;
        let (inputs, mesh_sampling, mesh_gate) = self.read_tnt(folder)?;
        self.next("aligning")?;
        let options = self.options(profile, self.job.seed);
        let source = match inputs.start {
            Start::Trajectories(_) => AlignmentSource::Trajectory,
            Start::Given(_) | Start::Refined(_) => AlignmentSource::Transform,
        };
        let aligned = !matches!(inputs.start, Start::Given(_));
        let other_wanted = aligned && !self.job.one_profile;
        let tolerance = inputs.tolerance;
        let truth = inputs.truth.bounds();
        // Clouds that nothing asks for later make room.
        let (aligned, inputs) = if other_wanted || self.job.seeds >= 2 {
            (tnt::align(&inputs, &options)?, Some(&inputs))
        } else {
            (tnt::align_last(inputs, &options)?, None)
        };
        let motion = aligned.motion.clone();
        let at = motion.truth_from_reconstruction;
        let boxes = Boxes::around(&aligned.reconstruction, at, truth);
        self.next("scoring")?;
        let evaluation = aligned.evaluate()?;
        self.next("checking")?;
        let mut gates: Vec<Gate> = mesh_gate.into_iter().collect();
        gates.extend(self.gates_of_motion(&motion));
        gates.extend(self.gates_of_place(&evaluation, &boxes)?);
        self.warn_of(&gates);
        if let Some(said) = gates::unconverged(&motion.stages, profile) {
            self.warnings.add("icp-not-converged", said);
        }
        let other_profile = match inputs.filter(|_| other_wanted) {
            Some(inputs) => self.other_profile(inputs, &evaluation)?,
            None => None,
        };
        let spread = match inputs {
            Some(inputs) => self.spread(inputs, &evaluation)?,
            None => None,
        };
        Ok(Scored {
            alignment: Alignment::found(source, &motion, profile),
            gates,
            other_profile,
            spread,
            mesh_sampling,
            voxel: Some(tolerance.get() / 2.0),
            evaluation,
        })
    }

    fn options(&self, profile: Profile, seed: u64) -> tnt::Options {
        tnt::Options {
            profile,
            camera_distance: self.job.camera_distance,
            seed,
        }
    }

    fn next(&self, stage: &str) -> Result<()> {
        self.context.progress.check()?;
        self.context.progress.begin(stage, 1);
        Ok(())
    }

    fn read_tnt(&self, folder: &TntFolder) -> Result<(tnt::Inputs, Option<MeshAs>, Option<Gate>)> {
        let start = input::read_start(self.job, folder)?;
        let crop = points::prism(&folder.read_crop()?)?;
        let options = self.options(self.job.profile, self.job.seed);
        let (truth, reconstruction) = parallel::both(
            || input::finite(folder.read_truth()?, &folder.truth, "truth", &self.warnings),
            || self.read_reconstruction(|| tnt::start_scale(&start, &options)),
        );
        let truth = truth?;
        let (reconstruction, mesh_sampling, gate) = reconstruction?;
        if input::is_mesh(&folder.truth)? {
            let file = folder.truth.display();
            let message =
                format!("{file}: the truth has faces; its vertices are taken as the scan");
            self.warnings.add("truth-is-mesh", message);
        }
        let inputs = tnt::Inputs {
            reconstruction,
            truth,
            crop,
            tolerance: self.plan.tolerances[0],
            start,
        };
        Ok((inputs, mesh_sampling, gate))
    }

    /// As [`input::read_reconstruction`].
    fn read_reconstruction(&self, scale: impl FnOnce() -> Result<f64>) -> Result<ReadPoints> {
        let path = &self.job.reconstruction;
        input::read_reconstruction(path, self.draw(), scale, &self.warnings)
    }

    /// Meshes as the job wants them: sampled for the smallest tolerance.
    fn draw(&self) -> Draw {
        let tau = self.plan.tolerances.iter().map(|tolerance| tolerance.get());
        Draw {
            how: self.job.mesh_as,
            tau: tau.fold(f64::INFINITY, f64::min),
            seed: self.job.seed,
        }
    }

    fn gates_of_motion(&self, motion: &Motion) -> Vec<Gate> {
        let cameras = motion.cameras.as_ref();
        let cameras = cameras.map(|fit| gates::of_cameras(fit, self.job.camera_distance));
        let mut all = cameras.unwrap_or_default();
        all.extend(gates::of_stages(&motion.stages));
        all
    }

    /// Whether the clouds, once moved, lie where they should.
    fn gates_of_place(&self, evaluation: &Evaluation, boxes: &Boxes) -> Result<Vec<Gate>> {
        Ok(vec![
            gates::of_crop(
                evaluation,
                (&boxes.moved, &boxes.truth),
                self.job.trajectory.is_some(),
            ),
            gates::of_tolerances(evaluation, self.plan.tolerances[0])?,
        ])
    }

    fn warn_of(&self, gates: &[Gate]) {
        for gate in gates.iter().filter(|gate| !gate.passed) {
            self.warnings.add(&gate.code, gate.message.clone());
        }
    }

    /// The other profile's score; none, and a warning, where it cannot be computed.
    fn other_profile(
        &self,
        inputs: &tnt::Inputs,
        evaluation: &Evaluation,
    ) -> Result<Option<OtherProfile>> {
        let profile = match self.job.profile {
            Profile::Official => Profile::Strict,
            Profile::Strict => Profile::Official,
        };
        self.next(&format!("comparing with {profile}"))?;
        let aligned = match tnt::align(inputs, &self.options(profile, self.job.seed)) {
            Ok(aligned) => aligned,
            Err(error) => {
                let message = format!("the {profile} profile gives no score: {error}");
                self.warnings.add("other-profile-failed", message);
                return Ok(None);
            }
        };
        let other = aligned.evaluate()?;
        let score = other.score(inputs.tolerance);
        let (ours, theirs) = (
            evaluation.score(inputs.tolerance).f_score(),
            score.f_score(),
        );
        if (ours - theirs).abs() > PROFILES_DIFFER {
            let message = format!(
                "F is {ours:.4} by the {} profile and {theirs:.4} by the {profile} profile",
                self.job.profile
            );
            self.warnings.add("profiles-differ", message);
        }
        Ok(Some(OtherProfile {
            profile,
            precision: score.precision(),
            recall: score.recall(),
            f_score: theirs,
        }))
    }

    /// F over seeds, the evaluated one first.
    fn spread(&self, inputs: &tnt::Inputs, evaluation: &Evaluation) -> Result<Option<Spread>> {
        if self.job.seeds < 2 {
            return Ok(None);
        }
        let mut f_scores = vec![evaluation.score(inputs.tolerance).f_score()];
        for nth in 1..u64::from(self.job.seeds) {
            self.next(&format!("seed {nth}"))?;
            let options = self.options(self.job.profile, self.job.seed.wrapping_add(nth));
            match tnt::align(inputs, &options) {
                Ok(aligned) => {
                    let evaluation = aligned.evaluate()?;
                    f_scores.push(evaluation.score(inputs.tolerance).f_score());
                }
                Err(error) => {
                    let message = format!("seed {} gives no score: {error}", options.seed);
                    self.warnings.add("seed-failed", message);
                }
            }
        }
        Ok(Some(Spread {
            min: f_scores.iter().copied().fold(f64::INFINITY, f64::min),
            mean: f_scores.iter().sum::<f64>() / f_scores.len() as f64,
            max: f_scores.iter().copied().fold(f64::NEG_INFINITY, f64::max),
            f_scores,
        }))
    }

    /// The content of `score.json`.
    pub(super) fn document(&self, scored: &Scored, inputs: InputHashes) -> Result<ScoreDocument> {
        let job = self.job;
        let evaluation = &scored.evaluation;
        let at = |&tolerance: &Tolerance| {
            let (confidence, doubt) =
                bootstrap::interval(evaluation, tolerance, job.bootstrap, job.seed);
            if let Some(doubt) = doubt {
                self.warnings.add(&doubt.code, doubt.message);
            }
            AtTolerance {
                confidence,
                ..AtTolerance::of(evaluation, tolerance)
            }
        };
        let by_tolerance: Vec<AtTolerance> = self.plan.tolerances.iter().map(at).collect();
        let first = by_tolerance[0];
        let method = || plan::stem_of(&job.reconstruction);
        Ok(ScoreDocument {
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
            passed: scored.gates.iter().all(|gate| gate.passed),
            gates: scored.gates.clone(),
            other_profile: scored.other_profile,
            confidence: first.confidence,
            spread: scored.spread.clone(),
            mesh_sampling: scored.mesh_sampling,
            voxel: scored.voxel,
            seed: job.seed,
            inputs,
            warnings: self.warnings.sorted(),
        })
    }
}
