//! What a search for partners remembers, lane by lane.
#![allow(
    clippy::needless_range_loop,
    reason = "one index runs over several columns"
)]

use super::blocks::{Block, LANES};
use super::search::{Found, joined, smaller, squares};
use super::wide::Width;
use glam::DVec3;

/// No partner.
pub(super) const NONE: u32 = u32::MAX;

/// Per lane the squared distance of the nearest target found or the bound that it came with, and its
/// place in the index's blocks, or [`NONE`].
#[derive(Clone, Copy)]
pub(super) struct Closest {
    pub(super) best: [f64; LANES],
    pub(super) partner: [u32; LANES],
}

impl Closest {
    pub(super) const NOTHING: Self = Self {
        best: [0.0; LANES],
        partner: [NONE; LANES],
    };
}

impl Found for Closest {
    #[inline(always)]
    fn bounds(&self) -> &[f64; LANES] {
        &self.best
    }

    #[inline(always)]
    fn meet(&mut self, width: impl Width, number: usize, block: &Block, lane: usize, query: DVec3) {
        let least = width.least(block, query, self.best[lane]);
        if least < self.best[lane] {
            let first = width.first_within(block, query, least);
            self.partner[lane] = number as u32 * LANES as u32 + first;
            self.best[lane] = least;
        }
    }
}

/// Per lane the nearest target found, and how far away all others are at least, squared.
#[derive(Clone, Copy)]
pub(super) struct Nearest {
    pub(super) best: [f64; LANES],
    /// Its place in the index's blocks.
    pub(super) partner: [u32; LANES],
    /// 0 where nothing is asked for.
    pub(super) second: [f64; LANES],
}

impl Nearest {
    pub(super) const NOTHING: Self = Self {
        best: [f64::INFINITY; LANES],
        partner: [NONE; LANES],
        second: [0.0; LANES],
    };
}

impl Found for Nearest {
    #[inline(always)]
    fn bounds(&self) -> &[f64; LANES] {
        &self.second
    }

    #[inline(always)]
    fn meet(&mut self, _: impl Width, number: usize, block: &Block, lane: usize, query: DVec3) {
        let squares = squares(block, query);
        let (mut best, mut second) = (self.best[lane], self.second[lane]);
        let mut bits = [0u64; LANES];
        for k in 0..LANES {
            bits[k] = if squares[k] < second { 1 << k } else { 0 };
        }
        let mut near = joined(&bits);
        while near != 0 {
            let k = near.trailing_zeros() as usize % LANES;
            near &= near - 1;
            let (place, square) = ((number * LANES + k) as u32, squares[k]);
            if square < best {
                second = smaller(best, second);
                best = square;
                self.partner[lane] = place;
            } else if place != self.partner[lane] {
                // The partner itself may be met again.
                second = smaller(square, second);
            }
        }
        (self.best[lane], self.second[lane]) = (best, second);
    }
}
