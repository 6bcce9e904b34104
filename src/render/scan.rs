//! Which clusters a tile may see, nearest first, and which of them are hidden already.

use super::bent::Bent;
use super::clusters::{Child, Clusters, WIDTH, Wide};
use super::doubts::Doubts;
use super::lanes::{LANES, Lanes, SetBits, Task, dispatch, whole};
use super::lens::{Grid, Lens, Place, Projected};
use super::raster::Brush;
use super::sieve::{Offers, Sieve};
use super::tile::{SIDE, Spot, Tile};
use glam::{DMat3, DVec2, DVec3};

/// Rounding of boxes in the camera frame, relative to the coordinates that enter.
const ROUNDING: f32 = 1e-6;
const _: () = assert!(WIDTH == LANES);
/// Cache lines of a cluster that are fetched when it is found, and when it is next.
const HEAD_LINES: usize = 2;
const CLUSTER_LINES: usize = 20;

/// Finds what is visible in a tile of `width` × `height` samples at `place`, which a lens may have bent.
pub(crate) fn scan(
    clusters: &Clusters,
    (place, bent): (&Place<'_>, Option<&Bent>),
    (width, height): (usize, usize),
) -> Tile {
    let mut tile = Tile::new(width, height);
    let (grid, away) = match bent {
        Some(bent) => (bent.grid, bent.away),
        None => (Grid::of(place), 0.0),
    };
    if let Some(bent) = bent {
        tile.close_where(|index| !bent.has_ray(index));
    }
    let stand = (place.eye.rotation, place.eye.center_in_cam);
    let lens = Lens::new(stand, &grid);
    let gaze = Gaze::new(stand, (&grid, away), (width, height));
    let mut brush = Brush {
        tile: &mut tile,
        place,
        bent,
        lens: &lens,
        scratch: &mut Projected::new(away, (width, height)),
        sieve: &mut Sieve::new(),
        offers: &mut Offers::new(),
        doubts: &mut Doubts::default(),
    };
    let mut stack = vec![Waiting::ROOT];
    let mut next: Option<(Waiting, u32)> = None;
    loop {
        // The cluster after this one is looked for first, so that it is fetched meanwhile.
        let after = next_cluster(clusters, &gaze, brush.tile, &mut stack);
        if let Some((_, index)) = after {
            clusters.fetch(Child::Cluster(index), CLUSTER_LINES);
        }
        match next {
            Some((waiting, index))
                if !brush
                    .tile
                    .hides((waiting.from, waiting.to), waiting.nearness) =>
            {
                brush.draw(&clusters.cluster(index));
            }
            None if after.is_none() => break,
            _ => {}
        }
        next = after;
    }
    brush.settle_doubts();
    tile
}

/// Takes the nearest cluster that is not hidden.
fn next_cluster(
    clusters: &Clusters,
    gaze: &Gaze,
    tile: &mut Tile,
    stack: &mut Vec<Waiting>,
) -> Option<(Waiting, u32)> {
    while let Some(next) = stack.pop() {
        if tile.hides((next.from, next.to), next.nearness) {
            continue;
        }
        match next.child {
            Child::None => {}
            Child::Cluster(index) => return Some((next, index)),
            Child::Node(index) => {
                let first = stack.len();
                dispatch(Look(gaze, &clusters.nodes[index as usize], stack));
                for entry in &stack[first..] {
                    clusters.fetch(entry.child, HEAD_LINES);
                }
                stack[first..].sort_unstable_by(|a, b| b.depth.total_cmp(&a.depth));
            }
        }
    }
    None
}

/// A part of the tree that the tile may see.
#[derive(Debug, Clone, Copy)]
pub(super) struct Waiting {
    pub(super) child: Child,
    /// From where on, in z-depth, it lies.
    pub(super) depth: f32,
    /// The inverse of `depth`; infinite where that is not positive.
    pub(super) nearness: f32,
    /// The samples that it may cover, if it lies before the camera as a whole.
    pub(super) from: Spot,
    pub(super) to: Spot,
}

impl Waiting {
    pub(super) const ROOT: Self = Self {
        child: Child::Node(0),
        depth: 0.0,
        nearness: f32::INFINITY,
        from: Spot { column: 0, row: 0 },
        to: Spot { column: 0, row: 0 },
    };
}

/// A tile's view of boxes, in f32.
pub(super) struct Gaze {
    rotation: [[f32; 3]; 3],
    center_in_cam: [f32; 3],
    rounding: f32,
    /// x / z and y / z at the tile's outer borders.
    low: [f32; 2],
    high: [f32; 2],
    /// Samples per unit of x / z and y / z.
    scale: [f32; 2],
    /// How far samples are from whole numbers at most.
    away: f32,
    /// The last used sample.
    last: [f32; 2],
}

impl Gaze {
    #[allow(
        clippy::cast_possible_truncation,
        reason = "boxes are enlarged by ROUNDING"
    )]
    pub(super) fn new(
        (rotation, center): (DMat3, DVec3),
        (grid, away): (&Grid, f32),
        (width, height): (usize, usize),
    ) -> Self {
        debug_assert!(width <= SIDE && height <= SIDE);
        let border = |sample: f64| (DVec2::splat(sample) - grid.shift) / grid.focal;
        // One sample more on each side than the sample centres need.
        let low = border(-1.0 - f64::from(away));
        let high = DVec2::new(width as f64, height as f64) + f64::from(away);
        let high = (high - grid.shift) / grid.focal;
        Self {
            rotation: rotation
                .transpose()
                .to_cols_array_2d()
                .map(|row| row.map(|v| v as f32)),
            center_in_cam: center.as_vec3().to_array(),
            rounding: ROUNDING * center.length() as f32,
            low: low.as_vec2().to_array(),
            high: high.as_vec2().to_array(),
            scale: grid.focal.as_vec2().to_array(),
            away,
            last: [(width - 1) as f32, (height - 1) as f32],
        }
    }

    /// Low and high ends of eight boxes along an axis of the camera; NaN where there is no box.
    #[inline(always)]
    fn turned<L: Lanes>(&self, l: L, node: &Wide, axis: usize) -> [L::V; 2] {
        let half = l.splat(0.5);
        let mut center = l.splat(self.center_in_cam[axis]);
        let mut reach = l.splat(self.rounding);
        for k in 0..3 {
            let (low, high) = (l.load(&node.low[k]), l.load(&node.high[k]));
            let middle = l.mul(half, l.add(high, low));
            let side = l.mul(half, l.sub(high, low));
            let factor = self.rotation[axis][k];
            center = l.mul_add(l.splat(factor), middle, center);
            reach = l.mul_add(l.splat(factor.abs() + ROUNDING), side, reach);
            reach = l.mul_add(l.splat(ROUNDING), l.abs(middle), reach);
        }
        [l.sub(center, reach), l.add(center, reach)]
    }

    /// First and last samples that may be covered along an axis of the image, by eight boxes that
    /// reach from `low` to `high` and have inverse depths between those given; and which boxes do
    /// not lie beside the tile's pyramid.
    #[inline(always)]
    fn samples<L: Lanes>(
        &self,
        l: L,
        axis: usize,
        [low, high]: [L::V; 2],
        ([near, far], [nearness, farness]): ([L::V; 2], [L::V; 2]),
    ) -> ([L::V; 2], u32) {
        let (left, right) = (l.splat(self.low[axis]), l.splat(self.high[axis]));
        let start = l.min(l.mul(left, near), l.mul(left, far));
        let end = l.max(l.mul(right, near), l.mul(right, far));
        let beside = l.less(high, start) | l.less(end, low);
        let scale = l.splat(self.scale[axis]);
        let (zero, last) = (l.splat(0.0), l.splat(self.last[axis]));
        let first = l.min(l.mul(low, nearness), l.mul(low, farness));
        let first = l.mul_add(l.sub(first, left), scale, l.splat(-2.0 - 2.0 * self.away));
        let end = l.max(l.mul(high, nearness), l.mul(high, farness));
        let end = l.mul_add(l.sub(end, left), scale, l.splat(1.0));
        // `left` is one sample, and how far they are away, before the tile's first centre; NaN becomes
        // the first sample.
        let first = l.min(l.max(first, zero), last);
        let end = l.min(l.max(end, zero), last);
        ([l.floor(first), l.floor(end)], !beside)
    }
}

/// Adds the node's children that the tile may see.
pub(super) struct Look<'g>(
    pub(super) &'g Gaze,
    pub(super) &'g Wide,
    pub(super) &'g mut Vec<Waiting>,
);

impl Task for Look<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self, l: L) {
        let Self(gaze, node, waiting) = self;
        let x = gaze.turned(l, node, 0);
        let y = gaze.turned(l, node, 1);
        let [depth, far] = gaze.turned(l, node, 2);
        let (zero, one) = (l.splat(0.0), l.splat(1.0));
        let inverse = [l.div(one, depth), l.div(one, far)];
        let depths = ([l.max(depth, zero), far], inverse);
        let (columns, in_width) = gaze.samples(l, 0, x, depths);
        let (rows, in_height) = gaze.samples(l, 1, y, depths);
        let seen = l.less(zero, far) & in_width & in_height;
        let ahead = l.less(zero, depth);
        let nearness = l.store(l.pick(ahead, inverse[0], l.splat(f32::INFINITY)));
        let depth = l.store(depth);
        let (left, right) = (l.store(columns[0]), l.store(columns[1]));
        let (top, bottom) = (l.store(rows[0]), l.store(rows[1]));
        for lane in SetBits(seen) {
            waiting.push(Waiting {
                child: node.children[lane],
                depth: depth[lane],
                nearness: nearness[lane],
                from: Spot {
                    column: whole(left[lane]),
                    row: whole(top[lane]),
                },
                to: Spot {
                    column: whole(right[lane]),
                    row: whole(bottom[lane]),
                },
            });
        }
    }
}
