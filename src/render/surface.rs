//! What a mesh looks like: positions seen from a view, colours at a point of a triangle.

use super::lanes::{Lanes, Plain};
use super::light;
use super::sight::BackFaces;
use super::texture::{self, Border, Parts, Texels};
use super::triangle::{Crossing, Ray};
use glam::{DMat3, DVec3, Vec3};
use mvs_datasets::scene::{Camera, Corner, Mesh, View};

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

    pub(crate) fn mesh(&self) -> &'m Mesh {
        self.mesh
    }

    /// From the world to the camera.
    pub(crate) fn rotation(&self) -> DMat3 {
        self.rotation
    }

    /// The mesh's centre, in the world.
    pub(crate) fn center(&self) -> DVec3 {
        self.center
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
        let (along, across) = (b - a, c - a);
        let normal = along.cross(across);
        let volume = normal.dot(a);
        let paint = Paint::of(self.mesh, triangle);
        // Weights of the second and third corner, times the normal's share of the direction.
        let (second, third) = (across.cross(a), a.cross(along));
        let [x, y] = match &paint {
            Paint::Texture(texels, corners) => {
                let [a, b, c] = corners.map(|corner| texels.place(corner));
                let mixed =
                    |k: usize| a[k] * normal + (b[k] - a[k]) * second + (c[k] - a[k]) * third;
                [mixed(0), mixed(1)]
            }
            Paint::Tinted(..) | Paint::Light(_) | Paint::Linear(_) => [second, third],
        };
        Patch {
            x,
            y,
            normal,
            volume,
            back: self.is_one_sided(triangle) && volume > 0.0,
            paint,
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

    /// Whether its back is seen, which is no surface.
    pub(crate) fn is_hollow(&self) -> bool {
        self.one_sided && self.normal.dot(self.corners[0]) > 0.0
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

/// A triangle's surface as seen from a view: ratios of linear functions of the direction.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Patch<'m> {
    /// What is divided by the normal's share of the direction: the place on the texture in texels,
    /// or, for another [`Paint`], the weights of the second and third corner.
    pub(crate) x: DVec3,
    pub(crate) y: DVec3,
    /// As long as twice the triangle's area.
    pub(crate) normal: DVec3,
    /// As `x`, for the z-depth.
    pub(crate) volume: f64,
    /// Whether the back of a one-sided triangle is seen.
    pub(crate) back: bool,
    pub(crate) paint: Paint<'m>,
}

/// What is seen along a direction that meets a triangle.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Glimpse {
    /// In 8-bit sRGB units: from the material's texture, else from vertex colours, else the
    /// material's own.
    pub(crate) color: Parts,
    /// About the z-depth.
    pub(crate) depth: f64,
    /// Whether this is the back of a one-sided triangle.
    pub(crate) back: bool,
}

/// A direction's share of an axis, in the order that `super::shade` adds in.
#[inline(always)]
pub(crate) fn share(axis: DVec3, (x, y): (f64, f64)) -> f64 {
    axis.x * x + (axis.y * y + axis.z)
}

impl Patch<'_> {
    /// What a direction with z = 1 sees that meets the triangle.
    pub(crate) fn glimpse(&self, direction: DVec3) -> Glimpse {
        let direction = (direction.x, direction.y);
        let scale = 1.0 / share(self.normal, direction);
        let [x, y] = [self.x, self.y].map(|axis| share(axis, direction) * scale);
        Glimpse {
            color: self.paint.color(Plain, [x, y]),
            depth: self.volume * scale,
            back: self.back,
        }
    }
}

/// Where a triangle's colours come from.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Paint<'m> {
    /// A texture, and the corners' places on it.
    Texture(Texels<'m>, Corner),
    /// A texture times the corners' colours in linear light.
    Tinted(Texels<'m>, (Corner, [Vec3; 3])),
    /// The corners' colours in linear light.
    Light([Vec3; 3]),
    /// The first corner's colour, and the others' less that.
    Linear([Parts; 3]),
}

impl<'m> Paint<'m> {
    fn of(mesh: &'m Mesh, triangle: usize) -> Self {
        let material = mesh.material_of(triangle);
        let colors = mesh.vertex_colors().map(|colors| {
            let color = |vertex: u32| Vec3::from(colors[vertex as usize].map(f32::from));
            mesh.triangles()[triangle].map(color)
        });
        if let (Some(texture), Some(coords)) = (&material.texture, mesh.texture_coords()) {
            let corners = coords[triangle];
            let texels = Texels::new(texture, Border::of(&corners));
            return match colors.filter(|_| material.tinted) {
                Some(colors) => Self::Tinted(texels, (corners, colors.map(light::to_linear))),
                None => Self::Texture(texels, corners),
            };
        }
        if let Some(colors) = colors.filter(|_| material.tinted) {
            return Self::Light(colors.map(light::to_linear));
        }
        let plain = Vec3::from(material.color.map(f32::from));
        let [a, b, c] = colors.unwrap_or([plain; 3]);
        Self::Linear([a, b - a, c - a].map(parts))
    }

    /// The colour at a place on the texture in texels, or at weights of the second and third corner.
    #[inline(always)]
    pub(crate) fn color<L: Lanes>(&self, l: L, [x, y]: [f64; 2]) -> L::V {
        #[allow(clippy::cast_possible_truncation, reason = "colours need no f64")]
        let weights = [x as f32, y as f32];
        match self {
            Self::Texture(texels, _) => texels.color_at(l, [x, y]),
            Self::Tinted(texels, corners) => l.load(&tinted(texels, corners, weights)),
            Self::Light(corners) => l.load(&lit(corners, weights)),
            Self::Linear([first, second, third]) => {
                let [v, w] = weights.map(|weight| l.splat(weight));
                let sum = l.add(l.load(first), l.mul(l.load(second), v));
                let sum = l.add(sum, l.mul(l.load(third), w));
                l.min(l.max(sum, l.splat(0.0)), l.splat(255.0))
            }
        }
    }
}

#[inline(never)]
fn tinted(texels: &Texels<'_>, (corners, tints): &(Corner, [Vec3; 3]), weights: [f32; 2]) -> Parts {
    let color = texels.color_at(Plain, texels.place(between(*corners, weights)));
    let tint = mixed(*tints, weights);
    parts(light::to_srgb(
        light::to_linear(texture::whole(color)) * tint,
    ))
}

#[inline(never)]
fn lit(corners: &[Vec3; 3], weights: [f32; 2]) -> Parts {
    parts(light::to_srgb(mixed(*corners, weights)))
}

/// Light between the corners'; weights may lie a little outside.
fn mixed(corners: [Vec3; 3], weights: [f32; 2]) -> Vec3 {
    between(corners, weights).clamp(Vec3::ZERO, Vec3::ONE)
}

/// A colour as the first of its parts.
fn parts(color: Vec3) -> Parts {
    let [r, g, b] = color.to_array();
    [r, g, b, 0.0, 0.0, 0.0, 0.0, 0.0]
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
