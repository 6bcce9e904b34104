//! Boards as tables: in the form of the benchmark's site and in the papers'.

use super::check::is_average;
use super::leaderboard::{
    Board, Common, Entry, Metric, NO_THRESHOLD, Ranked, Value, has_values, is_sound, mean,
};
use super::record::Record;
use super::table::{Better, Cell, MISSING, Marks, SUSPECT, Table, emphasise};
use std::collections::BTreeSet;

/// What columns hold that are no scene's, beside averages.
const OTHER_COLUMNS: [&str; 9] = [
    "method",
    "metric",
    "rank",
    "mean rank",
    "protocol",
    "profile",
    "split",
    "threshold",
    "unit",
];

/// The boards as the benchmark's site shows them: one table per board and metric, methods ranked,
/// percent with two decimals (distances with four, or as many as leave the smallest two digits), best bold and second underlined. Values that
/// failed a gate carry a † and are not marked.
pub fn site_tables(boards: &[Board]) -> Vec<Table> {
    boards
        .iter()
        .flat_map(|board| {
            let has = Metric::ALL.into_iter().filter(|&metric| board.has(metric));
            let mut metrics: Vec<Metric> = has.collect();
            if metrics.is_empty() {
                // Nothing but failures: the table says so.
                metrics.push(Metric::FScore);
            }
            let named = Named::among(board, boards);
            metrics
                .into_iter()
                .map(move |metric| site_table(named, metric))
        })
        .collect()
}

fn site_table(named: Named<'_>, metric: Metric) -> Table {
    let board = named.board;
    let ranked = board.ranking(metric);
    let decimals = decimals_of(&ranked);
    let shown = |value: Option<f64>| match value {
        Some(value) if metric.is_fraction() => format!("{:.2}", 100.0 * value),
        Some(value) => format!("{value:.decimals$}"),
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
            cells.extend(row.values.iter().map(|&value| cell(value, shown)));
            cells
        })
        .collect();
    for column in 3..4 + board.scenes.len() {
        let value = |row: &Ranked| {
            if column == 3 {
                row.mean
            } else {
                row.values[column - 4].counted
            }
        };
        let values: Vec<Option<f64>> = ranked.iter().map(value).collect();
        let mut cells: Vec<&mut Cell> = rows.iter_mut().map(|row| &mut row[column]).collect();
        emphasise(&mut cells, &values, better(metric), Marks::BestAndSecond);
    }
    let mut header: Vec<String> = ["method", "rank", "mean rank", "mean"]
        .map(String::from)
        .to_vec();
    header.extend(named.columns());
    let mut identity = named.identity();
    identity.push(("metric".into(), metric.name().into()));
    let mut notes = board.notes();
    let alike =
        |two: &[Ranked]| two[0].rank != two[1].rank && shown(two[0].mean) == shown(two[1].mean);
    if ranked.windows(2).any(alike) {
        notes.push("Ranks come from all digits, marks from those that are shown.".to_owned());
    }
    Table {
        title: named.title(metric.name()),
        identity,
        notes,
        header,
        labels: 1,
        rows_per_method: 1,
        rows,
    }
}

/// Below this part of the largest distance one is as good as 0.
const NOTHING: f64 = 1e-6;

/// Decimals of distances: four, or as many as leave the smallest two digits that is not as good as 0.
fn decimals_of(ranked: &[Ranked]) -> usize {
    let values = |row: &Ranked| {
        let of_scenes: Vec<Option<f64>> = row.values.iter().map(|value| value.shown).collect();
        of_scenes.into_iter().chain([row.mean])
    };
    let all: Vec<f64> = ranked.iter().flat_map(values).flatten().collect();
    let largest = all.iter().copied().fold(0.0, f64::max);
    let counting = all.into_iter().filter(|&value| value > NOTHING * largest);
    let smallest = counting.fold(1.0, f64::min);
    #[allow(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "between 1 and 324"
    )]
    let wanted = (1.0 - libm::log10(smallest).floor()) as usize;
    wanted.max(4)
}

/// The boards as papers print them: per method the rows precision, recall and F-score, the scenes
/// and their average, fractions with three decimals, best F-score bold. Methods by name.
pub fn paper_tables(boards: &[Board]) -> Vec<Table> {
    let printable = boards.iter().filter(|board| board.has(Metric::FScore));
    printable
        .map(|board| paper_table(Named::among(board, boards)))
        .collect()
}

fn paper_table(named: Named<'_>) -> Table {
    let board = named.board;
    let shown =
        |value: Option<f64>| value.map_or(MISSING.to_owned(), |value| format!("{value:.3}"));
    let wanted = [Metric::Precision, Metric::Recall, Metric::FScore];
    let metrics: Vec<Metric> = wanted.into_iter().filter(|&m| board.has(m)).collect();
    let mut rows = Vec::new();
    let mut f_scores: Vec<Vec<Option<f64>>> = Vec::new();
    for entry in &board.entries {
        for &metric in &metrics {
            let value = |record: &Option<Record>| Value::of(record.as_ref(), metric);
            let values: Vec<Value> = entry.records.iter().map(value).collect();
            let mut counted: Vec<Option<f64>> = values.iter().map(|value| value.counted).collect();
            counted.push(mean(counted.iter().copied()));
            let mut cells = vec![Cell::plain(&entry.label), Cell::plain(metric.name())];
            cells.extend(values.iter().map(|&value| cell(value, shown)));
            cells.push(Cell::plain(shown(counted.last().copied().flatten())));
            rows.push(cells);
            if metric == Metric::FScore {
                f_scores.push(counted);
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
        emphasise(&mut cells, &values, Better::Higher, Marks::Best);
    }
    let mut header = vec!["method".to_owned(), "metric".to_owned()];
    header.extend(named.columns());
    header.push("Average".into());
    Table {
        title: named.title("Precision, recall and F-score"),
        identity: named.identity(),
        notes: board.notes(),
        header,
        labels: 2,
        rows_per_method: metrics.len(),
        rows,
    }
}

/// The name of a scene's column: the scene's, unless another column of our tables, which has those of all `boards`,
/// has it.
fn column_of(scene: &str, boards: &[Board]) -> String {
    let mut taken = OTHER_COLUMNS.iter();
    let mut name = scene.to_owned();
    if is_average(scene) || taken.any(|name| scene.eq_ignore_ascii_case(name)) {
        let scenes = || boards.iter().flat_map(|board| &board.scenes);
        name = format!("scene {name}");
        while scenes().any(|other| *other == name) {
            name = format!("scene {name}");
        }
    }
    name
}

fn better(metric: Metric) -> Better {
    if metric.is_fraction() {
        Better::Higher
    } else {
        Better::Lower
    }
}

/// A value; with a mark where it does not count.
fn cell(value: Value, shown: impl Fn(Option<f64>) -> String) -> Cell {
    let mut text = shown(value.shown);
    if value.shown.is_some() && value.counted.is_none() {
        text.push(SUSPECT);
    }
    Cell::plain(text)
}

impl Board {
    /// The board as sentences: thresholds, who misses what, and whose scores are not to be trusted.
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
            notes.extend(self.notes_on(entry));
        }
        notes
    }

    /// What a method misses.
    fn notes_on(&self, entry: &Entry) -> Vec<String> {
        let mut notes = Vec::new();
        let cells = || self.scenes.iter().zip(&entry.records);
        let missing = cells().filter(|(_, record)| record.is_none());
        let missing: Vec<&str> = missing.map(|(scene, _)| scene.as_str()).collect();
        if !missing.is_empty() {
            let missing = missing.join(", ");
            let label = &entry.label;
            notes.push(format!(
                "{label} has no record for {missing}: no mean, no rank."
            ));
        }
        for (scene, record) in cells() {
            let Some(record) = record.as_ref() else {
                continue;
            };
            let (label, status) = (&entry.label, &record.status);
            if !has_values(record) {
                let status = match status.as_str() {
                    "" => "no status",
                    _ if is_sound(record) => "no numbers",
                    status => status,
                };
                notes.push(format!(
                    "{label} has no score for {scene} ({status}): no mean, no rank."
                ));
            } else if !is_sound(record) {
                notes.push(format!(
                    "{SUSPECT} {label}, {scene}: {status}; no mean, no rank."
                ));
            }
        }
        notes
    }
}

/// A board among others, and whether its unit tells it apart from another one.
#[derive(Clone, Copy)]
struct Named<'a> {
    board: &'a Board,
    boards: &'a [Board],
    by_unit: bool,
}

impl<'a> Named<'a> {
    fn among(board: &'a Board, boards: &'a [Board]) -> Self {
        let differs_in_unit_alone = |other: &Board| {
            let unit = board.common.unit.clone();
            let same = Common {
                unit,
                ..other.common.clone()
            };
            other.common != board.common && same == board.common
        };
        Self {
            board,
            boards,
            by_unit: boards.iter().any(differs_in_unit_alone),
        }
    }

    /// The names of its scenes' columns.
    fn columns(&self) -> impl Iterator<Item = String> {
        let scenes = self.board.scenes.iter();
        scenes.map(|scene| column_of(scene, self.boards))
    }

    fn identity(&self) -> Vec<(String, String)> {
        let common = &self.board.common;
        let unit = self.by_unit.then_some(("unit", &common.unit));
        let names = [
            ("protocol", &common.protocol),
            ("profile", &common.profile),
            ("split", &common.split),
            ("threshold", &common.threshold),
        ];
        let names = names.into_iter().chain(unit);
        names
            .map(|(name, value)| (name.to_owned(), value.clone()))
            .collect()
    }

    fn title(&self, what: &str) -> String {
        let common = &self.board.common;
        let mut parts = vec![what.to_owned()];
        let named = [&common.protocol, &common.profile, &common.split];
        let named = named
            .into_iter()
            .chain(self.by_unit.then_some(&common.unit));
        parts.extend(named.filter(|part| !part.is_empty()).cloned());
        if common.threshold == NO_THRESHOLD {
            parts.push("no threshold given".to_owned());
        } else if !common.threshold.is_empty() {
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
