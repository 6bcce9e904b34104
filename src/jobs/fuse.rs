//! `mvs-eval fuse`: a folder of depth maps → a point cloud, view by view.

mod maps;
mod output;

use super::{Context, check_out_file, run_file_beside};
use crate::error::{Error, Result};
use crate::fuse::{
    FuseCounts, FuseInputs, FuseOptions, MEMORY, MemoryScratch, Region, Scratch, columns, fuse_maps,
};
use crate::provenance::Run;
use glam::DVec3;
use maps::{FileScratch, FolderMaps};
use mvs_datasets::layout::files;
use mvs_datasets::layout::mvsnet::PixelCentre;
use mvs_datasets::layout::scratch::ScratchFolder;
use mvs_metrics::crop::Prism;
use output::PlySink;
use serde::{Deserialize, Serialize};
use std::io::Write;
use std::path::{Path, PathBuf};

/// Options of `mvs-eval fuse`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FuseJob {
    /// The scene: a folder with `cams/` (and `pair.txt`), and images for colours if there are any.
    pub scene: PathBuf,
    /// The folder of estimated depth maps, `<id>.pfm`; they may be smaller than the images.
    pub depths: PathBuf,
    /// The folder of confidence maps, `<id>.pfm`, if there is one.
    pub confidence: Option<PathBuf>,
    /// The folder of masks, `<id>.png`, of the depth maps' size: pixels below 128 are left out.
    pub masks: Option<PathBuf>,
    /// A polygon crop volume (JSON as Open3D's) in the scene's frame: points outside are left out.
    pub crop: Option<PathBuf>,
    /// The PLY to write.
    pub out: PathBuf,
    /// Where the cams put the centre of the top-left pixel.
    pub pixel_center: PixelCentre,
    /// How to fuse.
    pub fuse: FuseOptions,
}

/// What was fused.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FuseOutcome {
    /// Views with a depth map.
    pub views: usize,
    /// Points of the cloud.
    pub points: usize,
    /// What became of the pixels.
    pub counts: FuseCounts,
}

/// What stands in the JSON beside the cloud.
#[derive(Serialize)]
struct Report<'a> {
    version: &'a str,
    options: &'a FuseOptions,
    #[serde(flatten)]
    outcome: &'a FuseOutcome,
}

/// Fuses the depth maps into `job.out`, and writes beside it a report (`.json`) of what became of
/// the pixels and the `.run.toml`.
///
/// Intermediate maps lie in a temporary folder beside the cloud where they do not fit into memory.
pub fn run(job: &FuseJob, context: &Context<'_>) -> Result<FuseOutcome> {
    check_out_file(&job.out, context.force)?;
    job.fuse.check()?;
    let maps = FolderMaps::open(job, context)?;
    let prism = job.crop.as_deref().map(read_prism).transpose()?;
    let inside = |point: DVec3| prism.as_ref().is_none_or(|prism| prism.contains(point));
    let region: Option<&Region<'_>> = if prism.is_some() { Some(&inside) } else { None };
    let scratch = scratch(&maps, &job.out)?;
    let inputs = FuseInputs {
        maps: &maps,
        region,
        scratch: scratch.as_ref(),
        memory: MEMORY,
        progress: context.progress,
        warnings: context.warnings,
    };
    let outcome = write_cloud(job, &inputs)?;
    write_report(job, &outcome)?;
    let mut read = vec![job.scene.as_path(), job.depths.as_path()];
    read.extend(
        [&job.confidence, &job.masks, &job.crop]
            .into_iter()
            .flatten()
            .map(PathBuf::as_path),
    );
    Run::new("fuse", job, &read)?.write(&run_file_beside(&job.out))?;
    Ok(outcome)
}

fn read_prism(path: &Path) -> Result<Prism> {
    let crop = files::read_crop(path)?;
    Ok(Prism::new(
        crop.axis().index(),
        crop.range(),
        crop.polygon(),
    )?)
}

/// In memory where two passes' maps fit into the budget, else in files.
fn scratch(maps: &FolderMaps<'_>, out: &Path) -> Result<Box<dyn Scratch>> {
    let bytes = maps.pixels().saturating_mul(2 * size_of::<f32>() as u64);
    if bytes <= MEMORY as u64 / 4 {
        return Ok(Box::new(MemoryScratch::default()));
    }
    Ok(Box::new(FileScratch(ScratchFolder::beside(out)?)))
}

/// Streams the points into the PLY, which appears only when it is whole and not empty.
fn write_cloud(job: &FuseJob, inputs: &FuseInputs<'_>) -> Result<FuseOutcome> {
    let mut failed = None;
    let mut outcome = None;
    let written = files::write_atomically(&job.out, |out| {
        let columns = columns(inputs.maps, &job.fuse);
        let mut sink = PlySink::new(out, columns, &comments(&job.fuse), job.out.clone())?;
        let fused = fuse_maps(inputs, &job.fuse, &mut sink).and_then(|counts| {
            if sink.count() == 0 {
                return Err(nothing(job, inputs.maps.count(), &counts));
            }
            Ok(counts)
        });
        match fused {
            Ok(counts) => {
                outcome = Some((sink.finish()?, counts));
                Ok(())
            }
            Err(error) => {
                failed = Some(error);
                Err(std::io::Error::other("nothing to keep"))
            }
        }
    });
    if let Some(error) = failed {
        return Err(error);
    }
    written?;
    let (points, counts) = outcome.unwrap_or_default();
    Ok(FuseOutcome {
        views: inputs.maps.count(),
        points: usize::try_from(points).unwrap_or(usize::MAX),
        counts,
    })
}

fn nothing(job: &FuseJob, views: usize, counts: &FuseCounts) -> Error {
    let problem = format!(
        "no pixel of {views} depth maps passed: {} empty, {} masked, {} out of the depth range, {} \
         below the confidence threshold, {} without enough agreeing views, {} contradicted, {} \
         outside of the bounds",
        counts.empty,
        counts.masked,
        counts.out_of_range,
        counts.unconfident,
        counts.inconsistent,
        counts.contradicted,
        counts.outside
    );
    Error::invalid(job.depths.display().to_string(), problem)
}

/// The header's comments: the program and every option.
fn comments(options: &FuseOptions) -> Vec<String> {
    let mut lines = vec![format!("mvs-eval {} fuse", crate::provenance::VERSION)];
    let text = toml::to_string(options).unwrap_or_default();
    lines.extend(text.lines().map(str::to_owned));
    lines
}

fn write_report(job: &FuseJob, outcome: &FuseOutcome) -> Result<()> {
    let report = Report {
        version: crate::provenance::VERSION,
        options: &job.fuse,
        outcome,
    };
    let text = serde_json::to_string_pretty(&report)
        .map_err(|error| Error::invalid("JSON", error.to_string()))?;
    let path = job.out.with_extension("json");
    Ok(files::write_atomically(&path, |out| {
        writeln!(out, "{text}")
    })?)
}
