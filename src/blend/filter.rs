//! The three ways to blend, on planes of values.

use super::frame::Axis;
use super::light::Light;
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

impl<'a> Inputs<'a> {
    fn new(rendered: &'a ColorImage, photograph: &'a ColorImage, mask: &'a Mask) -> Self {
        Self {
            rendered,
            photograph,
            mask,
        }
    }
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
        self.blend_as(&Inputs::new(rendered, photograph, mask), to_level)
    }

    /// As [`Blender::blend`], before values are rounded and clipped to 0 … 255.
    pub fn blend_unrounded(
        &self,
        rendered: &ColorImage,
        photograph: &ColorImage,
        mask: &Mask,
    ) -> Result<Raster<[f32; 3]>> {
        self.blend_as(&Inputs::new(rendered, photograph, mask), |value| value)
    }

    /// The blend with each value turned into what the result holds.
    fn blend_as<T: Copy + Default + Send>(
        &self,
        inputs: &Inputs<'_>,
        finish: impl Fn(f32) -> T + Sync + Send,
    ) -> Result<Raster<[T; 3]>> {
        self.check("rendered image", inputs.rendered.size())?;
        self.check("photograph", inputs.photograph.size())?;
        self.check("mask", inputs.mask.size())?;
        let table = self.light.table();
        let weights = usize::from(self.mode == BlendMode::Normalized);
        let mut planes =
            parallel::try_map(3 + weights, |plane| match plane.checked_sub(weights) {
                Some(channel) => self.filtered(|row, out| {
                    self.difference_row(inputs, (channel, &table), row, out);
                }),
                None => self.filtered(|row, out| self.mask_row(inputs.mask, row, out)),
            })?;
        let lights = planes.split_off(weights);
        let low = LowPassed {
            weights: planes.pop(),
            lights,
        };
        let mut blended = Raster::filled(self.size.0, self.size.1, [T::default(); 3])?;
        let width = self.size.0 as usize;
        parallel::for_each_chunk(blended.values_mut(), width, |row, pixels| {
            self.finish_row((inputs, &table), &low, (row, pixels), &finish);
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

    /// The pixels of a row of the image.
    fn row_range(&self, row: usize) -> std::ops::Range<usize> {
        let width = self.size.0 as usize;
        row * width..(row + 1) * width
    }

    /// What is low-passed in a row: photograph − rendering, of one channel.
    fn difference_row(
        &self,
        inputs: &Inputs<'_>,
        (channel, table): (usize, &[f32; 256]),
        row: usize,
        out: &mut [f32],
    ) {
        let range = self.row_range(row);
        let rendered = &inputs.rendered.values()[range.clone()];
        let photograph = &inputs.photograph.values()[range.clone()];
        let outside = if self.mode == BlendMode::Reference {
            1.0
        } else {
            0.0
        };
        let pixels = rendered
            .iter()
            .zip(photograph)
            .zip(&inputs.mask.values()[range]);
        for (value, ((rendered, photograph), &inside)) in out.iter_mut().zip(pixels) {
            let photograph = table[usize::from(photograph[channel])];
            let difference = photograph - table[usize::from(rendered[channel])];
            *value = if inside {
                difference
            } else {
                outside * photograph
            };
        }
    }

    fn mask_row(&self, mask: &Mask, row: usize, out: &mut [f32]) {
        for (value, &inside) in out.iter_mut().zip(&mask.values()[self.row_range(row)]) {
            *value = f32::from(u8::from(inside));
        }
    }

    /// The low-passed plane, in the frame's size, whose rows `fill` writes at the image's width.
    fn filtered(&self, fill: impl Fn(usize, &mut [f32])) -> Result<Vec<f32>> {
        let (frame, width) = (self.columns.length(), self.size.0 as usize);
        let offset = self.columns.offset;
        let mut plane = vec![0.0; frame * self.rows.length()];
        for (out, &row) in plane.chunks_exact_mut(frame).zip(&self.rows.source) {
            fill(row, &mut out[offset..offset + width]);
            for margin in (0..offset).chain(offset + width..frame) {
                out[margin] = out[offset + self.columns.source[margin]];
            }
        }
        self.low_pass.apply(&mut plane)?;
        Ok(plane)
    }

    /// Adds the low-passed difference to the rendering in one row of the result.
    fn finish_row<T>(
        &self,
        (inputs, table): (&Inputs<'_>, &[f32; 256]),
        low: &LowPassed,
        (row, pixels): (usize, &mut [[T; 3]]),
        finish: &impl Fn(f32) -> T,
    ) {
        let range = self.row_range(row);
        let rendered = &inputs.rendered.values()[range.clone()];
        let photograph = &inputs.photograph.values()[range.clone()];
        let start = (row + self.rows.offset) * self.columns.length() + self.columns.offset;
        let frame_range = start..start + pixels.len();
        let lights = [0, 1, 2].map(|channel| &low.lights[channel][frame_range.clone()]);
        let weights = low.weights.as_ref().map(|weights| &weights[frame_range]);
        let mask = &inputs.mask.values()[range];
        for (column, pixel) in pixels.iter_mut().enumerate() {
            let inside = mask[column];
            if !inside && self.mode != BlendMode::Reference {
                *pixel = photograph[column].map(|value| finish(f32::from(value)));
                continue;
            }
            let weight = weights.map_or(1.0, |weights| weights[column]);
            let gain = 1.0 / weight;
            *pixel = std::array::from_fn(|channel| {
                let base = table[usize::from(rendered[column][channel])];
                let added = if weight < SMALLEST_WEIGHT {
                    table[usize::from(photograph[column][channel])] - base
                } else {
                    lights[channel][column] * gain
                };
                let base = if inside { base } else { 0.0 };
                finish(self.light.encode(base + added))
            });
        }
    }
}

/// Low-passed planes in the frame's size.
struct LowPassed {
    /// Of the mask, where the mode divides by it.
    weights: Option<Vec<f32>>,
    /// Of the difference, per channel.
    lights: Vec<Vec<f32>>,
}

/// The nearest of the 256 levels.
#[allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "clamped to 0 … 255 before the cast"
)]
fn to_level(value: f32) -> u8 {
    (value.clamp(0.0, 255.0) + 0.5) as u8
}
