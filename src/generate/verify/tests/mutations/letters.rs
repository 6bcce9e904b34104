//! What is wrong in texts and among files.

use super::*;

/// What cams say, by letter.
pub(super) const CAMS: [Mutation; 6] = [
    (
        "trailing space",
        |s| edit_line(s, CAM_1, 11, |l| format!("{l} ")),
        "depth-line",
    ),
    (
        "three numbers",
        |s| edit_line(s, CAM_1, 11, cut_last),
        "depth-line",
    ),
    (
        "interval",
        |s| edit_line(s, CAM_1, 11, |l| l.replace(" 128.0 ", " 64.0 ")),
        "depth-interval",
    ),
    (
        "hypotheses",
        |s| edit_line(s, CAM_1, 11, |_| "2 0.05 20 3".into()),
        "depth-interval-dialect",
    ),
    (
        "negative depth",
        |s| edit_line(s, CAM_1, 11, |_| "-1 0.01 128 0.28".into()),
        "depth-range",
    ),
    (
        "keyword",
        |s| edit_line(s, CAM_1, 0, |_| "extrinsics".into()),
        "cam-keywords",
    ),
];

/// What `pair.txt` says, by letter.
pub(super) const PAIRS: [Mutation; 16] = [
    (
        "blank line",
        |s| s.edit(PAIR, |t| format!("{t}\n")),
        "pair-blanks",
    ),
    (
        "double space",
        |s| edit_line(s, PAIR, 2, |l| l.replacen(' ', "  ", 1)),
        "pair-blanks",
    ),
    (
        "count",
        |s| edit_line(s, PAIR, 0, |_| "13".into()),
        "pair-count",
    ),
    ("source count", |s| sources(s, "0"), "source-count"),
    (
        "eleven sources",
        |s| {
            sources(
                s,
                "11 1 19 2 18 3 17 4 16 5 15 6 14 7 13 8 12 9 11 10 10 11 9",
            );
        },
        "source-count",
    ),
    ("itself", |s| sources(s, "2 0 5 1 4"), "source-is-itself"),
    (
        "a source again",
        |s| sources(s, "3 1 5 2 4 1 3"),
        "source-twice",
    ),
    ("zero score", |s| sources(s, "2 1 5 2 0"), "score-zero"),
    ("rising", |s| sources(s, "2 1 5 2 6"), "score-order"),
    (
        "another score back",
        |s| sources(s, "2 1 5000 13 1"),
        "score-asymmetric",
    ),
    ("broken line", |s| sources(s, "3 1 5 2 6"), "pair-line"),
    (
        "a reference again",
        |s| edit_line(s, PAIR, 3, |_| "0".into()),
        "pair-twice",
    ),
    (
        "no reference",
        |s| s.edit(PAIR, drop_last_reference),
        "source-is-no-reference",
    ),
    (
        "no entry",
        |s| s.edit(PAIR, drop_last_reference),
        "view-without-pairs",
    ),
    ("no pairs", |s| remove(s, PAIR), "missing-pairs"),
    ("no camera", |s| remove(s, CAM_2), "pair-without-camera"),
];

/// Files that are missing or too many.
pub(super) const FILES: [Mutation; 9] = [
    (
        "foreign cam",
        |s| write(&s.path("cams/notes.txt"), b""),
        "foreign-file",
    ),
    (
        "foreign depth",
        |s| write(&s.path("rendered_depth_maps/00000000_prob.pfm"), b""),
        "foreign-file",
    ),
    (
        "no image",
        |s| remove(s, "blended_images/00000002.jpg"),
        "missing-image",
    ),
    (
        "no masked image",
        |s| remove(s, "blended_images/00000002_masked.jpg"),
        "missing-masked-image",
    ),
    (
        "no depth",
        |s| remove(s, "rendered_depth_maps/00000002.pfm"),
        "missing-depth",
    ),
    ("depth alone", |s| remove(s, CAM_2), "depth-without-camera"),
    (
        "a colour map for depth",
        |s| write(&s.blended().depth(4), b"PF\n4 3\n1.0\n"),
        "pfm-header",
    ),
    (
        "an interrupted run",
        |s| write(&s.path("run.partial.toml"), b""),
        "unfinished",
    ),
    (
        "no depth maps",
        |s| std::fs::remove_dir_all(s.path("rendered_depth_maps")).unwrap(),
        "missing-folder",
    ),
];
