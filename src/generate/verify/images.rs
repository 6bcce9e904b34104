//! Whether images show what depths and cameras say: brightness at the same points of the surface.
//!
//! Judged by correlation, which light that brightens or dims whole images does not move. Medians over pairs:
//! .86 to .95 on three real and synthetic scenes, .7 on one of 128x96 pixels whose texture is as fine as its
//! pixels; .40 with images moved by eight views and .22 with images turned upside down on a real scene. A
//! smooth scene whose views are much alike can reach .62 with the images of other views: those are told by
//! where they fit best. On three sound scenes each of 296, 296 and 56 pairs fits best at the same points,
//! with images moved by one view 93, 94 and 48 do. Of one view by itself: .84 and more where it is sound, .34
//! and less with another's image, on the real scene.

use super::geometry::{FEW, PairCheck};
use super::{Finding, median};
use glam::DVec2;
use mvs_datasets::scene::{ColorImage, Scene};

/// Images correlate at least so where they show the same: between the finest texture that is right and the
/// likest images that are wrong, nearer to these, as what is right must not be called a fault.
const SAME: f64 = 0.5;
/// A view by itself is at fault below this part of the scene's correlation.
const OTHER: f64 = 0.6;
/// How far from the right pixels images are held against each other too, in widths, and at least in pixels.
const AWAY: f64 = 0.03;
const LEAST_AWAY: f64 = 3.0;
/// Of the pairs so many fit best where they should. By chance, one in five would.
const PEAKS: f64 = 0.5;
/// In grey levels: images that vary less say nothing. Noise of 5 levels, more than JPEG and resampling
/// have, leaves a correlation of .76 in those that vary by 9.
const CONTRAST: f64 = 10.0;

/// The correlation of brightness at these (reference, source) pixels; `None` for few of them, and
/// where either image varies too little there.
pub(super) fn correlation(
    (reference, source): (&ColorImage, &ColorImage),
    pixels: impl Iterator<Item = (DVec2, DVec2)>,
) -> Option<f64> {
    let brightness = |image: &ColorImage, at: DVec2| {
        let color = image.get(at.x as u32, at.y as u32);
        color.iter().map(|&value| f64::from(value)).sum::<f64>() / 3.0
    };
    let values: Vec<DVec2> = pixels
        .map(|(from, to)| DVec2::new(brightness(reference, from), brightness(source, to)))
        .collect();
    if values.len() < FEW {
        return None;
    }
    let count = values.len() as f64;
    let mean = values.iter().sum::<DVec2>() / count;
    let apart = || values.iter().map(|&value| value - mean);
    let variance = apart().map(|d| d * d).sum::<DVec2>() / count;
    let shared = apart().map(|d| d.x * d.y).sum::<f64>() / count;
    let spread = DVec2::new(variance.x.sqrt(), variance.y.sqrt());
    (spread.min_element() >= CONTRAST).then(|| shared / (spread.x * spread.y))
}

/// As [`correlation`], with pixels of the source that lie `by` so much beside, those within it.
pub(super) fn correlation_beside(
    images: (&ColorImage, &ColorImage),
    pixels: impl Iterator<Item = (DVec2, DVec2)>,
    by: DVec2,
) -> Option<f64> {
    let size = DVec2::new(images.1.width().into(), images.1.height().into());
    let moved = pixels.map(|(from, to)| (from, to + by));
    let inside = |at: DVec2| at.cmpge(DVec2::ZERO).all() && at.cmplt(size).all();
    correlation(images, moved.filter(|&(_, to)| inside(to)))
}

/// Whether the brightness at these pixels correlates at least as well as at pixels of the source that
/// lie a few per cent of its width away, in any of four directions; `None` as [`correlation`].
pub(super) fn is_peak(
    images: (&ColorImage, &ColorImage),
    pixels: impl Iterator<Item = (DVec2, DVec2)> + Clone,
) -> Option<bool> {
    let own = correlation(images, pixels.clone())?;
    let apart = (AWAY * f64::from(images.1.width())).max(LEAST_AWAY);
    let turns = [DVec2::X, DVec2::Y, DVec2::NEG_X, DVec2::NEG_Y];
    let others = turns.map(|turn| correlation_beside(images, pixels.clone(), apart * turn));
    let others = others.into_iter().flatten();
    Some(others.fold(f64::NEG_INFINITY, f64::max) <= own)
}

/// A fault where all images show something else, else one for each view whose image alone does. The `pairs`
/// are those of views that fit by their depth: others say nothing of images.
pub(super) fn check(scene: &Scene, pairs: &[PairCheck]) -> Vec<Finding> {
    let all = pairs.iter().filter_map(|pair| pair.color_correlation);
    let Some(overall) = median(all.collect()) else {
        return Vec::new();
    };
    if overall < SAME {
        let message = format!(
            "expected images that show the same at the same points of the surface, found a correlation \
             of {overall:.2} (median over pairs; sound scenes have .7 and more): they are those of other \
             views, turned or mirrored, or of other cameras"
        );
        return vec![Finding::fault("images-do-not-match", "all views", message)];
    }
    let peaks: Vec<bool> = pairs.iter().filter_map(|pair| pair.color_peak).collect();
    let best = peaks.iter().filter(|&&peak| peak).count();
    if (best as f64) < PEAKS * peaks.len() as f64 {
        let message = format!(
            "expected images that fit best at the same points of the surface, found that {} of {} pairs of \
             views fit better a little beside them (correlation {overall:.2} at them): they are those of \
             other views or of other cameras",
            peaks.len() - best,
            peaks.len()
        );
        return vec![Finding::fault("images-do-not-match", "all views", message)];
    }
    let finding = |id: u32| {
        let place = format!("view {id}");
        let own = pairs
            .iter()
            .filter(|pair| pair.reference == id || pair.source == id)
            .filter_map(|pair| pair.color_correlation);
        let found = median(own.collect()).filter(|&found| found < OTHER * overall)?;
        let message = format!(
            "expected an image that shows what its source views show, found a correlation of \
             {found:.2} at the same points of the surface, {overall:.2} in the scene (medians over \
             pairs): it is that of another view, turned or mirrored"
        );
        Some(Finding::fault("image-does-not-match", place, message))
    };
    let ids = scene.views().iter().map(|view| view.id);
    ids.filter_map(finding).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use mvs_datasets::scene::Raster;

    #[test]
    fn correlations_by_hand() {
        let values = |value: fn(u8) -> u8| (0..64).map(|i| [value(i); 3]).collect();
        let image = |value: fn(u8) -> u8| Raster::from_values(8, 8, values(value)).unwrap();
        let centres =
            || (0..64).map(|i| DVec2::new(f64::from(i % 8) + 0.5, f64::from(i / 8) + 0.5));
        let of = |first: &ColorImage, second: &ColorImage| {
            correlation((first, second), centres().zip(centres()))
        };
        let ramp = image(|i| i);
        let close = |found: Option<f64>, expected: f64| (found.unwrap() - expected).abs() < 1e-12;
        assert!(close(of(&ramp, &image(|i| 2 * i + 30)), 1.0));
        assert!(close(of(&ramp, &image(|i| 255 - i)), -1.0));
        assert!(close(
            of(&image(|i| i % 2 * 99), &image(|i| i / 2 % 2 * 99)),
            0.0
        ));
        assert_eq!(of(&ramp, &image(|_| 9)), None, "flat");
        assert_eq!(of(&ramp, &image(|i| i % 2 * 19)), None, "9.5 levels");
        let few = centres().take(FEW - 1).zip(centres());
        assert_eq!(correlation((&ramp, &ramp), few), None);
    }

    /// A smooth hill, and one a little beside it: they correlate well, and better beside the right pixels.
    #[test]
    fn smooth_images_of_other_views_are_told_by_where_they_fit_best() {
        let hill = |middle: f64| {
            let at = |place: u32| {
                let (x, y) = (f64::from(place % 200), f64::from(place / 200));
                let away = ((x - middle) / 60.0).powi(2) + ((y - 75.0) / 60.0).powi(2);
                [(200.0 * (-away).exp()) as u8; 3]
            };
            ColorImage::from_values(200, 150, (0..200 * 150).map(at).collect()).unwrap()
        };
        let pixels = || {
            let places = (0..200 * 150).step_by(7);
            let centre =
                |place: u32| DVec2::new(f64::from(place % 200) + 0.5, f64::from(place / 200) + 0.5);
            places.map(move |place| (centre(place), centre(place)))
        };
        let (right, beside) = (hill(100.0), hill(106.0));
        assert_eq!(is_peak((&right, &right), pixels()), Some(true));
        assert_eq!(is_peak((&right, &beside), pixels()), Some(false));
        let correlated = correlation((&right, &beside), pixels()).unwrap();
        assert!(correlated > 0.9, "{correlated}");
        let pair = |color_peak| PairCheck {
            reference: 0,
            source: 1,
            in_frame: 100,
            agree: 100,
            in_front: 0,
            median_difference: 0.0,
            worst_difference: 0.0,
            color_difference: 0.0,
            color_correlation: Some(correlated),
            color_peak: Some(color_peak),
            color_shift: None,
        };
        let scene = Scene::new(Vec::new()).unwrap();
        let of = |peaks: usize| {
            let pairs: Vec<PairCheck> = (0..10).map(|nth| pair(nth < peaks)).collect();
            check(&scene, &pairs)
        };
        assert!(of(5).is_empty());
        let found = of(4);
        assert_eq!(found[0].code, "images-do-not-match");
        assert!(
            found[0].message.contains("6 of 10 pairs"),
            "{}",
            found[0].message
        );
    }
}
