//! The rules of the strictest public readers, on files as they are.

use super::Finding;
use crate::error::Result;
use mvs_datasets::layout::blended::{self, BlendedFolder};
use mvs_datasets::layout::mvsnet::file_name;
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

/// Most source views that readers make room for.
const MOST_SOURCES: usize = 10;

/// Checks the folder's files by name and the texts by letter.
pub(super) fn check(folder: &BlendedFolder) -> Result<Vec<Finding>> {
    let mut findings = Vec::new();
    for name in ["cams", "blended_images", "rendered_depth_maps"] {
        if !folder.path().join(name).is_dir() {
            findings.push(Finding::fault(
                "missing-folder",
                name,
                "expected this folder in the scene's folder, found none",
            ));
        }
    }
    if !findings.is_empty() {
        return Ok(findings);
    }
    if folder.path().join(blended::UNFINISHED).exists() {
        findings.push(Finding::fault(
            "unfinished",
            blended::UNFINISHED,
            "expected a finished scene, found one whose making was interrupted: run it again, or --merge",
        ));
    }
    let ids = cams(folder, &mut findings)?;
    depths(folder, &mut findings)?;
    for &id in &ids {
        files_of(folder, id, &mut findings);
        cam_text(folder, id, &mut findings);
    }
    match std::fs::read_to_string(folder.pairs()) {
        Ok(text) => pair_text(&text, &ids, &mut findings),
        Err(error) => findings.push(Finding::fault(
            "missing-pairs",
            "cams/pair.txt",
            format!("expected a text file, found {error}"),
        )),
    }
    Ok(findings)
}

/// The view ids of `cams/`, in which nothing else may stand.
fn cams(folder: &BlendedFolder, findings: &mut Vec<Finding>) -> Result<BTreeSet<u32>> {
    let mut ids = BTreeSet::new();
    for name in blended::names_in(&folder.path().join("cams"))? {
        match id_in(&name, "_cam.txt") {
            Some(id) => {
                ids.insert(id);
            }
            None if name == "pair.txt" => {}
            None => findings.push(foreign("cams", &name, "00000000_cam.txt … and pair.txt")),
        }
    }
    Ok(ids)
}

/// `rendered_depth_maps/` holds one PFM per view and nothing else.
fn depths(folder: &BlendedFolder, findings: &mut Vec<Finding>) -> Result<()> {
    for name in blended::names_in(&folder.path().join("rendered_depth_maps"))? {
        let Some(id) = id_in(&name, ".pfm") else {
            findings.push(foreign("rendered_depth_maps", &name, "00000000.pfm …"));
            continue;
        };
        if !folder.cam(id).is_file() {
            let message = format!(
                "expected a camera for it, found no {}",
                file_name(id, "_cam.txt")
            );
            findings.push(Finding::fault(
                "depth-without-camera",
                place("rendered_depth_maps", &name),
                message,
            ));
        }
        if let Some(found) = bad_pfm_header(&folder.depth(id)) {
            findings.push(Finding::fault(
                "pfm-header",
                place("rendered_depth_maps", &name),
                format!("expected `Pf`, width and height, and a scale below 0 on three lines, found {found}"),
            ));
        }
    }
    Ok(())
}

/// What is wrong with the start of a PFM, if anything.
fn bad_pfm_header(path: &Path) -> Option<String> {
    use std::io::Read;
    let mut start = [0u8; 64];
    let length = match std::fs::File::open(path).and_then(|mut file| file.read(&mut start)) {
        Ok(length) => length,
        Err(error) => return Some(error.to_string()),
    };
    let text = String::from_utf8_lossy(&start[..length]).into_owned();
    let lines: Vec<&str> = text.split('\n').take(3).collect();
    let size_is_two_numbers = |line: &str| {
        let numbers: Vec<&str> = line.split(' ').collect();
        numbers.len() == 2 && numbers.iter().all(|n| n.parse::<u32>().is_ok())
    };
    let good = lines.len() == 3
        && lines[0] == "Pf"
        && size_is_two_numbers(lines[1])
        && lines[2].parse::<f64>().is_ok_and(|scale| scale < 0.0);
    (!good).then(|| format!("{lines:?}"))
}

/// Readers open all of a view's files, the masked image too.
fn files_of(folder: &BlendedFolder, id: u32, findings: &mut Vec<Finding>) {
    let expected = [
        ("missing-image", folder.image(id)),
        ("missing-masked-image", folder.masked_image(id)),
        ("missing-depth", folder.depth(id)),
    ];
    for (code, path) in expected {
        if !path.is_file() {
            let inside = path.strip_prefix(folder.path()).unwrap_or(&path);
            let message = format!("expected this file for view {id}, found none");
            findings.push(Finding::fault(code, inside.display().to_string(), message));
        }
    }
}

/// A cam's keywords and its depth line.
fn cam_text(folder: &BlendedFolder, id: u32, findings: &mut Vec<Finding>) {
    let place = place("cams", &file_name(id, "_cam.txt"));
    let text = match std::fs::read_to_string(folder.cam(id)) {
        Ok(text) => text,
        Err(error) => {
            findings.push(Finding::fault("unreadable", place, error.to_string()));
            return;
        }
    };
    let lines: Vec<&str> = text.lines().collect();
    let keyword = |line: usize| lines.get(line).map(|line| line.trim_end());
    if keyword(0) != Some("extrinsic") || keyword(6) != Some("intrinsic") {
        findings.push(Finding::fault(
            "cam-keywords",
            place.clone(),
            "expected `extrinsic` on line 1 and `intrinsic` on line 7, as readers count lines",
        ));
        return;
    }
    let depth_line = lines.get(11).copied().unwrap_or_default();
    let numbers: Vec<f64> = depth_line
        .split(' ')
        .map_while(|n| n.parse().ok())
        .collect();
    if numbers.len() != 4 || depth_line.split(' ').count() != 4 {
        let message = format!(
            "expected four numbers with single spaces and no trailing one on line 12, found `{depth_line}`"
        );
        findings.push(Finding::fault("depth-line", place, message));
        return;
    }
    range(&numbers, place, findings);
}

/// depth_min, interval, count, depth_max agree.
fn range(numbers: &[f64], place: String, findings: &mut Vec<Finding>) {
    let (min, interval, count, max) = (numbers[0], numbers[1], numbers[2], numbers[3]);
    if !(min > 0.0 && max > min) {
        let message = format!("expected 0 < depth_min < depth_max, found {min} and {max}");
        findings.push(Finding::fault("depth-range", place, message));
        return;
    }
    let by_count = (max - min) / count;
    let by_planes = (max - min) / (count - 1.0);
    let is = |expected: f64| (interval / expected - 1.0).abs() < 1e-3;
    if !is(by_count) && !is(by_planes) {
        let message =
            format!("expected an interval of (max - min) / {count} = {by_count}, found {interval}");
        findings.push(Finding::fault("depth-interval", place, message));
    } else if !is(by_count) || count != 128.0 {
        let message = format!("expected 128 intervals of {by_count}, found {count} of {interval}");
        findings.push(Finding::advice("depth-interval-dialect", place, message));
    }
}

/// `pair.txt` by letter: readers split on single spaces and count lines.
fn pair_text(text: &str, cams: &BTreeSet<u32>, findings: &mut Vec<Finding>) {
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
    pair_entries(&entries, cams, findings);
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
fn pair_entries(
    entries: &BTreeMap<u32, Vec<(u32, f64)>>,
    cams: &BTreeSet<u32>,
    findings: &mut Vec<Finding>,
) {
    let at = |id: u32| format!("cams/pair.txt, view {id}");
    for (&id, sources) in entries {
        let mut fault = |code: &str, message: String| {
            findings.push(Finding::fault(code, at(id), message));
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
                let message = format!(
                    "expected the same score in both directions, found another for {source}"
                );
                findings.push(Finding::advice("score-asymmetric", at(id), message));
            }
        }
    }
    for id in cams.iter().filter(|id| !entries.contains_key(id)) {
        let message = "expected every view to be a reference, found none in pair.txt";
        findings.push(Finding::fault("view-without-pairs", at(*id), message));
    }
}

fn foreign(folder: &str, name: &str, expected: &str) -> Finding {
    let message =
        format!("expected only {expected} here, found another file; readers list the folder");
    Finding::fault("foreign-file", place(folder, name), message)
}

fn place(folder: &str, name: &str) -> String {
    format!("{folder}/{name}")
}

/// The id in an eight-digit name with this ending.
fn id_in(name: &str, ending: &str) -> Option<u32> {
    let digits = name.strip_suffix(ending)?;
    let all_digits = digits.len() == 8 && digits.bytes().all(|byte| byte.is_ascii_digit());
    all_digits.then(|| digits.parse().ok()).flatten()
}
