//! Which clusters a tile may see, nearest first, and which of them are hidden already.

use super::clusters::{Child, Clusters, WIDTH, Wide};
use super::lens::{Lens, Place, Projected};
use super::raster::Brush;
use super::tile::{SIZE, Spot, Tile};

/// Rounding of boxes in the camera frame, relative to the coordinates that enter.
const ROUNDING: f32 = 1e-6;

/// Finds what is visible in a tile of `width` × `height` samples at `place`.
pub(crate) fn scan(
    clusters: &Clusters,
    place: &Place<'_>,
    (width, height): (usize, usize),
) -> Tile {
    let mut tile = Tile::new(width, height);
    let mut scratch = Projected::new();
    let lens = Lens::new(place);
    let gaze = Gaze::new(place, (width, height));
    let mut waiting = vec![(Child::Node(0), Box3::EVERYWHERE)];
    while let Some((child, seen)) = waiting.pop() {
        if gaze.is_hidden(&mut tile, &seen) {
            continue;
        }
        match child {
            Child::None => {}
            Child::Cluster(index) => {
                let mut brush = Brush {
                    tile: &mut tile,
                    place,
                    lens: &lens,
                    scratch: &mut scratch,
                };
                brush.draw(&clusters.cluster(index));
            }
            Child::Node(index) => {
                let first = waiting.len();
                gaze.look_into(&clusters.nodes[index as usize], &mut waiting);
                let depth = |entry: &(Child, Box3)| entry.1.low[2];
                waiting[first..].sort_by(|a, b| depth(b).total_cmp(&depth(a)));
            }
        }
    }
    tile
}

/// A box in the camera frame.
#[derive(Debug, Clone, Copy)]
struct Box3 {
    low: [f32; 3],
    high: [f32; 3],
}

impl Box3 {
    const EVERYWHERE: Self = Self {
        low: [f32::NEG_INFINITY; 3],
        high: [f32::INFINITY; 3],
    };
}

/// A tile's view of boxes, in f32.
struct Gaze {
    rotation: [[f32; 3]; 3],
    center_in_cam: [f32; 3],
    rounding: f32,
    /// x / z and y / z at the tile's outer borders.
    low: [f32; 2],
    high: [f32; 2],
    /// Samples per unit of x / z and y / z.
    scale: [f32; 2],
    /// The last used sample.
    last: Spot,
}

#[allow(
    clippy::cast_possible_truncation,
    reason = "boxes are enlarged by ROUNDING"
)]
impl Gaze {
    fn new(place: &Place<'_>, (width, height): (usize, usize)) -> Self {
        let eye = place.eye;
        let border = |pixel: f64, axis: usize| (pixel - eye.principal[axis]) / eye.focal[axis];
        let (left, top) = (place.column as f64, place.row as f64);
        // One sample more on each side than the sample centres need.
        let low = [border(left - 0.5, 0), border(top - 0.5, 1)];
        let high = [
            border(left + width as f64 + 0.5, 0),
            border(top + height as f64 + 0.5, 1),
        ];
        Self {
            rotation: eye
                .rotation
                .transpose()
                .to_cols_array_2d()
                .map(|row| row.map(|v| v as f32)),
            center_in_cam: eye.center_in_cam.as_vec3().to_array(),
            rounding: ROUNDING * eye.center_in_cam.length() as f32,
            low: low.map(|v| v as f32),
            high: high.map(|v| v as f32),
            scale: eye.focal.as_vec2().to_array(),
            last: Spot {
                column: width - 1,
                row: height - 1,
            },
        }
    }

    /// Adds the node's children that the tile may see.
    fn look_into(&self, node: &Wide, waiting: &mut Vec<(Child, Box3)>) {
        let mut low = [[0.0f32; WIDTH]; 3];
        let mut high = [[0.0f32; WIDTH]; 3];
        for axis in 0..3 {
            let row = self.rotation[axis];
            for i in 0..WIDTH {
                let mut center = self.center_in_cam[axis];
                let mut half = self.rounding;
                let mut sum = 0.0;
                for (k, factor) in row.iter().enumerate() {
                    let (middle, reach) = (
                        0.5 * (node.high[k][i] + node.low[k][i]),
                        0.5 * (node.high[k][i] - node.low[k][i]),
                    );
                    center += factor * middle;
                    half += factor.abs() * reach;
                    sum += middle.abs() + reach;
                }
                half += ROUNDING * sum;
                low[axis][i] = center - half;
                high[axis][i] = center + half;
            }
        }
        for (i, &child) in node.children.iter().enumerate() {
            let seen = Box3 {
                low: [low[0][i], low[1][i], low[2][i]],
                high: [high[0][i], high[1][i], high[2][i]],
            };
            if child != Child::None && self.meets(&seen) {
                waiting.push((child, seen));
            }
        }
    }

    /// Whether the box reaches into the pyramid through the tile's borders.
    fn meets(&self, seen: &Box3) -> bool {
        let near = seen.low[2].max(0.0);
        let far = seen.high[2];
        far > 0.0
            && (0..2).all(|axis| {
                let low = (self.low[axis] * near).min(self.low[axis] * far);
                let high = (self.high[axis] * near).max(self.high[axis] * far);
                seen.high[axis] >= low && seen.low[axis] <= high
            })
    }

    /// Whether everything that the tile can see of the box lies behind what has been drawn.
    fn is_hidden(&self, tile: &mut Tile, seen: &Box3) -> bool {
        let [near, far] = [seen.low[2], seen.high[2]];
        if near <= 0.0 {
            return false;
        }
        let (mut from, mut to) = ([0usize; 2], [0usize; 2]);
        let last = [self.last.column, self.last.row];
        for axis in 0..2 {
            let low = (seen.low[axis] / near).min(seen.low[axis] / far) - self.low[axis];
            let high = (seen.high[axis] / near).max(seen.high[axis] / far) - self.low[axis];
            // `low` is one sample before the tile's first centre.
            let first = (low * self.scale[axis] - 2.0).clamp(0.0, last[axis] as f32);
            let end = (high * self.scale[axis] + 1.0).clamp(0.0, last[axis] as f32);
            #[allow(clippy::cast_sign_loss, reason = "clamped")]
            {
                from[axis] = first as usize;
                to[axis] = end as usize;
            }
        }
        let corners = (
            Spot {
                column: from[0],
                row: from[1],
            },
            Spot {
                column: to[0],
                row: to[1],
            },
        );
        debug_assert!(to[0] < SIZE && to[1] < SIZE);
        tile.hides(corners, 1.0 / near)
    }
}
