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
    /// 32-bit where that moves no point by more than a millionth of a usual depth, or of its own where that is
    /// greater, else 64-bit.
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
/// Depths in those below which all rows are.
const FEW: usize = 64;
/// The part of the depths that are nearer than a usual one: beyond them may be a background that is left out.
const NEARER: usize = 20;

/// What depths a map of this `size` has: of those in some rows, or in all where they are few, a near one, that a
/// twentieth are nearer than. `None` where there are none, or they cannot be read, which is said when all are.
pub(super) fn usual_depth(
    size: (u32, u32),
    rows: impl Fn(usize) -> Result<Vec<f32>, FormatError>,
) -> Option<f32> {
    let depths_of = |every| {
        let mut depths = rows(every).ok()?;
        depths.retain(|&depth| depth > 0.0 && depth.is_finite());
        Some(depths)
    };
    let mut depths = depths_of((size.1 as usize).div_ceil(ROWS))?;
    if depths.len() < FEW {
        depths = depths_of(1)?;
    }
    let near = depths.len() / NEARER;
    (near < depths.len()).then(|| *depths.select_nth_unstable_by(near, f32::total_cmp).1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_usual_depth_is_one_that_a_twentieth_are_nearer_than() {
        let depth = |row: usize, column: usize| match (row, column) {
            (_, 0..3) => 0.0,
            (_, 3) => 0.1,
            (_, 4) => f32::INFINITY,
            (_, column) if column < 60 => 2.0,
            _ => 1e9,
        };
        let found = |rows_with: &dyn Fn(usize) -> bool| {
            let rows = |every: usize| {
                let rows = (0..80).step_by(every);
                let value = |row| (0..100).map(move |column| (row, column));
                let all = rows.flat_map(value);
                let or_none = |(row, column)| {
                    if rows_with(row) {
                        depth(row, column)
                    } else {
                        0.0
                    }
                };
                Ok(all.map(or_none).collect())
            };
            usual_depth((100, 80), rows)
        };
        assert_eq!(found(&|_| true), Some(2.0));
        // None of the rows that are looked at first has any, or one alone.
        assert_eq!(found(&|row| row % 10 > 0), Some(2.0));
        assert_eq!(found(&|row| row == 33), Some(2.0));
        assert_eq!(found(&|_| false), None);
    }
}
