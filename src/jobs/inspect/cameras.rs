//! Facts about cameras.

use super::text::{between, box_text, short};
use super::{Answer, Fact, InspectJob, fact};
use crate::jobs::cameras::{INTEGER_CENTRES, are_half_pixel_off};
use crate::jobs::fuse::find_image;
use glam::DVec2;
use mvs_datasets::layout::cameras::{self, CameraSource, CamerasOptions, ReadCameras};
use mvs_datasets::layout::files;
use mvs_datasets::scene::{Aabb, Distortion, Scene, View};

/// What the folder or file of cameras holds.
pub(super) fn inspect(job: &InspectJob) -> Answer {
    let options = CamerasOptions {
        pixel_centre: job.pixel_center,
        ..CamerasOptions::default()
    };
    let read = cameras::read_scene(&job.path, &options)?;
    if read.source == CameraSource::Cams {
        return inspect_cams(job, read, options);
    }
    Ok((source_name(read.source), camera_facts(read)))
}

/// Cams do not know their images' size: it is taken from an image where the folder has one.
fn inspect_cams(job: &InspectJob, read: ReadCameras, options: CamerasOptions) -> Answer {
    let image = read.scene.views().first().and_then(|view| {
        let beside = job.path.parent().unwrap_or(&job.path);
        find_image(&job.path, view.id).or_else(|| find_image(beside, view.id))
    });
    let Some(image) = image else {
        let mut facts = camera_facts(read);
        let text = "no images beside the cams: their size is taken as twice the principal point";
        facts.push(fact("note", text));
        return Ok((source_name(CameraSource::Cams), facts));
    };
    let size = files::read_with(&image, mvs_datasets::format::image::read_size)?;
    let options = CamerasOptions {
        size: Some(size),
        ..options
    };
    let read = cameras::read_scene(&job.path, &options)?;
    let integer = are_half_pixel_off(&read.scene).then_some(INTEGER_CENTRES);
    let mut facts = camera_facts(read);
    facts.push(fact("image size from", image.display().to_string()));
    facts.extend(integer.map(|note| fact("note", note)));
    Ok((source_name(CameraSource::Cams), facts))
}

fn source_name(source: CameraSource) -> &'static str {
    match source {
        CameraSource::Cams => "MVSNet cameras",
        CameraSource::Colmap => "COLMAP model",
        CameraSource::Transforms => "transforms.json",
        CameraSource::Log => "camera trajectory",
    }
}

fn camera_facts(read: ReadCameras) -> Vec<Fact> {
    let mut facts = vec![fact("read from", read.path.display().to_string())];
    facts.extend(scene_facts(&read.scene));
    facts.extend(read.notes.into_iter().map(|note| fact("note", note)));
    facts
}

fn scene_facts(scene: &Scene) -> Vec<Fact> {
    let views = scene.views();
    let mut facts = vec![fact("views", views.len().to_string())];
    if let (Some(first), Some(last)) = (views.first(), views.last()) {
        facts.push(fact("ids", format!("{} … {}", first.id, last.id)));
        facts.push(fact("first view", view_text(first)));
    }
    facts.push(fact("lens", lens_text(views)));
    let centers = Aabb::around(views.iter().map(|view| view.pose.center_in_world()));
    facts.push(fact("camera centres", box_text(centers)));
    let ranges: Vec<_> = views.iter().filter_map(|view| view.depth_range).collect();
    let min = ranges.iter().map(|range| range.min()).reduce(f64::min);
    let max = ranges.iter().map(|range| range.max()).reduce(f64::max);
    if let (Some(min), Some(max)) = (min, max) {
        facts.push(fact("depth ranges", between(min, max)));
    }
    let sources = (0..views.len()).map(|index| scene.sources_of(index).len());
    let (least, most) = (
        sources.clone().min().unwrap_or(0),
        sources.max().unwrap_or(0),
    );
    facts.push(fact("source views per view", format!("{least} … {most}")));
    facts
}

fn view_text(view: &View) -> String {
    let camera = view.camera;
    let (focal, center) = (camera.focal(), camera.center());
    format!(
        "{}x{} px, focal lengths {} and {} px, principal point ({}, {}) px from the outer corner",
        camera.width(),
        camera.height(),
        short(focal.x),
        short(focal.y),
        short(center.x),
        short(center.y)
    )
}

/// What lenses do, in plain words.
fn lens_text(views: &[View]) -> String {
    let bent = |view: &&View| view.camera.distortion() != Distortion::None;
    let Some(first) = views.iter().find(bent) else {
        return "none: pinhole cameras".to_owned();
    };
    let kind = match first.camera.distortion() {
        Distortion::None => "none",
        Distortion::RadialTangential { .. } => "radial and tangential",
        Distortion::Fisheye { .. } => "fisheye",
        Distortion::ThinPrismFisheye { .. } => "thin-prism fisheye",
        Distortion::FieldOfView { .. } => "field-of-view",
    };
    let camera = first.camera;
    let size = DVec2::new(f64::from(camera.width()), f64::from(camera.height()));
    let corners = [DVec2::ZERO, DVec2::X, DVec2::Y, DVec2::ONE].map(|part| part * size);
    let angle = |corner: DVec2| {
        let ray = camera.ray(corner);
        ray.is_finite()
            .then(|| ray.truncate().length().atan().to_degrees())
    };
    let reach: Vec<f64> = corners.into_iter().filter_map(angle).collect();
    let corner = match reach.iter().copied().reduce(f64::max) {
        Some(degrees) if reach.len() == 4 => {
            format!("its corners look up to {degrees:.1} degrees off the axis")
        }
        _ => "its corners lie outside its field, where there are no rays".to_owned(),
    };
    let count = views.iter().filter(bent).count();
    format!(
        "{count} of {} views have a {kind} lens; that of view {}: {corner}",
        views.len(),
        first.id
    )
}
