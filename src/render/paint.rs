//! The colours of a part of a tile, row of pixels by row, from those of its samples.

#![allow(
    clippy::needless_range_loop,
    reason = "columns are walked side by side, and closures would leave the instruction set"
)]

use super::lanes::{Lanes, Task, dispatch};
use super::look::Look;
use super::picture::Maps;
use super::row::starts;
use super::shade::Brushes;
use super::sight::{Samples, Sight};
use super::surface::Frame;
use super::texture::Parts;
use std::ops::Range;

/// A part of a tile that is to be painted.
pub(crate) struct Painting<'r, 'p> {
    pub(crate) brushes: &'r mut Brushes<'p>,
    /// What the part's samples see; the part is all that it has.
    pub(crate) look: &'r Look<'r>,
    pub(crate) frame: &'r Frame<'p>,
    /// Samples along each side of a pixel.
    pub(crate) side: usize,
    /// The tile.
    pub(crate) maps: &'r mut Maps,
    /// The part's pixels in the tile, row by row.
    pub(crate) rows: &'r [Range<usize>],
}

impl Painting<'_, '_> {
    /// Gives the part's pixels that show surface their colours; `at_center` has a pixel's whose samples see
    /// none.
    pub(crate) fn run(self, at_center: impl Fn(usize) -> Parts) {
        dispatch(With(self, at_center));
    }
}

struct With<'r, 'p, F>(Painting<'r, 'p>, F);

impl<F: Fn(usize) -> Parts> Task for With<'_, '_, F> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self, l: L) {
        let Self(
            Painting {
                brushes,
                look,
                frame,
                side,
                maps,
                rows,
            },
            at_center,
        ) = self;
        let mut again = false;
        for (row, pixels) in rows.iter().enumerate() {
            if !maps.sights(pixels).contains(&Sight::Surface) {
                continue;
            }
            let width = pixels.len() * side;
            brushes.begin(maps.depths(pixels), side);
            for down in row * side..(row + 1) * side {
                brushes.aim(look, (down, width), again);
                again = true;
                let ids = look.row(down);
                let starts = starts(l, ids);
                brushes.find_runs(ids, starts, |triangle| frame.patch(triangle as usize));
                brushes.add_row(l, (width, side), starts);
            }
            brushes.finish(maps, (pixels, side), &at_center);
        }
    }
}

impl Brushes<'_> {
    /// Gives a row of pixels their colours.
    #[inline(always)]
    fn finish(
        &self,
        maps: &mut Maps,
        (pixels, side): (&Range<usize>, usize),
        at_center: impl Fn(usize) -> Parts,
    ) {
        let (count, samples) = (pixels.len(), (side * side) as u32);
        // All are looked at, side by side: no first one is looked for.
        let mut whole = true;
        for (&count, &mixed) in self.counts.iter().zip(&self.mixed).take(count) {
            whole &= (count == samples) & !mixed;
        }
        for &sight in maps.sights(pixels) {
            whole &= sight == Sight::Surface;
        }
        if whole {
            return self.finish_alike(samples, maps.colors(pixels));
        }
        for (column, index) in pixels.clone().enumerate() {
            let samples = Samples {
                sum: self.sums[column],
                count: self.counts[column],
                mixed: self.mixed[column],
            };
            maps.paint(index, samples, || at_center(index));
        }
    }

    /// Gives pixels of surface alone, each of which has all its samples, their colours.
    #[inline(always)]
    fn finish_alike(&self, samples: u32, colors: &mut [[u8; 3]]) {
        #[allow(clippy::cast_precision_loss, reason = "at most 64")]
        let samples = samples as f32;
        for (color, sum) in colors.iter_mut().zip(&self.sums) {
            let mut levels = [0u8; 4];
            for i in 0..4 {
                let mean = (sum[i] + sum[i + 3]) / samples;
                // A whole number below 2^23 stands in the lowest bits of its sum with that.
                let level = (mean + 0.5).floor() + 8_388_608.0;
                levels[i] = (level.to_bits() & 0xff) as u8;
            }
            color.copy_from_slice(&levels[..3]);
        }
    }
}
