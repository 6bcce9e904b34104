//! Reading the JPEGs that nearly all are: baseline, three components, one scan, chroma whole or halved.
//!
//! Pixels are those of the decoder that reads all others, to the bit; whatever is not plain is left to it. Coded
//! data that end early or hold what is no code are refused, which that one would fill up.

mod bands;
mod reader;

use super::stripe::{Stripe, UNITS, blocks_a_side};
use super::transform::Coefficients;
use crate::error::FormatError;
use crate::scene::{ColorImage, Raster, Window};
use bands::{Band, Rows};
use reader::{Bits, Table};
use std::ops::Range;

/// What stands before the coded data.
struct Frame {
    width: usize,
    height: usize,
    half_chroma: bool,
    /// Of luma and both components of chroma, in the order of the zigzag.
    steps: [[u8; 64]; 3],
    /// Of the same: for the first coefficient and for the others.
    tables: [[Table; 2]; 3],
}

/// What is wanted of an image, of its pixels and of what they are made of.
struct Wanted {
    columns: Range<usize>,
    rows: Range<usize>,
    /// Rows of units, and stripes of each.
    bands: Range<usize>,
    stripes: Range<usize>,
}

impl Wanted {
    fn new(frame: &Frame, window: &Window) -> Self {
        let range = |range: &Range<u32>| range.start as usize..range.end as usize;
        let (columns, rows) = (range(&window.columns), range(&window.rows));
        // Halved chroma is mixed with that of the neighbours.
        let around = |pixels: &Range<usize>, side: usize| {
            pixels.start.saturating_sub(2) / side..(pixels.end + 2).div_ceil(side)
        };
        let side = 8 * frame.side();
        Self {
            bands: around(&rows, side),
            stripes: around(&columns, UNITS * side),
            columns,
            rows,
        }
    }
}

impl Frame {
    fn pixels(&self) -> u64 {
        (self.width * self.height) as u64
    }

    /// Blocks of luma along a side of a unit.
    fn side(&self) -> usize {
        blocks_a_side(self.half_chroma)
    }

    /// Nothing where a first coefficient is far beyond all pixels, as in broken files: there the other
    /// decoder's sums for flat blocks do not overflow as ours do.
    fn can_be(&self, component: usize, first: i16) -> Option<()> {
        let scaled = i32::from(first).abs() * i32::from(self.steps[component][0]);
        (scaled <= 1 << 16).then_some(())
    }

    /// Units along a side of so many pixels.
    fn units(&self, pixels: usize) -> usize {
        pixels.div_ceil(8 * self.side())
    }
}

/// An image's width and height, and some of its pixels.
pub(in crate::format) type Part = ((u32, u32), ColorImage);

/// Why coded data are read no further.
#[derive(Debug, PartialEq)]
enum Stop {
    /// They end early, or hold what is no code.
    Broken,
    /// The other decoder's sums do not overflow there.
    Left,
}

/// Of an image, if it is a plain JPEG of at most `most` pixels, its width and height, and the pixels in the
/// window that `wanted` answers to them. Its other pixels are checked and not made. An error where its coded
/// data are not whole.
pub(in crate::format) fn decode(
    bytes: &[u8],
    most: u64,
    wanted: impl FnOnce((u32, u32)) -> Window,
) -> Result<Option<Part>, FormatError> {
    let plain = header(bytes).filter(|(frame, _)| frame.pixels() <= most);
    let plain = plain.and_then(|(frame, coded)| Some((frame, reader::unstuffed(coded)?)));
    let Some((frame, coded)) = plain else {
        return Ok(None);
    };
    let size = (frame.width as u32, frame.height as u32);
    let window = Some(wanted(size)).filter(|window| window.is_within(size));
    let Some(window) = window else {
        return Ok(None);
    };
    match pixels(&frame, &coded, &window) {
        Ok(image) => Ok(Some((size, image))),
        Err((Stop::Left, _)) => Ok(None),
        Err((Stop::Broken, row)) => {
            let problem = format!(
                "expected a whole JPEG, found one whose coded data end early or are damaged at row {row} of {} \
                 pixels, or before it: copy the file anew",
                frame.height
            );
            Err(FormatError::new("image", problem))
        }
    }
}

/// The pixels in the window, or why and at which row of pixels they end.
fn pixels(frame: &Frame, coded: &[u8], window: &Window) -> Result<ColorImage, (Stop, usize)> {
    let mut bits = Bits::of(coded);
    let wanted = Wanted::new(frame, window);
    let image = Raster::filled(window.size().0, window.size().1, [0; 3]);
    let mut image = image.map_err(|_| (Stop::Left, 0))?;
    let rows = frame.units(frame.height);
    let mut before = [0; 3];
    // The row of units before, the one that is put, and the one behind.
    let mut bands = [(); 3].map(|()| Band::new(frame));
    let mut out = Rows::new(frame, &wanted);
    let mut stripe = Stripe::new();
    for down in 0..rows {
        let [_, _, behind] = &mut bands;
        let stripes = match wanted.bands.contains(&down) {
            true => wanted.stripes.clone(),
            false => 0..0,
        };
        let room = (&mut stripe, behind);
        let read = read_row((frame, stripes), &mut bits, &mut before, room);
        read.map_err(|stop| (stop, down * 8 * frame.side()))?;
        if down > 0 {
            out.put(&bands, (down - 1, rows), image.values_mut());
        }
        bands.rotate_left(1);
    }
    out.put(&bands, (rows - 1, rows), image.values_mut());
    match bits.is_within() {
        true => Ok(image),
        false => Err((Stop::Broken, frame.height)),
    }
}

/// Reads a row of units, by way of a stripe, into a band, which takes the `wanted` ones.
fn read_row(
    (frame, wanted): (&Frame, Range<usize>),
    bits: &mut Bits<'_>,
    before: &mut [i16; 3],
    (stripe, band): (&mut Stripe, &mut Band),
) -> Result<(), Stop> {
    let (units, side) = (frame.units(frame.width), frame.side());
    for (along, first) in (0..units).step_by(UNITS).enumerate() {
        let blocks = stripe.luma.iter_mut().take(side * side);
        for blocks in blocks.chain(&mut stripe.chroma) {
            *blocks = Coefficients::ZERO;
        }
        for unit in 0..UNITS.min(units - first) {
            for at in 0..side * side {
                let block = side * unit + at % side;
                let out = &mut stripe.luma[side * (at / side) + block / UNITS];
                let read = bits.block(&frame.tables[0], &mut before[0], (out, block % UNITS));
                read.ok_or(Stop::Broken)?;
                frame.can_be(0, before[0]).ok_or(Stop::Left)?;
            }
            for (component, out) in stripe.chroma.iter_mut().enumerate() {
                let (tables, before) = (&frame.tables[1 + component], &mut before[1 + component]);
                let read = bits.block(tables, before, (out, unit));
                read.ok_or(Stop::Broken)?;
                frame.can_be(1 + component, *before).ok_or(Stop::Left)?;
            }
        }
        if wanted.contains(&along) {
            band.take(frame, along, stripe);
        }
    }
    Ok(())
}

/// The next bytes.
fn take<'b>(bytes: &mut &'b [u8], count: usize) -> Option<&'b [u8]> {
    let (taken, rest) = bytes.split_at_checked(count)?;
    *bytes = rest;
    Some(taken)
}

/// What stands before the coded data, and that.
fn header(mut rest: &[u8]) -> Option<(Frame, &[u8])> {
    let mut quantisers = [None; 4];
    let mut tables = [const { [const { None }; 4] }; 2];
    let mut start = None;
    if take(&mut rest, 2)? != [0xff, 0xd8] {
        return None;
    }
    loop {
        let &[0xff, marker, high, low] = take(&mut rest, 4)? else {
            return None;
        };
        let length = usize::from(u16::from_be_bytes([high, low]));
        let content = take(&mut rest, length.checked_sub(2)?)?;
        match marker {
            0xdb => read_quantisers(content, &mut quantisers)?,
            0xc4 => read_tables(content, &mut tables)?,
            0xc0 if start.is_none() => start = Some(Start::read(content)?),
            0xda => {
                let frame = start?.frame(content, &quantisers, &tables)?;
                return Some((frame, rest));
            }
            // No intervals after which decoding begins anew.
            0xdd if content == [0, 0] => {}
            // Comments and what applications say, but for what may say that colours are others.
            0xe0..=0xed | 0xef | 0xfe => {}
            _ => return None,
        }
    }
}

fn read_quantisers(mut content: &[u8], out: &mut [Option<[u8; 64]>; 4]) -> Option<()> {
    while !content.is_empty() {
        // Of 8 bits.
        let &[place @ 0..4] = take(&mut content, 1)? else {
            return None;
        };
        let steps = take(&mut content, 64)?;
        out[usize::from(place)] = steps.first_chunk().copied();
    }
    Some(())
}

fn read_tables(mut content: &[u8], out: &mut [[Option<Table>; 4]; 2]) -> Option<()> {
    while !content.is_empty() {
        let &[place] = take(&mut content, 1)? else {
            return None;
        };
        let counts = take(&mut content, 16)?.first_chunk()?;
        let count = counts.iter().map(|&count| usize::from(count)).sum();
        let (kind, place) = (usize::from(place >> 4), usize::from(place & 15));
        let table = Table::new(counts, take(&mut content, count)?, kind == 0)?;
        *out.get_mut(kind)?.get_mut(place)? = Some(table);
    }
    Some(())
}

/// A start of frame.
struct Start {
    width: usize,
    height: usize,
    half_chroma: bool,
    /// Of each component: its name and the place of its quantiser.
    components: [[u8; 2]; 3],
}

impl Start {
    fn read(content: &[u8]) -> Option<Self> {
        let (size, components) = content.split_at_checked(6)?;
        let &[8, high, low, right, left, 3] = size else {
            return None;
        };
        let &[a, luma, p, b, 0x11, q, c, 0x11, r] = components else {
            return None;
        };
        let named = matches!([a, b, c], [0, 1, 2] | [1, 2, 3]);
        let half_chroma = match luma {
            0x11 => false,
            0x22 => true,
            _ => return None,
        };
        let side = |bytes| usize::from(u16::from_be_bytes(bytes));
        let (width, height) = (side([right, left]), side([high, low]));
        // Smaller ones are put together in other ways.
        let large = width.min(height) > 16;
        (named && large).then_some(Self {
            width,
            height,
            half_chroma,
            components: [[a, p], [b, q], [c, r]],
        })
    }

    /// The frame of the scan that begins.
    fn frame(
        self,
        scan: &[u8],
        quantisers: &[Option<[u8; 64]>; 4],
        tables: &[[Option<Table>; 4]; 2],
    ) -> Option<Frame> {
        let &[3, a, of_a, b, of_b, c, of_c, 0, 63, 0] = scan else {
            return None;
        };
        let names = self.components.map(|[name, _]| name);
        let [steps_a, steps_b, steps_c] =
            (self.components).map(|[_, place]| *quantisers.get(usize::from(place))?);
        let tables_of = |places: u8| {
            let (first, others) = (usize::from(places >> 4), usize::from(places & 15));
            let table = |kind: usize, place: usize| tables[kind].get(place)?.clone();
            Some([table(0, first)?, table(1, others)?])
        };
        (names == [a, b, c]).then_some(Frame {
            width: self.width,
            height: self.height,
            half_chroma: self.half_chroma,
            steps: [steps_a?, steps_b?, steps_c?],
            tables: [tables_of(of_a)?, tables_of(of_b)?, tables_of(of_c)?],
        })
    }
}

#[cfg(test)]
mod tests;
