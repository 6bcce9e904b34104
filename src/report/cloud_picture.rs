//! A cloud coloured by its errors as a still picture: the page's first look at it, for readers
//! without scripts or WebGL.

use super::colormap;
use super::html::ErrorCloud;
use crate::error::Result;
use glam::{DVec3, dvec3};
use mvs_datasets::scene::ColorImage;
use mvs_metrics::Usual;

/// The viewer's first pose: turn and tilt in radians, focal length in half heights, and the part of the
/// picture that the cloud may reach. `page.js` has the same numbers.
const YAW: f64 = 0.7;
const PITCH: f64 = 0.55;
const FOCAL: f64 = 1.9;
const REACHED: f64 = 0.95;
const GROUND: [u8; 3] = [16, 20, 24];
/// Errors get the last colour at so many thresholds, as where the viewer's slider begins.
const REACH: f64 = 1.0;

/// Draws the cloud from the viewer's first pose, `width` × `height` pixels; nearer points hide
/// farther ones. Points that are not finite are left out, and those far from the others, as [`Usual`] has it.
///
/// # Errors
/// A picture without pixels.
pub fn draw(cloud: &ErrorCloud<'_>, width: u32, height: u32) -> Result<ColorImage> {
    let usual = Usual::of(cloud.positions.iter().copied());
    let is_shown = |point: DVec3| point.is_finite() && usual.holds(point);
    let shown = || cloud.positions.iter().filter(|&&point| is_shown(point));
    let low = shown().copied().fold(DVec3::INFINITY, DVec3::min);
    let high = shown().copied().fold(DVec3::NEG_INFINITY, DVec3::max);
    let extent = (high - low).max_element().max(f64::MIN_POSITIVE);
    let middle = (low + high) / 2.0;
    let ((sy, cy), (sp, cp)) = (libm::sincos(YAW), libm::sincos(PITCH));
    let axes = [
        dvec3(-sy, cy, 0.0),
        dvec3(-sp * cy, -sp * sy, cp),
        dvec3(cp * cy, cp * sy, sp),
    ];
    let (w, h) = (f64::from(width), f64::from(height));
    let focal = FOCAL * (w / h).min(1.0) * h / 2.0;
    let places = shown().map(|&position| (position - middle) / extent);
    let (target, away) = fitted(&axes, places, [2.0 * focal / w, 2.0 * focal / h]);
    #[allow(
        clippy::cast_precision_loss,
        reason = "point counts are far below 2^53"
    )]
    let spacing = 2.4 * h / (shown().count().max(1) as f64).sqrt();
    let mut image = ColorImage::filled(width, height, GROUND)?;
    let mut nearest = vec![f64::INFINITY; image.values().len()];
    for (&position, &distance) in cloud.positions.iter().zip(cloud.distances) {
        let place = (position - middle) / extent;
        let depth = away - axes[2].dot(place);
        if !(is_shown(position) && depth > 0.01) {
            continue;
        }
        let x = w / 2.0 + focal * (axes[0].dot(place) - target[0]) / depth;
        let y = h / 2.0 - focal * (axes[1].dot(place) - target[1]) / depth;
        let half = (spacing / depth).clamp(1.0, 8.0) / 2.0;
        let color = colormap::error(distance / (REACH * cloud.tau));
        for row in pixels(y, half, height) {
            for column in pixels(x, half, width) {
                let index = row as usize * width as usize + column as usize;
                if depth < nearest[index] {
                    nearest[index] = depth;
                    image.values_mut()[index] = color;
                }
            }
        }
    }
    Ok(image)
}

/// Where the eye looks, counted along the axes' first two, and how far away it is so that the places fill
/// the picture and all are in it; `focal` in half widths and half heights.
fn fitted(
    axes: &[DVec3; 3],
    places: impl Iterator<Item = DVec3>,
    focal: [f64; 2],
) -> ([f64; 2], f64) {
    // At distance d a place is in the picture if its offset is at most REACHED / focal · (d − back) from
    // where the eye looks.
    let share = focal.map(|focal| REACHED / focal);
    let mut least = [f64::INFINITY; 2];
    let mut most = [f64::NEG_INFINITY; 2];
    for place in places {
        for side in 0..2 {
            let (at, part) = (axes[side].dot(place), share[side] * axes[2].dot(place));
            least[side] = least[side].min(at - part);
            most[side] = most[side].max(at + part);
        }
    }
    let away = |side: usize| (most[side] - least[side]) / (2.0 * share[side]);
    let target = [0, 1].map(|side| 0.5 * (most[side] + least[side]));
    (target, away(0).max(away(1)).max(0.15))
}

/// The pixels whose centres are at most `half` from `at`, at least the one that holds it.
fn pixels(at: f64, half: f64, count: u32) -> std::ops::Range<u32> {
    #[allow(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "clamped to 0 ..= count"
    )]
    let bound = |value: f64| value.clamp(0.0, f64::from(count)) as u32;
    bound((at - half).round())..bound((at + half).round())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn near_points_hide_far_ones_and_errors_have_their_colours() {
        // Two points on the line of sight through the middle, and four around it.
        let (sy, cy, sp, cp) = (YAW.sin(), YAW.cos(), PITCH.sin(), PITCH.cos());
        let toward = dvec3(cp * cy, cp * sy, sp);
        let (right, up) = (dvec3(-sy, cy, 0.0), dvec3(-sp * cy, -sp * sy, cp));
        let positions = [
            toward * 0.4,
            toward * -0.4,
            right,
            -right,
            up,
            -up,
            DVec3::NAN,
        ];
        let cloud = ErrorCloud {
            name: "",
            positions: &positions,
            distances: &[0.0, 9.0, 1.0, 1.0, 1.0, 1.0, 1.0],
            tau: 1.0,
            unit: "",
        };
        let image = draw(&cloud, 200, 100).unwrap();
        assert_eq!(image.get(100, 50), colormap::error(0.0));
        assert_eq!(image.get(0, 0), GROUND);
        let lit = image
            .values()
            .iter()
            .filter(|&&pixel| pixel != GROUND)
            .count();
        assert!(
            (100..400).contains(&lit),
            "five squares of 8 pixels, found {lit}"
        );
    }

    #[test]
    fn points_far_from_the_others_change_no_picture() {
        let mut positions: Vec<DVec3> = (0..1000)
            .map(|i| dvec3(f64::from(i % 40), f64::from(i / 40), 0.0))
            .collect();
        let picture = |positions: &[DVec3]| {
            let cloud = ErrorCloud {
                name: "",
                positions,
                distances: &vec![0.5; positions.len()],
                tau: 1.0,
                unit: "",
            };
            draw(&cloud, 200, 100).unwrap()
        };
        let near = picture(&positions);
        positions.extend([DVec3::X * 1e3, DVec3::splat(-4e3)]);
        assert!(picture(&positions) == near);
    }

    #[test]
    fn every_point_is_in_the_picture() {
        let corners = |half: DVec3| -> Vec<DVec3> {
            let sign = |bit: u32| if bit & 1 == 1 { 1.0 } else { -1.0 };
            let corner = |i: u32| half * dvec3(sign(i), sign(i >> 1), sign(i >> 2));
            (0..8).map(corner).collect()
        };
        for (half, size) in [
            (DVec3::ONE, (300, 200)),
            (dvec3(1.0, 1.0, 0.05), (200, 300)),
            (dvec3(0.1, 0.2, 3.0), (400, 200)),
        ] {
            let positions = corners(half);
            let cloud = ErrorCloud {
                name: "",
                positions: &positions,
                distances: &[0.0; 8],
                tau: 1.0,
                unit: "",
            };
            let image = draw(&cloud, size.0, size.1).unwrap();
            let rows = |row: u32| (0..size.0).map(move |column| (column, row));
            let columns = |column: u32| (0..size.1).map(move |row| (column, row));
            let border = rows(0).chain(rows(size.1 - 1));
            let mut border = border.chain(columns(0)).chain(columns(size.0 - 1));
            assert!(
                border.all(|(column, row)| image.get(column, row) == GROUND),
                "{half}"
            );
            let lit = image
                .values()
                .iter()
                .filter(|&&pixel| pixel != GROUND)
                .count();
            assert!(lit > 4 * 16, "{half}: {lit}");
        }
    }
}
