use super::common::{Centre, Global, Verdict, resolve, with_context};
use super::output::{answer, table};
use super::render::{CameraFlags, MeshFlags};
use clap::Args;
use mvs_eval::jobs::pairs::{self, PairsJob};
use serde::Serialize;
use std::path::PathBuf;

/// Choose each view's source views, from a COLMAP model's points or a mesh
///
/// By MVSNet's score over the points that two views share: best at an angle of 5 degrees between
/// their lines of sight. With a mesh, what it hides is not shared.
///
/// Example: mvs-eval pairs --cameras sparse/0 --out pair.txt
#[derive(Debug, Args, Serialize)]
pub(crate) struct PairsArgs {
    /// A folder with a COLMAP model (binary or text); with --mesh, cameras of any kind
    #[arg(long, value_name = "PATH")]
    cameras: Option<PathBuf>,
    /// Mesh files, folders of tiles, or quoted patterns like 'tiles/*.obj'
    #[arg(long, num_args = 1.., value_name = "PATH")]
    #[serde(skip_serializing_if = "Vec::is_empty")]
    mesh: Vec<PathBuf>,
    /// The pair.txt to write; its run.toml stands beside it, which strict loaders do not want in cams/
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    #[command(flatten)]
    camera: CameraFlags,
    /// Where the cams put the centre of the top-left pixel: at (0.5, 0.5) or at (0, 0)
    #[arg(long, value_enum)]
    pixel_center: Option<Centre>,
    #[command(flatten)]
    meshes: MeshFlags,
    #[command(flatten)]
    pairs: PairFlags,
}

#[derive(Debug, Args, Serialize)]
struct PairFlags {
    /// Source views per view, at most (default 10)
    #[arg(long, value_name = "N")]
    sources: Option<usize>,
}

pub(crate) fn run(args: &PairsArgs, global: &Global) -> anyhow::Result<Verdict> {
    execute(&resolve("pairs", args, global)?, global)
}

pub(crate) fn execute(job: &PairsJob, global: &Global) -> anyhow::Result<Verdict> {
    let outcome = with_context(global, |context| pairs::run(job, context))?;
    answer(global.format, &outcome, || {
        let mut table = table(&["view", "image", "source views, best first"]);
        for view in &outcome.views {
            let ids: Vec<String> = view.sources.iter().map(|(id, _)| id.to_string()).collect();
            table.add_row([view.id.to_string(), view.name.clone(), ids.join(" ")]);
        }
        table
    })?;
    Ok(Verdict::Passed)
}
