//! Clusters drawn into a tile: projected in f64, tested in f32 with a known error; what lies
//! within that error of an edge, or of another surface's depth, is decided by the exact test.

use super::clusters::{Cluster, Content, MOST_VERTICES};
use super::eye::Eye;
use super::near;
use super::tile::{DOUBT, SIZE, Spot, Tile};

/// Rounding of one f32 operation, relative.
const ULP: f32 = 1.2e-7;
/// Triangles whose corners may be off by more samples than this are tested exactly throughout.
const MOST_ERROR: f32 = 0.05;

/// Samples whose edge functions are worked out side by side.
const LANES: usize = 8;
/// The first and the last sample of a tile.
const WHOLE: (Spot, Spot) = (
    Spot { column: 0, row: 0 },
    Spot {
        column: SIZE - 1,
        row: SIZE - 1,
    },
);

/// Where a tile lies: the grid and its first sample there.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Place<'e> {
    pub(crate) eye: &'e Eye<'e>,
    pub(crate) column: usize,
    pub(crate) row: usize,
}

/// A cluster's vertices on a tile. Sample centres have whole numbers, (0, 0) the tile's first.
#[derive(Debug)]
pub(crate) struct Projected {
    x: [f32; MOST_VERTICES],
    y: [f32; MOST_VERTICES],
    nearness: [f32; MOST_VERTICES],
    /// By how many samples a vertex may be off.
    error: f32,
}

impl Projected {
    pub(crate) fn new() -> Self {
        Self {
            x: [0.0; MOST_VERTICES],
            y: [0.0; MOST_VERTICES],
            nearness: [0.0; MOST_VERTICES],
            error: 0.0,
        }
    }

    /// Projects a cluster; `false` when it comes too close to the camera, or behind it, for its
    /// projection to be of use.
    fn project(&mut self, place: &Place<'_>, cluster: &Cluster, content: &Content<'_>) -> bool {
        let eye = place.eye;
        let base = eye.rotation * cluster.center + eye.center_in_cam;
        let [rx, ry, rz] = eye.rotation.transpose().to_cols_array_2d();
        let origin_x = eye.principal.x - place.column as f64 - 0.5;
        let origin_y = eye.principal.y - place.row as f64 - 0.5;
        let [ox, oy, oz] = content.offsets;
        let count = ox.len();
        let (oy, oz) = (&oy[..count], &oz[..count]);
        let (sx, sy) = (&mut self.x[..count], &mut self.y[..count]);
        let near = &mut self.nearness[..count];
        let mut nearest = f64::INFINITY;
        for i in 0..count {
            let offset = [f64::from(ox[i]), f64::from(oy[i]), f64::from(oz[i])];
            let along =
                |row: &[f64; 3]| row[0] * offset[0] + row[1] * offset[1] + row[2] * offset[2];
            let z = base.z + along(&rz);
            let inverse = 1.0 / z;
            #[allow(clippy::cast_possible_truncation, reason = "allowed for in the error")]
            {
                sx[i] = (eye.focal.x * (base.x + along(&rx)) * inverse + origin_x) as f32;
                sy[i] = (eye.focal.y * (base.y + along(&ry)) * inverse + origin_y) as f32;
                near[i] = inverse as f32;
            }
            nearest = if z < nearest { z } else { nearest };
        }
        if nearest <= 0.0 {
            return false;
        }
        let mut farthest = 0.0f32;
        for (x, y) in sx.iter().zip(sy.iter()) {
            let reach = if x.abs() > y.abs() { x.abs() } else { y.abs() };
            farthest = if reach > farthest { reach } else { farthest };
        }
        self.error = error(place, cluster, nearest, farthest);
        self.error < MOST_ERROR
    }
}

/// By how many samples a projected vertex may be off: its offset's rounding seen from the nearest
/// depth, the rounding of f64 coordinates, and that of f32 positions up to `farthest` samples away.
fn error(place: &Place<'_>, cluster: &Cluster, nearest: f64, farthest: f32) -> f32 {
    let eye = place.eye;
    let focal = eye.focal.max_element();
    let reach = eye.principal.abs().max_element() + (place.column + place.row + SIZE) as f64;
    let slope = 1.0 + (reach + f64::from(farthest)) / eye.focal.min_element();
    let scale = eye.center_in_cam.length() + cluster.center.length() + f64::from(cluster.radius);
    let offset = 1.1e-7 * f64::from(cluster.radius) + 2e-15 * scale;
    #[allow(
        clippy::cast_possible_truncation,
        reason = "a bound with room to spare"
    )]
    let projected = (focal * slope * offset / nearest + 1e-15 * reach) as f32;
    projected + 4.0 * ULP * (farthest + SIZE as f32)
}

/// Draws a cluster. `scratch` is working space.
pub(crate) fn draw(
    tile: &mut Tile,
    place: &Place<'_>,
    (cluster, content): (&Cluster, &Content<'_>),
    scratch: &mut Projected,
) {
    if !scratch.project(place, cluster, content) {
        for &triangle in content.triangles {
            near::draw(tile, place, triangle, WHOLE);
        }
        return;
    }
    for (corners, &triangle) in content.corners.iter().zip(content.triangles) {
        let corners = corners.map(usize::from);
        let xs = corners.map(|corner| scratch.x[corner]);
        let ys = corners.map(|corner| scratch.y[corner]);
        let (Some((left, right)), Some((top, bottom))) =
            (covered(xs, scratch.error), covered(ys, scratch.error))
        else {
            continue;
        };
        let from = Spot {
            column: left,
            row: top,
        };
        let to = Spot {
            column: right,
            row: bottom,
        };
        let nearness = corners.map(|corner| scratch.nearness[corner]);
        match Edges::new((xs, ys), nearness, scratch.error) {
            Some(edges) => edges.draw(tile, place, triangle, (from, to)),
            None => near::draw(tile, place, triangle, (from, to)),
        }
    }
}

/// First and last sample of the tile between three coordinates, `error` allowed for; `None` when
/// there is none.
fn covered([a, b, c]: [f32; 3], error: f32) -> Option<(usize, usize)> {
    const LAST: f32 = (SIZE - 1) as f32;
    let low = if a < b { a } else { b };
    let low = if c < low { c } else { low } - error;
    let high = if a > b { a } else { b };
    let high = if c > high { c } else { high } + error;
    if !(low <= LAST && high >= 0.0) {
        return None;
    }
    // Whole numbers upwards from `low`; at most one too many, never one too few.
    let first = if low > 0.0 { low + (1.0 - 1e-5) } else { 0.0 };
    let last = if high < LAST { high } else { LAST };
    #[allow(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "between 0 and SIZE"
    )]
    let (first, last) = (first as i32 as usize, last as i32 as usize);
    (first <= last).then_some((first, last))
}

/// Edge functions of a triangle: twice the areas that a sample spans with each edge, positive
/// inside. Divided by their sum they are the barycentric weights on the image.
#[derive(Debug, Clone, Copy)]
struct Edges {
    along_x: [f32; 3],
    along_y: [f32; 3],
    at_origin: [f32; 3],
    /// How far the functions may be off; inside or outside is clear beyond this.
    doubt: f32,
    /// Nearness at each corner, over the sum of the functions.
    nearness: [f32; 3],
}

impl Edges {
    /// `None` when f32 cannot tell the triangle's depth well enough.
    fn new((xs, ys): ([f32; 3], [f32; 3]), nearness: [f32; 3], error: f32) -> Option<Self> {
        let (ux, uy) = (xs[1] - xs[0], ys[1] - ys[0]);
        let (vx, vy) = (xs[2] - xs[0], ys[2] - ys[0]);
        let area = ux * vy - uy * vx;
        let extent = ux.abs() + uy.abs() + vx.abs() + vy.abs();
        let doubt = 3.0 * error * extent;
        let (low, high) = spread(nearness);
        // Inside, nearness is a mean of the corners', weighted by the functions.
        let uncertain = (high - low) * (4.0 * doubt);
        if !(area.abs() > 2.0 * doubt && uncertain < area.abs() * low * (0.2 * DOUBT)) {
            return None;
        }
        let sign = if area > 0.0 { 1.0 } else { -1.0 };
        let edge = |from: usize, to: usize| {
            let (dx, dy) = (sign * (xs[to] - xs[from]), sign * (ys[to] - ys[from]));
            (-dy, dx, dy * xs[from] - dx * ys[from])
        };
        let [a, b, c] = [edge(1, 2), edge(2, 0), edge(0, 1)];
        let scale = 1.0 / area.abs();
        Some(Self {
            along_x: [a.0, b.0, c.0],
            along_y: [a.1, b.1, c.1],
            at_origin: [a.2, b.2, c.2],
            doubt,
            nearness: nearness.map(|nearness| nearness * scale),
        })
    }

    /// Offers the triangle to all samples between two corners, both included.
    fn draw(&self, tile: &mut Tile, place: &Place<'_>, triangle: u32, (from, to): (Spot, Spot)) {
        for row in from.row..to.row + 1 {
            let y = row as f32;
            let start = [0, 1, 2].map(|edge| self.at_origin[edge] + self.along_y[edge] * y);
            for first in (from.column..to.column + 1).step_by(LANES) {
                let (least, nearness) = self.lanes(start, first as f32);
                for lane in 0..LANES.min(to.column + 1 - first) {
                    if least[lane] < -self.doubt {
                        continue;
                    }
                    let column = first + lane;
                    let spot = Spot { column, row };
                    let known = (least[lane] > self.doubt).then_some(nearness[lane]);
                    if known.is_none_or(|nearness| !tile.try_offer(spot, (triangle, nearness))) {
                        settle(tile, place, (spot, triangle), known);
                    }
                }
            }
        }
        tile.touch(from, to);
    }

    /// The least of the edge functions and the nearness at some samples from column `x` on of the
    /// row where the functions start with `start`.
    #[inline]
    fn lanes(&self, start: [f32; 3], x: f32) -> ([f32; LANES], [f32; LANES]) {
        let mut least = [0.0; LANES];
        let mut nearness = [0.0; LANES];
        for lane in 0..LANES {
            let x = x + lane as f32;
            let at = [0, 1, 2].map(|edge| start[edge] + self.along_x[edge] * x);
            let low = if at[0] < at[1] { at[0] } else { at[1] };
            least[lane] = if at[2] < low { at[2] } else { low };
            nearness[lane] =
                at[0] * self.nearness[0] + at[1] * self.nearness[1] + at[2] * self.nearness[2];
        }
        (least, nearness)
    }
}

/// Offers a triangle where f32 is in doubt about what is nearer or, without a known nearness, about
/// whether the sample sees the triangle at all.
#[cold]
fn settle(tile: &mut Tile, place: &Place<'_>, (spot, triangle): (Spot, u32), known: Option<f32>) {
    let direction = place
        .eye
        .direction(place.column + spot.column, place.row + spot.row);
    let exact = |triangle: u32| {
        let crossing = place.eye.frame.cross(triangle as usize, direction);
        crossing.map(|crossing| crossing.distance)
    };
    #[allow(clippy::cast_possible_truncation, reason = "well below DOUBT")]
    let nearness = known.or_else(|| exact(triangle).map(|distance| (1.0 / distance) as f32));
    if let Some(nearness) = nearness {
        tile.offer(spot, (triangle, nearness), exact);
    }
}

/// The least and the greatest of three.
fn spread([a, b, c]: [f32; 3]) -> (f32, f32) {
    let low = if a < b { a } else { b };
    let high = if a < b { b } else { a };
    (
        if c < low { c } else { low },
        if c > high { c } else { high },
    )
}
