//! Scenes whose truth has a closed form: depth, surface samples and distances by formula, and
//! photographs and estimated depths whose faults are known. Sines and the like are `libm`'s: those of systems
//! differ in last bits, and a scene is to be the same everywhere.

mod light;
mod noise;
mod options;
mod random;
mod rectangle;
mod sphere;
mod stage;
mod surface;
mod texture;
mod tube;

use crate::error::{Error, Result};
use crate::scene::{
    Camera, ColorImage, DepthMap, DepthRange, Material, Mesh, PointCloud, Pose, Raster, Scene,
    SourceScore, View,
};
use glam::{DVec2, DVec3};
use random::Random;
use stage::{Part, Stage};
use surface::Ray;

pub use light::{camera_response, lighting};
pub use options::{DepthNoise, SceneKind, SyntheticOptions};

/// The most pixels an image may have, and the most points a sampled surface.
const MOST: f64 = 3e8;
/// At most so many source views per view, as BlendedMVS has.
const SOURCES: usize = 10;

/// A scene with closed-form truth: by default a box and a sphere on a plane, seen by a ring of
/// cameras. +Z is up; the ground is z = 0.
#[derive(Debug, Clone)]
pub struct SyntheticScene {
    options: SyntheticOptions,
    parts: Vec<Part>,
    scene: Scene,
    mesh: Mesh,
    deviation: f64,
    /// Zeros of the image size, from which depth maps are made.
    blank: Raster<f32>,
}

impl SyntheticScene {
    /// Builds the scene.
    ///
    /// # Errors
    /// Fewer than 2 or more than 10000 views, and no or more than 3·10⁸ pixels.
    pub fn new(options: SyntheticOptions) -> Result<Self> {
        if !(2..=10_000).contains(&options.views) {
            let problem = format!("expected 2 to 10000 views, found {}", options.views);
            return Err(Error::invalid("synthetic scene", problem));
        }
        let pixels = f64::from(options.width) * f64::from(options.height);
        if !(1.0..=MOST).contains(&pixels) {
            let problem = format!("expected 1 to {MOST:e} pixels, found {pixels:e}");
            return Err(Error::invalid("synthetic scene", problem));
        }
        let stage = stage::stage(options.kind, options.seed, options.views)?;
        let (mesh, deviation) = mesh_of(&stage.parts)?;
        let mut built = Self {
            blank: Raster::filled(options.width, options.height, 0.0)?,
            scene: cameras(&stage, &options)?,
            parts: stage.parts,
            options,
            mesh,
            deviation,
        };
        built.scene = built.with_ranges()?.with_sources(sources(&stage.stands))?;
        Ok(built)
    }

    /// The cameras, with depth ranges and source views.
    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    /// The textured mesh, one material per surface. Its sphere is a polyhedron: see
    /// [`SyntheticScene::mesh_deviation`]. The ground reaches under what stands on it.
    pub fn mesh(&self) -> &Mesh {
        &self.mesh
    }

    /// The largest distance from a visible point of the mesh to the exact surface, in world units,
    /// in closed form.
    pub fn mesh_deviation(&self) -> f64 {
        self.deviation
    }

    /// Exact z-depth at the pixel centres of the view at `index` of the scene's views, by formula
    /// in f64, rounded once to f32.
    pub fn depth(&self, index: usize) -> DepthMap {
        let view = &self.scene.views()[index];
        let mut raster = self.blank.clone();
        for row in 0..raster.height() {
            for column in 0..raster.width() {
                let center = DVec2::new(f64::from(column) + 0.5, f64::from(row) + 0.5);
                #[allow(clippy::cast_possible_truncation, reason = "depth is stored as f32")]
                let depth = self.depth_at(view, center).unwrap_or(0.0) as f32;
                raster.set(column, row, depth);
            }
        }
        DepthMap::clean(raster).0
    }

    /// Exact z-depth of the first surface that `view` sees at continuous image coordinates `pixel`.
    pub fn depth_at(&self, view: &View, pixel: DVec2) -> Option<f64> {
        // A ray that is 1 long along +Z: its parameter is the z-depth.
        let ray = sight(view, pixel);
        self.parts
            .iter()
            .filter_map(|part| part.surface.hit(&ray))
            .min_by(f64::total_cmp)
    }

    /// The photograph that view `index` takes, given the scene's render on black, of any size:
    /// [`lighting`] and [`camera_response`] applied to it, over a backdrop.
    pub fn photograph(&self, index: usize, rendered: &ColorImage) -> ColorImage {
        let view = &self.scene.views()[index];
        let (width, height) = rendered.size();
        let size = DVec2::new(f64::from(width), f64::from(height));
        let own_size = DVec2::new(
            f64::from(view.camera.width()),
            f64::from(view.camera.height()),
        );
        let pixel_at = |place: DVec2| place / size * own_size;
        let mut photograph = rendered.clone();
        for row in 0..height {
            for column in 0..width {
                let corner = DVec2::new(f64::from(column), f64::from(row));
                let center = corner + DVec2::splat(0.5);
                let share = self.share(|offset| sight(view, pixel_at(corner + offset)));
                let light = lighting(index, center / size);
                let surface = light::photographed(rendered.get(column, row), light);
                let backdrop = light::backdrop(sight(view, pixel_at(center)).direction);
                photograph.set(column, row, light::composed(surface, backdrop, share));
            }
        }
        photograph
    }

    /// The share of a pixel that surfaces cover, from 4 × 4 rays where its corners disagree.
    fn share(&self, ray_at: impl Fn(DVec2) -> Ray) -> f64 {
        let met = |x: f64, y: f64| {
            let ray = ray_at(DVec2::new(x, y));
            self.parts
                .iter()
                .any(|part| part.surface.hit(&ray).is_some())
        };
        let corners = [met(0.0, 0.0), met(1.0, 0.0), met(0.0, 1.0), met(1.0, 1.0)];
        if corners.iter().all(|&met| met == corners[0]) {
            return f64::from(u8::from(corners[0]));
        }
        let offsets = [0.125, 0.375, 0.625, 0.875];
        let hits = offsets
            .iter()
            .flat_map(|&y| offsets.iter().map(move |&x| (x, y)))
            .filter(|&(x, y)| met(x, y))
            .count();
        #[allow(clippy::cast_precision_loss, reason = "at most 16")]
        let share = hits as f64 / 16.0;
        share
    }

    /// Estimated depth and confidence (0 to 1; good depths lie mostly above 0.8) of view `index`:
    /// the exact depth made worse. Pixels without truth have neither.
    pub fn estimated_depth(&self, index: usize, noise: &DepthNoise) -> (DepthMap, Raster<f32>) {
        self.worsened(index, &self.depth(index), noise)
    }

    /// As [`SyntheticScene::estimated_depth`], from a depth map of view `index` that was made some
    /// other way, such as rendered from the mesh.
    pub fn worsened(
        &self,
        index: usize,
        depth: &DepthMap,
        noise: &DepthNoise,
    ) -> (DepthMap, Raster<f32>) {
        let mut random = Random::new(self.options.seed, 1 + index as u64);
        match self.scene.views()[index].depth_range {
            Some(range) => noise::estimate(depth, range, noise, &mut random),
            None => (depth.clone(), self.blank.clone()),
        }
    }

    /// Points on the exact surface, uniform by area with about `spacing` world units between
    /// neighbours, normals and colours included; only surface that can be seen from outside.
    ///
    /// # Errors
    /// A `spacing` that is not above 0, or so small that there would be over 3·10⁸ points.
    pub fn sample_surface(&self, spacing: f64) -> Result<PointCloud> {
        let area: f64 = self.parts.iter().map(|part| part.surface.area()).sum();
        let count = area / (spacing * spacing);
        if !(spacing > 0.0 && count <= MOST) {
            let least = (area / MOST).sqrt();
            let problem = format!("expected at least {least:.1e} world units, found {spacing:?}");
            return Err(Error::invalid("sample spacing", problem));
        }
        let (mut positions, mut normals, mut colors) = (Vec::new(), Vec::new(), Vec::new());
        for (stream, part) in self.parts.iter().enumerate() {
            let mut random = Random::new(self.options.seed, (1 << 32) + stream as u64);
            for sample in part.surface.sample(spacing, &mut random) {
                positions.push(sample.position);
                normals.push(sample.normal.as_vec3());
                colors.push(texture::lookup(&part.texture, sample.uv));
            }
        }
        PointCloud::new(positions)
            .with_normals(normals)?
            .with_colors(colors)
    }

    /// Distance from a point to the nearest point of the exact surface that can be seen from
    /// outside, in world units.
    pub fn distance_to_surface(&self, point: DVec3) -> f64 {
        let distances = self.parts.iter().map(|part| part.surface.distance(point));
        distances.fold(f64::INFINITY, f64::min)
    }

    /// The scene with each view's range: what it sees, widened by 3 % on both sides.
    fn with_ranges(&self) -> Result<Scene> {
        let mut views = self.scene.views().to_vec();
        for (index, view) in views.iter_mut().enumerate() {
            let depth = self.depth(index);
            let seen = depth.values().iter().copied().filter(|&depth| depth > 0.0);
            let (min, max) = seen.fold((f32::INFINITY, 0.0f32), |(min, max), depth| {
                (min.min(depth), max.max(depth))
            });
            if min <= max {
                let range = DepthRange::new(0.97 * f64::from(min), 1.03 * f64::from(max))?;
                view.depth_range = Some(range);
            }
        }
        Scene::new(views)
    }
}

fn sight(view: &View, pixel: DVec2) -> Ray {
    Ray {
        origin: view.pose.center_in_world(),
        direction: view.pose.direction_to_world(view.camera.ray(pixel)),
    }
}

/// All cameras, alike, their focal length such that all of them see everything, unless the stage
/// sets it.
fn cameras(stage: &Stage, options: &SyntheticOptions) -> Result<Scene> {
    let outline: Vec<DVec3> = stage
        .parts
        .iter()
        .flat_map(|part| part.surface.outline())
        .collect();
    let poses = stage
        .stands
        .iter()
        .map(|stand| Pose::looking_at(stand.eye, stand.target, DVec3::Z))
        .collect::<Result<Vec<Pose>>>()?;
    let spread = poses.iter().fold(DVec2::ZERO, |widest, pose| {
        widest.max(stage::spread(pose, &outline))
    });
    let size = DVec2::new(f64::from(options.width), f64::from(options.height));
    let focal = match stage.reach {
        Some(reach) => 0.5 * size.x / reach,
        None => (0.49 * size / spread).min_element(),
    };
    let camera = Camera::new(
        options.width,
        options.height,
        DVec2::splat(focal),
        0.5 * size,
    )?;
    let views = (0..).zip(poses).map(|(id, pose)| View {
        id,
        name: format!("{id:08}.jpg"),
        camera,
        pose,
        depth_range: None,
    });
    Scene::new(views.collect())
}

/// For each stand the others by the angle between their lines of sight, nearest first; the score is
/// 180 less that angle in degrees.
fn sources(stands: &[stage::Stand]) -> Vec<Vec<SourceScore>> {
    let sight = |stand: &stage::Stand| stand.eye - stand.target;
    let list = |(own, stand): (usize, &stage::Stand)| {
        let others = (0u32..).zip(stands).filter(|&(id, _)| id as usize != own);
        let mut scores: Vec<SourceScore> = others
            .map(|(id, other)| SourceScore {
                id,
                score: 180.0 - sight(stand).angle_between(sight(other)).to_degrees(),
            })
            .filter(|source| source.score > 0.0)
            .collect();
        scores.sort_by(|a, b| b.score.total_cmp(&a.score).then(a.id.cmp(&b.id)));
        scores.truncate(SOURCES);
        scores
    };
    stands.iter().enumerate().map(list).collect()
}

/// All parts as one mesh, and its largest deviation.
fn mesh_of(parts: &[Part]) -> Result<(Mesh, f64)> {
    let (mut vertices, mut triangles, mut uvs) = (Vec::new(), Vec::new(), Vec::new());
    let (mut materials, mut indices, mut deviation) = (Vec::new(), Vec::new(), 0.0f64);
    for (index, part) in (0u32..).zip(parts) {
        let patch = part.surface.patch();
        let first = u32::try_from(vertices.len())
            .map_err(|_| Error::invalid("synthetic scene", "too many vertices"))?;
        indices.extend(std::iter::repeat_n(index, patch.triangles.len()));
        triangles.extend(
            patch
                .triangles
                .iter()
                .map(|t| t.map(|vertex| first + vertex)),
        );
        vertices.extend(patch.vertices);
        uvs.extend(patch.uvs);
        deviation = deviation.max(patch.deviation);
        materials.push(Material {
            name: part.name.clone(),
            texture: Some(part.texture.clone()),
            ..Material::default()
        });
    }
    let mesh = Mesh::new(vertices, triangles)?
        .with_texture_coords(uvs)?
        .with_materials(materials, Some(indices))?;
    Ok((mesh, deviation))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The default scene, built once.
    fn scene() -> SyntheticScene {
        static SCENE: std::sync::LazyLock<SyntheticScene> =
            std::sync::LazyLock::new(|| SyntheticScene::new(SyntheticOptions::default()).unwrap());
        SCENE.clone()
    }

    /// The first t at which the distance to the surface vanishes, by sphere tracing: no formula of
    /// the ray is used.
    fn march(scene: &SyntheticScene, ray: &Ray) -> Option<f64> {
        let length = ray.direction.length();
        let mut t = 0.0;
        while t < 20.0 {
            let distance = scene.distance_to_surface(ray.at(t));
            if distance < 1e-10 {
                return Some(t);
            }
            t += distance / length;
        }
        None
    }

    #[test]
    fn depth_agrees_with_marching_along_the_ray() {
        let scene = scene();
        for index in [0, 5] {
            let view = &scene.scene().views()[index];
            let depth = scene.depth(index);
            let mut compared = 0;
            for row in (0..240).step_by(7) {
                for column in (0..320).step_by(7) {
                    let pixel = DVec2::new(f64::from(column) + 0.5, f64::from(row) + 0.5);
                    let marched = march(&scene, &sight(view, pixel)).unwrap_or(0.0);
                    let exact = f64::from(depth.get(column, row));
                    assert!((exact - marched).abs() < 1e-6, "{pixel}: {exact} {marched}");
                    compared += usize::from(exact > 0.0);
                }
            }
            assert!(compared > 300);
        }
    }

    #[test]
    fn samples_lie_on_the_surface_and_face_outward() {
        let scene = scene();
        let cloud = scene.sample_surface(0.02).unwrap();
        let normals = cloud.normals().unwrap();
        for (&point, normal) in cloud.positions().iter().zip(normals) {
            assert!(scene.distance_to_surface(point) <= 1e-12);
            let outside = point + 1e-6 * normal.as_dvec3();
            assert!((scene.distance_to_surface(outside) - 1e-6).abs() < 1e-9);
        }
    }

    #[test]
    fn samples_are_as_dense_everywhere() {
        let (scene, spacing) = (scene(), 0.01);
        let cloud = scene.sample_surface(spacing).unwrap();
        let normals = cloud.normals().unwrap();
        let count = |keep: &dyn Fn(DVec3, DVec3) -> bool| {
            let all = cloud.positions().iter().zip(normals);
            let kept = all.filter(|&(&point, normal)| keep(point, normal.as_dvec3()));
            kept.count() as f64 * spacing * spacing
        };
        let near = |area: f64, expected: f64| {
            let relative = area / expected - 1.0;
            assert!(relative.abs() < 0.01, "{area} {expected}");
        };
        let rim_squared = 0.45f64.powi(2) - 0.15f64.powi(2);
        let ground = 2.1 * 2.1 - 0.7 * 0.5 - std::f64::consts::PI * rim_squared;
        near(count(&|point, _| point.z == 0.0), ground);
        near(
            count(&|point, normal| point.z == 0.6 && normal.z == 1.0),
            0.35,
        );
        let center = DVec3::new(0.5, -0.42, 0.15);
        let on_ball = |point: DVec3| ((point - center).length() - 0.45).abs() < 1e-9;
        let cap = |height: f64| std::f64::consts::TAU * 0.45 * height;
        near(count(&|point, _| on_ball(point)), cap(0.6));
        near(count(&|point, _| on_ball(point) && point.z > 0.4), cap(0.2));
        let walls = 2.0 * (0.7 + 0.5) * 0.6;
        let wall = |point: DVec3, normal: DVec3| normal.z == 0.0 && !on_ball(point);
        near(count(&wall), walls);
    }

    #[test]
    fn every_camera_sees_everything() {
        let scene = scene();
        let mesh = scene.mesh();
        for view in scene.scene().views() {
            for &vertex in mesh.vertices() {
                let pixel = view.camera.project(view.pose.to_cam(vertex)).unwrap();
                assert!(view.camera.contains(pixel), "view {}: {pixel}", view.id);
            }
        }
    }

    #[test]
    fn every_surface_point_is_seen_from_three_sides() {
        let scene = scene();
        let cloud = scene.sample_surface(0.1).unwrap();
        for &point in cloud.positions() {
            let seen = scene.scene().views().iter().filter(|view| {
                let in_cam = view.pose.to_cam(point);
                let pixel = view.camera.project(in_cam).unwrap();
                let first = scene.depth_at(view, pixel).unwrap_or(f64::INFINITY);
                (first - in_cam.z).abs() < 1e-9
            });
            assert!(seen.count() >= 3, "{point}");
        }
    }

    #[test]
    fn ranges_hold_every_depth_and_sources_are_the_neighbours() {
        let scene = scene();
        for (index, view) in scene.scene().views().iter().enumerate() {
            let range = view.depth_range.unwrap();
            let depth = scene.depth(index);
            let inside = |depth: f32| (range.min()..range.max()).contains(&f64::from(depth));
            assert!(depth.values().iter().all(|&d| d == 0.0 || inside(d)));
            assert!(depth.valid_count() > 15_000, "{}", depth.valid_count());
            let sources = scene.scene().sources_of(index);
            assert_eq!(sources.len(), 10);
            let mut nearest = [sources[0].id, sources[1].id];
            nearest.sort_unstable();
            let mut expected = [(view.id + 1) % 12, (view.id + 11) % 12];
            expected.sort_unstable();
            assert_eq!(nearest, expected);
        }
    }

    #[test]
    fn mesh_vertices_lie_on_the_surface_and_deviation_is_small() {
        let scene = scene();
        let mesh = scene.mesh();
        assert!(scene.mesh_deviation() > 1e-5 && scene.mesh_deviation() < 2e-4);
        assert!(
            mesh.vertices()
                .iter()
                .all(|&vertex| scene.distance_to_surface(vertex) < 1e-12)
        );
        assert_eq!(mesh.materials().len(), 7);
    }

    #[test]
    fn a_photograph_is_the_lit_render_over_a_backdrop() {
        let scene = scene();
        let rendered = texture::canvas(160, 120).unwrap().map(|_| [100, 150, 200]);
        let photograph = scene.photograph(3, &rendered);
        let middle = photograph.get(80, 60);
        let light = lighting(3, DVec2::new(80.5 / 160.0, 60.5 / 120.0));
        let red = 255.0 * camera_response(100.0 / 255.0 * light * 1.05);
        assert!((f64::from(middle[0]) - red).abs() <= 0.5);
        assert!(middle[2] > middle[0]);
        assert!(photograph.get(0, 0)[2] > 100, "sky, not black");
    }

    #[test]
    fn the_seed_decides_everything() {
        let other = |seed| {
            let options = SyntheticOptions {
                seed,
                ..SyntheticOptions::default()
            };
            SyntheticScene::new(options).unwrap()
        };
        let noise = DepthNoise::default();
        let all = |scene: &SyntheticScene| {
            (
                scene.estimated_depth(2, &noise),
                scene.mesh().clone(),
                scene.sample_surface(0.05).unwrap(),
            )
        };
        assert_eq!(all(&scene()), all(&other(0)));
        assert_ne!(all(&scene()).0, all(&other(1)).0);
        assert_ne!(all(&scene()).1, all(&other(1)).1);
        assert_ne!(
            scene().estimated_depth(2, &noise),
            scene().estimated_depth(3, &noise)
        );
    }

    #[test]
    fn fixtures_agree_with_marching_and_sample_their_own_surface() {
        for (name, options) in SyntheticOptions::fixtures() {
            let scene = SyntheticScene::new(options).unwrap();
            let view = &scene.scene().views()[1];
            let depth = scene.depth(1);
            let mut compared = 0;
            for row in (3..240).step_by(29) {
                for column in (3..320).step_by(29) {
                    let pixel = DVec2::new(f64::from(column) + 0.5, f64::from(row) + 0.5);
                    let exact = f64::from(depth.get(column, row));
                    let Some(marched) = march(&scene, &sight(view, pixel)) else {
                        continue;
                    };
                    let relative = (exact - marched).abs() / marched;
                    assert!(relative < 1e-6, "{name} {pixel}: {exact} {marched}");
                    compared += 1;
                }
            }
            assert!(compared > 10, "{name}: {compared}");
            assert!(
                depth.valid_count() > 8_000,
                "{name}: {}",
                depth.valid_count()
            );
            let spacing = scene.mesh().bounds().size().max_element() / 60.0;
            let cloud = scene.sample_surface(spacing).unwrap();
            let far = cloud
                .positions()
                .iter()
                .map(|&p| scene.distance_to_surface(p));
            assert!(far.fold(0.0, f64::max) < 1e-10, "{name}");
            let stray = scene.mesh_deviation();
            assert!(stray < 1e-4, "{name}: {stray}");
        }
    }

    #[test]
    fn what_cannot_be_built_is_refused() {
        let fails =
            |options: SyntheticOptions| SyntheticScene::new(options).unwrap_err().to_string();
        let default = SyntheticOptions::default;
        assert!(
            fails(SyntheticOptions {
                views: 1,
                ..default()
            })
            .contains("found 1")
        );
        assert!(
            fails(SyntheticOptions {
                width: 0,
                ..default()
            })
            .contains("pixels")
        );
        assert!(
            fails(SyntheticOptions {
                width: u32::MAX,
                ..default()
            })
            .contains("pixels")
        );
        for spacing in [0.0, -1.0, f64::NAN, 1e-9] {
            assert!(scene().sample_surface(spacing).is_err(), "{spacing}");
        }
        let said = scene().sample_surface(5e-151).unwrap_err().to_string();
        assert!(said.ends_with("found 5e-151"), "{said}");
    }
}
