//! Reading meshes for a job.

use super::Context;
use crate::error::Result;
use crate::parallel;
use mvs_datasets::layout::mesh::{self, LoadedMesh, ReadOptions};
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// How meshes are read.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct MeshOptions {
    /// The most memory that decoded textures may take, in MiB.
    pub texture_memory: u64,
}

impl Default for MeshOptions {
    fn default() -> Self {
        Self {
            texture_memory: mesh::TEXTURE_BYTES >> 20,
        }
    }
}

/// Reads the meshes as one; what was odd about them becomes warnings.
pub fn read_mesh(
    paths: &[PathBuf],
    options: &MeshOptions,
    context: &Context<'_>,
) -> Result<LoadedMesh> {
    let options = ReadOptions {
        texture_bytes: options.texture_memory.saturating_mul(1 << 20),
        threads: parallel::threads(),
    };
    let loaded = mesh::read_meshes_with(paths, &options)?;
    for note in &loaded.notes {
        context.warnings.add("mesh", note.clone());
    }
    Ok(loaded)
}
