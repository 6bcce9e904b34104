//! The `mvs-eval` command.

fn main() {}
