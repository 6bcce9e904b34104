//! Checks a scene of the BlendedMVS kind, ours or somebody else's: the rules of its readers, and
//! whether images, depths and cameras say the same.

mod as_written;
mod carry;
mod contradictions;
mod encoded;
mod geometry;
mod images;
mod listed;
mod pair_rules;
mod pictures;
mod reading;
mod rules;
mod shifts;
mod single;
mod twice;

pub use geometry::PairCheck;
pub use reading::Reading;

use crate::error::{Error, Result};
use crate::progress::Progress;
use mvs_datasets::layout::blended::BlendedFolder;
use mvs_datasets::layout::mvsnet::PixelCentre;
use serde::{Deserialize, Serialize};

/// How bad a finding is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Severity {
    /// Some public reader fails on it, or the data contradict each other.
    Fault,
    /// Worth knowing; readers cope.
    Advice,
}

/// Something that is not as it should be.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Finding {
    /// How bad.
    pub severity: Severity,
    /// A stable name to test for, e.g. `half-pixel`.
    pub code: String,
    /// The file, view or pair.
    pub place: String,
    /// Expected, found, what to do.
    pub message: String,
}

impl Finding {
    fn fault(code: &str, place: impl Into<String>, message: impl Into<String>) -> Self {
        Self::new(Severity::Fault, code, place, message)
    }

    fn advice(code: &str, place: impl Into<String>, message: impl Into<String>) -> Self {
        Self::new(Severity::Advice, code, place, message)
    }

    fn new(
        severity: Severity,
        code: &str,
        place: impl Into<String>,
        message: impl Into<String>,
    ) -> Self {
        Self {
            severity,
            code: code.to_owned(),
            place: place.into(),
            message: message.into(),
        }
    }
}

/// How to verify.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct VerifyOptions {
    /// The pixel centre of the intrinsics; without it what `scene.json` says, else (0.5, 0.5).
    #[serde(alias = "pixel_center", skip_serializing_if = "Option::is_none")]
    pub pixel_centre: Option<PixelCentre>,
    /// Points per view that are carried into its source views, at least 200.
    pub points: u32,
}

impl Default for VerifyOptions {
    fn default() -> Self {
        Self {
            pixel_centre: None,
            points: 2000,
        }
    }
}

/// What was checked and found.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Verification {
    /// Views with a camera.
    pub views: usize,
    /// Findings, faults first.
    pub findings: Vec<Finding>,
    /// Depth carried from each view into its source views, by pair.
    pub pairs: Vec<PairCheck>,
    /// Median over pairs of the pairs' median relative depth difference; `None` without pairs.
    pub median_difference: Option<f64>,
    /// Median difference of colours that show the same point, in grey levels; `None` without pairs.
    pub median_color_difference: Option<f64>,
}

impl Verification {
    /// Whether there is a finding of this code.
    pub fn found(&self, code: &str) -> bool {
        self.findings.iter().any(|finding| finding.code == code)
    }

    /// How well views agree, in words: what is wrong with all of them alike may show in nothing else.
    pub fn agreement(&self) -> Option<String> {
        let depths = self.median_difference?;
        let colors = self.median_color_difference?;
        Some(format!(
            "depths agree to {depths:.1e}, colours to {colors:.1} grey levels (medians over pairs of views)"
        ))
    }

    /// Whether there is any fault.
    pub fn failed(&self) -> bool {
        let fault = |finding: &Finding| finding.severity == Severity::Fault;
        self.findings.iter().any(fault)
    }
}

/// With fewer points per view nothing can be said of its pairs.
const FEWEST_POINTS: u32 = 200;

impl VerifyOptions {
    /// Refuses options with which nothing can be verified.
    ///
    /// # Errors
    /// Fewer than 200 points per view.
    pub fn check(&self) -> Result<()> {
        if self.points < FEWEST_POINTS {
            let problem = format!("expected at least {FEWEST_POINTS}, found {}", self.points);
            return Err(Error::invalid("verify: --points", problem));
        }
        Ok(())
    }
}

/// Verifies the scene in `folder`. What is wrong with it is a finding, not an error; an error means
/// that it could not be looked at.
///
/// # Errors
/// Fewer than 200 points per view, folders of the scene that cannot be listed, and interruption.
pub fn verify(
    folder: &BlendedFolder,
    options: &VerifyOptions,
    progress: &dyn Progress,
) -> Result<Verification> {
    options.check()?;
    let mut findings = rules::check(folder)?;
    let mut verification = Verification {
        views: 0,
        findings: Vec::new(),
        pairs: Vec::new(),
        median_difference: None,
        median_color_difference: None,
    };
    match folder.read_scene(options.pixel_centre) {
        Ok(scene) => {
            verification.views = scene.views().len();
            match as_written::check(folder) {
                Ok(found) => findings.extend(found),
                Err(error) => {
                    let message = format!("{error}: nothing was compared with it");
                    findings.push(Finding::fault("unreadable", "scene.json", message));
                }
            }
            findings.extend(twice::check(&scene));
            findings.extend(pictures::check_views(folder, &scene, progress)?);
            let checked = geometry::check(folder, &scene, options, progress)?;
            findings.extend(checked.findings);
            verification.median_difference = checked.median_difference;
            verification.median_color_difference = checked.median_color_difference;
            verification.pairs = checked.pairs;
        }
        Err(error) => {
            let message = format!(
                "{error}; images, depths and their agreement were not checked: mend this first"
            );
            findings.push(Finding::fault("unreadable", place(folder, &error), message));
            // Where that is wrong it has been said.
            findings.extend(as_written::check(folder).unwrap_or_default());
        }
    }
    findings.sort();
    findings.dedup();
    verification.findings = findings;
    Ok(verification)
}

/// The file that an error names, seen from the scene's folder, else `cams`.
fn place(folder: &BlendedFolder, error: &mvs_datasets::Error) -> String {
    use mvs_datasets::Error::{Format, Io, Layout};
    let named = match error {
        Io { path, .. } | Format { path, .. } | Layout { path, .. } => Some(path),
        _ => None,
    };
    let inside = named.and_then(|path| path.strip_prefix(folder.path()).ok());
    inside.map_or("cams".to_owned(), |path| path.display().to_string())
}

/// The middle one of the values; of two the upper.
fn median(mut values: Vec<f64>) -> Option<f64> {
    values.sort_unstable_by(f64::total_cmp);
    values.get(values.len() / 2).copied()
}

/// The value that a quarter of the others lie below.
fn quarter(mut values: Vec<f64>) -> Option<f64> {
    values.sort_unstable_by(f64::total_cmp);
    values.get(values.len() / 4).copied()
}

#[cfg(test)]
mod tests;
