//! [`Lanes`] in the registers of x86-64: AVX2, and AVX-512 where whole tables fit into registers.

use super::cluster::Many;
use super::lanes::{ALL, LANES, Lanes, PACKED, TABLE, gathered};
use pulp::x86::{V3, V4};
use pulp::{cast, f32x8, f32x16, m32x8, u16x32, u32x4, u32x8};
use std::arch::x86_64::__m256i;

/// Sets of instructions that have AVX2.
pub(crate) trait Wide: Copy {
    fn v3(self) -> V3;
    /// As [`Lanes::gather`].
    fn gather(self, table: &[f32; TABLE], few: bool, places: &[[u8; LANES]; 3]) -> [f32x8; 3];
    /// As [`Lanes::meet_cells`].
    fn meet_cells(self, cells: [&[u16; TABLE]; 2], corners: [&Many; 3]) -> u32;
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

    /// A table of 64 bytes is four registers, of which a place's lowest four bits choose a byte each, and the
    /// next two bits choose the register.
    #[inline(always)]
    fn meet_cells(self, cells: [&[u16; TABLE]; 2], corners: [&Many; 3]) -> u32 {
        let wide = self.avx2;
        let [a, b, c] = corners;
        let places = [cast(*a), cast(*b), cast(*c)];
        let mut none = cast(self.splat_u8x32(0));
        for cells in cells {
            let tables = byte_tables(self, cells);
            let mut sum = cast(self.splat_u8x32(0));
            for table in tables {
                let least = wide._mm256_min_epu8(
                    chosen(self, table, places[0]),
                    chosen(self, table, places[1]),
                );
                let least = wide._mm256_min_epu8(least, chosen(self, table, places[2]));
                sum = wide._mm256_adds_epu8(sum, least);
            }
            let full = wide._mm256_cmpeq_epi8(sum, cast(self.splat_u8x32(255)));
            none = wide._mm256_or_si256(none, full);
        }
        !wide._mm256_movemask_epi8(none).cast_unsigned()
    }
}

/// Sixteen bytes, twice.
type Quarter = __m256i;

/// The low bytes of 64 shorts and the high ones, sixteen to a register.
#[inline(always)]
fn byte_tables(wide: V3, cells: &[u16; TABLE]) -> [[Quarter; 4]; 2] {
    let avx = wide.avx2;
    let (parts, _) = cells.as_chunks::<16>();
    let low_byte = cast(wide.splat_u16x16(255));
    let mut tables = [[low_byte; 4]; 2];
    for quarter in 0..4 {
        let shorts = cast(parts[quarter]);
        let low = avx._mm256_and_si256(shorts, low_byte);
        let high = avx._mm256_srli_epi16::<8>(shorts);
        // Eight low ones, eight high ones, and the same of the second half.
        let both = avx._mm256_packus_epi16(low, high);
        tables[0][quarter] = avx._mm256_permute4x64_epi64::<0b10_00_10_00>(both);
        tables[1][quarter] = avx._mm256_permute4x64_epi64::<0b11_01_11_01>(both);
    }
    tables
}

#[inline(always)]
fn chosen(wide: V3, [a, b, c, d]: [Quarter; 4], places: __m256i) -> __m256i {
    let avx = wide.avx2;
    let (fifth, sixth) = (
        avx._mm256_slli_epi16::<3>(places),
        avx._mm256_slli_epi16::<2>(places),
    );
    let low = avx._mm256_blendv_epi8(
        avx._mm256_shuffle_epi8(a, places),
        avx._mm256_shuffle_epi8(b, places),
        fifth,
    );
    let high = avx._mm256_blendv_epi8(
        avx._mm256_shuffle_epi8(c, places),
        avx._mm256_shuffle_epi8(d, places),
        fifth,
    );
    avx._mm256_blendv_epi8(low, high, sixth)
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

    /// A table of 64 shorts is two registers, of which a place's lowest six bits choose one.
    #[inline(always)]
    fn meet_cells(self, cells: [&[u16; TABLE]; 2], corners: [&Many; 3]) -> u32 {
        let wide = self.avx512bw;
        let [a, b, c] = corners;
        let [a, b, c] = [
            wide._mm512_cvtepu8_epi16(cast(*a)),
            wide._mm512_cvtepu8_epi16(cast(*b)),
            wide._mm512_cvtepu8_epi16(cast(*c)),
        ];
        let mut met = u32::MAX;
        for cells in cells {
            let (parts, _) = cells.as_chunks::<32>();
            let [low, high]: [u16x32; 2] = [cast(parts[0]), cast(parts[1])];
            let codes = [
                wide._mm512_permutex2var_epi16(cast(low), a, cast(high)),
                wide._mm512_permutex2var_epi16(cast(low), b, cast(high)),
                wide._mm512_permutex2var_epi16(cast(low), c, cast(high)),
            ];
            let least = wide._mm512_min_epu8(wide._mm512_min_epu8(codes[0], codes[1]), codes[2]);
            let sums = wide._mm512_maddubs_epi16(least, cast(self.splat_u8x64(1)));
            met &= wide._mm512_cmplt_epi16_mask(sums, cast(self.splat_u16x32(255)));
        }
        met
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
    const CELLS: bool = true;

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
    fn shorts(self, values: f32x8) -> [u16; LANES] {
        let wide = self.v3();
        let whole = wide.avx._mm256_cvtps_epi32(cast(values));
        let [low, high]: [u32x4; 2] = cast(whole);
        cast(wide.sse4_1._mm_packus_epi32(cast(low), cast(high)))
    }

    #[inline(always)]
    fn meet_cells(self, cells: [&[u16; TABLE]; 2], corners: [&Many; 3]) -> u32 {
        Wide::meet_cells(self, cells, corners)
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
    fn pairs(self, a: f32x8, b: f32x8) -> [[f32; 2]; LANES] {
        let wide = self.v3().avx;
        let low = wide._mm256_unpacklo_ps(cast(a), cast(b));
        let high = wide._mm256_unpackhi_ps(cast(a), cast(b));
        cast([
            wide._mm256_permute2f128_ps::<0x20>(low, high),
            wide._mm256_permute2f128_ps::<0x31>(low, high),
        ])
    }

    /// Three being odd, each of the three has its numbers in other lanes of what comes out: once they are moved
    /// there, lanes are only chosen.
    #[inline(always)]
    fn triples(self, a: f32x8, b: f32x8, c: f32x8) -> [[f32; 3]; LANES] {
        let (avx, avx2) = (self.v3().avx, self.v3().avx2);
        let a = avx2._mm256_permutevar8x32_ps(cast(a), cast(u32x8(0, 3, 6, 1, 4, 7, 2, 5)));
        let b = avx2._mm256_permutevar8x32_ps(cast(b), cast(u32x8(5, 0, 3, 6, 1, 4, 7, 2)));
        let c = avx2._mm256_permutevar8x32_ps(cast(c), cast(u32x8(2, 5, 0, 3, 6, 1, 4, 7)));
        let first = avx._mm256_blend_ps::<0b1001_0010>(a, b);
        let second = avx._mm256_blend_ps::<0b0010_0100>(a, b);
        let third = avx._mm256_blend_ps::<0b0100_1001>(a, b);
        cast([
            avx._mm256_blend_ps::<0b0010_0100>(first, c),
            avx._mm256_blend_ps::<0b0100_1001>(second, c),
            avx._mm256_blend_ps::<0b1001_0010>(third, c),
        ])
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
