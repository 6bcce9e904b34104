use super::common::{self, Centre, Global, Verdict, resolve, with_context};
use super::output::{answer, table};
use clap::Args;
use mvs_eval::config::Size;
use mvs_eval::jobs::tradeoff::{self, TradeoffJob, sentences};
use serde::Serialize;
use serde_json::json;
use std::path::PathBuf;

/// Measure what the knobs of each stage cost and what they change
///
/// Runs a grid of settings and writes tradeoff.csv (CPU time with its spread, peak memory, result, difference
/// from the exact setting, error and Pareto front), tradeoff.svg and tradeoff.md (a sentence per knob).
/// The error is 1 - F for fused clouds, elsewhere the difference, with the ± of a sample on top. On the front are
/// settings that no other beats in both: times within each other's spread are the same.
/// A stage is measured where its inputs are given; those of all stages are read before the first is
/// measured. Fusing that keeps no point has F = 0. Peak memory is the whole process's, with the inputs and
/// what earlier settings left with it: a setting that needs less than that shows no less. Scoring thins
/// queries only, never clouds. Run it
/// on a quiet machine: times are measurements.
///
/// Example: mvs-eval tradeoff --truth truth.ply --reconstruction cloud.ply --tau 0.01 --out tradeoff
#[derive(Debug, Args, Serialize)]
pub(crate) struct TradeoffArgs {
    /// Scoring: the truth, a PLY cloud; or a PLY, OBJ, GLB or glTF mesh, sampled by area as by score
    #[arg(long, value_name = "FILE")]
    truth: Option<PathBuf>,
    /// Scoring: the reconstruction, a cloud or a mesh as the truth
    #[arg(long, value_name = "FILE")]
    reconstruction: Option<PathBuf>,
    /// Scoring: a 4x4 text file, reconstruction frame to truth frame
    #[arg(long, value_name = "TXT")]
    transform: Option<PathBuf>,
    /// Scoring: a polygon crop volume (JSON)
    #[arg(long, value_name = "JSON")]
    crop: Option<PathBuf>,
    /// Tolerance in world units, for scoring and for fused clouds (default 0.01)
    #[arg(long)]
    tau: Option<f64>,
    /// Fusion: the folder with cams and pairs
    #[arg(long, value_name = "DIR")]
    scene: Option<PathBuf>,
    /// Fusion: the folder of depth maps
    #[arg(long, value_name = "DIR")]
    depths: Option<PathBuf>,
    /// Fusion: the folder of confidence maps
    #[arg(long, value_name = "DIR")]
    confidence: Option<PathBuf>,
    /// Fusion: the image size that the cams of --scene are for; by default that of a view's image or depth map,
    /// whichever goes with the principal point
    #[arg(long, value_name = "WxH")]
    camera_size: Option<Size>,
    /// Fusion: leave out pixels below this confidence
    #[arg(long)]
    min_confidence: Option<f64>,
    /// Fusion: the cloud or mesh that fused clouds are scored against; by default the cloud of all sources
    #[arg(long, value_name = "FILE")]
    fuse_truth: Option<PathBuf>,
    /// Rendering: mesh files or folders of them
    #[arg(long, num_args = 1.., value_name = "PATH")]
    #[serde(skip_serializing_if = "Vec::is_empty")]
    mesh: Vec<PathBuf>,
    /// Rendering: cameras in any known form
    #[arg(long, value_name = "PATH")]
    cameras: Option<PathBuf>,
    /// Rendering: the size of the images, as for `render`
    #[arg(long, value_name = "WxH")]
    size: Option<Size>,
    /// Blending: a scene folder that was generated with --extras input-images,rendered-images
    #[arg(long, value_name = "DIR")]
    dataset: Option<PathBuf>,
    /// Where the cams put the centre of the top-left pixel
    #[arg(long, value_enum)]
    pixel_center: Option<Centre>,
    /// Rendering and blending: at most so many views (default 3)
    #[arg(long)]
    views: Option<u32>,
    /// Run every setting in so many stretches of a tenth of a second or more; the median counts (default 3)
    #[arg(long)]
    repeats: Option<u32>,
    /// Seed of the queries, and of the points of meshes, that are drawn (default 0)
    #[arg(long, value_name = "N", value_parser = common::seed)]
    seed: Option<u64>,
    /// The folder to write
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
}

pub(crate) fn run(args: &TradeoffArgs, global: &Global) -> anyhow::Result<Verdict> {
    execute(&resolve("tradeoff", args, global)?, global)
}

pub(crate) fn execute(job: &TradeoffJob, global: &Global) -> anyhow::Result<Verdict> {
    let rows = with_context(global, |context| tradeoff::run(job, context))?;
    let value = json!({ "out": job.out, "settings": rows.len(), "sentences": sentences(&rows) });
    answer(global.format, &value, || {
        let mut shown = table(&[
            "stage", "knob", "setting", "CPU s", "MiB", "value", "Δ", "front",
        ]);
        for row in &rows {
            shown.add_row([
                row.stage.to_owned(),
                row.knob.clone(),
                row.setting.clone(),
                format!("{:.3}", row.seconds),
                row.peak_mib
                    .map(|mib| format!("{mib:.0}"))
                    .unwrap_or_default(),
                format!("{:.5}", row.value),
                format!("{:+.5}", row.difference),
                if row.front { "*" } else { "" }.to_owned(),
            ]);
        }
        shown
    })?;
    Ok(Verdict::Passed)
}
