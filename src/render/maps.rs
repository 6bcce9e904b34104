//! Exact maps of what is visible at pixel centres, without colours.
//!
//! As soon as a tile's visibility is known, its triangles are set up in f64 ([`super::planes`]), each
//! once, and a pixel costs a few products and one division; where nearly every pixel sees a triangle of its
//! own, that is worked out at the pixel alone ([`super::dots`]). A depth that lies so close to the border
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
use super::row::{Cross, Line, starts};
use super::scan::scan;
use super::surface::Frame;
use super::tile::{NONE, SIDE, SIZE, Spot, Tile};
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
    // Enough for all threads.
    let side = match height.div_ceil(SIDE) < 2 * parallel::threads() {
        true => SIZE,
        false => SIDE,
    };
    let mut bands = Maps::of(seen).cut(width * side);
    parallel::for_each_chunk_with((&mut bands, 1), Resolver::new, |resolver, band, maps| {
        let row = band * side;
        let rows = side.min(height - row);
        let mut waiting = Waiting::new();
        for column in (0..width).step_by(SIDE) {
            let place = Place {
                eye: &eye,
                column,
                row,
            };
            let columns = SIDE.min(width - column);
            let tile = scan(clusters, (&place, None), (columns, rows));
            for maps in &mut *maps {
                for part in parts(columns, rows) {
                    let column = column + part.corner.column;
                    let count = part.size.0;
                    let row = |line: &mut Line, number: usize| {
                        let number = part.corner.row + number;
                        let row = Row {
                            number,
                            first: number * width + column,
                            count,
                            joined: [column > 0, column + count < width],
                        };
                        maps.stream(line, &row, &mut waiting);
                    };
                    resolver.resolve((&place, &tile), &part, row);
                }
            }
        }
    });
}

/// A part of a tile of which the maps are worked out together.
pub(super) struct Part {
    /// Its first sample.
    corner: Spot,
    /// Columns and rows.
    pub(super) size: (usize, usize),
}

/// The parts of a tile, each after those to its left.
fn parts(columns: usize, rows: usize) -> impl Iterator<Item = Part> {
    let tops = (0..rows).step_by(SIZE);
    tops.flat_map(move |row| {
        (0..columns).step_by(SIZE).map(move |column| Part {
            corner: Spot { column, row },
            size: (SIZE.min(columns - column), SIZE.min(rows - row)),
        })
    })
}

/// Slots of the memory of triangles that have been met; one more is for none.
const SLOTS: usize = 512;

/// Mean number of runs in rows that are worked out together above which their pixels are worked out one by
/// one.
const OWN_RUNS: u32 = 46;

/// Most runs of pixels in rows that are worked out together.
const RUNS: usize = ROWS * SIZE;

/// What is worked out about a tile.
pub(crate) struct Resolver {
    /// Triangles met in the present rows for the first time, and how many.
    pending: [Pending; RUNS],
    waiting: usize,
    /// y of the directions of the present rows.
    y: [f64; ROWS],
    /// The first stands for none, and how many have been set up, it included.
    planes: Vec<Plane>,
    set_up: usize,
    /// Triangles met of late, by their number, with their place in `planes`.
    met: [(u32, u32); SLOTS + 1],
    pub(super) fresh: Fresh,
    /// The vertices of pending triangles; of rows that are worked out pixel by pixel, those of the triangles that
    /// are seen.
    pub(super) vertices: [[u32; 3]; RUNS],
    /// Places in `planes` of the runs of pixels that see one triangle.
    runs: [u32; RUNS],
    /// In each row: the first pixels of runs as bits, and the number of its first run.
    pub(super) rows: [(u64, usize); ROWS],
    /// As [`OWN_RUNS`].
    own_runs: u32,
    /// The rows of the tile up to which triangles, and vertices, have been asked for.
    pub(super) asked: [usize; 2],
    /// x of the directions of the tile's columns, as it is and counted from the first.
    pub(super) x: [f64; SIZE],
    from_first: [f64; SIZE],
}

impl Resolver {
    pub(crate) fn new() -> Self {
        let mut planes = Vec::with_capacity(SIZE * SIZE + 1 + SIZE);
        planes.push(Plane::NONE);
        Self {
            pending: [Pending::NONE; RUNS],
            waiting: 0,
            y: [0.0; ROWS],
            planes,
            set_up: 1,
            met: [(NONE, 0); SLOTS + 1],
            fresh: Fresh::new(),
            vertices: [[0; 3]; RUNS],
            runs: [0; RUNS],
            rows: [(0, 0); ROWS],
            own_runs: OWN_RUNS,
            asked: [0; 2],
            x: [0.0; SIZE],
            from_first: [0.0; SIZE],
        }
    }

    /// Writes the pixels of a tile of at most [`SIZE`] pixels a side.
    pub(crate) fn resolve_tile(
        &mut self,
        (place, tile): (&Place<'_>, &Tile),
        (columns, rows): (usize, usize),
        seen: &mut Seen,
    ) {
        seen.resize(columns * rows);
        let mut maps = Maps::of(seen);
        let whole = Part {
            corner: Spot { column: 0, row: 0 },
            size: (columns, rows),
        };
        self.resolve((place, tile), &whole, |line, row| {
            maps.put(line, row * columns, columns);
        });
    }

    /// Works out the pixels of a part of a tile and calls `put` with each row.
    fn resolve(
        &mut self,
        (place, tile): (&Place<'_>, &Tile),
        part: &Part,
        put: impl FnMut(&mut Line, usize),
    ) {
        let place = &Place {
            column: place.column + part.corner.column,
            row: place.row + part.corner.row,
            ..*place
        };
        self.set_up = 1;
        self.met = [(NONE, 0); SLOTS + 1];
        self.asked = [0; 2];
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
            part,
            put,
        });
    }
}

/// A part of a tile of the maps.
pub(super) struct Sheet<'s, P> {
    pub(super) resolver: &'s mut Resolver,
    /// Of the part.
    pub(super) place: &'s Place<'s>,
    pub(super) window: &'s Window,
    tile: &'s Tile,
    pub(super) part: &'s Part,
    /// As for [`Resolver::resolve`].
    pub(super) put: P,
}

impl<P: FnMut(&mut Line, usize)> Task for Sheet<'_, P> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(mut self, l: L) {
        let (_, rows) = self.part.size;
        let mut line = Line::NONE;
        for top in (0..rows).step_by(ROWS) {
            let count = ROWS.min(rows - top);
            if self.find_starts(l, top, count) {
                self.dot(l, (top, count), &mut line);
                continue;
            }
            self.find_runs(top, count);
            self.set_up(l);
            for row in 0..count {
                self.cross(l, (top, row), &mut line);
                (self.put)(&mut line, top + row);
            }
        }
    }
}

impl<'s, P: FnMut(&mut Line, usize)> Sheet<'s, P> {
    pub(super) fn y(&self, row: usize) -> f64 {
        let place = self.place;
        place.eye.direction(place.column, place.row + row).y
    }

    /// What the pixels of a row see.
    pub(super) fn ids(&self, row: usize) -> &'s [u32] {
        let Spot { column, row: top } = self.part.corner;
        let row = top + row;
        self.tile.row(Spot { column, row })
    }

    /// Finds where runs begin in some rows. Answers whether nearly every pixel sees a triangle of its own.
    #[inline(always)]
    fn find_starts<L: Lanes>(&mut self, l: L, top: usize, count: usize) -> bool {
        let mut runs = 0;
        for row in 0..count {
            let ids = self.ids(top + row);
            let starts = starts(l, ids);
            self.resolver.rows[row % ROWS] = (starts, 0);
            runs += starts.count_ones();
        }
        runs > self.resolver.own_runs * count as u32
    }

    /// Has the exact test decide some pixels of a row.
    #[inline(always)]
    pub(super) fn settle(&self, mut doubtful: u64, y: f64, line: &mut Line) {
        while doubtful != 0 {
            let column = doubtful.trailing_zeros() as usize % SIZE;
            doubtful &= doubtful - 1;
            let direction = DVec3::new(self.resolver.x[column], y, 1.0);
            settle(&self.place.eye.frame, direction, (line, column));
        }
    }

    /// Finds the runs in some rows, and the triangles that are met for the first time: nothing branches on
    /// which these are, which cannot be foreseen.
    #[inline(always)]
    fn find_runs(&mut self, top: usize, count: usize) {
        let triangles = self.place.eye.frame.mesh().triangles();
        let (mut runs, mut waiting) = (0, 0);
        for row in 0..count {
            let (ids, y) = (self.ids(top + row), self.y(top + row));
            let resolver = &mut *self.resolver;
            resolver.y[row % ROWS] = y;
            #[allow(clippy::cast_possible_truncation, reason = "at most 4097")]
            let planes = resolver.set_up as u32;
            let (starts, _) = resolver.rows[row % ROWS];
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
                #[allow(clippy::cast_possible_truncation, reason = "below 64 and 8")]
                let (column, row) = (column as u16, row as u16);
                resolver.pending[waiting % RUNS] = Pending { id, column, row };
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
            vertices,
            waiting,
            fresh,
            planes,
            set_up,
            x,
            y,
            ..
        } = &mut *self.resolver;
        let (pending, vertices) = (&pending[..*waiting], &mut vertices[..*waiting]);
        for (vertices, triangle) in vertices.iter_mut().zip(pending) {
            *vertices = mesh.triangles()[triangle.id as usize];
            for &vertex in &*vertices {
                prefetch(mesh.vertices(), vertex as usize);
            }
        }
        for (pending, vertices) in pending.chunks(SIZE).zip(vertices.chunks(SIZE)) {
            fresh.load(l, frame, (pending, vertices), (x, y));
            let end = pending.len().next_multiple_of(LANES);
            fresh.set_up(self.window, (0, end));
            fresh.put(l, (planes, *set_up));
            *set_up += pending.len();
        }
    }

    /// Works out a row of pixels.
    #[inline(always)]
    fn cross<L: Lanes>(&mut self, l: L, (top, row): (usize, usize), line: &mut Line) {
        let resolver = &*self.resolver;
        let (starts, first) = resolver.rows[row % ROWS];
        let ids = self.ids(top + row);
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
        let doubtful = cross.write(l, line);
        self.settle(doubtful, y, line);
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

#[cfg(test)]
mod tests {
    use super::super::scan::scan;
    use super::super::widths::shapes::{soup, terrain};
    use super::*;
    use glam::DVec2;
    use mvs_datasets::scene::{Camera, Pose, View};

    /// More runs than rows have.
    const NEVER: u32 = u32::MAX / 64;

    /// A tile's maps, with planes where rows have at most so many runs in the mean: with 0 none at all.
    fn maps((place, tile): (&Place<'_>, &Tile), own_runs: u32) -> Seen {
        let (mut resolver, mut seen) = (Resolver::new(), Seen::default());
        resolver.own_runs = own_runs;
        resolver.resolve_tile((place, tile), (60, 50), &mut seen);
        if [0, NEVER].contains(&own_runs) {
            assert_eq!(
                resolver.set_up == 1,
                own_runs == 0,
                "the way that was asked for"
            );
        }
        seen
    }

    fn view(width: u32, height: u32) -> View {
        let eye = DVec3::new(0.3, -0.7, 0.6).normalize() * 2.5;
        let center = DVec2::new(f64::from(width), f64::from(height)) / 2.0 + DVec2::new(1.0, -1.0);
        let focal = DVec2::splat(f64::from(height) + 5.0);
        View {
            id: 0,
            name: String::new(),
            camera: Camera::new(width, height, focal, center).unwrap(),
            pose: Pose::looking_at(eye, DVec3::ZERO, DVec3::new(0.1, 0.2, 1.0)).unwrap(),
            depth_range: None,
        }
    }

    #[test]
    fn parts_of_a_tile_are_what_tiles_of_their_own_give() {
        let (width, height) = (150, 140);
        let mut surface = 0;
        for mesh in [terrain(300), terrain(20), soup(3000, 6)] {
            let (view, center) = (view(150, 140), mesh.bounds().center());
            let (clusters, frame) = (
                Clusters::new(&mesh, center),
                Frame::new(&mesh, center, &view),
            );
            let mut whole = Seen::default();
            see(&clusters, &frame, &mut whole);
            let eye = &Eye::new(frame, 1);
            for (column, row) in (0..9).map(|tile| (tile % 3 * SIZE, tile / 3 * SIZE)) {
                let (columns, rows) = (SIZE.min(width - column), SIZE.min(height - row));
                let place = Place { eye, column, row };
                let tile = scan(&clusters, (&place, None), (columns, rows));
                let mut own = Seen::default();
                Resolver::new().resolve_tile((&place, &tile), (columns, rows), &mut own);
                for down in 0..rows {
                    let (from, to) = (down * columns, (row + down) * width + column);
                    let (from, to) = (from..from + columns, to..to + columns);
                    assert_eq!(own.triangles[from.clone()], whole.triangles[to.clone()]);
                    assert_eq!(own.depth[from.clone()], whole.depth[to.clone()]);
                    assert_eq!(own.normals[from.clone()], whole.normals[to.clone()]);
                    assert_eq!(own.weights[from], whole.weights[to]);
                }
                surface += own.depth.iter().filter(|&&z| z > 0.0).count();
            }
        }
        assert!(surface > 20_000, "{surface}");
    }

    #[test]
    fn pixel_by_pixel_is_what_planes_give() {
        let (mut weights, mut moved, mut blank) = (0, 0, 0);
        for mesh in [terrain(300), terrain(20), soup(3000, 6)] {
            let (view, center) = (view(60, 50), mesh.bounds().center());
            let eye = Eye::new(Frame::new(&mesh, center, &view), 1);
            let place = Place {
                eye: &eye,
                column: 0,
                row: 0,
            };
            let tile = scan(&Clusters::new(&mesh, center), (&place, None), (60, 50));
            let (dots, planes) = (maps((&place, &tile), 0), maps((&place, &tile), NEVER));
            let bits = |depth: &[f32]| depth.iter().map(|z| z.to_bits()).collect::<Vec<_>>();
            // By turns in one tile, too.
            let by_turns = [8, 20, 30, 40, 50].map(|own_runs| maps((&place, &tile), own_runs));
            for other in by_turns.iter().chain([&dots]) {
                assert_eq!(other.triangles, planes.triangles);
                assert_eq!(bits(&other.depth), bits(&planes.depth));
                assert_eq!(other.normals, planes.normals);
            }
            blank += dots.depth.iter().filter(|&&z| z == 0.0).count();
            let both = dots.weights.as_flattened().iter();
            for (a, b) in both.zip(planes.weights.as_flattened()) {
                // As far apart as two roundings of one number.
                assert!((a - b).abs() <= f32::EPSILON * b.abs().max(1e-6), "{a} {b}");
                weights += 1;
                moved += usize::from(a != b);
            }
        }
        assert!(
            weights == 18_000 && blank > 100 && moved < 5,
            "{weights} {blank} {moved}"
        );
    }
}
