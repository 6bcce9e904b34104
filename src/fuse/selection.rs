//! Merrell's selection over a reference view: opinions gathered, one depth kept per pixel.

use super::counts::FuseCounts;
use super::geometry::PairGeometry;
use super::merrell::{Opinion, Rendered, center, most_confident, nearest_stable, seen_through};
use super::options::{FuseOptions, Visibility};
use super::samples::{PixelFilter, Samples};
use std::ops::Range;
use std::sync::Arc;

/// A view's confidences, row-major; empty where every pixel has 1.
pub(super) type Confidences = Vec<f32>;

/// All that speaks about a reference view.
pub(super) struct Selection<'a> {
    pub(super) own: &'a Samples,
    pub(super) own_confidences: Arc<Confidences>,
    /// Which of the reference's pixels and depths are wanted at all.
    pub(super) filter: PixelFilter,
    pub(super) sources: Vec<Witness>,
    pub(super) options: &'a FuseOptions,
}

/// A source, seen from the reference.
pub(super) struct Witness {
    pub(super) pair: PairGeometry,
    pub(super) samples: Arc<Samples>,
    pub(super) confidences: Arc<Confidences>,
    pub(super) rendered: Rendered,
}

/// Negative ones are none: they are added and subtracted as weights.
fn confidence(all: &Confidences, pixel: usize) -> f32 {
    all.get(pixel).copied().unwrap_or(1.0).max(0.0)
}

impl Selection<'_> {
    /// The selected depths of `rows`, as stored values row-major.
    pub(super) fn select(&self, rows: Range<usize>) -> (Vec<f32>, FuseCounts) {
        let width = self.own.width();
        let mut stored = Vec::with_capacity(rows.len() * width);
        let mut counts = FuseCounts::default();
        let mut opinions = Vec::with_capacity(self.sources.len() + 1);
        for row in rows {
            for column in 0..width {
                let had = self.own.get(column, row) > 0.0;
                let depth = match self.filter.wants(row * width + column) {
                    true => self.depth(column, row, &mut opinions),
                    false => None,
                };
                let depth = depth.filter(|&depth| self.filter.reaches(depth));
                let value = depth.map_or(0.0, |depth| self.own.unit().convert(depth));
                let has = value > 0.0;
                counts.inconsistent += u64::from(had && !has);
                counts.filled += u64::from(!had && has);
                stored.push(if has { value } else { 0.0 });
            }
        }
        (stored, counts)
    }

    fn depth(&self, column: usize, row: usize, opinions: &mut Vec<Opinion>) -> Option<f32> {
        let at = row * self.own.width() + column;
        opinions.clear();
        opinions.push(Opinion {
            depth: self.own.unit().convert(self.own.get(column, row)),
            confidence: confidence(&self.own_confidences, at),
        });
        opinions.extend(self.sources.iter().map(|source| Opinion {
            depth: source.rendered.depth[at],
            confidence: confidence(&source.confidences, source.rendered.from[at] as usize),
        }));
        #[allow(clippy::cast_possible_truncation, reason = "f32 is what depths are")]
        let tolerance = self.options.max_depth_error as f32;
        let violated = |source: usize, depth: f32| {
            let source = &self.sources[source];
            let pixel = center(column, row);
            let (ratio, from) =
                seen_through(&source.pair, &source.samples, pixel, f64::from(depth))?;
            let through = ratio * (1.0 - f64::from(tolerance)) > 1.0;
            through.then(|| confidence(&source.confidences, from))
        };
        if self.options.visibility == Visibility::MerrellStability {
            return nearest_stable(opinions, violated, tolerance);
        }
        #[allow(clippy::cast_possible_truncation, reason = "a threshold")]
        let support = self.options.min_support as f32;
        most_confident(opinions, violated, tolerance, support)
    }
}
