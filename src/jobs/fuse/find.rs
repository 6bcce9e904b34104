//! Which files views have.

use crate::error::{Error, Result};
use crate::jobs::Context;
use mvs_datasets::layout::mvsnet;
use mvs_datasets::scene::Camera;
use std::path::{Path, PathBuf};

/// Folders in which images of a scene are looked for, relative to it.
pub(super) const IMAGE_FOLDERS: [&str; 3] = ["blended_images", "images", "color"];

/// What images of views end in, those of the data sets first.
const SUFFIXES: [&str; 6] = [".jpg", ".png", ".jpeg", ".JPG", ".PNG", ".JPEG"];

/// Checks that there are depth maps, and warns of views without one; `example` is one's path.
pub(super) fn check_present(
    (present, all): (usize, usize),
    example: &Path,
    context: &Context<'_>,
) -> Result<()> {
    if present == 0 {
        let folder = example.parent().unwrap_or(example);
        let name = example.file_name().unwrap_or_default().to_string_lossy();
        let problem = format!("expected depth maps named like {name}, found none");
        return Err(Error::invalid(folder.display().to_string(), problem));
    }
    if present < all {
        let message = format!("{} views have no depth map", all - present);
        context.warnings.add("missing-depth", message);
    }
    Ok(())
}

/// The camera scaled to the size of the depth map in the file `depth`.
pub(super) fn camera_for(camera: &Camera, size: (u32, u32), depth: &Path) -> Result<Camera> {
    let resized = camera.resized(size.0, size.1);
    resized.map_err(|error| Error::invalid(depth.display().to_string(), error.to_string()))
}

pub(super) fn find_mask(folder: &Path, id: u32) -> Result<PathBuf> {
    let names = [".png", ".jpg"].map(|suffix| folder.join(mvsnet::file_name(id, suffix)));
    names.into_iter().find(|path| path.exists()).ok_or_else(|| {
        let problem = format!(
            "expected a mask {}, found none",
            mvsnet::file_name(id, ".png")
        );
        Error::invalid(folder.display().to_string(), problem)
    })
}

/// The image of view `id`, if the scene has one.
pub(in crate::jobs) fn find_image(scene: &Path, id: u32) -> Option<PathBuf> {
    let names = SUFFIXES.map(|suffix| mvsnet::file_name(id, suffix));
    let folders = IMAGE_FOLDERS.iter().map(|folder| scene.join(folder));
    folders
        .flat_map(|folder| names.clone().map(|name| folder.join(name)))
        .find(|path| path.exists())
}
