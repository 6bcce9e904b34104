//! The list of source views against what it could be.

use super::Finding;
use super::carry::{agrees, carry, grid};
use super::geometry::{AS_IS, Seen};
use crate::generate::PairOptions;
use crate::generate::pairs::angle_at;
use glam::DVec2;
use mvs_datasets::scene::Scene;
use std::collections::BTreeMap;

/// Whether the listed source views suit their references better than any others would, by the part of
/// what could be gained over others at random: in a compact array of cameras all are nearly as good.
pub(super) fn judge(scene: &Scene, judged: &BTreeMap<usize, Seen>) -> Option<Finding> {
    let options = PairOptions::default();
    let mut sums = Attained::default();
    for (&index, reference) in judged {
        let points = grid(&reference.depth, 300);
        let others = judged.iter().filter(|&(&other, _)| other != index);
        let scored = others.map(|(_, source)| {
            let listed = scene.sources_of(index).iter();
            let is_listed = listed.map(|s| s.id).any(|id| id == source.view.id);
            (score((reference, &points), source, &options), is_listed)
        });
        sums.add(scored.collect());
    }
    let (listed, mean, best) = sums.means();
    let enough = sums.listed_count >= 5 && sums.other_count >= 5;
    (enough && best > 1.2 * mean && listed - mean < 0.3 * (best - mean)).then(|| {
        let message = format!(
            "expected source views that see the same surface under a small angle, found a mean \
             score of {listed:.2} for those in pair.txt, {mean:.2} for any and {best:.2} for the best"
        );
        Finding::fault("shuffled-pairs", "cams/pair.txt", message)
    })
}

/// MVSNet's score of a pair, over the reference's points that both see.
fn score(
    (reference, points): (&Seen, &[(DVec2, f32)]),
    source: &Seen,
    options: &PairOptions,
) -> f64 {
    let carried = carry(
        (&reference.view, points),
        (&source.view, &source.depth),
        AS_IS,
    );
    let centers = (
        reference.view.pose.center_in_world(),
        source.view.pose.center_in_world(),
    );
    let same = carried.iter().filter(|(_, _, carried)| agrees(carried));
    same.map(|(_, at, _)| options.weight(angle_at(*at, centers)))
        .sum()
}

/// Sums over listed pairs: their scores, those of pairs at random, and of the best in their place.
#[derive(Default)]
struct Attained {
    listed_count: usize,
    other_count: usize,
    listed: f64,
    random: f64,
    best: f64,
}

impl Attained {
    /// Adds one reference's others: their scores, and whether they are listed.
    fn add(&mut self, mut scored: Vec<(f64, bool)>) {
        let listed = scored.iter().filter(|(_, listed)| *listed).count();
        self.listed_count += listed;
        self.other_count += scored.len() - listed;
        let sum = |scored: &[(f64, bool)]| scored.iter().map(|(score, _)| score).sum::<f64>();
        self.random += sum(&scored) * listed as f64 / scored.len().max(1) as f64;
        self.listed += scored.iter().filter(|s| s.1).map(|s| s.0).sum::<f64>();
        scored.sort_by(|a, b| b.0.total_cmp(&a.0));
        self.best += sum(&scored[..listed]);
    }

    /// Means over listed pairs: of theirs, at random, of the best.
    fn means(&self) -> (f64, f64, f64) {
        let count = self.listed_count.max(1) as f64;
        (self.listed / count, self.random / count, self.best / count)
    }
}
