//! `mvs-eval fuse`: a folder of depth maps → a point cloud, view by view.

mod cams;
mod check;
mod confidences;
mod coordinates;
mod find;
mod maps;
mod output;
pub mod sweep;
mod units;
mod workspace;

use super::out::{
    check_no_input, check_run_file, check_still_free, remove_if_there, replaced, write_out_file,
    write_run_file,
};
use super::{Context, check_out_file, run_file_beside};
use crate::config::Size;
use crate::error::{Error, Result};
use crate::fuse::{
    CLUSTER_BYTES, Columns, DepthMaps, FuseCounts, FuseInputs, FuseMode, FuseOptions, MEMORY,
    MemoryScratch, PointSink, Region, Scratch, VoxelSink, columns, fuse_maps,
};
use crate::provenance::Run;
pub use check::check_used;
pub use coordinates::Coordinates;
pub(super) use find::find_image;
use glam::DVec3;
use maps::{FileScratch, FolderMaps};
use mvs_datasets::layout::files;
use mvs_datasets::layout::mvsnet::{self, PixelCentre};
use mvs_datasets::layout::scratch::ScratchFolder;
use mvs_datasets::layout::workspace::StereoPass;
use mvs_metrics::crop::Prism;
use output::{Outputs, Visible};
use serde::{Deserialize, Serialize};
use std::io::Write;
use std::path::{Path, PathBuf};

/// Options of `mvs-eval fuse`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FuseJob {
    /// The scene: a folder with `cams/` (and `pair.txt`, in it or beside it), and images for colours if there are any;
    /// or a COLMAP dense workspace.
    pub scene: PathBuf,
    /// The folder of estimated depth maps, `<id>.pfm`; they may be smaller than the images. Empty
    /// for a workspace, which has them.
    pub depths: PathBuf,
    /// Folders of confidence maps, `<id>.pfm`. Of several the smallest value counts; the first has
    /// the depth maps' size, the others may have fewer pixels.
    pub confidence: Vec<PathBuf>,
    /// Which maps of a workspace.
    pub stereo: StereoPass,
    /// The folder of masks, `<id>.png` (of a workspace `<image name>.png`), of the depth maps' size:
    /// pixels below 128 are left out.
    pub masks: Option<PathBuf>,
    /// A polygon crop volume (JSON as Open3D's) in the scene's frame: points outside are left out.
    pub crop: Option<PathBuf>,
    /// The PLY to write.
    pub out: PathBuf,
    /// Merge the points of each voxel of this edge (world units) into one, as
    /// [`VoxelSink`] says; 0 for no merging.
    pub voxel: f64,
    /// Write `<out>.vis` too: which views see each point, in COLMAP's format. Views are counted from 0: by
    /// ascending id, in a workspace as COLMAP counts its images (`sparse::registered_names`).
    pub vis: bool,
    /// A folder for the depths that became points, `<id>.pfm`, 0 = none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub filtered_depths: Option<PathBuf>,
    /// Which properties the PLY's points have beside position, normal, colour, views and confidence.
    pub properties: Properties,
    /// The type of the PLY's coordinates.
    pub coordinates: Coordinates,
    /// Where the cams put the centre of the top-left pixel.
    pub pixel_center: PixelCentre,
    /// The image size that the cams' intrinsics are for. Without it that of the view's image, or of
    /// its depth map, whichever goes with the principal point.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub camera_size: Option<Size>,
    /// About how many MiB of maps to hold at a time; of that no result depends, so it is not
    /// recorded.
    #[serde(skip)]
    pub memory: Option<usize>,
    /// How to fuse.
    pub fuse: FuseOptions,
}

/// Properties of points that not everybody wants.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Properties {
    /// None.
    #[default]
    Basic,
    /// `violations` (views that see through the point) and `scale` (depth over focal length).
    Full,
}

impl FuseJob {
    /// The confidence maps of the view `id`.
    fn confidence_paths(&self, id: u32) -> Vec<PathBuf> {
        let name = mvsnet::file_name(id, ".pfm");
        let folders = self.confidence.iter();
        folders.map(|folder| folder.join(&name)).collect()
    }

    /// How many bytes of maps to hold at a time.
    fn budget(&self) -> usize {
        self.memory.map_or(MEMORY, |mib| mib << 20)
    }
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
    /// Points that became part of another one of their voxel.
    pub merged_in_voxels: u64,
}

/// What stands in the JSON beside the cloud.
#[derive(Serialize)]
struct Report<'a> {
    version: &'a str,
    /// Of the options of fusion and the voxels' edge, not of what comes with the inputs: crop, masks, cameras. It
    /// stands in the PLY's header too.
    fingerprint: String,
    /// Edge of the voxels, 0 = none.
    voxel: f64,
    options: &'a FuseOptions,
    #[serde(flatten)]
    outcome: &'a FuseOutcome,
}

/// Fuses the depth maps into `job.out`, and writes beside it a report (`.json`) of what became of
/// the pixels and the `.run.toml`.
///
/// Intermediate maps lie in a temporary folder beside the cloud where they do not fit into memory.
///
/// # Errors
/// Options that do not go together, a result that is there without `force` or would replace what is read or another
/// command's, maps that are missing or do not go with their cameras, [`Error::NoPoints`] where no pixel passes; else
/// as [`fuse_maps`].
pub fn run(job: &FuseJob, context: &Context<'_>) -> Result<FuseOutcome> {
    job.check()?;
    let (report, run_file) = (report_path(&job.out), run_file_beside(&job.out));
    let visible = visible_path(&job.out);
    if !context.force {
        check_run_file(&run_file, "fuse")?;
    }
    check_out_files(&[&job.out, &report, &run_file, &visible], context.force)?;
    let mut own = vec![job.out.clone(), report, run_file.clone(), visible.clone()];
    if let Some(folder) = job
        .filtered_depths
        .as_ref()
        .filter(|folder| own.contains(folder))
    {
        let problem = "expected a folder for the filtered depth maps, found a file of the result";
        return Err(Error::invalid(folder.display().to_string(), problem));
    }
    let before = filtered_before(job, &run_file);
    let maps = FolderMaps::open(job, replaced(&own, &run_file, "fuse"), context)?;
    let results: Vec<&Path> = own.iter().map(PathBuf::as_path).collect();
    let read = maps.files().into_iter().chain(job.crop.as_deref());
    check_no_input(&results, read)?;
    check_run_file(&run_file, "fuse")?;
    let prism = job.crop.as_deref().map(read_prism).transpose()?;
    let inside = |point: DVec3| prism.as_ref().is_none_or(|prism| prism.contains(point));
    let region: Option<&Region<'_>> = if prism.is_some() { Some(&inside) } else { None };
    let (scratch, memory) = scratch(&maps, job.fuse.mode, (&job.out, job.budget()))?;
    let inputs = FuseInputs {
        maps: &maps,
        region,
        scratch: scratch.as_ref(),
        memory,
        progress: context.progress,
        warnings: context.warnings,
    };
    let doubles = job.coordinates.are_doubles(&maps, context.warnings);
    let outcome = write_cloud(job, &maps, (&inputs, doubles, context.force));
    maps.warn_of_turned();
    maps.warn_of_empty();
    let outcome = outcome?;
    if !job.vis {
        remove_if_there(&visible)?; // that of the cloud before
    }
    let filtered = maps.filtered(job);
    let stale = before.iter().filter(|path| !filtered.contains(path));
    stale.map(PathBuf::as_path).try_for_each(remove_if_there)?;
    write_report(job, &outcome)?;
    own.retain(|path| *path != run_file && path.is_file());
    own.extend(filtered);
    write_run_file(Run::new("fuse", job, &maps.inputs)?, &run_file, &own)?;
    Ok(outcome)
}

/// The maps that the result before wrote into the same folder.
fn filtered_before(job: &FuseJob, run_file: &Path) -> Vec<PathBuf> {
    let (Some(folder), Ok(run)) = (&job.filtered_depths, Run::read(run_file)) else {
        return Vec::new();
    };
    let Ok(real) = folder.canonicalize() else {
        return Vec::new();
    };
    let beside = files::folder_of(run_file);
    let of_folder = |file: &String| {
        let file = beside.join(file);
        let is_inside = file.parent()?.canonicalize().ok()? == real;
        let is_map = is_inside && file.extension()? == "pfm";
        is_map.then(|| folder.join(file.file_name().unwrap_or_default()))
    };
    run.files.iter().filter_map(of_folder).collect()
}

/// Reads all that [`run`] reads, and refuses of it what that would refuse.
pub(super) fn check_inputs(job: &FuseJob, context: &Context<'_>) -> Result<()> {
    job.check()?;
    let maps = FolderMaps::open(job, &[], context)?;
    for index in 0..maps.count() {
        context.progress.check()?;
        maps.depth(index)?;
        maps.confidence(index)?;
        maps.image(index)?;
    }
    Ok(())
}

/// Checks each of the files that a command writes, before the work; no two may be one file.
fn check_out_files(paths: &[&Path], force: bool) -> Result<()> {
    for (index, path) in paths.iter().enumerate() {
        if paths[..index].contains(path) {
            let problem = "expected a name for the result other than that of the files beside it, found \
                           the same: use .ply (or .csv for --sweep)";
            return Err(Error::invalid(path.display().to_string(), problem));
        }
        check_out_file(path, force)?;
    }
    Ok(())
}

/// `cloud.json` for `cloud.ply`.
fn report_path(out: &Path) -> PathBuf {
    out.with_extension("json")
}

fn read_prism(path: &Path) -> Result<Prism> {
    let crop = files::read_crop(path)?;
    Ok(Prism::new(
        crop.axis().index(),
        crop.range(),
        crop.polygon(),
    )?)
}

/// In memory where two passes' maps take at most half of the budget, else in files beside the
/// result; and what of the budget is left. `cluster` asks for it only where its tiles do not fit into the
/// budget.
fn scratch(
    maps: &FolderMaps<'_>,
    mode: FuseMode,
    (out, budget): (&Path, usize),
) -> Result<(Box<dyn Scratch>, usize)> {
    let pixels = usize::try_from(maps.pixels()).unwrap_or(usize::MAX);
    let bytes = match mode {
        FuseMode::Hkust => pixels.saturating_mul(2 * size_of::<f32>()),
        FuseMode::Cluster if pixels.saturating_mul(CLUSTER_BYTES) > budget => usize::MAX,
        _ => 0,
    };
    if bytes <= budget / 2 {
        return Ok((Box::new(MemoryScratch::default()), budget - bytes));
    }
    Ok((Box::new(FileScratch(ScratchFolder::beside(out)?)), budget))
}

/// Fuses into the outputs, which appear only when they are whole and not empty.
fn write_cloud(
    job: &FuseJob,
    maps: &FolderMaps<'_>,
    (inputs, doubles, force): (&FuseInputs<'_>, bool, bool),
) -> Result<FuseOutcome> {
    let beside = visible_path(&job.out);
    let visible = match job.vis {
        true => Visible::create(&beside, force)?,
        false => Visible::None,
    };
    let depths = job.filtered_depths.as_deref();
    let depths = depths.map(|folder| output::DepthFolder::create(folder, maps, force));
    let depths = depths.transpose()?;
    let mut failed = None;
    let mut outcome = None;
    let written = write_out_file(&job.out, force, |out| {
        let extras = Columns::EXTRAS.when(job.properties == Properties::Full);
        let types = Columns::DOUBLES.when(doubles);
        let types = types.and(Columns::MANY.when(maps.count() > usize::from(u8::MAX)));
        let columns = columns(maps, &job.fuse).and(extras).and(types);
        let ply = output::PlySink::new(out, columns, &comments(job), &job.out)?;
        let mut outputs = Outputs {
            ply,
            visible,
            depths,
            maps,
        };
        // The cloud comes last: without it there is no result.
        let fused = fuse_into(job, inputs, &mut outputs).and_then(|(counts, merged)| {
            // All is written before anything of an earlier result goes.
            let points = outputs.complete()?;
            let (report, run_file) = (report_path(&job.out), run_file_beside(&job.out));
            check_still_free(&[&job.out, &report, &run_file, &beside], force)?;
            // It comes back last: without it the result is not whole.
            remove_if_there(&run_file)?;
            outputs.appear()?;
            Ok((points, counts, merged))
        });
        match fused {
            Ok(fused) => {
                outcome = Some(fused);
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
    let (points, counts, merged_in_voxels) = outcome.unwrap_or_default();
    Ok(FuseOutcome {
        views: maps.count(),
        points: usize::try_from(points).unwrap_or(usize::MAX),
        counts,
        merged_in_voxels,
    })
}

/// Fuses, by way of voxels where they are asked for; an error where nothing comes out.
fn fuse_into<W: Write + std::io::Seek>(
    job: &FuseJob,
    inputs: &FuseInputs<'_>,
    outputs: &mut Outputs<'_, W>,
) -> Result<(FuseCounts, u64)> {
    let mut merged = 0;
    let counts = if job.voxel == 0.0 {
        fuse_maps(inputs, &job.fuse, outputs)?
    } else {
        let mut voxels = VoxelSink::new(job.voxel, columns(inputs.maps, &job.fuse))?;
        let counts = fuse_maps(inputs, &job.fuse, &mut voxels)?;
        let (points, others) = voxels.finish();
        merged = others;
        outputs.take(&points)?;
        counts
    };
    outputs.maps.warn_of_units()?;
    if outputs.ply.count() == 0 {
        return Err(nothing(job, inputs.maps.count(), &counts));
    }
    Ok((counts, merged))
}

/// `cloud.ply.vis` for `cloud.ply`, as COLMAP names it.
fn visible_path(out: &Path) -> PathBuf {
    let mut name = out.as_os_str().to_owned();
    name.push(".vis");
    PathBuf::from(name)
}

fn nothing(job: &FuseJob, views: usize, counts: &FuseCounts) -> Error {
    let problem = format!(
        "no pixel of {views} depth maps passed: {} empty, {} masked, {} out of the depth range, {} \
         of too little confidence, {} without enough agreeing views, {} contradicted, {} \
         outside of the bounds",
        counts.empty,
        counts.masked,
        counts.out_of_range,
        counts.unconfident,
        counts.inconsistent,
        counts.contradicted,
        counts.outside
    );
    let place = if job.depths.as_os_str().is_empty() {
        &job.scene
    } else {
        &job.depths
    };
    Error::NoPoints {
        what: place.display().to_string(),
        problem,
    }
}

/// The first 16 hexadecimal digits of BLAKE3 over the options of fusion, as TOML, and the voxels' edge.
fn fingerprint(job: &FuseJob) -> String {
    let options = toml::to_string(&job.fuse).unwrap_or_default();
    let all = format!("{options}voxel = {:?}\n", job.voxel);
    blake3::hash(all.as_bytes()).to_hex()[..16].to_owned()
}

/// All options of the procedure and their fingerprint, on one line.
pub fn summary(job: &FuseJob) -> String {
    let text = toml::to_string(&job.fuse).unwrap_or_default();
    let options: Vec<&str> = text.lines().collect();
    format!("{}; fingerprint {}", options.join(", "), fingerprint(job))
}

/// The header's comments: the program, the fingerprint and every option.
fn comments(job: &FuseJob) -> Vec<String> {
    let mut lines = vec![
        format!("mvs-eval {} fuse", crate::provenance::VERSION),
        format!("fingerprint = {}", fingerprint(job)),
        format!("voxel = {:?}", job.voxel),
    ];
    let text = toml::to_string(&job.fuse).unwrap_or_default();
    lines.extend(text.lines().map(str::to_owned));
    lines
}

fn write_report(job: &FuseJob, outcome: &FuseOutcome) -> Result<()> {
    let report = Report {
        version: crate::provenance::VERSION,
        fingerprint: fingerprint(job),
        voxel: job.voxel,
        options: &job.fuse,
        outcome,
    };
    let text = serde_json::to_string_pretty(&report)
        .map_err(|error| Error::invalid("JSON", error.to_string()))?;
    Ok(files::write_atomically(&report_path(&job.out), |out| {
        writeln!(out, "{text}")
    })?)
}
