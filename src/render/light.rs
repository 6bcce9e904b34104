//! 8-bit sRGB values and linear light, for the places where light is multiplied or mixed.

use glam::Vec3;

/// Linear light in 0…1 of 8-bit sRGB values (IEC 61966-2-1).
pub(crate) fn to_linear(color: Vec3) -> Vec3 {
    let linear = |level: f32| {
        let value = level / 255.0;
        if value <= 0.040_45 {
            value / 12.92
        } else {
            libm::powf((value + 0.055) / 1.055, 2.4)
        }
    };
    Vec3::new(linear(color.x), linear(color.y), linear(color.z))
}

/// The inverse of [`to_linear`].
pub(crate) fn to_srgb(light: Vec3) -> Vec3 {
    let level = |value: f32| {
        255.0
            * if value <= 0.003_130_8 {
                value * 12.92
            } else {
                1.055 * libm::powf(value, 1.0 / 2.4) - 0.055
            }
    };
    Vec3::new(level(light.x), level(light.y), level(light.z)).clamp(Vec3::ZERO, Vec3::splat(255.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn there_and_back_is_the_same_level() {
        for level in 0..=255u8 {
            let back = to_srgb(to_linear(Vec3::splat(f32::from(level))));
            assert!((back.x - f32::from(level)).abs() < 1e-3, "{level}: {back}");
        }
        // sRGB 188 is half the light of white.
        assert!((to_linear(Vec3::splat(188.0)).y - 0.5).abs() < 0.005);
    }
}
