//! Errors of the pipeline: one sentence each; the command line turns them into exit code 2.

use std::path::{Path, PathBuf};

/// Why a stage or a job could not be done.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// An input could not be read, or an output not written.
    #[error(transparent)]
    Dataset(#[from] mvs_datasets::Error),
    /// A number could not be computed from what was given.
    #[error(transparent)]
    Metric(#[from] mvs_metrics::Error),
    /// Values that do not fit together, or an option out of its range.
    #[error("{what}: {problem}")]
    Invalid {
        /// What the problem is with: an option, a view, a pair of inputs.
        what: String,
        /// Expected, found, what to do.
        problem: String,
    },
    /// Fusion keeps no point of what it was given.
    #[error("{what}: {problem}")]
    NoPoints {
        /// The folder of the depth maps.
        what: String,
        /// What became of the pixels.
        problem: String,
    },
    /// An output is there already.
    #[error("{}: already exists; give --force to replace it", path.display())]
    Exists {
        /// The existing file or folder.
        path: PathBuf,
    },
    /// The user interrupted the work.
    #[error("interrupted")]
    Interrupted,
}

/// The result of everything in this crate that can fail.
pub type Result<T, E = Error> = std::result::Result<T, E>;

impl Error {
    /// An [`Error::Invalid`].
    pub fn invalid(what: impl Into<String>, problem: impl Into<String>) -> Self {
        Self::Invalid {
            what: what.into(),
            problem: problem.into(),
        }
    }

    /// What is wrong with `text`, which was read as TOML from `what`: its line, and the parser's word.
    pub(crate) fn toml(what: impl Into<String>, text: &str, error: &toml::de::Error) -> Self {
        let problem = error.message().trim().replace('\n', ", ");
        let before = error.span().and_then(|span| text.get(..span.start));
        let problem = match before {
            Some(before) => format!("line {}: {problem}", before.matches('\n').count() + 1),
            None => problem,
        };
        Self::invalid(what, problem)
    }

    /// An [`Error::Exists`].
    pub fn exists(path: impl AsRef<Path>) -> Self {
        Self::Exists {
            path: path.as_ref().to_path_buf(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_no_toml_is_one_sentence_with_its_line() {
        let said = |text: &str| {
            let error = toml::from_str::<crate::provenance::Run>(text).unwrap_err();
            Error::toml("run.toml", text, &error).to_string()
        };
        let unclosed = said("command = \"fuse\"\nversion = [\n1,\n");
        assert!(unclosed.starts_with("run.toml: line 3: "), "{unclosed}");
        for text in ["a = 1\na = 2", "command = 1", "\u{e9} = ", ""] {
            let said = said(text);
            assert!(!said.contains(['\n', '|', '^']), "{said}");
        }
        assert!(said("").contains("missing field `command`"), "{}", said(""));
    }
}
