use super::common::{Global, Verdict, resolve, with_context};
use super::output::{answer, table};
use clap::Args;
use mvs_eval::jobs::extremes::{self, ExtremesJob};
use serde::Serialize;
use std::path::PathBuf;

/// Measure every stage at the extremes: offsets, scales, depth ranges, repeats, image sizes
///
/// Errors of render, blend, fuse and score against closed forms, beside what f32 or f64 in plain world
/// coordinates would give. Writes extremes.csv; exits with 1 where a promised bound is broken.
#[derive(Debug, Args, Serialize)]
pub(crate) struct ExtremesArgs {
    /// The folder to write (default extremes-out)
    #[arg(long, value_name = "DIR")]
    #[serde(skip_serializing_if = "Option::is_none")]
    out: Option<PathBuf>,
    /// Points of the scored truth, at least 100 (default 1000000)
    #[arg(long, value_name = "N")]
    #[serde(skip_serializing_if = "Option::is_none")]
    points: Option<u32>,
    /// The widest image that is rendered (default 2048)
    #[arg(long, value_name = "PIXELS")]
    #[serde(skip_serializing_if = "Option::is_none")]
    width: Option<u32>,
}

pub(crate) fn run(args: &ExtremesArgs, global: &Global) -> anyhow::Result<Verdict> {
    execute(&resolve("extremes", args, global)?, global)
}

pub(crate) fn execute(job: &ExtremesJob, global: &Global) -> anyhow::Result<Verdict> {
    let outcome = with_context(global, |context| extremes::run(job, context))?;
    answer(global.format, &outcome, || {
        let mut table = table(&[
            "stage",
            "axis",
            "value",
            "arithmetic",
            "quantity",
            "error",
            "bound",
        ]);
        for row in &outcome.rows {
            let mark = if row.holds() { "" } else { " broken" };
            let bound = row
                .bound
                .map_or_else(String::new, |bound| format!("{bound:e}{mark}"));
            table.add_row([
                row.stage.clone(),
                row.axis.clone(),
                row.value.to_string(),
                row.arithmetic.clone(),
                row.quantity.clone(),
                format!("{:.2e}", row.error),
                bound,
            ]);
        }
        table
    })?;
    Ok(Verdict::failed_if(outcome.broken > 0))
}
