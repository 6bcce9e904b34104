use super::common::{self, Global, Left, Verdict, resolve, with_context_leaving};
use super::output::{answer, table};
use clap::Args;
use mvs_eval::jobs::augment::{self, AugmentJob};
use serde::Serialize;
use std::path::PathBuf;

/// Change training images at random: brightness, contrast, motion blur, in random order
///
/// As the BlendedMVS training does. The same seed gives the same images; what was drawn is written
/// to OUT/augment.json.
///
/// Example: mvs-eval augment --images dataset/<id> --seed 7 --out augmented
#[derive(Debug, Args, Serialize)]
pub(crate) struct AugmentArgs {
    /// A folder of images, or a scene with blended_images/
    #[arg(long, value_name = "DIR")]
    images: Option<PathBuf>,
    /// The folder for the changed images
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// What is drawn follows from this and the view (default 0)
    #[arg(long, value_name = "N", value_parser = common::seed)]
    seed: Option<u64>,
}

pub(crate) fn run(args: &AugmentArgs, global: &Global) -> anyhow::Result<Verdict> {
    execute(&resolve("augment", args, global)?, global)
}

pub(crate) fn execute(job: &AugmentJob, global: &Global) -> anyhow::Result<Verdict> {
    let outcome = with_context_leaving(Left::Files, global, |context| augment::run(job, context))?;
    answer(global.format, &outcome, || {
        let mut table = table(&["image", "first", "then", "then"]);
        for image in &outcome.images {
            let steps = image.steps.iter().map(|step| format!("{step:?}"));
            table.add_row(std::iter::once(image.file.clone()).chain(steps));
        }
        table
    })?;
    Ok(Verdict::Passed)
}
