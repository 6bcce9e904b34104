//! Which boards a record stands in by its threshold.

use super::leaderboard::Metric;
use super::record::Record;
use mvs_datasets::layout::tnt::known_tolerance;
use std::collections::{BTreeMap, BTreeSet};

/// What stands for the threshold of scores that name none, where others of their scene do.
pub const NO_THRESHOLD: &str = "none";

/// Per scene the threshold of the main board, as bits. An error where no scene tells which of its
/// several thresholds is the main one: all of them, as texts.
pub(super) fn main_thresholds<'a>(
    records: &[&'a Record],
) -> std::result::Result<BTreeMap<&'a str, u64>, BTreeSet<String>> {
    let mut scenes: BTreeMap<&str, BTreeMap<u64, usize>> = BTreeMap::new();
    let mut everywhere: BTreeMap<u64, usize> = BTreeMap::new();
    for record in records {
        let Some(threshold) = record.threshold else {
            continue;
        };
        let of_scene = scenes.entry(&record.scene).or_default();
        *of_scene.entry(threshold.to_bits()).or_default() += 1;
        *everywhere.entry(threshold.to_bits()).or_default() += 1;
    }
    let known = |scene: &str| known_tolerance(scene).map(f64::to_bits);
    let settled = |(scene, found): (&&str, &BTreeMap<u64, usize>)| {
        found.len() == 1 || known(scene).is_some_and(|tau| found.contains_key(&tau))
    };
    if !scenes.is_empty() && !scenes.iter().any(settled) {
        let texts = everywhere
            .keys()
            .map(|&bits| f64::from_bits(bits).to_string());
        return Err(texts.collect());
    }
    let main = |scene: &str, found: &BTreeMap<u64, usize>| {
        let known = known(scene).filter(|tau| found.contains_key(tau));
        // Of the equally common, the smaller.
        let often = |bits: &&u64| (found[*bits], everywhere[*bits], std::cmp::Reverse(**bits));
        known.or_else(|| found.keys().max_by_key(often).copied())
    };
    let scenes = scenes.iter();
    Ok(scenes
        .filter_map(|(&scene, found)| Some((scene, main(scene, found)?)))
        .collect())
}

/// The boards that a record stands in, by their threshold's text.
pub(super) fn boards_of(
    record: &Record,
    main: std::result::Result<&BTreeMap<&str, u64>, &BTreeSet<String>>,
) -> Vec<String> {
    match (record.threshold, main) {
        (Some(threshold), Ok(main))
            if main.get(record.scene.as_str()) == Some(&threshold.to_bits()) =>
        {
            vec![String::new()]
        }
        (Some(threshold), _) => vec![threshold.to_string()],
        (None, main)
            if has_fraction(record)
                && main.map_or(true, |main| main.contains_key(record.scene.as_str())) =>
        {
            vec![NO_THRESHOLD.to_owned()]
        }
        (None, Ok(_)) => vec![String::new()],
        // A failure that has no threshold is missing from all of them.
        (None, Err(all)) => all.iter().cloned().collect(),
    }
}

/// Whether it has a score that a threshold is part of.
fn has_fraction(record: &Record) -> bool {
    let mut metrics = Metric::ALL.into_iter();
    metrics.any(|metric| metric.is_fraction() && metric.of(record).is_some())
}
