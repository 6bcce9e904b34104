//! Four f64 side by side. Nothing here is fused, so that every set of instructions gives the same bits.

use glam::DVec3;

/// Numbers side by side.
pub(crate) const FOUR: usize = 4;

/// A set of instructions for f64.
pub(crate) trait Doubles: Copy {
    /// Four f64.
    type D: Copy;
    fn load_f64(self, values: &[f64; FOUR]) -> Self::D;
    fn store_f64(self, values: Self::D) -> [f64; FOUR];
    fn splat_f64(self, value: f64) -> Self::D;
    fn add_f64(self, a: Self::D, b: Self::D) -> Self::D;
    fn sub_f64(self, a: Self::D, b: Self::D) -> Self::D;
    fn mul_f64(self, a: Self::D, b: Self::D) -> Self::D;
    fn div_f64(self, a: Self::D, b: Self::D) -> Self::D;
    /// x, y and z of four points.
    fn points(self, points: [&DVec3; FOUR]) -> [Self::D; 3];
    /// Rows become columns.
    fn transpose(self, rows: [Self::D; FOUR]) -> [Self::D; FOUR];
    /// The nearest f32.
    fn round(self, a: Self::D) -> [f32; FOUR];
    /// The nearest f32 of two, pair by pair.
    fn round_pairs(self, a: Self::D, b: Self::D) -> [[f32; 2]; FOUR];
}

impl Doubles for super::lanes::Plain {
    type D = [f64; FOUR];

    #[inline(always)]
    fn load_f64(self, values: &[f64; FOUR]) -> Self::D {
        *values
    }

    #[inline(always)]
    fn store_f64(self, values: Self::D) -> [f64; FOUR] {
        values
    }

    #[inline(always)]
    fn splat_f64(self, value: f64) -> Self::D {
        [value; FOUR]
    }

    #[inline(always)]
    fn add_f64(self, a: Self::D, b: Self::D) -> Self::D {
        std::array::from_fn(|lane| a[lane] + b[lane])
    }

    #[inline(always)]
    fn sub_f64(self, a: Self::D, b: Self::D) -> Self::D {
        std::array::from_fn(|lane| a[lane] - b[lane])
    }

    #[inline(always)]
    fn mul_f64(self, a: Self::D, b: Self::D) -> Self::D {
        std::array::from_fn(|lane| a[lane] * b[lane])
    }

    #[inline(always)]
    fn div_f64(self, a: Self::D, b: Self::D) -> Self::D {
        std::array::from_fn(|lane| a[lane] / b[lane])
    }

    #[inline(always)]
    fn points(self, points: [&DVec3; FOUR]) -> [Self::D; 3] {
        [
            points.map(|p| p.x),
            points.map(|p| p.y),
            points.map(|p| p.z),
        ]
    }

    #[inline(always)]
    fn transpose(self, rows: [Self::D; FOUR]) -> [Self::D; FOUR] {
        std::array::from_fn(|column| rows.map(|row| row[column]))
    }

    #[inline(always)]
    #[allow(clippy::cast_possible_truncation, reason = "what it is for")]
    fn round(self, a: Self::D) -> [f32; FOUR] {
        a.map(|value| value as f32)
    }

    #[inline(always)]
    fn round_pairs(self, a: Self::D, b: Self::D) -> [[f32; 2]; FOUR] {
        let (a, b) = (self.round(a), self.round(b));
        std::array::from_fn(|lane| [a[lane], b[lane]])
    }
}

#[cfg(target_arch = "x86_64")]
mod x86 {
    use super::super::avx::Wide;
    use super::{Doubles, FOUR};
    use glam::DVec3;
    use pulp::{cast, f64x4};

    impl<W: Wide> Doubles for W {
        type D = f64x4;

        #[inline(always)]
        fn load_f64(self, values: &[f64; FOUR]) -> f64x4 {
            cast(*values)
        }

        #[inline(always)]
        fn store_f64(self, values: f64x4) -> [f64; FOUR] {
            cast(values)
        }

        #[inline(always)]
        fn splat_f64(self, value: f64) -> f64x4 {
            self.v3().splat_f64x4(value)
        }

        #[inline(always)]
        fn add_f64(self, a: f64x4, b: f64x4) -> f64x4 {
            self.v3().add_f64x4(a, b)
        }

        #[inline(always)]
        fn sub_f64(self, a: f64x4, b: f64x4) -> f64x4 {
            self.v3().sub_f64x4(a, b)
        }

        #[inline(always)]
        fn mul_f64(self, a: f64x4, b: f64x4) -> f64x4 {
            self.v3().mul_f64x4(a, b)
        }

        #[inline(always)]
        fn div_f64(self, a: f64x4, b: f64x4) -> f64x4 {
            self.v3().div_f64x4(a, b)
        }

        #[inline(always)]
        fn points(self, [a, b, c, d]: [&DVec3; FOUR]) -> [f64x4; 3] {
            let avx = self.v3().avx;
            let even = cast([[a.x, a.y], [c.x, c.y]]);
            let odd = cast([[b.x, b.y], [d.x, d.y]]);
            [
                cast(avx._mm256_unpacklo_pd(even, odd)),
                cast(avx._mm256_unpackhi_pd(even, odd)),
                cast([a.z, b.z, c.z, d.z]),
            ]
        }

        #[inline(always)]
        fn transpose(self, rows: [f64x4; FOUR]) -> [f64x4; FOUR] {
            let [a, b, c, d] = rows.map(cast);
            let avx = self.v3().avx;
            let (even, odd) = (avx._mm256_unpacklo_pd(a, b), avx._mm256_unpackhi_pd(a, b));
            let (even2, odd2) = (avx._mm256_unpacklo_pd(c, d), avx._mm256_unpackhi_pd(c, d));
            [
                cast(avx._mm256_permute2f128_pd::<0x20>(even, even2)),
                cast(avx._mm256_permute2f128_pd::<0x20>(odd, odd2)),
                cast(avx._mm256_permute2f128_pd::<0x31>(even, even2)),
                cast(avx._mm256_permute2f128_pd::<0x31>(odd, odd2)),
            ]
        }

        #[inline(always)]
        fn round(self, a: f64x4) -> [f32; FOUR] {
            cast(self.v3().avx._mm256_cvtpd_ps(cast(a)))
        }

        #[inline(always)]
        fn round_pairs(self, a: f64x4, b: f64x4) -> [[f32; 2]; FOUR] {
            let a = self.v3().avx._mm256_cvtpd_ps(cast(a));
            let b = self.v3().avx._mm256_cvtpd_ps(cast(b));
            let halves = [
                self.v3().sse._mm_unpacklo_ps(a, b),
                self.v3().sse._mm_unpackhi_ps(a, b),
            ];
            cast(halves)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::lanes::{Lanes, Plain, Task, dispatch};
    use super::*;

    struct Everything([[f64; FOUR]; FOUR]);

    impl Task for Everything {
        type Output = Vec<[u32; FOUR]>;

        #[inline(always)]
        fn run<L: Lanes>(self, l: L) -> Self::Output {
            let [a, b, c, d] = self.0.map(|row| l.load_f64(&row));
            let sums = [l.add_f64(a, b), l.sub_f64(a, c), l.mul_f64(b, d)];
            let quotients = [l.div_f64(a, d), l.splat_f64(0.1), l.load_f64(&self.0[3])];
            let all = [sums, quotients].concat();
            let columns = l.transpose([all[0], all[1], all[2], all[3]]);
            let points = self.0.map(|[x, y, z, _]| DVec3::new(x, y, z));
            let axes = l.points(points.each_ref());
            let pairs = l.round_pairs(all[4], all[5]);
            let pairs = [[pairs[0], pairs[1]], [pairs[2], pairs[3]]];
            let mut values: Vec<[f32; FOUR]> = columns.map(|v| l.round(v)).to_vec();
            values.extend(pairs.map(|[[p, q], [r, s]]| [p, q, r, s]));
            values.extend(axes.map(|v| l.round(v)));
            values.iter().map(|v| v.map(f32::to_bits)).collect()
        }
    }

    #[test]
    fn every_set_of_instructions_does_the_same() {
        let rows = std::array::from_fn(|row| {
            std::array::from_fn(|lane| (0.3 + row as f64 * 1.7 - lane as f64 * 0.9) * 1e3)
        });
        let plain = Everything(rows).run(Plain);
        assert_eq!(plain, dispatch(Everything(rows)));
        let sum = (rows[0][2] + rows[1][2]) as f32;
        assert_eq!(plain[2][0], sum.to_bits(), "the third column's first");
        assert_eq!(plain[4][0], 0.1f32.to_bits());
        assert_eq!(plain[4][1], (rows[3][0] as f32).to_bits());
        let y = rows.map(|row| (row[1] as f32).to_bits());
        assert_eq!(plain[7], y, "the second axis of all points");
    }
}
