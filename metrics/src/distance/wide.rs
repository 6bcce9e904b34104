//! The same work compiled for processors with AVX2 and AVX-512, chosen while running. Same bits:
//! these widen the operations and change none; fused multiply-add is not asked for.
#![allow(
    unsafe_code,
    reason = "a function for a newer processor may only be called after asking for it"
)]
#![allow(
    clippy::needless_range_loop,
    reason = "one index runs over several columns"
)]

use super::blocks::{Block, LANES};
use super::search::{joined, smaller, squares};
use glam::DVec3;

/// Work whose loops over columns gain from wide registers. What `run` calls must be inlined into it.
pub(crate) trait Task {
    /// What it gives.
    type Output;

    /// Does it.
    fn run(self, width: impl Width) -> Self::Output;
}

/// Registers, and what the compiler does not find the wide instructions for by itself.
pub(crate) trait Width: Copy {
    /// The least squared distance from a query to the points of a block, or `bound` if that is less.
    fn least(self, block: &Block, query: DVec3, bound: f64) -> f64;

    /// The first point of a block whose squared distance from a query is at most `square`, where there is
    /// one.
    #[inline(always)]
    fn first_within(self, block: &Block, query: DVec3, square: f64) -> u32 {
        let (squares, mut bits) = (squares(block, query), [0u64; LANES]);
        for k in 0..LANES {
            bits[k] = if squares[k] <= square { 1 << k } else { 0 };
        }
        joined(&bits).trailing_zeros()
    }

    /// A bit for each lane of `a` that is less than that of `b`.
    #[inline(always)]
    fn below(self, a: &[f32; LANES], b: &[f32; LANES]) -> u32 {
        let mut bits = [0u32; LANES];
        for lane in 0..LANES {
            bits[lane] = if a[lane] < b[lane] { 1 << lane } else { 0 };
        }
        bits.iter().fold(0, |all, bit| all | bit)
    }
}

/// What the compiler takes for granted.
#[derive(Debug, Clone, Copy)]
pub(super) struct Baseline;

impl Width for Baseline {
    #[inline(always)]
    fn least(self, block: &Block, query: DVec3, bound: f64) -> f64 {
        let mut four = [bound; 4];
        for eight in squares(block, query).chunks_exact(8) {
            for k in 0..4 {
                four[k] = smaller(smaller(eight[k], eight[k + 4]), four[k]);
            }
        }
        smaller(smaller(four[0], four[2]), smaller(four[1], four[3]))
    }
}

/// Registers that a test may ask for; [`run`] takes the widest there are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Registers {
    /// [`Baseline`].
    Baseline,
    /// 256 bits.
    Avx2,
    /// 512 bits.
    Avx512,
}

impl Registers {
    /// Whether this processor has them.
    pub(super) fn are_there(self) -> bool {
        match self {
            Self::Baseline => true,
            #[cfg(target_arch = "x86_64")]
            Self::Avx2 => std::arch::is_x86_feature_detected!("avx2"),
            #[cfg(target_arch = "x86_64")]
            Self::Avx512 => {
                std::arch::is_x86_feature_detected!("avx512f")
                    && std::arch::is_x86_feature_detected!("avx512vl")
                    && std::arch::is_x86_feature_detected!("avx512dq")
            }
            #[cfg(not(target_arch = "x86_64"))]
            _ => false,
        }
    }

    /// The widest that this processor has.
    pub(crate) fn widest() -> Self {
        let wide = [Self::Avx512, Self::Avx2];
        let there = wide.into_iter().find(|registers| registers.are_there());
        there.unwrap_or(Self::Baseline)
    }

    /// Does the work with these, or without, where this processor has none such.
    pub(crate) fn run<T: Task>(self, task: T) -> T::Output {
        if !self.are_there() {
            return task.run(Baseline);
        }
        match self {
            Self::Baseline => task.run(Baseline),
            #[cfg(target_arch = "x86_64")]
            // SAFETY: the processor has AVX2, as it just said.
            Self::Avx2 => unsafe { x86::with_avx2(task) },
            #[cfg(target_arch = "x86_64")]
            // SAFETY: the processor has these, as it just said.
            Self::Avx512 => unsafe { x86::with_avx512(task) },
            #[cfg(not(target_arch = "x86_64"))]
            _ => task.run(Baseline),
        }
    }
}

#[cfg(target_arch = "x86_64")]
mod x86 {
    use super::{Task, Width};
    use crate::distance::blocks::{Block, LANES};
    use crate::distance::search::smaller;
    use glam::DVec3;
    use std::arch::x86_64::{
        __m256d, __m512d, _CMP_LE_OQ, _CMP_LT_OQ, _mm_cvtsd_f64, _mm_min_pd, _mm_unpackhi_pd,
        _mm256_add_pd, _mm256_castpd256_pd128, _mm256_extractf128_pd, _mm256_loadu_pd,
        _mm256_min_pd, _mm256_mul_pd, _mm256_set1_pd, _mm256_sub_pd, _mm512_add_pd,
        _mm512_castpd512_pd256, _mm512_cmp_pd_mask, _mm512_cmp_ps_mask, _mm512_extractf64x4_pd,
        _mm512_loadu_pd, _mm512_loadu_ps, _mm512_min_pd, _mm512_mul_pd, _mm512_set1_pd,
        _mm512_sub_pd,
    };

    /// 512 bits. Made by [`with_avx512`] only.
    #[derive(Debug, Clone, Copy)]
    pub(in super::super) struct Avx512(());

    /// 256 bits. Made by [`with_avx2`] only.
    #[derive(Debug, Clone, Copy)]
    pub(in super::super) struct Avx2(());

    #[target_feature(enable = "avx512f,avx512vl,avx512dq")]
    pub(super) fn with_avx512<T: Task>(task: T) -> T::Output {
        task.run(Avx512(()))
    }

    #[target_feature(enable = "avx2")]
    pub(super) fn with_avx2<T: Task>(task: T) -> T::Output {
        task.run(Avx2(()))
    }

    impl Width for Avx512 {
        #[inline(always)]
        fn least(self, block: &Block, query: DVec3, bound: f64) -> f64 {
            // SAFETY: who made this value had asked the processor.
            unsafe { least_avx512(block, query, bound) }
        }

        #[inline(always)]
        fn first_within(self, block: &Block, query: DVec3, square: f64) -> u32 {
            // SAFETY: who made this value had asked the processor.
            unsafe { first_within_avx512(block, query, square) }
        }

        #[inline(always)]
        fn below(self, a: &[f32; LANES], b: &[f32; LANES]) -> u32 {
            // SAFETY: who made this value had asked the processor.
            unsafe { below_avx512(a, b) }
        }
    }

    impl Width for Avx2 {
        #[inline(always)]
        fn least(self, block: &Block, query: DVec3, bound: f64) -> f64 {
            // SAFETY: who made this value had asked the processor.
            unsafe { least_avx2(block, query, bound) }
        }
    }

    #[target_feature(enable = "avx512f,avx512vl,avx512dq")]
    #[inline]
    fn least_avx512(block: &Block, query: DVec3, bound: f64) -> f64 {
        let [low, high] = squares_avx512(block, query);
        let eight = _mm512_min_pd(low, high);
        let four = _mm256_min_pd(
            _mm512_castpd512_pd256(eight),
            _mm512_extractf64x4_pd::<1>(eight),
        );
        smaller(least_of_four(four), bound)
    }

    #[target_feature(enable = "avx512f,avx512vl,avx512dq")]
    #[inline]
    fn first_within_avx512(block: &Block, query: DVec3, square: f64) -> u32 {
        let most = _mm512_set1_pd(square);
        let bits = |eight| u32::from(_mm512_cmp_pd_mask::<_CMP_LE_OQ>(eight, most));
        let [low, high] = squares_avx512(block, query);
        (bits(low) | bits(high) << 8).trailing_zeros()
    }

    #[target_feature(enable = "avx512f,avx512vl,avx512dq")]
    #[inline]
    fn below_avx512(a: &[f32; LANES], b: &[f32; LANES]) -> u32 {
        const { assert!(LANES == 16) };
        // SAFETY: both are sixteen.
        let (a, b) = unsafe { (_mm512_loadu_ps(a.as_ptr()), _mm512_loadu_ps(b.as_ptr())) };
        _mm512_cmp_ps_mask::<_CMP_LT_OQ>(a, b).into()
    }

    /// The squared distances from a query to the points of a block.
    #[target_feature(enable = "avx512f,avx512vl,avx512dq")]
    #[inline]
    fn squares_avx512(block: &Block, query: DVec3) -> [__m512d; 2] {
        const { assert!(LANES == 16) };
        let (x, y, z) = (
            _mm512_set1_pd(query.x),
            _mm512_set1_pd(query.y),
            _mm512_set1_pd(query.z),
        );
        let square = |column: &[f64; LANES], first: usize, along: __m512d| {
            // SAFETY: `first` is 0 or 8 of sixteen.
            let gap = unsafe { _mm512_sub_pd(_mm512_loadu_pd(column.as_ptr().add(first)), along) };
            _mm512_mul_pd(gap, gap)
        };
        let eight = |first: usize| {
            let flat = _mm512_add_pd(square(&block.x, first, x), square(&block.y, first, y));
            _mm512_add_pd(flat, square(&block.z, first, z))
        };
        [eight(0), eight(8)]
    }

    #[target_feature(enable = "avx2")]
    #[inline]
    fn least_avx2(block: &Block, query: DVec3, bound: f64) -> f64 {
        const { assert!(LANES == 16) };
        let (x, y, z) = (
            _mm256_set1_pd(query.x),
            _mm256_set1_pd(query.y),
            _mm256_set1_pd(query.z),
        );
        let square = |column: &[f64; LANES], first: usize, along: __m256d| {
            // SAFETY: `first` is 0, 4, 8 or 12 of sixteen.
            let gap = unsafe { _mm256_sub_pd(_mm256_loadu_pd(column.as_ptr().add(first)), along) };
            _mm256_mul_pd(gap, gap)
        };
        let four = |first: usize| {
            let flat = _mm256_add_pd(square(&block.x, first, x), square(&block.y, first, y));
            _mm256_add_pd(flat, square(&block.z, first, z))
        };
        let low = _mm256_min_pd(four(0), four(4));
        let high = _mm256_min_pd(four(8), four(12));
        smaller(least_of_four(_mm256_min_pd(low, high)), bound)
    }

    #[target_feature(enable = "avx")]
    #[inline]
    fn least_of_four(four: __m256d) -> f64 {
        let two = _mm_min_pd(
            _mm256_castpd256_pd128(four),
            _mm256_extractf128_pd::<1>(four),
        );
        _mm_cvtsd_f64(_mm_min_pd(two, _mm_unpackhi_pd(two, two)))
    }
}
