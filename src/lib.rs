//! Benchmark and evaluation suite for multi-view-stereo point clouds.
//!
//! mesh + cameras + photographs → [`generate`] → a BlendedMVS data set → [`fuse`] → a cloud →
//! [`score`] → records → [`report`]. Each stage is a plain function of values, but for
//! [`generate`], which takes photographs from their files and writes view by view; [`jobs`] has one file
//! per command that reads files, calls a stage and writes files. See `ARCHITECTURE.md`.
#![cfg_attr(test, allow(clippy::too_many_lines, reason = "a test tells one story"))]

mod ahead;
pub mod blend;
pub mod config;
pub mod error;
pub mod fuse;
pub mod generate;
pub mod jobs;
pub mod parallel;
pub mod progress;
pub mod provenance;
pub mod render;
pub mod report;
pub mod score;
pub mod warning;

pub use error::{Error, Result};
