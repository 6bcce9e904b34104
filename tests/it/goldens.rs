//! Fixture scenes from the mesh to the score, every stage held to numbers that are checked in under
//! tests/golden; what moved is named by its stage.

mod pipeline;

use mvs_datasets::layout::files::write_atomically;
use mvs_datasets::synthetic::SyntheticOptions;
use mvs_eval::fuse::FuseMode;
use pipeline::{Fault, Number, STAGES};
use std::collections::BTreeMap;
use std::path::PathBuf;

/// Set to write the numbers instead of comparing them.
const UPDATE: &str = "MVS_EVAL_UPDATE_GOLDENS";
/// Numbers that differ by less than this fraction, or by less than this where they are below 1, are
/// the same: counts here are below a million, so none may change.
const SAME: f64 = 1e-6;

fn file() -> PathBuf {
    PathBuf::from(concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/tests/golden/fixtures.csv"
    ))
}

fn checked_in(scene: &str) -> Vec<Number> {
    // While the numbers are written there is nothing to compare with.
    if std::env::var_os(UPDATE).is_some() {
        return Vec::new();
    }
    let mut reader = csv::Reader::from_path(file()).unwrap();
    let rows = reader.deserialize::<Number>().map(Result::unwrap);
    rows.filter(|row| row.scene == scene).collect()
}

/// The fixtures at a quarter of their pixels.
fn fixtures() -> impl Iterator<Item = (&'static str, SyntheticOptions)> {
    SyntheticOptions::fixtures()
        .into_iter()
        .map(|(name, options)| {
            let (width, height) = (options.width / 2, options.height / 2);
            (
                name,
                SyntheticOptions {
                    width,
                    height,
                    ..options
                },
            )
        })
}

fn options_of(scene: &str) -> SyntheticOptions {
    let mut all = fixtures();
    all.find(|(name, _)| *name == scene).unwrap().1
}

/// The first stage of the pipeline with numbers that are not the expected ones, and these in words.
/// Later stages then follow from it: they are not named.
fn moved(expected: &[Number], found: &[Number]) -> Option<(String, Vec<String>)> {
    let by_key = |numbers: &[Number]| -> BTreeMap<(String, String, String), f64> {
        let entry = |number: &Number| {
            let Number {
                stage,
                variant,
                quantity,
                value,
                ..
            } = number.clone();
            ((stage, variant, quantity), value)
        };
        numbers.iter().map(entry).collect()
    };
    let (expected, found) = (by_key(expected), by_key(found));
    let keys: std::collections::BTreeSet<_> = expected.keys().chain(found.keys()).collect();
    let difference = |key: &(String, String, String)| {
        let (before, now) = (expected.get(key), found.get(key));
        let same = match (before, now) {
            (Some(before), Some(now)) => (before - now).abs() <= SAME * before.abs().max(1.0),
            _ => false,
        };
        let said = |value: Option<&f64>| value.map_or("nothing".to_owned(), f64::to_string);
        (!same).then(|| format!("{} {}: {} → {}", key.1, key.2, said(before), said(now)))
    };
    STAGES.iter().find_map(|stage| {
        let of_stage = keys.iter().filter(|key| key.0 == *stage);
        let differences: Vec<String> = of_stage.filter_map(|key| difference(key)).collect();
        (!differences.is_empty()).then(|| ((*stage).to_owned(), differences))
    })
}

#[test]
fn every_stage_of_every_fixture_scene_gives_the_numbers_checked_in() {
    let mut numbers = Vec::new();
    let mut said = Vec::new();
    for (scene, options) in fixtures() {
        let found = pipeline::run(scene, options, None);
        if let Some((stage, differences)) = moved(&checked_in(scene), &found) {
            let some = differences
                .iter()
                .take(6)
                .cloned()
                .collect::<Vec<_>>()
                .join("\n    ");
            let count = differences.len();
            said.push(format!(
                "{scene}: stage `{stage}` moved, {count} numbers:\n    {some}"
            ));
        }
        numbers.extend(found);
    }
    if std::env::var_os(UPDATE).is_some() {
        write_atomically(&file(), |out| {
            let mut writer = csv::Writer::from_writer(out);
            for number in &numbers {
                writer.serialize(number).map_err(std::io::Error::other)?;
            }
            writer.flush()
        })
        .unwrap();
        return;
    }
    assert!(
        said.is_empty(),
        "{}\nif that is meant: {UPDATE}=1 cargo test --test it goldens, and say why under \
         \"Numbers\" in CHANGELOG.md",
        said.join("\n")
    );
}

#[test]
fn a_stage_broken_on_purpose_is_the_one_named() {
    if std::env::var_os(UPDATE).is_some() {
        return;
    }
    let scene = "object";
    let expected = checked_in(scene);
    for (fault, stage) in [
        (Fault::HalfPixel, "render"),
        (Fault::MoreNoise, "estimate"),
        (Fault::LooseGate, "fuse"),
        (Fault::ShiftedStart, "align"),
        (Fault::WideVoxel, "score"),
    ] {
        let found = pipeline::run(scene, options_of(scene), Some(fault));
        let (named, differences) = moved(&expected, &found).unwrap();
        assert_eq!(named, stage, "{fault:?}: {differences:?}");
    }
}

#[test]
fn the_goldens_hold_every_scene_mode_and_profile_and_make_sense() {
    if std::env::var_os(UPDATE).is_some() {
        return;
    }
    for (scene, _) in fixtures() {
        let rows = checked_in(scene);
        let value = |variant: &str, quantity: &str| {
            let found = rows
                .iter()
                .find(|row| row.variant == variant && row.quantity == quantity);
            found
                .unwrap_or_else(|| panic!("{scene} {variant} {quantity}"))
                .value
        };
        for mode in FuseMode::ALL {
            let mode = format!("{mode:?}").to_lowercase();
            for profile in ["plain", "official", "strict"] {
                let variant = format!("{mode} {profile}");
                let (p, r) = (value(&variant, "precision"), value(&variant, "recall"));
                assert!(
                    (0.0..=1.0).contains(&p) && (0.0..=1.0).contains(&r),
                    "{scene} {variant}"
                );
                assert!(p > 0.0, "{scene} {variant}: nothing is right");
            }
        }
    }
}

#[test]
fn the_first_stage_that_moved_is_named_and_missing_numbers_count() {
    let number = |stage: &str, quantity: &str, value: f64| Number {
        scene: "s".into(),
        stage: stage.into(),
        variant: "v".into(),
        quantity: quantity.into(),
        value,
    };
    let expected = [
        number("render", "a", 1e6),
        number("fuse", "b", 2.0),
        number("score", "c", 0.5),
    ];
    assert_eq!(moved(&expected, &expected), None);
    let slightly = [
        number("render", "a", 1e6 + 0.5),
        expected[1].clone(),
        expected[2].clone(),
    ];
    assert_eq!(moved(&expected, &slightly), None);
    let later = [
        expected[0].clone(),
        number("fuse", "b", 2.1),
        number("score", "c", 0.6),
    ];
    let (stage, differences) = moved(&expected, &later).unwrap();
    assert_eq!((stage.as_str(), differences.len()), ("fuse", 1));
    assert_eq!(differences[0], "v b: 2 → 2.1");
    let missing = moved(&expected, &expected[..2]).unwrap();
    assert_eq!(
        (missing.0.as_str(), missing.1[0].as_str()),
        ("score", "v c: 0.5 → nothing")
    );
}
