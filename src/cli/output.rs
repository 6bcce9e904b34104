//! The only place that prints.

use super::common::Format;
use comfy_table::Table;
use comfy_table::presets::UTF8_HORIZONTAL_ONLY;
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
        table().to_string()
    } else {
        serde_json::to_string_pretty(value)?
    };
    match writeln!(out, "{text}") {
        Err(error) if error.kind() == std::io::ErrorKind::BrokenPipe => Ok(()),
        other => Ok(other?),
    }
}

/// An empty table in the house style.
pub(crate) fn table(header: &[&str]) -> Table {
    let mut table = Table::new();
    table.load_style(UTF8_HORIZONTAL_ONLY).set_header(header);
    table
}

/// A table of names and values.
pub(crate) fn pairs(rows: &[(&str, String)]) -> Table {
    let mut table = Table::new();
    table.load_style(UTF8_HORIZONTAL_ONLY);
    for (name, value) in rows {
        table.add_row([*name, value.as_str()]);
    }
    table
}
