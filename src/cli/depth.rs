use super::common::{Global, Left, Verdict, resolve, with_context_leaving};
use super::output::{answer, table};
use clap::Args;
use mvs_eval::jobs::depth::{self, DepthJob};
use mvs_eval::score::depth::DepthScores;
use serde::Serialize;
use std::path::PathBuf;

/// Compare estimated depth maps with a scene's true ones
///
/// Errors in depth intervals (EPE, above 1, above 3; an error of exactly the limit counted as good
/// and as bad), absolute and relative, inliers at 1.03, density, and the area under the
/// sparsification error where there is confidence; per view and for the scene. Views without a depth
/// map, or whose map has no depth where the truth counts, count as density 0, make the means partial and
/// the exit code 1; so does a truth that counts nowhere. Views whose truth counts nowhere (no-truth in depth.csv)
/// are told of, and are in no mean.
///
/// Example: mvs-eval depth --truth scene --estimates estimates --out depth
#[derive(Debug, Args, Serialize)]
pub(crate) struct DepthArgs {
    /// The scene with the truth: cams/ and rendered_depth_maps/
    #[arg(long, value_name = "SCENE")]
    truth: Option<PathBuf>,
    /// The folder of estimated depth maps, <id>.pfm (z-depth, 0 = none); may be smaller
    #[arg(long, value_name = "DIR")]
    estimates: Option<PathBuf>,
    /// The folder of confidence maps, <id>.pfm (larger is surer)
    #[arg(long, value_name = "DIR")]
    confidence: Option<PathBuf>,
    /// Depth intervals in each view's range (default 128)
    #[arg(long, value_name = "D")]
    planes: Option<u32>,
    /// Bring estimates to the truth's scale, per view: none (default), median-ratio, least-squares
    #[arg(long, value_name = "HOW")]
    alignment: Option<String>,
    /// A folder for depth.csv, depth.json and errors/<id>.png
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
}

pub(crate) fn run(args: &DepthArgs, global: &Global) -> anyhow::Result<Verdict> {
    execute(&resolve("depth", args, global)?, global)
}

pub(crate) fn execute(job: &DepthJob, global: &Global) -> anyhow::Result<Verdict> {
    let left = match job.out {
        Some(_) => Left::Files,
        None => Left::Nothing,
    };
    let outcome = with_context_leaving(left, global, |context| depth::run(job, context))?;
    answer(global.format, &outcome, || {
        let mut header = vec!["view"];
        header.extend(DepthScores::NAMES);
        let mut table = table(&header);
        let mut add = |name: String, scores: &DepthScores| {
            let text = |value: Option<f64>| value.map_or("–".to_owned(), |v| format!("{v:.4}"));
            table.add_row(std::iter::once(name).chain(scores.values().map(text)));
        };
        for row in &outcome.views {
            let mark = match depth::status_of(row) {
                "compared" => String::new(),
                status => format!(" ({})", status.replace('-', " ")),
            };
            add(format!("{}{mark}", row.view), &row.scores);
        }
        let scene = &outcome.scene;
        let mark = if scene.partial { "partial " } else { "" };
        add(format!("{mark}mean over views"), &scene.mean_over_views);
        add(format!("{mark}mean over pixels"), &scene.mean_over_pixels);
        table
    })?;
    let scene = &outcome.scene;
    let nothing = scene.mean_over_views.epe.is_none();
    Ok(Verdict::failed_if(scene.partial || nothing))
}
