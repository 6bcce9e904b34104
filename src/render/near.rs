//! Triangles that the fast path cannot judge, such as those that reach behind the camera: whole
//! blocks are ruled out by homogeneous edge functions, every sample left is tested exactly. Nothing
//! is clipped: the exact test knows what is in front.

use super::bent::Bent;
use super::lens::Place;
use super::tile::{BLOCK, Spot, Tile};
use glam::DVec3;

/// Rounding of edge functions, relative to the lengths that enter them.
const ROUNDING: f64 = 1e-13;

/// Offers a triangle to all samples that see it between two corners of the tile, both included.
pub(crate) fn draw(
    tile: &mut Tile,
    (place, bent): (&Place<'_>, Option<&Bent>),
    triangle: u32,
    (from, to): (Spot, Spot),
) {
    if to.column - from.column < BLOCK && to.row - from.row < BLOCK {
        return draw_block(tile, (place, bent), triangle, (from, to));
    }
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
    for row in (from.row..=to.row).step_by(BLOCK) {
        for column in (from.column..=to.column).step_by(BLOCK) {
            let corner = Spot { column, row };
            let last = Spot {
                column: to.column.min(column + BLOCK - 1),
                row: to.row.min(row + BLOCK - 1),
            };
            let around = match bent {
                Some(bent) => bent.corners((corner, last)),
                None => Some(around(place, corner)),
            };
            if around.is_some_and(|directions| sides.may_cover(directions)) {
                draw_block(tile, (place, bent), triangle, (corner, last));
            }
        }
    }
}

/// Directions around a block of a pinhole's samples.
fn around(place: &Place<'_>, corner: Spot) -> [DVec3; 4] {
    let (left, top) = (place.column + corner.column, place.row + corner.row);
    let ends = [(0, 0), (BLOCK, 0), (0, BLOCK), (BLOCK, BLOCK)];
    ends.map(|(x, y)| place.eye.direction(left + x, top + y))
}

/// Planes through the camera and each edge.
struct Sides {
    normals: [DVec3; 3],
    slack: f64,
}

impl Sides {
    /// Whether some direction between four may lie on the same side of all three planes.
    fn may_cover(&self, directions: [DVec3; 4]) -> bool {
        let slack = self.slack * directions.iter().fold(0.0f64, |m, d| m.max(d.length()));
        let beyond = |sign: f64| {
            self.normals
                .iter()
                .all(|normal| directions.iter().any(|d| sign * normal.dot(*d) >= -slack))
        };
        beyond(1.0) || beyond(-1.0)
    }
}

fn draw_block(
    tile: &mut Tile,
    (place, bent): (&Place<'_>, Option<&Bent>),
    triangle: u32,
    (from, to): (Spot, Spot),
) {
    let facet = place.eye.frame.facet(triangle as usize);
    for row in from.row..=to.row {
        for column in from.column..=to.column {
            let spot = Spot { column, row };
            let direction = match bent {
                Some(bent) => bent.directions[spot.index()],
                None => place.eye.direction(place.column + column, place.row + row),
            };
            if !direction.is_finite() {
                continue;
            }
            let Some(crossing) = facet.cross(direction) else {
                continue;
            };
            let exact = |triangle: u32| {
                let crossing = place.eye.frame.cross(triangle as usize, direction);
                crossing.map(|crossing| crossing.distance)
            };
            #[allow(
                clippy::cast_possible_truncation,
                reason = "well below the tile's doubt"
            )]
            let nearness = (1.0 / crossing.distance) as f32;
            tile.offer(spot, (triangle, nearness), exact);
        }
    }
    tile.touch(from, to);
}
