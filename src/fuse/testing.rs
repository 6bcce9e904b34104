//! Random views and analytic estimates for this module's tests.

use super::{Columns, Estimate, Points};
use glam::{DQuat, DVec2, DVec3};
use mvs_datasets::scene::{Camera, DepthMap, Pose, View};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

pub(crate) fn rng(seed: u64) -> ChaCha8Rng {
    ChaCha8Rng::seed_from_u64(seed)
}

pub(crate) fn uniform(random: &mut ChaCha8Rng, low: f64, high: f64) -> f64 {
    let unit = (random.next_u64() >> 11) as f64 / (1u64 << 53) as f64;
    low + (high - low) * unit
}

pub(crate) fn view(id: u32, camera: Camera, pose: Pose) -> View {
    View {
        id,
        name: String::new(),
        camera,
        pose,
        depth_range: None,
    }
}

/// A 640×480 view somewhere within 3 units of the origin, turned any way.
pub(crate) fn random_view(random: &mut ChaCha8Rng, id: u32) -> View {
    let mut draw = |low, high| uniform(random, low, high);
    let focal = DVec2::new(draw(300.0, 900.0), draw(300.0, 900.0));
    let center = DVec2::new(draw(300.0, 340.0), draw(220.0, 260.0));
    let camera = Camera::new(640, 480, focal, center).unwrap();
    let turn = DQuat::from_xyzw(draw(-1.0, 1.0), draw(-1.0, 1.0), draw(-1.0, 1.0), 0.3).normalize();
    let translation = DVec3::new(draw(-3.0, 3.0), draw(-3.0, 3.0), draw(-3.0, 3.0));
    let pose = Pose::new(glam::DMat3::from_quat(turn), translation).unwrap();
    view(id, camera, pose)
}

/// A plane: points x with normal·x = offset.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Plane {
    pub(crate) normal: DVec3,
    pub(crate) offset: f64,
}

impl Plane {
    /// One that no camera of [`arc`] looks at head-on.
    pub(super) fn tilted() -> Self {
        Self {
            normal: DVec3::new(0.2, -0.3, 1.0).normalize(),
            offset: 0.1,
        }
    }

    /// z-depth of the plane along the ray through `pixel` of `view`, 0 where it does not meet it.
    pub(crate) fn depth(&self, view: &View, pixel: DVec2) -> f64 {
        let center = view.pose.center_in_world();
        let ray = view.pose.direction_to_world(view.camera.ray(pixel));
        let depth = (self.offset - self.normal.dot(center)) / self.normal.dot(ray);
        if depth.is_finite() && depth > 0.0 {
            depth
        } else {
            0.0
        }
    }
}

/// Exact depth of `surface(view, pixel)` at the pixel centres.
pub(crate) fn depth_map(view: &View, surface: impl Fn(&View, DVec2) -> f64) -> DepthMap {
    let (width, height) = (view.camera.width(), view.camera.height());
    let mut values = Vec::new();
    for row in 0..height {
        for column in 0..width {
            let pixel = DVec2::new(f64::from(column) + 0.5, f64::from(row) + 0.5);
            values.push(surface(view, pixel) as f32);
        }
    }
    DepthMap::from_values(width, height, values).unwrap().0
}

/// `count` views on an arc around `target + distance` looking at `target`, every other view a
/// source of each, with the exact depth of `surface`.
pub(crate) fn arc(
    count: usize,
    size: (u32, u32),
    target: DVec3,
    surface: impl Fn(&View, DVec2) -> f64,
) -> Vec<Estimate> {
    (0..count)
        .map(|index| {
            let angle = 0.12 * (index as f64 - 0.5 * (count as f64 - 1.0));
            let eye =
                target + 4.0 * DVec3::new(angle.sin(), 0.15 * (index % 3) as f64, angle.cos());
            let pose = Pose::looking_at(eye, target, DVec3::Y).unwrap();
            let focal = DVec2::splat(1.2 * f64::from(size.0));
            let center = DVec2::new(0.5 * f64::from(size.0) + 1.3, 0.5 * f64::from(size.1) - 0.7);
            let camera = Camera::new(size.0, size.1, focal, center).unwrap();
            let view = view(index as u32, camera, pose);
            Estimate {
                depth: depth_map(&view, &surface),
                view,
                confidence: None,
                image: None,
                sources: (0..count).filter(|&other| other != index).collect(),
            }
        })
        .collect()
}

/// Makes depths worse: Gaussian-like noise of `sigma` relative, outliers, and holes of 7×7 pixels.
pub(crate) fn spoil(estimate: &mut Estimate, seed: u64, sigma: f64, outliers: f64, holes: u32) {
    let mut random = rng(seed);
    let (width, height) = estimate.depth.size();
    let mut values = estimate.depth.values().to_vec();
    for value in &mut values {
        let noise: f64 = (0..6).map(|_| uniform(&mut random, -0.5, 0.5)).sum();
        *value *= (1.0 + sigma * noise * 2f64.sqrt()) as f32;
        if uniform(&mut random, 0.0, 1.0) < outliers {
            *value *= uniform(&mut random, 0.6, 1.6) as f32;
        }
    }
    for _ in 0..holes {
        let column = uniform(&mut random, 0.0, f64::from(width)) as u32;
        let row = uniform(&mut random, 0.0, f64::from(height)) as u32;
        for y in row..(row + 7).min(height) {
            for x in column..(column + 7).min(width) {
                values[(y * width + x) as usize] = 0.0;
            }
        }
    }
    estimate.depth = DepthMap::from_values(width, height, values).unwrap().0;
}

/// The rows of bytes of points, one after the other.
pub(crate) fn as_bytes(points: &Points, columns: Columns) -> Vec<u8> {
    let mut bytes = Vec::new();
    for at in 0..points.len() {
        let position = points.positions[at].to_array();
        match columns.has(Columns::DOUBLES) {
            true => bytes.extend(position.into_iter().flat_map(f64::to_le_bytes)),
            false => bytes.extend(
                position
                    .map(|value| value as f32)
                    .into_iter()
                    .flat_map(f32::to_le_bytes),
            ),
        }
        if columns.has(Columns::NORMALS) {
            let normal = points.normals[at].to_array();
            bytes.extend(normal.into_iter().flat_map(f32::to_le_bytes));
        }
        if columns.has(Columns::COLORS) {
            bytes.extend(points.colors[at]);
        }
        let number = |views: u32| match columns.has(Columns::MANY) {
            true => (views as f32).to_le_bytes().to_vec(),
            false => vec![views as u8],
        };
        bytes.extend(number(points.view_counts[at]));
        if columns.has(Columns::CONFIDENCES) {
            bytes.extend(points.confidences[at].to_le_bytes());
        }
        if columns.has(Columns::EXTRAS) {
            bytes.extend(number(points.violations[at]));
            bytes.extend(points.scales[at].to_le_bytes());
        }
    }
    bytes
}
