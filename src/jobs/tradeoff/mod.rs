//! `mvs-eval tradeoff`: what the knobs of each stage cost and what they change.

mod blend;
mod clock;
mod fuse;
mod plot;
mod render;
mod rows;
mod score;
mod shrink;

pub use rows::{Row, sentences};

use super::depth::nearest;
use super::score::Draw;
use super::{Context, OutDir};
use crate::config::Size;
use crate::error::{Error, Result};
use crate::provenance::{Inputs, Run};
use crate::score::sample::MeshAs;
use crate::warning::Warnings;
use mvs_datasets::layout::mvsnet::PixelCentre;
use mvs_datasets::scene::{ColorImage, View};
use mvs_metrics::Tolerance;
use serde::{Deserialize, Serialize};
use std::io::Write;
use std::path::{Path, PathBuf};

/// Options of `mvs-eval tradeoff`. A stage is measured where its inputs are given.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TradeoffJob {
    /// Scoring: the truth, a cloud or a mesh as `score` takes it.
    pub truth: Option<PathBuf>,
    /// Scoring: the reconstruction, a cloud or a mesh.
    pub reconstruction: Option<PathBuf>,
    /// Scoring: a 4×4 text file, reconstruction frame to truth frame.
    pub transform: Option<PathBuf>,
    /// Scoring: a polygon crop volume.
    pub crop: Option<PathBuf>,
    /// The tolerance in world units, for scoring and for fused clouds.
    pub tau: f64,
    /// Fusion: the folder with cams and pairs.
    pub scene: Option<PathBuf>,
    /// Fusion: the folder of depth maps.
    pub depths: Option<PathBuf>,
    /// Fusion: the folder of confidence maps.
    pub confidence: Option<PathBuf>,
    /// Fusion: the image size that the cams of `scene` are for; by default that of a view's image or depth map.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub camera_size: Option<Size>,
    /// Fusion: pixels below this confidence are left out.
    pub min_confidence: f64,
    /// Fusion: the cloud or mesh that fused clouds are scored against; the exact setting's cloud without.
    pub fuse_truth: Option<PathBuf>,
    /// Rendering: the mesh.
    pub mesh: Vec<PathBuf>,
    /// Rendering: cameras in any known form.
    pub cameras: Option<PathBuf>,
    /// Rendering: the size of the images; cameras that state another are scaled to cover it and cut to its centre.
    pub size: Option<Size>,
    /// Blending: a generated scene with its input and rendered images.
    pub dataset: Option<PathBuf>,
    /// Where the cams put the centre of the top-left pixel.
    pub pixel_center: PixelCentre,
    /// Rendering and blending: at most so many views, spread evenly.
    pub views: u32,
    /// Every setting is run in so many stretches of a tenth of a second or more; the median counts.
    pub repeats: u32,
    /// Seed of the queries, and of the points of meshes, that are drawn.
    pub seed: u64,
    /// The folder to write.
    pub out: PathBuf,
}

impl Default for TradeoffJob {
    fn default() -> Self {
        Self {
            truth: None,
            reconstruction: None,
            transform: None,
            crop: None,
            tau: 0.01,
            scene: None,
            depths: None,
            confidence: None,
            camera_size: None,
            min_confidence: crate::fuse::FuseOptions::default().min_confidence,
            fuse_truth: None,
            mesh: Vec::new(),
            cameras: None,
            size: None,
            dataset: None,
            pixel_center: PixelCentre::default(),
            views: 3,
            repeats: 3,
            seed: 0,
            out: PathBuf::new(),
        }
    }
}

impl TradeoffJob {
    /// A stage has both of the inputs that it needs, or none of its own; there is one.
    fn check_stages(&self) -> Result<()> {
        let path = |given: &Option<PathBuf>, option| (given.is_some(), option);
        let stages: [&[(bool, &'static str)]; 3] = [
            &[
                path(&self.truth, "--truth"),
                path(&self.reconstruction, "--reconstruction"),
                path(&self.transform, "--transform"),
                path(&self.crop, "--crop"),
            ],
            &[
                path(&self.scene, "--scene"),
                path(&self.depths, "--depths"),
                path(&self.confidence, "--confidence"),
                path(&self.fuse_truth, "--fuse-truth"),
                (self.camera_size.is_some(), "--camera-size"),
            ],
            &[
                (!self.mesh.is_empty(), "--mesh"),
                path(&self.cameras, "--cameras"),
                (self.size.is_some(), "--size"),
            ],
        ];
        for stage in stages {
            let given = stage.iter().find(|(given, _)| *given);
            let missing = stage[..2].iter().find(|(given, _)| !given);
            if let (Some((_, option)), Some((_, missing))) = (given, missing) {
                let problem = format!("goes with {missing}, which is not given");
                return Err(Error::invalid(*option, problem));
            }
        }
        let first = stages.map(|stage| stage[0].0);
        if first.contains(&true) || self.dataset.is_some() {
            return Ok(());
        }
        Err(no_stage())
    }

    /// Meshes as `score` takes them by default.
    fn draw(&self) -> Draw {
        Draw {
            how: MeshAs::default(),
            tau: self.tau,
            seed: self.seed,
        }
    }

    fn inputs(&self) -> Vec<&Path> {
        let single = [
            &self.truth,
            &self.reconstruction,
            &self.transform,
            &self.crop,
            &self.scene,
            &self.depths,
            &self.confidence,
            &self.fuse_truth,
            &self.cameras,
            &self.dataset,
        ];
        let single = single.into_iter().flatten().map(PathBuf::as_path);
        single
            .chain(self.mesh.iter().map(PathBuf::as_path))
            .collect()
    }
}

fn no_stage() -> Error {
    let problem = "expected the inputs of a stage (truth and reconstruction; scene and depths; mesh and \
                   cameras; dataset), found none";
    Error::invalid("tradeoff", problem)
}

/// Measures and writes `tradeoff.csv`, `tradeoff.svg` and `tradeoff.md` (a sentence per knob). The
/// results are measurements: only their errors are the same from run to run.
///
/// # Errors
/// No views or repeats, a `tau` that is no tolerance, no stage or one with half of its inputs, an output folder as
/// [`OutDir::create`] refuses it, whatever the stages bring, and interruption.
pub fn run(job: &TradeoffJob, context: &Context<'_>) -> Result<Vec<Row>> {
    for (value, option) in [(job.views, "--views"), (job.repeats, "--repeats")] {
        if value == 0 {
            return Err(Error::invalid(option, "expected at least 1, found 0"));
        }
    }
    Tolerance::new(job.tau).map_err(|error| Error::invalid("--tau", error.to_string()))?;
    job.check_stages()?;
    super::require("tradeoff", &[("--out", &[&job.out], "a folder to write")])?;
    let inputs = OutDir::inputs(&job.out, &job.inputs())?;
    let blank = Run::new("tradeoff", job, &Inputs::default())?;
    OutDir::check_again(&job.out, &blank, context.force)?;
    check_inputs(job, context)?;
    let run = context.run("tradeoff", job, &inputs)?;
    let out = OutDir::create(&job.out, run, context.force)?;
    if !clock::tells_cpu_time() {
        let message = "this system does not tell CPU times; wall-clock times are written instead";
        context.warnings.add("wall-clock", message.to_owned());
    }
    let mut rows = score::run(job, context)?;
    rows.extend(fuse::run(job, context)?);
    rows.extend(render::run(job, context)?);
    rows.extend(blend::run(job, context.progress)?);
    let svg = plot::svg(&rows).ok_or_else(no_stage)?;
    out.write("tradeoff.csv", |file| rows::write_csv(file, &rows))?;
    out.write("tradeoff.svg", |file| file.write_all(svg.as_bytes()))?;
    out.write("tradeoff.md", |file| {
        sentences(&rows)
            .iter()
            .try_for_each(|sentence| writeln!(file, "- {sentence}"))
    })?;
    out.finish()?;
    Ok(rows)
}

/// Reads the inputs of all stages before the first is measured, so that none is lost by what a later one lacks.
/// They are let go of again: memory that one stage's inputs take is not to count as another's.
fn check_inputs(job: &TradeoffJob, context: &Context<'_>) -> Result<()> {
    let said_again = Warnings::default();
    let context = &Context {
        warnings: &said_again,
        ..*context
    };
    // The quickest first.
    blend::check(job)?;
    score::check(job, context)?;
    render::check(job, context)?;
    fuse::check(job, context)
}

/// At most `most` of the views, spread evenly.
fn picked(views: &[View], most: u32) -> impl Iterator<Item = &View> {
    let step = views.len().div_ceil(most.max(1) as usize).max(1);
    views.iter().step_by(step)
}

/// Root mean square difference of colours in 8-bit levels over the pixels of the first images, where both
/// show surface (a channel above 0). The second image of a pair shows the same as the first, perhaps in
/// fewer pixels.
fn rmse<'a>(pairs: impl Iterator<Item = (&'a ColorImage, &'a ColorImage)>) -> f64 {
    let (mut sum, mut count) = (0.0, 0u64);
    for (exact, other) in pairs {
        for row in 0..exact.height() {
            let other_row = nearest(row, exact.height(), other.height());
            for column in 0..exact.width() {
                let other_column = nearest(column, exact.width(), other.width());
                let (a, b) = (exact.get(column, row), other.get(other_column, other_row));
                if a == [0; 3] || b == [0; 3] {
                    continue;
                }
                for channel in 0..3 {
                    let difference = f64::from(a[channel]) - f64::from(b[channel]);
                    sum += difference * difference;
                }
                count += 3;
            }
        }
    }
    #[allow(
        clippy::cast_precision_loss,
        reason = "pixel counts are far below 2^53"
    )]
    let mean = sum / count.max(1) as f64;
    mean.sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Of a ramp along both axes only the steps within one small pixel are left, wherever in the image.
    #[test]
    fn a_smaller_image_is_compared_where_it_shows_the_same() {
        let ramp = |width: u32, height: u32| {
            let level =
                |index: u32, count: u32| 50.0 + 150.0 * (f64::from(index) + 0.5) / f64::from(count);
            let values = (0..height).flat_map(|row| {
                (0..width).map(move |column| {
                    let (x, y) = (level(column, width), level(row, height));
                    [x.round() as u8, y.round() as u8, 100]
                })
            });
            ColorImage::from_values(width, height, values.collect()).unwrap()
        };
        let exact = ramp(259, 195);
        for by in [2, 4] {
            let small = ramp(259 / by, 195 / by);
            // Half a small pixel is the most that two places are apart.
            let most = 150.0 / f64::from(195 / by) / 2.0 + 1.0;
            let found = rmse([(&exact, &small)].into_iter());
            assert!(found < most / 1.7, "{found} of {most} at 1/{by}");
        }
        // By hand: five pixels beside two, of which the centre of the third is in the second.
        let grey = |values: &[u8]| {
            let values = values.iter().map(|&value| [value; 3]).collect::<Vec<_>>();
            ColorImage::from_values(values.len() as u32, 1, values).unwrap()
        };
        let exact = grey(&[10, 10, 10, 20, 30]);
        let found = rmse([(&exact, &grey(&[10, 20]))].into_iter());
        assert_eq!(found, (200.0f64 / 5.0).sqrt());
    }
}
