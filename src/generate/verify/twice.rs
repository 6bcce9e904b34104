//! Views that are the same one.

use super::Finding;
use mvs_datasets::scene::Scene;
use std::collections::BTreeMap;

/// Advice for each view whose camera stands exactly where an earlier one does and looks the same way: matched
/// with each other they say nothing of depth. Cameras that stand still while the light changes are so too.
pub(super) fn check(scene: &Scene) -> Vec<Finding> {
    let mut first = BTreeMap::new();
    let views = scene.views().iter();
    let again = views.filter_map(|view| {
        let pose = view.pose.matrix().to_cols_array().map(|value| (value + 0.0).to_bits());
        let earlier = *first.entry(pose).or_insert(view.id);
        (earlier != view.id).then(|| {
            let message = format!(
                "expected views from different places, found the pose of view {earlier} again: is it the \
                 same view?"
            );
            Finding::advice("view-twice", format!("view {}", view.id), message)
        })
    });
    again.collect()
}
