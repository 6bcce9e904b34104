//! 8-bit sRGB values and linear light, for the places where light is multiplied or mixed.

use glam::Vec3;
use mvs_datasets::scene::srgb::{encoded_f32, linear_f32};

/// Linear light in 0…1 of 8-bit sRGB values.
pub(crate) fn to_linear(color: Vec3) -> Vec3 {
    (color / 255.0).map(linear_f32)
}

/// The inverse of [`to_linear`].
pub(crate) fn to_srgb(light: Vec3) -> Vec3 {
    (255.0 * light.map(encoded_f32)).clamp(Vec3::ZERO, Vec3::splat(255.0))
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
