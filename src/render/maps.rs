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
use super::pages::{Maps, Row, Waiting};
use super::planes::{Fresh, Pending, Plane, Window};
use super::row::{Cross, Line};
use super::scan::scan;
use super::surface::Frame;
use super::tile::{NONE, SIZE, Tile};
use crate::ahead::{WORDS, prefetch};
use crate::parallel;
use glam::DVec3;
use std::hint::select_unpredictable;

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
        let (mut resolver, mut waiting) = (Resolver::new(), Waiting::new());
        for column in (0..width).step_by(SIZE) {
            let place = Place {
                eye: &eye,
                column,
                row,
            };
            let columns = SIZE.min(width - column);
            let tile = scan(clusters, (&place, None), (columns, rows));
            for maps in &mut *maps {
                let row = |line: &mut Line, number: usize| {
                    let row = Row {
                        number,
                        first: number * width + column,
                        count: columns,
                        joined: [column > 0, column + columns < width],
                    };
                    maps.stream(line, &row, &mut waiting);
                };
                resolver.resolve((&place, &tile), (columns, rows), row);
            }
        }
    });
}

/// Slots of the memory of triangles that have been met; one more is for none.
const SLOTS: usize = 512;

/// Most runs of pixels in rows that are worked out together.
const RUNS: usize = ROWS * SIZE;

/// What is worked out about a tile.
pub(crate) struct Resolver {
    /// Triangles met in the present rows for the first time, and how many.
    pending: [Pending; RUNS + 1],
    waiting: usize,
    planes: Vec<Plane>,
    /// Triangles met of late, by their number, with their place in `planes`.
    met: [(u32, u32); SLOTS + 1],
    fresh: Fresh,
    /// Places in `planes` of the runs of pixels that see one triangle.
    runs: [u32; RUNS],
    /// In each row: the first pixels of runs as bits, and the number of its first run.
    rows: [(u64, usize); ROWS],
    /// x of the directions of the tile's columns, as it is and counted from the first.
    x: [f64; SIZE],
    from_first: [f64; SIZE],
}

impl Resolver {
    pub(crate) fn new() -> Self {
        Self {
            pending: [Pending::NONE; RUNS + 1],
            waiting: 0,
            planes: Vec::with_capacity(SIZE * SIZE + 1),
            met: [(NONE, 0); SLOTS + 1],
            fresh: Fresh::new(),
            runs: [0; RUNS],
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
        let mut maps = Maps::of(seen);
        self.resolve((place, tile), (columns, rows), |line, row| {
            maps.put(line, row * columns, columns);
        });
    }

    /// Works out the pixels of a tile and calls `put` with each row.
    fn resolve(
        &mut self,
        (place, tile): (&Place<'_>, &Tile),
        (columns, rows): (usize, usize),
        put: impl FnMut(&mut Line, usize),
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
        dispatch(Sheet {
            resolver: self,
            place,
            window: &window,
            tile,
            size: (columns, rows),
            put,
        });
    }
}

/// A tile of the maps.
struct Sheet<'s, P> {
    resolver: &'s mut Resolver,
    place: &'s Place<'s>,
    window: &'s Window,
    tile: &'s Tile,
    /// Used columns and rows.
    size: (usize, usize),
    /// As for [`Resolver::resolve`].
    put: P,
}

impl<P: FnMut(&mut Line, usize)> Task for Sheet<'_, P> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(mut self, l: L) {
        let (_, rows) = self.size;
        let mut line = Line::NONE;
        for top in (0..rows).step_by(ROWS) {
            let count = ROWS.min(rows - top);
            self.find_runs(l, top, count);
            self.set_up(l);
            for row in 0..count {
                self.cross(l, (top, row), &mut line);
                (self.put)(&mut line, top + row);
            }
        }
    }
}

impl<P: FnMut(&mut Line, usize)> Sheet<'_, P> {
    fn y(&self, row: usize) -> f64 {
        let place = self.place;
        place.eye.direction(place.column, place.row + row).y
    }

    /// Finds the runs in some rows, and the triangles that are met for the first time: nothing branches on
    /// which these are, which cannot be foreseen.
    #[inline(always)]
    fn find_runs<L: Lanes>(&mut self, l: L, top: usize, count: usize) {
        let triangles = self.place.eye.frame.mesh().triangles();
        let (mut runs, mut waiting) = (0, 0);
        for row in 0..count {
            let (ids, y) = (self.tile.row(top + row, SIZE), self.y(top + row));
            let resolver = &mut *self.resolver;
            #[allow(clippy::cast_possible_truncation, reason = "at most 4097")]
            let planes = resolver.planes.len() as u32;
            let starts = starts(l, ids);
            resolver.rows[row % ROWS] = (starts, runs);
            let mut left = starts;
            while left != 0 {
                let column = left.trailing_zeros() as usize % SIZE;
                left &= left - 1;
                let id = ids[column];
                let slot = select_unpredictable(id == NONE, SLOTS, id as usize % SLOTS);
                let (known, place) = resolver.met[slot];
                let is_new = known != id;
                #[allow(clippy::cast_possible_truncation, reason = "at most 512")]
                let place = select_unpredictable(is_new, planes + waiting as u32, place);
                resolver.met[slot] = (id, place);
                prefetch(triangles, id as usize);
                resolver.pending[waiting % (RUNS + 1)] = Pending {
                    id,
                    spot: [resolver.x[column], y],
                    vertices: [0; 3],
                };
                waiting += usize::from(is_new);
                resolver.runs[runs % RUNS] = place;
                runs += 1;
            }
        }
        self.resolver.waiting = waiting;
    }

    /// Sets up triangles met for the first time: all vertices are asked for before the first is needed.
    #[inline(always)]
    fn set_up<L: Lanes>(&mut self, l: L) {
        let frame = &self.place.eye.frame;
        let mesh = frame.mesh();
        let Resolver {
            pending,
            waiting,
            fresh,
            planes,
            ..
        } = &mut *self.resolver;
        for triangle in &mut pending[..*waiting] {
            triangle.vertices = mesh.triangles()[triangle.id as usize];
            for vertex in triangle.vertices {
                prefetch(mesh.vertices(), vertex as usize);
            }
        }
        for pending in pending[..*waiting].chunks(SIZE) {
            fresh.load(frame, pending);
            fresh.turn(&frame.rotation(), frame.center_in_cam());
            fresh.set_up(self.window);
            fresh.put(l, planes);
        }
    }

    /// Works out a row of pixels.
    #[inline(always)]
    fn cross<L: Lanes>(&mut self, l: L, (top, row): (usize, usize), line: &mut Line) {
        let resolver = &*self.resolver;
        let (starts, first) = resolver.rows[row % ROWS];
        let ids = self.tile.row(top + row, SIZE);
        if starts == 1 && ids[0] == NONE {
            return line.clear();
        }
        line.triangles[WORDS..].copy_from_slice(ids);
        let y = self.y(top + row);
        let cross = Cross {
            x: &resolver.from_first,
            y: y - self.window.first[1],
            planes: &resolver.planes,
            runs: &resolver.runs,
            row: (starts, first),
        };
        let mut doubtful = cross.write(l, line);
        while doubtful != 0 {
            let column = doubtful.trailing_zeros() as usize;
            doubtful &= doubtful - 1;
            let direction = DVec3::new(resolver.x[column], y, 1.0);
            settle(&self.place.eye.frame, direction, (line, column));
        }
    }
}

/// Writes what the exact test says.
#[cold]
#[inline(never)]
fn settle(frame: &Frame<'_>, direction: DVec3, (line, column): (&mut Line, usize)) {
    let facet = frame.facet(line.triangles[WORDS + column] as usize);
    let normal = facet.facing_normal(direction).as_vec3().to_array();
    line.normals[WORDS + 3 * column..][..3].copy_from_slice(&normal);
    if let Some(crossing) = facet.cross(direction) {
        #[allow(clippy::cast_possible_truncation, reason = "maps are f32")]
        {
            line.depth[WORDS + column] = crossing.distance as f32;
            let weights = crossing.weights.map(|weight| weight as f32);
            line.weights[WORDS + 2 * column..][..2].copy_from_slice(&weights);
        }
    }
}

/// The pixels of a row that see another triangle than the one before, as bits.
#[inline(always)]
pub(super) fn starts<L: Lanes>(l: L, ids: &[u32]) -> u64 {
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
