//! A scene's cameras for other programs: nerfstudio's `transforms.json` and COLMAP's text model.
//!
//! Both have pixel centres at (0.5, 0.5), as this crate. What is written reads back to the same
//! cameras; COLMAP's quaternions hold exact rotations only, so that of rounded ones the nearest is written.

use super::{files, mvsnet};
use crate::error::{Error, FormatError, Result};
use crate::format::colmap::{self, ColmapCamera, ColmapImage};
use crate::format::transforms::{self, Frame};
use crate::scene::{Camera, Scene, View};
use glam::{DMat4, DVec4};
use std::path::Path;

/// Where the images of a BlendedMVS scene lie, seen from its folder.
pub const IN_SCENE_FOLDER: &str = "blended_images/";

/// Writes a `transforms.json`; images are `images` + `00000000.jpg`.
///
/// # Errors
/// A lens that [`transforms::write`] refuses, and what [`files::write_atomically`] brings.
pub fn write_transforms(path: &Path, scene: &Scene, images: &str) -> Result<()> {
    let frames: Vec<Frame> = (scene.views().iter())
        .map(|view| frame_of(view, images))
        .collect();
    let json = transforms::write(&frames)
        .map_err(|problem| Error::in_file(path)(FormatError::new("cameras", problem)))?;
    files::write_atomically(path, |out| std::io::Write::write_all(out, json.as_bytes()))
}

fn frame_of(view: &View, images: &str) -> Frame {
    let camera = &view.camera;
    let mut world_from_cam = view.pose.matrix().inverse();
    world_from_cam.y_axis = -world_from_cam.y_axis;
    world_from_cam.z_axis = -world_from_cam.z_axis;
    let [x, y, z, w] = [
        world_from_cam.x_axis,
        world_from_cam.y_axis,
        world_from_cam.z_axis,
        world_from_cam.w_axis,
    ]
    .map(|column| column.truncate());
    Frame {
        file: format!("{images}{}", mvsnet::file_name(view.id, ".jpg")),
        world_from_gl_cam: DMat4::from_cols(
            x.extend(0.0),
            y.extend(0.0),
            z.extend(0.0),
            DVec4::new(w.x, w.y, w.z, 1.0),
        ),
        size: Some((camera.width(), camera.height())),
        focal: Some(camera.focal().to_array()),
        angles: [None; 2],
        center: Some(camera.center().to_array()),
        distortion: camera.distortion(),
    }
}

/// Writes `cameras.txt`, `images.txt` and a `points3D.txt` without points into `folder`. Images are
/// `00000000.jpg`, their numbers the views' plus 1 (an id that has none above is refused); equal
/// cameras are one.
///
/// # Errors
/// A view whose id has none above, and what [`files::write_atomically`] brings.
pub fn write_colmap(folder: &Path, scene: &Scene) -> Result<()> {
    let mut distinct: Vec<Camera> = Vec::new();
    let mut images = Vec::new();
    for view in scene.views() {
        let place = distinct.iter().position(|camera| *camera == view.camera);
        let place = place.unwrap_or_else(|| {
            distinct.push(view.camera);
            distinct.len() - 1
        });
        let name = mvsnet::file_name(view.id, ".jpg");
        let number = view.id.checked_add(1).ok_or_else(|| {
            let problem = format!("expected view ids below {0}, found {0}", view.id);
            Error::layout(folder, problem)
        })?;
        images.push(ColmapImage::new(number, &view.pose, place as u32 + 1, name));
    }
    let cameras: Vec<ColmapCamera> = (1u32..)
        .zip(&distinct)
        .map(|(id, camera)| ColmapCamera::new(id, camera))
        .collect();
    let write = |name: &str, text: String| {
        let path = folder.join(name);
        files::write_atomically(&path, |out| std::io::Write::write_all(out, text.as_bytes()))
    };
    write("cameras.txt", colmap::write_cameras_text(&cameras))?;
    write("images.txt", colmap::write_images_text(&images))?;
    write("points3D.txt", colmap::write_no_points_text())
}

#[cfg(test)]
mod tests {
    use super::super::cameras::{CamerasOptions, read_scene};
    use super::*;
    use crate::scene::{Distortion, Pose};
    use glam::{DMat3, DQuat, DVec2, DVec3};

    fn scene() -> Scene {
        let lenses = [
            Distortion::None,
            Distortion::RadialTangential {
                radial: [-0.12, 0.03, 0.0, 0.0, 0.0, 0.0],
                tangential: [1e-3, -2e-3],
            },
            Distortion::RadialTangential {
                radial: [-0.12, 0.03, 0.007, 0.0, 0.0, 0.0],
                tangential: [1e-3, -2e-3],
            },
            Distortion::Fisheye {
                radial: [0.01, -0.02, 0.003, 1e-4],
            },
            Distortion::None,
        ];
        let view = |(id, lens): (u32, Distortion)| {
            let t = f64::from(id) + 0.37;
            let focal = DVec2::new(1000.0 / 3.0, 1001.0 / 3.0);
            let camera = Camera::new(640, 480, focal, DVec2::new(319.123, 240.7)).unwrap();
            let turn = DQuat::from_euler(glam::EulerRot::XYZ, 2.9 * t, 1.1 * t, -0.7 * t);
            View {
                id: 3 * id,
                name: String::new(),
                camera: camera.with_distortion(lens).unwrap(),
                pose: Pose::new(DMat3::from_quat(turn), DVec3::new(t, -2.0 * t, 1e3 / 7.0))
                    .unwrap(),
                depth_range: None,
            }
        };
        Scene::new((0..).zip(lenses).map(view).collect()).unwrap()
    }

    fn close(written: &Scene, read: &Scene) {
        assert_eq!(written.views().len(), read.views().len());
        for (a, b) in written.views().iter().zip(read.views()) {
            assert_eq!((a.id, a.camera), (b.id, b.camera));
            let (a, b) = (a.pose.matrix(), b.pose.matrix());
            for (a, b) in a.to_cols_array().into_iter().zip(b.to_cols_array()) {
                assert!((a - b).abs() <= 1e-12 * a.abs().max(1.0), "{a} {b}");
            }
        }
    }

    #[test]
    fn both_read_back_to_the_same_cameras() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("transforms.json");
        write_transforms(&path, &scene(), IN_SCENE_FOLDER).unwrap();
        close(
            &scene(),
            &read_scene(&path, &CamerasOptions::default()).unwrap().scene,
        );
        let model = folder.path().join("sparse/0");
        write_colmap(&model, &scene()).unwrap();
        let read = read_scene(&model, &CamerasOptions::default())
            .unwrap()
            .scene;
        close(&scene(), &read);
        assert_eq!(read.views()[1].name, "00000003.jpg");
        let cameras = std::fs::read_to_string(model.join("cameras.txt")).unwrap();
        let lines = cameras.lines().filter(|line| !line.starts_with('#'));
        assert_eq!(lines.count(), 4, "equal cameras are one");
    }

    /// Far from the origin a rotation that is off by 1e-6 moves the centre by some units, if the translation is kept.
    #[test]
    fn centres_stay_where_rotations_are_rounded() {
        let center = DVec3::new(451_000.25, 5_100_000.125, 321.5);
        let views = scene().views().to_vec().into_iter().map(|view| {
            let rounded =
                (view.pose.rotation().to_cols_array()).map(|entry| (entry * 1e6).round() / 1e6);
            let rotation = DMat3::from_cols_array(&rounded);
            let pose = Pose::new(rotation, -(rotation * center)).unwrap();
            View { pose, ..view }
        });
        let written = Scene::new(views.collect()).unwrap();
        let folder = tempfile::tempdir().unwrap();
        write_colmap(folder.path(), &written).unwrap();
        let read = read_scene(folder.path(), &CamerasOptions::default()).unwrap();
        for (written, read) in written.views().iter().zip(read.scene.views()) {
            let moved = (read.pose.center_in_world() - center).length();
            assert!(moved < 1e-8, "{moved}");
            let difference = written.pose.rotation() - read.pose.rotation();
            let worst = difference.to_cols_array().map(f64::abs);
            assert!(worst.into_iter().all(|entry| entry < 1e-6), "{difference}");
        }
    }

    #[test]
    fn a_lens_that_the_format_has_no_words_for_is_refused() {
        let lens = Distortion::RadialTangential {
            radial: [0.0, 0.0, 0.0, 0.1, 0.0, 0.0],
            tangential: [0.0; 2],
        };
        let mut views = scene().views().to_vec();
        views[0].camera = views[0].camera.with_distortion(lens).unwrap();
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("transforms.json");
        let error = write_transforms(&path, &Scene::new(views).unwrap(), "").unwrap_err();
        assert!(error.to_string().contains("k4"), "{error}");
        assert!(!path.exists());
    }
}
