//! The three ICP stages that bring a reconstruction from the cameras' alignment onto the truth.

use super::evaluation::{Judged, Side};
use super::points::{FinitePoints, Moved};
use super::tnt::{Profile, scale_of};
use crate::error::Result;
use glam::DMat4;
use mvs_metrics::Tolerance;
use mvs_metrics::align::{Icp, IcpOptions, Scale, icp_onto};
use mvs_metrics::crop::Prism;
use mvs_metrics::distance::{BlockIndex, Coordinate, Source};
use std::borrow::Cow;

/// How many points the last stage leaves as they are (`MAX_POINT_NUMBER` of the toolbox).
const MOST_POINTS: f64 = 4e6;
/// The toolbox means 20 iterations and sets an RMSE tolerance of 20 instead (`registration.py`).
const OFFICIAL_RMSE: f64 = 20.0;
/// The strict RMSE tolerance in τ: 1e-6 m at the largest τ of the training set, tighter at all others.
const STRICT_RMSE: f64 = 4e-5;
/// Updates after which the strict profile settles for what it has.
const STRICT_ITERATIONS: usize = 100;

/// Edge of the voxels over which a stage averages both clouds, and maximal correspondence distance, in τ
/// (`run.py`).
const COARSE: (f64, f64) = (1.0, 80.0);
/// As [`COARSE`]. The voxels are those of the score.
const FINE: (f64, f64) = (0.5, 20.0);
/// The maximal correspondence distance in τ of the stage that takes every k-th point, so that about
/// [`MOST_POINTS`] are left.
const LAST: f64 = 2.0;

/// What one stage did.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stage {
    /// Points of the reconstruction that took part.
    pub reconstruction_points: usize,
    /// Points of the truth that took part.
    pub truth_points: usize,
    /// The maximal correspondence distance in world units.
    pub max_distance: f64,
    /// Pairs over points of the reconstruction.
    pub fitness: f64,
    /// Root mean square distance of the pairs in world units.
    pub inlier_rmse: f64,
    /// Updates made.
    pub iterations: usize,
    /// Whether it ended because nothing changed any more.
    pub converged: bool,
    /// The scale of this stage's own motion.
    pub scale: f64,
    /// All motion so far, the start included.
    pub truth_from_reconstruction: DMat4,
}

/// The truth as [`refine`] left it.
pub enum Truth<'a> {
    /// As given.
    Given(Cow<'a, FinitePoints>),
    /// Cropped and thinned to voxels of τ/2, as the second stage had it: what is judged against.
    Thinned(Side),
}

/// Runs the three stages from `start`. A stage that finds nothing inside the crop volume has fitness
/// 0 and is the last; one whose pairs fix no similarity has fitness 0 too. An owned truth goes before
/// the last stage begins; what is left of it comes back.
///
/// # Errors
/// As [`Moved::new`] and [`Moved::voxels`].
pub fn refine<'a>(
    reconstruction: &FinitePoints,
    truth: Cow<'a, FinitePoints>,
    crop: &Prism,
    tolerance: Tolerance,
    start: DMat4,
    profile: Profile,
) -> Result<(Vec<Stage>, Truth<'a>)> {
    let mut run = Run {
        reconstruction,
        crop,
        tolerance,
        profile,
        so_far: start,
        stages: Vec::new(),
    };
    let kept = Moved::new(&truth, None, Some(crop))?;
    let thinned = |(edge, _): (f64, f64)| {
        let size = edge * tolerance.get();
        BlockIndex::gathered(kept.len(), |take| kept.voxels(size, take))
    };
    if !run.voxel_stage(thinned(COARSE)?.as_ref(), COARSE)? {
        return Ok((run.stages, Truth::Given(truth)));
    }
    let target = thinned(FINE)?;
    let goes_on = run.voxel_stage(target.as_ref(), FINE)?;
    let Some(target) = target.filter(|_| goes_on) else {
        return Ok((run.stages, Truth::Given(truth)));
    };
    let judged = Side {
        input: truth.input(),
        non_finite: truth.non_finite(),
        cropped: kept.len(),
        points: Judged::Indexed(target),
        distances: Vec::new(),
    };
    let last = kept.every_kth_of(uniform_step);
    if last.are_narrow() {
        let target = BlockIndex::gathered_narrow(last.len(), |take| last.each(take))?;
        drop(last);
        drop(truth);
        run.last_stage(target.as_ref())?;
    } else {
        let target = BlockIndex::gathered(last.len(), |take| last.each(take))?;
        drop(last);
        drop(truth);
        run.last_stage(target.as_ref())?;
    }
    Ok((run.stages, Truth::Thinned(judged)))
}

/// The stages under way.
struct Run<'a> {
    reconstruction: &'a FinitePoints,
    crop: &'a Prism,
    tolerance: Tolerance,
    profile: Profile,
    so_far: DMat4,
    stages: Vec<Stage>,
}

impl Run<'_> {
    /// A stage over voxels of an edge; false where it found nothing to align.
    fn voxel_stage(
        &mut self,
        target: Option<&BlockIndex>,
        (edge, reach): (f64, f64),
    ) -> Result<bool> {
        let kept = self.kept()?;
        let size = edge * self.tolerance.get();
        let source = Source::gathered(kept.len(), |take| kept.voxels(size, take))?;
        let found_something = !source.is_empty() && target.is_some();
        self.align(source, target, reach);
        Ok(found_something)
    }

    fn last_stage<C: Coordinate>(&mut self, target: Option<&BlockIndex<C>>) -> Result<()> {
        let kept = self.kept()?.every_kth_of(uniform_step);
        let source = Source::gathered(kept.len(), |take| kept.each(take))?;
        self.align(source, target, LAST);
        Ok(())
    }

    /// The reconstruction as far as it has come.
    fn kept(&self) -> Result<Moved<'_>> {
        Moved::new(self.reconstruction, Some(self.so_far), Some(self.crop))
    }

    fn align<C: Coordinate>(&mut self, source: Source, target: Option<&BlockIndex<C>>, reach: f64) {
        let options = options(self.profile, reach * self.tolerance.get(), self.tolerance);
        let stage = run_stage(source, target, &options, self.so_far);
        self.so_far = stage.truth_from_reconstruction;
        self.stages.push(stage);
    }
}

/// The toolbox's k: n / 4e6 rounded half to even where n is above 4e6, else 1.
fn uniform_step(count: usize) -> usize {
    let ratio = count as f64 / MOST_POINTS;
    if ratio > 1.0 {
        (ratio.round_ties_even() as usize).max(1)
    } else {
        1
    }
}

/// Official: Open3D's default iteration limit and the RMSE tolerance that is none. Strict: converged,
/// in whatever unit, and the scale fitted in the reconstruction's frame: each update of a fit in the
/// truth's frame takes off a share of size for the reconstruction's noise and for the truth's own
/// sampling, and on smooth open surfaces nothing gives it back.
fn options(profile: Profile, max_distance: f64, tolerance: Tolerance) -> IcpOptions {
    match profile {
        Profile::Official => IcpOptions {
            relative_rmse: OFFICIAL_RMSE,
            ..IcpOptions::new(max_distance)
        },
        Profile::Strict => IcpOptions {
            relative_rmse: STRICT_RMSE * tolerance.get(),
            max_iterations: STRICT_ITERATIONS,
            scale: Scale::FreeInSource,
            ..IcpOptions::new(max_distance)
        },
    }
}

fn run_stage<C: Coordinate>(
    source: Source,
    target: Option<&BlockIndex<C>>,
    options: &IcpOptions,
    so_far: DMat4,
) -> Stage {
    let reconstruction_points = source.len();
    let nothing = Icp {
        target_from_source: DMat4::IDENTITY,
        fitness: 0.0,
        inlier_rmse: 0.0,
        pairs: 0,
        iterations: 0,
        converged: false,
    };
    let found = match target {
        // Pairs that fix no similarity, as those of a wrong log may, are as good as none.
        Some(target) if !source.is_empty() => icp_onto(target, source, options).unwrap_or(nothing),
        _ => nothing,
    };
    Stage {
        reconstruction_points,
        truth_points: target.map_or(0, BlockIndex::len),
        max_distance: options.max_distance,
        fitness: found.fitness,
        inlier_rmse: found.inlier_rmse,
        iterations: found.iterations,
        converged: found.converged,
        scale: scale_of(found.target_from_source),
        truth_from_reconstruction: found.target_from_source * so_far,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::score::tnt::preparation;
    use glam::{DQuat, DVec2, DVec3};

    #[test]
    fn the_uniform_step_rounds_half_to_even() {
        for (count, step) in [
            (0, 1),
            (4_000_000, 1),
            (4_000_001, 1),
            (6_000_000, 2),
            (10_000_000, 2),
            (14_000_000, 4),
            (20_000_000, 5),
        ] {
            assert_eq!(uniform_step(count), step, "{count}");
        }
    }

    /// `count` scattered points of a curved surface over the square [−1, 1]².
    fn surface(count: u64) -> Vec<DVec3> {
        let unit = |key: u64| {
            let mut bits = key.wrapping_add(1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
            bits = (bits ^ (bits >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
            bits = (bits ^ (bits >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
            ((bits ^ (bits >> 31)) >> 11) as f64 / (1u64 << 52) as f64 - 1.0
        };
        let point = |i: u64| {
            let (x, y) = (unit(2 * i), unit(2 * i + 1));
            DVec3::new(x, y, 0.5 * x * x - 0.25 * x * y + 0.1 * (5.0 * y).sin())
        };
        (0..count).map(point).collect()
    }

    fn crop() -> Prism {
        let square = [(-2.0, -2.0), (2.0, -2.0), (2.0, 2.0), (-2.0, 2.0)].map(DVec2::from);
        Prism::new(2, (-2.0, 2.0), &square).unwrap()
    }

    #[test]
    fn a_scaled_and_turned_surface_comes_back() {
        let truth = surface(14_400);
        let motion = DMat4::from_scale_rotation_translation(
            DVec3::splat(1.02),
            DQuat::from_rotation_z(0.02),
            DVec3::new(0.01, -0.02, 0.01),
        );
        let moved = motion.inverse();
        let reconstruction: Vec<DVec3> = truth.iter().map(|&p| moved.transform_point3(p)).collect();
        let tolerance = Tolerance::new(0.02).unwrap();
        let (reconstruction, truth) = (FinitePoints::new(reconstruction), FinitePoints::new(truth));
        let run = |profile| {
            let (stages, left) = refine(
                &reconstruction,
                Cow::Borrowed(&truth),
                &crop(),
                tolerance,
                DMat4::IDENTITY,
                profile,
            )
            .unwrap();
            // What the second stage leaves is what is judged against.
            let preparation = preparation(&crop(), tolerance);
            let own = preparation.apply_to_truth(&truth).unwrap();
            assert!(matches!(left, Truth::Thinned(side) if side == own));
            stages
        };
        let strict = run(Profile::Strict);
        assert_eq!(strict.len(), 3);
        let last = strict[2];
        assert!(last.converged && last.fitness == 1.0);
        assert!(
            last.truth_from_reconstruction.abs_diff_eq(motion, 1e-4),
            "{last:?}"
        );
        // The slip: one update with an unchanged fitness ends an official stage.
        let official = run(Profile::Official);
        assert_eq!(official[0].iterations, 1);
        assert!(
            !official[2]
                .truth_from_reconstruction
                .abs_diff_eq(motion, 1e-4)
        );
    }

    #[test]
    fn nothing_inside_the_crop_ends_with_fitness_zero() {
        let far: Vec<DVec3> = surface(400).iter().map(|&p| p + DVec3::X * 100.0).collect();
        let tolerance = Tolerance::new(0.02).unwrap();
        let start = DMat4::from_translation(DVec3::Y);
        let (stages, left) = refine(
            &FinitePoints::new(far),
            Cow::Owned(FinitePoints::new(surface(400))),
            &crop(),
            tolerance,
            start,
            Profile::Strict,
        )
        .unwrap();
        assert!(matches!(left, Truth::Given(_)));
        assert_eq!(stages.len(), 1);
        assert_eq!(
            (stages[0].fitness, stages[0].reconstruction_points),
            (0.0, 0)
        );
        assert_eq!(stages[0].truth_from_reconstruction, start);
    }
}
