//! When sources agree with a pixel, and the depth that follows from those that do.

#![allow(
    clippy::needless_range_loop,
    reason = "columns are walked side by side, and closures would leave the instruction set"
)]

use super::kernel::{BLOCK, Block, Footprint, Pair, Seen, Taps};
use super::options::{FuseMode, FuseOptions, Sampling};
use super::samples::Samples;
use mvs_datasets::scene::View;
use pulp::{Simd, WithSimd};

/// The bounds of the two-way check for one reference view.
#[derive(Debug, Clone, Copy)]
pub(super) struct Bounds {
    /// Square of the largest pixel error.
    pixel2: f32,
    /// Largest relative depth error.
    relative: f32,
    /// Relative depth error below which the pixel error is not asked: what the bound on the pixel
    /// error amounts to at the widest angle for which it is meant.
    ///
    /// A depth error moves the reprojection by about focal · tan(angle) · relative error, so a
    /// bound that grows with the tangent beyond that angle is a constant bound on the depth.
    tight: f32,
    /// Below this ratio of expected depth to depth, the source sees through the point.
    through: f32,
    /// Above this ratio the source sees something in front of the point.
    occluded: f32,
}

impl Bounds {
    #[allow(
        clippy::cast_possible_truncation,
        reason = "f32 is what the loop works in"
    )]
    pub(super) fn new(view: &View, options: &FuseOptions) -> Self {
        let focal = 0.5 * (view.camera.focal().x + view.camera.focal().y);
        let tight = match options.wide_angle {
            angle if angle > 0.0 => options.max_pixel_error / (focal * angle.to_radians().tan()),
            _ => 0.0,
        };
        Self {
            pixel2: (options.max_pixel_error * options.max_pixel_error) as f32,
            relative: options.max_depth_error as f32,
            tight: tight as f32,
            through: (1.0 - options.max_depth_error) as f32,
            occluded: (1.0 + options.max_depth_error) as f32,
        }
    }
}

/// What the sources together say about a block.
pub(super) struct Consensus {
    /// Sources that agree.
    pub(super) count: [u32; BLOCK],
    /// Sources that see through the point and do not agree.
    pub(super) violations: [u32; BLOCK],
    /// What [`Witnesses`] counts.
    witnesses: Witnesses,
    /// Fused depth minus the reference's.
    pub(super) delta: [f32; BLOCK],
    /// Whether enough sources agree.
    pub(super) enough: [bool; BLOCK],
}

impl Consensus {
    pub(super) fn new() -> Self {
        Self {
            count: [0; BLOCK],
            violations: [0; BLOCK],
            witnesses: Witnesses::new(),
            delta: [0.0; BLOCK],
            enough: [false; BLOCK],
        }
    }
}

/// Who can judge a pixel at all: for those that hardly any source sees.
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

impl Witnesses {
    fn new() -> Self {
        Self {
            close: [0; BLOCK],
            against: [0; BLOCK],
            silent: [0; BLOCK],
        }
    }

    #[inline(always)]
    fn hear(&mut self, seen: &Seen, bounds: &Bounds) {
        for i in 0..BLOCK {
            let near =
                (seen.pixel2[i] < 0.25 * bounds.pixel2) | (seen.relative[i] < 0.5 * bounds.tight);
            let close = near & (seen.relative[i] < 0.5 * bounds.relative);
            let judges = (seen.near[i] > 0.0) & (seen.near[i] <= bounds.occluded);
            let silent = (seen.z[i] > 0.0) & (seen.near[i] <= 0.0);
            self.close[i] += seen.agrees[i] & u32::from(close);
            self.against[i] += (1 - seen.agrees[i]) & u32::from(judges);
            self.silent[i] += (1 - seen.agrees[i]) & u32::from(silent);
        }
    }

    #[inline(always)]
    fn suffice(&self, i: usize) -> bool {
        (self.close[i] >= FEWEST) & (self.against[i] == 0) & (self.silent[i] <= MOST_SILENT)
    }
}

/// How a block's verdict is reached.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Rule {
    /// Two-way check; the mean of the reference's depth and the agreeing ones.
    Average,
    /// Two-way check; their median, of an even number the nearer middle one.
    Median,
    /// Two-way check; the reference's depth.
    Keep,
    /// Bounds that grow with the number of sources that meet them; the mean.
    Dynamic,
    /// Pseudo-disparities; the reference's depth (the mean of points is taken when they are made).
    Disparity,
}

impl Rule {
    /// The rule of the modes that have a single pass.
    pub(super) fn of(mode: FuseMode) -> Self {
        match mode {
            FuseMode::Dynamic => Self::Dynamic,
            FuseMode::Gipuma => Self::Disparity,
            FuseMode::Geo | FuseMode::Hkust | FuseMode::Cluster => Self::Average,
        }
    }

    /// How sources are sampled under this rule.
    #[allow(
        clippy::cast_possible_truncation,
        reason = "f32 is what the loop works in"
    )]
    pub(super) fn taps(self, options: &FuseOptions) -> Taps {
        match (self, options.sampling) {
            (Self::Disparity, _) => Taps::Nearest,
            (_, Sampling::Plain) => Taps::Plain,
            (_, Sampling::Valid) => Taps::Valid(options.similar_depth as f32),
        }
    }
}

/// A source as the inner loop needs it.
#[derive(Clone, Copy)]
pub(super) struct Against<'a> {
    pub(super) pair: &'a Pair,
    pub(super) samples: &'a Samples,
    /// See [`disparity_scale`].
    pub(super) disparity: f32,
}

/// What decides, the same for all pixels of a reference view.
#[derive(Clone, Copy)]
pub(super) struct Court<'a> {
    pub(super) rule: Rule,
    pub(super) taps: Taps,
    pub(super) bounds: Bounds,
    /// Sources that must agree.
    pub(super) needed: u32,
    /// Whether [`FEWEST`] do where nobody else can judge.
    pub(super) soften: bool,
    pub(super) sources: &'a [Against<'a>],
}

/// What is written while a block is decided, used again for the next.
pub(super) struct Verdict {
    /// What each source says.
    pub(super) seen: Vec<Seen>,
    /// Fused depth minus the reference's, by source: room for sorting.
    sorted: Vec<[f32; BLOCK]>,
    footprints: Vec<Footprint>,
    pub(super) consensus: Consensus,
}

impl Verdict {
    pub(super) fn new(sources: usize) -> Self {
        Self {
            seen: vec![Seen::new(); sources],
            sorted: vec![[0.0; BLOCK]; sources + 1],
            footprints: (0..sources).map(|_| Footprint::new()).collect(),
            consensus: Consensus::new(),
        }
    }
}

/// A block before the court. `pulp` compiles [`WithSimd::with_simd`], and what is inlined into it,
/// once per instruction set.
pub(super) struct Case<'a> {
    pub(super) court: Court<'a>,
    pub(super) block: &'a Block,
    pub(super) verdict: &'a mut Verdict,
}

impl WithSimd for Case<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self {
            court,
            block,
            verdict,
        } = self;
        let Verdict {
            seen,
            sorted,
            footprints,
            consensus,
        } = verdict;
        *consensus = Consensus::new();
        // All sources are projected first, so that their samples have time to come.
        for at in 0..court.sources.len() {
            let source = &court.sources[at];
            let (seen, footprint) = (&mut seen[at], &mut footprints[at]);
            source.pair.project(block, source.samples, seen, footprint);
        }
        for at in 0..court.sources.len() {
            let source = &court.sources[at];
            let (seen, footprint) = (&mut seen[at], &mut footprints[at]);
            let map = (source.samples, court.taps);
            source.pair.look(block, map, footprint, seen);
            match court.rule {
                Rule::Dynamic => within_widest(seen),
                Rule::Disparity => within_disparity(seen, source.disparity),
                Rule::Average | Rule::Median | Rule::Keep => within_bounds(seen, &court.bounds),
            }
            tally(seen, &court.bounds, consensus);
            if court.soften {
                consensus.witnesses.hear(seen, &court.bounds);
            }
        }
        for i in 0..BLOCK {
            let suffice = court.soften & consensus.witnesses.suffice(i);
            consensus.enough[i] = suffice | (consensus.count[i] >= court.needed);
        }
        match court.rule {
            Rule::Average => mean(seen, consensus),
            Rule::Median => median(seen, sorted, consensus),
            Rule::Dynamic => {
                mean(seen, consensus);
                dynamic(seen, &mut sorted[0], consensus);
            }
            Rule::Keep | Rule::Disparity => {}
        }
    }
}

#[inline(always)]
fn within_bounds(seen: &mut Seen, bounds: &Bounds) {
    for i in 0..BLOCK {
        let near = (seen.pixel2[i] < bounds.pixel2) | (seen.relative[i] < bounds.tight);
        seen.agrees[i] = u32::from(near & (seen.relative[i] < bounds.relative));
    }
}

/// Steps of the `dynamic` bounds: i/4 px and i/1300 for i from 2 to 10.
const STEPS: std::ops::RangeInclusive<u32> = 2..=10;

/// As many sources, at least, must agree in `dynamic`.
pub(super) const DYNAMIC_FROM: usize = *STEPS.start() as usize;

/// How many steps wide the bounds must be for the source to agree: below i at step i.
#[inline(always)]
fn step(seen: &Seen, i: usize) -> f32 {
    (4.0 * seen.pixel2[i].sqrt()).max(1300.0 * seen.relative[i])
}

#[inline(always)]
#[allow(clippy::cast_precision_loss, reason = "ten")]
fn within_widest(seen: &mut Seen) {
    for i in 0..BLOCK {
        seen.agrees[i] = u32::from(step(seen, i) < *STEPS.end() as f32);
    }
}

/// Enough where i sources meet the bounds of some step i. `room` is overwritten.
#[inline(always)]
#[allow(clippy::cast_precision_loss, reason = "at most ten")]
fn dynamic(seen: &[Seen], room: &mut [f32; BLOCK], consensus: &mut Consensus) {
    let mut meets = [[0u32; BLOCK]; 9];
    for source in seen {
        for i in 0..BLOCK {
            room[i] = step(source, i);
        }
        for (wide, meets) in STEPS.zip(&mut meets) {
            for i in 0..BLOCK {
                meets[i] += u32::from(room[i] < wide as f32);
            }
        }
    }
    consensus.enough = [false; BLOCK];
    for (wide, meets) in STEPS.zip(&meets) {
        for i in 0..BLOCK {
            consensus.enough[i] |= meets[i] >= wide;
        }
    }
}

/// |f·B/z − f·B/D| below the bound, by the ratio z/D; `scale` is f·B over the bound.
#[inline(always)]
fn within_disparity(seen: &mut Seen, scale: f32) {
    for i in 0..BLOCK {
        let off = scale * (seen.ratio[i] - 1.0).abs();
        seen.agrees[i] = u32::from((seen.ratio[i] > 0.0) & (off < seen.z[i]));
    }
}

#[inline(always)]
fn tally(seen: &Seen, bounds: &Bounds, consensus: &mut Consensus) {
    for i in 0..BLOCK {
        let through = (seen.near[i] > 0.0) & (seen.near[i] < bounds.through);
        consensus.count[i] += seen.agrees[i];
        consensus.violations[i] += u32::from(through) & (1 - seen.agrees[i]);
    }
}

#[inline(always)]
fn mean(seen: &[Seen], consensus: &mut Consensus) {
    let mut sum = [0.0f32; BLOCK];
    for source in seen {
        for (i, sum) in sum.iter_mut().enumerate() {
            *sum += if source.agrees[i] == 1 {
                source.delta[i]
            } else {
                0.0
            };
        }
    }
    for (i, sum) in sum.iter().enumerate() {
        #[allow(clippy::cast_precision_loss, reason = "a number of views")]
        let count = (consensus.count[i] + 1) as f32;
        consensus.delta[i] = sum / count;
    }
}

/// The middle value of the reference's (0) and the agreeing ones, of an even number the smaller
/// middle one. All pixels are sorted at once by the same comparisons; what does not agree is ∞.
#[inline(always)]
fn median(seen: &[Seen], sorted: &mut [[f32; BLOCK]], consensus: &mut Consensus) {
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

/// Focal length times baseline over the bound on disparities, in pixels × world units.
#[allow(
    clippy::cast_possible_truncation,
    reason = "f32 is what the loop works in"
)]
pub(super) fn disparity_scale(reference: &View, source: &View, options: &FuseOptions) -> f32 {
    let between = reference.pose.center_in_world() - source.pose.center_in_world();
    (reference.camera.focal().x * between.length() / options.max_disparity_error) as f32
}

#[cfg(test)]
mod tests;
