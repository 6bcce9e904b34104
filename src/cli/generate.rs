use super::blend::BlendFlags;
use super::common::{Centre, Global, Verdict, resolve, with_context};
use super::output::{answer, pairs};
use super::render::{CameraFlags, RenderFlags};
use clap::Args;
use mvs_eval::config::Size;
use mvs_eval::jobs::generate::{self, GenerateJob};
use serde::{Serialize, Serializer};
use std::path::PathBuf;

/// Generate a BlendedMVS scene from a mesh, cameras and photographs
///
/// Writes OUT/<id>/{blended_images,cams,rendered_depth_maps} as existing BlendedMVS loaders read
/// them, list files in OUT, and scene.json with every convention, range and count. An interrupted
/// run goes on where it stopped.
///
/// Example: mvs-eval generate --mesh model.obj --cameras cams --photos images --out dataset
#[derive(Debug, Args, Serialize)]
pub(crate) struct GenerateArgs {
    /// Mesh files (.obj with .mtl and textures, .ply), or folders of tiles; together one scene
    #[arg(long, num_args = 1.., value_name = "PATH")]
    #[serde(skip_serializing_if = "Vec::is_empty")]
    mesh: Vec<PathBuf>,
    /// Cameras: a folder of MVSNet cams, a COLMAP model, transforms.json, or a .log
    #[arg(long, value_name = "PATH")]
    cameras: Option<PathBuf>,
    /// A folder of photographs, 00000000.jpg …
    #[arg(long, value_name = "DIR")]
    photos: Option<PathBuf>,
    /// The data set's root
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// The scene's name, whose hash names its folder; by default that of the photographs' parent
    #[arg(long)]
    name: Option<String>,
    /// The 24 hexadecimal digits of the scene's folder
    #[arg(long, value_name = "HEX")]
    id: Option<String>,
    #[command(flatten)]
    camera: CameraFlags,
    /// Where the cams put the centre of the top-left pixel: at (0.5, 0.5) or at (0, 0)
    #[arg(long, value_enum)]
    pixel_center: Option<Centre>,
    #[command(flatten)]
    options: GenerateFlags,
}

#[derive(Debug, Args, Serialize)]
struct GenerateFlags {
    /// Size of the data set's images, e.g. 2048x1536 or 768x576; photographs are resized to cover it
    /// and cut to its centre, as the paper does
    #[arg(long, value_name = "WxH")]
    #[serde(skip_serializing_if = "Option::is_none", serialize_with = "as_pair")]
    size: Option<Size>,
    #[command(flatten)]
    render: RenderFlags,
    #[command(flatten)]
    blend: BlendFlags,
}

fn as_pair<S: Serializer>(size: &Option<Size>, serializer: S) -> Result<S::Ok, S::Error> {
    size.map(|size| (size.width, size.height))
        .serialize(serializer)
}

pub(crate) fn run(args: &GenerateArgs, global: &Global) -> anyhow::Result<Verdict> {
    execute(&resolve("generate", args, global)?, global)
}

pub(crate) fn execute(job: &GenerateJob, global: &Global) -> anyhow::Result<Verdict> {
    let outcome = with_context(global, |context| generate::run(job, context))?;
    answer(global.format, &outcome, || {
        pairs(&[
            ("scene", outcome.folder.display().to_string()),
            ("views", outcome.scene.views.len().to_string()),
        ])
    })?;
    Ok(Verdict::Passed)
}
