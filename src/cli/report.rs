use super::common::{Global, Verdict, resolve, with_context};
use super::output::{answer, table};
use clap::Args;
use mvs_eval::jobs::report::{self, ReportJob, ReportOutcome};
use serde::Serialize;
use serde_json::json;
use std::path::PathBuf;

/// Join records into leaderboards
///
/// Writes results.csv (all records in long form) and leaderboard.csv, .md and .tex in the style of
/// the benchmark's site, leaderboard_paper.csv, .md and .tex in the style of papers. Records of
/// different protocols, profiles or thresholds never share a table.
///
/// Example: mvs-eval report results --out leaderboards
#[derive(Debug, Args, Serialize)]
pub(crate) struct ReportArgs {
    /// Files of records (scores.csv, results.csv), or folders that hold such files
    #[serde(skip_serializing_if = "Vec::is_empty")]
    records: Vec<PathBuf>,
    /// The folder to write
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
}

pub(crate) fn run(args: &ReportArgs, global: &Global) -> anyhow::Result<Verdict> {
    execute(&resolve("report", args, global)?, global)
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
