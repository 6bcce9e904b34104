//! What a mesh looks like: positions seen from a view, colours at a point of a triangle.

use super::texture::{self, Border};
use super::triangle::{Crossing, Ray};
use glam::{DMat3, DVec3, Vec3};
use mvs_datasets::scene::{Camera, ColorImage, Corner, Mesh, View};

/// A view of a mesh whose vertices are counted from the mesh's centre, so that large world
/// offsets cost no precision.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Frame<'m> {
    mesh: &'m Mesh,
    camera: Camera,
    rotation: DMat3,
    /// The mesh's centre, in the world.
    center: DVec3,
    /// The mesh's centre, in the camera frame.
    center_in_cam: DVec3,
}

impl<'m> Frame<'m> {
    pub(crate) fn new(mesh: &'m Mesh, center: DVec3, view: &View) -> Self {
        Self {
            mesh,
            camera: view.camera,
            rotation: view.pose.rotation(),
            center,
            center_in_cam: view.pose.to_cam(center),
        }
    }

    pub(crate) fn camera(&self) -> Camera {
        self.camera
    }

    /// From the world to the camera.
    pub(crate) fn rotation(&self) -> DMat3 {
        self.rotation
    }

    /// The mesh's centre, in the camera frame.
    pub(crate) fn center_in_cam(&self) -> DVec3 {
        self.center_in_cam
    }

    /// Vertices of a triangle.
    #[inline]
    pub(crate) fn vertices_of(&self, triangle: usize) -> [u32; 3] {
        self.mesh.triangles()[triangle]
    }

    /// A vertex, counted from the mesh's centre.
    #[inline]
    pub(crate) fn offset_of(&self, vertex: u32) -> DVec3 {
        self.mesh.vertices()[vertex as usize] - self.center
    }

    /// Corners of a triangle in the camera frame.
    pub(crate) fn corners(&self, triangle: usize) -> [DVec3; 3] {
        let to_cam = |corner| self.rotation * (corner - self.center) + self.center_in_cam;
        self.mesh.corners(triangle).map(to_cam)
    }

    /// Where the ray through `direction` of the camera frame, with z = 1, meets the triangle in front of
    /// the camera; the distance is the z-depth. This decides all visibility.
    pub(crate) fn cross(&self, triangle: usize, direction: DVec3) -> Option<Crossing> {
        cross(self.corners(triangle), direction)
    }

    /// A triangle as the camera sees it.
    pub(crate) fn facet(&self, triangle: usize) -> Facet {
        let corners = self.corners(triangle);
        let [a, b, c] = corners;
        Facet {
            corners,
            normal: (b - a).cross(c - a).normalize_or_zero(),
        }
    }

    /// The surface of a triangle, for its colours.
    pub(crate) fn patch(&self, triangle: usize) -> Patch<'m> {
        let [a, b, c] = self.corners(triangle);
        let (first, second, third) = (c.cross(b), a.cross(c), b.cross(a));
        Patch {
            second,
            third,
            total: first + second + third,
            look: Look::of(self.mesh, triangle),
        }
    }
}

fn cross(corners: [DVec3; 3], direction: DVec3) -> Option<Crossing> {
    Ray::of_pixel(direction)
        .cross(corners)
        .filter(|crossing| crossing.distance > 0.0)
}

/// A triangle in the camera frame.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Facet {
    corners: [DVec3; 3],
    /// By the corners' order; zero for a triangle without area.
    normal: DVec3,
}

impl Facet {
    /// As [`Frame::cross`].
    pub(crate) fn cross(&self, direction: DVec3) -> Option<Crossing> {
        cross(self.corners, direction)
    }

    /// The unit normal on the side that is seen along `direction`.
    pub(crate) fn facing_normal(&self, direction: DVec3) -> DVec3 {
        if self.normal.dot(direction) > 0.0 {
            -self.normal
        } else {
            self.normal
        }
    }
}

/// A triangle's surface as seen from a view. Barycentric weights are ratios of linear functions of
/// the direction.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Patch<'m> {
    second: DVec3,
    third: DVec3,
    total: DVec3,
    look: Look<'m>,
}

impl Patch<'_> {
    /// The colour seen along a direction that meets the triangle, in 8-bit sRGB units: from the
    /// material's texture, else from vertex colours, else the material's own.
    pub(crate) fn color(&self, direction: DVec3) -> Vec3 {
        let scale = 1.0 / self.total.dot(direction);
        #[allow(clippy::cast_possible_truncation, reason = "colours need no f64")]
        let weights = [self.second, self.third].map(|side| (side.dot(direction) * scale) as f32);
        self.look.color(weights)
    }
}

/// Where a triangle's colours come from.
#[derive(Debug, Clone, Copy)]
enum Look<'m> {
    Texture(&'m ColorImage, Corner, Border),
    Vertices([Vec3; 3]),
    Plain(Vec3),
}

impl<'m> Look<'m> {
    fn of(mesh: &'m Mesh, triangle: usize) -> Self {
        let material = mesh.material_of(triangle);
        if let (Some(texture), Some(coords)) = (&material.texture, mesh.texture_coords()) {
            let corners = coords[triangle];
            return Self::Texture(texture, corners, Border::of(&corners));
        }
        if let Some(colors) = mesh.vertex_colors() {
            let color = |vertex: u32| Vec3::from(colors[vertex as usize].map(f32::from));
            return Self::Vertices(mesh.triangles()[triangle].map(color));
        }
        Self::Plain(Vec3::from(material.color.map(f32::from)))
    }

    fn color(&self, [v, w]: [f32; 2]) -> Vec3 {
        match self {
            Self::Texture(texture, [a, b, c], border) => {
                texture::bilinear(texture, *a * (1.0 - v - w) + *b * v + *c * w, *border)
            }
            Self::Vertices([a, b, c]) => {
                (*a * (1.0 - v - w) + *b * v + *c * w).clamp(Vec3::ZERO, Vec3::splat(255.0))
            }
            Self::Plain(color) => *color,
        }
    }
}
