//! Errors of this crate.

/// Why a number could not be computed.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A value out of its range, or values that do not fit together.
    #[error("{what}: {problem}")]
    Invalid {
        /// The kind of value: `tolerance`, `voxel size`.
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
}
