//! Reading meshes for a job.

use super::Context;
use crate::error::{Error, Result};
use crate::parallel;
use glam::DVec3;
use mvs_datasets::layout::mesh::{self, LoadedMesh, ReadOptions};
use mvs_datasets::scene::Mesh;
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
    check_surface(&loaded.mesh, paths)?;
    Ok(loaded)
}

/// Refuses a mesh in which nothing is to be seen, as where positions were rounded to few digits.
pub(super) fn check_surface(mesh: &Mesh, paths: &[PathBuf]) -> Result<()> {
    let has_area = |triangle| {
        let [a, b, c] = mesh.corners(triangle);
        (b - a).cross(c - a) != DVec3::ZERO
    };
    let count = mesh.triangles().len();
    if count == 0 || (0..count).any(has_area) {
        return Ok(()); // a mesh without triangles is refused as such
    }
    let names: Vec<String> = paths
        .iter()
        .map(|path| path.display().to_string())
        .collect();
    let problem = format!(
        "expected a surface, found {count} triangles without an area: all of their corners coincide or lie \
         on a line"
    );
    Err(Error::invalid(names.join(", "), problem))
}
