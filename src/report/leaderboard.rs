//! Records side by side: who is best, scene by scene. Records of different protocols, profiles,
//! splits, units or thresholds never stand in one board.

use super::record::Record;
use super::table::{Cell, MISSING, Table, emphasise};
use crate::error::{Error, Result};
use std::collections::{BTreeMap, BTreeSet};

/// The scenes of Tanks and Temples in the order of its site: training, intermediate, advanced.
const SITE_ORDER: [&str; 21] = [
    "Barn",
    "Caterpillar",
    "Church",
    "Courthouse",
    "Ignatius",
    "Meetingroom",
    "Truck",
    "Family",
    "Francis",
    "Horse",
    "Lighthouse",
    "M60",
    "Panther",
    "Playground",
    "Train",
    "Auditorium",
    "Ballroom",
    "Courtroom",
    "Museum",
    "Palace",
    "Temple",
];

/// A number of a record by which methods are compared.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Metric {
    /// Harmonic mean of precision and recall.
    FScore,
    /// Fraction of the reconstruction near the truth.
    Precision,
    /// Fraction of the truth near the reconstruction.
    Recall,
    /// Mean distance from reconstruction to truth.
    Accuracy,
    /// Mean distance from truth to reconstruction.
    Completeness,
    /// Mean of accuracy and completeness.
    Overall,
}

impl Metric {
    /// All of them, the most asked for first.
    pub const ALL: [Self; 6] = [
        Self::FScore,
        Self::Precision,
        Self::Recall,
        Self::Accuracy,
        Self::Completeness,
        Self::Overall,
    ];

    /// The name that tables show.
    pub fn name(self) -> &'static str {
        match self {
            Self::FScore => "F-score",
            Self::Precision => "precision",
            Self::Recall => "recall",
            Self::Accuracy => "accuracy",
            Self::Completeness => "completeness",
            Self::Overall => "overall",
        }
    }

    /// Whether it is a fraction, of which more is better; otherwise a distance.
    pub fn is_fraction(self) -> bool {
        matches!(self, Self::FScore | Self::Precision | Self::Recall)
    }

    fn of(self, record: &Record) -> Option<f64> {
        match self {
            Self::FScore => record.fscore,
            Self::Precision => record.precision,
            Self::Recall => record.recall,
            Self::Accuracy => record.acc_mean,
            Self::Completeness => record.comp_mean,
            Self::Overall => record.overall,
        }
    }
}

/// What all records of a board have in common.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub struct Common {
    /// The protocol.
    pub protocol: String,
    /// The profile.
    pub profile: String,
    /// The split.
    pub split: String,
    /// The unit of distances.
    pub unit: String,
    /// The threshold as text where scenes were scored at several; empty where each scene has one.
    pub threshold: String,
}

/// One method's records, scene by scene.
#[derive(Debug, Clone, PartialEq)]
pub struct Entry {
    /// The method; with its group in brackets where it has one.
    pub label: String,
    /// Records in the order of the board's scenes; `None` where there is none.
    pub records: Vec<Option<Record>>,
}

/// Methods × scenes, all comparable.
#[derive(Debug, Clone, PartialEq)]
pub struct Board {
    /// What makes them comparable.
    pub common: Common,
    /// Scenes in the site's order, others after them by name.
    pub scenes: Vec<String>,
    /// The threshold of each scene.
    pub thresholds: Vec<Option<f64>>,
    /// Methods by label.
    pub entries: Vec<Entry>,
}

/// One method's place in one metric.
#[derive(Debug, Clone, PartialEq)]
pub struct Ranked {
    /// The method.
    pub label: String,
    /// 1 for the best mean rank; equals share the better place. `None` when a scene is missing.
    pub rank: Option<usize>,
    /// Mean over scenes of the place in that scene.
    pub mean_rank: Option<f64>,
    /// Arithmetic mean over all scenes of the board; `None` when one is missing.
    pub mean: Option<f64>,
    /// The values, scene by scene.
    pub values: Vec<Option<f64>>,
}

/// Sorts records into boards. Fails when a method has two records for the same cell, or a value is
/// no number.
pub fn boards(records: &[Record]) -> Result<Vec<Board>> {
    let mut groups: BTreeMap<Common, Vec<&Record>> = BTreeMap::new();
    for record in records {
        groups.entry(common(record)).or_default().push(record);
    }
    let mut split = BTreeMap::new();
    for (common, records) in groups {
        if one_threshold_per_scene(&records) {
            split.insert(common, records);
            continue;
        }
        for record in records {
            let threshold = record.threshold.map(|t| t.to_string()).unwrap_or_default();
            let common = Common {
                threshold,
                ..common.clone()
            };
            split.entry(common).or_insert_with(Vec::new).push(record);
        }
    }
    split
        .into_iter()
        .map(|(common, records)| board(common, &records))
        .collect()
}

fn common(record: &Record) -> Common {
    Common {
        protocol: record.protocol.clone(),
        profile: record.profile.clone(),
        split: record.split.clone(),
        unit: record.unit.clone(),
        threshold: String::new(),
    }
}

fn one_threshold_per_scene(records: &[&Record]) -> bool {
    let mut thresholds: BTreeMap<&str, Option<u64>> = BTreeMap::new();
    records.iter().all(|record| {
        let bits = record.threshold.map(f64::to_bits);
        *thresholds.entry(&record.scene).or_insert(bits) == bits
    })
}

fn label(record: &Record) -> String {
    if record.group.is_empty() {
        return record.method.clone();
    }
    format!("{} ({})", record.method, record.group)
}

fn site_place(scene: &str) -> (usize, &str) {
    let place = SITE_ORDER.iter().position(|&known| known == scene);
    (place.unwrap_or(SITE_ORDER.len()), scene)
}

fn board(common: Common, records: &[&Record]) -> Result<Board> {
    let distinct: BTreeSet<&str> = records.iter().map(|r| r.scene.as_str()).collect();
    let mut scenes: Vec<String> = distinct.into_iter().map(str::to_owned).collect();
    scenes.sort_by(|a, b| site_place(a).cmp(&site_place(b)));
    let mut thresholds = vec![None; scenes.len()];
    let mut rows: BTreeMap<String, Vec<Option<Record>>> = BTreeMap::new();
    for &record in records {
        check(record)?;
        let row = rows
            .entry(label(record))
            .or_insert_with(|| vec![None; scenes.len()]);
        for (index, scene) in scenes.iter().enumerate() {
            if *scene != record.scene {
                continue;
            }
            thresholds[index] = record.threshold;
            if row[index].replace(record.clone()).is_some() {
                return Err(duplicate(record));
            }
        }
    }
    let entries = rows
        .into_iter()
        .map(|(label, records)| Entry { label, records })
        .collect();
    Ok(Board {
        common,
        scenes,
        thresholds,
        entries,
    })
}

fn check(record: &Record) -> Result<()> {
    for metric in Metric::ALL {
        if let Some(value) = metric.of(record).filter(|value| !value.is_finite()) {
            let (name, scene) = (metric.name(), &record.scene);
            let problem = format!(
                "{name} of {} on {scene}: expected a number, found {value}",
                record.method
            );
            return Err(Error::invalid("records", problem));
        }
    }
    Ok(())
}

fn duplicate(record: &Record) -> Error {
    let threshold = record.threshold.map(|t| t.to_string()).unwrap_or_default();
    let problem = format!(
        "expected one record per cell, found two for {} on {} at threshold {threshold} ({} {}); \
         leave one out or give the methods different names",
        label(record),
        record.scene,
        record.protocol,
        record.profile
    );
    Error::invalid("records", problem)
}

impl Board {
    /// Whether any record has this metric.
    pub fn has(&self, metric: Metric) -> bool {
        let mut records = self.entries.iter().flat_map(|entry| &entry.records);
        records.any(|record| record.as_ref().is_some_and(|r| metric.of(r).is_some()))
    }

    /// The methods by mean rank, then mean, then name. Those that miss a scene have no mean and no
    /// rank and come last.
    pub fn ranking(&self, metric: Metric) -> Vec<Ranked> {
        let sign = if metric.is_fraction() { 1.0 } else { -1.0 };
        let values: Vec<Vec<Option<f64>>> = self
            .entries
            .iter()
            .map(|entry| {
                let value = |record: &Option<Record>| record.as_ref().and_then(|r| metric.of(r));
                entry.records.iter().map(value).collect()
            })
            .collect();
        let place = |row: usize, scene: usize| {
            let own = values[row][scene]?;
            let better = values
                .iter()
                .filter(|other| other[scene].is_some_and(|other| sign * other > sign * own));
            #[allow(clippy::cast_precision_loss, reason = "a few methods")]
            Some(better.count() as f64 + 1.0)
        };
        let mut ranked: Vec<Ranked> = (0..values.len())
            .map(|row| Ranked {
                label: self.entries[row].label.clone(),
                rank: None,
                mean_rank: mean((0..self.scenes.len()).map(|scene| place(row, scene))),
                mean: mean(values[row].iter().copied()),
                values: values[row].clone(),
            })
            .collect();
        let last = f64::INFINITY;
        ranked.sort_by(|a, b| {
            let by_rank = a
                .mean_rank
                .unwrap_or(last)
                .total_cmp(&b.mean_rank.unwrap_or(last));
            let by_mean =
                (sign * b.mean.unwrap_or(-last)).total_cmp(&(sign * a.mean.unwrap_or(-last)));
            by_rank.then(by_mean).then(a.label.cmp(&b.label))
        });
        number(&mut ranked);
        ranked
    }

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

/// The mean if all values are there.
fn mean(values: impl Iterator<Item = Option<f64>>) -> Option<f64> {
    let all: Vec<f64> = values.collect::<Option<_>>()?;
    #[allow(clippy::cast_precision_loss, reason = "a few scenes")]
    let count = all.len() as f64;
    (!all.is_empty()).then(|| all.iter().sum::<f64>() / count)
}

/// Numbers sorted rows; equal mean ranks share the better number.
fn number(ranked: &mut [Ranked]) {
    for row in 0..ranked.len() {
        if ranked[row].mean_rank.is_none() {
            continue;
        }
        let same = row > 0 && ranked[row - 1].mean_rank == ranked[row].mean_rank;
        ranked[row].rank = if same {
            ranked[row - 1].rank
        } else {
            Some(row + 1)
        };
    }
}

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
