//! One view against all others: the fault of a single camera or depth map.

use super::carry::{agrees, carry, grid};
use super::geometry::{FEW, FLOOR, PairCheck, Seen, read};
use super::reading::Reading;
use super::{Finding, VerifyOptions, median};
use mvs_datasets::layout::blended::BlendedFolder;
use mvs_datasets::scene::{Scene, View};
use std::collections::BTreeMap;

/// Depths of rendered scenes agree to less than this fraction; more is rough, or wrong.
pub(super) const CLOSE: f64 = 1e-3;
/// A view by itself is at fault when it agrees so many times worse than all do.
const WORSE: f64 = 3.0;

/// A fault for each view that agrees with the others nowhere, or only roughly where they agree closely
/// (`overall`: median relative difference over pairs). `points` says how many points each view has.
pub(super) fn check(
    (folder, scene): (&BlendedFolder, &Scene),
    (pairs, points): (&[PairCheck], &BTreeMap<u32, usize>),
    overall: f64,
    options: &VerifyOptions,
) -> Vec<Finding> {
    let views = scene.views().iter();
    let finding = |view: &View| {
        let own = |pair: &&PairCheck| pair.reference == view.id || pair.source == view.id;
        let own: Vec<&PairCheck> = pairs.iter().filter(own).collect();
        let found = complaint(&own, *points.get(&view.id)?, overall)?;
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
        Some(Finding::fault(
            "view-does-not-fit",
            format!("view {}", view.id),
            message,
        ))
    };
    views.filter_map(finding).collect()
}

/// What is wrong with a view of so many `points` by its pairs, in either direction.
fn complaint(own: &[&PairCheck], points: usize, overall: f64) -> Option<String> {
    if own.is_empty() || points < FEW {
        return None;
    }
    let agree: usize = own.iter().map(|pair| pair.agree).sum();
    if agree * 50 < points {
        return Some(format!(
            "expected depth that agrees with other views, found {agree} points in {} pairs that do, \
             of {points} in the view",
            own.len()
        ));
    }
    let agreeing = own.iter().filter(|pair| pair.agree >= FEW);
    let differences = agreeing.map(|pair| pair.median_difference).collect();
    let difference = median(differences).filter(|&d| d > CLOSE && d > WORSE * overall)?;
    Some(format!(
        "expected depths that agree with other views as theirs do, to {overall:.1e}, found \
         {difference:.1e} (median over pairs, relative)"
    ))
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
