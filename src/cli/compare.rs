use super::common::{Global, Verdict, resolve, with_context};
use super::output::{answer, table};
use clap::Args;
use mvs_eval::jobs::compare::{self, CompareJob};
use mvs_eval::report::compare::Outcome;
use serde::Serialize;
use std::path::PathBuf;

/// Compare two sets of records and exit with 1 when a score became worse
///
/// A difference counts when it is larger than the records' confidence intervals allow (see
/// `score --bootstrap`, which says where they are too narrow) and larger than --tolerance. Both intervals count
/// as independent, though scores against one truth share its part of the chance: a difference may be real that
/// is called none. Cells are paired by method, scene and threshold, by split where a set has several. A score that
/// failed its gates counts as none beside one that passed them: what passed them before is lost then, which
/// is worse. Where both failed, their F-scores are compared all the same.
///
/// Sets of different protocols or profiles, and scores of one cell against different truths, in different
/// crops or with different samplings of meshes, are refused unless --mix is given.
#[derive(Debug, Args, Serialize)]
pub(crate) struct CompareArgs {
    /// Records (scores.csv, results.csv) or a folder that holds them: how it was
    before: PathBuf,
    /// The same: how it is
    after: PathBuf,
    /// F-score differences up to this are no differences (default 1e-9)
    #[arg(long, value_name = "F")]
    tolerance: Option<f64>,
    /// Compare records of different protocols, profiles, truths, crops or samplings of meshes too
    #[arg(long)]
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    mix: bool,
}

pub(crate) fn run(args: &CompareArgs, global: &Global) -> anyhow::Result<Verdict> {
    let job: CompareJob = resolve("compare", args, global)?;
    let comparison = with_context(global, |context| compare::run(&job, context))?;
    answer(global.format, &comparison, || {
        let mut table = table(&["", "before", "after", "uncertainty", ""]);
        for difference in &comparison.differences {
            let outcome = match difference.outcome {
                Outcome::Same => "same",
                Outcome::Better => "better",
                Outcome::Worse => "worse",
            };
            table.add_row([
                difference.cell.clone(),
                format!("{:.4}", difference.before),
                format!("{:.4}", difference.after),
                format!("{:.4}", difference.uncertainty),
                outcome.to_owned(),
            ]);
        }
        for cell in &comparison.lost {
            table.add_row([cell.as_str(), "", "", "", "lost"]);
        }
        for cell in &comparison.gained {
            table.add_row([cell.as_str(), "", "", "", "new"]);
        }
        table
    })?;
    Ok(Verdict::failed_if(comparison.is_regression()))
}
