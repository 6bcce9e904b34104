use super::common::{Global, Left, Verdict, resolve, with_context_leaving};
use super::output::{answer, table};
use clap::{Args, ValueEnum};
use mvs_eval::jobs::blend::{self, BlendJob};
use serde::Serialize;
use std::path::PathBuf;

/// Blend renderings with photographs: the rendering's detail in the photograph's light
///
/// The low frequencies come from the photograph, the high ones from the rendering (as the
/// BlendedMVS paper generates its blended images). Writes <name>.jpg and <name>_masked.jpg.
///
/// Example: mvs-eval blend --rendered rendered --photos images --out blended
#[derive(Debug, Args, Serialize)]
pub(crate) struct BlendArgs {
    /// What `render` wrote, or a folder of renderings on black
    #[arg(long, value_name = "DIR")]
    rendered: Option<PathBuf>,
    /// A folder of photographs with the names of the rendered images (`render` writes them to views.json),
    /// else with the renderings'; one of another size is resized to cover its rendering and cut to the centre
    #[arg(long, value_name = "DIR")]
    photos: Option<PathBuf>,
    /// The folder to write
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    #[command(flatten)]
    blend: BlendFlags,
}

/// Flags of the blend itself.
#[derive(Debug, Args, Serialize)]
pub(crate) struct BlendFlags {
    /// `reference` is the paper's formula, `composite` fills the background from the photograph
    /// first, `normalized` (default) is exact for constant light up to the mask's edge
    #[arg(long, value_enum)]
    mode: Option<Mode>,
    /// The filter's D0 in squared FFT bins of the full frame (default 5000)
    #[arg(long, conflicts_with = "sigma")]
    d0: Option<f64>,
    /// The filter's standard deviation in pixels instead of --d0
    #[arg(long, value_name = "PX")]
    sigma: Option<f64>,
    /// Blend in linear light instead of on sRGB values
    #[arg(long)]
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    linear_light: bool,
}

#[derive(Debug, Clone, Copy, ValueEnum, Serialize)]
#[serde(rename_all = "lowercase")]
enum Mode {
    Reference,
    Composite,
    Normalized,
}

pub(crate) fn run(args: &BlendArgs, global: &Global) -> anyhow::Result<Verdict> {
    execute(&resolve("blend", args, global)?, global)
}

pub(crate) fn execute(job: &BlendJob, global: &Global) -> anyhow::Result<Verdict> {
    let outcome = with_context_leaving(Left::Files, global, |context| blend::run(job, context))?;
    answer(global.format, &outcome, || {
        let mut table = table(&["image", "size", "|render − photo|", "|blended − photo|"]);
        for image in &outcome.images {
            table.add_row([
                image.name.clone(),
                format!("{}x{}", image.size.0, image.size.1),
                format!("{:.2}", image.difference_before),
                format!("{:.2}", image.difference_after),
            ]);
        }
        table
    })?;
    Ok(Verdict::Passed)
}
