use super::common::{Centre, Global, Verdict, with_context};
use super::output::{self, answer, pairs};
use super::sweep::{self, SweepFlags};
use clap::Args;
use mvs_eval::config::{self, Size};
use mvs_eval::fuse::{FuseOptions, presets};
use mvs_eval::jobs::fuse::sweep::SweepJob;
use mvs_eval::jobs::fuse::{self, FuseJob};
use serde::Serialize;
use std::path::PathBuf;

/// Fuse depth maps into a point cloud, keeping what several views agree on
///
/// Reads SCENE/cams (or SCENE itself) and pair.txt, and colours the points from
/// SCENE/{blended_images,images,color} where there are images. Depth maps may be smaller than the
/// images: intrinsics are scaled to them. SCENE may be a COLMAP dense workspace too: its depth and
/// normal maps, fusion.cfg and sparse model are read.
///
/// Beside cloud.ply, cloud.json says what became of all pixels, by reason, and cloud.run.toml how it was made.
///
/// With --sweep the maps are read once and fused with a grid of parameters: OUT is a CSV of what
/// each gives, scored where --truth is given.
///
/// Example: mvs-eval fuse scene --depths estimates --confidence estimates/conf --out cloud.ply
#[derive(Debug, Args, Serialize)]
pub(crate) struct FuseArgs {
    /// The scene's folder
    scene: Option<PathBuf>,
    /// The folder of estimated depth maps, <id>.pfm (z-depth, 0 = none)
    #[arg(long, value_name = "DIR")]
    depths: Option<PathBuf>,
    /// A folder of confidence maps, <id>.pfm; given several times, the smallest value counts, and all but one may
    /// have fewer pixels than the depth maps. NaN and infinity are no confidence
    #[arg(long, value_name = "DIR")]
    #[serde(skip_serializing_if = "Vec::is_empty")]
    confidence: Vec<PathBuf>,
    /// Which maps of a COLMAP workspace: geometric (default) or photometric
    #[arg(long, value_name = "PASS")]
    stereo: Option<String>,
    /// The PLY to write
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// The folder of masks of the depth maps' size, <id>.png (of a workspace <image name>.png): pixels below 128
    /// are left out
    #[arg(long, value_name = "DIR")]
    masks: Option<PathBuf>,
    /// Leave out points outside of this polygon crop volume (JSON, in the scene's frame)
    #[arg(long, value_name = "FILE")]
    crop: Option<PathBuf>,
    /// Merge the points of each voxel of this edge (world units) into one, at their mean
    #[arg(long, value_name = "EDGE")]
    voxel: Option<f64>,
    /// Write OUT.vis too: which views see each point, as COLMAP's meshers read it
    #[arg(long)]
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    vis: bool,
    /// A folder for the depths that became points, <id>.pfm
    #[arg(long, value_name = "DIR")]
    filtered_depths: Option<PathBuf>,
    /// full: points have violations and scale, too; basic (default): they have not
    #[arg(long, value_name = "NAME")]
    properties: Option<String>,
    /// Type of the coordinates: auto (default: float where that moves no point by a millionth of a usual depth, or
    /// its own, else double), float or double
    #[arg(long, value_name = "TYPE")]
    coordinates: Option<String>,
    #[command(flatten)]
    #[serde(skip)]
    sweep: SweepFlags,
    /// Named set of options: blendedmvs, dtu, eth3d, tnt-advanced, tnt-intermediate
    #[arg(long, value_name = "NAME")]
    #[serde(skip)]
    preset: Option<String>,
    /// Where the cams put the centre of the top-left pixel: at (0.5, 0.5) or at (0, 0)
    #[arg(long, value_enum)]
    pixel_center: Option<Centre>,
    /// The image size that the cams are for; by default twice the principal point where that is whole and the view's
    /// image or depth map has so many times it or such a part of it; else that of either, whichever goes with the
    /// principal point, or a multiple of the depth map's size, with a warning
    #[arg(long, value_name = "WxH")]
    camera_size: Option<Size>,
    /// About how many MiB of maps to hold at a time (default 512); results do not depend on it
    #[arg(long, value_name = "MIB")]
    #[serde(skip)]
    memory: Option<usize>,
    #[command(flatten)]
    fuse: FuseFlags,
}

#[derive(Debug, Args, Serialize)]
pub(crate) struct FuseFlags {
    /// Procedure: hkust (default), geo, dynamic, gipuma, cluster
    #[arg(long, value_name = "NAME")]
    mode: Option<String>,
    /// hkust's first pass: median (default), merrell-confidence, merrell-stability, none
    #[arg(long, value_name = "NAME")]
    visibility: Option<String>,
    /// Sampling of source depth maps: valid (default of hkust and cluster) or plain
    #[arg(long, value_name = "NAME")]
    sampling: Option<String>,
    /// Leave out this fraction of each view's pixels with a depth, the least confident, instead of a threshold
    #[arg(long, value_name = "Q")]
    confidence_quantile: Option<f64>,
    /// Largest number of source views per reference view (default 10, cluster 50, gipuma all); 0 for all
    #[arg(long, value_name = "N")]
    max_sources: Option<usize>,
    /// Least confidence (default 0.8; where it is a maximum over hypotheses, 0.3 is usual): pixels below it are left
    /// out, in hkust, geo and dynamic those at it, too
    #[arg(long, value_name = "C")]
    pub(super) min_confidence: Option<f64>,
    /// Largest reprojection error in pixels (default 1, cluster 2)
    #[arg(long, value_name = "PX")]
    pub(super) max_pixel_error: Option<f64>,
    /// Largest relative depth error (default 0.01); in gipuma and dynamic it bounds nothing, but tells which views see
    /// through a point (--properties all, the guard)
    #[arg(long, value_name = "R")]
    max_depth_error: Option<f64>,
    /// Source views that must agree, the reference view not counted (default 3, cluster 4;
    /// dynamic has its own rule)
    #[arg(long, value_name = "N")]
    pub(super) min_sources: Option<usize>,
}

pub(crate) fn run(args: &FuseArgs, global: &Global) -> anyhow::Result<Verdict> {
    let job = job(args, global)?;
    if !global.quiet {
        let preset = args
            .preset
            .as_deref()
            .map(|name| format!(", preset {name}"));
        let summary = fuse::summary(&job);
        output::say(&format!("fusing{}: {summary}", preset.unwrap_or_default()));
    }
    if args.sweep.sweep {
        for (given, flag) in [
            (&args.properties, "--properties"),
            (&args.coordinates, "--coordinates"),
        ] {
            if given.is_some() {
                anyhow::bail!("{flag}: expected none with --sweep, which writes a table, no cloud");
            }
        }
        let file = sweep_file(args, global)?;
        return sweep::execute(&args.sweep.job(job, &args.fuse, file)?, global);
    }
    execute(&job, global)
}

/// The mode's options, overridden by the preset's, the file's, the flags'.
fn job(args: &FuseArgs, global: &Global) -> anyhow::Result<FuseJob> {
    let flags = config::layer_of(args)?;
    let mut file = match (sweep_file(args, global)?, &global.config) {
        (Some(sweep), _) => of_sweep(sweep)?,
        (None, Some(path)) => config::read_layer_of::<FuseJob>(path, "fuse")?,
        (None, None) => toml::Table::new(),
    };
    let is_run = (global.config.as_deref()).is_some_and(config::is_run);
    if is_run && mode_of(&flags).is_some_and(|mode| Some(mode) != mode_of(&file)) {
        leave_mode_out(&mut file)?;
    }
    let said = [&flags, &file].into_iter().find_map(mode_of);
    let mode = presets::mode_layer(said.unwrap_or("hkust"))?;
    let scene = scene_name(args, &file);
    let preset = match &args.preset {
        Some(name) => presets::preset_layer(name, &scene)?,
        None => toml::Table::new(),
    };
    say_what_hides(&preset, &file, &flags);
    let given = given(&args.fuse);
    let said = [&flags, &file]
        .iter()
        .any(|layer| says(layer, "min_sources"));
    let fuse = |options| toml::Table::from_iter([("fuse".to_owned(), toml::Value::Table(options))]);
    let job: FuseJob = config::resolve([fuse(mode), fuse(preset), file, flags])?;
    fuse::check_used(&job, &given)?;
    if let Some(name) = &args.preset
        && !said
        && job.fuse.mode.asks_for("min_sources")
    {
        say_unknown_scene(name, &scene)?;
    }
    Ok(FuseJob {
        memory: args.memory,
        ..job
    })
}

/// The file of a sweep, if one is asked for and the file is a sweep's.
fn sweep_file(args: &FuseArgs, global: &Global) -> mvs_eval::Result<Option<SweepJob>> {
    match &global.config {
        Some(path) if args.sweep.sweep => sweep::read(path),
        _ => Ok(None),
    }
}

/// What a sweep says of the job around which it is.
fn of_sweep(sweep: SweepJob) -> mvs_eval::Result<toml::Table> {
    config::layer_of(&FuseJob {
        out: sweep.out,
        ..sweep.fuse
    })
}

fn mode_of(layer: &toml::Table) -> Option<&str> {
    layer.get("fuse")?.get("mode")?.as_str()
}

/// Whether a layer says something of this option.
fn says(layer: &toml::Table, option: &str) -> bool {
    let options = layer.get("fuse").and_then(toml::Value::as_table);
    options.is_some_and(|options| options.contains_key(option))
}

/// Leaves out what a `run.toml`, which says everything, says only because of its mode.
fn leave_mode_out(layer: &mut toml::Table) -> anyhow::Result<()> {
    if let Some(toml::Value::Table(options)) = layer.get_mut("fuse")
        && let Some(mode) = options.get("mode")
    {
        let of_mode = toml::Table::try_from(FuseOptions::of(mode.clone().try_into()?))?;
        options.retain(|option, value| of_mode.get(option) != Some(value));
    }
    Ok(())
}

/// Names the options of a preset that the file overrides: a `run.toml` says all of them.
fn say_what_hides(preset: &toml::Table, file: &toml::Table, flags: &toml::Table) {
    let of = |layer: &toml::Table, option: &str| layer.get("fuse")?.get(option).cloned();
    let hidden = preset.iter().filter(|(option, value)| {
        let of_file = of(file, option);
        of(flags, option).is_none() && of_file.is_some_and(|of_file| !is_same(&of_file, value))
    });
    let hidden: Vec<&str> = hidden.map(|(option, _)| option.as_str()).collect();
    if !hidden.is_empty() {
        output::say(&format!(
            "warning [preset]: the file of --config, which counts, says something else than the preset for {}: \
             give them as flags, or leave one of the two out",
            hidden.join(", ")
        ));
    }
}

/// Whether two values are one, also where a number was written as an integer or is one of f32.
#[allow(
    clippy::cast_precision_loss,
    clippy::cast_possible_truncation,
    reason = "as options are read"
)]
fn is_same(one: &toml::Value, other: &toml::Value) -> bool {
    let number = |value: &toml::Value| match value {
        toml::Value::Integer(value) => Some(*value as f32),
        toml::Value::Float(value) => Some(*value as f32),
        _ => None,
    };
    match (number(one), number(other)) {
        (Some(one), Some(other)) => one.total_cmp(&other).is_eq(),
        _ => one == other,
    }
}

/// The procedure's options that were given as flags.
fn given(flags: &FuseFlags) -> Vec<&'static str> {
    let all = [
        (flags.visibility.is_some(), "visibility"),
        (flags.min_confidence.is_some(), "min_confidence"),
        (flags.max_pixel_error.is_some(), "max_pixel_error"),
        (flags.min_sources.is_some(), "min_sources"),
    ];
    let given = all.into_iter().filter(|(given, _)| *given);
    given.map(|(_, option)| option).collect()
}

/// Says so where a preset has a minimum of views for other scenes than this one.
fn say_unknown_scene(name: &str, scene: &str) -> anyhow::Result<()> {
    let known = presets::scenes(name)?;
    if !known.is_empty() && !known.iter().any(|known| known == scene) {
        output::say(&format!(
            "warning [preset]: {name} has a minimum of views for {}, none for `{scene}`: its general \
             one is used",
            known.join(", ")
        ));
    }
    Ok(())
}

/// The name that the scene folder is given by, that of a link perhaps, by which presets know it; that of
/// the folder itself for `.`.
fn scene_name(args: &FuseArgs, file: &toml::Table) -> String {
    let said = file.get("scene").and_then(toml::Value::as_str);
    let scene = args.scene.clone().or_else(|| said.map(PathBuf::from));
    mvs_eval::jobs::name_of(&scene.unwrap_or_default())
}

pub(crate) fn execute(job: &FuseJob, global: &Global) -> anyhow::Result<Verdict> {
    let outcome = with_context(global, |context| fuse::run(job, context))?;
    let counts = outcome.counts;
    let outside = counts.outside + counts.masked + counts.out_of_range;
    answer(global.format, &outcome, || {
        pairs(&[
            ("views", outcome.views.to_string()),
            ("points", outcome.points.to_string()),
            ("pixels", counts.pixels.to_string()),
            ("without a depth", counts.empty.to_string()),
            ("of too little confidence", counts.unconfident.to_string()),
            ("too few views agree", counts.inconsistent.to_string()),
            ("contradicted", counts.contradicted.to_string()),
            ("filled in from others", counts.filled.to_string()),
            (
                "merged",
                (counts.merged + outcome.merged_in_voxels).to_string(),
            ),
            ("outside, masked or out of range", outside.to_string()),
        ])
    })?;
    Ok(Verdict::Passed)
}
