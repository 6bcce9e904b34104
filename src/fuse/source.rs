//! A source view as a reference view needs it.

use super::kernel::Pair;
use super::options::FuseOptions;
use super::rules::disparity_scale;
use super::samples::Samples;
use glam::DVec3;
use mvs_datasets::scene::{ColorImage, View};
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
    pub(super) image: Arc<ColorImage>,
    pub(super) scale: [f32; 2],
}

impl SourceImage {
    #[allow(clippy::cast_precision_loss, reason = "image sizes are far below 2^23")]
    pub(super) fn new(image: Arc<ColorImage>, samples: &Samples) -> Self {
        let scale = [
            image.width() as f32 / samples.width() as f32,
            image.height() as f32 / samples.height() as f32,
        ];
        Self { image, scale }
    }
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
