//! Smooth lines and discs on a picture, the same bytes everywhere: only +, −, ×, ÷ and square roots.

use mvs_datasets::scene::ColorImage;

/// Draws a line through `points` (pixels, (0, 0) is the outer corner of the top-left pixel), `width`
/// pixels wide with round ends and joins, anti-aliased by each pixel centre's distance from it.
pub(super) fn line(image: &mut ColorImage, points: &[(f64, f64)], width: f64, ink: [u8; 3]) {
    let radius = 0.5 * width;
    let (columns, rows) = image.size();
    let along = |coordinate: fn(&(f64, f64)) -> f64, count| {
        let all = || points.iter().map(coordinate);
        let ends = (
            all().fold(f64::INFINITY, f64::min),
            all().fold(f64::NEG_INFINITY, f64::max),
        );
        span(ends, radius, count)
    };
    let (left, right) = along(|point| point.0, columns);
    let (top, bottom) = along(|point| point.1, rows);
    // One layer for all pieces: where they overlap, ink must not be laid twice.
    let stride = right.saturating_sub(left) as usize;
    let mut layer = vec![0.0f64; stride * bottom.saturating_sub(top) as usize];
    let alone = points.len() == 1;
    let pieces = points.windows(2).map(|pair| (pair[0], pair[1]));
    for (from, to) in pieces.chain(alone.then(|| (points[0], points[0]))) {
        let (x0, x1) = span((from.0, to.0), radius, columns);
        let (y0, y1) = span((from.1, to.1), radius, rows);
        for row in y0..y1 {
            for column in x0..x1 {
                let centre = (f64::from(column) + 0.5, f64::from(row) + 0.5);
                let share = (radius + 0.5 - distance(centre, from, to)).clamp(0.0, 1.0);
                let cell = &mut layer[(row - top) as usize * stride + (column - left) as usize];
                *cell = cell.max(share);
            }
        }
    }
    for (row, shares) in (top..).zip(layer.chunks_exact(stride.max(1))) {
        for (column, &share) in (left..).zip(shares).filter(|(_, share)| **share > 0.0) {
            let paper = image.get(column, row);
            image.set(
                column,
                row,
                std::array::from_fn(|k| mixed(paper[k], ink[k], share)),
            );
        }
    }
}

/// Draws a disc.
pub(super) fn disc(image: &mut ColorImage, centre: (f64, f64), radius: f64, ink: [u8; 3]) {
    line(image, &[centre], 2.0 * radius, ink);
}

/// Draws a line of dashes from `from` to `to`, each `dash` pixels long and as far apart.
pub(super) fn dashes(
    image: &mut ColorImage,
    [from, to]: [(f64, f64); 2],
    dash: f64,
    (width, ink): (f64, [u8; 3]),
) {
    let (dx, dy) = (to.0 - from.0, to.1 - from.1);
    let length = (dx * dx + dy * dy).sqrt();
    let at = |along: f64| {
        let share = (along / length).min(1.0);
        (from.0 + dx * share, from.1 + dy * share)
    };
    let mut along = 0.0;
    while along < length {
        line(image, &[at(along), at(along + dash)], width, ink);
        along += 2.0 * dash;
    }
}

/// The pixels along one axis that a piece between `ends` can touch.
fn span((a, b): (f64, f64), radius: f64, count: u32) -> (u32, u32) {
    let clamped = |edge: f64| edge.clamp(0.0, f64::from(count));
    let first = clamped((a.min(b) - radius - 1.0).floor());
    let last = clamped((a.max(b) + radius + 1.0).ceil());
    #[allow(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "clamped to the picture"
    )]
    let pixels = (first as u32, last as u32);
    pixels
}

/// Distance of a point from a piece of a line.
fn distance(point: (f64, f64), from: (f64, f64), to: (f64, f64)) -> f64 {
    let (dx, dy) = (to.0 - from.0, to.1 - from.1);
    let (px, py) = (point.0 - from.0, point.1 - from.1);
    let square = dx * dx + dy * dy;
    let share = if square > 0.0 {
        ((px * dx + py * dy) / square).clamp(0.0, 1.0)
    } else {
        0.0
    };
    let (ox, oy) = (px - share * dx, py - share * dy);
    (ox * ox + oy * oy).sqrt()
}

fn mixed(paper: u8, ink: u8, share: f64) -> u8 {
    let value = f64::from(paper) * (1.0 - share) + f64::from(ink) * share;
    #[allow(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "between two bytes"
    )]
    let byte = (value + 0.5).floor() as u8;
    byte
}

#[cfg(test)]
mod tests {
    use super::*;
    use mvs_datasets::scene::Raster;

    fn ink(image: &ColorImage) -> f64 {
        let dark = |pixel: &[u8; 3]| 1.0 - f64::from(pixel[0]) / 255.0;
        image.values().iter().map(dark).sum()
    }

    #[test]
    fn a_line_lays_its_area_of_ink_whatever_its_direction() {
        for end in [(60.0, 10.0), (50.0, 50.0), (12.3, 57.8)] {
            let mut image = Raster::filled(70, 70, [255; 3]).unwrap();
            line(&mut image, &[(10.0, 10.0), end], 4.0, [0; 3]);
            let length = (end.0 - 10.0f64).hypot(end.1 - 10.0);
            let area = 4.0 * length + std::f64::consts::PI * 4.0;
            assert!(
                (ink(&image) / area - 1.0).abs() < 0.02,
                "{end:?} {}",
                ink(&image)
            );
        }
    }

    #[test]
    fn joins_are_inked_once_and_borders_cut_off() {
        let mut image = Raster::filled(9, 9, [255; 3]).unwrap();
        let corner = [(4.5, -20.0), (4.5, 4.5), (30.0, 4.5)];
        line(&mut image, &corner, 1.0, [55, 100, 200]);
        assert_eq!(image.get(4, 0), [55, 100, 200]);
        assert_eq!(image.get(4, 4), [55, 100, 200]);
        assert_eq!(image.get(8, 4), [55, 100, 200]);
        assert_eq!(image.get(2, 6), [255; 3]);
        line(&mut image, &[], 3.0, [0; 3]);
        assert_eq!(image.get(2, 6), [255; 3]);
    }

    #[test]
    fn dashes_leave_every_other_piece_open() {
        let mut image = Raster::filled(40, 5, [255; 3]).unwrap();
        let ends = [(0.0, 2.5), (40.0, 2.5)];
        dashes(&mut image, ends, 8.0, (1.0, [0; 3]));
        let row: Vec<u8> = (0..40).map(|column| image.get(column, 2)[0]).collect();
        assert_eq!((row[4], row[12], row[20], row[28]), (0, 255, 0, 255));
    }
}
