//! Files seen as bytes without copying them.
#![allow(
    unsafe_code,
    reason = "memory maps have no safe constructor; reviewed here, used nowhere else"
)]

use crate::error::{Error, Result};
use std::fs::File;
use std::path::Path;

/// A file's bytes, mapped into memory read-only. Empty files are an empty slice.
#[derive(Debug)]
pub(crate) struct MappedFile {
    map: Option<memmap2::Mmap>,
}

impl MappedFile {
    /// Maps the whole of `path`.
    pub(crate) fn open(path: &Path) -> Result<Self> {
        let metadata = std::fs::metadata(path).map_err(Error::io(path, "open"))?;
        if metadata.is_dir() {
            return Err(Error::layout(path, "expected a file, found a folder"));
        }
        if !metadata.is_file() {
            return Err(Error::layout(
                path,
                "expected a regular file, found a pipe or a device: write its content to a file first",
            ));
        }
        let file = File::open(path).map_err(Error::io(path, "open"))?;
        if metadata.len() == 0 {
            return Ok(Self { map: None });
        }
        // SAFETY: the map is read-only. Nothing of this program writes to a file that it reads: outputs
        // replace files as a whole. Users are told (README, --help) that inputs must not change during a
        // run: another process that shortens the file ends this one with SIGBUS, and what one writes to
        // it can be seen here after it was checked.
        let map = unsafe { memmap2::Mmap::map(&file) }.map_err(Error::io(path, "map"))?;
        Ok(Self { map: Some(map) })
    }

    /// The file's bytes.
    pub(crate) fn bytes(&self) -> &[u8] {
        self.map.as_deref().unwrap_or_default()
    }
}
