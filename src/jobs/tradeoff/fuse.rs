//! The knobs of fusion: number of sources, sampling and mode, against all sources.

use super::rows::{Measured, Row, rows};
use super::{TradeoffJob, clock};
use crate::error::{Error, Result};
use crate::fuse::{FuseMode, FuseOptions, Sampling};
use crate::jobs::Context;
use crate::jobs::fuse::{self, FuseJob};
use glam::DVec3;
use mvs_datasets::layout::files;
use mvs_datasets::layout::scratch::ScratchFolder;
use mvs_metrics::{Score, Tolerance, distance};

fn settings() -> Vec<(&'static str, String, FuseOptions)> {
    let exact = FuseOptions {
        max_sources: 0,
        ..FuseOptions::default()
    };
    let mut all = vec![("exact", "hkust, all sources".to_owned(), exact.clone())];
    for count in [3, 5, 7, 10] {
        let options = FuseOptions {
            max_sources: count,
            ..exact.clone()
        };
        all.push(("sources", count.to_string(), options));
    }
    let options = FuseOptions {
        sampling: Sampling::Plain,
        ..exact.clone()
    };
    all.push(("sampling", "plain".to_owned(), options));
    let options = FuseOptions {
        normals: false,
        ..exact
    };
    all.push(("normals", "left out".to_owned(), options));
    for (name, mode) in [
        ("geo", FuseMode::Geo),
        ("dynamic", FuseMode::Dynamic),
        ("gipuma", FuseMode::Gipuma),
    ] {
        all.push((
            "mode",
            format!("{name}, its own values"),
            FuseOptions::of(mode),
        ));
    }
    all
}

/// Fuses at every setting; F against the job's `fuse_truth`, or against the exact setting's cloud.
pub(super) fn run(job: &TradeoffJob, context: &Context<'_>) -> Result<Vec<Row>> {
    let (Some(scene), Some(depths)) = (&job.scene, &job.depths) else {
        return Ok(Vec::new());
    };
    let scratch = ScratchFolder::beside(&job.out.join("fused"))?;
    let mut truth: Option<Vec<DVec3>> = match &job.fuse_truth {
        Some(path) => Some(files::read_cloud(path)?.into_positions()),
        None => None,
    };
    let tolerance = Tolerance::new(job.tau)?;
    let settings = settings();
    let context = &Context {
        force: true,
        ..*context
    };
    let mut measured = Vec::new();
    for (knob, setting, options) in settings {
        context.progress.check()?;
        let fuse_job = FuseJob {
            scene: scene.clone(),
            depths: depths.clone(),
            confidence: job.confidence.iter().cloned().collect(),
            out: scratch.folder().join("cloud.ply"),
            pixel_center: job.pixel_center,
            fuse: FuseOptions {
                min_confidence: job.min_confidence,
                ..options
            },
            ..FuseJob::default()
        };
        let (_, cost) = clock::measure(job.repeats, || fuse::run(&fuse_job, context))?;
        let cloud = files::read_cloud(&fuse_job.out)?.into_positions();
        let truth = truth.get_or_insert_with(|| cloud.clone());
        let (to_truth, to_cloud) = distance::both_ways(&cloud, truth)
            .map_err(|error| Error::invalid("fused cloud", error.to_string()))?;
        let value = Score::from_distances(&to_truth, &to_cloud, tolerance).f_score();
        measured.push(Measured {
            knob,
            setting,
            cost,
            value,
            half_width: None,
        });
    }
    let default = FuseOptions::default().max_sources.to_string();
    Ok(rows(("fuse", "F"), measured, |knob, setting| {
        knob == "sources" && setting == default
    }))
}
