//! Rendering + photograph → blended image: the photograph's light, the rendering's detail.

use crate::error::Result;
use mvs_datasets::scene::{ColorImage, Mask};
use serde::{Deserialize, Serialize};

/// What happens outside the mask and at its border.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum BlendMode {
    /// The paper's formula: circular, zero background.
    Reference,
    /// Pixels without rendering are filled from the photograph first.
    Composite,
    /// Low-pass of the difference normalised by the low-pass of the mask, reflected at borders;
    /// exact for a constant lighting offset.
    #[default]
    Normalized,
}

/// How to blend.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct BlendOptions {
    /// What happens outside the mask.
    pub mode: BlendMode,
    /// The filter's D0 in squared FFT bins of the full frame: L = exp(−(u² + v²) / (2 · D0)).
    pub d0: f64,
}

impl Default for BlendOptions {
    fn default() -> Self {
        Self {
            mode: BlendMode::Normalized,
            d0: 5000.0,
        }
    }
}

/// Blends `rendered` with `photograph`, both of one size, `mask` telling where there is rendered
/// surface. Outside the mask: in `reference` mode the formula's own values, in the others the
/// photograph.
pub fn blend(
    _rendered: &ColorImage,
    _photograph: &ColorImage,
    _mask: &Mask,
    _options: &BlendOptions,
) -> Result<ColorImage> {
    todo!()
}
