//! Meshes with their materials and textures, from one or many files.

use crate::error::Result;
use crate::scene::Mesh;
use std::path::PathBuf;

/// A mesh, and what was odd about its files (a missing texture, say), one sentence each.
#[derive(Debug, Clone)]
pub struct LoadedMesh {
    /// All files as one mesh.
    pub mesh: Mesh,
    /// Sentences for the user.
    pub notes: Vec<String>,
}

/// Reads meshes (`.obj` with its materials, `.ply`) and joins them into one. A folder stands for
/// all its meshes, in name order. Textures are found beside the file that names them.
pub fn read_meshes(_paths: &[PathBuf]) -> Result<LoadedMesh> {
    todo!()
}
