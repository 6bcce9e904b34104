//! Why to believe it: one integration binary.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::print_stderr,
    clippy::too_many_lines,
    reason = "helpers of tests may fail like tests, and a test tells one story"
)]

mod architecture;
mod augment;
mod blend;
mod cli;
mod dataset;
mod demo;
mod depth;
mod extremes;
mod formats;
mod fuse;
mod generate;
mod gltf;
mod goldens;
mod lenses;
mod meshes;
mod pairs;
mod parity;
mod render;
mod report;
mod report_folders;
mod score;
mod support;
mod synthetic;
mod tradeoff;
