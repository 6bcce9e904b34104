//! The knobs of scoring. Queries may be thinned; the clouds that are searched never, because a
//! thinned cloud lies farther from everything.

use super::TradeoffJob;
use super::clock;
use super::rows::{Measured, Row, rows};
use crate::error::{Error, Result};
use crate::jobs::Context;
use crate::jobs::score::{read_reconstruction, read_truth};
use crate::score::evaluation::Judged;
use crate::score::plain::{self, Preparation};
use crate::score::points::{FinitePoints, prism};
use crate::score::tnt;
use glam::{DMat4, DVec3};
use mvs_datasets::layout::files;
use mvs_metrics::Score;
use mvs_metrics::Tolerance;
use mvs_metrics::distance::{self, BlockIndex, Order, listed};

/// The normal distribution's quantile of a two-sided 95 % interval.
const Z95: f64 = 1.959_964;

/// What is scored.
struct Pair {
    truth: FinitePoints,
    reconstruction: FinitePoints,
    motion: Option<DMat4>,
    preparation: Preparation,
    tolerance: Tolerance,
}

/// A setting of the knobs.
#[derive(Debug, Clone, Copy)]
struct Setting {
    /// Edge of the voxels in τ; none without.
    voxel: Option<f64>,
    /// One query in so many is asked.
    every: u64,
    /// Searches end at so many τ.
    bound: f64,
    /// What happens to coordinates before the search.
    rounding: Rounding,
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum Rounding {
    None,
    Recentred,
    InPlace,
}

const EXACT: Setting = Setting {
    voxel: Some(0.5),
    every: 1,
    bound: f64::INFINITY,
    rounding: Rounding::None,
};

fn settings() -> Vec<(&'static str, String, Setting)> {
    let mut all = vec![("exact", "voxel τ/2, all queries, f64".to_owned(), EXACT)];
    for (name, voxel) in [("none", None), ("τ/4", Some(0.25)), ("τ", Some(1.0))] {
        all.push(("voxel", name.to_owned(), Setting { voxel, ..EXACT }));
    }
    for every in [2, 4, 16, 64] {
        all.push(("queries", format!("1/{every}"), Setting { every, ..EXACT }));
    }
    for (name, bound) in [("up to 5 τ", 5.0), ("up to τ", 1.0)] {
        all.push(("search", name.to_owned(), Setting { bound, ..EXACT }));
    }
    for (name, rounding) in [
        ("f32, recentred", Rounding::Recentred),
        ("f32, in place", Rounding::InPlace),
    ] {
        all.push((
            "coordinates",
            name.to_owned(),
            Setting { rounding, ..EXACT },
        ));
    }
    all
}

/// The clouds and what happens to them.
fn read(job: &TradeoffJob, context: &Context<'_>) -> Result<Option<Pair>> {
    let (Some(truth), Some(reconstruction)) = (&job.truth, &job.reconstruction) else {
        return Ok(None);
    };
    let motion = job.transform.as_deref().map(files::read_similarity);
    let motion = motion.transpose()?.map(|similarity| similarity.matrix());
    let scale = || Ok(motion.map_or(1.0, tnt::scale_of));
    let crop = job.crop.as_deref().map(files::read_crop).transpose()?;
    let warnings = context.warnings;
    Ok(Some(Pair {
        truth: read_truth(truth, job.draw(), warnings)?.0,
        reconstruction: read_reconstruction(reconstruction, job.draw(), scale, warnings)?.0,
        motion,
        preparation: Preparation {
            crop: crop.as_ref().map(prism).transpose()?,
            voxel: None,
        },
        tolerance: Tolerance::new(job.tau)?,
    }))
}

/// Refuses what [`run`] would, before anything is measured.
pub(super) fn check(job: &TradeoffJob, context: &Context<'_>) -> Result<()> {
    if let Some(pair) = read(job, context)? {
        pair.preparation.apply_to_truth(&pair.truth)?;
    }
    Ok(())
}

/// Measures every setting: preparing both clouds and the distances both ways.
pub(super) fn run(job: &TradeoffJob, context: &Context<'_>) -> Result<Vec<Row>> {
    let Some(pair) = read(job, context)? else {
        return Ok(Vec::new());
    };
    let (settings, progress) = (settings(), context.progress);
    progress.begin("score settings", settings.len() as u64);
    let mut measured = Vec::new();
    for (knob, name, setting) in settings {
        progress.check()?;
        let ((score, half_width), cost) =
            clock::measure(job.repeats, || pair.score(&setting, job.seed))?;
        measured.push(Measured {
            knob,
            setting: name,
            cost,
            value: score.f_score(),
            half_width,
        });
        progress.advance(1);
    }
    Ok(rows(("score", "F"), None, measured, |knob, setting| {
        (knob, setting) == ("voxel", "none")
    }))
}

impl Pair {
    /// The score, and half its interval where queries are a sample.
    fn score(&self, setting: &Setting, seed: u64) -> Result<(Score, Option<f64>)> {
        let tau = self.tolerance.get();
        let preparation = Preparation {
            voxel: setting.voxel.map(|edge| edge * tau),
            ..self.preparation.clone()
        };
        let bound = setting.bound * tau;
        let all = setting.every == 1 && bound.is_infinite();
        if all && setting.rounding == Rounding::None {
            // The very path of `score`.
            let (reconstruction, truth) = (&self.reconstruction, &self.truth);
            let evaluation = plain::evaluate(reconstruction, self.motion, truth, &preparation)?;
            return Ok((evaluation.score(self.tolerance), None));
        }
        let truth = preparation.apply_to_truth(&self.truth)?.points;
        let reconstruction = preparation.apply(&self.reconstruction, self.motion)?.points;
        let order = setting.voxel.map_or(Order::Any, |_| Order::Spatial);
        if setting.rounding != Rounding::None {
            let lists = rounded([reconstruction.to_vec(), truth.to_vec()], setting.rounding);
            let [a, b] = distance::both_ways_in(order, lists)?;
            return Ok((Score::from_distances(&a.1, &b.1, self.tolerance), None));
        }
        let totals = (reconstruction.len(), truth.len());
        let (reconstruction, truth) = (indexed(reconstruction, order)?, indexed(truth, order)?);
        // Two draws: the same indices of both clouds would err together, and the interval takes them
        // as independent.
        let seed = seed.wrapping_mul(2);
        let ask = |queries: &Option<BlockIndex>, cloud: &Option<BlockIndex>, draw: u64| {
            let drawn = match (setting.every, queries) {
                (2.., Some(all)) => {
                    let points = all.pieces().flatten();
                    let sampled = sample(points, setting.every, seed ^ draw);
                    Some(indexed(Judged::Listed(sampled), order)?)
                }
                _ => None,
            };
            let Some(queries) = drawn.as_ref().unwrap_or(queries) else {
                return Ok(Vec::new());
            };
            let nowhere = || vec![f64::INFINITY; queries.len()];
            let found = cloud
                .as_ref()
                .map(|cloud| cloud.distances_from_below(queries, bound));
            Ok::<_, Error>(found.unwrap_or_else(nowhere))
        };
        let from_reconstruction = ask(&reconstruction, &truth, 0)?;
        let from_truth = ask(&truth, &reconstruction, 1)?;
        let score = Score::from_distances(&from_reconstruction, &from_truth, self.tolerance);
        let width = (setting.every > 1).then(|| half_width(&score, totals));
        Ok((score, width))
    }
}

/// What is searched, and queries that keep the order they have; `None` without points.
fn indexed(points: Judged, order: Order) -> Result<Option<BlockIndex>> {
    Ok(match points {
        Judged::Indexed(index) => Some(index),
        Judged::Listed(points) if points.is_empty() => None,
        Judged::Listed(points) => Some(BlockIndex::of(&listed(&points, order))?),
    })
}

/// The reconstruction and the truth as f32, counted from the truth's first point or as they are.
fn rounded(mut lists: [Vec<DVec3>; 2], rounding: Rounding) -> [Vec<DVec3>; 2] {
    let center = match (rounding, lists[1].first()) {
        (Rounding::Recentred, Some(&first)) => first,
        _ => DVec3::ZERO,
    };
    for point in lists.iter_mut().flatten() {
        *point = (*point - center).as_vec3().as_dvec3();
    }
    lists
}

/// About one point in `every`, by a hash of its index: near any place the same share.
fn sample(points: impl Iterator<Item = DVec3>, every: u64, seed: u64) -> Vec<DVec3> {
    let chosen = points
        .enumerate()
        .filter(|(index, _)| mixed(*index as u64 ^ seed.rotate_left(32)).is_multiple_of(every));
    chosen.map(|(_, point)| point).collect()
}

/// SplitMix64's finaliser (Steele, Lea and Flood 2014).
fn mixed(value: u64) -> u64 {
    let mut z = value.wrapping_add(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// Half of the 95 % interval of the F-score that all queries would give, from a sample drawn without
/// replacement: binomial variances with the finite-population factor, carried through
/// F = 2PR / (P + R) to first order. Shares are drawn towards a half as by Agresti and Coull (1998), so that
/// a sample of one kind only is not taken for sure; where none was drawn nothing is known.
fn half_width(score: &Score, totals: (usize, usize)) -> f64 {
    let (reconstruction, truth) = (score.reconstruction(), score.truth());
    if reconstruction.total().min(truth.total()) == 0 {
        return 1.0;
    }
    #[allow(
        clippy::cast_precision_loss,
        reason = "point counts are far below 2^53"
    )]
    let share_and_variance = |share: f64, drawn: usize, total: usize| {
        let (drawn, total) = (drawn as f64, total as f64);
        let trials = drawn + Z95 * Z95;
        let share = (share * drawn + 0.5 * Z95 * Z95) / trials;
        let of_all = (1.0 - drawn / total).max(0.0);
        (share, share * (1.0 - share) / trials * of_all)
    };
    let (p, along_p) = share_and_variance(score.precision(), reconstruction.total(), totals.0);
    let (r, along_r) = share_and_variance(score.recall(), truth.total(), totals.1);
    let (by_p, by_r) = (2.0 * (r / (p + r)).powi(2), 2.0 * (p / (p + r)).powi(2));
    Z95 * (by_p * by_p * along_p + by_r * by_r * along_r).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Points on a plane, and others above it whose height is below 1 at about seven in ten.
    fn pair() -> Pair {
        pair_of(20_000, |i| (mixed(i ^ 77) % 1000) as f64 / 700.0)
    }

    /// Points on a plane, and as many above it.
    fn pair_of(count: u64, height: impl Fn(u64) -> f64) -> Pair {
        let at = |i: u64| DVec3::new((i % 200) as f64, (i / 200) as f64, 0.0);
        let truth = (0..count).map(at).collect();
        let above = (0..count).map(|i| at(i) + DVec3::Z * height(i));
        let reconstruction = above.collect();
        Pair {
            truth: FinitePoints::new(truth),
            reconstruction: FinitePoints::new(reconstruction),
            motion: None,
            preparation: Preparation::default(),
            tolerance: Tolerance::new(0.9).unwrap(),
        }
    }

    fn plain(setting: Setting) -> Setting {
        Setting {
            voxel: None,
            ..setting
        }
    }

    #[test]
    fn a_reconstruction_that_the_crop_leaves_nothing_of_scores_zero() {
        let square = [(-1.0, -1.0), (1e3, -1.0), (1e3, 1e3), (-1.0, 1e3)].map(glam::DVec2::from);
        let prism = mvs_metrics::crop::Prism::new(2, (-1.0, 1.0), &square).unwrap();
        let mut pair = pair();
        pair.preparation.crop = Some(prism);
        pair.motion = Some(DMat4::from_translation(DVec3::Z * 100.0));
        for setting in [
            EXACT,
            Setting {
                bound: 5.0,
                ..EXACT
            },
            Setting { every: 2, ..EXACT },
        ] {
            let (score, _) = pair.score(&plain(setting), 0).unwrap();
            assert_eq!(score.f_score(), 0.0);
        }
    }

    #[test]
    fn bounded_searches_give_the_same_score() {
        let pair = pair();
        for exact in [EXACT, plain(EXACT)] {
            let (score, none) = pair.score(&exact, 0).unwrap();
            assert!(none.is_none() && (0.5..0.8).contains(&score.precision()));
            for bound in [1.0, 5.0] {
                let (bounded, _) = pair.score(&Setting { bound, ..exact }, 0).unwrap();
                assert_eq!(bounded, score);
            }
        }
    }

    #[test]
    fn intervals_of_samples_hold_the_exact_score_as_often_as_they_say() {
        let pair = pair();
        let exact = pair.score(&plain(EXACT), 0).unwrap().0.f_score();
        let thinned = plain(Setting { every: 16, ..EXACT });
        let mut inside = 0;
        for seed in 0..200 {
            let (score, width) = pair.score(&thinned, seed).unwrap();
            let width = width.unwrap();
            assert!(width > 0.001 && width < 0.03, "{width}");
            inside += u32::from((score.f_score() - exact).abs() <= width);
        }
        // 95 % of 200 is 190 with a standard deviation of 3.1.
        assert!((178..=199).contains(&inside), "{inside} of 200");
    }

    /// Two points in a thousand are outliers: one draw in two has none of them.
    #[test]
    fn a_sample_of_one_kind_is_not_taken_for_sure() {
        let pair = pair_of(20_000, |i| f64::from(u8::from(i % 500 == 0)));
        let exact = pair.score(&plain(EXACT), 0).unwrap().0.f_score();
        let thinned = plain(Setting { every: 64, ..EXACT });
        let (mut inside, mut of_one_kind) = (0, 0);
        for seed in 0..200 {
            let (score, width) = pair.score(&thinned, seed).unwrap();
            inside += u32::from((score.f_score() - exact).abs() <= width.unwrap());
            of_one_kind += u32::from(score.f_score() == 1.0);
        }
        assert!(
            of_one_kind > 20 && inside >= 185,
            "{inside} of 200, {of_one_kind}"
        );
        let few = pair_of(4, |_| 0.0);
        let (score, width) = few.score(&thinned, 0).unwrap();
        assert_eq!((score.truth().total(), width), (0, Some(1.0)));
    }
}
