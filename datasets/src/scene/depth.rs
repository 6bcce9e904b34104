use super::raster::{Mask, Raster};
use crate::error::Result;

/// A map of z-depths along the camera's +Z axis, in world units; 0 means none.
///
/// Every value is finite and ≥ 0. Values are sampled at pixel centres.
#[derive(Debug, Clone, PartialEq)]
pub struct DepthMap(Raster<f32>);

/// How many values of a depth map were turned into 0 because they are no depths.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct RejectedDepths {
    /// Values that were NaN.
    pub nan: usize,
    /// Values that were infinite.
    pub infinite: usize,
    /// Values below 0.
    pub negative: usize,
}

impl RejectedDepths {
    /// All of them together.
    pub fn total(&self) -> usize {
        self.nan + self.infinite + self.negative
    }

    /// Counts those of another part of the map, too.
    pub fn add(&mut self, other: Self) {
        self.nan += other.nan;
        self.infinite += other.infinite;
        self.negative += other.negative;
    }
}

impl DepthMap {
    /// A depth map from raw values; NaN, infinities and negatives become 0 and are counted.
    pub fn clean(mut raw: Raster<f32>) -> (Self, RejectedDepths) {
        let rejected = Self::clean_values(raw.values_mut());
        (Self(raw), rejected)
    }

    /// Makes depths of raw values as [`DepthMap::clean`] does.
    pub fn clean_values(values: &mut [f32]) -> RejectedDepths {
        let mut rejected = RejectedDepths::default();
        // The bits of 0 and of all finite values above it are below those of infinity. Nearly all
        // maps have nothing else, and are told so eight values at a time.
        let is_depth = |value: f32| value.to_bits() < f32::INFINITY.to_bits();
        let any = values.iter();
        if !any.fold(false, |odd, &value| odd | !is_depth(value)) {
            return rejected;
        }
        for value in values {
            if is_depth(*value) {
                continue;
            }
            if value.is_nan() {
                rejected.nan += 1;
            } else if value.is_infinite() {
                rejected.infinite += 1;
            } else if *value < 0.0 {
                rejected.negative += 1;
            }
            *value = 0.0;
        }
        rejected
    }

    /// A depth map from `width * height` values, row-major from the top-left pixel.
    ///
    /// # Errors
    /// As [`Raster::from_values`].
    pub fn from_values(
        width: u32,
        height: u32,
        values: Vec<f32>,
    ) -> Result<(Self, RejectedDepths)> {
        Ok(Self::clean(Raster::from_values(width, height, values)?))
    }

    /// Width in pixels.
    pub fn width(&self) -> u32 {
        self.0.width()
    }

    /// Height in pixels.
    pub fn height(&self) -> u32 {
        self.0.height()
    }

    /// (width, height) in pixels.
    pub fn size(&self) -> (u32, u32) {
        self.0.size()
    }

    /// The depth at pixel (`column`, `row`), 0 for none.
    pub fn get(&self, column: u32, row: u32) -> f32 {
        self.0.get(column, row)
    }

    /// All depths, row-major from the top-left pixel.
    pub fn values(&self) -> &[f32] {
        self.0.values()
    }

    /// The raster of depths.
    pub fn raster(&self) -> &Raster<f32> {
        &self.0
    }

    /// How many pixels have a depth.
    pub fn valid_count(&self) -> usize {
        self.values().iter().filter(|&&depth| depth > 0.0).count()
    }

    /// Which pixels have a depth.
    pub fn valid_mask(&self) -> Mask {
        self.0.map(|&depth| depth > 0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_no_depth_becomes_none_and_is_counted() {
        let raw = vec![
            1.5,
            f32::NAN,
            f32::INFINITY,
            -2.0,
            0.0,
            -0.0,
            f32::NEG_INFINITY,
            3.0,
        ];
        let (map, rejected) = DepthMap::from_values(4, 2, raw).unwrap();
        assert_eq!(map.values(), [1.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 3.0]);
        assert!(map.values().iter().all(|value| value.is_sign_positive()));
        assert_eq!(
            rejected,
            RejectedDepths {
                nan: 1,
                infinite: 2,
                negative: 1
            }
        );
        assert_eq!((map.valid_count(), rejected.total()), (2, 4));
    }
}
