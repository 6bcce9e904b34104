//! Rows of 8-bit levels and of values, one operation each, by the widest instructions there are: all sets
//! of them give the same.

use pulp::{Arch, Simd, WithSimd};

/// The values of levels.
pub(super) fn values(levels: &[u8], out: &mut [f32]) {
    Arch::new().dispatch(Values(levels, out));
}

/// `first` − `second`.
pub(super) fn difference((first, second): (&[u8], &[u8]), out: &mut [f32]) {
    Arch::new().dispatch(Difference((first, second), out));
}

/// Adds levels to values.
pub(super) fn add(levels: &[u8], values: &mut [f32]) {
    Arch::new().dispatch(Add(levels, values));
}

/// Divides the three values of each pixel by its weight.
pub(super) fn normalize(values: &mut [f32], weights: &[f32]) {
    Arch::new().dispatch(Normalize(values, weights));
}

/// [`normalize`] where all weights are the same, then [`add`].
pub(super) fn scale_and_add((values, weight): (&mut [f32], f32), levels: &[u8]) {
    Arch::new().dispatch(ScaleAndAdd((values, weight), levels));
}

/// The nearest levels, halves up.
pub(super) fn round(values: &[f32], out: &mut [u8]) {
    Arch::new().dispatch(Round(values, out));
}

/// Whether all values are this one.
pub(super) fn all_are(values: &[f32], value: f32) -> bool {
    Arch::new().dispatch(AllAre(values, value))
}

/// Whether any value is smaller.
pub(super) fn any_below(values: &[f32], limit: f32) -> bool {
    Arch::new().dispatch(AnyBelow(values, limit))
}

// Structs, because what a closure holds inside is not compiled for each set.

struct Values<'a>(&'a [u8], &'a mut [f32]);

impl WithSimd for Values<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        for (out, &level) in self.1.iter_mut().zip(self.0) {
            *out = f32::from(level);
        }
    }
}

struct Difference<'a>((&'a [u8], &'a [u8]), &'a mut [f32]);

impl WithSimd for Difference<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self((first, second), out) = self;
        for (out, (&first, &second)) in out.iter_mut().zip(first.iter().zip(second)) {
            *out = f32::from(first) - f32::from(second);
        }
    }
}

struct Add<'a>(&'a [u8], &'a mut [f32]);

impl WithSimd for Add<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        for (value, &level) in self.1.iter_mut().zip(self.0) {
            *value += f32::from(level);
        }
    }
}

/// Pixels that are divided side by side.
const BLOCK: usize = 8;

struct Normalize<'a>(&'a mut [f32], &'a [f32]);

impl WithSimd for Normalize<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self(values, weights) = self;
        let (blocks, rest) = values.as_chunks_mut::<{ 3 * BLOCK }>();
        let (weights, last) = weights.as_chunks::<BLOCK>();
        for (values, weights) in blocks.iter_mut().zip(weights) {
            let gains = weights.map(|weight| 1.0 / weight);
            for (i, value) in values.iter_mut().enumerate() {
                *value *= gains[i / 3];
            }
        }
        for (values, weight) in rest.as_chunks_mut::<3>().0.iter_mut().zip(last) {
            let gain = 1.0 / weight;
            for value in values {
                *value *= gain;
            }
        }
    }
}

struct ScaleAndAdd<'a>((&'a mut [f32], f32), &'a [u8]);

impl WithSimd for ScaleAndAdd<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self((values, weight), levels) = self;
        let gain = 1.0 / weight;
        for (value, &level) in values.iter_mut().zip(levels) {
            *value = *value * gain + f32::from(level);
        }
    }
}

struct Round<'a>(&'a [f32], &'a mut [u8]);

impl WithSimd for Round<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        for (out, &value) in self.1.iter_mut().zip(self.0) {
            // A whole number below 2^23 stands in the lowest bits of its sum with that.
            let value = (value.clamp(0.0, 255.0) + 0.5).floor() + 8_388_608.0;
            *out = (value.to_bits() & 0xff) as u8;
        }
    }
}

struct AllAre<'a>(&'a [f32], f32);

impl WithSimd for AllAre<'_> {
    type Output = bool;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> bool {
        let Self(values, value) = self;
        let mut all = true;
        for other in values {
            all &= *other == value;
        }
        all
    }
}

struct AnyBelow<'a>(&'a [f32], f32);

impl WithSimd for AnyBelow<'_> {
    type Output = bool;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> bool {
        let Self(values, limit) = self;
        let mut any = false;
        for &value in values {
            any |= value < limit;
        }
        any
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn levels_are_rounded_and_clipped_as_numbers_are() {
        let values: Vec<f32> = (-900..3600)
            .map(|i| i as f32 * 0.0837)
            .chain([0.5, 254.5])
            .collect();
        let mut levels = vec![0; values.len()];
        round(&values, &mut levels);
        for (value, level) in values.iter().zip(levels) {
            assert_eq!(level, (value.clamp(0.0, 255.0) + 0.5) as u8, "{value}");
        }
        assert_eq!(round_one(-3.0), 0);
        assert_eq!(round_one(255.5), 255);
        assert_eq!(round_one(0.5), 1);
    }

    fn round_one(value: f32) -> u8 {
        let mut level = [0];
        round(&[value], &mut level);
        level[0]
    }

    #[test]
    fn every_pixel_is_divided_by_its_own_weight() {
        for count in 1..40 {
            let mut values: Vec<f32> = (0..3 * count).map(|i| i as f32).collect();
            let weights: Vec<f32> = (0..count).map(|i| 0.25 + i as f32).collect();
            normalize(&mut values, &weights);
            for (i, value) in values.iter().enumerate() {
                assert_eq!(*value, i as f32 * (1.0 / weights[i / 3]));
            }
        }
    }

    #[test]
    fn one_weight_for_all_is_each_its_own() {
        for count in [1, 7, 50] {
            let levels: Vec<u8> = (0..3 * count).map(|i| (i * 37 % 256) as u8).collect();
            let values: Vec<f32> = (0..3 * count).map(|i| i as f32 * 0.7 - 9.0).collect();
            let mut weights = vec![0.999_99; count];
            let (mut apart, mut together) = (values.clone(), values);
            assert!(all_are(&weights, weights[0]));
            normalize(&mut apart, &weights);
            add(&levels, &mut apart);
            scale_and_add((&mut together, weights[0]), &levels);
            assert_eq!(apart, together);
            weights.push(1.0);
            assert!(!all_are(&weights, weights[0]));
        }
    }

    #[test]
    fn one_value_below_is_found_wherever_it_is() {
        for count in [0, 1, 7, 16, 100] {
            let mut values = vec![0.5; count];
            values.push(f32::NAN);
            assert!(!any_below(&values, 0.5));
            for at in 0..count {
                values[at] = 0.49;
                assert!(any_below(&values, 0.5), "{at} of {count}");
                values[at] = 0.5;
            }
        }
    }

    #[test]
    fn levels_become_values() {
        let (a, b): (Vec<u8>, Vec<u8>) = ((0..=255).collect(), (0..=255).rev().collect());
        let mut out = vec![0.0; 256];
        values(&a, &mut out);
        assert!(out.iter().enumerate().all(|(i, &v)| v == i as f32));
        difference((&a, &b), &mut out);
        assert!(
            out.iter()
                .enumerate()
                .all(|(i, &v)| v == 2.0 * i as f32 - 255.0)
        );
        add(&b, &mut out);
        assert!(out.iter().enumerate().all(|(i, &v)| v == i as f32));
    }
}
