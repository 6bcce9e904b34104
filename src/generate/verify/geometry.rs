//! Depth carried from each view into its source views.

use super::carry::{SAME_SURFACE, agrees, carry, grid};
use super::reading::Reading;
use super::{Finding, Severity, VerifyOptions, median, quarter};
use super::{contradictions, images, listed, shifts, single};
use crate::error::Result;
use crate::parallel;
use crate::progress::Progress;
use glam::DVec2;
use mvs_datasets::layout::blended::BlendedFolder;
use mvs_datasets::scene::{ColorImage, DepthMap, Scene, View};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Both views as they are.
pub(super) const AS_IS: (Reading, Reading) = (Reading::AsIs, Reading::AsIs);
/// Views, evenly spread, by which readings and pairs are judged.
const JUDGED_VIEWS: usize = 24;
/// Below this many points in frame nothing is said about a pair.
pub(super) const FEW: usize = 20;
/// Of fewer views, one that is wrong spoils half of all pairs or more.
const FEW_VIEWS: usize = 5;
/// Differences below this say nothing more: the depths' own rounding.
pub(super) const FLOOR: f64 = 1e-7;

/// One view's depth carried into one of its source views.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PairCheck {
    /// The view whose depth is carried.
    pub reference: u32,
    /// The view into which.
    pub source: u32,
    /// Points that fall on smooth depth of the source.
    pub in_frame: usize,
    /// Of those, the ones whose depth agrees to 1 %; the others are mostly occluded.
    pub agree: usize,
    /// Those that lie more than 1 % in front of all that the source sees within two pixels.
    pub in_front: usize,
    /// Median relative difference of those that agree; 0 when there are none.
    pub median_difference: f64,
    /// The largest difference but for one in a thousand of those that agree.
    pub worst_difference: f64,
    /// Median difference of colour where depths agree, in grey levels.
    pub color_difference: f64,
    /// Correlation of brightness where depths agree; none where too few do or an image hardly varies.
    pub color_correlation: Option<f64>,
    /// Whether they correlate at least as well there as a little beside; none where `color_correlation`
    /// is none.
    pub color_peak: Option<bool>,
    /// How far to the right and below, in pixels, the source's image shows what its camera says is there; none
    /// where `color_correlation` is none, and where brightness varies too slowly to tell.
    pub color_shift: Option<[f64; 2]>,
}

/// The outcome of all of these checks.
pub(super) struct Checked {
    pub(super) findings: Vec<Finding>,
    pub(super) pairs: Vec<PairCheck>,
    pub(super) median_difference: Option<f64>,
    pub(super) median_color_difference: Option<f64>,
}

/// A view with its depth and, if readable, its image.
pub(super) struct Seen {
    pub(super) view: View,
    pub(super) depth: DepthMap,
    image: Option<ColorImage>,
}

pub(super) fn check(
    folder: &BlendedFolder,
    scene: &Scene,
    options: &VerifyOptions,
    progress: &dyn Progress,
) -> Result<Checked> {
    let mut findings = Vec::new();
    let judged = read_some(folder, scene)?;
    let mut convention = judge_readings(scene, &judged, options);
    let (pairs, points) = check_pairs(folder, scene, options, progress)?;
    let agreeing = || pairs.iter().filter(|pair| pair.agree >= FEW);
    let differences = || {
        agreeing()
            .map(|pair| pair.median_difference)
            .collect::<Vec<_>>()
    };
    let median_difference = median(differences());
    let few = scene.views().len() < FEW_VIEWS;
    if convention.is_none() || few {
        // Where all views are misread, each by itself is too.
        let level = quarter(differences()).unwrap_or(0.0);
        let of_views = single::check((folder, scene), (&pairs, &points), level, options);
        let at_fault = of_views.iter().filter(|f| f.severity == Severity::Fault);
        let at_fault: Vec<&str> = at_fault.map(|finding| &finding.place[..]).collect();
        // One wrong view of so few is in so many pairs that another reading of all can fit better.
        let single = few && at_fault.len() == 1;
        convention = convention.filter(|_| !single);
        if convention.is_none() {
            let fits = |id: u32| !at_fault.contains(&&format!("view {id}")[..]);
            let fitting = pairs
                .iter()
                .filter(|pair| fits(pair.reference) && fits(pair.source));
            let fitting: Vec<PairCheck> = fitting.cloned().collect();
            let of_images = images::check(scene, &fitting);
            if of_images.is_empty() {
                findings.extend(shifts::check(scene, &fitting));
            }
            findings.extend(of_images);
            let known = |id: &u32| {
                of_views
                    .iter()
                    .any(|found| found.place == format!("view {id}"))
            };
            let ids = scene.views().iter().map(|view| view.id);
            let known: Vec<u32> = ids.filter(known).collect();
            findings.extend(contradictions::check(
                &pairs,
                (scene.views().len(), &known),
                median_difference.is_some_and(|difference| difference > single::CLOSE),
            ));
            findings.extend(of_views);
            let overall = median_difference.filter(|_| !single);
            findings.extend(overall_finding(overall.unwrap_or(0.0)));
        }
    }
    findings.extend(convention);
    findings.extend(listed::judge(scene, &judged));
    findings.extend(pairs.iter().filter_map(pair_finding));
    Ok(Checked {
        median_difference,
        median_color_difference: median(agreeing().map(|pair| pair.color_difference).collect()),
        findings,
        pairs,
    })
}

pub(super) fn read(folder: &BlendedFolder, view: &View) -> Option<Seen> {
    let (depth, _) = folder.read_depth(view.id).ok()?;
    if depth.size() != (view.camera.width(), view.camera.height()) {
        return None;
    }
    let image = folder.read_image(view.id).ok();
    let image = image.filter(|image| image.size() == depth.size());
    Some(Seen {
        view: view.clone(),
        depth,
        image,
    })
}

/// Evenly spread views and the best two sources of each, by index.
fn read_some(folder: &BlendedFolder, scene: &Scene) -> Result<BTreeMap<usize, Seen>> {
    let count = scene.views().len();
    let picked = JUDGED_VIEWS.min(count);
    let indices: Vec<usize> = (0..picked).map(|i| i * count / picked).collect();
    let seen = parallel::map(indices.len(), |i| read(folder, &scene.views()[indices[i]]));
    let pairs = indices.into_iter().zip(seen);
    Ok(pairs
        .filter_map(|(index, seen)| Some((index, seen?)))
        .collect())
}

/// Advice where views agree that they see the same surface, and not where it is.
fn overall_finding(median_difference: f64) -> Option<Finding> {
    (median_difference > single::CLOSE).then(|| {
        let message = format!(
            "expected depths that agree to {:.1e} where views see the same surface, found \
             {median_difference:.1e} (median over pairs, relative): depths or cameras are rough",
            single::CLOSE
        );
        Finding::advice("depths-disagree", "all views", message)
    })
}

/// What was found of pairs, and how many points each view has, by id.
type OfPairs = (Vec<PairCheck>, BTreeMap<u32, usize>);

/// Carries every view's depth into its listed source views.
fn check_pairs(
    folder: &BlendedFolder,
    scene: &Scene,
    options: &VerifyOptions,
    progress: &dyn Progress,
) -> Result<OfPairs> {
    progress.begin(
        "carrying depth into source views",
        scene.views().len() as u64,
    );
    let checked = parallel::try_map(scene.views().len(), |index| {
        progress.check()?;
        progress.advance(1);
        let Some(reference) = read(folder, &scene.views()[index]) else {
            return Ok((Vec::new(), None));
        };
        let points = grid(&reference.depth, options.points);
        let sources = scene.sources_of(index).iter().filter_map(|source| {
            let view = &scene.views()[scene.index_of(source.id)?];
            Some(check_pair(&reference, &points, &read(folder, view)?))
        });
        let count = (reference.view.id, points.len());
        Ok((sources.collect::<Vec<_>>(), Some(count)))
    })?;
    let (pairs, counts): (Vec<_>, Vec<_>) = checked.into_iter().unzip();
    let counts = counts.into_iter().flatten();
    Ok((pairs.into_iter().flatten().collect(), counts.collect()))
}

fn check_pair(reference: &Seen, points: &[(DVec2, f32)], source: &Seen) -> PairCheck {
    let all = carry(
        (&reference.view, points),
        (&source.view, &source.depth),
        AS_IS,
    );
    let same: Vec<_> = all
        .iter()
        .filter(|(_, _, carried)| agrees(carried))
        .collect();
    let mut differences: Vec<f64> = same.iter().map(|(_, _, c)| c.difference.abs()).collect();
    differences.sort_unstable_by(f64::total_cmp);
    let at = |fraction: f64| {
        let index = (fraction * differences.len() as f64) as usize;
        differences
            .get(index.min(differences.len().saturating_sub(1)))
            .copied()
            .unwrap_or(0.0)
    };
    let pixels = || same.iter().map(|(from, _, carried)| (*from, carried.pixel));
    let images = reference.image.as_ref().zip(source.image.as_ref());
    PairCheck {
        reference: reference.view.id,
        source: source.view.id,
        in_frame: all.len(),
        agree: same.len(),
        in_front: all
            .iter()
            .filter(|(_, _, carried)| carried.in_front)
            .count(),
        median_difference: at(0.5),
        worst_difference: at(0.999),
        color_difference: images
            .and_then(|images| median(color_differences(images, pixels())))
            .unwrap_or(0.0),
        color_correlation: images.and_then(|images| images::correlation(images, pixels())),
        color_peak: images.and_then(|images| images::is_peak(images, pixels())),
        color_shift: images.and_then(|images| shifts::shift(images, pixels())),
    }
}

/// Mean absolute colour difference between pixels of two images.
fn color_differences(
    (first, second): (&ColorImage, &ColorImage),
    pixels: impl Iterator<Item = (DVec2, DVec2)>,
) -> Vec<f64> {
    let difference = |(from, to): (DVec2, DVec2)| {
        let a = first.get(from.x as u32, from.y as u32);
        let b = second.get(to.x as u32, to.y as u32);
        (0..3).map(|c| f64::from(a[c].abs_diff(b[c]))).sum::<f64>() / 3.0
    };
    pixels.map(difference).collect()
}

/// A listed pair that shares no surface.
fn pair_finding(pair: &PairCheck) -> Option<Finding> {
    let place = format!("view {} and source {}", pair.reference, pair.source);
    if pair.in_frame >= FEW && pair.agree * 50 < pair.in_frame {
        let message = format!(
            "expected a source view that sees the same surface, found {} of {} points that agree",
            pair.agree, pair.in_frame
        );
        return Some(Finding::fault("pair-without-overlap", place, message));
    }
    None
}

/// How well a reading makes the views agree: agreeing points over their median difference.
fn merit(
    scene: &Scene,
    judged: &BTreeMap<usize, Seen>,
    reading: Reading,
    points: u32,
) -> Result<(f64, f64)> {
    let views: BTreeMap<usize, View> = judged
        .iter()
        .map(|(&index, seen)| Ok((index, reading.view(&seen.view)?)))
        .collect::<Result<_>>()?;
    let references: Vec<usize> = judged.keys().copied().collect();
    let differences = parallel::map(references.len(), |i| {
        let index = references[i];
        let grid = grid(&judged[&index].depth, points);
        let others = references.iter().filter(|&&other| other != index);
        let listed = others.filter(|&&other| {
            let id = scene.views()[other].id;
            let few = references.len() <= 8;
            few || scene.sources_of(index).iter().any(|source| source.id == id)
                || other.abs_diff(index) <= scene.views().len().div_ceil(8)
        });
        let differences = listed.flat_map(|&other| {
            carry(
                (&views[&index], &grid),
                (&views[&other], &judged[&other].depth),
                (reading, reading),
            )
        });
        let agreeing = differences.filter(|(_, _, carried)| agrees(carried));
        agreeing
            .map(|(_, _, carried)| carried.difference.abs())
            .collect::<Vec<_>>()
    });
    let differences: Vec<f64> = differences.into_iter().flatten().collect();
    let count = differences.len() as f64;
    let difference = median(differences).unwrap_or(SAME_SURFACE);
    Ok((count / difference.max(FLOOR), difference))
}

/// Whether another reading of cameras or depths makes the views agree much better.
fn judge_readings(
    scene: &Scene,
    judged: &BTreeMap<usize, Seen>,
    options: &VerifyOptions,
) -> Option<Finding> {
    let points = (options.points / 4).max(50);
    let merit_of = |reading| merit(scene, judged, reading, points).ok();
    let (as_is, difference) = merit_of(Reading::AsIs)?;
    let others = Reading::all().into_iter().skip(1);
    let judged = others.filter_map(|reading| Some((merit_of(reading)?, reading)));
    let best = judged.max_by(|a, b| a.0.0.total_cmp(&b.0.0));
    if let Some(((merit, better), reading)) = best
        && merit > 2.0 * as_is
    {
        let message = format!(
            "{}; the views then agree to {better:.2e} (median, relative), as they are to \
             {difference:.2e}",
            reading.advice()
        );
        return Some(Finding::fault(reading.code(), "all views", message));
    }
    (as_is == 0.0 && judged_enough(scene)).then(|| {
        let message = "expected depths that agree where views see the same surface, found none \
                       that do, under any known convention";
        Finding::fault("no-agreement", "all views", message)
    })
}

fn judged_enough(scene: &Scene) -> bool {
    scene.views().len() >= 2
}
