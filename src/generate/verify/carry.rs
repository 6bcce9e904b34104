//! Points of one view's depth, seen by another view.

use super::reading::Reading;
use glam::{DVec2, DVec3};
use mvs_datasets::scene::{DepthMap, View};

/// Depths that differ by less than this fraction are taken to show the same surface.
pub(super) const SAME_SURFACE: f64 = 0.01;
/// Neighbouring depths that differ by more are not interpolated.
pub(super) const SMOOTH: f64 = 0.02;

/// A point carried into another view.
pub(super) struct Carried {
    /// Where it falls in the source.
    pub(super) pixel: DVec2,
    /// Relative difference between its depth there and the source's: positive when behind.
    pub(super) difference: f64,
    /// Whether it lies in front of all that the source sees there and two pixels around: what is seen at an edge
    /// may fall beside it in another view.
    pub(super) in_front: bool,
}

/// Pixels with depth on a regular grid of about `points`.
pub(super) fn grid(depth: &DepthMap, points: u32) -> Vec<(DVec2, f32)> {
    let (width, height) = depth.size();
    let pixels = f64::from(width) * f64::from(height);
    let stride = ((pixels / f64::from(points.max(1))).sqrt() as usize).max(1);
    let mut found = Vec::new();
    for row in (stride as u32 / 2..height).step_by(stride) {
        for column in (stride as u32 / 2..width).step_by(stride) {
            let value = depth.get(column, row);
            if value > 0.0 {
                let pixel = DVec2::new(f64::from(column) + 0.5, f64::from(row) + 0.5);
                found.push((pixel, value));
            }
        }
    }
    found
}

/// The depth at continuous coordinates, interpolated as a plane is: linearly in 1/z. `None` at
/// borders, jumps and holes.
fn interpolated(depth: &DepthMap, view: &View, pixel: DVec2, reading: Reading) -> Option<f64> {
    let corner = pixel - 0.5;
    let (width, height) = depth.size();
    let inside = corner.x >= 0.0
        && corner.y >= 0.0
        && corner.x < f64::from(width) - 1.0
        && corner.y < f64::from(height) - 1.0;
    if !inside {
        return None;
    }
    let (column, row) = (corner.x as u32, corner.y as u32);
    let (fx, fy) = (corner.x.fract(), corner.y.fract());
    let mut inverse = 0.0;
    let (mut least, mut most) = (f64::INFINITY, 0.0f64);
    for (dx, dy, weight) in [
        (0, 0, (1.0 - fx) * (1.0 - fy)),
        (1, 0, fx * (1.0 - fy)),
        (0, 1, (1.0 - fx) * fy),
        (1, 1, fx * fy),
    ] {
        let value = depth.get(column + dx, row + dy);
        if value <= 0.0 {
            return None;
        }
        let centre = DVec2::new(f64::from(column + dx) + 0.5, f64::from(row + dy) + 0.5);
        let z = reading.depth(&view.camera, centre, value);
        least = least.min(z);
        most = most.max(z);
        inverse += weight / z;
    }
    (most <= least * (1.0 + SMOOTH)).then(|| 1.0 / inverse)
}

/// The least depth within two pixels of continuous coordinates.
fn nearest(depth: &DepthMap, view: &View, pixel: DVec2, reading: Reading) -> f64 {
    let (width, height) = depth.size();
    let around = |at: f64, length: u32| {
        let at = at as u32;
        at.saturating_sub(2)..(at + 3).min(length)
    };
    let places = around(pixel.y, height)
        .flat_map(|row| around(pixel.x, width).map(move |column| (column, row)));
    let depths = places.filter_map(|(column, row)| {
        let value = depth.get(column, row);
        let centre = DVec2::new(f64::from(column) + 0.5, f64::from(row) + 0.5);
        (value > 0.0).then(|| reading.depth(&view.camera, centre, value))
    });
    depths.fold(f64::INFINITY, f64::min)
}

/// The reference's points that fall on smooth depth of the source, with their world positions; the
/// depths of either are understood by its reading.
pub(super) fn carry(
    reference: (&View, &[(DVec2, f32)]),
    source: (&View, &DepthMap),
    (reading, of_source): (Reading, Reading),
) -> Vec<(DVec2, DVec3, Carried)> {
    let (view, points) = reference;
    let carried = |&(from, value): &(DVec2, f32)| {
        let z = reading.depth(&view.camera, from, value);
        let position = view.pose.to_world(z * view.camera.ray(from));
        let in_source = source.0.pose.to_cam(position);
        let pixel = source.0.camera.project(in_source)?;
        let there = interpolated(source.1, source.0, pixel, of_source)?;
        let difference = in_source.z / there - 1.0;
        let in_front = difference < -SAME_SURFACE
            && in_source.z < nearest(source.1, source.0, pixel, of_source) * (1.0 - SAME_SURFACE);
        let carried = Carried {
            pixel,
            difference,
            in_front,
        };
        Some((from, position, carried))
    };
    points.iter().filter_map(carried).collect()
}

pub(super) fn agrees(carried: &Carried) -> bool {
    carried.difference.abs() < SAME_SURFACE
}
