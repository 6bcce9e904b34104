//! Triangles drawn into a tile one by one, eight samples at a time.

#![allow(
    clippy::needless_range_loop,
    reason = "columns are walked side by side, and closures would leave the instruction set"
)]

use super::bent::Bent;
use super::doubts::Doubt;
use super::lanes::{ALL, LANES, Lanes, SetBits, Task, dispatch};
use super::raster::{Brush, between, spot, spread};
use super::tile::Spot;

/// What is known about eight triangles, in memory: see [`super::raster`].
pub(super) struct Stored {
    pub(super) columns: [[f32; LANES]; 2],
    pub(super) rows: [[f32; LANES]; 2],
    pub(super) at: [[f32; LANES]; 3],
    pub(super) along_x: [[f32; LANES]; 3],
    pub(super) along_y: [[f32; LANES]; 3],
    pub(super) nearness: [[f32; LANES]; 3],
    pub(super) doubt: [f32; LANES],
    pub(super) nearest: [f32; LANES],
}

const STEPS: [f32; LANES] = [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0];

impl Stored {
    /// Draws a triangle. No call is in its loops, or what they need would not stay in registers: if something is
    /// in doubt, its samples are gone through again.
    #[inline(always)]
    pub(super) fn draw<L: Lanes>(
        &self,
        l: L,
        brush: &mut Brush<'_>,
        (lane, triangle): (usize, u32),
    ) {
        let from = spot(self.columns[0][lane], self.rows[0][lane]);
        let to = spot(self.columns[1][lane], self.rows[1][lane]);
        let steps = l.load(&STEPS);
        let pen = Pen::of(l, self, lane);
        let one = l.splat(1.0);
        let (mut start, mut down) = ([steps; 3], [steps; 3]);
        for edge in 0..3 {
            let along = l.splat(self.along_x[edge][lane]);
            start[edge] = l.mul_add(along, steps, l.splat(self.at[edge][lane]));
            down[edge] = l.splat(self.along_y[edge][lane]);
        }
        let stride = brush.tile.stride();
        let mut settled = l.below(l.splat(0.0), one);
        // Most are no wider than one stroke.
        let mut first = from.column;
        loop {
            let mut y = l.splat(0.0);
            let index = from.row * stride + first;
            let end = to.row * stride + first + LANES;
            let mut canvas = brush.tile.canvas().cut(index..end);
            let mut row = 0;
            while let Some(samples) = canvas.at(row) {
                row += stride;
                let mut at = start;
                for edge in 0..3 {
                    at[edge] = l.mul_add(down[edge], y, start[edge]);
                }
                y = l.add(y, one);
                let (near, known) = pen.judge(l, at);
                settled = l.and(settled, samples.try_offer(l, (triangle, near), known));
            }
            first += LANES;
            if first > to.column {
                break;
            }
            let right = l.splat((first - from.column) as f32);
            for edge in 0..3 {
                let along = l.splat(self.along_x[edge][lane]);
                let corner = l.mul_add(along, right, l.splat(self.at[edge][lane]));
                start[edge] = l.mul_add(along, steps, corner);
            }
        }
        if l.bits(settled) != ALL {
            doubt_samples(self, brush, (lane, triangle));
        }
    }

    /// Draws a triangle that f32 cannot judge: where it is not clearly outside, and what is there is
    /// not clearly nearer than its nearest corner, the exact test decides.
    #[inline(always)]
    pub(super) fn draw_exactly<L: Lanes>(
        &self,
        l: L,
        brush: &mut Brush<'_>,
        (lane, triangle, nearest): (usize, u32, f32),
    ) {
        let from = spot(self.columns[0][lane], self.rows[0][lane]);
        let to = spot(self.columns[1][lane], self.rows[1][lane]);
        let (above, below) = (l.splat(self.doubt[lane]), l.splat(-self.doubt[lane]));
        let (bent, stride) = (brush.bent, brush.tile.stride());
        for row in from.row..=to.row {
            for first in (from.column..=to.column).step_by(LANES) {
                let at = self.edges(l, lane, (places(l, bent, (first, row)), from));
                let (least, greatest) = spread(l, at);
                let outside = l.less(least, below) & l.less(above, greatest);
                let last = (to.column - first).min(LANES - 1);
                for lane in SetBits(!outside & ALL >> (LANES - 1 - last)) {
                    let index = row * stride + first + lane;
                    if !brush.tile.surely_hides(index, nearest) {
                        brush.doubt(Doubt {
                            index,
                            triangle,
                            nearness: nearest,
                            met: false,
                        });
                    }
                }
            }
        }
    }

    /// As [`Self::draw`] for samples that a lens has moved.
    #[inline(always)]
    pub(super) fn draw_bent<L: Lanes>(
        &self,
        l: L,
        brush: &mut Brush<'_>,
        bent: &Bent,
        (lane, triangle): (usize, u32),
    ) {
        let from = spot(self.columns[0][lane], self.rows[0][lane]);
        let to = spot(self.columns[1][lane], self.rows[1][lane]);
        let pen = Pen::of(l, self, lane);
        for row in from.row..=to.row {
            for first in (from.column..=to.column).step_by(LANES) {
                let at = self.edges(l, lane, (places(l, Some(bent), (first, row)), from));
                let index = brush.tile.index(Spot { column: first, row });
                pen.stroke(l, brush, (index, triangle), at);
            }
        }
    }

    /// The edge functions at eight places, for a triangle whose first column and row are known.
    #[inline(always)]
    fn edges<L: Lanes>(&self, l: L, lane: usize, ([x, y], from): ([L::V; 2], Spot)) -> [L::V; 3] {
        let right = l.sub(x, l.splat(from.column as f32));
        let down = l.sub(y, l.splat(from.row as f32));
        let mut at = [right; 3];
        for edge in 0..3 {
            let (along, below) = (self.along_x[edge][lane], self.along_y[edge][lane]);
            let start = l.mul_add(l.splat(below), down, l.splat(self.at[edge][lane]));
            at[edge] = l.mul_add(l.splat(along), right, start);
        }
        at
    }
}

#[cold]
#[inline(never)]
fn doubt_samples(triangles: &Stored, brush: &mut Brush<'_>, which: (usize, u32)) {
    dispatch(Hesitate(triangles, brush, which));
}

/// Has it decided later which samples see a triangle that has been drawn: those that may, unless what is there
/// shows it already or clearly hides it. Rounded otherwise than in the strokes, which the doubts allow for.
struct Hesitate<'s, 'b>(&'s Stored, &'s mut Brush<'b>, (usize, u32));

impl Task for Hesitate<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self, l: L) {
        let Self(triangles, brush, (lane, triangle)) = self;
        let from = spot(triangles.columns[0][lane], triangles.rows[0][lane]);
        let to = spot(triangles.columns[1][lane], triangles.rows[1][lane]);
        let pen = Pen::of(l, triangles, lane);
        for row in from.row..=to.row {
            // Strokes reach beyond the last column.
            for first in (from.column..=to.column).step_by(LANES) {
                let at = triangles.edges(l, lane, (places(l, None, (first, row)), from));
                let (near, (inside, beside)) = pen.judge(l, at);
                let index = brush.tile.index(Spot { column: first, row });
                let mut canvas = brush.tile.canvas();
                let Some(samples) = canvas.at(index) else {
                    continue;
                };
                let open = samples.open(l, (triangle, near));
                let (near, inside) = (l.store(near), l.bits(inside));
                for lane in SetBits(open & !l.bits(beside)) {
                    brush.doubt(Doubt {
                        index: index + lane,
                        triangle,
                        nearness: near[lane],
                        met: inside >> lane & 1 == 1,
                    });
                }
            }
        }
    }
}

/// What draws one triangle, eight samples at a time.
struct Pen<V> {
    doubt: V,
    below: V,
    nearness: [V; 3],
}

impl<V: Copy> Pen<V> {
    #[inline(always)]
    fn of<L: Lanes<V = V>>(l: L, triangles: &Stored, lane: usize) -> Self {
        let (doubt, nearness) = (triangles.doubt[lane], &triangles.nearness);
        Self {
            doubt: l.splat(doubt),
            below: l.splat(-doubt),
            nearness: [
                l.splat(nearness[0][lane]),
                l.splat(nearness[1][lane]),
                l.splat(nearness[2][lane]),
            ],
        }
    }

    /// Offers the triangle to the samples from `index` on at which its edge functions are `at`.
    #[inline(always)]
    fn stroke<L: Lanes<V = V>>(
        &self,
        l: L,
        brush: &mut Brush<'_>,
        (index, triangle): (usize, u32),
        at: [V; 3],
    ) {
        let (near, known) = self.judge(l, at);
        offer_lanes(l, brush, (index, triangle, near), known);
    }

    /// How near the triangle is where its edge functions are `at`, and whether it surely is seen there, and surely
    /// not.
    #[inline(always)]
    fn judge<L: Lanes<V = V>>(&self, l: L, at: [V; 3]) -> (V, (L::M, L::M)) {
        let least = l.min(l.min(at[0], at[1]), at[2]);
        let beside = l.below(least, self.below);
        // Whether all lie beside it cannot be foreseen: nothing branches on it.
        let near = between(l, at, self.nearness);
        (near, (l.below(self.doubt, least), beside))
    }
}

/// Where eight samples from one on lie.
#[inline(always)]
fn places<L: Lanes>(l: L, bent: Option<&Bent>, (column, row): (usize, usize)) -> [L::V; 2] {
    let index = Spot { column, row }.index();
    if let Some(bent) = bent
        && let Some(x) = bent.x[index..].first_chunk()
        && let Some(y) = bent.y[index..].first_chunk()
    {
        return [l.load(x), l.load(y)];
    }
    let x = l.add(l.splat(column as f32), l.load(&STEPS));
    [x, l.splat(row as f32)]
}

/// Offers a triangle to eight samples, and settles what is in doubt.
#[inline(always)]
fn offer_lanes<L: Lanes>(
    l: L,
    brush: &mut Brush<'_>,
    (index, triangle, near): (usize, u32, L::V),
    (inside, beside): (L::M, L::M),
) {
    let mut canvas = brush.tile.canvas();
    let Some(samples) = canvas.at(index) else {
        return;
    };
    let settled = l.bits(samples.try_offer(l, (triangle, near), (inside, beside)));
    if settled != ALL {
        let (near, inside) = (l.store(near), l.bits(inside));
        for lane in SetBits(!settled & ALL) {
            brush.doubt(Doubt {
                index: index + lane,
                triangle,
                nearness: near[lane],
                met: inside >> lane & 1 == 1,
            });
        }
    }
}
