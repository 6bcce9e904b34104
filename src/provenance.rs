//! Who made a result, from what and how: `run.toml` beside every result, which replays it.

use crate::error::{Error, Result};
use crate::parallel;
use crate::progress::{Progress, Silent};
use mvs_datasets::layout::files;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use std::collections::{BTreeMap, BTreeSet};
use std::io::{Read, Write};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};

/// This program's version.
pub const VERSION: &str = env!("CARGO_PKG_VERSION");
/// The revision of the sources it was built from, or `unknown`.
pub const REVISION: &str = env!("MVS_EVAL_REVISION");

/// A run of one command: enough to do it again and to see whether its inputs have changed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Run {
    /// The command's name.
    pub command: String,
    /// Version of the tool that ran it.
    pub version: String,
    /// Revision of the tool's sources.
    pub revision: String,
    /// The command's options, all of them, defaults included.
    pub options: toml::Table,
    /// BLAKE3 of each input, by the path it was given as.
    #[serde(default)]
    pub inputs: BTreeMap<String, String>,
    /// The files that this run wrote, by their paths from the folder of its `run.toml`, which lead up by `..`
    /// where they do not lie in it (whole ones only where no path leads there, as to another drive). Where
    /// they lie in a folder that is an input, they are none of it. A later run into a result folder with
    /// `--force` removes those that it does not write again.
    #[serde(default, skip_serializing_if = "BTreeSet::is_empty")]
    pub files: BTreeSet<String>,
}

impl Run {
    /// The run of `command` with these resolved options on these inputs; those that are not hashed yet are.
    ///
    /// # Errors
    /// Options that TOML cannot hold, and inputs that cannot be read.
    pub fn new(command: &str, options: &impl Serialize, inputs: &Inputs) -> Result<Self> {
        let options = toml::Table::try_from(options)
            .map_err(|error| Error::invalid("run.toml", error.to_string()))?;
        let inputs = inputs.hashes()?;
        Ok(Self {
            command: command.to_owned(),
            version: VERSION.to_owned(),
            revision: REVISION.to_owned(),
            options,
            inputs,
            files: BTreeSet::new(),
        })
    }

    /// Reads a `run.toml`.
    ///
    /// # Errors
    /// Names the file that cannot be read, or the key in it that is missing, unknown or of another kind.
    pub fn read(path: &Path) -> Result<Self> {
        let text = files::read_text(path)?;
        toml::from_str(&text)
            .map_err(|error| Error::toml(path.display().to_string(), &text, &error))
    }

    /// Writes a `run.toml`.
    ///
    /// # Errors
    /// Options that TOML cannot hold, and a file that cannot be written.
    pub fn write(&self, path: &Path) -> Result<()> {
        let text =
            toml::to_string(self).map_err(|error| Error::invalid("run.toml", error.to_string()))?;
        files::write_atomically(path, |out| {
            writeln!(
                out,
                "# Made by mvs-eval. To do it again: mvs-eval replay run.toml --out NEW"
            )?;
            out.write_all(text.as_bytes())
        })?;
        Ok(())
    }

    /// The inputs whose content is no longer what it was, or that are gone. What this run itself wrote into
    /// them, found from its `run.toml` at `run_file`, does not count; all else that was added does, other
    /// results too: they may be read.
    pub fn changed_inputs(&self, run_file: &Path) -> Vec<String> {
        let own = self.own(run_file);
        let unchanged = |(path, hash): &(&String, &String)| {
            let listed = Inputs::list(&[Path::new(path)], &own);
            let now = listed.and_then(|listed| listed.hashes());
            now.is_ok_and(|now| now.values().eq([*hash]))
        };
        let changed = self.inputs.iter().filter(|input| !unchanged(input));
        changed.map(|(path, _)| path.clone()).collect()
    }

    /// The run's `run.toml` at `run_file`, and the files that it names.
    pub fn own(&self, run_file: &Path) -> Vec<PathBuf> {
        let named = self.files.iter().map(|name| run_file.with_file_name(name));
        named.chain([run_file.to_path_buf()]).collect()
    }
}

/// Inputs, listed before the work. Files that are read during it can be hashed as they are read, so that
/// none of them is gone through twice; the rest is hashed before it, or else at the end.
#[derive(Debug, Default)]
pub struct Inputs {
    /// By the path they were given as.
    listed: BTreeMap<String, Listed>,
    /// What is left out of folders, by its [`real_path`].
    own: BTreeSet<PathBuf>,
    known: Mutex<BTreeMap<PathBuf, blake3::Hash>>,
}

/// A file that is being read.
pub struct Reading<'a> {
    inputs: &'a Inputs,
    path: &'a Path,
    hasher: Option<blake3::Hasher>,
}

impl Reading<'_> {
    /// Takes the next bytes. Those that the processor has at hand cost half as much.
    pub fn passed(&mut self, bytes: &[u8]) {
        if let Some(hasher) = &mut self.hasher {
            bytes.chunks(PIECE).for_each(|piece| update(hasher, piece));
        }
    }

    /// All of it was passed.
    pub fn done(self) {
        if let Some(hasher) = self.hasher {
            let path = self.path.to_path_buf();
            self.inputs.known().insert(path, hasher.finalize());
        }
    }
}

/// Bytes that are hashed at a time: they fit into the processor's second cache.
const PIECE: usize = 1 << 17;

/// Hashes a piece that is gone through in order before, which the processor foresees; the hash reads at
/// sixteen places in turn.
fn update(hasher: &mut blake3::Hasher, piece: &[u8]) {
    let words = piece.as_chunks().0.iter();
    let bits = words.fold(0, |bits, word| bits | u64::from_ne_bytes(*word));
    std::hint::black_box(bits);
    hasher.update(piece);
}

/// What lies at a path.
#[derive(Debug)]
enum Listed {
    File(PathBuf),
    /// By name.
    Folder(Vec<(String, Listed)>),
}

impl Inputs {
    /// Lists files and folders with all the files that lie in them, but for this program's temporary ones
    /// and those of `own`: what the run itself writes or replaces.
    ///
    /// # Errors
    /// What is missing, and what is no regular file.
    pub fn list(paths: &[&Path], own: &[PathBuf]) -> Result<Self> {
        let mut inputs = Self {
            own: own.iter().filter_map(|path| real_path(path)).collect(),
            ..Self::default()
        };
        paths.iter().try_for_each(|path| inputs.add(path))?;
        Ok(inputs)
    }

    /// Lists another one.
    ///
    /// # Errors
    /// As [`Inputs::list`].
    pub fn add(&mut self, path: &Path) -> Result<()> {
        let listed = Listed::at(path, &self.own)?;
        self.listed.insert(path.display().to_string(), listed);
        Ok(())
    }

    /// All that is listed, folder by folder.
    pub fn files(&self) -> Vec<&Path> {
        let mut waiting: Vec<&Listed> = self.listed.values().collect();
        let mut files = Vec::new();
        while let Some(listed) = waiting.pop() {
            match listed {
                Listed::Folder(entries) => waiting.extend(entries.iter().map(|(_, entry)| entry)),
                Listed::File(path) => files.push(path.as_path()),
            }
        }
        files
    }

    /// Hashes what is listed now, but for the files of `later`, which are hashed as they are read: what is
    /// read before the work, and what is not read at all, counts as it was then.
    ///
    /// # Errors
    /// What cannot be read.
    pub fn hash_others(&self, later: &BTreeSet<&Path>) -> Result<()> {
        let hashes = self.others(later, &Silent)?;
        self.known().extend(hashes);
        Ok(())
    }

    /// Hashes what is not hashed yet, with progress where that takes long.
    ///
    /// # Errors
    /// What cannot be read, and interruption.
    pub fn hash(&self, progress: &dyn Progress) -> Result<()> {
        let hashes = self.others(&BTreeSet::new(), progress)?;
        self.known().extend(hashes);
        Ok(())
    }

    /// The hashes of the files that are not hashed yet, but for those of `later`.
    fn others(
        &self,
        later: &BTreeSet<&Path>,
        progress: &dyn Progress,
    ) -> Result<BTreeMap<PathBuf, blake3::Hash>> {
        let mut paths = self.files();
        paths.retain(|path| !later.contains(path) && !self.known().contains_key(*path));
        paths.sort_unstable();
        let bytes = paths
            .iter()
            .map(|path| std::fs::metadata(path).map_or(0, |file| file.len()));
        let total: u64 = bytes.sum();
        // What takes less than a second needs no stage of its own.
        let progress = if total < LONG { &Silent } else { progress };
        progress.begin("hashing, MiB", total >> 20);
        let hashes = parallel::try_map(paths.len(), |nth| hash_file(paths[nth], progress))?;
        let paths = paths.into_iter().map(Path::to_path_buf);
        Ok(paths.zip(hashes).collect())
    }

    /// Hashes the content of a file that is about to be read, piece by piece, unless it was before.
    pub fn reading<'a>(&'a self, path: &'a Path) -> Reading<'a> {
        let hasher = (!self.known().contains_key(path)).then(blake3::Hasher::new);
        Reading {
            inputs: self,
            path,
            hasher,
        }
    }

    fn known(&self) -> MutexGuard<'_, BTreeMap<PathBuf, blake3::Hash>> {
        self.known.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// BLAKE3 of each, as [`hash_path`] has it, by the path it was given as.
    fn hashes(&self) -> Result<BTreeMap<String, String>> {
        let mut hashes = self.others(&BTreeSet::new(), &Silent)?;
        hashes.extend(self.known().clone());
        let hash = |(path, listed): (&String, &Listed)| (path.clone(), listed.hash(&hashes));
        Ok(self.listed.iter().map(hash).collect())
    }
}

impl Listed {
    /// The hash of a file, one of `hashes`, or of a folder.
    fn hash(&self, hashes: &BTreeMap<PathBuf, blake3::Hash>) -> String {
        let hash = match self {
            Listed::File(path) => hashes[path],
            Listed::Folder(entries) => {
                let mut hasher = blake3::Hasher::new();
                for (name, listed) in entries {
                    let hash = listed.hash(hashes);
                    hasher
                        .update(name.as_bytes())
                        .update(&[0])
                        .update(hash.as_bytes());
                }
                hasher.finalize()
            }
        };
        hash.to_hex().to_string()
    }

    fn at(path: &Path, own: &BTreeSet<PathBuf>) -> Result<Self> {
        let unreadable = || mvs_datasets::Error::io(path, "read");
        let metadata = std::fs::metadata(path).map_err(unreadable())?;
        if metadata.is_dir() {
            let real = path.canonicalize().map_err(unreadable())?;
            return Self::folder(path, &real, own);
        }
        if !metadata.is_file() {
            let problem = "expected a regular file, found a pipe or a device: write its content to a file first";
            return Err(Error::invalid(path.display().to_string(), problem));
        }
        Ok(Self::File(path.to_path_buf()))
    }

    /// What lies in the folder at `path`, which is `real`. Folders in it without files are as good as not
    /// there: results make them.
    fn folder(path: &Path, real: &Path, own: &BTreeSet<PathBuf>) -> Result<Self> {
        let mut entries = Vec::new();
        for entry in sorted_entries(path)? {
            let name = entry.strip_prefix(path).unwrap_or(&entry);
            let shown = name.to_string_lossy();
            if shown.starts_with(files::TEMPORARY) {
                continue;
            }
            match Self::at(&entry, own)? {
                Self::Folder(inside) if inside.is_empty() => {}
                Self::File(_) if own.contains(&real.join(name)) => {}
                listed => entries.push((shown.into_owned(), listed)),
            }
        }
        Ok(Self::Folder(entries))
    }
}

/// Where a file lies or would lie, whatever links its folder is reached by; none without a folder.
pub(crate) fn real_path(path: &Path) -> Option<PathBuf> {
    let folder = files::folder_of(path).canonicalize().ok()?;
    Some(folder.join(path.file_name()?))
}

/// Bytes that take about half a second to hash.
const LONG: u64 = 1 << 30;

fn hash_file(path: &Path, progress: &dyn Progress) -> Result<blake3::Hash> {
    const MIB: usize = 1 << 20;
    let unreadable = || mvs_datasets::Error::io(path, "read");
    let mut file = std::fs::File::open(path).map_err(unreadable())?;
    let size = file
        .metadata()
        .map_or(PIECE, |file| file.len() as usize + 1);
    let (mut hasher, mut all) = (blake3::Hasher::new(), 0);
    let mut piece = vec![0; PIECE.min(size)];
    loop {
        let count = match file.read(&mut piece) {
            Ok(0) => return Ok(hasher.finalize()),
            Err(error) if error.kind() == std::io::ErrorKind::Interrupted => continue,
            other => other.map_err(unreadable())?,
        };
        update(&mut hasher, &piece[..count]);
        progress.check()?;
        progress.advance(((all + count) / MIB - all / MIB) as u64);
        all += count;
    }
}

/// BLAKE3 of a file's bytes; of a folder, over the names and hashes of its files, by name.
///
/// # Errors
/// As [`Inputs::list`], and what cannot be read.
pub fn hash_path(path: &Path) -> Result<String> {
    let mut inputs = Inputs::default();
    inputs.add(path)?;
    Ok(inputs.hashes()?.into_values().collect())
}

/// SHA-256 of a file's bytes, in hexadecimal: what `sha256sum` prints and records name files by.
///
/// # Errors
/// A file that cannot be read.
pub fn sha256(path: &Path) -> Result<String> {
    let unreadable = || mvs_datasets::Error::io(path, "read");
    let mut file = std::fs::File::open(path).map_err(unreadable())?;
    let mut hasher = Sha256::new();
    let mut buffer = vec![0; 1 << 18];
    loop {
        let count = file.read(&mut buffer).map_err(unreadable())?;
        if count == 0 {
            break;
        }
        hasher.update(&buffer[..count]);
    }
    let digest = hasher.finalize();
    Ok(digest.iter().map(|byte| format!("{byte:02x}")).collect())
}

/// Everything in `folder`, by name.
pub(crate) fn sorted_entries(folder: &Path) -> Result<Vec<PathBuf>> {
    let entries = std::fs::read_dir(folder).map_err(mvs_datasets::Error::io(folder, "read"))?;
    let mut paths = Vec::new();
    for entry in entries {
        paths.push(
            entry
                .map_err(mvs_datasets::Error::io(folder, "read"))?
                .path(),
        );
    }
    paths.sort();
    Ok(paths)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_hashed_as_it_is_read_is_what_is_hashed_from_the_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        let put = |name: &str, content: &[u8]| {
            files::write_atomically(&path(name), |out| out.write_all(content)).unwrap();
        };
        let large: Vec<u8> = (0..400_000u32).map(|at| (at % 251) as u8).collect();
        put("in/a", b"one");
        put("in/below/b", &large);
        put("other", b"");
        let (inside, other) = (path("in"), path("other"));
        let inputs = Inputs::list(&[&inside, &other], &[]).unwrap();
        let read = |name: &str, pieces: &[&[u8]]| {
            let path = path(name);
            let mut reading = inputs.reading(&path);
            pieces.iter().for_each(|piece| reading.passed(piece));
            reading.done();
        };
        inputs
            .reading(&path("in/a"))
            .passed(b"the beginning of one that is not read to its end");
        read(
            "in/below/b",
            &[&large[..7], b"", &large[7..170_000], &large[170_000..]],
        );
        read("in/below/b", &[b"is known"]);
        read("elsewhere", &[b"is no input"]);
        // What comes later is no input.
        put("in/c", b"a result");
        let run = |inputs: &Inputs| Run::new("test", &toml::Table::new(), inputs).unwrap();
        let found = run(&inputs).inputs;
        std::fs::remove_file(path("in/c")).unwrap();
        let expected = |path: &Path| (path.display().to_string(), hash_path(path).unwrap());
        assert_eq!(found, [expected(&inside), expected(&other)].into());
        assert_eq!(
            found,
            run(&Inputs::list(&[&other, &inside], &[]).unwrap()).inputs
        );
        assert_eq!(expected(&other).1, blake3::hash(b"").to_hex().to_string());
        let known = blake3::hash(&large).to_hex().to_string();
        assert_eq!(hash_path(&path("in/below/b")).unwrap(), known);
        read("in/a", &[b"as it was ", b"read"]);
        assert_ne!(found, run(&inputs).inputs);
        assert!(Inputs::list(&[&path("missing")], &[]).is_err());
    }

    #[cfg(unix)]
    #[test]
    fn a_file_is_hashed_in_pieces_and_a_long_one_can_be_stopped() {
        #[derive(Default)]
        struct Heard(Mutex<Vec<(String, u64)>>);
        impl Progress for Heard {
            fn begin(&self, stage: &str, total: u64) {
                self.0.lock().unwrap().push((stage.to_owned(), total));
            }
            fn advance(&self, _: u64) {}
            fn cancelled(&self) -> bool {
                true
            }
        }
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("file");
        for size in [0, 1, PIECE - 1, PIECE, PIECE + 1, 3 * PIECE + 5] {
            let bytes: Vec<u8> = (0..size).map(|i| ((i * i) >> 3) as u8).collect();
            files::write_atomically(&path, |out| out.write_all(&bytes)).unwrap();
            let expected = blake3::hash(&bytes).to_hex().to_string();
            assert_eq!(hash_path(&path).unwrap(), expected, "{size} bytes");
        }
        let hash = |heard: &Heard| Inputs::list(&[&path], &[]).unwrap().hash(heard);
        let heard = Heard::default();
        hash(&heard).unwrap();
        assert!(heard.0.into_inner().unwrap().is_empty(), "a short one");
        let file = std::fs::File::options().write(true).open(&path).unwrap();
        file.set_len(LONG).unwrap();
        let heard = Heard::default();
        assert!(matches!(hash(&heard), Err(Error::Interrupted)));
        let stages = heard.0.into_inner().unwrap();
        assert_eq!(stages, [("hashing, MiB".to_owned(), 1024)]);
    }

    #[cfg(unix)]
    #[test]
    fn own_files_are_left_out_by_whatever_path_and_nothing_else_is() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        let put = |name: &str| {
            files::write_atomically(&path(name), |out| out.write_all(name.as_bytes())).unwrap();
        };
        put("in/a");
        std::os::unix::fs::symlink(path("in"), path("link")).unwrap();
        let listed = |own: &[&str]| {
            let own: Vec<PathBuf> = own.iter().map(|name| path(name)).collect();
            let (inside, link) = (path("in"), path("link"));
            let inputs = Inputs::list(&[&inside, &link], &own).unwrap();
            let hashes: Vec<String> = inputs.hashes().unwrap().into_values().collect();
            assert_eq!(hashes[0], hashes[1]);
            hashes[0].clone()
        };
        let first = listed(&["elsewhere/a", "in/below/b"]);
        assert_eq!(first, hash_path(&path("in")).unwrap());
        put("in/below/b");
        put("in/below/.mvs-eval-b-Ab12cd.part");
        std::fs::create_dir(path("in/empty")).unwrap();
        for own in ["in/below/b", "link/below/b", "in/below/../../link/below/b"] {
            assert_eq!(listed(&[own]), first, "{own}");
        }
        for others in ["in/b", "below/b", "in/below", "in/below/c"] {
            assert_ne!(listed(&[others]), first, "{others}");
        }
        // An input that is named itself is one.
        let itself = Inputs::list(&[&path("in/a")], &[path("in/a")]).unwrap();
        assert_eq!(itself.files(), [path("in/a")]);
    }

    #[test]
    fn sha256_is_that_of_the_standard() {
        // FIPS 180-4's examples.
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("file");
        let put = |path: &Path, text: &str| {
            files::write_atomically(path, |out| out.write_all(text.as_bytes())).unwrap();
        };
        for (text, expected) in [
            (
                "",
                "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855",
            ),
            (
                "abc",
                "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad",
            ),
        ] {
            put(&path, text);
            assert_eq!(sha256(&path).unwrap(), expected);
        }
        let million = "a".repeat(1_000_000);
        put(&path, &million);
        let expected = "cdc76e5c9914fb9281a1c7e284d73e67f1809a48a497200e046d39ccc7112cd0";
        assert_eq!(sha256(&path).unwrap(), expected);
        assert!(sha256(&folder.path().join("missing")).is_err());
    }
}
