//! The rules of the strictest public readers on `pair.txt`.

use super::Finding;
use crate::generate::MOST_SOURCES;
use mvs_datasets::layout::mvsnet::file_name;
use std::collections::{BTreeMap, BTreeSet};

/// `pair.txt` by letter: readers split on single spaces and count lines.
pub(super) fn check(text: &str, cams: &BTreeSet<u32>, findings: &mut Vec<Finding>) {
    let place = || "cams/pair.txt".to_owned();
    let body = text.strip_suffix('\n').unwrap_or(text);
    let lines: Vec<&str> = body.split('\n').collect();
    for (index, line) in lines.iter().enumerate() {
        let untidy = line.is_empty() || line.contains("  ") || line.trim() != *line;
        // The published files end source lines with one space, which readers know.
        if untidy
            && line
                .strip_suffix(' ')
                .is_none_or(|rest| rest.is_empty() || rest.contains("  "))
        {
            let message = format!(
                "expected no blank line and single spaces, found `{line}` on line {}",
                index + 1
            );
            findings.push(Finding::fault("pair-blanks", place(), message));
        }
    }
    let mut rows = lines.into_iter().filter(|line| !line.trim().is_empty());
    let promised: Option<usize> = rows.next().and_then(|line| line.trim().parse().ok());
    let rows: Vec<&str> = rows.collect();
    if promised != Some(rows.len() / 2) || !rows.len().is_multiple_of(2) {
        let message = format!(
            "expected the number of references and two lines for each, found {promised:?} and {} lines",
            rows.len()
        );
        findings.push(Finding::fault("pair-count", place(), message));
        return;
    }
    let mut entries = BTreeMap::new();
    for pair in rows.chunks_exact(2) {
        match (pair[0].trim().parse::<u32>(), sources_in(pair[1])) {
            (Ok(id), Some(sources)) => {
                if entries.insert(id, sources).is_some() {
                    let message = format!("expected each reference once, found view {id} again");
                    findings.push(Finding::fault("pair-twice", place(), message));
                }
            }
            _ => {
                let message = format!(
                    "expected an id and `n id score …`, found `{}` and `{}`",
                    pair[0], pair[1]
                );
                findings.push(Finding::fault("pair-line", place(), message));
            }
        }
    }
    entries_of(&entries, cams, findings);
}

/// (id, score) after the count, if the line is whole.
fn sources_in(line: &str) -> Option<Vec<(u32, f64)>> {
    let mut words = line.split_whitespace();
    let count: usize = words.next()?.parse().ok()?;
    let rest: Vec<&str> = words.collect();
    let sources: Option<Vec<_>> = rest
        .chunks(2)
        .map(|pair| Some((pair.first()?.parse().ok()?, pair.get(1)?.parse().ok()?)))
        .collect();
    sources.filter(|sources| sources.len() == count)
}

/// Closure, counts, scores and symmetry.
fn entries_of(
    entries: &BTreeMap<u32, Vec<(u32, f64)>>,
    cams: &BTreeSet<u32>,
    findings: &mut Vec<Finding>,
) {
    for (&id, sources) in entries {
        entry_of(entries, (id, sources), cams, findings);
    }
    for id in cams.iter().filter(|id| !entries.contains_key(id)) {
        let message = "expected every view to be a reference, found none in pair.txt";
        findings.push(Finding::fault("view-without-pairs", place_of(*id), message));
    }
}

fn place_of(id: u32) -> String {
    format!("cams/pair.txt, view {id}")
}

/// One view's sources.
fn entry_of(
    entries: &BTreeMap<u32, Vec<(u32, f64)>>,
    (id, sources): (u32, &[(u32, f64)]),
    cams: &BTreeSet<u32>,
    findings: &mut Vec<Finding>,
) {
    let mut fault = |code: &str, message: String| {
        findings.push(Finding::fault(code, place_of(id), message));
    };
    if !cams.contains(&id) {
        fault(
            "pair-without-camera",
            format!(
                "expected a camera for the view, found no {}",
                file_name(id, "_cam.txt")
            ),
        );
    }
    if sources.is_empty() || sources.len() > MOST_SOURCES {
        fault(
            "source-count",
            format!(
                "expected 1 to {MOST_SOURCES} source views, found {}",
                sources.len()
            ),
        );
    }
    if sources.iter().any(|&(source, _)| source == id) {
        fault(
            "source-is-itself",
            "expected other views as sources, found the view itself".to_owned(),
        );
    }
    let mut seen = BTreeSet::new();
    if let Some((source, _)) = sources.iter().find(|(source, _)| !seen.insert(*source)) {
        fault(
            "source-twice",
            format!("expected each source view once, found {source} again"),
        );
    }
    if let Some((source, _)) = sources
        .iter()
        .find(|(source, _)| !entries.contains_key(source))
    {
        fault(
            "source-is-no-reference",
            format!("expected every source to be a reference too, found {source}"),
        );
    }
    if let Some((source, score)) = sources
        .iter()
        .find(|(_, score)| score.is_nan() || *score <= 0.0)
    {
        fault(
            "score-zero",
            format!("expected scores above 0, found {score} for source {source}"),
        );
    }
    if sources.windows(2).any(|two| two[0].1 < two[1].1) {
        fault(
            "score-order",
            "expected falling scores, found a rise".to_owned(),
        );
    }
    for &(source, score) in sources {
        let back = entries
            .get(&source)
            .into_iter()
            .flatten()
            .find(|(other, _)| *other == id);
        if back.is_some_and(|(_, other)| (other - score).abs() > 1e-3 * score.abs()) {
            let message =
                format!("expected the same score in both directions, found another for {source}");
            findings.push(Finding::advice("score-asymmetric", place_of(id), message));
        }
    }
}
