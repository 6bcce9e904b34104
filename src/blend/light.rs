//! Values that are blended: 8-bit sRGB as they are, or light proportional to energy.

use mvs_datasets::scene::srgb::{encoded_f32, linear_f32};

/// What is added and filtered.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Light {
    /// sRGB values 0 to 255, as the paper does.
    Encoded,
    /// Linear light, scaled to 0 to 255.
    Linear,
}

impl Light {
    /// The value of each of the 256 sRGB levels.
    pub(super) fn table(self) -> [f32; 256] {
        std::array::from_fn(|level| {
            #[allow(clippy::cast_precision_loss, reason = "at most 255")]
            let encoded = level as f32;
            match self {
                Self::Encoded => encoded,
                Self::Linear => 255.0 * linear_f32(encoded / 255.0),
            }
        })
    }

    /// The sRGB value, 0 to 255 and not rounded, of what was blended.
    pub(super) fn encode(self, value: f32) -> f32 {
        match self {
            Self::Encoded => value,
            Self::Linear => 255.0 * encoded_f32(value.clamp(0.0, 255.0) / 255.0),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn linear_light_there_and_back() {
        let table = Light::Linear.table();
        for (level, &value) in table.iter().enumerate() {
            assert!(
                (Light::Linear.encode(value) - level as f32).abs() < 1e-2,
                "{level}"
            );
        }
        assert!((table[188] / 255.0 - 0.5029).abs() < 1e-3);
        assert_eq!(Light::Encoded.encode(Light::Encoded.table()[77]), 77.0);
    }
}
