//! Several confidences of one view.

use mvs_datasets::scene::Raster;

/// The smallest value of all maps at each pixel of a map of this `size`, which one of them at least has.
pub(super) fn smallest(mut maps: Vec<Raster<f32>>, size: (u32, u32)) -> Option<Raster<f32>> {
    maps.sort_by_key(|map| map.size() != size);
    maps.into_iter().reduce(|least, map| smaller(least, &map))
}

/// The smaller value at each pixel; where `other` has fewer pixels, its nearest. NaN and ∞,
/// which are none, stay.
fn smaller(mut least: Raster<f32>, other: &Raster<f32>) -> Raster<f32> {
    let (width, height) = least.size();
    let nearest = |index: u32, length: u32, of: u32| {
        let at = (2 * u64::from(index) + 1) * u64::from(of) / (2 * u64::from(length));
        u32::try_from(at).unwrap_or(u32::MAX).min(of - 1)
    };
    for row in 0..height {
        for column in 0..width {
            let at = (
                nearest(column, width, other.width()),
                nearest(row, height, other.height()),
            );
            let (own, value) = (least.get(column, row), other.get(at.0, at.1));
            let is_none = |value: f32| value.is_nan() || value == f32::INFINITY;
            if !is_none(own) && (value < own || is_none(value)) {
                least.set(column, row, value);
            }
        }
    }
    least
}
