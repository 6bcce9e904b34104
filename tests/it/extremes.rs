//! Every stage at the extremes: the promised bounds hold, and the table can tell good arithmetic from
//! bad.

use crate::support::{mvs_eval, stderr, text};
use mvs_eval::jobs::Context;
use mvs_eval::jobs::extremes::{ExtremesJob, ExtremesRow, measure};
use mvs_eval::progress::Silent;
use mvs_eval::warning::Warnings;

#[test]
fn every_bound_holds_and_plain_f32_is_seen_to_fail() {
    let warnings = Warnings::default();
    let context = Context {
        progress: &Silent,
        warnings: &warnings,
        force: false,
    };
    let job = ExtremesJob {
        points: 40_000,
        width: 256,
        ..ExtremesJob::default()
    };
    let rows = measure(&job, &context).unwrap();
    let broken: Vec<&ExtremesRow> = rows.iter().filter(|row| !row.holds()).collect();
    assert!(broken.is_empty(), "{broken:#?}");
    assert!(rows.iter().filter(|row| row.bound.is_some()).count() > 40);
    let far_away = |stage: &str, arithmetic: &str| {
        let row = rows.iter().find(|row| {
            row.stage == stage
                && row.axis == "offset"
                && row.value >= 1e7
                && row.arithmetic == arithmetic
        });
        row.unwrap_or_else(|| panic!("{stage} {arithmetic}")).error
    };
    assert!(far_away("render", "f32") > 1e-2 && far_away("render", "f32 recentred") < 1e-5);
    assert!(far_away("fuse", "f32") > 1e-2 && far_away("fuse", "f32 recentred") < 1e-5);
    assert!(far_away("score", "f32") > 1e-2 && far_away("score", "f32 recentred") < 1e-3);
}

#[test]
fn clouds_without_a_point_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    for points in ["0", "99"] {
        let refused = mvs_eval(&["extremes", "--points", points, "--out", text(&out)]);
        assert_eq!(refused.status.code(), Some(2), "{}", stderr(&refused));
        let said = "--points: expected at least 100";
        assert!(stderr(&refused).contains(said), "{}", stderr(&refused));
    }
    assert!(!out.exists());
}
