//! Rows of 8-bit levels and of values, one operation each, by the widest instructions there are: all sets
//! of them give the same.

use pulp::Arch;

/// The values of levels.
pub(super) fn values(levels: &[u8], out: &mut [f32]) {
    Arch::new().dispatch(
        #[inline(always)]
        || {
            for (out, &level) in out.iter_mut().zip(levels) {
                *out = f32::from(level);
            }
        },
    );
}

/// `first` − `second`.
pub(super) fn difference((first, second): (&[u8], &[u8]), out: &mut [f32]) {
    Arch::new().dispatch(
        #[inline(always)]
        || {
            for (out, (&first, &second)) in out.iter_mut().zip(first.iter().zip(second)) {
                *out = f32::from(first) - f32::from(second);
            }
        },
    );
}

/// Adds levels to values.
pub(super) fn add(levels: &[u8], values: &mut [f32]) {
    Arch::new().dispatch(
        #[inline(always)]
        || {
            for (value, &level) in values.iter_mut().zip(levels) {
                *value += f32::from(level);
            }
        },
    );
}

/// Pixels that are divided side by side.
const BLOCK: usize = 8;

/// Divides the three values of each pixel by its weight.
pub(super) fn normalize(values: &mut [f32], weights: &[f32]) {
    Arch::new().dispatch(
        #[inline(always)]
        || {
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
        },
    );
}

/// The nearest levels, halves up.
pub(super) fn round(values: &[f32], out: &mut [u8]) {
    Arch::new().dispatch(
        #[inline(always)]
        || {
            for (out, &value) in out.iter_mut().zip(values) {
                // A whole number below 2^23 stands in the lowest bits of its sum with that.
                let value = (value.clamp(0.0, 255.0) + 0.5).floor() + 8_388_608.0;
                *out = (value.to_bits() & 0xff) as u8;
            }
        },
    );
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
