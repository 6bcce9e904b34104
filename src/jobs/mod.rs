//! One file per command: files in, one stage, files out.
//!
//! A job is a serde struct of all its options: what the command line resolves, what `run.toml`
//! stores and what replays it. Each file has the struct and a `run(&job, &context)` that returns
//! an outcome which the command line prints.

pub mod augment;
pub mod blend;
pub mod cameras;
pub mod compare;
pub mod demo;
pub mod depth;
pub mod extremes;
pub mod fuse;
pub mod generate;
pub mod generate_all;
pub mod inspect;
pub mod meshes;
mod out;
pub mod pairs;
pub mod render;
pub mod report;
pub mod report_folder;
pub mod score;
pub mod score_all;
pub mod tradeoff;
pub mod verify;

pub use out::{OutDir, check_out_file, run_file_beside};

use crate::error::{Error, Result};
use crate::progress::Progress;
use crate::provenance::{Inputs, Run};
use crate::warning::Warnings;
use mvs_datasets::layout::blended::UNFINISHED;
use serde::Serialize;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// What every job is given beside its options. None of it changes a result.
#[derive(Clone, Copy)]
pub struct Context<'a> {
    /// Hears how far the work is and says when to stop.
    pub progress: &'a dyn Progress,
    /// Collects warnings.
    pub warnings: &'a Warnings,
    /// Whether existing outputs may be replaced.
    pub force: bool,
}

impl Context<'_> {
    /// As [`Run::new`], with progress where the inputs take long to hash.
    fn run(&self, command: &str, options: &impl Serialize, inputs: &Inputs) -> Result<Run> {
        inputs.hash(self.progress)?;
        Run::new(command, options, inputs)
    }

    /// Says which of these inputs belong to results that are not finished: part of them may be missing. The result at
    /// `out`, which is made further, does not count, nor does the `demo` or the batch of scores that it is a part
    /// of.
    fn warn_of_unfinished(&self, inputs: &[&Path], out: &Path) {
        let (own, around) = (real_folder(out), out.ancestors().find_map(real_folder));
        let has_parts = |folder: &Path| {
            let made = Run::read(&folder.join(UNFINISHED));
            made.is_ok_and(|run| match run.command.as_str() {
                "score" => run.options.contains_key("all"),
                command => command == "demo",
            })
        };
        let is_own = |folder: &Path| {
            let is_around = around
                .as_ref()
                .is_some_and(|around| around.starts_with(folder));
            own.as_deref() == Some(folder) || (is_around && has_parts(folder))
        };
        let places = inputs.iter().flat_map(|path| path.ancestors().take(2));
        self.warn_of_marks(places.filter_map(real_folder).collect(), is_own);
    }

    /// Says which of the folders have the mark of a result that is not finished, but for a command's own.
    fn warn_of_marks(&self, folders: BTreeSet<PathBuf>, is_own: impl Fn(&Path) -> bool) {
        let unfinished = folders
            .iter()
            .filter(|folder| folder.join(UNFINISHED).is_file());
        for folder in unfinished.filter(|folder| !is_own(folder)) {
            let message = format!(
                "{}: has a {UNFINISHED}: what makes the folder was interrupted or still runs, and some of it may \
                 be missing or older",
                folder.display()
            );
            self.warnings.add("unfinished", message);
        }
    }
}

/// The real path of what is there; no path at all is the present folder.
fn real_folder(path: &Path) -> Option<PathBuf> {
    match path.as_os_str().is_empty() {
        true => Path::new(".").canonicalize(),
        false => path.canonicalize(),
    }
    .ok()
}

/// Refuses a `command` without one of its paths before any work: (flag, its paths, what is expected).
/// No path and an empty one are the same: none.
fn require(command: &str, expected: &[(&str, &[&Path], &str)]) -> Result<()> {
    let missing = |(_, paths, _): &&(&str, &[&Path], &str)| {
        paths.is_empty() || paths.iter().any(|path| path.as_os_str().is_empty())
    };
    match expected.iter().find(missing) {
        None => Ok(()),
        Some((flag, _, what)) => Err(Error::invalid(
            format!("{command}: {flag}"),
            format!("expected {what}, found none"),
        )),
    }
}

/// The name that a folder is given by, that of a link perhaps; that of the folder itself where it is given
/// as `.` or `..`.
pub fn name_of(folder: &Path) -> String {
    let whole = match folder.file_name() {
        None => folder.canonicalize().ok(),
        Some(_) => None,
    };
    let named = whole.as_deref().unwrap_or(folder).file_name();
    named.unwrap_or_default().to_string_lossy().into_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_scene_is_named_however_it_is_given() {
        assert_eq!(name_of(Path::new("sets/one")), "one");
        assert_eq!(name_of(Path::new("sets/one/.")), "one");
        let here = std::env::current_dir().unwrap();
        let name = |path: &Path| path.file_name().unwrap().to_string_lossy().into_owned();
        assert_eq!(name_of(Path::new(".")), name(&here));
        assert_eq!(name_of(Path::new("src/..")), name(&here));
    }
}
