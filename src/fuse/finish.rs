//! The columns of finished points, a block at a time in the machine's vectors.

#![allow(
    clippy::needless_range_loop,
    reason = "columns are walked side by side, and closures would leave the instruction set"
)]

use super::confident::Rows;
use super::consensus::Consensus;
use super::geometry::unprojection;
use super::kernel::{BLOCK, Block, Seen};
use super::rows::Entries;
use super::samples::Unit;
use super::source::Photo;
use crate::ahead::prefetch;
use glam::{DMat3, DVec3, Vec3};
use mvs_datasets::scene::View;
use pulp::{Simd, WithSimd};

/// From a view's pixels, and planes in its inverse depth, to the world.
pub(super) struct Frame {
    /// By column, R⁻¹·K⁻¹: pixel (u, v, 1) at unit depth to a direction in the world.
    ray: [[f64; 3]; 3],
    /// By column, −R⁻¹·Kᵀ: (a, b, c) of 1/d = a·u + b·v + c to a normal that faces the camera.
    normal: [[f64; 3]; 3],
    center: [f64; 3],
    /// Mean focal length in pixels.
    focal: f64,
}

impl Frame {
    pub(super) fn new(view: &View) -> Self {
        let axes = [DVec3::X, DVec3::Y, DVec3::Z].map(|axis| view.pose.direction_to_world(axis));
        let turn = DMat3::from_cols(axes[0], axes[1], axes[2]);
        Self {
            ray: (turn * unprojection(view)).to_cols_array_2d(),
            normal: (-(turn * view.camera.intrinsics().transpose())).to_cols_array_2d(),
            center: view.pose.center_in_world().to_array(),
            focal: 0.5 * (view.camera.focal().x + view.camera.focal().y),
        }
    }
}

/// Room for a block's columns; entries of pixels that are not kept mean nothing.
pub(super) struct Room {
    position: [[f64; BLOCK]; 3],
    /// Depth over focal length.
    scale: [f32; BLOCK],
    /// Views that agree, the reference counted.
    views: [u32; BLOCK],
    /// A bit per pixel on which enough sources agree, one per pixel that lies to the right of the entry before,
    /// and one per pixel that lies in its row.
    enough: u64,
    follows: u64,
    beside: u64,
    /// Stored values of the 3×3 pixels around each, rows from the top.
    windows: [[f32; BLOCK]; 9],
    normal: [[f32; BLOCK]; 3],
    /// A bit for each where all of the window counts.
    whole: u64,
    /// Pixels of each source's image: their place, then their colour, red in the lowest byte.
    texels: Vec<[u32; BLOCK]>,
    sums: [[u32; BLOCK]; 3],
    colored: [u32; BLOCK],
    /// Mixed ones, if there are any.
    colors: [[u8; 3]; BLOCK],
}

impl Room {
    pub(super) fn new(sources: usize) -> Self {
        Self {
            position: [[0.0; BLOCK]; 3],
            scale: [0.0; BLOCK],
            views: [0; BLOCK],
            enough: 0,
            follows: 0,
            beside: 0,
            windows: [[1.0; BLOCK]; 9],
            normal: [[0.0; BLOCK]; 3],
            whole: 0,
            texels: vec![[0; BLOCK]; sources],
            sums: [[0; BLOCK]; 3],
            colored: [0; BLOCK],
            // White without an image.
            colors: [[255; 3]; BLOCK],
        }
    }

    pub(super) fn position(&self, i: usize) -> DVec3 {
        let [x, y, z] = &self.position;
        DVec3::new(x[i], y[i], z[i])
    }

    /// Of the first `len` pixels, a bit for each on which enough sources agree.
    pub(super) fn enough(&self, len: usize) -> u64 {
        self.enough & first(len)
    }

    /// Of these entries, the first ones that lie in one row of the map.
    #[inline(always)]
    pub(super) fn of_one_row(&self, entries: u64) -> u64 {
        let first = entries.trailing_zeros();
        let others = u64::MAX.checked_shl(first + 1).unwrap_or(0) & !self.beside;
        let next = others & others.wrapping_neg();
        entries & next.wrapping_sub(1)
    }

    /// A bit for each pixel whose window is whole: then its normal is there.
    pub(super) fn whole(&self) -> u64 {
        self.whole
    }

    pub(super) fn set_normal(&mut self, i: usize, normal: Vec3) {
        for (axis, value) in self.normal.iter_mut().zip(normal.to_array()) {
            axis[i] = value;
        }
    }

    /// Copies the windows around all pixels, stretch by stretch of those that lie side by side: what is copied
    /// past the end of one is overwritten by the next, or means nothing.
    pub(super) fn copy_windows(&mut self, block: &Block, map: Rows<'_>) {
        let mut starts = !self.follows & first(block.len);
        while starts != 0 {
            let start = starts.trailing_zeros() as usize;
            starts &= starts - 1;
            let end = (starts.trailing_zeros() as usize).min(block.len);
            let place = block.place[start] as usize;
            for (at, windows) in self.windows.iter_mut().enumerate() {
                let from = map.of_neighbour(place, at);
                let to = &mut windows[start..];
                match (from.first_chunk::<STEP>(), to.first_chunk_mut::<STEP>()) {
                    (Some(from), Some(to)) if end - start <= STEP => *to = *from,
                    _ => to[..end - start].copy_from_slice(&from[..end - start]),
                }
            }
        }
    }

    /// The window that was copied.
    pub(super) fn window(&self, i: usize) -> [[f32; 3]; 3] {
        std::array::from_fn(|row| std::array::from_fn(|column| self.windows[3 * row + column][i]))
    }

    /// Begins the means of colours of the `kept` with the reference's own.
    pub(super) fn own_colors(&mut self, kept: u64, color: impl Fn(usize) -> [u8; 3]) {
        self.colored = [1; BLOCK];
        for i in entries(kept) {
            let own = color(i);
            for channel in 0..3 {
                self.sums[channel][i] = u32::from(own[channel]);
            }
        }
    }

    /// Asks for the texels of a source's `photo`, which are to be fetched later.
    pub(super) fn ask(&self, source: usize, kept: u64, photo: &Photo) {
        let (texels, values) = (&self.texels[source], photo.part.values());
        entries(kept).for_each(|i| prefetch(values, texels[i] as usize));
    }

    /// Replaces the places of a source's texels by their colours.
    pub(super) fn fetch(&mut self, source: usize, kept: u64, photo: &Photo) {
        let (texels, values) = (&mut self.texels[source], photo.part.values());
        for i in entries(kept) {
            let [red, green, blue] = values[texels[i] as usize];
            texels[i] = u32::from_le_bytes([red, green, blue, 0]);
        }
    }

    /// Keeps the colours that were mixed.
    pub(super) fn keep_colors(&mut self) {
        let [red, green, blue] = &self.sums;
        for (i, color) in self.colors.iter_mut().enumerate() {
            *color = [red, green, blue].map(|channel| channel[i].to_le_bytes()[0]);
        }
    }
}

/// The numbers of the bits that are set, in order.
#[inline(always)]
pub(super) fn entries(mut bits: u64) -> impl Iterator<Item = usize> {
    std::iter::from_fn(move || {
        let next = bits.trailing_zeros() as usize;
        let some = bits != 0;
        bits &= bits.wrapping_sub(1);
        some.then_some(next % BLOCK)
    })
}

/// A bit for each of the first `len` entries.
fn first(len: usize) -> u64 {
    let beyond = BLOCK.saturating_sub(len);
    u64::MAX.checked_shr(beyond as u32).unwrap_or(0)
}

/// Points that a block became, as far as they were found.
pub(super) struct BlockPoints<'a> {
    pub(super) block: &'a Block,
    pub(super) consensus: &'a Consensus,
    pub(super) room: &'a Room,
    /// The first of the map's rows that are worked on.
    pub(super) first_row: usize,
    /// By pixel; 1 without.
    pub(super) confidences: Option<&'a [f32]>,
    /// Where colours are those of its pixels; else they are the mixed ones.
    pub(super) photo: Option<&'a Photo>,
}

impl BlockPoints<'_> {
    /// The row of a point, from the first that is worked on.
    #[inline(always)]
    pub(super) fn row(&self, i: usize) -> usize {
        self.block.row[i] as usize - self.first_row
    }
}

impl Entries for BlockPoints<'_> {
    #[inline(always)]
    fn position(&self, i: usize) -> [f64; 3] {
        self.room.position.each_ref().map(|axis| axis[i])
    }

    #[inline(always)]
    fn normal(&self, i: usize) -> [f32; 3] {
        self.room.normal.each_ref().map(|axis| axis[i])
    }

    #[inline(always)]
    fn color(&self, i: usize) -> [u8; 3] {
        match self.photo {
            Some(photo) => photo.part.values()[photo.place(self.block.at(i))],
            None => self.room.colors[i],
        }
    }

    #[inline(always)]
    fn view_count(&self, i: usize) -> u32 {
        self.room.views[i]
    }

    #[inline(always)]
    fn confidence(&self, i: usize) -> f32 {
        match self.confidences {
            Some(map) => map[self.block.pixel[i] as usize],
            None => 1.0,
        }
    }

    #[inline(always)]
    fn extras(&self, i: usize) -> (u32, f32) {
        (self.consensus.violations[i], self.room.scale[i])
    }

    #[inline(always)]
    fn pixel(&self, i: usize) -> u32 {
        self.block.pixel[i]
    }
}

/// Entries that are copied at a time.
const STEP: usize = 16;

/// Where the block's points lie: at the fused depths.
pub(super) struct Place<'a> {
    pub(super) frame: &'a Frame,
    pub(super) block: &'a Block,
    pub(super) consensus: &'a Consensus,
    pub(super) room: &'a mut Room,
}

impl WithSimd for Place<'_> {
    type Output = ();

    #[inline(always)]
    #[allow(clippy::cast_possible_truncation, reason = "a size for display")]
    fn with_simd<S: Simd>(self, _: S) {
        let (block, [a, b, c]) = (self.block, self.frame.ray);
        let per_focal = 1.0 / self.frame.focal;
        for i in 0..BLOCK {
            let (u, v) = (f64::from(block.u[i]), f64::from(block.v[i]));
            let depth = f64::from(block.depth[i]) + f64::from(self.consensus.delta[i]);
            for axis in 0..3 {
                let direction = a[axis].mul_add(u, b[axis].mul_add(v, c[axis]));
                self.room.position[axis][i] = depth.mul_add(direction, self.frame.center[axis]);
            }
            self.room.scale[i] = (depth * per_focal) as f32;
        }
        for i in 0..BLOCK {
            self.room.views[i] = self.consensus.count[i] + 1;
        }
        let (mut enough, mut follows, mut beside) = (0, 0, 0);
        for i in 0..BLOCK {
            enough |= u64::from(self.consensus.enough[i]) << i;
        }
        for i in 1..BLOCK {
            follows |= u64::from(block.place[i] == block.place[i - 1] + 1) << i;
        }
        for i in 1..BLOCK {
            beside |= u64::from(block.row[i] == block.row[i - 1]) << i;
        }
        (self.room.enough, self.room.follows, self.room.beside) = (enough, follows, beside);
    }
}

/// `gipuma`: moves the points to the mean of theirs and those of the agreeing sources. A source's
/// point is C + (X − C) · sampled / expected depth, C its centre.
pub(super) struct Gather<'a> {
    /// The sources' centres in the world, and what they say.
    pub(super) centers: &'a [DVec3],
    pub(super) seen: &'a [Seen],
    pub(super) consensus: &'a Consensus,
    pub(super) room: &'a mut Room,
}

impl WithSimd for Gather<'_> {
    type Output = ();

    #[inline(always)]
    #[allow(clippy::cast_possible_wrap, reason = "a number of views")]
    fn with_simd<S: Simd>(self, _: S) {
        for axis in 0..3 {
            let at = &mut self.room.position[axis];
            let mut moved = [0.0f64; BLOCK];
            for (center, seen) in self.centers.iter().zip(self.seen) {
                let center = center[axis];
                for i in 0..BLOCK {
                    let by = (1.0 / f64::from(seen.ratio[i]) - 1.0) * (at[i] - center);
                    moved[i] += if seen.agrees[i] == 1 { by } else { 0.0 };
                }
            }
            for i in 0..BLOCK {
                at[i] += moved[i] / f64::from((self.consensus.count[i] + 1) as i32);
            }
        }
    }
}

/// Which way the planes through whole windows face: [`super::normals`], for the common case.
pub(super) struct Face<'a> {
    pub(super) frame: &'a Frame,
    pub(super) block: &'a Block,
    pub(super) unit: Unit,
    /// Largest relative difference of inverse depths from the middle one.
    pub(super) similar: f64,
    pub(super) room: &'a mut Room,
}

impl WithSimd for Face<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        match self.unit {
            Unit::Inverse => self.all(|value, _, inverse| value * inverse),
            // 0, which is no depth, becomes ∞ and is not similar.
            Unit::Depth => self.all(|value, middle, _| middle / value),
        }
    }
}

impl Face<'_> {
    #[inline(always)]
    #[allow(clippy::cast_possible_truncation, reason = "normals are f32")]
    fn all(self, ratio: impl Fn(f64, f64, f64) -> f64) {
        let (block, [a, b, c]) = (self.block, self.frame.normal);
        let Room {
            windows,
            normal,
            whole,
            ..
        } = self.room;
        let mut wholes = [false; BLOCK];
        for i in 0..BLOCK {
            let middle = f64::from(windows[4][i]);
            let inverse = 1.0 / middle;
            let mut off = [0.0f64; 9];
            let mut all = true;
            for at in 0..9 {
                off[at] = ratio(f64::from(windows[at][i]), middle, inverse) - 1.0;
                all &= off[at].abs() <= self.similar;
            }
            let column = |at: usize| off[at] + off[at + 3] + off[at + 6];
            let row = |at: usize| off[at] + off[at + 1] + off[at + 2];
            let slope_u = (column(2) - column(0)) / 6.0;
            let slope_v = (row(6) - row(0)) / 6.0;
            let offset = (column(0) + column(1) + column(2)) / 9.0;
            let (u, v) = (f64::from(block.u[i]), f64::from(block.v[i]));
            let constant = 1.0 + offset - slope_u * u - slope_v * v;
            let along = |axis: usize| a[axis] * slope_u + b[axis] * slope_v + c[axis] * constant;
            let (x, y, z) = (along(0), along(1), along(2));
            let length = (x * x + y * y + z * z).sqrt();
            normal[0][i] = (x / length) as f32;
            normal[1][i] = (y / length) as f32;
            normal[2][i] = (z / length) as f32;
            wholes[i] = all & (length > 0.0);
        }
        *whole = 0;
        for i in 0..BLOCK {
            *whole |= u64::from(wholes[i]) << i;
        }
    }
}

/// Where a source's photograph shows the block: its nearest pixels, clamped to the part at hand.
pub(super) struct Locate<'a> {
    pub(super) seen: &'a Seen,
    /// Pixels of the image per pixel of the depth map.
    pub(super) scale: [f32; 2],
    /// Column and row of the part, and its size.
    pub(super) corner: (u32, u32),
    pub(super) size: (u32, u32),
    /// The number of the source, and room.
    pub(super) to: (usize, &'a mut Room),
}

impl WithSimd for Locate<'_> {
    type Output = ();

    #[inline(always)]
    #[allow(clippy::cast_precision_loss, reason = "image sizes are far below 2^23")]
    fn with_simd<S: Simd>(self, _: S) {
        let (seen, [wide, high]) = (self.seen, self.scale);
        let (left, top) = (self.corner.0 as f32, self.corner.1 as f32);
        let (width, height) = self.size;
        let texels = &mut self.to.1.texels[self.to.0];
        let (last_column, last_row) = ((width - 1) as f32, (height - 1) as f32);
        for i in 0..BLOCK {
            // Exact where it lies in the part: the difference has no more digits than the position.
            let column = whole((seen.x[i] - 0.5) * wide - left, last_column);
            let row = whole((seen.y[i] - 0.5) * high - top, last_row);
            texels[i] = seen.agrees[i] * (row * width + column);
        }
    }
}

/// The whole part of `value`, from 0 to `last`, which is whole and below 2^23.
#[inline(always)]
fn whole(value: f32, last: f32) -> u32 {
    const ROUND: f32 = 8_388_608.0;
    let value = if value > 0.0 { value.floor() } else { 0.0 };
    let value = if value < last { value } else { last };
    (value + ROUND).to_bits() & 0x7f_ffff
}

/// Adds the texels of an agreeing source to the sums.
pub(super) struct Add<'a> {
    pub(super) agrees: &'a [u32; BLOCK],
    /// The number of the source, and room.
    pub(super) to: (usize, &'a mut Room),
}

impl WithSimd for Add<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let (source, room) = self.to;
        let Room {
            texels,
            sums,
            colored,
            ..
        } = room;
        let texels = &texels[source];
        for i in 0..BLOCK {
            let (texel, agrees) = (texels[i], self.agrees[i]);
            sums[0][i] += agrees * (texel & 255);
            sums[1][i] += agrees * ((texel >> 8) & 255);
            sums[2][i] += agrees * ((texel >> 16) & 255);
            colored[i] += agrees;
        }
    }
}

/// Turns sums of bytes into their means, to the nearest.
pub(super) struct Mean<'a>(pub(super) &'a mut Room);

impl WithSimd for Mean<'_> {
    type Output = ();

    #[inline(always)]
    #[allow(
        clippy::cast_precision_loss,
        clippy::cast_possible_wrap,
        reason = "sums of bytes over fewer than 2^16 views"
    )]
    fn with_simd<S: Simd>(self, _: S) {
        let Room { sums, colored, .. } = self.0;
        for channel in sums {
            for i in 0..BLOCK {
                // The quotient is a whole number or at least 1/count away from the next above.
                let sum = (channel[i] + colored[i] / 2) as i32 as f32;
                channel[i] = whole(sum / colored[i] as i32 as f32, 255.0);
            }
        }
    }
}

#[cfg(test)]
mod tests;
