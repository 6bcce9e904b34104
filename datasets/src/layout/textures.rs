//! Texture images: each read once, all in parallel, within a bound of memory.

use super::files::read_with;
use super::materials::Draft;
use super::mesh::ReadOptions;
use crate::error::{Error, FormatError, Result};
use crate::format::image::{self, Channel};
use crate::parallel;
use crate::scene::{ColorImage, Cutout, Material, Raster, srgb};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// What of an image is used.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Use {
    /// Its colours.
    Color,
    /// Its colours, each multiplied in linear light by a factor in units of 2⁻¹⁶.
    Scaled([u32; 3]),
    /// Its alpha channel; an image without one is solid.
    Opacity,
    /// The channel that is asked for; else its alpha channel, or its brightness where that is opaque throughout.
    Mask(Option<Channel>),
}

impl Use {
    /// Colours multiplied by `factor`, linear.
    pub(super) fn scaled(factor: [f64; 3]) -> Self {
        #[allow(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "clamped to 0 … 2^16"
        )]
        let units = factor.map(|part| (part.clamp(0.0, 1.0) * 65536.0).round() as u32);
        match units {
            [65536, 65536, 65536] => Self::Color,
            units => Self::Scaled(units),
        }
    }

    /// What shows where there is no such image.
    pub(super) fn instead(self) -> &'static str {
        match self {
            Self::Color | Self::Scaled(_) => {
                "the colors of its vertices are shown, or, where there are none, its material's"
            }
            Self::Opacity | Self::Mask(_) => "nothing is cut out of the surface",
        }
    }

    /// Bytes per pixel once read.
    fn bytes(self) -> u64 {
        match self {
            Self::Color | Self::Scaled(_) => 3,
            Self::Opacity | Self::Mask(_) => 1,
        }
    }
}

/// Images that materials asked for, numbered in the order in which they were.
#[derive(Debug, Default)]
pub(super) struct Textures {
    numbers: BTreeMap<(PathBuf, Use), usize>,
    wanted: Vec<Wanted>,
}

#[derive(Debug)]
struct Wanted {
    /// A file, or what to call `bytes`.
    path: PathBuf,
    bytes: Option<Arc<[u8]>>,
    used: Use,
}

impl Wanted {
    fn with_bytes<T>(&self, read: impl FnOnce(&[u8]) -> Result<T, FormatError>) -> Result<T> {
        match &self.bytes {
            Some(bytes) => read(bytes).map_err(Error::in_file(&self.path)),
            None => read_with(&self.path, read),
        }
    }

    /// Bytes that the image takes once read; 0 for what cannot be read.
    fn cost(&self) -> u64 {
        let size = self.with_bytes(image::read_size);
        size.map_or(0, |(width, height)| {
            u64::from(width) * u64::from(height) * self.used.bytes()
        })
    }

    fn read(&self) -> Result<Image> {
        self.with_bytes(|bytes| match self.used {
            Use::Color => Ok(Image::Color(Arc::new(image::read_color(bytes)?))),
            Use::Scaled(factor) => {
                let color = scaled(image::read_color(bytes)?, factor);
                Ok(Image::Color(Arc::new(color)))
            }
            Use::Opacity => Ok(image::read_channel(bytes, Channel::Alpha)?
                .map_or(Image::Solid, |alpha| Image::Opacity(Arc::new(alpha)))),
            Use::Mask(channel) => Ok(Image::Opacity(Arc::new(read_mask(bytes, channel)?))),
        })
    }
}

/// Where there is surface: by `channel`, else as [`image::read_cutout`] has it.
fn read_mask(bytes: &[u8], channel: Option<Channel>) -> Result<Raster<u8>, FormatError> {
    if let Some(channel) = channel {
        return image::read_channel(bytes, channel)?.ok_or_else(|| {
            let problem = "expected an alpha channel, for which -imfchan m asks, found none";
            FormatError::new("image", problem)
        });
    }
    image::read_cutout(bytes)
}

enum Image {
    Color(Arc<ColorImage>),
    Opacity(Arc<Raster<u8>>),
    Solid,
}

/// Images by their number; `None` where one could not be read.
pub(super) struct Images(Vec<Option<Image>>);

impl Textures {
    /// The number of the image at `path`, or of the `bytes` that are called so.
    pub(super) fn add(&mut self, path: PathBuf, bytes: Option<&[u8]>, used: Use) -> usize {
        let next = self.wanted.len();
        let number = *self.numbers.entry((path.clone(), used)).or_insert(next);
        if number == next {
            self.wanted.push(Wanted {
                path,
                bytes: bytes.map(Arc::from),
                used,
            });
        }
        number
    }

    /// Reads all images, several at a time. One that cannot be read is noted. Refuses, before any is
    /// read, images that would take more memory than allowed.
    pub(super) fn read(&self, options: &ReadOptions, notes: &mut Vec<String>) -> Result<Images> {
        let costs: Vec<u64> = self.wanted.iter().map(Wanted::cost).collect();
        let total: u64 = costs.iter().sum();
        if total > options.texture_bytes {
            let largest = (0..costs.len()).max_by_key(|&number| costs[number]);
            let path = largest.map_or(Path::new(""), |number| &self.wanted[number].path);
            let problem = format!(
                "expected textures of at most {} MiB once decoded, found {} textures of {} MiB, of \
                 which this is the largest: make them smaller, or allow more (render, generate and pairs \
                 have --texture-memory)",
                options.texture_bytes >> 20,
                costs.len(),
                total.div_ceil(1 << 20)
            );
            return Err(Error::layout(path, problem));
        }
        let read = parallel::map(&self.wanted, options.threads, Wanted::read);
        let images = read.into_iter().zip(&self.wanted).map(|(image, wanted)| {
            let note = |error| notes.push(format!("{error}; {}", wanted.used.instead()));
            image.map_err(note).ok()
        });
        Ok(Images(images.collect()))
    }
}

impl Images {
    /// The material with its textures.
    pub(super) fn finish(&self, draft: Draft) -> Material {
        let image = |number: usize| self.0.get(number).and_then(Option::as_ref);
        let mut material = draft.material;
        if let Some(Image::Color(color)) = draft.texture.and_then(image) {
            material.texture = Some(Arc::clone(color));
        }
        if let Some((number, cutoff)) = draft.opacity
            && let Some(Image::Opacity(opacity)) = image(number)
        {
            #[allow(clippy::cast_possible_truncation, reason = "in 8-bit units")]
            let cutoff = (255.0 * cutoff) as f32;
            let opacity = Arc::clone(opacity);
            material.cutout = Some(Cutout { opacity, cutoff });
        }
        material
    }
}

/// The image with each channel multiplied in linear light.
fn scaled(mut image: ColorImage, factor: [u32; 3]) -> ColorImage {
    let tables = factor.map(|factor| {
        let factor = f64::from(factor) / 65536.0;
        std::array::from_fn::<u8, 256, _>(|level| {
            let light = srgb::linear(level as f64 / 255.0);
            crate::format::gltf::byte_of_linear(light * factor)
        })
    });
    for pixel in image.values_mut() {
        *pixel = std::array::from_fn(|channel| tables[channel][usize::from(pixel[channel])]);
    }
    image
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_factor_of_one_keeps_every_level_and_half_is_half_the_light() {
        let levels = (0..=255u8).map(|level| [level; 3]).collect();
        let ramp = Raster::from_values(256, 1, levels).unwrap();
        assert_eq!(scaled(ramp.clone(), [65536; 3]), ramp);
        let half = scaled(ramp, [32768; 3]);
        // sRGB 188 is half the light of white.
        assert_eq!(half.get(255, 0), [188; 3]);
        assert_eq!(Use::scaled([1.0; 3]), Use::Color);
    }
}
