//! Bringing a reconstruction into the frame of the truth: the crate's only user of nalgebra.

pub mod icp;
mod own;
mod quick;
mod reach;
pub mod trajectory;
pub mod umeyama;

pub use icp::{Icp, IcpOptions, icp, icp_onto, icp_plain};
pub use umeyama::{Scale, umeyama};

use glam::{DMat4, DVec3};
use rayon::prelude::*;

/// The points moved by a 4×4 affine matrix, in Open3D's order of operations: columns are scaled and
/// added from the first to the last, with no fused rounding.
pub fn transformed(points: &[DVec3], target_from_source: DMat4) -> Vec<DVec3> {
    points
        .par_iter()
        .map(|&point| transform(target_from_source, point))
        .collect()
}

/// One point, as [`transformed`] moves it.
#[inline]
pub fn transform(target_from_source: DMat4, point: DVec3) -> DVec3 {
    target_from_source.transform_point3(point)
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// Points in the cube [−1, 1)³ from an integer hash: the same on every machine.
    pub(crate) fn scattered(seed: u64, count: u64) -> Vec<DVec3> {
        let unit = |key: u64| {
            let mut bits =
                key.wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ seed.wrapping_mul(0xd1b5_4a32_d192_ed03);
            bits = (bits ^ (bits >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
            bits = (bits ^ (bits >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
            bits ^= bits >> 31;
            (bits >> 11) as f64 / (1u64 << 52) as f64 - 1.0
        };
        (0..count)
            .map(|i| DVec3::new(unit(3 * i), unit(3 * i + 1), unit(3 * i + 2)))
            .collect()
    }

    #[test]
    fn columns_are_added_from_first_to_last() {
        let m = DMat4::from_cols_array(&[
            0.1, 0.2, 0.3, 0.0, 1e8, 0.7, 1e-9, 0.0, 0.3, 1e5, 0.9, 0.0, 1e6, -1e-3, 7.0, 1.0,
        ]);
        for point in scattered(1, 100) {
            let by_hand: [f64; 3] = std::array::from_fn(|row| {
                let mut sum = m.x_axis[row] * point.x;
                sum += m.y_axis[row] * point.y;
                sum += m.z_axis[row] * point.z;
                sum + m.w_axis[row]
            });
            assert_eq!(transform(m, point).to_array(), by_hand);
        }
    }
}
