//! Sixteen of JPEG's smallest coded units side by side: RGB → planes → coefficients.

use super::transform::{self, BLOCKS, Coefficients, Quantiser, WIDTH};
use pulp::{Arch, Simd, WithSimd};

/// Units side by side.
pub(super) const UNITS: usize = BLOCKS;

/// A row of pixels of one component, at most.
type Row = [u8; 2 * WIDTH];

/// Pixels of a stripe by component, chroma at full resolution. With half chroma, units are 16 × 16
/// pixels, else 8 × 8; what lies beyond them is not used.
pub(super) struct Planes {
    pub(super) luma: [Row; 16],
    chroma: [[Row; 16]; 2],
    /// Chroma at the resolution that is coded.
    pub(super) coded_chroma: [[[u8; WIDTH]; 8]; 2],
}

impl Planes {
    pub(super) fn new() -> Self {
        Self {
            luma: [[0; 2 * WIDTH]; 16],
            chroma: [[[0; 2 * WIDTH]; 16]; 2],
            coded_chroma: [[[0; WIDTH]; 8]; 2],
        }
    }
}

/// The coefficients of a stripe: of luma, blocks in a row by sixteens, rows one after the other, and
/// of both chroma components.
pub(super) struct Stripe {
    pub(super) luma: [Coefficients; 4],
    pub(super) chroma: [Coefficients; 2],
}

impl Stripe {
    pub(super) fn new() -> Self {
        Self {
            luma: [const { Coefficients::ZERO }; 4],
            chroma: [const { Coefficients::ZERO }; 2],
        }
    }
}

/// Blocks of luma along a side of a unit: 2 with half chroma, else 1.
pub(super) fn blocks_a_side(half_chroma: bool) -> usize {
    if half_chroma { 2 } else { 1 }
}

/// A row of pixels, and which of them are kept: the others are black. Shorter than the stripe at the
/// image's right border, where the last pixel is repeated.
#[derive(Clone, Copy)]
pub(super) struct Pixels<'a> {
    pub(super) colors: &'a [[u8; 3]],
    pub(super) kept: Option<&'a [bool]>,
}

/// Makes the coefficients of a stripe from its rows of pixels, 16 or 8 of them.
pub(super) struct Code<'a> {
    pub(super) rows: &'a [Pixels<'a>],
    pub(super) quantisers: &'a [Quantiser; 2],
    pub(super) planes: &'a mut Planes,
    pub(super) stripe: &'a mut Stripe,
}

impl Code<'_> {
    pub(super) fn run(self) {
        Arch::new().dispatch(self);
    }
}

impl WithSimd for Code<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Planes {
            luma,
            chroma: [blue, red],
            coded_chroma,
        } = self.planes;
        for (y, pixels) in self.rows.iter().enumerate() {
            convert(*pixels, (&mut luma[y], &mut blue[y], &mut red[y]));
        }
        let side = self.rows.len() / 8;
        for (full, coded) in [&*blue, &*red].into_iter().zip(&mut *coded_chroma) {
            for (y, out) in coded.iter_mut().enumerate() {
                match side {
                    2 => halve((&full[2 * y], &full[2 * y + 1]), out),
                    _ => out.copy_from_slice(&full[y][..WIDTH]),
                }
            }
        }
        for (place, out) in self.stripe.luma.iter_mut().take(side * side).enumerate() {
            let (down, along) = (place / side, place % side);
            let row = |y: usize| part(&luma[8 * down + y], along);
            let rows = [0, 1, 2, 3, 4, 5, 6, 7].map(row);
            transform::forward(rows, &self.quantisers[0], out);
        }
        for (plane, out) in coded_chroma.iter().zip(&mut self.stripe.chroma) {
            transform::forward(plane.each_ref(), &self.quantisers[1], out);
        }
    }
}

/// Half of a row.
#[inline(always)]
fn part(row: &Row, half: usize) -> &[u8; WIDTH] {
    &row.as_chunks::<WIDTH>().0[half]
}

/// Pixels that are converted side by side.
const SIDE_BY_SIDE: usize = 32;

/// One number of each of them.
type Side<T> = [T; SIDE_BY_SIDE];

/// RGB → luma and chroma as JFIF has them.
#[inline(always)]
fn convert(pixels: Pixels<'_>, (luma, blue, red): (&mut Row, &mut Row, &mut Row)) {
    let count = pixels.colors.len();
    for start in (0..count).step_by(SIDE_BY_SIDE) {
        let part = start..(start + SIDE_BY_SIDE).min(count);
        let (mut colors, mut kept) = ([[0; 3]; SIDE_BY_SIDE], [true; SIDE_BY_SIDE]);
        fill(&mut colors, &pixels.colors[part.clone()]);
        if let Some(all) = pixels.kept {
            fill(&mut kept, &all[part]);
        }
        let out = start / SIDE_BY_SIDE;
        let (luma, blue, red) = (
            &mut luma.as_chunks_mut().0[out],
            &mut blue.as_chunks_mut().0[out],
            &mut red.as_chunks_mut().0[out],
        );
        convert_some(&colors, &kept, (luma, blue, red));
    }
    for row in [luma, blue, red] {
        let last = row[count - 1];
        row[count..].fill(last);
    }
}

#[inline(always)]
fn fill<T: Copy>(out: &mut Side<T>, from: &[T]) {
    match from.first_chunk() {
        Some(whole) => *out = *whole,
        None => out[..from.len()].copy_from_slice(from),
    }
}

/// By integers with 16 bits of fraction.
#[inline(always)]
fn convert_some(
    colors: &Side<[u8; 3]>,
    kept: &Side<bool>,
    (luma, blue, red): (&mut Side<u8>, &mut Side<u8>, &mut Side<u8>),
) {
    let (mut r, mut g, mut b) = ([0; SIDE_BY_SIDE], [0; SIDE_BY_SIDE], [0; SIDE_BY_SIDE]);
    for i in 0..SIDE_BY_SIDE {
        (r[i], g[i], b[i]) = (colors[i][0], colors[i][1], colors[i][2]);
    }
    for i in 0..SIDE_BY_SIDE {
        let keep = 0u8.wrapping_sub(u8::from(kept[i]));
        (r[i], g[i], b[i]) = (r[i] & keep, g[i] & keep, b[i] & keep);
    }
    for i in 0..SIDE_BY_SIDE {
        let (r, g, b) = (i32::from(r[i]), i32::from(g[i]), i32::from(b[i]));
        let middle = (128 << 16) + 0x7fff;
        luma[i] = ((19595 * r + 38470 * g + 7471 * b + 0x7fff) >> 16) as u8;
        blue[i] = ((32768 * b - 11059 * r - 21709 * g + middle) >> 16) as u8;
        red[i] = ((32768 * r - 27439 * g - 5329 * b + middle) >> 16) as u8;
    }
}

/// The means of two by two pixels; halves are rounded down and up in turns.
#[inline(always)]
fn halve((above, below): (&Row, &Row), out: &mut [u8; WIDTH]) {
    for (i, out) in out.iter_mut().enumerate() {
        let (left, right) = (2 * i, 2 * i + 1);
        let sum = [above[left], above[right], below[left], below[right]].map(u16::from);
        let sum = sum[0] + sum[1] + sum[2] + sum[3];
        *out = ((sum + 1 + (i & 1) as u16) >> 2) as u8;
    }
}
