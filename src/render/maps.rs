//! Exact maps of what is visible at pixel centres, without colours.
//!
//! The visible triangle is intersected once more in f64, a row of a tile at a time, by the very
//! operations of [`super::triangle`]: whatever the fast test saw, depth and weights are its.

use super::Seen;
use super::clusters::Clusters;
use super::eye::Eye;
use super::lens::Place;
use super::scan::scan;
use super::surface::Frame;
use super::tile::{NONE, SIZE, Tile};
use super::triangle::THIN;
use crate::parallel;
use glam::{DMat3, DVec3};
use pulp::Arch;

/// Writes what each pixel of a view sees, row by row.
pub(crate) fn see(clusters: &Clusters, frame: &Frame<'_>, pixels: &mut Vec<Seen>) {
    let camera = frame.camera();
    let (width, height) = (camera.width() as usize, camera.height() as usize);
    let eye = Eye::new(*frame, 1);
    pixels.resize(width * height, Seen::NOTHING);
    parallel::for_each_chunk(pixels, width * SIZE, |band, pixels| {
        let row = band * SIZE;
        let rows = SIZE.min(height - row);
        for column in (0..width).step_by(SIZE) {
            let place = Place {
                eye: &eye,
                column,
                row,
            };
            let columns = SIZE.min(width - column);
            let tile = scan(clusters, &place, (columns, rows));
            resolve(
                (&place, &tile),
                (columns, rows),
                (&mut pixels[column..], width),
            );
        }
    });
}

/// Writes the pixels of a tile; `pixels` starts with its first.
fn resolve(
    (place, tile): (&Place<'_>, &Tile),
    (columns, rows): (usize, usize),
    (pixels, stride): (&mut [Seen], usize),
) {
    let mut row = Row::new(place);
    for index in 0..rows {
        let ids = tile.row(index, columns);
        let pixels = &mut pixels[index * stride..][..columns];
        if ids.iter().all(|&id| id == NONE) {
            pixels.fill(Seen::NOTHING);
            continue;
        }
        row.y = place.eye.direction(place.column, place.row + index).y;
        row.meet(&place.eye.frame, ids);
        Arch::new().dispatch(
            #[inline(always)]
            || {
                row.fetch(ids);
                row.cross();
                row.store(&place.eye.frame, ids, pixels);
            },
        );
    }
}

/// A triangle in the camera frame: its corners, its unit normal.
type Flat = [f64; 12];

/// Slots of the memory of triangles that have been met.
const SLOTS: usize = 256;

/// One row of a tile: the corners of each sample's triangle in the camera frame, and where they are
/// crossed.
struct Row {
    /// Directions of the samples, at depth 1.
    x: [f64; SIZE],
    y: f64,
    corners: [[f64; SIZE]; 9],
    /// z-depth and the weights of the second and third corner.
    depth: [f64; SIZE],
    weights: [[f64; SIZE]; 2],
    /// Negative where the triangle is thin as seen here.
    clear: [f64; SIZE],
    /// The triangles met, and of each sample which one that is.
    flats: Vec<Flat>,
    places: [u32; SIZE],
    /// Triangles met of late, by their number, with their place in `flats`.
    met: [(u32, u32); SLOTS],
    fresh: Fresh,
}

impl Row {
    fn new(place: &Place<'_>) -> Self {
        let direction = |column: usize| place.eye.direction(place.column + column, place.row);
        Self {
            x: std::array::from_fn(|column| direction(column).x),
            y: 0.0,
            corners: [[0.0; SIZE]; 9],
            depth: [0.0; SIZE],
            weights: [[0.0; SIZE]; 2],
            clear: [0.0; SIZE],
            flats: Vec::with_capacity(SIZE),
            places: [0; SIZE],
            met: [(NONE, 0); SLOTS],
            fresh: Fresh::new(),
        }
    }

    /// Works out the triangles that have not been met of late.
    fn meet(&mut self, frame: &Frame<'_>, ids: &[u32]) {
        let fresh = &mut self.fresh;
        fresh.count = 0;
        let mut before = (NONE, 0);
        for (column, &id) in ids.iter().enumerate() {
            if id == NONE {
                self.places[column] = 0;
                continue;
            }
            if id != before.0 {
                before = self.met[id as usize % SLOTS];
                if before.0 != id {
                    #[allow(clippy::cast_possible_truncation, reason = "at most 4096")]
                    let place = (self.flats.len() + fresh.count) as u32;
                    before = (id, place);
                    self.met[id as usize % SLOTS] = before;
                    fresh.add(id);
                }
            }
            self.places[column] = before.1;
        }
        fresh.load(frame);
        let (rotation, center) = (frame.rotation(), frame.center_in_cam());
        Arch::new().dispatch(
            #[inline(always)]
            || fresh.turn(&rotation, center),
        );
        for index in 0..fresh.count {
            self.flats.push(fresh.flat(index));
        }
    }

    /// Puts the corners of each sample's triangle side by side.
    #[inline(always)]
    fn fetch(&mut self, ids: &[u32]) {
        for (column, &place) in self.places[..ids.len()].iter().enumerate() {
            let flat = &self.flats[place as usize];
            for (corners, &value) in self.corners.iter_mut().zip(flat) {
                corners[column % SIZE] = value;
            }
        }
    }

    /// [`super::triangle::Ray::cross`] for rays with z = 1, sample by sample.
    #[inline(always)]
    fn cross(&mut self) {
        let y = self.y;
        let [ax, ay, az, bx, by, bz, cx, cy, cz] = &self.corners;
        for i in 0..SIZE {
            let x = self.x[i];
            let (a0, a1) = (ax[i] - x * az[i], ay[i] - y * az[i]);
            let (b0, b1) = (bx[i] - x * bz[i], by[i] - y * bz[i]);
            let (c0, c1) = (cx[i] - x * cz[i], cy[i] - y * cz[i]);
            let u = c0 * b1 - c1 * b0;
            let v = a0 * c1 - a1 * c0;
            let w = b0 * a1 - b1 * a0;
            let total = u + v + w;
            let (second, third) = (v / total, w / total);
            let depth = (1.0 - second - third) * az[i] + second * bz[i] + third * cz[i];
            let ab = (a0 - b0) * (a0 - b0) + (a1 - b1) * (a1 - b1);
            let bc = (b0 - c0) * (b0 - c0) + (b1 - c1) * (b1 - c1);
            let ca = (c0 - a0) * (c0 - a0) + (c1 - a1) * (c1 - a1);
            let longest = if ab > bc { ab } else { bc };
            let longest = if longest > ca { longest } else { ca };
            self.depth[i] = depth;
            self.weights[0][i] = second;
            self.weights[1][i] = third;
            let thin = THIN * longest;
            self.clear[i] = if total.abs() < thin { -1.0 } else { 1.0 };
        }
    }

    #[inline(always)]
    fn store(&self, frame: &Frame<'_>, ids: &[u32], pixels: &mut [Seen]) {
        for (column, (&id, pixel)) in ids.iter().zip(pixels).enumerate() {
            if id == NONE {
                *pixel = Seen::NOTHING;
                continue;
            }
            let direction = DVec3::new(self.x[column], self.y, 1.0);
            let (mut depth, mut weights) = (
                self.depth[column],
                [self.weights[0][column], self.weights[1][column]],
            );
            if self.clear[column] < 0.0
                && let Some(crossing) = frame.cross(id as usize, direction)
            {
                (depth, weights) = (crossing.distance, crossing.weights);
            }
            let flat = &self.flats[self.places[column] as usize];
            let normal = DVec3::new(flat[9], flat[10], flat[11]);
            let facing = if normal.dot(direction) > 0.0 {
                -normal
            } else {
                normal
            };
            #[allow(clippy::cast_possible_truncation, reason = "maps are f32")]
            {
                *pixel = Seen {
                    triangle: id,
                    depth: depth as f32,
                    normal: facing.as_vec3().to_array(),
                    weights: [weights[0] as f32, weights[1] as f32],
                };
            }
        }
    }
}

/// Triangles met for the first time, to be turned into the camera frame together.
struct Fresh {
    count: usize,
    ids: [u32; SIZE],
    corners: [[f64; SIZE]; 9],
    normals: [[f64; SIZE]; 3],
}

impl Fresh {
    fn new() -> Self {
        Self {
            count: 0,
            ids: [0; SIZE],
            corners: [[0.0; SIZE]; 9],
            normals: [[0.0; SIZE]; 3],
        }
    }

    fn add(&mut self, id: u32) {
        self.ids[self.count] = id;
        self.count += 1;
    }

    /// Fetches the corners, counted from the mesh's centre; all indices first, so that many reads
    /// are on their way from memory at once.
    fn load(&mut self, frame: &Frame<'_>) {
        let mut vertices = [[0; 3]; SIZE];
        for (vertices, &id) in vertices.iter_mut().zip(&self.ids[..self.count]) {
            *vertices = frame.vertices_of(id as usize);
        }
        for (index, vertices) in vertices[..self.count].iter().enumerate() {
            for (corner, &vertex) in vertices.iter().enumerate() {
                let position = frame.offset_of(vertex);
                self.corners[3 * corner][index] = position.x;
                self.corners[3 * corner + 1][index] = position.y;
                self.corners[3 * corner + 2][index] = position.z;
            }
        }
    }

    /// [`Frame::facet`], triangle by triangle.
    #[inline(always)]
    fn turn(&mut self, rotation: &DMat3, center: DVec3) {
        let [rx, ry, rz] = [rotation.x_axis, rotation.y_axis, rotation.z_axis];
        let count = self.count;
        for corner in 0..3 {
            let [px, py, pz] = &mut self.corners[3 * corner..3 * corner + 3] else {
                return;
            };
            for i in 0..count {
                let (x, y, z) = (px[i], py[i], pz[i]);
                px[i] = rx.x * x + ry.x * y + rz.x * z + center.x;
                py[i] = rx.y * x + ry.y * y + rz.y * z + center.y;
                pz[i] = rx.z * x + ry.z * y + rz.z * z + center.z;
            }
        }
        let [ax, ay, az, bx, by, bz, cx, cy, cz] = &self.corners;
        let [nx, ny, nz] = &mut self.normals;
        for i in 0..count {
            let (ux, uy, uz) = (bx[i] - ax[i], by[i] - ay[i], bz[i] - az[i]);
            let (vx, vy, vz) = (cx[i] - ax[i], cy[i] - ay[i], cz[i] - az[i]);
            let (x, y, z) = (uy * vz - vy * uz, uz * vx - vz * ux, ux * vy - vx * uy);
            let scale = 1.0 / (x * x + y * y + z * z).sqrt();
            // As glam's `normalize_or_zero`.
            let usable = scale < f64::INFINITY && scale > 0.0;
            nx[i] = if usable { x * scale } else { 0.0 };
            ny[i] = if usable { y * scale } else { 0.0 };
            nz[i] = if usable { z * scale } else { 0.0 };
        }
    }

    fn flat(&self, index: usize) -> Flat {
        let mut flat = [0.0; 12];
        for (value, column) in flat
            .iter_mut()
            .zip(self.corners.iter().chain(&self.normals))
        {
            *value = column[index];
        }
        flat
    }
}
