//! A few neighbouring points split into blocks, as a tree of halves.
#![allow(
    clippy::needless_range_loop,
    reason = "one index runs over several columns"
)]

use super::blocks::{LANES, NOWHERE, around};
use super::hilbert::CHUNK;
use super::wide::{Registers, Task, Width};
use glam::DVec3;

/// The largest coordinate of an entry.
const FINEST: f64 = u16::MAX as f64;
/// Entries that spread over less than this have their coordinates made again, finer.
const COARSE: u16 = 256;

/// A point: its place in the box around its neighbours along x, y and z, and its index.
type Entry = [u16; 4];

/// Halves at most [`CHUNK`] finite points across their longest extent, again and again, down to whole
/// blocks: boxes of a tree are tighter than those of stretches of the curve. The points' indices in
/// that order.
pub(super) fn split(points: &[DVec3]) -> Vec<u16> {
    split_by(Registers::widest(), points)
}

fn split_by(registers: Registers, points: &[DVec3]) -> Vec<u16> {
    registers.run(Split { points })
}

struct Split<'a> {
    points: &'a [DVec3],
}

impl Task for Split<'_> {
    type Output = Vec<u16>;

    #[inline(always)]
    fn run(self, _: impl Width) -> Vec<u16> {
        assert!(self.points.len() <= CHUNK, "a chunk has 16-bit indices");
        let mut entries = [[0; 4]; CHUNK];
        let entries = &mut entries[..self.points.len()];
        for (index, entry) in entries.iter_mut().enumerate() {
            entry[3] = index as u16;
        }
        let mut room = Room {
            keys: [u16::MAX; CHUNK],
            sorted: [[0; 4]; CHUNK],
        };
        // Parts still to be halved, the last one first: each leaves one more on its way down.
        let mut parts = [(0, 0); CHUNK / LANES];
        parts[0] = (0, entries.len());
        let mut waiting = 1;
        let mut is_fresh = place(self.points, entries);
        while waiting > 0 {
            waiting -= 1;
            let (first, end) = parts[waiting];
            let part = &mut entries[first..end];
            let blocks = part.len().div_ceil(LANES);
            if blocks < 2 {
                continue;
            }
            let mut extents = extents(part);
            if !std::mem::take(&mut is_fresh) && extents.iter().all(|&extent| extent < COARSE) {
                place(self.points, part);
                extents = self::extents(part);
            }
            let axis = longest(extents);
            if extents[axis] == 0 {
                continue;
            }
            let middle = blocks.div_ceil(2).next_power_of_two().min(blocks - 1) * LANES;
            match axis {
                0 => halve::<0>(part, middle, &mut room),
                1 => halve::<1>(part, middle, &mut room),
                _ => halve::<2>(part, middle, &mut room),
            }
            parts[waiting] = (first + middle, end);
            parts[waiting + 1] = (first, first + middle);
            waiting += 2;
        }
        entries.iter().map(|entry| entry[3]).collect()
    }
}

/// Gives entries their places in the box around their points; false where these are all in one place,
/// or as good as that.
#[inline(always)]
fn place(points: &[DVec3], entries: &mut [Entry]) -> bool {
    let at = |entry: &Entry| points[usize::from(entry[3])];
    let (min, max) = entries
        .iter()
        .fold(NOWHERE, |corners, entry| around(corners, at(entry)));
    // Halved first: the difference of finite numbers may be infinite.
    let scale = FINEST / (max * 0.5 - min * 0.5).max_element();
    if !scale.is_finite() {
        entries.iter_mut().for_each(|entry| entry[..3].fill(0));
        return false;
    }
    for entry in entries {
        let along = (at(entry) * 0.5 - min * 0.5) * scale;
        for axis in 0..3 {
            entry[axis] = along[axis] as u16;
        }
    }
    true
}

#[inline(always)]
fn extents(entries: &[Entry]) -> [u16; 3] {
    let (mut min, mut max) = ([u16::MAX; 4], [0; 4]);
    for entry in entries {
        for k in 0..4 {
            min[k] = entry[k].min(min[k]);
            max[k] = entry[k].max(max[k]);
        }
    }
    [max[0] - min[0], max[1] - min[1], max[2] - min[2]]
}

fn longest([x, y, z]: [u16; 3]) -> usize {
    match x >= y && x >= z {
        true => 0,
        false if y >= z => 1,
        false => 2,
    }
}

/// Where a part is sorted.
struct Room {
    keys: [u16; CHUNK],
    sorted: [Entry; CHUNK],
}

/// Brings the `middle` least along an axis to the front; those at one place stay in their order.
#[inline(always)]
fn halve<const AXIS: usize>(entries: &mut [Entry], middle: usize, room: &mut Room) {
    let keys = &mut room.keys[..entries.len().next_multiple_of(LANES)];
    let (mut least, mut largest) = (u16::MAX, 0);
    for (key, entry) in keys.iter_mut().zip(&*entries) {
        *key = entry[AXIS];
        (least, largest) = (least.min(*key), largest.max(*key));
    }
    // What is left of the last sixteen counts as larger than all.
    keys[entries.len()..].fill(u16::MAX);
    // The largest bound with at most `middle` below it: guessed as if all were spread evenly between
    // two bounds, and halfway at times where that comes to little.
    let mut low = (usize::from(least), 0);
    let mut high = (usize::from(largest) + 1, entries.len());
    let mut guesses = 0;
    while high.0 - low.0 > 1 {
        let (bounds, counts) = (high.0 - low.0, high.1 - low.1);
        let ahead = match guesses > 3 && guesses % 2 == 0 {
            true => bounds / 2,
            false => bounds * (middle - low.1) / counts.max(1),
        };
        let bound = low.0 + ahead.clamp(1, bounds - 1);
        let count = below(keys, bound as u16);
        guesses += 1;
        if count == middle {
            low = (bound, count);
            break;
        }
        if count < middle {
            low = (bound, count);
        } else {
            high = (bound, count);
        }
    }
    let bound = low.0 as u16;
    let mut at_bound = middle - low.1;
    let mut lower = 0;
    let mut put = |nth: usize, entry: Entry, is_lower: bool| {
        let place = if is_lower {
            lower
        } else {
            middle + nth - lower
        };
        room.sorted[place % CHUNK] = entry;
        lower += usize::from(is_lower);
    };
    if at_bound == 0 {
        for (nth, &entry) in entries.iter().enumerate() {
            put(nth, entry, entry[AXIS] < bound);
        }
    } else {
        for (nth, &entry) in entries.iter().enumerate() {
            let is_taken = (entry[AXIS] == bound) & (at_bound > 0);
            at_bound -= usize::from(is_taken);
            put(nth, entry, (entry[AXIS] < bound) | is_taken);
        }
    }
    entries.copy_from_slice(&room.sorted[..entries.len()]);
}

/// How many keys, some times sixteen, are below a bound.
#[inline(always)]
fn below(keys: &[u16], bound: u16) -> usize {
    let mut counts = [0u16; LANES];
    for keys in keys.chunks_exact(LANES) {
        for k in 0..LANES {
            counts[k] += u16::from(keys[k] < bound);
        }
    }
    usize::from(counts.iter().sum::<u16>())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::align::tests::scattered;

    const ALL: [Registers; 3] = [Registers::Baseline, Registers::Avx2, Registers::Avx512];

    fn longest_extent(points: &[DVec3], part: &[u16]) -> (DVec3, usize) {
        let at = |&index: &u16| points[usize::from(index)];
        let (min, max) = part.iter().map(at).fold(NOWHERE, around);
        let extent = max * 0.5 - min * 0.5;
        (extent, extent.max_position())
    }

    /// The tree again, top down: each half lies on its side of the other, but for what rounding to
    /// 65 536 places along the box of all leaves open.
    fn check_halves(points: &[DVec3], order: &[u16], slack: f64) {
        let blocks = order.len().div_ceil(LANES);
        if blocks < 2 {
            return;
        }
        let middle = blocks.div_ceil(2).next_power_of_two().min(blocks - 1) * LANES;
        let (lower, upper) = order.split_at(middle);
        let (extent, _) = longest_extent(points, order);
        let along = |axis: usize| {
            let at = |&index: &u16| points[usize::from(index)][axis];
            let last = lower.iter().map(at).fold(f64::NEG_INFINITY, f64::max);
            let first = upper.iter().map(at).fold(f64::INFINITY, f64::min);
            last * 0.5 - first * 0.5 <= slack && extent[axis] >= extent.max_element() - 2.0 * slack
        };
        assert!((0..3).any(along), "{extent} {middle}");
        check_halves(points, lower, slack);
        check_halves(points, upper, slack);
    }

    #[test]
    fn each_half_lies_on_its_side_across_the_longest_extent() {
        for count in [1, 15, 16, 17, 32, 33, 100, 1000, 1009, 1024, 4096] {
            let points = scattered(count, count);
            for registers in ALL {
                let order = split_by(registers, &points);
                let mut sorted = order.clone();
                sorted.sort_unstable();
                assert!(sorted.iter().enumerate().all(|(i, &k)| i == usize::from(k)));
                check_halves(&points, &order, 2.0 / FINEST);
            }
        }
    }

    #[test]
    fn all_registers_give_one_order() {
        let points = scattered(7, 1000);
        let orders = ALL.map(|registers| split_by(registers, &points));
        assert!(orders.iter().all(|order| *order == orders[0]));
    }

    #[test]
    fn beside_an_outlier_the_others_are_halved_as_finely() {
        let mut points = scattered(8, 1023);
        points.push(DVec3::new(1e300, -1e300, f64::MAX));
        let order = split(&points);
        let near: Vec<u16> = order.into_iter().filter(|&index| index < 1023).collect();
        // A part with the outlier is cut anywhere, the other half of it properly: its blocks are less
        // than 1.2 wide in a cube of 2³, those of strangers 1.8.
        let wide = |block: &[u16]| longest_extent(&points, block).0.max_element() > 0.6;
        let strangers = near.chunks_exact(LANES).filter(|block| wide(block)).count();
        assert!(strangers <= 12, "{strangers}");
    }

    #[test]
    fn equal_points_and_the_ends_of_the_number_range_are_ordered() {
        assert_eq!(split(&[]), []);
        assert_eq!(split(&[DVec3::ONE; 500]), Vec::from_iter(0..500));
        for scale in [1e-320, 1e-308, 1e300, f64::MAX / 2.0] {
            let points: Vec<DVec3> = scattered(9, 1000).iter().map(|p| *p * scale).collect();
            let mut order = split(&points);
            order.sort_unstable();
            assert_eq!(order, Vec::from_iter(0..1000));
        }
    }
}
