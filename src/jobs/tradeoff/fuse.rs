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
use std::path::PathBuf;

/// What is fused, and how.
struct Setting {
    knob: &'static str,
    name: String,
    options: FuseOptions,
    /// Maps of a `shrink`-th of the width and height are fused.
    shrink: u32,
}

impl Setting {
    fn title(&self) -> String {
        format!("fusing with {} {}", self.knob, self.name)
    }
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

/// What fusing needs beside its settings.
struct Inputs {
    /// What clouds are scored against: the exact setting's where none is given.
    truth: Option<FinitePoints>,
    /// Where smaller maps and clouds lie.
    scratch: ScratchFolder,
}

impl Inputs {
    fn read(job: &TradeoffJob, context: &Context<'_>) -> Result<Option<Self>> {
        if job.scene.is_none() || job.depths.is_none() {
            return Ok(None);
        }
        let truth = job.fuse_truth.as_deref();
        let truth = truth.map(|path| read_truth(path, job.draw(), context.warnings));
        Ok(Some(Self {
            truth: truth.transpose()?.map(|(points, ..)| points),
            scratch: ScratchFolder::beside(&job.out)?,
        }))
    }

    /// What is run at a setting.
    fn job(&self, job: &TradeoffJob, setting: &Setting) -> Result<FuseJob> {
        let (depths, confidence) = self.maps(job, setting.shrink)?;
        Ok(FuseJob {
            scene: job.scene.clone().unwrap_or_default(),
            depths,
            confidence,
            out: self.scratch.folder().join("cloud.ply"),
            pixel_center: job.pixel_center,
            camera_size: job.camera_size,
            fuse: FuseOptions {
                min_confidence: job.min_confidence,
                ..setting.options.clone()
            },
            ..FuseJob::default()
        })
    }

    /// The folders of depth and of confidence maps of a `by`-th of the size, made in the scratch where they
    /// are not there yet.
    fn maps(&self, job: &TradeoffJob, by: u32) -> Result<(PathBuf, Vec<PathBuf>)> {
        let (depths, confidence) = (job.depths.clone().unwrap_or_default(), &job.confidence);
        if by == 1 {
            return Ok((depths, confidence.iter().cloned().collect()));
        }
        let small = self.scratch.folder().join(format!("depth-{by}"));
        if !small.exists() {
            shrink::folder((&depths, &small), by, shrink::depth)?;
        }
        let folders = confidence.iter().map(|folder| {
            let small = self.scratch.folder().join(format!("confidence-{by}"));
            if !small.exists() {
                shrink::folder((folder, &small), by, shrink::confidence)?;
            }
            Ok(small)
        });
        Ok((small, folders.collect::<Result<_>>()?))
    }
}

/// Says at which setting fusing failed.
fn of_setting(setting: &Setting, error: Error) -> Error {
    match error {
        Error::Interrupted => error,
        error => Error::invalid(setting.title(), error.to_string()),
    }
}

/// Refuses what [`run`] would, before anything is measured: reads the truth and the maps of every size.
pub(super) fn check(job: &TradeoffJob, context: &Context<'_>) -> Result<()> {
    let Some(inputs) = Inputs::read(job, context)? else {
        return Ok(());
    };
    for setting in settings() {
        if setting.knob == "exact" {
            fuse::check_inputs(&inputs.job(job, &setting)?, context)?;
        } else if setting.shrink > 1 {
            fuse::check_inputs(&inputs.job(job, &setting)?, context)
                .map_err(|error| of_setting(&setting, error))?;
        }
    }
    Ok(())
}

/// Fuses at every setting; F against the job's `fuse_truth`, or against the exact setting's cloud. A setting
/// that keeps no point has F = 0.
pub(super) fn run(job: &TradeoffJob, context: &Context<'_>) -> Result<Vec<Row>> {
    let Some(mut inputs) = Inputs::read(job, context)? else {
        return Ok(Vec::new());
    };
    let tolerance = Tolerance::new(job.tau)?;
    let context = &Context {
        force: true,
        ..*context
    };
    let mut measured = Vec::new();
    for setting in settings() {
        context.progress.check()?;
        let fuse_job = inputs.job(job, &setting)?;
        let (nothing, cost) =
            clock::measure(job.repeats, || match fuse::run(&fuse_job, context) {
                Ok(_) => Ok(None),
                Err(Error::NoPoints { problem, .. }) => Ok(Some(problem)),
                Err(error) => Err(of_setting(&setting, error)),
            })?;
        let cloud = match nothing {
            None => files::read_positions(&fuse_job.out)?,
            Some(problem) => {
                warn_of_nothing((&setting, &problem), inputs.truth.is_none(), context);
                Vec::new()
            }
        };
        let cloud = FinitePoints::new(cloud);
        let truth = inputs.truth.get_or_insert_with(|| cloud.clone());
        measured.push(Measured {
            knob: setting.knob,
            setting: setting.name,
            cost,
            value: f_score(&cloud, truth, tolerance)?,
            half_width: None,
        });
    }
    let default = FuseOptions::default();
    let defaults = [
        ("sources", default.max_sources.to_string()),
        ("wide angle", format!("{}°", default.wide_angle)),
        ("similar depth", default.similar_depth.to_string()),
    ];
    Ok(rows(("fuse", "F"), Some(1.0), measured, |knob, setting| {
        defaults
            .iter()
            .any(|(of, value)| *of == knob && value == setting)
    }))
}

/// `is_truth` where the others are held against this setting's cloud.
fn warn_of_nothing((setting, problem): (&Setting, &str), is_truth: bool, context: &Context<'_>) {
    let others = match is_truth {
        true => ", and so is that of all settings, which are held against it: give --fuse-truth",
        false => "",
    };
    let message = format!("{}: {problem}; F is 0{others}", setting.title());
    context.warnings.add("nothing-fused", message);
}

/// F of two clouds; 0 where either has no points.
fn f_score(cloud: &FinitePoints, truth: &FinitePoints, tolerance: Tolerance) -> Result<f64> {
    if truth.is_empty() {
        return Ok(0.0);
    }
    let evaluation = plain::evaluate(cloud, None, truth, &Preparation::default())?;
    Ok(evaluation.score(tolerance).f_score())
}
