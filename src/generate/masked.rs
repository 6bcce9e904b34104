//! The masked image as JPEG, dark enough outside the mask.
//!
//! Readers take a pixel of the masked image for background when it is at most 10. JPEG at quality 95
//! with half-resolution chroma carries the colour of the surface across the mask's edge; where that
//! shows, the image is encoded with full chroma and, if need be, better.

use crate::error::{Error, Result};
use mvs_datasets::format::image::{self, JpegOptions};
use mvs_datasets::scene::{ColorImage, Mask};

/// The brightest that the background may come back as: readers' 10, less what decoders differ by.
const DARK: u8 = 8;

/// The bytes of a JPEG of `masked`, encoded by `options` if its background comes back dark, else
/// with full chroma and the least quality above that does. Both of one size. Not to be asked where
/// the mask leaves nothing out: the image itself is the masked one.
pub(super) fn encode(masked: &ColorImage, mask: &Mask, options: JpegOptions) -> Result<Vec<u8>> {
    let full_chroma = |quality: u8| JpegOptions {
        quality: quality.max(options.quality),
        subsample_chroma: false,
    };
    for attempt in [options, full_chroma(options.quality), full_chroma(98)] {
        let bytes = jpeg(masked, attempt)?;
        let read = image::read_color(&bytes)
            .map_err(|error| Error::invalid("masked image", error.to_string()))?;
        if brightest_outside(&read, mask) <= DARK {
            return Ok(bytes);
        }
    }
    jpeg(masked, full_chroma(100))
}

/// The bytes of a JPEG of `image`.
pub(super) fn jpeg(image: &ColorImage, options: JpegOptions) -> Result<Vec<u8>> {
    let mut bytes = Vec::new();
    image::write_jpeg(&mut bytes, image, options)
        .map_err(|error| Error::invalid("image to encode", error.to_string()))?;
    Ok(bytes)
}

/// The largest value of any channel outside the mask; 0 where there is no outside.
fn brightest_outside(image: &ColorImage, mask: &Mask) -> u8 {
    let pixels = image.values().iter().zip(mask.values());
    let outside = pixels.filter(|(_, inside)| !**inside);
    outside.flat_map(|(pixel, _)| *pixel).max().unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::blend;
    use mvs_datasets::scene::Raster;

    #[test]
    fn a_saturated_edge_needs_full_chroma_and_stays_dark() {
        let (width, height) = (64, 64);
        let values = (0..width * height).map(|i| i % width + i / width / 3 < 41);
        let mask = Raster::from_values(width, height, values.collect()).unwrap();
        let image = |color| blend::masked(&Raster::filled(width, height, color).unwrap(), &mask);
        let red = image([250, 20, 20]).unwrap();
        let plain = image::read_color(&jpeg(&red, JpegOptions::default()).unwrap()).unwrap();
        assert!(
            brightest_outside(&plain, &mask) > 10,
            "the plain JPEG would do"
        );
        let bytes = encode(&red, &mask, JpegOptions::default()).unwrap();
        let read = image::read_color(&bytes).unwrap();
        assert!(brightest_outside(&read, &mask) <= DARK);
        let black = image([0; 3]).unwrap();
        let plain = jpeg(&black, JpegOptions::default()).unwrap();
        assert_eq!(
            encode(&black, &mask, JpegOptions::default()).unwrap(),
            plain
        );
    }
}
