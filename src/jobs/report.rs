//! `mvs-eval report`: records → leaderboards.

mod page;

use super::out::FINISHED;
use super::{Context, OutDir};
use crate::error::{Error, Result};
use crate::provenance::{self, Run};
use crate::report::check::{self, Checked};
use crate::report::leaderboard;
use crate::report::record::{self, Record};
use crate::report::table::Table;
use crate::report::{table_csv, table_md, table_tex};
use mvs_datasets::layout::blended::UNFINISHED;
use mvs_datasets::layout::files;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use std::io::Write;
use std::path::{Path, PathBuf};

/// File names under which records are looked for in folders.
const RECORD_FILES: [&str; 2] = ["results.csv", "scores.csv"];

/// Options of `mvs-eval report`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ReportJob {
    /// Files of records, or folders that are searched for `scores.csv` and `results.csv`, but not in the results of
    /// `report` that lie in them.
    pub records: Vec<PathBuf>,
    /// The folder to write.
    pub out: PathBuf,
    /// The page's heading.
    pub title: Option<String>,
    /// PNG or JPEG pictures for the page.
    pub pictures: Vec<PathBuf>,
}

/// What was reported.
#[derive(Debug, Clone, PartialEq)]
pub struct ReportOutcome {
    /// Files of records that were read.
    pub files: Vec<PathBuf>,
    /// Different rows in them.
    pub records: usize,
    /// The leaderboards, in the site's style.
    pub tables: Vec<Table>,
}

/// Joins the records and writes `results.csv`, the leaderboards and the page `index.html`, which also
/// shows the curves, errors and clouds of the score folders that the records lie in.
///
/// # Errors
/// No records, a folder without files of them, a file that cannot be read, what [`leaderboard::boards`] refuses, a
/// score folder or picture that cannot be read, an output folder as [`OutDir::create`] refuses it, a page over
/// 10 MB, whatever writing brings, and interruption.
pub fn run(job: &ReportJob, context: &Context<'_>) -> Result<ReportOutcome> {
    let (files, records) = read_all(&job.records, Some(&job.out), context)?;
    let boards = leaderboard::boards(&records).map_err(|error| place_of(error, &files))?;
    for sentence in boards.iter().flat_map(leaderboard::Board::not_comparable) {
        context.warnings.add("not-comparable", sentence);
    }
    let folders = page::score_folders(&files)?;
    page::warn_of_others(&folders, &records, context);
    let shown = page::files_of(&folders);
    let inputs = files.iter().chain(&job.pictures).chain(&shown);
    let inputs: Vec<&Path> = inputs.map(PathBuf::as_path).collect();
    let out = OutDir::create(
        &job.out,
        context.run("report", job, &OutDir::inputs(&job.out, &inputs)?)?,
        context.force,
    )?;
    let tables = leaderboard::site_tables(&boards);
    context.progress.begin("page", 1);
    let (page, still) = page::of(job, (&files, &folders), &tables, context)?;
    out.write("results.csv", |file| record::write(file, &records))?;
    write_tables(&out, (&tables, &leaderboard::paper_tables(&boards)))?;
    out.write("index.html", |file| file.write_all(page.as_bytes()))?;
    if let Some(png) = still {
        out.write("errors.png", |file| file.write_all(&png))?;
    }
    out.finish()?;
    Ok(ReportOutcome {
        records: records.len(),
        files,
        tables,
    })
}

/// Writes the site's tables and the papers', each as CSV, Markdown and LaTeX.
fn write_tables(out: &OutDir, (site, paper): (&[Table], &[Table])) -> Result<()> {
    for (name, tables) in [("leaderboard", site), ("leaderboard_paper", paper)] {
        out.write(format!("{name}.csv"), |file| table_csv::write(file, tables))?;
        out.write(format!("{name}.md"), |file| table_md::write(file, tables))?;
        out.write(format!("{name}.tex"), |file| table_tex::write(file, tables))?;
    }
    Ok(())
}

/// The files of records at `paths`, and all their rows, of which there is at least one. A row that
/// stands in several files, as those of a batch do, is there once. Folders are not searched in `out`, nor in
/// results of `report` below them.
/// Warns of files in results that are not finished.
pub(super) fn read_all(
    paths: &[PathBuf],
    out: Option<&Path>,
    context: &Context<'_>,
) -> Result<(Vec<PathBuf>, Vec<Record>)> {
    let found = find_records(paths, out)?;
    warn_of_unfinished(&found, out, context);
    let mut records = Vec::new();
    let mut seen = BTreeSet::new();
    for path in &found {
        let rows = files::read_with(path, |bytes| record::read(bytes))?;
        // Equal numbers print alike, different ones do not.
        records.extend(
            rows.into_iter()
                .filter(|row| seen.insert(format!("{row:?}"))),
        );
    }
    if records.is_empty() {
        let problem = "expected rows of records in the given files, found none";
        return Err(Error::invalid("report", problem));
    }
    Ok((found, records))
}

/// How far above its records a batch of scores has its mark: `OUT/<scene>/<method>/scores.csv`.
const LEVELS: usize = 3;

/// Says which records lie in results that are not finished. A report at `out` that a `demo` makes of its own is no
/// matter.
fn warn_of_unfinished(found: &[PathBuf], out: Option<&Path>, context: &Context<'_>) {
    let around = |path: &PathBuf| {
        let real = path.canonicalize().unwrap_or_else(|_| path.clone());
        let folders = real.ancestors().skip(1).take(LEVELS);
        folders.map(Path::to_path_buf).collect::<Vec<_>>()
    };
    let out = out.and_then(|out| out.ancestors().find_map(super::real_folder));
    let is_own_demo = |folder: &Path| {
        let made = Run::read(&folder.join(UNFINISHED));
        let within = out.as_ref().is_some_and(|out| out.starts_with(folder));
        within && made.is_ok_and(|run| run.command == "demo")
    };
    context.warn_of_marks(found.iter().flat_map(around).collect(), is_own_demo);
}

/// The error with the files named where it is of two different records of one cell.
fn place_of(error: Error, files: &[PathBuf]) -> Error {
    let mut cells: BTreeMap<String, Vec<(&PathBuf, Record)>> = BTreeMap::new();
    for path in files {
        let rows = files::read_with(path, |bytes| record::read(bytes));
        for row in rows.unwrap_or_default() {
            let before = cells.entry(leaderboard::place(&row)).or_default();
            // A failure may not say its threshold: it is in the way of any.
            let is_twin = |(_, other): &&(&PathBuf, Record)| {
                let apart = other.threshold.zip(row.threshold);
                apart.is_none_or(|(a, b)| a.total_cmp(&b).is_eq())
                    && format!("{other:?}") != format!("{row:?}")
            };
            if let Some((other, _)) = before.iter().find(is_twin) {
                let files = match *other == path {
                    true => path.display().to_string(),
                    false => format!("{} and {}", other.display(), path.display()),
                };
                return Error::invalid(files, error.to_string());
            }
            before.push((path, row));
        }
    }
    error
}

/// Recomputes what a published table derives; see [`check::check`].
///
/// # Errors
/// A file that cannot be read; else as [`check::check`], with the file named.
pub fn check_table(path: &Path) -> Result<Checked> {
    Ok(files::read_with(path, |bytes| check::check(bytes))?)
}

/// The given files, and the files of records in the given folders but not in `out` and in reports, by name.
fn find_records(paths: &[PathBuf], out: Option<&Path>) -> Result<Vec<PathBuf>> {
    let mut found = Vec::new();
    // What is not there yet cannot be found in.
    let out = out.and_then(|out| out.canonicalize().ok());
    for path in paths {
        if path.is_dir() {
            let before = found.len();
            // Links may lead in circles, and twice to one folder.
            let mut visited: BTreeSet<PathBuf> = out.iter().cloned().collect();
            search(path, &mut visited, &mut found)?;
            if found.len() == before {
                let why = match path.canonicalize().ok() == out {
                    true => ": this is where the report goes, which is not searched",
                    false => {
                        " outside of reports: give the folder of a report itself to take its records"
                    }
                };
                let names = RECORD_FILES.join(" or ");
                let problem = format!("expected {names} in it, found none{why}");
                return Err(Error::invalid(path.display().to_string(), problem));
            }
        } else {
            found.push(path.clone());
        }
    }
    if found.is_empty() {
        let problem = "expected files of records or folders that hold them, found none";
        return Err(Error::invalid("report", problem));
    }
    Ok(found)
}

/// Each folder once, by its real path; those in `visited` not at all.
fn search(folder: &Path, visited: &mut BTreeSet<PathBuf>, found: &mut Vec<PathBuf>) -> Result<()> {
    let real = folder.canonicalize();
    if !visited.insert(real.map_err(mvs_datasets::Error::io(folder, "read"))?) {
        return Ok(());
    }
    for path in provenance::sorted_entries(folder)? {
        if path.is_dir() {
            if !is_report(&path) {
                search(&path, visited, found)?;
            }
        } else if RECORD_FILES.iter().any(|name| path.ends_with(name)) {
            found.push(path);
        }
    }
    Ok(())
}

/// Whether the folder is a result of `report`, finished or not: what it has joined lies elsewhere, and may have been
/// scored again since.
fn is_report(folder: &Path) -> bool {
    let marks = [FINISHED, UNFINISHED].map(|mark| Run::read(&folder.join(mark)));
    marks
        .into_iter()
        .flatten()
        .any(|run| run.command == "report")
}
