//! What a number means: functions of positions, depths and tolerances, on plain slices.
//!
//! This crate never sees a file, a camera or a data set; see `ARCHITECTURE.md`.

pub mod error;

pub use error::{Error, Result};
