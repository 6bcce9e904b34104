//! Coefficients → rows of pixels.

use super::super::color::{self, mix};
use super::super::stripe::Stripe;
use super::super::transform::{self, WIDTH};
use super::{Frame, Wanted};
use pulp::{Arch, Simd, WithSimd};
use std::ops::Range;

/// A row of units as components.
pub(super) struct Band {
    /// Stripes of luma in a row, and of chroma.
    stripes: [usize; 2],
    luma: Vec<[u8; WIDTH]>,
    chroma: [Vec<[u8; WIDTH]>; 2],
}

impl Band {
    pub(super) fn new(frame: &Frame) -> Self {
        let stripes = frame.units(frame.width).div_ceil(super::UNITS);
        let stripes = [stripes * frame.side(), stripes];
        let empty = |rows: usize, stripes: usize| vec![[0; WIDTH]; rows * stripes];
        Self {
            stripes,
            luma: empty(8 * frame.side(), stripes[0]),
            chroma: [empty(8, stripes[1]), empty(8, stripes[1])],
        }
    }

    /// Takes the stripe at `along`.
    pub(super) fn take(&mut self, frame: &Frame, along: usize, stripe: &Stripe) {
        Arch::new().dispatch(Take {
            band: self,
            frame,
            along,
            stripe,
        });
    }

    /// A row of luma, and of chroma.
    fn luma(&self, row: usize) -> &[u8] {
        self.luma[row * self.stripes[0]..][..self.stripes[0]].as_flattened()
    }

    fn chroma(&self, component: usize, row: usize) -> &[u8] {
        self.chroma[component][row * self.stripes[1]..][..self.stripes[1]].as_flattened()
    }
}

struct Take<'a> {
    band: &'a mut Band,
    frame: &'a Frame,
    along: usize,
    stripe: &'a Stripe,
}

impl WithSimd for Take<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self {
            band,
            frame,
            along,
            stripe,
        } = self;
        let side = frame.side();
        let mut pixels = [[0; WIDTH]; 8];
        let [luma, chroma] = band.stripes;
        for (place, coded) in stripe.luma.iter().take(side * side).enumerate() {
            transform::inverse(coded, &frame.steps[0], pixels.each_mut());
            let first = 8 * (place / side) * luma + side * along + place % side;
            put(&pixels, &mut band.luma[first..], luma);
        }
        for (component, coded) in stripe.chroma.iter().enumerate() {
            transform::inverse(coded, &frame.steps[1 + component], pixels.each_mut());
            put(&pixels, &mut band.chroma[component][along..], chroma);
        }
    }
}

/// Puts eight rows where every `stripes`-th is.
#[inline(always)]
fn put(pixels: &[[u8; WIDTH]; 8], out: &mut [[u8; WIDTH]], stripes: usize) {
    for (out, row) in out.iter_mut().step_by(stripes).zip(pixels) {
        *out = *row;
    }
}

/// Puts rows of pixels together.
pub(super) struct Rows<'f> {
    frame: &'f Frame,
    wanted: &'f Wanted,
    /// Chroma of a row at full resolution, where it is wanted.
    chroma: [Vec<u8>; 2],
    /// At half resolution, between two rows; the ends are repeated.
    between: Vec<u16>,
}

impl<'f> Rows<'f> {
    pub(super) fn new(frame: &'f Frame, wanted: &'f Wanted) -> Self {
        let width = frame.units(frame.width) * 8;
        Self {
            frame,
            wanted,
            chroma: [(); 2].map(|()| vec![0; frame.side() * width]),
            between: vec![0; width + 2],
        }
    }

    /// Puts what is wanted of the second of three bands, which is the `down`-th of `rows`, into the image.
    pub(super) fn put(&mut self, bands: &[Band; 3], down: (usize, usize), image: &mut [[u8; 3]]) {
        Arch::new().dispatch(Put {
            rows: self,
            bands,
            down,
            image,
        });
    }
}

struct Put<'a, 'f> {
    rows: &'a mut Rows<'f>,
    bands: &'a [Band; 3],
    down: (usize, usize),
    image: &'a mut [[u8; 3]],
}

impl WithSimd for Put<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self {
            rows,
            bands,
            down: (down, count),
            image,
        } = self;
        let (frame, wanted) = (rows.frame, rows.wanted);
        let (columns, side) = (wanted.columns.clone(), 8 * frame.side());
        let first = (side * down).max(wanted.rows.start);
        let end = (side * (down + 1)).min(wanted.rows.end);
        let lines = image.chunks_exact_mut(columns.len());
        for (y, out) in (first..end).zip(lines.skip(first - wanted.rows.start)) {
            let y = y - side * down;
            let luma = &bands[1].luma(y)[columns.clone()];
            if !frame.half_chroma {
                let chroma = |component| &bands[1].chroma(component, y)[columns.clone()];
                convert(luma, [0, 1].map(chroma), out);
                continue;
            }
            // The next row of chroma may be another band's; the image's first and last go on.
            let (near, far) = (8 + y / 2, 8 + y / 2 + 2 * (y % 2) - 1);
            let far = far.clamp(
                if down == 0 { 8 } else { 0 },
                if down + 1 == count { 15 } else { 23 },
            );
            for (component, out) in rows.chroma.iter_mut().enumerate() {
                let row = |at: usize| bands[at / 8].chroma(component, at % 8);
                let half = columns.start / 2..columns.end.div_ceil(2);
                widen((row(near), row(far)), half, &mut rows.between, out);
            }
            let chroma = rows.chroma.each_ref();
            let chroma = chroma.map(|chroma| &chroma[columns.clone()]);
            convert(luma, chroma, out);
        }
    }
}

/// Halved chroma at full resolution, of the places in `half`: between rows first, then within them.
#[inline(always)]
fn widen((near, far): (&[u8], &[u8]), half: Range<usize>, between: &mut [u16], out: &mut [u8]) {
    let count = between.len() - 2;
    let (first, end) = (half.start.saturating_sub(1), (half.end + 1).min(count));
    let rows = near[first..end].iter().zip(&far[first..end]);
    for (out, (&near, &far)) in between[1 + first..=end].iter_mut().zip(rows) {
        *out = mix(u16::from(near), u16::from(far));
    }
    if first == 0 {
        between[0] = between[1];
    }
    if end == count {
        between[count + 1] = between[count];
    }
    let from = |offset: usize| &between[half.start + offset..half.end + offset];
    let all = from(0).iter().zip(from(1)).zip(from(2));
    let out = &mut out.as_chunks_mut::<2>().0[half.clone()];
    for (out, ((&left, &here), &right)) in out.iter_mut().zip(all) {
        *out = [mix(here, left) as u8, mix(here, right) as u8];
    }
}

/// Pixels that are converted side by side.
const SIDE_BY_SIDE: usize = 64;

/// Luma and chroma → RGB.
#[inline(always)]
fn convert(luma: &[u8], [blue, red]: [&[u8]; 2], out: &mut [[u8; 3]]) {
    let (blocks, rest) = out.as_chunks_mut::<SIDE_BY_SIDE>();
    let whole = blocks.len() * SIDE_BY_SIDE;
    let (lumas, blues) = (luma.as_chunks().0, blue.as_chunks().0);
    let parts = lumas.iter().zip(blues).zip(red.as_chunks().0);
    for (out, ((luma, blue), red)) in blocks.iter_mut().zip(parts) {
        convert_block(luma, [blue, red], out);
    }
    let mut last = [[0; SIDE_BY_SIDE]; 3];
    for (last, row) in last.iter_mut().zip([luma, blue, red]) {
        last[..rest.len()].copy_from_slice(&row[whole..]);
    }
    let mut block = [[0; 3]; SIDE_BY_SIDE];
    convert_block(&last[0], [&last[1], &last[2]], &mut block);
    rest.copy_from_slice(&block[..rest.len()]);
}

#[inline(always)]
fn convert_block(
    luma: &[u8; SIDE_BY_SIDE],
    [blue, red]: [&[u8; SIDE_BY_SIDE]; 2],
    out: &mut [[u8; 3]; SIDE_BY_SIDE],
) {
    let mut levels = [[0u8; SIDE_BY_SIDE]; 3];
    for i in 0..SIDE_BY_SIDE {
        let all = color::levels(luma[i], [blue[i], red[i]]);
        for (levels, level) in levels.iter_mut().zip(all) {
            levels[i] = level.clamp(0, 255) as u8;
        }
    }
    for (i, out) in out.iter_mut().enumerate() {
        *out = [levels[0][i], levels[1][i], levels[2][i]];
    }
}
