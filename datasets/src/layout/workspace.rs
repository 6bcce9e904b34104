//! COLMAP's dense workspace.
//!
//! ```text
//! images/<name>                                undistorted images
//! sparse/{cameras,images,points3D}.bin         their model (or .txt)
//! stereo/depth_maps/<name>.geometric.bin       and .photometric.bin
//! stereo/normal_maps/<name>.geometric.bin
//! stereo/fusion.cfg                            the images to fuse, one a line
//! ```

use super::files;
use crate::error::{Error, Result};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// Which of the two passes of COLMAP's stereo.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum StereoPass {
    /// The second, filtered by geometric consistency.
    #[default]
    Geometric,
    /// The first.
    Photometric,
}

impl StereoPass {
    fn name(self) -> &'static str {
        match self {
            Self::Geometric => "geometric",
            Self::Photometric => "photometric",
        }
    }
}

/// The paths of one workspace.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Workspace {
    path: PathBuf,
}

impl Workspace {
    /// The workspace at `path`, if it is one: it has `stereo/depth_maps/`.
    pub fn at(path: &Path) -> Option<Self> {
        let path = path.to_path_buf();
        path.join("stereo/depth_maps")
            .is_dir()
            .then_some(Self { path })
    }

    /// The workspace itself.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The depth map of the image called `name`.
    pub fn depth(&self, name: &str, pass: StereoPass) -> PathBuf {
        self.stereo("depth_maps", name, pass)
    }

    /// Its normal map, camera frame.
    pub fn normals(&self, name: &str, pass: StereoPass) -> PathBuf {
        self.stereo("normal_maps", name, pass)
    }

    fn stereo(&self, folder: &str, name: &str, pass: StereoPass) -> PathBuf {
        let file = format!("{name}.{}.bin", pass.name());
        self.path.join("stereo").join(folder).join(file)
    }

    /// The image called `name`.
    pub fn image(&self, name: &str) -> PathBuf {
        self.path.join("images").join(name)
    }

    /// The names that `fusion.cfg` lists; `None` where there is no such file.
    ///
    /// # Errors
    /// A file that is there and that [`files::read_text`] refuses, and one without names.
    pub fn listed(&self) -> Result<Option<Vec<String>>> {
        let path = self.path.join("stereo/fusion.cfg");
        if !path.is_file() {
            return Ok(None);
        }
        let text = files::read_text(&path)?;
        let lines = text.lines().map(str::trim);
        let names: Vec<String> = lines
            .filter(|line| !line.is_empty() && !line.starts_with('#'))
            .map(str::to_owned)
            .collect();
        if names.is_empty() {
            let problem = "expected names of images to fuse, one a line, found none";
            return Err(Error::layout(path, problem));
        }
        Ok(Some(names))
    }
}
