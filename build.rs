//! Records the revision the binary is built from, where the sources lie in a git checkout; `-dirty` follows it where
//! what git tracks differs from that revision.

use std::process::Command;

/// What a binary is made of.
const SOURCES: [&str; 6] = [
    "Cargo.lock",
    "Cargo.toml",
    "build.rs",
    "datasets",
    "metrics",
    "src",
];

fn main() {
    println!("cargo:rerun-if-changed=.git/HEAD");
    println!("cargo:rerun-if-changed=.git/logs/HEAD");
    for path in SOURCES {
        println!("cargo:rerun-if-changed={path}");
    }
    let revision = git(&["rev-parse", "--short=12", "HEAD"]).unwrap_or_else(|| "unknown".into());
    let changes = ["status", "--porcelain", "--untracked-files=no", "--"];
    let dirty = match git(&[&changes[..], &SOURCES[..]].concat()) {
        Some(_) => "-dirty",
        None => "",
    };
    println!("cargo:rustc-env=MVS_EVAL_REVISION={revision}{dirty}");
}

fn git(arguments: &[&str]) -> Option<String> {
    let output = Command::new("git").args(arguments).output().ok()?;
    let text = String::from_utf8(output.stdout).ok()?;
    (output.status.success() && !text.trim().is_empty()).then(|| text.trim().to_owned())
}
