//! `mvs-eval depth`: estimated depth maps against a scene's true ones.

mod odd;

use super::{Context, OutDir};
use crate::error::{Error, Result};
use crate::parallel;
use crate::report::colormap;
use crate::score::depth::{
    DepthMapsOfView, DepthRow, DepthScene, DepthScores, score_missing, score_scene, score_view,
};
use crate::warning::Warning;
use mvs_datasets::format::image;
use mvs_datasets::layout::blended::BlendedFolder;
use mvs_datasets::layout::{files, mvsnet};
use mvs_datasets::scene::{ColorImage, DepthMap, Raster, RejectedDepths, View};
use mvs_metrics::depth::{Alignment, DepthErrors, DepthPlanes};
use serde::{Deserialize, Serialize};
use std::io::Write;
use std::path::{Path, PathBuf};

/// Options of `mvs-eval depth`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct DepthJob {
    /// The scene: `cams/` with depth ranges, `rendered_depth_maps/`.
    pub truth: PathBuf,
    /// The folder of estimated depth maps, `<id>.pfm`. Where they are smaller than the truth, that is
    /// taken at the pixel nearest to each of theirs.
    pub estimates: PathBuf,
    /// The folder of confidence maps, `<id>.pfm`, of the estimates' size; larger is surer.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub confidence: Option<PathBuf>,
    /// D: the number of depth intervals in each view's range.
    pub planes: u32,
    /// How estimates are brought to the truth's scale, view by view.
    pub alignment: Alignment,
    /// The folder for `depth.csv`, `depth.json` and error maps; without it only the answer is given.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub out: Option<PathBuf>,
}

impl Default for DepthJob {
    fn default() -> Self {
        Self {
            truth: PathBuf::new(),
            estimates: PathBuf::new(),
            confidence: None,
            planes: 128,
            alignment: Alignment::None,
            out: None,
        }
    }
}

/// What was measured.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct DepthOutcome {
    /// How estimates were aligned.
    pub alignment: Alignment,
    /// Depth intervals per view.
    pub planes: u32,
    /// The scene's means.
    pub scene: DepthScene,
    /// The views, by id; those without an estimate have density 0.
    pub views: Vec<DepthRow>,
    /// Ids of the views without an estimate.
    pub missing: Vec<u32>,
    /// Ids of the views whose estimate has no depth where the truth counts.
    pub empty: Vec<u32>,
}

/// So many ids of views are named in a warning.
const NAMED: usize = 8;
/// Errors of this many intervals and more have the darkest colour in a map.
const DARKEST: f64 = 3.0;
/// Pixels whose truth does not count.
const NOT_COUNTED: [u8; 3] = [64; 3];
/// Pixels whose truth counts and that have no estimate.
const NO_ESTIMATE: [u8; 3] = [40, 70, 200];

/// Compares every view's estimate with its truth.
///
/// # Errors
/// A scene that cannot be read, no estimate at all, cams without a depth range, fewer than 3 planes, an estimate of
/// another shape or of more pixels than the truth, a confidence map of another size, an output folder as
/// [`OutDir::create`] refuses it, whatever reading and writing brings, and interruption.
pub fn run(job: &DepthJob, context: &Context<'_>) -> Result<DepthOutcome> {
    let folder = BlendedFolder::new(&job.truth);
    let scene = folder.read_scene(None)?;
    let all = scene.views();
    let there = |view: &View| {
        job.estimates
            .join(mvsnet::file_name(view.id, ".pfm"))
            .exists()
    };
    let there: Vec<bool> = all.iter().map(there).collect();
    let missing = all.iter().zip(&there).filter(|(_, there)| !**there);
    let missing: Vec<u32> = missing.map(|(view, _)| view.id).collect();
    if missing.len() == all.len() {
        let name = mvsnet::file_name(all.first().map_or(0, |view| view.id), ".pfm");
        let problem = format!("expected depth maps named like {name}, found none");
        return Err(Error::invalid(job.estimates.display().to_string(), problem));
    }
    let warn = |(code, problem): (&str, &str), views: &[u32]| {
        if let Some(warning) = warning_of((code, problem), views, all.len()) {
            context.warnings.add(&warning.code, warning.message);
        }
    };
    let out = job.out.as_deref();
    let out = out.map(|path| create(job, path, context)).transpose()?;
    context.progress.begin("comparing", all.len() as u64);
    let first = there.iter().position(|&there| there).unwrap_or_default();
    let sizes = Sizes::of(job, &folder, &all[first])?;
    let views = parallel::try_map(all.len(), |index| {
        context.progress.check()?;
        let row = match there[index] {
            true => one_view(job, &folder, &all[index], (out.as_ref(), context))?,
            false => missing_view(job, &folder, (&all[index], &sizes), (out.as_ref(), context))?,
        };
        if row.counted == 0 {
            let message = format!("view {}: no true depth lies in its range", row.view);
            context.warnings.add("nothing-counted", message);
        }
        context.progress.advance(1);
        Ok(row)
    })?;
    let odd = [odd::intervals(job, &folder, all), odd::strays(job, all)?];
    for warning in odd.into_iter().flatten() {
        context.warnings.add(&warning.code, warning.message);
    }
    let wanted = views.iter().filter(|row| row.missing && row.counted > 0);
    let wanted: Vec<u32> = wanted.map(|row| row.view).collect();
    warn(("missing-depth", "have no depth map"), &wanted);
    let empty = views.iter().filter(|row| row.is_empty());
    let empty: Vec<u32> = empty.map(|row| row.view).collect();
    let problem = "have a depth map without a depth where the truth counts";
    warn(("empty-depth", problem), &empty);
    let outcome = DepthOutcome {
        alignment: job.alignment,
        planes: job.planes,
        scene: score_scene(&views),
        views,
        missing,
        empty,
    };
    if let Some(out) = out {
        out.write_json("depth.json", &outcome)?;
        out.write("depth.csv", |file| write_csv(file, &outcome))?;
        out.finish()?;
    }
    Ok(outcome)
}

/// Says which views give no errors, and why.
fn warning_of((code, problem): (&str, &str), found: &[u32], views: usize) -> Option<Warning> {
    let named: Vec<String> = found.iter().take(NAMED).map(u32::to_string).collect();
    let rest = match found.len() - named.len() {
        0 => String::new(),
        rest => format!(" and {rest} more"),
    };
    let message = format!(
        "{} of {views} views {problem}: {}{rest}; they count as density 0, errors are means over the others only",
        found.len(),
        named.join(", ")
    );
    (!found.is_empty()).then(|| Warning::new(code, message))
}

fn create(job: &DepthJob, path: &Path, context: &Context<'_>) -> Result<OutDir> {
    let truth = ["cams", "rendered_depth_maps"].map(|name| job.truth.join(name));
    let mut read: Vec<&Path> = truth.iter().map(PathBuf::as_path).collect();
    read.push(&job.estimates);
    read.extend(job.confidence.as_deref());
    context.warn_of_unfinished(&read, path);
    OutDir::create(
        path,
        context.run("depth", job, &OutDir::inputs(path, &read)?)?,
        context.force,
    )
}

fn one_view(
    job: &DepthJob,
    folder: &BlendedFolder,
    view: &View,
    (out, context): (Option<&OutDir>, &Context<'_>),
) -> Result<DepthRow> {
    let planes = planes_of(job, folder, view)?;
    let name = mvsnet::file_name(view.id, ".pfm");
    let path = job.estimates.join(&name);
    let (estimate, rejected) = files::read_depth(&path)?;
    warn_of(&path, rejected, context);
    let truth = true_depth(folder, view, context)?;
    let truth = at_size(&truth, estimate.size(), &path)?;
    let confidence = match &job.confidence {
        Some(folder) => Some(read_confidence(&folder.join(&name), estimate.size())?),
        None => None,
    };
    let maps = DepthMapsOfView {
        truth: truth.values(),
        estimate: estimate.values(),
        confidence: confidence.as_ref().map(Raster::values),
    };
    let (row, errors) = score_view(view.id, &maps, &planes, job.alignment)?;
    write_picture(out, view, || picture(&truth, &planes, &errors))?;
    Ok(row)
}

/// Those of a view's estimate and truth.
struct Sizes {
    estimate: (u32, u32),
    truth: (u32, u32),
}

impl Sizes {
    fn of(job: &DepthJob, folder: &BlendedFolder, view: &View) -> Result<Self> {
        let path = job.estimates.join(mvsnet::file_name(view.id, ".pfm"));
        Ok(Self {
            estimate: files::read_depth(&path)?.0.size(),
            truth: folder.read_depth(view.id)?.0.size(),
        })
    }

    /// The size that the estimate would have beside a truth of this size. Both sides are rounded, and a small one
    /// says little of the ratio: they give one together.
    fn beside(&self, size: (u32, u32)) -> (u32, u32) {
        if size == self.truth {
            return self.estimate;
        }
        let both = |(width, height): (u32, u32)| u64::from(width) + u64::from(height);
        let (estimate, truth) = (both(self.estimate), both(self.truth).max(1));
        let share = |length: u32| {
            let rounded = (u64::from(length) * estimate + truth / 2) / truth;
            u32::try_from(rounded).map_or(length, |rounded| rounded.clamp(1, length))
        };
        (share(size.0), share(size.1))
    }
}

/// A view without an estimate: its row, by as many pixels as the other estimates would have, and a picture of
/// what is missing.
fn missing_view(
    job: &DepthJob,
    folder: &BlendedFolder,
    (view, sizes): (&View, &Sizes),
    (out, context): (Option<&OutDir>, &Context<'_>),
) -> Result<DepthRow> {
    let planes = planes_of(job, folder, view)?;
    let truth = true_depth(folder, view, context)?;
    let truth = thinned(&truth, sizes.beside(truth.size()))?;
    let (row, errors) = score_missing(view.id, truth.values(), &planes)?;
    write_picture(out, view, || picture(&truth, &planes, &errors))?;
    Ok(row)
}

fn true_depth(folder: &BlendedFolder, view: &View, context: &Context<'_>) -> Result<DepthMap> {
    let (truth, rejected) = folder.read_depth(view.id)?;
    warn_of(&folder.depth(view.id), rejected, context);
    Ok(truth)
}

fn warn_of(path: &Path, rejected: RejectedDepths, context: &Context<'_>) {
    if rejected.total() > 0 {
        let (path, count) = (path.display(), rejected.total());
        let message = format!("{path}: {count} NaN, infinite or negative depths count as none");
        context.warnings.add("bad-depth", message);
    }
}

/// Makes and writes the picture of a view's errors, where there is a folder for it.
fn write_picture(
    out: Option<&OutDir>,
    view: &View,
    picture: impl FnOnce() -> Result<ColorImage>,
) -> Result<()> {
    let Some(out) = out else {
        return Ok(());
    };
    let picture = picture()?;
    let name = Path::new("errors").join(mvsnet::file_name(view.id, ".png"));
    out.write(name, |file| image::write_png(file, &picture))
}

/// The view's sweep, from the range in its `cam.txt`.
fn planes_of(job: &DepthJob, folder: &BlendedFolder, view: &View) -> Result<DepthPlanes> {
    let Some(range) = view.depth_range else {
        let problem = "expected a depth range in its last line, found none: errors in depth \
                       intervals need one";
        let cam = folder.cam(view.id).display().to_string();
        return Err(Error::invalid(cam, problem));
    };
    Ok(DepthPlanes::new(range.min(), range.max(), job.planes)?)
}

/// The pixel of `of` in a row that holds the centre of pixel `index` of `length`, where both rows show the same.
pub(super) fn nearest(index: u32, length: u32, of: u32) -> u32 {
    let at = (u64::from(index) * 2 + 1) * u64::from(of) / (2 * u64::from(length));
    u32::try_from(at).unwrap_or(u32::MAX).min(of - 1)
}

/// The truth at the pixels nearest to those of a map of `size`, which must have its shape; `path` is the map's.
fn at_size(truth: &DepthMap, size: (u32, u32), path: &Path) -> Result<Raster<f32>> {
    let whole = truth.size();
    // The smaller map may have lost up to a pixel of its own by rounding.
    let scale = f64::from(whole.0) / f64::from(size.0);
    let height = f64::from(whole.1) / scale;
    if scale < 1.0 || (height - f64::from(size.1)).abs() > 1.0 {
        let problem = format!(
            "expected the truth's size {}x{} or the same shape in fewer pixels, found {}x{}",
            whole.0, whole.1, size.0, size.1
        );
        return Err(Error::invalid(path.display().to_string(), problem));
    }
    thinned(truth, size)
}

/// The truth at the pixels nearest to those of a map of `size`: depth is never interpolated.
fn thinned(truth: &DepthMap, size: (u32, u32)) -> Result<Raster<f32>> {
    let whole = truth.size();
    if whole == size {
        return Ok(truth.raster().clone());
    }
    let pixels = (0..size.1).flat_map(|row| (0..size.0).map(move |column| (column, row)));
    let values = pixels.map(|(column, row)| {
        truth.get(
            nearest(column, size.0, whole.0),
            nearest(row, size.1, whole.1),
        )
    });
    Ok(Raster::from_values(size.0, size.1, values.collect())?)
}

fn read_confidence(path: &Path, size: (u32, u32)) -> Result<Raster<f32>> {
    let raster = files::read_raster(path)?;
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

/// White over yellow and red to black at three intervals; grey where no truth counts, blue where
/// there is no estimate for one that does.
fn picture(truth: &Raster<f32>, planes: &DepthPlanes, errors: &DepthErrors) -> Result<ColorImage> {
    let mut picture = truth.map(|&depth| {
        if planes.counts(f64::from(depth)) {
            NO_ESTIMATE
        } else {
            NOT_COUNTED
        }
    });
    for (pixel, error) in errors.in_intervals() {
        picture.values_mut()[pixel] = colormap::hot_r(error / DARKEST);
    }
    Ok(picture)
}

/// What became of a view, in one word.
pub fn status_of(row: &DepthRow) -> &'static str {
    if row.missing {
        "missing"
    } else if row.is_empty() {
        "empty"
    } else if row.counted == 0 {
        "no-truth"
    } else {
        "compared"
    }
}

/// One line per view, then the two means, which are named partial where views are missing or empty.
fn write_csv(out: &mut impl Write, outcome: &DepthOutcome) -> std::io::Result<()> {
    let names = DepthScores::NAMES.join(",");
    writeln!(
        out,
        "view,interval,scale,offset,counted,compared,{names},status"
    )?;
    let values = |scores: &DepthScores| {
        let text = |value: Option<f64>| value.map_or_else(String::new, |value| value.to_string());
        scores.values().map(text).join(",")
    };
    for row in &outcome.views {
        let (fit, scores) = (row.fit, values(&row.scores));
        writeln!(
            out,
            "{},{},{},{},{},{},{scores},{}",
            row.view,
            row.interval,
            fit.scale,
            fit.offset,
            row.counted,
            row.compared,
            status_of(row)
        )?;
    }
    let scene = &outcome.scene;
    let (prefix, status) = match scene.partial {
        true => ("partial_", "partial"),
        false => ("", "complete"),
    };
    let means = [
        ("mean_over_views", &scene.mean_over_views),
        ("mean_over_pixels", &scene.mean_over_pixels),
    ];
    means.into_iter().try_for_each(|(name, scores)| {
        writeln!(out, "{prefix}{name},,,,,,{},{status}", values(scores))
    })
}
