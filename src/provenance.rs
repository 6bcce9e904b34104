//! Who made a result, from what and how: `run.toml` beside every result, which replays it.

use crate::error::{Error, Result};
use mvs_datasets::layout::files;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use std::collections::{BTreeMap, BTreeSet};
use std::io::{Read, Write};
use std::path::{Path, PathBuf};

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
    /// The files of a result folder that this run wrote, by their paths in it; a later run with
    /// `--force` removes those that it does not write again.
    #[serde(default, skip_serializing_if = "BTreeSet::is_empty")]
    pub files: BTreeSet<String>,
}

impl Run {
    /// The run of `command` with these resolved options on these inputs, which are hashed.
    pub fn new(command: &str, options: &impl Serialize, inputs: &[&Path]) -> Result<Self> {
        let options = toml::Table::try_from(options)
            .map_err(|error| Error::invalid("run.toml", error.to_string()))?;
        let inputs = inputs
            .iter()
            .map(|&path| Ok((path.display().to_string(), hash_path(path)?)))
            .collect::<Result<_>>()?;
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
    pub fn read(path: &Path) -> Result<Self> {
        let text = files::read_text(path)?;
        toml::from_str(&text).map_err(|error| {
            let problem = error.to_string().trim().replace('\n', " ");
            Error::invalid(path.display().to_string(), problem)
        })
    }

    /// Writes a `run.toml`.
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

    /// The inputs whose content is no longer what it was, or that are gone.
    pub fn changed_inputs(&self) -> Vec<String> {
        let unchanged = |(path, hash): &(&String, &String)| {
            hash_path(Path::new(path)).is_ok_and(|now| now == **hash)
        };
        let changed = self.inputs.iter().filter(|input| !unchanged(input));
        changed.map(|(path, _)| path.clone()).collect()
    }
}

/// BLAKE3 of a file's bytes; of a folder, over the names and hashes of its files, by name.
pub fn hash_path(path: &Path) -> Result<String> {
    let mut hasher = blake3::Hasher::new();
    if !path.is_dir() {
        if std::fs::metadata(path).is_ok_and(|metadata| !metadata.is_file()) {
            let problem = "expected a regular file, found a pipe or a device: write its content to a file first";
            return Err(Error::invalid(path.display().to_string(), problem));
        }
        hasher
            .update_mmap(path)
            .map_err(mvs_datasets::Error::io(path, "read"))?;
        return Ok(hasher.finalize().to_hex().to_string());
    }
    for entry in sorted_entries(path)? {
        let name = entry
            .strip_prefix(path)
            .unwrap_or(&entry)
            .to_string_lossy()
            .into_owned();
        hasher
            .update(name.as_bytes())
            .update(&[0])
            .update(hash_path(&entry)?.as_bytes());
    }
    Ok(hasher.finalize().to_hex().to_string())
}

/// SHA-256 of a file's bytes, in hexadecimal: what `sha256sum` prints and records name files by.
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
