//! Records side by side: who is best, scene by scene. Records of different protocols, profiles,
//! splits, units or thresholds never stand in one board.
//!
//! A record whose status is not `ok` failed, or failed a gate: its value, if it has one, is shown and
//! takes no part in ranks and means. So is one that was scored against another truth, in another crop or
//! with another sampling of meshes than most of its scene; boards say so in its status.

use super::basis;
pub use super::leaderboard_tables::{paper_tables, site_tables};
use super::record::Record;
pub use super::thresholds::NO_THRESHOLD;
use super::thresholds::{boards_of, main_thresholds};
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

    /// The record's value.
    pub(super) fn of(self, record: &Record) -> Option<f64> {
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
    /// The threshold as text on the boards of further thresholds of a scene, [`NO_THRESHOLD`] on that
    /// of scores without one beside scores that have one; empty where each scene has its own.
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
    pub values: Vec<Value>,
}

/// A metric's value in one cell.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Value {
    /// The number; `None` where there is none.
    pub shown: Option<f64>,
    /// The number where it takes part in ranks and means: the record's status is `ok`.
    pub counted: Option<f64>,
}

impl Value {
    pub(super) fn of(record: Option<&Record>, metric: Metric) -> Self {
        let shown = record.and_then(|record| metric.of(record));
        Self {
            shown,
            counted: shown.filter(|_| record.is_some_and(is_sound)),
        }
    }
}

/// Whether nothing is known against the record.
pub(super) fn is_sound(record: &Record) -> bool {
    let status = record.status.trim();
    status.is_empty() || status.eq_ignore_ascii_case("ok")
}

/// Whether the record has a value of any metric.
pub(super) fn has_values(record: &Record) -> bool {
    Metric::ALL.iter().any(|metric| metric.of(record).is_some())
}

/// Sorts records into boards. A scene that was scored at several thresholds stands in the main board
/// at its known one (or the commonest), and in boards of their own at the others; where every scene
/// has several unknown ones, each threshold has a board. Fractions without a threshold have a board of
/// their own where others of their scene have one.
///
/// # Errors
/// Names the method that has two records for the same cell, the label that two methods have, and the value that is no
/// finite number.
pub fn boards(records: &[Record]) -> Result<Vec<Board>> {
    let mut groups: BTreeMap<Common, Vec<&Record>> = BTreeMap::new();
    for record in records {
        groups.entry(common(record)).or_default().push(record);
    }
    let mut split = BTreeMap::new();
    for (common, records) in groups {
        let main = main_thresholds(&records);
        for record in records {
            for threshold in boards_of(record, main.as_ref()) {
                let common = Common {
                    threshold,
                    ..common.clone()
                };
                split.entry(common).or_insert_with(Vec::new).push(record);
            }
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

/// What a method is called: its name, with its group in brackets where it has one.
pub(super) fn label(record: &Record) -> String {
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
    let mut systems: BTreeMap<String, (&str, &str)> = BTreeMap::new();
    for &record in records {
        check(record)?;
        let system = (record.method.as_str(), record.group.as_str());
        if *systems.entry(label(record)).or_insert(system) != system {
            return Err(alike(record));
        }
        let row = rows
            .entry(label(record))
            .or_insert_with(|| vec![None; scenes.len()]);
        for (index, scene) in scenes.iter().enumerate() {
            if *scene != record.scene {
                continue;
            }
            thresholds[index] = record.threshold.or(thresholds[index]);
            if row[index].replace(record.clone()).is_some() {
                return Err(duplicate(record));
            }
        }
    }
    for index in 0..scenes.len() {
        let of_scene = rows.values_mut().filter_map(|row| row[index].as_mut());
        basis::set_apart(&mut of_scene.collect::<Vec<_>>());
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

fn alike(record: &Record) -> Error {
    let problem = format!(
        "expected methods that look different, found two that look like {}: one has its group in \
         brackets, the other brackets in its name; give one of them another name",
        label(record)
    );
    Error::invalid("records", problem)
}

fn duplicate(record: &Record) -> Error {
    let problem = format!(
        "expected one record per cell, found two for {}; leave one out or give the methods different names",
        cell(record)
    );
    Error::invalid("records", problem)
}

/// What a record is of, in words.
fn cell(record: &Record) -> String {
    let threshold = record.threshold.map(|t| format!(" at threshold {t}"));
    in_words(record, &threshold.unwrap_or_default())
}

/// What a record is of but for its threshold, in words.
pub fn place(record: &Record) -> String {
    in_words(record, "")
}

fn in_words(record: &Record, threshold: &str) -> String {
    let kind = [
        &record.protocol,
        &record.profile,
        &record.split,
        &record.unit,
    ];
    let kind: Vec<&str> = kind
        .into_iter()
        .map(String::as_str)
        .filter(|word| !word.is_empty())
        .collect();
    let (label, scene) = (label(record), &record.scene);
    format!("{label} on {scene}{threshold} ({})", kind.join(" "))
}

impl Board {
    /// Whether any record has this metric.
    pub fn has(&self, metric: Metric) -> bool {
        let mut records = self.entries.iter().flat_map(|entry| &entry.records);
        records.any(|record| record.as_ref().is_some_and(|r| metric.of(r).is_some()))
    }

    /// A sentence per scene whose records rest on different truths, crops or samplings of meshes.
    pub fn not_comparable(&self) -> Vec<String> {
        let apart = |scene: usize| {
            let of_scene = |entry: &&Entry| {
                entry.records[scene]
                    .as_ref()
                    .is_some_and(basis::is_set_apart)
            };
            let labels = self
                .entries
                .iter()
                .filter(of_scene)
                .map(|entry| entry.label.as_str());
            labels.collect::<Vec<_>>().join(", ")
        };
        let scenes = self.scenes.iter().enumerate();
        let named = scenes.map(|(nth, scene)| (scene, apart(nth)));
        let sentences = named.filter(|(_, labels)| !labels.is_empty()).map(|(scene, labels)| {
            format!(
                "scores of {scene} are against different truths, crops or samplings of meshes: {labels} \
                 stand with a † and take no part in ranks and means (the notes say what differs; score \
                 them alike)"
            )
        });
        sentences.collect()
    }

    /// The methods by mean rank, then mean, then name. Those that miss a scene, or whose score of one
    /// failed a gate, have no mean and no rank and come last.
    pub fn ranking(&self, metric: Metric) -> Vec<Ranked> {
        let sign = if metric.is_fraction() { 1.0 } else { -1.0 };
        let values: Vec<Vec<Value>> = self
            .entries
            .iter()
            .map(|entry| {
                let value = |record: &Option<Record>| Value::of(record.as_ref(), metric);
                entry.records.iter().map(value).collect()
            })
            .collect();
        let place = |row: usize, scene: usize| {
            let own = values[row][scene].counted?;
            let better = values.iter().filter(|other| {
                let other = other[scene].counted;
                other.is_some_and(|other| sign * other > sign * own)
            });
            #[allow(clippy::cast_precision_loss, reason = "a few methods")]
            Some(better.count() as f64 + 1.0)
        };
        let mut ranked: Vec<Ranked> = (0..values.len())
            .map(|row| Ranked {
                label: self.entries[row].label.clone(),
                rank: None,
                mean_rank: mean((0..self.scenes.len()).map(|scene| place(row, scene))),
                mean: mean(values[row].iter().map(|value| value.counted)),
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
}

/// The mean if all values are there.
pub(super) fn mean(values: impl Iterator<Item = Option<f64>>) -> Option<f64> {
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
