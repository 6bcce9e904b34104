//! Mesh + cameras + photographs → a BlendedMVS scene.

pub mod augment;
mod fit;
mod masked;
mod pairs;
mod photos;
mod plan;
mod range;
mod resample;
mod sparse;
pub mod verify;
mod view;
pub mod visibility;

pub use fit::Fit;
pub use pairs::{Covisibility, PairOptions};
pub use photos::{PhotoFolder, Photographs};
pub use plan::{mesh_digest, scene_id};
pub use range::{HYPOTHESES, RangeRule, depth_range, kept_by_readers};
pub use resample::resized;
pub use sparse::sparse_sources;

use crate::blend::BlendOptions;
use crate::error::{Error, Result};
use crate::parallel;
use crate::progress::Progress;
use crate::render::{RenderOptions, Renderer};
use crate::warning::Warnings;
use mvs_datasets::format::npy;
use mvs_datasets::layout::blended::BlendedFolder;
use mvs_datasets::layout::blended::record::{self, LeftOut, SceneFile, ViewRecord};
use mvs_datasets::layout::files;
use mvs_datasets::layout::mvsnet::{self, PixelCentre};
use mvs_datasets::scene::{Mesh, Scene, SourceScore, View};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};

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
    /// `depth_edges/`: where the depth jumps.
    DepthEdges,
    /// `covisibility.npy`: how much of each view's surface each other view sees.
    Covisibility,
}

/// How a scene is generated. The default is what the BlendedMVS paper and its set do, with the
/// `normalized` blend.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct GenerateOptions {
    /// Width and height of all images: photographs are resized to cover it and cut to its centre.
    /// Without it every view keeps its camera's size.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub size: Option<(u32, u32)>,
    /// How a view's depth range is chosen.
    pub range: RangeRule,
    /// The range is made longer by this fraction of its length at either end.
    pub range_margin: f64,
    /// The pixel centre that the written intrinsics are for.
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

/// What a scene is generated from.
#[derive(Clone, Copy)]
pub struct Source<'a> {
    /// The scene's name.
    pub name: &'a str,
    /// The name of its folder, as [`scene_id`] makes it from the name.
    pub id: &'a str,
    /// The textured surface.
    pub mesh: &'a Mesh,
    /// The cameras, as they took the photographs.
    pub views: &'a [View],
    /// The photographs.
    pub photographs: &'a dyn Photographs,
}

/// Views, fitted to the wanted size, that belong into the scene, and their source views.
#[derive(Debug)]
struct Plan {
    digest: String,
    /// (as given, fitted).
    views: Vec<(View, View)>,
    sources: Vec<Vec<SourceScore>>,
    left_out: Vec<LeftOut>,
    covisibility: Vec<f32>,
}

impl Plan {
    /// The views whose sight of the view at `index` is written with it: its sources, if occlusion
    /// is asked for.
    fn watchers(&self, index: usize, options: &GenerateOptions) -> Vec<View> {
        if !options.extras.contains(&Extra::Occlusion) {
            return Vec::new();
        }
        let view_of = |source: &SourceScore| {
            let found = self.views.iter().find(|(given, _)| given.id == source.id)?;
            Some(found.1.clone())
        };
        self.sources[index].iter().filter_map(view_of).collect()
    }
}

/// Generates the scene in `folder`. Views that are there already, made from the same inputs with
/// the same options, are kept. `scene.json` is written last: a folder without it is not finished.
pub fn generate(
    source: &Source<'_>,
    folder: &BlendedFolder,
    options: &GenerateOptions,
    progress: &dyn Progress,
    warnings: &Warnings,
) -> Result<SceneFile> {
    view::check_jpeg_quality(options.jpeg_quality)?;
    let renderer = Renderer::new(source.mesh)?;
    let plan = plan_scene(source, &renderer, options, progress)?;
    for left_out in &plan.left_out {
        let message = format!("view {} is left out: {}", left_out.id, left_out.reason);
        warnings.add("view-left-out", message);
    }
    progress.begin("generating views", plan.views.len() as u64);
    let work = view::ViewWork {
        source,
        renderer: &renderer,
        folder,
        options,
        scene_digest: &plan.digest,
    };
    let records = parallel::try_map(plan.views.len(), |index| {
        progress.check()?;
        let (given, fitted) = &plan.views[index];
        let record = work.finish(given, fitted, &plan.watchers(index, options))?;
        progress.advance(1);
        Ok(record)
    })?;
    for (code, message) in records.iter().flat_map(|record| &record.warnings) {
        warnings.add(code, message.clone());
    }
    finish_scene(source, folder, options, plan, records, warnings)
}

/// Chooses the views and their sources.
fn plan_scene(
    source: &Source<'_>,
    renderer: &Renderer,
    options: &GenerateOptions,
    progress: &dyn Progress,
) -> Result<Plan> {
    let fit = |view: &View| Ok(Fit::new(&view.camera, options.size)?.view(view));
    let fitted = source.views.iter().map(fit).collect::<Result<Vec<_>>>()?;
    let covisibility =
        Covisibility::measure((renderer, source.mesh), &fitted, &options.pairs, progress)?;
    let mut sources = covisibility.sources(&fitted, options.pairs.sources);
    let kept: Vec<usize> = (0..fitted.len())
        .filter(|&i| !sources[i].is_empty())
        .collect();
    if kept.is_empty() {
        let problem = format!(
            "expected at least two views that see the same surface, found none among {}; are mesh \
             and cameras in the same frame, and poses world-to-camera?",
            fitted.len()
        );
        return Err(Error::invalid("views", problem));
    }
    let leave_out = |index: usize| LeftOut {
        id: fitted[index].id,
        reason: "no other view sees the surface that it sees".to_owned(),
    };
    let dropped = (0..fitted.len()).filter(|&i| sources[i].is_empty());
    Ok(Plan {
        digest: plan::scene_digest(source.mesh, options)?,
        left_out: dropped.map(leave_out).collect(),
        covisibility: kept
            .iter()
            .flat_map(|&row| kept.iter().map(move |&column| (row, column)))
            .map(|(row, column)| covisibility.shared()[row * fitted.len() + column])
            .collect(),
        views: kept
            .iter()
            .map(|&i| (source.views[i].clone(), fitted[i].clone()))
            .collect(),
        sources: kept
            .iter()
            .map(|&i| std::mem::take(&mut sources[i]))
            .collect(),
    })
}

/// Writes what belongs to the scene as a whole.
fn finish_scene(
    source: &Source<'_>,
    folder: &BlendedFolder,
    options: &GenerateOptions,
    plan: Plan,
    records: Vec<ViewRecord>,
    warnings: &Warnings,
) -> Result<SceneFile> {
    let count = plan.views.len();
    let views = plan.views.into_iter().map(|(_, fitted)| fitted).collect();
    let scene = Scene::new(views)?.with_sources(plan.sources)?;
    mvsnet::write_pairs(&folder.pairs(), &scene)?;
    if options.extras.contains(&Extra::Covisibility) {
        files::write_atomically(&folder.covisibility(), |out| {
            npy::write_f32(out, (count, count), &plan.covisibility)
        })?;
    }
    view::remove_leftovers(folder, &records)?;
    let digests: Vec<&str> = records.iter().map(|record| record.plan.as_str()).collect();
    let scene_file = SceneFile {
        version: 1,
        id: source.id.to_owned(),
        name: source.name.to_owned(),
        pixel_centre: options.pixel_centre,
        conventions: conventions(options),
        options: serde_json::to_value(options)
            .map_err(|error| Error::invalid("options", error.to_string()))?,
        plan: plan::digest_of(&digests)?,
        left_out: plan.left_out,
        warnings: warnings
            .sorted()
            .into_iter()
            .map(|warning| (warning.code, warning.message))
            .collect(),
        views: records,
    };
    record::write_json(&folder.record(), &scene_file)?;
    Ok(scene_file)
}

/// The conventions of the written files, in words.
fn conventions(options: &GenerateOptions) -> BTreeMap<String, String> {
    let centre = match options.pixel_centre {
        PixelCentre::Half => "the centre of the top-left pixel is at (0.5, 0.5)",
        PixelCentre::Integer => "the centre of the top-left pixel is at (0, 0)",
    };
    let texts = [
        ("pixels", centre),
        (
            "extrinsic",
            "world to camera; +X right, +Y down, +Z forward",
        ),
        (
            "depth",
            "along the camera's +Z axis, world units, at pixel centres; 0 = none",
        ),
        (
            "depth_range",
            "minimum, interval = (maximum - minimum) / 128, 128, maximum",
        ),
        (
            "normals",
            "camera frame, facing the camera, unit length; 0 = none",
        ),
        ("mask", "255 where there is rendered surface"),
        (
            "occlusion",
            "0 = no surface or outside the source, 128 = occluded, 255 = visible",
        ),
        ("images", "8-bit sRGB"),
        (
            "covisibility",
            "row = reference: fraction of its surface that the column's view sees",
        ),
    ];
    let owned = |(topic, text): (&str, &str)| (topic.to_owned(), text.to_owned());
    texts.into_iter().map(owned).collect()
}
