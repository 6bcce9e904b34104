use super::common::{Centre, Global, Verdict, with_context};
use super::output::{answer, pairs};
use clap::Args;
use mvs_eval::config;
use mvs_eval::fuse::presets;
use mvs_eval::jobs::fuse::{self, FuseJob};
use serde::Serialize;
use std::path::PathBuf;

/// Fuse depth maps into a point cloud, keeping what several views agree on
///
/// Reads SCENE/cams (or SCENE itself) and pair.txt, and colours the points from
/// SCENE/{blended_images,images,color} where there are images. Depth maps may be smaller than the
/// images: intrinsics are scaled to them.
///
/// Example: mvs-eval fuse scene --depths estimates --confidence estimates/conf --out cloud.ply
#[derive(Debug, Args, Serialize)]
pub(crate) struct FuseArgs {
    /// The scene's folder
    scene: Option<PathBuf>,
    /// The folder of estimated depth maps, <id>.pfm (z-depth, 0 = none)
    #[arg(long, value_name = "DIR")]
    depths: Option<PathBuf>,
    /// The folder of confidence maps, <id>.pfm
    #[arg(long, value_name = "DIR")]
    confidence: Option<PathBuf>,
    /// The PLY to write
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// The folder of masks, <id>.png of the depth maps' size: pixels below 128 are left out
    #[arg(long, value_name = "DIR")]
    masks: Option<PathBuf>,
    /// Leave out points outside of this polygon crop volume (JSON, in the scene's frame)
    #[arg(long, value_name = "FILE")]
    crop: Option<PathBuf>,
    /// Named set of options: blendedmvs, dtu, eth3d, tnt-advanced, tnt-intermediate
    #[arg(long, value_name = "NAME")]
    #[serde(skip)]
    preset: Option<String>,
    /// Where the cams put the centre of the top-left pixel: at (0.5, 0.5) or at (0, 0)
    #[arg(long, value_enum)]
    pixel_center: Option<Centre>,
    #[command(flatten)]
    fuse: FuseFlags,
}

#[derive(Debug, Args, Serialize)]
pub(crate) struct FuseFlags {
    /// Procedure: hkust (default), geo, dynamic, gipuma, cluster
    #[arg(long, value_name = "NAME")]
    mode: Option<String>,
    /// hkust's first pass: median (default), merrell-confidence, merrell-stability, none
    #[arg(long, value_name = "NAME")]
    visibility: Option<String>,
    /// Sampling of source depth maps: valid or plain
    #[arg(long, value_name = "NAME")]
    sampling: Option<String>,
    /// Leave out this fraction of each view's pixels, the least confident, instead of a threshold
    #[arg(long, value_name = "Q")]
    confidence_quantile: Option<f64>,
    /// Largest number of source views per reference view; 0 for all
    #[arg(long, value_name = "N")]
    max_sources: Option<usize>,
    /// Smallest confidence
    #[arg(long, value_name = "C")]
    min_confidence: Option<f32>,
    /// Largest reprojection error in pixels
    #[arg(long, value_name = "PX")]
    max_pixel_error: Option<f64>,
    /// Largest relative depth error
    #[arg(long, value_name = "R")]
    max_depth_error: Option<f64>,
    /// Source views that must agree, the reference view not counted
    #[arg(long, value_name = "N")]
    min_sources: Option<usize>,
}

pub(crate) fn run(args: &FuseArgs, global: &Global) -> anyhow::Result<Verdict> {
    execute(&job(args, global)?, global)
}

/// The mode's options, overridden by the preset's, the file's, the flags'.
fn job(args: &FuseArgs, global: &Global) -> anyhow::Result<FuseJob> {
    let flags = config::layer_of(args)?;
    let file = match &global.config {
        Some(path) => config::read_layer(path, "fuse")?,
        None => toml::Table::new(),
    };
    let preset = match &args.preset {
        Some(name) => presets::preset_layer(name, scene_name(args))?,
        None => toml::Table::new(),
    };
    let said = [&flags, &file].into_iter().find_map(|layer| {
        let mode = layer.get("fuse")?.get("mode")?;
        mode.as_str().map(str::to_owned)
    });
    let mode = presets::mode_layer(said.as_deref().unwrap_or("hkust"))?;
    let fuse = |options| toml::Table::from_iter([("fuse".to_owned(), toml::Value::Table(options))]);
    Ok(config::resolve([fuse(mode), fuse(preset), file, flags])?)
}

/// The scene folder's name, by which presets know it.
fn scene_name(args: &FuseArgs) -> &str {
    let name = args.scene.as_deref().and_then(std::path::Path::file_name);
    name.and_then(std::ffi::OsStr::to_str).unwrap_or_default()
}

pub(crate) fn execute(job: &FuseJob, global: &Global) -> anyhow::Result<Verdict> {
    let outcome = with_context(global, |context| fuse::run(job, context))?;
    let counts = outcome.counts;
    let outside = counts.outside + counts.masked + counts.out_of_range;
    answer(global.format, &outcome, || {
        pairs(&[
            ("views", outcome.views.to_string()),
            ("points", outcome.points.to_string()),
            ("pixels", counts.pixels.to_string()),
            ("without a depth", counts.empty.to_string()),
            (
                "below the confidence threshold",
                counts.unconfident.to_string(),
            ),
            ("too few views agree", counts.inconsistent.to_string()),
            ("contradicted", counts.contradicted.to_string()),
            ("merged", counts.merged.to_string()),
            ("outside, masked or out of range", outside.to_string()),
        ])
    })?;
    Ok(Verdict::Passed)
}
