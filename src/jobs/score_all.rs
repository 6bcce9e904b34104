//! `mvs-eval score --all`: every scene and method under a folder, going on after failures.

use super::score::{self, Protocol, ScoreDocument, ScoreJob};
use super::{Context, OutDir};
use crate::error::{Error, Result};
use crate::provenance::{VERSION, sorted_entries};
use crate::report::record::{self, Record};
use crate::warning::Warnings;
use mvs_datasets::layout::files;
use mvs_datasets::layout::tnt::{TntFolder, known_tolerance, model_images};
use serde::Serialize;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// What a file name ends in that names its folder a scene's.
const SCENE_MARK: &str = "_trans.txt";

/// What a folder lacks whose reconstruction cannot be aligned.
const NOT_ALIGNED: &str =
    ".log of its cameras, no COLMAP model of them and no .txt with its transform";

/// What became of every scene and method.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct BatchOutcome {
    /// By scene, then by method.
    pub rows: Vec<BatchRow>,
    /// How many rows are not `ok`.
    pub not_ok: usize,
}

/// What became of one scene and method.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct BatchRow {
    /// The scene.
    pub scene: String,
    /// The method.
    pub method: String,
    /// Fraction of the reconstruction that is right; none where scoring failed.
    pub precision: Option<f64>,
    /// Fraction of the truth that was found.
    pub recall: Option<f64>,
    /// 2PR / (P + R).
    pub f_score: Option<f64>,
    /// `ok`, the failed gates, or why there is no score.
    pub status: String,
}

/// A scene folder.
#[derive(Debug, Clone, PartialEq)]
struct SceneFolder {
    path: PathBuf,
    name: String,
}

/// One reconstruction to be scored, or why it cannot be.
#[derive(Debug)]
struct Task {
    scene: SceneFolder,
    method: String,
    files: Result<Files>,
}

/// A reconstruction and how it is aligned.
#[derive(Debug, Clone, PartialEq)]
struct Files {
    reconstruction: PathBuf,
    trajectory: Option<PathBuf>,
    transform: Option<PathBuf>,
}

/// Scores everything that `job.all` holds. Scene folders are `ROOT/<folder>/` with the files of a
/// Tanks and Temples scene. Methods are their sub-folders with one `.ply` and one `.log`, or else a
/// COLMAP model (in the sub-folder, its `sparse` or `sparse/0`), or else one `.txt` that holds a 4×4
/// transform. With `job.methods` they are `METHODS/<method>/<Scene>.ply` beside `<Scene>.log`, a
/// folder `<Scene>` with the model, or `<Scene>.txt`.
///
/// Results go to `OUT/<scene>/<method>/`, all rows to `OUT/scores.csv`; a failure is a row that says
/// why. Of a batch that is replaced, the results of what failed or is gone are removed.
///
/// # Errors
/// Options that are for one scene or with which none can be scored, nothing to score, two folders of one scene, a
/// result that would lie in its method's folder, an output folder as [`OutDir::create`] refuses it, folders that
/// cannot be read, whatever writing brings, and interruption.
pub fn run(job: &ScoreJob, context: &Context<'_>) -> Result<BatchOutcome> {
    check_options(job)?;
    let root = job.all.as_deref().unwrap_or(Path::new("."));
    let tasks = find_tasks(root, job.methods.as_deref())?;
    check_places(job, &tasks)?;
    let inputs = inputs_of(&tasks);
    let inputs: Vec<&Path> = inputs.iter().map(PathBuf::as_path).collect();
    let out = OutDir::create(
        &job.out,
        context.run(
            "score",
            &as_scored(job),
            &OutDir::inputs(&job.out, &inputs)?,
        )?,
        context.force,
    )?;
    // What lies in the folder was made by this batch, or by the one before it that it replaces.
    let inner = Context {
        force: true,
        ..*context
    };
    let mut records = Vec::new();
    let mut rows = Vec::new();
    for task in tasks {
        context.progress.check()?;
        let (scene, method) = (task.scene.name.clone(), task.method.clone());
        let scored = match score_task(job, task, &out, &inner) {
            Err(Error::Interrupted) => return Err(Error::Interrupted),
            scored => scored,
        };
        let (of_task, row) = reported(job, scene, method, scored);
        records.extend(of_task);
        rows.push(row);
    }
    out.write("scores.csv", |file| record::write(file, &records))?;
    out.finish()?;
    let not_ok = rows.iter().filter(|row| row.status != "ok").count();
    Ok(BatchOutcome { rows, not_ok })
}

/// The options with the procedure that a batch always follows, which need not be given.
fn as_scored(job: &ScoreJob) -> ScoreJob {
    ScoreJob {
        protocol: Protocol::Tnt,
        ..job.clone()
    }
}

/// Says which options mean nothing to a batch.
fn check_options(job: &ScoreJob) -> Result<()> {
    let foreign = [
        (job.scene.is_some(), "--scene"),
        (
            !job.reconstruction.as_os_str().is_empty(),
            "--reconstruction",
        ),
        (job.transform.is_some(), "--transform"),
        (job.trajectory.is_some(), "--trajectory"),
        (job.name.is_some(), "--name"),
        (job.method.is_some(), "--method"),
        (job.truth.is_some(), "--truth"),
        (job.crop.is_some(), "--crop"),
        (job.voxel.is_some(), "--voxel"),
    ];
    match foreign.into_iter().find(|(given, _)| *given) {
        Some((_, option)) => Err(Error::invalid(
            option,
            "does not go with --all, which finds scenes and methods by their folders",
        )),
        // What no scene can be scored with is no row for each of them.
        None => score::check_values(&ScoreJob {
            protocol: Protocol::Tnt,
            ..job.clone()
        }),
    }
}

/// Refuses to write a method's result into the folder that the method is read from: its clouds would be taken for
/// the method's by the next batch.
fn check_places(job: &ScoreJob, tasks: &[Task]) -> Result<()> {
    for task in tasks {
        let scene = &task.scene;
        let result = job.out.join(&scene.name).join(&task.method);
        let read = job
            .methods
            .as_ref()
            .unwrap_or(&scene.path)
            .join(&task.method);
        let real = result.canonicalize().ok();
        if real.is_some() && real == read.canonicalize().ok() {
            let problem = "expected another folder for the result than the method's own, which is read: give another \
                           --out";
            return Err(Error::invalid(result.display().to_string(), problem));
        }
    }
    Ok(())
}

/// Every file that is there to be read, once.
fn inputs_of(tasks: &[Task]) -> BTreeSet<PathBuf> {
    let mut inputs = BTreeSet::new();
    for task in tasks {
        if let Ok(folder) = TntFolder::open(&task.scene.path, Some(&task.scene.name)) {
            let of_scene = [
                folder.truth,
                folder.crop,
                folder.trajectory,
                folder.transform,
            ];
            inputs.extend(of_scene.into_iter().chain(folder.mapping));
        }
        if let Ok(files) = &task.files {
            let files = files.clone();
            let cameras = files
                .trajectory
                .map(|path| model_images(&path).unwrap_or(path));
            let aligned_by = cameras.into_iter().chain(files.transform);
            inputs.extend(aligned_by.chain([files.reconstruction]));
        }
    }
    inputs
}

fn score_task(
    job: &ScoreJob,
    task: Task,
    out: &OutDir,
    context: &Context<'_>,
) -> Result<ScoreDocument> {
    let inputs = task.files?;
    let folder = Path::new(&task.scene.name).join(&task.method);
    let name = folder.display().to_string();
    // What only an alignment heeds is for the methods that come without a transform.
    let (standard, aligned) = (ScoreJob::default(), inputs.transform.is_none());
    let seeds = if aligned || job.refine {
        job
    } else {
        &standard
    }
    .seeds;
    let camera_distance = if aligned { job } else { &standard }.camera_distance;
    let job = ScoreJob {
        seeds,
        camera_distance,
        all: None,
        methods: None,
        protocol: Protocol::Tnt,
        scene: Some(task.scene.path),
        name: Some(task.scene.name),
        method: Some(task.method),
        reconstruction: inputs.reconstruction,
        trajectory: inputs.trajectory,
        refine: job.refine && inputs.transform.is_some(),
        transform: inputs.transform,
        out: out.file(folder),
        ..job.clone()
    };
    let warnings = Warnings::default();
    let inner = Context {
        warnings: &warnings,
        ..*context
    };
    let scored = score::run(&job, &inner);
    if scored.is_ok() {
        out.adopt(&name)?;
    }
    for warning in warnings.sorted() {
        let message = format!("{name}: {}", warning.message);
        context.warnings.add(&warning.code, message);
    }
    scored
}

fn reported(
    job: &ScoreJob,
    scene: String,
    method: String,
    scored: Result<ScoreDocument>,
) -> (Vec<Record>, BatchRow) {
    match scored {
        Ok(document) => {
            let records = score::records(&document);
            let row = BatchRow {
                scene,
                method,
                precision: Some(document.precision),
                recall: Some(document.recall),
                f_score: Some(document.f_score),
                status: records
                    .first()
                    .map_or_else(String::new, |record| record.status.clone()),
            };
            (records, row)
        }
        Err(error) => {
            let status = format!("failed: {error}");
            let tau = job.tau.first().copied();
            let record = Record {
                protocol: Protocol::Tnt.to_string(),
                profile: job.profile.to_string(),
                method: method.clone(),
                split: score::split_of(Protocol::Tnt, &scene).into(),
                scene: scene.clone(),
                threshold: tau.or_else(|| known_tolerance(&scene)),
                unit: score::unit_of(Protocol::Tnt, &scene).into(),
                seed: Some(job.seed),
                status: status.clone(),
                tool_version: VERSION.into(),
                ..Record::default()
            };
            let row = BatchRow {
                scene,
                method,
                precision: None,
                recall: None,
                f_score: None,
                status,
            };
            (vec![record], row)
        }
    }
}

fn find_tasks(root: &Path, methods: Option<&Path>) -> Result<Vec<Task>> {
    let mut scenes = Vec::new();
    for folder in folders_of(root)? {
        let names = files_of(&folder)?.into_iter().filter_map(|file| {
            let name = file.file_name()?.to_str()?.strip_suffix(SCENE_MARK)?;
            Some(name.to_owned())
        });
        scenes.extend(names.map(|name| SceneFolder {
            path: folder.clone(),
            name,
        }));
    }
    let mut folders = BTreeMap::new();
    for scene in &scenes {
        if let Some(other) = folders.insert(scene.name.as_str(), &scene.path) {
            let problem = format!(
                "expected one folder per scene, found {} and {} with the files of {}: one's results \
                 would replace the other's; move one of them away",
                other.display(),
                scene.path.display(),
                scene.name
            );
            return Err(Error::invalid(root.display().to_string(), problem));
        }
    }
    let mut tasks = Vec::new();
    for scene in &scenes {
        match methods {
            Some(methods) => tasks.extend(submitted(scene, methods)?),
            None => tasks.extend(beside(scene)?),
        }
    }
    if tasks.is_empty() {
        let problem = format!(
            "expected scene folders with <Scene>{SCENE_MARK} and methods in them or under --methods, \
             found {} scenes and no method",
            scenes.len()
        );
        return Err(Error::invalid(root.display().to_string(), problem));
    }
    Ok(tasks)
}

/// `METHODS/<method>/<Scene>.ply` with `<Scene>.log`, `<Scene>/` or `<Scene>.txt` for every method.
fn submitted(scene: &SceneFolder, methods: &Path) -> Result<Vec<Task>> {
    let task = |folder: PathBuf| {
        let file = |extension: &str| folder.join(format!("{}.{extension}", scene.name));
        let there = |extension: &str| Some(file(extension)).filter(|path| path.is_file());
        let files = match there("ply") {
            Some(reconstruction) => {
                let model = folder.join(&scene.name);
                let texts = there("txt");
                cameras(there("log").as_slice(), &model, &folder)
                    .and_then(|cameras| aligned(reconstruction, cameras, texts.as_slice(), &folder))
            }
            None => Err(missing(&folder, &format!("{}.ply", scene.name))),
        };
        Task {
            scene: scene.clone(),
            method: name_of(&folder),
            files,
        }
    };
    Ok(folders_of(methods)?.into_iter().map(task).collect())
}

/// The sub-folders of a scene with a cloud or a log in them.
fn beside(scene: &SceneFolder) -> Result<Vec<Task>> {
    let mut tasks = Vec::new();
    for folder in folders_of(&scene.path)? {
        let files = files_of(&folder)?;
        let ending = |extension: &str| -> Vec<PathBuf> {
            let has = |file: &&PathBuf| file.extension().is_some_and(|found| found == extension);
            files.iter().filter(has).cloned().collect()
        };
        let clouds = ending("ply");
        if clouds.is_empty() && ending("log").is_empty() {
            continue;
        }
        let files = match clouds.as_slice() {
            [one] => cameras(&ending("log"), &folder, &folder)
                .and_then(|cameras| aligned(one.clone(), cameras, &ending("txt"), &folder)),
            [] => Err(missing(&folder, ".ply")),
            several => Err(too_many(&folder, ".ply", several)),
        };
        tasks.push(Task {
            scene: scene.clone(),
            method: name_of(&folder),
            files,
        });
    }
    Ok(tasks)
}

/// The reconstruction's cameras: the one log or, where there is none, the folder of the COLMAP model.
fn cameras(logs: &[PathBuf], model: &Path, folder: &Path) -> Result<Option<PathBuf>> {
    match logs {
        [log] => Ok(Some(log.clone())),
        [] => Ok(Some(model.to_owned()).filter(|model| model_images(model).is_some())),
        several => Err(too_many(folder, ".log", several)),
    }
}

/// The reconstruction with its cameras or, where there are none, its one text file that holds a
/// transform.
fn aligned(
    reconstruction: PathBuf,
    cameras: Option<PathBuf>,
    texts: &[PathBuf],
    folder: &Path,
) -> Result<Files> {
    let transform = match cameras {
        Some(_) => None,
        None => Some(transform_among(texts, folder)?),
    };
    Ok(Files {
        reconstruction,
        trajectory: cameras,
        transform,
    })
}

/// The one text that holds a transform.
fn transform_among(texts: &[PathBuf], folder: &Path) -> Result<PathBuf> {
    let holds = |text: &&PathBuf| files::read_similarity(text).is_ok();
    let transforms: Vec<PathBuf> = texts.iter().filter(holds).cloned().collect();
    match (transforms.as_slice(), texts) {
        ([one], _) => Ok(one.clone()),
        // Its own reader says best what is wrong with it.
        ([], [one]) => Err(unreadable_transform(one, folder)),
        ([], _) => Err(missing(folder, NOT_ALIGNED)),
        (several, _) => Err(too_many(folder, ".txt with a transform", several)),
    }
}

/// Why a folder's only text is no transform.
fn unreadable_transform(text: &Path, folder: &Path) -> Error {
    let why = files::read_similarity(text).err();
    let why = why.map_or_else(String::new, |error| format!(" ({error})"));
    let what = format!("{NOT_ALIGNED}{why}");
    missing(folder, &what)
}

fn too_many(folder: &Path, what: &str, found: &[PathBuf]) -> Error {
    let names: Vec<String> = found.iter().map(|path| name_of(path)).collect();
    let problem = format!("expected one {what}, found {}", names.join(", "));
    Error::invalid(folder.display().to_string(), problem)
}

fn missing(folder: &Path, what: &str) -> Error {
    Error::invalid(folder.display().to_string(), format!("found no {what}"))
}

fn name_of(path: &Path) -> String {
    let name = path.file_name().unwrap_or_default();
    name.to_string_lossy().into_owned()
}

fn folders_of(folder: &Path) -> Result<Vec<PathBuf>> {
    let mut all = sorted_entries(folder)?;
    all.retain(|path| path.is_dir());
    Ok(all)
}

fn files_of(folder: &Path) -> Result<Vec<PathBuf>> {
    let mut all = sorted_entries(folder)?;
    all.retain(|path| path.is_file());
    Ok(all)
}
