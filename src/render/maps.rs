//! Exact maps of what is visible at pixel centres, without colours.
//!
//! As soon as a tile's visibility is known, its triangles are set up in f64 ([`super::planes`]), each
//! once, and a pixel costs a few products and one division. A depth that lies so close to the border
//! between two f32 that this could round to the other one is worked out by the exact test.

#![allow(
    clippy::needless_range_loop,
    reason = "columns are walked side by side, and closures would leave the instruction set"
)]

use super::Seen;
use super::clusters::Clusters;
use super::eye::Eye;
use super::lanes::{LANES, Lanes, Task, dispatch};
use super::lens::Place;
use super::planes::{Fresh, Pending, Plane, Window};
use super::row::{Cross, Line};
use super::scan::scan;
use super::surface::Frame;
use super::tile::{NONE, SIZE, Tile};
use crate::ahead::{prefetch, prefetch_all};
use crate::parallel;
use glam::DVec3;

/// Rows of a tile that are worked out together.
pub(super) const ROWS: usize = 8;

/// Writes what each pixel of a view sees, row by row.
pub(crate) fn see(clusters: &Clusters, frame: &Frame<'_>, seen: &mut Seen) {
    let camera = frame.camera();
    let (width, height) = (camera.width() as usize, camera.height() as usize);
    let eye = Eye::new(*frame, 1);
    seen.resize(width * height);
    let mut bands = Maps::of(seen).cut(width * SIZE);
    parallel::for_each_chunk(&mut bands, 1, |band, maps| {
        let row = band * SIZE;
        let rows = SIZE.min(height - row);
        let mut resolver = Resolver::new();
        for column in (0..width).step_by(SIZE) {
            let place = Place {
                eye: &eye,
                column,
                row,
            };
            let columns = SIZE.min(width - column);
            let tile = scan(clusters, (&place, None), (columns, rows));
            for maps in &mut *maps {
                resolver.resolve((&place, &tile), (columns, rows), (maps, width, column));
            }
        }
    });
}

/// Some rows of all maps.
struct Maps<'s> {
    triangles: &'s mut [u32],
    depth: &'s mut [f32],
    normals: &'s mut [[f32; 3]],
    weights: &'s mut [[f32; 2]],
}

impl<'s> Maps<'s> {
    fn of(seen: &'s mut Seen) -> Self {
        Self {
            triangles: &mut seen.triangles,
            depth: &mut seen.depth,
            normals: &mut seen.normals,
            weights: &mut seen.weights,
        }
    }

    /// Bands of `size` pixels.
    fn cut(self, size: usize) -> Vec<Self> {
        let triangles = self.triangles.chunks_mut(size);
        let depth = self.depth.chunks_mut(size);
        let normals = self.normals.chunks_mut(size);
        let weights = self.weights.chunks_mut(size);
        let all = triangles.zip(depth).zip(normals.zip(weights));
        all.map(|((triangles, depth), (normals, weights))| Self {
            triangles,
            depth,
            normals,
            weights,
        })
        .collect()
    }

    /// Has the memory fetched that will be written.
    fn fetch(&self) {
        prefetch_all(self.triangles);
        prefetch_all(self.depth);
        prefetch_all(self.normals);
        prefetch_all(self.weights);
    }

    fn part(&mut self, first: usize, count: usize) -> Maps<'_> {
        Maps {
            triangles: &mut self.triangles[first..][..count],
            depth: &mut self.depth[first..][..count],
            normals: &mut self.normals[first..][..count],
            weights: &mut self.weights[first..][..count],
        }
    }
}

/// Slots of the memory of triangles that have been met; one more is for none.
const SLOTS: usize = 512;

/// What is worked out about a tile.
pub(crate) struct Resolver {
    /// Triangles met in the present rows for the first time.
    pending: Vec<Pending>,
    planes: Vec<Plane>,
    /// Triangles met of late, by their number, with their place in `planes`.
    met: [(u32, u32); SLOTS + 1],
    fresh: Fresh,
    /// Places in `planes` of the runs of pixels that see one triangle.
    runs: [u32; ROWS * SIZE],
    /// In each row: the first pixels of runs as bits, and the number of its first run.
    rows: [(u64, usize); ROWS],
    /// x of the directions of the tile's columns, as it is and counted from the first.
    x: [f64; SIZE],
    from_first: [f64; SIZE],
}

impl Resolver {
    pub(crate) fn new() -> Self {
        Self {
            pending: Vec::with_capacity(ROWS * SIZE),
            planes: Vec::with_capacity(SIZE * SIZE + 1),
            met: [(NONE, 0); SLOTS + 1],
            fresh: Fresh::new(),
            runs: [0; ROWS * SIZE],
            rows: [(0, 0); ROWS],
            x: [0.0; SIZE],
            from_first: [0.0; SIZE],
        }
    }

    /// Writes the pixels of one tile.
    pub(crate) fn resolve_tile(
        &mut self,
        (place, tile): (&Place<'_>, &Tile),
        (columns, rows): (usize, usize),
        seen: &mut Seen,
    ) {
        seen.resize(columns * rows);
        let maps = (&mut Maps::of(seen), columns, 0);
        self.resolve((place, tile), (columns, rows), maps);
    }

    /// Writes the pixels of a tile: the first of them to place `first_pixel` of maps whose rows are `stride`
    /// long.
    fn resolve(
        &mut self,
        (place, tile): (&Place<'_>, &Tile),
        (columns, rows): (usize, usize),
        (maps, stride, first_pixel): (&mut Maps<'_>, usize, usize),
    ) {
        self.planes.clear();
        self.planes.push(Plane::NONE);
        self.met = [(NONE, 0); SLOTS + 1];
        let first = place.eye.direction(place.column, place.row);
        let last = place.eye.direction(place.column + SIZE, place.row + SIZE);
        let window = Window {
            first: [first.x, first.y],
            width: (last.x - first.x).abs().max((last.y - first.y).abs()),
            reach: first.abs().max(last.abs()).truncate().max_element(),
        };
        for column in 0..SIZE {
            let direction = place.eye.direction(place.column + column, place.row);
            self.x[column] = direction.x;
            self.from_first[column] = direction.x - first.x;
        }
        for top in (0..rows).step_by(ROWS) {
            for row in top..rows.min(top + ROWS) {
                maps.part(row * stride + first_pixel, columns).fetch();
            }
            dispatch(Strip {
                resolver: self,
                place,
                window: &window,
                tile,
                rows: (top, ROWS.min(rows - top)),
            });
            for row in top..rows.min(top + ROWS) {
                let ids = tile.row(row, columns);
                let y = place.eye.direction(place.column, place.row + row).y;
                let maps = maps.part(row * stride + first_pixel, columns);
                self.write((&place.eye.frame, &window), (row - top, y), (ids, maps));
            }
        }
    }

    /// Writes a row of pixels.
    fn write(
        &mut self,
        (frame, window): (&Frame<'_>, &Window),
        (row, y): (usize, f64),
        (ids, mut maps): (&[u32], Maps<'_>),
    ) {
        maps.triangles.copy_from_slice(ids);
        let (starts, first) = self.rows[row];
        if starts == 1 && ids[0] == NONE {
            maps.depth.fill(0.0);
            maps.normals.as_flattened_mut().fill(0.0);
            maps.weights.as_flattened_mut().fill(0.0);
            return;
        }
        let Maps {
            depth,
            normals,
            weights,
            ..
        } = &mut maps;
        let whole = (
            depth.first_chunk_mut(),
            normals.first_chunk_mut(),
            weights.first_chunk_mut(),
        );
        let cross = |depth: &mut _, normals: &mut _, weights: &mut _| {
            dispatch(Cross {
                x: &self.from_first,
                y: y - window.first[1],
                planes: &self.planes,
                runs: &self.runs,
                row: (starts, first),
                out: (depth, normals, weights),
            })
        };
        let doubtful = if let (Some(depth), Some(normals), Some(weights)) = whole {
            cross(depth, normals, weights)
        } else {
            let (mut line, count) = (Line::NONE, ids.len());
            let doubtful = cross(&mut line.depth, &mut line.normals, &mut line.weights);
            depth.copy_from_slice(&line.depth[..count]);
            normals.copy_from_slice(&line.normals[..count]);
            weights.copy_from_slice(&line.weights[..count]);
            doubtful
        };
        for column in 0..ids.len() {
            if doubtful >> column & 1 == 1 {
                let direction = DVec3::new(self.x[column], y, 1.0);
                settle(frame, (ids[column], direction), (&mut maps, column));
            }
        }
    }
}

/// Writes what the exact test says.
#[cold]
fn settle(
    frame: &Frame<'_>,
    (id, direction): (u32, DVec3),
    (maps, column): (&mut Maps<'_>, usize),
) {
    let facet = frame.facet(id as usize);
    let normal = facet.facing_normal(direction);
    maps.normals[column] = normal.as_vec3().to_array();
    if let Some(crossing) = facet.cross(direction) {
        #[allow(clippy::cast_possible_truncation, reason = "maps are f32")]
        {
            maps.depth[column] = crossing.distance as f32;
            maps.weights[column] = crossing.weights.map(|weight| weight as f32);
        }
    }
}

/// Finds the runs in some rows and sets up their triangles.
struct Strip<'r, 't> {
    resolver: &'r mut Resolver,
    place: &'t Place<'t>,
    window: &'t Window,
    tile: &'t Tile,
    /// The first row, and how many.
    rows: (usize, usize),
}

impl Task for Strip<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self, l: L) {
        let Self {
            resolver,
            place,
            window,
            tile,
            rows: (top, count),
        } = self;
        let mut runs = 0;
        for row in 0..count {
            let ids = tile.row(top + row, SIZE);
            let y = place.eye.direction(place.column, place.row + top + row).y;
            let starts = starts(l, ids);
            resolver.rows[row % ROWS] = (starts, runs);
            let mut left = starts;
            while left != 0 {
                let column = left.trailing_zeros() as usize;
                left &= left - 1;
                let id = ids[column % SIZE];
                let slot = if id == NONE {
                    SLOTS
                } else {
                    id as usize % SLOTS
                };
                let mut known = resolver.met[slot];
                if known.0 != id {
                    #[allow(clippy::cast_possible_truncation, reason = "at most 4097")]
                    let next = (resolver.planes.len() + resolver.pending.len()) as u32;
                    known = (id, next);
                    resolver.met[slot] = known;
                    prefetch(place.eye.frame.mesh().triangles(), id as usize);
                    resolver.pending.push(Pending {
                        id,
                        spot: [resolver.x[column % SIZE], y],
                        vertices: [0; 3],
                    });
                }
                resolver.runs[runs % (ROWS * SIZE)] = known.1;
                runs += 1;
            }
        }
        resolver.set_up(&place.eye.frame, window);
    }
}

/// The pixels of a row that see another triangle than the one before, as bits.
#[inline(always)]
fn starts<L: Lanes>(l: L, ids: &[u32]) -> u64 {
    let mut shifted = [0; SIZE];
    let mut here = [0; SIZE];
    here.copy_from_slice(ids);
    shifted[1..].copy_from_slice(&ids[..SIZE - 1]);
    shifted[0] = !ids[0];
    let mut bits = 0;
    let pairs = here
        .as_chunks::<LANES>()
        .0
        .iter()
        .zip(shifted.as_chunks().0);
    for (index, (here, before)) in pairs.enumerate() {
        bits |= u64::from(l.differ(here, before)) << (LANES * index);
    }
    bits
}

/// Sets up triangles met for the first time, at most [`SIZE`].
struct SetUp<'r> {
    pending: &'r [Pending],
    fresh: &'r mut Fresh,
    planes: &'r mut Vec<Plane>,
    frame: &'r Frame<'r>,
    window: &'r Window,
}

impl Task for SetUp<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self, _: L) {
        let (fresh, frame) = (self.fresh, self.frame);
        fresh.load(frame, self.pending);
        fresh.turn(&frame.rotation(), frame.center_in_cam());
        fresh.set_up(self.window);
        for index in 0..fresh.count {
            self.planes.push(fresh.plane(index));
        }
    }
}

impl Resolver {
    /// Sets up what is pending: all vertices are asked for before the first is needed.
    fn set_up(&mut self, frame: &Frame<'_>, window: &Window) {
        let mesh = frame.mesh();
        for triangle in &mut self.pending {
            triangle.vertices = mesh.triangles()[triangle.id as usize];
            for vertex in triangle.vertices {
                prefetch(mesh.vertices(), vertex as usize);
            }
        }
        for pending in self.pending.chunks(SIZE) {
            dispatch(SetUp {
                pending,
                fresh: &mut self.fresh,
                planes: &mut self.planes,
                frame,
                window,
            });
        }
        self.pending.clear();
    }
}
