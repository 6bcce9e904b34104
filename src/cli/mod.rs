//! The command line: one file per command, each with arguments, one library call and one output.
//!
//! stdout is the answer, stderr the conversation. Exit codes: 0 done; 1 done, and a check or gate
//! failed; 2 could not do it.

mod augment;
mod bars;
mod blend;
mod common;
mod compare;
mod demo;
mod depth;
mod extremes;
mod fuse;
mod generate;
mod inspect;
mod memory;
mod output;
mod pairs;
mod render;
mod replay;
mod report;
mod score;
mod sweep;
mod tradeoff;
mod verify;

use clap::{Arg, CommandFactory, FromArgMatches, Parser, Subcommand};
use common::{Global, Verdict};
use std::ffi::OsString;
use std::process::ExitCode;

const ABOUT: &str = "Benchmark and evaluation suite for multi-view-stereo point clouds";
const LONG_ABOUT: &str = "\
Benchmark and evaluation suite for multi-view-stereo (MVS) point clouds.

  mesh + cameras + photographs --generate--> BlendedMVS data set
  depth maps ---------------------fuse-----> point cloud
  point cloud + truth -------------score---> precision, recall, F-score
  scores -------------------------report---> leaderboards

Try `mvs-eval demo`: it does all of it on a scene that the program makes itself.

Every result folder holds a run.toml with all options and the hashes of the inputs; \
`mvs-eval replay run.toml --out NEW` makes the result again. Inputs are read where they lie and must not \
change while a command runs: the system ends a program whose file gets shorter. The answer goes to stdout (a \
table on a terminal, JSON otherwise), progress and warnings to stderr.

Exit codes: 0 done; 1 done, and a check or gate failed; 2 could not do it.";

#[derive(Parser)]
#[command(name = "mvs-eval", version, about = ABOUT, long_about = LONG_ABOUT)]
#[command(propagate_version = true, arg_required_else_help = true)]
struct Cli {
    #[command(flatten)]
    global: Global,
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    Demo(demo::DemoArgs),
    Generate(generate::GenerateArgs),
    Fuse(fuse::FuseArgs),
    Score(score::ScoreArgs),
    Report(report::ReportArgs),
    Compare(compare::CompareArgs),
    Depth(depth::DepthArgs),
    Tradeoff(tradeoff::TradeoffArgs),
    Verify(verify::VerifyArgs),
    Render(render::RenderArgs),
    Augment(augment::AugmentArgs),
    Pairs(pairs::PairsArgs),
    Blend(blend::BlendArgs),
    Inspect(inspect::InspectArgs),
    Extremes(extremes::ExtremesArgs),
    Replay(replay::ReplayArgs),
}

impl Command {
    /// Says how the command wants its memory: before there is a second thread, which would have a pool of
    /// buffers of its own by then.
    fn settle_memory(&self) {
        let replayed = match self {
            Self::Replay(args) => args.command(),
            _ => None,
        };
        match (self, replayed.as_deref()) {
            (Self::Score(_), _) | (_, Some("score")) => memory::reuse_large_buffers(),
            (Self::Generate(_), _) | (_, Some("generate")) => memory::keep_buffers(),
            (Self::Fuse(_), _) | (_, Some("fuse" | "sweep")) => {
                memory::keep_buffers_in_large_pages();
            }
            _ => {}
        }
    }
}

/// Runs the command line of this process.
pub(crate) fn main() -> ExitCode {
    let arguments: Vec<OsString> = std::env::args_os().collect();
    if let Some(odd) = arguments
        .iter()
        .find(|argument| argument.to_str().is_none())
    {
        output::say(&format!(
            "error: {}: expected arguments in UTF-8, which records can hold, found other bytes: rename the file",
            odd.to_string_lossy()
        ));
        return ExitCode::from(2);
    }
    let cli = match parse(arguments) {
        Ok(cli) => cli,
        Err(error) => {
            let printed = error.print();
            if error.use_stderr() {
                return ExitCode::from(2);
            }
            return ended(output::on_stdout(printed).map(|()| Verdict::Passed));
        }
    };
    cli.command.settle_memory();
    let outcome = common::install_interrupt()
        .and_then(|()| common::in_pool(cli.global.threads, || run(&cli.command, &cli.global)));
    ended(outcome)
}

/// The exit code; an error is said.
fn ended(outcome: anyhow::Result<Verdict>) -> ExitCode {
    match outcome {
        Ok(Verdict::Passed) => ExitCode::SUCCESS,
        Ok(Verdict::Failed) => ExitCode::from(1),
        Err(error) => {
            output::say(&format!("error: {}", sentence(&error)));
            ExitCode::from(2)
        }
    }
}

/// The arguments as a command. A value may start with a minus: the job says what is wrong with it,
/// which is more than that an argument `-1` is unknown.
fn parse(arguments: impl IntoIterator<Item = OsString>) -> Result<Cli, clap::Error> {
    let negative = |argument: Arg| match argument.get_action().takes_values() {
        true => argument.allow_negative_numbers(true),
        false => argument,
    };
    let command = Cli::command()
        .mut_args(negative)
        .mut_subcommands(|command| command.mut_args(negative));
    Cli::from_arg_matches(&command.try_get_matches_from(arguments)?)
}

fn run(command: &Command, global: &Global) -> anyhow::Result<Verdict> {
    match command {
        Command::Demo(args) => demo::run(args, global),
        Command::Pairs(args) => pairs::run(args, global),
        Command::Augment(args) => augment::run(args, global),
        Command::Blend(args) => blend::run(args, global),
        Command::Generate(args) => generate::run(args, global),
        Command::Report(args) => report::run(args, global),
        Command::Compare(args) => compare::run(args, global),
        Command::Depth(args) => depth::run(args, global),
        Command::Tradeoff(args) => tradeoff::run(args, global),
        Command::Verify(args) => verify::run(args, global),
        Command::Render(args) => render::run(args, global),
        Command::Fuse(args) => fuse::run(args, global),
        Command::Inspect(args) => inspect::run(args, global),
        Command::Extremes(args) => extremes::run(args, global),
        Command::Score(args) => score::run(args, global),
        Command::Replay(args) => replay::run(args, global),
    }
}

/// The error as one sentence: causes that the message already says are not said again.
fn sentence(error: &anyhow::Error) -> String {
    error
        .chain()
        .map(ToString::to_string)
        .fold(String::new(), |said, cause| {
            match (said.is_empty(), said.contains(&cause)) {
                (true, _) => cause,
                (false, true) => said,
                (false, false) => format!("{said}: {cause}"),
            }
        })
}
