//! Order along a Hilbert curve: neighbours in the order are neighbours in space.

use super::blocks::{Corners, NOWHERE, wider};
use glam::DVec3;
use rayon::prelude::*;

/// Bits per axis of one pass.
const BITS: u32 = 10;
/// Cells per axis of one pass.
const CELLS: f64 = (1 << BITS) as f64;
/// Points that neighbour each other on the curve and are split as a tree: 256 blocks.
pub(super) const CHUNK: usize = 4096;
/// Points in one cell that need no order among themselves.
const RUN: usize = 16;
/// Points looked at to see where most of them are.
const SAMPLE: usize = 4096;
/// Keys that one thread makes at a time.
const KEYS: usize = 1 << 14;
/// Bits of the digit by which entries are shared out.
const SHARED_BITS: u32 = 10;
/// Entries below which they are not.
const FEW: usize = 1 << 16;

/// The indices of `count` finite points in Hilbert order; at most 2³² − 1 points.
///
/// The cube around most of them is cut into 1024³ cells; what lies outside counts to the nearest cell. A cell
/// that holds many points is cut again by the cube around its own, and so on: an outlier, however
/// far, leaves the order of the others as fine. Points in the same place stay in input order.
pub(super) fn order(count: usize, at: &(impl Fn(usize) -> DVec3 + Sync)) -> Vec<u32> {
    let frame = Frame::of(count, at);
    let mut entries: Vec<u64> = (0..count as u64).collect();
    sort(at, &mut entries, &frame, &mut Vec::new());
    entries.into_iter().map(|entry| entry as u32).collect()
}

/// Sorts entries, whose low halves are indices of points, by the keys of their points.
fn sort(
    at: &(impl Fn(usize) -> DVec3 + Sync),
    entries: &mut [u64],
    frame: &Frame,
    spare: &mut Vec<u64>,
) {
    entries.par_chunks_mut(KEYS).for_each(|chunk| {
        for entry in chunk {
            let index = *entry & u64::from(u32::MAX);
            *entry = u64::from(frame.key(at(index as usize))) << 32 | index;
        }
    });
    sort_by_key(entries, spare);
    let runs = entries.par_chunk_by_mut(|a, b| a >> 32 == b >> 32);
    runs.for_each_init(Vec::new, |spare, run| {
        if run.len() > RUN {
            let inner = run.iter().map(|&entry| at(entry as u32 as usize));
            if let Some(frame) = Frame::around(inner) {
                sort(at, run, &frame, spare);
            }
        }
    });
}

/// Sorts entries by their keys, those of one key by index, as [`radix_sort`] of all 30 bits does: many of them
/// on all threads, each of which takes those with one highest digit.
fn sort_by_key(entries: &mut [u64], spare: &mut Vec<u64>) {
    let threads = rayon::current_num_threads();
    if threads == 1 || entries.len() < FEW {
        return radix_sort::<32, 10, 3>(entries, spare);
    }
    let parts: Vec<Parted> = (entries.par_chunks(entries.len().div_ceil(threads)))
        .map(Parted::new)
        .collect();
    let mut rest = entries;
    let buckets = (0..1 << SHARED_BITS).map(|digit| {
        let count = parts.iter().map(|part| part.of(digit).len()).sum();
        rest.split_off_mut(..count).unwrap_or_default()
    });
    let buckets: Vec<&mut [u64]> = buckets.collect();
    let buckets = buckets.into_par_iter().enumerate();
    buckets.for_each_init(Vec::new, |spare, (digit, bucket)| {
        let mut free = &mut *bucket;
        for part in &parts {
            let some = part.of(digit);
            if let Some(room) = free.split_off_mut(..some.len()) {
                room.copy_from_slice(some);
            }
        }
        radix_sort::<32, 10, 2>(bucket, spare);
    });
}

/// Entries by the highest digit of their keys, otherwise in the order given.
struct Parted {
    entries: Vec<u64>,
    /// Where those of each digit end.
    ends: Vec<usize>,
}

impl Parted {
    fn new(entries: &[u64]) -> Self {
        let digit = |entry: u64| (entry >> (62 - SHARED_BITS)) as usize;
        let mut places = vec![0; 1 << SHARED_BITS];
        for &entry in entries {
            places[digit(entry)] += 1;
        }
        let mut first = 0;
        for place in &mut places {
            first += std::mem::replace(place, first);
        }
        let mut parted = vec![0; entries.len()];
        for &entry in entries {
            let place = &mut places[digit(entry)];
            parted[*place] = entry;
            *place += 1;
        }
        Self {
            entries: parted,
            ends: places,
        }
    }

    fn of(&self, digit: usize) -> &[u64] {
        let first = digit.checked_sub(1).map_or(0, |before| self.ends[before]);
        &self.entries[first..self.ends[digit]]
    }
}

fn corners(points: impl Iterator<Item = DVec3>) -> Corners {
    points.fold(NOWHERE, |(min, max), p| (min.min(p), max.max(p)))
}

/// A cube whose cells are numbered along the curve.
#[derive(Debug, Clone)]
struct Frame {
    min: DVec3,
    cells_per_unit: f64,
}

impl Frame {
    /// The cube in which finite points are put in order first: the one around all of them,
    /// or where a few lie far off the one around the others.
    fn of(count: usize, at: &(impl Fn(usize) -> DVec3 + Sync)) -> Self {
        let nowhere = Self {
            min: DVec3::ZERO,
            cells_per_unit: 0.0,
        };
        let chunks = (0..count.div_ceil(KEYS)).into_par_iter();
        let corners = chunks.map(|chunk| {
            let points = chunk * KEYS..count.min((chunk + 1) * KEYS);
            corners(points.map(at))
        });
        let Some(all) = Self::between(corners.reduce(|| NOWHERE, wider)) else {
            return nowhere;
        };
        let step = count.div_ceil(SAMPLE).max(1);
        let sample = (0..count).step_by(step).map(at);
        let axis = |k: usize| {
            let mut along: Vec<f64> = sample.clone().map(|point| point[k]).collect();
            along.sort_unstable_by(f64::total_cmp);
            let skipped = along.len() / 64;
            (along[skipped], along[along.len() - 1 - skipped])
        };
        let (x, y, z) = (axis(0), axis(1), axis(2));
        let corners = [DVec3::new(x.0, y.0, z.0), DVec3::new(x.1, y.1, z.1)];
        match Self::around(corners.into_iter()) {
            Some(most) if most.cells_per_unit > 4.0 * all.cells_per_unit => most.widened(),
            _ => all,
        }
    }

    /// The cube around the points; `None` where all of them are in one place, or so near to it that
    /// no cell is small enough.
    fn around(points: impl Iterator<Item = DVec3>) -> Option<Self> {
        Self::between(corners(points))
    }

    /// As [`Frame::around`], of the box around the points.
    fn between((min, max): Corners) -> Option<Self> {
        // Halved first: the difference of finite numbers may be infinite.
        let half_extent = (max * 0.5 - min * 0.5).max_element();
        let cells_per_unit = 0.5 * CELLS / half_extent;
        (half_extent > 0.0 && cells_per_unit.is_finite()).then_some(Self {
            min,
            cells_per_unit,
        })
    }

    /// The same cube, half as wide again.
    fn widened(self) -> Self {
        let quarter = 0.25 * CELLS / self.cells_per_unit;
        Self {
            min: self.min - quarter,
            cells_per_unit: self.cells_per_unit / 1.5,
        }
    }

    /// The number of the cell of a finite point.
    #[inline]
    fn key(&self, point: DVec3) -> u32 {
        // Multiplied first, as the difference may be infinite. The cast takes what is below the
        // cube, and NaN, to 0.
        let cell = |p: f64, min: f64| {
            let along = p * self.cells_per_unit - min * self.cells_per_unit;
            (along as u32).min((1 << BITS) - 1)
        };
        hilbert::<BITS>(
            cell(point.x, self.min.x),
            cell(point.y, self.min.y),
            cell(point.z, self.min.z),
        )
    }
}

/// Sorts entries by their keys, which start at bit KEY and have DIGITS digits of BITS bits: least
/// significant digits first, stable.
pub(crate) fn radix_sort<const KEY: u32, const BITS: u32, const DIGITS: usize>(
    entries: &mut [u64],
    spare: &mut Vec<u64>,
) {
    let buckets = 1 << BITS;
    if entries.len() < buckets {
        // Entries of one key are in order of their lower bits in all uses.
        return entries.sort_unstable();
    }
    let of = |entry: u64, digit: usize| (entry >> (KEY + BITS * digit as u32)) as usize % buckets;
    let mut counts = vec![[0u32; DIGITS]; buckets];
    for &entry in entries.iter() {
        for digit in 0..DIGITS {
            counts[of(entry, digit)][digit] += 1;
        }
    }
    let mut starts = [0; DIGITS];
    for counts in &mut counts {
        for (start, count) in starts.iter_mut().zip(counts) {
            *start += std::mem::replace(count, *start);
        }
    }
    spare.clear();
    spare.resize(entries.len(), 0);
    let (mut from, mut to) = (&mut *entries, &mut spare[..]);
    for digit in 0..DIGITS {
        for &entry in from.iter() {
            let place = &mut counts[of(entry, digit)][digit];
            to[*place as usize] = entry;
            *place += 1;
        }
        std::mem::swap(&mut from, &mut to);
    }
    if DIGITS % 2 == 1 {
        to.copy_from_slice(from);
    }
}

/// Per state and octant of two levels: the digits of the curve in the low six bits, the next state
/// above. A state is the corner at which the curve enters a cube (three bits) and the axis along
/// which it leaves (two bits).
static STEPS: [[u16; 64]; 32] = two_levels();

/// The position of a cell along the curve through 2^BITS cells along each axis, an even power (Hamilton
/// and Rau-Chaplin, Compact Hilbert indices, 2007).
#[inline]
pub(crate) fn hilbert<const BITS: u32>(x: u32, y: u32, z: u32) -> u32 {
    let (mut state, mut key) = (0usize, 0u32);
    for level in (0..BITS / 2).rev() {
        let shift = 2 * level;
        let two = |v: u32| (v >> shift & 3) as usize;
        let octants = SPREAD[two(x)] | SPREAD[two(y)] << 1 | SPREAD[two(z)] << 2;
        let step = STEPS[state][octants];
        key = key << 6 | u32::from(step & 63);
        state = usize::from(step >> 6);
    }
    key
}

/// Two bits moved to places 0 and 3.
const SPREAD: [usize; 4] = [0, 1, 8, 9];

const fn two_levels() -> [[u16; 64]; 32] {
    let mut table = [[0; 64]; 32];
    let mut state = 0;
    while state < 32 {
        let mut octants = 0;
        while octants < 64 && state & 3 < 3 {
            let (high, middle) = one_level(state as u16, octants as u16 >> 3);
            let (low, last) = one_level(middle, octants as u16 & 7);
            table[state][octants] = last << 6 | high << 3 | low;
            octants += 1;
        }
        state += 1;
    }
    table
}

/// The digit of an octant in a state, and the state within that octant.
const fn one_level(state: u16, octant: u16) -> (u16, u16) {
    let (entry, axis) = (state >> 2, state & 3);
    let turned = rotate_right(octant ^ entry, axis + 1);
    let digit = gray_inverse(turned);
    let inner_entry = entry ^ rotate_left(entry_point(digit), axis + 1);
    let inner_axis = (axis + inner_direction(digit) + 1) % 3;
    (digit, inner_entry << 2 | inner_axis)
}

const fn rotate_right(bits: u16, by: u16) -> u16 {
    let by = by % 3;
    (bits >> by | bits << (3 - by)) & 7
}

const fn rotate_left(bits: u16, by: u16) -> u16 {
    rotate_right(bits, 3 - by % 3)
}

const fn gray(digit: u16) -> u16 {
    digit ^ digit >> 1
}

const fn gray_inverse(bits: u16) -> u16 {
    bits ^ bits >> 1 ^ bits >> 2
}

/// The corner at which the curve enters the sub-cube of a digit.
const fn entry_point(digit: u16) -> u16 {
    if digit == 0 {
        0
    } else {
        gray((digit - 1) & !1)
    }
}

/// The axis along which the curve crosses the sub-cube of a digit.
const fn inner_direction(digit: u16) -> u16 {
    if digit == 0 {
        0
    } else if digit & 1 == 0 {
        (digit - 1).trailing_ones() as u16 % 3
    } else {
        digit.trailing_ones() as u16 % 3
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::align::tests::scattered;

    fn order(points: &[DVec3]) -> Vec<u32> {
        super::order(points.len(), &|index| points[index])
    }

    #[test]
    fn the_curve_visits_every_cell_once_by_steps_of_one() {
        // The first 64 cells along each axis: one whole sub-cube of the curve.
        let mut cells = vec![None; 64 * 64 * 64];
        for x in 0..64 {
            for y in 0..64 {
                for z in 0..64 {
                    let key = hilbert::<8>(x, y, z) as usize;
                    assert_eq!(cells[key].replace([x, y, z]), None);
                }
            }
        }
        let cells: Vec<[u32; 3]> = cells.into_iter().map(Option::unwrap).collect();
        for pair in cells.windows(2) {
            let step: u32 = (0..3).map(|k| pair[0][k].abs_diff(pair[1][k])).sum();
            assert_eq!(step, 1, "{pair:?}");
        }
    }

    fn path_length(points: &[DVec3], order: &[u32]) -> f64 {
        let at = |index: u32| points[index as usize];
        order.windows(2).map(|w| at(w[0]).distance(at(w[1]))).sum()
    }

    #[test]
    fn every_index_appears_once_and_the_path_is_short() {
        let points = scattered(20, 20_000);
        let order = order(&points);
        let mut sorted = order.clone();
        sorted.sort_unstable();
        assert!(
            sorted
                .iter()
                .enumerate()
                .all(|(i, &index)| i == index as usize)
        );
        // Neighbours of 20 000 points in a cube of 2³ are about 0.07 apart; strangers about 1.3.
        assert!(path_length(&points, &order) < 0.1 * 20_000.0);
    }

    #[test]
    fn an_outlier_changes_little() {
        let mut points = scattered(21, 20_000);
        let before = path_length(&points, &order(&points));
        points.push(DVec3::splat(1e9));
        points.push(DVec3::new(-1e300, 1e300, 0.0));
        let order = order(&points);
        let near: Vec<u32> = order.into_iter().filter(|&index| index < 20_000).collect();
        assert!(path_length(&points, &near) < 1.2 * before);
    }

    #[test]
    fn equal_points_stay_in_input_order() {
        let points = vec![DVec3::splat(0.1); 10_000];
        assert!(order(&points).windows(2).all(|pair| pair[0] < pair[1]));
        let two: Vec<DVec3> = (0..3000).map(|i| DVec3::X * f64::from(i % 2)).collect();
        let sorted = order(&two);
        assert!(sorted[..1500].windows(2).all(|pair| pair[0] < pair[1]));
        assert!(sorted[..1500].iter().all(|index| index % 2 == 0));
    }

    #[test]
    fn entries_are_shared_out_into_the_order_of_one_thread() {
        let pool = |threads| {
            rayon::ThreadPoolBuilder::new()
                .num_threads(threads)
                .build()
                .unwrap()
        };
        for (count, kept) in [(FEW, u64::MAX), (3 * FEW + 7, 0x3ff_0000), (FEW + 1, 0)] {
            let random = |index: u64| index.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 34;
            let entry = |index| (random(index) & kept) << 32 | index;
            let entries: Vec<u64> = (0..count as u64).map(entry).collect();
            let mut expected = entries.clone();
            expected.sort_unstable();
            for threads in [1, 2, 7] {
                let mut sorted = entries.clone();
                pool(threads).install(|| sort_by_key(&mut sorted, &mut Vec::new()));
                assert!(sorted == expected, "{count} by {threads} threads");
            }
        }
    }

    #[test]
    fn the_ends_of_the_number_range_are_ordered() {
        for scale in [1e-308, 1e-320, 1e300, f64::MAX / 2.0] {
            let points: Vec<DVec3> = scattered(22, 2000).iter().map(|p| *p * scale).collect();
            let mut sorted = order(&points);
            sorted.sort_unstable();
            assert!(
                sorted
                    .iter()
                    .enumerate()
                    .all(|(i, &index)| i == index as usize)
            );
        }
        assert_eq!(order(&[]), []);
    }
}
