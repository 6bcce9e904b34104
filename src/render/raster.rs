//! Clusters drawn into a tile: eight triangles at a time, tested in f32 with a known error; what
//! lies within that error of an edge, or of another surface's depth, is decided by the exact test.

#![allow(
    clippy::needless_range_loop,
    reason = "columns are walked side by side, and closures would leave the instruction set"
)]

use super::bent::Bent;
use super::cluster::{self, Cluster};
use super::lanes::{ALL, LANES, Lanes, SetBits, Task, dispatch, whole};
use super::lens::{Lens, PLACES, Place, Projected, ULP};
use super::near;
use super::strokes::Stored;
use super::tile::{DOUBT, SIZE, STRIDE, Spot, Tile};

/// The first and the last sample of a tile.
const WHOLE: (Spot, Spot) = (
    Spot { column: 0, row: 0 },
    Spot {
        column: SIZE - 1,
        row: SIZE - 1,
    },
);
const LAST: f32 = (SIZE - 1) as f32;

/// Draws clusters into one tile.
pub(crate) struct Brush<'t> {
    pub(crate) tile: &'t mut Tile,
    pub(crate) place: &'t Place<'t>,
    /// What a lens does to the samples.
    pub(crate) bent: Option<&'t Bent>,
    pub(crate) lens: &'t Lens,
    pub(crate) scratch: &'t mut Projected,
}

impl Brush<'_> {
    pub(crate) fn draw(&mut self, cluster: &Cluster<'_>) {
        dispatch(Draw(self, cluster));
    }

    fn draw_exactly(&mut self, triangle: u32, from_to: (Spot, Spot)) {
        near::draw(self.tile, (self.place, self.bent), triangle, from_to);
    }

    /// Offers a triangle where f32 is in doubt about what is nearer or, without a known nearness,
    /// about whether the sample sees the triangle at all.
    #[cold]
    #[inline(never)]
    pub(super) fn settle(&mut self, index: usize, triangle: u32, known: Option<f32>) {
        let spot = Spot {
            column: index % STRIDE,
            row: index / STRIDE,
        };
        let place = self.place;
        let direction = match self.bent {
            Some(bent) => bent.directions[index],
            None => place
                .eye
                .direction(place.column + spot.column, place.row + spot.row),
        };
        let exact = |triangle: u32| {
            let crossing = place.eye.frame.cross(triangle as usize, direction);
            crossing.map(|crossing| crossing.distance)
        };
        #[allow(clippy::cast_possible_truncation, reason = "well below DOUBT")]
        let nearness = known.or_else(|| exact(triangle).map(|distance| (1.0 / distance) as f32));
        if let Some(nearness) = nearness {
            self.tile.offer(spot, (triangle, nearness), exact);
        }
    }
}

struct Draw<'d, 'b>(&'d mut Brush<'b>, &'d Cluster<'d>);

impl Task for Draw<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self, l: L) {
        let Self(brush, cluster) = self;
        if !brush.lens.project(l, cluster, brush.scratch) {
            for (_, triangle) in cluster.triangles() {
                brush.draw_exactly(triangle, WHOLE);
            }
            return;
        }
        let error = brush.scratch.error + brush.scratch.away;
        let [left, right, top, bottom] = brush.scratch.extent;
        let (Some(columns), Some(rows)) = (
            covered(left - error, right + error),
            covered(top - error, bottom + error),
        ) else {
            return;
        };
        for (numbers, used) in cluster.groups() {
            if let Some(group) = Group::new(l, brush.scratch, (numbers, used)) {
                group.draw(l, brush, numbers);
            }
        }
        let [from, to] = [0, 1].map(|end| Spot {
            column: [columns.0, columns.1][end],
            row: [rows.0, rows.1][end],
        });
        brush.tile.touch(from, to);
    }
}

/// First and last sample of the tile between two coordinates; `None` when there is none.
#[inline(always)]
fn covered(low: f32, high: f32) -> Option<(usize, usize)> {
    if !(low <= LAST && high >= 0.0) {
        return None;
    }
    #[allow(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "between 0 and SIZE"
    )]
    let (first, last) = (low.max(0.0).ceil() as usize, high.min(LAST) as usize);
    (first <= last).then_some((first, last))
}

/// Eight triangles on the tile.
///
/// Edge functions are twice the areas that a sample spans with each edge, positive inside. Divided
/// by their sum they are the barycentric weights on the image.
struct Group<L: Lanes> {
    /// First and last column, first and last row that a triangle may cover.
    columns: [L::V; 2],
    rows: [L::V; 2],
    /// The functions at the first column and row, and how they change along both.
    at: [L::V; 3],
    along_x: [L::V; 3],
    along_y: [L::V; 3],
    /// How far the functions may be off; inside or outside is clear beyond this.
    doubt: L::V,
    /// Nearness at each corner, over the sum of the functions.
    nearness: [L::V; 3],
    /// That of the nearest corner.
    nearest: L::V,
    /// Lanes with a triangle that may be seen, and those for which f32 is good enough.
    alive: u32,
    fine: u32,
}

/// The values of three corners' vertices in eight triangles.
#[inline(always)]
fn gather<L: Lanes>(l: L, values: &[f32; PLACES], places: &[[u8; LANES]; 3]) -> [L::V; 3] {
    let mut corners = [[0.0; LANES]; 3];
    for corner in 0..3 {
        for lane in 0..LANES {
            corners[corner][lane] = values[usize::from(places[corner][lane])];
        }
    }
    [
        l.load(&corners[0]),
        l.load(&corners[1]),
        l.load(&corners[2]),
    ]
}

/// Least and greatest of three.
#[inline(always)]
pub(super) fn spread<L: Lanes>(l: L, [a, b, c]: [L::V; 3]) -> (L::V, L::V) {
    (l.min(l.min(a, b), c), l.max(l.max(a, b), c))
}

/// First and last sample between three coordinates, `error` allowed for.
#[inline(always)]
fn samples<L: Lanes>(l: L, corners: [L::V; 3], error: L::V) -> [L::V; 2] {
    let (low, high) = spread(l, corners);
    let low = l.max(l.sub(low, error), l.splat(0.0));
    let high = l.min(l.add(high, error), l.splat(LAST));
    [l.ceil(low), l.floor(high)]
}

impl<L: Lanes> Group<L> {
    /// `None` when no triangle may cover a sample.
    #[inline(always)]
    fn new(l: L, scratch: &Projected, (numbers, used): (&cluster::Group, usize)) -> Option<Self> {
        let places = cluster::places(numbers);
        let reach = l.splat(scratch.error + scratch.away);
        let xs = gather(l, &scratch.x, &places);
        let columns = samples(l, xs, reach);
        let ys = gather(l, &scratch.y, &places);
        let rows = samples(l, ys, reach);
        let none = l.less(columns[1], columns[0]) | l.less(rows[1], rows[0]);
        let alive = ALL >> (LANES - used) & !none;
        if alive == 0 {
            return None;
        }
        let nearness = gather(l, &scratch.nearness, &places);
        Some(Self::edges(
            l,
            [xs, ys, nearness],
            (columns, rows),
            (scratch, alive),
        ))
    }

    #[inline(always)]
    fn edges(
        l: L,
        [xs, ys, nearness]: [[L::V; 3]; 3],
        (columns, rows): ([L::V; 2], [L::V; 2]),
        (scratch, alive): (&Projected, u32),
    ) -> Self {
        let (ux, uy) = (l.sub(xs[1], xs[0]), l.sub(ys[1], ys[0]));
        let (vx, vy) = (l.sub(xs[2], xs[0]), l.sub(ys[2], ys[0]));
        let area = l.sub(l.mul(ux, vy), l.mul(uy, vx));
        let size = l.abs(area);
        let extent = l.add(l.add(l.abs(ux), l.abs(uy)), l.add(l.abs(vx), l.abs(vy)));
        // Corners that are off, then the roundings of the functions up to a few lanes beyond.
        let error = l.splat(scratch.error);
        let beyond = l.splat(8.0 + 2.0 * scratch.away);
        let rounding = l.mul(l.add(extent, beyond), l.splat(8.0 * ULP));
        let doubt = l.mul(l.mul_add(error, l.splat(3.0), rounding), extent);
        let (low, high) = spread(l, nearness);
        // Inside, nearness is a mean of the corners', weighted by the functions.
        let uncertain = l.mul(l.sub(high, low), l.mul(doubt, l.splat(4.0)));
        let tolerable = l.mul(l.mul(size, low), l.splat(0.2 * DOUBT));
        let fine = l.less(l.add(doubt, doubt), size) & l.less(uncertain, tolerable);
        let zero = l.splat(0.0);
        let turned = l.less(area, zero);
        let (mut at, mut along_x, mut along_y) = ([zero; 3], [zero; 3], [zero; 3]);
        for (edge, (from, to)) in [(1, 2), (2, 0), (0, 1)].into_iter().enumerate() {
            let (dx, dy) = (l.sub(xs[to], xs[from]), l.sub(ys[to], ys[from]));
            let dx = l.pick(turned, l.sub(zero, dx), dx);
            let dy = l.pick(turned, l.sub(zero, dy), dy);
            let (x, y) = (l.sub(columns[0], xs[from]), l.sub(rows[0], ys[from]));
            at[edge] = l.sub(l.mul(dx, y), l.mul(dy, x));
            along_x[edge] = l.sub(zero, dy);
            along_y[edge] = dx;
        }
        let scale = l.div(l.splat(1.0), size);
        Self {
            columns,
            rows,
            at,
            along_x,
            along_y,
            doubt,
            nearness: [
                l.mul(nearness[0], scale),
                l.mul(nearness[1], scale),
                l.mul(nearness[2], scale),
            ],
            nearest: high,
            alive,
            fine,
        }
    }

    #[inline(always)]
    fn draw(&self, l: L, brush: &mut Brush<'_>, numbers: &cluster::Group) {
        let one = l.splat(1.0);
        let large = l.less(l.add(self.columns[0], one), self.columns[1])
            | l.less(l.add(self.rows[0], one), self.rows[1]);
        let large = if brush.bent.is_some() { ALL } else { large };
        let good = self.alive & self.fine;
        if good & !large != 0 {
            self.draw_small(l, brush, numbers, good & !large);
        }
        if good & large != 0 {
            self.draw_large(l, brush, numbers, good & large);
        }
        let bad = self.alive & !self.fine;
        if bad != 0 {
            let stored = self.stored(l);
            for lane in SetBits(bad) {
                let triangle = cluster::number(numbers, lane);
                stored.draw_exactly(l, brush, (lane, triangle, stored.nearest[lane]));
            }
        }
    }

    /// Draws the triangles of some lanes, which cover at most two samples a side: sample by sample,
    /// all triangles at a time.
    #[inline(always)]
    fn draw_small(&self, l: L, brush: &mut Brush<'_>, numbers: &cluster::Group, bits: u32) {
        let first = l.mul_add(self.rows[0], l.splat(STRIDE as f32), self.columns[0]);
        let first = l.store(first);
        let below = l.sub(l.splat(0.0), self.doubt);
        let wide = l.less(self.columns[0], self.columns[1]);
        let high = l.less(self.rows[0], self.rows[1]);
        for (x, y) in [(false, false), (true, false), (false, true), (true, true)] {
            let bits = bits & if x { wide } else { ALL } & if y { high } else { ALL };
            if bits == 0 {
                continue;
            }
            let mut at = self.at;
            for edge in 0..3 {
                if x {
                    at[edge] = l.add(at[edge], self.along_x[edge]);
                }
                if y {
                    at[edge] = l.add(at[edge], self.along_y[edge]);
                }
            }
            let least = l.min(l.min(at[0], at[1]), at[2]);
            let inside = bits & l.less(self.doubt, least);
            let maybe = bits & !inside & !l.less(least, below);
            if inside | maybe == 0 {
                continue;
            }
            let nearness = l.store(weighted(l, at, self.nearness));
            let step = usize::from(x) + if y { STRIDE } else { 0 };
            for lane in SetBits(inside) {
                let offer = (cluster::number(numbers, lane), nearness[lane]);
                let index = whole(first[lane]) + step;
                if !brush.tile.try_offer(index, offer) {
                    brush.settle(index, offer.0, Some(offer.1));
                }
            }
            for lane in SetBits(maybe) {
                let index = whole(first[lane]) + step;
                if !brush.tile.surely_hides(index, nearness[lane]) {
                    brush.settle(index, cluster::number(numbers, lane), None);
                }
            }
        }
    }

    /// Draws the triangles of some lanes: triangle by triangle, eight samples at a time.
    #[inline(always)]
    fn draw_large(&self, l: L, brush: &mut Brush<'_>, numbers: &cluster::Group, bits: u32) {
        let stored = self.stored(l);
        let bent = brush.bent;
        for lane in SetBits(bits) {
            let which = (lane, cluster::number(numbers, lane));
            match bent {
                None => stored.draw(l, brush, which),
                Some(bent) => stored.draw_bent(l, brush, bent, which),
            }
        }
    }

    #[inline(always)]
    fn stored(&self, l: L) -> Stored {
        Stored {
            columns: [l.store(self.columns[0]), l.store(self.columns[1])],
            rows: [l.store(self.rows[0]), l.store(self.rows[1])],
            at: [
                l.store(self.at[0]),
                l.store(self.at[1]),
                l.store(self.at[2]),
            ],
            along_x: [
                l.store(self.along_x[0]),
                l.store(self.along_x[1]),
                l.store(self.along_x[2]),
            ],
            along_y: [
                l.store(self.along_y[0]),
                l.store(self.along_y[1]),
                l.store(self.along_y[2]),
            ],
            nearness: [
                l.store(self.nearness[0]),
                l.store(self.nearness[1]),
                l.store(self.nearness[2]),
            ],
            doubt: l.store(self.doubt),
            nearest: l.store(self.nearest),
        }
    }
}

#[inline(always)]
pub(super) fn weighted<L: Lanes>(l: L, at: [L::V; 3], values: [L::V; 3]) -> L::V {
    let sum = l.mul(at[0], values[0]);
    l.mul_add(at[2], values[2], l.mul_add(at[1], values[1], sum))
}

#[inline(always)]
pub(super) fn spot(column: f32, row: f32) -> Spot {
    Spot {
        column: whole(column),
        row: whole(row),
    }
}
