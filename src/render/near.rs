//! Triangles that the fast path cannot judge, such as those that reach behind the camera: whole
//! blocks are ruled out by homogeneous edge functions, every sample left is tested exactly. Nothing
//! is clipped: the exact test knows what is in front.

use super::raster::Place;
use super::tile::{BLOCK, SIZE, Spot, Tile};
use glam::DVec3;

/// Rounding of edge functions, relative to the lengths that enter them.
const ROUNDING: f64 = 1e-13;

/// Offers a triangle to all samples of the tile that see it.
pub(crate) fn draw(tile: &mut Tile, place: &Place<'_>, triangle: u32) {
    let corners = place.eye.frame.corners(triangle as usize);
    if corners.iter().all(|corner| corner.z <= 0.0) {
        return;
    }
    let [a, b, c] = corners;
    let longest = corners
        .iter()
        .fold(0.0f64, |m, corner| m.max(corner.length()));
    let sides = Sides {
        normals: [c.cross(b), a.cross(c), b.cross(a)],
        slack: ROUNDING * longest * longest,
    };
    for row in (0..SIZE).step_by(BLOCK) {
        for column in (0..SIZE).step_by(BLOCK) {
            if sides.may_cover(place, Spot { column, row }) {
                draw_block(tile, place, triangle, Spot { column, row });
            }
        }
    }
}

/// Planes through the camera and each edge.
struct Sides {
    normals: [DVec3; 3],
    slack: f64,
}

impl Sides {
    /// Whether some direction of the block may lie on the same side of all three planes.
    fn may_cover(&self, place: &Place<'_>, corner: Spot) -> bool {
        let (left, top) = (place.column + corner.column, place.row + corner.row);
        let ends = [(0, 0), (BLOCK, 0), (0, BLOCK), (BLOCK, BLOCK)];
        let directions = ends.map(|(x, y)| place.eye.direction(left + x, top + y));
        let slack = self.slack * directions.iter().fold(0.0f64, |m, d| m.max(d.length()));
        let beyond = |sign: f64| {
            self.normals
                .iter()
                .all(|normal| directions.iter().any(|d| sign * normal.dot(*d) >= -slack))
        };
        beyond(1.0) || beyond(-1.0)
    }
}

fn draw_block(tile: &mut Tile, place: &Place<'_>, triangle: u32, corner: Spot) {
    for row in corner.row..corner.row + BLOCK {
        for column in corner.column..corner.column + BLOCK {
            let exact = |triangle| {
                let crossing = place
                    .eye
                    .cross(triangle, place.column + column, place.row + row);
                crossing.map(|crossing| crossing.distance)
            };
            if let Some(distance) = exact(triangle) {
                #[allow(
                    clippy::cast_possible_truncation,
                    reason = "well below the tile's doubt"
                )]
                tile.offer(
                    Spot { column, row },
                    (triangle, (1.0 / distance) as f32),
                    exact,
                );
            }
        }
    }
    let last = BLOCK - 1;
    tile.touch(
        corner,
        Spot {
            column: corner.column + last,
            row: corner.row + last,
        },
    );
}
