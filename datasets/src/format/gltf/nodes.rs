//! Where the meshes of a glTF's scene stand, and how often.

use super::wire::{Node, Root};
use crate::error::FormatError;
use glam::{DMat4, DQuat, DVec3};
use std::collections::BTreeSet;

/// Vertices and corners of triangles that the instances of a file's meshes may add up to, where the meshes
/// themselves have fewer.
pub(super) const MOST_INSTANCED: usize = 1 << 26;

/// The nodes of the scene with their `world_from_node`, parents first.
pub(super) fn placed_nodes(root: &Root) -> Result<Vec<(usize, DMat4)>, FormatError> {
    let wrong = |index: usize, problem: &str| FormatError::new(format!("node {index}"), problem);
    let roots: Vec<usize> = match root.scenes.get(root.scene.unwrap_or(0)) {
        Some(scene) => scene.nodes.clone(),
        None => {
            let child = |index| root.nodes.iter().any(|node| node.children.contains(&index));
            (0..root.nodes.len())
                .filter(|&index| !child(index))
                .collect()
        }
    };
    let mut seen = vec![false; root.nodes.len()];
    let mut placed = Vec::new();
    let mut waiting: Vec<(usize, DMat4)> = roots
        .into_iter()
        .rev()
        .map(|index| (index, DMat4::IDENTITY))
        .collect();
    while let Some((index, parent)) = waiting.pop() {
        let Some(node) = root.nodes.get(index) else {
            return Err(wrong(index, "expected a node, found none of this number"));
        };
        if std::mem::replace(&mut seen[index], true) {
            return Err(wrong(
                index,
                "expected one parent, found it in two places of the scene",
            ));
        }
        let matrix = parent * local(node);
        if !matrix.is_finite() {
            return Err(wrong(index, "expected a finite transform, found another"));
        }
        placed.push((index, matrix));
        waiting.extend(node.children.iter().rev().map(|&child| (child, matrix)));
    }
    Ok(placed)
}

/// Refuses a file whose nodes show its meshes so often that a small file would fill the memory.
pub(super) fn check_instances(
    root: &Root,
    nodes: &[(usize, DMat4)],
    most: usize,
) -> Result<(), FormatError> {
    let count = |accessor: usize| {
        root.accessors
            .get(accessor)
            .map_or(0, |accessor| accessor.count)
    };
    let accessors = |mesh: usize| {
        let meshes = root.meshes.get(mesh).into_iter();
        let primitives = meshes.flat_map(|mesh| &mesh.primitives);
        primitives.flat_map(|p| {
            let positions = p.attributes.get("POSITION").copied();
            positions.into_iter().chain(p.indices)
        })
    };
    let sum = |of: &mut dyn Iterator<Item = usize>| of.fold(0, usize::saturating_add);
    let meshes = nodes.iter().filter_map(|&(node, _)| root.nodes[node].mesh);
    let distinct: BTreeSet<usize> = meshes.clone().flat_map(accessors).collect();
    let once = sum(&mut distinct.into_iter().map(count));
    let placed = sum(&mut meshes.flat_map(accessors).map(count));
    if placed <= once.max(most) {
        return Ok(());
    }
    let problem = format!(
        "expected at most {most} vertices and corners in all instances of meshes, found {placed} where the file has \
         {once}: export the scene in parts"
    );
    Err(FormatError::new("nodes", problem))
}

fn local(node: &Node) -> DMat4 {
    if let Some(matrix) = &node.matrix {
        return DMat4::from_cols_array(matrix);
    }
    let scale = node.scale.map_or(DVec3::ONE, DVec3::from_array);
    let rotation = node.rotation.map_or(DQuat::IDENTITY, DQuat::from_array);
    let rotation = match rotation.length() > 0.0 {
        true => rotation.normalize(),
        false => DQuat::IDENTITY,
    };
    let translation = node.translation.map_or(DVec3::ZERO, DVec3::from_array);
    DMat4::from_scale_rotation_translation(scale, rotation, translation)
}
