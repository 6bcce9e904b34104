//! What a mesh looks like: positions seen from a view, colours at a point of a triangle.

use super::light;
use super::sight::BackFaces;
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
    /// The inverse of `rotation`.
    from_cam: DMat3,
    /// The mesh's centre, in the world.
    center: DVec3,
    /// The mesh's centre, in the camera frame.
    center_in_cam: DVec3,
    back_faces: BackFaces,
    has_cutouts: bool,
    /// Per vertex, in the world, where interpolated normals are wanted.
    vertex_normals: Option<&'m [Vec3]>,
}

impl<'m> Frame<'m> {
    pub(crate) fn new(mesh: &'m Mesh, center: DVec3, view: &View) -> Self {
        let to_world = |axis| view.pose.direction_to_world(axis);
        Self {
            mesh,
            camera: view.camera,
            rotation: view.pose.rotation(),
            from_cam: DMat3::from_cols(to_world(DVec3::X), to_world(DVec3::Y), to_world(DVec3::Z)),
            center,
            center_in_cam: view.pose.to_cam(center),
            back_faces: BackFaces::default(),
            has_cutouts: mesh.materials().iter().any(|m| m.cutout.is_some()),
            vertex_normals: None,
        }
    }

    /// The same view with another rule for back faces.
    pub(crate) fn with_back_faces(self, back_faces: BackFaces) -> Self {
        Self { back_faces, ..self }
    }

    /// The same view with normals, one per vertex, to interpolate.
    pub(crate) fn with_vertex_normals(self, vertex_normals: Option<&'m [Vec3]>) -> Self {
        Self {
            vertex_normals,
            ..self
        }
    }

    /// The camera's centre, counted from the mesh's.
    pub(crate) fn eye(&self) -> DVec3 {
        -self.to_world(self.center_in_cam)
    }

    /// A direction of the camera frame in the world.
    pub(crate) fn to_world(self, direction: DVec3) -> DVec3 {
        self.from_cam * direction
    }

    /// Whether any material is cut out somewhere.
    pub(crate) fn has_cutouts(&self) -> bool {
        self.has_cutouts
    }

    /// Whether the triangle has surface at a point with barycentric `weights`.
    pub(crate) fn is_solid(&self, triangle: usize, weights: [f64; 2]) -> bool {
        !self.has_cutouts || is_solid(self.mesh, triangle, weights)
    }

    fn is_one_sided(&self, triangle: usize) -> bool {
        self.back_faces == BackFaces::Invalid && !self.mesh.material_of(triangle).double_sided
    }

    /// Whether interpolated normals are wanted.
    pub(crate) fn has_vertex_normals(&self) -> bool {
        self.vertex_normals.is_some()
    }

    /// The unit normal interpolated between the corners' on the side that is seen along `direction`;
    /// the triangle's own where that would face away.
    pub(crate) fn interpolated_normal(
        &self,
        (triangle, facet): (usize, &Facet),
        weights: [f64; 2],
        direction: DVec3,
    ) -> DVec3 {
        let facing = facet.facing_normal(direction);
        let Some(normals) = self.vertex_normals else {
            return facing;
        };
        let [a, b, c] =
            self.mesh.triangles()[triangle].map(|vertex| normals[vertex as usize].as_dvec3());
        let [v, w] = weights;
        let normal = (self.rotation * (a * (1.0 - v - w) + b * v + c * w)).normalize_or_zero();
        let seen = if facet.is_back(direction) {
            -normal
        } else {
            normal
        };
        if seen.dot(direction) < 0.0 {
            seen
        } else {
            facing
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
            one_sided: self.is_one_sided(triangle),
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
            volume: a.dot(first),
            normal: (b - a).cross(c - a),
            one_sided: self.is_one_sided(triangle),
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
    one_sided: bool,
}

impl Facet {
    /// As [`Frame::cross`].
    pub(crate) fn cross(&self, direction: DVec3) -> Option<Crossing> {
        cross(self.corners, direction)
    }

    /// Whether the side seen along `direction` is the back.
    fn is_back(&self, direction: DVec3) -> bool {
        self.normal.dot(direction) > 0.0
    }

    /// Whether the side seen along `direction` is no surface.
    pub(crate) fn is_hollow(&self, direction: DVec3) -> bool {
        self.one_sided && self.is_back(direction)
    }

    /// The unit normal on the side that is seen along `direction`.
    pub(crate) fn facing_normal(&self, direction: DVec3) -> DVec3 {
        if self.is_back(direction) {
            -self.normal
        } else {
            self.normal
        }
    }
}

/// A triangle's surface as seen from a view. Barycentric weights and depth are ratios of linear
/// functions of the direction.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Patch<'m> {
    second: DVec3,
    third: DVec3,
    total: DVec3,
    volume: f64,
    normal: DVec3,
    one_sided: bool,
    look: Look<'m>,
}

/// What is seen along a direction that meets a triangle.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Glimpse {
    /// In 8-bit sRGB units: from the material's texture, else from vertex colours, else the
    /// material's own.
    pub(crate) color: Vec3,
    /// About the z-depth.
    pub(crate) depth: f64,
    /// Whether this is the back of a one-sided triangle.
    pub(crate) back: bool,
}

impl Patch<'_> {
    /// What a direction sees that meets the triangle.
    pub(crate) fn glimpse(&self, direction: DVec3) -> Glimpse {
        let scale = 1.0 / self.total.dot(direction);
        #[allow(clippy::cast_possible_truncation, reason = "colours need no f64")]
        let weights = [self.second, self.third].map(|side| (side.dot(direction) * scale) as f32);
        Glimpse {
            color: self.look.color(weights),
            depth: self.volume * scale,
            back: self.one_sided && self.normal.dot(direction) > 0.0,
        }
    }
}

/// Where a triangle's colours come from.
#[derive(Debug, Clone, Copy)]
enum Look<'m> {
    Texture(&'m ColorImage, Corner, Border),
    Tinted(&'m ColorImage, (Corner, Border), [Vec3; 3]),
    Vertices([Vec3; 3]),
    Plain(Vec3),
}

impl<'m> Look<'m> {
    fn of(mesh: &'m Mesh, triangle: usize) -> Self {
        let material = mesh.material_of(triangle);
        let colors = mesh.vertex_colors().map(|colors| {
            let color = |vertex: u32| Vec3::from(colors[vertex as usize].map(f32::from));
            mesh.triangles()[triangle].map(color)
        });
        if let (Some(texture), Some(coords)) = (&material.texture, mesh.texture_coords()) {
            let corners = coords[triangle];
            let border = Border::of(&corners);
            return match colors.filter(|_| material.tinted) {
                Some(colors) => {
                    Self::Tinted(texture, (corners, border), colors.map(light::to_linear))
                }
                None => Self::Texture(texture, corners, border),
            };
        }
        if let Some(colors) = colors {
            return Self::Vertices(colors);
        }
        Self::Plain(Vec3::from(material.color.map(f32::from)))
    }

    fn color(&self, [v, w]: [f32; 2]) -> Vec3 {
        match self {
            Self::Texture(texture, corners, border) => {
                texture::bilinear(texture, between(*corners, [v, w]), *border)
            }
            Self::Tinted(texture, (corners, border), tints) => {
                let color = texture::bilinear(texture, between(*corners, [v, w]), *border);
                let tint = between(*tints, [v, w]).clamp(Vec3::ZERO, Vec3::ONE);
                light::to_srgb(light::to_linear(color) * tint)
            }
            Self::Vertices(corners) => {
                between(*corners, [v, w]).clamp(Vec3::ZERO, Vec3::splat(255.0))
            }
            Self::Plain(color) => *color,
        }
    }
}

/// The value at barycentric weights of the second and third corner.
fn between<T>([a, b, c]: [T; 3], [v, w]: [f32; 2]) -> T
where
    T: std::ops::Mul<f32, Output = T> + std::ops::Add<Output = T>,
{
    a * (1.0 - v - w) + b * v + c * w
}

/// Whether a triangle has surface at a point, that is, is not cut out there.
pub(crate) fn is_solid(mesh: &Mesh, triangle: usize, weights: [f64; 2]) -> bool {
    let Some(cutout) = &mesh.material_of(triangle).cutout else {
        return true;
    };
    let Some(coords) = mesh.texture_coords() else {
        return true;
    };
    let corners = coords[triangle];
    #[allow(clippy::cast_possible_truncation, reason = "textures need no f64")]
    let at = between(corners, weights.map(|weight| weight as f32));
    texture::bilinear_gray(&cutout.opacity, at, Border::of(&corners)) >= cutout.cutoff
}

/// A unit normal per vertex in the world: the sum over its triangles, weighted by area; zero where
/// there is none.
pub(crate) fn vertex_normals(mesh: &Mesh) -> Vec<Vec3> {
    let mut sums = vec![DVec3::ZERO; mesh.vertices().len()];
    for (index, triangle) in mesh.triangles().iter().enumerate() {
        let [a, b, c] = mesh.corners(index);
        let normal = (b - a).cross(c - a);
        for &vertex in triangle {
            sums[vertex as usize] += normal;
        }
    }
    let unit = |sum: DVec3| sum.normalize_or_zero().as_vec3();
    sums.into_iter().map(unit).collect()
}
