//! Single files: reading with the path in every error, writing to a temporary name.

use super::blocks::BlockWriter;
use crate::error::{Error, FormatError, Result};
use crate::format;
use crate::mapped::MappedFile;
use crate::scene::{
    ColorImage, CropVolume, DepthMap, PointCloud, Raster, RejectedDepths, Similarity,
};
use glam::DVec3;
use std::ffi::{OsStr, OsString};
use std::fs::{DirEntry, TryLockError};
use std::io::Write;
use std::path::{Path, PathBuf};
use tempfile::TempPath;

/// What the names of temporary files begin with; what an ended process leaves of them may go. The name of
/// the file to be follows, and some letters that are drawn.
pub const TEMPORARY: &str = ".mvs-eval-";
const SUFFIX: &str = ".part";
/// Letters that are drawn.
const DRAWN: usize = 6;
/// Bytes of a name that go into that of its temporary file: names may have 255, on some file systems 143.
const LONGEST: usize = 100;

/// Writes `path` by way of a temporary file in the same folder, which is renamed when `write` has
/// succeeded: readers see the old file or the whole new one. Missing parent folders are made.
///
/// # Errors
/// A folder or temporary file that cannot be made, what `write` brings, and a `path` that cannot be replaced.
pub fn write_atomically(
    path: &Path,
    write: impl FnOnce(&mut BlockWriter) -> std::io::Result<()>,
) -> Result<()> {
    write_by_way_of(folder_of(path), path, write)
}

/// As [`write_atomically`] for a `path` that is not there: what has come there by the time that all is written stays,
/// and the temporary file goes.
///
/// # Errors
/// As [`write_atomically`], and a `path` that is there.
pub fn write_new(
    path: &Path,
    write: impl FnOnce(&mut BlockWriter) -> std::io::Result<()>,
) -> Result<()> {
    let (temporary, file) = written(folder_of(path), path, write)?;
    let refused = match temporary.persist_noclobber(path) {
        Ok(()) => return Ok(()),
        Err(refused) => refused,
    };
    if path.symlink_metadata().is_ok() {
        return Err(has_come(path));
    }
    // Some file systems cannot refuse.
    let named = refused.path.persist(path);
    drop(file);
    named.map_err(|refused| Error::io(path, "replace")(refused.error))
}

/// The error of a result `path` where a file has come during the work.
pub fn has_come(path: &Path) -> Error {
    let problem = "expected no file, as when the run began, found one that another run has written since: it stays; \
                   give another --out, or --force to replace it";
    Error::layout(path, problem)
}

/// The folder that a file lies in, `.` for a bare name.
pub fn folder_of(path: &Path) -> &Path {
    match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    }
}

/// The folder that `folder` lies in if it is called `name`, also where it is given as `.`.
pub fn above(folder: &Path, name: &str) -> Option<PathBuf> {
    let real = match folder.file_name() {
        Some(_) => folder.to_path_buf(),
        None => folder.canonicalize().ok()?,
    };
    let is_named = real.ends_with(name);
    real.parent().filter(|_| is_named).map(Path::to_path_buf)
}

/// As [`write_atomically`], with the temporary file in `folder`, which is on the same file system.
///
/// # Errors
/// As [`write_atomically`], and a `path` whose own folder is not there or on another file system.
pub fn write_by_way_of(
    folder: &Path,
    path: &Path,
    write: impl FnOnce(&mut BlockWriter) -> std::io::Result<()>,
) -> Result<()> {
    let (temporary, file) = written(folder, path, write)?;
    // The file is open, and so locked, until it has its name.
    let named = temporary.persist(path);
    drop(file);
    named.map_err(|refused| Error::io(path, "replace")(refused.error))
}

/// A whole temporary file for `path` in `folder`, and its open file.
fn written(
    folder: &Path,
    path: &Path,
    write: impl FnOnce(&mut BlockWriter) -> std::io::Result<()>,
) -> Result<(TempPath, BlockWriter)> {
    std::fs::create_dir_all(folder).map_err(Error::io(folder, "create the folder"))?;
    let temporary = temporary_file(folder, path).map_err(Error::io(path, "create"))?;
    let (file, temporary) = temporary.into_parts();
    let mut out = BlockWriter::new(file);
    write(&mut out)
        .and_then(|()| out.flush())
        .map_err(Error::io(path, "write"))?;
    Ok((temporary, out))
}

/// Removes what runs that were killed have left of writing `path`, beside it. What a run still writes it
/// holds locked (on a network file system that keeps locks to each machine, only against runs on its own),
/// and what cannot be removed stays.
pub fn remove_left(path: &Path) {
    let prefix = prefix_for(path);
    let is_left = |name: &OsStr| {
        inner_of(name, prefix.as_encoded_bytes()).is_some_and(|inner| inner.len() == DRAWN)
    };
    for entry in entries_of(folder_of(path)) {
        if is_left(&entry.file_name()) {
            remove_unless_locked(&entry);
        }
    }
}

/// As [`remove_left`], of writing any file in a folder or so many levels below it.
pub fn remove_all_left(folder: &Path, levels: u32) {
    for entry in entries_of(folder) {
        let name = entry.file_name();
        if entry.file_type().is_ok_and(|kind| kind.is_dir()) {
            // What is temporary as a whole is another's to remove.
            if levels > 0 && !name.as_encoded_bytes().starts_with(TEMPORARY.as_bytes()) {
                remove_all_left(&entry.path(), levels - 1);
            }
        } else if inner_of(&name, TEMPORARY.as_bytes()).is_some() {
            remove_unless_locked(&entry);
        }
    }
}

fn entries_of(folder: &Path) -> impl Iterator<Item = DirEntry> + use<> {
    std::fs::read_dir(folder).into_iter().flatten().flatten()
}

/// What a temporary file's name has between `prefix` and its ending, the letters that are drawn last.
fn inner_of<'n>(name: &'n OsStr, prefix: &[u8]) -> Option<&'n [u8]> {
    let inner = name.as_encoded_bytes().strip_prefix(prefix)?;
    let inner = inner.strip_suffix(SUFFIX.as_bytes())?;
    let drawn = &inner[inner.len().checked_sub(DRAWN)?..];
    drawn.iter().all(u8::is_ascii_alphanumeric).then_some(inner)
}

fn remove_unless_locked(entry: &DirEntry) {
    if !entry.file_type().is_ok_and(|kind| kind.is_file()) {
        return;
    }
    let file = std::fs::File::options().write(true).open(entry.path());
    if file.is_ok_and(|file| file.try_lock().is_ok()) {
        let _ = std::fs::remove_file(entry.path());
    }
}

/// What the names of temporary files for `path` begin with.
fn prefix_for(path: &Path) -> OsString {
    let mut prefix = OsString::from(TEMPORARY);
    if let Some(name) = path.file_name().filter(|name| name.len() <= LONGEST) {
        prefix.push(name);
        prefix.push("-");
    }
    prefix
}

/// A temporary file for `path` with the permissions that a plain new file has, locked while it is open.
pub(super) fn temporary_file(
    folder: &Path,
    path: &Path,
) -> std::io::Result<tempfile::NamedTempFile> {
    let prefix = prefix_for(path);
    let mut builder = tempfile::Builder::new();
    builder.prefix(&prefix).suffix(SUFFIX).rand_bytes(DRAWN);
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        builder.permissions(std::fs::Permissions::from_mode(0o666)); // less the umask
    }
    loop {
        let temporary = builder.tempfile_in(folder)?;
        // Where files cannot be locked, what a killed run leaves stays.
        let locked = temporary.as_file().try_lock();
        let is_taken = matches!(locked, Err(TryLockError::WouldBlock));
        // Another run may have taken it for left before it was locked.
        if !is_taken && temporary.path().exists() {
            return Ok(temporary);
        }
    }
}

/// Maps a file and gives its bytes to `read`; the path goes into every error.
///
/// # Errors
/// A file that is not there, is no regular one or cannot be mapped, and what `read` finds wrong.
pub fn read_with<T>(path: &Path, read: impl FnOnce(&[u8]) -> Result<T, FormatError>) -> Result<T> {
    let file = MappedFile::open(path)?;
    read(file.bytes()).map_err(Error::in_file(path))
}

/// Reads a text file as UTF-8; a byte-order mark is skipped.
///
/// # Errors
/// As [`read_with`], and bytes that are no UTF-8.
pub fn read_text(path: &Path) -> Result<String> {
    read_with(path, |bytes| text_of(bytes).map(str::to_owned))
}

/// Reads a text file and gives its text to `read`; the path goes into every error.
pub(crate) fn read_text_with<T>(
    path: &Path,
    read: impl FnOnce(&str) -> Result<T, FormatError>,
) -> Result<T> {
    read_with(path, |bytes| read(text_of(bytes)?))
}

fn text_of(bytes: &[u8]) -> Result<&str, FormatError> {
    let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
    std::str::from_utf8(bytes).map_err(|error| {
        let problem = "expected text in UTF-8, found other bytes: save the file as UTF-8 text";
        FormatError::new(format!("byte {}", error.valid_up_to()), problem)
    })
}

/// Reads a cloud from a PLY.
///
/// # Errors
/// As [`read_with`] and [`crate::format::ply::read_cloud`], and a PLY without points.
pub fn read_cloud(path: &Path) -> Result<PointCloud> {
    let cloud = read_with(path, format::ply::read_cloud)?;
    if cloud.is_empty() {
        return Err(no_points(path));
    }
    Ok(cloud)
}

/// As [`read_cloud`], the positions alone: what else the points have is not looked at.
///
/// # Errors
/// As [`read_with`] and [`crate::format::ply::read_positions`], and a PLY without points.
pub fn read_positions(path: &Path) -> Result<Vec<DVec3>> {
    let positions = read_with(path, format::ply::read_positions)?;
    match positions.is_empty() {
        true => Err(no_points(path)),
        false => Ok(positions),
    }
}

fn no_points(path: &Path) -> Error {
    Error::layout(path, "expected a cloud, found a PLY without points")
}

/// Reads a JPEG or PNG.
///
/// # Errors
/// As [`read_with`] and [`crate::format::image::read_color`].
pub fn read_image(path: &Path) -> Result<ColorImage> {
    read_with(path, format::image::read_color)
}

/// Reads a one-channel PFM as it is, e.g. confidences.
///
/// # Errors
/// As [`read_with`] and [`crate::format::pfm::read_gray`].
pub fn read_raster(path: &Path) -> Result<Raster<f32>> {
    read_with(path, format::pfm::read_gray)
}

/// Reads a PFM depth map.
///
/// # Errors
/// As [`read_raster`].
pub fn read_depth(path: &Path) -> Result<(DepthMap, RejectedDepths)> {
    Ok(DepthMap::clean(read_raster(path)?))
}

/// Reads a 4×4 similarity transform.
///
/// # Errors
/// As [`read_text`], [`crate::format::transform::read`] and [`Similarity::from_matrix`].
pub fn read_similarity(path: &Path) -> Result<Similarity> {
    let matrix = read_text_with(path, format::transform::read)?;
    Similarity::from_matrix(matrix).map_err(|error| Error::layout(path, error.to_string()))
}

/// Reads a polygon crop volume.
///
/// # Errors
/// As [`read_text`] and [`crate::format::crop::read`].
pub fn read_crop(path: &Path) -> Result<CropVolume> {
    read_text_with(path, format::crop::read)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write;

    fn names_in(folder: &Path) -> Vec<String> {
        let entries = std::fs::read_dir(folder).unwrap();
        entries
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .collect()
    }

    fn put(path: &Path, bytes: &[u8]) {
        write_atomically(path, |out| out.write_all(bytes)).unwrap();
    }

    #[test]
    fn a_file_appears_whole_in_folders_made_for_it() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a/b/out.txt");
        put(&path, b"first");
        put(&path, b"second");
        assert_eq!(std::fs::read(&path).unwrap(), b"second");
        assert_eq!(names_in(path.parent().unwrap()), ["out.txt"]);
    }

    #[test]
    fn a_failed_write_leaves_the_old_file_and_no_other() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("out.txt");
        put(&path, b"old");
        let error = write_atomically(&path, |out| {
            out.write_all(b"new")?;
            Err(std::io::Error::other("the disk is full"))
        });
        let error = error.unwrap_err().to_string();
        assert!(
            error.contains("out.txt: cannot write: the disk is full"),
            "{error}"
        );
        assert_eq!(std::fs::read(&path).unwrap(), b"old");
        assert_eq!(names_in(folder.path()), ["out.txt"]);
    }

    #[test]
    fn what_has_come_during_the_writing_of_a_new_file_stays() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("new/out.txt");
        write_new(&path, |out| out.write_all(b"first")).unwrap();
        let path = folder.path().join("out.txt");
        let error = write_new(&path, |out| {
            put(&path, b"another run's");
            out.write_all(b"mine")
        });
        let error = error.unwrap_err().to_string();
        assert!(
            error.contains("out.txt: expected no file, as when the run began"),
            "{error}"
        );
        assert_eq!(std::fs::read(&path).unwrap(), b"another run's");
        let mut names = names_in(folder.path());
        names.sort();
        assert_eq!(names, ["new", "out.txt"]);
    }

    #[test]
    fn what_killed_runs_left_of_a_file_goes_and_what_others_write_stays() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("cloud.ply");
        let left = [
            ".mvs-eval-cloud.ply-Ab12cd.part",
            ".mvs-eval-cloud.ply-Ab12c.part",
            ".mvs-eval-cloud.ply-ab-cd1.part",
            ".mvs-eval-other.ply-Ab12cd.part",
            "cloud.ply-Ab12cd.part",
        ];
        for name in left {
            std::fs::File::create_new(folder.path().join(name)).unwrap();
        }
        let mut here = names_in(folder.path());
        write_atomically(&path, |out| {
            let names = names_in(folder.path());
            let own = names.iter().find(|name| !here.contains(name)).unwrap();
            here.push(own.clone());
            remove_left(&path);
            assert!(folder.path().join(own).exists(), "it is being written");
            out.write_all(b"x")
        })
        .unwrap();
        let mut found = names_in(folder.path());
        found.sort();
        let mut expected = left[1..].to_vec();
        expected.push("cloud.ply");
        expected.sort_unstable();
        assert_eq!(found, expected);
        // The name of what is being written is of the same kind as that which went.
        let own = here.last().unwrap();
        assert_eq!((own.len(), &own[..20]), (left[0].len(), &left[0][..20]));
        let long = folder.path().join("n".repeat(255));
        put(&long, b"x");
        remove_left(&long);
        assert!(long.exists());
    }

    #[test]
    fn what_killed_runs_left_in_a_folder_goes_level_by_level() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        let left = ".mvs-eval-a.png-Ab12cd.part";
        let places = [
            "",
            "color",
            "color/deep",
            "color/deep/deeper",
            ".mvs-eval-scratch",
        ];
        for place in places {
            put(&at(place).join("a.png"), b"x");
            put(&at(place).join(left), b"x");
            put(&at(place).join("b-Ab12cd.part"), b"x");
        }
        write_atomically(&at("b.png"), |out| {
            let before = names_in(folder.path()).len();
            remove_all_left(folder.path(), 2);
            assert_eq!(
                names_in(folder.path()).len(),
                before - 1,
                "it is being written"
            );
            out.write_all(b"x")
        })
        .unwrap();
        let stays = |place: &str| at(place).join(left).exists();
        assert_eq!(places.map(stays), [false, false, false, true, true]);
        assert!(places.iter().all(|place| at(place).join("a.png").exists()));
        assert!(at("b.png").exists() && at("b-Ab12cd.part").exists());
    }

    #[cfg(unix)]
    #[test]
    fn permissions_are_those_of_a_plain_new_file() {
        use std::os::unix::fs::PermissionsExt;
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("out.txt");
        put(&path, b"x");
        let plain = folder.path().join("plain.txt");
        std::fs::OpenOptions::new()
            .create(true)
            .truncate(true)
            .write(true)
            .open(&plain)
            .unwrap();
        let mode = |path: &Path| path.metadata().unwrap().permissions().mode();
        assert_eq!(mode(&path), mode(&plain));
    }

    #[test]
    fn a_path_that_cannot_be_written_is_named() {
        let folder = tempfile::tempdir().unwrap();
        put(&folder.path().join("file"), b"x");
        let inside = folder.path().join("file/out.txt");
        let error = write_atomically(&inside, |_| Ok(()))
            .unwrap_err()
            .to_string();
        assert!(error.contains("cannot create the folder"), "{error}");
        let error = write_atomically(folder.path(), |_| Ok(()))
            .unwrap_err()
            .to_string();
        assert!(error.contains("cannot replace"), "{error}");
    }

    #[test]
    fn texts_are_utf8_with_or_without_a_mark() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("t.txt");
        put(&path, b"\xef\xbb\xbf1 2");
        assert_eq!(read_text(&path).unwrap(), "1 2");
        put(&path, b"ab\xff\xfe");
        let error = read_text(&path).unwrap_err().to_string();
        assert!(
            error.contains("t.txt: byte 2: expected text in UTF-8"),
            "{error}"
        );
        put(&path, b"");
        assert_eq!(read_text(&path).unwrap(), "");
    }

    #[test]
    fn every_reader_names_the_file() {
        let folder = tempfile::tempdir().unwrap();
        let missing = folder.path().join("missing");
        let readers: [fn(&Path) -> Option<Error>; 7] = [
            |path| read_text(path).err(),
            |path| read_cloud(path).err(),
            |path| read_image(path).err(),
            |path| read_depth(path).err(),
            |path| read_similarity(path).err(),
            |path| read_crop(path).err(),
            |path| read_raster(path).err(),
        ];
        let garbage = folder.path().join("garbage");
        put(&garbage, b"\x00\x01\x02\xff\xfe not a file of any kind");
        for read in readers {
            let error = read(&missing).unwrap().to_string();
            assert!(
                error.contains("missing: cannot open: No such file"),
                "{error}"
            );
            let error = read(folder.path()).unwrap().to_string();
            assert!(error.contains("expected a file, found a folder"), "{error}");
            let error = read(&garbage).unwrap().to_string();
            assert!(
                error.contains("garbage: ") && error.contains("expected"),
                "{error}"
            );
        }
    }

    #[test]
    fn a_transform_that_is_no_similarity_names_the_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("s_trans.txt");
        put(&path, b"1 0 0 0\n0 2 0 0\n0 0 1 0\n0 0 0 1\n");
        let error = read_similarity(&path).unwrap_err().to_string();
        assert!(
            error.contains("s_trans.txt: similarity transform: expected a rotation"),
            "{error}"
        );
    }
}
