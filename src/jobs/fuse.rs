//! `mvs-eval fuse`: a folder of depth maps → a point cloud.

use super::{Context, check_out_file, run_file_beside};
use crate::error::{Error, Result};
use crate::fuse::{Estimate, FuseCounts, FuseOptions, fuse};
use crate::parallel;
use crate::provenance::Run;
use mvs_datasets::format::image;
use mvs_datasets::format::ply::{self, PlyOptions};
use mvs_datasets::layout::files;
use mvs_datasets::layout::mvsnet::{self, CamsOptions, PixelCentre};
use mvs_datasets::scene::{Raster, Scene, View};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// Options of `mvs-eval fuse`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FuseJob {
    /// The scene: a folder with `cams/` (and `pair.txt`), and images for colours if there are any.
    pub scene: PathBuf,
    /// The folder of estimated depth maps, `<id>.pfm`.
    pub depths: PathBuf,
    /// The folder of confidence maps, `<id>.pfm`, if there is one.
    pub confidence: Option<PathBuf>,
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

/// Folders in which images of a scene are looked for, relative to it.
const IMAGE_FOLDERS: [&str; 3] = ["blended_images", "images", "color"];

/// Fuses the depth maps.
pub fn run(job: &FuseJob, context: &Context<'_>) -> Result<FuseOutcome> {
    check_out_file(&job.out, context.force)?;
    let estimates = read_estimates(job, context)?;
    let fused = fuse(&estimates, &job.fuse, context.progress)?;
    if fused.cloud.is_empty() {
        let problem = format!(
            "no pixel of {} depth maps passed: {} empty, {} below the confidence threshold, {} \
             without enough agreeing views",
            estimates.len(),
            fused.counts.empty,
            fused.counts.unconfident,
            fused.counts.inconsistent
        );
        return Err(Error::invalid(job.depths.display().to_string(), problem));
    }
    let comments = vec![format!("mvs-eval {} fuse", crate::provenance::VERSION)];
    let options = PlyOptions {
        comments,
        ..PlyOptions::default()
    };
    files::write_atomically(&job.out, |out| {
        ply::write_cloud(out, &fused.cloud, &[], &options)
    })?;
    let mut inputs = vec![job.scene.as_path(), job.depths.as_path()];
    inputs.extend(job.confidence.as_deref());
    Run::new("fuse", job, &inputs)?.write(&run_file_beside(&job.out))?;
    let (views, points) = (estimates.len(), fused.cloud.len());
    Ok(FuseOutcome {
        views,
        points,
        counts: fused.counts,
    })
}

fn read_estimates(job: &FuseJob, context: &Context<'_>) -> Result<Vec<Estimate>> {
    let options = CamsOptions {
        pixel_centre: job.pixel_center,
        size: image_size(job)?,
    };
    let scene = mvsnet::read_scene(&job.scene, &options)?;
    let present: Vec<usize> = (0..scene.views().len())
        .filter(|&index| depth_path(job, &scene.views()[index]).exists())
        .collect();
    if present.is_empty() {
        let problem = format!(
            "expected depth maps named like {}, found none",
            mvsnet::file_name(scene.views().first().map_or(0, |view| view.id), ".pfm")
        );
        return Err(Error::invalid(job.depths.display().to_string(), problem));
    }
    if present.len() < scene.views().len() {
        let missing = scene.views().len() - present.len();
        context.warnings.add(
            "missing-depth",
            format!("{missing} views have no depth map"),
        );
    }
    context.progress.begin("reading", present.len() as u64);
    parallel::try_map(present.len(), |slot| {
        context.progress.check()?;
        let estimate = read_estimate(job, &scene, &present, present[slot], context)?;
        context.progress.advance(1);
        Ok(estimate)
    })
}

fn depth_path(job: &FuseJob, view: &View) -> PathBuf {
    job.depths.join(mvsnet::file_name(view.id, ".pfm"))
}

fn read_estimate(
    job: &FuseJob,
    scene: &Scene,
    present: &[usize],
    index: usize,
    context: &Context<'_>,
) -> Result<Estimate> {
    let view = &scene.views()[index];
    let path = depth_path(job, view);
    let (depth, rejected) = files::read_depth(&path)?;
    if rejected.total() > 0 {
        let message = format!(
            "{}: {} NaN, {} infinite and {} negative depths count as none",
            path.display(),
            rejected.nan,
            rejected.infinite,
            rejected.negative
        );
        context.warnings.add("bad-depth", message);
    }
    let (width, height) = depth.size();
    let camera = view.camera.resized(width, height)?;
    let confidence = job
        .confidence
        .as_deref()
        .map(|folder| read_confidence(folder, view.id, depth.size()));
    let image = find_image(&job.scene, view.id).map(|path| files::read_image(&path));
    let position_of = |id: u32| {
        let index = scene.index_of(id)?;
        present.iter().position(|&other| other == index)
    };
    let sources = scene
        .sources_of(index)
        .iter()
        .filter_map(|source| position_of(source.id));
    Ok(Estimate {
        view: View {
            camera,
            ..view.clone()
        },
        depth,
        confidence: confidence.transpose()?,
        image: image.transpose()?,
        sources: sources.collect(),
    })
}

fn read_confidence(folder: &Path, id: u32, size: (u32, u32)) -> Result<Raster<f32>> {
    let path = folder.join(mvsnet::file_name(id, ".pfm"));
    let raster = files::read_raster(&path)?;
    if raster.size() != size {
        let (found, expected) = (raster.size(), size);
        let problem = format!(
            "expected the depth map's size {}x{}, found {}x{}",
            expected.0, expected.1, found.0, found.1
        );
        return Err(Error::invalid(path.display().to_string(), problem));
    }
    Ok(raster)
}

/// The image of view `id`, if the scene has one.
fn find_image(scene: &Path, id: u32) -> Option<PathBuf> {
    let names = [".jpg", ".png"].map(|suffix| mvsnet::file_name(id, suffix));
    let folders = IMAGE_FOLDERS.iter().map(|folder| scene.join(folder));
    folders
        .flat_map(|folder| names.clone().map(|name| folder.join(name)))
        .find(|path| path.exists())
}

/// The size the cams are for: that of the scene's first image. Without images it is twice the
/// principal point.
fn image_size(job: &FuseJob) -> Result<Option<(u32, u32)>> {
    let options = CamsOptions {
        pixel_centre: job.pixel_center,
        size: None,
    };
    let scene = mvsnet::read_scene(&job.scene, &options)?;
    let image = scene
        .views()
        .iter()
        .find_map(|view| find_image(&job.scene, view.id));
    image
        .map(|path| Ok(files::read_with(&path, image::read_size)?))
        .transpose()
}
