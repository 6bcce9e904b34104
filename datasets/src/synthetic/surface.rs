//! What every exact surface can do.

use super::random::Random;
use glam::{DVec2, DVec3, Vec2};

/// A ray in world coordinates: origin + t · direction.
#[derive(Debug, Clone, Copy)]
pub(super) struct Ray {
    pub(super) origin: DVec3,
    pub(super) direction: DVec3,
}

impl Ray {
    /// The point at `t`.
    pub(super) fn at(&self, t: f64) -> DVec3 {
        self.origin + t * self.direction
    }
}

/// A point of a surface.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sample {
    pub(super) position: DVec3,
    /// Unit, outward.
    pub(super) normal: DVec3,
    /// Texture coordinates, (0, 0) bottom left.
    pub(super) uv: DVec2,
}

/// A surface with closed forms, part of a scene. It is exposed except where another solid covers it.
pub(super) trait Surface: std::fmt::Debug + Send + Sync {
    /// The smallest t > 0 at which the ray meets the surface.
    fn hit(&self, ray: &Ray) -> Option<f64>;

    /// Distance from `point` to the nearest exposed point of the surface.
    fn distance(&self, point: DVec3) -> f64;

    /// Exposed points, uniform by area, about `spacing` apart.
    fn sample(&self, spacing: f64, random: &mut Random) -> Vec<Sample>;

    /// The area of the surface, covered parts included.
    fn area(&self) -> f64;

    /// Points whose convex hull holds the surface.
    fn outline(&self) -> Vec<DVec3>;

    /// The surface as triangles.
    fn patch(&self) -> Patch;
}

/// Triangles of one surface.
#[derive(Debug, Clone)]
pub(super) struct Patch {
    pub(super) vertices: Vec<DVec3>,
    pub(super) triangles: Vec<[u32; 3]>,
    pub(super) uvs: Vec<[Vec2; 3]>,
    /// The largest distance from a point of a triangle to the surface.
    pub(super) deviation: f64,
}

impl Patch {
    /// A grid of `columns` × `rows` cells over the texture square, each of two triangles;
    /// triangles without area (at a pole) are left out.
    pub(super) fn grid(columns: u32, rows: u32, position: impl Fn(DVec2) -> DVec3) -> Self {
        let uv = |column: u32, row: u32| {
            DVec2::new(
                f64::from(column) / f64::from(columns),
                f64::from(row) / f64::from(rows),
            )
        };
        let index = |column: u32, row: u32| row * (columns + 1) + column;
        let mut patch = Self {
            vertices: Vec::new(),
            triangles: Vec::new(),
            uvs: Vec::new(),
            deviation: 0.0,
        };
        for row in 0..=rows {
            let along = (0..=columns).map(|column| position(uv(column, row)));
            patch.vertices.extend(along);
        }
        for row in 0..rows {
            for column in 0..columns {
                let [a, b] = [(column, row), (column + 1, row)];
                let [c, d] = [(column + 1, row + 1), (column, row + 1)];
                for corners in [[a, b, c], [a, c, d]] {
                    let triangle = corners.map(|(column, row)| index(column, row));
                    let uvs = corners.map(|(column, row)| uv(column, row).as_vec2());
                    patch.push(triangle, uvs);
                }
            }
        }
        patch
    }

    fn push(&mut self, triangle: [u32; 3], uvs: [Vec2; 3]) {
        let [a, b, c] = triangle.map(|vertex| self.vertices[vertex as usize]);
        let longest = (b - a).length().max((c - a).length());
        if (b - a).cross(c - a).length() > 1e-9 * longest * longest {
            self.triangles.push(triangle);
            self.uvs.push(uvs);
        }
    }
}

/// How many cells of about `spacing` cover `length`; at least one.
pub(super) fn cells(length: f64, spacing: f64) -> u32 {
    #[allow(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "the caller bounds the number of samples; the cast saturates"
    )]
    let count = (length / spacing).round().max(1.0) as u32;
    count
}

/// One point in each cell of a grid of `columns` × `rows`, jittered by up to a quarter of a cell,
/// in coordinates 0 to 1.
pub(super) fn jittered_grid(columns: u32, rows: u32, random: &mut Random) -> Vec<DVec2> {
    let mut points = Vec::with_capacity(columns as usize * rows as usize);
    for row in 0..rows {
        for column in 0..columns {
            let u = (f64::from(column) + random.between(0.25, 0.75)) / f64::from(columns);
            let v = (f64::from(row) + random.between(0.25, 0.75)) / f64::from(rows);
            points.push(DVec2::new(u, v));
        }
    }
    points
}
