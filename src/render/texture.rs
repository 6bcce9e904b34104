//! Bilinear texture lookup.
//!
//! Places are counted in texels: 0 is the centre of the first one along an axis. Colours come as two
//! parts that are yet to be added, since both texels of a row lie side by side in memory and are
//! weighed side by side; every sum of samples is therefore kept in eight parts.

#![allow(
    clippy::needless_range_loop,
    reason = "columns are walked side by side"
)]

use super::lanes::{LANES, Lanes};
use crate::ahead::prefetch;
use crate::error::{Error, Result};
use glam::{Vec2, Vec3};
use mvs_datasets::scene::{ColorImage, Corner, Raster};

/// What lies beyond the border of a texture.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Border {
    /// The outermost texels go on.
    Clamp,
    /// The texture starts again.
    Repeat,
}

impl Border {
    /// A triangle whose corners all lie on the texture never reads across its border, as an atlas
    /// needs; any other triangle sees the texture repeated, as OBJ viewers show it.
    pub(crate) fn of(corners: &Corner) -> Self {
        let unit = |coord: &Vec2| coord.cmpge(Vec2::ZERO).all() && coord.cmple(Vec2::ONE).all();
        if corners.iter().all(unit) {
            Self::Clamp
        } else {
            Self::Repeat
        }
    }
}

/// One axis of a texture.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Axis {
    size: u32,
    border: Border,
    /// The last texel, and the last that is the first of two.
    end: f64,
    last: f64,
}

/// 1.5 · 2^52: a number from 0 to 2^32 that is added to it stands in the lowest bits of the sum.
const MAGIC: f64 = 6_755_399_441_055_744.0;

/// Texels along an axis, as whole numbers, and the weights of the ones after them.
type Found<const N: usize> = ([f64; N], [f32; N]);

impl Axis {
    fn new(size: u32, border: Border) -> Self {
        let end = f64::from(size) - 1.0;
        Self {
            size,
            border,
            end,
            last: if end > 1.0 { end - 1.0 } else { 0.0 },
        }
    }

    /// The first of two texels beside each place and the weight of the second. What is no number is
    /// 0. (Step by step, which the compiler turns into vector instructions.)
    #[inline(always)]
    fn find<const N: usize>(self, places: [f64; N]) -> Found<N> {
        match self.border {
            Border::Clamp => self.find_clamped(places),
            Border::Repeat => self.find_repeated(places),
        }
    }

    #[inline(always)]
    fn find_clamped<const N: usize>(self, mut places: [f64; N]) -> Found<N> {
        // The last texel is the second of two, with weight 1.
        let (end, last) = (self.end, self.last);
        for place in &mut places {
            *place = if *place > 0.0 { *place } else { 0.0 };
        }
        for place in &mut places {
            *place = if *place < end { *place } else { end };
        }
        let mut texels = places;
        for texel in &mut texels {
            *texel = texel.floor();
        }
        for texel in &mut texels {
            *texel = if *texel < last { *texel } else { last };
        }
        (texels, weights(&places, &texels))
    }

    #[inline(always)]
    fn find_repeated<const N: usize>(self, mut places: [f64; N]) -> Found<N> {
        let size = f64::from(self.size);
        let inverse = 1.0 / size;
        for place in &mut places {
            *place -= size * (*place * inverse).floor();
        }
        for place in &mut places {
            *place = if *place > 0.0 { *place } else { 0.0 };
        }
        for place in &mut places {
            *place = if *place < size { *place } else { 0.0 };
        }
        let mut texels = places;
        for texel in &mut texels {
            *texel = texel.floor();
        }
        (texels, weights(&places, &texels))
    }

    /// The texel after one.
    #[inline(always)]
    fn after(self, texel: u32) -> u32 {
        if texel + 1 < self.size {
            return texel + 1;
        }
        match self.border {
            Border::Clamp => texel,
            Border::Repeat => 0,
        }
    }
}

#[inline(always)]
#[allow(clippy::cast_possible_truncation, reason = "between 0 and 1")]
fn weights<const N: usize>(places: &[f64; N], texels: &[f64; N]) -> [f32; N] {
    let mut weights = [0.0; N];
    for i in 0..N {
        weights[i] = (places[i] - texels[i]) as f32;
    }
    weights
}

/// A whole number between 0 and 2^32.
#[inline(always)]
#[allow(clippy::cast_possible_truncation, reason = "the lowest bits")]
fn index(value: f64) -> u32 {
    (value + MAGIC).to_bits() as u32
}

/// A colour texture, as one triangle sees it.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Texels<'m> {
    bytes: &'m [u8],
    columns: Axis,
    rows: Axis,
}

/// Checks that every byte of a texture of this size has a 32-bit number.
pub(crate) fn check_size((width, height): (u32, u32)) -> Result<()> {
    let bytes = 3 * u64::from(width) * u64::from(height);
    if u32::try_from(bytes).is_ok() {
        return Ok(());
    }
    let problem = format!(
        "expected at most 4 GiB of colours, found {width}x{height} texels: cut it into several"
    );
    Err(Error::invalid("texture", problem))
}

/// Samples on a texture: of each the byte at which the upper left of four texels begins, and how much
/// of the right and of the lower ones counts.
pub(crate) struct Spots<const N: usize> {
    pub(crate) start: [u32; N],
    pub(crate) right: [f32; N],
    pub(crate) down: [f32; N],
}

/// Parts of a colour: a first red, green and blue, a second, and nothing.
pub(crate) type Parts = [f32; LANES];

const FIRST: Parts = [1.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0];
const SECOND: Parts = [-1.0, -1.0, -1.0, 1.0, 1.0, 1.0, 0.0, 0.0];

/// The colour of these parts.
pub(crate) fn whole(parts: Parts) -> Vec3 {
    let [a, b, c, d, e, f, ..] = parts;
    Vec3::new(a + d, b + e, c + f)
}

impl<'m> Texels<'m> {
    pub(crate) fn new(texture: &'m ColorImage, border: Border) -> Self {
        let (width, height) = texture.size();
        let axis = |size| Axis::new(size, border);
        Self {
            bytes: texture.values().as_flattened(),
            columns: axis(width),
            rows: axis(height),
        }
    }

    /// The place, along columns and rows, of texture coordinates with (0, 0) at the bottom-left outer
    /// corner.
    pub(crate) fn place(&self, coord: Vec2) -> [f64; 2] {
        [
            f64::from(coord.x) * f64::from(self.columns.size) - 0.5,
            (1.0 - f64::from(coord.y)) * f64::from(self.rows.size) - 0.5,
        ]
    }

    /// Where places, along columns and rows, lie.
    #[inline(always)]
    pub(crate) fn find<const N: usize>(&self, [x, y]: [[f64; N]; 2]) -> Spots<N> {
        self.spots(self.columns.find(x), self.rows.find(y))
    }

    /// As [`Self::find`], for textures that end at their border.
    #[inline(always)]
    pub(crate) fn find_inside<const N: usize>(&self, [x, y]: [[f64; N]; 2]) -> Spots<N> {
        self.spots(self.columns.find_clamped(x), self.rows.find_clamped(y))
    }

    #[inline(always)]
    fn spots<const N: usize>(
        &self,
        (columns, right): Found<N>,
        (rows, down): Found<N>,
    ) -> Spots<N> {
        let width = f64::from(self.columns.size);
        let mut start = [0; N];
        for i in 0..N {
            start[i] = index(3.0 * (rows[i] * width + columns[i]));
        }
        Spots { start, right, down }
    }

    /// Whether both are the same texture, with the same borders.
    #[inline(always)]
    pub(crate) fn is(&self, other: &Self) -> bool {
        std::ptr::eq(self.bytes, other.bytes)
            && (self.columns, self.rows) == (other.columns, other.rows)
    }

    /// Whether the texture starts again beyond its border.
    #[inline(always)]
    pub(crate) fn repeats(&self) -> bool {
        self.columns.border == Border::Repeat
    }

    /// The colour between the four texels from `start` on, in 8-bit sRGB units that are interpolated
    /// as they are.
    #[inline(always)]
    pub(crate) fn color<L: Lanes>(&self, l: L, start: u32, parts: (f32, f32)) -> L::V {
        if self.repeats() {
            mix(l, self.around(start as usize), parts)
        } else {
            self.color_inside(l, start, parts)
        }
    }

    /// As [`Self::color`], for textures that end at their border.
    #[inline(always)]
    pub(crate) fn color_inside<L: Lanes>(&self, l: L, start: u32, parts: (f32, f32)) -> L::V {
        mix(l, self.inside(start as usize), parts)
    }

    /// As [`Self::color_inside`], of places that [`Self::are_inside`].
    #[inline(always)]
    pub(crate) fn color_well_inside<L: Lanes>(&self, l: L, start: u32, parts: (f32, f32)) -> L::V {
        let (start, stride) = (start as usize, 3 * self.columns.size as usize);
        // One comparison for both rows.
        let both = self.bytes.get(start..start + stride + LANES);
        let (upper, lower) = both.map_or((&[][..], &[][..]), |both| (both, &both[stride..]));
        match (upper.first_chunk(), lower.first_chunk()) {
            (Some(upper), Some(lower)) => mix(l, (*upper, *lower), parts),
            _ => l.load(&nowhere()),
        }
    }

    /// Asks for what is read of a place before its turn.
    #[inline(always)]
    pub(crate) fn fetch(&self, start: u32) {
        prefetch(self.bytes, start as usize);
        prefetch(self.bytes, start as usize + 3 * self.columns.size as usize);
    }

    /// Whether two rows of two texels and what is read behind them lie in the texture, from all of these
    /// on.
    #[inline(always)]
    pub(crate) fn are_inside<const N: usize>(&self, starts: &[u32; N]) -> bool {
        let room = 3 * self.columns.size as usize + LANES;
        let Some(last) = self.bytes.len().checked_sub(room) else {
            return false;
        };
        // A texture has at most 2^32 bytes.
        #[allow(clippy::cast_possible_truncation, reason = "was compared")]
        let last = last.min(u32::MAX as usize) as u32;
        let mut inside = true;
        for &start in starts {
            inside &= start <= last;
        }
        inside
    }

    /// The colour at a place.
    #[inline(always)]
    pub(crate) fn color_at<L: Lanes>(&self, l: L, [x, y]: [f64; 2]) -> L::V {
        let Spots { start, right, down } = self.find([[x], [y]]);
        self.color(l, start[0], (right[0], down[0]))
    }

    /// Two rows of two texels and whatever follows, for textures that end at their border. What lies
    /// beyond it counts nothing.
    #[inline(always)]
    fn inside(&self, start: usize) -> ([u8; LANES], [u8; LANES]) {
        let lower = start + 3 * self.columns.size as usize;
        if let (Some(upper), Some(lower)) = (self.eight(start), self.eight(lower)) {
            return (upper, lower);
        }
        (self.rest(start), self.rest(lower))
    }

    #[inline(always)]
    fn eight(&self, start: usize) -> Option<[u8; LANES]> {
        self.bytes.get(start..start + LANES)?.first_chunk().copied()
    }

    /// The bytes from `start` on, as far as there are any, then zeros.
    #[cold]
    #[inline(never)]
    fn rest(&self, start: usize) -> [u8; LANES] {
        let mut eight = [0; LANES];
        let rest = self.bytes.get(start..).unwrap_or_default();
        for (to, &from) in eight.iter_mut().zip(rest) {
            *to = from;
        }
        eight
    }

    /// As [`Self::inside`], for textures that start again.
    #[inline(never)]
    fn around(&self, start: usize) -> ([u8; LANES], [u8; LANES]) {
        let stride = 3 * self.columns.size as usize;
        let (row, left) = (start / stride * stride, start % stride);
        let right = if left + 3 < stride { left + 3 } else { 0 };
        let below = row + stride;
        let below = if below < self.bytes.len() { below } else { 0 };
        let pair = |row: usize| {
            let mut pair = [0; LANES];
            pair[..3].copy_from_slice(&self.bytes[row + left..][..3]);
            pair[3..6].copy_from_slice(&self.bytes[row + right..][..3]);
            pair
        };
        (pair(row), pair(below))
    }
}

/// What no place that was checked has.
#[cold]
#[inline(never)]
fn nowhere() -> Parts {
    [0.0; LANES]
}

/// The upper two texels with the lower two, each by its share.
#[inline(always)]
fn mix<L: Lanes>(
    l: L,
    (upper, lower): ([u8; LANES], [u8; LANES]),
    (right, down): (f32, f32),
) -> L::V {
    let (upper, lower) = (l.bytes(upper), l.bytes(lower));
    // Never fused: all sets of instructions give the same.
    let mixed = l.add(upper, l.mul(l.sub(lower, upper), l.splat(down)));
    let share = l.add(l.load(&FIRST), l.mul(l.load(&SECOND), l.splat(right)));
    l.mul(mixed, share)
}

/// The value of a one-channel texture, as that of [`Texels`].
pub(crate) fn bilinear_gray(texture: &Raster<u8>, coord: Vec2, border: Border) -> f32 {
    let axis = |size| Axis::new(size, border);
    let (columns, rows) = (axis(texture.width()), axis(texture.height()));
    let place = |coord: f32, size: u32| f64::from(coord) * f64::from(size) - 0.5;
    let ([left], [right]) = columns.find([place(coord.x, texture.width())]);
    let ([top], [down]) = rows.find([place(1.0 - coord.y, texture.height())]);
    let (left, top) = (index(left), index(top));
    let along = |row| {
        let texel = |column| f32::from(texture.get(column, row));
        let (first, second) = (texel(left), texel(columns.after(left)));
        first + (second - first) * right
    };
    let (upper, lower) = (along(top), along(rows.after(top)));
    upper + (lower - upper) * down
}

#[cfg(test)]
mod tests {
    use super::super::lanes::{Plain, Task, dispatch};
    use super::*;

    fn gradient() -> ColorImage {
        let values =
            (0..4u8).flat_map(|row| (0..4u8).map(move |column| [column * 40, row * 40, 7]));
        ColorImage::from_values(4, 4, values.collect()).unwrap()
    }

    struct At<'m>(Texels<'m>, Vec2);

    impl Task for At<'_> {
        type Output = Parts;

        #[inline(always)]
        fn run<L: Lanes>(self, l: L) -> Parts {
            let Self(texels, coord) = self;
            l.store(texels.color_at(l, texels.place(coord)))
        }
    }

    fn look_up(image: &ColorImage, coord: Vec2, border: Border) -> [f32; 3] {
        let texels = Texels::new(image, border);
        let plain = At(texels, coord).run(Plain);
        let best = dispatch(At(texels, coord));
        assert_eq!(plain.map(f32::to_bits), best.map(f32::to_bits), "{coord}");
        whole(plain).into()
    }

    fn at(x: f32, y: f32, border: Border) -> [f32; 3] {
        look_up(&gradient(), Vec2::new(x, y), border)
    }

    /// The obvious, in f64 from 16-bit indices on.
    fn obvious(image: &ColorImage, coord: Vec2, border: Border) -> [f64; 3] {
        let (width, height) = (i64::from(image.width()), i64::from(image.height()));
        let x = f64::from(coord.x) * width as f64 - 0.5;
        let y = (1.0 - f64::from(coord.y)) * height as f64 - 0.5;
        let inside = |index: i64, size: i64| match border {
            Border::Clamp => index.clamp(0, size - 1),
            Border::Repeat => index.rem_euclid(size),
        };
        let mut sum = [0.0; 3];
        for (down, right) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
            let (column, row) = (x.floor() as i64 + right, y.floor() as i64 + down);
            let weight = (1.0 - (x - column as f64).abs()).max(0.0)
                * (1.0 - (y - row as f64).abs()).max(0.0);
            let texel = image.get(inside(column, width) as u32, inside(row, height) as u32);
            for channel in 0..3 {
                sum[channel] += weight * f64::from(texel[channel]);
            }
        }
        sum
    }

    #[test]
    fn texel_centres_return_texels_and_v_points_up() {
        assert_eq!(at(0.125, 0.875, Border::Clamp), [0.0, 0.0, 7.0]);
        assert_eq!(at(0.875, 0.875, Border::Clamp), [120.0, 0.0, 7.0]);
        assert_eq!(at(0.125, 0.125, Border::Repeat), [0.0, 120.0, 7.0]);
    }

    #[test]
    fn between_centres_the_value_is_linear() {
        let [r, g, _] = at(0.5, 0.3, Border::Clamp);
        assert!((r - 60.0).abs() < 1e-4, "{r}");
        assert!((g - 40.0 * (0.7 * 4.0 - 0.5)).abs() < 1e-4, "{g}");
    }

    #[test]
    fn all_sizes_and_borders_agree_with_the_obvious() {
        for (width, height) in [(1, 1), (1, 5), (7, 1), (2, 2), (3, 4), (13, 9)] {
            let count = width * height;
            let values = (0..count).map(|i| [i * 37 % 256, i * 91 % 253, i * 17].map(|v| v as u8));
            let image = ColorImage::from_values(width, height, values.collect()).unwrap();
            for step in 0..3000 {
                let noise = |factor: f32| (step as f32 * factor).fract() * 4.0 - 1.5;
                let coord = Vec2::new(noise(0.618_034), noise(0.754_877_7));
                for border in [Border::Clamp, Border::Repeat] {
                    let found = look_up(&image, coord, border);
                    let expected = obvious(&image, coord, border);
                    for channel in 0..3 {
                        let off = f64::from(found[channel]) - expected[channel];
                        assert!(
                            off.abs() < 1e-3,
                            "{width}x{height} {coord} {border:?}: {off}"
                        );
                    }
                }
            }
        }
    }

    #[test]
    fn an_atlas_clamps_and_a_tiling_repeats() {
        assert_eq!(at(0.0, 0.875, Border::Clamp)[0], 0.0);
        assert_eq!(at(0.0, 0.875, Border::Repeat)[0], 60.0);
        assert_eq!(
            at(1.375, -0.625, Border::Repeat),
            at(0.375, 0.375, Border::Repeat)
        );
        let inside = [Vec2::ZERO, Vec2::ONE, Vec2::X];
        assert_eq!(Border::of(&inside), Border::Clamp);
        assert_eq!(
            Border::of(&[Vec2::ZERO, Vec2::new(1.5, 0.0), Vec2::X]),
            Border::Repeat
        );
    }

    #[test]
    fn textures_of_more_bytes_than_have_numbers_are_refused() {
        assert!(check_size((65_536, 21_845)).is_ok());
        let problem = check_size((65_536, 21_846)).unwrap_err().to_string();
        assert!(problem.contains("65536x21846"), "{problem}");
    }

    #[test]
    fn what_is_no_number_reads_some_texel() {
        for wrong in [f32::NAN, f32::INFINITY, -1e30] {
            for border in [Border::Clamp, Border::Repeat] {
                assert!(at(wrong, wrong, border)[0].is_finite());
            }
        }
    }
}
