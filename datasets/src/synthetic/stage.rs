//! What stands in a scene and where the cameras are, before anything is computed.

use super::SceneKind;
use super::rectangle::{Footprint, Rectangle, standing_box, upright_box};
use super::sphere::Sphere;
use super::surface::Surface;
use super::texture::{self, Palette};
use super::tube::Tube;
use crate::error::Result;
use crate::scene::ColorImage;
use glam::{DVec2, DVec3};
use libm::{cos, sin};
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
    /// Tangent of half the horizontal field of view; `None` stands for what shows everything.
    pub(super) reach: Option<f64>,
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
            let height = elevation.0 + elevation.1 * sin(2.0 * azimuth);
            let direction = DVec3::new(
                cos(height) * cos(azimuth),
                cos(height) * sin(azimuth),
                sin(height),
            );
            Stand {
                eye: target + distance * direction,
                target,
            }
        }));
    }
}

/// The surfaces and cameras of a kind of scene.
pub(super) fn stage(kind: SceneKind, seed: u64, views: u32) -> Result<Stage> {
    let mut stage = Stage {
        seed,
        ..Stage::default()
    };
    match kind {
        SceneKind::Tabletop => tabletop(&mut stage, views)?,
        SceneKind::Object => object(&mut stage, views)?,
        SceneKind::Facade => facade(&mut stage, views)?,
        SceneKind::Outdoor => outdoor(&mut stage, views)?,
        SceneKind::Thin => thin(&mut stage, views)?,
    }
    Ok(stage)
}

/// A square of ground around the origin, `half` its edge, at z = 0.
fn ground(half: f64) -> Rectangle {
    let corner = DVec3::new(-half, -half, 0.0);
    Rectangle::new(corner, 2.0 * half * DVec3::X, 2.0 * half * DVec3::Y)
}

/// Where a solid stands on such a square.
fn quad(half_ground: f64, center: DVec3, size: DVec3, yaw: f64) -> Footprint {
    Footprint::Quad {
        center: center.truncate() + DVec2::splat(half_ground),
        half: 0.5 * size.truncate(),
        yaw,
    }
}

fn disc(half_ground: f64, center: DVec3, radius: f64) -> Footprint {
    Footprint::Disc {
        center: center.truncate() + DVec2::splat(half_ground),
        radius,
    }
}

/// A box and a sphere on a square of ground, seen from all around. The sphere is sunk a little, so
/// that a ring of cameras above the ground sees all of it.
fn tabletop(stage: &mut Stage, views: u32) -> Result<()> {
    let half = 1.05;
    let (foot, size, yaw) = (
        DVec3::new(-0.45, 0.38, 0.0),
        DVec3::new(0.7, 0.5, 0.6),
        0.45,
    );
    let middle = DVec3::new(0.5, -0.42, 0.15);
    let sphere = Sphere::new(middle, 0.45, 0.0);
    let ground =
        ground(half)
            .under(quad(half, foot, size, yaw))
            .under(disc(half, middle, sphere.rim()));
    stage.add("ground", ground, Paint::new((768, 768), (8, 8), STONE))?;
    stage.add("sphere", sphere, Paint::new((768, 384), (8, 4), GLAZE))?;
    for (index, side) in upright_box(foot, size, yaw).into_iter().enumerate() {
        let paint = Paint::new((256, 256), (3, 3), BRICK);
        stage.add(&format!("box{index}"), side, paint)?;
    }
    stage.ring(views, DVec3::new(0.0, 0.0, 0.2), 3.5, (0.66, 0.12));
    Ok(())
}

/// A ball on a small square of ground, photographed from one side only: an arc of a third of a
/// turn. Its back is never seen.
fn object(stage: &mut Stage, views: u32) -> Result<()> {
    let half = 0.7;
    let middle = DVec3::new(0.0, 0.0, 0.3);
    let sphere = Sphere::new(middle, 0.5, 0.0).with_cells(288);
    let ground = ground(half).under(disc(half, middle, sphere.rim()));
    stage.add("ground", ground, Paint::new((512, 512), (6, 6), STONE))?;
    stage.add("ball", sphere, Paint::new((1024, 512), (10, 5), GLAZE))?;
    let step = std::f64::consts::TAU / 3.0 / f64::from(views - 1);
    let target = DVec3::new(0.0, 0.0, 0.25);
    stage.stands.extend((0..views).map(|index| {
        let azimuth = step * f64::from(index);
        let direction = DVec3::new(cos(azimuth), sin(azimuth), 0.7).normalize();
        Stand {
            eye: target + 2.5 * direction,
            target,
        }
    }));
    Ok(())
}

/// A wall with bays, photographed by walking along it.
fn facade(stage: &mut Stage, views: u32) -> Result<()> {
    let (width, height) = (8.0, 4.0);
    let corner = DVec3::new(-0.5 * width, 0.0, 0.0);
    let mut wall = Rectangle::new(corner, width * DVec3::X, height * DVec3::Z);
    let mut bays = Vec::new();
    for (column, row) in (0..8).map(|bay| (bay % 4, bay / 4)) {
        let place = DVec2::new(0.5 + 2.0 * f64::from(column), 0.5 + 2.0 * f64::from(row));
        let (size, depth) = (DVec2::new(1.0, 1.0), 0.15 + 0.1 * f64::from(column));
        wall = wall.under(Footprint::Quad {
            center: place + 0.5 * size,
            half: 0.5 * size,
            yaw: 0.0,
        });
        let base = corner + DVec3::new(place.x, 0.0, place.y);
        let out = depth * DVec3::NEG_Y;
        bays.extend(standing_box(
            base,
            size.x * DVec3::X,
            size.y * DVec3::Z,
            out,
        ));
    }
    stage.add("wall", wall, Paint::new((1024, 512), (16, 8), BRICK))?;
    for (index, side) in bays.into_iter().enumerate() {
        let paint = Paint::new((128, 128), (2, 2), STONE);
        stage.add(&format!("bay{index}"), side, paint)?;
    }
    let step = 6.0 / f64::from(views - 1);
    stage.stands.extend((0..views).map(|index| {
        let x = step * f64::from(index) - 3.0;
        // Up and down a little, so that upper and lower faces of the bays are seen.
        let z = 2.0 + if index % 2 == 0 { 1.8 } else { -1.8 };
        Stand {
            eye: DVec3::new(x, -6.0, z),
            target: DVec3::new(0.5 * x, 0.0, 2.0),
        }
    }));
    Ok(())
}

/// Three buildings in a wide plain with hills' worth of background far behind: depths from a few
/// units to over a hundred. Cameras see parts of it only.
fn outdoor(stage: &mut Stage, views: u32) -> Result<()> {
    let half = 90.0;
    let buildings = [
        (DVec3::new(0.0, 2.0, 0.0), DVec3::new(6.0, 4.0, 5.0), 0.3),
        (DVec3::new(-11.0, 9.0, 0.0), DVec3::new(5.0, 5.0, 8.0), -0.5),
        (DVec3::new(14.0, 16.0, 0.0), DVec3::new(9.0, 5.0, 4.0), 0.1),
    ];
    let plain = buildings
        .iter()
        .fold(ground(half), |plain, &(foot, size, yaw)| {
            plain.under(quad(half, foot, size, yaw))
        });
    stage.add("plain", plain, Paint::new((1536, 1536), (64, 64), STONE))?;
    let corner = DVec3::new(-half, half, 0.0);
    let backdrop = Rectangle::new(corner, 2.0 * half * DVec3::X, 30.0 * DVec3::Z);
    stage.add(
        "backdrop",
        backdrop,
        Paint::new((1536, 256), (48, 8), GLAZE),
    )?;
    for (index, &(foot, size, yaw)) in buildings.iter().enumerate() {
        for (side, face) in upright_box(foot, size, yaw).into_iter().enumerate() {
            let paint = Paint::new((256, 256), (5, 5), BRICK);
            stage.add(&format!("building{index}_{side}"), face, paint)?;
        }
    }
    let step = 16.0 / f64::from(views - 1);
    stage.stands.extend((0..views).map(|index| {
        let x = step * f64::from(index) - 8.0;
        Stand {
            eye: DVec3::new(x, -10.0 - 0.05 * x * x, 3.0 + 0.2 * f64::from(index % 3)),
            target: DVec3::new(0.3 * x, 6.0, 2.5),
        }
    }));
    stage.reach = Some(0.7);
    Ok(())
}

/// Thin posts with round heads on a square of ground: a few pixels wide, in front of each other.
fn thin(stage: &mut Stage, views: u32) -> Result<()> {
    let (half, radius, height) = (1.0, 0.02, 0.8);
    let places = (0..9u32).map(|post| {
        let (column, row) = (f64::from(post % 3) - 1.0, f64::from(post / 3) - 1.0);
        DVec3::new(0.6 * column + 0.1 * row, 0.6 * row - 0.1 * column, 0.0)
    });
    let places: Vec<DVec3> = places.collect();
    let ground = places.iter().fold(ground(half), |ground, &foot| {
        ground.under(disc(half, foot, radius))
    });
    stage.add("ground", ground, Paint::new((768, 768), (8, 8), STONE))?;
    for (index, foot) in places.into_iter().enumerate() {
        let paint = Paint::new((64, 512), (2, 16), BRICK);
        stage.add(
            &format!("post{index}"),
            Tube::new(foot, height, radius),
            paint,
        )?;
        let top = foot + height * DVec3::Z;
        let head = Sphere::new(top, radius, top.z).with_cells(48);
        stage.add(
            &format!("head{index}"),
            head,
            Paint::new((64, 32), (2, 1), GLAZE),
        )?;
    }
    stage.ring(views, DVec3::new(0.0, 0.0, 0.3), 3.2, (0.55, 0.1));
    Ok(())
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
