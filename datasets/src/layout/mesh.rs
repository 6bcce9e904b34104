//! Meshes with their materials and textures, from one or many files.

mod join;
mod paint;
mod part;
mod twins;

use super::materials::Library;
use crate::error::{Error, Result};
use crate::parallel;
use crate::scene::Mesh;
use join::Joined;
use part::Contents;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// A mesh, and what was odd about its files (a missing texture, say), one sentence each.
#[derive(Debug, Clone)]
pub struct LoadedMesh {
    /// All files as one mesh.
    pub mesh: Mesh,
    /// Sentences for the user.
    pub notes: Vec<String>,
    /// Every file that the result follows from: meshes, material libraries, textures, buffers; by
    /// path, each once.
    pub files: Vec<PathBuf>,
}

/// The memory that decoded textures may take unless said otherwise: 6 GiB.
pub const TEXTURE_BYTES: u64 = 6 << 30;

/// Bytes from which a file is read by all threads, and not beside others: what several files hold that
/// are not joined yet is bounded by this.
const LARGE: u64 = 32 << 20;

/// How meshes are read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ReadOptions {
    /// The most bytes that decoded textures may take; more are refused before any is decoded.
    pub texture_bytes: u64,
    /// Threads that read meshes and decode textures; the result does not depend on it.
    pub threads: usize,
}

impl Default for ReadOptions {
    fn default() -> Self {
        Self {
            texture_bytes: TEXTURE_BYTES,
            threads: std::thread::available_parallelism().map_or(1, usize::from),
        }
    }
}

/// [`read_meshes_with`] by default options.
///
/// # Errors
/// As [`read_meshes_with`].
pub fn read_meshes(paths: &[PathBuf]) -> Result<LoadedMesh> {
    read_meshes_with(paths, &ReadOptions::default())
}

/// Reads meshes (`.obj` with its materials, `.ply`, `.gltf`, `.glb`) and joins them into one. A
/// folder stands for all its meshes but hidden ones, and a last name with `*` or `?` for all that fit, in name order;
/// two of them that differ in their ending alone are refused, and several formats noted.
/// Textures are found beside the file that names them, and only those that faces use are read; one
/// that cannot be is noted, and its vertices' colours or its material's show instead. Where some vertices have colours,
/// the others have those of their materials, and stand there once for each. Faces that are there both ways round
/// are one with two sides, which is noted too; of a large mesh those at a sample of the vertices are looked at
/// first, and all if some are.
///
/// # Errors
/// No paths, a path that is no mesh and no folder or pattern of some, such files of one model in two formats, meshes
/// and material libraries that cannot be read, no faces in all of them, 2³² vertices or more, and textures that would
/// take more memory than the options allow.
pub fn read_meshes_with(paths: &[PathBuf], options: &ReadOptions) -> Result<LoadedMesh> {
    let mut joined = Joined::default();
    let mut library = Library::default();
    let files = mesh_files(paths)?;
    let several = of_several_formats(paths, &files);
    let mut left = files.as_slice();
    while !left.is_empty() {
        let (some, rest) = left.split_at(side_by_side(left, options.threads));
        let each = options.threads / some.len();
        let read = parallel::map(some, options.threads, |path| Contents::read(path, each));
        for (path, contents) in some.iter().zip(read) {
            let part = contents?.finish(path, &mut library)?;
            joined
                .add(part)
                .map_err(|problem| Error::layout(path, problem))?;
        }
        left = rest;
    }
    if joined.triangle_count() == 0 {
        let found = joined.vertex_count();
        let problem = format!("expected a mesh, found {found} vertices and no faces");
        return Err(Error::layout(
            paths.first().map_or(Path::new(""), PathBuf::as_path),
            problem,
        ));
    }
    let drafts = joined.take_drafts();
    let finished = library.finish(drafts, options)?;
    let (mesh, note) = twins::merged(joined.finish(finished.materials)?)?;
    let mut notes = finished.notes;
    notes.extend(note.into_iter().chain(several));
    Ok(LoadedMesh {
        mesh,
        notes,
        files: finished.files,
    })
}

/// How many of the next files are read at a time, each by a thread; a large one alone, by all.
fn side_by_side(files: &[PathBuf], threads: usize) -> usize {
    let is_small = |path: &&PathBuf| {
        let size = std::fs::metadata(path).map_or(0, |metadata| metadata.len());
        // What a `.gltf` holds lies in other files.
        size < LARGE && extension_of(path) != "gltf"
    };
    let small = files.iter().take(threads).take_while(is_small).count();
    small.max(1)
}

/// The ending in small letters.
fn extension_of(path: &Path) -> String {
    let extension = path.extension().unwrap_or_default();
    extension.to_string_lossy().to_ascii_lowercase()
}

/// Whether the file's name ends like a mesh's.
pub fn is_mesh(path: &Path) -> bool {
    matches!(extension_of(path).as_str(), "obj" | "ply" | "gltf" | "glb")
}

/// The files behind `paths`: folders and patterns are replaced by the meshes that they stand for.
fn mesh_files(paths: &[PathBuf]) -> Result<Vec<PathBuf>> {
    if paths.is_empty() {
        return Err(Error::layout("", "expected at least one mesh, found none"));
    }
    let mut files = Vec::new();
    for path in paths {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        if path.is_dir() {
            files.extend(meshes_in(path, "*")?);
        } else if name.contains(['*', '?']) && !path.exists() {
            let folder = path
                .parent()
                .filter(|parent| !parent.as_os_str().is_empty());
            files.extend(meshes_in(folder.unwrap_or(Path::new(".")), &name)?);
        } else if is_mesh(path) {
            files.push(path.clone());
        } else {
            let problem =
                "expected a mesh that ends in .obj, .ply, .gltf or .glb, or a folder of them";
            return Err(Error::layout(path, problem));
        }
    }
    Ok(files)
}

/// The meshes in a folder whose names fit the pattern.
fn meshes_in(folder: &Path, pattern: &str) -> Result<Vec<PathBuf>> {
    let mut files = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(Error::io(folder, "list"))? {
        let path = entry.map_err(Error::io(folder, "list"))?.path();
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        // `._name` is what macOS keeps beside a file in archives, no mesh.
        let hidden = name.starts_with('.') && !pattern.starts_with('.');
        if !hidden && is_mesh(&path) && fits(name.as_bytes(), pattern.as_bytes()) && path.is_file()
        {
            files.push(path);
        }
    }
    files.sort();
    if files.is_empty() {
        let which = match pattern {
            "*" => String::new(),
            pattern => format!(" that fit {pattern}"),
        };
        let problem =
            format!("expected .obj, .ply, .gltf or .glb files{which} in this folder, found none");
        return Err(Error::layout(folder, problem));
    }
    check_stems(folder, &files)?;
    Ok(files)
}

/// Refuses two files that are one model in two formats, as programs export them side by side.
fn check_stems(folder: &Path, files: &[PathBuf]) -> Result<()> {
    let mut stems = BTreeMap::new();
    for path in files {
        if let Some(other) = stems.insert(path.file_stem(), path)
            && extension_of(other) != extension_of(path)
        {
            let problem = format!(
                "expected each mesh once, found {} and {}, one model in two formats perhaps: name the one that is \
                 meant, or a pattern (*.obj)",
                other.display(),
                path.display()
            );
            return Err(Error::layout(folder, problem));
        }
    }
    Ok(())
}

/// A note where a folder or pattern stands for files of several formats.
fn of_several_formats(paths: &[PathBuf], files: &[PathBuf]) -> Option<String> {
    let first = files.first()?;
    let other = files
        .iter()
        .find(|path| extension_of(path) != extension_of(first))?;
    (files.len() > paths.len()).then(|| {
        format!(
            "{} files of several formats are joined into one mesh, {} and {} among them: if they are one model \
             twice, name the one that is meant",
            files.len(),
            first.display(),
            other.display()
        )
    })
}

/// Whether a name fits a pattern in which `*` stands for any letters and `?` for one.
fn fits(name: &[u8], pattern: &[u8]) -> bool {
    match (name, pattern) {
        ([], []) => true,
        (_, [b'*', rest @ ..]) => (0..=name.len()).any(|skip| fits(&name[skip..], rest)),
        ([_, name @ ..], [b'?', rest @ ..]) => fits(name, rest),
        ([letter, name @ ..], [wanted, rest @ ..]) => letter == wanted && fits(name, rest),
        _ => false,
    }
}

#[cfg(test)]
mod tests {
    use super::{LARGE, fits, side_by_side};
    use crate::layout::files::write_atomically;
    use std::io::{Seek, SeekFrom, Write};
    use std::path::PathBuf;

    #[test]
    fn small_files_are_read_side_by_side_and_large_ones_alone() {
        let folder = tempfile::tempdir().unwrap();
        let sizes = [10, 0, LARGE, 5, LARGE - 1, 7, LARGE];
        let file = |(index, &size): (usize, &u64)| {
            let path = folder.path().join(format!("{index}.obj"));
            write_atomically(&path, |out| {
                out.seek(SeekFrom::Start(size.saturating_sub(1)))?;
                out.write_all(&[0; 1][..size.min(1) as usize])
            })
            .unwrap();
            path
        };
        let files: Vec<PathBuf> = sizes.iter().enumerate().map(file).collect();
        let taken = |from: usize, threads: usize| side_by_side(&files[from..], threads);
        assert_eq!([taken(0, 8), taken(2, 8), taken(3, 8)], [2, 1, 3]);
        assert_eq!([taken(0, 1), taken(3, 2), taken(3, 0)], [1, 2, 1]);
        assert_eq!(side_by_side(&[PathBuf::from("missing.obj")], 4), 1);
        let with = |name: &str| [files[0].clone(), folder.path().join(name), files[1].clone()];
        assert_eq!(side_by_side(&with("small.gltf"), 4), 1);
        assert_eq!(side_by_side(&with("small.glb"), 4), 3);
    }

    #[test]
    fn patterns_stand_for_names() {
        for (name, pattern, expected) in [
            ("tile_1_2.obj", "tile_*.obj", true),
            ("tile_1_2.obj", "tile_?_?.obj", true),
            ("tile_1_12.obj", "tile_?_?.obj", false),
            ("tile.obj", "*.ply", false),
            ("a", "a*", true),
            ("", "?", false),
        ] {
            assert_eq!(
                fits(name.as_bytes(), pattern.as_bytes()),
                expected,
                "{name} {pattern}"
            );
        }
    }
}
