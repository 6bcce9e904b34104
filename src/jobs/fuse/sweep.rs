//! `mvs-eval fuse --sweep`: the same maps fused with a grid of parameters, so that tuning by scene
//! shows.

use super::maps::FolderMaps;
use super::{FuseJob, check_out_files};
use crate::error::{Error, Result};
use crate::fuse::{DepthMaps, FuseCounts, FuseInputs, FuseOptions, Points, fuse_maps};
use crate::jobs::out::{
    check_no_input, check_run_file, check_still_free, remove_if_there, replaced, write_out_file,
    write_run_file,
};
use crate::jobs::score::{Draw, read_truth};
use crate::jobs::{Context, run_file_beside};
use crate::provenance::Run;
use crate::score::FinitePoints;
use crate::score::plain::{Preparation, evaluate};
use crate::score::sample::MeshAs;
use mvs_datasets::scene::{ColorImage, DepthMap, Mask, NormalMap, Raster, View};
use mvs_metrics::{Score, Tolerance};
use serde::{Deserialize, Serialize};
use std::io::Write;
use std::path::PathBuf;

/// Options of `mvs-eval fuse --sweep`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SweepJob {
    /// The CSV to write: one line per combination.
    pub out: PathBuf,
    /// Values of `max_pixel_error`.
    pub pixel_errors: Vec<f64>,
    /// Values of `min_sources`.
    pub min_sources: Vec<usize>,
    /// Values of `min_confidence`; without confidence maps it is not varied.
    pub min_confidences: Vec<f64>,
    /// A cloud of the true surface: each combination is scored against it, in the crop volume if one is given,
    /// both clouds averaged over voxels of `tau` / 2.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub truth: Option<PathBuf>,
    /// The distance below which points count, world units; needed with `truth`.
    pub tau: f64,
    /// The inputs and everything that is not varied; its `out` is not written.
    pub fuse: FuseJob,
}

impl Default for SweepJob {
    fn default() -> Self {
        Self {
            out: PathBuf::new(),
            pixel_errors: vec![0.5, 1.0, 2.0],
            min_sources: vec![2, 3, 5],
            min_confidences: vec![0.3, 0.6, 0.8],
            truth: None,
            tau: 0.0,
            fuse: FuseJob::default(),
        }
    }
}

/// One combination.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct SweepRow {
    /// Largest reprojection error in pixels, where the mode asks for it.
    pub max_pixel_error: Option<f64>,
    /// Sources that must agree, where the mode asks for it.
    pub min_sources: Option<usize>,
    /// Smallest confidence, where maps of it are given and no quantile.
    pub min_confidence: Option<f64>,
    /// Points of the cloud.
    pub points: usize,
    /// What became of the pixels.
    pub counts: FuseCounts,
    /// Against the truth, where one is given.
    pub score: Option<Score>,
}

/// The table.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SweepOutcome {
    /// All combinations: confidence outermost, pixel error innermost.
    pub rows: Vec<SweepRow>,
    /// The smallest and the largest F-score.
    pub fscore: Option<(f64, f64)>,
}

/// Fuses with every combination and writes the table.
///
/// # Errors
/// Options that do not go together or are out of range, a table that is there without `force` or would replace what
/// is read or another command's, a truth without points to judge against or a `tau` that is no tolerance,
/// [`Error::NoPoints`] where every combination keeps none, whatever reading and writing brings, and interruption.
pub fn run(job: &SweepJob, context: &Context<'_>) -> Result<SweepOutcome> {
    job.check()?;
    let run_file = run_file_beside(&job.out);
    if !context.force {
        check_run_file(&run_file, "sweep")?;
    }
    check_out_files(&[&job.out, &run_file], context.force)?;
    let all = combinations(job);
    all.iter().try_for_each(FuseOptions::check)?;
    let truth = truth_of(job, context)?;
    let own = [job.out.clone(), run_file.clone()];
    let mut folder = FolderMaps::open(&job.fuse, replaced(&own, &run_file, "sweep"), context)?;
    let others = [&job.fuse.crop, &job.truth].into_iter().flatten();
    let read = folder
        .files()
        .into_iter()
        .chain(others.map(PathBuf::as_path));
    check_no_input(&[&job.out, &run_file], read)?;
    check_run_file(&run_file, "sweep")?;
    if let Some(truth) = &job.truth {
        folder.inputs.add(truth)?;
        folder.hash_others()?;
    }
    let kept = KeptMaps::read(&folder, job.fuse.budget(), context)?;
    let mut rows = Vec::new();
    for options in all {
        rows.push(one(job, &options, (&kept, truth.as_ref()), context)?);
    }
    folder.warn_of_units()?;
    if let Some(row) = rows
        .iter()
        .min_by_key(|row| row.counts.inconsistent + row.counts.unconfident)
        && rows.iter().all(|row| row.points == 0)
    {
        return Err(super::nothing(&job.fuse, folder.count(), &row.counts));
    }
    let scores: Vec<f64> = rows
        .iter()
        .filter_map(|row| Some(row.score?.f_score()))
        .collect();
    let outcome = SweepOutcome {
        fscore: scores
            .iter()
            .copied()
            .reduce(f64::min)
            .zip(scores.iter().copied().reduce(f64::max)),
        rows,
    };
    check_still_free(&[&job.out, &run_file], context.force)?;
    write_out_file(&job.out, context.force, |out| {
        write_csv(out, &outcome.rows)?;
        out.flush()?;
        // All is written before anything of an earlier result goes; it comes back last.
        remove_if_there(&run_file).map_err(std::io::Error::other)
    })?;
    let run = Run::new("sweep", job, &folder.inputs)?;
    write_run_file(run, &run_file, &own[..1])?;
    Ok(outcome)
}

/// The truth as `score` reads it by default: a mesh is sampled by area.
fn truth_of(job: &SweepJob, context: &Context<'_>) -> Result<Option<(FinitePoints, Tolerance)>> {
    let Some(path) = &job.truth else {
        return Ok(None);
    };
    let tau = Tolerance::new(job.tau)?;
    let draw = Draw {
        how: MeshAs::default(),
        tau: tau.get(),
        seed: 0,
    };
    let (points, ..) = read_truth(path, draw, context.warnings)?;
    Ok(Some((points, tau)))
}

impl SweepJob {
    /// Refuses what only a cloud has.
    fn check(&self) -> Result<()> {
        self.fuse.check()?;
        let fuse = &self.fuse;
        let odd = [
            (fuse.voxel != 0.0, "--voxel"),
            (fuse.vis, "--vis"),
            (fuse.filtered_depths.is_some(), "--filtered-depths"),
        ];
        if let Some((_, flag)) = odd.iter().find(|(given, _)| *given) {
            let problem =
                format!("expected no {flag} with --sweep, which writes a table, no cloud");
            return Err(Error::invalid("sweep", problem));
        }
        if self.tau != 0.0 && self.truth.is_none() {
            return Err(Error::invalid(
                "--tau",
                "needs --truth, to which distances are measured",
            ));
        }
        let standard = Self::default();
        let varied = Varied::of(fuse);
        let mode = fuse.fuse.mode;
        check_axis(
            "--sweep-min-confidence",
            (&self.min_confidences, &standard.min_confidences),
            varied.confidence,
            "a threshold without --confidence, or beside --confidence-quantile",
        )?;
        let unasked = format!("what the mode {mode:?} does not ask for").to_lowercase();
        check_axis(
            "--sweep-min-sources",
            (&self.min_sources, &standard.min_sources),
            varied.sources,
            &unasked,
        )?;
        check_axis(
            "--sweep-pixel-error",
            (&self.pixel_errors, &standard.pixel_errors),
            varied.pixels,
            &unasked,
        )
    }
}

/// Says which axis has a value twice, or values of its own though it is not varied: `what` that would be.
fn check_axis<T: Copy + PartialEq + std::fmt::Display>(
    flag: &str,
    (values, standard): (&[T], &[T]),
    varied: bool,
    what: &str,
) -> Result<()> {
    if !varied && values != standard {
        let problem = format!("expected no values for {what}, found some");
        return Err(Error::invalid(flag, problem));
    }
    let mut nth = values.iter().enumerate();
    match nth.find(|(nth, value)| values[..*nth].contains(value)) {
        Some((_, twice)) => {
            let problem = format!("expected different values, found {twice} twice");
            Err(Error::invalid(flag, problem))
        }
        None => Ok(()),
    }
}

/// Which axes count.
struct Varied {
    confidence: bool,
    sources: bool,
    pixels: bool,
}

impl Varied {
    /// What a mode does not ask for is not varied: confidence without maps of it or with a quantile in
    /// its place, `dynamic`'s bounds and minimum, `gipuma`'s pixels.
    fn of(job: &FuseJob) -> Self {
        let mode = job.fuse.mode;
        Self {
            confidence: !job.confidence.is_empty() && job.fuse.confidence_quantile == 0.0,
            sources: mode.asks_for("min_sources"),
            pixels: mode.asks_for("max_pixel_error"),
        }
    }
}

/// The grid.
fn combinations(job: &SweepJob) -> Vec<FuseOptions> {
    let own = &job.fuse.fuse;
    let varied = Varied::of(&job.fuse);
    let confidences = axis(varied.confidence, &job.min_confidences, own.min_confidence);
    let sources = axis(varied.sources, &job.min_sources, own.min_sources);
    let pixels = axis(varied.pixels, &job.pixel_errors, own.max_pixel_error);
    let mut all = Vec::new();
    for &min_confidence in confidences.iter() {
        for &min_sources in sources.iter() {
            for &max_pixel_error in pixels.iter() {
                all.push(FuseOptions {
                    max_pixel_error,
                    min_sources,
                    min_confidence,
                    normals: false,
                    ..own.clone()
                });
            }
        }
    }
    all
}

/// The values of an axis that counts, else the one value.
fn axis<T: Copy>(counts: bool, values: &[T], own: T) -> Vec<T> {
    if counts { values.to_vec() } else { vec![own] }
}

fn one(
    job: &SweepJob,
    options: &FuseOptions,
    (maps, truth): (&KeptMaps<'_>, Option<&(FinitePoints, Tolerance)>),
    context: &Context<'_>,
) -> Result<SweepRow> {
    let prism = job
        .fuse
        .crop
        .as_deref()
        .map(super::read_prism)
        .transpose()?;
    let inside = |point| prism.as_ref().is_none_or(|prism| prism.contains(point));
    let place = (job.out.as_path(), job.fuse.budget());
    let (scratch, memory) = super::scratch(maps.folder, options.mode, place)?;
    let inputs = FuseInputs {
        maps,
        region: prism.is_some().then_some(&inside),
        scratch: scratch.as_ref(),
        memory,
        progress: context.progress,
        warnings: context.warnings,
    };
    let mut points = Points::default();
    let counts = fuse_maps(&inputs, options, &mut points)?;
    let count = points.len();
    let score = match truth {
        None => None,
        Some((truth, tau)) => {
            let found = FinitePoints::new(points.positions);
            let preparation = Preparation {
                crop: prism.clone(),
                voxel: Some(0.5 * tau.get()),
            };
            Some(evaluate(&found, None, truth, &preparation)?.score(*tau))
        }
    };
    let varied = Varied::of(&job.fuse);
    Ok(SweepRow {
        max_pixel_error: varied.pixels.then_some(options.max_pixel_error),
        min_sources: varied.sources.then_some(options.min_sources),
        min_confidence: varied.confidence.then_some(options.min_confidence),
        points: count,
        counts,
        score,
    })
}

fn write_csv(out: &mut impl Write, rows: &[SweepRow]) -> std::io::Result<()> {
    writeln!(
        out,
        "min_confidence,min_sources,max_pixel_error,points,pixels,unconfident,inconsistent,\
         contradicted,precision,recall,fscore"
    )?;
    for row in rows {
        let counts = row.counts;
        write!(
            out,
            "{},{},{},{},{},{},{},{}",
            or_empty(row.min_confidence),
            or_empty(row.min_sources),
            or_empty(row.max_pixel_error),
            row.points,
            counts.pixels,
            counts.unconfident,
            counts.inconsistent,
            counts.contradicted
        )?;
        match row.score {
            Some(score) => writeln!(
                out,
                ",{},{},{}",
                score.precision(),
                score.recall(),
                score.f_score()
            )?,
            None => writeln!(out, ",,,")?,
        }
    }
    Ok(())
}

fn or_empty(value: Option<impl ToString>) -> String {
    value.map_or_else(String::new, |value| value.to_string())
}

/// The maps of a folder, without images, which no count needs: read once and kept where all of them
/// fit into the budget, else read when they are asked for.
struct KeptMaps<'a> {
    folder: &'a FolderMaps<'a>,
    maps: Vec<KeptView>,
}

struct KeptView {
    depth: DepthMap,
    confidence: Option<Raster<f32>>,
    mask: Option<Mask>,
    /// `cluster` compares them.
    normals: Option<NormalMap>,
}

impl<'a> KeptMaps<'a> {
    fn read(folder: &'a FolderMaps<'a>, budget: usize, context: &Context<'_>) -> Result<Self> {
        // Depth and confidence, mask, normals.
        let bytes = folder.pixels().saturating_mul(4 + 4 + 1 + 12);
        if bytes > budget as u64 {
            let maps = Vec::new();
            return Ok(Self { folder, maps });
        }
        context.progress.begin("reading", folder.count() as u64);
        let read = |index| {
            context.progress.check()?;
            let kept = KeptView {
                depth: folder.depth(index)?,
                confidence: folder.confidence(index)?,
                mask: folder.mask(index)?,
                normals: folder.normals(index)?,
            };
            context.progress.advance(1);
            Ok(kept)
        };
        let maps = (0..folder.count()).map(read).collect::<Result<_>>()?;
        Ok(Self { folder, maps })
    }
}

impl DepthMaps for KeptMaps<'_> {
    fn count(&self) -> usize {
        self.folder.count()
    }

    fn view(&self, index: usize) -> &View {
        self.folder.view(index)
    }

    fn sources(&self, index: usize) -> &[usize] {
        self.folder.sources(index)
    }

    fn depth(&self, index: usize) -> Result<DepthMap> {
        match self.maps.get(index) {
            Some(kept) => Ok(kept.depth.clone()),
            None => self.folder.depth(index),
        }
    }

    fn confidence(&self, index: usize) -> Result<Option<Raster<f32>>> {
        match self.maps.get(index) {
            Some(kept) => Ok(kept.confidence.clone()),
            None => self.folder.confidence(index),
        }
    }

    fn mask(&self, index: usize) -> Result<Option<Mask>> {
        match self.maps.get(index) {
            Some(kept) => Ok(kept.mask.clone()),
            None => self.folder.mask(index),
        }
    }

    fn normals(&self, index: usize) -> Result<Option<NormalMap>> {
        match self.maps.get(index) {
            Some(kept) => Ok(kept.normals.clone()),
            None => self.folder.normals(index),
        }
    }

    fn image(&self, _index: usize) -> Result<Option<ColorImage>> {
        Ok(None)
    }

    fn has_images(&self) -> bool {
        false
    }

    fn has_confidence(&self) -> bool {
        self.folder.has_confidence()
    }
}
