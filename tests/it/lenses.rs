//! Camera models against COLMAP, and the same cameras described in five ways.

use crate::support::{mvs_eval, stderr, text};
use glam::{DMat4, DVec2, DVec3};
use mvs_datasets::format::colmap::{ColmapCamera, read_cameras_text};
use mvs_datasets::format::log;
use mvs_datasets::layout::cameras::{CamerasOptions, read_scene};
use mvs_datasets::layout::files::{self, write_atomically};
use mvs_datasets::layout::mvsnet::{self, PixelCentre};
use mvs_datasets::scene::{Camera, ColorImage, DepthRange, Pose, View};
use mvs_datasets::synthetic::{SyntheticOptions, SyntheticScene};
use mvs_eval::render::{RenderOptions, Renderer};
use serde::Deserialize;
use std::fmt::Write as _;
use std::io::Write as _;
use std::path::Path;

#[derive(Deserialize)]
struct Golden {
    size: [u32; 2],
    points: Vec<[f64; 3]>,
    cameras: Vec<GoldenCamera>,
}

#[derive(Deserialize)]
struct GoldenCamera {
    model: String,
    params: Vec<f64>,
    pixels: Vec<[f64; 2]>,
}

/// Numbers of pycolmap 4.2.1; see `tests/reference/cameras_colmap.py`.
#[test]
fn every_camera_model_puts_points_where_colmap_does() {
    let golden: Golden =
        serde_json::from_str(include_str!("../reference/cameras_colmap.json")).unwrap();
    assert_eq!(golden.cameras.len(), 13);
    for camera in &golden.cameras {
        let params: Vec<String> = camera.params.iter().map(f64::to_string).collect();
        let [width, height] = golden.size;
        let line = format!("7 {} {width} {height} {}\n", camera.model, params.join(" "));
        let read = read_cameras_text(&line).unwrap()[0].to_camera().unwrap();
        let again = ColmapCamera::new(7, &read).to_camera().unwrap();
        assert_eq!(again, read, "{}: written and read again", camera.model);
        for (point, expected) in golden.points.iter().zip(&camera.pixels) {
            let point = DVec3::from_array(*point);
            let pixel = read.project(point).unwrap();
            let error = (pixel - DVec2::from_array(*expected)).length();
            assert!(
                error < 1e-9,
                "{}: {point} at {pixel}, COLMAP {expected:?}",
                camera.model
            );
            let back = read.ray(pixel) * point.z;
            assert!(
                (back - point).length() < 1e-9,
                "{}: {back} for {point}",
                camera.model
            );
        }
    }
}

fn put(path: &Path, content: &str) {
    write_atomically(path, |out| out.write_all(content.as_bytes())).unwrap();
}

/// A synthetic scene of three views whose ids have gaps and whose names are no numbers.
fn scene() -> (SyntheticScene, Vec<View>) {
    let options = SyntheticOptions {
        views: 3,
        width: 96,
        height: 72,
        ..SyntheticOptions::default()
    };
    let scene = SyntheticScene::new(options).unwrap();
    let mut views = scene.scene().views().to_vec();
    for (index, view) in views.iter_mut().enumerate() {
        view.camera =
            Camera::new(96, 72, DVec2::new(90.25, 91.5), DVec2::new(47.25, 36.75)).unwrap();
        view.name = format!("left {}.jpg", ["c", "a", "b"][index]);
        view.depth_range = Some(DepthRange::new(1.0, 9.0).unwrap());
    }
    (scene, views)
}

/// A COLMAP model whose ids are neither contiguous nor in the order of names.
fn put_colmap(folder: &Path, views: &[View], model: &str) {
    put(&folder.join("cameras.txt"), &format!("40 {model}\n"));
    let mut images = String::new();
    for (index, view) in views.iter().enumerate() {
        let q = glam::DQuat::from_mat3(&view.pose.rotation());
        let t = view.pose.translation();
        let id = [905, 17, 300][index];
        writeln!(
            images,
            "{id} {} {} {} {} {} {} {} 40 {}\n",
            q.w, q.x, q.y, q.z, t.x, t.y, t.z, view.name
        )
        .unwrap();
    }
    put(&folder.join("images.txt"), &images);
}

fn world_from_cam(view: &View) -> DMat4 {
    view.pose.matrix().inverse()
}

fn put_transforms(path: &Path, views: &[View], lens: &str) {
    let frame = |view: &View| {
        let mut matrix = world_from_cam(view);
        matrix.y_axis = -matrix.y_axis;
        matrix.z_axis = -matrix.z_axis;
        let rows = matrix.transpose().to_cols_array_2d();
        format!(
            "{{\"file_path\": {:?}, \"transform_matrix\": {rows:?}}}",
            format!("./{}", view.name)
        )
    };
    let frames: Vec<String> = views.iter().map(frame).collect();
    put(
        path,
        &format!(
            "{{\"w\": 96, \"h\": 72, \"fl_x\": 90.25, \"fl_y\": 91.5, \"cx\": 47.25, \
             \"cy\": 36.75, {lens}\"frames\": [{}]}}",
            frames.join(",\n")
        ),
    );
}

/// The images that the cameras at `path` give, in the order of the views' positions in `poses`.
fn images(path: &Path, renderer: &Renderer, poses: &[Pose]) -> Vec<ColorImage> {
    let options = CamerasOptions {
        size: Some((96, 72)),
        focal: Some(DVec2::new(90.25, 91.5)),
        center: Some(DVec2::new(47.25, 36.75)),
        ..CamerasOptions::default()
    };
    let read = read_scene(path, &options).unwrap().scene;
    assert_eq!(read.views().len(), poses.len());
    let view_at = |pose: &Pose| {
        let near = |view: &&View| {
            let between = view.pose.center_in_world() - pose.center_in_world();
            between.length() < 1e-6
        };
        read.views().iter().find(near).unwrap()
    };
    let options = RenderOptions {
        samples: 4,
        ..RenderOptions::default()
    };
    let render = |pose| renderer.render(view_at(pose), &options).unwrap().color;
    poses.iter().map(render).collect()
}

/// Poses lose digits as quaternions and inverses, so that a sample in a million falls on another
/// triangle: images are the same but for that.
fn assert_same(what: &str, found: &[ColorImage], expected: &[ColorImage]) {
    for (found, expected) in found.iter().zip(expected) {
        let pairs = found.values().iter().zip(expected.values());
        let off = pairs.filter(|(a, b)| (0..3).any(|k| a[k].abs_diff(b[k]) > 1));
        let count = off.count();
        assert!(
            count <= 2,
            "{what}: {count} of {} pixels differ",
            found.values().len()
        );
    }
}

#[test]
fn five_descriptions_of_the_same_cameras_give_the_same_images() {
    let (scene, views) = scene();
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let renderer = Renderer::new(scene.mesh()).unwrap();
    let poses: Vec<Pose> = views.iter().map(|view| view.pose).collect();
    for view in &views {
        let name = mvsnet::file_name(view.id, "_cam.txt");
        mvsnet::write_view(&at("cams").join(name), view, PixelCentre::Half).unwrap();
    }
    put_colmap(
        &at("colmap"),
        &views,
        "PINHOLE 96 72 90.25 91.5 47.25 36.75",
    );
    put_colmap(
        &at("bent"),
        &views,
        "OPENCV 96 72 90.25 91.5 47.25 36.75 0 0 0 0",
    );
    put_transforms(&at("nerf/transforms.json"), &views, "");
    let trajectory: Vec<log::LogPose> = views
        .iter()
        .map(|view| log::LogPose {
            metadata: [i64::from(view.id), i64::from(view.id), 0],
            world_from_cam: world_from_cam(view),
        })
        .collect();
    write_atomically(&at("scene.log"), |out| log::write(out, &trajectory)).unwrap();
    let expected = images(&at("cams"), &renderer, &poses);
    let lit = |image: &ColorImage| image.values().iter().filter(|v| **v != [0; 3]).count();
    assert!(expected.iter().all(|image| lit(image) > 1000));
    assert_ne!(expected[0], expected[1]);
    for name in ["colmap", "bent", "nerf/transforms.json", "scene.log"] {
        assert_same(name, &images(&at(name), &renderer, &poses), &expected);
    }
    let read = read_scene(&at("colmap"), &CamerasOptions::default())
        .unwrap()
        .scene;
    let names: Vec<(u32, &str)> = read
        .views()
        .iter()
        .map(|v| (v.id, v.name.as_str()))
        .collect();
    assert_eq!(
        names,
        [(0, "left a.jpg"), (1, "left b.jpg"), (2, "left c.jpg")]
    );
}

#[test]
fn a_lens_is_the_same_in_colmap_and_transforms_json() {
    let (scene, views) = scene();
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let renderer = Renderer::new(scene.mesh()).unwrap();
    let poses: Vec<Pose> = views.iter().map(|view| view.pose).collect();
    for (model, lens) in [
        (
            "OPENCV 96 72 90.25 91.5 47.25 36.75 -0.2 0.05 0.002 -0.001",
            "\"k1\": -0.2, \"k2\": 0.05, \"p1\": 0.002, \"p2\": -0.001, ",
        ),
        (
            "OPENCV_FISHEYE 96 72 90.25 91.5 47.25 36.75 -0.02 0.01 -0.005 0.0005",
            "\"camera_model\": \"OPENCV_FISHEYE\", \"k1\": -0.02, \"k2\": 0.01, \"k3\": -0.005, \
             \"k4\": 0.0005, ",
        ),
    ] {
        put_colmap(&at("colmap"), &views, model);
        put_transforms(&at("transforms.json"), &views, lens);
        let colmap = images(&at("colmap"), &renderer, &poses);
        let nerf = images(&at("transforms.json"), &renderer, &poses);
        assert_same(model, &nerf, &colmap);
        put_colmap(&at("plain"), &views, "PINHOLE 96 72 90.25 91.5 47.25 36.75");
        let plain = images(&at("plain"), &renderer, &poses);
        assert_ne!(plain, colmap, "the lens shows");
    }
}

#[test]
fn render_goes_through_the_lens_or_takes_it_off_as_asked() {
    let (scene, views) = scene();
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    mvs_datasets::layout::mesh_out::write_obj(&at("mesh.obj"), scene.mesh()).unwrap();
    put_colmap(&at("bent"), &views, "RADIAL 96 72 90 47.25 36.75 0.2 0.02");
    let renderer = Renderer::new(scene.mesh()).unwrap();
    let read = read_scene(&at("bent"), &CamerasOptions::default())
        .unwrap()
        .scene;
    let plain = Camera::new(96, 72, DVec2::splat(90.0), DVec2::new(47.25, 36.75)).unwrap();
    let (mesh, cameras) = (at("mesh.obj"), at("bent"));
    for (name, flags) in [
        (
            "through",
            &["--also", "normals,interpolated_normals,sight"][..],
        ),
        ("straight", &["--undistort"]),
    ] {
        let out = at(name);
        let mut arguments = vec!["render", "--mesh", text(&mesh), "--cameras", text(&cameras)];
        arguments.extend(["--out", text(&out)]);
        arguments.extend(flags);
        let output = mvs_eval(&arguments);
        assert!(output.status.success(), "{}", stderr(&output));
        let answer: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
        let names = answer["views"].as_array().unwrap().iter();
        let names: Vec<&str> = names.map(|view| view["name"].as_str().unwrap()).collect();
        let given: Vec<&str> = read.views().iter().map(|view| view.name.as_str()).collect();
        assert!(names == given && !names[0].is_empty(), "{names:?}");
        let warned = stderr(&output).contains("3 views are rendered through their lens");
        assert_eq!(warned, name == "through", "{}", stderr(&output));
        for view in read.views() {
            let view = match name {
                "through" => view.clone(),
                _ => View {
                    camera: plain,
                    ..view.clone()
                },
            };
            let expected = renderer.render(&view, &RenderOptions::default()).unwrap();
            let file = |folder: &str, ending: &str| {
                out.join(folder).join(mvsnet::file_name(view.id, ending))
            };
            let color = files::read_image(&file("color", ".png")).unwrap();
            assert!(color == expected.color, "{name} {}", view.id);
            let depth = files::read_depth(&file("depth", ".pfm")).unwrap().0;
            assert!(depth == expected.depth, "{name} {}", view.id);
            let more = ["normals", "interpolated_normals"].map(|f| file(f, ".pfm").is_file());
            assert_eq!(more, [name == "through"; 2]);
            if name == "through" {
                let sight = files::read_image(&file("sight", ".png")).unwrap();
                let surface = sight
                    .values()
                    .iter()
                    .filter(|level| level[0] >= 128)
                    .count();
                assert_eq!(surface, depth.valid_count());
            }
        }
    }
}
