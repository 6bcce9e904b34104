//! Facts about cameras.

use super::text::{between, box_text, short};
use super::{Answer, Fact, InspectJob, fact};
use crate::config::Size;
use crate::error::Result;
use crate::jobs::cameras::{INTEGER_CENTRES, NOMINAL, are_half_pixel_off, of_images, with_sizes};
use crate::jobs::fuse::find_image;
use glam::DVec2;
use mvs_datasets::format::pfm;
use mvs_datasets::layout::cameras::{self, CameraSource, CamerasOptions, LeftOpen, ReadCameras};
use mvs_datasets::layout::{files, mvsnet};
use mvs_datasets::scene::{Aabb, Distortion, Scene, View};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// What the folder or file of cameras holds.
pub(super) fn inspect(job: &InspectJob) -> Answer {
    let open = cameras::left_open(&job.path)?;
    let options = CamerasOptions {
        pixel_centre: job.pixel_center,
        size: open.size.then_some((NOMINAL.width, NOMINAL.height)),
        focal: open.focal.then_some(DVec2::ONE),
        ..CamerasOptions::default()
    };
    let read = cameras::inspect_scene(&job.path, &options)?;
    if open != LeftOpen::default() {
        return Ok((read.source.name(), open_facts(read, open)));
    }
    if read.source == CameraSource::Cams {
        return inspect_cams(job, read);
    }
    Ok((read.source.name(), camera_facts(read)))
}

/// Cams do not know their images' sizes: they are taken from the images where the folder has some.
fn inspect_cams(job: &InspectJob, mut read: ReadCameras) -> Answer {
    let images = images_of(job, read.scene.views());
    let Some(first) = images.iter().flatten().next() else {
        let mut facts = camera_facts(read);
        let text = "no images beside the cams: their size is taken as twice the principal point";
        facts.push(fact("note", text));
        return Ok((CameraSource::Cams.name(), facts));
    };
    let from = first.display().to_string();
    let mut unreadable = None;
    let given = images.iter().map(|image| {
        size_of(image.as_deref()).unwrap_or_else(|error| {
            unreadable.get_or_insert(error.to_string());
            None
        })
    });
    let given: Vec<Option<Size>> = given.collect();
    let sizes = of_images(read.scene.views(), &given);
    read.scene = with_sizes(read.scene, &sizes)?;
    let mut notes = size_notes(&read.scene, (&given, &sizes));
    notes.extend(are_half_pixel_off(&read.scene).then(|| INTEGER_CENTRES.to_owned()));
    notes.extend(unreadable);
    let mut facts = camera_facts(read);
    let count = images.iter().flatten().count();
    facts.push(fact(
        "image size from",
        match count {
            1 => from,
            _ => format!("{from} and {} others", count - 1),
        },
    ));
    facts.extend(notes.into_iter().map(|note| fact("note", note)));
    Ok((CameraSource::Cams.name(), facts))
}

/// Each view's depth map among the cams, or its image in their folder or beside it.
fn images_of(job: &InspectJob, views: &[View]) -> Vec<Option<PathBuf>> {
    let beside = job.path.parent().unwrap_or(&job.path);
    let find = |id: u32| {
        let depth = job.path.join(mvsnet::file_name(id, ".pfm"));
        let depth = Some(depth).filter(|path| path.is_file());
        let image = || find_image(&job.path, id).or_else(|| find_image(beside, id));
        depth.or_else(image)
    };
    views.iter().map(|view| find(view.id)).collect()
}

fn size_of(image: Option<&Path>) -> Result<Option<Size>> {
    let size = image.map(
        |path| match path.extension().is_some_and(|end| end == "pfm") {
            true => files::read_with(path, pfm::read_size),
            false => files::read_with(path, mvs_datasets::format::image::read_size),
        },
    );
    let size = size.transpose()?;
    Ok(size.map(|(width, height)| Size { width, height }))
}

/// What is odd about the sizes that images have and those of them that cams are taken to be for.
fn size_notes(scene: &Scene, (given, taken): (&[Option<Size>], &[Option<Size>])) -> Vec<String> {
    let mut notes = Vec::new();
    let views = scene.views();
    let sizes = views
        .iter()
        .map(|view| (view.camera.width(), view.camera.height()));
    let distinct: BTreeSet<(u32, u32)> = sizes.collect();
    if distinct.len() > 1 {
        let texts = distinct
            .iter()
            .map(|(width, height)| format!("{width}x{height}"));
        let texts: Vec<String> = texts.collect();
        notes.push(format!(
            "the views have different sizes: {}",
            texts.join(", ")
        ));
    }
    let mut refused = (views.iter().zip(given).zip(taken)).filter_map(|((view, given), taken)| {
        (*given)
            .filter(|_| taken.is_none())
            .map(|size| (view.id, size))
    });
    if let Some((id, size)) = refused.next() {
        notes.push(format!(
            "{} images do not go with the principal point, the first is view {id}'s of {size} pixels: the \
             cams are taken to be for images of another size, twice the principal point",
            1 + refused.count()
        ));
    }
    let without = given.iter().filter(|size| size.is_none()).count();
    if without > 0 {
        notes.push(format!(
            "{without} views have no image beside the cams: their size is taken as twice the principal point"
        ));
    }
    notes
}

fn camera_facts(read: ReadCameras) -> Vec<Fact> {
    let mut facts = vec![fact("read from", read.path.display().to_string())];
    facts.extend(scene_facts(&read.scene));
    facts.extend(read.notes.into_iter().map(|note| fact("note", note)));
    facts
}

/// What is known of cameras without an image size or a focal length, which they were read with stand-ins for.
fn open_facts(read: ReadCameras, open: LeftOpen) -> Vec<Fact> {
    let views = read.scene.views();
    let mut facts = vec![fact("read from", read.path.display().to_string())];
    facts.push(fact("views", views.len().to_string()));
    facts.extend(names_text(views).map(|names| fact("image names", names)));
    facts.push(fact("camera centres", centers_text(views)));
    let size = "no image size (w, h): generate takes the photographs', all else that reads these cameras needs \
                --camera-size";
    let focal = "no focal length (fl_x or camera_angle_x): what reads these cameras needs --focal";
    let lacking = [(open.size, size), (open.focal, focal)];
    let lacking = lacking.into_iter().filter(|(lacks, _)| *lacks);
    facts.extend(lacking.map(|(_, text)| fact("note", text)));
    facts.extend(read.notes.into_iter().map(|note| fact("note", note)));
    facts
}

fn centers_text(views: &[View]) -> String {
    box_text(Aabb::around(
        views.iter().map(|view| view.pose.center_in_world()),
    ))
}

/// Names that one line shows.
const NAMES: usize = 20;

/// Which image each id is, where names do not say it.
fn names_text(views: &[View]) -> Option<String> {
    let is_told = |view: &View| {
        let stem = Path::new(&view.name).file_stem().unwrap_or_default();
        stem.to_str().and_then(|stem| stem.parse().ok()) == Some(view.id)
    };
    if views
        .iter()
        .all(|view| view.name.is_empty() || is_told(view))
    {
        return None;
    }
    let names = views.iter().take(NAMES);
    let names: Vec<String> = names
        .map(|view| format!("{} = {}", view.id, view.name))
        .collect();
    let more = if views.len() > NAMES { ", …" } else { "" };
    Some(names.join(", ") + more)
}

fn scene_facts(scene: &Scene) -> Vec<Fact> {
    let views = scene.views();
    let mut facts = vec![fact("views", views.len().to_string())];
    if let (Some(first), Some(last)) = (views.first(), views.last()) {
        facts.push(fact("ids", format!("{} … {}", first.id, last.id)));
        facts.push(fact("first view", view_text(first)));
    }
    facts.extend(names_text(views).map(|names| fact("image names", names)));
    facts.push(fact("lens", lens_text(views)));
    facts.push(fact("camera centres", centers_text(views)));
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
            .then(|| libm::atan(ray.truncate().length()).to_degrees())
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
