//! The knobs of blending: the filter's band limit, the mode and the light, against the default.

use super::rows::{Measured, Row, rows};
use super::{TradeoffJob, clock, picked, rmse};
use crate::blend::{BlendMode, BlendOptions, blend};
use crate::error::Result;
use crate::progress::Progress;
use mvs_datasets::layout::blended::BlendedFolder;
use mvs_datasets::layout::files;
use mvs_datasets::scene::{ColorImage, Mask, View};

/// Blends some views of a generated scene at every setting.
pub(super) fn run(job: &TradeoffJob, progress: &dyn Progress) -> Result<Vec<Row>> {
    let Some(path) = &job.dataset else {
        return Ok(Vec::new());
    };
    let folder = BlendedFolder::new(path);
    let scene = folder.read_scene(None)?;
    let inputs: Vec<(ColorImage, ColorImage, Mask)> = picked(scene.views(), job.views)
        .map(|view| read(&folder, view))
        .collect::<Result<_>>()?;
    let with = |d0, mode| BlendOptions {
        d0,
        mode,
        ..BlendOptions::default()
    };
    let BlendOptions { d0, mode, .. } = BlendOptions::default();
    let settings = [
        ("exact", format!("normalized, D0 = {d0}"), with(d0, mode)),
        ("band limit", "D0 = 1250".to_owned(), with(1250.0, mode)),
        ("band limit", "D0 = 2500".to_owned(), with(2500.0, mode)),
        ("band limit", "D0 = 10000".to_owned(), with(10_000.0, mode)),
        ("band limit", "D0 = 20000".to_owned(), with(20_000.0, mode)),
        (
            "mode",
            "reference".to_owned(),
            with(d0, BlendMode::Reference),
        ),
        (
            "mode",
            "composite".to_owned(),
            with(d0, BlendMode::Composite),
        ),
        (
            "light",
            "linear".to_owned(),
            BlendOptions {
                linear_light: true,
                ..BlendOptions::default()
            },
        ),
    ];
    progress.begin("blend settings", settings.len() as u64);
    let mut exact: Vec<ColorImage> = Vec::new();
    let mut measured = Vec::new();
    for (knob, setting, options) in settings {
        progress.check()?;
        let (images, cost) = clock::measure(job.repeats, || {
            let one = |(rendered, photograph, mask): &(ColorImage, ColorImage, Mask)| {
                crate::blend::masked(&blend(rendered, photograph, mask, &options)?, mask)
            };
            inputs.iter().map(one).collect::<Result<Vec<_>>>()
        })?;
        if exact.is_empty() {
            exact.clone_from(&images);
        }
        let value = rmse(exact.iter().zip(&images));
        measured.push(Measured {
            knob,
            setting,
            cost,
            value,
            half_width: None,
        });
        progress.advance(1);
    }
    Ok(rows(("blend", "RMSE"), measured, |knob, _| knob == "exact"))
}

/// The rendering, the photograph and where there is surface.
fn read(folder: &BlendedFolder, view: &View) -> Result<(ColorImage, ColorImage, Mask)> {
    let rendered = files::read_image(&folder.rendered_image(view.id))?;
    let photograph = files::read_image(&folder.input_image(view.id))?;
    let (depth, _) = folder.read_depth(view.id)?;
    let (width, height) = depth.size();
    let inside = depth.values().iter().map(|&depth| depth > 0.0).collect();
    let mask = Mask::from_values(width, height, inside)?;
    Ok((rendered, photograph, mask))
}
