//! When sources agree with a pixel, and the depth that follows from those that do.

#![allow(
    clippy::needless_range_loop,
    reason = "columns are walked side by side, and closures would leave the instruction set"
)]

use super::consensus::{Consensus, Errors, median};
use super::kernel::{BLOCK, Block, Footprint, Pair, Seen};
use super::near::{ABREAST, Abreast, Near, Relative};
use super::options::{FuseMode, FuseOptions, Sampling};
use super::samples::Samples;
use super::taps::{Looks, PlainLooks, Sampled, Sight, Taps, ValidLooks};
use mvs_datasets::scene::View;
use pulp::{Simd, WithSimd};

/// The bounds of the two-way check for one reference view.
#[derive(Debug, Clone, Copy)]
pub(super) struct Bounds {
    /// Square of the largest pixel error.
    pub(super) pixel2: f32,
    /// Largest relative depth error.
    pub(super) relative: f32,
    /// Relative depth error below which the pixel error is not asked: what the bound on the pixel
    /// error amounts to at the widest angle for which it is meant.
    ///
    /// A depth error moves the reprojection by about focal · tan(angle) · relative error, so a
    /// bound that grows with the tangent beyond that angle is a constant bound on the depth.
    pub(super) tight: f32,
    /// Below this ratio of expected depth to depth, the source sees through the point.
    pub(super) through: f32,
    /// Above this ratio the source sees something in front of the point.
    pub(super) occluded: f32,
}

impl Bounds {
    #[allow(
        clippy::cast_possible_truncation,
        reason = "f32 is what the loop works in"
    )]
    pub(super) fn new(view: &View, options: &FuseOptions) -> Self {
        let focal = 0.5 * (view.camera.focal().x + view.camera.focal().y);
        let tight = match options.wide_angle {
            angle if angle > 0.0 => {
                options.max_pixel_error / (focal * libm::tan(angle.to_radians()))
            }
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

/// What is kept of what each source says, for whoever looks at it after the decision.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Kept {
    /// Nothing: what one source says takes the place of what the one before did, in the nearest cache.
    Nothing,
    /// All but positions.
    Words,
    /// Positions, too.
    Positions,
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
    pub(super) kept: Kept,
    pub(super) sources: &'a [Against<'a>],
}

/// What is written while a block is decided, used again for the next.
pub(super) struct Verdict {
    /// What each source says; if nothing is kept, the last one.
    pub(super) seen: Vec<Seen>,
    /// Fused depth minus the reference's, by source: room for sorting.
    sorted: Vec<[f32; BLOCK]>,
    /// In turn of the sources that are being looked at.
    footprints: Vec<Footprint>,
    near: Near,
    /// The sources by so many, and where a block lies in each.
    abreast: Vec<(Abreast, Relative)>,
    /// Of the source being looked at, and of the next.
    sampled: [Sampled; 2],
    pub(super) consensus: Consensus,
}

impl Verdict {
    /// For blocks before a court with these sources.
    pub(super) fn new(sources: &[Against<'_>], kept: Kept) -> Self {
        let told = match kept {
            Kept::Nothing => 1,
            _ => sources.len(),
        };
        let abreast = |some: &[Against<'_>]| {
            let some = some.iter().map(|source| (source.pair, source.samples));
            (Abreast::new(some), Relative::new())
        };
        Self {
            seen: vec![Seen::new(); told],
            sorted: vec![[0.0; BLOCK]; sources.len() + 1],
            footprints: (0..LOOKED_AT).map(|_| Footprint::new()).collect(),
            near: Near::new(),
            abreast: sources.chunks(ABREAST).map(abreast).collect(),
            sampled: [Sampled::new(), Sampled::new()],
            consensus: Consensus::new(),
        }
    }
}

/// Sources that are looked at by turns: one's pixels are asked for while another's are fetched and the third's
/// are weighed.
const LOOKED_AT: usize = 3;

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
            near,
            abreast,
            sampled,
            consensus,
        } = verdict;
        consensus.begin(court.rule, court.soften, &block.depth);
        near.fill(block);
        for (sources, relative) in &mut *abreast {
            relative.fill(near, sources);
        }
        let (told, turns) = (seen.len(), footprints.len());
        let sources = court.sources;
        // Which footprint is a step's, and which those of the two before. (Not by remainders: divisions are slow.)
        let mut turn = [turns - 1, turns - 2, turns - 3];
        // Pixels are fetched when the next source was projected, so that they have time to come. What was
        // fetched is looked at when the next source's pixels have been, too: right away it would still be on its
        // way from single pixels to memory, where vectors of them are read.
        for step in 0..sources.len() + 2 {
            let next = if turn[0] + 1 == turns { 0 } else { turn[0] + 1 };
            turn = [next, turn[0], turn[1]];
            if let Some(source) = sources.get(step) {
                let to = &mut footprints[turn[0]];
                let seen = &mut seen[if told == 1 { 0 } else { step }];
                let relative = &abreast[step / ABREAST].1;
                let from = (block, &*near, (relative, step % ABREAST));
                match court.kept {
                    Kept::Positions => source.pair.project::<true>(from, source.samples, seen, to),
                    _ => source.pair.project::<false>(from, source.samples, seen, to),
                }
            }
            let ahead = &footprints[turn[1]];
            if let Some(source) = step.checked_sub(1).and_then(|ahead| sources.get(ahead))
                && ahead.any
            {
                sampled[step % 2].fetch((source.samples, court.taps), ahead);
            }
            let Some(at) = step.checked_sub(2) else {
                continue;
            };
            let (source, footprint) = (&sources[at], &footprints[turn[2]]);
            let seen = &mut seen[if told == 1 { 0 } else { at }];
            let sampled = &sampled[1 - step % 2];
            if !footprint.any {
                seen.nothing();
                continue;
            }
            let errors = Errors {
                epipole: source.pair.epipole,
                block,
                bounds: &court.bounds,
            };
            let sight = Sight {
                sampled,
                footprint,
                bounds: &court.bounds,
            };
            look(&court, source, (&errors, sight), (consensus, seen));
        }
        consensus.decide(court.rule, court.needed, court.soften);
        if court.rule == Rule::Median {
            median(seen, sorted, consensus);
        }
    }
}

/// Looks at what was sampled of a source, and hears it.
#[inline(always)]
fn look(
    court: &Court<'_>,
    source: &Against<'_>,
    (errors, sight): (&Errors<'_>, Sight<'_>),
    (consensus, seen): (&mut Consensus, &mut Seen),
) {
    match court.taps {
        Taps::Nearest => {
            let (unit, footprint) = (source.samples.unit(), sight.footprint);
            (sight.sampled).weigh_nearest(unit, footprint, &mut seen.ratio);
            let scale = (&footprint.z, source.disparity);
            match court.soften {
                true => consensus.hear_disparity::<true>(errors, scale, seen),
                false => consensus.hear_disparity::<false>(errors, scale, seen),
            }
        }
        Taps::Plain => hear(court, errors, &PlainLooks(sight), (consensus, seen)),
        Taps::Valid(similar) => {
            let looks = ValidLooks(sight, similar);
            hear(court, errors, &looks, (consensus, seen));
        }
    }
}

/// Hears a source by the rule of the court.
#[inline(always)]
fn hear(
    court: &Court<'_>,
    errors: &Errors<'_>,
    looks: &impl Looks,
    (consensus, seen): (&mut Consensus, &mut Seen),
) {
    let kept = court.kept != Kept::Nothing;
    match (court.rule, court.soften, kept) {
        (Rule::Dynamic, _, false) => consensus.hear_dynamic::<false>(errors, looks, seen),
        (Rule::Dynamic, _, true) => consensus.hear_dynamic::<true>(errors, looks, seen),
        (Rule::Average, false, false) => consensus.hear::<true, false, false>(errors, looks, seen),
        (Rule::Average, false, true) => consensus.hear::<true, false, true>(errors, looks, seen),
        (Rule::Average, true, _) => consensus.hear::<true, true, true>(errors, looks, seen),
        (_, false, _) => consensus.hear::<false, false, true>(errors, looks, seen),
        (_, true, _) => consensus.hear::<false, true, true>(errors, looks, seen),
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
