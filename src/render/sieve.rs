//! Small triangles, most of which lie between samples: those that may cover one are brought together, and
//! so are the samples that they are offered to.

use super::cluster::{Cluster, Eight, MANY, MOST_TRIANGLES};
use super::lanes::{ALL, LANES, Lanes, whole};
use super::lens::Projected;
use super::raster::{SMALL, spread};

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
        let columns = samples(l, xs, (reach, scratch.last[0]));
        let ys = l.gather(&scratch.y, few, places);
        let rows = samples(l, ys, (reach, scratch.last[1]));
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

/// First and last sample between three coordinates, `error` allowed for, up to the tile's last.
#[inline(always)]
fn samples<L: Lanes>(l: L, corners: [L::V; 3], (error, last): (L::V, f32)) -> [L::V; 2] {
    let (low, high) = spread(l, corners);
    let low = l.max(l.sub(low, error), l.splat(0.0));
    let high = l.min(l.add(high, error), l.splat(last));
    [l.ceil(low), l.floor(high)]
}

/// Triangles of a cluster that may cover a sample. In one page: see [`super::row::Line`].
#[derive(Debug)]
#[repr(align(1024))]
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

    /// Puts some of eight triangles behind the first `count` and returns how many there are.
    #[inline(always)]
    fn put<L: Lanes>(&mut self, l: L, (eight, bits): (&Eight, u32), count: usize) -> usize {
        let numbers = l.store(l.pack(bits, l.load(&eight.numbers)));
        let from = count.min(SIEVED - LANES);
        if let Some(to) = self.numbers[from..].first_chunk_mut() {
            *to = numbers;
        }
        for corner in 0..3 {
            if let Some(to) = self.places[corner][from..].first_chunk_mut() {
                *to = l.pack_bytes(bits, eight.places[corner]);
            }
        }
        from + bits.count_ones() as usize
    }
}

/// Leaves in the sieve what may cover a sample of a projected cluster: by each vertex's cell rather than by
/// each triangle's corners where tables fit into registers.
#[inline(always)]
pub(super) fn sieve<L: Lanes>(
    l: L,
    cluster: &Cluster<'_>,
    scratch: &mut Projected,
    to: &mut Sieve,
) {
    let mut count = 0;
    if L::CELLS && scratch.few {
        scratch.find_cells(l, cluster.packs.len());
        let [columns, rows] = &scratch.cells;
        for first in (0..cluster.groups()).step_by(MANY / LANES) {
            let mut met = l.meet_cells([columns, rows], cluster.many(first));
            for group in first..cluster.groups().min(first + MANY / LANES) {
                let eight = cluster.eight(group);
                let alive = met & ALL >> (LANES - eight.used);
                count = to.put(l, (&eight, alive), count);
                met >>= LANES;
            }
        }
    } else {
        for group in 0..cluster.groups() {
            let eight = cluster.eight(group);
            let alive = Reach::of(l, scratch, &eight).alive;
            count = to.put(l, (&eight, alive), count);
        }
    }
    to.count = count;
}

/// Triangles that are seen at samples if nothing nearer is there. In two pages, of which the second begins with
/// numbers: see [`super::row::Line`].
#[derive(Debug)]
#[repr(C, align(4096))]
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

    /// Takes all: where, and which triangle with what nearness.
    #[inline(always)]
    pub(crate) fn take(&mut self) -> impl Iterator<Item = (usize, (u32, f32))> {
        let count = std::mem::take(&mut self.count).min(OFFERS);
        let with = self.nearness[..count].iter().zip(&self.numbers[..count]);
        let offers = self.indices[..count].iter().zip(with);
        offers.map(|(&index, (&nearness, number))| (whole(index), (number.to_bits(), nearness)))
    }
}

#[cfg(test)]
mod tests {
    use super::super::cluster::Draft;
    use super::super::lanes::forced::{self, Width};
    use super::super::lanes::{Plain, Task, dispatch};
    use super::*;
    use glam::DVec3;

    /// Numbers of the triangles that the sieve leaves, and of those with samples in reach.
    struct Sift<'s>(&'s Cluster<'s>, &'s mut Projected);

    impl Task for Sift<'_> {
        type Output = [Vec<u32>; 2];

        #[inline(always)]
        fn run<L: Lanes>(self, l: L) -> Self::Output {
            let Self(cluster, projected) = self;
            let mut left = Sieve::new();
            sieve(l, cluster, projected, &mut left);
            let mut numbers = [vec![], vec![]];
            let mut first = 0;
            while let Some(eight) = left.eight(first) {
                numbers[0].extend((0..eight.used).map(|lane| eight.number(lane)));
                first += LANES;
            }
            for group in 0..cluster.groups() {
                let eight = cluster.eight(group);
                let alive = Reach::of(l, projected, &eight).alive;
                let lanes = (0..LANES).filter(|lane| alive >> lane & 1 == 1);
                numbers[1].extend(lanes.map(|lane| eight.number(lane)));
            }
            numbers
        }
    }

    /// A cluster of small triangles among `vertices` around a tile, some far beside it, some on whole numbers.
    fn small(seed: u32, vertices: u8, triangles: u32) -> (Vec<f32>, Projected) {
        let mut state = seed;
        let mut next = |count: u32| {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 8) % count
        };
        let mut projected = Projected::new(0.0, (64, 64));
        let mut draft = Draft::default();
        let corner = [next(90) as f32 - 20.0, next(90) as f32 - 20.0];
        for vertex in 0..vertices {
            let place = usize::from(draft.add_vertex([0.0; 3]));
            let far = if vertex % 13 == 12 { 1e6 } else { 1.0 };
            projected.x[place] = corner[0] + far * (next(48) as f32 / 16.0 - 1.0);
            projected.y[place] = corner[1] + far * (next(48) as f32 / 16.0 - 1.0);
        }
        for number in 0..triangles {
            let corners = [0; 3].map(|_| next(u32::from(vertices)) as u8);
            draft.add_triangle(corners, 7 * number);
        }
        projected.error = 1e-4 * next(3) as f32;
        projected.few = vertices <= 64;
        let mut words = Vec::new();
        draft.write(DVec3::ZERO, &mut words);
        (words, projected)
    }

    #[test]
    fn the_sieve_leaves_just_what_has_a_sample_in_reach() {
        let mut counts = [0, 0];
        for seed in 0..400 {
            let vertices = [3, 17, 64, 65, 200][seed as usize % 5];
            let (words, mut projected) = small(seed, vertices, 1 + seed % 80);
            let cluster = Cluster::read(&words);
            let [plain, expected] = Sift(&cluster, &mut projected).run(Plain);
            assert_eq!(plain, expected, "{seed}");
            assert_eq!(
                dispatch(Sift(&cluster, &mut projected))[0],
                expected,
                "{seed}"
            );
            forced::force(Some(Width::Avx2));
            let [other, _] = dispatch(Sift(&cluster, &mut projected));
            forced::force(None);
            assert_eq!(other, expected, "{seed}");
            counts[0] += expected.len();
            counts[1] += cluster.count();
        }
        assert!(
            4 * counts[0] > counts[1] && 4 * counts[0] < 3 * counts[1],
            "{counts:?}"
        );
    }
}
