//! Who may use whom: the import table of ARCHITECTURE.md, held by reading the sources.

use std::fs;
use std::path::{Path, PathBuf};

/// No file under `scope` mentions any of `forbidden`, but for the files in `except`.
struct Rule {
    scope: &'static str,
    forbidden: &'static [&'static str],
    except: &'static [&'static str],
}

/// What a stage that turns values into values must not know.
const NOT_FOR_STAGES: &[&str] = &[
    "mvs_metrics",
    "mvs_datasets::format",
    "mvs_datasets::layout",
    "mvs_datasets::synthetic",
    "crate::score",
    "crate::report",
    "crate::jobs",
    "crate::generate",
    "crate::config",
    "std::fs",
];

const RULES: &[Rule] = &[
    rule(
        "metrics/src",
        &[
            "mvs_datasets",
            "mvs_eval",
            "std::fs",
            "std::path",
            "image::",
        ],
    ),
    rule("datasets/src", &["mvs_metrics", "mvs_eval"]),
    rule(
        "datasets/src/scene",
        &["crate::format", "crate::layout", "crate::synthetic"],
    ),
    rule(
        "datasets/src/format",
        &["crate::layout", "crate::synthetic", "std::fs", "std::path"],
    ),
    rule("datasets/src/layout", &["crate::synthetic"]),
    rule("src/render", NOT_FOR_STAGES),
    rule("src/render", &["crate::blend", "crate::fuse"]),
    rule("src/blend", NOT_FOR_STAGES),
    rule("src/blend", &["crate::render", "crate::fuse"]),
    rule("src/fuse", NOT_FOR_STAGES),
    rule("src/fuse", &["crate::render", "crate::blend"]),
    rule(
        "src/generate",
        &[
            "mvs_metrics",
            "crate::score",
            "crate::report",
            "crate::fuse",
        ],
    ),
    rule(
        "src/score",
        &[
            "crate::render",
            "crate::blend",
            "crate::fuse",
            "crate::generate",
        ],
    ),
    rule(
        "src/report",
        &[
            "crate::render",
            "crate::blend",
            "crate::fuse",
            "crate::generate",
        ],
    ),
    Rule {
        scope: "src",
        forbidden: &["crate::cli", "mod cli"],
        except: &["src/cli", "src/main.rs"],
    },
    // One home for each named crate.
    Rule {
        scope: "src",
        forbidden: &["rayon::"],
        except: &["src/parallel.rs"],
    },
    Rule {
        scope: "src",
        forbidden: &["rustfft::", "realfft::"],
        except: &["src/blend/spectrum.rs"],
    },
    rule("src", &["nalgebra::", "kiddo::", "ply_rs"]),
    Rule {
        scope: "metrics/src",
        forbidden: &["nalgebra::"],
        except: &["metrics/src/align"],
    },
    Rule {
        scope: "metrics/src",
        forbidden: &["kiddo::"],
        except: &["metrics/src/distance"],
    },
    Rule {
        scope: "datasets/src",
        forbidden: &["ply_rs"],
        except: &["datasets/src/format/ply"],
    },
    // Unsafe code stays where it was reviewed.
    Rule {
        scope: "",
        forbidden: &["unsafe_code"],
        except: REVIEWED_UNSAFE,
    },
];

/// The reviewed places with unsafe code, and this file, which names what it forbids.
const REVIEWED_UNSAFE: &[&str] = &[
    "datasets/src/mapped.rs",
    "metrics/src/distance/wide.rs",
    "src/cli/memory.rs",
    "src/ahead.rs",
    "tests/it/architecture.rs",
];

const fn rule(scope: &'static str, forbidden: &'static [&'static str]) -> Rule {
    Rule {
        scope,
        forbidden,
        except: &[],
    }
}

/// The parts of `source` that count: no comments, nothing after the first line of unit tests.
fn code_of(source: &str) -> String {
    let is_tests = |&(_, marked): &(usize, &str)| {
        let next = marked.lines().nth(1);
        next.is_some_and(|line| line.contains("mod tests {"))
    };
    let marks = source.match_indices("#[cfg(test)]\n");
    let mut marked = marks.map(|(place, _)| (place, &source[place..]));
    let tests = marked
        .find(is_tests)
        .map_or(source.len(), |(place, _)| place);
    let lines = source[..tests].lines();
    lines
        .map(|line| line.split("//").next().unwrap_or_default())
        .collect::<Vec<_>>()
        .join("\n")
}

/// What in `path` with content `source` breaks which rule.
fn violations(path: &str, source: &str) -> Vec<String> {
    let covers = |scope: &str| {
        scope.is_empty()
            || path == scope
            || path.strip_prefix(scope).is_some_and(|rest| {
                rest.starts_with('/') || rest.starts_with(".rs") || scope.ends_with('/')
            })
    };
    let code = code_of(source);
    let applies = |rule: &&Rule| covers(rule.scope) && !rule.except.iter().any(|e| covers(e));
    let broken = RULES.iter().filter(applies).flat_map(|rule| {
        let used = rule.forbidden.iter().filter(|&&name| code.contains(name));
        used.map(|name| {
            format!(
                "{path} uses {name}, which {} must not",
                scope_name(rule.scope)
            )
        })
    });
    broken.collect()
}

fn scope_name(scope: &str) -> &str {
    if scope.is_empty() {
        "the project"
    } else {
        scope
    }
}

fn rust_files(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        if path.is_dir() && name != "target" && !name.starts_with('.') {
            rust_files(&path, found);
        } else if name.ends_with(".rs") {
            found.push(path);
        }
    }
}

/// Functions that each system's library rounds in its own way.
const SYSTEM_MATHS: &[&str] = &[
    ".sin()",
    ".cos()",
    ".tan()",
    ".sin_cos()",
    ".asin()",
    ".acos()",
    ".atan()",
    ".atan2(",
    ".sinh()",
    ".cosh()",
    ".tanh()",
    ".exp()",
    ".exp2()",
    ".exp_m1()",
    ".ln()",
    ".ln_1p()",
    ".log(",
    ".log2()",
    ".log10()",
    ".powf(",
    ".cbrt()",
    ".hypot(",
];

/// What in a source that is no test's rounds otherwise on other systems.
fn system_maths(path: &str, source: &str) -> Vec<String> {
    let in_tests = ["/tests.rs", "/testing.rs"]
        .iter()
        .any(|end| path.ends_with(end));
    if in_tests || path.contains("tests/") || !path.contains("src/") {
        return Vec::new();
    }
    let code = code_of(source);
    let used = SYSTEM_MATHS.iter().filter(|&&name| code.contains(name));
    used.map(|name| format!("{path} uses {name}: take it from libm, the same on every system"))
        .collect()
}

/// What a check finds in all sources of the project.
fn found_by(check: fn(&str, &str) -> Vec<String>) -> Vec<String> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut files = Vec::new();
    rust_files(root, &mut files);
    assert!(files.len() > 40, "found only {} source files", files.len());
    let found = files.iter().flat_map(|file| {
        let path = file.strip_prefix(root).unwrap().to_string_lossy();
        let source = fs::read_to_string(file).unwrap();
        check(&path.replace('\\', "/"), &source)
    });
    found.collect()
}

#[test]
fn the_import_table_holds() {
    let broken = found_by(violations);
    assert!(broken.is_empty(), "{}", broken.join("\n"));
}

#[test]
fn results_take_no_maths_of_the_system() {
    let broken = found_by(system_maths);
    assert!(broken.is_empty(), "{}", broken.join("\n"));
    for (path, source, found) in [
        ("src/blend/light.rs", "let y = x.powf(2.4);", 1),
        (
            "datasets/src/scene/distortion.rs",
            "(a.atan(), b.hypot(c))",
            2,
        ),
        (
            "src/blend/light.rs",
            "let y = libm::powf(x, 2.4); // x.powf(2.4)",
            0,
        ),
        ("src/blend/tests.rs", "let y = x.powf(2.4);", 0),
        ("tests/it/extremes.rs", "x.sin()", 0),
        (
            "src/fuse/geo.rs",
            "#[cfg(test)]\nmod tests { let x = 1.0.sin(); }",
            0,
        ),
    ] {
        assert_eq!(system_maths(path, source).len(), found, "{path}: {source}");
    }
}

#[test]
fn a_forbidden_import_is_found() {
    for (path, source) in [
        (
            "metrics/src/score.rs",
            "use mvs_datasets::scene::PointCloud;",
        ),
        ("datasets/src/layout/tnt.rs", "use mvs_metrics::Tolerance;"),
        ("datasets/src/scene/mesh.rs", "use crate::format::ply;"),
        ("datasets/src/format/ply/mod.rs", "use std::path::Path;"),
        ("src/fuse/geo.rs", "use mvs_datasets::layout::files;"),
        ("src/blend/mod.rs", "use crate::render::Renderer;"),
        ("src/score/tnt.rs", "use crate::fuse::fuse;"),
        ("src/generate/mod.rs", "fn f() { crate::score::run() }"),
        ("src/render/mod.rs", "use rayon::prelude::*;"),
        ("src/blend/filter.rs", "use rustfft::FftPlanner;"),
        ("metrics/src/curve.rs", "use nalgebra::Matrix3;"),
        ("src/jobs/demo.rs", "use crate::cli::common;"),
        ("src/parallel.rs", "#![allow(unsafe_code)]"),
        (
            "src/parallel.rs",
            "#![allow(\n    unsafe_code,\n    reason = \"fast\"\n)]",
        ),
    ] {
        assert_eq!(violations(path, source).len(), 1, "{path}: {source}");
    }
}

#[test]
fn what_is_allowed_is_not_blamed() {
    for (path, source) in [
        ("metrics/src/align/icp.rs", "use nalgebra::Matrix3;"),
        ("metrics/src/distance.rs", "use kiddo::ImmutableKdTree;"),
        (
            "metrics/src/distance/oracle.rs",
            "use kiddo::ImmutableKdTree;",
        ),
        ("src/blend/spectrum.rs", "use realfft::RealFftPlanner;"),
        ("src/cli/demo.rs", "use crate::cli::common;"),
        (
            "src/fuse/geo.rs",
            "// unlike crate::render\nuse mvs_datasets::scene::View;",
        ),
        (
            "src/fuse/geo.rs",
            "#[cfg(test)]\nmod tests { use mvs_datasets::synthetic; }",
        ),
        ("datasets/src/mapped.rs", "#![allow(unsafe_code)]"),
        ("src/rendering.rs", "use crate::blend::blend;"),
    ] {
        assert_eq!(
            violations(path, source),
            Vec::<String>::new(),
            "{path}: {source}"
        );
    }
}
