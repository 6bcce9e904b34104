//! The report's page: leaderboards, and of every score folder its curves, errors and clouds.

use super::{RECORD_FILES, ReportJob};
use crate::error::{Error, Result};
use crate::jobs::score::ScoreDocument;
use crate::provenance;
use crate::report::cloud_picture;
use crate::report::curve_svg::{self, Curves};
use crate::report::histogram_svg;
use crate::report::html::{ErrorCloud, Page, Picture, Plot, html};
use crate::report::table::Table;
use glam::DVec3;
use mvs_datasets::format::image;
use mvs_datasets::layout::files;
use mvs_metrics::{Curve, Tolerance, distance};
use std::path::{Path, PathBuf};

/// Score folders whose clouds are shown; of further ones the curves are.
const CLOUDS: usize = 12;
/// Pixels of a cloud's still picture.
const STILL: (u32, u32) = (960, 560);

/// A score folder's judged points with their distances.
struct Scored {
    document: ScoreDocument,
    unit: &'static str,
    reconstruction: Side,
    truth: Side,
}

struct Side {
    name: String,
    points: Vec<DVec3>,
    distances: Vec<f64>,
}

impl Scored {
    /// Reads the folder; its PLYs hold the judged points, whose distances are taken again.
    fn read(folder: &Path) -> Result<Self> {
        let path = folder.join("score.json");
        let document: ScoreDocument = serde_json::from_str(&files::read_text(&path)?)
            .map_err(|error| Error::invalid(path.display().to_string(), error.to_string()))?;
        let points = |side: &str| {
            let path = folder.join(format!("{}.{side}.ply", document.scene));
            files::read_cloud(&path).map(|cloud| cloud.into_positions())
        };
        let (reconstruction, truth) = (points("precision")?, points("recall")?);
        let (from_reconstruction, from_truth) = distance::both_ways(&reconstruction, &truth)?;
        let side = |side: &str, points, distances| Side {
            name: format!("{}, {}: {side}", document.scene, document.method),
            points,
            distances,
        };
        Ok(Self {
            unit: crate::jobs::score::unit_of(document.protocol),
            reconstruction: side("precision", reconstruction, from_reconstruction),
            truth: side("recall", truth, from_truth),
            document,
        })
    }

    fn tau(&self) -> f64 {
        self.document.tolerance
    }

    /// The curves and both histograms.
    fn plots(&self) -> Result<Vec<Plot>> {
        let tolerance = Tolerance::new(self.tau())?;
        let precision = Curve::of(&self.reconstruction.distances, tolerance);
        let recall = Curve::of(&self.truth.distances, tolerance);
        let name = format!("{}, {}", self.document.scene, self.document.method);
        let svg = curve_svg::svg(&Curves {
            title: &name,
            tau: self.tau(),
            unit: self.unit,
            distances: &precision.edges()[1..],
            precision: &precision.fractions(),
            recall: &recall.fractions(),
        })?;
        let mut plots = vec![Plot {
            caption: format!("Precision, recall and F-score of {name}"),
            svg,
        }];
        for side in self.sides() {
            let svg = histogram_svg::svg(&side.name, &side.distances, self.tau(), self.unit)?;
            let caption = format!("Errors of {}", side.name);
            plots.push(Plot { caption, svg });
        }
        Ok(plots)
    }

    /// The sides that have points.
    fn sides(&self) -> impl Iterator<Item = &Side> {
        let sides = [&self.reconstruction, &self.truth].into_iter();
        sides.filter(|side| !side.points.is_empty())
    }

    fn clouds(&self) -> impl Iterator<Item = ErrorCloud<'_>> {
        self.sides().map(|side| ErrorCloud {
            name: &side.name,
            positions: &side.points,
            distances: &side.distances,
            tau: self.tau(),
            unit: self.unit,
        })
    }

    fn facts(&self, folder: &Path) -> (String, String) {
        let document = &self.document;
        let profile = document
            .profile
            .map(|profile| format!(", {profile}"))
            .unwrap_or_default();
        let gates = if document.passed { "passed" } else { "failed" };
        let facts = format!(
            "{}: protocol {}{profile}, τ = {} {}, seed {}, gates {gates}",
            folder.display(),
            document.protocol,
            document.tolerance,
            self.unit,
            document.seed
        );
        (format!("{}, {}", document.scene, document.method), facts)
    }
}

/// The page of `tables` and of the score folders that the record files lie in, and its first
/// cloud's still picture as PNG, where there is a cloud.
pub(super) fn of(
    job: &ReportJob,
    records: &[PathBuf],
    tables: &[Table],
) -> Result<(String, Option<Vec<u8>>)> {
    let folders: Vec<&Path> = records
        .iter()
        .filter_map(|file| file.parent())
        .filter(|folder| folder.join("score.json").is_file())
        .collect();
    let mut scored = Vec::new();
    for folder in &folders {
        scored.push(Scored::read(folder)?);
    }
    let plots: Vec<Vec<Plot>> = scored.iter().map(Scored::plots).collect::<Result<_>>()?;
    let plots = plots.concat();
    let clouds: Vec<ErrorCloud<'_>> = scored
        .iter()
        .take(CLOUDS)
        .flat_map(Scored::clouds)
        .collect();
    let still = clouds.first().map(still).transpose()?;
    let pictures = job
        .pictures
        .iter()
        .map(|path| picture(path))
        .collect::<Result<Vec<_>>>()?;
    let mut provenance = vec![
        (
            "program".to_owned(),
            format!("mvs-eval {}", provenance::VERSION),
        ),
        ("revision".to_owned(), provenance::REVISION.to_owned()),
    ];
    provenance.extend(
        scored
            .iter()
            .zip(&folders)
            .map(|(scored, folder)| scored.facts(folder)),
    );
    for path in records {
        let hash = provenance::hash_path(path)?;
        provenance.push((path.display().to_string(), format!("BLAKE3 {hash}")));
    }
    let page = html(&Page {
        title: job.title.as_deref().unwrap_or("Scores"),
        lead: &lead(tables, &scored),
        tables,
        plots: &plots,
        clouds: &clouds,
        still: still.as_deref(),
        pictures: &pictures,
        provenance: &provenance,
    })?;
    Ok((page, still))
}

fn lead(tables: &[Table], scored: &[Scored]) -> String {
    let hidden = scored.len().saturating_sub(CLOUDS);
    let more = match (scored.len(), hidden) {
        (0, _) => format!(
            " No score folder lies beside the records ({}), so there are no curves and clouds.",
            RECORD_FILES.join(", ")
        ),
        (_, 0) => String::new(),
        _ => format!(" The clouds of {hidden} further score folders are left out."),
    };
    format!(
        "Records of different protocols, profiles or thresholds stand in tables of their own: {} \
         here. Scores are in percent, the best bold, the second best underlined; – is a missing \
         scene, and a method with one has no mean and no rank.{more}",
        tables.len()
    )
}

fn still(cloud: &ErrorCloud<'_>) -> Result<Vec<u8>> {
    let drawn = cloud_picture::draw(cloud, STILL.0, STILL.1)?;
    let mut bytes = Vec::new();
    image::write_png(&mut bytes, &drawn)
        .map_err(|error| Error::invalid("picture", error.to_string()))?;
    Ok(bytes)
}

/// A picture for the page, as its file has it.
fn picture(path: &Path) -> Result<Picture> {
    let bytes = files::read_with(path, |bytes| Ok(bytes.to_vec()))?;
    let media_type = match bytes.first() {
        Some(0x89) => "image/png",
        Some(0xff) => "image/jpeg",
        _ => {
            let problem = "expected a PNG or JPEG picture, found something else";
            return Err(Error::invalid(path.display().to_string(), problem));
        }
    };
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    Ok(Picture {
        caption: stem.replace(['_', '-'], " "),
        media_type,
        bytes,
    })
}
