//! The masked image as JPEG, dark enough outside the mask.
//!
//! Readers take a pixel of the masked image for background when it is at most 10. JPEG at quality 95
//! with half-resolution chroma carries the colour of the surface across the mask's edge; where that
//! shows, the image is encoded with full chroma and, if need be, better.

use crate::error::{Error, Result};
use mvs_datasets::format::jpeg::{self, JpegOptions};
use mvs_datasets::scene::{ColorImage, Mask};

/// The brightest that readers take for background.
pub(crate) const BACKGROUND: u8 = 10;
/// The brightest that the background may come back as: decoders differ by a little.
const DARK: u8 = BACKGROUND - 2;

/// An image and what a mask leaves of it, as JPEGs.
pub(crate) struct Pair {
    /// By the options that were given.
    pub(crate) whole: Vec<u8>,
    /// `None` where the mask leaves nothing out: the image itself is the masked one.
    pub(crate) masked: Option<Vec<u8>>,
    /// What the masked one was encoded by.
    pub(crate) used: JpegOptions,
}

/// Encodes `blended`, and what the mask, of one size, leaves of it: by the same options if its background
/// comes back dark, else with full chroma and the least quality above that does.
pub(crate) fn encode(blended: &ColorImage, mask: &Mask, options: JpegOptions) -> Result<Pair> {
    if !mask.values().contains(&false) {
        return Ok(Pair {
            whole: jpeg(blended, options)?,
            masked: None,
            used: options,
        });
    }
    let full_chroma = |quality: u8| JpegOptions {
        quality: quality.max(options.quality),
        subsample_chroma: false,
    };
    let mut used = full_chroma(100);
    for attempt in [options, full_chroma(options.quality), full_chroma(98)] {
        if jpeg::stays_dark(blended, mask, attempt, DARK).map_err(refused)? {
            used = attempt;
            break;
        }
    }
    Ok(Pair {
        whole: jpeg(blended, options)?,
        masked: Some(jpeg::encode(blended, Some(mask), used).map_err(refused)?),
        used,
    })
}

/// The bytes of a JPEG of `image`.
pub(crate) fn jpeg(image: &ColorImage, options: JpegOptions) -> Result<Vec<u8>> {
    jpeg::encode(image, None, options).map_err(refused)
}

fn refused(error: std::io::Error) -> Error {
    Error::invalid("image to encode", error.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::blend;
    use mvs_datasets::format::image;
    use mvs_datasets::scene::Raster;

    fn read(bytes: &[u8]) -> ColorImage {
        image::read_color(bytes).unwrap()
    }

    /// The largest value of any channel outside the mask; 0 where there is no outside.
    fn brightest_outside(image: &ColorImage, mask: &Mask) -> u8 {
        let pixels = image.values().iter().zip(mask.values());
        let outside = pixels.filter(|(_, inside)| !**inside);
        outside.flat_map(|(pixel, _)| *pixel).max().unwrap_or(0)
    }

    #[test]
    fn a_saturated_edge_needs_full_chroma_and_stays_dark() {
        let (width, height) = (64, 64);
        let values = (0..width * height).map(|i| i % width + i / width / 3 < 41);
        let mask = Raster::from_values(width, height, values.collect()).unwrap();
        let image = |color| blend::masked(&Raster::filled(width, height, color).unwrap(), &mask);
        let red = image([250, 20, 20]).unwrap();
        let plain = read(&jpeg(&red, JpegOptions::default()).unwrap());
        assert!(
            brightest_outside(&plain, &mask) > 10,
            "the plain JPEG would do"
        );
        let pair = encode(&red, &mask, JpegOptions::default()).unwrap();
        assert!(!pair.used.subsample_chroma && pair.used.quality >= 95);
        let bytes = pair.masked.unwrap();
        assert!(brightest_outside(&read(&bytes), &mask) <= DARK);
        assert_eq!(pair.whole, jpeg(&red, JpegOptions::default()).unwrap());
        let black = image([0; 3]).unwrap();
        let plain = jpeg(&black, JpegOptions::default()).unwrap();
        let pair = encode(&black, &mask, JpegOptions::default()).unwrap();
        assert_eq!((&pair.whole, pair.masked.as_ref()), (&plain, Some(&plain)));
        assert_eq!(pair.used, JpegOptions::default());
    }

    /// The least good encoding that does, whole images tried one after the other.
    fn obvious(masked: &ColorImage, mask: &Mask) -> Vec<u8> {
        let full_chroma = |quality| JpegOptions {
            quality,
            subsample_chroma: false,
        };
        let attempts = [JpegOptions::default(), full_chroma(95), full_chroma(98)];
        let tried = attempts.map(|attempt| jpeg(masked, attempt).unwrap());
        let dark = |bytes: &&Vec<u8>| brightest_outside(&read(bytes), mask) <= DARK;
        let found = tried.iter().find(dark).cloned();
        found.unwrap_or_else(|| jpeg(masked, full_chroma(100)).unwrap())
    }

    #[test]
    fn the_edge_tells_what_the_whole_image_would() {
        let (width, height) = (100, 800);
        let mut seen = Vec::new();
        for (seed, contrast) in [(1u32, 250), (2, 120), (3, 40), (4, 14), (5, 90)] {
            let inside = |i: u32| (i % width) * 7 < 250 + 40 * (i / width % 9) + seed;
            let mask = (0..width * height).map(inside).collect();
            let mask = Raster::from_values(width, height, mask).unwrap();
            let level = |i: u32, channel: u32| (i * (channel + 3) * seed / 11 % contrast) as u8;
            let colors =
                (0..width * height).map(|i| [level(i, 0), level(i, 1) / 2, level(i, 5) / 9]);
            let image = ColorImage::from_values(width, height, colors.collect()).unwrap();
            let masked = blend::masked(&image, &mask).unwrap();
            let pair = encode(&image, &mask, JpegOptions::default()).unwrap();
            let found = pair.masked.unwrap();
            assert!(found == obvious(&masked, &mask), "{seed}");
            assert!(pair.whole == jpeg(&image, JpegOptions::default()).unwrap());
            seen.push(found == jpeg(&masked, JpegOptions::default()).unwrap());
        }
        assert!(seen.contains(&true) && seen.contains(&false), "{seen:?}");
    }
}
