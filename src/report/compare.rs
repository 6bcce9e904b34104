//! Two sets of records side by side: what became better, what worse, beyond the stated uncertainty.

use super::basis;
use super::leaderboard::{is_sound, label};
use super::record::Record;
use crate::error::{Error, Result};
use serde::Serialize;
use std::collections::{BTreeMap, BTreeSet};

/// How two sets are compared.
#[derive(Debug, Clone, PartialEq)]
pub struct CompareOptions {
    /// F-score differences up to this are no differences, whatever the records' intervals say.
    pub tolerance: f64,
    /// Whether sets of different protocols, profiles, truths, crops or samplings of meshes may be
    /// compared at all.
    pub mixing: Mixing,
}

/// What to do about records whose numbers mean different things.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Mixing {
    /// An error.
    #[default]
    Refused,
    /// Records are paired by scene and threshold alone.
    Allowed,
}

impl Default for CompareOptions {
    fn default() -> Self {
        Self {
            tolerance: 1e-9,
            mixing: Mixing::Refused,
        }
    }
}

/// What a difference means.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Outcome {
    /// Within the uncertainty.
    Same,
    /// Better beyond it.
    Better,
    /// Worse beyond it.
    Worse,
}

/// One cell of both sets.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Difference {
    /// Procedure, split, method, scene and threshold, as far as they tell cells apart.
    pub cell: String,
    /// The first set's F-score, 0 to 1.
    pub before: f64,
    /// The second set's.
    pub after: f64,
    /// How far the two may differ by chance: the root of the summed squares of both confidence
    /// intervals' half widths, or the tolerance where that is larger.
    pub uncertainty: f64,
    /// What it means.
    pub outcome: Outcome,
}

/// Both sets, cell by cell.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct Comparison {
    /// Cells of both.
    pub differences: Vec<Difference>,
    /// Cells that have an F-score that passed its gates in the first set alone: the second misses them, or its
    /// status follows in brackets.
    pub lost: Vec<String>,
    /// Cells that have an F-score in the second set alone, or one that passed its gates there alone.
    pub gained: Vec<String>,
    /// Cells that have distances but no F-score, and of which nothing is said.
    pub passed_over: Vec<String>,
    /// Cells of both that rest on another truth, crop or sampling of meshes, and on which.
    pub mixed: Vec<String>,
}

impl Comparison {
    /// Whether a cell became worse or was lost.
    pub fn is_regression(&self) -> bool {
        let mut worse = self.differences.iter();
        worse.any(|difference| difference.outcome == Outcome::Worse) || !self.lost.is_empty()
    }
}

/// Compares the F-scores of `after` with those of `before`. A score whose status is not `ok` is no score
/// beside one whose status is, as in leaderboards, nor beside none; two such are compared. Methods are paired by name,
/// unless both sets hold a single one; splits where a set has the same cell in several.
///
/// # Errors
/// Scores of different protocols, profiles or units, and cells of different truths, crops or samplings of meshes,
/// unless they may be mixed; a cell that is there twice; no cell in common, or none of those with an F-score.
pub fn compare(
    before: &[Record],
    after: &[Record],
    options: &CompareOptions,
) -> Result<Comparison> {
    if options.mixing == Mixing::Refused {
        same_procedure(before, after)?;
    }
    let mut naming = Naming {
        methods: methods(before).len() > 1 || methods(after).len() > 1,
        procedures: has_several_procedures(before, after),
        splits: false,
    };
    naming.splits = naming.has_twins(before) || naming.has_twins(after);
    let first = cells(before, naming)?;
    let second = cells(after, naming)?;
    let mut comparison = Comparison::default();
    let passed_over = first.iter().chain(&second);
    let passed_over = passed_over.filter(|(_, record)| is_of_distances(record));
    let passed_over: BTreeSet<String> = passed_over.map(|(cell, _)| cell.name()).collect();
    comparison.passed_over = passed_over.into_iter().collect();
    for (cell, old) in &first {
        let Some(before) = old.fscore else { continue };
        let new = second.get(cell).copied();
        let scored = new.and_then(|new| Some((new.fscore?, new)));
        let Some((after, new)) = scored.filter(|(_, new)| is_sound(new) || !is_sound(old)) else {
            if is_sound(old) {
                comparison.lost.push(with_status(&cell.name(), new));
            }
            continue;
        };
        if is_sound(new) && !is_sound(old) {
            comparison.gained.push(with_status(&cell.name(), Some(old)));
            continue;
        }
        if let Some(change) = basis::change(old, new) {
            comparison.mixed.push(format!("{}: {change}", cell.name()));
        }
        let uncertainty = libm::hypot(half_width(old), half_width(new)).max(options.tolerance);
        comparison
            .differences
            .push(difference(cell.name(), (before, after), uncertainty));
    }
    if options.mixing == Mixing::Refused && !comparison.mixed.is_empty() {
        return Err(mixed(&comparison.mixed));
    }
    let unscored = |cell: &&Cell| first.get(*cell).is_none_or(|old| old.fscore.is_none());
    let new_cells = second.iter().filter(|(_, new)| new.fscore.is_some());
    let new_cells = new_cells.filter(|(cell, _)| unscored(cell));
    let new_cells = new_cells.map(|(cell, new)| with_status(&cell.name(), Some(*new)));
    comparison.gained.extend(new_cells);
    comparison.gained.sort();
    // What was scored on one side and failed on the other is in both.
    let mut in_both = first
        .iter()
        .filter_map(|(cell, old)| Some((*old, *second.get(cell)?)));
    let is_scored = |(old, new): (&Record, &Record)| old.fscore.or(new.fscore).is_some();
    match in_both.clone().any(is_scored) {
        true => Ok(comparison),
        false => Err(nothing_to_compare(in_both.next().is_some())),
    }
}

/// Why no cell has an F-score on both sides.
fn nothing_to_compare(in_common: bool) -> Error {
    let why = match in_common {
        true => "what they have in common has none",
        false => "the sets have no method, scene and threshold in common",
    };
    let problem = format!("expected cells with an F-score in both, found none: {why}");
    Error::invalid("compare", problem)
}

/// The cell; with the status of its record in brackets, where that is not `ok`.
fn with_status(cell: &str, record: Option<&Record>) -> String {
    match record.filter(|record| !is_sound(record)) {
        Some(record) => format!("{cell} ({})", record.status),
        None => cell.to_owned(),
    }
}

fn mixed(cells: &[String]) -> Error {
    let more = match cells.len() {
        0 | 1 => String::new(),
        several => format!(" (and so in {} more cells)", several - 1),
    };
    let problem = format!(
        "expected both sets scored against the same truths, in the same crops and with the same sampling \
         of meshes, found {}{more}; their numbers mean different things (allow mixing to compare them all the \
         same)",
        cells.first().map_or("", String::as_str)
    );
    Error::invalid("compare", problem)
}

/// Whether there are distances but no F-score.
fn is_of_distances(record: &Record) -> bool {
    let distances = [record.acc_mean, record.comp_mean, record.overall];
    record.fscore.is_none() && distances.iter().any(Option::is_some)
}

/// The methods of two sets that hold one each, where these are not the same.
pub fn other_method(before: &[Record], after: &[Record]) -> Option<[String; 2]> {
    let [first, second] = [before, after].map(methods);
    let is_apart = first.len() == 1 && second.len() == 1 && first != second;
    is_apart.then(|| [before, after].map(|records| label(&records[0])))
}

fn difference(cell: String, (before, after): (f64, f64), uncertainty: f64) -> Difference {
    // What .8 and .7 differ by is a little more than .1 in binary.
    let uncertain = uncertainty + 4.0 * f64::EPSILON;
    let outcome = if after - before > uncertain {
        Outcome::Better
    } else if before - after > uncertain {
        Outcome::Worse
    } else {
        Outcome::Same
    };
    Difference {
        cell,
        before,
        after,
        uncertainty,
        outcome,
    }
}

fn half_width(record: &Record) -> f64 {
    match (record.f_ci_lo, record.f_ci_hi) {
        (Some(low), Some(high)) => 0.5 * (high - low).max(0.0),
        _ => 0.0,
    }
}

fn methods(records: &[Record]) -> BTreeSet<(&str, &str)> {
    records
        .iter()
        .map(|r| (r.method.as_str(), r.group.as_str()))
        .collect()
}

fn procedure(record: &Record) -> String {
    let parts = [&record.protocol, &record.profile, &record.unit];
    let named: Vec<&str> = parts
        .into_iter()
        .filter(|p| !p.is_empty())
        .map(String::as_str)
        .collect();
    named.join(" ")
}

/// The procedures that gave scores; failures may not say all of theirs.
fn procedures(records: &[Record]) -> BTreeSet<String> {
    let scored = records.iter().filter(|record| record.fscore.is_some());
    scored.map(procedure).collect()
}

/// Whether cells must say their procedure: a set has several, and one that the other has.
fn has_several_procedures(before: &[Record], after: &[Record]) -> bool {
    let (first, second) = (procedures(before), procedures(after));
    first.len().max(second.len()) > 1 && !first.is_disjoint(&second)
}

/// An error where a set has scores of a procedure that the other does not even name in a failure.
fn same_procedure(before: &[Record], after: &[Record]) -> Result<()> {
    let (first, second) = (procedures(before), procedures(after));
    let all = |records: &[Record]| records.iter().map(procedure).collect::<BTreeSet<_>>();
    let are_named = first.is_subset(&all(after)) && second.is_subset(&all(before));
    if are_named || first.is_empty() || second.is_empty() {
        return Ok(());
    }
    let list = |set: &BTreeSet<String>| set.iter().cloned().collect::<Vec<_>>().join(", ");
    let problem = format!(
        "expected both sets from the same protocols, profiles and units, found {} and {}; their \
         numbers mean different things (allow mixing to compare them all the same)",
        list(&first),
        list(&second)
    );
    Err(Error::invalid("compare", problem))
}

/// What tells cells apart beside scene and threshold.
#[derive(Debug, Clone, Copy)]
struct Naming {
    methods: bool,
    procedures: bool,
    splits: bool,
}

/// What pairs records of both sets; a text is empty where it does not tell cells apart.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
struct Cell {
    procedure: String,
    split: String,
    method: String,
    group: String,
    scene: String,
    /// As bits, which thresholds are sorted by as well: they are above 0.
    threshold: Option<u64>,
}

impl Cell {
    fn name(&self) -> String {
        let threshold = self.threshold.map(f64::from_bits);
        let threshold = threshold.map_or_else(String::new, |threshold| format!("τ {threshold}"));
        let texts = [
            &self.procedure,
            &self.split,
            &self.method,
            &self.group,
            &self.scene,
            &threshold,
        ];
        let told = texts.into_iter().filter(|text| !text.is_empty());
        told.map(String::as_str).collect::<Vec<_>>().join(" · ")
    }
}

impl Naming {
    fn cell(self, record: &Record) -> Cell {
        let of = |is_told: bool, text: &str| if is_told { text } else { "" }.to_owned();
        Cell {
            procedure: of(self.procedures, &procedure(record)),
            split: of(self.splits, &record.split),
            method: of(self.methods, &record.method),
            group: of(self.methods, &record.group),
            scene: record.scene.clone(),
            threshold: record.threshold.map(f64::to_bits),
        }
    }

    /// Whether two records are of one cell.
    fn has_twins(self, records: &[Record]) -> bool {
        let mut seen = BTreeSet::new();
        let mut records = records.iter();
        records.any(|record| !seen.insert(self.cell(record)))
    }
}

fn cells(records: &[Record], naming: Naming) -> Result<BTreeMap<Cell, &Record>> {
    let mut cells = BTreeMap::new();
    for record in records {
        let cell = naming.cell(record);
        if cells.contains_key(&cell) {
            let cell = cell.name();
            let problem = format!("expected one record per cell, found two for {cell}");
            return Err(Error::invalid("compare", problem));
        }
        cells.insert(cell, record);
    }
    Ok(cells)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn record(scene: &str, f: f64, half: f64) -> Record {
        Record {
            protocol: "tnt".into(),
            scene: scene.into(),
            threshold: Some(0.01),
            fscore: Some(f),
            f_ci_lo: Some(f - half),
            f_ci_hi: Some(f + half),
            ..Record::default()
        }
    }

    fn compared(before: &[Record], after: &[Record]) -> Comparison {
        compare(before, after, &CompareOptions::default()).unwrap()
    }

    /// Scores by two profiles, of which one failed after; and by one alone.
    #[test]
    fn a_procedure_that_failed_is_lost_and_one_alone_may_be_mixed_with_two() {
        let by = |profile: &str, f: Option<f64>| Record {
            profile: profile.into(),
            fscore: f,
            status: if f.is_some() { "ok" } else { "failed: x" }.into(),
            ..record("Barn", 0.5, 0.0)
        };
        let both = [by("strict", Some(0.5)), by("official", Some(0.6))];
        let failed = [by("strict", Some(0.5)), by("official", None)];
        let found = compared(&both, &failed);
        assert_eq!(found.lost, ["tnt official · Barn · τ 0.01 (failed: x)"]);
        assert_eq!(found.differences.len(), 1);
        assert_eq!(compared(&failed, &both).gained.len(), 1);
        let alone = &both[..1];
        let refused = compare(&both, alone, &CompareOptions::default());
        assert!(refused.unwrap_err().to_string().contains("same protocols"));
        let mixing = CompareOptions {
            mixing: Mixing::Allowed,
            ..CompareOptions::default()
        };
        let mixed = compare(&both, alone, &mixing).unwrap();
        assert_eq!(mixed.lost, ["tnt official · Barn · τ 0.01"]);
        assert_eq!(mixed.differences[0].outcome, Outcome::Same);
    }

    #[test]
    fn cells_of_several_splits_are_paired_by_split_and_those_of_one_by_scene_alone() {
        let of = |split: &str, f: f64| Record {
            split: split.into(),
            ..record("Barn", f, 0.0)
        };
        let both = [of("training", 0.5), of("rerun", 0.6)];
        let itself = compared(&both, &both);
        let cells: Vec<&str> = itself.differences.iter().map(|d| d.cell.as_str()).collect();
        assert_eq!(cells, ["rerun · Barn · τ 0.01", "training · Barn · τ 0.01"]);
        assert!(!itself.is_regression());
        let worse = compared(&both, &[of("rerun", 0.6), of("training", 0.4)]);
        let outcomes: Vec<Outcome> = worse.differences.iter().map(|d| d.outcome).collect();
        assert_eq!(outcomes, [Outcome::Same, Outcome::Worse]);
        assert_eq!(compared(&both, &both[..1]).lost, ["rerun · Barn · τ 0.01"]);
        let one = compared(&both[..1], &[of("", 0.5)]);
        assert_eq!(one.differences[0].cell, "Barn · τ 0.01");
    }

    #[test]
    fn names_that_look_alike_joined_are_different_cells() {
        let of = |method: &str, scene: &str, f: f64| Record {
            method: method.into(),
            ..record(scene, f, 0.0)
        };
        let both = [of("a · b", "c", 0.5), of("a", "b · c", 0.6)];
        let found = compared(&both, &both);
        let values: Vec<f64> = found.differences.iter().map(|d| d.after).collect();
        assert_eq!(values, [0.6, 0.5]);
        assert!(!found.is_regression());
    }

    #[test]
    fn only_a_drop_beyond_the_uncertainty_is_a_regression() {
        // Half widths .003 and .004 add up to .005.
        let before = [record("Barn", 0.5, 0.003)];
        let inside = compared(&before, &[record("Barn", 0.4951, 0.004)]);
        assert_eq!(inside.differences[0].outcome, Outcome::Same);
        assert!(!inside.is_regression());
        let outside = compared(&before, &[record("Barn", 0.4949, 0.004)]);
        assert_eq!(outside.differences[0].outcome, Outcome::Worse);
        assert!(outside.is_regression());
        let better = compared(&before, &[record("Barn", 0.51, 0.004)]);
        assert_eq!(better.differences[0].outcome, Outcome::Better);
        assert!(!better.is_regression());
    }

    #[test]
    fn a_lost_scene_is_a_regression_and_a_gained_one_is_not() {
        let (barn, truck) = (record("Barn", 0.5, 0.0), record("Truck", 0.6, 0.0));
        let lost = compared(&[barn.clone(), truck.clone()], std::slice::from_ref(&barn));
        assert!(lost.is_regression());
        assert_eq!(lost.lost, ["Truck · τ 0.01"]);
        let gained = compared(std::slice::from_ref(&barn), &[barn.clone(), truck]);
        assert!(!gained.is_regression());
        assert_eq!(gained.gained, ["Truck · τ 0.01"]);
    }

    #[test]
    fn a_score_that_failed_its_gates_is_lost_whatever_its_number() {
        let failed = |f: f64| Record {
            status: "gate: few-inliers".into(),
            ..record("Barn", f, 0.0)
        };
        let sound = [record("Barn", 0.5, 0.0)];
        let lost = compared(&sound, &[failed(0.6)]);
        assert_eq!(lost.lost, ["Barn · τ 0.01 (gate: few-inliers)"]);
        assert!(lost.is_regression() && lost.differences.is_empty());
        let gained = compared(&[failed(0.6)], &sound);
        assert_eq!(gained.gained, ["Barn · τ 0.01 (gate: few-inliers)"]);
        assert!(!gained.is_regression() && gained.differences.is_empty());
        // A failed one is not lost.
        let missing = compared(
            &[failed(0.6), record("Truck", 0.5, 0.0)],
            &[record("Truck", 0.5, 0.0)],
        );
        assert!(!missing.is_regression() && missing.differences.len() == 1);
        // Neither is any better than its status: what they say is all there is to compare.
        let both = compared(&[failed(0.6)], &[failed(0.5)]);
        assert_eq!(both.differences[0].outcome, Outcome::Worse);
    }

    #[test]
    fn protocols_are_not_mixed_unless_told() {
        let before = [record("Barn", 0.5, 0.0)];
        let mut other = record("Barn", 0.4, 0.0);
        other.profile = "strict".into();
        let after = [other];
        let error = compare(&before, &after, &CompareOptions::default()).unwrap_err();
        assert!(
            error.to_string().contains("found tnt and tnt strict"),
            "{error}"
        );
        let options = CompareOptions {
            mixing: Mixing::Allowed,
            ..CompareOptions::default()
        };
        assert!(compare(&before, &after, &options).unwrap().is_regression());
    }

    #[test]
    fn another_truth_crop_or_sampling_is_refused_by_name_unless_mixed() {
        let of = |truth: &str, crop: &str, f: f64| Record {
            truth_sha256: truth.into(),
            crop_sha256: crop.into(),
            ..record("Barn", f, 0.0)
        };
        let before = [of("aa", "", 0.5)];
        let options = CompareOptions::default();
        for (after, said) in [
            (of("bb", "", 0.6), "Barn · τ 0.01: truth aa and bb;"),
            (of("aa", "cc", 0.6), "Barn · τ 0.01: crop none and cc;"),
        ] {
            let error = compare(&before, std::slice::from_ref(&after), &options).unwrap_err();
            assert!(error.to_string().contains(said), "{error}");
            let mixed = CompareOptions {
                mixing: Mixing::Allowed,
                ..options.clone()
            };
            let compared = compare(&before, &[after], &mixed).unwrap();
            assert_eq!(compared.differences[0].outcome, Outcome::Better);
            assert_eq!(compared.mixed.len(), 1);
        }
        // Nothing is known of the truth of records put together by hand.
        assert_eq!(
            compared(&before, &[record("Barn", 0.5, 0.0)]).mixed.len(),
            0
        );
    }

    #[test]
    fn nothing_in_common_is_an_error() {
        let (barn, truck) = (record("Barn", 0.5, 0.0), record("Truck", 0.6, 0.0));
        let options = CompareOptions::default();
        let said = |before: &Record, after: &Record| {
            let one = std::slice::from_ref;
            compare(one(before), one(after), &options)
                .unwrap_err()
                .to_string()
        };
        assert!(said(&barn, &truck).ends_with("no method, scene and threshold in common"));
        let distances = Record {
            fscore: None,
            acc_mean: Some(0.5),
            ..record("Barn", 0.5, 0.0)
        };
        assert!(said(&distances, &distances).ends_with("what they have in common has none"));
        assert!(compare(&[barn.clone(), barn.clone()], &[barn], &options).is_err());
    }
}
