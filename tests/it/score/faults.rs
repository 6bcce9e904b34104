//! Spoiled inputs: each is named, the result is still written, the exit code is 1.

use super::fixture::{
    Fixture, bumps, given_centres, given_poses, own_from_scan, read, scan_from_own, unregistered,
    video,
};
use super::{failed, run};
use assert_cmd::Command;
use glam::{DMat4, DVec3};
use mvs_datasets::format::ply::{self, PlyOptions};
use mvs_datasets::layout::files::write_atomically;
use mvs_datasets::scene::Mesh;
use mvs_eval::jobs::score::{ScoreDocument, ScoreJob};
use mvs_eval::score::cameras::MatchedBy;
use mvs_eval::score::sample::MeshAs;
use std::process::Output;

const TAU: f64 = 0.05;

fn small() -> Fixture {
    Fixture::new(6000)
}

fn message<'a>(document: &'a ScoreDocument, code: &str) -> &'a str {
    let warning = document
        .warnings
        .iter()
        .find(|warning| warning.code == code);
    &warning.unwrap().message
}

#[test]
fn a_sound_input_passes_every_gate() {
    let fixture = small();
    let document = run(&fixture.job("out", TAU)).unwrap();
    assert_eq!(failed(&document), [""; 0]);
    assert!(
        document.passed && document.warnings.is_empty(),
        "{:?}",
        document.warnings
    );
    assert!(document.f_score > 0.85, "{}", document.f_score);
    let report = document.alignment.trajectory.unwrap();
    assert_eq!(
        (report.inliers, report.registered, report.residuals.len()),
        (40, 40, 40)
    );
}

#[test]
fn a_shifted_log_is_named_with_its_shift() {
    let fixture = small();
    let mut poses = given_poses();
    poses.rotate_left(3);
    fixture.put_log("rec.log", &poses);
    let document = run(&fixture.job("out", TAU)).unwrap();
    assert!(
        failed(&document).contains(&"poses-shifted"),
        "{:?}",
        failed(&document)
    );
    assert!(message(&document, "poses-shifted").contains("shifted by 3"));
    assert!(fixture.path("out/score.json").is_file());
}

#[test]
fn the_log_of_another_scene_is_named() {
    let fixture = small();
    let mut poses = given_poses();
    poses.reverse();
    fixture.put_log("rec.log", &poses);
    let document = run(&fixture.job("out", TAU)).unwrap();
    assert!(
        failed(&document).contains(&"few-inliers"),
        "{:?}",
        failed(&document)
    );
    assert!(message(&document, "few-inliers").contains("another scene's"));
}

#[test]
fn a_wrong_transform_of_the_scene_is_named() {
    let fixture = small();
    let away = DMat4::from_translation(DVec3::new(40.0, 0.0, 0.0));
    fixture.put_transform(
        "Synth/Synth_trans.txt",
        away * super::fixture::truth_from_reference(),
    );
    let document = run(&fixture.job("out", TAU)).unwrap();
    let failed = failed(&document);
    assert!(failed.contains(&"crop-keeps-little"), "{failed:?}");
    assert!(failed.contains(&"low-icp-fitness"), "{failed:?}");
    assert_eq!(document.f_score, 0.0);
}

#[test]
fn a_transform_in_other_units_is_named_with_the_unit() {
    let fixture = small();
    fixture.put_transform(
        "t.txt",
        DMat4::from_scale(DVec3::splat(1000.0)) * scan_from_own(),
    );
    let job = ScoreJob {
        trajectory: None,
        transform: Some(fixture.path("t.txt")),
        ..fixture.job("out", TAU)
    };
    let document = run(&job).unwrap();
    assert_eq!(failed(&document), ["crop-keeps-little"]);
    assert!(message(&document, "crop-keeps-little").contains("millimetres"));
}

#[test]
fn what_only_an_alignment_heeds_is_refused_beside_a_transform() {
    let fixture = small();
    fixture.put_transform("t.txt", scan_from_own());
    let job = ScoreJob {
        trajectory: None,
        transform: Some(fixture.path("t.txt")),
        ..fixture.job("out", TAU)
    };
    type Change = fn(&mut ScoreJob);
    let changes: [(&str, Change); 2] = [
        ("--seeds: belongs to --trajectory or --refine", |job| {
            job.seeds = 3;
        }),
        ("--camera-distance: belongs to --trajectory: ", |job| {
            job.camera_distance = 1.0;
        }),
    ];
    for (expected, change) in changes {
        let mut job = job.clone();
        change(&mut job);
        let said = run(&job).unwrap_err().to_string();
        assert!(said.starts_with(expected), "{said}");
    }
    let refined = ScoreJob {
        refine: true,
        seeds: 2,
        ..job
    };
    assert_eq!(
        run(&refined)
            .unwrap()
            .spread
            .map(|spread| spread.f_scores.len()),
        Some(2)
    );
}

#[test]
fn a_transform_that_is_a_little_off_is_told_from_noise() {
    let fixture = small();
    let off = DMat4::from_translation(DVec3::new(0.0, 0.0, 0.12));
    fixture.put_transform("t.txt", off * scan_from_own());
    let job = ScoreJob {
        trajectory: None,
        transform: Some(fixture.path("t.txt")),
        ..fixture.job("out", TAU)
    };
    let document = run(&job).unwrap();
    assert_eq!(failed(&document), ["low-at-tau"]);
    let refined = run(&ScoreJob {
        refine: true,
        out: fixture.path("refined"),
        ..job
    })
    .unwrap();
    assert!(
        refined.passed && refined.f_score > 0.85,
        "{}",
        refined.f_score
    );
}

#[test]
fn sixty_percent_unregistered_poses_are_named_and_the_strict_score_still_stands() {
    let fixture = small();
    let good = run(&fixture.job("good", TAU)).unwrap();
    let mut poses = given_poses();
    for index in (0..poses.len()).filter(|index| index % 5 < 3) {
        poses[index] = unregistered(index);
    }
    fixture.put_log("rec.log", &poses);
    let document = run(&fixture.job("out", TAU)).unwrap();
    assert_eq!(failed(&document), ["poses-missing"]);
    assert!(message(&document, "poses-missing").contains("16 of the scene's 40"));
    assert!((document.f_score - good.f_score).abs() < 0.005);
}

#[test]
fn a_log_that_leaves_images_out_is_matched_by_number_or_named() {
    let fixture = small();
    let mut poses = given_poses();
    poses.remove(20);
    fixture.put_log("rec.log", &poses);
    let document = run(&fixture.job("numbered", TAU)).unwrap();
    assert!(document.passed, "{:?}", document.warnings);
    assert_eq!(
        document.alignment.trajectory.unwrap().matched_by,
        MatchedBy::Number
    );
    for (index, pose) in poses.iter_mut().enumerate() {
        pose.metadata[0] = index as i64;
    }
    fixture.put_log("rec.log", &poses);
    let document = run(&fixture.job("renumbered", TAU)).unwrap();
    assert!(
        failed(&document).contains(&"pose-count"),
        "{:?}",
        failed(&document)
    );
}

#[test]
fn a_video_log_is_thinned_by_the_mapping_file() {
    let fixture = small();
    let (poses, mapping) = video();
    fixture.put_log("rec.log", &poses);
    let error = run(&fixture.job("without", TAU)).unwrap_err().to_string();
    assert!(error.contains("mapping file"), "{error}");
    fixture.put_text("Synth/Synth_mapping_reference.txt", &mapping);
    let document = run(&fixture.job("with", TAU)).unwrap();
    assert!(document.passed && document.f_score > 0.85);
    assert_eq!(
        document.alignment.trajectory.unwrap().matched_by,
        MatchedBy::Mapping
    );
    // Frames that got lost, at the end or before, leave the poses after them to others.
    let mut short = poses;
    short.pop();
    fixture.put_log("rec.log", &short);
    let document = run(&fixture.job("short", TAU)).unwrap();
    assert_eq!(failed(&document), ["pose-count"]);
    let said = message(&document, "pose-count");
    assert!(said.contains("1799 poses for the 1800 frames"), "{said}");
}

#[test]
fn images_of_a_model_are_matched_by_their_names() {
    let fixture = small();
    let by_log = run(&fixture.job("log", TAU)).unwrap();
    // In an order of its own, with two images missing: a log of these would be shifted.
    let mut images = given_centres();
    images.reverse();
    images.retain(|(number, _)| ![1, 21].contains(number));
    fixture.put_model("model", &images);
    let job = |out: &str| ScoreJob {
        trajectory: Some(fixture.path("model")),
        ..fixture.job(out, TAU)
    };
    let document = run(&job("model-score")).unwrap();
    assert_eq!(failed(&document), [""; 0]);
    let report = document.alignment.trajectory.as_ref().unwrap();
    assert_eq!(
        (report.matched_by, report.registered),
        (MatchedBy::Name, 38)
    );
    assert_eq!(report.inliers, 38);
    assert!(
        (document.f_score - by_log.f_score).abs() < 0.005,
        "{}",
        document.f_score
    );
    let row = read(&fixture.path("model-score"), "scores.csv");
    let images_file = fixture.path("model/sparse/0/images.txt");
    assert!(row.contains(&mvs_eval::provenance::sha256(&images_file).unwrap()));

    // Numbers from 0 on.
    let from_zero = given_centres()
        .into_iter()
        .map(|(number, centre)| (number - 1, centre));
    let from_zero: Vec<(u32, DVec3)> = from_zero.collect();
    fixture.put_model("model", &from_zero);
    let document = run(&job("zero")).unwrap();
    assert_eq!(
        (failed(&document).len(), document.f_score),
        (0, by_log.f_score)
    );

    fixture.put_model("model", &[(41, DVec3::ZERO)]);
    let said = run(&job("beyond")).unwrap_err().to_string();
    assert!(
        said.contains("images.txt") && said.contains("scene's 40 cameras, found 41"),
        "{said}"
    );
    std::fs::remove_dir_all(fixture.path("model")).unwrap();
    fixture.put_text("model/readme", "nothing");
    let said = run(&job("none")).unwrap_err().to_string();
    assert!(
        said.contains("expected a .log, or a COLMAP model"),
        "{said}"
    );
}

/// The surface as a mesh of wide triangles, in the reconstruction's frame.
fn put_mesh(fixture: &Fixture, name: &str) {
    let at = |i: u32| 2.0 * f64::from(i) / 10.0 - 1.0;
    let vertex = |i: u32| {
        let (x, y) = (at(i % 11), at(i / 11));
        own_from_scan(DVec3::new(x, y, bumps(x, y)))
    };
    let corner = |i: u32| (i / 10) * 11 + i % 10;
    let triangles = (0..100).flat_map(|i| {
        let v = corner(i);
        [[v, v + 1, v + 12], [v, v + 12, v + 11]]
    });
    let mesh = Mesh::new((0..121).map(vertex).collect(), triangles.collect()).unwrap();
    let options = PlyOptions::default();
    write_atomically(&fixture.path(name), |out| {
        ply::write_mesh(out, &mesh, &options)
    })
    .unwrap();
}

#[test]
fn a_mesh_is_sampled_by_area_and_named_when_read_as_its_vertices() {
    let fixture = small();
    put_mesh(&fixture, "rec.ply");
    let sampled = run(&fixture.job("area", TAU)).unwrap();
    assert!(
        sampled.passed && sampled.f_score > 0.95,
        "{}",
        sampled.f_score
    );
    assert_eq!(sampled.mesh_sampling, Some(MeshAs::Area));
    let as_vertices = run(&ScoreJob {
        mesh_as: MeshAs::Vertices,
        ..fixture.job("vertices", TAU)
    })
    .unwrap();
    assert!(failed(&as_vertices).contains(&"mesh-too-coarse"));
    assert!(as_vertices.recall < 0.5, "{}", as_vertices.recall);
    assert!(read(&fixture.path("vertices"), "scores.csv").contains(",vertices,"));
}

fn command(fixture: &Fixture, out: &str, more: &[&str]) -> Output {
    Command::cargo_bin("mvs-eval")
        .unwrap()
        .current_dir(fixture.folder.path())
        .args([
            "score",
            "--protocol",
            "tnt",
            "--scene",
            "Synth",
            "--reconstruction",
            "rec.ply",
        ])
        .args([
            "--trajectory",
            "rec.log",
            "--tau",
            "0.05",
            "--out",
            out,
            "--quiet",
        ])
        .args(more)
        .output()
        .unwrap()
}

#[test]
fn the_command_says_0_1_or_2_and_replays() {
    let fixture = small();
    let good = command(&fixture, "good", &["--one-profile"]);
    let said = String::from_utf8_lossy(&good.stderr).into_owned();
    assert_eq!(good.status.code(), Some(0), "{said}");
    let answer: ScoreDocument = serde_json::from_slice(&good.stdout).unwrap();
    let written = read(&fixture.path("good"), "score.json");
    assert_eq!(
        serde_json::from_str::<ScoreDocument>(&written).unwrap(),
        answer
    );

    let again = command(&fixture, "good", &["--seed", "1"]);
    assert_eq!(again.status.code(), Some(2), "an existing result stays");

    let mut poses = given_poses();
    poses.rotate_left(3);
    fixture.put_log("rec.log", &poses);
    let bad = command(&fixture, "bad", &["--one-profile"]);
    assert_eq!(bad.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&bad.stderr).contains("[poses-shifted]"));
    assert!(fixture.path("bad/score.json").is_file());

    fixture.put_log("rec.log", &given_poses());
    let replay = Command::cargo_bin("mvs-eval")
        .unwrap()
        .current_dir(fixture.folder.path())
        .args([
            "replay",
            "good/run.toml",
            "--out",
            "replayed",
            "--quiet",
            "--threads",
            "1",
        ])
        .output()
        .unwrap();
    assert_eq!(replay.status.code(), Some(0));
    for name in [
        "score.json",
        "scores.csv",
        "Synth.precision.txt",
        "Synth.recall.ply",
    ] {
        let bytes = |out: &str| std::fs::read(fixture.path(out).join(name)).unwrap();
        assert_eq!(bytes("good"), bytes("replayed"), "{name}");
    }
}
