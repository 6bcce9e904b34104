//! Where photographs come from.

use crate::error::{Error, Result};
use crate::provenance;
use crate::render::Rendering;
use mvs_datasets::format::image;
use mvs_datasets::layout::files;
use mvs_datasets::scene::{ColorImage, View};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// The photographs of a scene's views, of any size.
pub trait Photographs: Sync {
    /// The photograph that belongs to `view`. `rendering` is what the photograph will be blended
    /// with; a synthetic scene lights it.
    fn photograph(&self, view: &View, rendering: &Rendering) -> Result<ColorImage>;

    /// What the photograph's content follows from: a hash of its file, say.
    fn digest(&self, view: &View) -> Result<String>;
}

/// Photographs in a folder, found by the view's name, else by its eight-digit id.
#[derive(Debug, Clone)]
pub struct PhotoFolder {
    paths: BTreeMap<u32, PathBuf>,
}

const ENDINGS: [&str; 6] = ["jpg", "jpeg", "JPG", "JPEG", "png", "PNG"];

impl PhotoFolder {
    /// Finds the photograph of each view; the ones that are missing are named at once.
    pub fn open(folder: &Path, views: &[View]) -> Result<Self> {
        if !folder.is_dir() {
            let problem = "expected a folder of photographs, found none";
            return Err(mvs_datasets::Error::layout(folder, problem).into());
        }
        let mut paths = BTreeMap::new();
        let mut missing = Vec::new();
        for view in views {
            match find(folder, view) {
                Some(path) => {
                    paths.insert(view.id, path);
                }
                None => missing.push(view),
            }
        }
        if let Some(first) = missing.first() {
            let problem = format!(
                "expected a photograph of each view, found none of {} of {} views; the first is {}",
                missing.len(),
                views.len(),
                expected_name(first)
            );
            return Err(mvs_datasets::Error::layout(folder, problem).into());
        }
        Ok(Self { paths })
    }

    /// The (width, height) in pixels that a view's photograph has.
    pub fn size(&self, view: &View) -> Result<(u32, u32)> {
        let path = self.path(view)?;
        let bytes = std::fs::read(path).map_err(mvs_datasets::Error::io(path, "read"))?;
        Ok(image::read_size(&bytes).map_err(mvs_datasets::Error::in_file(path))?)
    }

    /// The files, by view id.
    pub fn files(&self) -> impl Iterator<Item = &Path> {
        self.paths.values().map(PathBuf::as_path)
    }

    fn path(&self, view: &View) -> Result<&PathBuf> {
        let unknown = || Error::invalid(format!("view {}", view.id), "has no photograph");
        self.paths.get(&view.id).ok_or_else(unknown)
    }
}

fn find(folder: &Path, view: &View) -> Option<PathBuf> {
    let named = folder.join(&view.name);
    if !view.name.is_empty() && named.is_file() {
        return Some(named);
    }
    let stem = Path::new(&view.name).file_stem();
    let by_id = format!("{:08}", view.id);
    let stems = stem
        .into_iter()
        .map(|stem| stem.to_string_lossy().into_owned())
        .chain([by_id]);
    stems
        .flat_map(|stem| ENDINGS.map(|end| folder.join(format!("{stem}.{end}"))))
        .find(|path| path.is_file())
}

fn expected_name(view: &View) -> String {
    if view.name.is_empty() {
        format!("{:08}.jpg or .png", view.id)
    } else {
        format!("{} or {:08}.jpg or .png", view.name, view.id)
    }
}

impl Photographs for PhotoFolder {
    fn photograph(&self, view: &View, _rendering: &Rendering) -> Result<ColorImage> {
        Ok(files::read_image(self.path(view)?)?)
    }

    fn digest(&self, view: &View) -> Result<String> {
        provenance::hash_path(self.path(view)?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec2;
    use mvs_datasets::scene::{Camera, Pose};

    fn view(id: u32, name: &str) -> View {
        View {
            id,
            name: name.to_owned(),
            camera: Camera::new(4, 3, DVec2::ONE, DVec2::ONE).unwrap(),
            pose: Pose::IDENTITY,
            depth_range: None,
        }
    }

    fn touch(path: &Path) {
        files::write_atomically(path, |_| Ok(())).unwrap();
    }

    #[test]
    fn photographs_are_found_by_name_then_by_id_and_missing_ones_named() {
        let folder = tempfile::tempdir().unwrap();
        let views = [view(0, "a/left.jpg"), view(1, "right.tif"), view(12, "")];
        for name in ["a/left.jpg", "right.PNG", "00000012.jpeg"] {
            touch(&folder.path().join(name));
        }
        let photos = PhotoFolder::open(folder.path(), &views).unwrap();
        assert_eq!(photos.paths[&1], folder.path().join("right.PNG"));
        assert_eq!(photos.paths[&12], folder.path().join("00000012.jpeg"));
        let more = [views[0].clone(), view(3, "x.jpg"), view(4, "")];
        let error = PhotoFolder::open(folder.path(), &more)
            .unwrap_err()
            .to_string();
        assert!(
            error.contains("2 of 3 views") && error.contains("x.jpg"),
            "{error}"
        );
    }
}
