//! What an encoded image's background comes back as, without encoding the image.

use super::color::{levels, mix};
use super::stripe::{Planes, Stripe};
use super::transform::{self, WIDTH};
use super::{JpegOptions, Source};
use crate::scene::{ColorImage, Mask};
use pulp::{Arch, Simd, WithSimd};
use std::io::Result;

/// Whether no channel of a pixel outside the mask comes back above `limit` from
/// [`encode`](super::encode) with that mask, read by this crate's decoder, which interpolates halved
/// chroma (3 : 1 along either axis). Only what lies at the mask's edge is looked at, to the first pixel
/// that is brighter.
///
/// # Errors
/// A mask of another size than the image ([`std::io::ErrorKind::InvalidInput`]).
pub fn stays_dark(
    image: &ColorImage,
    mask: &Mask,
    options: JpegOptions,
    limit: u8,
) -> Result<bool> {
    let source = Source::new(image, Some(mask), options)?;
    let edges = Edges::of(&source, mask);
    let mut decoded = Decoded::new(&source);
    for down in 0..source.rows() {
        for along in 0..source.stripes() {
            if edges.need(along, down) && decoded.brightest((along, down), mask) > limit {
                return Ok(false);
            }
        }
    }
    Ok(true)
}

/// What the mask has in a stripe.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Kind {
    Inside,
    Edge,
    Outside,
}

/// What the mask has in each stripe, row by row.
struct Edges {
    kinds: Vec<Kind>,
    stripes: usize,
    rows: usize,
    /// A stripe outside, between others: all those are black and alike.
    black: Option<(usize, usize)>,
}

impl Edges {
    fn of(source: &Source<'_>, mask: &Mask) -> Self {
        let (stripes, rows) = (source.stripes(), source.rows());
        let mut kinds = Vec::with_capacity(stripes * rows);
        for down in 0..rows {
            for along in 0..stripes {
                kinds.push(kind(source, mask, (along, down)));
            }
        }
        let mut edges = Self {
            kinds,
            stripes,
            rows,
            black: None,
        };
        let places = (0..rows).flat_map(|down| (0..stripes).map(move |along| (along, down)));
        edges.black = places.clone().find(|&place| edges.is_black(place));
        edges
    }

    /// Whether the stripe and its neighbours have nothing of the surface.
    fn is_black(&self, (along, down): (usize, usize)) -> bool {
        let rows = down.saturating_sub(1)..(down + 2).min(self.rows);
        let columns = along.saturating_sub(1)..(along + 2).min(self.stripes);
        rows.into_iter().all(|down| {
            let row = &self.kinds[down * self.stripes..(down + 1) * self.stripes];
            row[columns.clone()]
                .iter()
                .all(|&kind| kind == Kind::Outside)
        })
    }

    /// Whether the stripe's background is to be looked at.
    fn need(&self, along: usize, down: usize) -> bool {
        self.kinds[down * self.stripes + along] != Kind::Inside
            && (!self.is_black((along, down)) || self.black == Some((along, down)))
    }
}

fn kind(source: &Source<'_>, mask: &Mask, (along, down): (usize, usize)) -> Kind {
    let (first, count) = (8 * source.side() * down, 8 * source.side());
    let rows = first..(first + count).min(mask.height() as usize);
    let (mut inside, mut outside) = (false, false);
    for row in rows {
        let row = &mask.values()[source.places(along, row)];
        // All of them, side by side: most are alike.
        let kept = row.iter().map(|&kept| u32::from(kept)).sum::<u32>();
        inside |= kept > 0;
        outside |= (kept as usize) < row.len();
    }
    match (inside, outside) {
        (_, false) => Kind::Inside,
        (true, true) => Kind::Edge,
        (false, true) => Kind::Outside,
    }
}

/// A stripe as a decoder has it before colours are converted.
struct Pixels {
    /// Which stripe.
    place: (usize, usize),
    luma: [[u8; 2 * WIDTH]; 16],
    chroma: [[[u8; WIDTH]; 8]; 2],
}

/// Stripes that were decoded last, by place: those of three rows.
struct Decoded<'a> {
    source: &'a Source<'a>,
    planes: Planes,
    stripe: Stripe,
    /// Row by row, three of them.
    kept: Vec<Option<Box<Pixels>>>,
}

impl<'a> Decoded<'a> {
    fn new(source: &'a Source<'a>) -> Self {
        Self {
            source,
            planes: Planes::new(),
            stripe: Stripe::new(),
            kept: (0..3 * source.stripes()).map(|_| None).collect(),
        }
    }

    fn slot(&self, (along, down): (usize, usize)) -> usize {
        down % 3 * self.source.stripes() + along
    }

    /// Decodes a stripe unless that is done.
    fn ready(&mut self, place: (usize, usize)) {
        let slot = self.slot(place);
        if (self.kept[slot].as_ref()).is_some_and(|pixels| pixels.place == place) {
            return;
        }
        self.source.code(place, &mut self.planes, &mut self.stripe);
        let mut pixels = self.kept[slot].take().unwrap_or_else(|| {
            Box::new(Pixels {
                place,
                luma: [[0; 2 * WIDTH]; 16],
                chroma: [[[0; WIDTH]; 8]; 2],
            })
        });
        pixels.place = place;
        Arch::new().dispatch(Decode {
            source: self.source,
            stripe: &self.stripe,
            out: &mut pixels,
        });
        self.kept[slot] = Some(pixels);
    }

    fn pixels(&self, place: (usize, usize)) -> Option<&Pixels> {
        self.kept[self.slot(place)].as_deref()
    }

    /// The largest value of a channel outside the mask in a stripe.
    fn brightest(&mut self, (along, down): (usize, usize), mask: &Mask) -> u8 {
        let half = self.source.half_chroma;
        let (rows, stripes) = (self.source.rows(), self.source.stripes());
        self.ready((along, down));
        if half {
            for down in down.saturating_sub(1)..(down + 2).min(rows) {
                for along in along.saturating_sub(1)..(along + 2).min(stripes) {
                    self.ready((along, down));
                }
            }
        }
        let side = 8 * self.source.side();
        let mut brightest = 0;
        for y in 0..side {
            let row = side * down + y;
            if row >= mask.height() as usize {
                break;
            }
            let mask = &mask.values()[self.source.places(along, row)];
            if !mask.contains(&false) {
                continue;
            }
            let chroma = [0, 1].map(|component| match half {
                true => self.interpolated((along, down), component, y),
                false => self.full((along, down), component, y),
            });
            let Some(pixels) = self.pixels((along, down)) else {
                continue;
            };
            let (luma, [blue, red]) = (&pixels.luma[y], &chroma);
            brightest = brightest.max(Arch::new().dispatch(Brightest {
                luma,
                blue,
                red,
                mask,
            }));
        }
        brightest
    }

    /// A row of chroma at full resolution.
    fn full(&self, place: (usize, usize), component: usize, y: usize) -> [u8; 2 * WIDTH] {
        let mut out = [0; 2 * WIDTH];
        if let Some(pixels) = self.pixels(place) {
            out[..WIDTH].copy_from_slice(&pixels.chroma[component][y]);
        }
        out
    }

    /// A row of halved chroma, interpolated: three parts of the nearest to one of the next, between
    /// rows first; the border is repeated.
    fn interpolated(
        &self,
        (along, down): (usize, usize),
        component: usize,
        y: usize,
    ) -> [u8; 2 * WIDTH] {
        let near = 8 * down + y / 2;
        let far = match y % 2 {
            0 => near.saturating_sub(1),
            _ => (near + 1).min(8 * self.source.rows() - 1),
        };
        let between = |along: usize| {
            let row = |row: usize| {
                let pixels = self.pixels((along, row / 8));
                pixels.map_or([0; WIDTH], |pixels| pixels.chroma[component][row % 8])
            };
            let (near, far) = (row(near), row(far));
            let mut out = [0; WIDTH];
            for ((out, near), far) in out.iter_mut().zip(near).zip(far) {
                *out = mix(u16::from(near), u16::from(far));
            }
            out
        };
        // The decoder's row ends with the image's last unit.
        let (own, count) = (between(along), 8 * self.source.units(along));
        let mut line = [0; WIDTH + 2];
        line[1..=WIDTH].copy_from_slice(&own);
        line[0] = match along {
            0 => own[0],
            _ => between(along - 1)[WIDTH - 1],
        };
        line[count + 1] = match along + 1 < self.source.stripes() {
            true => between(along + 1)[0],
            false => own[count - 1],
        };
        let mut out = [0; 2 * WIDTH];
        for (column, out) in out.as_chunks_mut::<2>().0.iter_mut().enumerate() {
            let here = line[column + 1];
            *out = [line[column], line[column + 2]].map(|next| mix(here, next) as u8);
        }
        out
    }
}

struct Decode<'a> {
    source: &'a Source<'a>,
    stripe: &'a Stripe,
    out: &'a mut Pixels,
}

impl WithSimd for Decode<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let side = self.source.side();
        let [luma, chroma] = &self.source.quantisers;
        for (place, coded) in self.stripe.luma.iter().take(side * side).enumerate() {
            let (down, along) = (place / side, place % side);
            let (rows, _) = self.out.luma[8 * down..].as_chunks_mut::<8>();
            let rows = rows[0].each_mut();
            transform::inverse(
                coded,
                &luma.steps,
                rows.map(|row| &mut row.as_chunks_mut::<WIDTH>().0[along]),
            );
        }
        for (coded, out) in self.stripe.chroma.iter().zip(&mut self.out.chroma) {
            transform::inverse(coded, &chroma.steps, out.each_mut());
        }
    }
}

/// The largest value of a channel in a row outside the mask.
struct Brightest<'a> {
    luma: &'a [u8; 2 * WIDTH],
    blue: &'a [u8; 2 * WIDTH],
    red: &'a [u8; 2 * WIDTH],
    mask: &'a [bool],
}

impl WithSimd for Brightest<'_> {
    type Output = u8;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> u8 {
        let chroma = self.blue.iter().zip(self.red);
        let pixels = self.luma.iter().zip(chroma).zip(self.mask);
        let mut brightest = 0;
        for ((&luma, (&blue, &red)), &inside) in pixels {
            let [red, green, blue] = levels(luma, [blue, red]);
            let level = red.max(green).max(blue);
            brightest = brightest.max(if inside { 0 } else { level });
        }
        brightest.clamp(0, 255) as u8
    }
}
