//! What stands in a scene and where the cameras are, before anything is computed.

use super::rectangle::{Footprint, Rectangle, upright_box};
use super::sphere::Sphere;
use super::surface::Surface;
use super::texture::{self, Palette};
use crate::error::Result;
use crate::scene::ColorImage;
use glam::{DVec2, DVec3};
use std::sync::Arc;

/// A surface and what is painted on it.
#[derive(Debug, Clone)]
pub(super) struct Part {
    pub(super) name: String,
    pub(super) surface: Arc<dyn Surface>,
    pub(super) texture: Arc<ColorImage>,
}

/// Where a camera stands and what it looks at, in world units; +Z is up.
#[derive(Debug, Clone, Copy)]
pub(super) struct Stand {
    pub(super) eye: DVec3,
    pub(super) target: DVec3,
}

/// Surfaces and camera positions.
#[derive(Debug, Clone, Default)]
pub(super) struct Stage {
    pub(super) parts: Vec<Part>,
    pub(super) stands: Vec<Stand>,
    seed: u64,
}

/// How a part is painted.
#[derive(Debug, Clone, Copy)]
struct Paint {
    size: (u32, u32),
    cells: (u32, u32),
    palette: Palette,
}

impl Paint {
    const fn new(size: (u32, u32), cells: (u32, u32), palette: Palette) -> Self {
        Self {
            size,
            cells,
            palette,
        }
    }
}

const STONE: Palette = Palette {
    dark: [0.22, 0.20, 0.18],
    light: [0.86, 0.82, 0.74],
    accent: [0.55, 0.68, 0.40],
};
const BRICK: Palette = Palette {
    dark: [0.25, 0.08, 0.06],
    light: [0.95, 0.62, 0.42],
    accent: [0.95, 0.88, 0.72],
};
const GLAZE: Palette = Palette {
    dark: [0.05, 0.12, 0.32],
    light: [0.62, 0.86, 0.95],
    accent: [0.98, 0.80, 0.25],
};

impl Stage {
    fn add(&mut self, name: &str, surface: impl Surface + 'static, paint: Paint) -> Result<()> {
        #[allow(clippy::cast_possible_truncation, reason = "a seed; any bits will do")]
        let seed = (self.seed as u32).wrapping_mul(101) + 17 * self.parts.len() as u32;
        let canvas = texture::canvas(paint.size.0, paint.size.1)?;
        self.parts.push(Part {
            name: name.into(),
            surface: Arc::new(surface),
            texture: Arc::new(texture::draw(canvas, paint.cells, &paint.palette, seed)),
        });
        Ok(())
    }

    /// Cameras around `target` at `distance`, their elevation swinging by `swing` around
    /// `elevation` (radians).
    fn ring(&mut self, count: u32, target: DVec3, distance: f64, elevation: (f64, f64)) {
        let turn = std::f64::consts::TAU / f64::from(count);
        self.stands.extend((0..count).map(|index| {
            let azimuth = turn * (f64::from(index) + 0.5);
            let height = elevation.0 + elevation.1 * (2.0 * azimuth).sin();
            let direction = DVec3::new(
                height.cos() * azimuth.cos(),
                height.cos() * azimuth.sin(),
                height.sin(),
            );
            Stand {
                eye: target + distance * direction,
                target,
            }
        }));
    }
}

/// A box and a sphere on a square of ground, seen from all around. The sphere is sunk a little, so
/// that a ring of cameras above the ground sees all of it.
pub(super) fn tabletop(seed: u64, views: u32) -> Result<Stage> {
    let mut stage = Stage {
        seed,
        ..Stage::default()
    };
    let half = 1.05;
    let corner = DVec3::new(-half, -half, 0.0);
    let (box_center, box_size, yaw) = (
        DVec3::new(-0.45, 0.38, 0.0),
        DVec3::new(0.7, 0.5, 0.6),
        0.45,
    );
    let sphere = Sphere::new(DVec3::new(0.5, -0.42, 0.15), 0.45, 0.0);
    let in_ground = |point: DVec3| (point - corner).truncate();
    let ground = Rectangle::new(corner, 2.0 * half * DVec3::X, 2.0 * half * DVec3::Y)
        .under(Footprint::Quad {
            center: in_ground(box_center),
            half: 0.5 * box_size.truncate(),
            yaw,
        })
        .under(Footprint::Disc {
            center: in_ground(DVec3::new(0.5, -0.42, 0.0)),
            radius: sphere.rim(),
        });
    stage.add("ground", ground, Paint::new((768, 768), (8, 8), STONE))?;
    stage.add("sphere", sphere, Paint::new((768, 384), (8, 4), GLAZE))?;
    for (index, side) in upright_box(box_center, box_size, yaw)
        .into_iter()
        .enumerate()
    {
        let name = format!("box{index}");
        stage.add(&name, side, Paint::new((256, 256), (3, 3), BRICK))?;
    }
    let target = DVec3::new(0.0, 0.0, 0.2);
    stage.ring(views, target, 3.5, (0.66, 0.12));
    Ok(stage)
}

/// The largest tangents (horizontal, vertical) under which the stand's camera sees the points;
/// infinite when a point lies beside or behind it.
pub(super) fn spread(pose: &crate::scene::Pose, points: &[DVec3]) -> DVec2 {
    points.iter().fold(DVec2::ZERO, |widest, &point| {
        let in_cam = pose.to_cam(point);
        if in_cam.z <= 0.0 {
            return DVec2::INFINITY;
        }
        widest.max((in_cam.truncate() / in_cam.z).abs())
    })
}
