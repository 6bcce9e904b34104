//! Places for results: checked before the long work, never destroyed without leave.

use crate::error::{Error, Result};
use crate::provenance::Run;
use mvs_datasets::layout::files;
use std::fs;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

/// A folder for a result. Files in it are written to a temporary name and renamed, `run.toml` last:
/// a folder without it is not finished.
#[derive(Debug)]
pub struct OutDir {
    path: PathBuf,
}

impl OutDir {
    /// Makes the folder, or takes an existing one that is empty. With `force` an existing result is
    /// replaced file by file; its `run.toml` goes first, so that a half-replaced folder is known.
    pub fn create(path: &Path, force: bool) -> Result<Self> {
        fs::create_dir_all(path).map_err(mvs_datasets::Error::io(path, "create the folder"))?;
        let mut entries = fs::read_dir(path).map_err(mvs_datasets::Error::io(path, "read"))?;
        if entries.next().is_some() && !force {
            return Err(Error::exists(path));
        }
        let out = Self {
            path: path.to_path_buf(),
        };
        let finished = out.file("run.toml");
        if finished.exists() {
            fs::remove_file(&finished).map_err(mvs_datasets::Error::io(&finished, "remove"))?;
        }
        out.check_writable()?;
        Ok(out)
    }

    fn check_writable(&self) -> Result<()> {
        let probe = self.file(".writable");
        files::write_atomically(&probe, |_| Ok(()))?;
        fs::remove_file(&probe).map_err(mvs_datasets::Error::io(&probe, "remove"))?;
        Ok(())
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
    pub fn finish(self, run: &Run) -> Result<()> {
        run.write(&self.file("run.toml"))
    }
}

/// Checks that a result file may be written: it is not there, or may be replaced, and its folder can
/// be made.
pub fn check_out_file(path: &Path, force: bool) -> Result<()> {
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

/// Where the `run.toml` of a result file stands: `cloud.ply` → `cloud.run.toml`.
pub fn run_file_beside(result: &Path) -> PathBuf {
    result.with_extension("run.toml")
}
