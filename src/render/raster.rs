//! Clusters drawn into a tile: eight triangles at a time, tested in f32 with a known error; what
//! lies within that error of an edge, or of another surface's depth, is decided by the exact test.

#![allow(
    clippy::needless_range_loop,
    reason = "columns are walked side by side, and closures would leave the instruction set"
)]

use super::bent::Bent;
use super::cluster::{Cluster, Eight};
use super::doubts::{Doubt, Doubts};
use super::lanes::{ALL, LANES, Lanes, SetBits, Task, dispatch, whole};
use super::lens::{Lens, Place, Projected, ULP};
use super::near;
use super::sieve::{Offers, Reach, Sieve, sieve};
use super::strokes::Stored;
use super::tile::{DOUBT, Spot, Tile};

/// Samples per triangle up to which a cluster's triangles are sieved.
const SIEVED_AREA: f32 = 4.0;
/// Samples a side up to which triangles are drawn side by side.
pub(super) const SMALL: usize = 5;

/// Draws clusters into one tile.
pub(crate) struct Brush<'t> {
    pub(crate) tile: &'t mut Tile,
    pub(crate) place: &'t Place<'t>,
    /// What a lens does to the samples.
    pub(crate) bent: Option<&'t Bent>,
    pub(crate) lens: &'t Lens,
    pub(crate) scratch: &'t mut Projected,
    pub(crate) sieve: &'t mut Sieve,
    pub(crate) offers: &'t mut Offers,
    pub(crate) doubts: &'t mut Doubts,
}

impl Brush<'_> {
    pub(crate) fn draw(&mut self, cluster: &Cluster<'_>) {
        dispatch(Draw(self, cluster));
    }

    fn draw_exactly(&mut self, triangle: u32, from_to: (Spot, Spot)) {
        near::draw(self.tile, (self.place, self.bent), triangle, from_to);
    }

    #[inline(always)]
    fn draw_eight<L: Lanes>(&mut self, l: L, eight: &Eight) {
        let reach = Reach::of(l, self.scratch, eight);
        if reach.alive != 0 {
            if self.offers.is_full() {
                self.settle_offers();
            }
            let nearness = l.gather(&self.scratch.nearness, self.scratch.few, &eight.places);
            Group::new(l, reach, nearness, self.scratch).draw(l, self, eight);
        }
    }

    /// Makes visible what has been offered and is nearer than what is there.
    #[inline(always)]
    fn settle_offers(&mut self) {
        let doubts = &mut *self.doubts;
        let mut full = false;
        let unsure = |index, (triangle, nearness)| {
            let doubt = Doubt {
                index,
                triangle,
                nearness,
                met: true,
            };
            full |= doubts.put(doubt);
        };
        self.tile.try_offers(self.offers.take(), unsure);
        if full {
            self.settle_doubts();
        }
    }

    /// Settles whether some triangles are seen at one sample each.
    #[inline(always)]
    fn settle_lanes(
        &mut self,
        (bits, eight): (u32, &Eight),
        indices: [f32; LANES],
        nearness: [f32; LANES],
    ) {
        for lane in SetBits(bits) {
            let index = whole(indices[lane]);
            if !self.tile.surely_hides(index, nearness[lane]) {
                self.doubt(Doubt {
                    index,
                    triangle: eight.number(lane),
                    nearness: nearness[lane],
                    met: false,
                });
            }
        }
    }

    /// Has it decided later whether a triangle is seen at a sample.
    #[cold]
    #[inline(never)]
    pub(super) fn doubt(&mut self, doubt: Doubt) {
        if self.doubts.put(doubt) {
            self.settle_doubts();
        }
    }

    /// Decides what is in doubt by the exact test.
    pub(crate) fn settle_doubts(&mut self) {
        let frame = &self.place.eye.frame;
        let hidden = |doubt: &Doubt| self.tile.surely_hides(doubt.index, doubt.nearness);
        for doubt in self.doubts.take(frame, hidden) {
            self.settle(doubt);
        }
    }

    fn settle(&mut self, doubt: Doubt) {
        let Doubt {
            index, triangle, ..
        } = doubt;
        let stride = self.tile.stride();
        let spot = Spot {
            column: index % stride,
            row: index / stride,
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
        let known = doubt.met.then_some(doubt.nearness);
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
            let [column, row] = brush.scratch.last;
            let whole = (spot(0.0, 0.0), spot(column, row));
            for (_, triangle) in cluster.triangles() {
                brush.draw_exactly(triangle, whole);
            }
            return;
        }
        let error = brush.scratch.error + brush.scratch.away;
        let [left, right, top, bottom] = brush.scratch.extent;
        let last = brush.scratch.last;
        let (Some(columns), Some(rows)) = (
            covered(left - error, right + error, last[0]),
            covered(top - error, bottom + error, last[1]),
        ) else {
            return;
        };
        if is_fine(brush.scratch.extent, cluster.count()) {
            sieve(l, cluster, brush.scratch, brush.sieve);
            let mut first = 0;
            while let Some(eight) = brush.sieve.eight(first) {
                brush.draw_eight(l, &eight);
                first += LANES;
            }
        } else {
            for group in 0..cluster.groups() {
                brush.draw_eight(l, &cluster.eight(group));
            }
        }
        brush.settle_offers();
        let [from, to] = [0, 1].map(|end| Spot {
            column: [columns.0, columns.1][end],
            row: [rows.0, rows.1][end],
        });
        brush.tile.touch(from, to);
    }
}

/// Whether triangles of a cluster with this extent are mostly smaller than the distance of samples.
#[inline(always)]
fn is_fine([left, right, top, bottom]: [f32; 4], triangles: usize) -> bool {
    (right - left) * (bottom - top) < SIEVED_AREA * triangles as f32
}

/// First and last sample between two coordinates, up to the tile's last; `None` when there is none.
#[inline(always)]
fn covered(low: f32, high: f32, last: f32) -> Option<(usize, usize)> {
    if !(low <= last && high >= 0.0) {
        return None;
    }
    #[allow(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "between 0 and SIDE"
    )]
    let (first, last) = (low.max(0.0).ceil() as usize, high.min(last) as usize);
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
    /// Nearness at the first corner, and what the others add to it by their functions.
    nearness: [L::V; 3],
    /// That of the nearest corner.
    nearest: L::V,
    /// Lanes with a triangle that may be seen, and those for which f32 is good enough.
    alive: u32,
    fine: u32,
}

/// Least and greatest of three.
#[inline(always)]
pub(super) fn spread<L: Lanes>(l: L, [a, b, c]: [L::V; 3]) -> (L::V, L::V) {
    (l.min(l.min(a, b), c), l.max(l.max(a, b), c))
}

impl<L: Lanes> Group<L> {
    #[inline(always)]
    fn new(l: L, reach: Reach<L>, nearness: [L::V; 3], scratch: &Projected) -> Self {
        let Reach {
            xs,
            ys,
            columns,
            rows,
            alive,
        } = reach;
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
                nearness[0],
                l.mul(l.sub(nearness[1], nearness[0]), scale),
                l.mul(l.sub(nearness[2], nearness[0]), scale),
            ],
            nearest: high,
            alive,
            fine,
        }
    }

    #[inline(always)]
    fn draw(&self, l: L, brush: &mut Brush<'_>, eight: &Eight) {
        let most = l.splat((SMALL - 1) as f32);
        let large = l.less(l.add(self.columns[0], most), self.columns[1])
            | l.less(l.add(self.rows[0], most), self.rows[1]);
        let large = if brush.bent.is_some() { ALL } else { large };
        let good = self.alive & self.fine;
        if good & !large != 0 {
            self.draw_small(l, brush, eight, good & !large);
        }
        if good & large != 0 {
            self.draw_large(l, brush, eight, good & large);
        }
        let bad = self.alive & !self.fine;
        if bad != 0 {
            let stored = self.stored(l);
            for lane in SetBits(bad) {
                let triangle = eight.number(lane);
                stored.draw_exactly(l, brush, (lane, triangle, stored.nearest[lane]));
            }
        }
    }

    /// Draws the triangles of some lanes, which cover at most [`SMALL`] samples a side: sample by sample,
    /// all triangles at a time.
    #[inline(always)]
    fn draw_small(&self, l: L, brush: &mut Brush<'_>, eight: &Eight, bits: u32) {
        let stride = l.splat(brush.tile.stride() as f32);
        let first = l.mul_add(self.rows[0], stride, self.columns[0]);
        let numbers = l.load(&eight.numbers);
        let below = l.sub(l.splat(0.0), self.doubt);
        for y in 0..SMALL {
            let down = l.splat(y as f32);
            let high = bits & !l.less(self.rows[1], l.add(self.rows[0], down));
            if high == 0 {
                break;
            }
            let first = l.mul_add(down, stride, first);
            let mut start = self.at;
            for edge in 0..3 {
                start[edge] = l.mul_add(self.along_y[edge], down, start[edge]);
            }
            for x in 0..SMALL {
                let right = l.splat(x as f32);
                let wide = high & !l.less(self.columns[1], l.add(self.columns[0], right));
                if wide == 0 {
                    break;
                }
                let mut at = start;
                for edge in 0..3 {
                    at[edge] = l.mul_add(self.along_x[edge], right, start[edge]);
                }
                let least = l.min(l.min(at[0], at[1]), at[2]);
                let inside = wide & l.less(self.doubt, least);
                let maybe = wide & !inside & !l.less(least, below);
                let nearness = between(l, at, self.nearness);
                let index = l.add(first, right);
                brush.offers.put(l, inside, [index, nearness, numbers]);
                if maybe != 0 {
                    brush.settle_lanes((maybe, eight), l.store(index), l.store(nearness));
                }
            }
        }
    }

    /// Draws the triangles of some lanes: triangle by triangle, eight samples at a time.
    #[inline(always)]
    fn draw_large(&self, l: L, brush: &mut Brush<'_>, eight: &Eight, bits: u32) {
        let stored = self.stored(l);
        let bent = brush.bent;
        for lane in SetBits(bits) {
            let which = (lane, eight.number(lane));
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

/// How near a triangle is where its edge functions are `at`, from its first corner's nearness and what the others
/// add: so the roundings of the functions, which need not add up to the triangle's size, count for no more than the
/// corners differ.
#[inline(always)]
pub(super) fn between<L: Lanes>(l: L, at: [L::V; 3], [first, second, third]: [L::V; 3]) -> L::V {
    l.mul_add(at[2], third, l.mul_add(at[1], second, first))
}

#[inline(always)]
pub(super) fn spot(column: f32, row: f32) -> Spot {
    Spot {
        column: whole(column),
        row: whole(row),
    }
}
