//! The knobs of fusion: sources, gates, sampling, map size and mode, against all sources.

use super::rows::{Measured, Row, rows};
use super::{TradeoffJob, clock, shrink};
use crate::error::{Error, Result};
use crate::fuse::{FuseMode, FuseOptions, Sampling};
use crate::jobs::Context;
use crate::jobs::fuse::{self, FuseJob};
use crate::jobs::score::read_truth;
use crate::score::FinitePoints;
use crate::score::plain::{self, Preparation};
use mvs_datasets::layout::files;
use mvs_datasets::layout::scratch::ScratchFolder;
use mvs_metrics::Tolerance;
use std::path::{Path, PathBuf};

/// What is fused, and how.
struct Setting {
    knob: &'static str,
    name: String,
    options: FuseOptions,
    /// Maps of a `shrink`-th of the width and height are fused.
    shrink: u32,
}

fn settings() -> Vec<Setting> {
    let exact = || FuseOptions {
        max_sources: 0,
        ..FuseOptions::default()
    };
    let setting = |knob, name: &str, options| Setting {
        knob,
        name: name.to_owned(),
        options,
        shrink: 1,
    };
    let turned = |knob, name: &str, turn: &dyn Fn(&mut FuseOptions)| {
        let mut options = exact();
        turn(&mut options);
        setting(knob, name, options)
    };
    let mut all = vec![setting("exact", "hkust, all sources", exact())];
    for count in [3, 5, 7, 10] {
        let turn = |options: &mut FuseOptions| options.max_sources = count;
        all.push(turned("sources", &count.to_string(), &turn));
    }
    for degrees in [0.0, 10.0, 20.0, 30.0, 45.0] {
        let turn = |options: &mut FuseOptions| options.wide_angle = degrees;
        all.push(turned("wide angle", &format!("{degrees}°"), &turn));
    }
    for share in [0.005, 0.02, 0.08] {
        let turn = |options: &mut FuseOptions| options.similar_depth = share;
        all.push(turned("similar depth", &share.to_string(), &turn));
    }
    let plain = |options: &mut FuseOptions| options.sampling = Sampling::Plain;
    all.push(turned("sampling", "plain", &plain));
    let bare = |options: &mut FuseOptions| options.normals = false;
    all.push(turned("normals", "left out", &bare));
    for (name, shrink) in [("a half", 2), ("a quarter", 4)] {
        all.push(Setting {
            shrink,
            ..setting("map size", name, exact())
        });
    }
    for (name, mode) in [
        ("geo", FuseMode::Geo),
        ("dynamic", FuseMode::Dynamic),
        ("gipuma", FuseMode::Gipuma),
        ("cluster", FuseMode::Cluster),
    ] {
        let name = format!("{name}, its own values");
        all.push(setting("mode", &name, FuseOptions::of(mode)));
    }
    all
}

/// The folders of depth and of confidence maps of a `by`-th of the size, made in `scratch` where they
/// are not there yet.
fn maps(job: &TradeoffJob, scratch: &Path, by: u32) -> Result<(PathBuf, Vec<PathBuf>)> {
    let (depths, confidence) = (job.depths.clone().unwrap_or_default(), &job.confidence);
    if by == 1 {
        return Ok((depths, confidence.iter().cloned().collect()));
    }
    let small = scratch.join(format!("depth-{by}"));
    if !small.exists() {
        shrink::folder((&depths, &small), by, shrink::depth)?;
    }
    let folders = confidence.iter().map(|folder| {
        let small = scratch.join(format!("confidence-{by}"));
        if !small.exists() {
            shrink::folder((folder, &small), by, shrink::confidence)?;
        }
        Ok(small)
    });
    Ok((small, folders.collect::<Result<_>>()?))
}

/// Says at which setting fusing failed, as where no point is left.
fn of_setting((knob, name): (&str, &str), error: Error) -> Error {
    match error {
        Error::Interrupted => error,
        error => Error::invalid(format!("fusing with {knob} {name}"), error.to_string()),
    }
}

/// Fuses at every setting; F against the job's `fuse_truth`, or against the exact setting's cloud.
pub(super) fn run(job: &TradeoffJob, context: &Context<'_>) -> Result<Vec<Row>> {
    let (Some(scene), Some(_)) = (&job.scene, &job.depths) else {
        return Ok(Vec::new());
    };
    let scratch = ScratchFolder::beside(&job.out.join("fused"))?;
    let mut truth: Option<FinitePoints> = match &job.fuse_truth {
        Some(path) => Some(read_truth(path, job.draw(), context.warnings)?.0),
        None => None,
    };
    let tolerance = Tolerance::new(job.tau)?;
    let settings = settings();
    let context = &Context {
        force: true,
        ..*context
    };
    let mut measured = Vec::new();
    for setting in settings {
        context.progress.check()?;
        let (depths, confidence) = maps(job, scratch.folder(), setting.shrink)?;
        let fuse_job = FuseJob {
            scene: scene.clone(),
            depths,
            confidence,
            out: scratch.folder().join("cloud.ply"),
            pixel_center: job.pixel_center,
            camera_size: job.camera_size,
            fuse: FuseOptions {
                min_confidence: job.min_confidence,
                ..setting.options
            },
            ..FuseJob::default()
        };
        let (_, cost) = clock::measure(job.repeats, || fuse::run(&fuse_job, context))
            .map_err(|error| of_setting((setting.knob, &setting.name), error))?;
        let cloud = FinitePoints::new(files::read_positions(&fuse_job.out)?);
        let truth = truth.get_or_insert_with(|| cloud.clone());
        let evaluation = plain::evaluate(&cloud, None, truth, &Preparation::default())?;
        let value = evaluation.score(tolerance).f_score();
        measured.push(Measured {
            knob: setting.knob,
            setting: setting.name,
            cost,
            value,
            half_width: None,
        });
    }
    let default = FuseOptions::default();
    let defaults = [
        ("sources", default.max_sources.to_string()),
        ("wide angle", format!("{}°", default.wide_angle)),
        ("similar depth", default.similar_depth.to_string()),
    ];
    Ok(rows(("fuse", "F"), measured, |knob, setting| {
        defaults
            .iter()
            .any(|(of, value)| *of == knob && value == setting)
    }))
}
