//! `fuse --sweep`: a grid around a job of fusion.

use super::common::{Global, Verdict, with_context};
use super::fuse::FuseFlags;
use super::output::{answer, table};
use clap::Args;
use mvs_eval::config;
use mvs_eval::jobs::fuse::sweep::{self, SweepJob};
use mvs_eval::jobs::fuse::{Coordinates, FuseJob, Properties};
use mvs_eval::provenance::Run;
use mvs_eval::{Error, Result};
use std::path::{Path, PathBuf};

#[derive(Debug, Args)]
pub(super) struct SweepFlags {
    /// Fuse with a grid of parameters and write a table of what each gives
    #[arg(long)]
    pub(super) sweep: bool,
    /// A cloud of the true surface to score each combination by, in the crop volume where one is given; both
    /// clouds are averaged over voxels of τ/2 first
    #[arg(long, value_name = "PLY", requires = "sweep", requires = "tau")]
    truth: Option<PathBuf>,
    /// The distance below which points count, world units
    #[arg(long, value_name = "T", requires = "sweep", requires = "truth")]
    tau: Option<f64>,
    /// Values of --max-pixel-error in the grid (default that flag's, else 0.5,1,2)
    #[arg(long, value_name = "LIST", value_delimiter = ',', requires = "sweep")]
    sweep_pixel_error: Vec<f64>,
    /// Values of --min-sources in the grid (default that flag's, else 2,3,5)
    #[arg(long, value_name = "LIST", value_delimiter = ',', requires = "sweep")]
    sweep_min_sources: Vec<usize>,
    /// Values of --min-confidence in the grid (default that flag's, else 0.3,0.6,0.8)
    #[arg(long, value_name = "LIST", value_delimiter = ',', requires = "sweep")]
    sweep_min_confidence: Vec<f64>,
}

impl SweepFlags {
    /// The sweep around a job with these flags, beside the file of a sweep if there is one.
    pub(super) fn job(
        &self,
        fuse: FuseJob,
        flags: &FuseFlags,
        file: Option<SweepJob>,
    ) -> Result<SweepJob> {
        let or = file.unwrap_or_default();
        Ok(SweepJob {
            pixel_errors: axis(
                ("--sweep-pixel-error", "--max-pixel-error"),
                (&self.sweep_pixel_error, flags.max_pixel_error),
                or.pixel_errors,
            )?,
            min_sources: axis(
                ("--sweep-min-sources", "--min-sources"),
                (&self.sweep_min_sources, flags.min_sources),
                or.min_sources,
            )?,
            min_confidences: axis(
                ("--sweep-min-confidence", "--min-confidence"),
                (&self.sweep_min_confidence, flags.min_confidence),
                or.min_confidences,
            )?,
            truth: self.truth.clone().or(or.truth),
            tau: self.tau.unwrap_or(or.tau),
            out: fuse.out.clone(),
            fuse: FuseJob {
                out: PathBuf::new(),
                // A table does not hang on how a cloud is written.
                properties: Properties::default(),
                coordinates: Coordinates::default(),
                ..fuse
            },
        })
    }
}

/// The options of a sweep in the `run.toml` at `path`; `None` if it is no sweep's.
///
/// # Errors
/// Names the file whose options are none of a sweep.
pub(super) fn read(path: &Path) -> Result<Option<SweepJob>> {
    if !Run::read(path).is_ok_and(|run| run.command == "sweep") {
        return Ok(None);
    }
    let layer = config::read_layer_of::<SweepJob>(path, "sweep")?;
    config::resolve([layer]).map(Some)
}

/// The values of one axis: the list's, else the flag's one, else the usual ones.
fn axis<T: Copy>(
    (list_flag, flag): (&str, &str),
    (list, one): (&[T], Option<T>),
    usual: Vec<T>,
) -> Result<Vec<T>> {
    match (list, one) {
        ([], None) => Ok(usual),
        ([], Some(one)) => Ok(vec![one]),
        (list, None) => Ok(list.to_vec()),
        (_, Some(_)) => {
            let problem = format!("says the same as {flag}: give one of them");
            Err(Error::invalid(list_flag, problem))
        }
    }
}

pub(crate) fn execute(job: &SweepJob, global: &Global) -> anyhow::Result<Verdict> {
    let outcome = with_context(global, |context| sweep::run(job, context))?;
    answer(global.format, &outcome, || {
        let mut table = table(&[
            "min confidence",
            "min sources",
            "max pixel error",
            "points",
            "precision",
            "recall",
            "F-score",
        ]);
        for row in &outcome.rows {
            let score = row
                .score
                .map_or(["–".to_owned(), "–".into(), "–".into()], |score| {
                    [score.precision(), score.recall(), score.f_score()].map(|v| format!("{v:.4}"))
                });
            let options = [
                or_dash(row.min_confidence),
                or_dash(row.min_sources),
                or_dash(row.max_pixel_error),
                row.points.to_string(),
            ];
            table.add_row(options.into_iter().chain(score));
        }
        table
    })?;
    Ok(Verdict::Passed)
}

/// A value, or a dash where it counts for nothing.
fn or_dash(value: Option<impl ToString>) -> String {
    value.map_or_else(|| "–".to_owned(), |value| value.to_string())
}
