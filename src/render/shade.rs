//! The colours of a part of a tile: where its samples lie on their triangles' textures by vector operations
//! in f64, eight side by side, then texel by texel into the sums of their pixels.
//!
//! Each operation is that of [`Patch::glimpse`] and [`super::sight::Samples`], never fused, so that all sets
//! of instructions give the same bytes.

#![allow(
    clippy::needless_range_loop,
    reason = "columns are walked side by side, and closures would leave the instruction set"
)]

use super::doubles::FOUR;
use super::lanes::{LANES, Lanes, Task, dispatch};
use super::look::Look;
use super::maps::starts;
use super::picture::Maps;
use super::sight::{Samples, Sight, alike};
use super::surface::{Frame, Paint, Patch};
use super::texture::{Parts, Texels};
use super::tile::{NONE, SIZE, Spot};
use glam::DVec3;
use std::ops::Range;

/// Samples whose places are worked out side by side.
const BLOCK: usize = LANES;
const BLOCKS: usize = SIZE / BLOCK;
/// Slots of the memory of triangles that have been met.
const SLOTS: usize = 256;
/// Patches that are kept at most, but for those of one row.
const MOST: usize = 1024;

/// What parts of tiles are coloured with, one after the other.
pub(crate) struct Brushes<'m> {
    /// Directions at depth 1 of a row of samples.
    x: [f64; SIZE],
    y: [f64; SIZE],
    /// Depth at the centre of each sample's pixel.
    center: [f64; SIZE],
    /// Of the triangles that were met; the first stands for none.
    brushes: Vec<Brush<'m>>,
    /// Their textures.
    textures: Vec<Texels<'m>>,
    /// Triangles met of late, by their number, with their place in `brushes`.
    met: [(u32, u32); SLOTS],
    /// Places in `brushes` of the runs of a row's samples.
    runs: [u32; SIZE],
    row: Row,
    /// Of each pixel in a row.
    sums: [Parts; SIZE],
    counts: [u32; SIZE],
    mixed: [bool; SIZE],
}

/// A triangle as it is painted.
struct Brush<'m> {
    /// By x, by y and as they are: the parts of the normal's share, of both places', and of the volume, as
    /// [`Patch`] has them.
    axes: [[f64; FOUR]; 3],
    kind: Kind,
    /// `None` where it is no surface.
    patch: Option<Patch<'m>>,
}

/// What is painted.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Kind {
    /// No surface.
    Nothing,
    /// A texture that ends at its border: its place among those that were met.
    Texture(u32),
    Other,
}

impl<'m> Brush<'m> {
    const NONE: Self = Self {
        axes: [[0.0; FOUR]; 3],
        kind: Kind::Nothing,
        patch: None,
    };

    fn new(patch: Patch<'m>, textures: &mut Vec<Texels<'m>>) -> Self {
        let axes = |part: fn(DVec3) -> f64, volume: f64| {
            [part(patch.normal), part(patch.x), part(patch.y), volume]
        };
        let kind = match &patch.paint {
            _ if patch.back => Kind::Nothing,
            Paint::Texture(texels, _) if !texels.repeats() => {
                let met = textures.iter().rposition(|met| met.is(texels));
                let place = met.unwrap_or_else(|| {
                    textures.push(*texels);
                    textures.len() - 1
                });
                #[allow(
                    clippy::cast_possible_truncation,
                    reason = "as many as there are brushes"
                )]
                Kind::Texture(place as u32)
            }
            Paint::Texture(..) | Paint::Tinted(..) | Paint::Linear(_) => Kind::Other,
        };
        Self {
            axes: [
                axes(|axis| axis.x, 0.0),
                axes(|axis| axis.y, 0.0),
                axes(|axis| axis.z, patch.volume),
            ],
            kind,
            patch: (!patch.back).then_some(patch),
        }
    }
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
            brushes: vec![Brush::NONE],
            textures: Vec::new(),
            met: [(NONE, 0); SLOTS],
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
    fn aim(&mut self, look: &Look<'_>, (row, width): (usize, usize), again: bool) {
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
    fn begin(&mut self, depths: &[f32], side: usize) {
        for (centers, &depth) in self.center.chunks_exact_mut(side).zip(depths) {
            centers.fill(f64::from(depth));
        }
        self.sums[..depths.len()].fill([0.0; LANES]);
        self.counts[..depths.len()].fill(0);
        self.mixed[..depths.len()].fill(false);
    }

    /// Finds the runs of a row's samples that see one triangle, whose first samples are set in `starts`.
    #[inline(always)]
    fn find_runs(&mut self, ids: &[u32], starts: u64, make: impl Fn(u32) -> Patch<'m>) {
        if self.brushes.len() > MOST {
            self.brushes.truncate(1);
            self.textures.clear();
            self.met = [(NONE, 0); SLOTS];
        }
        let (mut left, mut run) = (starts, 0);
        while left != 0 {
            let id = ids[left.trailing_zeros() as usize % SIZE];
            left &= left - 1;
            // None is met from the start.
            let slot = &mut self.met[id as usize % SLOTS];
            let known = slot.0 == id;
            self.runs[run % SIZE] = match (id, known) {
                (NONE, _) => 0,
                (_, true) => slot.1,
                (_, false) => {
                    #[allow(clippy::cast_possible_truncation, reason = "some thousand at most")]
                    let place = self.brushes.len() as u32;
                    let brush = Brush::new(make(id), &mut self.textures);
                    self.brushes.push(brush);
                    *slot = (id, place);
                    place
                }
            };
            run += 1;
        }
    }

    /// The brush of a run.
    #[inline(always)]
    fn of_run(&self, run: usize) -> &Brush<'m> {
        &self.brushes[self.runs[run % SIZE] as usize]
    }

    /// Places a block of samples that see one triangle.
    #[inline(always)]
    fn place_alike(&mut self, run: usize, left: usize) {
        let (x, y) = (eight(&self.x, left), eight(&self.y, left));
        let (mut places, mut depth) = ([[0.0; BLOCK]; 2], [0.0; BLOCK]);
        let axes = &self.of_run(run).axes;
        let [normal, right, below, volume] = [0, 1, 2, 3].map(|i| axes.map(|axis| axis[i]));
        for i in 0..BLOCK {
            let share = |[by_x, by_y, own]: [f64; 3]| by_x * x[i] + (by_y * y[i] + own);
            let scale = 1.0 / share(normal);
            places[0][i] = share(right) * scale;
            places[1][i] = share(below) * scale;
            depth[i] = volume[2] * scale;
        }
        self.row.places[0][left..left + BLOCK].copy_from_slice(&places[0]);
        self.row.places[1][left..left + BLOCK].copy_from_slice(&places[1]);
        self.row.depth[left..left + BLOCK].copy_from_slice(&depth);
    }

    /// Places a block of samples that see several triangles, each on its own. The first bits of `starts` say
    /// where runs begin, the last of which before the block is `run`.
    #[inline(always)]
    fn place<L: Lanes>(&mut self, l: L, left: usize, (starts, mut run): (u64, usize)) {
        let (x, y) = (eight(&self.x, left), eight(&self.y, left));
        let one = l.splat_f64(1.0);
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
            let part = left + half..left + half + FOUR;
            let row = &mut self.row;
            row.places[0][part.clone()].copy_from_slice(&l.store_f64(l.mul_f64(right, scale)));
            row.places[1][part.clone()].copy_from_slice(&l.store_f64(l.mul_f64(below, scale)));
            row.depth[part].copy_from_slice(&l.store_f64(l.mul_f64(volume, scale)));
        }
    }

    /// Places a row of `width` samples, of which `starts` has the first of each run. Returns what each block
    /// is painted with.
    #[inline(always)]
    fn place_row<L: Lanes>(&mut self, l: L, width: usize, starts: u64) -> [Kind; BLOCKS] {
        let mut kinds = [Kind::Nothing; BLOCKS];
        let mut run = usize::MAX;
        for left in (0..width).step_by(BLOCK) {
            let here = starts >> left;
            let last = run.wrapping_add((here & 0xff).count_ones() as usize);
            let first = run.wrapping_add((here & 1) as usize);
            let mut kind = self.of_run(first).kind;
            if first == last {
                if kind != Kind::Nothing {
                    self.place_alike(first, left);
                }
            } else {
                for run in first + 1..=last {
                    if self.of_run(run).kind != kind {
                        kind = Kind::Other;
                    }
                }
                self.place(l, left, (here, run));
            }
            // Blocks that end early have a second run, of samples that are not there.
            kinds[left / BLOCK % BLOCKS] = kind;
            run = last;
        }
        kinds
    }

    /// Adds a row of `width` samples to the sums of their pixels, `side` of them to each.
    #[inline(always)]
    fn add_row<L: Lanes>(&mut self, l: L, (width, side): (usize, usize), starts: u64) {
        let kinds = self.place_row(l, width, starts);
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
                    self.add(l, place, (range, side));
                }
                Kind::Texture(_) | Kind::Other => self.add_each(l, range, side, starts),
            }
            first = end;
        }
    }

    /// Finds where samples in whole blocks lie on a texture; false where some lie at its very end.
    #[inline(always)]
    fn find(&mut self, place: u32, range: Range<usize>) -> bool {
        let texels = self.textures[place as usize];
        let mut inside = true;
        let Row {
            places: [x, y],
            start,
            right,
            down,
            ..
        } = &mut self.row;
        for left in range.step_by(BLOCK) {
            let spots = texels.find_inside([eight(x, left), eight(y, left)]);
            inside &= texels.are_inside(&spots.start);
            let part = left..left + BLOCK;
            start[part.clone()].copy_from_slice(&spots.start);
            right[part.clone()].copy_from_slice(&spots.right);
            down[part].copy_from_slice(&spots.down);
        }
        inside
    }

    /// Adds samples in whole blocks that lie well inside a texture.
    #[inline(always)]
    fn add<L: Lanes>(&mut self, l: L, place: u32, (range, side): (Range<usize>, usize)) {
        let mut all = true;
        for left in range.clone().step_by(BLOCK) {
            let (depth, center) = (eight(&self.row.depth, left), eight(&self.center, left));
            for i in 0..BLOCK {
                all &= alike(depth[i], center[i]);
            }
        }
        if !all {
            self.compare(range.clone(), side);
        }
        let texels = self.textures[place as usize];
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
            let Some(patch) = &self.of_run(run).patch else {
                self.mixed[pixel] = true;
                continue;
            };
            let Row { places, depth, .. } = &self.row;
            let color = patch.paint.color(l, [places[0][at], places[1][at]]);
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

/// Eight numbers of a row from one on.
#[inline(always)]
fn eight(row: &[f64; SIZE], left: usize) -> [f64; BLOCK] {
    row.as_chunks().0[left / BLOCK % BLOCKS]
}

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
        let whole = (self.counts[..count].iter()).all(|&count| count == samples)
            && !self.mixed[..count].contains(&true)
            && (maps.sights(pixels).iter()).all(|&sight| sight == Sight::Surface);
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
}
