use super::common::{Centre, Global, Verdict, resolve, with_context};
use super::output::{answer, pairs};
use clap::Args;
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
    /// Where the cams put the centre of the top-left pixel: at (0.5, 0.5) or at (0, 0)
    #[arg(long, value_enum)]
    pixel_center: Option<Centre>,
    #[command(flatten)]
    fuse: FuseFlags,
}

#[derive(Debug, Args, Serialize)]
pub(crate) struct FuseFlags {
    /// Largest number of source views per reference view
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
    execute(&resolve("fuse", args, global)?, global)
}

pub(crate) fn execute(job: &FuseJob, global: &Global) -> anyhow::Result<Verdict> {
    let outcome = with_context(global, |context| fuse::run(job, context))?;
    let counts = outcome.counts;
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
        ])
    })?;
    Ok(Verdict::Passed)
}
