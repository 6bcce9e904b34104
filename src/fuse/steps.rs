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
    /// Sources that meet the bounds of each step, as far as that matters: all of a block in one vector.
    meets: [[u8; BLOCK]; STEPS.len()],
    /// The most that any of them can be.
    most: u8,
    /// Those of the widest step that were left out.
    more: [u32; BLOCK],
}

impl Steps {
    pub(super) fn new() -> Self {
        Self {
            per_depth: [0.0; BLOCK],
            squares: [0.0; BLOCK],
            meets: [[0; BLOCK]; _],
            most: 0,
            more: [0; BLOCK],
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
        self.meets = [[0; BLOCK]; _];
        self.most = 0;
        self.more = [0; BLOCK];
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
                self.meets[at][i] += u8::from(meets);
            }
        }
        self.most += 1;
        if self.most == u8::MAX {
            self.lower();
        }
    }

    /// Makes room: whether a step is met does not hang on more than are asked for.
    #[inline(always)]
    fn lower(&mut self) {
        for at in 0..STEPS.len() {
            for i in 0..BLOCK {
                let kept = self.meets[at][i].min(WIDEST as u8);
                if at == STEPS.len() - 1 {
                    self.more[i] += u32::from(self.meets[at][i] - kept);
                }
                self.meets[at][i] = kept;
            }
        }
        self.most = WIDEST as u8;
    }

    /// After all sources: how many meet the bounds of the widest step, and whether those of some step are met
    /// by as many sources.
    #[inline(always)]
    pub(super) fn decide(&self) -> ([u32; BLOCK], [bool; BLOCK]) {
        let (mut count, mut enough) = ([0; BLOCK], [false; BLOCK]);
        for i in 0..BLOCK {
            count[i] = self.more[i] + u32::from(self.meets[STEPS.len() - 1][i]);
        }
        for at in 0..STEPS.len() {
            for i in 0..BLOCK {
                enough[i] |= self.meets[at][i] >= STEPS[at] as u8;
            }
        }
        (count, enough)
    }
}

/// 2^23: added to a whole number that is less, the bits of the sum end with its own.
const WHOLE: f32 = 8_388_608.0;
