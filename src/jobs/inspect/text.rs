//! Numbers for reading, not for computing with.

use mvs_datasets::scene::Aabb;

pub(super) fn box_text(bounds: Aabb) -> String {
    if bounds.is_empty() {
        return "none".to_owned();
    }
    let (min, max) = (bounds.min, bounds.max);
    let axes = [0, 1, 2].map(|axis| between(min[axis], max[axis]));
    axes.join(", ")
}

pub(super) fn between(min: f64, max: f64) -> String {
    format!("{} … {}", short(min), short(max))
}

/// Three decimals, or four digits where they are small: for reading, not for computing with.
pub(super) fn short(value: f64) -> String {
    let text = if value.abs() >= 1.0 || value == 0.0 {
        format!("{value:.3}")
    } else {
        let decimals = (3.0 - libm::log10(value.abs()).floor()).clamp(3.0, 20.0);
        #[allow(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "clamped to 3 ..= 20"
        )]
        let decimals = decimals as usize;
        format!("{value:.decimals$}")
    };
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}
