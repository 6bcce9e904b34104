//! JPEG and PNG. Values are 8-bit sRGB, kept as they are; EXIF orientation is not applied.

use super::jpeg;
pub use super::jpeg::JpegOptions;
use crate::error::FormatError;
use crate::scene::{ColorImage, Mask, Raster, Window};
use ::image::codecs::png::{CompressionType, FilterType, PngEncoder};
use ::image::{
    ColorType, DynamicImage, ExtendedColorType, ImageDecoder, ImageEncoder, ImageError,
    ImageFormat, ImageReader, Limits, RgbImage, RgbaImage,
};
use std::io::{Cursor, Error, Write};

/// No image has more pixels: 23,170 squared.
const MOST_PIXELS: u64 = 1 << 29;
/// Deflate shrinks at most 1032-fold and a pixel takes at least one bit; JPEG stays below that.
const MOST_PIXELS_PER_BYTE: u64 = 8 * 1032;

/// Reads a JPEG or PNG (told apart by content) as RGB; alpha is dropped, grey is spread, 16 bits
/// become 8.
///
/// # Errors
/// Bytes that are no JPEG or PNG, are cut short or damaged (inside a JPEG that is not plain damage may pass), or
/// state more than 2²⁹ pixels or more than so few bytes can hold; JPEGs with components in scans of their own that
/// are not progressive, or with chroma finer than brightness.
pub fn read_color(bytes: &[u8]) -> Result<ColorImage, FormatError> {
    match jpeg::decode(bytes, most_pixels(bytes), Window::whole)? {
        Some((_, image)) => Ok(image),
        None => read_other(bytes),
    }
}

/// Of a JPEG or PNG, read as [`read_color`] does, its width and height, and the pixels in the window that
/// `wanted` answers to them. Of plain JPEGs no other pixels are made.
///
/// # Errors
/// As [`read_color`], and a window that is empty or reaches beyond the image.
pub fn read_color_part(
    bytes: &[u8],
    wanted: impl Fn((u32, u32)) -> Window,
) -> Result<((u32, u32), ColorImage), FormatError> {
    if let Some(found) = jpeg::decode(bytes, most_pixels(bytes), &wanted)? {
        return Ok(found);
    }
    let image = read_other(bytes)?;
    let (size, window) = (image.size(), wanted(image.size()));
    if window == Window::whole(size) {
        return Ok((size, image));
    }
    let part = image.cut(&window).map_err(FormatError::at("image"))?;
    Ok((size, part))
}

/// What is no plain JPEG.
fn read_other(bytes: &[u8]) -> Result<ColorImage, FormatError> {
    let decoder = decoder(bytes, pixels(bytes)?)?;
    let (width, height) = decoder.dimensions();
    let values = match decoder.color_type() {
        ColorType::Rgb8 => {
            let mut values = vec![[0; 3]; width as usize * height as usize];
            let read = decoder.read_image(values.as_flattened_mut());
            read.map_err(undecodable)?;
            values
        }
        _ => {
            let image = DynamicImage::from_decoder(decoder).map_err(undecodable)?;
            image.into_rgb8().into_raw().as_chunks::<3>().0.to_vec()
        }
    };
    Raster::from_values(width, height, values).map_err(FormatError::at("image"))
}

/// Reads a JPEG or PNG as one channel; colours become their luminance.
///
/// # Errors
/// As [`read_color`].
pub fn read_gray(bytes: &[u8]) -> Result<Raster<u8>, FormatError> {
    gray_of(decode(bytes)?)
}

fn gray_of(image: DynamicImage) -> Result<Raster<u8>, FormatError> {
    let gray = image.into_luma8();
    let (width, height) = gray.dimensions();
    Raster::from_values(width, height, gray.into_raw()).map_err(FormatError::at("image"))
}

/// Reads where a mask leaves surface: its opacity; its luminance where it states none or is opaque throughout, as
/// many tools write an alpha channel beside a mask in grey.
///
/// # Errors
/// As [`read_gray`].
pub fn read_cutout(bytes: &[u8]) -> Result<Raster<u8>, FormatError> {
    let image = decode(bytes)?;
    if image.color().has_alpha() {
        let alpha = channel_of(&image.to_rgba8(), 3)?;
        if alpha.values().iter().any(|&level| level < 255) {
            return Ok(alpha);
        }
    }
    gray_of(image)
}

fn channel_of(image: &RgbaImage, place: usize) -> Result<Raster<u8>, FormatError> {
    let (width, height) = image.dimensions();
    let values = image.pixels().map(|pixel| pixel.0[place]).collect();
    Raster::from_values(width, height, values).map_err(FormatError::at("image"))
}

/// One of the numbers of a pixel.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Channel {
    /// Its red.
    Red,
    /// Its green.
    Green,
    /// Its blue.
    Blue,
    /// Its opacity.
    Alpha,
    /// What [`read_gray`] makes of its colours.
    Luminance,
}

/// Reads one channel of a JPEG or PNG; `None` for the opacity of an image that states none.
///
/// # Errors
/// As [`read_gray`].
pub fn read_channel(bytes: &[u8], channel: Channel) -> Result<Option<Raster<u8>>, FormatError> {
    let place = match channel {
        Channel::Red => 0,
        Channel::Green => 1,
        Channel::Blue => 2,
        Channel::Alpha => 3,
        Channel::Luminance => return read_gray(bytes).map(Some),
    };
    let image = decode(bytes)?;
    if channel == Channel::Alpha && !image.color().has_alpha() {
        return Ok(None);
    }
    channel_of(&image.into_rgba8(), place).map(Some)
}

/// The (width, height) that a JPEG or PNG states, without decoding it.
///
/// # Errors
/// Bytes that are no JPEG or PNG, or that end or are wrong before the size is known.
pub fn read_size(bytes: &[u8]) -> Result<(u32, u32), FormatError> {
    let format = format_of(bytes)?;
    let reader = ImageReader::with_format(Cursor::new(bytes), format);
    reader.into_dimensions().map_err(undecodable)
}

/// The EXIF orientation that a JPEG or PNG states, 1 to 8; 1, upright as stored, where it states none.
/// The head of a file is enough.
///
/// # Errors
/// Bytes that are no JPEG or PNG, and a head that cannot be read, unless it is a JPEG's without EXIF.
pub fn read_orientation(bytes: &[u8]) -> Result<u8, FormatError> {
    let format = format_of(bytes)?;
    if format == ImageFormat::Jpeg && !may_have_exif(bytes) {
        return Ok(1);
    }
    let reader = ImageReader::with_format(Cursor::new(bytes), format);
    let mut decoder = reader.into_decoder().map_err(undecodable)?;
    let orientation = decoder.orientation().map_err(undecodable)?;
    Ok(orientation.to_exif())
}

/// Whether a JPEG has EXIF before its first scan, or nothing can be said: the reader copies what it reads.
fn may_have_exif(bytes: &[u8]) -> bool {
    for segment in jpeg::segments(bytes) {
        match segment.marker {
            jpeg::SCAN => return false,
            0xe1 if segment.content.starts_with(b"Exif") => return true,
            _ => {}
        }
    }
    true
}

/// Decodes after checking that the stated size is possible for so few bytes. Plain JPEGs are decoded as
/// [`read_color`] does, which finds damage inside their coded data.
fn decode(bytes: &[u8]) -> Result<DynamicImage, FormatError> {
    if let Some((_, image)) = jpeg::decode(bytes, most_pixels(bytes), Window::whole)? {
        let (width, height) = image.size();
        let levels = image.values().as_flattened().to_vec();
        let image = RgbImage::from_raw(width, height, levels).map(DynamicImage::ImageRgb8);
        return image.ok_or_else(|| FormatError::new("image", "expected all pixels, found fewer"));
    }
    DynamicImage::from_decoder(decoder(bytes, pixels(bytes)?)?).map_err(undecodable)
}

/// The most pixels that so many bytes can hold.
fn most_pixels(bytes: &[u8]) -> u64 {
    MOST_PIXELS.min(MOST_PIXELS_PER_BYTE * bytes.len() as u64)
}

/// The pixels that a JPEG or PNG states, if so few bytes can hold them.
fn pixels(bytes: &[u8]) -> Result<u64, FormatError> {
    let (width, height) = read_size(bytes)?;
    let pixels = u64::from(width) * u64::from(height);
    let most = most_pixels(bytes);
    if pixels > most {
        let problem = format!(
            "expected at most {most} pixels in an image of {} bytes, found {width} x {height}",
            bytes.len()
        );
        return Err(FormatError::new("header", problem));
    }
    Ok(pixels)
}

/// What decodes so many pixels.
fn decoder(bytes: &[u8], pixels: u64) -> Result<impl ImageDecoder, FormatError> {
    let format = format_of(bytes)?;
    // Crate image fills up what is missing; PNG's decoder says so itself.
    if format == ImageFormat::Jpeg {
        jpeg::check_others(bytes)?;
    }
    let mut reader = ImageReader::with_format(Cursor::new(bytes), format);
    let mut limits = Limits::default();
    limits.max_alloc = Some(8 * pixels + (1 << 26));
    reader.limits(limits);
    reader.into_decoder().map_err(undecodable)
}

fn format_of(bytes: &[u8]) -> Result<ImageFormat, FormatError> {
    match ::image::guess_format(bytes) {
        Ok(format @ (ImageFormat::Png | ImageFormat::Jpeg)) => Ok(format),
        _ if bytes.is_empty() => Err(FormatError::new(
            "byte 0",
            "expected a JPEG or PNG, found an empty file",
        )),
        _ => {
            let found = match other_name(bytes) {
                Some(name) => format!("a {name}, which is not read: convert it to PNG or JPEG"),
                None => format!(
                    "a file that starts with {:02x?}",
                    &bytes[..bytes.len().min(4)]
                ),
            };
            let problem = format!("expected a JPEG or PNG, found {found}");
            Err(FormatError::new("byte 0", problem))
        }
    }
}

/// What an image of another format is called, if its first bytes say what it is.
fn other_name(bytes: &[u8]) -> Option<&'static str> {
    match ::image::guess_format(bytes) {
        Ok(ImageFormat::Tiff) => return Some("TIFF"),
        Ok(ImageFormat::Bmp) => return Some("BMP"),
        Ok(ImageFormat::WebP) => return Some("WebP"),
        Ok(ImageFormat::Gif) => return Some("GIF"),
        Ok(ImageFormat::Dds) => return Some("DDS"),
        Ok(ImageFormat::OpenExr) => return Some("OpenEXR"),
        Ok(ImageFormat::Hdr) => return Some("Radiance HDR"),
        _ => {}
    }
    if matches!(
        bytes.get(4..12),
        Some(b"ftypheic" | b"ftypheix" | b"ftypmif1")
    ) {
        return Some("HEIC");
    }
    if bytes.starts_with(b"\xabKTX ") {
        return Some("KTX");
    }
    // A TGA begins with no name, but few bytes may stand where its kind, whether it has a palette and its depth do.
    let is_tga = bytes.len() > 18
        && bytes[1] <= 1
        && matches!(bytes[2], 1..=3 | 9..=11)
        && matches!(bytes[16], 8 | 15 | 16 | 24 | 32);
    is_tga.then_some("TGA")
}

fn undecodable(error: ImageError) -> FormatError {
    let said = error.to_string().replace('\n', " ");
    FormatError::new(
        "image",
        format!("expected a whole JPEG or PNG, found: {said}"),
    )
}

/// Writes an RGB PNG.
///
/// # Errors
/// What writing to `out` brings.
pub fn write_png(out: &mut impl Write, image: &ColorImage) -> std::io::Result<()> {
    let bytes = image.values().as_flattened();
    encode_png(out, bytes, image.size(), ExtendedColorType::Rgb8)
}

/// Writes a one-channel PNG.
///
/// # Errors
/// What writing to `out` brings.
pub fn write_gray_png(out: &mut impl Write, image: &Raster<u8>) -> std::io::Result<()> {
    encode_png(out, image.values(), image.size(), ExtendedColorType::L8)
}

/// Writes a mask as a one-channel PNG of 0 and 255.
///
/// # Errors
/// What writing to `out` brings.
pub fn write_mask_png(out: &mut impl Write, mask: &Mask) -> std::io::Result<()> {
    write_gray_png(out, &mask.map(|&counts| if counts { 255 } else { 0 }))
}

fn encode_png(
    out: &mut impl Write,
    bytes: &[u8],
    (width, height): (u32, u32),
    color: ExtendedColorType,
) -> std::io::Result<()> {
    PngEncoder::new_with_quality(out, CompressionType::Fast, FilterType::Adaptive)
        .write_image(bytes, width, height, color)
        .map_err(|error| match error {
            ImageError::IoError(error) => error,
            other => Error::other(other),
        })
}

/// Writes a baseline JFIF JPEG without EXIF. Sides are at most 65,535 pixels.
///
/// # Errors
/// Longer sides ([`std::io::ErrorKind::InvalidInput`]), and what writing to `out` brings.
pub fn write_jpeg(
    out: &mut impl Write,
    image: &ColorImage,
    options: JpegOptions,
) -> std::io::Result<()> {
    out.write_all(&jpeg::encode(image, None, options)?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn smooth(width: u32, height: u32) -> ColorImage {
        let values = (0..width * height)
            .map(|index| {
                let (x, y) = (f64::from(index % width), f64::from(index / width));
                [x * 0.03, y * 0.05, (x + y) * 0.02]
                    .map(|phase| (127.0 + 100.0 * phase.sin()) as u8)
            })
            .collect();
        Raster::from_values(width, height, values).unwrap()
    }

    fn jpeg(image: &ColorImage, options: JpegOptions) -> Vec<u8> {
        let mut bytes = Vec::new();
        write_jpeg(&mut bytes, image, options).unwrap();
        bytes
    }

    fn worst_difference(a: &ColorImage, b: &ColorImage) -> u8 {
        let pairs = a
            .values()
            .as_flattened()
            .iter()
            .zip(b.values().as_flattened());
        pairs.map(|(x, y)| x.abs_diff(*y)).max().unwrap()
    }

    /// The bytes of the frame header from its sampling factors on: three per component.
    fn components(jpeg: &[u8]) -> &[u8] {
        let frame = jpeg
            .windows(2)
            .position(|pair| pair == [0xff, 0xc0])
            .unwrap();
        &jpeg[frame + 10..frame + 19]
    }

    proptest! {
        #[test]
        fn png_keeps_every_value(
            width in 1u32..9,
            values in proptest::collection::vec(any::<[u8; 3]>(), 1..9),
        ) {
            let height = u32::try_from(values.len()).unwrap();
            let values = values.iter().flat_map(|&v| vec![v; width as usize]).collect();
            let image = Raster::from_values(width, height, values).unwrap();
            let mut bytes = Vec::new();
            write_png(&mut bytes, &image).unwrap();
            prop_assert_eq!(read_size(&bytes).unwrap(), image.size());
            prop_assert_eq!(read_color(&bytes).unwrap(), image);
        }
    }

    /// A mask is refused where its colours would be.
    #[test]
    fn grey_is_what_colours_make_and_damage_is_found() {
        let image = smooth(64, 48);
        let bytes = jpeg(&image, JpegOptions::default());
        let color = read_color(&bytes).unwrap();
        let gray = read_gray(&bytes).unwrap();
        // Within a level, however halves are rounded.
        let luma = |pixel: &[u8; 3]| {
            let [r, g, b] = pixel.map(f64::from);
            0.2126 * r + 0.7152 * g + 0.0722 * b
        };
        let both = gray.values().iter().zip(color.values());
        let off = both.map(|(&level, pixel)| (f64::from(level) - luma(pixel)).abs());
        assert!(off.fold(0.0, f64::max) <= 1.0);
        // The end of the coded data is gone.
        let mut cut = bytes[..bytes.len() * 3 / 4].to_vec();
        cut.extend([0xff, 0xd9]);
        let said = |error: FormatError| error.to_string();
        let expected = read_color(&cut).map_err(said).unwrap_err();
        assert!(
            expected.contains("end early or are damaged at row"),
            "{expected}"
        );
        assert_eq!(read_gray(&cut).map_err(said), Err(expected));
    }

    #[test]
    fn grey_and_masks_keep_their_values() {
        let gray = Raster::from_values(3, 1, vec![0u8, 7, 255]).unwrap();
        let mut bytes = Vec::new();
        write_gray_png(&mut bytes, &gray).unwrap();
        assert_eq!(read_gray(&bytes).unwrap(), gray);
        assert_eq!(read_color(&bytes).unwrap().get(1, 0), [7; 3]);
        let mask = Raster::from_values(2, 1, vec![true, false]).unwrap();
        let mut bytes = Vec::new();
        write_mask_png(&mut bytes, &mask).unwrap();
        assert_eq!(read_gray(&bytes).unwrap().values(), [255, 0]);
    }

    #[test]
    fn images_of_other_formats_are_named() {
        let mut tga = vec![0u8, 0, 2];
        tga.resize(16, 0);
        tga.extend([24, 0, 9, 9, 9]);
        for (bytes, name) in [
            (&b"II*\0\x08\0\0\0"[..], "TIFF"),
            (b"BM\x46\0\0\0\0\0", "BMP"),
            (b"RIFF\x10\0\0\0WEBPVP8 ", "WebP"),
            (b"GIF89a\x01\0", "GIF"),
            (b"\0\0\0\x18ftypheic\0\0", "HEIC"),
            (&tga, "TGA"),
        ] {
            let error = read_size(bytes).unwrap_err().to_string();
            let said = format!("found a {name}, which is not read: convert it to PNG or JPEG");
            assert!(error.ends_with(&said), "{error}");
        }
        let error = read_size(b"hello").unwrap_err().to_string();
        assert!(error.contains("starts with [68, 65, 6c, 6c]"), "{error}");
    }

    #[test]
    fn opacity_is_the_alpha_channel_where_there_is_one() {
        let mut bytes = Vec::new();
        PngEncoder::new(&mut bytes)
            .write_image(&[1, 2, 3, 4, 5, 6, 7, 200], 2, 1, ExtendedColorType::Rgba8)
            .unwrap();
        let channel = |channel| read_channel(&bytes, channel).unwrap().unwrap();
        assert_eq!(channel(Channel::Alpha).values(), [4, 200]);
        assert_eq!(channel(Channel::Red).values(), [1, 5]);
        assert_eq!(channel(Channel::Green).values(), [2, 6]);
        assert_eq!(channel(Channel::Blue).values(), [3, 7]);
        assert_eq!(channel(Channel::Luminance), read_gray(&bytes).unwrap());
        assert_eq!(read_color(&bytes).unwrap().values(), [[1, 2, 3], [5, 6, 7]]);
        let opaque = jpeg(&smooth(4, 3), JpegOptions::default());
        assert_eq!(read_channel(&opaque, Channel::Alpha).unwrap(), None);
        assert!(read_channel(&bytes[..20], Channel::Alpha).is_err());
    }

    #[test]
    fn jpeg_is_jfif_with_the_sampling_asked_for() {
        let image = smooth(67, 45);
        let bytes = jpeg(&image, JpegOptions::default());
        assert_eq!(&bytes[..4], [0xff, 0xd8, 0xff, 0xe0]);
        assert_eq!(&bytes[6..10], b"JFIF");
        assert!(!bytes.windows(4).any(|four| four == b"Exif"));
        assert_eq!([components(&bytes)[1], components(&bytes)[4]], [0x22, 0x11]);
        assert!(worst_difference(&read_color(&bytes).unwrap(), &image) <= 4); // libjpeg: 4
        let full = JpegOptions {
            quality: 100,
            subsample_chroma: false,
        };
        let bytes = jpeg(&image, full);
        assert_eq!([components(&bytes)[1], components(&bytes)[4]], [0x11, 0x11]);
        assert!(worst_difference(&read_color(&bytes).unwrap(), &image) <= 4);
        assert_eq!(read_size(&bytes).unwrap(), (67, 45));
    }

    #[test]
    fn what_is_no_image_gets_one_sentence() {
        let whole = jpeg(&smooth(40, 30), JpegOptions::default());
        let mut png = Vec::new();
        write_png(&mut png, &smooth(40, 30)).unwrap();
        for (bytes, expected) in [
            (&b""[..], "found an empty file"),
            (
                b"no image",
                "found a file that starts with [6e, 6f, 20, 69]",
            ),
            (b"\x00", "found a file that starts with [00]"),
            (&png[..png.len() / 2], "expected a whole JPEG or PNG"),
            (&png[..20], "expected a whole JPEG or PNG"),
            (&whole[..40], "expected a whole JPEG or PNG"),
        ] {
            let error = read_color(bytes).unwrap_err().to_string();
            assert!(error.contains(expected) && !error.contains('\n'), "{error}");
        }
    }

    #[test]
    fn a_size_that_the_bytes_cannot_hold_is_refused_before_allocating() {
        let mut png = Vec::new();
        write_png(&mut png, &smooth(4, 3)).unwrap();
        png[16..20].copy_from_slice(&50_000u32.to_be_bytes());
        png[20..24].copy_from_slice(&50_000u32.to_be_bytes());
        let crc = crc32(&png[12..29]);
        png[29..33].copy_from_slice(&crc.to_be_bytes());
        let error = read_color(&png).unwrap_err().to_string();
        assert!(error.contains("found 50000 x 50000"), "{error}");
    }

    fn crc32(bytes: &[u8]) -> u32 {
        !bytes.iter().fold(!0u32, |crc, &byte| {
            (0..8).fold(crc ^ u32::from(byte), |crc, _| {
                (crc >> 1) ^ (0xedb8_8320 & (0u32.wrapping_sub(crc & 1)))
            })
        })
    }

    /// As the reader of all JPEGs finds it, wherever the note stands before the first scan.
    #[test]
    fn orientations_are_found_behind_other_notes_and_nowhere_else() {
        let mut plain = Vec::new();
        let picture = ColorImage::filled(20, 17, [90; 3]).unwrap();
        write_jpeg(&mut plain, &picture, JpegOptions::default()).unwrap();
        let mut exif = b"\xff\xe1\x00\x22Exif\0\0II*\0\x08\0\0\0\x01\0".to_vec();
        exif.extend(b"\x12\x01\x03\0\x01\0\0\0\x06\0\0\0\0\0\0\0"); // orientation, one u16
        let scan = plain.windows(2).position(|two| two == [0xff, 0xda]);
        let noted = [&b"\xff\xe1\x00\x06XMP\0\xff\xfe\x00\x04hi"[..], &exif].concat();
        assert_eq!(read_orientation(&plain).unwrap(), 1);
        for (at, notes) in [(2, &exif), (2, &noted), (scan.unwrap(), &exif)] {
            let mut turned = plain.clone();
            turned.splice(at..at, notes.iter().copied());
            assert_eq!(read_orientation(&turned).unwrap(), 6, "{at}");
            // Of a head that is too short nothing is said rather than something wrong.
            for length in 0..turned.len() {
                let found = read_orientation(&turned[..length]);
                assert!(
                    found.is_err() || found.is_ok_and(|found| found == 6),
                    "{at} {length}"
                );
            }
        }
        // Behind the scan it is no note.
        let behind = [&plain[..plain.len() - 2], &exif, &plain[plain.len() - 2..]].concat();
        assert_eq!(read_orientation(&behind).unwrap(), 1);
        assert!(!may_have_exif(&plain) && may_have_exif(&plain[..scan.unwrap()]));
    }
}
