//! `mvs-eval generate --manifest`: several scenes, going on after failures.

use super::Context;
use super::generate::{self, GenerateJob};
use crate::config;
use crate::error::{Error, Result};
use crate::generate::Part;
use crate::warning::Warnings;
use mvs_datasets::layout::files;
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use toml::{Table, Value};

/// What a manifest says.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Manifest {
    /// Options of every scene.
    #[serde(default)]
    defaults: Table,
    /// The scenes, each with the options of one `generate`.
    scene: Vec<Table>,
}

/// What became of every scene.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct BatchOutcome {
    /// In the manifest's order.
    pub scenes: Vec<BatchScene>,
    /// How many have failed.
    pub failed: usize,
}

/// What became of one scene.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct BatchScene {
    /// The scene's name, or its place in the manifest where it has none.
    pub name: String,
    /// Its folders, one per image size.
    pub folders: Vec<PathBuf>,
    /// Views that are finished now, of all sizes.
    pub views: usize,
    /// `ok`, or why it failed.
    pub status: String,
}

/// The options in a manifest that are paths, seen from its folder.
const PATHS: [&str; 4] = ["mesh", "cameras", "photos", "out"];

/// Generates all scenes of a manifest, one after another:
///
/// ```toml
/// [defaults]
/// out = "dataset"
/// sizes = ["2048x1536", "768x576"]
/// [[scene]]
/// name = "garden"
/// mesh = ["garden/mesh"]
/// cameras = "garden/sparse/0"
/// photos = "garden/images"
/// ```
///
/// A scene's options win over `defaults`, `flags` over both. Paths are seen from the manifest's
/// folder. A scene that fails is reported and the next one is made.
///
/// # Errors
/// A manifest that cannot be read, has other keys or no scene, and interruption.
pub fn run(
    manifest: &Path,
    flags: &Table,
    part: Part,
    context: &Context<'_>,
) -> Result<BatchOutcome> {
    let jobs = jobs_of(manifest, flags)?;
    let mut taken = BTreeSet::new();
    let mut scenes = Vec::new();
    for (name, job) in jobs {
        context.progress.check()?;
        let (name, made) = match job {
            Ok(job) => {
                let name = generate::name_of(&job);
                (name, make(&job, &mut taken, part, context))
            }
            Err(error) => (name, Err(error)),
        };
        scenes.push(match made {
            Err(Error::Interrupted) => return Err(Error::Interrupted),
            made => reported(name, made),
        });
    }
    let failed = scenes.iter().filter(|scene| scene.status != "ok").count();
    Ok(BatchOutcome { scenes, failed })
}

fn make(
    job: &GenerateJob,
    taken: &mut BTreeSet<PathBuf>,
    part: Part,
    context: &Context<'_>,
) -> Result<generate::GenerateOutcome> {
    let name = generate::name_of(job);
    let id = generate::id_of(job, &name)?;
    if !taken.insert(job.out.join(&id)) {
        let problem = "expected scenes with distinct names, found this one twice: give `name`";
        return Err(Error::invalid(format!("scene {id}"), problem));
    }
    let warnings = Warnings::default();
    let alone = Context {
        warnings: &warnings,
        ..*context
    };
    let made = generate::run(job, part, &alone);
    for warning in warnings.sorted() {
        let message = format!("{name}: {}", warning.message);
        context.warnings.add(&warning.code, message);
    }
    made
}

fn reported(name: String, made: Result<generate::GenerateOutcome>) -> BatchScene {
    match made {
        Ok(made) => BatchScene {
            name,
            views: made.sets.iter().map(|set| set.views).sum(),
            folders: made.sets.into_iter().map(|set| set.folder).collect(),
            status: "ok".to_owned(),
        },
        Err(error) => BatchScene {
            name,
            folders: Vec::new(),
            views: 0,
            status: format!("failed: {error}"),
        },
    }
}

/// The job of each scene, or what is wrong with its options; with the scene's name, or its place where
/// it gives none.
fn jobs_of(path: &Path, flags: &Table) -> Result<Vec<(String, Result<GenerateJob>)>> {
    let text = files::read_text(path)?;
    let manifest: Manifest = toml::from_str(&text)
        .map_err(|error| Error::toml(path.display().to_string(), &text, &error))?;
    if manifest.scene.is_empty() {
        let problem = "expected at least one [[scene]], found none";
        return Err(Error::invalid(path.display().to_string(), problem));
    }
    let folder = path.parent().unwrap_or(Path::new(""));
    let defaults = seen_from(folder, manifest.defaults);
    let job = |(place, scene): (usize, Table)| {
        let name = scene.get("name").and_then(Value::as_str);
        let name = name.map_or_else(|| format!("scene {}", place + 1), str::to_owned);
        let layers = [defaults.clone(), seen_from(folder, scene), flags.clone()];
        (name, config::resolve(layers))
    };
    Ok(manifest.scene.into_iter().enumerate().map(job).collect())
}

/// The layer with its paths seen from `folder`.
fn seen_from(folder: &Path, mut layer: Table) -> Table {
    let seen = |value: &mut Value| {
        if let Value::String(path) = value {
            *path = folder.join(&path).to_string_lossy().into_owned();
        }
    };
    for key in PATHS {
        match layer.get_mut(key) {
            Some(Value::Array(paths)) => paths.iter_mut().for_each(seen),
            Some(path) => seen(path),
            None => {}
        }
    }
    layer
}
