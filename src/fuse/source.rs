//! A source view as a reference view needs it.

use super::kernel::Pair;
use super::options::FuseOptions;
use super::rules::disparity_scale;
use super::samples::Samples;
use glam::DVec3;
use mvs_datasets::scene::{ColorImage, View, Window};
use std::ops::Range;
use std::sync::Arc;

/// A source view, ready to be looked at from the reference.
pub(super) struct Source {
    /// The view's number.
    pub(super) number: usize,
    pub(super) pair: Pair,
    pub(super) samples: Arc<Samples>,
    pub(super) image: Option<SourceImage>,
    /// Centre in the world.
    pub(super) center: DVec3,
    /// See [`disparity_scale`].
    pub(super) disparity: f32,
}

/// A source's photograph and its pixels per pixel of the depth map.
pub(super) struct SourceImage {
    pub(super) photo: Arc<Photo>,
    pub(super) scale: [f32; 2],
}

impl SourceImage {
    #[allow(clippy::cast_precision_loss, reason = "image sizes are far below 2^23")]
    pub(super) fn new(photo: Arc<Photo>, samples: &Samples) -> Self {
        let scale = [
            photo.size.0 as f32 / samples.width() as f32,
            photo.size.1 as f32 / samples.height() as f32,
        ];
        Self { photo, scale }
    }
}

/// A photograph, or the part of it that points can ask for.
#[derive(Debug, PartialEq)]
pub(super) struct Photo {
    /// Of the whole.
    pub(super) size: (u32, u32),
    /// Column and row of the part in it.
    pub(super) corner: (u32, u32),
    pub(super) part: ColorImage,
}

/// Pixels around those with depth that are kept: what agrees with a sample lies at most one away.
const MARGIN: u32 = 2;

impl Photo {
    /// Which part points can ask for: of one with the size of its view's depth map what lies around depths,
    /// else all.
    pub(super) fn window(size: (u32, u32), samples: &Samples) -> Window {
        let same = (size.0 as usize, size.1 as usize) == (samples.width(), samples.height());
        match samples.filled() {
            Some((columns, rows)) if same => Window {
                columns: around(columns, size.0),
                rows: around(rows, size.1),
            },
            _ => Window::whole(size),
        }
    }

    /// Of a photograph of this size the part that is its [`Photo::window`].
    pub(super) fn new((size, part): ((u32, u32), ColorImage), samples: &Samples) -> Self {
        let window = Self::window(size, samples);
        let corner = (window.columns.start, window.rows.start);
        Self { size, corner, part }
    }

    /// The place in the part of a pixel of the whole that lies in it.
    pub(super) fn place(&self, (column, row): (usize, usize)) -> usize {
        let (left, top) = (self.corner.0 as usize, self.corner.1 as usize);
        (row - top) * self.part.width() as usize + column - left
    }
}

fn around(filled: Range<u32>, size: u32) -> Range<u32> {
    filled.start.saturating_sub(MARGIN)..(filled.end + MARGIN).min(size)
}

impl Source {
    pub(super) fn new(
        reference: &View,
        (number, view): (usize, &View),
        samples: Arc<Samples>,
        options: &FuseOptions,
    ) -> Self {
        Self {
            number,
            pair: Pair::new(reference, view),
            samples,
            image: None,
            center: view.pose.center_in_world(),
            disparity: disparity_scale(reference, view, options),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fuse::samples::Unit;

    #[test]
    fn of_a_photograph_only_what_lies_around_depths_is_kept() {
        let values: Vec<[u8; 3]> = (0..120u8).map(|at| [at, 1, 2]).collect();
        let image = ColorImage::from_values(12, 10, values).unwrap();
        let mut extents = vec![0..0; 10];
        (extents[4], extents[6]) = (5..7, 4..6);
        let samples = |size: (u32, u32)| {
            let none = vec![0.0; (size.0 * size.1) as usize];
            Samples::new(size, Unit::Depth, &none)
        };
        let narrow = samples((12, 10)).within(extents);
        let of = |samples: &Samples| {
            let part = image.cut(&Photo::window(image.size(), samples));
            Photo::new((image.size(), part.unwrap()), samples)
        };
        let photo = of(&narrow);
        assert_eq!((photo.size, photo.corner), ((12, 10), (2, 2)));
        assert_eq!(photo.part.size(), (7, 7));
        for (column, row) in [(2u32, 2u32), (8, 8), (5, 4)] {
            let found = photo.part.values()[photo.place((column as usize, row as usize))];
            assert_eq!(found, image.get(column, row));
        }
        let nothing = samples((12, 10)).within(vec![0..0; 10]);
        for samples in [samples((12, 10)), nothing, samples((6, 5))] {
            let photo = of(&samples);
            assert_eq!((photo.corner, &photo.part), ((0, 0), &image));
        }
    }
}
