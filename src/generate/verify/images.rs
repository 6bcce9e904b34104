//! Whether images show what depths and cameras say: brightness at the same points of the surface.
//!
//! Judged by correlation, which light that brightens or dims whole images does not move. Medians over
//! pairs: .86 to .95 on three real and synthetic scenes, .7 on one of 128x96 pixels whose texture is as
//! fine as its pixels; .40 with images moved by eight views and .22 with images turned upside down on a
//! real scene. A smooth scene whose views are much alike can reach .62 with the images of other views:
//! those are not found. Of one view by itself: .84 and more where it is sound, .34 and less with another's
//! image, on the real scene.

use super::geometry::{FEW, PairCheck};
use super::{Finding, median};
use glam::DVec2;
use mvs_datasets::scene::{ColorImage, Scene};

/// Images correlate at least so where they show the same: between the finest texture that is right and the
/// likest images that are wrong, nearer to these, as what is right must not be called a fault.
const SAME: f64 = 0.5;
/// A view by itself is at fault below this part of the scene's correlation.
const OTHER: f64 = 0.6;
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

/// A fault where all images show something else, else one for each view whose image alone does; those
/// `known` not to fit by their depth are left out.
pub(super) fn check(scene: &Scene, pairs: &[PairCheck], known: &[Finding]) -> Vec<Finding> {
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
        let known = known.iter().any(|finding| finding.place == place);
        (!known).then(|| Finding::fault("image-does-not-match", place, message))
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
}
