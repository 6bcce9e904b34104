use super::common::{self, Global, Left, Verdict, resolve, with_context_leaving};
use super::output::{answer, say, table};
use clap::Args;
use mvs_eval::config::Size;
use mvs_eval::jobs::demo::{self, DemoJob};
use serde::Serialize;
use std::path::PathBuf;

/// Do everything once, on a scene that the program makes itself
///
/// A box and a sphere on a plane, with exact truth: renders and blends the data set, fuses noisy
/// depth maps, scores the cloud against points sampled on the exact surface, writes leaderboard, curve,
/// coloured clouds and a contact sheet, and prints the score beside what the noise model predicts.
#[derive(Debug, Args, Serialize)]
pub(crate) struct DemoArgs {
    /// The folder to write [default: demo-out]
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Seed of everything drawn
    #[arg(long, value_name = "N", value_parser = common::seed)]
    seed: Option<u64>,
    /// Number of cameras [default: 12]
    #[arg(long, value_name = "N")]
    views: Option<u32>,
    /// Image size in pixels [default: 512x384]
    #[arg(long, value_name = "WxH")]
    size: Option<Size>,
    /// Distance up to which a point is right; the scene is about 2 units wide [default: 0.01]
    #[arg(long)]
    tau: Option<f64>,
}

pub(crate) fn run(args: &DemoArgs, global: &Global) -> anyhow::Result<Verdict> {
    execute(&resolve("demo", args, global)?, global)
}

pub(crate) fn execute(job: &DemoJob, global: &Global) -> anyhow::Result<Verdict> {
    let outcome = with_context_leaving(Left::Views, global, |context| demo::run(job, context))?;
    answer(global.format, &outcome, || {
        let mut table = table(&["", "precision", "recall", "F-score"]);
        let row = |name: &str, values: [f64; 3]| {
            let [p, r, f] = values.map(|value| format!("{value:.4}"));
            [name.to_owned(), p, r, f]
        };
        let predicted = outcome.predicted;
        table.add_row(row(
            "measured",
            [outcome.precision, outcome.recall, outcome.f_score],
        ));
        let predicted = [predicted.precision, predicted.recall, predicted.f_score];
        table.add_row(row("predicted from the noise", predicted));
        table
    })?;
    if !global.quiet {
        let out = outcome.out.display();
        say(&format!(
            "{} points; look at {out}/contact_sheet.png and {out}/score",
            outcome.points
        ));
    }
    Ok(Verdict::Passed)
}
