use super::common::{Global, Verdict, resolve, with_context};
use super::output::{answer, table};
use clap::Args;
use mvs_eval::jobs::compare::{self, CompareJob};
use mvs_eval::report::compare::{Difference, Outcome};
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
            let [before, after] = shown(difference);
            table.add_row([
                difference.cell.clone(),
                before,
                after,
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

/// Both F-scores with four decimals, or with all where four do not show that they differ.
fn shown(difference: &Difference) -> [String; 2] {
    let both = [difference.before, difference.after];
    let short = both.map(|value| format!("{value:.4}"));
    match difference.outcome != Outcome::Same && short[0] == short[1] {
        true => both.map(|value| value.to_string()),
        false => short,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_became_worse_is_seen_to_differ() {
        let difference = |after, outcome| Difference {
            cell: String::new(),
            before: 0.5454,
            after,
            uncertainty: 1e-9,
            outcome,
        };
        assert_eq!(
            shown(&difference(0.54539999, Outcome::Worse)),
            ["0.5454", "0.54539999"]
        );
        assert_eq!(
            shown(&difference(0.545_400_000_001, Outcome::Same)),
            ["0.5454", "0.5454"]
        );
    }
}
