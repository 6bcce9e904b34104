//! The three ways to blend, on planes of values.

use super::frame::{Axis, Edge};
use super::light::Light;
use super::neighbours::{Neighbours, Sample, Weights};
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
    filter: Filter,
}

/// Two ways to the same low-pass.
#[derive(Debug)]
enum Filter {
    /// Over neighbouring pixels, where it is narrow: all images of the usual sizes.
    Narrow(Neighbours),
    /// Over frequencies.
    Wide(Frame),
}

/// What is transformed for the low-pass over frequencies.
#[derive(Debug)]
struct Frame {
    columns: Axis,
    rows: Axis,
    low_pass: LowPass,
}

impl Filter {
    fn new(size: (usize, usize), edge: Edge, d0: (f64, f64)) -> Self {
        let (columns, rows) = (edge.axis(size.0, d0.0), edge.axis(size.1, d0.1));
        let weights = (
            Weights::new(columns.length(), columns.d0),
            Weights::new(rows.length(), rows.d0),
        );
        if let (Some(along_rows), Some(along_columns)) = weights {
            return Self::Narrow(Neighbours::new(size, edge, (along_rows, along_columns)));
        }
        let low_pass = LowPass::new((columns.length(), rows.length()), (columns.d0, rows.d0));
        Self::Wide(Frame {
            columns,
            rows,
            low_pass,
        })
    }
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
        let edge = match options.mode {
            BlendMode::Reference | BlendMode::Composite => Edge::Circular,
            BlendMode::Normalized => Edge::Reflected,
        };
        Ok(Self {
            size,
            mode: options.mode,
            light: if options.linear_light {
                Light::Linear
            } else {
                Light::Encoded
            },
            filter: Filter::new((width, height), edge, d0),
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
        let fill = |row: usize, out: &mut [Sample]| self.source_row(inputs, &table, row, out);
        let take = |row: usize, low: &[Sample], out: &mut [[T; 3]]| {
            self.finish_row((inputs, &table), low, (row, out), &finish);
        };
        let mut blended = Raster::filled(self.size.0, self.size.1, [T::default(); 3])?;
        match &self.filter {
            Filter::Narrow(neighbours) => neighbours.filter(blended.values_mut(), fill, take),
            Filter::Wide(frame) => {
                let weighted = self.mode == BlendMode::Normalized;
                frame.filter(
                    (blended.values_mut(), self.size.0 as usize),
                    weighted,
                    fill,
                    take,
                )?;
            }
        }
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

    /// What is low-passed in a row: photograph − rendering per channel, and the mask.
    fn source_row(&self, inputs: &Inputs<'_>, table: &[f32; 256], row: usize, out: &mut [Sample]) {
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
        for (sample, ((rendered, photograph), &inside)) in out.iter_mut().zip(pixels) {
            let weight = f32::from(u8::from(inside));
            let kept = weight.max(outside);
            // Channel by channel: arrays of three that are mapped pass through memory.
            let value = |channel: usize| {
                let [photograph, rendered] =
                    [photograph[channel], rendered[channel]].map(|level| table[usize::from(level)]);
                kept * photograph - weight * rendered
            };
            *sample = [value(0), value(1), value(2), weight];
        }
    }

    /// Adds the low-passed difference to the rendering in one row of the result.
    fn finish_row<T>(
        &self,
        (inputs, table): (&Inputs<'_>, &[f32; 256]),
        low: &[Sample],
        (row, pixels): (usize, &mut [[T; 3]]),
        finish: &impl Fn(f32) -> T,
    ) {
        let range = self.row_range(row);
        let rendered = &inputs.rendered.values()[range.clone()];
        let photograph = &inputs.photograph.values()[range.clone()];
        let mask = &inputs.mask.values()[range];
        for (column, pixel) in pixels.iter_mut().enumerate() {
            let inside = mask[column];
            if !inside && self.mode != BlendMode::Reference {
                *pixel = photograph[column].map(|value| finish(f32::from(value)));
                continue;
            }
            let [red, green, blue, weight] = low[column];
            let weight = match self.mode {
                BlendMode::Normalized => weight,
                BlendMode::Reference | BlendMode::Composite => 1.0,
            };
            let gain = 1.0 / weight;
            *pixel = std::array::from_fn(|channel| {
                let base = table[usize::from(rendered[column][channel])];
                let added = if weight < SMALLEST_WEIGHT {
                    table[usize::from(photograph[column][channel])] - base
                } else {
                    [red, green, blue][channel] * gain
                };
                let base = if inside { base } else { 0.0 };
                finish(self.light.encode(base + added))
            });
        }
    }
}

impl Frame {
    /// As [`Neighbours::filter`], for an image of `width`; the fourth value of a sample only if
    /// `weighted`.
    fn filter<T: Send>(
        &self,
        (out, width): (&mut [T], usize),
        weighted: bool,
        fill: impl Fn(usize, &mut [Sample]) + Sync + Send,
        take: impl Fn(usize, &[Sample], &mut [T]) + Sync + Send,
    ) -> Result<()> {
        let planes = parallel::try_map(3 + usize::from(weighted), |channel| {
            self.filtered((channel, width), &fill)
        })?;
        parallel::for_each_chunk(out, width, |row, out| {
            let start = (row + self.rows.offset) * self.columns.length() + self.columns.offset;
            let sample = |column: usize| {
                let value = |channel: usize| planes.get(channel).map_or(0.0, |p| p[start + column]);
                std::array::from_fn(value)
            };
            let low: Vec<Sample> = (0..width).map(sample).collect();
            take(row, &low, out);
        });
        Ok(())
    }

    /// The low-passed plane of one channel, in the frame's size.
    fn filtered(
        &self,
        (channel, width): (usize, usize),
        fill: &impl Fn(usize, &mut [Sample]),
    ) -> Result<Vec<f32>> {
        let frame = self.columns.length();
        let mut samples = vec![[0.0; 4]; width];
        let mut plane = vec![0.0; frame * self.rows.length()];
        for (out, &row) in plane.chunks_exact_mut(frame).zip(&self.rows.source) {
            fill(row, &mut samples);
            for (value, &column) in out.iter_mut().zip(&self.columns.source) {
                *value = samples[column][channel];
            }
        }
        self.low_pass.apply(&mut plane)?;
        Ok(plane)
    }
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
