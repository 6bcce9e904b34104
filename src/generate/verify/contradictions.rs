//! Points where another view sees through them: depths that are wrong on a part of a map.

use super::geometry::{FEW, PairCheck};
use super::{Finding, Severity};

// A point that lies behind what another view sees is hidden there; one in front of it would hide it. In 21 sound scenes
// (rendered; the real one at three sizes, the demo's, terrains) no point lies more than 1 % in front of all that is seen
// within two pixels, nor where all depths are rough by 0.6 %. (In front of what is seen at the pixel itself, up to 0.9 %
// of a pair's points do, 2.9 % in small images: edges fall beside it.) A view of the real one with a tenth of its depths a
// tenth too long has 4.5 to 7.6 %, with a quarter 21; left halves of all views that are 5 % too long, 16.
/// More than this fraction of points in front is a fault of the view.
const FAULT: f64 = 0.03;
/// More than this is worth knowing.
const ADVICE: f64 = 0.01;

/// A finding for each view too many of whose points lie in front of what others see, or that sees through too many
/// of theirs; the worst first, without whose pairs the next is looked for. One for the scene where those are more
/// than a quarter of all `views`. Views of `known` are left out: they have a finding already. Where depths are
/// `rough` everywhere it is advice.
pub(super) fn check(
    pairs: &[PairCheck],
    (views, known): (usize, &[u32]),
    rough: bool,
) -> Vec<Finding> {
    let without = |pair: &&PairCheck, view: u32| pair.reference != view && pair.source != view;
    let mut left: Vec<&PairCheck> = pairs.iter().collect();
    left.retain(|pair| known.iter().all(|&view| without(pair, view)));
    let mut found: Vec<(u32, f64)> = Vec::new();
    while let Some((view, share)) = worst(&left).filter(|(_, share)| *share > ADVICE) {
        found.push((view, share));
        left.retain(|pair| without(pair, view));
    }
    let finding = |(view, share): &(u32, f64)| (format!("view {view}"), *share);
    let placed: Vec<(String, f64)> =
        match (found.len() > 1 && found.len() * 4 > views, found.first()) {
            (true, Some((_, most))) => vec![("all views".to_owned(), *most)],
            _ => found.iter().map(finding).collect(),
        };
    let said = placed.into_iter().map(|(place, share)| {
        let message = format!(
            "expected no points in front of what other views see there, found {:.1} % of those in frame that lie \
             more than 1 % in front: depths are wrong on a part of the map, or of those of its partners",
            100.0 * share
        );
        let severity = match share > FAULT && !rough {
            true => Severity::Fault,
            false => Severity::Advice,
        };
        Finding::new(severity, "depths-contradict", place, message)
    });
    said.collect()
}

/// The view with the largest share of points in front, in either direction.
fn worst(pairs: &[&PairCheck]) -> Option<(u32, f64)> {
    let mut sums = std::collections::BTreeMap::<(u32, bool), (usize, usize)>::new();
    for pair in pairs {
        for side in [(pair.reference, true), (pair.source, false)] {
            let sum = sums.entry(side).or_default();
            *sum = (sum.0 + pair.in_front, sum.1 + pair.in_frame);
        }
    }
    let shares = sums.into_iter().filter(|(_, (_, all))| *all >= FEW);
    let shares = shares.map(|((view, _), (some, all))| (view, some as f64 / all as f64));
    shares.max_by(|a, b| a.1.total_cmp(&b.1))
}
