//! The knobs of blending: the filter's band limit, the mode and the light, against the default.

use super::rows::{Measured, Row, rows};
use super::{TradeoffJob, clock, picked, rmse};
use crate::blend::{BlendMode, BlendOptions, blend};
use crate::error::{Error, Result};
use crate::progress::Progress;
use mvs_datasets::layout::blended::BlendedFolder;
use mvs_datasets::layout::files;
use mvs_datasets::scene::{ColorImage, Mask, View};

/// The rendering, the photograph and where there is surface.
type Input = (ColorImage, ColorImage, Mask);

/// The views to blend; none without a scene.
fn read(job: &TradeoffJob) -> Result<Vec<Input>> {
    let Some(path) = &job.dataset else {
        return Ok(Vec::new());
    };
    let folder = BlendedFolder::new(path);
    let scene = folder.read_scene(None)?;
    let views = picked(scene.views(), job.views);
    views.map(|view| read_view(&folder, view)).collect()
}

/// Refuses what [`run`] would, before anything is measured.
pub(super) fn check(job: &TradeoffJob) -> Result<()> {
    for (rendered, photograph, mask) in read(job)? {
        blend(&rendered, &photograph, &mask, &BlendOptions::default())?;
    }
    Ok(())
}

/// Blends some views of a generated scene at every setting.
pub(super) fn run(job: &TradeoffJob, progress: &dyn Progress) -> Result<Vec<Row>> {
    let inputs = read(job)?;
    if inputs.is_empty() {
        return Ok(Vec::new());
    }
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
            let one = |(rendered, photograph, mask): &Input| {
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
    Ok(rows(("blend", "RMSE"), None, measured, |knob, _| {
        knob == "exact"
    }))
}

fn read_view(folder: &BlendedFolder, view: &View) -> Result<Input> {
    let paths = [folder.rendered_image(view.id), folder.input_image(view.id)];
    if let Some(missing) = paths.iter().find(|path| !path.is_file()) {
        let problem = "expected the rendering and the photograph of each view, found none here: they are \
                       written by `mvs-eval generate --extras input-images,rendered-images`";
        return Err(Error::invalid(missing.display().to_string(), problem));
    }
    let [rendered, photograph] = paths.map(|path| files::read_image(&path));
    let (depth, _) = folder.read_depth(view.id)?;
    let (width, height) = depth.size();
    let inside = depth.values().iter().map(|&depth| depth > 0.0).collect();
    let mask = Mask::from_values(width, height, inside)?;
    Ok((rendered?, photograph?, mask))
}
