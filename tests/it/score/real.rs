//! The faults users meet, on a real pair: each is named, the result is written, the command ends
//! with 1.

use super::{expected, saharov, write_transform};
use crate::support::{mvs_eval, real_data, text};
use glam::{DMat4, DVec3};
use mvs_datasets::format::log::LogPose;
use mvs_datasets::format::ply::PlyOptions;
use mvs_datasets::format::{log, ply, transform};
use mvs_datasets::layout::files::{read_cloud, write_atomically};
use mvs_datasets::scene::Mesh;
use mvs_eval::jobs::score::ScoreDocument;
use std::path::{Path, PathBuf};

/// The real pair in a folder that may be spoiled.
struct Pair {
    folder: tempfile::TempDir,
    poses: Vec<LogPose>,
}

impl Pair {
    fn new(data: &Path) -> Self {
        let folder = tempfile::tempdir().unwrap();
        for name in [
            "saharov.ply",
            "saharov.json",
            "saharov_trans.txt",
            "saharov_COLMAP_SfM.log",
        ] {
            std::fs::copy(data.join(name), folder.path().join(name)).unwrap();
        }
        let read = |name: &str| std::fs::read_to_string(data.join("rec").join(name)).unwrap();
        std::fs::copy(
            data.join("rec/saharov_rec.ply"),
            folder.path().join("rec.ply"),
        )
        .unwrap();
        let pair = Self {
            folder,
            poses: log::read(&read("saharov_rec.log")).unwrap(),
        };
        pair.put_log(&pair.poses);
        pair
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn put_log(&self, poses: &[LogPose]) {
        write_atomically(&self.path("rec.log"), |out| log::write(out, poses)).unwrap();
    }

    /// The exit code, what was said, and what was written, of scoring with these options.
    fn score(&self, out: &str, options: &[&str]) -> (Option<i32>, String, ScoreDocument) {
        let (scene, rec, folder) = (self.path(""), self.path("rec.ply"), self.path(out));
        let mut arguments = vec!["score", "--protocol", "tnt", "--scene", text(&scene)];
        arguments.extend([
            "--name",
            "saharov",
            "--tau",
            "0.03",
            "--one-profile",
            "--quiet",
        ]);
        arguments.extend(["--reconstruction", text(&rec), "--out", text(&folder)]);
        arguments.extend(options);
        let output = mvs_eval(&arguments);
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        let written = std::fs::read(folder.join("score.json"));
        let written = written.unwrap_or_else(|error| panic!("{error}: {said}"));
        (
            output.status.code(),
            said,
            serde_json::from_slice(&written).unwrap(),
        )
    }

    fn by_cameras(&self, out: &str) -> (Option<i32>, String, ScoreDocument) {
        let log = self.path("rec.log");
        self.score(out, &["--trajectory", text(&log)])
    }
}

#[test]
fn faults_of_a_real_log_are_named() {
    let Some(data) = real_data("pair_saharov") else {
        return;
    };
    let pair = Pair::new(&data);
    let (code, said, good) = pair.by_cameras("good");
    assert_eq!(code, Some(0), "{said}");
    let mut poses = pair.poses.clone();
    poses.rotate_left(3);
    pair.put_log(&poses);
    let (code, said, _) = pair.by_cameras("shifted");
    assert_eq!(code, Some(1));
    assert!(said.contains("the log seems shifted by 3"), "{said}");

    // The same poses in another order: a log of the right length that is another scene's.
    let mut poses = pair.poses.clone();
    poses.sort_by_key(|pose| (pose.metadata[0] * 13) % 32);
    pair.put_log(&poses);
    let (code, said, _) = pair.by_cameras("other");
    assert_eq!(code, Some(1));
    assert!(
        said.contains("[few-inliers]") && said.contains("another scene's"),
        "{said}"
    );

    let mut poses = pair.poses.clone();
    for (index, pose) in poses
        .iter_mut()
        .enumerate()
        .filter(|(index, _)| index % 5 < 3)
    {
        pose.metadata = [index as i64, -1, 0];
        pose.world_from_cam = DMat4::IDENTITY;
    }
    pair.put_log(&poses);
    let (code, said, document) = pair.by_cameras("unregistered");
    assert_eq!(code, Some(1));
    assert!(
        said.contains("[poses-missing]") && said.contains("12 of the scene's 32"),
        "{said}"
    );
    assert!(
        (document.f_score - good.f_score).abs() < 0.01,
        "{}",
        document.f_score
    );
}

#[test]
fn faults_of_a_real_transform_and_a_mesh_as_vertices_are_named() {
    let Some(data) = real_data("pair_saharov") else {
        return;
    };
    let pair = Pair::new(&data);
    let start = pair.path("icp.txt");
    write_transform(&start, &expected(&data)["T_icp"]);
    let (code, said, good) = pair.score("given", &["--transform", text(&start)]);
    assert_eq!(code, Some(0), "{said}");

    let right = transform::read(&std::fs::read_to_string(&start).unwrap()).unwrap();
    let put = |name: &str, motion: DMat4| {
        let path = pair.path(name);
        write_atomically(&path, |out| transform::write(out, &motion)).unwrap();
        path
    };
    let thousand = put("mm.txt", DMat4::from_scale(DVec3::splat(1000.0)) * right);
    let (code, said, _) = pair.score("units", &["--transform", text(&thousand)]);
    assert_eq!(code, Some(1));
    assert!(said.contains("units look like millimetres"), "{said}");

    let away = DMat4::from_translation(DVec3::new(60.0, 0.0, 0.0));
    let wrong = put("wrong.txt", away * right);
    let (code, said, document) = pair.score("wrong", &["--transform", text(&wrong)]);
    assert_eq!((code, document.f_score), (Some(1), 0.0));
    assert!(said.contains("[crop-keeps-little]"), "{said}");

    // Triangles of neighbouring rows of the cloud: wide enough to lose what lies between.
    let cloud = read_cloud(&pair.path("rec.ply")).unwrap();
    let vertices: Vec<DVec3> = cloud.positions().iter().step_by(50).copied().collect();
    let triangles = (0..vertices.len() as u32 - 2)
        .map(|i| [i, i + 1, i + 2])
        .collect();
    let mesh = Mesh::new(vertices, triangles).unwrap();
    write_atomically(&pair.path("rec.ply"), |out| {
        ply::write_mesh(out, &mesh, &PlyOptions::default())
    })
    .unwrap();
    let options = ["--transform", text(&start), "--mesh-as", "vertices"];
    let (code, said, document) = pair.score("vertices", &options);
    assert_eq!(code, Some(1));
    assert!(said.contains("[mesh-too-coarse]"), "{said}");
    assert!(document.recall < good.recall);
}

#[test]
fn the_real_pair_passes_every_gate_well_inside_its_bounds() {
    let Some(data) = real_data("pair_saharov") else {
        return;
    };
    let temporary = tempfile::tempdir().unwrap();
    let document = super::run(&mvs_eval::jobs::score::ScoreJob {
        trajectory: Some(data.join("rec/saharov_rec.log")),
        ..saharov(&data, &temporary.path().join("out"))
    })
    .unwrap();
    let value = |code: &str| {
        let gate = document.gates.iter().find(|gate| gate.code == code);
        gate.unwrap_or_else(|| panic!("no gate {code}"))
            .value
            .unwrap()
    };
    // Half-way to a bound or better: a bound that a sound pair nearly touches is no bound.
    assert!(value("poses-missing") == 1.0);
    assert!(value("few-inliers") > 0.8, "{}", value("few-inliers"));
    assert!((value("implausible-scale") - 1.0).abs() < 0.1);
    assert!(
        (value("icp-scale") - 1.0).abs() < 0.06,
        "{}",
        value("icp-scale")
    );
    assert!(value("low-icp-fitness") > 0.6);
    assert!(value("crop-keeps-little") > 0.5);
}
