//! What visibility and exact maps cost, for `benches/render_visibility.py`.
//!
//! usage: `render_visibility REPEATS SIDE...`: for each terrain of SIDE × SIDE cells one JSON line;
//! `render_visibility leaks RAYS`: how many rays aimed at edges and corners of closed meshes from
//! inside slip through; `render_visibility arbitrate SIDE...`: how many pixels of the same views differ
//! from the exact test of every candidate in f64, one ray at a time; `render_visibility lens SIDE...`:
//! the same views through a lens, drawn and traced; `render_visibility fisheye SIDE...`: the same through
//! fisheyes that see up to 90 degrees from the axis; `render_visibility rays SIDE...`: the rays of the same
//! views from world to world, one by one and together.

#![allow(
    clippy::print_stdout,
    clippy::unwrap_used,
    reason = "a measuring program: it prints, and stops where anything is wrong"
)]

#[path = "../tests/it/render/shapes.rs"]
#[allow(dead_code, reason = "shared with the tests")]
mod shapes;

use glam::{DVec2, DVec3};
use mvs_datasets::scene::{Camera, Distortion, Mesh, Pose, View};
use mvs_eval::parallel;
use mvs_eval::render::oracle::Oracle;
use mvs_eval::render::{BackFaces, RenderOptions, Renderer, Seen};
use shapes::{Noise, terrain};
use std::fs;

const EYES: [DVec3; 3] = [
    DVec3::new(0.9, -1.4, 1.1),
    DVec3::new(-1.1, 0.3, 0.5),
    DVec3::new(0.1, 0.2, 1.6),
];

/// A unit sphere of latitude and longitude, `rings` from pole to pole, each pole one vertex.
fn sphere(rings: u32) -> Mesh {
    let around = 2 * rings;
    let mut vertices = vec![DVec3::Z];
    for ring in 1..rings {
        let polar = std::f64::consts::PI * f64::from(ring) / f64::from(rings);
        for step in 0..around {
            let turn = std::f64::consts::TAU * f64::from(step) / f64::from(around);
            let (sin, cos) = polar.sin_cos();
            vertices.push(DVec3::new(sin * turn.cos(), sin * turn.sin(), cos));
        }
    }
    vertices.push(DVec3::NEG_Z);
    let at = |ring: u32, step: u32| match ring {
        0 => 0,
        ring if ring == rings => 1 + (rings - 1) * around,
        ring => 1 + (ring - 1) * around + step % around,
    };
    let mut triangles = Vec::new();
    for ring in 0..rings {
        for step in 0..around {
            let [a, b] = [at(ring, step), at(ring, step + 1)];
            let [c, d] = [at(ring + 1, step), at(ring + 1, step + 1)];
            triangles.extend([[a, c, d], [a, d, b]].iter().filter(|t| {
                let [x, y, z] = **t;
                x != y && y != z && z != x
            }));
        }
    }
    Mesh::new(vertices, triangles).unwrap()
}

/// Seconds this thread has run.
fn cpu() -> f64 {
    let text = fs::read_to_string("/proc/thread-self/schedstat").unwrap();
    let first = text.split_whitespace().next().unwrap();
    first.parse::<f64>().unwrap() * 1e-9
}

/// The most memory this process has held, in bytes.
fn peak() -> f64 {
    let text = fs::read_to_string("/proc/self/status").unwrap();
    let line = text.lines().find(|line| line.starts_with("VmHWM")).unwrap();
    let kib = line.split_whitespace().nth(1).unwrap();
    kib.parse::<f64>().unwrap() * 1024.0
}

/// Runs that are timed together: the clock steps by milliseconds.
const TOGETHER: usize = 10;

/// The median CPU time of one run, over some batches, in seconds.
fn timed(batches: usize, mut work: impl FnMut()) -> f64 {
    let mut times: Vec<f64> = (0..batches)
        .map(|_| {
            let start = cpu();
            for _ in 0..TOGETHER {
                work();
            }
            (cpu() - start) / TOGETHER as f64
        })
        .collect();
    times.sort_by(f64::total_cmp);
    times[times.len() / 2]
}

fn view_from(eye: DVec3) -> View {
    View {
        id: 0,
        name: String::new(),
        camera: Camera::new(2048, 1536, DVec2::splat(1600.0), DVec2::new(1024.0, 768.0)).unwrap(),
        pose: Pose::looking_at(eye, DVec3::ZERO, DVec3::new(0.1, 0.0, 1.0)).unwrap(),
        depth_range: None,
    }
}

fn measure(side: u32, repeats: usize) {
    let mesh = terrain(side);
    let count = mesh.triangles().len() as f64;
    let held = peak();
    let start = cpu();
    let renderer = Renderer::new(&mesh).unwrap();
    let build = cpu() - start;
    let build_peak = peak() - held;
    let mut rows = Vec::new();
    for view in EYES.map(view_from) {
        let mut seen = Seen::default();
        let hits = renderer.visible_count(&view);
        renderer.see(&view, &mut seen).unwrap();
        let visibility = timed(repeats, || {
            renderer.visible_count(&view);
        });
        let maps = timed(repeats, || renderer.see(&view, &mut seen).unwrap());
        rows.push(format!(
            r#"{{"hits": {hits}, "visibility_s": {visibility}, "maps_s": {maps}}}"#
        ));
    }
    println!(
        r#"{{"triangles": {count}, "build_s": {build}, "bytes_per_triangle": {}, "build_peak_bytes_per_triangle": {}, "process_peak_bytes": {}, "views": [{}]}}"#,
        renderer.bytes() as f64 / count,
        build_peak / count,
        peak(),
        rows.join(", ")
    );
}

fn leaks(rays: usize) {
    let mut noise = Noise(17);
    for (name, mesh) in [
        ("sphere, 159 k triangles", sphere(200)),
        ("sphere, 3 k triangles", sphere(28)),
    ] {
        let renderer = Renderer::new(&mesh).unwrap();
        let mut missed = [0, 0];
        for index in 0..rays / 2 {
            let [a, b, _] =
                mesh.corners((noise.next().abs() * 1e9) as usize % mesh.triangles().len());
            let edge = index % 2;
            let along = if edge == 0 {
                0.0
            } else {
                0.5 + 0.5 * noise.next()
            };
            let origin = noise.vector() * 0.4;
            let direction = a.lerp(b, along) - origin;
            let hit = renderer.first_hit(origin, direction, (0.0, f64::INFINITY));
            missed[edge] += usize::from(hit.is_none());
        }
        println!(
            r#"{{"mesh": "{name}", "rays": {}, "leaks_at_corners": {}, "leaks_at_edges": {}}}"#,
            rays / 2,
            missed[0],
            missed[1]
        );
    }
}

/// Pixels of a view that are wrong: another mask, or another depth or normal in any bit.
fn wrong_pixels(mesh: &Mesh, view: &View) -> usize {
    let options = RenderOptions {
        samples: 1,
        back_faces: BackFaces::Valid,
        ..RenderOptions::default()
    };
    let exact = Oracle::new(mesh).render(view, &options).unwrap();
    let mut seen = Seen::default();
    Renderer::new(mesh).unwrap().see(view, &mut seen).unwrap();
    let found = seen.depth.iter().zip(&seen.normals);
    let normals = exact.normals.unwrap();
    let expected = exact.depth.values().iter().zip(normals.values());
    let both = found.zip(expected);
    both.filter(|((depth, normal), (z, n))| depth.to_bits() != z.to_bits() || normal != n)
        .count()
}

fn arbitrate(side: u32) {
    let mesh = terrain(side);
    for (index, view) in EYES.map(view_from).iter().enumerate() {
        let wrong = wrong_pixels(&mesh, view);
        let pixels = 2048 * 1536;
        println!(
            r#"{{"triangles": {}, "view": {index}, "pixels": {pixels}, "wrong": {wrong}}}"#,
            mesh.triangles().len()
        );
    }
}

/// A lens and the camera's focal length in pixels.
type Optics = (f64, Distortion);

/// What views are usually taken through.
const USUAL: Optics = (
    1600.0,
    Distortion::RadialTangential {
        radial: [-0.2, 0.05, 0.0, 0.0, 0.0, 0.0],
        tangential: [2e-3, -1e-3],
    },
);
/// Focal lengths with which 90° from the axis is far inside the view, near its upper border, and at its corners.
const WIDE: [f64; 3] = [100.0, 450.0, 800.0];
const FISHEYE: Distortion = Distortion::Fisheye {
    radial: [-0.02, 0.01, -0.005, 0.0005],
};

/// A view through a lens: what it sees, drawn; its rays alone; the same rays traced one by one.
fn through_lens(side: u32, (focal, lens): Optics) {
    let mesh = terrain(side);
    let renderer = Renderer::new(&mesh).unwrap();
    for (index, mut view) in EYES.map(view_from).into_iter().enumerate() {
        let camera = Camera::new(2048, 1536, DVec2::splat(focal), DVec2::new(1024.0, 768.0));
        view.camera = camera.unwrap().with_distortion(lens).unwrap();
        let pixels = (0..2048 * 1536).map(|i| DVec2::new(f64::from(i % 2048), f64::from(i / 2048)));
        let mut directions = Vec::new();
        let rays = timed_once(|| {
            let direction = |pixel| view.pose.direction_to_world(view.camera.ray(pixel + 0.5));
            directions = pixels.map(direction).collect();
        });
        let mut hits = 0;
        let drawn = timed_once(|| hits = renderer.visible_count(&view));
        let mut traced_hits = 0;
        let traced = timed_once(|| {
            let eye = view.pose.center_in_world();
            let hit = |&&direction: &&DVec3| {
                let hit = renderer.first_hit(eye, direction, (0.0, f64::INFINITY));
                hit.is_some()
            };
            traced_hits = directions.iter().filter(hit).count();
        });
        println!(
            r#"{{"triangles": {}, "focal": {focal}, "view": {index}, "hits": {hits}, "traced_hits": {traced_hits}, "rays_s": {rays}, "drawn_s": {drawn}, "traced_s": {traced}}}"#,
            mesh.triangles().len()
        );
    }
}

/// The rays of the views' pixels: one by one, together, and only whether they meet something.
fn many_rays(side: u32) {
    let mesh = terrain(side);
    let renderer = Renderer::new(&mesh).unwrap();
    let range = (0.0, f64::INFINITY);
    for (index, view) in EYES.map(view_from).into_iter().enumerate() {
        let pixels = (0..2048 * 1536).map(|i| DVec2::new(f64::from(i % 2048), f64::from(i / 2048)));
        let direction = |pixel| view.pose.direction_to_world(view.camera.ray(pixel + 0.5));
        let directions: Vec<DVec3> = pixels.map(direction).collect();
        let eye = view.pose.center_in_world();
        let mut alone = Vec::new();
        let single = timed_once(|| {
            let hit = |&direction| renderer.first_hit(eye, direction, range);
            alone = directions.iter().map(hit).collect();
        });
        let mut hits = Vec::new();
        let together = timed_once(|| hits = renderer.first_hits(eye, &directions, range));
        let different = hits.iter().zip(&alone).filter(|(a, b)| a != b).count();
        let mut blocked = Vec::new();
        let any = timed_once(|| blocked = renderer.blocked(eye, &directions, range));
        let wrong = blocked
            .iter()
            .zip(&alone)
            .filter(|(a, b)| **a != b.is_some());
        // As when views are compared: few rays, far from each other.
        let few: Vec<DVec3> = directions.iter().copied().step_by(1021).collect();
        let sparse = timed_once(|| {
            for _ in 0..20 {
                renderer.blocked(eye, &few, range);
            }
        });
        println!(
            r#"{{"triangles": {}, "view": {index}, "rays": {}, "hits": {}, "different": {}, "single_s": {single}, "together_s": {together}, "any_s": {any}, "sparse_us_per_ray": {}}}"#,
            mesh.triangles().len(),
            directions.len(),
            hits.iter().flatten().count(),
            different + wrong.count(),
            1e6 * sparse / (20 * few.len()) as f64
        );
    }
}

fn timed_once(work: impl FnOnce()) -> f64 {
    let start = cpu();
    work();
    cpu() - start
}

fn main() {
    let numbers: Vec<String> = std::env::args().skip(1).collect();
    let number = |index: usize| numbers[index].parse().unwrap();
    let work = || match numbers[0].as_str() {
        "leaks" => leaks(number(1)),
        "lens" => {
            for index in 1..numbers.len() {
                through_lens(u32::try_from(number(index)).unwrap(), USUAL);
            }
        }
        "fisheye" => {
            for index in 1..numbers.len() {
                for focal in WIDE {
                    through_lens(u32::try_from(number(index)).unwrap(), (focal, FISHEYE));
                }
            }
        }
        "rays" => {
            for index in 1..numbers.len() {
                many_rays(u32::try_from(number(index)).unwrap());
            }
        }
        "arbitrate" => {
            for index in 1..numbers.len() {
                arbitrate(u32::try_from(number(index)).unwrap());
            }
        }
        _ => {
            for index in 1..numbers.len() {
                measure(u32::try_from(number(index)).unwrap(), number(0));
            }
        }
    };
    parallel::with_threads(1, work).unwrap();
}
