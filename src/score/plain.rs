//! The plain protocol: two clouds that share a frame, with a crop and a voxel grid where asked for.

use super::evaluation::{Evaluation, Judged, Side};
use super::points::{FinitePoints, Moved};
use crate::error::{Error, Result};
use glam::DMat4;
use mvs_datasets::scene::Aabb;
use mvs_metrics::crop::Prism;
use mvs_metrics::distance::BlockIndex;

/// What happens to both clouds before distances are taken.
#[derive(Debug, Clone, Default)]
pub struct Preparation {
    /// The region in which points are judged; all points without one.
    pub crop: Option<Prism>,
    /// Edge of the voxels over which points are averaged, in world units; every point counts
    /// without one. Each cloud's grid starts at its own corner, as in Open3D.
    pub voxel: Option<f64>,
}

impl Preparation {
    /// Crops and thins a cloud after moving it by `target_from_source`.
    ///
    /// # Errors
    /// As [`Moved::new`], and with voxels as [`Moved::voxels`].
    pub fn apply(&self, points: &FinitePoints, target_from_source: Option<DMat4>) -> Result<Side> {
        let kept = Moved::new(points, target_from_source, self.crop.as_ref())?;
        let judged = match self.voxel {
            Some(size) => {
                let found = BlockIndex::gathered(kept.len(), |take| kept.voxels(size, take))?;
                found.map_or(Judged::Listed(Vec::new()), Judged::Indexed)
            }
            None => Judged::Listed(kept.in_given_order()),
        };
        Ok(Side {
            input: points.input(),
            non_finite: points.non_finite(),
            cropped: kept.len(),
            points: judged,
            distances: Vec::new(),
        })
    }

    /// [`Preparation::apply`] to the truth, which must not end up empty.
    ///
    /// # Errors
    /// A truth of which no point is left; else as [`Preparation::apply`].
    pub fn apply_to_truth(&self, truth: &FinitePoints) -> Result<Side> {
        let side = self.apply(truth, None)?;
        if side.points.is_empty() {
            let input = truth.input();
            let problem = match &self.crop {
                Some(_) => format!(
                    "expected points of the truth inside the crop volume, found none of {input}: the \
                     truth spans {}; is it the crop file of this scene?",
                    span(&truth.bounds())
                ),
                None => format!("expected finite points, found {input} and none of them finite"),
            };
            return Err(Error::invalid("truth", problem));
        }
        Ok(side)
    }
}

/// A box as `min … max` for messages.
pub fn span(bounds: &Aabb) -> String {
    if bounds.is_empty() {
        return "nothing".to_owned();
    }
    let corner =
        |corner: glam::DVec3| format!("({:.4}, {:.4}, {:.4})", corner.x, corner.y, corner.z);
    format!("{} … {}", corner(bounds.min), corner(bounds.max))
}

/// Judges `reconstruction`, moved by `truth_from_reconstruction` where given, against `truth`.
///
/// A reconstruction without points left scores 0.
///
/// # Errors
/// A truth without points left to judge against; else as [`Preparation::apply`] and [`Evaluation::measure`].
pub fn evaluate(
    reconstruction: &FinitePoints,
    truth_from_reconstruction: Option<DMat4>,
    truth: &FinitePoints,
    preparation: &Preparation,
) -> Result<Evaluation> {
    let truth = preparation.apply_to_truth(truth)?;
    let reconstruction = preparation.apply(reconstruction, truth_from_reconstruction)?;
    Evaluation::measure(reconstruction, truth)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{DVec2, DVec3};
    use mvs_metrics::Tolerance;

    /// A square grid of `count`² points in the plane z = `height`, one unit apart.
    fn plane(count: u32, height: f64) -> FinitePoints {
        let at = |i: u32| DVec3::new(f64::from(i % count), f64::from(i / count), height);
        FinitePoints::new((0..count * count).map(at).collect())
    }

    #[test]
    fn two_planes_are_as_far_apart_as_their_heights() {
        let evaluation = evaluate(
            &plane(20, 0.25),
            None,
            &plane(20, 0.0),
            &Preparation::default(),
        )
        .unwrap();
        assert!(
            evaluation
                .reconstruction
                .distances
                .iter()
                .all(|&d| d == 0.25)
        );
        let f_at = |tau| evaluation.score(Tolerance::new(tau).unwrap()).f_score();
        assert_eq!((f_at(0.25), f_at(0.250_000_1)), (0.0, 1.0));
    }

    #[test]
    fn counts_follow_the_points_through_crop_and_voxels() {
        let square = [(-0.5, -0.5), (9.5, -0.5), (9.5, 9.5), (-0.5, 9.5)].map(DVec2::from);
        let preparation = Preparation {
            crop: Some(Prism::new(2, (-1.0, 1.0), &square).unwrap()),
            voxel: Some(2.0),
        };
        let mut positions = plane(20, 0.0).positions();
        positions.push(DVec3::NAN);
        let reconstruction = FinitePoints::new(positions);
        let shift = DMat4::from_translation(DVec3::new(0.0, 0.0, 0.5));
        let evaluation =
            evaluate(&reconstruction, Some(shift), &plane(20, 0.0), &preparation).unwrap();
        let (counts, _) = evaluation.counts(Tolerance::new(1.0).unwrap());
        // The grid starts one unit below the corner: voxels hold 1 + 2 + 2 + 2 + 2 + 1 columns.
        assert_eq!((counts.input, counts.non_finite), (401, 1));
        assert_eq!(
            (counts.cropped, counts.evaluated, counts.within),
            (100, 36, 36)
        );
    }

    #[test]
    fn a_truth_outside_the_crop_is_an_error_with_its_bounds() {
        let far = [(100.0, 100.0), (110.0, 100.0), (110.0, 110.0)].map(DVec2::from);
        let preparation = Preparation {
            crop: Some(Prism::new(2, (-1.0, 1.0), &far).unwrap()),
            voxel: None,
        };
        let error = evaluate(&plane(3, 0.0), None, &plane(3, 0.0), &preparation).unwrap_err();
        let error = error.to_string();
        assert!(
            error.contains("none of 9") && error.contains("(2.0000, 2.0000"),
            "{error}"
        );
    }
}
