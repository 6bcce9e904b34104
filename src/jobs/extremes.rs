//! `mvs-eval extremes`: how far off every stage is where coordinates, scales, depth ranges, repeats and
//! image sizes are extreme, and what plainer arithmetic would have given.
//!
//! Every error is against a closed form, or against the same input where nothing is extreme.

mod blend;
mod fuse;
mod naive;
mod place;
mod render;
mod score;

use super::{Context, OutDir};
use crate::error::{Error, Result};
use crate::progress::Progress;
use crate::provenance::{Inputs, Run};
use place::Place;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// Relative depth error allowed to a rendered map: twice the rounding of f32, near enough.
pub const DEPTH_BOUND: f64 = 1e-7;
/// Change of precision and recall allowed under any offset, from a million points on: a count or two in them.
pub const SCORE_BOUND: f64 = 1e-6;

/// Options of `mvs-eval extremes`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ExtremesJob {
    /// The folder to write.
    pub out: PathBuf,
    /// Points of the scored truth; the reconstruction has half as many.
    pub points: u32,
    /// The widest image that is rendered, in pixels.
    pub width: u32,
}

impl Default for ExtremesJob {
    fn default() -> Self {
        Self {
            out: PathBuf::from("extremes-out"),
            points: 1_000_000,
            width: 2048,
        }
    }
}

/// One measured error.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ExtremesRow {
    /// `render`, `fuse`, `blend` or `score`.
    pub stage: String,
    /// What is extreme: `offset`, `scale`, `near-far`, `duplicates`, `image-size` or `light`.
    pub axis: String,
    /// How extreme: world units, a factor, a ratio, copies, pixels across, or grey levels.
    pub value: f64,
    /// `ours`, or the plainer arithmetic beside it: `f64`, `f64 recentred`, `f32`, `f32 recentred`.
    pub arithmetic: String,
    /// What is measured, with its unit.
    pub quantity: String,
    /// The error.
    pub error: f64,
    /// The largest error that is allowed, where this project promises one.
    pub bound: Option<f64>,
}

impl ExtremesOutcome {
    fn of(rows: Vec<ExtremesRow>) -> Self {
        let broken = rows.iter().filter(|row| !row.holds()).count();
        Self { rows, broken }
    }
}

impl ExtremesRow {
    /// Whether the error is within its bound.
    pub fn holds(&self) -> bool {
        self.bound.is_none_or(|bound| self.error <= bound)
    }
}

/// A row of `extremes.csv`: one measurement by every arithmetic.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
struct WideRow {
    stage: String,
    axis: String,
    value: f64,
    quantity: String,
    ours: Option<f64>,
    bound: Option<f64>,
    f64: Option<f64>,
    f64_recentred: Option<f64>,
    f32: Option<f64>,
    f32_recentred: Option<f64>,
}

/// Joins what differs in arithmetic alone, in the order of first appearance.
fn wide(rows: &[ExtremesRow]) -> Vec<WideRow> {
    let mut all: Vec<WideRow> = Vec::new();
    for row in rows {
        let wide = match all.iter().position(|wide| {
            wide.stage == row.stage
                && wide.axis == row.axis
                && wide.value.to_bits() == row.value.to_bits()
                && wide.quantity == row.quantity
        }) {
            Some(place) => &mut all[place],
            None => {
                all.push(WideRow {
                    stage: row.stage.clone(),
                    axis: row.axis.clone(),
                    value: row.value,
                    quantity: row.quantity.clone(),
                    ..WideRow::default()
                });
                let last = all.len() - 1;
                &mut all[last]
            }
        };
        let cell = match row.arithmetic.as_str() {
            "f64" => &mut wide.f64,
            "f64 recentred" => &mut wide.f64_recentred,
            "f32" => &mut wide.f32,
            "f32 recentred" => &mut wide.f32_recentred,
            _ => &mut wide.ours,
        };
        *cell = Some(row.error);
        wide.bound = wide.bound.or(row.bound);
    }
    all
}

/// What was measured.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ExtremesOutcome {
    /// All rows, as in `extremes.csv`.
    pub rows: Vec<ExtremesRow>,
    /// Rows whose error is beyond its bound.
    pub broken: usize,
}

/// Collects the rows of one stage, unless the user wants that to stop.
struct Rows<'a> {
    stage: &'static str,
    all: Vec<ExtremesRow>,
    progress: &'a dyn Progress,
}

impl Rows<'_> {
    fn put(
        &mut self,
        (axis, value): (&str, f64),
        arithmetic: &str,
        (quantity, error): (&str, f64),
        bound: Option<f64>,
    ) -> Result<()> {
        self.all.push(ExtremesRow {
            stage: self.stage.to_owned(),
            axis: axis.to_owned(),
            value,
            arithmetic: arithmetic.to_owned(),
            quantity: quantity.to_owned(),
            error,
            bound,
        });
        self.progress.check()
    }
}

/// Points below which the bound of scores would allow nearly any.
const FEWEST: u32 = 100;

/// Measures everything and writes `extremes.csv`.
///
/// # Errors
/// Fewer than 100 points, no width, an output folder as [`OutDir::create`] refuses it, whatever writing brings, and
/// interruption.
pub fn run(job: &ExtremesJob, context: &Context<'_>) -> Result<ExtremesOutcome> {
    if job.points < FEWEST {
        let problem = format!(
            "expected at least {FEWEST}, as a score may change by two points of the half of them, found {}",
            job.points
        );
        return Err(Error::invalid("--points", problem));
    }
    if job.width == 0 {
        return Err(Error::invalid("--width", "expected at least 1, found 0"));
    }
    let out = OutDir::create(
        &job.out,
        Run::new("extremes", job, &Inputs::default())?,
        context.force,
    )?;
    let rows = measure(job, context)?;
    out.write("extremes.csv", |file| {
        let mut writer = csv::Writer::from_writer(file);
        for row in &wide(&rows) {
            writer.serialize(row).map_err(std::io::Error::other)?;
        }
        writer.flush()
    })?;
    out.finish()?;
    Ok(ExtremesOutcome::of(rows))
}

/// The rows of every stage.
///
/// # Errors
/// No points, and interruption.
pub fn measure(job: &ExtremesJob, context: &Context<'_>) -> Result<Vec<ExtremesRow>> {
    type Stage = fn(&ExtremesJob, &mut Rows<'_>) -> Result<()>;
    let stages: [(&'static str, Stage); 4] = [
        ("render", render::measure),
        ("blend", blend::measure),
        ("fuse", fuse::measure),
        ("score", score::measure),
    ];
    context.progress.begin("extremes", stages.len() as u64);
    let mut all = Vec::new();
    for (stage, measure) in stages {
        let mut rows = Rows {
            stage,
            all: Vec::new(),
            progress: context.progress,
        };
        measure(job, &mut rows)?;
        all.append(&mut rows.all);
        context.progress.advance(1);
    }
    Ok(all)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_above_their_bounds_and_no_numbers_are_broken() {
        let row = |error, bound| ExtremesRow {
            stage: "score".into(),
            axis: "offset".into(),
            value: 1e6,
            arithmetic: "ours".into(),
            quantity: "change".into(),
            error,
            bound,
        };
        let broken = |error, bound| ExtremesOutcome::of(vec![row(error, bound)]).broken;
        assert_eq!((broken(0.1, Some(0.1)), broken(9.0, None)), (0, 0));
        assert_eq!(
            (broken(0.11, Some(0.1)), broken(f64::NAN, Some(0.1))),
            (1, 1)
        );
    }
}
