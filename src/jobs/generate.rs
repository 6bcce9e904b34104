//! `mvs-eval generate`: mesh + cameras + photographs → a BlendedMVS scene.

use super::cameras::{self, CameraOptions};
use super::meshes::{MeshOptions, read_mesh, warn_of_plain};
use super::{Context, OutDir};
use crate::config::Size;
use crate::error::{Error, Result};
use crate::generate::{
    self, Extra, GenerateOptions, Part, PhotoFolder, Source, Target, scene_id, sparse_sources,
};
use crate::parallel;
use crate::provenance::{Inputs, Run};
use mvs_datasets::layout::blended::record::SceneFile;
use mvs_datasets::layout::blended::{self, BlendedFolder};
use mvs_datasets::layout::cameras::{self as layout, CameraSource, CamerasOptions};
use mvs_datasets::layout::mesh::LoadedMesh;
use mvs_datasets::layout::mvsnet::PixelCentre;
use mvs_datasets::layout::sparse;
use mvs_datasets::scene::{Scene, SourceScore, View};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::collections::BTreeSet;
use std::path::{Component, Path, PathBuf};

/// Options of `mvs-eval generate`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct GenerateJob {
    /// Mesh files, or folders of them; together they are one scene.
    pub mesh: Vec<PathBuf>,
    /// Cameras in any form that [`mvs_datasets::layout::cameras`] knows.
    pub cameras: PathBuf,
    /// A folder of photographs, named by view id.
    pub photos: PathBuf,
    /// The data set's root; the scene becomes a folder in it.
    pub out: PathBuf,
    /// Image sizes of sets that are made in one run, each with a root of its own in `out`, e.g.
    /// `2048x1536/`; with one size or none there is one set, in `out` itself.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub sizes: Vec<Size>,
    /// Whether the scene is held out for validation in the list files.
    pub validation: bool,
    /// The scene's name, whose hash is its folder's; by default the name of the folder with the
    /// photographs' parent.
    pub name: Option<String>,
    /// The 24 hexadecimal digits of the scene's folder instead of the name's hash.
    pub id: Option<String>,
    /// What the camera files leave open; a view's image size is its photograph's where that goes with the
    /// principal point.
    pub camera: CameraOptions,
    /// Where the cams put the centre of the top-left pixel.
    pub pixel_center: PixelCentre,
    /// What says which views see the same surface.
    pub pairs: PairsFrom,
    /// How the mesh is read.
    pub meshes: MeshOptions,
    /// How the scene is made.
    pub options: GenerateOptions,
}

/// What source views are chosen by.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum PairsFrom {
    /// What the mesh lets each view see.
    #[default]
    Exact,
    /// The points of the COLMAP model that the cameras are from, as `mvs-eval pairs` does.
    Colmap,
}

/// What was generated.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct GenerateOutcome {
    /// One per image size, in the order of the sizes.
    pub sets: Vec<GeneratedSet>,
}

/// The scene at one image size.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct GeneratedSet {
    /// The scene's folder.
    pub folder: PathBuf,
    /// Views that are finished now.
    pub views: usize,
    /// What its `scene.json` says; none where only a shard was made.
    pub scene: Option<SceneFile>,
}

/// Generates the scene, or a part of it, or finishes it where an earlier run was interrupted.
///
/// # Errors
/// Paths not given, options that do not go together, an output folder as [`OutDir::create_again`] refuses it or in
/// which what is read would be replaced, cameras, photographs or meshes that cannot be read; else as
/// [`generate::generate_sets`].
pub fn run(job: &GenerateJob, part: Part, context: &Context<'_>) -> Result<GenerateOutcome> {
    check_paths(job)?;
    let name = name_of(job);
    let id = id_of(job, &name)?;
    let roots = roots_of(job)?;
    let blank = Run::new("generate", job, &Inputs::default())?;
    for (root, _) in &roots {
        OutDir::check_again(&root.join(&id), &blank, context.force).map_err(of_unfinished)?;
    }
    let scene = read_cameras(job, context)?;
    let photographs = PhotoFolder::open(&job.photos, scene.views())?;
    for warning in photographs.warnings() {
        context.warnings.add(&warning.code, warning.message);
    }
    let sources = chosen_sources(job, scene.views())?;
    let loaded = read_mesh(&job.mesh, &job.meshes, context)?;
    warn_of_plain(&loaded.mesh, context);
    let inputs = inputs_of(job, &loaded, &photographs)?;
    let inputs: Vec<&Path> = inputs.iter().map(PathBuf::as_path).collect();
    let run = context.run("generate", job, &Inputs::list(&inputs, &[])?)?;
    let create = |(root, _): &(PathBuf, _)| {
        let out = OutDir::create_shared(&root.join(&id), run.clone(), context.force)?;
        generate::written().try_for_each(|name| out.check_not_read(name))?;
        Ok(out)
    };
    let outs = roots.iter().map(create).collect::<Result<Vec<_>>>();
    let mut outs = outs.map_err(of_unfinished)?;
    let source = Source {
        name: &name,
        id: &id,
        mesh: &loaded.mesh,
        views: scene.views(),
        photographs: &photographs,
        notes: &loaded.notes,
        sources: sources.as_deref(),
    };
    let target = |(root, size): &(PathBuf, Option<(u32, u32)>)| Target {
        folder: BlendedFolder::new(root.join(&id)),
        size: *size,
    };
    let targets: Vec<Target> = roots.iter().map(target).collect();
    let made = generate::generate_sets(
        &source,
        (&targets, part),
        &job.options,
        &mut |index| outs[index].begin(),
        context.progress,
        context.warnings,
    )?;
    let mut sets = Vec::new();
    for (((root, _), out), made) in roots.iter().zip(outs).zip(made) {
        let folder = root.join(&id);
        if made.scene.is_some() {
            let _held = blended::write_lists(root, &id, job.validation)?;
            for file in exported(&job.options.extras) {
                let _ = out.file(file);
            }
            out.finish()?;
        }
        sets.push(GeneratedSet {
            folder,
            views: made.views,
            scene: made.scene,
        });
    }
    Ok(GenerateOutcome { sets })
}

/// Says of a folder that is in the way, if so it is, that its result is not finished.
fn of_unfinished(error: Error) -> Error {
    match error {
        Error::Exists { path } if path.join(blended::UNFINISHED).is_file() => {
            let problem = "expected an unfinished result of the same options and inputs, found one of \
                           others (a file that was read has changed, perhaps): give --force to go on; \
                           finished views that follow from what is unchanged are kept";
            Error::invalid(path.display().to_string(), problem)
        }
        other => other,
    }
}

/// The files of the whole scene that only some runs write. Those of views are looked after where views are
/// made.
fn exported(extras: &BTreeSet<Extra>) -> impl Iterator<Item = &'static str> {
    let files = extras.iter().map(|extra| match extra {
        Extra::Covisibility => &["covisibility.npy"][..],
        Extra::Transforms => &["transforms.json"],
        Extra::Colmap => &[
            "sparse/0/cameras.txt",
            "sparse/0/images.txt",
            "sparse/0/points3D.txt",
        ],
        _ => &[],
    });
    files.flatten().copied()
}

fn check_paths(job: &GenerateJob) -> Result<()> {
    let mesh: Vec<&Path> = job.mesh.iter().map(PathBuf::as_path).collect();
    super::require(
        "generate",
        &[
            ("--mesh", &mesh, "meshes"),
            ("--cameras", &[&job.cameras], "cameras"),
            ("--photos", &[&job.photos], "a folder of photographs"),
            ("--out", &[&job.out], "a folder to write"),
        ],
    )
}

/// Every file that the scene follows from: what else lies in the folders, the data set perhaps, does
/// not count.
fn inputs_of(
    job: &GenerateJob,
    loaded: &LoadedMesh,
    photographs: &PhotoFolder,
) -> Result<Vec<PathBuf>> {
    let cameras = layout::source_files(&job.cameras)?;
    let mut inputs = loaded.files.clone();
    inputs.extend(cameras.into_iter().flat_map(|(_, files)| files));
    inputs.extend(photographs.files().map(Path::to_path_buf));
    Ok(inputs)
}

/// The sources of each of `views`, where the model's points choose them.
fn chosen_sources(job: &GenerateJob, views: &[View]) -> Result<Option<Vec<Vec<SourceScore>>>> {
    if job.pairs == PairsFrom::Exact {
        return Ok(None);
    }
    let source = layout::source_files(&job.cameras)?.map(|(source, _)| source);
    if source != Some(CameraSource::Colmap) {
        let problem = format!(
            "expected cameras of a COLMAP model, whose points choose the source views, found {}: \
             name the model's folder",
            source.map_or("none".to_owned(), |source| format!("{source:?}"))
        );
        return Err(Error::invalid("--pairs colmap", problem));
    }
    let model = sparse::read_sparse(&job.cameras, &CamerasOptions::default())?;
    let seen = (&model.points[..], &model.seen[..]);
    let chosen = sparse_sources(&model.views, seen, &job.options.pairs)?;
    let of_id: BTreeMap<u32, Vec<SourceScore>> =
        model.views.iter().map(|view| view.id).zip(chosen).collect();
    let of_view = |view: &View| of_id.get(&view.id).cloned().unwrap_or_default();
    Ok(Some(views.iter().map(of_view).collect()))
}

/// The root of a set and its image size in pixels; `None` for that of the photographs.
type Root = (PathBuf, Option<(u32, u32)>);

/// The root of each set and its image size.
fn roots_of(job: &GenerateJob) -> Result<Vec<Root>> {
    let pair = |size: &Size| Some((size.width, size.height));
    if let (Some((width, height)), [first, ..]) = (job.options.size, &job.sizes[..]) {
        let problem = format!(
            "expected `sizes` or `options.size`, found both ({first}, {width}x{height}): leave one out"
        );
        return Err(Error::invalid("image sizes", problem));
    }
    if let Some((index, twice)) =
        (job.sizes.iter().enumerate()).find(|(index, size)| job.sizes[..*index].contains(size))
    {
        let problem = format!("expected distinct sizes, found {twice} again at place {index}");
        return Err(Error::invalid("image sizes", problem));
    }
    Ok(match &job.sizes[..] {
        [] => vec![(job.out.clone(), job.options.size)],
        [size] => vec![(job.out.clone(), pair(size))],
        sizes => (sizes.iter())
            .map(|size| (job.out.join(size.to_string()), pair(size)))
            .collect(),
    })
}

/// The given name, or that of the folder that holds the photographs' folder.
pub(super) fn name_of(job: &GenerateJob) -> String {
    let given = job.name.clone();
    given.unwrap_or_else(|| {
        let path = std::path::absolute(&job.photos).unwrap_or_else(|_| job.photos.clone());
        let path = without_parents(path);
        let named = path.parent().and_then(Path::file_name).or(path.file_name());
        named.map_or_else(String::new, |name| name.to_string_lossy().into_owned())
    })
}

/// The path with its `..` gone through, so that a folder has one name however it is reached.
fn without_parents(path: PathBuf) -> PathBuf {
    let parts: Vec<Component<'_>> = path.components().collect();
    let last = parts.iter().rposition(|part| *part == Component::ParentDir);
    let Some(last) = last else {
        return path;
    };
    let (up, rest) = parts.split_at(last + 1);
    let up: PathBuf = up.iter().collect();
    up.canonicalize()
        .unwrap_or(up)
        .join(rest.iter().collect::<PathBuf>())
}

pub(super) fn id_of(job: &GenerateJob, name: &str) -> Result<String> {
    match &job.id {
        None => Ok(scene_id(name)),
        Some(id) if blended::is_scene_id(id) => Ok(id.clone()),
        Some(id) => {
            let problem = format!("expected 24 digits 0-9 and a-f, found `{id}`");
            Err(Error::invalid("scene id", problem))
        }
    }
}

/// The cameras; the photographs' sizes help where the camera files have none.
fn read_cameras(job: &GenerateJob, context: &Context<'_>) -> Result<Scene> {
    let options = (job.pixel_center, &job.camera);
    let sizes = |views: &[View]| {
        let photographs = PhotoFolder::open(&job.photos, views)?;
        parallel::try_map(views.len(), |index| {
            let (width, height) = photographs.size(&views[index])?;
            Ok(Size { width, height })
        })
    };
    let (scene, photographs) = cameras::read_for(&job.cameras, options, sizes, context)?;
    warn_of_sizes(scene.views(), &photographs, job, context);
    Ok(scene)
}

/// Says so where photographs have another size than their intrinsics are for.
fn warn_of_sizes(views: &[View], photographs: &[Size], job: &GenerateJob, context: &Context<'_>) {
    let size_of = |view: &View| (view.camera.width(), view.camera.height());
    let differs = |(view, size): &(&View, &Size)| size_of(view) != (size.width, size.height);
    let others = || views.iter().zip(photographs).filter(differs);
    if let Some((view, photograph)) = others().next() {
        let (width, height) = size_of(view);
        let advice = match job.camera.size {
            Some(_) => "give another --camera-size",
            None => "give --camera-size, or correct the size that the camera files state",
        };
        let message = format!(
            "{} of {} photographs are resized to what their view's intrinsics are taken to be for; the \
             first is view {}'s, from {photograph} to {width}x{height} pixels: if that is wrong, {advice}",
            others().count(),
            views.len(),
            view.id
        );
        context.warnings.add("camera-size", message);
    }
}
