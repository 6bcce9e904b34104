//! The report's page: leaderboards, and of every score folder its curves, errors and clouds.

use super::{RECORD_FILES, ReportJob};
use crate::error::{Error, Result};
use crate::jobs::Context;
use crate::jobs::score::{SCHEMA, ScoreDocument};
use crate::provenance;
use crate::report::cloud_picture;
use crate::report::curve_svg::{self, Curves};
use crate::report::histogram_svg;
use crate::report::html::{self, ErrorCloud, PackedCloud, Page, Picture, Plot};
use crate::report::record::Record;
use crate::report::table::Table;
use glam::DVec3;
use mvs_datasets::format::{image, ply};
use mvs_datasets::layout::files;
use mvs_metrics::distance::{self, Order};
use mvs_metrics::{Curve, Tolerance};
use serde::Deserialize;
use std::path::{Path, PathBuf};

/// Score folders whose clouds are shown; of further ones the curves are, as long as they fit.
const CLOUDS: usize = 12;
/// Bytes of the sentences on top, at most.
const LEAD: usize = 2000;
/// What marks a score folder.
const DOCUMENT: &str = "score.json";
/// Pixels of a cloud's still picture.
const STILL: (u32, u32) = (960, 560);

/// A score folder's judged points with their distances.
struct Scored<'a> {
    document: &'a ScoreDocument,
    unit: &'static str,
    reconstruction: Side,
    truth: Side,
}

struct Side {
    name: String,
    points: Vec<DVec3>,
    distances: Vec<f64>,
}

impl<'a> Scored<'a> {
    /// Reads the folder's PLYs: they hold the judged points, whose distances are taken again.
    fn read(folder: &Path, document: &'a ScoreDocument) -> Result<Self> {
        // A side may be empty.
        let points =
            |side| files::read_with(&cloud_file(folder, document, side), ply::read_positions);
        let order = document.voxel.map_or(Order::Any, |_| Order::Spatial);
        let [reconstruction, truth] =
            distance::both_ways_in(order, [points("precision")?, points("recall")?])?;
        let side = |side: &str, (points, distances)| Side {
            name: format!("{}, {}: {side}", document.scene, document.method),
            points,
            distances,
        };
        Ok(Self {
            unit: crate::jobs::score::unit_of(document.protocol, &document.scene),
            reconstruction: side("precision", reconstruction),
            truth: side("recall", truth),
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
            at_tau: (self.document.precision, self.document.recall),
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
}

/// Where a score folder has the judged points of a side.
fn cloud_file(folder: &Path, document: &ScoreDocument, side: &str) -> PathBuf {
    folder.join(format!("{}.{side}.ply", document.scene))
}

/// The files of score folders that the page is made from.
pub(super) fn files_of(folders: &[(&Path, ScoreDocument)]) -> Vec<PathBuf> {
    let of_folder = |(folder, document): &(&Path, ScoreDocument)| {
        let clouds = ["precision", "recall"].map(|side| cloud_file(folder, document, side));
        let there = clouds.into_iter().filter(|cloud| cloud.is_file());
        std::iter::once(folder.join(DOCUMENT))
            .chain(there)
            .collect::<Vec<_>>()
    };
    folders.iter().flat_map(of_folder).collect()
}

/// Says which score folders no record agrees with: the page would show one score in its tables and another one, or
/// another name, on its curves.
pub(super) fn warn_of_others(
    folders: &[(&Path, ScoreDocument)],
    records: &[Record],
    context: &Context<'_>,
) {
    for (folder, document) in folders {
        let (method, scene) = (document.method.trim(), document.scene.trim());
        let is_of = |record: &&Record| {
            let same = record
                .fscore
                .is_some_and(|f| (f - document.f_score).abs() < 1e-9);
            same && record.method == method && record.scene == scene
        };
        if !records.iter().any(|record| is_of(&record)) {
            let message = format!(
                "{}: has F {:.4} for {method} on {scene}, and no record says so: the tables show the records, the \
                 curves this file; was one of them changed by hand?",
                folder.join(DOCUMENT).display(),
                document.f_score
            );
            context.warnings.add("other-score", message);
        }
    }
}

fn read_document(folder: &Path) -> Result<ScoreDocument> {
    /// What stands in every version of the file.
    #[derive(Deserialize)]
    struct Head {
        schema: String,
    }
    let path = folder.join(DOCUMENT);
    let text = files::read_text(&path)?;
    let broken = |problem: String| Error::invalid(path.display().to_string(), problem);
    let head: Head = serde_json::from_str(&text).map_err(|error| broken(error.to_string()))?;
    if head.schema != SCHEMA {
        let found = head.schema;
        return Err(broken(format!("schema: expected {SCHEMA}, found {found}")));
    }
    serde_json::from_str(&text).map_err(|error| broken(error.to_string()))
}

fn facts(folder: &Path, document: &ScoreDocument) -> (String, String) {
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
        crate::jobs::score::unit_of(document.protocol, &document.scene),
        document.seed
    );
    (format!("{}, {}", document.scene, document.method), facts)
}

/// What the page shows of score folders, read one at a time: no more than one's points are in memory.
#[derive(Default)]
struct Shown {
    clouds: Vec<PackedCloud>,
    /// By folder.
    plots: Vec<Vec<Plot>>,
    still: Option<Vec<u8>>,
}

impl Shown {
    /// Plots and, of `clouds` in the page, this folder's clouds; nothing where they cannot be read.
    fn add(
        &mut self,
        folder: &(&Path, ScoreDocument),
        clouds: usize,
        context: &Context<'_>,
    ) -> Result<()> {
        let Some(scored) = judged(folder, context) else {
            self.plots.push(Vec::new());
            return Ok(());
        };
        self.plots.push(scored.plots()?);
        for cloud in scored.clouds() {
            if self.still.is_none() {
                self.still = Some(still(&cloud)?);
            }
            self.clouds.push(PackedCloud::new(&cloud, clouds)?);
        }
        Ok(())
    }
}

/// The page of `tables` and of the score folders that the files of `records` lie in, and its first
/// cloud's still picture as PNG, where there is a cloud. Plots beyond the page's size are left out,
/// with a warning.
pub(super) fn of(
    job: &ReportJob,
    (records, folders): (&[PathBuf], &[(&Path, ScoreDocument)]),
    tables: &[Table],
    context: &Context<'_>,
) -> Result<(String, Option<Vec<u8>>)> {
    let with_clouds = &folders[..folders.len().min(CLOUDS)];
    let sides = with_clouds.iter().map(|(_, document)| {
        let counts = &document.counts;
        let evaluated = [counts.reconstruction.evaluated, counts.truth.evaluated];
        evaluated.iter().filter(|&&count| count > 0).count()
    });
    let clouds = sides.sum();
    let mut shown = Shown::default();
    for folder in with_clouds {
        context.progress.check()?;
        shown.add(folder, clouds, context)?;
    }
    let pictures = job.pictures.iter().map(|path| picture(path));
    let pictures = pictures.collect::<Result<Vec<_>>>()?;
    let provenance = provenance_of(folders, records)?;
    let page = Page {
        title: job.title.as_deref().unwrap_or("Scores"),
        tables,
        clouds: &shown.clouds,
        still: shown.still.as_deref(),
        pictures: &pictures,
        provenance: &provenance,
        ..Page::default()
    };
    let room = html::room(&page)?.saturating_sub(LEAD);
    let (plots, whole) = fitting(std::mem::take(&mut shown.plots), folders, room, context)?;
    if whole < folders.len() {
        let message = format!(
            "the page shows the curves of {whole} of {} score folders: it would exceed 10 MB",
            folders.len()
        );
        context.warnings.add("page-plots-left-out", message);
    }
    let page = Page {
        lead: &lead(tables, folders.len(), whole),
        plots: &plots,
        ..page
    };
    Ok((html::html(&page)?, shown.still.clone()))
}

/// The folders that hold a score beside the records, in order, each once.
pub(super) fn score_folders(records: &[PathBuf]) -> Result<Vec<(&Path, ScoreDocument)>> {
    let mut folders: Vec<&Path> = Vec::new();
    for folder in records.iter().filter_map(|file| file.parent()) {
        if !folders.contains(&folder) && folder.join(DOCUMENT).is_file() {
            folders.push(folder);
        }
    }
    let read = folders.into_iter();
    read.map(|folder| Ok((folder, read_document(folder)?)))
        .collect()
}

/// The judged points of a score folder; where they cannot be read, its scores still count, and a warning says what
/// the page lacks.
fn judged<'a>(
    (folder, document): &'a (&Path, ScoreDocument),
    context: &Context<'_>,
) -> Option<Scored<'a>> {
    let left_out = |error: Error| {
        let message = format!("the page has no curves and clouds of a score: {error}");
        context.warnings.add("page-score-left-out", message);
    };
    Scored::read(folder, document).map_err(left_out).ok()
}

/// The plots that fit into `room`, whole folders at a time, and of how many folders they are. `made`
/// are those of the first folders; of others the points are read as long as there is room.
fn fitting(
    made: Vec<Vec<Plot>>,
    folders: &[(&Path, ScoreDocument)],
    room: usize,
    context: &Context<'_>,
) -> Result<(Vec<Plot>, usize)> {
    let mut made = made.into_iter();
    let (mut plots, mut used) = (Vec::new(), 0);
    for (nth, folder) in folders.iter().enumerate() {
        context.progress.check()?;
        let of_folder = match made.next() {
            Some(of_folder) => of_folder,
            None => match judged(folder, context) {
                Some(scored) => scored.plots()?,
                None => Vec::new(),
            },
        };
        used += of_folder.iter().map(html::plot_bytes).sum::<usize>();
        if used > room {
            return Ok((plots, nth));
        }
        plots.extend(of_folder);
    }
    Ok((plots, folders.len()))
}

fn provenance_of(
    folders: &[(&Path, ScoreDocument)],
    records: &[PathBuf],
) -> Result<Vec<(String, String)>> {
    let program = format!("mvs-eval {}", provenance::VERSION);
    let mut said = vec![
        ("program".to_owned(), program),
        ("revision".to_owned(), provenance::REVISION.to_owned()),
    ];
    said.extend(
        folders
            .iter()
            .map(|(folder, document)| facts(folder, document)),
    );
    for path in records {
        let hash = provenance::hash_path(path)?;
        said.push((path.display().to_string(), format!("BLAKE3 {hash}")));
    }
    Ok(said)
}

/// The sentences on top: of `folders` score folders, `whole` have their curves in the page.
fn lead(tables: &[Table], folders: usize, whole: usize) -> String {
    let mut more = String::new();
    if folders == 0 {
        more = format!(
            " No score folder lies beside the records ({}), so there are no curves and clouds.",
            RECORD_FILES.join(", ")
        );
    }
    if folders > CLOUDS {
        let hidden = folders - CLOUDS;
        more.push_str(&format!(
            " The clouds of {hidden} further score folders are left out."
        ));
    }
    if whole < folders {
        let hidden = folders - whole;
        more.push_str(&format!(
            " The curves of {hidden} score folders are left out: the page would exceed 10 MB."
        ));
    }
    format!(
        "Records of different protocols or profiles, or of one scene's different thresholds, stand in tables of their \
         own: {} \
         here. Scores are in percent, the best bold, the second best underlined; – is a missing \
         scene, † a score that does not count (a gate failed, or it is against another truth than most); a \
         method with either has no mean and no rank.{more}",
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
