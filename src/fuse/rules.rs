//! When sources agree with a pixel, and the depth that follows from those that do.

use super::kernel::{BLOCK, Block, Seen, Taps};
use super::options::{FuseMode, FuseOptions, Sampling};
use glam::DVec3;
use mvs_datasets::scene::View;
use pulp::Arch;

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
        }
    }
}

/// What the sources together say about a block.
pub(super) struct Consensus {
    /// Sources that agree.
    pub(super) count: [u32; BLOCK],
    /// Sources that see through the point and do not agree.
    pub(super) violations: [u32; BLOCK],
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
            delta: [0.0; BLOCK],
            enough: [false; BLOCK],
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

    /// Reaches the verdict on `block` from what each source has `seen`; `disparity` is focal length
    /// times baseline over the bound, per source.
    pub(super) fn decide(
        self,
        block: &Block,
        seen: &mut [Seen],
        bounds: &Bounds,
        needed: usize,
        disparity: &[f32],
    ) -> Consensus {
        let mut consensus = Consensus::new();
        Arch::new().dispatch(|| {
            self.judge(seen, bounds, disparity, &mut consensus);
            match self {
                Self::Average | Self::Dynamic => mean(seen, &mut consensus),
                Self::Median | Self::Keep | Self::Disparity => {}
            }
        });
        let needed = u32::try_from(needed).unwrap_or(u32::MAX);
        for i in 0..BLOCK {
            consensus.enough[i] = consensus.count[i] >= needed;
        }
        match self {
            Self::Median => median(block, seen, &mut consensus),
            Self::Dynamic => dynamic(block, seen, &mut consensus),
            Self::Average | Self::Keep | Self::Disparity => {}
        }
        consensus
    }

    /// Which sources agree, and how many.
    #[inline(always)]
    fn judge(
        self,
        seen: &mut [Seen],
        bounds: &Bounds,
        disparity: &[f32],
        consensus: &mut Consensus,
    ) {
        for (index, source) in seen.iter_mut().enumerate() {
            match self {
                Self::Dynamic => within_widest(source),
                Self::Disparity => within_disparity(source, disparity[index]),
                Self::Average | Self::Median | Self::Keep => within_bounds(source, bounds),
            }
            tally(source, bounds, consensus);
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

#[allow(clippy::cast_precision_loss, reason = "at most ten")]
fn dynamic(block: &Block, seen: &[Seen], consensus: &mut Consensus) {
    for i in 0..block.len {
        consensus.enough[i] = STEPS.into_iter().any(|wide| {
            let meets = |source: &&Seen| step(source, i) < wide as f32;
            seen.iter().filter(meets).count() >= wide as usize
        });
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

fn median(block: &Block, seen: &[Seen], consensus: &mut Consensus) {
    let mut values = Vec::with_capacity(seen.len() + 1);
    for i in 0..block.len {
        values.clear();
        values.push(0.0);
        let agreeing = seen.iter().filter(|source| source.agrees[i] == 1);
        values.extend(agreeing.map(|source| source.delta[i]));
        consensus.delta[i] = nearer_median(&mut values);
    }
}

/// The middle value, of an even number the smaller middle one. At least one value.
fn nearer_median(values: &mut [f32]) -> f32 {
    // Insertion sort: a handful of values, mostly in no order.
    for end in 1..values.len() {
        let value = values[end];
        let mut at = end;
        while at > 0 && values[at - 1] > value {
            values[at] = values[at - 1];
            at -= 1;
        }
        values[at] = value;
    }
    values[(values.len() - 1) / 2]
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

/// `gipuma`: where the mean of the points of the reference and the agreeing sources lies from the
/// reference's `point`, in the reference's camera frame. For each agreeing source: its centre C in
/// that frame and expected / sampled depth. The source's point is C + (X − C) · sampled / expected.
pub(super) fn mean_displacement(point: DVec3, agreeing: &[(DVec3, f32)]) -> DVec3 {
    let moved = |(center, ratio): &(DVec3, f32)| (1.0 / f64::from(*ratio) - 1.0) * (point - center);
    let sum: DVec3 = agreeing.iter().map(moved).sum();
    #[allow(clippy::cast_precision_loss, reason = "a number of views")]
    let count = (agreeing.len() + 1) as f64;
    sum / count
}
