//! Single files: reading with the path in every error, writing to a temporary name.

use crate::error::Result;
use crate::scene::{ColorImage, CropVolume, DepthMap, PointCloud, RejectedDepths, Similarity};
use std::io::{BufWriter, Write};
use std::path::Path;

/// Writes `path` by way of a temporary file in the same folder, which is renamed when `write` has
/// succeeded: readers see the old file or the whole new one. Missing parent folders are made.
pub fn write_atomically(
    _path: &Path,
    _write: impl FnOnce(&mut BufWriter<std::fs::File>) -> std::io::Result<()>,
) -> Result<()> {
    let _ = std::io::sink().flush();
    todo!()
}

/// Reads a text file as UTF-8; a byte-order mark is skipped.
pub fn read_text(_path: &Path) -> Result<String> {
    todo!()
}

/// Reads a cloud from a PLY. An empty cloud is an error that says so.
pub fn read_cloud(_path: &Path) -> Result<PointCloud> {
    todo!()
}

/// Reads a JPEG or PNG.
pub fn read_image(_path: &Path) -> Result<ColorImage> {
    todo!()
}

/// Reads a PFM depth map.
pub fn read_depth(_path: &Path) -> Result<(DepthMap, RejectedDepths)> {
    todo!()
}

/// Reads a 4×4 similarity transform.
pub fn read_similarity(_path: &Path) -> Result<Similarity> {
    todo!()
}

/// Reads a polygon crop volume.
pub fn read_crop(_path: &Path) -> Result<CropVolume> {
    todo!()
}
