//! Errors of this crate: one sentence each, with the file and the place in it.

use std::path::{Path, PathBuf};

/// What went wrong inside one stream of bytes, before anybody knows the file's name.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{place}: {problem}")]
pub struct FormatError {
    /// Where in the stream, in the reader's terms: `line 12`, `header`, `vertex 1041`, `byte 88`.
    pub place: String,
    /// What was expected and what was found, lower case, no full stop.
    pub problem: String,
}

impl FormatError {
    /// An error at `place` saying `problem`.
    pub fn new(place: impl Into<String>, problem: impl Into<String>) -> Self {
        Self {
            place: place.into(),
            problem: problem.into(),
        }
    }
}

/// An error that names the file, or a value that breaks an invariant of [`crate::scene`].
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The operating system refused.
    #[error("{}: cannot {action}: {source}", path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// What was tried: `open`, `read`, `create`, `rename`.
        action: &'static str,
        /// The system's answer.
        source: std::io::Error,
    },
    /// The file was read and does not say what it should.
    #[error("{}: {source}", path.display())]
    Format {
        /// The file.
        path: PathBuf,
        /// The place in it and the problem.
        source: FormatError,
    },
    /// A folder lacks something or holds something that it should not.
    #[error("{}: {problem}", path.display())]
    Layout {
        /// The folder or file.
        path: PathBuf,
        /// Expected, found, what to do.
        problem: String,
    },
    /// A value breaks an invariant of the vocabulary.
    #[error("{what}: {problem}")]
    Invalid {
        /// The kind of value: `camera`, `depth map`.
        what: &'static str,
        /// Expected and found.
        problem: String,
    },
}

/// The result of everything in this crate that can fail.
pub type Result<T, E = Error> = std::result::Result<T, E>;

impl Error {
    /// An [`Error::Invalid`].
    pub fn invalid(what: &'static str, problem: impl Into<String>) -> Self {
        Self::Invalid {
            what,
            problem: problem.into(),
        }
    }

    /// An [`Error::Layout`].
    pub fn layout(path: impl AsRef<Path>, problem: impl Into<String>) -> Self {
        Self::Layout {
            path: path.as_ref().to_path_buf(),
            problem: problem.into(),
        }
    }

    /// An [`Error::Io`] from the system's answer to `action` on `path`.
    pub fn io(path: impl AsRef<Path>, action: &'static str) -> impl FnOnce(std::io::Error) -> Self {
        move |source| Self::Io {
            path: path.as_ref().to_path_buf(),
            action,
            source,
        }
    }

    /// An [`Error::Format`] from a format's complaint about `path`.
    pub fn in_file(path: impl AsRef<Path>) -> impl FnOnce(FormatError) -> Self {
        move |source| Self::Format {
            path: path.as_ref().to_path_buf(),
            source,
        }
    }
}

/// A broken invariant met while reading a stream: the format adds the place.
impl FormatError {
    /// Turns an error about a value into an error at `place`.
    pub fn at(place: impl Into<String>) -> impl FnOnce(Error) -> Self {
        move |error| Self::new(place, error.to_string())
    }
}
