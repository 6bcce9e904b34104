//! The depth range of a view from its rendered depth.

use super::order::{self, Extent};
use crate::error::{Error, Result};
use mvs_datasets::scene::{DepthMap, DepthRange};
use serde::{Deserialize, Serialize};

/// Number of depth hypotheses that BlendedMVS divides a range into.
pub const HYPOTHESES: u32 = 128;

/// How a depth range is chosen.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum RangeRule {
    /// From the 1st to the 99th percentile, as MVSNet's converter: `zs[int(.01 n)]`,
    /// `zs[int(.99 n)]` of the ascending depths.
    #[default]
    Percentile,
    /// From the smallest to the largest depth.
    Full,
    /// Wide enough that no depth is lost to readers that, like MVSNet, keep only truth in
    /// (min + Δ, min + 126·Δ] with Δ = (max − min) / 128. That is possible while the largest depth is
    /// below about 124 times the smallest: no range starts below 0.
    Widened,
}

/// The range of `depth` by `rule`, then made longer by the fraction `margin` (≥ 0) of its length at
/// either end. `None` where there is no depth. Always above 0 and not empty.
///
/// # Errors
/// A `margin` that is not finite and at least 0, or so large that the range has no end.
pub fn depth_range(depth: &DepthMap, rule: RangeRule, margin: f64) -> Result<Option<DepthRange>> {
    let Some(extent) = order::extent(depth) else {
        return check_margin(margin).map(|()| None);
    };
    range_within(depth, extent, rule, margin).map(Some)
}

pub(super) fn check_margin(margin: f64) -> Result<()> {
    if !(margin.is_finite() && margin >= 0.0) {
        let problem = format!("expected a finite fraction of at least 0, found {margin}");
        return Err(Error::invalid("range margin", problem));
    }
    Ok(())
}

/// [`depth_range`] of depths whose extent is known.
pub(super) fn range_within(
    depth: &DepthMap,
    extent: Extent,
    rule: RangeRule,
    margin: f64,
) -> Result<DepthRange> {
    check_margin(margin)?;
    let (low, high) = match rule {
        RangeRule::Percentile => percentiles(depth, extent.count),
        RangeRule::Full | RangeRule::Widened => (extent.smallest, extent.largest),
    };
    let (low, high) = not_empty(f64::from(low), f64::from(high));
    let length = high - low;
    let (min, max) = match rule {
        RangeRule::Widened => widened(low, high),
        _ => (low, high),
    };
    let min = (min - margin * length).max(low / f64::from(HYPOTHESES));
    Ok(DepthRange::new(min, max + margin * length)?)
}

/// The depths at indices int(.01 n) and int(.99 n) of the n ≥ 1 ascending ones.
fn percentiles(depth: &DepthMap, count: usize) -> (f32, f32) {
    #[allow(
        clippy::cast_precision_loss,
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "a fraction of a count is a count"
    )]
    let index = |fraction: f64| (fraction * count as f64) as usize;
    let [low, high] = order::at_ranks(depth, count, [index(0.01), index(0.99)]);
    (low, high)
}

/// A range that is not empty even for a surface at one depth.
fn not_empty(low: f64, high: f64) -> (f64, f64) {
    let half = 1e-3 * low;
    if high - low < half {
        (low - half, high + half)
    } else {
        (low, high)
    }
}

/// `low` and `high` two and three intervals inside the range.
fn widened(low: f64, high: f64) -> (f64, f64) {
    let interval = (high - low) / f64::from(HYPOTHESES - 5);
    (low - 2.0 * interval, high + 3.0 * interval)
}

/// How many depths a reader of the BlendedMVS kind keeps: those in (min + Δ, min + 126·Δ].
pub fn kept_by_readers(depth: &DepthMap, range: &DepthRange) -> usize {
    let interval = range.interval(HYPOTHESES);
    order::count_within(
        depth,
        (range.min() + interval, range.min() + 126.0 * interval),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    fn map(values: Vec<f32>) -> DepthMap {
        DepthMap::from_values(values.len() as u32, 1, values)
            .unwrap()
            .0
    }

    fn range(depth: &DepthMap, rule: RangeRule, margin: f64) -> (f64, f64) {
        let range = depth_range(depth, rule, margin).unwrap().unwrap();
        (range.min(), range.max())
    }

    #[test]
    fn percentiles_are_taken_at_truncated_indices() {
        // 250 depths in falling order and as many pixels without one: int(2.5) = 2, int(247.5) = 247.
        let depths = (0..500).map(|i| if i < 250 { 250.0 - i as f32 } else { 0.0 });
        let depth = map(depths.collect());
        assert_eq!(range(&depth, RangeRule::Percentile, 0.0), (3.0, 248.0));
        assert_eq!(range(&depth, RangeRule::Full, 0.0), (1.0, 250.0));
        let (min, max) = range(&depth, RangeRule::Percentile, 0.01);
        assert!((min - 0.55).abs() < 1e-12 && (max - 250.45).abs() < 1e-12);
    }

    #[test]
    fn percentiles_are_those_of_sorted_values() {
        for count in 1..300u32 {
            let depths = (0..count).map(|i| ((i * 7919) % 311) as f32 * 0.37 + 0.1);
            let mut sorted: Vec<f32> = depths.collect();
            let depth = map(sorted.clone());
            sorted.sort_by(f32::total_cmp);
            let at = |fraction: f64| f64::from(sorted[(fraction * f64::from(count)) as usize]);
            let expected = not_empty(at(0.01), at(0.99));
            assert_eq!(
                range(&depth, RangeRule::Percentile, 0.0),
                expected,
                "{count}"
            );
        }
    }

    #[test]
    fn a_widened_range_loses_no_depth_and_the_percentiles_do() {
        let depth = map((0..1000).map(|i| 2.0 + i as f32 * 1e-3).collect());
        let kept = |rule| {
            let range = depth_range(&depth, rule, 0.0).unwrap().unwrap();
            kept_by_readers(&depth, &range)
        };
        assert_eq!(kept(RangeRule::Widened), 1000);
        assert!(kept(RangeRule::Percentile) < 980);
        assert!(kept(RangeRule::Full) < 1000);
    }

    #[test]
    fn ranges_are_positive_and_not_empty() {
        let flat = range(&map(vec![2.0; 9]), RangeRule::Percentile, 0.0);
        assert!(flat.0 < 2.0 && flat.1 > 2.0, "{flat:?}");
        let deep = range(&map(vec![0.001, 1000.0]), RangeRule::Widened, 5.0);
        assert!(deep.0 > 0.0, "{deep:?}");
        assert_eq!(
            depth_range(&map(vec![0.0; 4]), RangeRule::Full, 0.0).unwrap(),
            None
        );
        assert!(depth_range(&map(vec![1.0]), RangeRule::Full, f64::NAN).is_err());
    }
}
