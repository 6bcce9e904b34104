//! Bilinear texture lookup.

use glam::{Vec2, Vec3};
use mvs_datasets::scene::{ColorImage, Corner, Raster};

/// What lies beyond the border of a texture.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Border {
    /// The outermost texels go on.
    Clamp,
    /// The texture starts again.
    Repeat,
}

impl Border {
    /// A triangle whose corners all lie on the texture never reads across its border, as an atlas
    /// needs; any other triangle sees the texture repeated, as OBJ viewers show it.
    pub(crate) fn of(corners: &Corner) -> Self {
        let unit = |coord: &Vec2| coord.cmpge(Vec2::ZERO).all() && coord.cmple(Vec2::ONE).all();
        if corners.iter().all(unit) {
            Self::Clamp
        } else {
            Self::Repeat
        }
    }

    /// The texel that stands for one at most `size` beyond the border.
    fn texel(self, index: i64, size: u32) -> u32 {
        let size = i64::from(size);
        let inside = match self {
            Self::Clamp => index.clamp(0, size - 1),
            Self::Repeat if index < 0 => index + size,
            Self::Repeat if index >= size => index - size,
            Self::Repeat => index,
        };
        u32::try_from(inside).unwrap_or_default()
    }
}

/// The colour at texture coordinates with (0, 0) at the bottom-left outer corner, as 8-bit sRGB
/// values that are interpolated as they are.
#[inline]
pub(crate) fn bilinear(texture: &ColorImage, coord: Vec2, border: Border) -> Vec3 {
    let around = Around::new(texture.size(), coord, border);
    // One by one: an array of three that is mapped passes through memory.
    let texel = |column, row| {
        let [r, g, b] = texture.get(column, row);
        Vec3::new(f32::from(r), f32::from(g), f32::from(b))
    };
    around.mix(texel, Vec3::lerp)
}

/// The value of a one-channel texture, as [`bilinear`].
pub(crate) fn bilinear_gray(texture: &Raster<u8>, coord: Vec2, border: Border) -> f32 {
    let around = Around::new(texture.size(), coord, border);
    let texel = |column, row| f32::from(texture.get(column, row));
    around.mix(texel, |a, b, part| a + (b - a) * part)
}

/// The four texels around a point and how much of each counts.
struct Around {
    columns: (u32, u32, f32),
    rows: (u32, u32, f32),
}

impl Around {
    #[inline]
    fn new((width, height): (u32, u32), coord: Vec2, border: Border) -> Self {
        Self {
            columns: neighbours(coord.x, width, border),
            rows: neighbours(1.0 - coord.y, height, border),
        }
    }

    #[inline]
    fn mix<T>(&self, texel: impl Fn(u32, u32) -> T, lerp: impl Fn(T, T, f32) -> T) -> T {
        let (left, right, across) = self.columns;
        let (top, bottom, down) = self.rows;
        let upper = lerp(texel(left, top), texel(right, top), across);
        let lower = lerp(texel(left, bottom), texel(right, bottom), across);
        lerp(upper, lower, down)
    }
}

/// The two texels beside a coordinate in 0…1 along one axis, and the weight of the second.
#[inline]
fn neighbours(coord: f32, size: u32, border: Border) -> (u32, u32, f32) {
    let coord = match border {
        Border::Clamp => coord.clamp(0.0, 1.0),
        Border::Repeat => coord - coord.floor(),
    };
    // NaN and infinity end at 0. f64: a coordinate of an 16k texture has its fraction left.
    let position = if coord.is_finite() {
        f64::from(coord) * f64::from(size) - 0.5
    } else {
        0.0
    };
    #[allow(
        clippy::cast_possible_truncation,
        reason = "between -1 and the texture's size"
    )]
    let first = (position + 1.0) as i64 - 1; // Rounds down, as the sum is not below 0.
    #[allow(
        clippy::cast_possible_truncation,
        clippy::cast_precision_loss,
        reason = "a fraction"
    )]
    let weight = (position - first as f64) as f32;
    (
        border.texel(first, size),
        border.texel(first + 1, size),
        weight,
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    fn gradient() -> ColorImage {
        let values =
            (0..4u8).flat_map(|row| (0..4u8).map(move |column| [column * 40, row * 40, 7]));
        ColorImage::from_values(4, 4, values.collect()).unwrap()
    }

    fn at(x: f32, y: f32, border: Border) -> [f32; 3] {
        bilinear(&gradient(), Vec2::new(x, y), border).into()
    }

    #[test]
    fn texel_centres_return_texels_and_v_points_up() {
        assert_eq!(at(0.125, 0.875, Border::Clamp), [0.0, 0.0, 7.0]);
        assert_eq!(at(0.875, 0.875, Border::Clamp), [120.0, 0.0, 7.0]);
        assert_eq!(at(0.125, 0.125, Border::Repeat), [0.0, 120.0, 7.0]);
    }

    #[test]
    fn between_centres_the_value_is_linear() {
        let [r, g, _] = at(0.5, 0.3, Border::Clamp);
        assert!((r - 60.0).abs() < 1e-4, "{r}");
        assert!((g - 40.0 * (0.7 * 4.0 - 0.5)).abs() < 1e-4, "{g}");
    }

    #[test]
    fn an_atlas_clamps_and_a_tiling_repeats() {
        assert_eq!(at(0.0, 0.875, Border::Clamp)[0], 0.0);
        assert_eq!(at(0.0, 0.875, Border::Repeat)[0], 60.0);
        assert_eq!(
            at(1.375, -0.625, Border::Repeat),
            at(0.375, 0.375, Border::Repeat)
        );
        let inside = [Vec2::ZERO, Vec2::ONE, Vec2::X];
        assert_eq!(Border::of(&inside), Border::Clamp);
        assert_eq!(
            Border::of(&[Vec2::ZERO, Vec2::new(1.5, 0.0), Vec2::X]),
            Border::Repeat
        );
    }

    #[test]
    fn what_is_no_number_reads_some_texel() {
        for wrong in [f32::NAN, f32::INFINITY, -1e30] {
            assert!(at(wrong, wrong, Border::Repeat)[0].is_finite());
        }
    }
}
