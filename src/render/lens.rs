//! A tile's projection of clusters, in f32 with a known error.
//!
//! The projection is set up in f64 for each cluster, for positions counted from where the cluster's
//! centre is seen, so that f32 is left with small numbers and one rounding on the tile.

#![allow(
    clippy::needless_range_loop,
    reason = "columns are walked side by side, and closures would leave the instruction set"
)]

use super::cluster::Cluster;
use super::eye::Eye;
use super::lanes::{LANES, Lanes};
use super::tile::DOUBT;
use glam::{DMat3, DVec2, DVec3};

/// Rounding of one f32 number, relative, doubled.
pub(crate) const ULP: f32 = 1.2e-7;
/// Clusters whose vertices may be off by more samples than this are tested exactly.
const MOST_ERROR: f32 = 0.05;
/// By how much the place of a sample behind a lens may be off: the rounding of a number up to 128.
pub(crate) const SAMPLE_ERROR: f32 = 1e-5;
/// Places for the vertices of a cluster: any u8 is one.
pub(crate) const PLACES: usize = super::lanes::TABLE;

/// Vertices that [`Lanes::gather`] calls few.
const FEW: usize = 64;

/// Where a tile lies: the grid and its first sample there.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Place<'e> {
    pub(crate) eye: &'e Eye<'e>,
    pub(crate) column: usize,
    pub(crate) row: usize,
}

/// Where a tile's samples lie on the plane at depth 1: sample (0, 0), the first, at -shift / focal.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Grid {
    pub(crate) focal: DVec2,
    pub(crate) shift: DVec2,
}

impl Grid {
    /// The samples of a pinhole from a place on.
    pub(crate) fn of(place: &Place<'_>) -> Self {
        let first = DVec2::new(place.column as f64, place.row as f64) + 0.5;
        Self {
            focal: place.eye.focal,
            shift: place.eye.principal - first,
        }
    }
}

/// x · z, y · z and z of a point as linear functions of its coordinates, x and y being sample
/// centres counted from the tile's first.
#[derive(Debug)]
pub(crate) struct Lens {
    rows: [DVec3; 3],
    offsets: [f64; 3],
    /// What rounding in f64 may add up to, per unit of the cluster's distance from the mesh's
    /// centre, and without any.
    rounding: [[f64; 2]; 3],
}

/// A cluster's vertices on a tile. Sample centres have whole numbers, (0, 0) the tile's first. Vectors of them
/// begin where cache lines do: else each would be fetched from two.
#[derive(Debug)]
#[repr(C, align(64))]
pub(crate) struct Projected {
    pub(crate) x: [f32; PLACES],
    pub(crate) y: [f32; PLACES],
    /// 1 / z-depth.
    pub(crate) nearness: [f32; PLACES],
    /// Between which columns and rows of samples a vertex lies: see [`Self::find_cells`].
    pub(crate) cells: [[u16; PLACES]; 2],
    /// By how many samples a vertex may be off.
    pub(crate) error: f32,
    /// Least x, greatest x, least y, greatest y.
    pub(crate) extent: [f32; 4],
    /// How far samples are from whole numbers at most.
    pub(crate) away: f32,
    /// The tile's last column and row.
    pub(crate) last: [f32; 2],
    /// Whether there are at most 64 vertices.
    pub(crate) few: bool,
}

impl Projected {
    /// For a tile of `width` × `height` samples.
    pub(crate) fn new(away: f32, (width, height): (usize, usize)) -> Self {
        Self {
            x: [0.0; PLACES],
            y: [0.0; PLACES],
            nearness: [0.0; PLACES],
            error: 0.0,
            extent: [0.0; 4],
            away,
            last: [(width - 1) as f32, (height - 1) as f32],
            few: false,
            cells: [[0; PLACES]; 2],
        }
    }

    /// Notes for the first vertices, per axis, the first sample that is not before a vertex, and in the high
    /// byte 255 less the first that is beyond it; what it may be off is allowed for. So a triangle may cover
    /// some sample if the least of both bytes among its corners add up to less than 255.
    #[inline(always)]
    pub(crate) fn find_cells<L: Lanes>(&mut self, l: L, packs: usize) {
        let error = l.splat(self.error + self.away);
        let (zero, one) = (l.splat(0.0), l.splat(1.0));
        let [xs, ys] = &mut self.cells;
        let [last_x, last_y] = self.last;
        for (at, cells, last) in [(&self.x, xs, last_x), (&self.y, ys, last_y)] {
            let (last, end) = (l.splat(last), l.splat(last + 1.0));
            let (at, _) = at.as_chunks();
            let (cells, _) = cells.as_chunks_mut();
            for (at, cells) in at.iter().zip(cells).take(packs) {
                let at = l.load(at);
                let first = l.ceil(l.max(l.sub(at, error), zero));
                let beyond = l.add(l.floor(l.min(l.add(at, error), last)), one);
                let (first, beyond) = (l.min(first, end), l.max(beyond, zero));
                let code = l.mul_add(l.sub(l.splat(255.0), beyond), l.splat(256.0), first);
                *cells = l.shorts(code);
            }
        }
    }
}

impl Lens {
    /// The lens of a camera to which the mesh's frame is turned by a rotation, and where it has the mesh's
    /// centre.
    pub(crate) fn new((rotation, center): (DMat3, DVec3), grid: &Grid) -> Self {
        let [right, down, ahead] = [0, 1, 2].map(|row| rotation.row(row));
        let Grid { focal, shift } = *grid;
        let rows = [
            focal.x * right + shift.x * ahead,
            focal.y * down + shift.y * ahead,
            ahead,
        ];
        let offsets = [
            focal.x * center.x + shift.x * center.z,
            focal.y * center.y + shift.y * center.z,
            center.z,
        ];
        let lever = [focal.x + shift.x.abs(), focal.y + shift.y.abs(), 1.0];
        Self {
            rows,
            offsets,
            rounding: lever.map(|lever| [2e-15 * lever, 2e-15 * lever * center.length()]),
        }
    }

    /// Projects a cluster; `false` when it comes too close to the camera, or behind it, for its
    /// projection to be of use.
    #[inline(always)]
    pub(crate) fn project<L: Lanes>(
        &self,
        l: L,
        cluster: &Cluster<'_>,
        to: &mut Projected,
    ) -> bool {
        let mut base = self.offsets;
        for k in 0..3 {
            base[k] += self.rows[k].dot(cluster.center);
        }
        let middle = [base[0] / base[2], base[1] / base[2]];
        let zero = l.splat(0.0);
        let (mut rows, mut start) = ([[zero; 3]; 2], [zero; 2]);
        let mut steep = [0.0; 2];
        let mut ahead = [zero; 3];
        #[allow(clippy::cast_possible_truncation, reason = "allowed for in the error")]
        for axis in 0..3 {
            ahead[axis] = l.splat(self.rows[2][axis] as f32);
            for k in 0..2 {
                let slope = self.rows[k][axis] - middle[k] * self.rows[2][axis];
                steep[k] += slope.abs();
                rows[k][axis] = l.splat(slope as f32);
                start[k] = l.splat(middle[k] as f32);
            }
        }
        #[allow(clippy::cast_possible_truncation, reason = "allowed for in the error")]
        let depth = l.splat(base[2] as f32);
        let mut nearest = l.splat(f32::INFINITY);
        let mut low = [nearest; 2];
        let mut high = [l.splat(f32::NEG_INFINITY); 2];
        for (index, pack) in cluster.packs.iter().enumerate() {
            let offset = [load(l, pack, 0), load(l, pack, 1), load(l, pack, 2)];
            let z = along(l, &ahead, &offset, depth);
            let near = l.div(l.splat(1.0), z);
            let mut at = start;
            for k in 0..2 {
                at[k] = l.mul_add(along(l, &rows[k], &offset, zero), near, start[k]);
                low[k] = l.min(at[k], low[k]);
                high[k] = l.max(at[k], high[k]);
            }
            nearest = l.min(z, nearest);
            put(&mut to.x, index, l.store(at[0]));
            put(&mut to.y, index, l.store(at[1]));
            put(&mut to.nearness, index, l.store(near));
        }
        let [left, top] = [l.least(low[0]), l.least(low[1])];
        let [right, bottom] = [l.greatest(high[0]), l.greatest(high[1])];
        to.few = cluster.packs.len() * LANES <= FEW;
        to.extent = [left, right, top, bottom];
        self.judge(cluster, (base[2], middle, steep), l.least(nearest), to)
    }

    /// Works out by how many samples a projected vertex may be off: a few roundings of each linear
    /// function, seen from the nearest depth, and two of the position on the tile.
    #[inline(always)]
    fn judge(
        &self,
        cluster: &Cluster<'_>,
        (depth, middle, steep): (f64, [f64; 2], [f64; 2]),
        nearest: f32,
        to: &mut Projected,
    ) -> bool {
        let radius = f64::from(cluster.radius);
        let size = cluster.center.abs().element_sum() + radius;
        let slack_z = 3.0 * f64::from(ULP) * (depth.abs() + 1.8 * radius)
            + self.rounding[2][0] * size
            + self.rounding[2][1];
        let nearest = f64::from(nearest) - slack_z;
        if !(nearest > 0.0 && slack_z < f64::from(0.2 * DOUBT) * nearest) {
            return false;
        }
        let mut slack = 0.0f64;
        for k in 0..2 {
            let wide = self.rounding[k][0] + middle[k].abs() * self.rounding[2][0];
            let fixed = self.rounding[k][1] + middle[k].abs() * self.rounding[2][1];
            slack = slack.max(3.0 * f64::from(ULP) * steep[k] * radius + wide * size + fixed);
        }
        let [left, right, top, bottom] = to.extent.map(f64::from);
        let [x, y] = middle;
        let across = (left - x).abs().max((right - x).abs());
        let across = across.max((top - y).abs()).max((bottom - y).abs());
        let farthest = left.abs().max(right.abs()).max(top.abs()).max(bottom.abs());
        let projected = (slack + across * slack_z) / nearest;
        let rounded = f64::from(ULP) * (farthest + x.abs().max(y.abs()) + across);
        #[allow(
            clippy::cast_possible_truncation,
            reason = "a bound with room to spare"
        )]
        let mut error = (1.05 * (projected + rounded)) as f32;
        if to.away > 0.0 {
            error += SAMPLE_ERROR;
        }
        to.error = error;
        error < MOST_ERROR
    }
}

#[inline(always)]
fn load<L: Lanes>(l: L, pack: &[f32; 3 * LANES], axis: usize) -> L::V {
    let mut values = [0.0; LANES];
    values.copy_from_slice(&pack[axis * LANES..][..LANES]);
    l.load(&values)
}

/// A linear function of three coordinates.
#[inline(always)]
fn along<L: Lanes>(l: L, row: &[L::V; 3], offset: &[L::V; 3], from: L::V) -> L::V {
    let sum = l.mul_add(row[0], offset[0], from);
    l.mul_add(row[2], offset[2], l.mul_add(row[1], offset[1], sum))
}

#[inline(always)]
fn put(column: &mut [f32; PLACES], index: usize, values: [f32; LANES]) {
    if let Some(lanes) = column[index * LANES..].first_chunk_mut() {
        *lanes = values;
    }
}
