//! COLMAP's side car of a fused cloud: which images see each point.
//!
//! `u64` number of points, then per point `u32` number of images and as many `u32` places of images
//! in the model as COLMAP counts them ([`super::sparse::registered_names`]), little-endian.

use super::blocks::BlockWriter;
use super::files::temporary_file;
use crate::error::{Error, Result};
use std::io::{Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

/// Writes point after point; the file appears when it is finished.
#[derive(Debug)]
pub struct VisibleWriter {
    out: BlockWriter,
    temporary: tempfile::TempPath,
    path: PathBuf,
    count: u64,
}

impl VisibleWriter {
    /// Begins the file that will be at `path`.
    ///
    /// # Errors
    /// A folder that is not there, and a file that cannot be made in it or written to.
    pub fn create(path: &Path) -> Result<Self> {
        let folder = path
            .parent()
            .filter(|folder| !folder.as_os_str().is_empty());
        let file = temporary_file(folder.unwrap_or(Path::new(".")), path);
        let (file, temporary) = file.map_err(Error::io(path, "create"))?.into_parts();
        let mut out = BlockWriter::new(file);
        out.write_all(&0u64.to_le_bytes())
            .map_err(Error::io(path, "write"))?;
        Ok(Self {
            out,
            temporary,
            path: path.to_path_buf(),
            count: 0,
        })
    }

    /// Adds a point that these images see.
    ///
    /// # Errors
    /// What writing the file brings.
    pub fn write(&mut self, images: impl ExactSizeIterator<Item = u32>) -> Result<()> {
        self.count += 1;
        let count = u32::try_from(images.len()).unwrap_or(u32::MAX);
        let mut bytes = Vec::with_capacity(4 + 4 * images.len());
        bytes.extend(count.to_le_bytes());
        bytes.extend(images.flat_map(u32::to_le_bytes));
        self.out
            .write_all(&bytes)
            .map_err(Error::io(&self.path, "write"))
    }

    /// Fills in the count and writes what is left, still under another name.
    ///
    /// # Errors
    /// What writing the file brings.
    pub fn complete(&mut self) -> Result<()> {
        let count = self.count.to_le_bytes();
        let out = &mut self.out;
        let filled = out
            .seek(SeekFrom::Start(0))
            .and_then(|_| out.write_all(&count));
        let whole = filled.and_then(|()| out.seek(SeekFrom::End(0)));
        whole
            .and_then(|_| out.flush())
            .map_err(Error::io(&self.path, "write"))
    }

    /// Completes the file and gives it its name.
    ///
    /// # Errors
    /// As [`VisibleWriter::complete`], and a path that cannot be replaced.
    pub fn finish(mut self) -> Result<()> {
        self.complete()?;
        // The file is open, and so locked, until it has its name.
        let named = self.temporary.persist(&self.path);
        drop(self.out);
        named.map_err(|refused| Error::io(&self.path, "write")(refused.error))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_file_is_as_colmap_reads_it_and_appears_whole() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("cloud.ply.vis");
        let mut writer = VisibleWriter::create(&path).unwrap();
        writer.write([7u32, 2].into_iter()).unwrap();
        writer.write([0u32].into_iter()).unwrap();
        assert!(!path.exists());
        writer.finish().unwrap();
        let words: Vec<u32> = [2, 0, 2, 7, 2, 1, 0].to_vec();
        let expected: Vec<u8> = words.iter().flat_map(|word| word.to_le_bytes()).collect();
        assert_eq!(std::fs::read(&path).unwrap(), expected);
        drop(VisibleWriter::create(&path).unwrap());
        assert_eq!(std::fs::read(&path).unwrap(), expected);
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    }
}
