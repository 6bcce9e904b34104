//! How far beside the right pixels an image shows what others do: what depths cannot tell where a camera is moved
//! along a flat surface.

use super::geometry::PairCheck;
use super::images::correlation_beside;
use super::{Finding, Severity, median};
use glam::DVec2;
use mvs_datasets::scene::{ColorImage, Scene};

// Medians over a view's pairs, in pixels: on 14 sound scenes (a real one at 768x576, the demo's, synthetic ones down
// to 48x36) .02 to .08 in the middle and .25 at most; one camera moved along the demo's table by 2.5 pixels: 2.56.
/// A view whose image is farther beside is at fault.
const FAULT: f64 = 1.0;
/// Farther than this is worth knowing.
const ADVICE: f64 = 0.5;
/// Fewer pairs say nothing of a view.
const PAIRS: usize = 3;

/// A finding for each view whose image lies beside where its camera puts it, as the other views show it. The
/// `pairs` are those of views that fit by their depth.
pub(super) fn check(scene: &Scene, pairs: &[PairCheck]) -> Vec<Finding> {
    let finding = |id: u32| {
        let own = pairs.iter().filter(|pair| pair.source == id);
        let shifts: Vec<[f64; 2]> = own.filter_map(|pair| pair.color_shift).collect();
        let along = |axis: usize| median(shifts.iter().map(|shift| shift[axis]).collect());
        let by = DVec2::new(along(0)?, along(1)?);
        if shifts.len() < PAIRS || by.length() <= ADVICE {
            return None;
        }
        let severity = match by.length() > FAULT {
            true => Severity::Fault,
            false => Severity::Advice,
        };
        let message = format!(
            "expected the image where cameras and depths of other views put it, found it {:.1} px to the \
             {} and {:.1} px {} (median over {} pairs): its principal point or pose is wrong, or the image is moved",
            by.x.abs(),
            if by.x < 0.0 { "left" } else { "right" },
            by.y.abs(),
            if by.y < 0.0 { "above" } else { "below" },
            shifts.len()
        );
        Some(Finding::new(
            severity,
            "image-beside",
            format!("view {id}"),
            message,
        ))
    };
    let ids = scene.views().iter().map(|view| view.id);
    ids.filter_map(finding).collect()
}

/// In pixels: where brightness is held against each other beside the best place so far.
const STEP: f64 = 1.0;
/// So many steps at most.
const MOST_STEPS: usize = 16;
/// The correlation drops by so much, both sides of its peak together, where images tell a pixel.
const CURVED: f64 = 0.01;

/// The shift of the source's image, in pixels, under which its brightness correlates best with the reference's
/// at these (reference, source) pixels. `None` as for [`correlation_beside`], and where no peak is near or sharp.
pub(super) fn shift(
    images: (&ColorImage, &ColorImage),
    pixels: impl Iterator<Item = (DVec2, DVec2)> + Clone,
) -> Option<[f64; 2]> {
    let at = |by: DVec2| correlation_beside(images, pixels.clone(), by);
    let mut best = DVec2::ZERO;
    let mut peak = at(best)?;
    for _ in 0..MOST_STEPS {
        let around = [DVec2::X, DVec2::NEG_X, DVec2::Y, DVec2::NEG_Y];
        let around = around.map(|way| best + STEP * way);
        let values = around.map(at);
        let higher = around.into_iter().zip(values);
        let higher = higher.filter_map(|(place, value)| value.map(|value| (value, place)));
        match higher.max_by(|a, b| a.0.total_cmp(&b.0)) {
            Some((value, place)) if value > peak => (peak, best) = (value, place),
            _ => {
                let [right, left, below, above] = values;
                let x = vertex(left?, peak, right?)?;
                let y = vertex(above?, peak, below?)?;
                return Some((best + STEP * DVec2::new(x, y)).to_array());
            }
        }
    }
    None
}

/// Where the parabola through these values at -1, 0 and 1 is highest; none where it is flat.
fn vertex(before: f64, peak: f64, after: f64) -> Option<f64> {
    let bend = 2.0 * peak - before - after;
    (bend > CURVED).then(|| 0.5 * (after - before) / bend)
}
