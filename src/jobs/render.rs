//! `mvs-eval render`: mesh + cameras → depth, colour and cams per view.

use super::cameras::{self, CameraOptions};
use super::meshes::{MeshOptions, read_mesh, warn_of_plain};
use super::{Context, OutDir};
use crate::config::Size;
use crate::error::{Error, Result};
use crate::parallel;
use crate::render::{RenderOptions, Renderer, Rendering, Sight};
use crate::warning::of_back_faces;
use mvs_datasets::format::{image, pfm};
use mvs_datasets::layout::files;
use mvs_datasets::layout::mvsnet::{self, PixelCentre};
use mvs_datasets::scene::{DepthRange, Scene, View};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
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
    /// Render pinhole images of cameras that have a lens, instead of images through the lens.
    pub undistort: bool,
    /// What is written beside depth, colour and cams.
    pub extras: BTreeSet<RenderExtra>,
    /// How the mesh is read.
    pub meshes: MeshOptions,
    /// How to render.
    pub render: RenderOptions,
}

/// What `render` can write beside depth, colour and cams.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RenderExtra {
    /// `normals/`: geometric normals, camera frame.
    Normals,
    /// `interpolated_normals/`: normals interpolated between vertices, camera frame.
    InterpolatedNormals,
    /// `sight/`: what each pixel shows, as [`Sight::level`].
    Sight,
}

impl RenderExtra {
    fn folder(self) -> &'static str {
        match self {
            Self::Normals => "normals",
            Self::InterpolatedNormals => "interpolated_normals",
            Self::Sight => "sight",
        }
    }
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
    /// The view's id, which names its files.
    pub id: u32,
    /// The name of its image, where the cameras say it.
    pub name: String,
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
    /// Pixels whose samples disagree.
    pub mixed: usize,
    /// Pixels that show the back of a triangle, which is no surface.
    pub back_faces: usize,
    /// Pixels to which the lens bends no ray.
    pub without_ray: usize,
}

/// Views that one warning names.
const NAMED: usize = 20;

/// Renders every view.
///
/// # Errors
/// Paths not given, cameras or meshes that cannot be read, an output folder as [`OutDir::create`] refuses it or in
/// which what is read would be replaced, a number of samples that is no square, no view that sees the mesh, whatever
/// writing brings, and interruption.
pub fn run(job: &RenderJob, context: &Context<'_>) -> Result<RenderOutcome> {
    let mesh: Vec<&Path> = job.mesh.iter().map(PathBuf::as_path).collect();
    super::require(
        "render",
        &[
            ("--mesh", &mesh, "meshes"),
            ("--cameras", &[&job.cameras], "cameras"),
            ("--out", &[&job.out], "a folder to write"),
        ],
    )?;
    let options = (job.pixel_center, &job.camera);
    let mut scene = cameras::read(&job.cameras, options, job.size, context)?;
    if job.undistort {
        warn_of_undistorted(&scene, context);
        scene = cameras::without_lenses(scene)?;
    }
    if let Some(size) = job.size {
        scene = cameras::fitted(scene, size)?;
    }
    let loaded = read_mesh(&job.mesh, &job.meshes, context)?;
    warn_of_plain(&loaded.mesh, context);
    let mut inputs: Vec<&Path> = loaded.files.iter().map(PathBuf::as_path).collect();
    inputs.push(&job.cameras);
    let out = OutDir::create(
        &job.out,
        context.run("render", job, &OutDir::inputs(&job.out, &inputs)?)?,
        context.force,
    )?;
    let extras = job.extras.iter().map(|extra| extra.folder());
    let mut folders = ["depth", "color", "cams"].into_iter().chain(extras);
    folders.try_for_each(|name| out.check_not_read(name))?;
    let bent = cameras::lens_count(&scene);
    if bent > 0 {
        let message = format!(
            "{bent} views are rendered through their lens, which their cam.txt cannot hold: it has \
             the pinhole part alone; --undistort renders pinhole images"
        );
        context.warnings.add("lens", message);
    }
    let renderer = Renderer::new(&loaded.mesh)?;
    let views = scene.views();
    context.progress.begin("rendering", views.len() as u64);
    let views = parallel::try_map_pieces(views.len(), |index| {
        context.progress.check()?;
        let rendered = render_view(&renderer, &views[index], job, &out)?;
        context.progress.advance(1);
        Ok(rendered)
    })?;
    warn_of_backs(&views, context);
    if views.iter().all(|view| view.depth_min.is_none()) {
        let problem = "expected views that see the mesh, found none that does; check that mesh and \
                       cameras share a frame, that poses are world-to-camera, and that faces are not wound \
             the other way (--back-faces valid)";
        return Err(Error::invalid(job.cameras.display().to_string(), problem));
    }
    warn_of_empty(&views, context);
    out.write_json(NAMES, &names_of(&views))?;
    out.finish()?;
    Ok(RenderOutcome {
        triangles: loaded.mesh.triangles().len(),
        views,
    })
}

/// Says that photographs as they were taken do not go with these renderings.
fn warn_of_undistorted(scene: &Scene, context: &Context<'_>) {
    let bent = cameras::lens_count(scene);
    if bent > 0 {
        let message = format!(
            "{bent} views have a lens, which these renderings do not go through: photographs that are blended with them \
             must be undistorted likewise (generate does so by itself)"
        );
        context.warnings.add("lens-undone", message);
    }
}

/// The file that says which image each rendering is of.
pub(super) const NAMES: &str = "views.json";

/// The names of the views' images, where there are any, by the names of their files.
fn names_of(views: &[RenderedView]) -> BTreeMap<String, &str> {
    let named = views.iter().filter(|view| !view.name.is_empty());
    let named = named.map(|view| (mvsnet::file_name(view.id, ""), view.name.as_str()));
    named.collect()
}

/// Names the views that see nothing, the first of them.
fn warn_of_empty(views: &[RenderedView], context: &Context<'_>) {
    let empty = views.iter().filter(|view| view.depth_min.is_none());
    let empty: Vec<String> = empty.map(|view| view.id.to_string()).collect();
    if empty.is_empty() {
        return;
    }
    let message = format!(
        "{} of {} views see nothing of the mesh and have empty images: {}{}",
        empty.len(),
        views.len(),
        empty[..empty.len().min(NAMED)].join(", "),
        if empty.len() > NAMED {
            " and others"
        } else {
            ""
        }
    );
    context.warnings.add("empty-view", message);
}

/// Says so when triangles are mostly seen from behind.
fn warn_of_backs(views: &[RenderedView], context: &Context<'_>) {
    let backs = views.iter().map(|view| view.back_faces).sum();
    let fronts: f64 = views.iter().map(RenderedView::pixels_of_surface).sum();
    if let Some(warning) = of_back_faces(backs, fronts as usize) {
        context.warnings.add(&warning.code, warning.message);
    }
}

impl RenderedView {
    fn pixels_of_surface(&self) -> f64 {
        (self.coverage * f64::from(self.width) * f64::from(self.height)).round()
    }
}

fn write_extras(
    rendering: &Rendering,
    job: &RenderJob,
    name: impl Fn(&str, &str) -> PathBuf,
) -> Result<()> {
    for extra in &job.extras {
        match extra {
            RenderExtra::Normals => {
                if let Some(normals) = &rendering.normals {
                    files::write_atomically(&name(extra.folder(), ".pfm"), |file| {
                        pfm::write_color(file, normals)
                    })?;
                }
            }
            RenderExtra::InterpolatedNormals => {
                if let Some(normals) = &rendering.interpolated_normals {
                    files::write_atomically(&name(extra.folder(), ".pfm"), |file| {
                        pfm::write_color(file, normals)
                    })?;
                }
            }
            RenderExtra::Sight => {
                files::write_atomically(&name(extra.folder(), ".png"), |file| {
                    image::write_gray_png(file, &rendering.sight.map(|sight| sight.level()))
                })?;
            }
        }
    }
    Ok(())
}

fn render_view(
    renderer: &Renderer,
    view: &View,
    job: &RenderJob,
    out: &OutDir,
) -> Result<RenderedView> {
    let options = RenderOptions {
        normals: job.extras.contains(&RenderExtra::Normals),
        interpolated_normals: job.extras.contains(&RenderExtra::InterpolatedNormals),
        ..job.render.clone()
    };
    let rendering = renderer.render(view, &options)?;
    let name = |folder: &str, suffix: &str| {
        out.file(Path::new(folder).join(mvsnet::file_name(view.id, suffix)))
    };
    files::write_atomically(&name("depth", ".pfm"), |file| {
        pfm::write_gray(file, rendering.depth.raster())
    })?;
    files::write_atomically(&name("color", ".png"), |file| {
        image::write_png(file, &rendering.color)
    })?;
    write_extras(&rendering, job, name)?;
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
    write_cam(&name("cams", "_cam.txt"), view, depth_min.zip(depth_max))?;
    let (width, height) = rendering.depth.size();
    let pixels = rendering.depth.values().len();
    #[allow(
        clippy::cast_precision_loss,
        reason = "pixel counts are far below 2^53"
    )]
    let coverage = rendering.depth.valid_count() as f64 / pixels as f64;
    Ok(RenderedView {
        id: view.id,
        name: view.name.clone(),
        width,
        height,
        coverage,
        depth_min,
        depth_max,
        mixed: rendering.count(Sight::Mixed),
        back_faces: rendering.count(Sight::BackFace),
        without_ray: rendering.count(Sight::NoRay),
    })
}

/// The cam with the range of what is seen; a view that sees nothing keeps its own range. Pixel centres are where
/// all cams of this program have them, wherever the given ones did.
fn write_cam(path: &Path, view: &View, seen: Option<(f32, f32)>) -> Result<()> {
    let seen = seen.and_then(|(min, max)| {
        let (min, max) = (f64::from(min), f64::from(max));
        DepthRange::new(min, if max > min { max } else { min * (1.0 + 1e-6) }).ok()
    });
    let depth_range = seen.or(view.depth_range).or(DepthRange::new(1.0, 2.0).ok());
    let view = View {
        depth_range,
        ..view.clone()
    };
    Ok(mvsnet::write_view(path, &view, PixelCentre::Half)?)
}
