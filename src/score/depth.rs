//! Depth maps against true ones: one row per view, and the scene's means.

use crate::error::Result;
use mvs_metrics::depth::{Alignment, DepthErrors, DepthFit, DepthPlanes, Limit};
use serde::Serialize;

/// What one view's maps say; all three of one size.
#[derive(Debug, Clone, Copy)]
pub struct DepthMapsOfView<'a> {
    /// True z-depth in world units, 0 = none.
    pub truth: &'a [f32],
    /// Estimated z-depth, 0 = none.
    pub estimate: &'a [f32],
    /// Larger is surer.
    pub confidence: Option<&'a [f32]>,
}

/// The numbers of one depth map, or means of them. Fractions are in [0, 1].
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct DepthScores {
    /// Mean |truth − estimate| in depth intervals.
    pub epe: Option<f64>,
    /// The fraction of estimates off by more than one interval; exactly one is good (the paper's
    /// code).
    pub above_1: Option<f64>,
    /// The same with exactly one counted as bad (others' code).
    pub at_least_1: Option<f64>,
    /// As `above_1` for three intervals.
    pub above_3: Option<f64>,
    /// As `at_least_1` for three intervals.
    pub at_least_3: Option<f64>,
    /// Mean |truth − estimate| in world units.
    pub absolute: Option<f64>,
    /// Mean |truth − estimate| / truth.
    pub absrel: Option<f64>,
    /// The fraction with max(truth / estimate, estimate / truth) < 1.03.
    pub inlier_1_03: Option<f64>,
    /// Of the pixels whose truth counts, the fraction that has an estimate.
    pub density: Option<f64>,
    /// Area under the sparsification error in depth intervals, from the confidence.
    pub ause: Option<f64>,
}

/// One view's row.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct DepthRow {
    /// The view's id.
    pub view: u32,
    /// Δ, world units.
    pub interval: f64,
    /// What aligned the estimate.
    pub fit: DepthFit,
    /// Pixels whose truth counts.
    pub counted: usize,
    /// Of those, the ones with an estimate.
    pub compared: usize,
    /// Whether there was no depth map: density is then 0, and there are no errors.
    pub missing: bool,
    /// The numbers.
    #[serde(flatten)]
    pub scores: DepthScores,
}

/// A scene's numbers.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct DepthScene {
    /// Whether views whose truth counts are missing. Errors are then means over the others, and say less than those of a
    /// method that dared them all; density is over all views. A view whose truth counts nowhere makes no
    /// means partial by itself: it is in no method's.
    pub partial: bool,
    /// The unweighted mean over the views that have the value: the published data-set value.
    pub mean_over_views: DepthScores,
    /// The mean weighted by compared pixels (`density`: by counted ones).
    pub mean_over_pixels: DepthScores,
}

impl DepthScores {
    /// The columns' names, in order.
    pub const NAMES: [&'static str; 10] = [
        "epe",
        "above_1",
        "at_least_1",
        "above_3",
        "at_least_3",
        "absolute",
        "absrel",
        "inlier_1_03",
        "density",
        "ause",
    ];

    /// The values in the order of [`DepthScores::NAMES`].
    pub fn values(&self) -> [Option<f64>; 10] {
        [
            self.epe,
            self.above_1,
            self.at_least_1,
            self.above_3,
            self.at_least_3,
            self.absolute,
            self.absrel,
            self.inlier_1_03,
            self.density,
            self.ause,
        ]
    }

    /// From values in the order of [`DepthScores::NAMES`].
    fn of_values(values: [Option<f64>; 10]) -> Self {
        Self {
            epe: values[0],
            above_1: values[1],
            at_least_1: values[2],
            above_3: values[3],
            at_least_3: values[4],
            absolute: values[5],
            absrel: values[6],
            inlier_1_03: values[7],
            density: values[8],
            ause: values[9],
        }
    }
}

impl DepthRow {
    /// Whether there is a depth map without a depth where the truth counts: it says as little as none.
    pub fn is_empty(&self) -> bool {
        !self.missing && self.says_nothing()
    }

    /// Whether truth counts and no depth is there.
    fn says_nothing(&self) -> bool {
        self.counted > 0 && self.compared == 0
    }
}

/// Scores one view, and gives the errors for a picture.
///
/// # Errors
/// Maps whose sizes differ.
pub fn score_view(
    view: u32,
    maps: &DepthMapsOfView<'_>,
    planes: &DepthPlanes,
    alignment: Alignment,
) -> Result<(DepthRow, DepthErrors)> {
    let fit = DepthFit::new(maps.truth, maps.estimate, planes, alignment)?;
    let errors = DepthErrors::aligned(maps.truth, maps.estimate, planes, &fit)?;
    let ause = match maps.confidence {
        Some(confidence) => errors.ause(confidence)?,
        None => None,
    };
    let scores = DepthScores {
        epe: errors.end_point(),
        above_1: errors.above(1.0, Limit::Good),
        at_least_1: errors.above(1.0, Limit::Bad),
        above_3: errors.above(3.0, Limit::Good),
        at_least_3: errors.above(3.0, Limit::Bad),
        absolute: errors.mean_absolute(),
        absrel: errors.mean_relative(),
        inlier_1_03: errors.inlier_ratio(),
        density: (errors.counted() > 0).then(|| errors.density()),
        ause,
    };
    let row = DepthRow {
        view,
        interval: planes.interval(),
        fit,
        counted: errors.counted(),
        compared: errors.compared(),
        missing: false,
        scores,
    };
    Ok((row, errors))
}

/// The row of a view without a depth map, and its errors, which are none.
///
/// # Errors
/// Never: what is missing counts as a map of the truth's size.
pub fn score_missing(
    view: u32,
    truth: &[f32],
    planes: &DepthPlanes,
) -> Result<(DepthRow, DepthErrors)> {
    let maps = DepthMapsOfView {
        truth,
        estimate: &vec![0.0; truth.len()],
        confidence: None,
    };
    let (row, errors) = score_view(view, &maps, planes, Alignment::None)?;
    let row = DepthRow {
        missing: true,
        ..row
    };
    Ok((row, errors))
}

/// The scene's means of its views' rows.
pub fn score_scene(rows: &[DepthRow]) -> DepthScene {
    let over_pixels = |row: &DepthRow, column: usize| match DepthScores::NAMES[column] {
        "density" => row.counted as f64,
        _ => row.compared as f64,
    };
    DepthScene {
        partial: rows.iter().any(DepthRow::says_nothing),
        mean_over_views: weighted(rows, |_, _| 1.0),
        mean_over_pixels: weighted(rows, over_pixels),
    }
}

fn weighted(rows: &[DepthRow], weight: impl Fn(&DepthRow, usize) -> f64) -> DepthScores {
    DepthScores::of_values(std::array::from_fn(|column| {
        let (mut sum, mut weights) = (0.0, 0.0);
        for row in rows {
            if let Some(value) = row.scores.values()[column] {
                sum += weight(row, column) * value;
                weights += weight(row, column);
            }
        }
        (weights > 0.0).then(|| sum / weights)
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn means_by_hand() {
        let planes = DepthPlanes::new(1.0, 9.0, 8).unwrap(); // Δ = 1: 2 < depth ≤ 7 counts
        let row = |view, truth: &[f32], estimate: &[f32], confidence: Option<&[f32]>| {
            let maps = DepthMapsOfView {
                truth,
                estimate,
                confidence,
            };
            score_view(view, &maps, &planes, Alignment::None).unwrap().0
        };
        let rows = [
            // Errors 0, 1, 2; one without an estimate.
            row(
                3,
                &[4.0; 4],
                &[4.0, 5.0, 6.0, 0.0],
                Some(&[3.0, 2.0, 1.0, 0.0]),
            ),
            row(5, &[4.0, 9.0], &[8.0, 8.0], None),
            row(9, &[0.0, 9.0], &[8.0, 8.0], None),
        ];
        let found = rows[0].scores;
        assert_eq!(
            (found.epe, found.absolute, found.absrel),
            (Some(1.0), Some(1.0), Some(0.25))
        );
        assert_eq!(
            (found.above_1, found.at_least_1),
            (Some(1.0 / 3.0), Some(2.0 / 3.0))
        );
        assert_eq!((found.above_3, found.at_least_3), (Some(0.0), Some(0.0)));
        assert_eq!((found.density, found.ause), (Some(0.75), Some(0.0)));
        assert_eq!((rows[0].counted, rows[0].compared), (4, 3));
        let scene = score_scene(&rows);
        // The view without truth has no say; errors (0 + 1 + 2) / 3 and 4 / 1.
        assert_eq!(scene.mean_over_views.epe, Some(2.5));
        assert_eq!(scene.mean_over_pixels.epe, Some(7.0 / 4.0));
        assert_eq!(scene.mean_over_views.density, Some(0.875));
        assert_eq!(scene.mean_over_pixels.density, Some(4.0 / 5.0));
        assert_eq!(scene.mean_over_views.ause, Some(0.0));
        assert!(!scene.partial);
        let missing = score_missing(11, &[4.0, 9.0], &planes).unwrap().0;
        assert!(missing.missing && missing.scores.epe.is_none());
        let scene = score_scene(&[rows[0].clone(), rows[1].clone(), missing]);
        assert!(scene.partial);
        // Of 4 + 1 + 1 true depths, 3 + 1 have an estimate; errors are those of the others.
        assert_eq!(scene.mean_over_views.density, Some((0.75 + 1.0) / 3.0));
        assert_eq!(scene.mean_over_pixels.density, Some(4.0 / 6.0));
        assert_eq!(scene.mean_over_views.epe, Some(2.5));
        assert_eq!(DepthScores::of_values(found.values()), found);
    }
}
