//! One view against all others: the fault of a single camera or depth map.

use super::carry::{SMOOTH, agrees, carry, grid};
use super::geometry::{FEW, FLOOR, PairCheck, Seen, read};
use super::reading::Reading;
use super::{Finding, Severity, VerifyOptions, median, quarter};
use glam::DVec2;
use mvs_datasets::layout::blended::BlendedFolder;
use mvs_datasets::scene::{DepthMap, Scene, View};
use std::collections::BTreeMap;

/// Depths of rendered scenes agree to less than this fraction; more is rough, or wrong.
pub(super) const CLOSE: f64 = 1e-3;

// What a view by itself is judged by. Its difference is that of the best quarter of its pairs, which a sound
// view has with sound partners, against the scene's, of the best quarter of all pairs. On 40 sound scenes of
// 96x72 to 768x576 pixels (a real one at four sizes, rendered, and with the depth that a program estimated
// for it; the demo's; terrains of fine and of smooth relief seen from near, far and at grazing angles) no
// view has more than 2.1 times the scene's, but for one that stands twelve times as far away as all others:
// 8.3. On the real scene, by view, one principal point that is off by half a pixel makes it 36 to 133 times,
// one focal length that is a per cent too long 107 to 167, 0.2 per cent 35, a depth map moved by a pixel 59, a
// yaw of 0.1 degree 85 to 103, depths of 16 bits 36.
/// A view at fault agrees at least so many times worse than all do.
const WORSE: f64 = 3.0;
/// One that agrees so many times worse is worth knowing by itself.
const MUCH_WORSE: f64 = 10.0;
/// No sound scene comes near this.
const FAR_WORSE: f64 = 30.0;
/// In pixels: a view that is moved by this much is at fault, one that is moved by less than a tenth of it
/// differs by what interpolation and the rounding of its numbers make.
const MOVED: f64 = 1.0 / 3.0;
/// Per pixel: where depth changes by less, the relative difference says more than one in pixels.
const LEAST_SLOPE: f64 = 3e-4;
/// Cameras and depths of few digits agree so.
const ROUNDED: f64 = 1e-5;

/// A finding for each view that agrees with the others nowhere, or worse than they do with each other
/// (`level`: the median relative difference of the best quarter of all pairs): a fault where it is large,
/// advice where it is small. `points` says how many points each view has.
pub(super) fn check(
    (folder, scene): (&BlendedFolder, &Scene),
    (pairs, points): (&[PairCheck], &BTreeMap<u32, usize>),
    level: f64,
    options: &VerifyOptions,
) -> Vec<Finding> {
    let views = scene.views().iter();
    let finding = |view: &View| {
        let own = |pair: &&PairCheck| pair.reference == view.id || pair.source == view.id;
        let own: Vec<&PairCheck> = pairs.iter().filter(own).collect();
        let points = *points.get(&view.id)?;
        let (severity, found) = nowhere(&own, points).or_else(|| {
            let difference = difference_of(&own, points).filter(|&d| d > WORSE * level)?;
            let slope = slope(&read(folder, view)?.depth, options.points);
            let moved = difference / slope.max(LEAST_SLOPE);
            worse(difference, moved, level)
        })?;
        let partners = own.iter().map(|pair| match pair.reference == view.id {
            true => pair.source,
            false => pair.reference,
        });
        let mut partners: Vec<u32> = partners.collect();
        partners.sort_unstable();
        partners.dedup();
        let advice = better_reading((folder, scene), (view, &partners), options);
        let message = match advice {
            Some(advice) => format!("{found}: {advice}"),
            None => format!("{found}: its camera or its depth is wrong"),
        };
        let place = format!("view {}", view.id);
        Some(Finding::new(severity, "view-does-not-fit", place, message))
    };
    views.filter_map(finding).collect()
}

/// The complaint of a view of so many `points` that agrees with no other, by its pairs in either direction.
fn nowhere(own: &[&PairCheck], points: usize) -> Option<(Severity, String)> {
    let agree: usize = own.iter().map(|pair| pair.agree).sum();
    (!own.is_empty() && points >= FEW && agree * 50 < points).then(|| {
        let message = format!(
            "expected depth that agrees with other views, found {agree} points in {} pairs that do, \
             of {points} in the view",
            own.len()
        );
        (Severity::Fault, message)
    })
}

/// The difference of the best quarter of a view's pairs that agree; none where too little is seen of it.
fn difference_of(own: &[&PairCheck], points: usize) -> Option<f64> {
    let agreeing = own.iter().filter(|pair| pair.agree >= FEW);
    quarter(agreeing.map(|pair| pair.median_difference).collect()).filter(|_| points >= FEW)
}

/// The complaint of a view whose depths differ by `difference` (relative), as if it were `moved` by so many
/// pixels, where all differ by `level`. At fault is one that is worse in two of three ways: by itself, in
/// pixels, against the others.
pub(super) fn worse(difference: f64, moved: f64, level: f64) -> Option<(Severity, String)> {
    let against_others = difference > (FAR_WORSE * level).max(ROUNDED);
    let bad = [difference > CLOSE, moved > MOVED, against_others];
    let severity = if bad.iter().filter(|&&bad| bad).count() >= 2 && difference > WORSE * level {
        Severity::Fault
    } else if against_others
        || (difference > (MUCH_WORSE * level).max(ROUNDED) && moved > 0.1 * MOVED)
    {
        Severity::Advice
    } else {
        return None;
    };
    let message = format!(
        "expected depths that agree with other views as theirs do, to {level:.1e}, found \
         {difference:.1e} (median of the best quarter of pairs, relative), as if moved by {moved:.2} pixels"
    );
    Some((severity, message))
}

/// By what fraction depth changes from a pixel to the next: the median over about `points` smooth places;
/// 0 where there are none.
fn slope(depth: &DepthMap, points: u32) -> f64 {
    let (width, height) = depth.size();
    let slopes = grid(depth, points)
        .into_iter()
        .filter_map(|(pixel, value)| {
            let (column, row) = (pixel.x as u32, pixel.y as u32);
            if column + 1 >= width || row + 1 >= height {
                return None;
            }
            let next = DVec2::new(
                depth.get(column + 1, row).into(),
                depth.get(column, row + 1).into(),
            );
            let change = (next / f64::from(value) - 1.0).abs();
            (change.max_element() < SMOOTH).then(|| change.length())
        });
    median(slopes.collect()).unwrap_or(0.0)
}

/// What to do if another reading of this view alone makes it agree with its partners.
fn better_reading(
    (folder, scene): (&BlendedFolder, &Scene),
    (view, partners): (&View, &[u32]),
    options: &VerifyOptions,
) -> Option<String> {
    let seen = read(folder, view)?;
    let partners = partners.iter().filter_map(|&id| {
        let index = scene.index_of(id)?;
        read(folder, &scene.views()[index])
    });
    let partners: Vec<Seen> = partners.collect();
    let merit_of = |reading: Reading| merit(&seen, &partners, (reading, options.points / 4));
    let (as_is, _) = merit_of(Reading::AsIs).unwrap_or_default();
    let judged = Reading::all().into_iter().skip(1);
    let judged = judged.filter_map(|reading| Some((merit_of(reading)?, reading)));
    let ((merit, difference), reading) = judged.max_by(|a, b| a.0.0.total_cmp(&b.0.0))?;
    (merit > 2.0 * as_is && difference < CLOSE).then(|| {
        let advice = reading.advice();
        format!("{advice}; it then agrees to {difference:.2e}")
    })
}

/// How well a reading of one view makes it agree with its partners as they are: agreeing points, in
/// both directions, over their median difference; and that difference.
fn merit(seen: &Seen, partners: &[Seen], (reading, points): (Reading, u32)) -> Option<(f64, f64)> {
    let view = reading.view(&seen.view).ok()?;
    let own = grid(&seen.depth, points);
    let mut differences = Vec::new();
    for partner in partners {
        let there = grid(&partner.depth, points);
        let out = carry(
            (&view, &own),
            (&partner.view, &partner.depth),
            (reading, Reading::AsIs),
        );
        let back = carry(
            (&partner.view, &there),
            (&view, &seen.depth),
            (Reading::AsIs, reading),
        );
        let all = out.iter().chain(&back).map(|(_, _, carried)| carried);
        let agreeing = all.filter(|carried| agrees(carried));
        differences.extend(agreeing.map(|carried| carried.difference.abs()));
    }
    let count = differences.len();
    let difference = median(differences).filter(|_| count >= FEW)?;
    Some((count as f64 / difference.max(FLOOR), difference))
}
