//! Names of photographs: what files a view's name may mean.

use crate::error::Result;
use std::ffi::OsStr;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

/// Endings of photographs.
const ENDINGS: [&str; 9] = [
    "jpg", "jpeg", "JPG", "JPEG", "png", "PNG", "Jpg", "Jpeg", "Png",
];

/// Those of images that are not read, for which one of the others may lie there.
const OTHER_ENDINGS: [&str; 6] = ["tif", "tiff", "bmp", "webp", "heic", "exr"];

/// The photograph of that name; else one of it with another ending, and, where folders are not `nested`, the same
/// without the name's folder.
pub(crate) fn find_named(folder: &Path, name: &str, nested: bool) -> Result<Option<PathBuf>> {
    let slashed = slashed(name);
    let below = below(folder, name);
    let names = [name, &slashed, &below];
    for name in names.into_iter().filter(|name| !name.is_empty()) {
        let named = folder.join(name);
        if is_file(&named)? {
            return Ok(Some(named));
        }
    }
    let stems = stems_of(Path::new(&slashed));
    let inside = [&slashed, &below].into_iter().flat_map(|name| {
        let inner = Path::new(folder_of(name));
        stems.iter().map(|stem| inner.join(stem))
    });
    let beside = stems.iter().map(PathBuf::from).filter(|_| !nested);
    for stem in inside.chain(beside) {
        if let Some(path) = with_ending(folder, &stem.display().to_string())? {
            return Ok(Some(path));
        }
    }
    Ok(None)
}

/// The photograph of that name and one of the endings.
pub(super) fn with_ending(folder: &Path, stem: &str) -> Result<Option<PathBuf>> {
    for end in ENDINGS {
        let path = folder.join(format!("{stem}.{end}"));
        if is_file(&path)? {
            return Ok(Some(path));
        }
    }
    Ok(None)
}

/// A file of that name and an ending of images that are not read.
pub(super) fn of_other_format(folder: &Path, name: &str) -> Result<Option<PathBuf>> {
    let below = below(folder, name);
    let base = below.rsplit('/').next().unwrap_or_default();
    for name in [below.as_str(), base]
        .into_iter()
        .filter(|name| !name.is_empty())
    {
        for end in OTHER_ENDINGS {
            let path = folder.join(name).with_extension(end);
            if is_file(&path)? {
                return Ok(Some(path));
            }
        }
    }
    Ok(None)
}

/// What endings may follow in a name: all before its own one; first all of it, where what follows its last
/// point is no image's ending.
fn stems_of(name: &Path) -> Vec<String> {
    let text = |part: &OsStr| part.to_string_lossy().into_owned();
    let ending = name.extension().unwrap_or_default();
    let is_images =
        (ENDINGS.iter().chain(&OTHER_ENDINGS)).any(|end| ending.eq_ignore_ascii_case(end));
    let whole = name.file_name().filter(|_| !is_images).map(text);
    let stem = name.file_stem().map(text);
    let stem = stem.filter(|stem| Some(stem) != whole.as_ref());
    whole.into_iter().chain(stem).collect()
}

/// A photograph of the same name whose ending is another one in whatever letters.
pub(super) fn of_another_ending(path: &Path) -> Result<Option<PathBuf>> {
    let own = path.extension().unwrap_or_default();
    for end in ENDINGS.iter().filter(|end| !own.eq_ignore_ascii_case(end)) {
        let other = path.with_extension(end);
        if is_file(&other)? {
            return Ok(Some(other));
        }
    }
    Ok(None)
}

/// `a` of `a/b.jpg` or `a\b.jpg`, else nothing.
pub(super) fn folder_of(name: &str) -> &str {
    let split = name.rsplit_once(['/', '\\']);
    split.map_or("", |(folder, _)| folder)
}

/// Some programs on Windows write `\` between folders.
fn slashed(name: &str) -> String {
    name.replace('\\', "/")
}

/// What stands in a name behind the folder's own, as `transforms.json` has names from the folder above; else all.
pub(super) fn below(folder: &Path, name: &str) -> String {
    let name = slashed(name);
    let folder = std::path::absolute(folder).unwrap_or_else(|_| folder.to_path_buf());
    let own = folder.file_name().unwrap_or_default().to_string_lossy();
    let mut parts = name.split('/');
    let is_there = parts.by_ref().any(|part| part == own);
    let rest: Vec<&str> = parts.collect();
    match is_there && !rest.is_empty() {
        true => rest.join("/"),
        false => name,
    }
}

fn is_file(path: &Path) -> Result<bool> {
    is(path, std::fs::Metadata::is_file)
}

/// Whether there is something of that kind; an error where that cannot be found out.
pub(super) fn is(path: &Path, kind: fn(&std::fs::Metadata) -> bool) -> Result<bool> {
    match std::fs::metadata(path) {
        Ok(found) => Ok(kind(&found)),
        Err(error) if matches!(error.kind(), ErrorKind::NotFound | ErrorKind::NotADirectory) => {
            Ok(false)
        }
        Err(error) => Err(mvs_datasets::Error::io(path, "look at")(error).into()),
    }
}
