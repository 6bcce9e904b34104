use super::common::{Centre, Global, Verdict, resolve, with_context};
use super::output::{answer, table};
use clap::Args;
use mvs_eval::jobs::inspect::{self, InspectJob};
use serde::Serialize;
use std::path::PathBuf;

/// Say what a file or folder is, as this program understands it
///
/// Takes a cloud or mesh (.ply, .obj, .glb, .gltf), a depth map (.pfm), an image, a trajectory (.log), a
/// crop volume or cameras (.json), or a folder of cams, with a COLMAP model or transforms.json, of
/// meshes or of a Tanks and Temples scene.
#[derive(Debug, Args, Serialize)]
pub(crate) struct InspectArgs {
    /// The file or folder
    path: PathBuf,
    /// Where cams put the centre of the top-left pixel: at (0.5, 0.5) or at (0, 0)
    #[arg(long, value_enum)]
    pixel_center: Option<Centre>,
}

pub(crate) fn run(args: &InspectArgs, global: &Global) -> anyhow::Result<Verdict> {
    let job: InspectJob = resolve("inspect", args, global)?;
    let outcome = with_context(global, |context| inspect::run(&job, context))?;
    answer(global.format, &outcome, || {
        let mut table = table(&["", outcome.kind.as_str()]);
        for fact in &outcome.facts {
            table.add_row([fact.name, fact.value.as_str()]);
        }
        table
    })?;
    Ok(Verdict::Passed)
}
