//! The colours of a row of samples: where they lie on their triangles' textures by vector operations
//! in f64, eight side by side, then texel by texel into the sums of their pixels.
//!
//! Each operation is that of [`Patch::glimpse`] and [`super::sight::Samples`], never fused, so that all sets
//! of instructions give the same bytes.

#![allow(
    clippy::needless_range_loop,
    reason = "columns are walked side by side, and closures would leave the instruction set"
)]

use super::doubles::FOUR;
use super::lanes::{LANES, Lanes};
use super::look::Look;
use super::palette::{Brush, Kind, Palette};
use super::sight::alike;
use super::surface::{Frame, Patch};
use super::texture::{Parts, Texels};
use super::tile::{SIZE, Spot};
use std::ops::Range;

/// Samples whose places are worked out side by side.
const BLOCK: usize = LANES;
const BLOCKS: usize = SIZE / BLOCK;

/// What parts of tiles are coloured with, one after the other.
pub(crate) struct Brushes<'m> {
    /// Directions at depth 1 of a row of samples.
    x: [f64; SIZE],
    y: [f64; SIZE],
    /// Depth at the centre of each sample's pixel.
    center: [f64; SIZE],
    /// Of the triangles that were met.
    palette: Palette<'m>,
    /// Places in the palette of the runs of a row's samples.
    runs: [u32; SIZE],
    row: Row,
    /// Of each pixel in a row.
    pub(super) sums: [Parts; SIZE],
    pub(super) counts: [u32; SIZE],
    pub(super) mixed: [bool; SIZE],
}

/// A row of samples as they lie on what they see.
struct Row {
    /// Along columns and rows of a texture, or weights of the triangle's corners.
    places: [[f64; SIZE]; 2],
    depth: [f64; SIZE],
    /// On a texture, as [`super::texture::Spots`].
    start: [u32; SIZE],
    right: [f32; SIZE],
    down: [f32; SIZE],
}

impl Row {
    const NONE: Self = Self {
        places: [[0.0; SIZE]; 2],
        depth: [0.0; SIZE],
        start: [0; SIZE],
        right: [0.0; SIZE],
        down: [0.0; SIZE],
    };
}

impl<'m> Brushes<'m> {
    pub(crate) fn new() -> Self {
        Self {
            x: [0.0; SIZE],
            y: [0.0; SIZE],
            center: [0.0; SIZE],
            palette: Palette::new(),
            runs: [0; SIZE],
            row: Row::NONE,
            sums: [[0.0; LANES]; SIZE],
            counts: [0; SIZE],
            mixed: [false; SIZE],
        }
    }

    /// Takes the directions of a row's samples; of rows after the first of a part, `again`, only what may
    /// differ.
    #[inline(always)]
    pub(super) fn aim(&mut self, look: &Look<'_>, (row, width): (usize, usize), again: bool) {
        let direction = |column| look.direction(Spot { column, row });
        if look.is_straight() {
            self.y[..width].fill(direction(0).y);
            if again {
                return;
            }
        }
        for column in 0..width {
            let direction = direction(column);
            (self.x[column], self.y[column]) = (direction.x, direction.y);
        }
    }

    /// Takes the depths at the centres of pixels with `side` samples each, whose sums begin.
    #[inline(always)]
    pub(super) fn begin(&mut self, depths: &[f32], side: usize) {
        if side == 1 {
            for (center, &depth) in self.center.iter_mut().zip(depths) {
                *center = f64::from(depth);
            }
        } else {
            for (centers, &depth) in self.center.chunks_exact_mut(side).zip(depths) {
                centers.fill(f64::from(depth));
            }
        }
        self.sums[..depths.len()].fill([0.0; LANES]);
        self.counts[..depths.len()].fill(0);
        self.mixed[..depths.len()].fill(false);
    }

    /// Whether what is seen of a triangle is no surface. To be asked of a tile's triangles between calls of
    /// [`Self::tidy`].
    #[inline(always)]
    pub(crate) fn is_hollow(&mut self, triangle: u32, frame: &Frame<'m>) -> bool {
        let patch = || frame.patch(triangle as usize);
        let place = self.palette.place(triangle, patch);
        self.palette.brush(place).kind == Kind::Nothing
    }

    /// Has room for the triangles of another tile.
    pub(crate) fn tidy(&mut self) {
        self.palette.tidy();
    }

    /// Finds the runs of a row's samples that see one triangle, whose first samples are set in `starts`.
    #[inline(always)]
    pub(super) fn find_runs(&mut self, ids: &[u32], starts: u64, make: impl Fn(u32) -> Patch<'m>) {
        self.palette.tidy();
        let (mut left, mut run) = (starts, 0);
        while left != 0 {
            let id = ids[left.trailing_zeros() as usize % SIZE];
            left &= left - 1;
            self.runs[run % SIZE] = self.palette.place(id, || make(id));
            run += 1;
        }
    }

    /// The brush of a run.
    #[inline(always)]
    fn of_run(&self, run: usize) -> &Brush {
        self.palette.brush(self.runs[run % SIZE])
    }

    /// Places a block of samples that see one triangle. Returns whether their depths are alike their
    /// centres'.
    #[inline(always)]
    fn place_alike(&mut self, run: usize, left: usize) -> bool {
        let (x, y, center) = (
            eight(&self.x, left),
            eight(&self.y, left),
            eight(&self.center, left),
        );
        // Number by number from where they are: copies of other widths would be waited for.
        let [by_x, by_y, own] = &self.of_run(run).axes;
        let (mut scale, mut depth) = ([0.0; BLOCK], [0.0; BLOCK]);
        for i in 0..BLOCK {
            scale[i] = 1.0 / (by_x[0] * x[i] + (by_y[0] * y[i] + own[0]));
            depth[i] = own[3] * scale[i];
        }
        let (mut right, mut below) = ([0.0; BLOCK], [0.0; BLOCK]);
        for i in 0..BLOCK {
            right[i] = (by_x[1] * x[i] + (by_y[1] * y[i] + own[1])) * scale[i];
            below[i] = (by_x[2] * x[i] + (by_y[2] * y[i] + own[2])) * scale[i];
        }
        let mut all = true;
        for i in 0..BLOCK {
            all &= alike(depth[i], center[i]);
        }
        self.row.places[0][left..left + BLOCK].copy_from_slice(&right);
        self.row.places[1][left..left + BLOCK].copy_from_slice(&below);
        self.row.depth[left..left + BLOCK].copy_from_slice(&depth);
        all
    }

    /// Places a block of samples that see several triangles, each on its own. The first bits of `starts` say
    /// where runs begin, the last of which before the block is `run`. Returns whether their depths are alike
    /// their centres'.
    #[inline(always)]
    fn place<L: Lanes>(&mut self, l: L, left: usize, (starts, mut run): (u64, usize)) -> bool {
        let (x, y) = (eight(&self.x, left), eight(&self.y, left));
        let center = eight(&self.center, left);
        let one = l.splat_f64(1.0);
        let mut all = true;
        for half in [0, FOUR] {
            let mut values = [one; FOUR];
            for k in 0..FOUR {
                run = run.wrapping_add((starts >> (half + k) & 1) as usize);
                let [by_x, by_y, own] = &self.of_run(run).axes;
                let along = l.mul_f64(l.load_f64(by_x), l.splat_f64(x[half + k]));
                let down = l.mul_f64(l.load_f64(by_y), l.splat_f64(y[half + k]));
                values[k] = l.add_f64(along, l.add_f64(down, l.load_f64(own)));
            }
            let [normal, right, below, volume] = l.transpose(values);
            let scale = l.div_f64(one, normal);
            let depth = l.store_f64(l.mul_f64(volume, scale));
            for k in 0..FOUR {
                all &= alike(depth[k], center[half + k]);
            }
            let part = left + half..left + half + FOUR;
            let row = &mut self.row;
            row.places[0][part.clone()].copy_from_slice(&l.store_f64(l.mul_f64(right, scale)));
            row.places[1][part.clone()].copy_from_slice(&l.store_f64(l.mul_f64(below, scale)));
            row.depth[part].copy_from_slice(&depth);
        }
        all
    }

    /// Places a row of `width` samples, of which `starts` has the first of each run, and writes what each
    /// block is painted with. Returns as bits the blocks in which depths are not alike their centres'.
    #[inline(always)]
    fn place_row<L: Lanes>(
        &mut self,
        l: L,
        (width, starts): (usize, u64),
        kinds: &mut [Kind; BLOCKS],
    ) -> u32 {
        let (mut unlike, mut run) = (0, usize::MAX);
        for left in (0..width).step_by(BLOCK) {
            let here = starts >> left;
            let last = run.wrapping_add((here & 0xff).count_ones() as usize);
            let first = run.wrapping_add((here & 1) as usize);
            let mut kind = self.of_run(first).kind;
            let mut all = true;
            if first == last {
                if kind != Kind::Nothing {
                    all = self.place_alike(first, left);
                }
            } else {
                for run in first + 1..=last {
                    if self.of_run(run).kind != kind {
                        kind = Kind::Several;
                    }
                }
                all = self.place(l, left, (here, run));
            }
            // Blocks that end early have a second run, of samples that are not there.
            kinds[left / BLOCK % BLOCKS] = kind;
            unlike |= u32::from(!all) << (left / BLOCK % BLOCKS);
            run = last;
        }
        unlike
    }

    /// Adds a row of `width` samples to the sums of their pixels, `side` of them to each.
    #[inline(always)]
    pub(super) fn add_row<L: Lanes>(&mut self, l: L, (width, side): (usize, usize), starts: u64) {
        let mut kinds = [Kind::Nothing; BLOCKS];
        let unlike = self.place_row(l, (width, starts), &mut kinds);
        let blocks = width.div_ceil(BLOCK).min(BLOCKS);
        let mut first = 0;
        while first < blocks {
            let kind = kinds[first];
            let others = kinds[first..blocks].iter().position(|&next| next != kind);
            let end = others.map_or(blocks, |count| first + count);
            let range = first * BLOCK..width.min(end * BLOCK);
            match kind {
                Kind::Nothing => {
                    self.mixed[range.start / side..range.end.div_ceil(side)].fill(true);
                }
                Kind::Texture(place) if self.find(place, range.clone()) => {
                    if unlike >> first & ((1 << (end - first)) - 1) != 0 {
                        self.compare(range.clone(), side);
                    }
                    self.add(l, place, (range, side));
                }
                Kind::Texture(_) | Kind::Paint(_) | Kind::Several => {
                    self.add_each(l, range, side, starts);
                }
            }
            first = end;
        }
    }

    /// Finds where samples in whole blocks lie on a texture; false where some lie at its very end.
    #[inline(always)]
    fn find(&mut self, place: u32, range: Range<usize>) -> bool {
        let texels = *self.palette.texture(place);
        let mut last = [0; BLOCK];
        let Row {
            places: [x, y],
            start,
            right,
            down,
            ..
        } = &mut self.row;
        for left in range.step_by(BLOCK) {
            let spots = texels.find_inside([eight(x, left), eight(y, left)]);
            texels.fetch(spots.start[0]);
            for i in 0..BLOCK {
                last[i] = spots.start[i].max(last[i]);
            }
            let part = left..left + BLOCK;
            start[part.clone()].copy_from_slice(&spots.start);
            right[part.clone()].copy_from_slice(&spots.right);
            down[part].copy_from_slice(&spots.down);
        }
        texels.are_inside(&last)
    }

    /// Adds samples in whole blocks that lie well inside a texture.
    #[inline(always)]
    fn add<L: Lanes>(&mut self, l: L, place: u32, (range, side): (Range<usize>, usize)) {
        let texels = *self.palette.texture(place);
        match side {
            1 => self.gather::<L, 1>(l, &texels, range),
            2 => self.gather::<L, 2>(l, &texels, range),
            4 => self.gather::<L, 4>(l, &texels, range),
            _ => {
                for at in range {
                    let pixel = at / side;
                    let sum = l.add(l.load(&self.sums[pixel]), self.color(l, &texels, at));
                    self.sums[pixel] = l.store(sum);
                    self.counts[pixel] += 1;
                }
            }
        }
    }

    #[inline(always)]
    fn color<L: Lanes>(&self, l: L, texels: &Texels<'_>, at: usize) -> L::V {
        let Row {
            start, right, down, ..
        } = &self.row;
        let at = at % SIZE;
        texels.color_well_inside(l, start[at], (right[at], down[at]))
    }

    /// Adds the colours of whole blocks, `SIDE` to each pixel.
    #[inline(always)]
    fn gather<L: Lanes, const SIDE: usize>(
        &mut self,
        l: L,
        texels: &Texels<'_>,
        range: Range<usize>,
    ) {
        for pixel in range.start / SIDE..range.end / SIDE {
            let mut sum = l.load(&self.sums[pixel]);
            for k in 0..SIDE {
                sum = l.add(sum, self.color(l, texels, pixel * SIDE + k));
            }
            self.sums[pixel] = l.store(sum);
            self.counts[pixel] += SIDE as u32;
        }
    }

    /// As [`Self::add`], sample by sample.
    #[inline(never)]
    fn add_each<L: Lanes>(&mut self, l: L, range: Range<usize>, side: usize, starts: u64) {
        let before = (1u64 << range.start) - 1;
        let mut run = ((starts & before).count_ones() as usize).wrapping_sub(1);
        for at in range {
            run = run.wrapping_add((starts >> at & 1) as usize);
            let pixel = at / side;
            let Row { places, depth, .. } = &self.row;
            let place = [places[0][at], places[1][at]];
            let Some(color) = self.palette.color(l, self.of_run(run).kind, place) else {
                self.mixed[pixel] = true;
                continue;
            };
            self.mixed[pixel] |= !alike(depth[at], self.center[at]);
            self.sums[pixel] = l.store(l.add(l.load(&self.sums[pixel]), color));
            self.counts[pixel] += 1;
        }
    }

    /// Notes which pixels have samples whose depths are not alike their centres'.
    #[cold]
    #[inline(never)]
    fn compare(&mut self, range: Range<usize>, side: usize) {
        for at in range {
            self.mixed[at / side] |= !alike(self.row.depth[at], self.center[at]);
        }
    }
}

/// Eight numbers of a row from one on.
#[inline(always)]
fn eight(row: &[f64; SIZE], left: usize) -> [f64; BLOCK] {
    row.as_chunks().0[left / BLOCK % BLOCKS]
}
