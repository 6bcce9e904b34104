use super::common::{Global, Verdict, resolve, with_context};
use super::output::{answer, pairs, table};
use clap::Args;
use mvs_eval::jobs::report::{self, ReportJob, ReportOutcome};
use mvs_eval::jobs::report_folder;
use serde::Serialize;
use serde_json::json;
use std::path::{Path, PathBuf};

/// Join records into leaderboards
///
/// Writes index.html (one page that opens from disk: leaderboards to sort, and of the score folders
/// that the records lie in the curves, error histograms and clouds to turn in 3-D), results.csv (all
/// records in long form) and leaderboard.csv, .md and .tex in the style of
/// the benchmark's site, leaderboard_paper.csv, .md and .tex in the style of papers. Records of
/// different protocols or profiles, or of different thresholds of one scene, never share a table. A score
/// whose gates failed, or which is against another truth, in another crop or with another sampling of meshes
/// than most of its scene, is shown with a † and takes no part in ranks and means.
///
/// With --check, instead, recomputes the F-scores and averages of a published table (CSV with the
/// columns method, metric, one per scene, Average), lists what does not follow from its own numbers,
/// and exits with 1 if there is such a slip, with 2 if nothing can be recomputed.
///
/// With --folder, instead, writes the README.md of dated folders of measurements from their run.toml
/// and CSV files; the keys are described in reports/README.md.
///
/// Example: mvs-eval report results --out leaderboards
#[derive(Debug, Args, Serialize)]
pub(crate) struct ReportArgs {
    /// Files of records (scores.csv, results.csv), or folders that hold such files; those of reports in a folder are
    /// passed over
    #[serde(skip_serializing_if = "Vec::is_empty")]
    records: Vec<PathBuf>,
    /// The folder to write
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// The page's heading
    #[arg(long, value_name = "TEXT")]
    title: Option<String>,
    /// PNG or JPEG pictures for the page, such as a demo's contact sheet
    #[arg(long = "picture", value_name = "FILE", num_args = 1..)]
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pictures: Vec<PathBuf>,
    /// Check a published table instead
    #[arg(long, value_name = "TABLE", conflicts_with_all = ["records", "out", "title", "pictures"])]
    #[serde(skip)]
    check: Option<PathBuf>,
    /// Write the README.md of folders of measurements instead
    #[arg(long, value_name = "DIR", num_args = 1.., conflicts_with_all = ["records", "out", "title", "pictures", "check"])]
    #[serde(skip)]
    folder: Vec<PathBuf>,
    /// With --folder: also put its first table and its pictures into this Markdown file
    #[arg(long, value_name = "README", requires = "folder", conflicts_with_all = ["records", "out", "check"])]
    #[serde(skip)]
    into: Option<PathBuf>,
}

pub(crate) fn run(args: &ReportArgs, global: &Global) -> anyhow::Result<Verdict> {
    anyhow::ensure!(
        global.config.is_none() || (args.folder.is_empty() && args.check.is_none()),
        "--config: expected none beside --check and --folder, which have no options in a run.toml, found one"
    );
    if !args.folder.is_empty() {
        return folders(&args.folder, args.into.as_deref(), global);
    }
    match &args.check {
        Some(path) => check(path, global),
        None => execute(&resolve("report", args, global)?, global),
    }
}

fn folders(paths: &[PathBuf], into: Option<&Path>, global: &Global) -> anyhow::Result<Verdict> {
    for path in paths {
        report_folder::run(path, global.force)?;
        if let Some(page) = into {
            report_folder::splice(page, path)?;
        }
    }
    let written: Vec<String> = paths
        .iter()
        .map(|path| path.join("README.md").display().to_string())
        .collect();
    answer(global.format, &json!({ "written": written }), || {
        pairs(&[("written", written.join("\n"))])
    })?;
    Ok(Verdict::Passed)
}

fn check(path: &Path, global: &Global) -> anyhow::Result<Verdict> {
    let checked = report::check_table(path)?;
    let slips: Vec<String> = checked.slips.iter().map(ToString::to_string).collect();
    let value = json!({
        "slips": slips,
        "f_scores": checked.f_scores,
        "averages": checked.averages,
        "unchecked": checked.unchecked,
    });
    answer(global.format, &value, || {
        pairs(&[
            ("F-scores recomputed", checked.f_scores.to_string()),
            ("averages recomputed", checked.averages.to_string()),
            ("not to be recomputed", checked.unchecked.to_string()),
            (
                "slips",
                if slips.is_empty() {
                    "none".to_owned()
                } else {
                    slips.join("\n")
                },
            ),
        ])
    })?;
    Ok(Verdict::failed_if(!slips.is_empty()))
}

pub(crate) fn execute(job: &ReportJob, global: &Global) -> anyhow::Result<Verdict> {
    let outcome = with_context(global, |context| report::run(job, context))?;
    let value = json!({
        "files": outcome.files,
        "records": outcome.records,
        "out": job.out,
        "tables": outcome.tables.iter().map(|table| &table.title).collect::<Vec<_>>(),
    });
    answer(global.format, &value, || first_table(&outcome))?;
    Ok(Verdict::Passed)
}

/// The first leaderboard, as a person reads it.
fn first_table(outcome: &ReportOutcome) -> comfy_table::Table {
    let Some(first) = outcome.tables.first() else {
        return table(&["no leaderboard"]);
    };
    let header: Vec<&str> = first.header.iter().map(String::as_str).collect();
    let mut shown = table(&header);
    for row in &first.rows {
        shown.add_row(row.iter().map(|cell| cell.text.clone()));
    }
    shown
}
