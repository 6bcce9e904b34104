//! Arrays of numbers kept in files for the time of a run.

use super::files;
use crate::error::{Error, Result};
use std::fs::File;
use std::io::{Read, Seek, SeekFrom, Write};
use std::ops::Range;
use std::path::{Path, PathBuf};

/// Numbers written at a time.
const PIECE: usize = 1 << 16;

/// What the names of scratch folders begin with.
const PREFIX: &str = ".mvs-eval-scratch-";
/// The file in each that its run holds locked: the system lets go of it when the run ends, however.
const LOCK: &str = "lock";

/// A folder of little-endian f32 arrays, removed with everything in it when dropped. What a run that was
/// killed has left is removed by the next one beside it.
#[derive(Debug)]
pub struct ScratchFolder {
    folder: tempfile::TempDir,
    _lock: File,
}

impl ScratchFolder {
    /// A new folder beside the file `path`, where there is room for a result.
    ///
    /// # Errors
    /// A folder of the file that is not there and cannot be made, or in which no folder and file can be.
    pub fn beside(path: &Path) -> Result<Self> {
        let parent = files::folder_of(path);
        std::fs::create_dir_all(parent).map_err(Error::io(parent, "create the folder"))?;
        remove_left(parent);
        let folder = tempfile::Builder::new()
            .prefix(PREFIX)
            .tempdir_in(parent)
            .map_err(Error::io(parent, "create a folder in"))?;
        let _lock = locked(folder.path()).map_err(Error::io(folder.path(), "lock a file in"))?;
        Ok(Self { folder, _lock })
    }

    /// The folder, where other files of the run may lie too.
    pub fn folder(&self) -> &Path {
        self.folder.path()
    }

    fn path(&self, key: u64) -> PathBuf {
        self.folder.path().join(format!("{key}.f32"))
    }

    /// Keeps `values` under `key`, in place of what was there.
    ///
    /// # Errors
    /// As [`files::write_atomically`].
    pub fn store(&self, key: u64, values: &[f32]) -> Result<()> {
        let mut bytes = vec![0; 4 * PIECE.min(values.len())];
        files::write_atomically(&self.path(key), |out| {
            values.chunks(PIECE).try_for_each(|piece| {
                let bytes = &mut bytes[..4 * piece.len()];
                for (to, value) in bytes.as_chunks_mut::<4>().0.iter_mut().zip(piece) {
                    *to = value.to_le_bytes();
                }
                out.write_all(bytes)
            })
        })
    }

    /// What was stored under `key`.
    ///
    /// # Errors
    /// Nothing stored there, and a file that cannot be read.
    pub fn fetch(&self, key: u64) -> Result<Vec<f32>> {
        files::read_with(&self.path(key), |bytes| {
            let values = bytes.as_chunks::<4>().0.iter();
            Ok(values.map(|four| f32::from_le_bytes(*four)).collect())
        })
    }

    /// Puts the numbers in `range` of what was stored under `key` into `to`, in place of what it held.
    ///
    /// # Errors
    /// Nothing stored there, and fewer numbers than asked for.
    pub fn fetch_part(&self, key: u64, range: Range<usize>, to: &mut Vec<f32>) -> Result<()> {
        let path = self.path(key);
        let mut bytes = vec![0; 4 * range.len()];
        File::open(&path)
            .and_then(|mut file| {
                file.seek(SeekFrom::Start(4 * range.start as u64))?;
                file.read_exact(&mut bytes)
            })
            .map_err(Error::io(&path, "read"))?;
        to.clear();
        let values = bytes.as_chunks::<4>().0.iter();
        to.extend(values.map(|four| f32::from_le_bytes(*four)));
        Ok(())
    }

    /// Forgets `key`.
    ///
    /// # Errors
    /// Nothing stored there, and a file that cannot be removed.
    pub fn discard(&self, key: u64) -> Result<()> {
        let path = self.path(key);
        std::fs::remove_file(&path).map_err(Error::io(&path, "remove"))
    }
}

/// A locked file in the folder, which has its name only once it is locked.
fn locked(folder: &Path) -> std::io::Result<File> {
    let before = folder.join("lock.new");
    let file = File::options().write(true).create_new(true).open(&before)?;
    // Where files cannot be locked, what a killed run leaves stays.
    let _ = file.try_lock();
    std::fs::rename(before, folder.join(LOCK))?;
    Ok(file)
}

/// Removes the scratch folders in `parent` whose runs have ended. What cannot be removed stays.
fn remove_left(parent: &Path) {
    let entries = std::fs::read_dir(parent).into_iter().flatten().flatten();
    for entry in entries.filter(|entry| entry.file_name().to_string_lossy().starts_with(PREFIX)) {
        let lock = File::options().write(true).open(entry.path().join(LOCK));
        if lock.is_ok_and(|file| file.try_lock().is_ok()) {
            let _ = std::fs::remove_dir_all(entry.path());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arrays_come_back_and_the_folder_goes() {
        let parent = tempfile::tempdir().unwrap();
        let scratch = ScratchFolder::beside(&parent.path().join("cloud.ply")).unwrap();
        scratch.store(3, &[1.5, -0.0, f32::MAX]).unwrap();
        assert_eq!(scratch.fetch(3).unwrap(), [1.5, -0.0, f32::MAX]);
        let mut part = vec![7.0; 9];
        scratch.fetch_part(3, 1..3, &mut part).unwrap();
        assert_eq!(part, [-0.0, f32::MAX]);
        assert!(scratch.fetch_part(3, 1..4, &mut part).is_err());
        scratch.discard(3).unwrap();
        assert!(scratch.fetch(3).is_err());
        // Another run beside it leaves it alone, and removes what one that was killed has left.
        let left = parent.path().join(format!("{PREFIX}killed"));
        std::fs::create_dir(&left).unwrap();
        let put = |name: &str| {
            files::write_atomically(&left.join(name), |out| out.write_all(&[0; 8])).unwrap();
        };
        put("7.f32");
        drop(ScratchFolder::beside(&parent.path().join("other.ply")).unwrap());
        assert!(left.exists(), "without a lock nothing is known of it");
        put(LOCK);
        drop(ScratchFolder::beside(&parent.path().join("other.ply")).unwrap());
        assert!(!left.exists());
        scratch.store(4, &[2.5]).unwrap();
        assert_eq!(scratch.fetch(4).unwrap(), [2.5]);
        drop(scratch);
        assert_eq!(std::fs::read_dir(parent.path()).unwrap().count(), 0);
    }
}
