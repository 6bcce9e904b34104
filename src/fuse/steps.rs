//! `dynamic`: bounds that grow with the number of sources that meet them.

#![allow(
    clippy::needless_range_loop,
    reason = "columns are walked side by side, and closures would leave the instruction set"
)]

use super::kernel::BLOCK;

/// Steps of the `dynamic` bounds: i/4 px and i/1300 for each of these i.
const STEPS: [u16; 9] = [2, 3, 4, 5, 6, 7, 8, 9, 10];
/// The widest step.
const WIDEST: u16 = STEPS[STEPS.len() - 1];

/// As many sources, at least, must agree in `dynamic`.
pub(super) const DYNAMIC_FROM: usize = STEPS[0] as usize;

/// What is counted of a block.
#[derive(Debug)]
#[repr(C, align(64))]
pub(super) struct Steps {
    /// Steps of the relative bound per difference of depths.
    pub(super) per_depth: [f32; BLOCK],
    /// Of the source being heard, how many steps wide the bounds must be, squared; what is beyond the widest
    /// as if just so.
    squares: [f32; BLOCK],
    /// Sources that meet the bounds of each step, of those heard last: all of a block in one vector.
    recent: [[u8; BLOCK]; STEPS.len()],
    /// How many were heard last.
    heard: u8,
    /// Sources heard before those that meet the bounds of each step.
    meets: [[u32; BLOCK]; STEPS.len()],
}

impl Steps {
    pub(super) fn new() -> Self {
        Self {
            per_depth: [0.0; BLOCK],
            squares: [0.0; BLOCK],
            recent: [[0; BLOCK]; _],
            heard: 0,
            meets: [[0; BLOCK]; _],
        }
    }

    /// Forgets what was heard; before pixels of these depths.
    #[inline(always)]
    pub(super) fn begin(&mut self, depth: &[f32; BLOCK]) {
        for i in 0..BLOCK {
            let per_depth = 1300.0 / depth[i];
            // Finite: no difference at all is no step.
            self.per_depth[i] = if per_depth < f32::MAX {
                per_depth
            } else {
                f32::MAX
            };
        }
        self.recent = [[0; BLOCK]; _];
        self.heard = 0;
        self.meets = [[0; BLOCK]; _];
    }

    /// Notes how many steps wide a source's bounds must be, squared; whether any is.
    #[inline(always)]
    pub(super) fn note(&mut self, i: usize, step2: f32) -> bool {
        let widest = f32::from(WIDEST * WIDEST);
        let agrees = step2 < widest;
        self.squares[i] = if agrees { step2 } else { widest };
        agrees
    }

    /// Counts the source of which all was noted.
    #[inline(always)]
    pub(super) fn count(&mut self) {
        // Those of steps are whole: the fraction does not matter.
        let mut whole = [0; BLOCK];
        for i in 0..BLOCK {
            whole[i] = (self.squares[i].floor() + WHOLE).to_bits() as u8;
        }
        for at in 0..STEPS.len() {
            let square = (STEPS[at] * STEPS[at]) as u8;
            for i in 0..BLOCK {
                let meets = whole[i] < square;
                self.recent[at][i] += u8::from(meets);
            }
        }
        self.heard += 1;
        if self.heard == u8::MAX {
            self.settle();
        }
    }

    /// Adds those heard last to the others.
    #[inline(always)]
    fn settle(&mut self) {
        for at in 0..STEPS.len() {
            for i in 0..BLOCK {
                self.meets[at][i] += u32::from(self.recent[at][i]);
            }
        }
        self.recent = [[0; BLOCK]; _];
        self.heard = 0;
    }

    /// After all sources: how many meet the bounds of the widest step, and whether those of some step are met
    /// by as many sources.
    #[inline(always)]
    pub(super) fn decide(&mut self) -> ([u32; BLOCK], [bool; BLOCK]) {
        self.settle();
        let mut enough = [false; BLOCK];
        for at in 0..STEPS.len() {
            for i in 0..BLOCK {
                enough[i] |= self.meets[at][i] >= u32::from(STEPS[at]);
            }
        }
        (self.meets[STEPS.len() - 1], enough)
    }
}

/// 2^23: added to a whole number that is less, the bits of the sum end with its own.
const WHOLE: f32 = 8_388_608.0;
