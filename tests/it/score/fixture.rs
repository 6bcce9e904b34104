//! Small Tanks and Temples scenes from formulas. Those without bumps have the same bits as
//! tests/reference/tnt_open3d.py makes.

use glam::{DMat4, DVec3};
use mvs_datasets::format::log::{self, LogPose};
use mvs_datasets::format::ply::{self, PlyOptions};
use mvs_datasets::format::transform;
use mvs_datasets::layout::files::write_atomically;
use mvs_datasets::scene::PointCloud;
use mvs_eval::jobs::score::{Protocol, ScoreJob};
use std::io::Write;
use std::path::{Path, PathBuf};

pub(super) const CAMERAS: usize = 40;

fn mixed(bits: u64) -> u64 {
    let bits = (bits ^ (bits >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let bits = (bits ^ (bits >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    bits ^ (bits >> 31)
}

/// Uniform in [−1, 1), one number per key.
pub(super) fn unit(seed: u64, key: u64) -> f64 {
    let seed = seed.wrapping_mul(0xd1b5_4a32_d192_ed03);
    let bits = mixed(key.wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ seed);
    (bits >> 11) as f64 / (1u64 << 52) as f64 - 1.0
}

fn triple(seed: u64, index: u64) -> DVec3 {
    DVec3::from(std::array::from_fn(|k| unit(seed, 3 * index + k as u64)))
}

pub(super) fn truth(count: u64) -> Vec<DVec3> {
    surface(1, count, 0.0)
}

fn surface(seed: u64, count: u64, noise: f64) -> Vec<DVec3> {
    let point = |index: u64| {
        let DVec3 { x, y, z } = triple(seed, index);
        DVec3::new(x, y, 0.25 * x * x - 0.125 * x * y + 0.0625 * y + z * noise)
    };
    (0..count).map(point).collect()
}

/// Noisy, with a quarter missing and some outliers, in its own frame.
pub(super) fn reconstruction(count: u64) -> Vec<DVec3> {
    let mut points = surface(2, count, 0.03);
    points.retain(|point| !(point.x > 0.25 && point.y > 0.25));
    points.extend((0..count / 60).map(|index| triple(3, index)));
    points.into_iter().map(own_from_scan).collect()
}

/// The height of a surface whose bumps hold ICP in place: on a smooth patch a similarity slides.
pub(super) fn bumps(x: f64, y: f64) -> f64 {
    0.25 * (4.0 * x).sin() * (5.0 * y).cos()
}

fn bumpy(seed: u64, count: u64, noise: f64) -> Vec<DVec3> {
    let point = |index: u64| {
        let DVec3 { x, y, z } = triple(seed, index);
        DVec3::new(x, y, bumps(x, y) + z * noise)
    };
    (0..count).map(point).collect()
}

/// The bumpy surface itself.
pub(super) fn bumpy_truth(count: u64) -> Vec<DVec3> {
    bumpy(1, count, 0.0)
}

/// The bumpy surface with a little noise and some outliers, in the reconstruction's own frame.
pub(super) fn bumpy_reconstruction(count: u64) -> Vec<DVec3> {
    let mut points = bumpy(2, count, 0.01);
    points.extend((0..count / 60).map(|index| triple(3, index)));
    points.into_iter().map(own_from_scan).collect()
}

/// Turns the axes and halves lengths, both exactly.
pub(super) fn own_from_scan(point: DVec3) -> DVec3 {
    DVec3::new(point.y, point.z, point.x) * 0.5
}

/// The inverse of [`own_from_scan`].
pub(super) fn scan_from_own() -> DMat4 {
    DMat4::from_cols_array(&[
        0.0, 2.0, 0.0, 0.0, 0.0, 0.0, 2.0, 0.0, 2.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0,
    ])
}

fn scan_from_reference() -> DMat4 {
    DMat4::from_cols_array(&[
        0.0, 0.0, 4.0, 0.0, 4.0, 0.0, 0.0, 0.0, 0.0, 4.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0,
    ])
}

fn centre(index: u64) -> DVec3 {
    triple(4, index) * DVec3::new(2.0, 2.0, 0.5) + DVec3::Z * 2.0
}

fn pose(index: usize, centre: DVec3) -> LogPose {
    LogPose {
        metadata: [index as i64, index as i64, 0],
        world_from_cam: DMat4::from_translation(centre),
    }
}

pub(super) fn unregistered(index: usize) -> LogPose {
    LogPose {
        metadata: [index as i64, -1, 0],
        world_from_cam: DMat4::IDENTITY,
    }
}

/// The reconstruction's cameras in its own frame.
pub(super) fn given_poses() -> Vec<LogPose> {
    let given = |index: usize| {
        let moved = centre(index as u64) + triple(5, index as u64) * 0.02;
        pose(index, own_from_scan(moved))
    };
    (0..CAMERAS).map(given).collect()
}

/// Their centres by the numbers of their images, from 1 on.
pub(super) fn given_centres() -> Vec<(u32, DVec3)> {
    let centres = given_poses().into_iter().zip(1..);
    let centres = centres.map(|(pose, number)| (number, pose.world_from_cam.w_axis.truncate()));
    centres.collect()
}

/// The scene's cameras in the frame of the reference.
pub(super) fn reference_poses() -> Vec<LogPose> {
    let reference = |index: usize| {
        let DVec3 { x, y, z } = centre(index as u64);
        pose(index, DVec3::new(z, x, y) * 0.25)
    };
    (0..CAMERAS).map(reference).collect()
}

pub(super) fn truth_from_reference() -> DMat4 {
    scan_from_reference()
}

/// A video log whose frames 1, 46, 91 … are the cameras, and the text of its mapping file.
pub(super) fn video() -> (Vec<LogPose>, String) {
    let mut poses = vec![unregistered(0); 45 * CAMERAS];
    let mut mapping = format!("{CAMERAS}\n{}\n", 45 * CAMERAS);
    for (index, pose) in given_poses().into_iter().enumerate() {
        poses[45 * index] = pose;
        mapping.push_str(&format!("{index} {}\n", 1 + 45 * index));
    }
    (poses, mapping)
}

pub(super) const NOTCHED: [[f64; 2]; 5] = [
    [-0.875, -0.875],
    [0.875, -0.9375],
    [0.75, 0.875],
    [0.0625, -0.25],
    [-0.8125, 0.9375],
];

fn crop_json(scale: f64) -> String {
    let vertices = NOTCHED.map(|[x, y]| format!("[{:?}, {:?}, 0.0]", x * scale, y * scale));
    format!(
        "{{\"class_name\": \"SelectionPolygonVolume\", \"orthogonal_axis\": \"Z\", \
         \"axis_min\": {:?}, \"axis_max\": {:?}, \"bounding_polygon\": [{}], \
         \"version_major\": 1, \"version_minor\": 0}}",
        -0.5 * scale,
        0.4375 * scale,
        vertices.join(", ")
    )
}

/// A scene folder and a reconstruction on disk, good until a test spoils them.
pub(super) struct Fixture {
    pub(super) folder: tempfile::TempDir,
}

impl Fixture {
    /// About `count` points a side.
    pub(super) fn new(count: u64) -> Self {
        Self::scaled(count, 1.0)
    }

    /// The same with every length in every file multiplied by `scale`.
    pub(super) fn scaled(count: u64, scale: f64) -> Self {
        let fixture = Self {
            folder: tempfile::tempdir().unwrap(),
        };
        let larger = |points: Vec<DVec3>| points.iter().map(|&point| point * scale).collect();
        let moved = |mut poses: Vec<LogPose>| {
            for pose in &mut poses {
                pose.world_from_cam.w_axis *= glam::DVec4::new(scale, scale, scale, 1.0);
            }
            poses
        };
        fixture.put_cloud("Synth/Synth.ply", larger(bumpy_truth(count)));
        fixture.put_text("Synth/Synth.json", &crop_json(scale));
        fixture.put_log("Synth/Synth_COLMAP_SfM.log", &moved(reference_poses()));
        fixture.put_transform("Synth/Synth_trans.txt", scan_from_reference());
        fixture.put_cloud("rec.ply", larger(bumpy_reconstruction(count)));
        fixture.put_log("rec.log", &moved(given_poses()));
        fixture
    }

    pub(super) fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    pub(super) fn put_cloud(&self, name: &str, points: Vec<DVec3>) {
        let cloud = PointCloud::new(points);
        let options = PlyOptions {
            double: true,
            ..PlyOptions::default()
        };
        let path = self.path(name);
        write_atomically(&path, |out| ply::write_cloud(out, &cloud, &[], &options)).unwrap();
    }

    pub(super) fn put_text(&self, name: &str, text: &str) {
        write_atomically(&self.path(name), |out| out.write_all(text.as_bytes())).unwrap();
    }

    pub(super) fn put_log(&self, name: &str, poses: &[LogPose]) {
        write_atomically(&self.path(name), |out| log::write(out, poses)).unwrap();
    }

    /// A COLMAP model under `folder`: images by their numbers; without turns, as the fixture's cameras are.
    pub(super) fn put_model(&self, folder: &str, images: &[(u32, DVec3)]) {
        let line = |&(number, centre): &(u32, DVec3)| {
            let DVec3 { x, y, z } = -centre;
            format!("{} 1 0 0 0 {x} {y} {z} 1 {number:06}.jpg\n\n", 900 - number)
        };
        let lines: Vec<String> = images.iter().map(line).collect();
        self.put_text(&format!("{folder}/sparse/0/images.txt"), &lines.concat());
        let camera = "1 PINHOLE 64 48 50 50 32 24\n";
        self.put_text(&format!("{folder}/sparse/0/cameras.txt"), camera);
    }

    pub(super) fn put_transform(&self, name: &str, matrix: DMat4) {
        write_atomically(&self.path(name), |out| transform::write(out, &matrix)).unwrap();
    }

    /// Scores `rec.ply` by the cameras of `rec.log`, into the folder `out`.
    pub(super) fn job(&self, out: &str, tau: f64) -> ScoreJob {
        ScoreJob {
            protocol: Protocol::Tnt,
            scene: Some(self.path("Synth")),
            reconstruction: self.path("rec.ply"),
            trajectory: Some(self.path("rec.log")),
            tau: vec![tau],
            one_profile: true,
            out: self.path(out),
            ..ScoreJob::default()
        }
    }
}

/// Reads a file of the result in `out`.
pub(super) fn read(out: &Path, name: &str) -> String {
    std::fs::read_to_string(out.join(name)).unwrap()
}
