//! Places for results: checked before the long work, never destroyed without leave.

use crate::error::{Error, Result};
use crate::provenance::{Inputs, Run, real_path};
use mvs_datasets::layout::blocks::BlockWriter;
use mvs_datasets::layout::files;
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::io::Write;
use std::path::{Component, Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};

mod file;
mod lock;

pub use file::{check_out_file, run_file_beside};
pub(super) use file::{check_run_file, check_still_free, replaced, write_out_file, write_run_file};

use file::other_command;
use lock::{is_taken, locked, shared};

/// The mark of a finished result folder.
pub(super) const FINISHED: &str = "run.toml";
/// The mark of a result folder that is being made, or whose making was interrupted.
const UNFINISHED: &str = mvs_datasets::layout::blended::UNFINISHED;

/// Levels of folders in results.
const LEVELS: u32 = 2;

/// A folder for a result. Files in it are written to a temporary name and renamed; its `run.toml`
/// appears last, so a folder without it is not finished. Of a result that is replaced, the files that the
/// new one does not have are removed then; until a first file is asked for it stays as it is, with its
/// `run.toml`. None of its files may be read for the new one.
#[derive(Debug)]
pub struct OutDir {
    path: PathBuf,
    run: Run,
    /// Whether the mark of the finished result that is to be replaced still lies there, as far as this run knows.
    replaces: AtomicBool,
    /// The files that were asked for, and whether what lies there is this run's even if it fails.
    asked: Mutex<BTreeMap<PathBuf, bool>>,
    /// Whether files may have been written that were not asked for.
    begun: bool,
    /// The folder, which no other run may take while it is open.
    _lock: Option<fs::File>,
}

impl OutDir {
    /// Lists the inputs of a run into the folder `path`. The result before it, whole or not, is none of them
    /// wherever it lies: this one replaces it.
    ///
    /// # Errors
    /// As [`Inputs::list`].
    pub fn inputs(path: &Path, inputs: &[&Path]) -> Result<Inputs> {
        Inputs::list(inputs, &files_of_result(path))
    }

    /// Makes the folder for the result of `run`, or takes an existing one that has no result yet,
    /// that an interrupted run of the same options and inputs left behind, or, with `force`, any but an
    /// input, one of whose result there are files among the inputs, and one with the result of another command.
    ///
    /// Until the result is finished or given up no other run may take the folder.
    ///
    /// # Errors
    /// An empty path, a folder that cannot be made or written, that another run has locked, or that is an input or
    /// has inputs among the files of its result; [`Error::Exists`] where it has files and is not of such an
    /// interrupted run, without `force`.
    pub fn create(path: &Path, run: Run, force: bool) -> Result<Self> {
        make_folder(path, &run)?;
        let lock = locked(path)?;
        let mut out = Self::take(path, run, force)?;
        out._lock = lock;
        Ok(out)
    }

    /// As [`OutDir::create`] for a folder that has been made.
    fn take(path: &Path, run: Run, force: bool) -> Result<Self> {
        let mut out = Self::at(path, run);
        out.check_command()?;
        if out.has_files()? && !force && !out.is_marked(UNFINISHED) {
            return Err(Error::exists(path));
        }
        let marked = |mark: &str| Run::read(&path.join(mark)).ok();
        let before = marked(FINISHED);
        *out.replaces.get_mut() = before.is_some();
        let replaced = before.or_else(|| marked(UNFINISHED));
        out.run.files = replaced.map(|run| run.files).unwrap_or_default();
        out.run.write(&path.join(UNFINISHED))?;
        if !*out.replaces.get_mut() {
            remove_if_there(&path.join(FINISHED))?;
        }
        files::remove_all_left(path, LEVELS);
        Ok(out)
    }

    /// What [`OutDir::create_again`] would refuse whatever the inputs are: for before the long reading of
    /// them. `run` needs none.
    ///
    /// # Errors
    /// [`Error::Exists`] where the folder has files and no mark of the same command and options, without `force`; a
    /// folder that cannot be read.
    pub fn check_again(path: &Path, run: &Run, force: bool) -> Result<()> {
        let same = |mark: &str| {
            let there = Run::read(&path.join(mark));
            there.is_ok_and(|there| {
                (there.command, there.options) == (run.command.clone(), run.options.clone())
            })
        };
        if !path.is_dir() {
            return Ok(());
        }
        let out = Self::at(path, run.clone());
        out.check_command()?;
        if force || same(FINISHED) || same(UNFINISHED) {
            return Ok(());
        }
        match out.has_files()? {
            true => Err(Error::exists(path)),
            false => Ok(()),
        }
    }

    fn at(path: &Path, run: Run) -> Self {
        Self {
            path: path.to_path_buf(),
            run,
            replaces: AtomicBool::new(false),
            asked: Mutex::default(),
            begun: false,
            _lock: None,
        }
    }

    /// Whether the folder, or one in it, holds a file but the mark of a run that failed before its first file and
    /// files that are just being written.
    fn has_files(&self) -> Result<bool> {
        has_files(&self.path, UNFINISHED)
    }

    /// Refuses a folder with the result of another command, finished or not: its files would go, or nothing would say
    /// any more how they were made.
    fn check_command(&self) -> Result<()> {
        if !self.has_files()? {
            return Ok(());
        }
        let command = &self.run.command;
        for mark in [FINISHED, UNFINISHED] {
            if let Some(other) = other_command(&self.path.join(mark), command) {
                let problem = format!(
                    "expected the {mark} of `{command}` or none, found that of `{other}`, whose result the folder is: \
                     give another --out"
                );
                return Err(Error::invalid(self.path.display().to_string(), problem));
            }
        }
        Ok(())
    }

    /// As [`OutDir::create`], and also takes a folder with a finished result of the same run: the
    /// same bytes are made again.
    ///
    /// # Errors
    /// As [`OutDir::create`], but not for a finished result of the same run.
    pub fn create_again(path: &Path, run: Run, force: bool) -> Result<Self> {
        make_folder(path, &run)?;
        let lock = locked(path)?;
        let mut out = Self::take_again(path, run, force)?;
        out._lock = lock;
        Ok(out)
    }

    /// As [`OutDir::create_again`]; runs of the same options and inputs may do so at once, as shards do.
    ///
    /// # Errors
    /// As [`OutDir::create`].
    pub fn create_shared(path: &Path, run: Run, force: bool) -> Result<Self> {
        make_folder(path, &run)?;
        let Ok(alone) = locked(path) else {
            let lock = shared(path).filter(|_| Self::at(path, run.clone()).is_of_same());
            let lock = lock.ok_or_else(|| is_taken(path))?;
            let mut out = Self::take_again(path, run, force)?;
            out._lock = Some(lock);
            return Ok(out);
        };
        let mut out = Self::take_again(path, run, force)?;
        // From here on the mark says whose the folder is.
        if alone.is_some() {
            drop(alone);
            out._lock = shared(path);
            if out._lock.is_none() || !out.is_of_same() {
                out.begun = true; // The folder is another's.
                return Err(is_taken(path));
            }
        }
        Ok(out)
    }

    /// As [`OutDir::create_again`] for a folder that has been made.
    fn take_again(path: &Path, run: Run, force: bool) -> Result<Self> {
        let same = Self::at(path, run.clone()).is_marked(FINISHED);
        Self::take(path, run, force || same)
    }

    /// Whether what is in the folder, or is being written there, is of the same options and inputs.
    fn is_of_same(&self) -> bool {
        match self.path.join(UNFINISHED).exists() {
            true => self.is_marked(UNFINISHED),
            false => self.is_marked(FINISHED),
        }
    }

    /// Whether the mark in the folder is that of the same options and inputs.
    fn is_marked(&self, mark: &str) -> bool {
        Run::read(&self.path.join(mark)).is_ok_and(|run| {
            let key = |run: &Run| (run.command.clone(), run.options.clone(), run.inputs.clone());
            key(&run) == key(&self.run)
        })
    }

    /// The folder itself.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Says that others write files in it from now on: the result before it is no longer whole.
    pub fn begin(&mut self) {
        self.begun = true;
        self.unmark();
    }

    /// Takes the mark of the result before away, once.
    fn unmark(&self) {
        if self.replaces.swap(false, Ordering::Relaxed) {
            // Should it stay, the other mark beside it says that the result is unfinished.
            let _ = remove_if_there(&self.path.join(FINISHED));
        }
    }

    /// The path of a file in it that is to be written; `name` may have folders.
    pub fn file(&self, name: impl AsRef<Path>) -> PathBuf {
        let name = name.as_ref();
        let path = self.path.join(name);
        let replaced = || as_text(name).is_some_and(|name| self.run.files.contains(&name));
        // What others have put there stays theirs until the run is finished.
        let own = !path.exists() || replaced();
        self.unmark();
        self.asked().entry(name.to_path_buf()).or_insert(own);
        path
    }

    /// Refuses what the run reads at `name` in the folder, or below it: before others write there.
    ///
    /// # Errors
    /// Names the input that lies there, below it, or above it within the folder.
    pub fn check_not_read(&self, name: impl AsRef<Path>) -> Result<()> {
        let Ok(real) = self.path.canonicalize() else {
            return Ok(());
        };
        let target = real.join(&name);
        let is_replaced = |at: PathBuf| {
            at.starts_with(&target) || (target.starts_with(&at) && !real.starts_with(&at))
        };
        let read_from = |input: &&String| {
            let input = Path::new(input.as_str());
            [input.canonicalize().ok(), real_path(input)]
        };
        let mut inputs = self.run.inputs.keys();
        match inputs.find(|input| read_from(input).into_iter().flatten().any(is_replaced)) {
            Some(input) => Err(is_in_the_way(input, &target)),
            None => Ok(()),
        }
    }

    /// Writes a file in the folder, unless it is read.
    ///
    /// # Errors
    /// As [`OutDir::check_not_read`], what `write` brings, and a file that cannot be made or replaced.
    pub fn write(
        &self,
        name: impl AsRef<Path>,
        write: impl FnOnce(&mut BlockWriter) -> std::io::Result<()>,
    ) -> Result<()> {
        self.check_not_read(&name)?;
        files::write_atomically(&self.file(&name), write)?;
        self.asked().insert(name.as_ref().to_path_buf(), true);
        Ok(())
    }

    /// Takes over the whole result in a folder of this one, which the run has made: its files are this run's.
    ///
    /// # Errors
    /// As [`Run::read`], of the `run.toml` there.
    pub fn adopt(&self, name: impl AsRef<Path>) -> Result<()> {
        let name = name.as_ref();
        let run = Run::read(&self.path.join(name).join(FINISHED))?;
        let files = run.files.iter().map(|file| name.join(file));
        let files = files.chain([name.join(FINISHED)]);
        self.asked().extend(files.map(|file| (file, true)));
        Ok(())
    }

    fn asked(&self) -> MutexGuard<'_, BTreeMap<PathBuf, bool>> {
        self.asked.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Writes a value as indented JSON with a final line break.
    ///
    /// # Errors
    /// A value that JSON cannot hold; else as [`OutDir::write`].
    pub fn write_json(&self, name: impl AsRef<Path>, value: &impl serde::Serialize) -> Result<()> {
        let text = serde_json::to_string_pretty(value)
            .map_err(|error| Error::invalid("JSON", error.to_string()))?;
        self.write(name, |out| writeln!(out, "{text}"))
    }

    /// Marks the result as finished, and removes what only the one before it had.
    ///
    /// # Errors
    /// Files of the result before that cannot be removed, and a `run.toml` that cannot be written.
    pub fn finish(mut self) -> Result<()> {
        self.unmark();
        let written = self.written(|_| true);
        let gone: Vec<String> = self.run.files.difference(&written).cloned().collect();
        // What fails from here on leaves all names in the mark.
        self.run.files.extend(written.iter().cloned());
        for name in gone {
            remove_within(&self.path, &name)?;
        }
        self.run.files = written;
        self.run.write(&self.path.join(FINISHED))?;
        remove_if_there(&self.path.join(UNFINISHED))?;
        self.asked().clear();
        Ok(())
    }

    /// The names of those that were asked for and are there, if `counts` says so of whether they are this
    /// run's even if it fails.
    fn written(&self, counts: impl Fn(bool) -> bool) -> BTreeSet<String> {
        let asked = self.asked();
        let there = asked
            .iter()
            .filter(|(name, own)| counts(**own) && self.path.join(name).is_file());
        there.filter_map(|(name, _)| as_text(name)).collect()
    }
}

impl Drop for OutDir {
    /// A run that failed before its first file leaves the result before it as it was; one that failed after
    /// it, the names of its files in its mark.
    fn drop(&mut self) {
        if !self.asked().is_empty() {
            let written = self.written(|own| own);
            self.run.files.extend(written);
            // Without the names they count as others' files.
            let _ = self.run.write(&self.path.join(UNFINISHED));
        } else if !self.begun && self.path.join(FINISHED).is_file() {
            // Nothing can be said of a failure here; both marks together are known as unfinished.
            let _ = remove_if_there(&self.path.join(UNFINISHED));
        }
    }
}

/// Whether files lie in `folder` or below it, but for `mark` in itself and those that are just being written.
fn has_files(folder: &Path, mark: &str) -> Result<bool> {
    let unreadable = || mvs_datasets::Error::io(folder, "read");
    for entry in fs::read_dir(folder).map_err(unreadable())? {
        let entry = entry.map_err(unreadable())?;
        let name = entry.file_name();
        let passing = name.to_string_lossy().starts_with(files::TEMPORARY);
        if name == mark || passing {
            continue;
        }
        let is_folder = entry.file_type().map_err(unreadable())?.is_dir();
        if !is_folder || has_files(&entry.path(), "")? {
            return Ok(true);
        }
    }
    Ok(false)
}

fn make_folder(path: &Path, run: &Run) -> Result<()> {
    check_given(path)?;
    check_place(path, run)?;
    let failed = mvs_datasets::Error::io(path, "create the folder");
    Ok(fs::create_dir_all(path).map_err(failed)?)
}

/// A path in a folder with `/` on every system; none for what is no text.
fn as_text(name: &Path) -> Option<String> {
    let parts: Option<Vec<&str>> = name.iter().map(|part| part.to_str()).collect();
    parts.map(|parts| parts.join("/"))
}

/// Removes a file in `folder`, and the folders in between that are empty then.
fn remove_within(folder: &Path, name: &str) -> Result<()> {
    let name = Path::new(name);
    let inside = |part| matches!(part, Component::Normal(_));
    if !name.components().all(inside) {
        return Ok(());
    }
    remove_if_there(&folder.join(name))?;
    for parent in name
        .ancestors()
        .skip(1)
        .filter(|parent| *parent != Path::new(""))
    {
        // One that is not empty stays.
        let _ = fs::remove_dir(folder.join(parent));
    }
    Ok(())
}

/// The marks of results in the folder `path`, and the files that they name.
fn files_of_result(path: &Path) -> Vec<PathBuf> {
    let marks = [FINISHED, UNFINISHED].map(|mark| path.join(mark));
    let files = marks.iter().flat_map(|mark| match Run::read(mark) {
        Ok(run) => run.own(mark),
        Err(_) => vec![mark.clone()],
    });
    files.collect()
}

/// No result goes into a folder that is read for it, and none replaces files that are read. A folder in which
/// the result's own folder lies is read without the result.
fn check_place(path: &Path, run: &Run) -> Result<()> {
    let Ok(real) = path.canonicalize() else {
        return Ok(());
    };
    let files = files_of_result(path).into_iter();
    let files: Vec<PathBuf> = files.filter_map(|file| file.canonicalize().ok()).collect();
    let is_replaced = |input: &Path| files.iter().any(|file| file.starts_with(input));
    let is_one =
        |input: PathBuf| input == real || (!real.starts_with(&input) && is_replaced(&input));
    let given = |input: &&String| Path::new(input.as_str()).canonicalize();
    let mut inputs = run.inputs.keys();
    match inputs.find(|input| given(input).is_ok_and(is_one)) {
        Some(input) => Err(is_in_the_way(input, path)),
        None => Ok(()),
    }
}

fn is_in_the_way(input: &str, result: &Path) -> Error {
    let problem = format!(
        "expected another folder for the result than that of files that are read, found {}: give another --out",
        result.display()
    );
    Error::invalid(input, problem)
}

/// No file that is read is replaced by a result.
pub(super) fn check_no_input<'p>(
    results: &[&Path],
    mut inputs: impl Iterator<Item = &'p Path>,
) -> Result<()> {
    let is_one = |input: &&Path| {
        let mut named = results
            .iter()
            .filter(|result| result.file_name() == input.file_name());
        named.any(|result| real_path(result).is_some_and(|result| real_path(input) == Some(result)))
    };
    match inputs.find(is_one) {
        Some(input) => {
            let problem = "expected another name for the result than that of a file that is read, found an input";
            Err(Error::invalid(input.display().to_string(), problem))
        }
        None => Ok(()),
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

fn check_given(path: &Path) -> Result<()> {
    if path.as_os_str().is_empty() {
        return Err(Error::invalid("--out", "needed: where to write, not given"));
    }
    Ok(())
}

#[cfg(test)]
mod tests;
