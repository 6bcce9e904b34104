//! Baseline JPEG: an encoder, what a decoder would make of the background of its images, and a decoder of
//! what is plain.
//!
//! By the JPEG standard (ITU-T T.81) and JFIF 1.02, with the typical Huffman tables of its section K.3
//! and the quantisers of section K.1 scaled by quality. All arithmetic is in integers: the bytes are
//! the same on every machine, and those of the crate jpeg-encoder without its own vector instructions,
//! with which the tests compare. Blocks are transformed sixteen at a time.

mod background;
mod bits;
mod color;
mod decode;
mod others;
mod stripe;
mod tables;
mod transform;

pub use background::stays_dark;
pub(super) use decode::decode;
pub(super) use others::{SCAN, check_others, segments};

use crate::scene::{ColorImage, Mask};
use bits::{Bits, Codes, Codings};
use std::io::{Error, ErrorKind, Result};
use std::ops::Range;
use stripe::{Code, Pixels, Planes, Stripe, UNITS};
use transform::Quantiser;

/// How a JPEG is encoded.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct JpegOptions {
    /// 1 to 100.
    pub quality: u8,
    /// Chroma at half resolution (4:2:0) rather than full (4:4:4).
    pub subsample_chroma: bool,
}

impl Default for JpegOptions {
    /// Quality 95, 4:2:0: what BlendedMVS has.
    fn default() -> Self {
        Self {
            quality: 95,
            subsample_chroma: true,
        }
    }
}

/// The bytes of a baseline JFIF JPEG of the image, without EXIF; with a mask of the same size, black
/// where that is false. Sides are at most 65,535 pixels.
///
/// # Errors
/// Longer sides, and a mask of another size than the image ([`ErrorKind::InvalidInput`]).
pub fn encode(image: &ColorImage, mask: Option<&Mask>, options: JpegOptions) -> Result<Vec<u8>> {
    let (Ok(width), Ok(height)) = (u16::try_from(image.width()), u16::try_from(image.height()))
    else {
        let (width, height) = image.size();
        let problem = format!("a JPEG has at most 65535 pixels a side, not {width} x {height}");
        return Err(Error::new(ErrorKind::InvalidInput, problem));
    };
    let source = Source::new(image, mask, options)?;
    let mut bytes = Vec::with_capacity(image.values().len());
    header(&mut bytes, (width, height), options);
    let codes = bits::standard_codes();
    let (mut bits, mut before) = (Bits::after(bytes), [0; 3]);
    let (mut planes, mut stripe) = (Planes::new(), Stripe::new());
    let mut codings = Codings::new();
    for down in 0..source.rows() {
        for along in 0..source.stripes() {
            source.code((along, down), &mut planes, &mut stripe);
            let units = source.units(along);
            codings.clear();
            put_units(
                &mut codings,
                (&stripe, source.side(), units),
                &codes,
                &mut before,
            );
            bits.append(&codings);
        }
    }
    let mut bytes = bits.finish();
    bytes.extend([0xff, 0xd9]);
    Ok(bytes)
}

/// Appends the first of a stripe's units, whose sides have so many blocks of luma.
#[inline(never)]
fn put_units(
    out: &mut Codings,
    (stripe, side, units): (&Stripe, usize, usize),
    [luma, chroma]: &[Codes; 2],
    before: &mut [i16; 3],
) {
    for unit in 0..units {
        for down in 0..side {
            for along in 0..side {
                let block = side * unit + along;
                let coded = &stripe.luma[side * down + block / UNITS];
                out.put_block(coded, block % UNITS, luma, &mut before[0]);
            }
        }
        for (coded, before) in stripe.chroma.iter().zip(&mut before[1..]) {
            out.put_block(coded, unit, chroma, before);
        }
    }
}

/// What is encoded, and how it is cut into stripes.
struct Source<'a> {
    image: &'a ColorImage,
    mask: Option<&'a Mask>,
    half_chroma: bool,
    quantisers: [Quantiser; 2],
}

impl<'a> Source<'a> {
    fn new(image: &'a ColorImage, mask: Option<&'a Mask>, options: JpegOptions) -> Result<Self> {
        if let Some(mask) = mask
            && mask.size() != image.size()
        {
            let (expected, found) = (image.size(), mask.size());
            let problem = format!("expected a mask of {expected:?} pixels, found {found:?}");
            return Err(Error::new(ErrorKind::InvalidInput, problem));
        }
        Ok(Self {
            image,
            mask,
            half_chroma: options.subsample_chroma,
            quantisers: tables::quantisers(options.quality).map(Quantiser::new),
        })
    }

    /// Blocks of luma along a side of a unit.
    fn side(&self) -> usize {
        stripe::blocks_a_side(self.half_chroma)
    }

    /// Rows of units.
    fn rows(&self) -> usize {
        (self.image.height() as usize).div_ceil(8 * self.side())
    }

    /// Stripes in a row.
    fn stripes(&self) -> usize {
        (self.image.width() as usize).div_ceil(8 * self.side() * UNITS)
    }

    /// Units of a stripe that lie in the image, at least in part.
    fn units(&self, along: usize) -> usize {
        let all = (self.image.width() as usize).div_ceil(8 * self.side());
        UNITS.min(all - along * UNITS)
    }

    /// The pixels of a row within a stripe: places among all of the image's, row by row.
    fn places(&self, along: usize, row: usize) -> Range<usize> {
        let width = self.image.width() as usize;
        let start = along * 8 * self.side() * UNITS;
        let end = width.min(start + 8 * self.side() * UNITS);
        row * width + start..row * width + end
    }

    /// Codes a stripe. Below the image its last row is repeated.
    fn code(&self, (along, down): (usize, usize), planes: &mut Planes, stripe: &mut Stripe) {
        let (height, rows) = (self.image.height() as usize, 8 * self.side());
        let empty = Pixels {
            colors: &[],
            kept: None,
        };
        let mut pixels = [empty; 16];
        for (y, pixels) in pixels[..rows].iter_mut().enumerate() {
            let places = self.places(along, (rows * down + y).min(height - 1));
            *pixels = Pixels {
                colors: &self.image.values()[places.clone()],
                kept: self.mask.map(|mask| &mask.values()[places]),
            };
        }
        let code = Code {
            rows: &pixels[..rows],
            quantisers: &self.quantisers,
            planes,
            stripe,
        };
        code.run();
    }
}

/// Everything before the coded data.
fn header(out: &mut Vec<u8>, (width, height): (u16, u16), options: JpegOptions) {
    out.extend([0xff, 0xd8]);
    segment(out, 0xe0, b"JFIF\0\x01\x02\0\0\x01\0\x01\0\0");
    let sampling = if options.subsample_chroma { 0x22 } else { 0x11 };
    let ([high, low], [right, left]) = (height.to_be_bytes(), width.to_be_bytes());
    let size = [8, high, low, right, left, 3];
    let components = [0, sampling, 0, 1, 0x11, 1, 2, 0x11, 1];
    segment(out, 0xc0, &[&size[..], &components].concat());
    for (place, table) in (0..).zip(tables::quantisers(options.quality)) {
        segment(out, 0xdb, &[&[place][..], &table].concat());
    }
    for (place, table) in [0x00, 0x10, 0x01, 0x11]
        .into_iter()
        .zip(tables::HUFFMAN_TABLES)
    {
        segment(
            out,
            0xc4,
            &[&[place][..], &table.counts, table.symbols].concat(),
        );
    }
    segment(out, 0xda, &[3, 0, 0x00, 1, 0x11, 2, 0x11, 0, 63, 0]);
}

fn segment(out: &mut Vec<u8>, marker: u8, content: &[u8]) {
    out.extend([0xff, marker]);
    out.extend((content.len() as u16 + 2).to_be_bytes());
    out.extend_from_slice(content);
}

#[cfg(test)]
mod tests;
