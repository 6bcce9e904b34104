//! Eight f32 side by side, in the widest registers that the machine has.
//!
//! What is computed with them is only ever a first guess with a known error, so a set of
//! instructions may round differently (fused or not) without changing a result.

use super::doubles::Doubles;

/// Numbers side by side.
pub(crate) const LANES: usize = 8;
/// All of them, as bits.
pub(crate) const ALL: u32 = (1 << LANES) - 1;

/// A set of instructions. Comparisons with NaN are false, and so is its lane's bit.
pub(crate) trait Lanes: Doubles {
    /// Eight f32.
    type V: Copy;
    /// Eight answers.
    type M: Copy;
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
    if forced::is_plain() {
        return task.run(Plain);
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

/// Lets a test have whole pictures made without the machine's best instructions. Tests beside it may
/// be met by this, which must not change what they find.
#[cfg(test)]
pub(crate) mod forced {
    use std::sync::atomic::{AtomicBool, Ordering};

    static PLAIN: AtomicBool = AtomicBool::new(false);

    pub(crate) fn plain(on: bool) {
        PLAIN.store(on, Ordering::SeqCst);
    }

    pub(super) fn is_plain() -> bool {
        PLAIN.load(Ordering::SeqCst)
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
}

#[cfg(target_arch = "x86_64")]
mod x86 {
    use super::{LANES, Lanes};
    use pulp::x86::V3;
    use pulp::{cast, f32x8, m32x8, u32x8};

    const BITS: u32x8 = u32x8(1, 2, 4, 8, 16, 32, 64, 128);

    /// `new` where the mask says so, by a way that the compiler does not see through. What it knows
    /// to be chosen by a mask and stored where the rest came from becomes a masked store, which AMD's
    /// processors take tens of cycles for.
    #[inline(always)]
    fn merge(wide: V3, mask: m32x8, new: u32x8, old: u32x8) -> u32x8 {
        let ones = cast(wide.splat_u32x8(1));
        let mask = wide.avx2._mm256_sign_epi32(ones, cast(mask));
        let new = wide.avx2._mm256_and_si256(mask, cast(new));
        let old = wide.avx2._mm256_andnot_si256(mask, cast(old));
        cast(wide.avx2._mm256_or_si256(new, old))
    }

    impl Lanes for V3 {
        type V = f32x8;
        type M = m32x8;

        #[inline(always)]
        fn load(self, values: &[f32; LANES]) -> f32x8 {
            cast(*values)
        }

        #[inline(always)]
        fn store(self, values: f32x8) -> [f32; LANES] {
            cast(values)
        }

        #[inline(always)]
        fn splat(self, value: f32) -> f32x8 {
            self.splat_f32x8(value)
        }

        #[inline(always)]
        fn bytes(self, values: [u8; LANES]) -> f32x8 {
            let values = cast([u64::from_le_bytes(values), 0]);
            cast(
                self.avx
                    ._mm256_cvtepi32_ps(self.avx2._mm256_cvtepu8_epi32(values)),
            )
        }

        #[inline(always)]
        fn add(self, a: f32x8, b: f32x8) -> f32x8 {
            self.add_f32x8(a, b)
        }

        #[inline(always)]
        fn sub(self, a: f32x8, b: f32x8) -> f32x8 {
            self.sub_f32x8(a, b)
        }

        #[inline(always)]
        fn mul(self, a: f32x8, b: f32x8) -> f32x8 {
            self.mul_f32x8(a, b)
        }

        #[inline(always)]
        fn div(self, a: f32x8, b: f32x8) -> f32x8 {
            self.div_f32x8(a, b)
        }

        #[inline(always)]
        fn mul_add(self, a: f32x8, b: f32x8, c: f32x8) -> f32x8 {
            self.mul_add_f32x8(a, b, c)
        }

        #[inline(always)]
        fn min(self, a: f32x8, b: f32x8) -> f32x8 {
            cast(self.avx._mm256_min_ps(cast(a), cast(b)))
        }

        #[inline(always)]
        fn max(self, a: f32x8, b: f32x8) -> f32x8 {
            cast(self.avx._mm256_max_ps(cast(a), cast(b)))
        }

        #[inline(always)]
        fn abs(self, a: f32x8) -> f32x8 {
            self.abs_f32x8(a)
        }

        #[inline(always)]
        fn floor(self, a: f32x8) -> f32x8 {
            cast(self.avx._mm256_floor_ps(cast(a)))
        }

        #[inline(always)]
        fn ceil(self, a: f32x8) -> f32x8 {
            cast(self.avx._mm256_ceil_ps(cast(a)))
        }

        #[inline(always)]
        fn below(self, a: f32x8, b: f32x8) -> m32x8 {
            self.cmp_lt_f32x8(a, b)
        }

        #[inline(always)]
        fn and(self, a: m32x8, b: m32x8) -> m32x8 {
            cast(self.avx._mm256_and_ps(cast(a), cast(b)))
        }

        #[inline(always)]
        fn or(self, a: m32x8, b: m32x8) -> m32x8 {
            cast(self.avx._mm256_or_ps(cast(a), cast(b)))
        }

        #[inline(always)]
        fn bits(self, mask: m32x8) -> u32 {
            self.avx._mm256_movemask_ps(cast(mask)).cast_unsigned()
        }

        #[inline(always)]
        fn choose(self, mask: m32x8, new: f32x8, old: f32x8) -> f32x8 {
            cast(merge(self, mask, cast(new), cast(old)))
        }

        #[inline(always)]
        fn overwrite(self, mask: m32x8, new: u32, old: &[u32; LANES]) -> [u32; LANES] {
            cast(merge(self, mask, self.splat_u32x8(new), cast(*old)))
        }

        #[inline(always)]
        fn differ(self, a: &[u32; LANES], b: &[u32; LANES]) -> u32 {
            let same: m32x8 = self.cmp_eq_u32x8(cast(*a), cast(*b));
            !self.bits(same) & super::ALL
        }

        #[inline(always)]
        fn pick(self, bits: u32, new: f32x8, old: f32x8) -> f32x8 {
            let each = cast(BITS);
            let set = self
                .avx2
                ._mm256_and_si256(cast(self.splat_u32x8(bits)), each);
            let mask = self.avx2._mm256_cmpeq_epi32(set, each);
            cast(self.avx._mm256_blendv_ps(cast(old), cast(new), cast(mask)))
        }
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
        let best = dispatch(Everything(a, b));
        let bits = |values: &[[f32; LANES]]| -> Vec<[u32; LANES]> {
            let canonical = |value: f32| if value.is_nan() { f32::NAN } else { value };
            values
                .iter()
                .map(|v| v.map(|x| canonical(x).to_bits()))
                .collect()
        };
        assert_eq!(bits(&plain.0), bits(&best.0));
        assert_eq!(plain.1, best.1);
        let less = [0b0000_0110, 0b1001_0001, 0];
        assert_eq!(plain.1[..3], less);
        assert_eq!(
            plain.1[3..],
            [0b1111_0111, 0, 0, less[0] | less[1], less[0]]
        );
    }
}
