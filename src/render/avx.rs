//! [`Lanes`] in the registers of x86-64: AVX2, and AVX-512 where whole tables fit into registers.

use super::lanes::{ALL, LANES, Lanes, PACKED, TABLE, gathered};
use pulp::x86::{V3, V4};
use pulp::{cast, f32x8, f32x16, m32x8, u32x8};

/// Sets of instructions that have AVX2.
pub(crate) trait Wide: Copy {
    fn v3(self) -> V3;
    /// As [`Lanes::gather`].
    fn gather(self, table: &[f32; TABLE], few: bool, places: &[[u8; LANES]; 3]) -> [f32x8; 3];
}

impl Wide for V3 {
    #[inline(always)]
    fn v3(self) -> V3 {
        self
    }

    #[inline(always)]
    fn gather(self, table: &[f32; TABLE], _: bool, places: &[[u8; LANES]; 3]) -> [f32x8; 3] {
        cast(gathered(table, places))
    }
}

impl Wide for V4 {
    #[inline(always)]
    fn v3(self) -> V3 {
        *self
    }

    /// Of a table of 64, its place's lowest five bits choose a value in either half, and the next bit
    /// chooses the half.
    #[inline(always)]
    fn gather(self, table: &[f32; TABLE], few: bool, places: &[[u8; LANES]; 3]) -> [f32x8; 3] {
        if !few {
            return cast(gathered(table, places));
        }
        let (parts, _) = table.as_chunks::<16>();
        let [a, b]: [f32x16; 2] = [cast(parts[0]), cast(parts[1])];
        let [c, d]: [f32x16; 2] = [cast(parts[2]), cast(parts[3])];
        let wide = self.avx512f;
        let half = cast(self.splat_u32x16(32));
        let [first, second, third] = *places;
        let mut both = [[self.splat_f32x8(0.0); 2]; 2];
        for (to, places) in [[first, second], [third, third]].into_iter().enumerate() {
            let at = wide._mm512_cvtepu8_epi32(cast(places));
            let low = wide._mm512_permutex2var_ps(cast(a), at, cast(b));
            let high = wide._mm512_permutex2var_ps(cast(c), at, cast(d));
            let upper = wide._mm512_test_epi32_mask(at, half);
            both[to] = cast(wide._mm512_mask_blend_ps(upper, low, high));
        }
        [both[0][0], both[0][1], both[1][0]]
    }
}

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

impl<W: Wide> Lanes for W {
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
        self.v3().splat_f32x8(value)
    }

    #[inline(always)]
    fn bytes(self, values: [u8; LANES]) -> f32x8 {
        let values = cast([u64::from_le_bytes(values), 0]);
        cast(
            self.v3()
                .avx
                ._mm256_cvtepi32_ps(self.v3().avx2._mm256_cvtepu8_epi32(values)),
        )
    }

    #[inline(always)]
    fn add(self, a: f32x8, b: f32x8) -> f32x8 {
        self.v3().add_f32x8(a, b)
    }

    #[inline(always)]
    fn sub(self, a: f32x8, b: f32x8) -> f32x8 {
        self.v3().sub_f32x8(a, b)
    }

    #[inline(always)]
    fn mul(self, a: f32x8, b: f32x8) -> f32x8 {
        self.v3().mul_f32x8(a, b)
    }

    #[inline(always)]
    fn div(self, a: f32x8, b: f32x8) -> f32x8 {
        self.v3().div_f32x8(a, b)
    }

    #[inline(always)]
    fn mul_add(self, a: f32x8, b: f32x8, c: f32x8) -> f32x8 {
        self.v3().mul_add_f32x8(a, b, c)
    }

    #[inline(always)]
    fn min(self, a: f32x8, b: f32x8) -> f32x8 {
        cast(self.v3().avx._mm256_min_ps(cast(a), cast(b)))
    }

    #[inline(always)]
    fn max(self, a: f32x8, b: f32x8) -> f32x8 {
        cast(self.v3().avx._mm256_max_ps(cast(a), cast(b)))
    }

    #[inline(always)]
    fn abs(self, a: f32x8) -> f32x8 {
        self.v3().abs_f32x8(a)
    }

    #[inline(always)]
    fn floor(self, a: f32x8) -> f32x8 {
        cast(self.v3().avx._mm256_floor_ps(cast(a)))
    }

    #[inline(always)]
    fn ceil(self, a: f32x8) -> f32x8 {
        cast(self.v3().avx._mm256_ceil_ps(cast(a)))
    }

    #[inline(always)]
    fn below(self, a: f32x8, b: f32x8) -> m32x8 {
        self.v3().cmp_lt_f32x8(a, b)
    }

    #[inline(always)]
    fn and(self, a: m32x8, b: m32x8) -> m32x8 {
        cast(self.v3().avx._mm256_and_ps(cast(a), cast(b)))
    }

    #[inline(always)]
    fn or(self, a: m32x8, b: m32x8) -> m32x8 {
        cast(self.v3().avx._mm256_or_ps(cast(a), cast(b)))
    }

    #[inline(always)]
    fn bits(self, mask: m32x8) -> u32 {
        self.v3().avx._mm256_movemask_ps(cast(mask)).cast_unsigned()
    }

    #[inline(always)]
    fn choose(self, mask: m32x8, new: f32x8, old: f32x8) -> f32x8 {
        cast(merge(self.v3(), mask, cast(new), cast(old)))
    }

    #[inline(always)]
    fn overwrite(self, mask: m32x8, new: u32, old: &[u32; LANES]) -> [u32; LANES] {
        cast(merge(
            self.v3(),
            mask,
            self.v3().splat_u32x8(new),
            cast(*old),
        ))
    }

    #[inline(always)]
    fn differ(self, a: &[u32; LANES], b: &[u32; LANES]) -> u32 {
        let same: m32x8 = self.v3().cmp_eq_u32x8(cast(*a), cast(*b));
        !self.bits(same) & ALL
    }

    #[inline(always)]
    fn pick(self, bits: u32, new: f32x8, old: f32x8) -> f32x8 {
        let each = cast(BITS);
        let set = self
            .v3()
            .avx2
            ._mm256_and_si256(cast(self.v3().splat_u32x8(bits)), each);
        let mask = self.v3().avx2._mm256_cmpeq_epi32(set, each);
        cast(
            self.v3()
                .avx
                ._mm256_blendv_ps(cast(old), cast(new), cast(mask)),
        )
    }

    #[inline(always)]
    fn gather(self, table: &[f32; TABLE], few: bool, places: &[[u8; LANES]; 3]) -> [f32x8; 3] {
        Wide::gather(self, table, few, places)
    }

    #[inline(always)]
    fn pack(self, bits: u32, values: f32x8) -> f32x8 {
        let wide = self.v3();
        let order = cast([PACKED[bits as usize % PACKED.len()], 0]);
        let order = wide.avx2._mm256_cvtepu8_epi32(order);
        cast(wide.avx2._mm256_permutevar8x32_ps(cast(values), order))
    }

    #[inline(always)]
    fn pack_bytes(self, bits: u32, bytes: [u8; LANES]) -> [u8; LANES] {
        let order = cast([PACKED[bits as usize % PACKED.len()], 0]);
        let bytes = cast([u64::from_le_bytes(bytes), 0]);
        let packed: [u64; 2] = cast(self.v3().ssse3._mm_shuffle_epi8(bytes, order));
        packed[0].to_le_bytes()
    }

    #[inline(always)]
    fn least(self, values: f32x8) -> f32 {
        let wide = self.v3();
        let turned = wide
            .avx
            ._mm256_permute2f128_ps::<1>(cast(values), cast(values));
        let four = wide.avx._mm256_min_ps(cast(values), turned);
        let two = wide
            .avx
            ._mm256_min_ps(four, wide.avx._mm256_permute_ps::<0b01_00_11_10>(four));
        let one = wide
            .avx
            ._mm256_min_ps(two, wide.avx._mm256_permute_ps::<0b10_11_00_01>(two));
        cast::<_, f32x8>(one).0
    }
}
