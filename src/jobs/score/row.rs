//! `scores.csv`: a row per tolerance.

use super::document::{AtTolerance, ScoreDocument};
use crate::error::{Error, Result};
use crate::jobs::OutDir;

const HEADER: [&str; 16] = [
    "protocol",
    "profile",
    "method",
    "scene",
    "threshold",
    "precision",
    "recall",
    "fscore",
    "n_rec_in",
    "n_rec_crop",
    "n_rec_eval",
    "n_truth_in",
    "n_truth_crop",
    "n_truth_eval",
    "align_scale",
    "tool_version",
];

/// Writes the file.
pub(super) fn write(out: &OutDir, document: &ScoreDocument) -> Result<()> {
    let mut writer = csv::Writer::from_writer(Vec::new());
    let failed = |error: csv::Error| Error::invalid("scores.csv", error.to_string());
    writer.write_record(HEADER).map_err(failed)?;
    for at in &document.by_tolerance {
        writer.write_record(fields(document, at)).map_err(failed)?;
    }
    let bytes = writer
        .into_inner()
        .map_err(|error| Error::invalid("scores.csv", error.to_string()))?;
    out.write("scores.csv", |file| std::io::Write::write_all(file, &bytes))
}

fn fields(document: &ScoreDocument, at: &AtTolerance) -> [String; 16] {
    let (reconstruction, truth) = (at.counts.reconstruction, at.counts.truth);
    [
        document.protocol.to_string(),
        document
            .profile
            .map_or_else(String::new, |profile| profile.to_string()),
        document.method.clone(),
        document.scene.clone(),
        at.tolerance.to_string(),
        at.precision.to_string(),
        at.recall.to_string(),
        at.f_score.to_string(),
        reconstruction.input.to_string(),
        reconstruction.cropped.to_string(),
        reconstruction.evaluated.to_string(),
        truth.input.to_string(),
        truth.cropped.to_string(),
        truth.evaluated.to_string(),
        document.alignment.scale.to_string(),
        crate::provenance::VERSION.to_owned(),
    ]
}
