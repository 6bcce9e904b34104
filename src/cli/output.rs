//! The only place that prints.

use super::common::Format;
use anyhow::Context as _;
use comfy_table::{CellAlignment, LineStyle, Table, TableStyle};
use mvs_eval::warning::Warning;
use serde::Serialize;
use std::io::{IsTerminal, Write};

/// A line of the conversation, on stderr.
pub(crate) fn say(line: &str) {
    // A closed stderr must not end the work.
    let _ = writeln!(std::io::stderr().lock(), "{line}");
}

/// Warnings, on stderr.
pub(crate) fn say_warnings(warnings: &[Warning]) {
    for warning in warnings {
        say(&format!("warning [{}]: {}", warning.code, warning.message));
    }
}

/// The answer, on stdout: JSON, or `table` where a person looks.
pub(crate) fn answer(
    format: Format,
    value: &impl Serialize,
    table: impl FnOnce() -> Table,
) -> anyhow::Result<()> {
    let mut out = std::io::stdout().lock();
    let as_table = match format {
        Format::Auto => out.is_terminal(),
        Format::Table => true,
        Format::Json => false,
    };
    let text = if as_table {
        let mut shown = table();
        numbers_to_the_right(&mut shown);
        shown.to_string()
    } else {
        serde_json::to_string_pretty(value)?
    };
    on_stdout(writeln!(out, "{text}"))
}

/// Says of a failure that it is stdout that could not be written; one that nobody reads any more is none.
pub(crate) fn on_stdout(written: std::io::Result<()>) -> anyhow::Result<()> {
    match written {
        Err(error) if error.kind() == std::io::ErrorKind::BrokenPipe => Ok(()),
        written => written.context("stdout: cannot write the answer"),
    }
}

/// Rules above and below and under the header, none between rows.
const STYLE: TableStyle = {
    let rule = LineStyle::none().fill('─').junction('─');
    TableStyle::new()
        .top_border(rule)
        .header_separator(rule)
        .bottom_border(rule)
};

/// Aligns the columns that hold nothing but numbers and marks of what is missing.
fn numbers_to_the_right(table: &mut Table) {
    let is_number = |text: &str| text.trim().trim_end_matches('%').parse::<f64>().is_ok();
    for index in 0..table.column_iter().count() {
        let cells = || {
            table
                .column_cells_iter(index)
                .flatten()
                .map(|cell| cell.content())
        };
        let numeric = cells().all(|text| text.is_empty() || text == "–" || is_number(&text))
            && cells().any(|text| is_number(&text));
        if let Some(column) = table.column_mut(index).filter(|_| numeric) {
            column.set_cell_alignment(CellAlignment::Right);
        }
    }
}

/// An empty table in the house style.
pub(crate) fn table(header: &[&str]) -> Table {
    let mut table = Table::new();
    table.load_style(STYLE).set_header(header);
    table
}

/// A table of names and values.
pub(crate) fn pairs(rows: &[(&str, String)]) -> Table {
    let mut table = Table::new();
    table.load_style(STYLE);
    for (name, value) in rows {
        table.add_row([*name, value.as_str()]);
    }
    table
}
