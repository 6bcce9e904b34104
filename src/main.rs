//! The `mvs-eval` command.
#![cfg_attr(test, allow(clippy::too_many_lines, reason = "a test tells one story"))]

mod cli;

use std::process::ExitCode;

fn main() -> ExitCode {
    cli::main()
}
