//! `mvs-eval inspect`: what a file or folder is, as this program understands it.

use super::Context;
use crate::error::{Error, Result};
use mvs_datasets::layout::cameras::{self, CameraSource, CamerasOptions, ReadCameras};
use mvs_datasets::layout::mvsnet::PixelCentre;
use mvs_datasets::layout::{files, mesh};
use mvs_datasets::scene::{Aabb, Scene, View};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// Options of `mvs-eval inspect`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct InspectJob {
    /// The file or folder.
    pub path: PathBuf,
    /// Where cams put the centre of the top-left pixel.
    pub pixel_center: PixelCentre,
}

/// What was understood.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Inspection {
    /// The file or folder.
    pub path: PathBuf,
    /// What it is taken for, in plain words.
    pub kind: String,
    /// Names and values, in reading order.
    pub facts: Vec<Fact>,
}

/// A name and a value.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Fact {
    /// What it is.
    pub name: &'static str,
    /// What it is like.
    pub value: String,
}

fn fact(name: &'static str, value: impl Into<String>) -> Fact {
    Fact {
        name,
        value: value.into(),
    }
}

/// Looks at the path.
pub fn run(job: &InspectJob, _context: &Context<'_>) -> Result<Inspection> {
    let path = &job.path;
    let extension = path
        .extension()
        .unwrap_or_default()
        .to_string_lossy()
        .to_ascii_lowercase();
    let (kind, facts) = if path.is_dir() {
        inspect_folder(job)?
    } else {
        match extension.as_str() {
            "ply" => inspect_ply(path)?,
            "obj" => inspect_mesh(path)?,
            "pfm" => inspect_depth(path)?,
            "jpg" | "jpeg" | "png" => inspect_image(path)?,
            "log" => inspect_log(path)?,
            "json" => inspect_json(job)?,
            _ => return Err(unknown(path)),
        }
    };
    Ok(Inspection {
        path: path.clone(),
        kind: kind.to_owned(),
        facts,
    })
}

fn unknown(path: &Path) -> Error {
    let known = "a .ply, .obj, .pfm, .jpg, .png, .log or .json file, or a folder of cams or meshes";
    Error::invalid(path.display().to_string(), format!("expected {known}"))
}

type Answer = Result<(&'static str, Vec<Fact>)>;

fn inspect_folder(job: &InspectJob) -> Answer {
    let options = CamerasOptions {
        pixel_centre: job.pixel_center,
        ..CamerasOptions::default()
    };
    match cameras::read_scene(&job.path, &options) {
        Ok(read) => Ok((source_name(read.source), camera_facts(read))),
        Err(no_cams) => inspect_mesh(&job.path).map_err(|_| no_cams.into()),
    }
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
    let centers = Aabb::around(views.iter().map(|view| view.pose.center_in_world()));
    facts.push(fact("camera centres", box_text(centers)));
    let ranges: Vec<_> = views.iter().filter_map(|view| view.depth_range).collect();
    let min = ranges.iter().map(|range| range.min()).reduce(f64::min);
    let max = ranges.iter().map(|range| range.max()).reduce(f64::max);
    if let (Some(min), Some(max)) = (min, max) {
        facts.push(fact("depth ranges", format!("{min} … {max}")));
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
        focal.x,
        focal.y,
        center.x,
        center.y
    )
}

fn box_text(bounds: Aabb) -> String {
    if bounds.is_empty() {
        return "none".to_owned();
    }
    let (min, max) = (bounds.min, bounds.max);
    format!(
        "{} … {}, {} … {}, {} … {}",
        min.x, max.x, min.y, max.y, min.z, max.z
    )
}

fn inspect_ply(path: &Path) -> Answer {
    let (cloud, dropped) = files::read_cloud(path)?.without_non_finite();
    if let Ok(loaded) = mesh::read_meshes(&[path.to_path_buf()])
        && !loaded.mesh.triangles().is_empty()
    {
        return inspect_mesh(path);
    }
    let columns = [
        ("normals", cloud.normals().is_some()),
        ("colours", cloud.colors().is_some()),
        ("view counts", cloud.view_counts().is_some()),
        ("confidences", cloud.confidences().is_some()),
    ];
    let present: Vec<&str> = columns
        .iter()
        .filter(|column| column.1)
        .map(|c| c.0)
        .collect();
    let columns = if present.is_empty() {
        "positions only".into()
    } else {
        present.join(", ")
    };
    let facts = vec![
        fact("points", cloud.len().to_string()),
        fact("not finite, left out", dropped.to_string()),
        fact("attributes", columns),
        fact("bounds", box_text(cloud.bounds())),
    ];
    Ok(("point cloud", facts))
}

fn inspect_mesh(path: &Path) -> Answer {
    let loaded = mesh::read_meshes(&[path.to_path_buf()])?;
    let mesh = &loaded.mesh;
    let textured = mesh
        .materials()
        .iter()
        .filter(|material| material.texture.is_some())
        .count();
    let mut facts = vec![
        fact("vertices", mesh.vertices().len().to_string()),
        fact("triangles", mesh.triangles().len().to_string()),
        fact(
            "materials",
            format!("{}, {textured} with a texture", mesh.materials().len()),
        ),
        fact(
            "texture coordinates",
            mesh.texture_coords().is_some().to_string(),
        ),
        fact("vertex colours", mesh.vertex_colors().is_some().to_string()),
        fact("bounds", box_text(mesh.bounds())),
    ];
    facts.extend(loaded.notes.into_iter().map(|note| fact("note", note)));
    Ok(("triangle mesh", facts))
}

fn inspect_depth(path: &Path) -> Answer {
    let (depth, rejected) = files::read_depth(path)?;
    let valid = || depth.values().iter().copied().filter(|&value| value > 0.0);
    let range = valid().reduce(f32::min).zip(valid().reduce(f32::max));
    let range = range.map_or("none".to_owned(), |(min, max)| format!("{min} … {max}"));
    let facts = vec![
        fact("size", format!("{}x{}", depth.width(), depth.height())),
        fact("pixels with a depth", depth.valid_count().to_string()),
        fact("NaN, infinite or negative", rejected.total().to_string()),
        fact("depths", range),
    ];
    Ok(("depth map", facts))
}

fn inspect_image(path: &Path) -> Answer {
    let image = files::read_image(path)?;
    Ok((
        "image",
        vec![fact(
            "size",
            format!("{}x{}", image.width(), image.height()),
        )],
    ))
}

fn inspect_log(path: &Path) -> Answer {
    let text = files::read_text(path)?;
    let poses =
        mvs_datasets::format::log::read(&text).map_err(mvs_datasets::Error::in_file(path))?;
    let unregistered = poses.iter().filter(|pose| pose.is_unregistered()).count();
    let registered = poses.iter().filter(|pose| !pose.is_unregistered());
    let centers = Aabb::around(registered.map(|pose| pose.world_from_cam.w_axis.truncate()));
    let facts = vec![
        fact("poses", poses.len().to_string()),
        fact("not registered", unregistered.to_string()),
        fact("camera centres", box_text(centers)),
    ];
    Ok(("camera trajectory", facts))
}

/// A crop volume, or cameras as transforms.json has them.
fn inspect_json(job: &InspectJob) -> Answer {
    let path = &job.path;
    let options = CamerasOptions {
        pixel_centre: job.pixel_center,
        ..CamerasOptions::default()
    };
    let volume = match files::read_crop(path) {
        Ok(volume) => volume,
        Err(no_crop) => {
            return match cameras::read_scene(path, &options) {
                Ok(read) => Ok((source_name(read.source), camera_facts(read))),
                Err(_) => Err(no_crop.into()),
            };
        }
    };
    let (min, max) = volume.range();
    let facts = vec![
        fact("swept along", format!("{:?}", volume.axis())),
        fact("from … to", format!("{min} … {max}")),
        fact("polygon vertices", volume.polygon().len().to_string()),
    ];
    Ok(("crop volume", facts))
}
