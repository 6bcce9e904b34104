//! Small triangles, most of which lie between samples: those that may cover one are brought together, and
//! so are the samples that they are offered to.

use super::cluster::{Cluster, Eight, MOST_TRIANGLES};
use super::lanes::{ALL, LANES, Lanes, whole};
use super::lens::Projected;
use super::raster::{LAST, SMALL, spread};

/// Samples that a triangle which is drawn as a small one covers at most.
const MOST_SAMPLES: usize = SMALL * SMALL;
/// Packed lanes are written whole.
const SIEVED: usize = MOST_TRIANGLES + LANES;
/// Offers of several times eight triangles: few enough to stay in the nearest cache.
const OFFERS: usize = 512;
const MOST_WAITING: usize = OFFERS - LANES * MOST_SAMPLES - LANES;
const _: () = assert!(MOST_WAITING > OFFERS / 4);

/// Which samples eight triangles may cover.
pub(super) struct Reach<L: Lanes> {
    pub(super) xs: [L::V; 3],
    pub(super) ys: [L::V; 3],
    /// First and last column, first and last row.
    pub(super) columns: [L::V; 2],
    pub(super) rows: [L::V; 2],
    /// Lanes with a triangle that may cover some.
    pub(super) alive: u32,
}

impl<L: Lanes> Reach<L> {
    #[inline(always)]
    pub(super) fn of(l: L, scratch: &Projected, eight: &Eight) -> Self {
        let (few, places) = (scratch.few, &eight.places);
        let reach = l.splat(scratch.error + scratch.away);
        let xs = l.gather(&scratch.x, few, places);
        let columns = samples(l, xs, reach);
        let ys = l.gather(&scratch.y, few, places);
        let rows = samples(l, ys, reach);
        let none = l.or(l.below(columns[1], columns[0]), l.below(rows[1], rows[0]));
        Self {
            xs,
            ys,
            columns,
            rows,
            alive: ALL >> (LANES - eight.used) & !l.bits(none),
        }
    }
}

/// First and last sample between three coordinates, `error` allowed for.
#[inline(always)]
fn samples<L: Lanes>(l: L, corners: [L::V; 3], error: L::V) -> [L::V; 2] {
    let (low, high) = spread(l, corners);
    let low = l.max(l.sub(low, error), l.splat(0.0));
    let high = l.min(l.add(high, error), l.splat(LAST));
    [l.ceil(low), l.floor(high)]
}

/// Triangles of a cluster that may cover a sample.
#[derive(Debug)]
pub(crate) struct Sieve {
    places: [[u8; SIEVED]; 3],
    numbers: [f32; SIEVED],
    count: usize,
}

impl Sieve {
    pub(crate) fn new() -> Self {
        Self {
            places: [[0; SIEVED]; 3],
            numbers: [0.0; SIEVED],
            count: 0,
        }
    }

    /// Eight of them from `first` on; `None` when there are no more.
    #[inline(always)]
    pub(crate) fn eight(&self, first: usize) -> Option<Eight> {
        let used = self.count.checked_sub(first + 1)? + 1;
        let mut eight = Eight {
            places: [[0; LANES]; 3],
            numbers: *self.numbers[first..].first_chunk()?,
            used: used.min(LANES),
        };
        for corner in 0..3 {
            eight.places[corner] = *self.places[corner][first..].first_chunk()?;
        }
        Some(eight)
    }

    #[inline(always)]
    fn put<L: Lanes>(&mut self, l: L, eight: &Eight, bits: u32) {
        let numbers = l.store(l.pack(bits, l.load(&eight.numbers)));
        let Some(to) = self.numbers[self.count..].first_chunk_mut() else {
            return;
        };
        *to = numbers;
        for corner in 0..3 {
            let Some(to) = self.places[corner][self.count..].first_chunk_mut() else {
                return;
            };
            *to = l.pack_bytes(bits, eight.places[corner]);
        }
        self.count += bits.count_ones() as usize;
    }
}

/// Leaves in the sieve what may cover a sample of a projected cluster.
#[inline(always)]
pub(super) fn sieve<L: Lanes>(l: L, cluster: &Cluster<'_>, scratch: &Projected, to: &mut Sieve) {
    to.count = 0;
    for eight in cluster.groups() {
        let alive = Reach::of(l, scratch, &eight).alive;
        to.put(l, &eight, alive);
    }
}

/// Triangles that are seen at samples if nothing nearer is there.
#[derive(Debug)]
pub(crate) struct Offers {
    /// Where the samples stand in the columns of the tile.
    indices: [f32; OFFERS],
    nearness: [f32; OFFERS],
    numbers: [f32; OFFERS],
    count: usize,
}

impl Offers {
    pub(crate) fn new() -> Self {
        Self {
            indices: [0.0; OFFERS],
            nearness: [0.0; OFFERS],
            numbers: [0.0; OFFERS],
            count: 0,
        }
    }

    /// Adds those in the lanes whose bit is set: their samples, nearness and numbers.
    #[inline(always)]
    pub(crate) fn put<L: Lanes>(
        &mut self,
        l: L,
        bits: u32,
        [indices, nearness, numbers]: [L::V; 3],
    ) {
        debug_assert!(self.count <= OFFERS - LANES, "offers would be lost");
        let from = self.count.min(OFFERS - LANES);
        let (Some(to), Some(near), Some(of)) = (
            self.indices[from..].first_chunk_mut(),
            self.nearness[from..].first_chunk_mut(),
            self.numbers[from..].first_chunk_mut(),
        ) else {
            return;
        };
        *to = l.store(l.pack(bits, indices));
        *near = l.store(l.pack(bits, nearness));
        *of = l.store(l.pack(bits, numbers));
        self.count = from + bits.count_ones() as usize;
    }

    /// Whether there may be no room for what eight triangles offer.
    #[inline(always)]
    pub(crate) fn is_full(&self) -> bool {
        self.count > MOST_WAITING
    }

    /// How many there are; there are none afterwards.
    #[inline(always)]
    pub(crate) fn finish(&mut self) -> usize {
        std::mem::take(&mut self.count).min(OFFERS)
    }

    /// An offer: where, and which triangle with what nearness.
    #[inline(always)]
    pub(crate) fn get(&self, index: usize) -> (usize, (u32, f32)) {
        let offer = (self.numbers[index].to_bits(), self.nearness[index]);
        (whole(self.indices[index]), offer)
    }
}
