//! Where skinned meshes stand.

use super::data::Document;
use super::wire::Skin;
use glam::DMat4;
use std::collections::BTreeMap;

/// What the numbers of two joints' transforms may differ by, relative to the largest: files hold f32.
const SAME: f64 = 1e-4;

/// What is said of the others.
pub(super) const LEFT: &str = "skins that bend a mesh are left out: it is shown where its vertices lie in the file, \
                               moved neither by joints nor, as glTF has it, by its node";

/// `world_from_mesh` of a mesh with a skin: its joints', not its node's (glTF 2.0, section 3.7.3.3); none where its
/// joints, as the file leaves them, do not all move it alike, or are not there. `nodes` are those of the scene with
/// their `world_from_node`.
pub(super) fn placed(
    document: &Document<'_>,
    nodes: &BTreeMap<usize, DMat4>,
    skin: usize,
) -> Result<Option<DMat4>, String> {
    let Some(skin) = document.root.skins.get(skin) else {
        return Ok(None);
    };
    let joints = joints_of(document, nodes, skin)?;
    let Some(&first) = joints.first() else {
        return Ok(None);
    };
    let numbers = first.to_cols_array();
    let largest = numbers
        .iter()
        .fold(0.0, |most: f64, number| most.max(number.abs()));
    let alike = |joint: &DMat4| {
        let both = joint.to_cols_array().into_iter().zip(numbers);
        both.into_iter()
            .all(|(a, b)| (a - b).abs() <= SAME * largest)
    };
    Ok(joints.iter().all(alike).then_some(first))
}

/// Where each joint moves what it holds; none where one is not in the scene, or moves it beyond all numbers.
fn joints_of(
    document: &Document<'_>,
    nodes: &BTreeMap<usize, DMat4>,
    skin: &Skin,
) -> Result<Vec<DMat4>, String> {
    let binds = match skin.inverse_bind_matrices {
        Some(accessor) => document.elements::<16>(accessor)?,
        None => vec![DMat4::IDENTITY.to_cols_array(); skin.joints.len()],
    };
    if binds.len() < skin.joints.len() {
        return Err(format!(
            "expected inverse bind matrices of {} joints, found {}",
            skin.joints.len(),
            binds.len()
        ));
    }
    let moved = |(joint, bind): (&usize, &[f64; 16])| {
        let matrix = *nodes.get(joint)? * DMat4::from_cols_array(bind);
        Some(matrix).filter(|matrix| matrix.is_finite())
    };
    let moved: Option<Vec<DMat4>> = skin.joints.iter().zip(&binds).map(moved).collect();
    Ok(moved.unwrap_or_default())
}
