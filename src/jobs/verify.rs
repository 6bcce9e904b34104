//! `mvs-eval verify`: whether a scene of the BlendedMVS kind is sound.

use super::{Context, OutDir, name_of};
use crate::error::Result;
use crate::generate::verify::{self, Finding, Severity, Verification, VerifyOptions};
use mvs_datasets::layout::blended::{self, BlendedFolder};
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// Options of `mvs-eval verify`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct VerifyJob {
    /// A scene folder, or a data set's root, or a folder of such roots (as `generate` makes for several sizes), whose
    /// scenes are all verified.
    pub scene: PathBuf,
    /// The folder for `verify.json`; without it only the answer is given.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub out: Option<PathBuf>,
    /// How to verify.
    pub verify: VerifyOptions,
}

/// What was found in each scene.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct VerifyOutcome {
    /// (scene's name or path seen from the given folder, what was found), by name.
    pub scenes: Vec<(String, Verification)>,
}

impl VerifyOutcome {
    /// Whether any scene has a fault.
    pub fn failed(&self) -> bool {
        self.scenes
            .iter()
            .any(|(_, verification)| verification.failed())
    }
}

/// Verifies the scene or scenes.
///
/// # Errors
/// No folder of a scene, or one that cannot be listed, an output folder as [`OutDir::create`] refuses it, a
/// `verify.json` that cannot be written; else as [`verify::verify`].
pub fn run(job: &VerifyJob, context: &Context<'_>) -> Result<VerifyOutcome> {
    super::require("verify", &[("SCENE", &[&job.scene], "a scene folder")])?;
    job.verify.check()?;
    let (folders, missing) = scenes_at(&job.scene)?;
    let out = match &job.out {
        None => None,
        Some(out) => {
            let run = context.run("verify", job, &OutDir::inputs(out, &[&job.scene])?)?;
            Some(OutDir::create(out, run, context.force)?)
        }
    };
    let missing = missing.into_iter().map(|name| (name, missing_scene()));
    let mut scenes: Vec<(String, Verification)> = missing.collect();
    for folder in folders {
        let name = match folder.strip_prefix(&job.scene) {
            Ok(inside) if inside != Path::new("") => inside.to_string_lossy().replace('\\', "/"),
            _ => name_of(&folder),
        };
        let scene = BlendedFolder::new(folder);
        let verification = verify::verify(&scene, &job.verify, context.progress)?;
        scenes.push((name, verification));
    }
    scenes.sort_by(|a, b| a.0.cmp(&b.0));
    let outcome = VerifyOutcome { scenes };
    if let Some(out) = out {
        out.write_json("verify.json", &outcome)?;
        out.finish()?;
    }
    Ok(outcome)
}

/// The scenes at `path` by folder, and names that list files have and that are no folder: the folder
/// itself, or those of the root that it is, or those of the roots in it that have list files.
fn scenes_at(path: &Path) -> Result<(Vec<PathBuf>, Vec<String>)> {
    if !path.is_dir() {
        let problem = "expected a scene folder or the root of a data set, found none";
        return Err(mvs_datasets::Error::layout(path, problem).into());
    }
    let own = (vec![path.to_path_buf()], Vec::new());
    if path.join("cams").is_dir() {
        return Ok(own);
    }
    let (mut folders, mut missing) = scenes_of(path)?;
    if !folders.is_empty() || !missing.is_empty() {
        return Ok((folders, missing));
    }
    if ["blended_images", "rendered_depth_maps"]
        .iter()
        .any(|name| path.join(name).is_dir())
    {
        return Ok(own);
    }
    let inside = blended::names_in(path)?.into_iter();
    for name in inside.filter(|name| path.join(name).is_dir()) {
        let root = path.join(&name);
        if !blended::listed_in(&root)?.is_empty() {
            let (there, gone) = scenes_of(&root)?;
            folders.extend(there);
            missing.extend(gone.into_iter().map(|scene| format!("{name}/{scene}")));
        }
    }
    if folders.is_empty() && missing.is_empty() {
        let problem = "expected a scene folder (cams/, blended_images/, rendered_depth_maps/) or the root of a data \
                       set, found neither";
        return Err(mvs_datasets::Error::layout(path, problem).into());
    }
    Ok((folders, missing))
}

/// The scenes of a data set's root by folder, and names that are no folder: every one that is listed, looks like a
/// scene or is called like one.
fn scenes_of(path: &Path) -> Result<(Vec<PathBuf>, Vec<String>)> {
    let listed = blended::listed_in(path)?;
    let mut names: BTreeSet<String> = blended::names_in(path)?.into_iter().collect();
    names.retain(|name| blended::is_scene_id(name) || path.join(name).join("cams").is_dir());
    names.extend(listed);
    let (there, missing): (Vec<String>, Vec<String>) =
        (names.into_iter()).partition(|name| path.join(name).is_dir());
    let folders = there.into_iter().map(|name| path.join(name));
    Ok((folders.collect(), missing))
}

/// What is said of a scene that is listed and not there.
fn missing_scene() -> Verification {
    let finding = Finding {
        severity: Severity::Fault,
        code: "missing-scene".to_owned(),
        place: "list files".to_owned(),
        message: "expected a folder for each scene that the list files name, found none".to_owned(),
    };
    Verification {
        views: 0,
        findings: vec![finding],
        pairs: Vec::new(),
        median_difference: None,
        median_color_difference: None,
    }
}
