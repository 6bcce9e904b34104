//! How exactly a cloud's coordinates are written.

use super::maps::FolderMaps;
use crate::error::Result;
use crate::fuse::DepthMaps;
use crate::warning::Warnings;
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

/// How far from the world's origin a camera may lie, in depths of its scene: a point about as far again as its
/// depth has coordinates below 16 of those, which f32 rounds by at most 2^-20 of one.
const FAR: f64 = 14.0;

impl Coordinates {
    /// Whether they are to be doubles.
    ///
    /// # Errors
    /// A depth map that cannot be read.
    pub(super) fn are_doubles(self, maps: &FolderMaps<'_>, warnings: &Warnings) -> Result<bool> {
        if self == Self::Double {
            return Ok(true);
        }
        let Some(depth) = usual_depth(maps)? else {
            return Ok(self == Self::Auto); // nothing will come of it
        };
        let views = (0..maps.count()).map(|index| maps.view(index));
        let farthest = views.map(|view| view.pose.center_in_world().length());
        let farthest = farthest.fold(0.0, f64::max);
        if farthest <= FAR * depth {
            return Ok(false);
        }
        if self == Self::Float {
            let step = (farthest + depth) * f64::from(f32::EPSILON);
            let message = format!(
                "the cameras lie up to {farthest:.3e} from the world's origin, where coordinates of 32 bits are up to \
                 {step:.1e} apart: --coordinates auto writes 64"
            );
            warnings.add("coarse-coordinates", message);
        }
        Ok(self == Self::Auto)
    }
}

/// The least depth of the views' ranges; without any, the middle one of the first map that has depths.
fn usual_depth(maps: &FolderMaps<'_>) -> Result<Option<f64>> {
    let ranges = (0..maps.count()).filter_map(|index| maps.view(index).depth_range);
    if let Some(least) = ranges.map(|range| range.min()).reduce(f64::min) {
        return Ok(Some(least));
    }
    for index in 0..maps.count() {
        let depth = maps.depth(index)?;
        let mut some: Vec<f32> = depth
            .values()
            .iter()
            .copied()
            .filter(|&z| z > 0.0)
            .collect();
        let middle = some.len() / 2;
        if middle < some.len() {
            let (_, depth, _) = some.select_nth_unstable_by(middle, f32::total_cmp);
            return Ok(Some(f64::from(*depth)));
        }
    }
    Ok(None)
}
