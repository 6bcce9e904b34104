use super::common::{Centre, Global, Left, Verdict, resolve, with_context_leaving};
use super::output::{answer, table};
use clap::{Args, ValueEnum};
use mvs_eval::config::Size;
use mvs_eval::jobs::render::{self, RenderJob, RenderOutcome};
use serde::Serialize;
use std::path::PathBuf;

/// Render a textured mesh from every camera: depth, colour, cams
///
/// Writes depth/<id>.pfm (z-depth in world units, 0 = none, exact at pixel centres), color/<id>.png
/// (8-bit sRGB) and cams/<id>_cam.txt, where <id> has eight digits, and views.json with the images' names
/// by id. Cameras with a lens are rendered
/// through it, by exact inversion of its distortion; --undistort renders pinhole images instead.
///
/// Example: mvs-eval render --mesh model.obj --cameras cams --pixel-center integer --out rendered
#[derive(Debug, Args, Serialize)]
pub(crate) struct RenderArgs {
    /// Mesh files (.obj with .mtl, .ply, .glb, .gltf; textures are PNG or JPEG), folders of tiles, or quoted patterns
    /// like 'tiles/*.obj'; together one scene
    #[arg(long, num_args = 1.., value_name = "PATH")]
    #[serde(skip_serializing_if = "Vec::is_empty")]
    mesh: Vec<PathBuf>,
    /// Cameras: a folder of MVSNet cams, a COLMAP model, transforms.json, or a .log
    #[arg(long, value_name = "PATH")]
    cameras: Option<PathBuf>,
    /// The folder to write
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Image size; cameras that state another are scaled to cover it and cut to its centre
    #[arg(long, value_name = "WxH")]
    size: Option<Size>,
    #[command(flatten)]
    camera: CameraFlags,
    /// Where the cameras put the centre of the top-left pixel: at (0.5, 0.5) or at (0, 0); the cams that are written
    /// have it at (0.5, 0.5)
    #[arg(long, value_enum)]
    pixel_center: Option<Centre>,
    /// Render pinhole images of cameras that have a lens
    #[arg(long)]
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    undistort: bool,
    /// Write more, separated by commas: normals (geometric), interpolated-normals, sight (what each pixel shows: 0 nothing,
    /// 32 no ray, 64 the back of a triangle, 192 surface whose samples disagree, 255 surface)
    #[arg(long = "also", value_enum, value_delimiter = ',', value_name = "WHAT")]
    #[serde(skip_serializing_if = "Vec::is_empty")]
    extras: Vec<Also>,
    #[command(flatten)]
    meshes: MeshFlags,
    #[command(flatten)]
    render: RenderFlags,
}

#[derive(Debug, Clone, Copy, ValueEnum, Serialize)]
#[serde(rename_all = "snake_case")]
enum Also {
    Normals,
    #[value(alias = "interpolated_normals")]
    InterpolatedNormals,
    Sight,
}

/// How meshes are read.
#[derive(Debug, Args, Serialize)]
pub(crate) struct MeshFlags {
    /// The most memory in MiB that decoded textures may take (default 6144); more are refused
    #[arg(long, value_name = "MIB")]
    texture_memory: Option<u64>,
}

/// What camera files may leave open.
#[derive(Debug, Args, Serialize)]
pub(crate) struct CameraFlags {
    /// The image size that the intrinsics are for, where the files have none; by default, where the
    /// files are cams, the size of the image asked for or, view by view, given if that goes
    /// with the principal point, else twice that; of a transforms.json, the photographs' (generate)
    #[arg(long = "camera-size", value_name = "WxH")]
    #[serde(rename = "size")]
    camera_size: Option<Size>,
    /// Focal length in pixels, where the files have none
    #[arg(long, value_name = "PX")]
    focal: Option<f64>,
    /// Principal point in pixels, where the files have none; by default the image's centre
    #[arg(long, value_names = ["X", "Y"], value_delimiter = ',', num_args = 2)]
    #[serde(skip_serializing_if = "Vec::is_empty")]
    center: Vec<f64>,
}

#[derive(Debug, Args, Serialize)]
pub(crate) struct RenderFlags {
    /// Colour samples per pixel, a square number: 4 for drafts, 16 (default) for data sets
    #[arg(long)]
    samples: Option<u32>,
    /// What the backs of triangles are: invalid (default; they hide what is behind and have no depth)
    /// or valid (surface like the front). Double-sided glTF materials are valid on both sides.
    #[arg(long, value_enum)]
    back_faces: Option<Backs>,
}

#[derive(Debug, Clone, Copy, ValueEnum, Serialize)]
#[serde(rename_all = "lowercase")]
enum Backs {
    Invalid,
    Valid,
}

pub(crate) fn run(args: &RenderArgs, global: &Global) -> anyhow::Result<Verdict> {
    execute(&resolve("render", args, global)?, global)
}

pub(crate) fn execute(job: &RenderJob, global: &Global) -> anyhow::Result<Verdict> {
    let outcome = with_context_leaving(Left::Files, global, |context| render::run(job, context))?;
    answer(global.format, &outcome, || as_table(&outcome))?;
    Ok(Verdict::Passed)
}

fn as_table(outcome: &RenderOutcome) -> comfy_table::Table {
    let mut table = table(&["view", "image", "size", "coverage", "depth"]);
    for view in &outcome.views {
        let depth = match (view.depth_min, view.depth_max) {
            (Some(min), Some(max)) => format!("{min:.4} … {max:.4}"),
            _ => "–".to_owned(),
        };
        table.add_row([
            view.id.to_string(),
            view.name.clone(),
            format!("{}x{}", view.width, view.height),
            format!("{:.1} %", 100.0 * view.coverage),
            depth,
        ]);
    }
    table
}
