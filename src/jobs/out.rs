//! Places for results: checked before the long work, never destroyed without leave.

use crate::error::{Error, Result};
use crate::provenance::Run;
use mvs_datasets::layout::files;
use std::fs;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

/// The mark of a finished result folder.
const FINISHED: &str = "run.toml";
/// The mark of a result folder that is being made, or whose making was interrupted.
const UNFINISHED: &str = "run.partial.toml";

/// A folder for a result. Files in it are written to a temporary name and renamed; its `run.toml`
/// appears last, so a folder without it is not finished.
#[derive(Debug)]
pub struct OutDir {
    path: PathBuf,
    run: Run,
}

impl OutDir {
    /// Makes the folder for the result of `run`, or takes an existing one that has no result yet,
    /// that an interrupted run of the same options and inputs left behind, or, with `force`, any.
    pub fn create(path: &Path, run: Run, force: bool) -> Result<Self> {
        check_given(path)?;
        fs::create_dir_all(path).map_err(mvs_datasets::Error::io(path, "create the folder"))?;
        let out = Self {
            path: path.to_path_buf(),
            run,
        };
        if out.has_files()? && !force && !out.is_marked(UNFINISHED) {
            return Err(Error::exists(path));
        }
        out.run.write(&out.file(UNFINISHED))?;
        remove_if_there(&out.file(FINISHED))?;
        Ok(out)
    }

    /// Whether the folder holds anything but the mark of a run that failed before its first file and
    /// files that are just being written.
    fn has_files(&self) -> Result<bool> {
        let unreadable = || mvs_datasets::Error::io(&self.path, "read");
        for entry in fs::read_dir(&self.path).map_err(unreadable())? {
            let name = entry.map_err(unreadable())?.file_name();
            let passing = name.to_string_lossy().starts_with(files::TEMPORARY);
            if name != UNFINISHED && !passing {
                return Ok(true);
            }
        }
        Ok(false)
    }

    /// As [`OutDir::create`], and also takes a folder with a finished result of the same run: the
    /// same bytes are made again.
    pub fn create_again(path: &Path, run: Run, force: bool) -> Result<Self> {
        let same = Self {
            path: path.to_path_buf(),
            run: run.clone(),
        }
        .is_marked(FINISHED);
        Self::create(path, run, force || same)
    }

    /// Whether the mark in the folder is that of the same options and inputs.
    fn is_marked(&self, mark: &str) -> bool {
        Run::read(&self.file(mark)).is_ok_and(|run| {
            let key = |run: &Run| (run.command.clone(), run.options.clone(), run.inputs.clone());
            key(&run) == key(&self.run)
        })
    }

    /// The folder itself.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The path of a file in it; `name` may have folders.
    pub fn file(&self, name: impl AsRef<Path>) -> PathBuf {
        self.path.join(name)
    }

    /// Writes a file in the folder.
    pub fn write(
        &self,
        name: impl AsRef<Path>,
        write: impl FnOnce(&mut BufWriter<fs::File>) -> std::io::Result<()>,
    ) -> Result<()> {
        Ok(files::write_atomically(&self.file(name), write)?)
    }

    /// Writes a value as indented JSON with a final line break.
    pub fn write_json(&self, name: impl AsRef<Path>, value: &impl serde::Serialize) -> Result<()> {
        let text = serde_json::to_string_pretty(value)
            .map_err(|error| Error::invalid("JSON", error.to_string()))?;
        self.write(name, |out| writeln!(out, "{text}"))
    }

    /// Marks the result as finished.
    pub fn finish(self) -> Result<()> {
        self.run.write(&self.file(FINISHED))?;
        remove_if_there(&self.file(UNFINISHED))
    }
}

/// Removes a file, if it is there.
pub(super) fn remove_if_there(path: &Path) -> Result<()> {
    match fs::remove_file(path) {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
            Err(mvs_datasets::Error::io(path, "remove")(error).into())
        }
        _ => Ok(()),
    }
}

/// Checks that a result file may be written: it is not there, or may be replaced, and its folder can
/// be made.
pub fn check_out_file(path: &Path, force: bool) -> Result<()> {
    check_given(path)?;
    if path.is_dir() {
        return Err(Error::invalid(
            path.display().to_string(),
            "expected a file, found a folder",
        ));
    }
    if path.exists() && !force {
        return Err(Error::exists(path));
    }
    let parent = path
        .parent()
        .filter(|parent| !parent.as_os_str().is_empty());
    let parent = parent.unwrap_or(Path::new("."));
    fs::create_dir_all(parent).map_err(mvs_datasets::Error::io(parent, "create the folder"))?;
    Ok(())
}

fn check_given(path: &Path) -> Result<()> {
    if path.as_os_str().is_empty() {
        return Err(Error::invalid("--out", "needed: where to write, not given"));
    }
    Ok(())
}

/// Where the `run.toml` of a result file stands: `cloud.ply` → `cloud.run.toml`.
pub fn run_file_beside(result: &Path) -> PathBuf {
    result.with_extension("run.toml")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::jobs::render::RenderJob;

    fn run_of(samples: u32) -> Run {
        let mut job = RenderJob::default();
        job.render.samples = samples;
        Run::new("render", &job, &[]).unwrap()
    }

    #[test]
    fn a_result_is_not_replaced_without_force() {
        let folder = tempfile::tempdir().unwrap();
        OutDir::create(folder.path(), run_of(4), false)
            .unwrap()
            .finish()
            .unwrap();
        let error = OutDir::create(folder.path(), run_of(4), false)
            .unwrap_err()
            .to_string();
        assert!(error.contains("already exists; give --force"), "{error}");
        assert!(
            folder.path().join(FINISHED).exists(),
            "refusing leaves the result as it is"
        );
        assert!(OutDir::create_again(folder.path(), run_of(16), false).is_err());
        assert!(OutDir::create_again(folder.path(), run_of(4), false).is_ok());
    }

    #[test]
    fn an_interrupted_run_of_the_same_options_goes_on() {
        let folder = tempfile::tempdir().unwrap();
        let out = OutDir::create(folder.path(), run_of(4), false).unwrap();
        out.write_json("half.json", &1).unwrap();
        drop(out);
        assert!(
            OutDir::create(folder.path(), run_of(16), false).is_err(),
            "other options"
        );
        let out = OutDir::create(folder.path(), run_of(4), false).unwrap();
        assert!(out.file("half.json").exists() && !out.file(FINISHED).exists());
        out.finish().unwrap();
        assert!(!folder.path().join(UNFINISHED).exists());
    }

    #[test]
    fn a_run_that_failed_before_its_first_file_is_in_nobodys_way() {
        let folder = tempfile::tempdir().unwrap();
        drop(OutDir::create(folder.path(), run_of(4), false).unwrap());
        let out = OutDir::create(folder.path(), run_of(16), false).unwrap();
        assert!(out.is_marked(UNFINISHED));
    }

    #[test]
    fn force_takes_any_folder() {
        let folder = tempfile::tempdir().unwrap();
        OutDir::create(folder.path(), run_of(4), false)
            .unwrap()
            .finish()
            .unwrap();
        assert!(OutDir::create(folder.path(), run_of(16), true).is_ok());
        assert!(
            !folder.path().join(FINISHED).exists(),
            "a half-replaced result is known as such"
        );
    }
}
