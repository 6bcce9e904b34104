//! Depth and confidence maps with fewer pixels, as an estimator would give that was run on smaller
//! images.

use crate::error::{Error, Result};
use mvs_datasets::format::pfm;
use mvs_datasets::layout::files;
use mvs_datasets::scene::Raster;
use std::fs;
use std::path::Path;

/// Depths of one surface differ by less than this factor between neighbours.
const SAME_SURFACE: f32 = 1.02;

/// Writes every `*.pfm` of `from` into `to` with a `by`-th of its width and height (rounded down, at
/// least 1); `pick` makes a pixel of the four that its centre lies between and of its place between
/// their centres.
pub(super) fn folder(
    (from, to): (&Path, &Path),
    by: u32,
    pick: fn([f32; 4], (f32, f32)) -> f32,
) -> Result<()> {
    let listed = fs::read_dir(from).map_err(|error| unread(from, &error))?;
    fs::create_dir_all(to).map_err(|error| unread(to, &error))?;
    for file in listed {
        let path = file.map_err(|error| unread(from, &error))?.path();
        let (Some(name), Some("pfm")) = (
            path.file_name(),
            path.extension().and_then(|end| end.to_str()),
        ) else {
            continue;
        };
        let small = shrunk(&files::read_raster(&path)?, by, pick)?;
        files::write_atomically(&to.join(name), |file| pfm::write_gray(file, &small))?;
    }
    Ok(())
}

fn unread(folder: &Path, error: &std::io::Error) -> Error {
    Error::invalid(folder.display().to_string(), error.to_string())
}

fn shrunk(
    map: &Raster<f32>,
    by: u32,
    pick: fn([f32; 4], (f32, f32)) -> f32,
) -> Result<Raster<f32>> {
    let (width, height) = ((map.width() / by).max(1), (map.height() / by).max(1));
    let mut values = Vec::with_capacity(width as usize * height as usize);
    for row in 0..height {
        let (top, bottom, y) = between(row, height, map.height());
        for column in 0..width {
            let (left, right, x) = between(column, width, map.width());
            let four = [(left, top), (right, top), (left, bottom), (right, bottom)];
            values.push(pick(four.map(|(column, row)| map.get(column, row)), (x, y)));
        }
    }
    Ok(Raster::from_values(width, height, values)?)
}

/// The two of `of` pixels between whose centres the centre of pixel `index` of `count` lies, and how
/// far it is on its way from the one to the other.
fn between(index: u32, count: u32, of: u32) -> (u32, u32, f32) {
    let place = (f64::from(index) + 0.5) * f64::from(of) / f64::from(count) - 0.5;
    #[allow(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "place is in 0 ..= of - 1"
    )]
    let first = place as u32;
    #[allow(clippy::cast_possible_truncation, reason = "a fraction")]
    let share = (place - f64::from(first)) as f32;
    (first, (first + 1).min(of - 1), share)
}

/// Bilinear in inverse depth, exact on planes; none where a depth is missing or a surface ends.
pub(super) fn depth(four: [f32; 4], (x, y): (f32, f32)) -> f32 {
    let nearest = four.iter().copied().fold(f32::INFINITY, f32::min);
    let of_one_surface = |&depth: &f32| depth > 0.0 && depth < nearest * SAME_SURFACE;
    if !four.iter().all(of_one_surface) {
        return 0.0;
    }
    let [a, b, c, d] = four.map(f32::recip);
    let (top, bottom) = (a + (b - a) * x, c + (d - c) * x);
    (top + (bottom - top) * y).recip()
}

/// The least of the four.
pub(super) fn confidence(four: [f32; 4], _: (f32, f32)) -> f32 {
    four.iter().copied().fold(f32::INFINITY, f32::min)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_plane_stays_the_plane_at_any_size() {
        // Inverse depth is affine in image coordinates (u, v), whose unit is the image's width.
        let plane = |u: f32, v: f32| (0.5 + 0.05 * u - 0.08 * v).recip();
        let map = |width: u32, height: u32| {
            let at = |index: u32, count: u32| (index as f32 + 0.5) / count as f32;
            let values = (0..height)
                .flat_map(|row| {
                    (0..width).map(move |column| plane(at(column, width), at(row, height)))
                })
                .collect();
            Raster::from_values(width, height, values).unwrap()
        };
        for by in [2, 3, 4] {
            let small = shrunk(&map(61, 40), by, depth).unwrap();
            let exact = map(61 / by, 40 / by);
            assert_eq!(small.size(), exact.size());
            for (found, expected) in small.values().iter().zip(exact.values()) {
                assert!((found / expected - 1.0).abs() < 1e-6, "{found} {expected}");
            }
        }
    }

    #[test]
    fn edges_and_holes_give_no_depth_and_the_least_confidence_counts() {
        assert_eq!(depth([1.0, 1.0, 1.0, 0.0], (0.5, 0.5)), 0.0);
        assert_eq!(depth([1.0, 1.0, 1.5, 1.5], (0.5, 0.5)), 0.0);
        assert_eq!(depth([f32::NAN, 1.0, 1.0, 1.0], (0.5, 0.5)), 0.0);
        assert_eq!(confidence([0.9, 0.2, 0.8, 0.7], (0.5, 0.5)), 0.2);
    }
}
