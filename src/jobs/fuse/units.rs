//! Whether depths are in the units of their cameras.

use mvs_datasets::scene::{DepthRange, View};

/// Depths beyond so many times their range are of other units.
const FAR: f64 = 10.0;

/// How many depths there are, and how many are far below and far above their view's range.
#[derive(Debug, Default)]
pub(super) struct Units {
    all: u64,
    below: u64,
    above: u64,
}

impl Units {
    /// Counts clean depths, ≥ 0, of which 0 is none.
    pub(super) fn add(&mut self, range: DepthRange, values: &[f32]) {
        #[allow(clippy::cast_possible_truncation, reason = "far is far to a digit")]
        let [below, above] = [range.min() / FAR, range.max() * FAR].map(|bound| bound as f32);
        let count = |is: &dyn Fn(f32) -> bool| values.iter().filter(|&&z| is(z)).count() as u64;
        self.all += count(&|z| z > 0.0);
        self.below += count(&|z| z > 0.0 && z < below);
        self.above += count(&|z| z > above);
    }

    /// Whether the median is neither; not known before any depth was read.
    pub(super) fn are_usual(&self) -> bool {
        self.all > 0 && 2 * self.below.max(self.above) < self.all
    }
}

/// What to say of a view with a depth range if its clean depths lie far outside of it.
pub(super) fn problem(view: &View, depths: &[f32]) -> Option<String> {
    let range = view.depth_range?;
    let mut depths: Vec<f32> = depths.iter().copied().filter(|&z| z > 0.0).collect();
    if depths.is_empty() {
        return None;
    }
    let middle = depths.len() / 2;
    let median = f64::from(*depths.select_nth_unstable_by(middle, f32::total_cmp).1);
    (median * FAR < range.min() || median > range.max() * FAR).then(|| {
        format!(
            "the median depth of view {} is {median} where its cam.txt states {} to {}: are the depth maps in \
             the cameras' units?",
            view.id,
            range.min(),
            range.max()
        )
    })
}
