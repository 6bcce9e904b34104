//! Writes what `benches/fusion.py` fuses: the synthetic scene's noisy depth maps in the project's
//! layout, the exact surface to score against, and, if asked for, the same maps as a COLMAP dense
//! workspace with exact normals.
//!
//! usage: `fusion_inputs FOLDER KIND VIEWS WIDTH HEIGHT [workspace]`
//!        `fusion_inputs error KIND CLOUD` prints the median and 95th percentile of the distances of the
//!        cloud's points from the exact surface, in world units.
#![allow(
    clippy::print_stdout,
    clippy::cast_possible_truncation,
    reason = "a tool for benches: it answers on stdout, and maps are f32"
)]

use glam::{DQuat, DVec2, DVec3, Vec3};
use mvs_datasets::format::image::{self, JpegOptions};
use mvs_datasets::format::pfm;
use mvs_datasets::format::ply::{self, PlyOptions};
use mvs_datasets::layout::files::{read_cloud, write_atomically};
use mvs_datasets::layout::mvsnet::{self, PixelCentre};
use mvs_datasets::scene::{DepthMap, Raster, View};
use mvs_datasets::synthetic::{DepthNoise, SceneKind, SyntheticOptions, SyntheticScene};
use mvs_eval::parallel;
use mvs_eval::render::{RenderOptions, Renderer};
use std::error::Error;
use std::io::Write;
use std::path::{Path, PathBuf};

/// Distance up to which a point is right, in world units; the truth has two samples per distance.
const TAU: f64 = 0.01;
/// The workspace has the depths that the fusion's own confidence filter would leave.
const MIN_CONFIDENCE: f32 = 0.8;
/// World units between the sparse points that tell COLMAP which images overlap.
const SPARSE: f64 = 0.08;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    if let [command, kind, cloud] = arguments.as_slice()
        && command == "error"
    {
        return print_error(kind_named(kind)?, Path::new(cloud));
    }
    let [folder, kind, views, width, height, rest @ ..] = arguments.as_slice() else {
        return Err("usage: fusion_inputs FOLDER KIND VIEWS WIDTH HEIGHT [workspace]".into());
    };
    let inputs = Inputs {
        folder: PathBuf::from(folder),
        scene: SyntheticScene::new(SyntheticOptions {
            kind: kind_named(kind)?,
            seed: 1,
            views: views.parse()?,
            width: width.parse()?,
            height: height.parse()?,
        })?,
        workspace: rest.iter().any(|word| word == "workspace"),
    };
    inputs.write()
}

fn kind_named(name: &str) -> Result<SceneKind, String> {
    match name {
        "tabletop" => Ok(SceneKind::Tabletop),
        "facade" => Ok(SceneKind::Facade),
        other => Err(format!("expected tabletop or facade, found {other}")),
    }
}

/// The surface does not depend on the cameras: any will do.
fn print_error(kind: SceneKind, cloud: &Path) -> Result<(), Box<dyn Error>> {
    let scene = SyntheticScene::new(SyntheticOptions {
        kind,
        seed: 1,
        views: 2,
        ..SyntheticOptions::default()
    })?;
    let cloud = read_cloud(cloud)?;
    let distance = |at: usize| scene.distance_to_surface(cloud.positions()[at]);
    let mut distances = parallel::map(cloud.len(), distance);
    distances.sort_by(f64::total_cmp);
    let at = |share: usize| distances[(distances.len() - 1) * share / 100];
    println!("{:e} {:e}", at(50), at(95));
    Ok(())
}

struct Inputs {
    folder: PathBuf,
    scene: SyntheticScene,
    workspace: bool,
}

impl Inputs {
    fn write(&self) -> Result<(), Box<dyn Error>> {
        mvsnet::write_pairs(&self.folder.join("scene/cams/pair.txt"), self.scene.scene())?;
        let truth = self.scene.sample_surface(0.5 * TAU)?;
        let double = PlyOptions {
            double: true,
            ..PlyOptions::default()
        };
        write_atomically(&self.folder.join("truth.ply"), |file| {
            ply::write_cloud(file, &truth, &[], &double)
        })?;
        let renderer = Renderer::new(self.scene.mesh())?;
        parallel::try_map_pieces(self.scene.scene().views().len(), |index| {
            self.write_view(index, &renderer)
        })?;
        if self.workspace {
            self.write_sparse()?;
        }
        Ok(())
    }

    fn write_view(&self, index: usize, renderer: &Renderer) -> mvs_eval::Result<()> {
        let view = &self.scene.scene().views()[index];
        let path = |folder: &str, suffix: &str| {
            let name = mvsnet::file_name(view.id, suffix);
            self.folder.join(folder).join(name)
        };
        mvsnet::write_view(&path("scene/cams", "_cam.txt"), view, PixelCentre::Half)?;
        let rendering = renderer.render(view, &RenderOptions::default())?;
        let photograph = self.scene.photograph(index, &rendering.color);
        let mut folders = vec!["scene/images"];
        folders.extend(self.workspace.then_some("workspace/images"));
        for folder in folders {
            write_atomically(&path(folder, ".jpg"), |file| {
                image::write_jpeg(file, &photograph, JpegOptions::default())
            })?;
        }
        let (depth, confidence) = self.scene.estimated_depth(index, &DepthNoise::default());
        write_atomically(&path("depths", ".pfm"), |file| {
            pfm::write_gray(file, depth.raster())
        })?;
        write_atomically(&path("confidence", ".pfm"), |file| {
            pfm::write_gray(file, &confidence)
        })?;
        if self.workspace {
            let stereo = self.folder.join("workspace/stereo");
            let name = format!("{}.geometric.bin", mvsnet::file_name(view.id, ".jpg"));
            write_depth(
                &stereo.join("depth_maps").join(&name),
                (&depth, &confidence),
            )?;
            self.write_normals(&stereo.join("normal_maps").join(&name), view)?;
        }
        Ok(())
    }

    /// Exact normals in the camera frame, one plane per component, zero without a surface.
    fn write_normals(&self, path: &Path, view: &View) -> mvs_eval::Result<()> {
        let (width, height) = (view.camera.width(), view.camera.height());
        let pixels = (0..height).flat_map(|row| (0..width).map(move |column| (column, row)));
        let normals: Vec<Vec3> = pixels
            .map(|(column, row)| {
                let pixel = DVec2::new(f64::from(column), f64::from(row)) + 0.5;
                self.normal(view, pixel).unwrap_or(Vec3::ZERO)
            })
            .collect();
        let planes = (0..3).flat_map(|axis| normals.iter().map(move |normal| normal[axis]));
        write_matrix(path, (width, height, 3), planes)
    }

    /// From the exact surface a thousandth of a pixel away on both sides.
    fn normal(&self, view: &View, pixel: DVec2) -> Option<Vec3> {
        let at = |dx: f64, dy: f64| {
            let pixel = pixel + DVec2::new(dx, dy);
            Some(view.camera.ray(pixel) * self.scene.depth_at(view, pixel)?)
        };
        let step = 1e-3;
        let along = at(step, 0.0)? - at(-step, 0.0)?;
        let down = at(0.0, step)? - at(0.0, -step)?;
        down.cross(along).try_normalize().map(|unit| unit.as_vec3())
    }

    /// Cameras, poses and points with the views that see them.
    fn write_sparse(&self) -> Result<(), Box<dyn Error>> {
        let views = self.scene.scene().views();
        let points = self.scene.sample_surface(SPARSE)?;
        let mut seen: Vec<Vec<(usize, DVec2)>> = vec![Vec::new(); views.len()];
        let mut lines = String::new();
        for (id, &point) in points.positions().iter().enumerate() {
            let mut track = String::new();
            for (at, view) in views.iter().enumerate() {
                if let Some(pixel) = self.visible(view, point) {
                    track += &format!(" {} {}", at + 1, seen[at].len());
                    seen[at].push((id + 1, pixel));
                }
            }
            lines += &format!(
                "{} {} {} {} 128 128 128 0.5{track}\n",
                id + 1,
                point.x,
                point.y,
                point.z
            );
        }
        let sparse = self.folder.join("workspace/sparse");
        put(&sparse.join("points3D.txt"), &lines)?;
        let (mut cameras, mut images, mut names) = (String::new(), String::new(), String::new());
        for (at, view) in views.iter().enumerate() {
            let (id, camera) = (at + 1, &view.camera);
            let (focal, center) = (camera.focal(), camera.center());
            let (width, height) = (camera.width(), camera.height());
            cameras += &format!(
                "{id} PINHOLE {width} {height} {} {} {} {}\n",
                focal.x, focal.y, center.x, center.y
            );
            let q = DQuat::from_mat3(&view.pose.rotation());
            let t = view.pose.translation();
            let name = mvsnet::file_name(view.id, ".jpg");
            images += &format!(
                "{id} {} {} {} {} {} {} {} {id} {name}\n",
                q.w, q.x, q.y, q.z, t.x, t.y, t.z
            );
            let keypoints = seen[at]
                .iter()
                .map(|(point, pixel)| format!("{} {} {point}", pixel.x, pixel.y));
            images += &keypoints.collect::<Vec<_>>().join(" ");
            images.push('\n');
            names += &format!("{name}\n");
        }
        put(&sparse.join("cameras.txt"), &cameras)?;
        put(&sparse.join("images.txt"), &images)?;
        put(&self.folder.join("workspace/stereo/fusion.cfg"), &names)
    }

    fn visible(&self, view: &View, point: DVec3) -> Option<DVec2> {
        let in_cam = view.pose.to_cam(point);
        let pixel = view.camera.project(in_cam)?;
        let first = view
            .camera
            .contains(pixel)
            .then(|| self.scene.depth_at(view, pixel))??;
        (first > in_cam.z * (1.0 - 1e-6)).then_some(pixel)
    }
}

fn write_depth(
    path: &Path,
    (depth, confidence): (&DepthMap, &Raster<f32>),
) -> mvs_eval::Result<()> {
    let kept = depth.values().iter().zip(confidence.values());
    let values = kept.map(|(&depth, &confidence)| {
        if confidence >= MIN_CONFIDENCE {
            depth
        } else {
            0.0
        }
    });
    write_matrix(path, (depth.width(), depth.height(), 1), values)
}

/// COLMAP's array file: `width&height&channels&`, then f32 values.
fn write_matrix(
    path: &Path,
    (width, height, channels): (u32, u32, u32),
    values: impl Iterator<Item = f32>,
) -> mvs_eval::Result<()> {
    let mut bytes = format!("{width}&{height}&{channels}&").into_bytes();
    values.for_each(|value| bytes.extend(value.to_le_bytes()));
    Ok(write_atomically(path, |file| file.write_all(&bytes))?)
}

fn put(path: &Path, text: &str) -> Result<(), Box<dyn Error>> {
    Ok(write_atomically(path, |file| {
        file.write_all(text.as_bytes())
    })?)
}
