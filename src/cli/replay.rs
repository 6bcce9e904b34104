use super::common::{Global, Verdict};
use super::{
    augment, blend, demo, depth, extremes, fuse, generate, output, pairs, render, report, score,
    sweep, tradeoff, verify,
};
use clap::Args;
use mvs_eval::Error;
use mvs_eval::config;
use mvs_eval::jobs::run_file_beside;
use mvs_eval::provenance::{REVISION, Run, VERSION};
use serde::de::DeserializeOwned;
use std::path::{Path, PathBuf};
use toml::{Table, Value};

/// Make a result again from its run.toml
///
/// Run it in the folder where the first run was started if the paths in run.toml are relative.
/// Inputs that have changed since are named; what the run itself wrote into them is no change.
#[derive(Debug, Args)]
pub(crate) struct ReplayArgs {
    /// The run.toml beside a result
    run: PathBuf,
    /// Where to write instead of the first place
    #[arg(long, value_name = "PATH")]
    out: Option<PathBuf>,
    /// Where to write the filtered depth maps of a run of `fuse` instead of the first place
    #[arg(long, value_name = "DIR")]
    filtered_depths: Option<PathBuf>,
}

impl ReplayArgs {
    /// The command that is to run again, if the file can be read.
    pub(super) fn command(&self) -> Option<String> {
        Run::read(&self.run).ok().map(|run| run.command)
    }
}

pub(crate) fn run(args: &ReplayArgs, global: &Global) -> anyhow::Result<Verdict> {
    anyhow::ensure!(
        global.config.is_none(),
        "--config: expected none, as replay takes the options of the run.toml, found one"
    );
    let run = Run::read(&args.run)?;
    say_other_version(args, &run);
    for path in run.changed_inputs(&args.run) {
        let how = match Path::new(&path).exists() {
            true => "not what it was in the first run",
            false => "not there, as seen from this folder",
        };
        output::say(&format!("warning [input-changed]: {path} is {how}"));
    }
    let asked = run.options.contains_key("filtered_depths");
    if asked && args.out.is_some() != args.filtered_depths.is_some() {
        anyhow::bail!(
            "{}: expected --out and --filtered-depths, as the run wrote to both, found one of them",
            args.run.display()
        );
    }
    let mut over = Table::new();
    for (option, path) in [
        ("out", &args.out),
        ("filtered_depths", &args.filtered_depths),
    ] {
        if let Some(path) = path {
            over.insert(option.into(), Value::String(path.display().to_string()));
        }
    }
    let layers = [run.options.clone(), over];
    let verdict = again(&run, layers.clone(), &args.run, global)?;
    say_of_new_inputs(&run, &layers);
    Ok(verdict)
}

/// Runs the command with its options.
fn again(
    run: &Run,
    layers: [Table; 2],
    run_file: &Path,
    global: &Global,
) -> anyhow::Result<Verdict> {
    match run.command.as_str() {
        "demo" => demo::execute(&options(layers, run_file)?, global),
        "augment" => augment::execute(&options(layers, run_file)?, global),
        "pairs" => pairs::execute(&options(layers, run_file)?, global),
        "depth" => depth::execute(&options(layers, run_file)?, global),
        "extremes" => extremes::execute(&options(layers, run_file)?, global),
        "blend" => blend::execute(&options(layers, run_file)?, global),
        "generate" => generate::execute(&options(layers, run_file)?, global),
        "tradeoff" => tradeoff::execute(&options(layers, run_file)?, global),
        "verify" => verify::execute(&options(layers, run_file)?, global),
        "report" => report::execute(&options(layers, run_file)?, global),
        "render" => render::execute(&options(layers, run_file)?, global),
        "score" => score::execute(&options(layers, run_file)?, global),
        "sweep" => sweep::execute(&options(layers, run_file)?, global),
        "fuse" => fuse::execute(&options(layers, run_file)?, global),
        other => anyhow::bail!("{}: unknown command `{other}`", run_file.display()),
    }
}

/// Says what was read that the first run did not read: files that lie in its folders since.
fn say_of_new_inputs(run: &Run, layers: &[Table; 2]) {
    let out = layers.iter().rev().find_map(|layer| layer.get("out"));
    let out = Path::new(out.and_then(Value::as_str).unwrap_or_default());
    let run_file = match out.is_dir() {
        true => out.join("run.toml"),
        false => run_file_beside(out),
    };
    let Ok(made) = Run::read(&run_file) else {
        return;
    };
    for path in made.inputs.keys() {
        if !run.inputs.contains_key(path) {
            output::say(&format!(
                "warning [input-changed]: {path} was not there, or was not read, in the first run"
            ));
        }
    }
}

/// Says so where another version made the run, or another revision as far as both are known.
fn say_other_version(args: &ReplayArgs, run: &Run) {
    let is_known = [run.revision.as_str(), REVISION]
        .iter()
        .all(|it| *it != "unknown");
    let (made, this) = if run.version != VERSION {
        (format!("mvs-eval {}", run.version), VERSION)
    } else if is_known && run.revision != REVISION {
        (format!("revision {}", run.revision), REVISION)
    } else {
        return;
    };
    output::say(&format!(
        "warning [other-version]: {}: made by {made}, this is {this}: the result may differ",
        args.run.display()
    ));
}

/// The options of a run, whose `run.toml` is named where they are none.
fn options<T: DeserializeOwned>(layers: [Table; 2], run_file: &Path) -> mvs_eval::Result<T> {
    config::resolve(layers).map_err(|error| match error {
        Error::Invalid { what, problem } if what == "options" => {
            Error::invalid(run_file.display().to_string(), problem)
        }
        other => other,
    })
}
