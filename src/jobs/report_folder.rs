//! `mvs-eval report --folder`: the record and the CSV files of a dated folder → its README.

use crate::error::{Error, Result};
use crate::report::folder::{Csv, Folder, MARK};
use mvs_datasets::layout::files;
use std::io::Write;
use std::path::Path;

/// A folder's record and CSV files. Every file that the record names must be there.
fn read(folder: &Path) -> Result<(Folder, Vec<Csv>)> {
    let path = folder.join("run.toml");
    let record = Folder::parse(&files::read_text(&path)?).map_err(in_record(folder))?;
    if let Some(gone) = record.files().find(|name| !folder.join(name).is_file()) {
        let problem = format!("expected the file {gone} beside it, found none");
        return Err(Error::invalid(path.display().to_string(), problem));
    }
    let read = |name: &str| files::read_with(&folder.join(name), Csv::parse);
    let tables = record
        .tables
        .iter()
        .map(|table| read(&table.file))
        .collect::<Result<_, _>>()?;
    Ok((record, tables))
}

/// Names the folder's record in an error.
fn in_record(folder: &Path) -> impl Fn(Error) -> Error {
    let path = folder.join("run.toml").display().to_string();
    move |error| Error::invalid(path.clone(), error.to_string())
}

/// The README that the folder's `run.toml` and CSV files make.
///
/// # Errors
/// A `run.toml` that cannot be read or is no record, files that it names and that are not there, and what
/// [`Folder::readme`] or [`Csv::parse`] refuses.
pub fn render(folder: &Path) -> Result<String> {
    let (record, tables) = read(folder)?;
    record.readme(&tables).map_err(in_record(folder))
}

/// The text of `page`, a Markdown file in a folder above, with the folder's first table and its
/// pictures between the lines `<!-- begin BASE -->` and `<!-- end BASE -->`, where BASE is the path
/// from the page to the folder.
///
/// # Errors
/// A page that cannot be read or has not the two lines in this order, a folder as [`render`] refuses to read it, and
/// what [`Folder::excerpt`] refuses.
pub fn spliced(page: &Path, folder: &Path) -> Result<String> {
    let base = path_between(page, folder);
    let text = files::read_text(page)?;
    let (begin, end) = (
        format!("<!-- begin {base} -->\n"),
        format!("<!-- end {base} -->"),
    );
    let places = text
        .find(&begin)
        .map(|at| at + begin.len())
        .zip(text.find(&end));
    let Some((from, to)) = places.filter(|(from, to)| from <= to) else {
        let problem = format!(
            "expected the lines {} and {end}, found none",
            begin.trim_end()
        );
        return Err(Error::invalid(page.display().to_string(), problem));
    };
    let (record, tables) = read(folder)?;
    let excerpt = record.excerpt(&base, &tables).map_err(in_record(folder))?;
    Ok(format!("{}\n{excerpt}\n{}", &text[..from], &text[to..]))
}

/// The path from a page to a folder below its own, however both are given.
fn path_between(page: &Path, folder: &Path) -> String {
    let root = files::folder_of(page);
    let real = root.canonicalize().ok().zip(folder.canonicalize().ok());
    let below = real.and_then(|(root, folder)| Some(folder.strip_prefix(root).ok()?.to_path_buf()));
    // A link may lead out of the page's folder.
    let lexical = || folder.strip_prefix(root).unwrap_or(folder).to_path_buf();
    let base = below.unwrap_or_else(lexical);
    let base = base.to_string_lossy();
    base.trim_end_matches('/').replace('\\', "/")
}

/// Writes [`spliced`] into the page.
///
/// # Errors
/// As [`spliced`], and a page that cannot be written.
pub fn splice(page: &Path, folder: &Path) -> Result<()> {
    let text = spliced(page, folder)?;
    files::write_atomically(page, |out| out.write_all(text.as_bytes()))?;
    Ok(())
}

/// Writes the folder's `README.md`; one that was written by hand is replaced only with `force`.
///
/// # Errors
/// As [`render`]; a README that cannot be read or written, and [`Error::Exists`] for one by hand, without `force`.
pub fn run(folder: &Path, force: bool) -> Result<()> {
    let text = render(folder)?;
    let path = folder.join("README.md");
    if path.exists() && !force && !files::read_text(&path)?.contains(MARK) {
        return Err(Error::exists(path));
    }
    files::write_atomically(&path, |out| out.write_all(text.as_bytes()))?;
    Ok(())
}
