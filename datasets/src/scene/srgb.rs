//! sRGB values and linear light, both in 0…1 (IEC 61966-2-1), to the same bits on every system.

/// Linear light of an sRGB value.
pub fn linear(encoded: f64) -> f64 {
    match encoded <= 0.040_45 {
        true => encoded / 12.92,
        false => libm::pow((encoded + 0.055) / 1.055, 2.4),
    }
}

/// The sRGB value of linear light.
pub fn encoded(linear: f64) -> f64 {
    match linear <= 0.003_130_8 {
        true => linear * 12.92,
        false => 1.055 * libm::pow(linear, 1.0 / 2.4) - 0.055,
    }
}

/// As [`linear`], in f32 for whole images.
pub fn linear_f32(encoded: f32) -> f32 {
    match encoded <= 0.040_45 {
        true => encoded / 12.92,
        false => libm::powf((encoded + 0.055) / 1.055, 2.4),
    }
}

/// As [`encoded`], in f32 for whole images.
pub fn encoded_f32(linear: f32) -> f32 {
    if linear <= 0.003_130_8 {
        return linear * 12.92;
    }
    // The power of 5 / 12 is that of 1 / 3 times that of 1 / 12: a third of a power's time.
    let root = libm::cbrtf(linear);
    1.055 * (root * root.sqrt().sqrt()) - 0.055
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Levels 10 and 11 lie on either side of the bend; 0.21404 is the standard's light of half.
    #[test]
    fn levels_have_the_light_of_the_standard() {
        assert!((linear(0.5) - 0.214_041_14).abs() < 1e-8);
        for (level, light) in [(0, 0.0), (10, 0.003_035_27), (11, 0.003_346_54), (255, 1.0)] {
            assert!((linear(f64::from(level) / 255.0) - light).abs() < 1e-8);
        }
    }

    #[test]
    fn there_and_back_is_the_same_value_in_either_precision() {
        for level in 0..=1020u16 {
            let value = f64::from(level) / 1020.0;
            let light = linear(value);
            assert!((encoded(light) - value).abs() < 1e-7, "{value}"); // the standard's bends differ a little
            let (narrow, narrow_light) = (value as f32, linear_f32(value as f32));
            assert!((f64::from(narrow_light) - light).abs() < 1e-6, "{value}");
            assert!((encoded_f32(narrow_light) - narrow).abs() < 1e-6, "{value}");
        }
    }
}
