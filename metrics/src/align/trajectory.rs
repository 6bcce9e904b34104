//! The similarity between two camera trajectories, found by RANSAC.

use super::own::{EIGHT, Own};
use super::quick;
use super::reach::Reach;
use super::transform;
use super::umeyama::{Scale, umeyama};
use crate::distance::squared_distance;
use crate::error::{Error, Result};
use glam::{DMat4, DVec3};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};
use rayon::prelude::*;

/// Candidates drawn from one random stream.
const BLOCK: usize = 1000;
/// How far a quick fit may be from the exact one, as a share of the moved centres' spread; where it is
/// more than this share of the maximal distance the exact one decides.
const QUICK: f64 = 1e-6;
/// See [`QUICK`].
const MOST_SLACK: f64 = 0.005;
/// The same for the rounding of coordinates far from 0, as a share of these.
const ROUNDING: f64 = 1e-12;
/// Refits of the strict rule before it settles for what it has.
const MAX_REFITS: usize = 100;

/// How a candidate is judged.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Rule {
    /// The official toolbox's: six correspondences with replacement, a candidate is judged by how
    /// many moved centres have *any* target centre near, and the winner is not refined.
    Official,
    /// Three different correspondences, a candidate is judged by how many centres come near *their
    /// own* target, and the winner is refitted to its inliers until these stay the same.
    Strict,
}

/// What the search needs to know.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct TrajectoryOptions {
    /// How a candidate is judged.
    pub rule: Rule,
    /// Centres nearer than this, in world units, agree.
    pub max_distance: f64,
    /// Candidates tried.
    pub iterations: usize,
    /// Seed of the draws.
    pub seed: u64,
}

impl TrajectoryOptions {
    /// The toolbox's constants, 0.2 m and 100 000 candidates, or a tenth of these for the strict
    /// rule, whose draws of three seldom miss.
    pub fn new(rule: Rule, seed: u64) -> Self {
        let iterations = match rule {
            Rule::Official => 100_000,
            Rule::Strict => 10_000,
        };
        Self {
            rule,
            max_distance: 0.2,
            iterations,
            seed,
        }
    }
}

/// The similarity found, and how far each centre stays from its own target.
#[derive(Debug, Clone, PartialEq)]
pub struct TrajectoryFit {
    /// The similarity that moves the source centres onto the target centres.
    pub target_from_source: DMat4,
    /// The fraction of centres that agree by the rule, in [0, 1]. For the official rule a centre
    /// agrees with whatever target is nearest: 1.0 says little, see [`TrajectoryFit::residuals`].
    pub fitness: f64,
    /// Root of the mean squared distance over the centres that agree, in world units.
    pub rmse: f64,
    /// Per centre the distance to its own target after the motion, in world units.
    pub residuals: Vec<f64>,
    /// How many residuals are below the maximal distance.
    pub inliers: usize,
}

/// Aligns `source[i]` with `target[i]`: camera centres in two frames. The same seed gives the same
/// bits at any number of threads.
///
/// # Errors
/// Lengths that differ, fewer than three centres, coordinates that are not finite, a maximal distance that is not
/// finite and above 0, no candidate that brings any centre near a target, and, by the strict rule, inliers that fix
/// no similarity.
pub fn align(
    source: &[DVec3],
    target: &[DVec3],
    options: &TrajectoryOptions,
) -> Result<TrajectoryFit> {
    check(source, target, options)?;
    let judge = Judge::new(source, target, options);
    let blocks = options.iterations.div_ceil(BLOCK);
    let winners: Vec<Option<Candidate>> = (0..blocks)
        .into_par_iter()
        .map(|block| judge.best_of_block(block))
        .collect();
    let Some(winner) = winners.into_iter().flatten().reduce(Candidate::better) else {
        let (n, d) = (options.iterations, options.max_distance);
        let problem = format!("none of {n} candidates brings a camera within {d:?} of a target");
        return Err(Error::invalid("trajectory alignment", problem));
    };
    let winner = match options.rule {
        Rule::Official => winner,
        Rule::Strict => judge.refined(winner)?,
    };
    let residuals = residuals(source, target, winner.target_from_source);
    let near = |&&residual: &&f64| residual < options.max_distance;
    Ok(TrajectoryFit {
        target_from_source: winner.target_from_source,
        fitness: winner.agreeing as f64 / source.len() as f64,
        rmse: winner.rmse(),
        inliers: residuals.iter().filter(near).count(),
        residuals,
    })
}

/// Per correspondence the distance left after the motion, in the target's units.
pub fn residuals(source: &[DVec3], target: &[DVec3], target_from_source: DMat4) -> Vec<f64> {
    source
        .iter()
        .zip(target)
        .map(|(&s, &t)| squared_distance(transform(target_from_source, s), t).sqrt())
        .collect()
}

fn check(source: &[DVec3], target: &[DVec3], options: &TrajectoryOptions) -> Result<()> {
    let what = "trajectory alignment";
    if source.len() != target.len() || source.len() < 3 {
        let (s, t) = (source.len(), target.len());
        let problem = format!("expected at least 3 cameras on both sides alike, found {s} and {t}");
        return Err(Error::invalid(what, problem));
    }
    if let Some(bad) = source.iter().chain(target).position(|c| !c.is_finite()) {
        let index = bad % source.len();
        let problem = format!("expected finite camera centres, found NaN or infinity at {index}");
        return Err(Error::invalid(what, problem));
    }
    if !(options.max_distance.is_finite() && options.max_distance > 0.0) {
        let found = options.max_distance;
        let problem = format!("expected a finite maximal distance above 0, found {found:?}");
        return Err(Error::invalid(what, problem));
    }
    Ok(())
}

/// A motion and how well it does.
#[derive(Debug, Clone, Copy)]
struct Candidate {
    target_from_source: DMat4,
    agreeing: usize,
    squares: f64,
}

impl Candidate {
    fn rmse(&self) -> f64 {
        (self.squares / self.agreeing.max(1) as f64).sqrt()
    }

    /// The one of more agreement, then of lower RMSE, then the earlier.
    fn better(self, later: Self) -> Self {
        let more = later.agreeing > self.agreeing;
        let closer = later.agreeing == self.agreeing && later.rmse() < self.rmse();
        if more || closer { later } else { self }
    }
}

struct Judge<'a> {
    source: &'a [DVec3],
    target: &'a [DVec3],
    near: Reach,
    own: Own,
    options: &'a TrajectoryOptions,
    /// A length that no two source centres are farther apart than.
    spread: f64,
    /// The largest coordinates of either side.
    farthest: [f64; 2],
}

impl<'a> Judge<'a> {
    fn new(source: &'a [DVec3], target: &'a [DVec3], options: &'a TrajectoryOptions) -> Self {
        let nowhere = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        let wider = |(min, max): (DVec3, DVec3), &c: &DVec3| (min.min(c), max.max(c));
        let (min, max) = source.iter().fold(nowhere, wider);
        let farthest = |side: &[DVec3]| {
            let largest = side.iter().map(|c| c.abs().max_element());
            largest.fold(0.0, f64::max)
        };
        Self {
            source,
            target,
            near: Reach::new(target, options.max_distance * (1.0 + 2.0 * MOST_SLACK)),
            own: Own::new(source, target, options.rule),
            options,
            spread: (max - min).length(),
            farthest: [farthest(source), farthest(target)],
        }
    }

    fn best_of_block(&self, block: usize) -> Option<Candidate> {
        let mut rng = ChaCha8Rng::seed_from_u64(self.options.seed);
        rng.set_stream(block as u64);
        let first = block * BLOCK;
        let count = BLOCK.min(self.options.iterations - first);
        let mut best: Option<Candidate> = None;
        let (mut source, mut target) = (Vec::new(), Vec::new());
        for _ in 0..count {
            // A draw of coinciding centres fixes no similarity: it has no candidate.
            self.draw(&mut rng, &mut source, &mut target);
            let hopeless = |best| self.is_hopeless(&source, &target, best);
            if best.as_ref().is_some_and(hopeless) {
                continue;
            }
            let Ok(motion) = umeyama(&source, &target, Scale::Free) else {
                continue;
            };
            if let Some(candidate) = self.judge(motion, best.as_ref()) {
                best = Some(best.map_or(candidate, |best| best.better(candidate)));
            }
        }
        best
    }

    /// Draws corresponding centres.
    fn draw(&self, rng: &mut ChaCha8Rng, source: &mut Vec<DVec3>, target: &mut Vec<DVec3>) {
        source.clear();
        target.clear();
        let mut take = |pick: usize| {
            source.push(self.source[pick]);
            target.push(self.target[pick]);
        };
        match self.options.rule {
            Rule::Official => (0..6).for_each(|_| take(below(rng, self.source.len()))),
            Rule::Strict => three_different(rng, self.source.len())
                .into_iter()
                .for_each(take),
        }
    }

    /// Whether a quick fit shows that the exact one cannot be better than `best`.
    fn is_hopeless(&self, source: &[DVec3], target: &[DVec3], best: &Candidate) -> bool {
        let Some((motion, scale)) = quick::similarity(source, target) else {
            return false;
        };
        let far = self.farthest[0] * scale + self.farthest[1];
        let slack = QUICK * scale * self.spread + ROUNDING * far;
        let most = self.options.max_distance;
        if slack.is_nan() || slack > MOST_SLACK * most {
            return false;
        }
        let bound = (most + slack) * (most + slack);
        let Some(mut may_miss) = self.source.len().checked_sub(best.agreeing) else {
            return true;
        };
        let (mut squares, beaten) = (0.0, best.squares * (1.0 + QUICK));
        for first in (0..self.source.len()).step_by(EIGHT) {
            for (i, own) in (first..self.source.len()).zip(self.own.squares(first, motion)) {
                let square = if own < self.own.near[i] {
                    own
                } else {
                    self.square(i, transform(motion, self.source[i]))
                };
                if square < bound {
                    // (d − slack)² and less.
                    squares += (square - 2.0 * slack * (most + slack)).max(0.0);
                } else if may_miss == 0 {
                    return true;
                } else {
                    may_miss -= 1;
                }
            }
            if may_miss == 0 && squares > beaten {
                return true;
            }
        }
        false
    }

    /// The squared distance by which a moved centre is judged.
    #[inline]
    fn square(&self, index: usize, moved: DVec3) -> f64 {
        match self.options.rule {
            Rule::Official => self.near.nearest_square(moved),
            Rule::Strict => squared_distance(moved, self.target[index]),
        }
    }

    /// The candidate, or `None` as soon as no centre can agree or it cannot be better than `best`.
    fn judge(&self, target_from_source: DMat4, best: Option<&Candidate>) -> Option<Candidate> {
        let bound = self.options.max_distance * self.options.max_distance;
        let (to_beat, most_squares) =
            best.map_or((1, f64::INFINITY), |best| (best.agreeing, best.squares));
        let mut candidate = Candidate {
            target_from_source,
            agreeing: 0,
            squares: 0.0,
        };
        let mut may_miss = self.source.len().checked_sub(to_beat)?;
        for (i, &centre) in self.source.iter().enumerate() {
            let moved = transform(target_from_source, centre);
            let square = self.square(i, moved);
            if square < bound {
                candidate.agreeing += 1;
                candidate.squares += square;
            } else {
                may_miss = may_miss.checked_sub(1)?;
            }
            if may_miss == 0 && candidate.squares >= most_squares {
                return None;
            }
        }
        Some(candidate)
    }

    /// Refits to the inliers until these stay the same.
    fn refined(&self, mut winner: Candidate) -> Result<Candidate> {
        let mut inliers = self.inliers(&winner);
        for _ in 0..MAX_REFITS {
            let pick = |side: &[DVec3]| inliers.iter().map(|&i| side[i]).collect::<Vec<_>>();
            let (source, target) = (pick(self.source), pick(self.target));
            if source.len() < 3 {
                break;
            }
            let motion = umeyama(&source, &target, Scale::Free)?;
            let Some(refit) = self.judge(motion, None) else {
                break;
            };
            winner = refit;
            let now = self.inliers(&winner);
            if now == inliers {
                break;
            }
            inliers = now;
        }
        Ok(winner)
    }

    fn inliers(&self, candidate: &Candidate) -> Vec<usize> {
        let left = residuals(self.source, self.target, candidate.target_from_source);
        let near = |&index: &usize| left[index] < self.options.max_distance;
        (0..left.len()).filter(near).collect()
    }
}

/// A uniform index below `count`, without bias.
fn below(rng: &mut ChaCha8Rng, count: usize) -> usize {
    let count = count as u64;
    let fair = u64::MAX - u64::MAX % count;
    loop {
        let bits = rng.next_u64();
        if bits < fair {
            return (bits % count) as usize;
        }
    }
}

fn three_different(rng: &mut ChaCha8Rng, count: usize) -> [usize; 3] {
    let (mut picks, mut drawn) = ([0; 3], 0);
    while drawn < 3 {
        let pick = below(rng, count);
        if !picks[..drawn].contains(&pick) {
            picks[drawn] = pick;
            drawn += 1;
        }
    }
    picks
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::align::tests::scattered;
    use crate::align::transformed;
    use crate::align::umeyama::tests::similarity;

    /// Centres on a ring with a little height, their true motion, and some of them misplaced.
    fn trajectories(misplaced: usize) -> (Vec<DVec3>, Vec<DVec3>, DMat4) {
        let source = scattered(10, 60);
        let truth = similarity(4.0, 0.9, DVec3::new(10.0, 20.0, 30.0));
        let noise = scattered(11, 60);
        let mut target = transformed(&source, truth);
        for (centre, noise) in target.iter_mut().zip(&noise) {
            *centre += *noise * 0.01;
        }
        let mut source = source;
        for centre in source.iter_mut().take(misplaced) {
            *centre = DVec3::ZERO;
        }
        (source, target, truth)
    }

    fn options(rule: Rule) -> TrajectoryOptions {
        TrajectoryOptions {
            iterations: 3000,
            ..TrajectoryOptions::new(rule, 7)
        }
    }

    /// The official winner by judging every candidate in full, over all targets.
    fn plain_winner(source: &[DVec3], target: &[DVec3], options: &TrajectoryOptions) -> DMat4 {
        let judge = Judge::new(source, target, options);
        let bound = options.max_distance * options.max_distance;
        let mut best: Option<(usize, f64, DMat4)> = None;
        for block in 0..options.iterations.div_ceil(BLOCK) {
            let mut rng = ChaCha8Rng::seed_from_u64(options.seed);
            rng.set_stream(block as u64);
            for _ in 0..BLOCK.min(options.iterations - block * BLOCK) {
                let (mut picked, mut wanted) = (Vec::new(), Vec::new());
                judge.draw(&mut rng, &mut picked, &mut wanted);
                let Ok(motion) = umeyama(&picked, &wanted, Scale::Free) else {
                    continue;
                };
                let nearest = |&s: &DVec3| {
                    let squares = target
                        .iter()
                        .map(|&t| squared_distance(transform(motion, s), t));
                    squares.fold(f64::INFINITY, f64::min)
                };
                let near: Vec<f64> = source.iter().map(nearest).filter(|&s| s < bound).collect();
                let mean = near.iter().sum::<f64>() / near.len().max(1) as f64;
                let found = (near.len(), mean.sqrt(), motion);
                let better = best.is_none_or(|b| found.0 > b.0 || found.0 == b.0 && found.1 < b.1);
                if better && found.0 > 0 {
                    best = Some(found);
                }
            }
        }
        best.unwrap().2
    }

    #[test]
    fn no_candidate_is_dropped_that_would_win() {
        for (misplaced, max_distance) in [(0, 0.2), (0, 0.02), (20, 0.2), (45, 1.5)] {
            let (source, target, _) = trajectories(misplaced);
            let options = TrajectoryOptions {
                max_distance,
                ..options(Rule::Official)
            };
            let fit = align(&source, &target, &options).unwrap();
            assert_eq!(
                fit.target_from_source,
                plain_winner(&source, &target, &options)
            );
        }
    }

    #[test]
    fn both_rules_find_the_motion_of_clean_trajectories() {
        let (source, target, truth) = trajectories(0);
        for rule in [Rule::Official, Rule::Strict] {
            let fit = align(&source, &target, &options(rule)).unwrap();
            assert!(fit.target_from_source.abs_diff_eq(truth, 0.1), "{rule:?}");
            assert_eq!((fit.inliers, fit.fitness), (60, 1.0));
            assert!(fit.rmse < 0.02 && fit.residuals.len() == 60);
        }
    }

    #[test]
    fn the_strict_rule_survives_where_most_centres_are_misplaced() {
        let (source, target, truth) = trajectories(36);
        let fit = align(&source, &target, &options(Rule::Strict)).unwrap();
        assert!(fit.target_from_source.abs_diff_eq(truth, 0.03));
        assert_eq!(fit.inliers, 24);
        assert_eq!(fit.fitness, 0.4);
        // The official rule collapses: all 36 equal centres land on one target and count.
        let collapsed = align(&source, &target, &options(Rule::Official)).unwrap();
        assert!(collapsed.inliers < 10 && collapsed.fitness > 0.5);
    }

    #[test]
    fn the_strict_winner_is_the_fit_to_its_inliers() {
        let (source, target, _) = trajectories(10);
        let fit = align(&source, &target, &options(Rule::Strict)).unwrap();
        let again = umeyama(&source[10..], &target[10..], Scale::Free).unwrap();
        assert_eq!(fit.target_from_source, again);
    }

    #[test]
    fn the_same_seed_gives_the_same_bits_at_any_number_of_threads() {
        let (source, target, _) = trajectories(20);
        for rule in [Rule::Official, Rule::Strict] {
            let run = |threads, seed| {
                let pool = rayon::ThreadPoolBuilder::new().num_threads(threads);
                let options = TrajectoryOptions {
                    seed,
                    ..options(rule)
                };
                let pool = pool.build().unwrap();
                pool.install(|| align(&source, &target, &options).unwrap())
            };
            assert_eq!(run(1, 3), run(4, 3));
        }
    }

    #[test]
    fn bad_trajectories_are_refused() {
        let (source, target, _) = trajectories(0);
        let options = options(Rule::Strict);
        assert!(align(&source[1..], &target, &options).is_err());
        assert!(align(&source[..2], &target[..2], &options).is_err());
        assert!(align(&[DVec3::NAN; 60], &target, &options).is_err());
        let same = align(&[DVec3::ONE; 60], &target, &options).unwrap_err();
        assert!(same.to_string().contains("none of 3000"), "{same}");
    }
}
