//! `mvs-eval compare`: two sets of records, cell by cell.

use super::{Context, report};
use crate::error::{Error, Result};
use crate::report::compare::{self, CompareOptions, Comparison, Mixing};
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// Options of `mvs-eval compare`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct CompareJob {
    /// Records, or a folder that holds them: how it was.
    pub before: PathBuf,
    /// Records, or a folder that holds them: how it is.
    pub after: PathBuf,
    /// F-score differences up to this are no differences; 1e-9 when not given.
    pub tolerance: Option<f64>,
    /// Compare records of different protocols, profiles, truths, crops or samplings of meshes too.
    pub mix: bool,
}

/// Compares the F-scores.
///
/// # Errors
/// A tolerance that is not from 0 to 1, and records that are not there or cannot be read; else as
/// [`compare::compare`].
pub fn run(job: &CompareJob, context: &Context<'_>) -> Result<Comparison> {
    if let Some(tolerance) = job.tolerance.filter(|value| !(0.0..=1.0).contains(value)) {
        let problem = format!("expected a difference of F-scores from 0 to 1, found {tolerance}");
        return Err(Error::invalid("--tolerance", problem));
    }
    let before = report::read_all(std::slice::from_ref(&job.before), None, context)?.1;
    let after = report::read_all(std::slice::from_ref(&job.after), None, context)?.1;
    let standard = CompareOptions::default();
    let options = CompareOptions {
        tolerance: job.tolerance.unwrap_or(standard.tolerance),
        mixing: if job.mix {
            Mixing::Allowed
        } else {
            Mixing::Refused
        },
    };
    let comparison = compare::compare(&before, &after, &options)?;
    if let Some([before, after]) = compare::other_method(&before, &after) {
        let message = format!(
            "{before} before is compared with {after} after: sets of one method each are paired whatever its name"
        );
        context.warnings.add("other-method", message);
    }
    if let Some(first) = comparison.passed_over.first() {
        let message = format!(
            "{} cells have distances but no F-score and are not compared, the first is {first}",
            comparison.passed_over.len()
        );
        context.warnings.add("no-f-score", message);
    }
    for cell in &comparison.mixed {
        context
            .warnings
            .add("mixed", format!("{cell}: the difference means little"));
    }
    Ok(comparison)
}
