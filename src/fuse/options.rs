//! Everything that decides which points come out, as one flat set that is printed whole.

use crate::error::{Error, Result};
use serde::{Deserialize, Serialize};

/// How depth maps are fused. The default is `hkust` with generic values; [`super::presets`] has
/// each mode's own and the named ones.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FuseOptions {
    /// Which procedure.
    pub mode: FuseMode,
    /// `hkust`: how the first pass picks one depth among what several views say.
    pub visibility: Visibility,
    /// At most so many source views per reference view; 0 for all that are listed.
    pub max_sources: usize,
    /// Where there is confidence, pixels below this one are left out, and in the modes whose published scripts keep
    /// what lies above (`hkust`, `geo`, `dynamic`) those at it, unless it is 0.
    pub min_confidence: f64,
    /// Instead of `min_confidence`: the fraction of each view's pixels with a depth (in range and in the mask), the
    /// least confident ones, that is left out; 0 for none. For confidences whose scale is unknown.
    pub confidence_quantile: f64,
    /// Largest reprojection error in pixels; strict but in `cluster`, which as COLMAP takes what has it exactly.
    pub max_pixel_error: f64,
    /// Largest relative depth error; strict but in `cluster`.
    pub max_depth_error: f64,
    /// Beyond this angle in degrees between two views of a point the bound on the pixel error grows
    /// with the tangent, so that it means the same relative depth error as at this angle; 0 for a
    /// fixed bound. The default is chosen in `reports/2026-11-25-tradeoff`.
    pub wide_angle: f64,
    /// A point needs so many source views that agree, the reference view not counted. `dynamic`
    /// has its own rule. `cluster` counts pixels: it needs one more than this.
    pub min_sources: usize,
    /// Lower `min_sources` to ⌈0.6 · available sources⌉ where that is less, never under 2. And where
    /// hardly anybody sees a point, let two sources do that agree within half the bounds: every
    /// other one has it beyond its image by half a pixel or more, or sees something in front of it;
    /// up to two may have no depth there.
    pub soften: bool,
    /// How a source's depth map is sampled between pixel centres.
    pub sampling: Sampling,
    /// `valid` sampling: only pixels within this fraction of the expected depth count.
    pub similar_depth: f64,
    /// Leave out points that more views see through than agree with.
    pub guard: bool,
    /// `gipuma`: largest difference in pixels of pseudo-disparities, strict.
    pub max_disparity_error: f64,
    /// `cluster`: largest angle in degrees between the normals of two pixels of a point.
    pub max_normal_angle: f64,
    /// Merrell's confidence variant: the fused confidence that a depth must exceed.
    pub min_support: f64,
    /// Where a point's colour comes from.
    pub colors: Colors,
    /// Estimate normals where none are given.
    pub normals: bool,
    /// Depths outside of this range are left out; a `max_depth` of 0 stands for no limit.
    pub min_depth: f64,
    /// See `min_depth`.
    pub max_depth: f64,
    /// Leave out depths outside of the range that the view's camera file states.
    pub view_range: bool,
    /// Points outside of this box (smallest corner, largest corner; world units) are left out.
    pub bounds: Option<[[f64; 3]; 2]>,
}

/// The fusion procedure.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum FuseMode {
    /// The BlendedMVS paper's: confidence filter, visibility fusion, average fusion, visibility
    /// filter.
    #[default]
    Hkust,
    /// Two-way geometric consistency and averaging, as MVSNet-family evaluation scripts do.
    Geo,
    /// As `geo` with bounds that grow with the number of views that meet them (D2HC-RMVSNet).
    Dynamic,
    /// Agreement in pseudo-disparity and the mean of the points (fusibile).
    Gipuma,
    /// Connected pixels that agree in depth and normal become one point at their median (COLMAP).
    Cluster,
}

/// The visibility fusion of `hkust`.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Visibility {
    /// The median of the reference's depth and the consistent reprojected ones.
    #[default]
    Median,
    /// Merrell et al. 2007, confidence-based.
    MerrellConfidence,
    /// Merrell et al. 2007, stability-based.
    MerrellStability,
    /// The reference's depth as it is.
    None,
}

/// How a depth map is sampled between pixel centres.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Sampling {
    /// Bilinear in inverse depth over those pixels that are near the expected depth, weights
    /// renormalised: exact on planes, whole at holes and edges.
    #[default]
    Valid,
    /// Bilinear in depth, pixels without depth as zeros: as OpenCV's `remap`.
    Plain,
}

/// Where a point's colour comes from.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Colors {
    /// The mean over the views that agree.
    #[default]
    Mean,
    /// The reference view's image.
    Reference,
}

impl FuseMode {
    /// All of them, in the order of the documentation.
    pub const ALL: [Self; 5] = [
        Self::Hkust,
        Self::Geo,
        Self::Dynamic,
        Self::Gipuma,
        Self::Cluster,
    ];

    /// Whether the procedure asks for this one of the options that only some procedures ask for.
    pub fn asks_for(self, option: &str) -> bool {
        match option {
            "visibility" => self == Self::Hkust,
            "max_pixel_error" => !matches!(self, Self::Dynamic | Self::Gipuma),
            "min_sources" => self != Self::Dynamic,
            // Where `max_depth_error` bounds nothing, it tells which views see through a point, and maps
            // that are not sampled are rounded as `sampling` keeps them.
            _ => true,
        }
    }
}

impl Default for FuseOptions {
    fn default() -> Self {
        Self {
            mode: FuseMode::Hkust,
            visibility: Visibility::Median,
            max_sources: 10,
            min_confidence: 0.8,
            confidence_quantile: 0.0,
            max_pixel_error: 1.0,
            max_depth_error: 0.01,
            wide_angle: 30.0,
            min_sources: 3,
            soften: true,
            sampling: Sampling::Valid,
            similar_depth: 0.02,
            guard: true,
            max_disparity_error: 0.25,
            max_normal_angle: 10.0,
            min_support: 0.0,
            colors: Colors::Mean,
            normals: true,
            min_depth: 0.0,
            max_depth: 0.0,
            view_range: false,
            bounds: None,
        }
    }
}

impl FuseOptions {
    /// Checks every value's range.
    ///
    /// # Errors
    /// Names the option, what is expected and what was found.
    pub fn check(&self) -> Result<()> {
        let positive = [
            ("max_pixel_error", self.max_pixel_error),
            ("max_depth_error", self.max_depth_error),
            ("max_disparity_error", self.max_disparity_error),
        ];
        for (name, bound) in positive {
            let fits = bound.is_finite() && bound > 0.0;
            expect(name, bound, "a finite bound above 0", fits)?;
        }
        let turn = self.max_normal_angle;
        let fits = turn > 0.0 && turn <= 180.0;
        expect("max_normal_angle", turn, "degrees above 0, up to 180", fits)?;
        let (angle, quantile) = (self.wide_angle, self.confidence_quantile);
        let within = |value: f64, end: f64| (0.0..end).contains(&value);
        expect(
            "wide_angle",
            angle,
            "0 or degrees below 90",
            within(angle, 90.0),
        )?;
        let fraction = "a fraction from 0 to below 1";
        expect(
            "confidence_quantile",
            quantile,
            fraction,
            within(quantile, 1.0),
        )?;
        let similar = self.similar_depth;
        let fits = similar > 0.0 && similar < 1.0;
        // From 1 on a pixel without a depth would be similar to all.
        expect(
            "similar_depth",
            similar,
            "a fraction above 0, below 1",
            fits,
        )?;
        let confidence = self.min_confidence;
        expect(
            "min_confidence",
            confidence,
            "a number",
            confidence < f64::from(f32::MAX),
        )?;
        expect(
            "min_support",
            self.min_support,
            "a number",
            !self.min_support.is_nan(),
        )?;
        let (near, far) = (self.min_depth, self.max_depth);
        expect(
            "min_depth",
            near,
            "0 or more",
            near.is_finite() && near >= 0.0,
        )?;
        let beyond = far.total_cmp(&0.0).is_eq() || (far.is_finite() && far > near);
        expect("max_depth", far, "0 or more than min_depth", beyond)?;
        if let Some([low, high]) = self.bounds {
            let ordered = (0..3).all(|axis| low[axis] <= high[axis]);
            let problem =
                format!("expected a smallest and a largest corner, found {low:?}, {high:?}");
            return if ordered {
                Ok(())
            } else {
                Err(Error::invalid("bounds", problem))
            };
        }
        Ok(())
    }

    /// The least confidence that is kept by [`Self::min_confidence`].
    #[allow(clippy::cast_possible_truncation, reason = "confidences are f32")]
    pub(super) fn least_confidence(&self) -> f32 {
        let least = self.min_confidence as f32;
        let above = match self.mode {
            FuseMode::Hkust | FuseMode::Geo | FuseMode::Dynamic => least != 0.0,
            FuseMode::Gipuma | FuseMode::Cluster => false,
        };
        if above { least.next_up() } else { least }
    }

    /// Whether depths may be filled in where a view has none.
    pub(super) fn fills(&self) -> bool {
        let selects = [Visibility::MerrellConfidence, Visibility::MerrellStability];
        self.mode == FuseMode::Hkust && selects.contains(&self.visibility)
    }

    /// How many sources of a view with `listed` sources are used.
    pub fn sources_used(&self, listed: usize) -> usize {
        if self.max_sources == 0 {
            listed
        } else {
            listed.min(self.max_sources)
        }
    }

    /// How many sources must agree where `available` are used.
    pub fn sources_needed(&self, available: usize) -> usize {
        if !self.soften {
            return self.min_sources;
        }
        let most = (available * 3).div_ceil(5).max(2);
        self.min_sources.min(most)
    }
}

fn expect(name: &str, found: f64, what: &str, fits: bool) -> Result<()> {
    if fits {
        return Ok(());
    }
    Err(Error::invalid(
        name,
        format!("expected {what}, found {found}"),
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn needed_sources_soften_to_three_fifths_but_not_below_two() {
        let options = FuseOptions::default();
        let needed: Vec<usize> = (0..7).map(|n| options.sources_needed(n)).collect();
        assert_eq!(needed, [2, 2, 2, 2, 3, 3, 3]);
        let hard = FuseOptions {
            soften: false,
            min_sources: 5,
            ..options
        };
        assert_eq!(hard.sources_needed(1), 5);
    }

    #[test]
    fn every_option_out_of_range_is_named() {
        let bad = |change: fn(&mut FuseOptions)| {
            let mut options = FuseOptions::default();
            change(&mut options);
            options.check().unwrap_err().to_string()
        };
        assert!(FuseOptions::default().check().is_ok());
        assert!(bad(|o| o.max_pixel_error = f64::NAN).contains("max_pixel_error"));
        assert!(bad(|o| o.similar_depth = 0.0).contains("similar_depth"));
        assert!(bad(|o| o.wide_angle = 90.0).contains("wide_angle"));
        assert!(bad(|o| o.confidence_quantile = 1.0).contains("confidence_quantile"));
        assert!(bad(|o| o.min_confidence = f64::NAN).contains("min_confidence"));
        assert!(bad(|o| o.max_depth = -1.0).contains("max_depth"));
        assert!(bad(|o| o.bounds = Some([[0.0; 3], [-1.0; 3]])).contains("bounds"));
    }
}
