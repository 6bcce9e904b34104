use super::common::{self, Global, Left, Verdict, resolve, with_context, with_context_leaving};
use super::output::{answer, pairs, table};
use clap::{Args, ValueEnum};
use mvs_eval::jobs::score::{self, ScoreDocument, ScoreJob};
use mvs_eval::jobs::score_all::{self, BatchOutcome};
use serde::Serialize;
use std::path::PathBuf;

/// Score a reconstruction against the truth: precision, recall, F-score
///
/// Two forms. `--protocol tnt` follows the Tanks and Temples toolbox: the reconstruction is brought
/// into the frame of the laser scan by its cameras (--trajectory) and ICP, or by a known --transform;
/// both clouds are cropped by the scene's polygon and averaged over voxels of τ/2. Without
/// --protocol, --truth and --reconstruction share a frame and are compared as they are.
///
/// Writes score.json, scores.csv, the judged clouds coloured by error (<Scene>.precision.ply and
/// .recall.ply, with the distance as scalar `error`), the cumulative curves up to 5 τ
/// (<Scene>.precision.txt and .recall.txt), their picture (PR_<Scene>_@d_th_*.png and .svg) and the
/// summary <Scene>.prf_tau_plotstr.txt.
///
/// With tnt, gates look for misalignment: a shifted or wrong log, a wrong transform, wrong units, a
/// collapsed scale. A failed gate names its cause on stderr and in score.json; the exit code is then 1.
/// Without --protocol the clouds are taken to share a frame: a score of 0 is explained by a warning.
///
/// Example: mvs-eval score --protocol tnt --scene data/Barn --reconstruction barn.ply
/// --trajectory barn.log --out results/barn
///
/// Example: mvs-eval score --all data --methods submissions --out results
///
/// Example: mvs-eval score --truth scan.ply --reconstruction cloud.ply --tau 0.01,0.02 --out results
#[derive(Debug, Args, Serialize)]
pub(crate) struct ScoreArgs {
    /// The procedure: `plain` (default) or `tnt`, Tanks and Temples
    #[arg(long, value_enum)]
    protocol: Option<ProtocolName>,
    /// tnt: the scene folder with <Scene>.ply, .json, _COLMAP_SfM.log and _trans.txt
    #[arg(long, value_name = "DIR")]
    scene: Option<PathBuf>,
    /// tnt: score every scene folder in this folder with every method in it, going on after failures;
    /// a method is a sub-folder with one .ply and one .log, or else a COLMAP model of its cameras (there,
    /// in sparse or in sparse/0), or else one .txt, its transform
    #[arg(long, value_name = "ROOT", conflicts_with_all = ["scene", "reconstruction"])]
    all: Option<PathBuf>,
    /// With --all: take <method>/<Scene>.ply and <Scene>.log, the model in <Scene>/ or <Scene>.txt from
    /// this folder of submissions
    #[arg(long, value_name = "DIR", requires = "all")]
    methods: Option<PathBuf>,
    /// plain: the true surface, a PLY cloud or any mesh that --reconstruction takes
    #[arg(long, value_name = "FILE")]
    truth: Option<PathBuf>,
    /// The reconstruction: a PLY cloud, or a PLY, OBJ, GLB or glTF mesh
    #[arg(long, value_name = "FILE")]
    reconstruction: Option<PathBuf>,
    /// A 4x4 text file, reconstruction to truth: takes the place of the alignment
    #[arg(long, value_name = "FILE", conflicts_with = "trajectory")]
    transform: Option<PathBuf>,
    /// tnt: the reconstruction's cameras; aligns by them, then by ICP. A .log, whose poses are in the
    /// scene's order; or the folder of a COLMAP model, whose images are known by their numbers
    /// (000001.jpg is the scene's first camera), so that none can be taken for another
    #[arg(long, value_name = "PATH")]
    trajectory: Option<PathBuf>,
    /// tnt: refine --transform by the ICP stages
    #[arg(long)]
    #[serde(skip_serializing_if = "is_false")]
    refine: bool,
    /// The folder to write
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// tnt: `strict` (default) aligns robustly and lets ICP converge; `official` repeats the toolbox
    /// with its slips (of a mesh it would take the vertices: --mesh-as vertices)
    #[arg(long, value_enum)]
    profile: Option<ProfileName>,
    /// Tolerances in world units, separated by commas; the seven known tnt scenes bring their own. Curve, picture and
    /// coloured clouds are for the first
    #[arg(long, value_name = "T", value_delimiter = ',')]
    #[serde(skip_serializing_if = "Vec::is_empty")]
    tau: Vec<f64>,
    /// The scene's name, prefix of its files; by default the folder's, or the truth's file name
    #[arg(long, value_name = "SCENE")]
    name: Option<String>,
    /// The method's name in the records; by default the reconstruction's file name
    #[arg(long)]
    method: Option<String>,
    /// plain: judge only what lies in this Open3D polygon volume (JSON)
    #[arg(long, value_name = "FILE")]
    crop: Option<PathBuf>,
    /// plain: average both clouds over voxels of this edge first
    #[arg(long, value_name = "H")]
    voxel: Option<f64>,
    /// Seed of everything drawn (default 0)
    #[arg(long, value_name = "N", value_parser = common::seed)]
    seed: Option<u64>,
    /// Which points stand for a mesh: `area` (default, at least one per (τ/2)²), `vertices` or
    /// `centroids`
    #[arg(long, value_enum)]
    mesh_as: Option<MeshAsName>,
    /// Confidence interval of F from this many resamples of blocks of space, 16 along the longest side of
    /// the truth, without what lies far from the rest of it: too narrow where errors hang together over more than
    /// a block, and none where one block holds more than half of a side's points
    #[arg(long, value_name = "N")]
    bootstrap: Option<u32>,
    /// tnt: spread of F over this many seeds
    #[arg(long, value_name = "N")]
    seeds: Option<u32>,
    /// tnt: do not also compute the other profile's score
    #[arg(long)]
    #[serde(skip_serializing_if = "is_false")]
    one_profile: bool,
    /// tnt: how near a camera must come to its reference to agree (default 0.2, metres)
    #[arg(long, value_name = "D")]
    camera_distance: Option<f64>,
}

#[derive(Debug, Clone, Copy, ValueEnum, Serialize)]
#[serde(rename_all = "lowercase")]
enum ProtocolName {
    Plain,
    Tnt,
}

#[derive(Debug, Clone, Copy, ValueEnum, Serialize)]
#[serde(rename_all = "lowercase")]
enum ProfileName {
    Strict,
    Official,
}

#[derive(Debug, Clone, Copy, ValueEnum, Serialize)]
#[serde(rename_all = "lowercase")]
enum MeshAsName {
    Area,
    Vertices,
    Centroids,
}

fn is_false(flag: &bool) -> bool {
    !flag
}

pub(crate) fn run(args: &ScoreArgs, global: &Global) -> anyhow::Result<Verdict> {
    if args.all.is_some() && matches!(args.protocol, Some(ProtocolName::Plain)) {
        anyhow::bail!(
            "--protocol: expected tnt, or none, beside --all, which scores Tanks and Temples scenes, \
             found plain: leave it out"
        );
    }
    execute(&resolve("score", args, global)?, global)
}

pub(crate) fn execute(job: &ScoreJob, global: &Global) -> anyhow::Result<Verdict> {
    if job.all.is_some() {
        let outcome =
            with_context_leaving(Left::Files, global, |context| score_all::run(job, context))?;
        answer(global.format, &outcome, || batch_table(&outcome))?;
        return Ok(Verdict::failed_if(outcome.not_ok > 0));
    }
    let document = with_context(global, |context| score::run(job, context))?;
    answer(global.format, &document, || as_table(&document))?;
    Ok(Verdict::failed_if(!document.passed))
}

fn batch_table(outcome: &BatchOutcome) -> comfy_table::Table {
    let mut table = table(&[
        "scene",
        "method",
        "precision",
        "recall",
        "F-score",
        "status",
    ]);
    let said = |value: Option<f64>| value.map_or_else(|| "–".to_owned(), |v| format!("{v:.4}"));
    for row in &outcome.rows {
        table.add_row([
            row.scene.clone(),
            row.method.clone(),
            said(row.precision),
            said(row.recall),
            said(row.f_score),
            row.status.clone(),
        ]);
    }
    table
}

fn as_table(document: &ScoreDocument) -> comfy_table::Table {
    let (reconstruction, truth) = (&document.counts.reconstruction, &document.counts.truth);
    let profile = document
        .profile
        .map_or_else(String::new, |profile| format!(" ({profile})"));
    let mut rows = vec![
        ("scene", document.scene.clone()),
        ("protocol", format!("{}{profile}", document.protocol)),
    ];
    for at in &document.by_tolerance {
        rows.push(("tolerance", at.tolerance.to_string()));
        rows.push(("precision", format!("{:.4}", at.precision)));
        rows.push(("recall", format!("{:.4}", at.recall)));
        rows.push(("F-score", format!("{:.4}", at.f_score)));
    }
    let funnel = |side: &mvs_eval::score::SideCounts| {
        let cropped = match document.inputs.crop {
            Some(_) => format!(", {} in the crop", side.cropped),
            None => String::new(),
        };
        format!("{} read{cropped}, {} judged", side.input, side.evaluated)
    };
    rows.push(("reconstruction", funnel(reconstruction)));
    rows.push(("truth", funnel(truth)));
    if let Some(other) = &document.other_profile {
        rows.push((
            "by the other profile",
            format!("{:.4} ({})", other.f_score, other.profile),
        ));
    }
    if let Some(interval) = &document.confidence {
        let (lower, upper) = (interval.lower, interval.upper);
        rows.push(("95 % interval of F", format!("{lower:.4} … {upper:.4}")));
    }
    if let Some(spread) = &document.spread {
        let seeds = spread.f_scores.len();
        rows.push((
            "over seeds",
            format!("{:.4} … {:.4} ({seeds})", spread.min, spread.max),
        ));
    }
    let failed: Vec<&str> = document
        .gates
        .iter()
        .filter(|gate| !gate.passed)
        .map(|gate| gate.code.as_str())
        .collect();
    if !document.gates.is_empty() {
        let passed = document.gates.len() - failed.len();
        rows.push((
            "gates",
            format!(
                "{passed} of {} passed {}",
                document.gates.len(),
                failed.join(", ")
            ),
        ));
    }
    pairs(&rows)
}
