//! Boards as tables: in the form of the benchmark's site and in the papers'.

use super::leaderboard::{Board, Metric, Ranked, mean};
use super::record::Record;
use super::table::{Cell, MISSING, Table, emphasise};
use std::collections::BTreeSet;

/// The boards as the benchmark's site shows them: one table per board and metric, methods ranked,
/// percent with two decimals (distances with four), best bold and second underlined.
pub fn site_tables(boards: &[Board]) -> Vec<Table> {
    boards
        .iter()
        .flat_map(|board| {
            let metrics = Metric::ALL.into_iter().filter(|&metric| board.has(metric));
            metrics.map(|metric| site_table(board, metric))
        })
        .collect()
}

fn site_table(board: &Board, metric: Metric) -> Table {
    let ranked = board.ranking(metric);
    let shown = |value: Option<f64>| match value {
        Some(value) if metric.is_fraction() => format!("{:.2}", 100.0 * value),
        Some(value) => format!("{value:.4}"),
        None => MISSING.to_owned(),
    };
    let optional = |text: Option<String>| Cell::plain(text.unwrap_or_else(|| MISSING.to_owned()));
    let mut rows: Vec<Vec<Cell>> = ranked
        .iter()
        .map(|row| {
            let mut cells = vec![
                Cell::plain(&row.label),
                optional(row.rank.map(|rank| rank.to_string())),
                optional(row.mean_rank.map(|rank| format!("{rank:.2}"))),
                Cell::plain(shown(row.mean)),
            ];
            cells.extend(row.values.iter().map(|&value| Cell::plain(shown(value))));
            cells
        })
        .collect();
    for column in 3..4 + board.scenes.len() {
        let value = |row: &Ranked| {
            if column == 3 {
                row.mean
            } else {
                row.values[column - 4]
            }
        };
        let values: Vec<Option<f64>> = ranked.iter().map(value).collect();
        let mut cells: Vec<&mut Cell> = rows.iter_mut().map(|row| &mut row[column]).collect();
        emphasise(&mut cells, &values, metric.is_fraction(), true);
    }
    let mut header: Vec<String> = ["method", "rank", "mean rank", "mean"]
        .map(String::from)
        .to_vec();
    header.extend(board.scenes.iter().cloned());
    let mut identity = board.identity();
    identity.push(("metric".into(), metric.name().into()));
    Table {
        title: board.title(metric.name()),
        identity,
        notes: board.notes(),
        header,
        labels: 1,
        rows_per_method: 1,
        rows,
    }
}

/// The boards as papers print them: per method the rows precision, recall and F-score, the scenes
/// and their average, fractions with three decimals, best F-score bold. Methods by name.
pub fn paper_tables(boards: &[Board]) -> Vec<Table> {
    let printable = boards.iter().filter(|board| board.has(Metric::FScore));
    printable.map(paper_table).collect()
}

fn paper_table(board: &Board) -> Table {
    let shown =
        |value: Option<f64>| value.map_or(MISSING.to_owned(), |value| format!("{value:.3}"));
    let wanted = [Metric::Precision, Metric::Recall, Metric::FScore];
    let metrics: Vec<Metric> = wanted.into_iter().filter(|&m| board.has(m)).collect();
    let mut rows = Vec::new();
    let mut f_scores: Vec<Vec<Option<f64>>> = Vec::new();
    for entry in &board.entries {
        for &metric in &metrics {
            let value = |record: &Option<Record>| record.as_ref().and_then(|r| metric.of(r));
            let mut values: Vec<Option<f64>> = entry.records.iter().map(value).collect();
            values.push(mean(values.iter().copied()));
            let mut cells = vec![Cell::plain(&entry.label), Cell::plain(metric.name())];
            cells.extend(values.iter().map(|&value| Cell::plain(shown(value))));
            rows.push(cells);
            if metric == Metric::FScore {
                f_scores.push(values);
            }
        }
    }
    for column in 0..=board.scenes.len() {
        let values: Vec<Option<f64>> = f_scores.iter().map(|row| row[column]).collect();
        let of_f = rows
            .iter_mut()
            .skip(metrics.len() - 1)
            .step_by(metrics.len());
        let mut cells: Vec<&mut Cell> = of_f.map(|row| &mut row[column + 2]).collect();
        emphasise(&mut cells, &values, true, false);
    }
    let mut header = vec!["method".to_owned(), "metric".to_owned()];
    header.extend(board.scenes.iter().cloned());
    header.push("Average".into());
    Table {
        title: board.title("Precision, recall and F-score"),
        identity: board.identity(),
        notes: board.notes(),
        header,
        labels: 2,
        rows_per_method: metrics.len(),
        rows,
    }
}

impl Board {
    /// The board as sentences: thresholds, and who misses what.
    fn notes(&self) -> Vec<String> {
        let mut notes = Vec::new();
        let distinct: BTreeSet<Option<u64>> = self
            .thresholds
            .iter()
            .map(|t| t.map(f64::to_bits))
            .collect();
        let unit = unit_suffix(&self.common.unit);
        if let (1, Some(Some(same))) = (distinct.len(), self.thresholds.first()) {
            notes.push(format!("Threshold: {same}{unit}."));
        } else {
            let each = self.scenes.iter().zip(&self.thresholds);
            let each = each.filter_map(|(scene, t)| t.map(|t| format!("{scene} {t}{unit}")));
            let thresholds: Vec<String> = each.collect();
            if !thresholds.is_empty() {
                notes.push(format!("Thresholds: {}.", thresholds.join(", ")));
            }
        }
        for entry in &self.entries {
            let missing: Vec<&str> = self
                .scenes
                .iter()
                .zip(&entry.records)
                .filter(|(_, record)| record.is_none())
                .map(|(scene, _)| scene.as_str())
                .collect();
            if !missing.is_empty() {
                let missing = missing.join(", ");
                notes.push(format!(
                    "{} has no record for {missing}: no mean, no rank.",
                    entry.label
                ));
            }
        }
        notes
    }

    fn identity(&self) -> Vec<(String, String)> {
        let common = &self.common;
        [
            ("protocol", &common.protocol),
            ("profile", &common.profile),
            ("split", &common.split),
            ("threshold", &common.threshold),
        ]
        .map(|(name, value)| (name.to_owned(), value.clone()))
        .to_vec()
    }

    fn title(&self, what: &str) -> String {
        let common = &self.common;
        let mut parts = vec![what.to_owned()];
        let named = [&common.protocol, &common.profile, &common.split];
        parts.extend(named.into_iter().filter(|part| !part.is_empty()).cloned());
        if !common.threshold.is_empty() {
            parts.push(format!(
                "τ = {}{}",
                common.threshold,
                unit_suffix(&common.unit)
            ));
        }
        parts.join(" · ")
    }
}

fn unit_suffix(unit: &str) -> String {
    if unit.is_empty() {
        String::new()
    } else {
        format!(" {unit}")
    }
}
