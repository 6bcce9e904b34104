//! What the sources say about a block, heard one after the other, and what follows.

#![allow(
    clippy::needless_range_loop,
    reason = "columns are walked side by side, and closures would leave the instruction set"
)]

use super::kernel::{BLOCK, Block, Seen};
use super::rules::{Bounds, Rule};
use super::steps::Steps;
use super::taps::{Look, Looks};

/// What the sources together say about a block.
#[derive(Debug)]
#[repr(C, align(64))]
pub(super) struct Consensus {
    /// Sources that agree.
    pub(super) count: [u32; BLOCK],
    /// Sources that see through the point and do not agree.
    pub(super) violations: [u32; BLOCK],
    /// What [`Witnesses`] counts.
    witnesses: Witnesses,
    dynamic: Steps,
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
    /// Sources on whose image the point lies, or less than half a pixel beyond it (as far as depths are sampled),
    /// where they have no depth.
    silent: [u32; BLOCK],
}

/// Sources that must agree closely where nobody else can judge.
const FEWEST: u32 = 2;
/// Silent sources up to which that holds: holes are common, and more are the sky's.
const MOST_SILENT: u32 = 2;

/// What the errors of one source follow from, beside what it says.
pub(super) struct Errors<'a> {
    /// (e_x, e_y, c_z) of the pair.
    pub(super) epipole: [f32; 3],
    pub(super) block: &'a Block,
    pub(super) bounds: &'a Bounds,
}

/// Of one pixel against one source; as they are compared, without divisions.
#[derive(Clone, Copy)]
pub(super) struct Error {
    /// Reprojected depth minus the reference's.
    pub(super) delta: f32,
    /// Square of the reprojection error in pixels times that of the reprojected depth.
    pub(super) across2: f32,
    /// Square of the reprojected depth.
    pub(super) reprojected2: f32,
}

impl Errors<'_> {
    /// From sampled depth / expected depth − 1.
    #[inline(always)]
    pub(super) fn at(&self, i: usize, q: f32) -> Error {
        let [ex, ey, cz] = self.epipole;
        let depth = self.block.depth[i];
        let delta = q * (depth - cz);
        let reprojected = depth + delta;
        let across_u = self.block.u[i].mul_add(cz, -ex);
        let across_v = self.block.v[i].mul_add(cz, -ey);
        Error {
            delta,
            across2: q * q * across_u.mul_add(across_u, across_v * across_v),
            reprojected2: reprojected * reprojected,
        }
    }

    /// Whether the errors are within a `part` of the bounds, and within its `square` where those are squares.
    #[inline(always)]
    fn within(&self, i: usize, error: Error, (part, square): (f32, f32)) -> bool {
        let (bounds, depth) = (self.bounds, self.block.depth[i]);
        let off = error.delta.abs();
        let near = (error.across2 < square * bounds.pixel2 * error.reprojected2)
            | (off < part * bounds.tight * depth);
        near & (off < part * bounds.relative * depth)
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
            dynamic: Steps::new(),
            delta: [0.0; BLOCK],
            enough: [false; BLOCK],
        }
    }

    /// Forgets what was heard; before pixels of these depths.
    #[inline(always)]
    pub(super) fn begin(&mut self, rule: Rule, soften: bool, depth: &[f32; BLOCK]) {
        self.count = [0; BLOCK];
        self.violations = [0; BLOCK];
        self.delta = [0.0; BLOCK];
        if soften {
            self.witnesses.close = [0; BLOCK];
            self.witnesses.against = [0; BLOCK];
            self.witnesses.silent = [0; BLOCK];
        }
        if rule == Rule::Dynamic {
            self.dynamic.begin(depth);
        }
    }

    /// Hears a source under the two-way check. Where the rule takes the `MEAN`, agreeing depths are added
    /// up; where it may `SOFTEN`, it is noted who could judge; what it says is `KEPT` or not.
    #[inline(always)]
    pub(super) fn hear<const MEAN: bool, const SOFTEN: bool, const KEPT: bool>(
        &mut self,
        errors: &Errors<'_>,
        looks: &impl Looks,
        seen: &mut Seen,
    ) {
        for i in 0..BLOCK {
            let look = looks.at(i);
            let error = errors.at(i, look.q);
            let agrees = look.sampled & errors.within(i, error, (1.0, 1.0));
            self.count(i, agrees, look);
            if MEAN {
                self.delta[i] += if agrees { error.delta } else { 0.0 };
            }
            if SOFTEN {
                let close = agrees & errors.within(i, error, (0.5, 0.25));
                self.note(i, (agrees, close), look);
            }
            if KEPT {
                seen.delta[i] = if look.sampled { error.delta } else { 0.0 };
                seen.agrees[i] = u32::from(agrees);
            }
        }
    }

    /// Hears a source under the bounds of `dynamic`.
    #[inline(always)]
    pub(super) fn hear_dynamic<const KEPT: bool>(
        &mut self,
        errors: &Errors<'_>,
        looks: &impl Looks,
        seen: &mut Seen,
    ) {
        for i in 0..BLOCK {
            let look = looks.at(i);
            let error = errors.at(i, look.q);
            // How many steps wide the bounds must be, squared: below i² at step i.
            let relative = error.delta * self.dynamic.per_depth[i];
            let step2 = (16.0 * error.across2 / error.reprojected2).max(relative * relative);
            let step2 = if look.sampled { step2 } else { f32::INFINITY };
            let agrees = self.dynamic.note(i, step2);
            self.violations[i] += u32::from(look.through & !agrees);
            self.delta[i] += if agrees { error.delta } else { 0.0 };
            if KEPT {
                seen.delta[i] = if look.sampled { error.delta } else { 0.0 };
                seen.agrees[i] = u32::from(agrees);
            }
        }
        self.dynamic.count();
    }

    /// Hears a source under `gipuma`'s rule, |f·B/z − f·B/D| below the bound, by the ratio z/D; `scale` is
    /// f·B over the bound.
    #[inline(always)]
    pub(super) fn hear_disparity<const SOFTEN: bool>(
        &mut self,
        errors: &Errors<'_>,
        (z, scale): (&[f32; BLOCK], f32),
        seen: &mut Seen,
    ) {
        let bounds = errors.bounds;
        for i in 0..BLOCK {
            let ratio = seen.ratio[i];
            let off = scale * (ratio - 1.0).abs();
            let sampled = ratio > 0.0;
            let agrees = sampled & (off < z[i]);
            let look = Look {
                sampled,
                q: (1.0 - ratio) / ratio,
                through: sampled & (ratio < bounds.through),
                judges: sampled & (ratio <= bounds.occluded),
                silent: (z[i] > 0.0) & (ratio <= 0.0),
            };
            self.count(i, agrees, look);
            if SOFTEN {
                let error = errors.at(i, look.q);
                let close = agrees & errors.within(i, error, (0.5, 0.25));
                self.note(i, (agrees, close), look);
            }
            seen.agrees[i] = u32::from(agrees);
        }
    }

    #[inline(always)]
    fn count(&mut self, i: usize, agrees: bool, look: Look) {
        self.count[i] += u32::from(agrees);
        self.violations[i] += u32::from(look.through & !agrees);
    }

    #[inline(always)]
    fn note(&mut self, i: usize, (agrees, close): (bool, bool), look: Look) {
        self.witnesses.close[i] += u32::from(close);
        self.witnesses.against[i] += u32::from(look.judges & !agrees);
        self.witnesses.silent[i] += u32::from(look.silent & !agrees);
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
            (self.count, self.enough) = self.dynamic.decide();
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
/// middle one. All pixels are sorted at once by the same exchanges; what does not agree is ∞.
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
    sort(sorted);
    // Exactly one rank is the middle. (Sums and minima, because conditional stores are slow.)
    consensus.delta = [0.0; BLOCK];
    for (rank, values) in (0u32..).zip(sorted.iter()) {
        for i in 0..BLOCK {
            let is_middle = consensus.count[i] / 2 == rank;
            consensus.delta[i] += if is_middle { values[i] } else { 0.0 };
        }
    }
}

/// Batcher's merge exchange (Knuth, The Art of Computer Programming 3, algorithm 5.2.2 M).
#[inline(always)]
fn sort(values: &mut [[f32; BLOCK]]) {
    let half = values.len().next_power_of_two() / 2;
    let mut part = half;
    while part > 0 {
        let (mut left, mut of, mut apart) = (half, 0, part);
        loop {
            for at in (0..values.len().saturating_sub(apart)).filter(|at| at & part == of) {
                let (lower, upper) = values.split_at_mut(at + apart);
                exchange(&mut lower[at], &mut upper[0]);
            }
            if left == part {
                break;
            }
            (apart, of) = (left - part, part);
            left /= 2;
        }
        part /= 2;
    }
}

/// Puts the smaller of each two values into `lower`; none is NaN.
#[inline(always)]
fn exchange(lower: &mut [f32; BLOCK], upper: &mut [f32; BLOCK]) {
    for i in 0..BLOCK {
        let (a, b) = (lower[i], upper[i]);
        // In these words one instruction each.
        lower[i] = if a < b { a } else { b };
        upper[i] = if a < b { b } else { a };
    }
}
