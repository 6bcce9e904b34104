//! Files that are written in whole blocks.

use std::fs::File;
use std::io::{Result, Seek, SeekFrom, Write};

/// Bytes of a block.
const BLOCK: usize = 1 << 18;

/// Room on the disk is asked for ahead from this length on, as much as there is already, ...
const FIRST: u64 = 1 << 22;
/// ... and at most so much.
const MOST: u64 = 1 << 26;

/// A new file that is written in blocks, each of which begins at a multiple of its length: systems that keep
/// what is written in pieces of many pages take those in a quarter less time than rows as they come, and map
/// them in half the time when the file is read.
#[derive(Debug)]
pub struct BlockWriter {
    file: File,
    /// Where in the file the bytes that wait belong.
    at: u64,
    waiting: Vec<u8>,
    /// To where in the file there is room on the disk that was asked for; none where that is not to be had.
    room: Option<u64>,
}

impl BlockWriter {
    pub(super) fn new(file: File) -> Self {
        Self {
            file,
            at: 0,
            waiting: Vec::new(),
            room: Some(0),
        }
    }

    /// Writes all that waits, and gives back the room on the disk that is not used.
    pub(super) fn finish(mut self) -> Result<()> {
        self.flush()?;
        if self.room.is_some_and(|room| room > 0) {
            let length = self.file.metadata()?.len();
            // What has the length already is left alone by some systems.
            self.file.set_len(length + 1)?;
            self.file.set_len(length)?;
        }
        Ok(())
    }

    /// Writes the bytes that wait.
    fn hand_on(&mut self) -> Result<()> {
        self.ask_for_room(self.waiting.len());
        self.file.write_all(&self.waiting)?;
        self.at += self.waiting.len() as u64;
        self.waiting.clear();
        Ok(())
    }

    /// Asks for room on the disk for large files, which is found at once instead of block by block: a quarter of
    /// the time that writing takes. Where there is none, writing tells.
    fn ask_for_room(&mut self, coming: usize) {
        let end = self.at + coming as u64;
        let Some(room) = self.room.filter(|&room| end >= FIRST && end > room) else {
            return;
        };
        let more = end.clamp(FIRST, MOST);
        self.room = reserve(&self.file, end, more).then_some(room.max(end + more));
    }

    /// Bytes to the end of the block in which the next one lies.
    fn free(&self) -> usize {
        let used = (self.at % BLOCK as u64) as usize + self.waiting.len();
        BLOCK - used % BLOCK
    }
}

/// Reserves room from a place in a file on, whose length stays; whether that was done.
#[cfg(target_os = "linux")]
fn reserve(file: &File, from: u64, length: u64) -> bool {
    rustix::fs::fallocate(file, rustix::fs::FallocateFlags::KEEP_SIZE, from, length).is_ok()
}

#[cfg(not(target_os = "linux"))]
fn reserve(_: &File, _: u64, _: u64) -> bool {
    false
}

impl Write for BlockWriter {
    fn write(&mut self, bytes: &[u8]) -> Result<usize> {
        let free = self.free();
        if self.waiting.is_empty() && free == BLOCK && bytes.len() >= BLOCK {
            let whole = &bytes[..bytes.len() / BLOCK * BLOCK];
            self.ask_for_room(whole.len());
            self.file.write_all(whole)?;
            self.at += whole.len() as u64;
            return Ok(whole.len());
        }
        let taken = &bytes[..free.min(bytes.len())];
        self.waiting.extend_from_slice(taken);
        if taken.len() == free {
            self.hand_on()?;
        }
        Ok(taken.len())
    }

    fn flush(&mut self) -> Result<()> {
        self.hand_on()?;
        self.file.flush()
    }
}

impl Seek for BlockWriter {
    fn seek(&mut self, to: SeekFrom) -> Result<u64> {
        self.hand_on()?;
        self.at = self.file.seek(to)?;
        Ok(self.at)
    }

    fn stream_position(&mut self) -> Result<u64> {
        Ok(self.at + self.waiting.len() as u64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::io::Cursor;

    #[test]
    fn blocks_are_whole_and_lie_at_multiples() {
        let file = tempfile::NamedTempFile::new().unwrap();
        let path = file.path();
        let mut out = BlockWriter::new(file.reopen().unwrap());
        let length = || path.metadata().unwrap().len() as usize;
        out.write_all(&[1; 1000]).unwrap();
        assert_eq!((length(), out.stream_position().unwrap()), (0, 1000));
        out.write_all(&[2; 3 * BLOCK]).unwrap();
        assert_eq!(length(), 3 * BLOCK, "the rest waits");
        out.write_all(&[3; BLOCK - 1000]).unwrap();
        assert_eq!(length(), 4 * BLOCK, "nothing waits");
        out.write_all(&[4; BLOCK + 7]).unwrap();
        assert_eq!(length(), 5 * BLOCK);
        out.flush().unwrap();
        assert_eq!(length(), 5 * BLOCK + 7);
        out.write_all(&[5; BLOCK]).unwrap();
        assert_eq!(length(), 6 * BLOCK, "up to the next multiple");
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn room_is_asked_for_ahead_and_given_back() {
        use std::os::unix::fs::MetadataExt;
        let file = tempfile::NamedTempFile::new().unwrap();
        let path = file.path();
        let mut out = BlockWriter::new(file.reopen().unwrap());
        let room = || path.metadata().unwrap().blocks() * 512;
        out.write_all(&vec![1; FIRST as usize - BLOCK]).unwrap();
        assert_eq!(out.room, Some(0), "small files ask for none");
        out.write_all(&vec![2; 9_000_000]).unwrap();
        out.write_all(b"the end").unwrap();
        let Some(asked) = out.room else {
            return; // not on this file system
        };
        assert!(asked >= 9_000_000 + FIRST - BLOCK as u64, "{asked}");
        assert!(asked <= 3 * (9_000_000 + FIRST), "{asked}");
        let before = room();
        out.seek(SeekFrom::Start(3)).unwrap();
        out.write_all(b"the count").unwrap();
        out.finish().unwrap();
        let found = std::fs::read(path).unwrap();
        assert_eq!(found.len(), FIRST as usize - BLOCK + 9_000_000 + 7);
        assert!(found.ends_with(b"the end") && found[3..].starts_with(b"the count"));
        assert!(room() <= before, "{} {before}", room());
        assert!(room() < found.len() as u64 + (1 << 20), "{}", room());
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(32))]
        #[test]
        fn what_is_written_anywhere_is_what_is_there(
            steps in proptest::collection::vec((0usize..3, 0usize..3 * BLOCK, 0usize..600_000), 1..8),
        ) {
            let file = tempfile::NamedTempFile::new().unwrap();
            let path = file.path();
            let mut found = BlockWriter::new(file.reopen().unwrap());
            let mut expected = Cursor::new(Vec::new());
            for (number, (kind, length, place)) in steps.into_iter().enumerate() {
                match kind {
                    0 => {
                        let to = SeekFrom::Start(place as u64);
                        prop_assert_eq!(found.seek(to).unwrap(), expected.seek(to).unwrap());
                    }
                    1 => {
                        let to = SeekFrom::End(0);
                        prop_assert_eq!(found.seek(to).unwrap(), expected.seek(to).unwrap());
                    }
                    _ => {}
                }
                let bytes: Vec<u8> = (0..length).map(|at| (at * 7 + number) as u8).collect();
                found.write_all(&bytes).unwrap();
                expected.write_all(&bytes).unwrap();
                prop_assert_eq!(found.stream_position().unwrap(), expected.stream_position().unwrap());
            }
            found.finish().unwrap();
            prop_assert!(std::fs::read(path).unwrap() == expected.into_inner());
        }
    }
}
