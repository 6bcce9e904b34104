//! The demo's inputs, as files that a user could have.

use crate::error::Result;
use crate::jobs::OutDir;
use crate::parallel;
use crate::progress::Progress;
use crate::render::{RenderOptions, Renderer};
use mvs_datasets::format::image::{self, JpegOptions};
use mvs_datasets::format::pfm;
use mvs_datasets::format::ply::{self, PlyOptions};
use mvs_datasets::layout::mvsnet::{self, PixelCentre};
use mvs_datasets::layout::{files, mesh_out};
use mvs_datasets::scene::PointCloud;
use mvs_datasets::synthetic::{DepthNoise, SyntheticScene};
use std::path::PathBuf;

/// Where the demo's inputs lie.
pub(super) struct Inputs {
    pub(super) mesh: PathBuf,
    pub(super) cameras: PathBuf,
    pub(super) photos: PathBuf,
    pub(super) depths: PathBuf,
    pub(super) confidence: PathBuf,
    pub(super) truth: PathBuf,
}

impl Inputs {
    fn within(out: &OutDir) -> Self {
        Self {
            mesh: out.file("input/mesh.obj"),
            cameras: out.file("input/cams"),
            photos: out.file("input/photos"),
            depths: out.file("estimates/depth"),
            confidence: out.file("estimates/confidence"),
            truth: out.file("input/truth.ply"),
        }
    }
}

/// Writes mesh, cams, photographs, noisy depth maps and the exact surface's points.
pub(super) fn write(
    out: &OutDir,
    scene: &SyntheticScene,
    (noise, truth): (&DepthNoise, &PointCloud),
    progress: &dyn Progress,
) -> Result<Inputs> {
    let inputs = Inputs::within(out);
    mesh_out::write_obj(&inputs.mesh, scene.mesh())?;
    mvsnet::write_pairs(&inputs.cameras.join("pair.txt"), scene.scene())?;
    let options = PlyOptions {
        double: true,
        ..PlyOptions::default()
    };
    files::write_atomically(&inputs.truth, |file| {
        ply::write_cloud(file, truth, &[], &options)
    })?;
    let renderer = Renderer::new(scene.mesh())?;
    let views = scene.scene().views();
    remove_from(&inputs, views.len() as u32)?;
    progress.begin("photographs", views.len() as u64);
    parallel::try_map_pieces(views.len(), |index| {
        progress.check()?;
        write_view(&inputs, scene, index, (&renderer, noise))?;
        progress.advance(1);
        Ok(())
    })?;
    Ok(inputs)
}

/// The files of a view: cam, photograph, depth and confidence.
fn files_of(inputs: &Inputs, id: u32) -> [PathBuf; 4] {
    let (cams, photos) = (&inputs.cameras, &inputs.photos);
    [
        cams.join(mvsnet::file_name(id, "_cam.txt")),
        photos.join(mvsnet::file_name(id, ".jpg")),
        inputs.depths.join(mvsnet::file_name(id, ".pfm")),
        inputs.confidence.join(mvsnet::file_name(id, ".pfm")),
    ]
}

/// Removes the views from `first` on, which an earlier demo with more of them left.
fn remove_from(inputs: &Inputs, first: u32) -> Result<()> {
    for id in first.. {
        let files = files_of(inputs, id);
        let there = || files.iter().filter(|path| path.exists());
        if there().next().is_none() {
            break;
        }
        for path in there() {
            std::fs::remove_file(path).map_err(mvs_datasets::Error::io(path, "remove"))?;
        }
    }
    Ok(())
}

fn write_view(
    inputs: &Inputs,
    scene: &SyntheticScene,
    index: usize,
    (renderer, noise): (&Renderer, &DepthNoise),
) -> Result<()> {
    let view = &scene.scene().views()[index];
    let [cam, path, depth_path, confidence_path] = files_of(inputs, view.id);
    mvsnet::write_view(&cam, view, PixelCentre::Half)?;
    let rendering = renderer.render(view, &RenderOptions::default())?;
    let photograph = scene.photograph(index, &rendering.color);
    files::write_atomically(&path, |file| {
        image::write_jpeg(file, &photograph, JpegOptions::default())
    })?;
    let (depth, confidence) = scene.estimated_depth(index, noise);
    files::write_atomically(&depth_path, |file| pfm::write_gray(file, depth.raster()))?;
    files::write_atomically(&confidence_path, |file| pfm::write_gray(file, &confidence))?;
    Ok(())
}
