//! Triangles turned into linear functions of the pixel, in f64, for [`super::maps`].
//!
//! Along the ray (x, y, 1) the edge functions of [`super::triangle::Ray::cross`], v and w of two corners
//! and their total t with the third, are linear in x and y, and t · depth is the same everywhere on the
//! triangle. So all three are kept divided by that product: depth = 1 / t, weights = v · depth, w · depth.
//! They are set up where a pixel sees the triangle, as [`super::triangle`] would there.

use super::doubles::FOUR;
use super::lanes::{LANES, Lanes};
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

/// A triangle that has not been set up yet.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Pending {
    pub(crate) id: u32,
    /// x and y of the direction of a pixel that sees it.
    pub(crate) spot: [f64; 2],
    pub(crate) vertices: [u32; 3],
}

impl Pending {
    /// Stands for none.
    pub(crate) const NONE: Self = Self {
        id: NONE,
        spot: [0.0; 2],
        vertices: [0; 3],
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
            normals: [[0.0; SIZE]; 3],
        }
    }

    /// Takes over some triangles, at most [`SIZE`].
    #[inline(always)]
    pub(crate) fn load<L: Lanes>(&mut self, l: L, frame: &Frame<'_>, pending: &[Pending]) {
        self.count = pending.len().min(SIZE);
        for (index, one) in pending.iter().enumerate().take(SIZE) {
            self.spots[0][index] = one.spot[0];
            self.spots[1][index] = one.spot[1];
        }
        // Of fewer than four, the last fills the rest.
        let vertices = |index: usize| pending[index.min(pending.len() - 1)].vertices;
        self.load_corners(l, frame, (0, self.count), vertices);
    }

    /// Takes over corners, by their vertices, from one triangle up to another, as [`Frame::facet`] has them; up to
    /// three beyond, too.
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
                let mut positions = [l.splat_f64(0.0); FOUR];
                for k in 0..FOUR {
                    let position = vertices[four[k][corner] as usize];
                    positions[k] = l.load_f64(&[position.x, position.y, position.z, 0.0]);
                }
                let [x, y, z, _] = l.transpose(positions);
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
    /// Without `SLOPES` only their values where the triangles are seen. From one place up to another: whole lanes,
    /// where there is nothing beyond the last triangle that anybody looks at.
    #[inline(always)]
    pub(crate) fn set_up<const SLOPES: bool>(
        &mut self,
        window: &Window,
        (first, end): (usize, usize),
    ) {
        let end = end.min(SIZE);
        let [ax, ay, az, bx, by, bz, cx, cy, cz] = &self.corners;
        let [vs, ws, ts, doubts] = &mut self.at;
        let [[vx, wx, tx], [vy, wy, ty]] = &mut self.along;
        let [nx, ny, nz] = &mut self.normals;
        for i in first..end {
            let (x, y) = (self.spots[0][i], self.spots[1][i]);
            let (ux, uy, uz) = (bx[i] - ax[i], by[i] - ay[i], bz[i] - az[i]);
            let (ox, oy, oz) = (cx[i] - ax[i], cy[i] - ay[i], cz[i] - az[i]);
            let normal = [uy * oz - oy * uz, uz * ox - oz * ux, ux * oy - ox * uy];
            let square = normal[0] * normal[0] + normal[1] * normal[1] + normal[2] * normal[2];
            let length = square.sqrt();

            let (a0, a1) = (ax[i] - x * az[i], ay[i] - y * az[i]);
            let (b0, b1) = (bx[i] - x * bz[i], by[i] - y * bz[i]);
            let (c0, c1) = (cx[i] - x * cz[i], cy[i] - y * cz[i]);
            let u = c0 * b1 - c1 * b0;
            let v = a0 * c1 - a1 * c0;
            let w = b0 * a1 - b1 * a0;
            let t = u + v + w;
            let volume = az[i] * t + v * uz + w * oz;
            let scale = 1.0 / volume;

            let far = most(most(az[i].abs(), bz[i].abs()), cz[i].abs());
            let deep = most(most(uz.abs(), oz.abs()), (oz - uz).abs());
            let wide = most(most(ux.abs(), ox.abs()), (ox - ux).abs());
            let high = most(most(uy.abs(), oy.abs()), (oy - uy).abs());
            let size = most(wide, high) + window.reach * deep;
            let sheared = UNIT * (window.reach * far + 2.0 * size);
            let edge = most(size, deep);
            let steep = normal[0].abs() + normal[1].abs();
            let lifted = (t.abs() + steep * window.width) * scale.abs();
            let doubt = (160.0 * size * sheared * deep
                + 48.0 * UNIT * edge * edge * window.width * far)
                * scale.abs()
                + 32.0 * UNIT * (1.0 + deep * lifted);
            // How small t · depth may be for the triangle to be neither thin nor edge-on.
            let least = far
                * most(
                    4.0 * THIN * size * size,
                    1e-12 * (1.0 + window.reach) * length,
                );
            let clear = volume.abs() > least && volume * t > 0.0;

            doubts[i] = if clear { doubt } else { f64::INFINITY };
            if SLOPES {
                // (x, y) counted from the tile's first pixel.
                let (dx, dy) = (x - window.first[0], y - window.first[1]);
                let slopes = [
                    [a1 * cz[i] - az[i] * c1, az[i] * c0 - a0 * cz[i]],
                    [b1 * az[i] - bz[i] * a1, bz[i] * a0 - b0 * az[i]],
                    [-normal[0], -normal[1]],
                ];
                vs[i] = (v - slopes[0][0] * dx - slopes[0][1] * dy) * scale;
                ws[i] = (w - slopes[1][0] * dx - slopes[1][1] * dy) * scale;
                ts[i] = (t - slopes[2][0] * dx - slopes[2][1] * dy) * scale;
                (vx[i], vy[i]) = (slopes[0][0] * scale, slopes[0][1] * scale);
                (wx[i], wy[i]) = (slopes[1][0] * scale, slopes[1][1] * scale);
                (tx[i], ty[i]) = (slopes[2][0] * scale, slopes[2][1] * scale);
            } else {
                (vs[i], ws[i], ts[i]) = (v * scale, w * scale, t * scale);
            }

            // As glam's `normalize_or_zero`, then turned to the camera: t is minus the normal along
            // the ray.
            let unit = 1.0 / length;
            let usable = unit < f64::INFINITY && unit > 0.0;
            let unit = if usable { unit } else { 0.0 };
            let side = if t < 0.0 { -1.0 } else { 1.0 };
            nx[i] = normal[0] * unit * side;
            ny[i] = normal[1] * unit * side;
            nz[i] = normal[2] * unit * side;
        }
    }

    /// Writes the pixels' depth, weights and normals, each pixel's triangle having been worked out where it
    /// sees it. Returns, as bits, those that the exact test has to decide.
    #[inline(always)]
    pub(crate) fn write<L: Lanes>(&self, l: L, line: &mut Line) -> u64 {
        let (depths, weights) = (&mut line.depth[WORDS..], &mut line.weights[WORDS..]);
        let normals = &mut line.normals[WORDS..];
        let one = l.splat_f64(1.0);
        let mut doubtful = 0;
        for left in (0..SIZE).step_by(LANES) {
            let (mut low, mut high) = ([0.0; LANES], [0.0; LANES]);
            for half in [0, FOUR] {
                let first = left + half;
                let [v, w, t, doubt] = [
                    four_of(l, &self.at[0], first),
                    four_of(l, &self.at[1], first),
                    four_of(l, &self.at[2], first),
                    four_of(l, &self.at[3], first),
                ];
                let depth = l.div_f64(one, t);
                let slack = l.mul_f64(depth, doubt);
                low[half..half + FOUR].copy_from_slice(&l.round(l.sub_f64(depth, slack)));
                high[half..half + FOUR].copy_from_slice(&l.round(l.add_f64(depth, slack)));
                let pairs = l.round_pairs(l.mul_f64(v, depth), l.mul_f64(w, depth));
                weights[2 * first..][..2 * FOUR].copy_from_slice(pairs.as_flattened());
                let turned = l.transpose([
                    four_of(l, &self.normals[0], first),
                    four_of(l, &self.normals[1], first),
                    four_of(l, &self.normals[2], first),
                    one,
                ]);
                for k in 0..FOUR {
                    // The fourth number is written over next.
                    normals[3 * (first + k)..][..FOUR].copy_from_slice(&l.round(turned[k]));
                }
            }
            depths[left..left + LANES].copy_from_slice(&low);
            doubtful |= u64::from(in_doubt(l, &low, &high)) << left;
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

/// Four of a column's numbers from one on, or the last four.
#[inline(always)]
fn four_of<L: Lanes>(l: L, column: &[f64; SIZE], from: usize) -> L::D {
    let mut four = [0.0; FOUR];
    four.copy_from_slice(&column[from.min(SIZE - FOUR)..][..FOUR]);
    l.load_f64(&four)
}

/// The greater, without the care for NaN that costs `f64::max` its speed.
#[inline(always)]
fn most(a: f64, b: f64) -> f64 {
    if a > b { a } else { b }
}
