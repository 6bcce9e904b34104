//! `mvs-eval report --folder`: the record and the CSV files of a dated folder → its README.

use crate::error::{Error, Result};
use crate::report::folder::{Csv, Folder, MARK};
use mvs_datasets::layout::files;
use std::io::Write;
use std::path::Path;

/// The README that the folder's `run.toml` and CSV files make. Every file that the record names
/// must be there.
pub fn render(folder: &Path) -> Result<String> {
    let path = folder.join("run.toml");
    let in_record = |error: Error| Error::invalid(path.display().to_string(), error.to_string());
    let record = Folder::parse(&files::read_text(&path)?).map_err(in_record)?;
    if let Some(gone) = record.files().find(|name| !folder.join(name).is_file()) {
        let problem = format!("expected the file {gone} beside it, found none");
        return Err(Error::invalid(path.display().to_string(), problem));
    }
    let read = |name: &str| files::read_with(&folder.join(name), Csv::parse);
    let tables: Vec<Csv> = record
        .tables
        .iter()
        .map(|table| read(&table.file))
        .collect::<Result<_, _>>()?;
    record.readme(&tables).map_err(in_record)
}

/// Writes the folder's `README.md`; one that was written by hand is replaced only with `force`.
pub fn run(folder: &Path, force: bool) -> Result<()> {
    let text = render(folder)?;
    let path = folder.join("README.md");
    if path.exists() && !force && !files::read_text(&path)?.contains(MARK) {
        return Err(Error::exists(path));
    }
    files::write_atomically(&path, |out| out.write_all(text.as_bytes()))?;
    Ok(())
}
