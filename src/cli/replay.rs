use super::common::{Global, Verdict};
use super::{
    augment, blend, demo, depth, extremes, fuse, generate, output, pairs, render, report, score,
    tradeoff, verify,
};
use clap::Args;
use mvs_eval::config;
use mvs_eval::provenance::Run;
use std::path::PathBuf;
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
    let run = Run::read(&args.run)?;
    for path in run.changed_inputs(&args.run) {
        output::say(&format!(
            "warning [input-changed]: {path} is not what it was in the first run"
        ));
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
    match run.command.as_str() {
        "demo" => demo::execute(&config::resolve(layers)?, global),
        "augment" => augment::execute(&config::resolve(layers)?, global),
        "pairs" => pairs::execute(&config::resolve(layers)?, global),
        "depth" => depth::execute(&config::resolve(layers)?, global),
        "extremes" => extremes::execute(&config::resolve(layers)?, global),
        "blend" => blend::execute(&config::resolve(layers)?, global),
        "generate" => generate::execute(&config::resolve(layers)?, global),
        "tradeoff" => tradeoff::execute(&config::resolve(layers)?, global),
        "verify" => verify::execute(&config::resolve(layers)?, global),
        "report" => report::execute(&config::resolve(layers)?, global),
        "render" => render::execute(&config::resolve(layers)?, global),
        "score" => score::execute(&config::resolve(layers)?, global),
        "sweep" => fuse::execute_sweep(&config::resolve(layers)?, global),
        "fuse" => fuse::execute(&config::resolve(layers)?, global),
        other => anyhow::bail!("{}: unknown command `{other}`", args.run.display()),
    }
}
