//! What the sources say about a block, heard one after the other, and what follows.

#![allow(
    clippy::needless_range_loop,
    reason = "columns are walked side by side, and closures would leave the instruction set"
)]

use super::kernel::{BLOCK, Block, Seen};
use super::rules::{Bounds, Rule};

/// What the sources together say about a block.
#[derive(Debug)]
pub(super) struct Consensus {
    /// Sources that agree.
    pub(super) count: [u32; BLOCK],
    /// Sources that see through the point and do not agree.
    pub(super) violations: [u32; BLOCK],
    /// What [`Witnesses`] counts.
    witnesses: Witnesses,
    /// `dynamic`: sources that meet the bounds of each step.
    meets: [[u32; BLOCK]; STEPS.len()],
    /// Fused depth minus the reference's; before the decision, where it is a mean, their sum.
    pub(super) delta: [f32; BLOCK],
    /// Whether enough sources agree.
    pub(super) enough: [bool; BLOCK],
}

/// Who can judge a pixel at all: for those that hardly any source sees.
#[derive(Debug)]
struct Witnesses {
    /// Sources that agree within half the bounds.
    close: [u32; BLOCK],
    /// Sources that see the point's place, nothing in front of it, and do not agree.
    against: [u32; BLOCK],
    /// Sources on whose image the point lies, where they have no depth.
    silent: [u32; BLOCK],
}

/// Sources that must agree closely where nobody else can judge.
const FEWEST: u32 = 2;
/// Silent sources up to which that holds: holes are common, and more are the sky's.
const MOST_SILENT: u32 = 2;

/// Steps of the `dynamic` bounds: i/4 px and i/1300 for each of these i.
const STEPS: [u16; 9] = [2, 3, 4, 5, 6, 7, 8, 9, 10];
/// The widest step.
const WIDEST: u16 = STEPS[STEPS.len() - 1];

/// As many sources, at least, must agree in `dynamic`.
pub(super) const DYNAMIC_FROM: usize = STEPS[0] as usize;

/// What the errors of one source follow from, beside its samples.
pub(super) struct Errors<'a> {
    /// (e_x, e_y, c_z) of the pair.
    pub(super) epipole: [f32; 3],
    pub(super) block: &'a Block,
    /// Expected depth / depth of the nearest pixel; 0 where that has none.
    pub(super) near: &'a [f32; BLOCK],
    /// z-depth in the source; 0 where the pixel does not project into its map.
    pub(super) z: &'a [f32; BLOCK],
    pub(super) bounds: &'a Bounds,
}

/// Of one pixel against one source.
#[derive(Clone, Copy)]
pub(super) struct Error {
    /// Reprojected depth minus the reference's; 0 without a sample.
    pub(super) delta: f32,
    /// Square of the reprojection error in pixels; ∞ without a sample.
    pub(super) pixel2: f32,
    /// Relative depth error; ∞ without a sample.
    pub(super) relative: f32,
}

impl Errors<'_> {
    /// Reprojected depth and the two errors from expected depth / sampled depth, 0 for none.
    #[inline(always)]
    pub(super) fn at(&self, i: usize, ratio: f32) -> Error {
        let [ex, ey, cz] = self.epipole;
        let depth = self.block.depth[i];
        let sampled = ratio > 0.0;
        let q = (1.0 - ratio) / ratio;
        let q = if sampled { q } else { 0.0 };
        let along = depth - cz;
        let delta = q * along;
        let reprojected = depth + delta;
        let across_u = self.block.u[i] * cz - ex;
        let across_v = self.block.v[i] * cz - ey;
        let across = q * q * (across_u * across_u + across_v * across_v);
        let pixel2 = across / (reprojected * reprojected);
        let relative = delta.abs() / depth;
        Error {
            delta,
            pixel2: if sampled { pixel2 } else { f32::INFINITY },
            relative: if sampled { relative } else { f32::INFINITY },
        }
    }

    /// 1 where the errors are within the bounds.
    #[inline(always)]
    fn agrees(&self, error: Error) -> u32 {
        let near = (error.pixel2 < self.bounds.pixel2) | (error.relative < self.bounds.tight);
        u32::from(near & (error.relative < self.bounds.relative))
    }
}

impl Consensus {
    pub(super) fn new() -> Self {
        Self {
            count: [0; BLOCK],
            violations: [0; BLOCK],
            witnesses: Witnesses {
                close: [0; BLOCK],
                against: [0; BLOCK],
                silent: [0; BLOCK],
            },
            meets: [[0; BLOCK]; STEPS.len()],
            delta: [0.0; BLOCK],
            enough: [false; BLOCK],
        }
    }

    /// Forgets what was heard.
    #[inline(always)]
    pub(super) fn begin(&mut self, rule: Rule, soften: bool) {
        self.count = [0; BLOCK];
        self.violations = [0; BLOCK];
        self.delta = [0.0; BLOCK];
        if soften {
            self.witnesses.close = [0; BLOCK];
            self.witnesses.against = [0; BLOCK];
            self.witnesses.silent = [0; BLOCK];
        }
        if rule == Rule::Dynamic {
            self.meets = [[0; BLOCK]; STEPS.len()];
        }
    }

    /// Hears a source under the two-way check. Where the rule takes the `MEAN`, agreeing depths are added
    /// up; where it may `SOFTEN`, it is noted who could judge.
    #[inline(always)]
    pub(super) fn hear<const MEAN: bool, const SOFTEN: bool>(
        &mut self,
        errors: &Errors<'_>,
        seen: &mut Seen,
    ) {
        for i in 0..BLOCK {
            let error = errors.at(i, seen.ratio[i]);
            let agrees = errors.agrees(error);
            self.count(i, agrees, errors);
            if MEAN {
                self.delta[i] += if agrees == 1 { error.delta } else { 0.0 };
            }
            if SOFTEN {
                self.note(i, (error, agrees), errors);
            }
            seen.delta[i] = error.delta;
            seen.agrees[i] = agrees;
        }
    }

    /// Hears a source under the bounds of `dynamic`.
    #[inline(always)]
    pub(super) fn hear_dynamic(&mut self, errors: &Errors<'_>, seen: &mut Seen) {
        for i in 0..BLOCK {
            let error = errors.at(i, seen.ratio[i]);
            // How many steps wide the bounds must be: below i at step i.
            let step = (4.0 * error.pixel2.sqrt()).max(1300.0 * error.relative);
            let agrees = u32::from(step < f32::from(WIDEST));
            for at in 0..STEPS.len() {
                self.meets[at][i] += u32::from(step < f32::from(STEPS[at]));
            }
            self.count(i, agrees, errors);
            self.delta[i] += if agrees == 1 { error.delta } else { 0.0 };
            seen.delta[i] = error.delta;
            seen.agrees[i] = agrees;
        }
    }

    /// Hears a source under `gipuma`'s rule, |f·B/z − f·B/D| below the bound, by the ratio z/D; `scale` is
    /// f·B over the bound.
    #[inline(always)]
    pub(super) fn hear_disparity(&mut self, errors: &Errors<'_>, scale: f32, seen: &mut Seen) {
        for i in 0..BLOCK {
            let ratio = seen.ratio[i];
            let off = scale * (ratio - 1.0).abs();
            let agrees = u32::from((ratio > 0.0) & (off < errors.z[i]));
            self.count(i, agrees, errors);
            seen.agrees[i] = agrees;
        }
    }

    /// Notes who could judge, where the rule has not done so.
    #[inline(always)]
    pub(super) fn witness(&mut self, errors: &Errors<'_>, seen: &Seen) {
        for i in 0..BLOCK {
            let error = errors.at(i, seen.ratio[i]);
            self.note(i, (error, seen.agrees[i]), errors);
        }
    }

    #[inline(always)]
    fn count(&mut self, i: usize, agrees: u32, errors: &Errors<'_>) {
        let through = (errors.near[i] > 0.0) & (errors.near[i] < errors.bounds.through);
        self.count[i] += agrees;
        self.violations[i] += u32::from(through) & (1 - agrees);
    }

    #[inline(always)]
    fn note(&mut self, i: usize, (error, agrees): (Error, u32), errors: &Errors<'_>) {
        let (bounds, near, z) = (errors.bounds, errors.near[i], errors.z[i]);
        let close = (error.pixel2 < 0.25 * bounds.pixel2) | (error.relative < 0.5 * bounds.tight);
        let close = close & (error.relative < 0.5 * bounds.relative);
        let judges = (near > 0.0) & (near <= bounds.occluded);
        let silent = (z > 0.0) & (near <= 0.0);
        self.witnesses.close[i] += agrees & u32::from(close);
        self.witnesses.against[i] += (1 - agrees) & u32::from(judges);
        self.witnesses.silent[i] += (1 - agrees) & u32::from(silent);
    }

    /// After all sources: whether `needed` of them agree, or [`FEWEST`] where that may `soften` and nobody
    /// else can judge; and the mean, where the rule takes it.
    #[inline(always)]
    pub(super) fn decide(&mut self, rule: Rule, needed: u32, soften: bool) {
        for i in 0..BLOCK {
            self.enough[i] = self.count[i] >= needed;
        }
        if soften {
            let heard = &self.witnesses;
            for i in 0..BLOCK {
                let nobody = (heard.against[i] == 0) & (heard.silent[i] <= MOST_SILENT);
                self.enough[i] |= (heard.close[i] >= FEWEST) & nobody;
            }
        }
        if rule == Rule::Dynamic {
            self.enough = [false; BLOCK];
            for at in 0..STEPS.len() {
                for i in 0..BLOCK {
                    self.enough[i] |= self.meets[at][i] >= u32::from(STEPS[at]);
                }
            }
        }
        if matches!(rule, Rule::Average | Rule::Dynamic) {
            for i in 0..BLOCK {
                #[allow(clippy::cast_precision_loss, reason = "a number of views")]
                let count = (self.count[i] + 1) as f32;
                self.delta[i] /= count;
            }
        }
    }
}

/// The middle value of the reference's (0) and the agreeing ones, of an even number the smaller
/// middle one. All pixels are sorted at once by the same comparisons; what does not agree is ∞.
#[inline(always)]
pub(super) fn median(seen: &[Seen], sorted: &mut [[f32; BLOCK]], consensus: &mut Consensus) {
    sorted[0] = [0.0; BLOCK];
    for (source, values) in seen.iter().zip(&mut sorted[1..]) {
        for i in 0..BLOCK {
            let agrees = source.agrees[i] == 1;
            values[i] = if agrees {
                source.delta[i]
            } else {
                f32::INFINITY
            };
        }
    }
    for end in 1..sorted.len() {
        for at in (0..end).rev() {
            let (lower, upper) = sorted.split_at_mut(at + 1);
            exchange(&mut lower[at], &mut upper[0]);
        }
    }
    // Exactly one rank is the middle. (Sums and minima, because conditional stores are slow.)
    consensus.delta = [0.0; BLOCK];
    for (rank, values) in (0u32..).zip(sorted.iter()) {
        for i in 0..BLOCK {
            let is_middle = consensus.count[i] / 2 == rank;
            consensus.delta[i] += if is_middle { values[i] } else { 0.0 };
        }
    }
}

/// Puts the smaller of each two values into `lower`; none is NaN.
#[inline(always)]
fn exchange(lower: &mut [f32; BLOCK], upper: &mut [f32; BLOCK]) {
    for i in 0..BLOCK {
        let (a, b) = (lower[i], upper[i]);
        lower[i] = a.min(b);
        upper[i] = a.max(b);
    }
}
