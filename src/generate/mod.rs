//! Mesh + cameras + photographs → a BlendedMVS scene.

pub mod augment;
mod choice;
mod fit;
mod leftovers;
mod likeness;
pub(crate) mod masked;
mod order;
mod pairs;
mod photos;
mod plan;
mod range;
mod resample;
mod scene;
mod shard;
mod sparse;
mod undistort;
pub mod verify;
mod view;
pub mod visibility;

pub(crate) use choice::too_far_apart;
pub(crate) use fit::same_shape;
pub use fit::{Fit, covering};
pub(crate) use leftovers::written;
pub(crate) use likeness::{likeness, warning_of_unlike};
pub(crate) use pairs::count_behind;
pub use pairs::{Covisibility, PairOptions};
pub use photos::{PhotoFolder, Photographs};
pub(crate) use photos::{find_named, orientation_in, turned_warning, warning_of_turned};
pub use plan::{mesh_digest, scene_id};
pub use range::{HYPOTHESES, RangeRule, depth_range, kept_by_readers};
pub use resample::resized;
pub use scene::{Generated, Source, Target, generate, generate_sets};
pub use shard::Part;
pub use sparse::sparse_sources;

use crate::blend::BlendOptions;
use crate::error::{Error, Result};
use crate::render::RenderOptions;
use mvs_datasets::layout::mvsnet::PixelCentre;
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;

/// What can be written beside the images, cameras and depths that every reader wants.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Extra {
    /// `input_images/`: the photographs in the render's camera.
    InputImages,
    /// `rendered_images/`: the renderings.
    RenderedImages,
    /// `masks/`: where there is surface.
    Masks,
    /// `normals/`: geometric normals, camera frame.
    Normals,
    /// `occlusion/`: per pair, where the source sees the reference's surface.
    Occlusion,
    /// `interpolated_normals/`: normals interpolated between vertices, camera frame.
    InterpolatedNormals,
    /// `sight/`: what each pixel shows, as [`crate::render::Sight::level`].
    Sight,
    /// `depth_edges/`: where the depth jumps.
    DepthEdges,
    /// `covisibility.npy`: how much of each view's surface each other view sees.
    Covisibility,
    /// `transforms.json`: the cameras as nerfstudio reads them.
    Transforms,
    /// `sparse/0/`: the cameras as a COLMAP text model.
    Colmap,
}

/// Most source views per view that readers of a data set make room for.
pub(crate) const MOST_SOURCES: usize = 10;

/// How a scene is generated. The default is what the BlendedMVS paper and its set do, with the
/// `normalized` blend and the cameras' own image sizes: the set's are 2048 × 1536 and 768 × 576. Some
/// readers want all views of one size, and that of shape 4:3; a scene of another kind has a warning.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct GenerateOptions {
    /// Width and height of all images: photographs are resized to cover it and cut to its centre.
    /// Without it every view keeps its camera's size, of whatever shape.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub size: Option<(u32, u32)>,
    /// How a view's depth range is chosen.
    pub range: RangeRule,
    /// The range is made longer by this fraction of its length at either end.
    pub range_margin: f64,
    /// The pixel centre that the written intrinsics are for.
    #[serde(alias = "pixel_center")]
    pub pixel_centre: PixelCentre,
    /// JPEG quality, 1 to 100.
    pub jpeg_quality: u8,
    /// Chroma at full resolution (4:4:4) instead of half (4:2:0).
    pub full_chroma: bool,
    /// What is written beside the standard files.
    pub extras: BTreeSet<Extra>,
    /// How views are rendered.
    pub render: RenderOptions,
    /// How renderings are blended with photographs.
    pub blend: BlendOptions,
    /// How source views are chosen.
    pub pairs: PairOptions,
}

impl GenerateOptions {
    /// Checks what no view can be made with.
    ///
    /// # Errors
    /// Names the option, what is expected and what was found.
    pub(crate) fn check(&self) -> Result<()> {
        view::check_jpeg_quality(self.jpeg_quality)?;
        self.render.check()?;
        if self.pairs.sources > MOST_SOURCES {
            let problem = format!(
                "expected at most {MOST_SOURCES} source views per view, as readers of the data set make room for, \
                 found {}: `pairs` writes longer lists",
                self.pairs.sources
            );
            return Err(Error::invalid("view selection", problem));
        }
        range::check_margin(self.range_margin)
    }
}

impl Default for GenerateOptions {
    fn default() -> Self {
        Self {
            size: None,
            range: RangeRule::Percentile,
            range_margin: 0.0,
            pixel_centre: PixelCentre::Half,
            jpeg_quality: 95,
            full_chroma: false,
            extras: BTreeSet::new(),
            render: RenderOptions::default(),
            blend: BlendOptions::default(),
            pairs: PairOptions::default(),
        }
    }
}
