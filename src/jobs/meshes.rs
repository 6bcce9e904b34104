//! Reading meshes for a job.

use super::Context;
use crate::error::{Error, Result};
use crate::parallel;
use glam::DVec3;
use mvs_datasets::layout::mesh::{self, LoadedMesh, ReadOptions};
use mvs_datasets::scene::{Material, Mesh};
use mvs_metrics::stats;
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
///
/// # Errors
/// Files that are missing or cannot be read, no faces in them or none with an area, and textures that would take more
/// than `options.texture_memory`.
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
    warn_of_far(&loaded.mesh, context);
    Ok(loaded)
}

/// A mesh that reaches so many times as far as half of it does leaves depths of that half few digits: places are
/// counted from the middle of all.
const FAR: f64 = 1e9;

/// Warns of a mesh of which a part lies absurdly far from the rest.
fn warn_of_far(mesh: &Mesh, context: &Context<'_>) {
    let count = mesh.triangles().len();
    let corners = || {
        let some = (0..count).step_by(count.div_ceil(1000));
        some.map(|triangle| mesh.corners(triangle)[0])
    };
    let middle = |values: Vec<f64>| stats::median(&values).unwrap_or(0.0);
    let axis = |k: usize| middle(corners().map(|corner| corner[k]).collect());
    let center = DVec3::new(axis(0), axis(1), axis(2));
    let usual = middle(corners().map(|corner| corner.distance(center)).collect());
    let reach = mesh.bounds().size().length();
    if usual > 0.0 && reach > FAR * usual {
        let message = format!(
            "the mesh reaches over {reach:.1e} units, though half of it lies within {usual:.1e} of its middle, so \
             that depths there lose digits: take away the vertices that lie far off"
        );
        context.warnings.add("mesh-far", message);
    }
}

/// Warns of a mesh that has one colour throughout: renderings show nothing but its outline.
pub(super) fn warn_of_plain(mesh: &Mesh, context: &Context<'_>) {
    let count = mesh.triangles().len();
    let materials = (0..count).map(|triangle| mesh.material_of(triangle));
    let shows = |material: &Material| material.texture.is_some();
    let first = mesh.material_of(0).color;
    let painted = mesh
        .vertex_colors()
        .is_some_and(|colors| colors.windows(2).any(|two| two[0] != two[1]));
    if !painted
        && !materials
            .clone()
            .any(|material| shows(material) || material.color != first)
    {
        let message = "the mesh has one colour throughout, no textures and no vertex colours: renderings show its \
                       outline alone, and blended images are blurred photographs; give the textured mesh";
        context.warnings.add("mesh-without-colors", message);
    }
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
