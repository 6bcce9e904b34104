//! What a job of fusion must not ask for, and what it reads.

use super::FuseJob;
use super::find::IMAGE_FOLDERS;
use crate::error::{Error, Result};
use crate::fuse::FuseMode;
use mvs_datasets::layout::cameras::source_files;
use mvs_datasets::layout::mvsnet;
use mvs_datasets::layout::sparse;
use mvs_datasets::layout::workspace::{StereoPass, Workspace};
use std::path::PathBuf;

impl FuseJob {
    pub(super) fn check(&self) -> Result<()> {
        self.fuse.check()?;
        if self.scene.as_os_str().is_empty() {
            return Err(Error::invalid(
                "fuse",
                "expected a scene folder, found none",
            ));
        }
        let is_workspace = self.is_workspace();
        if self.stereo != StereoPass::default() && !is_workspace {
            let problem = "expected a COLMAP dense workspace without --depths, whose maps it picks, found \
                           none: leave it out";
            return Err(Error::invalid("--stereo", problem));
        }
        if self.camera_size.is_some() && is_workspace {
            let problem = "expected none for a COLMAP dense workspace, whose model says its cameras' sizes: \
                           leave it out";
            return Err(Error::invalid("--camera-size", problem));
        }
        if self.fuse.confidence_quantile != 0.0 && self.confidence.is_empty() {
            let problem = "needs --confidence, whose maps it is a quantile of";
            return Err(Error::invalid("--confidence-quantile", problem));
        }
        let merges = self.fuse.mode == FuseMode::Cluster || self.voxel != 0.0;
        if self.filtered_depths.is_some() && merges {
            let problem = "expected a mode whose points belong to pixels, found merged points: leave \
                           out cluster and voxels";
            return Err(Error::invalid("filtered depth maps", problem));
        }
        let real = |path: &PathBuf| path.canonicalize().unwrap_or_else(|_| path.clone());
        let mut read = [&self.depths].into_iter().chain(&self.confidence);
        if let Some(folder) = &self.filtered_depths
            && read.any(|input| real(input) == real(folder))
        {
            let problem =
                "expected a folder for the filtered depth maps that is not read, found an input";
            return Err(Error::invalid(folder.display().to_string(), problem));
        }
        Ok(())
    }

    fn is_workspace(&self) -> bool {
        self.depths.as_os_str().is_empty() && Workspace::at(&self.scene).is_some()
    }

    /// Everything that is read: not the scene's whole folder, in which results may lie.
    pub(super) fn inputs(&self) -> Result<Vec<PathBuf>> {
        let parts = [
            "cams",
            "sparse",
            "stereo",
            "blended_images",
            "images",
            "color",
        ];
        let parts = parts.map(|part| self.scene.join(part));
        let mut read: Vec<PathBuf> = parts.into_iter().filter(|part| part.is_dir()).collect();
        let beside = mvsnet::above(&self.scene)
            .into_iter()
            .flat_map(|scene| IMAGE_FOLDERS.map(|part| scene.join(part)));
        let beside: Vec<PathBuf> = beside.filter(|part| part.is_dir()).collect();
        if self.is_workspace() {
            let model = sparse::model_files(&self.scene)?.into_iter();
            let beside = model.filter(|file| !read.iter().any(|part| file.starts_with(part)));
            read.extend(beside.collect::<Vec<PathBuf>>());
        } else if read.is_empty() {
            read.push(self.scene.clone());
        } else if !["cams", "sparse"]
            .iter()
            .any(|part| self.scene.join(part).is_dir())
            && let Some((_, files)) = source_files(&self.scene)?
        {
            // Cams that lie beside the folders.
            read.extend(files);
        }
        read.extend(beside);
        let pairs = mvsnet::pairs_file(&self.scene)?;
        read.extend(pairs.filter(|pairs| !read.iter().any(|part| pairs.starts_with(part))));
        read.extend(Some(self.depths.clone()).filter(|path| !path.as_os_str().is_empty()));
        read.extend(self.confidence.iter().cloned());
        read.extend([&self.masks, &self.crop].into_iter().flatten().cloned());
        Ok(read)
    }
}

/// Refuses those of the options `given` that would change nothing.
///
/// # Errors
/// Names the first, and why it counts for nothing.
pub fn check_used(job: &FuseJob, given: &[&str]) -> Result<()> {
    let mode = job.fuse.mode;
    let unused = given.iter().find(|option| !mode.asks_for(option));
    let problem = if unused.is_some() {
        format!("the mode {mode:?} does not ask for it: leave it out").to_lowercase()
    } else if given.contains(&"min_confidence") && job.confidence.is_empty() {
        "needs --confidence, whose maps it is a threshold for".to_owned()
    } else if given.contains(&"min_confidence") && job.fuse.confidence_quantile != 0.0 {
        "expected it or --confidence-quantile, which takes its place, found both".to_owned()
    } else {
        return Ok(());
    };
    let option = unused.unwrap_or(&"min_confidence").replace('_', "-");
    Err(Error::invalid(format!("--{option}"), problem))
}
