//! The three ways to blend, on planes of values.

use super::frame::{Axis, Edge};
use super::levels;
use super::light::Light;
use super::neighbours::{Extent, Neighbours, Weights, Work};
use super::spectrum::LowPass;
use super::{BlendMode, BlendOptions};
use crate::error::{Error, Result};
use crate::parallel;
use mvs_datasets::scene::{ColorImage, Mask, Raster};
use std::marker::PhantomData;
use std::ops::Range;

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
    ///
    /// # Errors
    /// No pixels, and a D0 or standard deviation that is not finite and above 0, or a standard deviation so far off
    /// that it has no D0.
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
    ///
    /// # Errors
    /// Images or a mask of another size than the blend was prepared for.
    pub fn blend(
        &self,
        rendered: &ColorImage,
        photograph: &ColorImage,
        mask: &Mask,
    ) -> Result<ColorImage> {
        let inputs = Inputs::new(rendered, photograph, mask);
        self.blend_as(&inputs, |values, out| {
            levels::round(values, out.as_flattened_mut());
        })
    }

    /// As [`Blender::blend`], before values are rounded and clipped to 0 … 255.
    ///
    /// # Errors
    /// As [`Blender::blend`].
    pub fn blend_unrounded(
        &self,
        rendered: &ColorImage,
        photograph: &ColorImage,
        mask: &Mask,
    ) -> Result<Raster<[f32; 3]>> {
        let inputs = Inputs::new(rendered, photograph, mask);
        self.blend_as(&inputs, |values, out| {
            out.as_flattened_mut().copy_from_slice(values);
        })
    }

    /// The blend with each row of values turned into what the result holds.
    fn blend_as<T: Copy + Default + Send>(
        &self,
        inputs: &Inputs<'_>,
        finish: impl Fn(&[f32], &mut [[T; 3]]) + Sync + Send,
    ) -> Result<Raster<[T; 3]>> {
        self.check("rendered image", inputs.rendered.size())?;
        self.check("photograph", inputs.photograph.size())?;
        self.check("mask", inputs.mask.size())?;
        let work = Blending {
            mode: self.mode,
            light: self.light,
            table: self.light.table(),
            inputs,
            extents: inputs.mask.rows().map(extent).collect(),
            finish,
            pixel: PhantomData,
        };
        let mut blended = Raster::filled(self.size.0, self.size.1, [T::default(); 3])?;
        match &self.filter {
            Filter::Narrow(neighbours) => neighbours.filter(&work, blended.values_mut()),
            Filter::Wide(frame) => {
                frame.filter(&work, (blended.values_mut(), self.size.0 as usize))?;
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
}

/// How much of a row is inside the mask.
fn extent(row: &[bool]) -> Extent {
    // All are counted, side by side: no first one is looked for.
    let inside = row.iter().map(|&inside| usize::from(inside)).sum::<usize>();
    match inside {
        0 => Extent::Nothing,
        _ if inside == row.len() => Extent::All,
        _ => Extent::Some,
    }
}

/// Pixels of a mask that are compared at once.
const AT_ONCE: usize = 64;

/// Runs of pixels inside and outside the mask: which, and where they begin and end.
fn runs(mask: &[bool]) -> impl Iterator<Item = (bool, Range<usize>)> {
    let mut from = 0;
    std::iter::from_fn(move || {
        let &inside = mask.get(from)?;
        let mut to = from;
        while let Some(all) = mask[to..].first_chunk::<AT_ONCE>()
            && *all == [inside; AT_ONCE]
        {
            to += AT_ONCE;
        }
        let others = mask[to..].iter().position(|&next| next != inside);
        to = others.map_or(mask.len(), |count| to + count);
        let run = (inside, from..to);
        from = to;
        Some(run)
    })
}

/// Whether all weights are one, which is large enough.
fn is_same_and_large(weights: &[f32]) -> bool {
    weights
        .first()
        .is_some_and(|&first| first >= SMALLEST_WEIGHT && levels::all_are(weights, first))
}

/// One blend of images.
struct Blending<'a, T, F> {
    mode: BlendMode,
    light: Light,
    table: [f32; 256],
    inputs: &'a Inputs<'a>,
    /// Of the mask, by row.
    extents: Vec<Extent>,
    /// Turns a row of values into pixels of the result.
    finish: F,
    pixel: PhantomData<fn() -> T>,
}

impl<T, F> Blending<'_, T, F> {
    /// A row of an image.
    fn row<'i, V>(&self, of: &'i Raster<V>, row: usize) -> &'i [V] {
        let width = of.width() as usize;
        &of.values()[row * width..][..width]
    }
}

impl<T: Send, F: Fn(&[f32], &mut [[T; 3]]) + Sync> Work for Blending<'_, T, F> {
    type Pixel = [T; 3];

    fn extent(&self, row: usize) -> Extent {
        match self.mode {
            BlendMode::Reference => Extent::Some,
            BlendMode::Composite | BlendMode::Normalized => self.extents[row],
        }
    }

    fn is_weighted(&self) -> bool {
        self.mode == BlendMode::Normalized
    }

    /// Photograph − rendering inside the mask; outside the photograph, or nothing.
    fn fill(&self, row: usize, colors: &mut [f32], weights: &mut [f32]) {
        let photograph = self.row(self.inputs.photograph, row).as_flattened();
        let rendered = self.row(self.inputs.rendered, row).as_flattened();
        for (inside, pixels) in runs(self.row(self.inputs.mask, row)) {
            weights[pixels.clone()].fill(if inside { 1.0 } else { 0.0 });
            let run = 3 * pixels.start..3 * pixels.end;
            let (colors, photograph) = (&mut colors[run.clone()], &photograph[run.clone()]);
            let rendered = inside.then(|| &rendered[run]);
            match (self.light, rendered) {
                (_, None) if self.mode != BlendMode::Reference => colors.fill(0.0),
                (Light::Encoded, None) => levels::values(photograph, colors),
                (Light::Encoded, Some(rendered)) => {
                    levels::difference((photograph, rendered), colors);
                }
                (Light::Linear, rendered) => {
                    for (at, color) in colors.iter_mut().enumerate() {
                        let value = |level: u8| self.table[usize::from(level)];
                        *color = value(photograph[at]) - rendered.map_or(0.0, |r| value(r[at]));
                    }
                }
            }
        }
    }

    /// Adds the low-passed difference to the rendering.
    fn take(&self, row: usize, (low, weights): (&mut [f32], &[f32]), out: &mut [[T; 3]]) {
        let photograph = self.row(self.inputs.photograph, row).as_flattened();
        let rendered = self.row(self.inputs.rendered, row).as_flattened();
        for (inside, pixels) in runs(self.row(self.inputs.mask, row)) {
            let run = 3 * pixels.start..3 * pixels.end;
            let (low, weights) = (&mut low[run.clone()], &weights[pixels]);
            let (photograph, rendered) = (&photograph[run.clone()], &rendered[run]);
            if !inside && self.mode != BlendMode::Reference {
                levels::values(photograph, low);
                continue;
            }
            if self.mode == BlendMode::Normalized {
                if self.light == Light::Encoded && is_same_and_large(weights) {
                    levels::scale_and_add((low, weights[0]), rendered);
                    continue;
                }
                levels::normalize(low, weights);
                self.mend(low, weights, (photograph, rendered));
            }
            match (self.light, inside) {
                (Light::Encoded, true) => levels::add(rendered, low),
                (Light::Encoded, false) => {}
                (Light::Linear, _) => {
                    for (value, &level) in low.iter_mut().zip(rendered) {
                        let base = if inside {
                            self.table[usize::from(level)]
                        } else {
                            0.0
                        };
                        *value = self.light.encode(base + *value);
                    }
                }
            }
        }
        (self.finish)(low, out);
    }
}

impl<T, F> Blending<'_, T, F> {
    /// Takes the difference unfiltered where the weights are too small.
    fn mend(&self, low: &mut [f32], weights: &[f32], (photograph, rendered): (&[u8], &[u8])) {
        if !levels::any_below(weights, SMALLEST_WEIGHT) {
            return;
        }
        for (at, value) in low.iter_mut().enumerate() {
            if weights[at / 3] < SMALLEST_WEIGHT {
                let [photograph, rendered] = [photograph[at], rendered[at]];
                *value = self.table[usize::from(photograph)] - self.table[usize::from(rendered)];
            }
        }
    }
}

impl Frame {
    /// As [`Neighbours::filter`], for an image of `width`.
    fn filter<W: Work>(&self, work: &W, (out, width): (&mut [W::Pixel], usize)) -> Result<()> {
        let channels = 3 + usize::from(work.is_weighted());
        let planes = parallel::try_map(channels, |channel| self.filtered((channel, width), work))?;
        parallel::for_each_chunk(out, width, |row, out| {
            let start = (row + self.rows.offset) * self.columns.length() + self.columns.offset;
            let value = |channel: usize, column: usize| planes[channel][start + column];
            let mut colors: Vec<f32> = (0..3 * width).map(|at| value(at % 3, at / 3)).collect();
            let weights: Vec<f32> = match work.is_weighted() {
                true => (0..width).map(|column| value(3, column)).collect(),
                false => vec![1.0; width],
            };
            work.take(row, (&mut colors, &weights), out);
        });
        Ok(())
    }

    /// The low-passed plane of one channel, the fourth of which is the weight, in the frame's size.
    fn filtered(&self, (channel, width): (usize, usize), work: &impl Work) -> Result<Vec<f32>> {
        let frame = self.columns.length();
        let (mut colors, mut weights) = (vec![0.0; 3 * width], vec![0.0; width]);
        let mut plane = vec![0.0; frame * self.rows.length()];
        for (out, &row) in plane.chunks_exact_mut(frame).zip(&self.rows.source) {
            work.fill(row, &mut colors, &mut weights);
            for (value, &column) in out.iter_mut().zip(&self.columns.source) {
                *value = match channel {
                    3 => weights[column],
                    _ => colors[3 * column + channel],
                };
            }
        }
        self.low_pass.apply(&mut plane)?;
        Ok(plane)
    }
}
