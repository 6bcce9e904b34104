//! Tables as CSV.

use super::table::Table;
use std::io::Write;

/// Writes all tables into one CSV: first the columns that tell tables apart, then the union of
/// their columns in order of appearance; a cell is empty where its table has no such column.
///
/// # Errors
/// What writing to `out` brings.
pub fn write(out: &mut impl Write, tables: &[Table]) -> std::io::Result<()> {
    let identity = union(tables.iter().map(|table| {
        let names = table.identity.iter().map(|(name, _)| name.as_str());
        names.collect()
    }));
    let columns = union(
        tables
            .iter()
            .map(|table| table.header.iter().map(String::as_str).collect()),
    );
    let mut writer = csv::Writer::from_writer(out);
    writer.write_record(identity.iter().chain(&columns))?;
    for table in tables {
        let value = |name: &&str| {
            let found = table.identity.iter().find(|(known, _)| known == name);
            found.map_or("", |(_, value)| value.as_str())
        };
        for row in &table.rows {
            let cell = |name: &&str| {
                let column = table.header.iter().position(|known| known == name);
                column.map_or("", |column| row[column].text.as_str())
            };
            writer.write_record(identity.iter().map(value).chain(columns.iter().map(cell)))?;
        }
    }
    writer.flush()
}

fn union<'a>(lists: impl Iterator<Item = Vec<&'a str>>) -> Vec<&'a str> {
    let mut all: Vec<&str> = Vec::new();
    for name in lists.flatten() {
        if !all.contains(&name) {
            all.push(name);
        }
    }
    all
}
