//! Locks of result folders, which last as long as the folder is open.

use crate::error::{Error, Result};
use std::fs::{File, TryLockError};
use std::path::Path;
use std::time::Duration;

/// The folder itself, locked while it is open; none where systems or file systems do not lock folders.
pub(super) fn locked(path: &Path) -> Result<Option<File>> {
    let Ok(folder) = File::open(path) else {
        return Ok(None);
    };
    match folder.try_lock() {
        Ok(()) => Ok(Some(folder)),
        Err(TryLockError::Error(_)) => Ok(None),
        Err(TryLockError::WouldBlock) => Err(is_taken(path)),
    }
}

pub(super) fn is_taken(path: &Path) -> Error {
    let problem = "expected a folder for this run alone, found one that another run is writing: wait until that \
                   ends, or give another --out";
    Error::invalid(path.display().to_string(), problem)
}

/// The folder itself, locked beside others that share it; none where a run has it alone, and goes on to.
pub(super) fn shared(path: &Path) -> Option<File> {
    let folder = File::open(path).ok()?;
    // Who shares it has it alone for the moment of marking it.
    for _ in 0..100 {
        if folder.try_lock_shared().is_ok() {
            return Some(folder);
        }
        std::thread::sleep(Duration::from_millis(20));
    }
    None
}
