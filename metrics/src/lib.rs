//! What a number means: functions of positions, depths and tolerances, on plain slices.
//!
//! This crate never sees a file, a camera or a data set; see `ARCHITECTURE.md`.
#![cfg_attr(test, allow(clippy::too_many_lines, reason = "a test tells one story"))]

pub mod align;
pub mod crop;
pub mod curve;
pub mod depth;
pub mod distance;
pub mod downsample;
pub mod error;
pub mod score;
pub mod stats;
pub mod stretches;
pub mod tolerance;
pub mod usual;

pub use curve::Curve;
pub use error::{Error, Result};
pub use score::{Count, Score};
pub use stretches::Stretches;
pub use tolerance::Tolerance;
pub use usual::Usual;
