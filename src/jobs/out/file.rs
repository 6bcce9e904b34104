//! Results that are one file, with the `run.toml` beside it.

use super::{as_text, check_given};
use crate::error::{Error, Result};
use crate::provenance::{Run, real_path};
use mvs_datasets::layout::blocks::BlockWriter;
use mvs_datasets::layout::files;
use std::fs;
use std::path::{Component, Path, PathBuf};

/// Checks that a result file may be written: it is not there, or may be replaced, and its folder can
/// be made. What a killed run has left of it goes.
///
/// # Errors
/// An empty path or one that names a folder, a device or pipe there, a name too long for the `run.toml` beside it, a folder that cannot be made, and
/// [`Error::Exists`] where the file is there, without `force`.
pub fn check_out_file(path: &Path, force: bool) -> Result<()> {
    check_given(path)?;
    if path.is_dir() {
        return Err(Error::invalid(
            path.display().to_string(),
            "expected a file, found a folder",
        ));
    }
    let text = path.to_string_lossy();
    let is_folder = |end: &str| {
        text.strip_suffix(end)
            .is_some_and(|text| text.ends_with(std::path::is_separator))
    };
    if path.file_name().is_none() || is_folder("") || is_folder(".") {
        let problem =
            "expected the name of a file, found that of a folder: end it with the file's name";
        return Err(Error::invalid(text, problem));
    }
    if path.exists() && !path.is_file() {
        let problem = "expected a regular file to replace, found a device or a pipe";
        return Err(Error::invalid(path.display().to_string(), problem));
    }
    if is_there(path) && !force {
        return Err(Error::exists(path));
    }
    let parent = files::folder_of(path);
    fs::create_dir_all(parent).map_err(mvs_datasets::Error::io(parent, "create the folder"))?;
    check_length(path)?;
    files::remove_left(path);
    Ok(())
}

/// Refuses a name that leaves no room for that of the `run.toml` beside it.
fn check_length(path: &Path) -> Result<()> {
    let beside = run_file_beside(path).symlink_metadata();
    if beside.is_err_and(|error| error.kind() == std::io::ErrorKind::InvalidFilename) {
        let name = path.file_stem().unwrap_or_default();
        let problem = format!(
            "expected a name to which .run.toml can be put, found one of {} bytes: give a shorter one",
            name.len()
        );
        return Err(Error::invalid(path.display().to_string(), problem));
    }
    Ok(())
}

/// Writes a file that [`check_out_file`] has let pass: without `force`, what has come there since stays.
pub(in crate::jobs) fn write_out_file(
    path: &Path,
    force: bool,
    write: impl FnOnce(&mut BlockWriter) -> std::io::Result<()>,
) -> mvs_datasets::Result<()> {
    match force {
        true => files::write_atomically(path, write),
        false => files::write_new(path, write),
    }
}

/// Refuses files of a result that have come since [`check_out_file`] let them pass, unless with `force`.
pub(in crate::jobs) fn check_still_free(paths: &[&Path], force: bool) -> Result<()> {
    match paths.iter().find(|path| is_there(path) && !force) {
        Some(path) => Err(files::has_come(path).into()),
        None => Ok(()),
    }
}

/// A link that leads nowhere is there, too.
fn is_there(path: &Path) -> bool {
    path.symlink_metadata().is_ok()
}

/// Where the `run.toml` of a result file stands: `cloud.ply` → `cloud.run.toml`.
pub fn run_file_beside(result: &Path) -> PathBuf {
    result.with_extension("run.toml")
}

/// Which of the files `own` that a run of `command` is to write are no inputs, as they are those of a result
/// that it replaces: all of them beside the `run.toml` of such a run, else none.
pub(in crate::jobs) fn replaced<'a>(
    own: &'a [PathBuf],
    run_file: &Path,
    command: &str,
) -> &'a [PathBuf] {
    match Run::read(run_file) {
        Ok(run) if run.command == command => own,
        _ => &[],
    }
}

/// Refuses a `run.toml` of another command's result, which `--force` would replace: nothing would say any more how
/// that was made.
pub(in crate::jobs) fn check_run_file(run_file: &Path, command: &str) -> Result<()> {
    let Some(other) = other_command(run_file, command) else {
        return Ok(());
    };
    let problem = format!(
        "expected the run.toml of `{command}` or none, found that of `{other}`, whose result it belongs to: choose \
         another name for --out"
    );
    Err(Error::invalid(run_file.display().to_string(), problem))
}

/// The command that made the `run.toml` at `run_file`, where that is there and is another.
pub(super) fn other_command(run_file: &Path, command: &str) -> Option<String> {
    let there = Run::read(run_file).ok()?.command;
    (there != command).then_some(there)
}

/// Writes the `run.toml` of a run at `run_file`, which names its result `files`.
pub(in crate::jobs) fn write_run_file(
    mut run: Run,
    run_file: &Path,
    files: &[PathBuf],
) -> Result<()> {
    let real = real_path(run_file);
    let folder = real.as_deref().and_then(Path::parent);
    let name = |file: &PathBuf| name_from(folder?, &real_path(file)?);
    run.files = files.iter().filter_map(name).collect();
    run.write(run_file).map_err(|error| {
        let problem = format!(
            "{error}: the result is there, and nothing says how it was made; make room and run again with --force"
        );
        Error::invalid(run_file.display().to_string(), problem)
    })
}

/// The path of `file` from `folder`, or the whole one where nothing leads there, as to another drive. Both
/// are real paths.
pub(super) fn name_from(folder: &Path, file: &Path) -> Option<String> {
    let both = folder.components().zip(file.components());
    let common = both.take_while(|(one, other)| one == other).count();
    if common == 0 {
        return file.to_str().map(str::to_owned);
    }
    let below = folder.components().skip(common);
    let up = below.map(|_| Component::ParentDir);
    let name: PathBuf = up.chain(file.components().skip(common)).collect();
    as_text(&name)
}
