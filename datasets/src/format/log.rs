//! Tanks and Temples trajectories: `.log` files and video mapping files.

use crate::error::FormatError;
use glam::DMat4;
use std::io::Write;

/// One pose of a `.log`.
#[derive(Debug, Clone, PartialEq)]
pub struct LogPose {
    /// The three integers before the matrix.
    pub metadata: [i64; 3],
    /// Camera-to-world.
    pub world_from_cam: DMat4,
}

impl LogPose {
    /// Whether the toolbox's converter marked this image as not registered: an identity matrix with
    /// −1 as second integer.
    pub fn is_unregistered(&self) -> bool {
        todo!()
    }
}

/// A mapping file: which video frame each sampled image is.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Mapping {
    /// Number of frames of the video.
    pub video_frames: usize,
    /// (image id, video frame id), 1-based as in the file.
    pub frames: Vec<(usize, usize)>,
}

/// Reads a `.log`.
pub fn read(_text: &str) -> Result<Vec<LogPose>, FormatError> {
    todo!()
}

/// Writes a `.log`.
pub fn write(_out: &mut impl Write, _poses: &[LogPose]) -> std::io::Result<()> {
    todo!()
}

/// Reads a mapping file.
pub fn read_mapping(_text: &str) -> Result<Mapping, FormatError> {
    todo!()
}
