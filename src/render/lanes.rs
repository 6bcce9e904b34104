//! Eight f32 side by side, in the widest registers that the machine has.
//!
//! What is computed with them is only ever a first guess with a known error, so a set of
//! instructions may round differently (fused or not) without changing a result.

use super::cluster::{MANY, Many};
use super::doubles::Doubles;

/// Numbers side by side.
pub(crate) const LANES: usize = 8;
/// Values of a table: any byte is a place.
pub(crate) const TABLE: usize = 256;
/// All of them, as bits.
pub(crate) const ALL: u32 = (1 << LANES) - 1;

/// A set of instructions. Comparisons with NaN are false, and so is its lane's bit.
pub(crate) trait Lanes: Doubles {
    /// Eight f32.
    type V: Copy;
    /// Eight answers.
    type M: Copy;
    /// Whether [`Self::meet_cells`] is quick.
    const CELLS: bool;
    fn load(self, values: &[f32; LANES]) -> Self::V;
    fn store(self, values: Self::V) -> [f32; LANES];
    fn splat(self, value: f32) -> Self::V;
    /// The values of eight bytes.
    fn bytes(self, values: [u8; LANES]) -> Self::V;
    fn add(self, a: Self::V, b: Self::V) -> Self::V;
    fn sub(self, a: Self::V, b: Self::V) -> Self::V;
    fn mul(self, a: Self::V, b: Self::V) -> Self::V;
    fn div(self, a: Self::V, b: Self::V) -> Self::V;
    /// a · b + c, rounded once or twice.
    fn mul_add(self, a: Self::V, b: Self::V, c: Self::V) -> Self::V;
    /// `b` where either is NaN.
    fn min(self, a: Self::V, b: Self::V) -> Self::V;
    fn max(self, a: Self::V, b: Self::V) -> Self::V;
    fn abs(self, a: Self::V) -> Self::V;
    fn floor(self, a: Self::V) -> Self::V;
    fn ceil(self, a: Self::V) -> Self::V;
    /// Where a < b.
    fn below(self, a: Self::V, b: Self::V) -> Self::M;
    fn and(self, a: Self::M, b: Self::M) -> Self::M;
    fn or(self, a: Self::M, b: Self::M) -> Self::M;
    /// The lanes with the answer yes, as bits.
    fn bits(self, mask: Self::M) -> u32;
    /// `new` in the lanes with the answer yes.
    fn choose(self, mask: Self::M, new: Self::V, old: Self::V) -> Self::V;
    /// A whole number in the lanes with the answer yes, `old` in the others.
    fn overwrite(self, mask: Self::M, new: u32, old: &[u32; LANES]) -> [u32; LANES];
    /// Bits of the lanes where a < b.
    #[inline(always)]
    fn less(self, a: Self::V, b: Self::V) -> u32 {
        self.bits(self.below(a, b))
    }
    /// Bits of the lanes in which two whole numbers differ.
    fn differ(self, a: &[u32; LANES], b: &[u32; LANES]) -> u32;
    /// `new` in the lanes whose bit is set.
    fn pick(self, bits: u32, new: Self::V, old: Self::V) -> Self::V;
    /// A table's values at three times eight places, which are below 64 where they are `few`.
    fn gather(self, table: &[f32; TABLE], few: bool, places: &[[u8; LANES]; 3]) -> [Self::V; 3];
    /// Whole numbers below 2^16.
    fn shorts(self, values: Self::V) -> [u16; LANES];
    /// The triangles, by three corners each, all of them places below 64, that may cover some sample, as
    /// bits: see [`super::lens::Projected::find_cells`].
    fn meet_cells(self, cells: [&[u16; TABLE]; 2], corners: [&Many; 3]) -> u32;
    /// The lanes whose bit is set, moved to the front in their order; anything behind them.
    fn pack(self, bits: u32, values: Self::V) -> Self::V;
    /// As [`Self::pack`].
    fn pack_bytes(self, bits: u32, bytes: [u8; LANES]) -> [u8; LANES];
    /// The numbers of two, by turns.
    fn pairs(self, a: Self::V, b: Self::V) -> [[f32; 2]; LANES];
    /// The numbers of three, by turns.
    fn triples(self, a: Self::V, b: Self::V, c: Self::V) -> [[f32; 3]; LANES];
    /// The least of the lanes, if none is NaN.
    fn least(self, values: Self::V) -> f32;
    /// The greatest of the lanes, if none is NaN.
    #[inline(always)]
    fn greatest(self, values: Self::V) -> f32 {
        -self.least(self.sub(self.splat(0.0), values))
    }
}

/// Which lanes come first when those with a bit set are packed: a byte each.
pub(crate) const PACKED: [u64; 1 << LANES] = {
    let mut orders = [0; 1 << LANES];
    let mut bits = 0;
    while bits < orders.len() {
        let (mut count, mut lane) = (0, 0);
        while lane < LANES {
            if bits >> lane & 1 == 1 {
                orders[bits] |= (lane as u64) << (8 * count);
                count += 1;
            }
            lane += 1;
        }
        bits += 1;
    }
    orders
};

/// A table's values at places, one by one.
#[inline(always)]
pub(crate) fn gathered(table: &[f32; TABLE], places: &[[u8; LANES]; 3]) -> [[f32; LANES]; 3] {
    let mut values = [[0.0; LANES]; 3];
    for corner in 0..3 {
        for lane in 0..LANES {
            values[corner][lane] = table[usize::from(places[corner][lane])];
        }
    }
    values
}

/// Work written once for all sets of instructions.
pub(crate) trait Task {
    type Output;
    /// Implementations are `#[inline(always)]`, or the instructions do not reach them.
    fn run<L: Lanes>(self, lanes: L) -> Self::Output;
}

/// Runs a task with the best instructions of this machine.
#[inline]
pub(crate) fn dispatch<T: Task>(task: T) -> T::Output {
    #[cfg(test)]
    if let Some(width) = forced::width() {
        return forced::dispatch(task, width);
    }
    #[cfg(target_arch = "x86_64")]
    if let Some(widest) = pulp::x86::V4::try_new() {
        return widest.vectorize(
            #[inline(always)]
            || task.run(widest),
        );
    }
    #[cfg(target_arch = "x86_64")]
    if let Some(wide) = pulp::x86::V3::try_new() {
        return wide.vectorize(
            #[inline(always)]
            || task.run(wide),
        );
    }
    task.run(Plain)
}

/// Lets a test have whole pictures made by another set of instructions than the machine's best. Tests
/// beside it may be met by this, which must not change what they find.
#[cfg(test)]
pub(crate) mod forced {
    use super::{Plain, Task};
    use std::sync::atomic::{AtomicU8, Ordering};

    #[derive(Debug, Clone, Copy, PartialEq)]
    pub(crate) enum Width {
        Plain = 1,
        Avx2 = 2,
    }

    static WIDTH: AtomicU8 = AtomicU8::new(0);

    pub(crate) fn force(width: Option<Width>) {
        WIDTH.store(width.map_or(0, |width| width as u8), Ordering::SeqCst);
    }

    pub(super) fn width() -> Option<Width> {
        match WIDTH.load(Ordering::SeqCst) {
            1 => Some(Width::Plain),
            2 => Some(Width::Avx2),
            _ => None,
        }
    }

    pub(super) fn dispatch<T: Task>(task: T, width: Width) -> T::Output {
        #[cfg(target_arch = "x86_64")]
        if let (Width::Avx2, Some(wide)) = (width, pulp::x86::V3::try_new()) {
            return wide.vectorize(
                #[inline(always)]
                || task.run(wide),
            );
        }
        let _ = width;
        task.run(Plain)
    }
}

/// The lanes whose bit is set.
pub(crate) struct SetBits(pub(crate) u32);

impl Iterator for SetBits {
    type Item = usize;

    #[inline(always)]
    fn next(&mut self) -> Option<usize> {
        if self.0 == 0 {
            return None;
        }
        let lane = self.0.trailing_zeros() as usize;
        self.0 &= self.0 - 1;
        Some(lane % LANES)
    }
}

/// A whole number between 0 and 2^16: the low bits of its sum with 2^23.
#[inline(always)]
pub(crate) fn whole(value: f32) -> usize {
    ((value + 8_388_608.0).to_bits() & 0xffff) as usize
}

/// Plain loops, for any machine.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Plain;

#[inline(always)]
fn each(a: [f32; LANES], b: [f32; LANES], f: impl Fn(f32, f32) -> f32) -> [f32; LANES] {
    let mut result = [0.0; LANES];
    for lane in 0..LANES {
        result[lane] = f(a[lane], b[lane]);
    }
    result
}

impl Lanes for Plain {
    type V = [f32; LANES];
    type M = [bool; LANES];
    const CELLS: bool = false;

    #[inline(always)]
    fn load(self, values: &[f32; LANES]) -> Self::V {
        *values
    }

    #[inline(always)]
    fn store(self, values: Self::V) -> [f32; LANES] {
        values
    }

    #[inline(always)]
    fn splat(self, value: f32) -> Self::V {
        [value; LANES]
    }

    #[inline(always)]
    fn bytes(self, values: [u8; LANES]) -> Self::V {
        values.map(f32::from)
    }

    #[inline(always)]
    fn add(self, a: Self::V, b: Self::V) -> Self::V {
        each(a, b, |a, b| a + b)
    }

    #[inline(always)]
    fn sub(self, a: Self::V, b: Self::V) -> Self::V {
        each(a, b, |a, b| a - b)
    }

    #[inline(always)]
    fn mul(self, a: Self::V, b: Self::V) -> Self::V {
        each(a, b, |a, b| a * b)
    }

    #[inline(always)]
    fn div(self, a: Self::V, b: Self::V) -> Self::V {
        each(a, b, |a, b| a / b)
    }

    #[inline(always)]
    fn mul_add(self, a: Self::V, b: Self::V, c: Self::V) -> Self::V {
        self.add(self.mul(a, b), c)
    }

    #[inline(always)]
    fn min(self, a: Self::V, b: Self::V) -> Self::V {
        each(a, b, |a, b| if a < b { a } else { b })
    }

    #[inline(always)]
    fn max(self, a: Self::V, b: Self::V) -> Self::V {
        each(a, b, |a, b| if a > b { a } else { b })
    }

    #[inline(always)]
    fn abs(self, a: Self::V) -> Self::V {
        a.map(f32::abs)
    }

    #[inline(always)]
    fn floor(self, a: Self::V) -> Self::V {
        a.map(f32::floor)
    }

    #[inline(always)]
    fn ceil(self, a: Self::V) -> Self::V {
        a.map(f32::ceil)
    }

    #[inline(always)]
    fn below(self, a: Self::V, b: Self::V) -> Self::M {
        let mut mask = [false; LANES];
        for lane in 0..LANES {
            mask[lane] = a[lane] < b[lane];
        }
        mask
    }

    #[inline(always)]
    fn and(self, a: Self::M, b: Self::M) -> Self::M {
        let mut mask = a;
        for lane in 0..LANES {
            mask[lane] &= b[lane];
        }
        mask
    }

    #[inline(always)]
    fn or(self, a: Self::M, b: Self::M) -> Self::M {
        let mut mask = a;
        for lane in 0..LANES {
            mask[lane] |= b[lane];
        }
        mask
    }

    #[inline(always)]
    fn bits(self, mask: Self::M) -> u32 {
        let bit = |lane: usize| u32::from(mask[lane]) << lane;
        (0..LANES).fold(0, |bits, lane| bits | bit(lane))
    }

    #[inline(always)]
    fn choose(self, mask: Self::M, new: Self::V, old: Self::V) -> Self::V {
        let mut result = old;
        for lane in 0..LANES {
            if mask[lane] {
                result[lane] = new[lane];
            }
        }
        result
    }

    #[inline(always)]
    fn overwrite(self, mask: Self::M, new: u32, old: &[u32; LANES]) -> [u32; LANES] {
        let mut result = *old;
        for lane in 0..LANES {
            if mask[lane] {
                result[lane] = new;
            }
        }
        result
    }

    #[inline(always)]
    fn differ(self, a: &[u32; LANES], b: &[u32; LANES]) -> u32 {
        let bit = |lane: usize| u32::from(a[lane] != b[lane]) << lane;
        (0..LANES).fold(0, |bits, lane| bits | bit(lane))
    }

    #[inline(always)]
    fn pick(self, bits: u32, new: Self::V, old: Self::V) -> Self::V {
        let mut result = old;
        for lane in 0..LANES {
            if bits >> lane & 1 == 1 {
                result[lane] = new[lane];
            }
        }
        result
    }

    #[inline(always)]
    fn gather(self, table: &[f32; TABLE], _: bool, places: &[[u8; LANES]; 3]) -> [Self::V; 3] {
        gathered(table, places)
    }

    #[inline(always)]
    #[allow(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "whole numbers below 2^16"
    )]
    fn shorts(self, values: Self::V) -> [u16; LANES] {
        values.map(|value| value as u16)
    }

    #[inline(always)]
    fn meet_cells(self, cells: [&[u16; TABLE]; 2], corners: [&Many; 3]) -> u32 {
        let mut met = u32::MAX;
        for cells in cells {
            for triangle in 0..MANY {
                let place = |four: &Many| four[triangle / 4].to_bits().to_le_bytes()[triangle % 4];
                let codes = corners.map(|places| cells[usize::from(place(places))]);
                let [a, b, c] = codes.map(u16::to_le_bytes);
                let least = |k: usize| u16::from(a[k].min(b[k]).min(c[k]));
                met &= !(u32::from(least(0) + least(1) >= 255) << triangle);
            }
        }
        met
    }

    #[inline(always)]
    fn pack(self, bits: u32, values: Self::V) -> Self::V {
        let order = PACKED[bits as usize % PACKED.len()].to_le_bytes();
        order.map(|lane| values[usize::from(lane)])
    }

    #[inline(always)]
    fn pack_bytes(self, bits: u32, bytes: [u8; LANES]) -> [u8; LANES] {
        let order = PACKED[bits as usize % PACKED.len()].to_le_bytes();
        order.map(|lane| bytes[usize::from(lane)])
    }

    #[inline(always)]
    fn pairs(self, a: Self::V, b: Self::V) -> [[f32; 2]; LANES] {
        std::array::from_fn(|lane| [a[lane], b[lane]])
    }

    #[inline(always)]
    fn triples(self, a: Self::V, b: Self::V, c: Self::V) -> [[f32; 3]; LANES] {
        std::array::from_fn(|lane| [a[lane], b[lane], c[lane]])
    }

    #[inline(always)]
    fn least(self, values: Self::V) -> f32 {
        let less = |a: f32, b: f32| if b < a { b } else { a };
        values.into_iter().fold(f32::INFINITY, less)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Everything([f32; LANES], [f32; LANES]);

    impl Task for Everything {
        type Output = (Vec<[f32; LANES]>, Vec<u32>);

        #[inline(always)]
        fn run<L: Lanes>(self, l: L) -> Self::Output {
            let (a, b) = (l.load(&self.0), l.load(&self.1));
            let mut results = vec![
                l.add(a, b),
                l.sub(a, b),
                l.mul(a, b),
                l.div(a, b),
                l.mul_add(a, b, l.splat(0.5)),
                l.min(a, b),
                l.max(a, b),
                l.abs(a),
                l.floor(a),
                l.ceil(a),
                l.pick(0b1010_0110, a, b),
                l.bytes([0, 1, 77, 127, 128, 200, 254, 255]),
            ];
            let (low, high) = (l.below(a, b), l.below(b, a));
            let masks = [l.and(low, high), l.or(low, high), l.or(low, low)];
            results.push(l.choose(masks[1], a, b));
            let written = l.overwrite(masks[0], 7, &[9; LANES]);
            results.push(l.load(&written.map(f32::from_bits)));
            let written = l.overwrite(masks[1], 7, &[9; LANES]);
            results.push(l.load(&written.map(f32::from_bits)));
            let table = std::array::from_fn(|place| (place as f32).sqrt());
            let places = [
                [3, 63, 0, 31, 32, 17, 48, 5],
                [64; LANES],
                [9, 255, 8, 7, 6, 5, 4, 1],
            ];
            results.extend(l.gather(&table, false, &places));
            let [near, _, far] = places;
            results.extend(l.gather(
                &table,
                true,
                &[near, near.map(|p| 63 - p), far.map(|p| p % 64)],
            ));
            // Lanes behind the packed ones may hold anything.
            for bits in [0b1001_0110, 0b1000_0000, ALL] {
                let packed = l.store(l.pack(bits, a));
                let bytes = l.pack_bytes(bits, near).map(f32::from);
                for packed in [packed, bytes] {
                    let kept = |lane: usize| {
                        if lane < bits.count_ones() as usize {
                            packed[lane]
                        } else {
                            0.0
                        }
                    };
                    results.push(l.load(&std::array::from_fn(kept)));
                }
            }
            let shorts = l.mul(l.bytes([0, 1, 77, 127, 128, 200, 254, 255]), l.splat(257.0));
            results.push(l.load(&l.shorts(shorts).map(f32::from)));
            let pairs = l.pairs(a, b);
            let triples = l.triples(a, b, l.floor(a));
            let in_turn = [pairs.as_flattened(), triples.as_flattened()].concat();
            results.extend(in_turn.as_chunks().0.iter().map(|eight| l.load(eight)));
            let finite = l.load(&[1.5, -2.25, 0.0, 7.0, -0.5, 3.0, 6.5, 2.0]);
            results.push(l.splat(l.least(finite)));
            results.push(l.splat(l.greatest(finite)));
            let masks = masks.map(|mask| l.bits(mask)).to_vec();
            let [p, q] = [self.0, self.1].map(|values| values.map(f32::to_bits));
            let differ = [l.differ(&p, &q), l.differ(&p, &p)];
            let stored = results.into_iter().map(|values| l.store(values));
            let less = [l.less(a, b), l.less(b, a), l.less(a, a)];
            (stored.collect(), [&less[..], &differ, &masks].concat())
        }
    }

    #[test]
    fn every_set_of_instructions_does_the_same() {
        // Small dyadic numbers: a fused product rounds as a plain one does.
        let a = [1.5, -2.25, 0.0, 7.0, -0.5, 3.0, f32::NAN, f32::INFINITY];
        let b = [0.5, 4.0, 0.25, 7.0, -8.0, f32::NAN, 1.0, 2.0];
        let plain = Everything(a, b).run(Plain);
        forced::force(Some(forced::Width::Avx2));
        let wide = dispatch(Everything(a, b));
        forced::force(None);
        let best = dispatch(Everything(a, b));
        let bits = |values: &[[f32; LANES]]| -> Vec<[u32; LANES]> {
            let canonical = |value: f32| if value.is_nan() { f32::NAN } else { value };
            values
                .iter()
                .map(|v| v.map(|x| canonical(x).to_bits()))
                .collect()
        };
        for fast in [&wide, &best] {
            assert_eq!(bits(&plain.0), bits(&fast.0));
            assert_eq!(plain.1, fast.1);
        }
        let [least, greatest] = [plain.0.len() - 2, plain.0.len() - 1].map(|k| plain.0[k][0]);
        assert_eq!((least, greatest), (-2.25, 7.0));
        let packed = plain.0[plain.0.len() - 14];
        let [first_pairs, first_triples] = [7, 5].map(|back| plain.0[plain.0.len() - back]);
        assert_eq!(first_pairs[..4], [a[0], b[0], a[1], b[1]]);
        assert_eq!(first_triples[..4], [a[0], b[0], a[0].floor(), a[1]]);
        assert_eq!(packed[..3], [a[1], a[2], a[4]], "lanes 1, 2, 4 and 7");
        let less = [0b0000_0110, 0b1001_0001, 0];
        assert_eq!(plain.1[..3], less);
        assert_eq!(
            plain.1[3..],
            [0b1111_0111, 0, 0, less[0] | less[1], less[0]]
        );
    }
}
