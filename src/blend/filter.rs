//! The three ways to blend, on planes of values.

use super::frame::Axis;
use super::light::{self, Light};
use super::spectrum::LowPass;
use super::{BlendMode, BlendOptions};
use crate::error::{Error, Result};
use crate::parallel;
use mvs_datasets::scene::{ColorImage, Mask, Raster};

/// Where the low-passed mask is smaller than this, the difference is taken unfiltered: only a mask
/// of a few pixels under a filter as wide as the image comes here.
const SMALLEST_WEIGHT: f32 = 1e-5;

/// A blend prepared for images of one size, to be used for many views.
#[derive(Debug)]
pub struct Blender {
    size: (u32, u32),
    mode: BlendMode,
    light: Light,
    columns: Axis,
    rows: Axis,
    low_pass: LowPass,
}

/// The inputs of one blend, all of one size.
struct Inputs<'a> {
    rendered: &'a ColorImage,
    photograph: &'a ColorImage,
    mask: &'a Mask,
}

impl Blender {
    /// Prepares to blend images of `size` (width, height), both ≥ 1.
    pub fn new(size: (u32, u32), options: &BlendOptions) -> Result<Self> {
        let (width, height) = (size.0 as usize, size.1 as usize);
        if width == 0 || height == 0 {
            let problem = format!("expected at least 1x1 pixels, found {width}x{height}");
            return Err(Error::invalid("image to blend", problem));
        }
        let d0 = options.d0_of(size)?;
        let axis = match options.mode {
            BlendMode::Reference | BlendMode::Composite => Axis::circular,
            BlendMode::Normalized => Axis::reflected,
        };
        let (columns, rows) = (axis(width, d0.0), axis(height, d0.1));
        let low_pass = LowPass::new((columns.length(), rows.length()), (columns.d0, rows.d0));
        Ok(Self {
            size,
            mode: options.mode,
            light: if options.linear_light {
                Light::Linear
            } else {
                Light::Encoded
            },
            columns,
            rows,
            low_pass,
        })
    }

    /// As [`super::blend`].
    pub fn blend(
        &self,
        rendered: &ColorImage,
        photograph: &ColorImage,
        mask: &Mask,
    ) -> Result<ColorImage> {
        let exact = self.blend_unrounded(rendered, photograph, mask)?;
        Ok(exact.map(|pixel| pixel.map(to_level)))
    }

    /// As [`Blender::blend`], before values are rounded and clipped to 0 … 255.
    pub fn blend_unrounded(
        &self,
        rendered: &ColorImage,
        photograph: &ColorImage,
        mask: &Mask,
    ) -> Result<Raster<[f32; 3]>> {
        self.check("rendered image", rendered.size())?;
        self.check("photograph", photograph.size())?;
        self.check("mask", mask.size())?;
        let inputs = Inputs {
            rendered,
            photograph,
            mask,
        };
        let table = self.light.table();
        // The mask's plane stands first, where there is one: the longest queue then starts first.
        let weights = usize::from(self.mode == BlendMode::Normalized);
        let mut planes =
            parallel::try_map(3 + weights, |plane| match plane.checked_sub(weights) {
                Some(channel) => self.filtered(self.difference(&inputs, channel, &table)),
                None => self.filtered(|index| f32::from(u8::from(mask.values()[index]))),
            })?;
        let lights = planes.split_off(weights);
        let mut blended = Raster::filled(self.size.0, self.size.1, [0.0; 3])?;
        let width = self.size.0 as usize;
        parallel::for_each_chunk(blended.values_mut(), width, |row, pixels| {
            self.finish_row(&inputs, &table, (planes.first(), &lights), (row, pixels));
        });
        Ok(blended)
    }

    fn check(&self, what: &str, found: (u32, u32)) -> Result<()> {
        if found == self.size {
            return Ok(());
        }
        let (width, height) = self.size;
        let problem = format!(
            "expected {width} x {height} pixels as the render has, found {} x {}; resample it first",
            found.0, found.1
        );
        Err(Error::invalid(what, problem))
    }

    /// What is low-passed: photograph − rendering, of one channel, at the pixel of an index.
    fn difference<'a>(
        &self,
        inputs: &'a Inputs<'a>,
        channel: usize,
        table: &'a [f32; 256],
    ) -> impl Fn(usize) -> f32 + 'a {
        let rendered = light::channel(inputs.rendered, channel, table);
        let photograph = light::channel(inputs.photograph, channel, table);
        let outside = if self.mode == BlendMode::Reference {
            1.0
        } else {
            0.0
        };
        let mask = inputs.mask.values();
        move |index| {
            if mask[index] {
                photograph(index) - rendered(index)
            } else {
                outside * photograph(index)
            }
        }
    }

    /// The low-passed plane of `value`, in the frame's size.
    fn filtered(&self, value: impl Fn(usize) -> f32) -> Result<Vec<f32>> {
        let width = self.size.0 as usize;
        let mut plane = Vec::with_capacity(self.columns.length() * self.rows.length());
        for &row in &self.rows.source {
            plane.extend(self.columns.source.iter().map(|&c| value(row * width + c)));
        }
        self.low_pass.apply(&mut plane)?;
        Ok(plane)
    }

    /// Adds the low-passed difference to the rendering in one row of the result.
    fn finish_row(
        &self,
        inputs: &Inputs<'_>,
        table: &[f32; 256],
        (weights, lights): (Option<&Vec<f32>>, &[Vec<f32>]),
        (row, pixels): (usize, &mut [[f32; 3]]),
    ) {
        let start = (row + self.rows.offset) * self.columns.length() + self.columns.offset;
        for (column, pixel) in pixels.iter_mut().enumerate() {
            let index = row * self.size.0 as usize + column;
            let inside = inputs.mask.values()[index];
            let (rendered, photograph) = (
                inputs.rendered.values()[index],
                inputs.photograph.values()[index],
            );
            if !inside && self.mode != BlendMode::Reference {
                *pixel = photograph.map(f32::from);
                continue;
            }
            let weight = weights.map_or(1.0, |w| w[start + column]);
            for (channel, value) in pixel.iter_mut().enumerate() {
                let base = table[usize::from(rendered[channel])];
                let added = if weight < SMALLEST_WEIGHT {
                    table[usize::from(photograph[channel])] - base
                } else {
                    lights[channel][start + column] / weight
                };
                *value = self.light.encode(if inside { base } else { 0.0 } + added);
            }
        }
    }
}

/// The nearest of the 256 levels.
#[allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "clamped to 0 … 255 before the cast"
)]
fn to_level(value: f32) -> u8 {
    value.round().clamp(0.0, 255.0) as u8
}
