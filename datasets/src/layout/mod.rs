//! Folder conventions: the only place that knows paths, and where foreign conventions (integer
//! pixel centres, camera-to-world poses) are converted.

pub mod blended;
pub mod blocks;
pub mod cameras;
pub mod exports;
pub mod files;
mod materials;
pub mod mesh;
pub mod mesh_out;
mod model;
pub mod mvsnet;
mod numbers;
pub mod scratch;
pub mod sparse;
mod textures;
pub mod tnt;
pub mod visible;
pub mod workspace;
