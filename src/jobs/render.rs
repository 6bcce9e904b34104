//! `mvs-eval render`: mesh + cameras → depth, colour and cams per view.

use super::cameras::{self, CameraOptions};
use super::{Context, OutDir};
use crate::config::Size;
use crate::error::{Error, Result};
use crate::parallel;
use crate::provenance::Run;
use crate::render::{RenderOptions, Renderer};
use mvs_datasets::format::{image, pfm};
use mvs_datasets::layout::mvsnet::{self, PixelCentre};
use mvs_datasets::layout::{files, mesh};
use mvs_datasets::scene::{DepthRange, View};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// Options of `mvs-eval render`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RenderJob {
    /// Mesh files, or folders of them; together they are one scene.
    pub mesh: Vec<PathBuf>,
    /// Cameras in any form that [`mvs_datasets::layout::cameras`] knows.
    pub cameras: PathBuf,
    /// The folder for `depth/`, `color/` and `cams/`.
    pub out: PathBuf,
    /// Image size: cameras are scaled and cropped to it. See [`cameras::read`] for cams.
    pub size: Option<Size>,
    /// What the camera files leave open.
    pub camera: CameraOptions,
    /// Where the cameras put the centre of the top-left pixel.
    pub pixel_center: PixelCentre,
    /// How to render.
    pub render: RenderOptions,
}

/// What was rendered.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RenderOutcome {
    /// Triangles of the mesh.
    pub triangles: usize,
    /// Rendered views, by id.
    pub views: Vec<RenderedView>,
}

/// One rendered view.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RenderedView {
    /// The view's id.
    pub id: u32,
    /// Image width in pixels.
    pub width: u32,
    /// Image height in pixels.
    pub height: u32,
    /// Fraction of pixels that show the surface.
    pub coverage: f64,
    /// Smallest depth in world units; `None` where nothing is seen.
    pub depth_min: Option<f32>,
    /// Largest depth in world units.
    pub depth_max: Option<f32>,
}

/// Renders every view.
pub fn run(job: &RenderJob, context: &Context<'_>) -> Result<RenderOutcome> {
    let options = (job.pixel_center, &job.camera);
    let mut scene = cameras::read(&job.cameras, options, job.size, context)?;
    cameras::check_no_lens(&scene)?;
    if let Some(size) = job.size {
        scene = cameras::fitted(scene, size)?;
    }
    let mut inputs: Vec<&Path> = job.mesh.iter().map(PathBuf::as_path).collect();
    inputs.push(&job.cameras);
    let out = OutDir::create(&job.out, Run::new("render", job, &inputs)?, context.force)?;
    let loaded = mesh::read_meshes(&job.mesh)?;
    for note in &loaded.notes {
        context.warnings.add("mesh", note.clone());
    }
    let renderer = Renderer::new(&loaded.mesh)?;
    let views = scene.views();
    context.progress.begin("rendering", views.len() as u64);
    let views = parallel::try_map(views.len(), |index| {
        context.progress.check()?;
        let rendered = render_view(&renderer, &views[index], job, &out)?;
        context.progress.advance(1);
        Ok(rendered)
    })?;
    for view in views.iter().filter(|view| view.depth_min.is_none()) {
        let message = format!(
            "view {} sees nothing of the mesh: its images are empty",
            view.id
        );
        context.warnings.add("empty-view", message);
    }
    if views.iter().all(|view| view.depth_min.is_none()) {
        let problem = "expected views that see the mesh, found none that does; check that mesh and \
                       cameras share a frame and that poses are world-to-camera";
        return Err(Error::invalid(job.cameras.display().to_string(), problem));
    }
    out.finish()?;
    Ok(RenderOutcome {
        triangles: loaded.mesh.triangles().len(),
        views,
    })
}

fn render_view(
    renderer: &Renderer,
    view: &View,
    job: &RenderJob,
    out: &OutDir,
) -> Result<RenderedView> {
    let rendering = renderer.render(view, &job.render)?;
    let name = |folder: &str, suffix: &str| {
        out.file(Path::new(folder).join(mvsnet::file_name(view.id, suffix)))
    };
    files::write_atomically(&name("depth", ".pfm"), |file| {
        pfm::write_gray(file, rendering.depth.raster())
    })?;
    files::write_atomically(&name("color", ".png"), |file| {
        image::write_png(file, &rendering.color)
    })?;
    let valid = || {
        rendering
            .depth
            .values()
            .iter()
            .copied()
            .filter(|&depth| depth > 0.0)
    };
    let depth_min = valid().reduce(f32::min);
    let depth_max = valid().reduce(f32::max);
    write_cam(
        &name("cams", "_cam.txt"),
        view,
        depth_min.zip(depth_max),
        job.pixel_center,
    )?;
    let (width, height) = rendering.depth.size();
    let pixels = rendering.depth.values().len();
    #[allow(
        clippy::cast_precision_loss,
        reason = "pixel counts are far below 2^53"
    )]
    let coverage = rendering.depth.valid_count() as f64 / pixels as f64;
    Ok(RenderedView {
        id: view.id,
        width,
        height,
        coverage,
        depth_min,
        depth_max,
    })
}

/// The cam with the range of what is seen; a view that sees nothing keeps its own range.
fn write_cam(
    path: &Path,
    view: &View,
    seen: Option<(f32, f32)>,
    pixel_centre: PixelCentre,
) -> Result<()> {
    let seen = seen.and_then(|(min, max)| {
        let (min, max) = (f64::from(min), f64::from(max));
        DepthRange::new(min, if max > min { max } else { min * (1.0 + 1e-6) }).ok()
    });
    let depth_range = seen.or(view.depth_range).or(DepthRange::new(1.0, 2.0).ok());
    let view = View {
        depth_range,
        ..view.clone()
    };
    Ok(mvsnet::write_view(path, &view, pixel_centre)?)
}
