//! Source views from the points of a sparse model, by MVSNet's score.

use super::pairs::{PairOptions, angle_at};
use crate::error::Result;
use glam::DVec3;
use mvs_datasets::scene::{SourceScore, View};
use std::collections::BTreeMap;

/// Source views of each view: those with the highest sum of [`PairOptions::weight`] over the points
/// that both saw, at most `options.sources`, best first, equal scores by ascending id. Never the view
/// itself, never a score of 0. A view without any is nobody's source either.
///
/// `seen` has per view the places in `points` (world) of those it saw, each once.
///
/// # Errors
/// Options without a point or a source view, an angle that is not finite, and a standard deviation that is not finite
/// and above 0.
pub fn sparse_sources(
    views: &[View],
    (points, seen): (&[DVec3], &[Vec<usize>]),
    options: &PairOptions,
) -> Result<Vec<Vec<SourceScore>>> {
    options.check()?;
    let centers: Vec<DVec3> = views
        .iter()
        .map(|view| view.pose.center_in_world())
        .collect();
    let mut seen_by: Vec<Vec<usize>> = vec![Vec::new(); points.len()];
    for (view, seen) in seen.iter().enumerate() {
        for &point in seen {
            seen_by[point].push(view);
        }
    }
    let mut scores: Vec<BTreeMap<usize, f64>> = vec![BTreeMap::new(); views.len()];
    for (&point, seen_by) in points.iter().zip(&seen_by) {
        for (place, &first) in seen_by.iter().enumerate() {
            for &second in &seen_by[place + 1..] {
                let weight = options.weight(angle_at(point, (centers[first], centers[second])));
                *scores[first].entry(second).or_default() += weight;
                *scores[second].entry(first).or_default() += weight;
            }
        }
    }
    let best = |scores: BTreeMap<usize, f64>| {
        let sources = scores.into_iter().map(|(other, score)| SourceScore {
            id: views[other].id,
            score,
        });
        let mut sources: Vec<_> = sources.filter(|source| source.score > 0.0).collect();
        sources.sort_by(|a, b| b.score.total_cmp(&a.score).then(a.id.cmp(&b.id)));
        sources.truncate(options.sources);
        sources
    };
    Ok(scores.into_iter().map(best).collect())
}
