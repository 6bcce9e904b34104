//! Rendered depth against formulas.

use super::{DEPTH_BOUND, ExtremesJob, Place, Rows, naive};
use crate::error::Result;
use crate::render::{BackFaces, RenderOptions, Renderer};
use glam::{DMat3, DVec2, DVec3};
use mvs_datasets::scene::{Camera, Mesh, Pose, View};
use mvs_datasets::synthetic::{SceneKind, SyntheticOptions, SyntheticScene};

/// A depth this far off, relative, is that of another surface: an edge fell on the other side of a
/// pixel's centre.
const OTHER_SURFACE: f64 = 1e-3;
/// Every so many pixels are computed by plain arithmetic too.
const STRIDE: usize = 23;
const QUANTITY: &str = "relative depth error, largest";

pub(super) fn measure(job: &ExtremesJob, rows: &mut Rows<'_>) -> Result<()> {
    let scene = facade(160)?;
    for (step, place) in Place::steps() {
        at_place(&scene, step, place, rows)?;
    }
    for ratio in [1e1, 1e3, 1e5, 1e6] {
        let (view, mesh) = two_planes(ratio)?;
        let exact = |pixel: DVec2| Some(two_depths(&view, pixel, ratio));
        let errors = Errors::of(&mesh, &view, exact)?;
        errors.put(rows, ("near-far", ratio), "ours")?;
    }
    for copies in [1, 8, 64] {
        let triangles = scene.mesh().triangles();
        let repeated = triangles
            .iter()
            .flat_map(|&t| std::iter::repeat_n(t, copies));
        let mesh = Mesh::new(scene.mesh().vertices().to_vec(), repeated.collect())?;
        let view = &scene.scene().views()[0];
        let errors = Errors::of(&mesh, view, |pixel| scene.depth_at(view, pixel))?;
        errors.put(rows, ("duplicates", copies as f64), "ours")?;
    }
    let widths = [4, 64, 512, 2048];
    for width in widths.into_iter().filter(|&width| width <= job.width) {
        let scene = facade(width)?;
        let view = &scene.scene().views()[0];
        let errors = Errors::of(scene.mesh(), view, |pixel| scene.depth_at(view, pixel))?;
        errors.put(rows, ("image-size", f64::from(width)), "ours")?;
    }
    Ok(())
}

/// A scene of rectangles alone, which its mesh does not approximate.
fn facade(width: u32) -> Result<SyntheticScene> {
    Ok(SyntheticScene::new(SyntheticOptions {
        kind: SceneKind::Facade,
        views: 4,
        width,
        height: 3 * width / 4,
        ..SyntheticOptions::default()
    })?)
}

fn at_place(
    scene: &SyntheticScene,
    step: (&str, f64),
    place: Place,
    rows: &mut Rows<'_>,
) -> Result<()> {
    let mesh = place.mesh(scene.mesh())?;
    let middle = mesh.bounds().center();
    let usual = &scene.scene().views()[1];
    let view = place.view(usual)?;
    let exact = |pixel| {
        scene
            .depth_at(usual, pixel)
            .map(|depth| depth * place.scale)
    };
    let errors = Errors::of(&mesh, &view, exact)?;
    errors.put(rows, step, "ours")?;
    let pixels: Vec<DVec2> = centres(&view).step_by(STRIDE).collect();
    for arithmetic in naive::ALL {
        let found = naive::depths(arithmetic, (&mesh, middle), &view, &pixels);
        let mut worst = 0.0f64;
        for (&pixel, depth) in pixels.iter().zip(found) {
            // Here every surface counts: a plain program that misses one is wrong by all of it.
            let error = exact(pixel).map_or(0.0, |exact| (depth / exact - 1.0).abs().min(1.0));
            worst = worst.max(error);
        }
        rows.put(step, arithmetic.name, (QUANTITY, worst), None)?;
    }
    Ok(())
}

fn centres(view: &View) -> impl Iterator<Item = DVec2> {
    let (width, height) = (view.camera.width(), view.camera.height());
    (0..height).flat_map(move |row| {
        (0..width).map(move |column| DVec2::new(f64::from(column), f64::from(row)) + 0.5)
    })
}

/// How a rendered map differs from the formula.
struct Errors {
    largest: f64,
    other_surface: f64,
}

impl Errors {
    fn of(mesh: &Mesh, view: &View, exact: impl Fn(DVec2) -> Option<f64>) -> Result<Self> {
        let options = RenderOptions {
            samples: 1,
            back_faces: BackFaces::Valid,
            ..RenderOptions::default()
        };
        let depth = Renderer::new(mesh)?.render(view, &options)?.depth;
        let (mut largest, mut other, mut all) = (0.0f64, 0.0, 0.0);
        for (pixel, &found) in centres(view).zip(depth.values()) {
            let exact = exact(pixel);
            all += 1.0;
            let error = match (exact, found > 0.0) {
                (Some(exact), true) => (f64::from(found) / exact - 1.0).abs(),
                (None, false) => 0.0,
                _ => 1.0,
            };
            if error > OTHER_SURFACE {
                other += 1.0;
            } else {
                largest = largest.max(error);
            }
        }
        Ok(Self {
            largest,
            other_surface: other / all,
        })
    }

    fn put(&self, rows: &mut Rows<'_>, step: (&str, f64), arithmetic: &str) -> Result<()> {
        let bound = Some(DEPTH_BOUND);
        rows.put(step, arithmetic, (QUANTITY, self.largest), bound)?;
        let quantity = ("pixels on another surface, fraction", self.other_surface);
        rows.put(step, arithmetic, quantity, Some(1e-3))
    }
}

/// Two slanted planes before one camera: the left half near, everything else `ratio` times as far.
fn two_planes(ratio: f64) -> Result<(View, Mesh)> {
    let camera = Camera::new(160, 120, DVec2::splat(100.0), DVec2::new(80.0, 60.0))?;
    let view = View {
        id: 0,
        name: String::new(),
        camera,
        pose: Pose::new(DMat3::IDENTITY, DVec3::ZERO)?,
        depth_range: None,
    };
    let on_plane =
        |x: f64, y: f64, distance: f64| DVec3::new(x, y, 1.0) * (distance / (1.0 - SLANT * x));
    let quad = |right: f64, distance: f64| {
        [(-1.0, -1.0), (right, -1.0), (right, 1.0), (-1.0, 1.0)]
            .map(|(x, y)| on_plane(x, y, distance))
    };
    let vertices = [quad(0.0, 1.0), quad(1.0, ratio)].concat();
    let triangles = vec![[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]];
    Ok((view, Mesh::new(vertices, triangles)?))
}

/// Both planes are z − slant · x = distance.
const SLANT: f64 = 0.2;

fn two_depths(view: &View, pixel: DVec2, ratio: f64) -> f64 {
    let x = view.camera.ray(pixel).x;
    let distance = if x < 0.0 { 1.0 } else { ratio };
    distance / (1.0 - SLANT * x)
}
