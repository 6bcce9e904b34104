//! `mvs-eval inspect`: what a file or folder is, as this program understands it.

mod cameras;
mod text;

use super::Context;
use crate::error::{Error, Result};
use crate::score::points::prism;
use mvs_datasets::format::ply;
use mvs_datasets::layout::cameras::source_files;
use mvs_datasets::layout::mvsnet::PixelCentre;
use mvs_datasets::layout::tnt::{TntFolder, known_tolerance};
use mvs_datasets::layout::{blended, files, mesh};
use mvs_datasets::scene::{Aabb, ColorImage, Material, Mesh, PointCloud};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use text::{between, box_text, short};

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
///
/// # Errors
/// Nothing there, a file of no known ending, and what cannot be read as what it is taken for.
pub fn run(job: &InspectJob, _context: &Context<'_>) -> Result<Inspection> {
    let path = &job.path;
    if !path.exists() {
        let problem = match path.symlink_metadata() {
            Ok(_) => "expected a file or folder, found a link that leads to none",
            Err(error) if error.kind() == std::io::ErrorKind::PermissionDenied => {
                "expected a file or folder, found one that may not be looked at: permission denied"
            }
            Err(_) => "expected a file or folder, found nothing there",
        };
        return Err(mvs_datasets::Error::layout(path, problem).into());
    }
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
            "obj" | "gltf" | "glb" => inspect_mesh(path)?,
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
    let known = "a .ply, .obj, .gltf, .glb, .pfm, .jpg, .png, .log or .json file, or a folder of cams, meshes or a Tanks and Temples scene";
    Error::invalid(path.display().to_string(), format!("expected {known}"))
}

type Answer = Result<(&'static str, Vec<Fact>)>;

fn inspect_folder(job: &InspectJob) -> Answer {
    if let Some(folder) = TntFolder::find(&job.path) {
        return inspect_tnt(&folder);
    }
    // What lies there decides, so that what is wrong with it is said.
    if source_files(&job.path)?.is_some() {
        return cameras::inspect(job);
    }
    let names = blended::names_in(&job.path)?;
    if names.iter().any(|name| mesh::is_mesh(Path::new(name))) {
        return inspect_mesh(&job.path);
    }
    let scenes = blended::scenes_in(&job.path)?;
    match scenes.first() {
        None => cameras::inspect(job),
        Some(first) => Ok((
            "data set",
            vec![
                fact("scenes", scenes.len().to_string()),
                fact("first scene", first.as_str()),
                fact(
                    "in list files",
                    blended::listed_in(&job.path)?.len().to_string(),
                ),
            ],
        )),
    }
}

fn inspect_tnt(folder: &TntFolder) -> Answer {
    let (truth, dropped) = PointCloud::new(folder.read_truth()?).without_non_finite();
    let crop = prism(&folder.read_crop()?)?;
    let points = truth.positions().iter();
    let kept = points.filter(|&&point| crop.contains(point)).count();
    let tolerance = known_tolerance(&folder.name);
    let facts = vec![
        fact("scene", folder.name.clone()),
        fact(
            "τ",
            tolerance.map_or("not one of the seven scenes: give --tau".into(), |tau| {
                format!("{tau} m")
            }),
        ),
        fact("points of the scan", truth.len().to_string()),
        fact("not finite, left out", dropped.to_string()),
        fact("inside the crop volume", kept.to_string()),
        fact("bounds", box_text(truth.bounds())),
        fact(
            "reference poses",
            folder.read_trajectory()?.len().to_string(),
        ),
        fact(
            "scale of the transform",
            short(folder.read_transform()?.scale()),
        ),
        fact(
            "mapping of a video log",
            if folder.mapping.is_some() {
                "yes"
            } else {
                "no"
            },
        ),
    ];
    Ok(("Tanks and Temples scene", facts))
}

fn inspect_ply(path: &Path) -> Answer {
    if files::read_with(path, ply::read_summary)?.faces > 0 {
        return inspect_mesh(path);
    }
    let (cloud, dropped) = files::read_cloud(path)?.without_non_finite();
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
    let mut facts = vec![
        fact("vertices", mesh.vertices().len().to_string()),
        fact("triangles", mesh.triangles().len().to_string()),
    ];
    facts.extend(look_facts(mesh));
    facts.push(fact("bounds", box_text(mesh.bounds())));
    facts.extend(loaded.notes.into_iter().map(|note| fact("note", note)));
    Ok(("triangle mesh", facts))
}

/// Where a mesh's colours come from, in plain words.
fn look_facts(mesh: &Mesh) -> Vec<Fact> {
    let mut faces = vec![0usize; mesh.materials().len()];
    match mesh.triangle_materials() {
        Some(slots) => slots.iter().for_each(|&slot| faces[slot as usize] += 1),
        None => faces[0] = mesh.triangles().len(),
    }
    let count = |has: fn(&Material) -> bool| {
        let materials = mesh.materials().iter().zip(&faces);
        let with = materials.filter(|(material, _)| has(material));
        with.fold((0, 0), |(materials, all), (_, faces)| {
            (materials + 1, all + faces)
        })
    };
    let (textured, textured_faces) = count(|material| material.texture.is_some());
    let (masked, masked_faces) = count(|material| material.cutout.is_some());
    let (both, both_faces) = count(|material| material.double_sided);
    let total = mesh.triangles().len();
    let rest = match mesh.vertex_colors() {
        _ if textured_faces == total => "",
        Some(_) => "; the others show vertex colors",
        None => "; the others show one color per material",
    };
    let mut facts = vec![
        fact("materials", mesh.materials().len().to_string()),
        fact(
            "color",
            format!(
                "{textured_faces} of {total} triangles show a texture ({textured} materials){rest}"
            ),
        ),
        fact("textures", textures_text(mesh)),
    ];
    if masked > 0 {
        let text = format!("{masked_faces} triangles ({masked} materials) are cut out by a mask");
        facts.push(fact("masks", text));
    }
    if both > 0 {
        let text = format!("{both_faces} triangles ({both} materials) have two sides");
        facts.push(fact("double-sided", text));
    }
    facts
}

/// How many textures there are, their sizes and memory.
fn textures_text(mesh: &Mesh) -> String {
    let mut textures: Vec<&Arc<ColorImage>> = Vec::new();
    for texture in mesh.materials().iter().filter_map(|m| m.texture.as_ref()) {
        if !textures.iter().any(|known| Arc::ptr_eq(known, texture)) {
            textures.push(texture);
        }
    }
    let bytes: usize = textures
        .iter()
        .map(|texture| 3 * texture.values().len())
        .sum();
    let largest = textures.iter().max_by_key(|texture| texture.values().len());
    match largest {
        None => "none".to_owned(),
        Some(largest) => format!(
            "{}, the largest {}x{}, {} MiB decoded",
            textures.len(),
            largest.width(),
            largest.height(),
            bytes.div_ceil(1 << 20)
        ),
    }
}

fn inspect_depth(path: &Path) -> Answer {
    let (depth, rejected) = files::read_depth(path)?;
    let valid = || depth.values().iter().copied().filter(|&value| value > 0.0);
    let range = valid().reduce(f32::min).zip(valid().reduce(f32::max));
    let range = range.map_or("none".to_owned(), |(min, max)| {
        between(min.into(), max.into())
    });
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
    let volume = match (files::read_crop(&job.path), cameras::inspect(job)) {
        (Ok(volume), _) => volume,
        (Err(_), Ok(cameras)) => return Ok(cameras),
        (Err(no_crop), Err(no_cameras)) => {
            let problem = format!(
                "expected a crop volume or cameras, found neither: as a crop volume, {no_crop}; as \
                 cameras, {no_cameras}"
            );
            return Err(Error::invalid(job.path.display().to_string(), problem));
        }
    };
    let (min, max) = volume.range();
    let facts = vec![
        fact("swept along", format!("{:?}", volume.axis())),
        fact("from … to", between(min, max)),
        fact("polygon vertices", volume.polygon().len().to_string()),
    ];
    Ok(("crop volume", facts))
}
