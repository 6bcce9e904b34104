//! What earlier runs left in a scene's folders.

use super::Extra;
use super::view::record_path;
use crate::error::Result;
use mvs_datasets::layout::blended::record::ViewRecord;
use mvs_datasets::layout::blended::{self, BlendedFolder};
use mvs_datasets::layout::files;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// Removes what earlier or interrupted runs left in the scene's folders and this one would not have
/// written: files named exactly as a view's are there, and temporary files. Anything else is left alone.
pub(super) fn remove_leftovers(folder: &BlendedFolder, records: &[ViewRecord]) -> Result<()> {
    let mut kept: BTreeSet<PathBuf> = records
        .iter()
        .flat_map(|record| record.files.keys())
        .map(|name| folder.path().join(name))
        .collect();
    kept.extend(records.iter().map(|record| record_path(folder, record.id)));
    for (name, endings) in FOLDERS {
        let inside = folder.path().join(name);
        if !inside.is_dir() {
            continue;
        }
        for file in blended::names_in(&inside)? {
            let path = inside.join(&file);
            let ours = file.starts_with(files::TEMPORARY) || is_of_a_view(&file, endings);
            if ours && path.is_file() && !kept.contains(&path) {
                remove(&path)?;
            }
        }
        if !name.is_empty() {
            // Only if nothing is left in it.
            let _ = std::fs::remove_dir(&inside);
        }
    }
    Ok(())
}

/// Removes a file unless it is gone already.
pub(super) fn remove_if_there(path: &Path) -> Result<()> {
    match path.exists() {
        true => remove(path),
        false => Ok(()),
    }
}

fn remove(path: &Path) -> Result<()> {
    Ok(std::fs::remove_file(path).map_err(mvs_datasets::Error::io(path, "remove"))?)
}

/// Removes what earlier runs wrote for the scene as a whole and `extras` no longer name.
pub(super) fn remove_unasked(folder: &BlendedFolder, extras: &BTreeSet<Extra>) -> Result<()> {
    let model = ["cameras.txt", "images.txt", "points3D.txt"];
    let files = [
        (Extra::Covisibility, vec![folder.covisibility()]),
        (Extra::Transforms, vec![folder.transforms()]),
        (
            Extra::Colmap,
            model.map(|name| folder.colmap().join(name)).to_vec(),
        ),
    ];
    let unasked = files
        .into_iter()
        .filter(|(extra, _)| !extras.contains(extra));
    for path in unasked.flat_map(|(_, paths)| paths) {
        remove_if_there(&path)?;
    }
    Ok(())
}

/// The scene's folder and those in it that hold files of views, with what comes after the views' ids
/// in their names.
const FOLDERS: [(&str, &[&str]); 14] = [
    ("", &[]),
    ("blended_images", &[".jpg", "_masked.jpg"]),
    ("cams", &["_cam.txt"]),
    ("rendered_depth_maps", &[".pfm"]),
    ("input_images", &[".jpg"]),
    ("rendered_images", &[".png"]),
    ("masks", &[".png"]),
    ("normals", &[".pfm"]),
    ("interpolated_normals", &[".pfm"]),
    ("sight", &[".png"]),
    ("occlusion", &["_00000000.png"]), // a second id
    ("depth_edges", &[".png"]),
    ("views", &[".json"]),
    ("sparse/0", &[]),
];

/// The folders and files that some set has, in its folder.
pub(crate) fn written() -> impl Iterator<Item = &'static str> {
    let folders = FOLDERS.iter().map(|(name, _)| *name);
    let files = ["scene.json", "transforms.json", "covisibility.npy"];
    folders.filter(|name| !name.is_empty()).chain(files)
}

/// Whether a file's name is a view's id and one of the endings, in which eight zeros are an id too.
fn is_of_a_view(file: &str, endings: &[&str]) -> bool {
    let after_id = |name: &str| {
        let digits = name.bytes().take_while(u8::is_ascii_digit).count();
        let id: u32 = name[..digits].parse().ok()?;
        (format!("{id:08}") == name[..digits]).then(|| name[digits..].to_owned())
    };
    let Some(rest) = after_id(file) else {
        return false;
    };
    endings
        .iter()
        .any(|ending| match ending.split_once("00000000") {
            None => rest == *ending,
            Some((between, end)) => rest
                .strip_prefix(between)
                .and_then(after_id)
                .is_some_and(|rest| rest == end),
        })
}
