//! A Tanks and Temples scene folder.

use crate::error::Result;
use crate::format::log::{LogPose, Mapping};
use crate::scene::{CropVolume, PointCloud, Similarity};
use std::path::{Path, PathBuf};

/// The files of `D/<Scene>/`, found but not read.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TntFolder {
    /// The scene's name, the prefix of its files.
    pub name: String,
    /// `<Scene>.ply`, the laser scan.
    pub truth: PathBuf,
    /// `<Scene>.json`, the crop volume.
    pub crop: PathBuf,
    /// `<Scene>_COLMAP_SfM.log`, the reference trajectory.
    pub trajectory: PathBuf,
    /// `<Scene>_trans.txt`, reference trajectory frame to scan frame.
    pub transform: PathBuf,
    /// `<Scene>_mapping_reference.txt`, if there.
    pub mapping: Option<PathBuf>,
}

impl TntFolder {
    /// Finds the scene's files in `folder`. The name is the folder's unless given; what is missing
    /// is said at once.
    pub fn open(_folder: &Path, _name: Option<&str>) -> Result<Self> {
        todo!()
    }

    /// Reads the scan.
    pub fn read_truth(&self) -> Result<PointCloud> {
        todo!()
    }

    /// Reads the crop volume.
    pub fn read_crop(&self) -> Result<CropVolume> {
        todo!()
    }

    /// Reads the reference trajectory.
    pub fn read_trajectory(&self) -> Result<Vec<LogPose>> {
        todo!()
    }

    /// Reads the transform from the reference trajectory's frame to the scan's.
    pub fn read_transform(&self) -> Result<Similarity> {
        todo!()
    }

    /// Reads the mapping file, if there is one.
    pub fn read_mapping(&self) -> Result<Option<Mapping>> {
        todo!()
    }
}

/// τ of the seven training scenes in metres; `None` for other names.
pub fn known_tolerance(_scene: &str) -> Option<f64> {
    todo!()
}
