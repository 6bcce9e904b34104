//! What a mesh looks like: positions seen from a view, colours at a point of a triangle.

use super::texture::{self, Border};
use super::triangle::{Crossing, Ray};
use glam::{DMat3, DVec2, DVec3, Vec2, Vec3};
use mvs_datasets::scene::{Camera, Mesh, View};

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

    /// The mesh's centre, in the camera frame.
    pub(crate) fn center_in_cam(&self) -> DVec3 {
        self.center_in_cam
    }

    /// Corners of a triangle in the camera frame.
    pub(crate) fn corners(&self, triangle: usize) -> [DVec3; 3] {
        let to_cam = |corner| self.rotation * (corner - self.center) + self.center_in_cam;
        self.mesh.corners(triangle).map(to_cam)
    }

    /// The point at depth 1 behind continuous image coordinates.
    pub(crate) fn direction(&self, pixel: DVec2) -> DVec3 {
        self.camera.ray(pixel)
    }

    /// Where the ray through `direction` (see [`Self::direction`]) meets the triangle in front of
    /// the camera; the distance is the z-depth. This decides all visibility.
    pub(crate) fn cross(&self, triangle: usize, direction: DVec3) -> Option<Crossing> {
        Ray::of_pixel(direction)
            .cross(self.corners(triangle))
            .filter(|crossing| crossing.distance > 0.0)
    }

    /// The triangle's unit normal in the camera frame, facing the camera as seen along
    /// `direction`; zero for a triangle without area.
    pub(crate) fn facing_normal(&self, triangle: usize, direction: DVec3) -> DVec3 {
        let [a, b, c] = self.corners(triangle);
        let normal = (b - a).cross(c - a).normalize_or_zero();
        if normal.dot(direction) > 0.0 {
            -normal
        } else {
            normal
        }
    }

    /// The colour at barycentric `weights` of a triangle's second and third corner, in 8-bit sRGB
    /// units: from the material's texture, else from vertex colours, else the material's own.
    pub(crate) fn color(&self, triangle: usize, weights: [f64; 2]) -> Vec3 {
        let material = self.mesh.material_of(triangle);
        #[allow(clippy::cast_possible_truncation, reason = "colours need no f64")]
        let [v, w] = weights.map(|weight| weight as f32);
        if let (Some(texture), Some(coords)) = (&material.texture, self.mesh.texture_coords()) {
            let corners = &coords[triangle];
            let coord: Vec2 = corners[0] * (1.0 - v - w) + corners[1] * v + corners[2] * w;
            return texture::bilinear(texture, coord, Border::of(corners));
        }
        if let Some(colors) = self.mesh.vertex_colors() {
            let [a, b, c] = self.mesh.triangles()[triangle]
                .map(|vertex| Vec3::from(colors[vertex as usize].map(f32::from)));
            return a * (1.0 - v - w) + b * v + c * w;
        }
        Vec3::from(material.color.map(f32::from))
    }
}
