//! Numbers to colours.

use std::sync::LazyLock;

/// Matplotlib's colour map `hot_r` at `value`, as 8-bit sRGB: white at 0 over yellow and red to near
/// black at 1 and above. The Tanks and Temples toolbox colours its error clouds with it.
///
/// As in Matplotlib: a table of 256 entries, entry ⌊256 · value⌋ (below 0 the first, above 1 the
/// last; NaN, which Matplotlib leaves transparent, is grey), each entry linear between the map's
/// anchors.
pub fn hot_r(value: f64) -> [u8; 3] {
    static TABLE: LazyLock<[[u8; 3]; 256]> = LazyLock::new(|| {
        let entry = |entry: usize| hot_r_entry(entry as f64);
        std::array::from_fn(entry)
    });
    if value.is_nan() {
        return [128; 3];
    }
    // The cast takes what is past the ends to them.
    TABLE[usize::from((256.0 * value) as u8)]
}

/// An entry of [`hot_r`]'s table, from 0 to 255.
fn hot_r_entry(entry: f64) -> [u8; 3] {
    // The table's position; the reversed map counts from the end.
    let x = 1.0 - entry / 255.0;
    let ramp = |anchors: &[(f64, f64)]| byte(interpolated(anchors, x));
    [
        ramp(&[(0.0, 0.0416), (0.365_079, 1.0), (1.0, 1.0)]),
        ramp(&[(0.0, 0.0), (0.365_079, 0.0), (0.746_032, 1.0), (1.0, 1.0)]),
        ramp(&[(0.0, 0.0), (0.746_032, 0.0), (1.0, 1.0)]),
    ]
}

/// The page's colour for an error, 0 (blue, over green and yellow at a third) to 1 and above (red), as
/// 8-bit sRGB. `page.js` and `page.css` have the same anchors.
pub fn error(value: f64) -> [u8; 3] {
    let ramp = |values: [f64; 5]| {
        let places = [0.0, 0.17, 0.33, 0.6, 1.0];
        let anchors: Vec<(f64, f64)> = places.into_iter().zip(values).collect();
        byte(interpolated(&anchors, value.clamp(0.0, 1.0)))
    };
    [
        ramp([0.227, 0.31, 0.949, 0.941, 0.839]),
        ramp([0.561, 0.765, 0.878, 0.533, 0.149]),
        ramp([0.839, 0.631, 0.353, 0.227, 0.235]),
    ]
}

/// A colour of evenly rising lightness for `value` from 0 (dark blue) to 1 (light yellow), clamped,
/// as 8-bit sRGB; black for NaN, which stands for no value.
///
/// Green's cubehelix (2011): a spiral around the grey diagonal, here one that avoids black and
/// white at its ends.
pub fn depth(value: f64) -> [u8; 3] {
    if value.is_nan() {
        return [0; 3];
    }
    let lightness = 0.12 + 0.80 * value.clamp(0.0, 1.0);
    let angle = std::f64::consts::TAU * (0.5 / 3.0 + 1.0 - 0.85 * lightness);
    let strength = 1.35 * lightness * (1.0 - lightness) / 2.0;
    let (sin, cos) = libm::sincos(angle);
    [
        byte(lightness + strength * (-0.14861 * cos + 1.78277 * sin)),
        byte(lightness + strength * (-0.29227 * cos - 0.90649 * sin)),
        byte(lightness + strength * (1.97294 * cos)),
    ]
}

/// Piecewise linear through `anchors`, whose first coordinates ascend.
fn interpolated(anchors: &[(f64, f64)], x: f64) -> f64 {
    let after = anchors.iter().position(|&(at, _)| at >= x).unwrap_or(0);
    let (right, before) = (anchors[after], anchors[after.saturating_sub(1)]);
    if after == 0 {
        return right.1;
    }
    before.1 + (x - before.0) / (right.0 - before.0) * (right.1 - before.1)
}

fn byte(value: f64) -> u8 {
    #[allow(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "clamped to 0 to 255"
    )]
    let byte = (255.0 * value).round().clamp(0.0, 255.0) as u8;
    byte
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Computed with Matplotlib 3: `round(255 * get_cmap("hot_r")(entry))`.
    const GOLDEN: [(u32, [u8; 3]); 15] = [
        (0, [255, 255, 255]),
        (1, [255, 255, 251]),
        (2, [255, 255, 247]),
        (32, [255, 255, 129]),
        (64, [255, 255, 3]),
        (65, [255, 254, 0]),
        (66, [255, 252, 0]),
        (100, [255, 162, 0]),
        (128, [255, 89, 0]),
        (162, [255, 0, 0]),
        (163, [252, 0, 0]),
        (164, [249, 0, 0]),
        (200, [155, 0, 0]),
        (254, [13, 0, 0]),
        (255, [11, 0, 0]),
    ];

    #[test]
    fn hot_r_is_matplotlibs() {
        for (entry, color) in GOLDEN {
            assert_eq!(hot_r(f64::from(entry) / 256.0), color, "entry {entry}");
            assert_eq!(hot_r((f64::from(entry) + 0.999) / 256.0), color);
        }
        assert_eq!((hot_r(-1.0), hot_r(7.0)), ([255; 3], [11, 0, 0]));
    }

    #[test]
    fn all_256_entries_are_matplotlibs() {
        // The same polynomial hash over Matplotlib's table.
        let hash = (0..256u32)
            .flat_map(|entry| hot_r(f64::from(entry) / 256.0))
            .fold(0u32, |hash, byte| {
                hash.wrapping_mul(31).wrapping_add(u32::from(byte))
            });
        assert_eq!(hash, 1_178_861_132);
    }

    #[test]
    fn depth_colors_rise_in_lightness() {
        let luminance = |color: [u8; 3]| {
            let [r, g, b] = color.map(f64::from);
            0.299 * r + 0.587 * g + 0.114 * b
        };
        let values: Vec<f64> = (0..=100)
            .map(|step| luminance(depth(f64::from(step) / 100.0)))
            .collect();
        assert!(values.windows(2).all(|pair| pair[0] < pair[1] + 0.01));
        assert!(values[0] < 40.0 && values[100] > 200.0);
        assert_eq!(depth(f64::NAN), [0; 3]);
    }
}
