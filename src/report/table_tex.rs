//! Tables as LaTeX, with the package `booktabs`.

use super::table::{Cell, Emphasis, MISSING, SUSPECT, Table};
use std::io::Write;

/// Writes each table as a `tabular`, its title and notes as comments.
///
/// # Errors
/// What writing to `out` brings.
pub fn write(out: &mut impl Write, tables: &[Table]) -> std::io::Result<()> {
    writeln!(out, "% needs \\usepackage{{booktabs}}")?;
    for table in tables {
        write_table(out, table)?;
    }
    Ok(())
}

fn write_table(out: &mut impl Write, table: &Table) -> std::io::Result<()> {
    for line in std::iter::once(&table.title).chain(&table.notes) {
        writeln!(out, "% {}", line.replace(['\n', '\r'], " "))?;
    }
    let numbers = table.header.len().saturating_sub(table.labels);
    let columns = "l".repeat(table.labels) + &"r".repeat(numbers);
    writeln!(out, "\\begin{{tabular}}{{{columns}}}\n\\toprule")?;
    let header: Vec<String> = table.header.iter().map(|name| escaped(name)).collect();
    writeln!(out, "{}", line(&header))?;
    for (index, row) in table.rows.iter().enumerate() {
        if index == 0 || (table.rows_per_method > 1 && index % table.rows_per_method == 0) {
            writeln!(out, "\\midrule")?;
        }
        let mut cells: Vec<String> = row.iter().map(marked).collect();
        if let Some(first) = cells.first_mut() {
            *first = escaped(table.label_of(index));
        }
        writeln!(out, "{}", line(&cells))?;
    }
    writeln!(out, "\\bottomrule\n\\end{{tabular}}")
}

/// A row of cells. What it begins with is no argument of the line above it.
fn line(cells: &[String]) -> String {
    let row = cells.join(" & ");
    let apart = if row.starts_with(['[', '*']) {
        "{}"
    } else {
        ""
    };
    format!("{apart}{row} \\\\")
}

fn marked(cell: &Cell) -> String {
    let text = escaped(&cell.text);
    match cell.emphasis {
        Emphasis::Plain => text,
        Emphasis::Best => format!("\\textbf{{{text}}}"),
        Emphasis::Second => format!("\\underline{{{text}}}"),
    }
}

/// Text that LaTeX prints as it is.
fn escaped(text: &str) -> String {
    if text == MISSING {
        return "--".into();
    }
    let mut safe = String::with_capacity(text.len());
    for character in text.chars() {
        match character {
            '&' | '%' | '$' | '#' | '_' | '{' | '}' => safe.extend(['\\', character]),
            SUSPECT => safe.push_str("\\dag{}"),
            '~' => safe.push_str("\\textasciitilde{}"),
            '^' => safe.push_str("\\textasciicircum{}"),
            '<' => safe.push_str("\\textless{}"),
            '>' => safe.push_str("\\textgreater{}"),
            '|' => safe.push_str("\\textbar{}"),
            '\\' => safe.push_str("\\textbackslash{}"),
            '\n' | '\r' => safe.push(' '),
            other => safe.push(other),
        }
    }
    safe
}
