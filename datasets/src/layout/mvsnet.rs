//! MVSNet's folder of cameras: `00000000_cam.txt` … and `pair.txt`.

use crate::error::Result;
use crate::scene::{Scene, View};
use std::path::Path;

/// Where a foreign file puts the centre of the top-left pixel.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum PixelCentre {
    /// At (0.5, 0.5), as this crate does.
    #[default]
    Half,
    /// At (0, 0).
    Integer,
}

/// How to read a folder of cams.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct CamsOptions {
    /// The files' convention.
    pub pixel_centre: PixelCentre,
    /// The image size (width, height) the intrinsics are for. Without it twice the principal point,
    /// rounded, is taken: `cam.txt` has no size.
    pub size: Option<(u32, u32)>,
}

/// Reads every `<id>_cam.txt` in `folder` (or in `folder/cams`) and `pair.txt` where present.
pub fn read_scene(_folder: &Path, _options: &CamsOptions) -> Result<Scene> {
    todo!()
}

/// Writes `view` as a `cam.txt` at `path`, in the given convention. The view needs a depth range.
pub fn write_view(_path: &Path, _view: &View, _pixel_centre: PixelCentre) -> Result<()> {
    todo!()
}

/// Writes the scene's source views as a `pair.txt` at `path`.
pub fn write_pairs(_path: &Path, _scene: &Scene) -> Result<()> {
    todo!()
}

/// A file's eight-digit name for view `id`, e.g. `00000012_cam.txt` for the suffix `_cam.txt`.
pub fn file_name(id: u32, suffix: &str) -> String {
    format!("{id:08}{suffix}")
}
