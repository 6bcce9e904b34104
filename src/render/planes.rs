//! Triangles turned into linear functions of the pixel, in f64, for [`super::maps`].
//!
//! Along the ray (x, y, 1) the edge functions of [`super::triangle::Ray::cross`], v and w of two corners
//! and their total t with the third, are linear in x and y, and t · depth is the same everywhere on the
//! triangle. So all three are kept divided by that product: depth = 1 / t, weights = v · depth, w · depth.
//! They are set up where a pixel sees the triangle, as [`super::triangle`] would there.

use super::doubles::FOUR;
use super::lanes::{LANES, Lanes};
use super::maps::ROWS;
use super::row::{Line, in_doubt};
use super::surface::Frame;
use super::tile::{NONE, SIZE};
use super::triangle::THIN;
use crate::ahead::WORDS;

/// Half the distance from 1 to the next f64.
const UNIT: f64 = 0.5 * f64::EPSILON;

/// A triangle as seen from a tile.
#[derive(Debug, Clone, Copy)]
#[repr(align(64))]
pub(crate) struct Plane {
    /// v, w and t at the tile's first pixel; last, by how much, relative, the depth that follows from
    /// t may differ from the one that the exact test rounds to.
    pub(crate) at: [f64; 4],
    /// How they change with the direction's x and y.
    pub(crate) along: [[f64; 4]; 2],
    /// Unit normal, facing the camera, and one number more.
    pub(crate) normal: [f32; 4],
}

impl Plane {
    /// Stands for no triangle: depth, weights and normal are 0.
    pub(crate) const NONE: Self = Self {
        at: [0.0, 0.0, f64::INFINITY, 0.0],
        along: [[0.0; 4]; 2],
        normal: [0.0; 4],
    };
}

/// Directions of a tile's pixels, as far as the functions depend on them.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Window {
    /// x and y of the first pixel's direction.
    pub(crate) first: [f64; 2],
    /// How far x and y may be from there, and from 0.
    pub(crate) width: f64,
    pub(crate) reach: f64,
}

/// A triangle that has not been set up yet. Few bytes: one is written for each run of pixels, met before or not.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Pending {
    pub(crate) id: u32,
    /// Of a pixel that sees it: its column, and its row among those worked out together.
    pub(crate) column: u16,
    pub(crate) row: u16,
}

impl Pending {
    /// Stands for none.
    pub(crate) const NONE: Self = Self {
        id: NONE,
        column: 0,
        row: 0,
    };
}

/// Triangles to be set up together, side by side, in columns that begin where cache lines do.
#[repr(C, align(64))]
pub(crate) struct Fresh {
    /// Where a pixel sees each: x and y of its direction.
    pub(crate) spots: [[f64; SIZE]; 2],
    corners: [[f64; SIZE]; 9],
    at: [[f64; SIZE]; 4],
    along: [[[f64; SIZE]; 3]; 2],
    /// Between what the depths lie there.
    depths: [[f64; SIZE]; 2],
    weights: [[f64; SIZE]; 2],
    normals: [[f64; SIZE]; 3],
    pub(crate) count: usize,
}

impl Fresh {
    pub(crate) fn new() -> Self {
        Self {
            count: 0,
            spots: [[0.0; SIZE]; 2],
            corners: [[0.0; SIZE]; 9],
            at: [[0.0; SIZE]; 4],
            along: [[[0.0; SIZE]; 3]; 2],
            depths: [[0.0; SIZE]; 2],
            weights: [[0.0; SIZE]; 2],
            normals: [[0.0; SIZE]; 3],
        }
    }

    /// Takes over some triangles, at most [`SIZE`], with their vertices, seen by pixels whose columns and rows have
    /// these x and y of their directions.
    #[inline(always)]
    pub(crate) fn load<L: Lanes>(
        &mut self,
        l: L,
        frame: &Frame<'_>,
        (pending, vertices): (&[Pending], &[[u32; 3]]),
        (x, y): (&[f64; SIZE], &[f64; ROWS]),
    ) {
        self.count = pending.len().min(SIZE);
        for (index, one) in pending.iter().enumerate().take(SIZE) {
            self.spots[0][index] = x[usize::from(one.column) % SIZE];
            self.spots[1][index] = y[usize::from(one.row) % ROWS];
        }
        // Of fewer than eight, the last fills the rest.
        let vertices = |index: usize| vertices[index.min(vertices.len() - 1)];
        self.load_corners(l, frame, (0, self.count.next_multiple_of(LANES)), vertices);
    }

    /// Takes over corners, by their vertices, from one triangle up to another, four by four, as [`Frame::facet`] has
    /// them.
    #[inline(always)]
    pub(crate) fn load_corners<L: Lanes>(
        &mut self,
        l: L,
        frame: &Frame<'_>,
        (first, end): (usize, usize),
        corners_of: impl Fn(usize) -> [u32; 3],
    ) {
        let vertices = frame.mesh().vertices();
        let (rotation, center) = (frame.rotation().to_cols_array(), frame.center_in_cam());
        let (mut middle, mut axes) = ([l.splat_f64(0.0); 3], [l.splat_f64(0.0); 9]);
        let mut origin = middle;
        for k in 0..3 {
            middle[k] = l.splat_f64(frame.center()[k]);
            origin[k] = l.splat_f64(center[k]);
        }
        for k in 0..9 {
            axes[k] = l.splat_f64(rotation[k]);
        }
        for from in (first..end).step_by(FOUR) {
            let from = from.min(SIZE - FOUR);
            let mut four = [[0; 3]; FOUR];
            for (k, vertices) in four.iter_mut().enumerate() {
                *vertices = corners_of(from + k);
            }
            for corner in 0..3 {
                let at = |k: usize| &vertices[four[k][corner] as usize];
                let [x, y, z] = l.points([at(0), at(1), at(2), at(3)]);
                let x = l.sub_f64(x, middle[0]);
                let y = l.sub_f64(y, middle[1]);
                let z = l.sub_f64(z, middle[2]);
                for k in 0..3 {
                    let sum = l.add_f64(l.mul_f64(axes[k], x), l.mul_f64(axes[3 + k], y));
                    let turned = l.add_f64(sum, l.mul_f64(axes[6 + k], z));
                    self.corners[3 * corner + k][from..][..FOUR]
                        .copy_from_slice(&l.store_f64(l.add_f64(turned, origin[k])));
                }
            }
        }
    }

    /// Works out the functions. What is thin as seen from the tile, seen along its plane or not in front
    /// of the camera gets an infinite doubt, or none that is a number.
    ///
    /// The doubt: sheared corners are off by h, edge functions of a triangle of sheared size s by 4sh,
    /// which moves the depth by that over t of the corners' difference in depth, in both ways to
    /// compute it; the rest is a few roundings. An error of t where the plane was set up cancels.
    ///
    /// From one place up to another: whole lanes, where there is nothing beyond the last triangle that anybody looks
    /// at.
    #[inline(always)]
    pub(crate) fn set_up(&mut self, window: &Window, (first, end): (usize, usize)) {
        let end = end.min(SIZE);
        let [vs, ws, ts, doubts] = &mut self.at;
        let [[vx, wx, tx], [vy, wy, ty]] = &mut self.along;
        let [nx, ny, nz] = &mut self.normals;
        for i in first..end {
            let spot = [self.spots[0][i], self.spots[1][i]];
            let glimpse = Glimpse::new(corners_of(&self.corners, i), spot, window.reach);
            let ([v, w, t], normal) = (glimpse.functions, glimpse.normal);
            let scale = 1.0 / glimpse.volume;
            let edge = most(glimpse.size, glimpse.deep);
            let steep = normal[0].abs() + normal[1].abs();
            let lifted = (t.abs() + steep * window.width) * scale.abs();
            let turned = 48.0 * UNIT * edge * edge * window.width * glimpse.far;
            let doubt = (glimpse.moved() + turned) * scale.abs()
                + 32.0 * UNIT * (1.0 + glimpse.deep * lifted);
            doubts[i] = if glimpse.is_clear() {
                doubt
            } else {
                f64::INFINITY
            };
            // (x, y) counted from the tile's first pixel.
            let (dx, dy) = (spot[0] - window.first[0], spot[1] - window.first[1]);
            let [[a0, a1], [b0, b1], [c0, c1]] = glimpse.sheared;
            let [az, bz, cz] = glimpse.depths;
            let slopes = [
                [a1 * cz - az * c1, az * c0 - a0 * cz],
                [b1 * az - bz * a1, bz * a0 - b0 * az],
                [-normal[0], -normal[1]],
            ];
            vs[i] = (v - slopes[0][0] * dx - slopes[0][1] * dy) * scale;
            ws[i] = (w - slopes[1][0] * dx - slopes[1][1] * dy) * scale;
            ts[i] = (t - slopes[2][0] * dx - slopes[2][1] * dy) * scale;
            (vx[i], vy[i]) = (slopes[0][0] * scale, slopes[0][1] * scale);
            (wx[i], wy[i]) = (slopes[1][0] * scale, slopes[1][1] * scale);
            (tx[i], ty[i]) = (slopes[2][0] * scale, slopes[2][1] * scale);
            [nx[i], ny[i], nz[i]] = glimpse.unit_normal();
        }
    }

    /// Works out depth, weights and normals where the triangles are seen: depth = t · depth / t. The doubt is that of
    /// [`Self::set_up`] for a window of no width, times the depth.
    #[inline(always)]
    pub(crate) fn see(&mut self, reach: f64, (first, end): (usize, usize)) {
        let end = end.min(SIZE);
        let [low, high] = &mut self.depths;
        let [vs, ws] = &mut self.weights;
        let [nx, ny, nz] = &mut self.normals;
        for i in first..end {
            let spot = [self.spots[0][i], self.spots[1][i]];
            let glimpse = Glimpse::new(corners_of(&self.corners, i), spot, reach);
            let [v, w, t] = glimpse.functions;
            let over = 1.0 / t;
            let depth = glimpse.volume * over;
            let slack = glimpse.moved() * over.abs() + 32.0 * UNIT * (depth + glimpse.deep);
            let slack = if glimpse.is_clear() {
                slack
            } else {
                f64::INFINITY
            };
            (low[i], high[i]) = (depth - slack, depth + slack);
            (vs[i], ws[i]) = (v * over, w * over);
            [nx[i], ny[i], nz[i]] = glimpse.unit_normal();
        }
    }

    /// Writes what has been worked out where the triangles are seen. Returns, as bits, the pixels that the exact
    /// test has to decide.
    #[inline(always)]
    pub(crate) fn write<L: Lanes>(&self, l: L, line: &mut Line) -> u64 {
        let (depths, weights) = (&mut line.depth[WORDS..], &mut line.weights[WORDS..]);
        let normals = &mut line.normals[WORDS..];
        let mut doubtful = 0;
        for left in (0..SIZE).step_by(LANES) {
            let low = eight_of(&self.depths[0], left);
            let high = eight_of(&self.depths[1], left);
            depths[left..][..LANES].copy_from_slice(&low);
            doubtful |= u64::from(in_doubt(l, &low, &high)) << left;
            let v = l.load(&eight_of(&self.weights[0], left));
            let w = l.load(&eight_of(&self.weights[1], left));
            weights[2 * left..][..2 * LANES].copy_from_slice(l.pairs(v, w).as_flattened());
            let x = l.load(&eight_of(&self.normals[0], left));
            let y = l.load(&eight_of(&self.normals[1], left));
            let z = l.load(&eight_of(&self.normals[2], left));
            normals[3 * left..][..3 * LANES].copy_from_slice(l.triples(x, y, z).as_flattened());
        }
        doubtful
    }

    /// Puts what was worked out into `planes` from `first` on.
    #[inline(always)]
    pub(crate) fn put<L: Lanes>(&self, l: L, (planes, first): (&mut Vec<Plane>, usize)) {
        let end = first + self.count.next_multiple_of(FOUR);
        if planes.len() < end {
            planes.resize(end.next_multiple_of(SIZE), Plane::NONE);
        }
        for (index, four) in planes[first..end].chunks_exact_mut(FOUR).enumerate() {
            let from = FOUR * index;
            let at = l.transpose([
                four_of(l, &self.at[0], from),
                four_of(l, &self.at[1], from),
                four_of(l, &self.at[2], from),
                four_of(l, &self.at[3], from),
            ]);
            for k in 0..FOUR {
                four[k].at = l.store_f64(at[k]);
            }
            for axis in 0..2 {
                let along = l.transpose([
                    four_of(l, &self.along[axis][0], from),
                    four_of(l, &self.along[axis][1], from),
                    four_of(l, &self.along[axis][2], from),
                    l.splat_f64(0.0),
                ]);
                for k in 0..FOUR {
                    four[k].along[axis] = l.store_f64(along[k]);
                }
            }
            let normals = l.transpose([
                four_of(l, &self.normals[0], from),
                four_of(l, &self.normals[1], from),
                four_of(l, &self.normals[2], from),
                l.splat_f64(0.0),
            ]);
            for k in 0..FOUR {
                four[k].normal = l.round(normals[k]);
            }
        }
    }
}

/// A triangle where a pixel sees it.
struct Glimpse {
    /// Across its plane, as long as twice its area.
    normal: [f64; 3],
    length: f64,
    /// v, w and t, and t · depth.
    functions: [f64; 3],
    volume: f64,
    /// The corners, sheared, and their depths.
    sheared: [[f64; 2]; 3],
    depths: [f64; 3],
    /// Bounds, up to twice as large: of the depth of the farthest corner; of how far the corners lie apart in
    /// depth, and when sheared.
    far: f64,
    deep: f64,
    size: f64,
    /// As that of the window.
    reach: f64,
}

impl Glimpse {
    #[inline(always)]
    fn new([a, b, c]: [[f64; 3]; 3], [x, y]: [f64; 2], reach: f64) -> Self {
        let (ux, uy, uz) = (b[0] - a[0], b[1] - a[1], b[2] - a[2]);
        let (ox, oy, oz) = (c[0] - a[0], c[1] - a[1], c[2] - a[2]);
        let normal = [uy * oz - oy * uz, uz * ox - oz * ux, ux * oy - ox * uy];
        let square = normal[0] * normal[0] + normal[1] * normal[1] + normal[2] * normal[2];

        let (a0, a1) = (a[0] - x * a[2], a[1] - y * a[2]);
        let (b0, b1) = (b[0] - x * b[2], b[1] - y * b[2]);
        let (c0, c1) = (c[0] - x * c[2], c[1] - y * c[2]);
        let u = c0 * b1 - c1 * b0;
        let v = a0 * c1 - a1 * c0;
        let w = b0 * a1 - b1 * a0;
        let t = u + v + w;

        let deep = uz.abs() + oz.abs();
        let across = most(ux.abs() + ox.abs(), uy.abs() + oy.abs());
        Self {
            normal,
            length: square.sqrt(),
            functions: [v, w, t],
            volume: a[2] * t + v * uz + w * oz,
            sheared: [[a0, a1], [b0, b1], [c0, c1]],
            depths: [a[2], b[2], c[2]],
            far: a[2].abs() + deep,
            deep,
            size: across + reach * deep,
            reach,
        }
    }

    /// By how much roundings of the edge functions move the depth, times t.
    #[inline(always)]
    fn moved(&self) -> f64 {
        let sheared = UNIT * (self.reach * self.far + 2.0 * self.size);
        160.0 * self.size * sheared * self.deep
    }

    /// Whether it is before the camera, neither thin nor edge-on.
    #[inline(always)]
    fn is_clear(&self) -> bool {
        let [_, _, t] = self.functions;
        let least = self.far
            * most(
                4.0 * THIN * self.size * self.size,
                1e-12 * (1.0 + self.reach) * self.length,
            );
        self.volume.abs() > least && self.volume * t > 0.0
    }

    /// As glam's `normalize_or_zero`, then turned to the camera: t is minus the normal along the ray.
    #[inline(always)]
    fn unit_normal(&self) -> [f64; 3] {
        let [_, _, t] = self.functions;
        let unit = 1.0 / self.length;
        let usable = unit < f64::INFINITY && unit > 0.0;
        let unit = if usable { unit } else { 0.0 };
        let unit = if t < 0.0 { -unit } else { unit };
        let [x, y, z] = self.normal;
        [x * unit, y * unit, z * unit]
    }
}

/// The corners of one of the triangles whose columns are given: x, y and z of each.
#[inline(always)]
fn corners_of(columns: &[[f64; SIZE]; 9], i: usize) -> [[f64; 3]; 3] {
    let [ax, ay, az, bx, by, bz, cx, cy, cz] = columns;
    [
        [ax[i], ay[i], az[i]],
        [bx[i], by[i], bz[i]],
        [cx[i], cy[i], cz[i]],
    ]
}

/// Four of a column's numbers from one on, or the last four.
#[inline(always)]
fn four_of<L: Lanes>(l: L, column: &[f64; SIZE], from: usize) -> L::D {
    let mut four = [0.0; FOUR];
    four.copy_from_slice(&column[from.min(SIZE - FOUR)..][..FOUR]);
    l.load_f64(&four)
}

/// Eight of a column's numbers from one on, or the last eight, as f32.
#[inline(always)]
#[allow(clippy::cast_possible_truncation, reason = "maps are f32")]
fn eight_of(column: &[f64; SIZE], from: usize) -> [f32; LANES] {
    let mut eight = [0.0; LANES];
    let column = &column[from.min(SIZE - LANES)..];
    for (eight, &value) in eight.iter_mut().zip(column) {
        *eight = value as f32;
    }
    eight
}

/// The greater, without the care for NaN that costs `f64::max` its speed.
#[inline(always)]
fn most(a: f64, b: f64) -> f64 {
    if a > b { a } else { b }
}
