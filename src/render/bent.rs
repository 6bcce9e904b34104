//! A tile's samples behind a lens: their directions, and where those lie on the tile.
//!
//! Through a lens, samples are no regular grid on the plane at depth 1. They are put onto the grid that
//! fits them best, and the fast paths then evaluate at the places themselves what they otherwise
//! evaluate at whole numbers.

use super::lens::{Grid, Place};
use super::tile::{SIZE, STRIDE, Spot};
use glam::{DVec2, DVec3};

/// How much finer than the camera's own the grid may be.
const FINEST: f64 = 16.0;
/// Where samples without a ray are put: the tile is never seen there.
const NOWHERE: f32 = 0.0;

#[derive(Debug)]
pub(crate) struct Bent {
    /// In the camera frame at depth 1; NaN where no ray is bent to the sample. Indexed as the tile.
    pub(crate) directions: Vec<DVec3>,
    pub(crate) grid: Grid,
    /// Places in samples of the grid.
    pub(crate) x: Vec<f32>,
    pub(crate) y: Vec<f32>,
    /// How far the places are from the samples' whole numbers at most.
    pub(crate) away: f32,
}

impl Bent {
    /// The `width` × `height` samples at `place`; `None` when no ray is bent to any.
    pub(crate) fn new(place: &Place<'_>, (width, height): (usize, usize)) -> Option<Self> {
        let mut directions = vec![DVec3::NAN; STRIDE * SIZE];
        for row in 0..height {
            let found = place.eye.directions(place.column, place.row + row, width);
            for (column, direction) in found.into_iter().enumerate() {
                if direction.is_finite() {
                    directions[Spot { column, row }.index()] = direction.extend(1.0);
                }
            }
        }
        Self::fitted(place.eye.focal, directions, (width, height))
    }

    /// The `width` × `height` samples from one on, on a grid of their own.
    pub(crate) fn part(
        &self,
        focal: DVec2,
        first: Spot,
        (width, height): (usize, usize),
    ) -> Option<Self> {
        let mut directions = vec![DVec3::NAN; STRIDE * SIZE];
        for row in 0..height {
            let to = Spot { column: 0, row }.index();
            let from = first.index() + to;
            directions[to..][..width].copy_from_slice(&self.directions[from..][..width]);
        }
        Self::fitted(focal, directions, (width, height))
    }

    /// Samples on the grid that fits them, which is not much finer than the camera's.
    fn fitted(
        focal: DVec2,
        directions: Vec<DVec3>,
        (width, height): (usize, usize),
    ) -> Option<Self> {
        let (mut low, mut high) = (DVec2::INFINITY, DVec2::NEG_INFINITY);
        for direction in directions.iter().filter(|direction| direction.is_finite()) {
            low = low.min(direction.truncate());
            high = high.max(direction.truncate());
        }
        if !low.is_finite() {
            return None;
        }
        let steps = DVec2::new((width - 1) as f64, (height - 1) as f64);
        let fitting = (steps / (high - low)).min(FINEST * focal);
        // 0 / 0 where there is one sample along an axis.
        let focal = DVec2::select(fitting.cmpgt(DVec2::ZERO), fitting, focal);
        let grid = Grid {
            focal,
            shift: -low * focal,
        };
        Some(Self::on(grid, directions))
    }

    fn on(grid: Grid, directions: Vec<DVec3>) -> Self {
        let (mut x, mut y) = (Vec::new(), Vec::new());
        let mut away = 0.0f64;
        for (index, direction) in directions.iter().enumerate() {
            let at = direction.truncate() * grid.focal + grid.shift;
            if direction.is_finite() {
                let whole = DVec2::new((index % STRIDE) as f64, (index / STRIDE) as f64);
                away = away.max((at - whole).abs().max_element());
            }
            #[allow(clippy::cast_possible_truncation, reason = "allowed for in errors")]
            let place = |at: f64| if at.is_finite() { at as f32 } else { NOWHERE };
            x.push(place(at.x));
            y.push(place(at.y));
        }
        #[allow(
            clippy::cast_possible_truncation,
            reason = "a bound with room to spare"
        )]
        let away = (away + 1e-3) as f32;
        Self {
            directions,
            grid,
            x,
            y,
            away,
        }
    }

    /// Whether a ray is bent to a sample.
    pub(crate) fn has_ray(&self, index: usize) -> bool {
        self.directions[index].is_finite()
    }

    /// Corners of a rectangle around the directions of a block, both ends included; `None` without
    /// rays.
    pub(crate) fn corners(&self, (from, to): (Spot, Spot)) -> Option<[DVec3; 4]> {
        let (mut low, mut high) = (DVec2::INFINITY, DVec2::NEG_INFINITY);
        for row in from.row..=to.row {
            for column in from.column..=to.column {
                let direction = self.directions[Spot { column, row }.index()];
                if direction.is_finite() {
                    low = low.min(direction.truncate());
                    high = high.max(direction.truncate());
                }
            }
        }
        let corners = [
            low,
            DVec2::new(high.x, low.y),
            DVec2::new(low.x, high.y),
            high,
        ];
        low.is_finite()
            .then(|| corners.map(|corner| corner.extend(1.0)))
    }
}
