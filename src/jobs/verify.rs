//! `mvs-eval verify`: whether a scene of the BlendedMVS kind is sound.

use super::{Context, OutDir};
use crate::error::Result;
use crate::generate::verify::{self, Verification, VerifyOptions};
use crate::provenance::Run;
use mvs_datasets::layout::blended::{self, BlendedFolder};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// Options of `mvs-eval verify`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct VerifyJob {
    /// A scene folder, or a data set's root, whose scenes are all verified.
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
    /// (scene folder's name, what was found).
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
pub fn run(job: &VerifyJob, context: &Context<'_>) -> Result<VerifyOutcome> {
    let folders = scene_folders(&job.scene)?;
    let out = match &job.out {
        None => None,
        Some(out) => {
            let run = Run::new("verify", job, &[&job.scene])?;
            Some(OutDir::create(out, run, context.force)?)
        }
    };
    let mut scenes = Vec::new();
    for folder in folders {
        let name = folder
            .file_name()
            .unwrap_or_default()
            .to_string_lossy()
            .into_owned();
        let scene = BlendedFolder::new(folder);
        let verification = verify::verify(&scene, &job.verify, context.progress)?;
        scenes.push((name, verification));
    }
    let outcome = VerifyOutcome { scenes };
    if let Some(out) = out {
        out.write_json("verify.json", &outcome)?;
        out.finish()?;
    }
    Ok(outcome)
}

/// The folder itself, or the scenes in it when it is a data set's root.
fn scene_folders(path: &Path) -> Result<Vec<PathBuf>> {
    if !path.is_dir() {
        let problem = "expected a scene folder or the root of a data set, found none";
        return Err(mvs_datasets::Error::layout(path, problem).into());
    }
    let inside = blended::scenes_in(path)?;
    if inside.is_empty() || path.join("cams").is_dir() {
        return Ok(vec![path.to_path_buf()]);
    }
    Ok(inside.into_iter().map(|name| path.join(name)).collect())
}
