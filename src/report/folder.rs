//! A dated folder of measurements: its record and CSV files → the README that people read.

use super::lines::Lines;
use super::table::MISSING;
use crate::error::{Error, Result};
use serde::Deserialize;
use std::collections::BTreeMap;
use std::fmt::Write;

/// The line by which a generated README is known.
pub const MARK: &str =
    "<!-- Made by `mvs-eval report --folder` from run.toml and the files beside it. -->";

/// The `run.toml` of a folder of measurements: all that its README says beside the numbers.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Folder {
    /// The heading.
    pub title: String,
    /// When it was measured, `YYYY-MM-DD`.
    pub date: String,
    /// Revision of the sources that were measured.
    pub revision: String,
    /// The machine, in words.
    pub machine: String,
    /// Versions of the tools, by name.
    pub versions: BTreeMap<String, String>,
    /// What to run to measure again.
    pub command: String,
    /// What was measured and what came out, in Markdown.
    pub summary: String,
    /// What speaks for or against the numbers, in Markdown.
    pub bias: String,
    /// The tables, in order.
    #[serde(default, rename = "table")]
    pub tables: Vec<TableOf>,
    /// The pictures, in order.
    #[serde(default, rename = "picture")]
    pub pictures: Vec<PictureOf>,
}

/// How a CSV file is shown.
#[derive(Debug, Clone, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TableOf {
    /// The CSV file, in the same folder, with full precision.
    pub file: String,
    /// What it shows, in Markdown.
    pub caption: String,
    /// The columns to show, in order; all by default, none for a link alone.
    pub columns: Option<Vec<String>>,
    /// What to write above a column instead of its name.
    #[serde(default)]
    pub headings: BTreeMap<String, String>,
    /// Decimals to show, by column.
    #[serde(default)]
    pub digits: BTreeMap<String, usize>,
    /// Decimals to show of `1.2e-7`, by column.
    #[serde(default)]
    pub scientific: BTreeMap<String, usize>,
}

/// A picture.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PictureOf {
    /// The SVG, PNG or JPEG file, in the same folder.
    pub file: String,
    /// What it shows.
    pub caption: String,
}

/// A table as its CSV file has it.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Csv {
    /// Names of the columns.
    pub header: Vec<String>,
    /// The rows, each as long as the header.
    pub rows: Vec<Vec<String>>,
}

impl Folder {
    /// Reads a record.
    ///
    /// # Errors
    /// Names the key that is unknown or missing, the text that is empty, the date that is not `YYYY-MM-DD`, and the
    /// file whose name leaves the folder, begins with a point, or has spaces or brackets.
    pub fn parse(text: &str) -> Result<Self> {
        let folder: Self =
            toml::from_str(text).map_err(|error| Error::toml("record", text, &error))?;
        folder.check()?;
        Ok(folder)
    }

    fn check(&self) -> Result<()> {
        let texts = [
            ("title", &self.title),
            ("revision", &self.revision),
            ("machine", &self.machine),
            ("command", &self.command),
            ("summary", &self.summary),
            ("bias", &self.bias),
        ];
        for (name, text) in texts {
            if text.trim().is_empty() {
                return Err(Error::invalid(name, "expected a text, found none"));
            }
        }
        if !is_date(&self.date) {
            let problem = format!("expected YYYY-MM-DD, found {}", self.date);
            return Err(Error::invalid("date", problem));
        }
        for name in self.files() {
            if name.is_empty() || name.starts_with('.') || name.contains(['/', '\\', '(', ')', ' '])
            {
                let problem =
                    format!("expected the name of a file in the same folder, found {name:?}");
                return Err(Error::invalid("file", problem));
            }
        }
        Ok(())
    }

    /// The files that the record names.
    pub fn files(&self) -> impl Iterator<Item = &str> {
        let tables = self.tables.iter().map(|table| table.file.as_str());
        tables.chain(self.pictures.iter().map(|picture| picture.file.as_str()))
    }

    /// The first table that is shown and all pictures, for a README elsewhere: `base` is the path
    /// from there to this folder. `tables` as for [`Self::readme`].
    ///
    /// # Errors
    /// As [`TableOf::shown`], of the tables up to the first that is shown.
    pub fn excerpt(&self, base: &str, tables: &[Csv]) -> Result<String> {
        let mut text = String::new();
        for (table, csv) in self.tables.iter().zip(tables) {
            let shown = table.shown(csv)?;
            if !shown.is_empty() {
                let (caption, file) = (table.caption.trim(), &table.file);
                push(
                    &mut text,
                    format_args!("{caption} ([{file}]({base}/{file}))"),
                );
                text.push_str(&shown);
                break;
            }
        }
        for PictureOf { file, caption } in &self.pictures {
            let caption = caption.trim();
            push(
                &mut text,
                format_args!("\n![{caption}]({base}/{file})\n\n{caption}"),
            );
        }
        Ok(text)
    }

    /// The README; `tables` are the contents of the CSV files, in the record's order. Only what is
    /// shown is rounded.
    ///
    /// # Errors
    /// As [`TableOf::shown`].
    pub fn readme(&self, tables: &[Csv]) -> Result<String> {
        let mut text = format!("# {}\n\n{MARK}\n\n{}\n", self.title, self.summary.trim());
        for (table, csv) in self.tables.iter().zip(tables) {
            let file = &table.file;
            let caption = table.caption.trim();
            push(&mut text, format_args!("\n{caption} ([{file}]({file}))"));
            text.push_str(&table.shown(csv)?);
        }
        for PictureOf { file, caption } in &self.pictures {
            let caption = caption.trim();
            push(
                &mut text,
                format_args!("\n![{caption}]({file})\n\n{caption}"),
            );
        }
        push(&mut text, format_args!("\n## Bias\n\n{}", self.bias.trim()));
        let versions: Vec<String> = self
            .versions
            .iter()
            .map(|(name, version)| format!("{name} {version}"))
            .collect();
        push(
            &mut text,
            format_args!("\n## Provenance\n\n- Date: {}", self.date),
        );
        push(&mut text, format_args!("- Revision: {}", self.revision));
        push(&mut text, format_args!("- Machine: {}", self.machine));
        push(
            &mut text,
            format_args!("- Versions: {}", versions.join(", ")),
        );
        push(
            &mut text,
            format_args!("\n```\n{}\n```", self.command.trim()),
        );
        Ok(text)
    }
}

impl TableOf {
    /// The table in Markdown; empty when no column is to be shown.
    ///
    /// # Errors
    /// Names the column that the record speaks of and the file does not have.
    pub fn shown(&self, csv: &Csv) -> Result<String> {
        self.check_names(csv)?;
        let columns = match &self.columns {
            None => (0..csv.header.len()).collect(),
            Some(names) => self.places(csv, names)?,
        };
        if columns.is_empty() {
            return Ok(String::new());
        }
        let heading = |&column: &usize| {
            let name = &csv.header[column];
            escaped(self.headings.get(name).unwrap_or(name))
        };
        let number = |&&column: &&usize| {
            csv.rows
                .iter()
                .all(|row| row[column].is_empty() || row[column].parse::<f64>().is_ok())
        };
        let mut text = String::from("\n");
        push_row(&mut text, columns.iter().map(heading));
        let rule = |column| if number(&column) { "--:" } else { ":--" };
        push_row(&mut text, columns.iter().map(rule).map(str::to_owned));
        for row in &csv.rows {
            let cell = |&column: &usize| self.cell(&csv.header[column], &row[column]);
            push_row(&mut text, columns.iter().map(cell));
        }
        Ok(text)
    }

    /// Names that no column has are mistakes of the record.
    fn check_names(&self, csv: &Csv) -> Result<()> {
        let named = self
            .headings
            .keys()
            .chain(self.digits.keys())
            .chain(self.scientific.keys());
        let names: Vec<String> = named.cloned().collect();
        self.places(csv, &names).map(|_| ())
    }

    fn places(&self, csv: &Csv, names: &[String]) -> Result<Vec<usize>> {
        let place = |name: &String| {
            csv.header
                .iter()
                .position(|known| known == name)
                .ok_or_else(|| {
                    let problem =
                        format!("expected a column {name}, found {}", csv.header.join(", "));
                    Error::invalid(&self.file, problem)
                })
        };
        names.iter().map(place).collect()
    }

    fn cell(&self, column: &str, text: &str) -> String {
        if text.is_empty() {
            return MISSING.to_owned();
        }
        match (
            text.parse::<f64>(),
            self.digits.get(column),
            self.scientific.get(column),
        ) {
            (Ok(value), Some(&digits), _) => unsigned_zero(format!("{value:.digits$}")),
            (Ok(value), None, Some(&digits)) => format!("{value:.digits$e}"),
            _ => escaped(text),
        }
    }
}

impl Csv {
    /// Reads a CSV file with a header and at least one row.
    ///
    /// # Errors
    /// Names the line that has not as many cells as the header or is not UTF-8; no row.
    pub fn parse(bytes: &[u8]) -> Result<Self, mvs_datasets::FormatError> {
        let lines = Lines {
            bytes,
            comment: None,
        };
        let mut reader = csv::Reader::from_reader(bytes);
        let texts = |record: &csv::StringRecord| record.iter().map(str::to_owned).collect();
        let header = texts(reader.headers().map_err(lines.broken())?);
        let rows = reader
            .records()
            .map(|row| row.map(|row| texts(&row)).map_err(lines.broken()));
        let rows = rows.collect::<Result<Vec<Vec<String>>, _>>()?;
        if rows.is_empty() {
            let problem = "expected a header and rows, found no row";
            return Err(mvs_datasets::FormatError::new("table", problem));
        }
        Ok(Self { header, rows })
    }
}

/// Appends a line. Writing to a `String` cannot fail.
fn push(text: &mut String, line: std::fmt::Arguments) {
    let _ = text.write_fmt(line);
    text.push('\n');
}

fn push_row(text: &mut String, cells: impl Iterator<Item = String>) {
    let cells: Vec<String> = cells.collect();
    push(text, format_args!("| {} |", cells.join(" | ")));
}

/// Text for a cell: Markdown stays as it is, but nothing may end the cell or be taken for HTML.
fn escaped(text: &str) -> String {
    let text = text.trim().replace('<', "&lt;").replace('|', "\\|");
    text.replace(['\n', '\r'], " ")
}

/// What is rounded to 0 has no sign.
fn unsigned_zero(text: String) -> String {
    match text.trim_start_matches(['-', '0', '.']) {
        "" => text.trim_start_matches('-').to_owned(),
        _ => text,
    }
}

fn is_date(text: &str) -> bool {
    let digits =
        |part: &str, count: usize| part.len() == count && part.bytes().all(|b| b.is_ascii_digit());
    let parts: Vec<&str> = text.split('-').collect();
    matches!(parts[..], [year, month, day] if digits(year, 4) && digits(month, 2) && digits(day, 2))
}

#[cfg(test)]
mod tests {
    use super::*;

    const RECORD: &str = r#"
title = "Something measured"
date = "2026-11-25"
revision = "abc"
machine = "two cores"
versions = { rust = "1.95" }
command = "python benches/x.py"
summary = "It is fast."
bias = "None known."
[[table]]
file = "x.csv"
caption = "Medians."
columns = ["tool", "cpu_s", "error"]
headings = { cpu_s = "CPU, s" }
digits = { cpu_s = 2 }
scientific = { error = 1 }
"#;

    fn csv() -> Csv {
        Csv::parse(b"tool,hidden,cpu_s,error\na|b,1,0.126,1.26e-7\nc,2,,0\n<d>,3,-0.001,1\n")
            .unwrap()
    }

    #[test]
    fn only_what_is_shown_is_rounded() {
        let text = Folder::parse(RECORD).unwrap().readme(&[csv()]).unwrap();
        let table = "Medians. ([x.csv](x.csv))\n\n| tool | CPU, s | error |\n| :-- | --: | --: |\n\
                     | a\\|b | 0.13 | 1.3e-7 |\n| c | – | 0.0e0 |\n| &lt;d> | 0.00 | 1.0e0 |\n\n## Bias\n";
        assert!(text.contains(table), "{text}");
        assert!(text.starts_with("# Something measured\n\n<!-- Made by"));
        assert!(text.ends_with("- Versions: rust 1.95\n\n```\npython benches/x.py\n```\n"));
    }

    #[test]
    fn mistakes_of_the_record_are_named() {
        let refused = |from: &str, to: &str| {
            let changed = RECORD.replace(from, to);
            assert_ne!(changed, RECORD);
            let folder = Folder::parse(&changed);
            folder
                .and_then(|folder| folder.readme(&[csv()]))
                .unwrap_err()
                .to_string()
        };
        for (from, to, said) in [
            ("title", "titel", "unknown field `titel`"),
            ("caption", "coption", "unknown field `coption`"),
            ("2026-11-25", "25 Nov", "expected YYYY-MM-DD, found 25 Nov"),
            ("\"None known.\"", "\" \"", "bias: expected a text"),
            (
                "x.csv",
                "../x.csv",
                "expected the name of a file in the same folder",
            ),
            (
                "cpu_s = 2",
                "cpu = 2",
                "x.csv: expected a column cpu, found tool, hidden",
            ),
            ("[\"tool\"", "[\"tol\"", "expected a column tol"),
        ] {
            let error = refused(from, to);
            assert!(error.contains(said), "{error}");
        }
        assert!(Csv::parse(b"a,b\n").is_err(), "no rows");
        assert!(Csv::parse(b"a,b\n1\n").is_err(), "a short row");
    }
}
