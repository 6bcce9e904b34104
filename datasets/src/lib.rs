//! What the truth is and how it lies on disk.
//!
//! - [`scene`]: the vocabulary in memory, with its invariants. Everything else speaks it.
//! - [`mod@format`]: bytes to values and back, one file per format, over `Read` and `Write`.
//! - [`layout`]: folder conventions, the only place that knows paths.
//! - [`synthetic`]: scenes whose truth has a closed form.
//!
//! This crate never sees a score; see `ARCHITECTURE.md` for the import table.
#![cfg_attr(test, allow(clippy::too_many_lines, reason = "a test tells one story"))]

pub mod error;
pub mod format;
pub mod layout;
mod mapped;
mod parallel;
pub mod scene;
pub mod synthetic;

pub use error::{Error, FormatError, Result};
