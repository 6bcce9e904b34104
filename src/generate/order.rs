//! Depths by their order: the smallest, the largest and those at given ranks, without sorting a map.
//!
//! Depths are looked at as bits, which are in the order of the numbers: none is below 0.

use mvs_datasets::scene::DepthMap;
use pulp::{Arch, Simd, WithSimd};

/// What a map has of depths.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Extent {
    /// How many there are, at least one.
    pub(super) count: usize,
    pub(super) smallest: f32,
    pub(super) largest: f32,
}

/// Values that are compared side by side.
const BLOCK: usize = 16;
/// Values from one that is tried to the next: a prime, or whole columns would be tried.
const STEP: usize = 61;
/// Maps of fewer values are put into order.
const FEW: usize = 1 << 14;

/// The extent of a map's depths; `None` where it has none.
pub(super) fn extent(depth: &DepthMap) -> Option<Extent> {
    Arch::new().dispatch(ExtentOf(depth.values()))
}

struct ExtentOf<'a>(&'a [f32]);

impl WithSimd for ExtentOf<'_> {
    type Output = Option<Extent>;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> Self::Output {
        let (mut counts, mut largest) = ([0u32; BLOCK], [0u32; BLOCK]);
        // One less, so that none is the largest of all.
        let mut smallest = [u32::MAX; BLOCK];
        let (blocks, rest) = self.0.as_chunks::<BLOCK>();
        let mut last = [0.0; BLOCK];
        last[..rest.len()].copy_from_slice(rest);
        for block in blocks.iter().chain([&last]) {
            for at in 0..BLOCK {
                let bits = block[at].to_bits();
                counts[at] += u32::from(bits != 0);
                largest[at] = largest[at].max(bits);
                smallest[at] = smallest[at].min(bits.wrapping_sub(1));
            }
        }
        let count = counts.iter().map(|&count| count as usize).sum();
        let smallest = smallest.into_iter().min()?.wrapping_add(1);
        (count > 0).then_some(Extent {
            count,
            smallest: f32::from_bits(smallest),
            largest: f32::from_bits(largest.into_iter().max()?),
        })
    }
}

/// How many depths are above `low` and at most `high`.
pub(super) fn count_within(depth: &DepthMap, (low, high): (f64, f64)) -> usize {
    let (low, high) = (rounded_down(low), rounded_down(high));
    Arch::new().dispatch(CountWithin(depth.values(), (low, high)))
}

struct CountWithin<'a>(&'a [f32], (f32, f32));

impl WithSimd for CountWithin<'_> {
    type Output = usize;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> usize {
        let Self(values, (low, high)) = self;
        let (blocks, rest) = values.as_chunks::<BLOCK>();
        let mut counts = [0u32; BLOCK];
        for block in blocks {
            for at in 0..BLOCK {
                counts[at] += u32::from(block[at] > low && block[at] <= high);
            }
        }
        let last = rest.iter().filter(|&&value| value > low && value <= high);
        last.count() + counts.iter().map(|&count| count as usize).sum::<usize>()
    }
}

/// The largest f32 that is not above a value: f32 are above that or not as they are above the value.
fn rounded_down(value: f64) -> f32 {
    #[allow(clippy::cast_possible_truncation, reason = "the nearest is wanted")]
    let nearest = value as f32;
    if f64::from(nearest) > value {
        nearest.next_down()
    } else {
        nearest
    }
}

/// The depths at these ranks, counted from 0 at the smallest, of the `count` that there are.
pub(super) fn at_ranks(depth: &DepthMap, count: usize, ranks: [usize; 2]) -> [f32; 2] {
    // What is no depth comes first.
    let none = depth.values().len() - count;
    let tried = Tried::new(depth.values());
    let ranks = ranks.map(|rank| none + rank.min(count - 1));
    tried.at(ranks).map(f32::from_bits)
}

/// Values, and some of them in order.
struct Tried<'a> {
    values: &'a [f32],
    some: Vec<u32>,
}

impl<'a> Tried<'a> {
    fn new(values: &'a [f32]) -> Self {
        let step = if values.len() < FEW { 1 } else { STEP };
        let mut some: Vec<u32> = values.iter().step_by(step).map(|z| z.to_bits()).collect();
        some.sort_unstable();
        Self { values, some }
    }

    /// The bits of the values at two ranks among all.
    fn at(&self, ranks: [usize; 2]) -> [u32; 2] {
        if self.some.len() == self.values.len() {
            return ranks.map(|rank| self.some[rank]);
        }
        let bounds = ranks.map(|rank| self.around(rank));
        let mut found = collect(self.values, bounds);
        [0, 1].map(|which| {
            let (below, within) = &mut found[which];
            match ranks[which].checked_sub(*below) {
                Some(rank) if rank < within.len() => *within.select_nth_unstable(rank).1,
                _ => self.select(ranks[which]),
            }
        })
    }

    /// Bits between which the value at a rank very probably lies. The ranks of values that are taken at
    /// random stray by the root of their number, of those that are taken regularly by less.
    fn around(&self, rank: usize) -> (u32, u32) {
        #[allow(
            clippy::cast_precision_loss,
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "fractions and roots of counts"
        )]
        let (place, margin) = {
            let (count, part) = (
                self.some.len() as f64,
                rank as f64 / self.values.len() as f64,
            );
            let stray = (count * part * (1.0 - part)).sqrt();
            ((part * count) as usize, (4.0 * stray) as usize + 2)
        };
        let low = place.checked_sub(margin).map_or(0, |at| self.some[at]);
        let high = self.some.get(place + margin);
        // Depths alone are asked for.
        (low.max(1), *high.unwrap_or(&u32::MAX))
    }

    /// The obvious way.
    fn select(&self, rank: usize) -> u32 {
        let mut bits: Vec<u32> = self.values.iter().map(|z| z.to_bits()).collect();
        *bits.select_nth_unstable(rank).1
    }
}

/// Of each of two pairs of bounds: how many values lie below the first, and which between both, they
/// themselves included.
fn collect(values: &[f32], bounds: [(u32, u32); 2]) -> [(usize, Vec<u32>); 2] {
    Arch::new().dispatch(Collect(values, bounds))
}

struct Collect<'a>(&'a [f32], [(u32, u32); 2]);

impl WithSimd for Collect<'_> {
    type Output = [(usize, Vec<u32>); 2];

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> Self::Output {
        let Self(values, bounds) = self;
        let mut within = [(); 2].map(|()| Vec::with_capacity(values.len() / 64));
        let (blocks, rest) = values.as_chunks::<BLOCK>();
        let mut counts = [[0u32; BLOCK]; 2];
        for block in blocks {
            for (which, (low, high)) in bounds.into_iter().enumerate() {
                let mut any = 0;
                for at in 0..BLOCK {
                    let bits = block[at].to_bits();
                    counts[which][at] += u32::from(bits < low);
                    // Differences from the lower one wrap around for what lies below.
                    any |= u32::from(bits.wrapping_sub(low) <= high.wrapping_sub(low));
                }
                if any != 0 {
                    add_within(block, (low, high), &mut within[which]);
                }
            }
        }
        let [first, second] = within;
        let mut found = [(0, first), (0, second)];
        for (((below, within), counts), bounds) in found.iter_mut().zip(counts).zip(bounds) {
            *below = counts.iter().map(|&count| count as usize).sum();
            *below += (rest.iter().filter(|value| value.to_bits() < bounds.0)).count();
            add_within(rest, bounds, within);
        }
        found
    }
}

/// Adds the values that lie between the bounds.
#[inline(never)]
fn add_within(values: &[f32], (low, high): (u32, u32), within: &mut Vec<u32>) {
    let bits = values.iter().map(|value| value.to_bits());
    within.extend(bits.filter(|bits| (low..=high).contains(bits)));
}

#[cfg(test)]
mod tests {
    use super::*;

    fn map(values: Vec<f32>) -> DepthMap {
        let (depth, rejected) = DepthMap::from_values(values.len() as u32, 1, values).unwrap();
        assert_eq!(rejected.total(), 0);
        depth
    }

    fn noise(index: u32) -> u32 {
        let state = index.wrapping_mul(2_654_435_761) ^ 0x9e37_79b9;
        let state = (state ^ state >> 15).wrapping_mul(3_266_489_917);
        state ^ state >> 13
    }

    /// Maps of several kinds: noise, a slope, few distinct depths, hardly any, and what the tried values
    /// say nothing of.
    fn depths(kind: u32, count: u32) -> Vec<f32> {
        let value = |i: u32| match kind {
            0 => 1.0 + (noise(i) >> 8) as f32 * 1e-7,
            1 if i.is_multiple_of(5) => 0.0,
            1 => 3.0 + i as f32 * 1e-4,
            2 => [0.0, 2.5, 2.5, 7.0][(noise(i) % 4) as usize],
            3 if noise(i).is_multiple_of(5000) => (noise(i + 1) >> 16) as f32 + 1.0,
            3 => 0.0,
            _ if i.is_multiple_of(STEP as u32) => 5.0,
            _ => (noise(i) >> 16) as f32 * 1e-3 + 1e-3,
        };
        (0..count).map(value).collect()
    }

    #[test]
    fn ranks_and_extents_are_those_of_sorted_depths() {
        for kind in 0..5 {
            for count in [1, 15, 16, 33, 16_383, 16_384, 70_001] {
                let values = depths(kind, count);
                let depth = map(values.clone());
                let mut sorted: Vec<f32> = values.into_iter().filter(|&z| z > 0.0).collect();
                sorted.sort_by(f32::total_cmp);
                let Some(&smallest) = sorted.first() else {
                    assert_eq!(extent(&depth), None);
                    continue;
                };
                let found = extent(&depth).unwrap();
                let (count, last) = (sorted.len(), sorted.len() - 1);
                assert_eq!((found.count, found.smallest), (count, smallest));
                assert_eq!(found.largest, sorted[last]);
                for part in [0, 1, 10, 500, 990, 999, 1000] {
                    let ranks = [last * part / 1000, last - last * part / 1000];
                    let expected = ranks.map(|rank| sorted[rank]);
                    assert_eq!(at_ranks(&depth, count, ranks), expected, "{kind} {part}");
                }
            }
        }
    }

    #[test]
    fn what_the_tried_values_miss_is_found_the_obvious_way() {
        let values = depths(4, 70_001);
        let tried = Tried::new(&values);
        let (low, high) = tried.around(35_000);
        let [(below, within), other] = collect(&values, [(low, high), (0, u32::MAX)]);
        assert_eq!(other.1.len(), values.len());
        assert!(35_000 < below || below + within.len() <= 35_000);
    }

    #[test]
    fn depths_are_counted_as_numbers_of_f64_are() {
        let values = depths(0, 1000);
        let depth = map(values.clone());
        for at in 0..999 {
            let (a, b) = (f64::from(values[at]), f64::from(values[at + 1]));
            for (low, high) in [(a, b), (b, a), (a - 1e-9, b + 1e-9), (a + 1e-9, b - 1e-9)] {
                let all = values.iter().map(|&z| f64::from(z));
                let expected = all.filter(|&z| z > low && z <= high).count();
                assert_eq!(count_within(&depth, (low, high)), expected);
            }
        }
        assert_eq!(count_within(&depth, (f64::MIN, f64::MAX)), 1000);
        assert_eq!(count_within(&depth, (0.0, f64::INFINITY)), 1000);
    }
}
