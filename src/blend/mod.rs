//! Rendering + photograph → blended image: the photograph's light, the rendering's detail.
//!
//! The blend of the BlendedMVS paper (Yao et al. 2020): low frequencies of the
//! photograph, high frequencies of the rendering, so that the light is real and every detail agrees
//! with the rendered depth.

mod filter;
mod frame;
mod levels;
mod light;
mod neighbours;
mod spectrum;

pub use filter::Blender;

use crate::error::{Error, Result};
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
    /// The filter's standard deviation in pixels, the same on both axes, instead of D0.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sigma: Option<f64>,
    /// Blend light proportional to energy instead of sRGB values.
    pub linear_light: bool,
}

impl Default for BlendOptions {
    fn default() -> Self {
        Self {
            mode: BlendMode::Normalized,
            d0: 5000.0,
            sigma: None,
            linear_light: false,
        }
    }
}

impl BlendOptions {
    /// D0 along (x, y) for images of `size` (width, height).
    fn d0_of(&self, size: (u32, u32)) -> Result<(f64, f64)> {
        let positive = |what: &str, value: f64| {
            if value.is_finite() && value > 0.0 {
                return Ok(value);
            }
            let problem = format!("expected a finite number above 0, found {value}");
            Err(Error::invalid(what, problem))
        };
        let Some(sigma) = self.sigma else {
            let d0 = positive("blend filter's d0", self.d0)?;
            return Ok((d0, d0));
        };
        let sigma = positive("blend filter's sigma", sigma)?;
        let d0 = |length: u32| {
            let d0 = (f64::from(length) / (std::f64::consts::TAU * sigma)).powi(2);
            if d0 > 0.0 && d0.is_finite() {
                return Ok(d0);
            }
            let problem = format!("expected pixels within 1e-150 … 1e150, found {sigma}");
            Err(Error::invalid("blend filter's sigma", problem))
        };
        Ok((d0(size.0)?, d0(size.1)?))
    }
}

/// Blends `rendered` with `photograph`, both of one size, `mask` telling where there is rendered
/// surface. Outside the mask: in `reference` mode the formula's own values, in the others the
/// photograph.
///
/// # Errors
/// As [`Blender::new`], and a photograph or mask of another size than the rendering.
pub fn blend(
    rendered: &ColorImage,
    photograph: &ColorImage,
    mask: &Mask,
    options: &BlendOptions,
) -> Result<ColorImage> {
    Blender::new(rendered.size(), options)?.blend(rendered, photograph, mask)
}

/// The blended image with black where there is no rendered surface.
///
/// # Errors
/// A mask of another size than the image's.
pub fn masked(blended: &ColorImage, mask: &Mask) -> Result<ColorImage> {
    if blended.size() != mask.size() {
        let (expected, found) = (blended.size(), mask.size());
        let problem = format!("expected the image's {expected:?} pixels, found {found:?}");
        return Err(Error::invalid("mask", problem));
    }
    let (width, height) = blended.size();
    let pixels = blended.values().iter().zip(mask.values());
    let values = pixels
        .map(|(&pixel, &inside)| if inside { pixel } else { [0; 3] })
        .collect();
    Ok(ColorImage::from_values(width, height, values)?)
}

#[cfg(test)]
mod tests;
