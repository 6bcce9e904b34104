//! The colours of a row of samples, a run of one triangle's samples at a time: where they lie on its
//! texture by vector operations in f64, then texel by texel into the sums of their pixels.
//!
//! Each operation is that of [`Patch::glimpse`] and [`super::sight::Samples::add`], never fused, so that
//! all sets of instructions give the same bytes.

#![allow(
    clippy::needless_range_loop,
    reason = "columns are walked side by side, and closures would leave the instruction set"
)]

use super::lanes::{Lanes, Task, dispatch};
use super::look::Look;
use super::sight::{Samples, alike};
use super::surface::{Paint, Patch, share};
use super::texture::Spots;
use super::tile::{NONE, SIZE, Spot};

/// Samples whose places are worked out side by side.
const BLOCK: usize = 8;
/// A run may end within a block: what is written beyond belongs to the next run, or to nobody.
const WIDE: usize = SIZE + BLOCK;

/// One row of samples, and what is worked out of a run of them.
pub(crate) struct Row {
    /// Directions at depth 1.
    x: [f64; WIDE],
    y: [f64; WIDE],
    /// Depth at the centre of each sample's pixel.
    center: [f64; WIDE],
    depth: [f64; WIDE],
    /// On the texture, as [`Spots`].
    start: [u32; WIDE],
    right: [f32; WIDE],
    down: [f32; WIDE],
    /// Otherwise: weights of the triangle's corners.
    weights: [[f64; WIDE]; 2],
}

impl Row {
    pub(crate) fn new() -> Self {
        Self {
            x: [0.0; WIDE],
            y: [0.0; WIDE],
            center: [0.0; WIDE],
            depth: [0.0; WIDE],
            start: [0; WIDE],
            right: [0.0; WIDE],
            down: [0.0; WIDE],
            weights: [[0.0; WIDE]; 2],
        }
    }

    /// Takes the directions of `width` samples from `first` on; of rows after the first of a part,
    /// `again`, only what may differ.
    pub(crate) fn aim(&mut self, look: &Look<'_>, (first, width): (Spot, usize), again: bool) {
        if look.is_straight() {
            self.y[..width].fill(look.direction(first).y);
            if again {
                return;
            }
        }
        for column in 0..width {
            let direction = look.direction(Spot {
                column: first.column + column,
                ..first
            });
            (self.x[column], self.y[column]) = (direction.x, direction.y);
        }
    }

    /// Takes the depths at the centres of pixels with `side` samples each.
    pub(crate) fn expect(&mut self, depths: &[f32], side: usize) {
        for (centers, &depth) in self.center.chunks_exact_mut(side).zip(depths) {
            centers.fill(f64::from(depth));
        }
    }

    /// Adds the samples `from` … `to` (excluded), all of which see `patch`, or nothing, to the sums of
    /// their pixels, `side` of them to each in this row.
    pub(crate) fn add(
        &mut self,
        patch: Option<&Patch<'_>>,
        range: (usize, usize),
        (pixels, side): (&mut [Samples], usize),
    ) {
        match patch.filter(|patch| !patch.back) {
            None => mix(pixels, side, range),
            Some(patch) => dispatch(Run {
                row: self,
                patch,
                pixels,
                side,
                range,
            }),
        }
    }
}

/// Runs of samples that see one triangle, or none: which, and where they begin and end.
pub(crate) fn runs(triangles: &[u32]) -> impl Iterator<Item = (Option<u32>, (usize, usize))> {
    let mut from = 0;
    std::iter::from_fn(move || {
        let &triangle = triangles.get(from)?;
        let others = triangles[from..].iter().position(|&next| next != triangle);
        let to = others.map_or(triangles.len(), |count| from + count);
        let run = ((triangle != NONE).then_some(triangle), (from, to));
        from = to;
        Some(run)
    })
}

/// Notes that samples see no surface.
fn mix(pixels: &mut [Samples], side: usize, (from, to): (usize, usize)) {
    for pixel in &mut pixels[from / side..to.div_ceil(side)] {
        pixel.mixed = true;
    }
}

/// Samples side by side that see one triangle.
struct Run<'r, 'm> {
    row: &'r mut Row,
    patch: &'r Patch<'m>,
    pixels: &'r mut [Samples],
    side: usize,
    range: (usize, usize),
}

impl Task for Run<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self, l: L) {
        let (row, patch, (from, to)) = (self.row, self.patch, self.range);
        let paint = &patch.paint;
        let mut alike = true;
        for start in (from..to).step_by(BLOCK) {
            let (places, same) = row.place(patch, start);
            alike &= same;
            match paint {
                Paint::Texture(texels, _) => row.keep(start, &texels.find(places)),
                Paint::Tinted(..) | Paint::Linear(_) => row.keep_weights(start, &places),
            }
        }
        if !alike {
            row.compare(self.range, (self.pixels, self.side));
        }
        let pixels = (self.pixels, self.side);
        match paint {
            &Paint::Texture(texels, _) if !texels.repeats() => row.gather(
                (l, self.range),
                pixels,
                #[inline(always)]
                |row, at| texels.color_inside(l, row.start[at], (row.right[at], row.down[at])),
            ),
            &Paint::Texture(texels, _) => row.gather(
                (l, self.range),
                pixels,
                #[inline(always)]
                |row, at| texels.color(l, row.start[at], (row.right[at], row.down[at])),
            ),
            Paint::Tinted(..) | Paint::Linear(_) => row.gather(
                (l, self.range),
                pixels,
                #[inline(always)]
                |row, at| paint.color(l, [row.weights[0][at], row.weights[1][at]]),
            ),
        }
    }
}

impl Row {
    /// Places of a block of samples, whose depths are kept; and whether all of those are alike the
    /// depths at their pixels' centres.
    #[inline(always)]
    fn place(&mut self, patch: &Patch<'_>, start: usize) -> ([[f64; BLOCK]; 2], bool) {
        let mut places = [[0.0; BLOCK]; 2];
        let (Some(x), Some(y), Some(center), Some(depth)) = (
            self.x[start..].first_chunk::<BLOCK>(),
            self.y[start..].first_chunk::<BLOCK>(),
            self.center[start..].first_chunk::<BLOCK>(),
            self.depth[start..].first_chunk_mut::<BLOCK>(),
        ) else {
            return (places, false);
        };
        for i in 0..BLOCK {
            let direction = (x[i], y[i]);
            let scale = 1.0 / share(patch.normal, direction);
            places[0][i] = share(patch.x, direction) * scale;
            places[1][i] = share(patch.y, direction) * scale;
            depth[i] = patch.volume * scale;
        }
        let mut all = true;
        for i in 0..BLOCK {
            all &= alike(depth[i], center[i]);
        }
        (places, all)
    }

    #[inline(always)]
    fn keep(&mut self, start: usize, spots: &Spots<BLOCK>) {
        self.start[start..start + BLOCK].copy_from_slice(&spots.start);
        self.right[start..start + BLOCK].copy_from_slice(&spots.right);
        self.down[start..start + BLOCK].copy_from_slice(&spots.down);
    }

    #[inline(always)]
    fn keep_weights(&mut self, start: usize, weights: &[[f64; BLOCK]; 2]) {
        for (kept, weights) in self.weights.iter_mut().zip(weights) {
            kept[start..start + BLOCK].copy_from_slice(weights);
        }
    }

    /// Adds the colours of a run to the sums of its pixels.
    #[inline(always)]
    fn gather<L: Lanes>(
        &self,
        (l, (from, to)): (L, (usize, usize)),
        (pixels, side): (&mut [Samples], usize),
        color: impl Fn(&Self, usize) -> L::V,
    ) {
        let first = from / side;
        let (mut at, mut end) = (from, first * side);
        for pixel in &mut pixels[first..to.div_ceil(side)] {
            end = to.min(end + side);
            let mut sum = l.load(&pixel.sum);
            pixel.count += (end - at) as u32;
            while at < end {
                sum = l.add(sum, color(self, at));
                at += 1;
            }
            pixel.sum = l.store(sum);
        }
    }

    /// Notes which pixels of a run have samples whose depths are not alike their centres'.
    #[cold]
    #[inline(never)]
    fn compare(&self, (from, to): (usize, usize), (pixels, side): (&mut [Samples], usize)) {
        for at in from..to {
            pixels[at / side].mixed |= !alike(self.depth[at], self.center[at]);
        }
    }
}
