//! How exactly a cloud's coordinates are written.

use super::maps::FolderMaps;
use crate::fuse::DepthMaps;
use crate::warning::Warnings;
use mvs_datasets::FormatError;
use serde::{Deserialize, Serialize};

/// The type of a PLY's coordinates.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Coordinates {
    /// 32-bit where that moves no point by more than a millionth of a usual depth, else 64-bit.
    #[default]
    Auto,
    /// 32-bit: some tools read no others.
    Float,
    /// 64-bit.
    Double,
}

/// How far from the world's origin a camera may lie, in usual depths: a point about as far again as its depth has
/// coordinates below 16 of those, which f32 rounds by at most 2^-20 of one.
const FAR: f64 = 14.0;
/// A scene beyond is left to f64, whatever else it is.
const LARGEST: f64 = 1e30;

impl Coordinates {
    /// Whether they are to be doubles.
    pub(super) fn are_doubles(self, maps: &FolderMaps<'_>, warnings: &Warnings) -> bool {
        let Some(depth) = maps.usual_depth().map(f64::from) else {
            return self != Self::Float; // nothing will come of it
        };
        let views = (0..maps.count()).map(|index| maps.view(index));
        let farthest = views.map(|view| view.pose.center_in_world().length());
        let farthest = farthest.fold(0.0, f64::max);
        let are_exact = farthest <= FAR * depth && farthest + depth < LARGEST;
        if self == Self::Float && !are_exact {
            let step = (farthest + depth) * f64::from(f32::EPSILON);
            let message = format!(
                "the cameras lie up to {farthest:.3e} from the world's origin, where coordinates of 32 bits are up to \
                 {step:.1e} apart: --coordinates auto writes 64"
            );
            warnings.add("coarse-coordinates", message);
        }
        match self {
            Self::Auto => !are_exact,
            Self::Float => false,
            Self::Double => true,
        }
    }
}

/// Rows of a map that are looked at.
const ROWS: usize = 8;
/// The part of the depths that are nearer than a usual one: beyond them may be a background that is left out.
const NEARER: usize = 20;

/// What depths a map of this `size` has: of those in some rows a near one, that a twentieth are nearer than. `None`
/// where they have none, or cannot be read, which is said when all are.
pub(super) fn usual_depth(
    size: (u32, u32),
    rows: impl FnOnce(usize) -> Result<Vec<f32>, FormatError>,
) -> Option<f32> {
    let mut depths = rows((size.1 as usize).div_ceil(ROWS)).ok()?;
    depths.retain(|&depth| depth > 0.0 && depth.is_finite());
    let near = depths.len() / NEARER;
    (near < depths.len()).then(|| *depths.select_nth_unstable_by(near, f32::total_cmp).1)
}
