//! Tables as Markdown.

use super::table::{Cell, Emphasis, Table};
use std::io::Write;

/// Writes each table with its title as a heading and its notes below.
///
/// # Errors
/// What writing to `out` brings.
pub fn write(out: &mut impl Write, tables: &[Table]) -> std::io::Result<()> {
    for (index, table) in tables.iter().enumerate() {
        if index > 0 {
            writeln!(out)?;
        }
        write_table(out, table)?;
    }
    Ok(())
}

fn write_table(out: &mut impl Write, table: &Table) -> std::io::Result<()> {
    writeln!(out, "## {}\n", escaped(&table.title))?;
    let header: Vec<String> = table.header.iter().map(|name| escaped(name)).collect();
    writeln!(out, "| {} |", header.join(" | "))?;
    let rule = |column: usize| if column < table.labels { ":--" } else { "--:" };
    let rules: Vec<&str> = (0..header.len()).map(rule).collect();
    writeln!(out, "| {} |", rules.join(" | "))?;
    for (index, row) in table.rows.iter().enumerate() {
        let mut cells: Vec<String> = row.iter().map(marked).collect();
        if let Some(first) = cells.first_mut() {
            *first = escaped(table.label_of(index));
        }
        writeln!(out, "| {} |", cells.join(" | "))?;
    }
    for note in &table.notes {
        writeln!(out, "\n{}", paragraph(note))?;
    }
    Ok(())
}

fn marked(cell: &Cell) -> String {
    let text = escaped(&cell.text);
    match cell.emphasis {
        Emphasis::Plain => text,
        Emphasis::Best => format!("**{text}**"),
        Emphasis::Second => format!("<u>{text}</u>"),
    }
}

/// A paragraph of text, whose beginning does not make it a heading, a list, a quotation or code.
fn paragraph(text: &str) -> String {
    let text = escaped(text);
    let text = text.trim_start();
    let digits = text.bytes().take_while(u8::is_ascii_digit).count();
    let (number, rest) = text.split_at(digits);
    let is_mark = match digits {
        0 => rest.starts_with(['#', '-', '+', '>']),
        _ => rest.starts_with(['.', ')']),
    };
    match is_mark {
        true => format!("{number}\\{rest}"),
        false => text.to_owned(),
    }
}

/// Text that Markdown leaves alone within a line.
fn escaped(text: &str) -> String {
    let mut safe = String::with_capacity(text.len());
    for character in text.chars() {
        match character {
            '\\' | '|' | '*' | '_' | '`' | '<' | '[' | '&' | '~' => safe.extend(['\\', character]),
            '\n' | '\r' => safe.push(' '),
            other => safe.push(other),
        }
    }
    safe
}
