//! Values that are blended: 8-bit sRGB as they are, or light proportional to energy.

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
                Self::Linear => 255.0 * linear(encoded / 255.0),
            }
        })
    }

    /// The sRGB value, 0 to 255 and not rounded, of what was blended.
    pub(super) fn encode(self, value: f32) -> f32 {
        match self {
            Self::Encoded => value,
            Self::Linear => 255.0 * encoded(value.clamp(0.0, 255.0) / 255.0),
        }
    }
}

/// Linear light of an sRGB value, both 0 to 1 (IEC 61966-2-1).
fn linear(encoded: f32) -> f32 {
    if encoded <= 0.04045 {
        encoded / 12.92
    } else {
        ((encoded + 0.055) / 1.055).powf(2.4)
    }
}

/// The sRGB value of linear light, both 0 to 1.
fn encoded(linear: f32) -> f32 {
    if linear <= 0.003_130_8 {
        12.92 * linear
    } else {
        1.055 * linear.powf(1.0 / 2.4) - 0.055
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
