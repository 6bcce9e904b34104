//! A cloud with errors as a few bytes per point, for a page that opens from disk.

use glam::DVec3;
use mvs_metrics::Usual;

/// Errors are stored up to so many thresholds.
const REACH: f64 = 3.0;

/// A packed cloud.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Payload {
    /// zlib stream of seven planes of one byte per point: low and high bytes of the steps along x,
    /// y and z (16 bits, modulo 2¹⁶, in Morton order), then the error (255 stands for 3 τ).
    pub(super) bytes: Vec<u8>,
    /// Half the cloud's extent in steps, 65535 on its longest axis.
    pub(super) middle: [f64; 3],
    /// Points kept.
    pub(super) count: usize,
    /// Points left out because they lie far from the others, which would be a dot beside them.
    pub(super) far: usize,
}

/// Packs at most `most` points: all of them, or every k-th in Morton order, which keeps the cloud's
/// density where it is. `distances` belong to `positions`; points that are not finite are left out, and those that
/// [`Usual`] does not hold.
pub(super) fn pack(positions: &[DVec3], distances: &[f64], tau: f64, most: usize) -> Payload {
    let finite = |index: &usize| positions[*index].is_finite() && !distances[*index].is_nan();
    let usual = Usual::of(positions.iter().copied());
    let (usable, far): (Vec<usize>, Vec<usize>) = (0..positions.len().min(distances.len()))
        .filter(finite)
        .partition(|&index| usual.holds(positions[index]));
    let points = || usable.iter().map(|&index| positions[index]);
    let low = points().fold(DVec3::INFINITY, DVec3::min);
    let high = points().fold(DVec3::NEG_INFINITY, DVec3::max);
    let extent = (high - low).max_element().max(f64::MIN_POSITIVE);
    let mut packed: Vec<(u64, [u16; 3], u8)> = usable
        .iter()
        .map(|&index| {
            let steps = (positions[index] - low) / extent * 65535.0;
            let steps = steps.to_array().map(|step| rounded(step, 65535.0) as u16);
            let error = rounded(distances[index] / (REACH * tau) * 255.0, 255.0) as u8;
            (morton(steps), steps, error)
        })
        .collect();
    packed.sort_unstable();
    let every = packed.len().div_ceil(most.max(1)).max(1);
    let kept: Vec<_> = packed.into_iter().step_by(every).collect();
    let half = if kept.is_empty() {
        DVec3::ZERO
    } else {
        (high - low) / extent * 32767.5
    };
    Payload {
        bytes: miniz_oxide::deflate::compress_to_vec_zlib(&planes(&kept), 9),
        middle: half.to_array(),
        count: kept.len(),
        far: far.len(),
    }
}

/// Rounded and clamped to 0..=`most`, which fits 16 bits.
fn rounded(value: f64, most: f64) -> u32 {
    #[allow(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "clamped"
    )]
    let whole = value.round().clamp(0.0, most) as u32;
    whole
}

fn planes(points: &[(u64, [u16; 3], u8)]) -> Vec<u8> {
    let mut planes = Vec::with_capacity(7 * points.len());
    for axis in 0..3 {
        let before = std::iter::once(0).chain(points.iter().map(|point| point.1[axis]));
        let steps: Vec<u16> = points
            .iter()
            .zip(before)
            .map(|(point, before)| point.1[axis].wrapping_sub(before))
            .collect();
        planes.extend(steps.iter().map(|step| step.to_le_bytes()[0]));
        planes.extend(steps.iter().map(|step| step.to_le_bytes()[1]));
    }
    planes.extend(points.iter().map(|point| point.2));
    planes
}

/// The bits of the three coordinates interleaved: near in this order is near in space.
fn morton(steps: [u16; 3]) -> u64 {
    let spread = |value: u16| {
        (0..16).fold(0u64, |sum, bit| {
            sum | u64::from(value >> bit & 1) << (3 * bit)
        })
    };
    spread(steps[0]) | spread(steps[1]) << 1 | spread(steps[2]) << 2
}

/// Base64 with padding (RFC 4648).
pub(super) fn base64(bytes: &[u8]) -> String {
    const DIGITS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut text = String::with_capacity(bytes.len().div_ceil(3) * 4);
    for chunk in bytes.chunks(3) {
        let byte = |index: usize| u32::from(chunk.get(index).copied().unwrap_or(0));
        let bits = byte(0) << 16 | byte(1) << 8 | byte(2);
        for digit in 0..4 {
            let value = (bits >> (18 - 6 * digit) & 63) as usize;
            let padding = digit as usize > chunk.len();
            text.push(if padding {
                '='
            } else {
                char::from(DIGITS[value])
            });
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn base64_of_the_standards_examples() {
        let examples = [
            ("", ""),
            ("f", "Zg=="),
            ("fo", "Zm8="),
            ("foo", "Zm9v"),
            ("foobar", "Zm9vYmFy"),
        ];
        for (plain, coded) in examples {
            assert_eq!(base64(plain.as_bytes()), coded);
        }
        assert_eq!(base64(&[251, 255, 191]), "+/+/");
    }

    #[test]
    fn unpacking_returns_every_point_to_half_a_step() {
        let positions: Vec<DVec3> = (0..1000)
            .map(|i| {
                let t = f64::from(i) * 0.1;
                DVec3::new(1e6 + t.sin() * 3.0, t.cos() * 2.0, t * 0.01)
            })
            .collect();
        let distances: Vec<f64> = (0..1000).map(|i| f64::from(i) * 1e-4).collect();
        let payload = pack(&positions, &distances, 0.02, usize::MAX);
        let planes = miniz_oxide::inflate::decompress_to_vec_zlib(&payload.bytes).unwrap();
        assert_eq!((payload.count, planes.len()), (1000, 7000));
        let low = positions.iter().copied().fold(DVec3::INFINITY, DVec3::min);
        let high = positions
            .iter()
            .copied()
            .fold(DVec3::NEG_INFINITY, DVec3::max);
        let step = (high - low).max_element() / 65535.0;
        let mut at = [0u16; 3];
        for index in 0..1000 {
            for (axis, value) in at.iter_mut().enumerate() {
                let plane = |half: usize| planes[(2 * axis + half) * 1000 + index];
                *value = value.wrapping_add(u16::from_le_bytes([plane(0), plane(1)]));
            }
            let point = low + DVec3::from_array(at.map(f64::from)) * step;
            let nearest = (0..1000).min_by(|&a, &b| {
                (positions[a] - point)
                    .length()
                    .total_cmp(&(positions[b] - point).length())
            });
            let nearest = nearest.unwrap();
            assert!((positions[nearest] - point).abs().max_element() <= 0.5001 * step);
            let error = f64::from(planes[6000 + index]) / 255.0 * 0.06;
            assert!((error - distances[nearest].min(0.06)).abs() <= 0.06 / 500.0);
        }
    }

    #[test]
    fn points_far_from_the_others_are_left_out_and_counted() {
        let mut positions: Vec<DVec3> = (0..1000)
            .map(|i| DVec3::new(f64::from(i % 40), f64::from(i / 40), 0.0))
            .collect();
        let near = pack(&positions, &[0.0; 1000], 1.0, 2000);
        positions.extend([DVec3::X * 1e3, DVec3::splat(-4e3)]);
        let all = pack(&positions, &[0.0; 1002], 1.0, 2000);
        assert_eq!((near.far, all.far), (0, 2));
        assert_eq!(all, Payload { far: 2, ..near });
    }

    #[test]
    fn thinning_keeps_every_kth_and_odd_clouds_do_no_harm() {
        let positions: Vec<DVec3> = (0..100).map(|i| DVec3::splat(f64::from(i))).collect();
        assert_eq!(pack(&positions, &[0.0; 100], 1.0, 30).count, 25);
        assert_eq!(pack(&[], &[], 1.0, 30).count, 0);
        let odd = [DVec3::NAN, DVec3::ONE, DVec3::ONE];
        let payload = pack(&odd, &[0.0, f64::INFINITY, 0.0], 1.0, 30);
        assert_eq!((payload.count, payload.middle), (2, [0.0; 3]));
    }
}
