//! The knobs of rendering: colour samples per pixel and resolution, against 64 samples.

use super::rows::{Measured, Row, rows};
use super::{TradeoffJob, clock, picked, rmse};
use crate::error::Result;
use crate::jobs::Context;
use crate::jobs::cameras::{self, CameraOptions};
use crate::jobs::meshes::{MeshOptions, read_mesh};
use crate::render::{RenderOptions, Renderer};
use mvs_datasets::layout::mesh::LoadedMesh;
use mvs_datasets::scene::{ColorImage, View};

const EXACT: u32 = 64;

/// The views to render and the mesh.
fn read(job: &TradeoffJob, context: &Context<'_>) -> Result<Option<(Vec<View>, LoadedMesh)>> {
    let Some(path) = job.cameras.as_ref().filter(|_| !job.mesh.is_empty()) else {
        return Ok(None);
    };
    let camera = CameraOptions::default();
    let mut scene = cameras::read(path, (job.pixel_center, &camera), job.size, context)?;
    if let Some(size) = job.size {
        scene = cameras::fitted(scene, size)?;
    }
    let views = picked(scene.views(), job.views).cloned().collect();
    let loaded = read_mesh(&job.mesh, &MeshOptions::default(), context)?;
    Ok(Some((views, loaded)))
}

/// Refuses what [`run`] would, before anything is measured.
pub(super) fn check(job: &TradeoffJob, context: &Context<'_>) -> Result<()> {
    let read = read(job, context)?;
    read.map_or(Ok(()), |(_, loaded)| Renderer::new(&loaded.mesh).map(drop))
}

/// Renders some views of the scene at every setting.
pub(super) fn run(job: &TradeoffJob, context: &Context<'_>) -> Result<Vec<Row>> {
    let Some((views, loaded)) = read(job, context)? else {
        return Ok(Vec::new());
    };
    let renderer = Renderer::new(&loaded.mesh)?;
    let settings = [
        ("exact", "64 samples", EXACT, 1),
        ("samples", "1", 1, 1),
        ("samples", "4", 4, 1),
        ("samples", "16", 16, 1),
        ("samples", "36", 36, 1),
        ("resolution", "a half, 16 samples", 16, 2),
        ("resolution", "a quarter, 16 samples", 16, 4),
    ];
    context
        .progress
        .begin("render settings", settings.len() as u64);
    let mut exact: Vec<ColorImage> = Vec::new();
    let mut measured = Vec::new();
    for (knob, setting, samples, shrink) in settings {
        context.progress.check()?;
        let options = RenderOptions {
            samples,
            ..RenderOptions::default()
        };
        let small: Vec<View> = views
            .iter()
            .map(|view| shrunk(view, shrink))
            .collect::<Result<_>>()?;
        let (images, cost) = clock::measure(job.repeats, || {
            let render = |view| {
                renderer
                    .render(view, &options)
                    .map(|rendering| rendering.color)
            };
            small.iter().map(render).collect::<Result<Vec<_>>>()
        })?;
        if exact.is_empty() {
            exact.clone_from(&images);
        }
        let value = rmse(exact.iter().zip(&images));
        let setting = setting.to_owned();
        measured.push(Measured {
            knob,
            setting,
            cost,
            value,
            half_width: None,
        });
        context.progress.advance(1);
    }
    let default = RenderOptions::default().samples.to_string();
    Ok(rows(("render", "RMSE"), None, measured, |knob, setting| {
        knob == "samples" && setting == default
    }))
}

/// The view with images of a `by`-th of the width and height, rounded down, at least 1: they show the same.
fn shrunk(view: &View, by: u32) -> Result<View> {
    let size = [view.camera.width(), view.camera.height()].map(|side| (side / by).max(1));
    let camera = view.camera.resized(size[0], size[1])?;
    Ok(View {
        camera,
        ..view.clone()
    })
}
