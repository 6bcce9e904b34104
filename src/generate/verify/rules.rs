//! The rules of the strictest public readers, on files as they are.

use super::{Finding, pair_rules};
use crate::error::Result;
use mvs_datasets::layout::blended::{self, BlendedFolder};
use mvs_datasets::layout::mvsnet::file_name;
use std::collections::BTreeSet;
use std::path::Path;

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
        Ok(text) => pair_rules::check(&text, &ids, &mut findings),
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
