//! Visibility-based depth selection after Merrell et al., ICCV 2007: every source's depth map is
//! rendered into the reference; occlusions and free-space violations decide which depth stands.
//!
//! Two things differ from the paper. Rendered pixels are small planes, not points, so that slopes
//! are not terraced. And what is selected here is only a hypothesis: the average fusion that
//! follows replaces it by exactly sampled depths.

use super::geometry::PairGeometry;
use super::samples::{Samples, Unit};
use glam::{DVec2, DVec3};
use mvs_datasets::scene::View;

/// What one view says about a reference pixel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Opinion {
    /// z-depth in the reference, 0 for none.
    pub(super) depth: f32,
    /// ≥ 0.
    pub(super) confidence: f32,
}

/// The confidence-based variant: the most confident opinion, averaged with those within the
/// fraction `tolerance` of it. Opinions in front of it (it would be occluded) and sources that see
/// through it speak against it with their confidence. The depth, where more than `min_support`
/// remains.
///
/// `violated(i, d)` is the confidence with which source `i` sees through depth `d`, if it does;
/// `opinions[0]` is the reference's, `opinions[i + 1]` source i's.
pub(super) fn most_confident(
    opinions: &[Opinion],
    violated: impl Fn(usize, f32) -> Option<f32>,
    tolerance: f32,
    min_support: f32,
) -> Option<f32> {
    let mut best: Option<&Opinion> = None;
    for opinion in opinions.iter().filter(|opinion| opinion.depth > 0.0) {
        // Of equally confident ones the first, which is the reference's.
        if best.is_none_or(|best| opinion.confidence > best.confidence) {
            best = Some(opinion);
        }
    }
    let start = best?.depth;
    let (mut weighted, mut weight, mut support) = (0.0, 0.0, 0.0);
    for opinion in opinions.iter().filter(|opinion| opinion.depth > 0.0) {
        let relative = opinion.depth / start - 1.0;
        if relative.abs() <= tolerance {
            weighted += opinion.confidence * relative;
            weight += opinion.confidence;
            support += opinion.confidence;
        } else if relative < 0.0 {
            support -= opinion.confidence;
        }
    }
    let depth = if weight > 0.0 {
        start * (1.0 + weighted / weight)
    } else {
        start
    };
    for source in 0..opinions.len() - 1 {
        support -= violated(source, depth).unwrap_or(0.0);
    }
    (support > min_support).then_some(depth)
}

/// The stability-based variant: the nearest opinion on which at least as many views' surfaces lie in
/// front of it as see through it, as the mean of the opinions that agree with it (itself, it would
/// be the nearest of them and off by their noise). Arguments as in [`most_confident`].
pub(super) fn nearest_stable(
    opinions: &[Opinion],
    violated: impl Fn(usize, f32) -> Option<f32>,
    tolerance: f32,
) -> Option<f32> {
    let mut depths: Vec<f32> = opinions
        .iter()
        .map(|o| o.depth)
        .filter(|&d| d > 0.0)
        .collect();
    depths.sort_by(f32::total_cmp);
    let stable = depths.iter().copied().find(|&depth| {
        let in_front = |&&other: &&f32| other < depth * (1.0 - tolerance);
        let occlusions = depths.iter().filter(in_front).count();
        let sources = 0..opinions.len() - 1;
        let violations = sources.filter(|&i| violated(i, depth).is_some()).count();
        occlusions >= violations
    })?;
    let relative = depths.iter().map(|depth| depth / stable - 1.0);
    let agreeing: Vec<f32> = relative.filter(|off| off.abs() <= tolerance).collect();
    #[allow(clippy::cast_precision_loss, reason = "a number of views")]
    let mean = agreeing.iter().sum::<f32>() / agreeing.len() as f32;
    Some(stable * (1.0 + mean))
}

/// A source's depth map as the reference sees it.
pub(super) struct Rendered {
    /// z-depth in the reference per pixel, 0 for none.
    pub(super) depth: Vec<f32>,
    /// The source pixel that each came from.
    pub(super) from: Vec<u32>,
}

/// Largest number of reference pixels that a source pixel spreads over to each side.
const SPREAD: f64 = 2.0;

/// Renders `samples` of `source` into `reference`; of several pixels the nearest.
pub(super) fn render(reference: &View, source: &View, samples: &Samples) -> Rendered {
    let (width, height) = (reference.camera.width(), reference.camera.height());
    let pixels = width as usize * height as usize;
    let mut rendered = Rendered {
        depth: vec![0.0; pixels],
        from: vec![0; pixels],
    };
    let (there, back) = (
        PairGeometry::new(source, reference),
        PairGeometry::new(reference, source),
    );
    let zoom = reference.camera.focal().x / source.camera.focal().x;
    for row in 0..samples.height() {
        let columns = samples.columns();
        for (column, &stored) in columns.clone().zip(samples.part(row, columns)) {
            let depth = f64::from(samples.unit().convert(stored));
            if depth <= 0.0 {
                continue;
            }
            let pixel = center(column, row);
            let Some(seen) = there.project(pixel, depth) else {
                continue;
            };
            let reach = (0.5 * zoom * depth / seen.depth).clamp(0.0, SPREAD);
            let patch = Patch {
                plane: plane(samples, column, row),
                back: &back,
                depth: seen.depth,
            };
            let from = row * samples.width() + column;
            #[allow(clippy::cast_possible_truncation, reason = "image sizes are u32")]
            patch.draw(
                (seen.pixel, reach),
                (width, height),
                from as u32,
                &mut rendered,
            );
        }
    }
    rendered
}

/// A source pixel as a small plane.
struct Patch<'a> {
    /// Inverse depth in the source = plane · (u, v, 1).
    plane: DVec3,
    back: &'a PairGeometry,
    /// z-depth of the middle in the reference.
    depth: f64,
}

impl Patch<'_> {
    fn draw(
        &self,
        (at, reach): (DVec2, f64),
        (width, height): (u32, u32),
        from: u32,
        to: &mut Rendered,
    ) {
        let columns = covered(at.x, reach, width);
        for row in covered(at.y, reach, height) {
            for column in columns.clone() {
                let index = (row * width + column) as usize;
                let depth = self.depth_at(center(column as usize, row as usize));
                if to.depth[index] <= 0.0 || depth < to.depth[index] {
                    to.depth[index] = depth;
                    to.from[index] = from;
                }
            }
        }
    }

    /// Depth of the plane along the reference's ray through `pixel`; that of the middle where the
    /// plane runs away.
    #[allow(clippy::cast_possible_truncation, reason = "depth maps are f32")]
    fn depth_at(&self, pixel: DVec2) -> f32 {
        let along = self.plane.dot(self.back.rotation * pixel.extend(1.0));
        let depth = (1.0 - self.plane.dot(self.back.translation)) / along;
        let near = (depth / self.depth - 1.0).abs() < 0.05;
        (if near { depth } else { self.depth }) as f32
    }
}

/// Pixels on an axis of `size` whose centre lies within `reach` of `at`, and the one that holds it.
#[allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "clamped to the axis"
)]
fn covered(at: f64, reach: f64, size: u32) -> std::ops::Range<u32> {
    let end = f64::from(size);
    let first = (at - reach - 0.5).ceil().min(at.floor()).clamp(0.0, end);
    let last = (at + reach - 0.5)
        .floor()
        .max(at.floor())
        .clamp(-1.0, end - 1.0);
    first as u32..(last + 1.0) as u32
}

/// The plane of inverse depth through a pixel with the slopes to its neighbours of similar depth.
fn plane(samples: &Samples, column: usize, row: usize) -> DVec3 {
    let inverse = |stored: f32| {
        f64::from(if samples.unit() == Unit::Depth {
            Unit::Inverse.convert(stored)
        } else {
            stored
        })
    };
    let [above, own, below] = samples.around(column, row).map(|row| row.map(inverse));
    let middle = own[1];
    let slope = |low: f64, high: f64| {
        let similar = |value: f64| (value / middle - 1.0).abs() < 0.02;
        match (similar(low), similar(high)) {
            (true, true) => 0.5 * (high - low),
            (true, false) => middle - low,
            (false, true) => high - middle,
            (false, false) => 0.0,
        }
    };
    let u = slope(own[0], own[2]);
    let v = slope(above[1], below[1]);
    let at = center(column, row);
    DVec3::new(u, v, middle - u * at.x - v * at.y)
}

/// The depth that a source has at the pixel where the reference's `pixel` at `depth` appears, over
/// the depth of the hypothesis there; and that pixel's index. `None` without one.
pub(super) fn seen_through(
    pair: &PairGeometry,
    samples: &Samples,
    pixel: DVec2,
    depth: f64,
) -> Option<(f64, usize)> {
    let seen = pair.project(pixel, depth)?;
    let (x, y) = (seen.pixel.x.floor(), seen.pixel.y.floor());
    #[allow(clippy::cast_precision_loss, reason = "image sizes are far below 2^52")]
    let inside = x >= 0.0 && y >= 0.0 && x < samples.width() as f64 && y < samples.height() as f64;
    if !inside {
        return None;
    }
    #[allow(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "inside the map"
    )]
    let (column, row) = (x as usize, y as usize);
    let found = f64::from(samples.unit().convert(samples.get(column, row)));
    (found > 0.0).then(|| (found / seen.depth, row * samples.width() + column))
}

#[allow(clippy::cast_precision_loss, reason = "image sizes are far below 2^52")]
pub(super) fn center(column: usize, row: usize) -> DVec2 {
    DVec2::new(column as f64 + 0.5, row as f64 + 0.5)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fuse::testing::{Plane, arc};

    fn says(depths: &[(f32, f32)]) -> Vec<Opinion> {
        let opinion = |&(depth, confidence)| Opinion { depth, confidence };
        depths.iter().map(opinion).collect()
    }

    /// Parallel cameras along one line of sight: source i sees through everything in front of its
    /// own depth.
    fn line_of_sight(opinions: &[Opinion]) -> impl Fn(usize, f32) -> Option<f32> {
        move |source, depth| {
            let other = opinions[source + 1];
            (other.depth > depth * 1.01).then_some(other.confidence)
        }
    }

    #[test]
    fn a_lone_occluder_in_front_gives_way_to_the_many_behind() {
        let opinions = says(&[(1.0, 0.5), (2.0, 1.0), (2.002, 1.0), (1.998, 1.0)]);
        let through = line_of_sight(&opinions);
        let stable = nearest_stable(&opinions, &through, 0.01).unwrap();
        assert!((stable - 2.0).abs() < 0.01, "{stable}");
        let fused = most_confident(&opinions, &through, 0.01, 0.0).unwrap();
        assert!((fused - 2.0).abs() < 1e-3, "{fused}");
    }

    #[test]
    fn a_lone_depth_behind_the_surface_is_occluded_by_it() {
        let opinions = says(&[(3.0, 0.9), (2.0, 0.8), (2.0, 0.8), (2.0, 0.8)]);
        let through = line_of_sight(&opinions);
        let stable = nearest_stable(&opinions, &through, 0.01).unwrap();
        assert!((stable - 2.0).abs() < 1e-6);
        // The most confident is the outlier: the three in front speak against it.
        assert_eq!(most_confident(&opinions, &through, 0.01, 0.0), None);
    }

    #[test]
    fn a_tie_is_stable_at_the_far_side_and_without_support() {
        // One surface in front, one behind that sees through it: S(front) = −1, S(behind) = +1.
        let opinions = says(&[(1.0, 1.0), (2.0, 1.0)]);
        let through = line_of_sight(&opinions);
        assert_eq!(nearest_stable(&opinions, &through, 0.01), Some(2.0));
        assert_eq!(most_confident(&opinions, &through, 0.01, 0.0), None);
        assert_eq!(
            nearest_stable(&says(&[(0.0, 0.0), (0.0, 0.0)]), &through, 0.01),
            None
        );
    }

    #[test]
    fn agreeing_depths_average_by_confidence() {
        let opinions = says(&[(2.0, 3.0), (2.01, 1.0)]);
        let none = |_, _| None;
        let fused = most_confident(&opinions, none, 0.01, 3.9).unwrap();
        assert!((fused - 2.0025).abs() < 1e-5, "{fused}");
        assert_eq!(most_confident(&opinions, none, 0.01, 4.0), None);
    }

    #[test]
    fn a_rendered_plane_lies_on_the_plane_and_leaves_no_holes() {
        let surface = Plane::tilted();
        let estimates = arc(3, (64, 48), DVec3::ZERO, |view, pixel| {
            surface.depth(view, pixel)
        });
        let (reference, source) = (&estimates[1], &estimates[0]);
        let stored: Vec<f32> = source
            .depth
            .values()
            .iter()
            .map(|&d| Unit::Inverse.convert(d))
            .collect();
        let samples = Samples::new((64, 48), Unit::Inverse, &stored);
        let rendered = render(&reference.view, &source.view, &samples);
        let mut seen = 0;
        for (found, expected) in rendered.depth.iter().zip(reference.depth.values()) {
            if *found > 0.0 {
                seen += 1;
                assert!((found / expected - 1.0).abs() < 2e-6, "{found} {expected}");
            }
        }
        assert!(seen > 64 * 48 * 8 / 10, "{seen}");
    }
}
