use super::blend::BlendFlags;
use super::common::{Centre, Global, Left, Verdict, resolve, with_context_leaving};
use super::output::{answer, table};
use super::render::{CameraFlags, MeshFlags, RenderFlags};
use anyhow::Context as _;
use clap::{Args, ValueEnum};
use mvs_eval::config::{self, Size};
use mvs_eval::generate::Part;
use mvs_eval::jobs::generate::{self, GenerateJob};
use mvs_eval::jobs::generate_all;
use serde::Serialize;
use std::path::{Path, PathBuf};

/// Generate a BlendedMVS scene from a mesh, cameras and photographs
///
/// Writes OUT/<id>/{blended_images,cams,rendered_depth_maps} as existing BlendedMVS loaders read
/// them, list files in OUT, and scene.json with every convention, range and count. An interrupted
/// run goes on where it stopped.
///
/// Two sets in one run: --size 2048x1536 --size 768x576. Array jobs: --shard 1/8 … --shard 8/8, then
/// --merge. Several scenes: --manifest scenes.toml with [defaults] and [[scene]] tables of options.
///
/// Example: mvs-eval generate --mesh model.obj --cameras cams --photos images --out dataset
#[derive(Debug, Args, Serialize)]
pub(crate) struct GenerateArgs {
    /// Mesh files (.obj with .mtl, .ply, .glb, .gltf; textures are PNG or JPEG), folders of tiles, or quoted patterns
    /// like 'tiles/*.obj'; together one scene
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
    /// Size of the data set's images, e.g. 2048x1536 or 768x576; photographs are resized to cover it
    /// and cut to its centre, as the paper does. Given more than once, a set of each is made in
    /// OUT/<size>
    #[arg(long = "size", value_name = "WxH")]
    #[serde(skip_serializing_if = "Vec::is_empty")]
    sizes: Vec<Size>,
    /// Hold the scene out for validation in the list files
    #[arg(long)]
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    validation: bool,
    /// Make only the i-th of n parts of the views (from 1), e.g. 3/8; --merge comes last
    #[arg(long, value_name = "I/N", conflicts_with = "merge")]
    #[serde(skip)]
    shard: Option<Part>,
    /// Make only what belongs to the scene as a whole, from views that shards have finished
    #[arg(long)]
    #[serde(skip)]
    merge: bool,
    /// A TOML file of scenes: [defaults] and one [[scene]] each, with the options of this command under
    /// the names that the [options] of a run.toml have: mesh, cameras, photos, out, name, sizes, pairs,
    /// pixel_center, camera.size, options.render.samples, options.blend.… Paths are seen from the file.
    /// A scene that fails is reported and the next one made: exit code 1, or 2 where all fail
    #[arg(long, value_name = "FILE", conflicts_with_all = ["mesh", "cameras", "photos", "name", "id"])]
    #[serde(skip)]
    manifest: Option<PathBuf>,
    #[command(flatten)]
    camera: CameraFlags,
    /// Where the cams put the centre of the top-left pixel: at (0.5, 0.5) or at (0, 0)
    #[arg(long, value_enum)]
    pixel_center: Option<Centre>,
    /// What source views are chosen by: what the mesh lets each view see (`exact`, default), or the
    /// points of the COLMAP model that --cameras names (`colmap`)
    #[arg(long, value_enum)]
    #[serde(skip_serializing_if = "Option::is_none")]
    pairs: Option<PairsFlag>,
    #[command(flatten)]
    meshes: MeshFlags,
    #[command(flatten)]
    options: GenerateFlags,
}

#[derive(Debug, Clone, Copy, ValueEnum, Serialize)]
#[serde(rename_all = "lowercase")]
enum PairsFlag {
    Exact,
    Colmap,
}

#[derive(Debug, Args, Serialize)]
struct GenerateFlags {
    /// What to write beside the standard files, separated by commas
    #[arg(long, value_enum, value_delimiter = ',', value_name = "WHAT")]
    #[serde(skip_serializing_if = "Vec::is_empty")]
    extras: Vec<ExtraFlag>,
    /// How a view's depth range is chosen: `percentile` (default) as MVSNet's converter, `full`, or
    /// `widened` so that no depth is lost to readers
    #[arg(long, value_enum)]
    range: Option<RangeFlag>,
    /// Make each depth range longer by this fraction of its length at either end (default 0)
    #[arg(long, value_name = "FRACTION")]
    range_margin: Option<f64>,
    /// The pixel centre that the written cams are for: half (default) or integer; readers of
    /// BlendedMVS expect half
    #[arg(long = "export-pixel-center", value_enum)]
    #[serde(rename = "pixel_centre", skip_serializing_if = "Option::is_none")]
    export_pixel_center: Option<Centre>,
    /// JPEG quality (default 95)
    #[arg(long, value_name = "1-100")]
    #[serde(skip_serializing_if = "Option::is_none")]
    jpeg_quality: Option<u8>,
    /// JPEG chroma at full resolution (4:4:4) instead of half (4:2:0)
    #[arg(long)]
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    full_chroma: bool,
    #[command(flatten)]
    render: RenderFlags,
    #[command(flatten)]
    blend: BlendFlags,
}

#[derive(Debug, Clone, Copy, ValueEnum, Serialize)]
#[serde(rename_all = "snake_case")]
enum ExtraFlag {
    /// The photographs in the render's camera
    InputImages,
    /// The renderings
    RenderedImages,
    /// Where there is surface
    Masks,
    /// Geometric normals, camera frame
    Normals,
    /// Per pair, where the source sees the reference's surface
    Occlusion,
    /// Normals interpolated between vertices, camera frame
    InterpolatedNormals,
    /// What each pixel shows: 0 nothing, 32 no ray, 64 the back of a triangle, 192 surface whose samples
    /// disagree, 255 surface
    Sight,
    /// Where depth jumps
    DepthEdges,
    /// How much of each view's surface each other view sees
    Covisibility,
    /// Cameras for nerfstudio
    Transforms,
    /// Cameras as a COLMAP text model
    Colmap,
}

#[derive(Debug, Clone, Copy, ValueEnum, Serialize)]
#[serde(rename_all = "lowercase")]
enum RangeFlag {
    Percentile,
    Full,
    Widened,
}

pub(crate) fn run(args: &GenerateArgs, global: &Global) -> anyhow::Result<Verdict> {
    let part = match (args.shard, args.merge) {
        (Some(shard), _) => shard,
        (None, true) => Part::Merge,
        (None, false) => Part::All,
    };
    match &args.manifest {
        Some(manifest) => run_all(manifest, args, part, global),
        None => execute_part(&resolve("generate", args, global)?, part, global),
    }
}

pub(crate) fn execute(job: &GenerateJob, global: &Global) -> anyhow::Result<Verdict> {
    execute_part(job, Part::All, global)
}

fn execute_part(job: &GenerateJob, part: Part, global: &Global) -> anyhow::Result<Verdict> {
    let outcome = with_context_leaving(Left::Views, global, |context| {
        generate::run(job, part, context)
    })?;
    answer(global.format, &outcome, || {
        let mut table = table(&["scene", "views"]);
        for set in &outcome.sets {
            table.add_row([set.folder.display().to_string(), set.views.to_string()]);
        }
        table
    })?;
    Ok(Verdict::Passed)
}

fn run_all(
    manifest: &Path,
    args: &GenerateArgs,
    part: Part,
    global: &Global,
) -> anyhow::Result<Verdict> {
    anyhow::ensure!(
        global.config.is_none(),
        "expected no --config beside --manifest: put shared options under [defaults]"
    );
    let flags = config::layer_of(args).context("flags")?;
    let outcome = with_context_leaving(Left::Views, global, |context| {
        generate_all::run(manifest, &flags, part, context)
    })?;
    answer(global.format, &outcome, || {
        let mut table = table(&["scene", "views", "status"]);
        for scene in &outcome.scenes {
            table.add_row([&scene.name, &scene.views.to_string(), &scene.status]);
        }
        table
    })?;
    let all = outcome.scenes.len();
    anyhow::ensure!(
        outcome.failed < all,
        "{}: expected scenes that can be made, found that all {all} failed, each for the reason in its status",
        manifest.display()
    );
    Ok(Verdict::failed_if(outcome.failed > 0))
}
