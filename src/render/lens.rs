//! A tile's projection of clusters, in f32 with a known error.
//!
//! Positions are counted from the tile's first sample: the numerators of the projection are formed
//! for that origin in f64 per cluster, so that f32 is left with small numbers.

use super::clusters::{Cluster, Pack};
use super::eye::Eye;
use super::lanes::{LANES, Lanes};
use super::tile::{DOUBT, SIZE};
use glam::DVec3;

/// Rounding of one f32 number, relative, doubled.
pub(crate) const ULP: f32 = 1.2e-7;
/// Clusters whose vertices may be off by more samples than this are tested exactly.
const MOST_ERROR: f32 = 0.05;
/// Places for the vertices of a cluster: any u8 is one.
pub(crate) const PLACES: usize = 256;

/// Where a tile lies: the grid and its first sample there.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Place<'e> {
    pub(crate) eye: &'e Eye<'e>,
    pub(crate) column: usize,
    pub(crate) row: usize,
}

/// x · z, y · z and z of a point as linear functions of its coordinates, x and y being sample
/// centres counted from the tile's first.
#[derive(Debug)]
pub(crate) struct Lens {
    rows: [DVec3; 3],
    offsets: [f64; 3],
    narrow: [[f32; 3]; 3],
    /// Sums of the rows' absolute values.
    reach: [f64; 3],
    /// What rounding in f64 may add up to, per unit of the cluster's distance from the mesh's
    /// centre, and without any.
    rounding: [[f64; 2]; 3],
}

/// A cluster's vertices on a tile. Sample centres have whole numbers, (0, 0) the tile's first.
#[derive(Debug)]
pub(crate) struct Projected {
    pub(crate) x: [f32; PLACES],
    pub(crate) y: [f32; PLACES],
    /// 1 / z-depth.
    pub(crate) nearness: [f32; PLACES],
    /// By how many samples a vertex may be off.
    pub(crate) error: f32,
    /// Least x, greatest x, least y, greatest y.
    pub(crate) extent: [f32; 4],
}

impl Projected {
    pub(crate) fn new() -> Self {
        Self {
            x: [0.0; PLACES],
            y: [0.0; PLACES],
            nearness: [0.0; PLACES],
            error: 0.0,
            extent: [0.0; 4],
        }
    }
}

impl Lens {
    pub(crate) fn new(place: &Place<'_>) -> Self {
        let eye = place.eye;
        let [right, down, ahead] = [0, 1, 2].map(|row| eye.rotation.row(row));
        let shift = [
            eye.principal.x - place.column as f64 - 0.5,
            eye.principal.y - place.row as f64 - 0.5,
        ];
        let rows = [
            eye.focal.x * right + shift[0] * ahead,
            eye.focal.y * down + shift[1] * ahead,
            ahead,
        ];
        let center = eye.center_in_cam;
        let offsets = [
            eye.focal.x * center.x + shift[0] * center.z,
            eye.focal.y * center.y + shift[1] * center.z,
            center.z,
        ];
        let lever = [
            eye.focal.x + shift[0].abs(),
            eye.focal.y + shift[1].abs(),
            1.0,
        ];
        Self {
            rows,
            offsets,
            narrow: rows.map(|row| row.as_vec3().to_array()),
            reach: rows.map(|row| row.abs().element_sum()),
            rounding: lever.map(|lever| [2e-15 * lever, 2e-15 * lever * center.length()]),
        }
    }

    /// Projects a cluster; `false` when it comes too close to the camera, or behind it, for its
    /// projection to be of use.
    #[inline(always)]
    pub(crate) fn project<L: Lanes>(
        &self,
        l: L,
        (cluster, packs): (&Cluster, &[Pack]),
        to: &mut Projected,
    ) -> bool {
        let mut base = self.offsets;
        let zero = l.splat(0.0);
        let (mut from, mut rows) = ([zero; 3], [[zero; 3]; 3]);
        for k in 0..3 {
            base[k] += self.rows[k].dot(cluster.center);
            #[allow(clippy::cast_possible_truncation, reason = "allowed for in the error")]
            let narrow = base[k] as f32;
            from[k] = l.splat(narrow);
            for axis in 0..3 {
                rows[k][axis] = l.splat(self.narrow[k][axis]);
            }
        }
        let mut nearest = l.splat(f32::INFINITY);
        let mut low = [nearest; 2];
        let mut high = [l.splat(f32::NEG_INFINITY); 2];
        for (index, pack) in packs.iter().enumerate() {
            let offset = [l.load(&pack[0]), l.load(&pack[1]), l.load(&pack[2])];
            let z = along(l, &rows[2], &offset, from[2]);
            let near = l.div(l.splat(1.0), z);
            let mut at = [near; 2];
            for axis in 0..2 {
                at[axis] = l.mul(along(l, &rows[axis], &offset, from[axis]), near);
            }
            nearest = l.min(z, nearest);
            for axis in 0..2 {
                low[axis] = l.min(at[axis], low[axis]);
                high[axis] = l.max(at[axis], high[axis]);
            }
            put(&mut to.x, index, l.store(at[0]));
            put(&mut to.y, index, l.store(at[1]));
            put(&mut to.nearness, index, l.store(near));
        }
        let [left, top] = [least(l.store(low[0])), least(l.store(low[1]))];
        let [right, bottom] = [greatest(l.store(high[0])), greatest(l.store(high[1]))];
        to.extent = [left, right, top, bottom];
        self.judge(cluster, base, least(l.store(nearest)), to)
    }

    /// Works out by how many samples a projected vertex may be off: a few roundings of each linear
    /// function, seen from the nearest depth.
    #[inline(always)]
    fn judge(&self, cluster: &Cluster, base: [f64; 3], nearest: f32, to: &mut Projected) -> bool {
        let size = cluster.center.abs().element_sum() + f64::from(cluster.radius);
        let slack = [0, 1, 2].map(|k| {
            let sum = base[k].abs() + self.reach[k] * f64::from(cluster.radius);
            3.0 * f64::from(ULP) * sum + self.rounding[k][0] * size + self.rounding[k][1]
        });
        let nearest = f64::from(nearest) - slack[2];
        if !(nearest > 0.0 && slack[2] < f64::from(0.2 * DOUBT) * nearest) {
            return false;
        }
        let farthest = to.extent.iter().fold(0.0f32, |far, v| far.max(v.abs()));
        let projected = (slack[0].max(slack[1]) + f64::from(farthest) * slack[2]) / nearest;
        #[allow(
            clippy::cast_possible_truncation,
            reason = "a bound with room to spare"
        )]
        let projected = 1.05 * projected as f32;
        to.error = projected + 4.0 * ULP * (farthest + SIZE as f32);
        to.error < MOST_ERROR
    }
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

#[inline(always)]
fn least(values: [f32; LANES]) -> f32 {
    let mut least = values[0];
    for value in values {
        least = if value < least { value } else { least };
    }
    least
}

#[inline(always)]
fn greatest(values: [f32; LANES]) -> f32 {
    let mut greatest = values[0];
    for value in values {
        greatest = if value > greatest { value } else { greatest };
    }
    greatest
}
