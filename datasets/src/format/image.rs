//! JPEG and PNG. Values are 8-bit sRGB, kept as they are.

use crate::error::FormatError;
use crate::scene::{ColorImage, Mask, Raster};
use std::io::Write;

/// How a JPEG is encoded.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct JpegOptions {
    /// 1 to 100.
    pub quality: u8,
    /// Chroma at half resolution (4:2:0) rather than full (4:4:4).
    pub subsample_chroma: bool,
}

impl Default for JpegOptions {
    /// Quality 95, 4:2:0: what BlendedMVS has.
    fn default() -> Self {
        Self {
            quality: 95,
            subsample_chroma: true,
        }
    }
}

/// Reads a JPEG or PNG (told apart by content) as RGB; alpha is dropped, grey is spread.
pub fn read_color(_bytes: &[u8]) -> Result<ColorImage, FormatError> {
    todo!()
}

/// Reads a JPEG or PNG as one channel.
pub fn read_gray(_bytes: &[u8]) -> Result<Raster<u8>, FormatError> {
    todo!()
}

/// The (width, height) that a JPEG or PNG states, without decoding it.
pub fn read_size(_bytes: &[u8]) -> Result<(u32, u32), FormatError> {
    todo!()
}

/// Writes an RGB PNG.
pub fn write_png(_out: &mut impl Write, _image: &ColorImage) -> std::io::Result<()> {
    todo!()
}

/// Writes a one-channel PNG.
pub fn write_gray_png(_out: &mut impl Write, _image: &Raster<u8>) -> std::io::Result<()> {
    todo!()
}

/// Writes a mask as a one-channel PNG of 0 and 255.
pub fn write_mask_png(_out: &mut impl Write, _mask: &Mask) -> std::io::Result<()> {
    todo!()
}

/// Writes a baseline JFIF JPEG without EXIF.
pub fn write_jpeg(
    _out: &mut impl Write,
    _image: &ColorImage,
    _options: JpegOptions,
) -> std::io::Result<()> {
    todo!()
}
