//! Sixteen blocks side by side: pixels → quantised coefficients and back.
//!
//! The forward transform is the accurate integer one of the Independent JPEG Group's library
//! (Loeffler, Ligtenberg and Moschytz 1989, 13 bits of fraction), the inverse the one of 12 bits that
//! the decoder has which reads our images. Every array holds one number of each of the blocks, so that
//! the compiler makes vector instructions of the innermost loops.

use super::tables::ZIGZAG;
use std::num::Wrapping;

/// Blocks side by side.
pub(super) const BLOCKS: usize = 16;
/// Pixels in a row of them.
pub(super) const WIDTH: usize = 8 * BLOCKS;

/// One number of each of the blocks.
type Each<T> = [T; BLOCKS];

/// Quantised coefficients.
#[derive(Clone)]
pub(super) struct Coefficients {
    /// In the order of the zigzag.
    pub(super) values: [Each<i16>; 64],
    /// A bit for each coefficient of a block that is not zero.
    pub(super) nonzero: Each<u64>,
}

impl Coefficients {
    pub(super) const ZERO: Self = Self {
        values: [[0; BLOCKS]; 64],
        nonzero: [0; BLOCKS],
    };
}

/// A quantiser for all blocks, in the order of the zigzag.
pub(super) struct Quantiser {
    pub(super) steps: [u8; 64],
    /// What makes the division by 8 times the step one that rounds to the nearest.
    corrections: Vec<u16>,
    /// 2^16 divided by 8 times the step.
    reciprocals: Vec<u16>,
}

impl Quantiser {
    pub(super) fn new(steps: [u8; 64]) -> Self {
        let (mut corrections, mut reciprocals) = (Vec::new(), Vec::new());
        for step in steps {
            // The transform's values are 8 times the coefficients.
            let divisor = 8 * u32::from(step);
            let (quotient, rest) = ((1 << 15) / divisor, (1 << 15) % divisor);
            let half = divisor / 2;
            let (reciprocal, correction) = match rest {
                0 => (quotient, half),
                rest if rest <= half => (quotient, half + 1),
                _ => (quotient + 1, half),
            };
            corrections.extend([correction as u16; BLOCKS]);
            reciprocals.extend([2 * reciprocal as u16; BLOCKS]);
        }
        Self {
            steps,
            corrections,
            reciprocals,
        }
    }
}

/// The eight outputs of the one-dimensional transform: numbers 0 and 4 as they are, the others times
/// 2^13.
#[inline(always)]
fn forward_8(v: [i32; 8]) -> [i32; 8] {
    let (sum, difference) = (
        [v[0] + v[7], v[1] + v[6], v[2] + v[5], v[3] + v[4]],
        [v[3] - v[4], v[2] - v[5], v[1] - v[6], v[0] - v[7]],
    );
    let (outer, inner) = (sum[0] + sum[3], sum[1] + sum[2]);
    let (a, b) = (sum[1] - sum[2], sum[0] - sum[3]);
    let even = 4433 * (a + b);
    let [d, e, f, g] = difference;
    let shared = 9633 * ((d + f) + (e + g));
    let (dg, ef) = (-7373 * (d + g), -20995 * (e + f));
    let (df, eg) = (shared - 16069 * (d + f), shared - 3196 * (e + g));
    [
        outer + inner,
        12299 * g + dg + eg,
        even + 6270 * b,
        25172 * f + ef + df,
        outer - inner,
        16819 * e + ef + eg,
        even - 15137 * a,
        2446 * d + dg + df,
    ]
}

#[inline(always)]
fn rounded_shift(value: i32, bits: u32) -> i32 {
    (value + (1 << (bits - 1))) >> bits
}

/// The quantised coefficients of the blocks in eight rows of pixels.
#[inline(always)]
pub(super) fn forward(rows: [&[u8; WIDTH]; 8], quantiser: &Quantiser, out: &mut Coefficients) {
    let mut half = [[[0i32; BLOCKS]; 8]; 8];
    for (row, half) in rows.into_iter().zip(&mut half) {
        forward_row(row, half);
    }
    let mut columns = [[[0i16; BLOCKS]; 8]; 8];
    for (x, column) in columns.iter_mut().enumerate() {
        for block in 0..BLOCKS {
            let all = forward_8([
                half[0][x][block],
                half[1][x][block],
                half[2][x][block],
                half[3][x][block],
                half[4][x][block],
                half[5][x][block],
                half[6][x][block],
                half[7][x][block],
            ]);
            for (y, value) in all.into_iter().enumerate() {
                let bits = if y % 4 == 0 { 2 } else { 15 };
                column[y][block] = rounded_shift(value, bits) as i16;
            }
        }
    }
    for (values, at) in out.values.iter_mut().zip(ZIGZAG) {
        let at = usize::from(at);
        *values = columns[at % 8][at / 8];
    }
    quantise(&mut out.values, quantiser);
    let (low, high) = out.values.split_at(32);
    let (low, high) = (bits_of(low), bits_of(high));
    for block in 0..BLOCKS {
        out.nonzero[block] = u64::from(low[block]) | u64::from(high[block]) << 32;
    }
}

#[inline(always)]
fn forward_row(row: &[u8; WIDTH], out: &mut [Each<i32>; 8]) {
    let (mut left, mut right) = ([0u32; BLOCKS], [0u32; BLOCKS]);
    for (block, eight) in row.as_chunks::<8>().0.iter().enumerate() {
        let eight = u64::from_le_bytes(*eight);
        left[block] = eight as u32;
        right[block] = (eight >> 32) as u32;
    }
    for block in 0..BLOCKS {
        let (left, right) = (left[block], right[block]);
        let all = forward_8([
            (left & 0xff) as i32,
            (left >> 8 & 0xff) as i32,
            (left >> 16 & 0xff) as i32,
            (left >> 24) as i32,
            (right & 0xff) as i32,
            (right >> 8 & 0xff) as i32,
            (right >> 16 & 0xff) as i32,
            (right >> 24) as i32,
        ]);
        for (x, value) in all.into_iter().enumerate() {
            out[x][block] = match x {
                // Levels are taken 128 lower, which only their sum shows.
                0 => (value - 8 * 128) << 2,
                4 => value << 2,
                _ => rounded_shift(value, 11),
            };
        }
    }
}

#[inline(always)]
fn quantise(values: &mut [Each<i16>; 64], quantiser: &Quantiser) {
    let tables = quantiser.corrections.iter().zip(&quantiser.reciprocals);
    for (value, (&correction, &reciprocal)) in values.as_flattened_mut().iter_mut().zip(tables) {
        let size = value.unsigned_abs() + correction;
        let quotient = ((u32::from(size) * u32::from(reciprocal)) >> 16) as i16;
        let sign = *value >> 15;
        *value = (quotient ^ sign) - sign;
    }
}

/// A bit for each of 32 coefficients of a block that is not zero.
#[inline(always)]
fn bits_of(values: &[Each<i16>]) -> Each<u32> {
    let mut bits = [0u32; BLOCKS];
    for (place, values) in values.iter().enumerate() {
        for block in 0..BLOCKS {
            bits[block] |= u32::from(values[block] != 0) << place;
        }
    }
    bits
}

/// As the decoder adds and multiplies numbers that no image has.
type W = Wrapping<i32>;

/// The eight outputs of the one-dimensional inverse transform, times 2^12.
#[inline(always)]
fn inverse_8(v: [W; 8], rounding: i32) -> [W; 8] {
    let shared = Wrapping(2217) * (v[2] + v[6]);
    let (low, high) = (
        shared - Wrapping(7567) * v[6],
        shared + Wrapping(3135) * v[2],
    );
    let (sum, difference) = (((v[0] + v[4]) << 12), ((v[0] - v[4]) << 12));
    let even = [sum + high, difference + low, difference - low, sum - high]
        .map(|x| x + Wrapping(rounding));
    let (a, b, c, d) = (v[7], v[5], v[3], v[1]);
    let shared = Wrapping(4816) * ((a + c) + (b + d));
    let (ad, bc) = (
        shared - Wrapping(3685) * (a + d),
        shared - Wrapping(10497) * (b + c),
    );
    let (ac, bd) = (Wrapping(-8034) * (a + c), Wrapping(-1597) * (b + d));
    let odd = [
        Wrapping(6149) * d + ad + bd,
        Wrapping(12586) * c + bc + ac,
        Wrapping(8410) * b + bc + bd,
        Wrapping(1223) * a + ad + ac,
    ];
    [
        even[0] + odd[0],
        even[1] + odd[1],
        even[2] + odd[2],
        even[3] + odd[3],
        even[3] - odd[3],
        even[2] - odd[2],
        even[1] - odd[1],
        even[0] - odd[0],
    ]
}

/// The eight rows of pixels that a decoder makes of the blocks.
#[inline(always)]
pub(super) fn inverse(coded: &Coefficients, steps: &[u8; 64], rows: [&mut [u8; WIDTH]; 8]) {
    let mut values = [[[Wrapping(0i32); BLOCKS]; 8]; 8];
    for ((at, coded), step) in ZIGZAG.into_iter().zip(&coded.values).zip(steps) {
        let at = usize::from(at);
        values[at / 8][at % 8] = coded.map(|value| Wrapping(i32::from(value) * i32::from(*step)));
    }
    let mut half = [[[Wrapping(0i32); BLOCKS]; 8]; 8];
    for (x, half) in half.iter_mut().enumerate() {
        for block in 0..BLOCKS {
            let all = inverse_8(
                [
                    values[0][x][block],
                    values[1][x][block],
                    values[2][x][block],
                    values[3][x][block],
                    values[4][x][block],
                    values[5][x][block],
                    values[6][x][block],
                    values[7][x][block],
                ],
                512,
            );
            for (y, value) in all.into_iter().enumerate() {
                half[y][block] = value >> 10;
            }
        }
    }
    for (y, row) in rows.into_iter().enumerate() {
        let mut pixels = [[0u8; BLOCKS]; 8];
        for block in 0..BLOCKS {
            let rounding = 512 + (1 << 16) + (128 << 17);
            let all = [
                half[0][y][block],
                half[1][y][block],
                half[2][y][block],
                half[3][y][block],
                half[4][y][block],
                half[5][y][block],
                half[6][y][block],
                half[7][y][block],
            ];
            for (x, value) in inverse_8(all, rounding).into_iter().enumerate() {
                pixels[x][block] = (value >> 17).0.clamp(0, 255) as u8;
            }
        }
        *row = block_by_block(&pixels);
    }
}

/// Eight pixels of each block, from the first pixels of all blocks, the second ones and so on.
#[inline(always)]
fn block_by_block(pixels: &[[u8; BLOCKS]; 8]) -> [u8; WIDTH] {
    let pair = |at: usize| in_turn::<BLOCKS, { 2 * BLOCKS }>(&pixels[at], &pixels[at + 4]);
    let four = |at: usize| in_turn::<{ 2 * BLOCKS }, { 4 * BLOCKS }>(&pair(at), &pair(at + 2));
    in_turn(&four(0), &four(1))
}

/// One of each in turn, as processors have an instruction for.
#[inline(always)]
fn in_turn<const N: usize, const TWICE: usize>(a: &[u8; N], b: &[u8; N]) -> [u8; TWICE] {
    let mut all = [0; TWICE];
    for (out, (&a, &b)) in all.as_chunks_mut::<2>().0.iter_mut().zip(a.iter().zip(b)) {
        *out = [a, b];
    }
    all
}
