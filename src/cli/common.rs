//! What every command shares: global options, layers of options, threads, Ctrl-C.

use super::bars::{Bars, INTERRUPTED};
use super::output;
use anyhow::Context as _;
use clap::{Args, ValueEnum};
use mvs_eval::jobs::Context;
use mvs_eval::parallel::MOST_THREADS;
use mvs_eval::warning::Warnings;
use mvs_eval::{Error, config};
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::path::PathBuf;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

/// How a command ended when it could be done.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Verdict {
    /// Exit code 0.
    Passed,
    /// A check or gate failed: exit code 1.
    Failed,
}

impl Verdict {
    /// Passed unless `failed`.
    pub(crate) fn failed_if(failed: bool) -> Self {
        if failed { Self::Failed } else { Self::Passed }
    }
}

/// How the answer on stdout looks.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum Format {
    /// A table on a terminal, JSON otherwise.
    Auto,
    /// A table.
    Table,
    /// JSON.
    Json,
}

/// The two conventions for pixel centres.
#[derive(Debug, Clone, Copy, ValueEnum, Serialize)]
#[serde(rename_all = "lowercase")]
pub(crate) enum Centre {
    /// At (0.5, 0.5).
    Half,
    /// At (0, 0).
    Integer,
}

/// Options of every command. None of them changes a result.
#[derive(Debug, Args)]
#[command(next_help_heading = "General options")]
pub(crate) struct Global {
    /// Worker threads; when not given, RAYON_NUM_THREADS, else all cores that the process may run on. Results do
    /// not depend on it.
    #[arg(long, global = true, default_value_t = 0, hide_default_value = true, value_parser = threads)]
    pub(crate) threads: usize,
    /// Replace an existing result.
    #[arg(long, global = true)]
    pub(crate) force: bool,
    /// No progress on stderr; warnings and errors stay.
    #[arg(long, short, global = true)]
    pub(crate) quiet: bool,
    /// How the answer on stdout looks.
    #[arg(long, global = true, value_enum, default_value = "auto")]
    pub(crate) format: Format,
    /// Options from a run.toml of the same command, or a TOML of such options alone, under the names that
    /// stand below [options] there (--max-pixel-error of fuse: fuse.max_pixel_error). Flags override it.
    #[arg(long, global = true, value_name = "FILE")]
    pub(crate) config: Option<PathBuf>,
}

/// A job's options from the configuration file and the flags.
pub(crate) fn resolve<T: DeserializeOwned>(
    command: &str,
    flags: &impl Serialize,
    global: &Global,
) -> anyhow::Result<T> {
    let flags = config::layer_of(flags)?;
    let file = match &global.config {
        Some(path) => config::read_layer_of::<T>(path, command)?,
        None => toml::Table::new(),
    };
    Ok(config::resolve([file, flags])?)
}

/// What an interrupted run leaves.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Left {
    /// Nothing: results get their names when all of them is there.
    Nothing,
    /// Files of a result that is not marked as finished.
    Files,
    /// Views that need not be made again.
    Views,
}

impl Left {
    fn sentence(self) -> &'static str {
        match self {
            Self::Nothing => {
                "interrupted; no result of this run is kept, and one from before is as it was"
            }
            Self::Files => {
                "interrupted; what was written stays, but is no finished result: the same command makes \
                 all of it again"
            }
            Self::Views => {
                "interrupted; finished views are kept: the same command goes on from there"
            }
        }
    }
}

/// Runs a job that leaves nothing when it is interrupted, with progress and warnings on stderr.
pub(crate) fn with_context<T>(
    global: &Global,
    job: impl FnOnce(&Context<'_>) -> mvs_eval::Result<T>,
) -> anyhow::Result<T> {
    with_context_leaving(Left::Nothing, global, job)
}

/// Runs a job with progress and warnings on stderr.
pub(crate) fn with_context_leaving<T>(
    left: Left,
    global: &Global,
    job: impl FnOnce(&Context<'_>) -> mvs_eval::Result<T>,
) -> anyhow::Result<T> {
    let bars = Bars::new(global.quiet);
    let warnings = Warnings::default();
    let context = Context {
        progress: &bars,
        warnings: &warnings,
        force: global.force,
    };
    let outcome = job(&context);
    bars.finish();
    output::say_warnings(&warnings.sorted());
    outcome.map_err(|error| match error {
        Error::Interrupted => anyhow::Error::msg(left.sentence()),
        error => error.into(),
    })
}

/// A seed: what a record can hold, whose numbers are signed.
pub(crate) fn seed(text: &str) -> Result<u64, String> {
    let read = text.parse().ok().filter(|seed| *seed <= i64::MAX as u64);
    read.ok_or_else(|| format!("expected a whole number from 0 to {}", i64::MAX))
}

/// A number of threads; 0 for all cores.
fn threads(text: &str) -> Result<usize, String> {
    let read = text.parse().ok().filter(|threads| *threads <= MOST_THREADS);
    read.ok_or_else(|| format!("expected a whole number from 0 (all cores) to {MOST_THREADS}"))
}

/// Runs `work` on at most `threads` threads.
pub(crate) fn in_pool<T: Send>(
    threads: usize,
    work: impl FnOnce() -> anyhow::Result<T> + Send,
) -> anyhow::Result<T> {
    mvs_eval::parallel::with_threads(threads, work)?
}

/// How long signals after the first are still part of it: `timeout` and others send one to a process, and then to
/// the group that it is in.
const ONE_SIGNAL: Duration = Duration::from_secs(1);

/// The first Ctrl-C asks the work to stop at the next safe point; one that comes more than a second later ends the
/// process.
pub(crate) fn install_interrupt() -> anyhow::Result<()> {
    let mut first: Option<Instant> = None;
    ctrlc::set_handler(move || {
        if let Some(first) = first {
            if first.elapsed() > ONE_SIGNAL {
                std::process::abort();
            }
            return;
        }
        first = Some(Instant::now());
        INTERRUPTED.store(true, Ordering::Relaxed);
        output::say(
            "stopping at the next safe point; press Ctrl-C again a second later to end at once",
        );
    })
    .context("cannot listen for Ctrl-C")
}
