//! The one place with unsafe code: files seen as bytes without copying them.
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
        let file = File::open(path).map_err(Error::io(path, "open"))?;
        let metadata = file.metadata().map_err(Error::io(path, "read the size"))?;
        if metadata.is_dir() {
            return Err(Error::layout(path, "expected a file, found a folder"));
        }
        if metadata.len() == 0 {
            return Ok(Self { map: None });
        }
        // SAFETY: the map is read-only and never handed out as anything but `&[u8]`. Another
        // process that truncates the file while it is mapped ends this one with SIGBUS; inputs are
        // documented as not to be changed during a run, and every value read is checked before use.
        let map = unsafe { memmap2::Mmap::map(&file) }.map_err(Error::io(path, "map"))?;
        Ok(Self { map: Some(map) })
    }

    /// The file's bytes.
    pub(crate) fn bytes(&self) -> &[u8] {
        self.map.as_deref().unwrap_or_default()
    }
}
