//! `mvs-eval generate`: mesh + cameras + photographs → a BlendedMVS scene.

use super::{Context, OutDir};
use crate::config::Size;
use crate::error::{Error, Result};
use crate::generate::{self, GenerateOptions, PhotoFolder, Source, scene_id};
use crate::provenance::Run;
use mvs_datasets::layout::blended::record::SceneFile;
use mvs_datasets::layout::blended::{self, BlendedFolder};
use mvs_datasets::layout::mesh;
use mvs_datasets::layout::mvsnet::{self, CamsOptions, PixelCentre};
use mvs_datasets::scene::Scene;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// Options of `mvs-eval generate`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct GenerateJob {
    /// Mesh files, or folders of them; together they are one scene.
    pub mesh: Vec<PathBuf>,
    /// A folder of MVSNet cams.
    pub cameras: PathBuf,
    /// A folder of photographs, named by view id.
    pub photos: PathBuf,
    /// The data set's root; the scene becomes a folder in it.
    pub out: PathBuf,
    /// The scene's name, whose hash is its folder's; by default the name of the folder with the
    /// photographs' parent.
    pub name: Option<String>,
    /// The 24 hexadecimal digits of the scene's folder instead of the name's hash.
    pub id: Option<String>,
    /// The image size the intrinsics are for; without it the photographs' size, or, where that does
    /// not agree with the principal point, twice the principal point.
    pub camera_size: Option<Size>,
    /// Where the cams put the centre of the top-left pixel.
    pub pixel_center: PixelCentre,
    /// How the scene is made.
    pub options: GenerateOptions,
}

/// What was generated.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct GenerateOutcome {
    /// The scene's folder.
    pub folder: PathBuf,
    /// What its `scene.json` says.
    pub scene: SceneFile,
}

/// Generates the scene, or finishes it where an earlier run was interrupted.
pub fn run(job: &GenerateJob, context: &Context<'_>) -> Result<GenerateOutcome> {
    let name = name_of(job);
    let id = id_of(job, &name)?;
    let scene = read_cameras(job, context)?;
    let photographs = PhotoFolder::open(&job.photos, scene.views())?;
    let mut inputs: Vec<&Path> = job.mesh.iter().map(PathBuf::as_path).collect();
    inputs.extend([job.cameras.as_path(), job.photos.as_path()]);
    let folder = job.out.join(&id);
    let run = Run::new("generate", job, &inputs)?;
    let out = OutDir::create_again(&folder, run, context.force)?;
    let loaded = mesh::read_meshes(&job.mesh)?;
    for note in &loaded.notes {
        context.warnings.add("mesh", note.clone());
    }
    let source = Source {
        name: &name,
        id: &id,
        mesh: &loaded.mesh,
        views: scene.views(),
        photographs: &photographs,
    };
    let scene = generate::generate(
        &source,
        &BlendedFolder::new(&folder),
        &job.options,
        context.progress,
        context.warnings,
    )?;
    blended::write_lists(&job.out, &[])?;
    out.finish()?;
    Ok(GenerateOutcome { folder, scene })
}

/// The given name, or that of the folder that holds the photographs' folder.
fn name_of(job: &GenerateJob) -> String {
    let given = job.name.clone();
    given.unwrap_or_else(|| {
        let path = std::path::absolute(&job.photos).unwrap_or_else(|_| job.photos.clone());
        let named = path.parent().and_then(Path::file_name).or(path.file_name());
        named.map_or_else(String::new, |name| name.to_string_lossy().into_owned())
    })
}

fn id_of(job: &GenerateJob, name: &str) -> Result<String> {
    match &job.id {
        None => Ok(scene_id(name)),
        Some(id) if blended::is_scene_id(id) => Ok(id.clone()),
        Some(id) => {
            let problem = format!("expected 24 digits 0-9 and a-f, found `{id}`");
            Err(Error::invalid("scene id", problem))
        }
    }
}

/// The cameras, with the image size that their intrinsics are for.
fn read_cameras(job: &GenerateJob, context: &Context<'_>) -> Result<Scene> {
    let options = |size: Option<(u32, u32)>| CamsOptions {
        pixel_centre: job.pixel_center,
        size,
    };
    let given = job.camera_size.map(|size| (size.width, size.height));
    let scene = mvsnet::read_scene(&job.cameras, &options(given))?;
    let (None, Some(first)) = (given, scene.views().first()) else {
        return Ok(scene);
    };
    let photographs = PhotoFolder::open(&job.photos, scene.views())?;
    let found = photographs.size(first)?;
    let center = first.camera.center();
    let near = |length: u32, center: f64| (2.0 * center / f64::from(length) - 1.0).abs() < 0.05;
    if near(found.0, center.x) && near(found.1, center.y) {
        return Ok(mvsnet::read_scene(&job.cameras, &options(Some(found)))?);
    }
    let message = format!(
        "the photographs have {} x {} pixels, the principal point of view {} is ({}, {}); its \
         intrinsics are taken to be for {} x {} pixels; give the size to say otherwise",
        found.0,
        found.1,
        first.id,
        center.x,
        center.y,
        first.camera.width(),
        first.camera.height()
    );
    context.warnings.add("camera-size", message);
    Ok(scene)
}
