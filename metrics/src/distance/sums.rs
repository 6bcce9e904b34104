//! Sums over pairs of points, from which a motion is fitted.
#![allow(
    clippy::needless_range_loop,
    reason = "one index runs over several columns"
)]

use super::blocks::{Block, LANES};
use super::search::square_of;
use glam::DVec3;

/// Sums over pairs; positions are taken about a centre.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(crate) struct PairSums {
    /// Pairs nearer than the maximal distance.
    pub(crate) pairs: usize,
    /// Σ |target − source|².
    pub(crate) squares: f64,
    /// Σ source.
    pub(crate) source: DVec3,
    /// Σ target.
    pub(crate) target: DVec3,
    /// Σ target sourceᵀ, by columns of the source axis.
    pub(crate) cross: [DVec3; 3],
    /// Σ |source|².
    pub(crate) source_squares: f64,
}

impl PairSums {
    pub(super) fn join(mut self, other: &Self) -> Self {
        self.pairs += other.pairs;
        self.squares += other.squares;
        self.source += other.source;
        self.target += other.target;
        for (column, other) in self.cross.iter_mut().zip(other.cross) {
            *column += other;
        }
        self.source_squares += other.source_squares;
        self
    }
}

#[inline(always)]
pub(super) fn squared_distance_at(a: &Block, b: &Block, lane: usize) -> f64 {
    square_of(
        a.x[lane] - b.x[lane],
        a.y[lane] - b.y[lane],
        a.z[lane] - b.z[lane],
    )
}

/// [`PairSums`], lane by lane: the same at any width of registers.
#[derive(Default)]
pub(super) struct LaneSums {
    pairs: usize,
    squares: [f64; LANES],
    source: Block3,
    target: Block3,
    cross: [Block3; 3],
    source_squares: [f64; LANES],
}

/// Three columns of sums.
type Block3 = [[f64; LANES]; 3];

impl LaneSums {
    /// Adds the pairs of the first lanes whose square is below the bound.
    #[inline(always)]
    pub(super) fn add(
        &mut self,
        at: &Block,
        partners: &Block,
        lanes: usize,
        bound: f64,
        centre: DVec3,
    ) {
        for lane in 0..LANES {
            let square = squared_distance_at(at, partners, lane);
            let paired = square < bound && lane < lanes;
            let or_zero = |value: f64| if paired { value } else { 0.0 };
            self.pairs += usize::from(paired);
            self.squares[lane] += or_zero(square);
            let source = [
                or_zero(at.x[lane] - centre.x),
                or_zero(at.y[lane] - centre.y),
                or_zero(at.z[lane] - centre.z),
            ];
            let target = [
                or_zero(partners.x[lane] - centre.x),
                or_zero(partners.y[lane] - centre.y),
                or_zero(partners.z[lane] - centre.z),
            ];
            for row in 0..3 {
                self.source[row][lane] += source[row];
                self.target[row][lane] += target[row];
                for column in 0..3 {
                    self.cross[column][row][lane] += target[row] * source[column];
                }
            }
            self.source_squares[lane] += square_of(source[0], source[1], source[2]);
        }
    }

    pub(super) fn total(&self) -> PairSums {
        let sum = |lanes: &[f64; LANES]| lanes.iter().sum::<f64>();
        let vector = |rows: &Block3| DVec3::new(sum(&rows[0]), sum(&rows[1]), sum(&rows[2]));
        PairSums {
            pairs: self.pairs,
            squares: sum(&self.squares),
            source: vector(&self.source),
            target: vector(&self.target),
            cross: [
                vector(&self.cross[0]),
                vector(&self.cross[1]),
                vector(&self.cross[2]),
            ],
            source_squares: sum(&self.source_squares),
        }
    }
}
