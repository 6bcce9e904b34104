use super::*;
use crate::scene::{DepthRange, Distortion};
use glam::DVec3;
use std::io::Write;

fn put(path: &Path, text: &str) {
    files::write_atomically(path, |out| out.write_all(text.as_bytes())).unwrap();
}

fn read(path: &Path) -> ReadCameras {
    read_scene(path, &CamerasOptions::default()).unwrap()
}

fn sentence(path: &Path, options: &CamerasOptions) -> String {
    read_scene(path, options).unwrap_err().to_string()
}

const CAMERAS: &str = "3 OPENCV 640 480 500 510 321 239 -0.1 0.02 0.001 -0.002\n";
const IMAGES: &str =
    "7 0.9238795325112867 0 0.3826834323650898 0 1 2 3 3 b.jpg\n\n2 1 0 0 0 0 0 4 3 a.jpg\n\n";

#[test]
fn every_description_of_the_same_cameras_gives_the_same_scene() {
    let root = tempfile::tempdir().unwrap();
    let model = root.path().join("sparse/0");
    put(&model.join("cameras.txt"), CAMERAS);
    put(&model.join("images.txt"), IMAGES);
    let colmap = read(root.path());
    assert_eq!(
        (colmap.source, &colmap.path),
        (CameraSource::Colmap, &model)
    );
    let views = colmap.scene.views();
    assert_eq!(
        (views[0].name.as_str(), views[1].name.as_str()),
        ("a.jpg", "b.jpg")
    );
    assert_eq!(views[0].camera.center(), DVec2::new(321.0, 239.0));
    assert_ne!(views[0].camera.distortion(), Distortion::None);
    let json = root.path().join("nerf/transforms.json");
    put(&json, &as_transforms(&colmap.scene));
    let nerf = read(&json);
    assert_eq!(nerf.source, CameraSource::Transforms);
    assert_same_views(&nerf.scene, &colmap.scene, 1e-14);
    assert!(nerf.scene.views()[0].camera == colmap.scene.views()[0].camera);
    assert_eq!(read(&root.path().join("nerf")).scene, nerf.scene);
}

fn as_transforms(scene: &Scene) -> String {
    let frames: Vec<_> = scene
        .views()
        .iter()
        .map(|view| {
            let gl = DMat4::from_diagonal(glam::DVec4::new(1.0, -1.0, -1.0, 1.0));
            let matrix = (view.pose.matrix().inverse() * gl)
                .transpose()
                .to_cols_array_2d();
            serde_json::json!({"file_path": format!("./{}", view.name), "transform_matrix": matrix})
        })
        .collect();
    serde_json::json!({
        "camera_model": "OPENCV", "w": 640, "h": 480, "fl_x": 500, "fl_y": 510, "cx": 321, "cy": 239,
        "k1": -0.1, "k2": 0.02, "p1": 0.001, "p2": -0.002, "frames": frames,
    })
    .to_string()
}

fn assert_same_views(found: &Scene, expected: &Scene, tolerance: f64) {
    assert_eq!(found.views().len(), expected.views().len());
    for (found, expected) in found.views().iter().zip(expected.views()) {
        assert_eq!(found.id, expected.id);
        let apart = found.pose.matrix() - expected.pose.matrix();
        let worst = apart
            .to_cols_array()
            .into_iter()
            .fold(0.0f64, |w, v| w.max(v.abs()));
        assert!(worst <= tolerance, "view {}: {worst:e}", found.id);
        assert_eq!(found.camera.focal(), expected.camera.focal());
        assert_eq!(found.camera.center(), expected.camera.center());
    }
}

#[test]
fn options_that_the_files_answer_themselves_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let put = |name: &str, text: &str| {
        let path = folder.path().join(name);
        files::write_atomically(&path, |out| std::io::Write::write_all(out, text.as_bytes()))
            .unwrap();
    };
    put("cameras.txt", "1 PINHOLE 40 30 40 40 20 15\n");
    put("images.txt", "1 1 0 0 0 0 0 0 1 00000000.jpg\n\n");
    assert!(read(folder.path()).notes.is_empty());
    let given = CamerasOptions {
        size: Some((80, 60)),
        focal: Some(DVec2::splat(9.0)),
        ..CamerasOptions::default()
    };
    let notes = read_scene(folder.path(), &given).unwrap().notes;
    assert_eq!(
        notes,
        ["the given image size and focal length counts for nothing: Colmap files have their own"]
    );
}

#[test]
fn numbers_that_are_none_and_cams_of_other_names_are_said() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("transforms.json");
    for none in ["NaN", "Infinity", "-Infinity"] {
        let text = format!(
            "{{\"frames\": [\n{{\"file_path\": \"a.png\", \"transform_matrix\": [[1, {none}]]}}]}}"
        );
        put(&path, &text);
        let error = read_scene(&path, &CamerasOptions::default()).unwrap_err();
        let error = error.to_string();
        let said = format!("expected a transforms.json, found {none}, which");
        assert!(error.contains("line 2") && error.contains(&said), "{error}");
    }
    std::fs::remove_file(&path).unwrap();
    put(&folder.path().join("IMG_3_cam.txt"), "");
    let error = read_scene(folder.path(), &CamerasOptions::default()).unwrap_err();
    assert!(error.to_string().contains("00000012_cam.txt"), "{error}");
}

#[test]
fn what_every_frame_of_transforms_has_itself_is_not_taken_from_options() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("transforms.json");
    let matrix = "\"transform_matrix\": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]]";
    let given = CamerasOptions {
        size: Some((80, 60)),
        focal: Some(DVec2::splat(9.0)),
        center: Some(DVec2::splat(20.0)),
        ..CamerasOptions::default()
    };
    let notes = |camera: &str, more: &str| {
        put(
            &path,
            &format!("{{{camera}, \"frames\": [{{\"file_path\": \"a.png\", {more}{matrix}}}]}}"),
        );
        read_scene(&path, &given).unwrap().notes
    };
    let said = [
        "the given image size and focal length counts for nothing: Transforms files have their own",
    ];
    let camera = "\"w\": 40, \"h\": 30, \"camera_angle_x\": 0.5";
    assert_eq!(notes(camera, ""), said);
    assert_eq!(notes("\"w\": 40, \"h\": 30", "\"fl_x\": 40, "), said);
    assert!(
        notes("\"aabb_scale\": 1", "")
            .iter()
            .all(|note| !note.contains("counts for nothing"))
    );
}

#[test]
fn the_real_scene_is_the_same_in_three_descriptions() {
    let beside = concat!(env!("CARGO_MANIFEST_DIR"), "/../../shared/data");
    let given = std::env::var_os("MVS_EVAL_DATA").map(PathBuf::from);
    let data = given.clone().unwrap_or_else(|| beside.into());
    if !data.is_dir() {
        assert!(
            given.is_none(),
            "MVS_EVAL_DATA: {} is not there",
            data.display()
        );
        eprintln!("skipped: no data at {} (set MVS_EVAL_DATA)", data.display());
        return;
    }
    let integer = CamerasOptions {
        pixel_centre: PixelCentre::Integer,
        ..CamerasOptions::default()
    };
    let folder = data.join("scene_saharov");
    let cams = read_scene(&folder, &integer).unwrap();
    assert_eq!(cams.source, CameraSource::Cams);
    assert!(
        cams.notes[0].contains("not the COLMAP model in") && cams.notes[0].ends_with("colmap"),
        "{:?}",
        cams.notes
    );
    let colmap = read(&folder.join("colmap"));
    assert_same_views(&colmap.scene, &cams.scene, 2e-9);
    let sizes = |scene: &Scene| {
        scene
            .views()
            .iter()
            .map(|v| v.camera.width())
            .collect::<Vec<_>>()
    };
    assert_eq!(sizes(&colmap.scene), sizes(&cams.scene));
    // Sorted depths of view 0's own 628 points by pycolmap 4.2.1, places 6 and 621.
    let range = colmap.scene.views()[0].depth_range.unwrap();
    let expected = DepthRange::new(1.4964564556448166, 2.044108071471348).unwrap();
    assert!(
        (range.min() - expected.min()).abs() < 1e-12
            && (range.max() - expected.max()).abs() < 1e-12
    );
    let given = CamerasOptions {
        size: Some((1092, 728)),
        focal: Some(DVec2::splat(1645.197217)),
        ..CamerasOptions::default()
    };
    let log = read_scene(&data.join("pair_saharov/saharov_COLMAP_SfM.log"), &given).unwrap();
    assert_same_views(&log.scene, &cams.scene, 2e-9);
    for path in [
        "formats/cameras/open3d_example.json",
        "formats/cameras/cameras.out",
    ] {
        let said = sentence(&data.join(path), &given);
        assert!(
            said.contains("expected") && said.contains("found"),
            "{said}"
        );
    }
}

#[test]
fn two_images_of_one_name_are_named() {
    let root = tempfile::tempdir().unwrap();
    put(&root.path().join("cameras.txt"), CAMERAS);
    let twice = IMAGES.replace("b.jpg", "a.jpg");
    put(&root.path().join("images.txt"), &twice);
    let said = sentence(root.path(), &CamerasOptions::default());
    let expected = "images 7 and 2: expected distinct names, found a.jpg for both";
    assert!(said.contains(expected), "{said}");
}

/// The text may be older or newer than the binary files.
#[test]
fn a_model_that_is_there_twice_is_said() {
    let root = tempfile::tempdir().unwrap();
    put(&root.path().join("cameras.txt"), CAMERAS);
    put(&root.path().join("images.txt"), IMAGES);
    assert_eq!(read(root.path()).notes, [""; 0]);
    let mut cameras = 1u64.to_le_bytes().to_vec();
    cameras.extend(3u32.to_le_bytes());
    cameras.extend(1i32.to_le_bytes());
    cameras.extend([640u64, 480].iter().flat_map(|side| side.to_le_bytes()));
    let params = [500.0, 510.0, 321.0, 239.0f64];
    cameras.extend(params.iter().flat_map(|param| param.to_le_bytes()));
    let mut images = 1u64.to_le_bytes().to_vec();
    images.extend(2u32.to_le_bytes());
    let pose = [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 4.0f64];
    images.extend(pose.iter().flat_map(|number| number.to_le_bytes()));
    images.extend(3u32.to_le_bytes());
    images.extend(b"a.jpg\0");
    images.extend(0u64.to_le_bytes());
    for (name, bytes) in [("cameras.bin", cameras), ("images.bin", images)] {
        let path = root.path().join(name);
        files::write_atomically(&path, |out| out.write_all(&bytes)).unwrap();
    }
    let both = read(root.path());
    assert_eq!(both.scene.views().len(), 1);
    assert!(
        both.notes[0].contains("holds the model as .txt too"),
        "{:?}",
        both.notes
    );
}

#[test]
fn integer_centres_are_refused_where_the_files_define_theirs() {
    let root = tempfile::tempdir().unwrap();
    put(&root.path().join("cameras.txt"), CAMERAS);
    put(&root.path().join("images.txt"), IMAGES);
    let integer = CamerasOptions {
        pixel_centre: PixelCentre::Integer,
        ..CamerasOptions::default()
    };
    let said = sentence(root.path(), &integer);
    assert!(
        said.contains("COLMAP defines pixel centres at (0.5, 0.5)"),
        "{said}"
    );
    let said = super::super::sparse::read_sparse(root.path(), &integer);
    let said = said.unwrap_err().to_string();
    assert!(said.contains("leave --pixel-center out"), "{said}");
}

#[test]
fn names_that_are_numbers_are_ids() {
    assert_eq!(number_names(&["x/00000012.jpg", "3.png"]), [12, 3]);
    assert_eq!(number_names(&["b/1.jpg", "a/1.jpg"]), [1, 0]);
    assert_eq!(
        number_names(&["frame_2.jpg", "7.jpg", "frame_1.jpg"]),
        [2, 0, 1]
    );
    assert_eq!(number_names(&["99999999999.jpg"]), [0]);
}

#[test]
fn angles_of_view_and_given_sizes_fill_in() {
    let root = tempfile::tempdir().unwrap();
    let path = root.path().join("transforms_train.json");
    put(
        &path,
        r#"{"camera_angle_x": 1.5707963267948966, "frames": [{"file_path": "./train/r_0", "transform_matrix": [[1,0,0,0],[0,1,0,0],[0,0,1,4],[0,0,0,1]]}]}"#,
    );
    let said = sentence(&path, &CamerasOptions::default());
    assert!(
        said.contains("frame ./train/r_0: camera: expected w and h"),
        "{said}"
    );
    let given = CamerasOptions {
        size: Some((800, 600)),
        ..CamerasOptions::default()
    };
    let scene = read_scene(&path, &given).unwrap().scene;
    let view = &scene.views()[0];
    assert!((view.camera.focal() - DVec2::splat(400.0)).length() < 1e-9);
    assert_eq!(view.camera.center(), DVec2::new(400.0, 300.0));
    // The camera looks along −Z from z = 4: the origin lies 4 in front of it.
    assert_eq!(view.pose.to_cam(DVec3::ZERO), DVec3::new(0.0, 0.0, 4.0));
    assert_eq!(view.pose.to_cam(DVec3::Y), DVec3::new(0.0, -1.0, 4.0));
}

#[test]
fn logs_need_intrinsics_and_leave_out_the_unregistered() {
    let root = tempfile::tempdir().unwrap();
    let path = root.path().join("a.log");
    put(
        &path,
        "0 -1 0\n1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n1 1 0\n1 0 0 5\n0 1 0 0\n0 0 1 0\n0 0 0 1\n",
    );
    let said = sentence(&path, &CamerasOptions::default());
    assert!(
        said.contains("expected an image size and focal lengths"),
        "{said}"
    );
    let given = CamerasOptions {
        focal: Some(DVec2::splat(9.0)),
        ..CamerasOptions::default()
    };
    let said = sentence(&path, &given);
    assert!(said.contains("found no --camera-size: give it"), "{said}");
    let given = CamerasOptions {
        size: Some((8, 6)),
        ..given
    };
    let read = read_scene(&path, &given).unwrap();
    assert_eq!((read.scene.views().len(), read.scene.views()[0].id), (1, 1));
    assert_eq!(
        read.scene.views()[0].pose.center_in_world(),
        DVec3::new(5.0, 0.0, 0.0)
    );
    assert!(
        read.notes[0].contains("left out 1 of 2 poses"),
        "{:?}",
        read.notes
    );
}

#[test]
fn what_is_no_camera_is_said() {
    let root = tempfile::tempdir().unwrap();
    let none = CamerasOptions::default();
    assert!(sentence(root.path(), &none).contains("found none of them"));
    assert!(sentence(&root.path().join("no"), &none).contains("found nothing there"));
    put(&root.path().join("cameras.txt"), CAMERAS);
    put(
        &root.path().join("images.txt"),
        &IMAGES.replace(" 3 a.jpg", " 4 a.jpg"),
    );
    let said = sentence(root.path(), &none);
    assert!(
        said.contains(
            "images.txt: image 2 (a.jpg): expected a camera of the model, found camera 4"
        ),
        "{said}"
    );
    put(&root.path().join("images.txt"), "# none\n");
    assert!(sentence(root.path(), &none).contains("expected at least one image"));
    put(&root.path().join("cameras.txt"), &CAMERAS.repeat(2));
    assert!(sentence(root.path(), &none).contains("camera 3: expected distinct camera ids"));
    put(
        &root.path().join("cameras.txt"),
        "3 DIVISION 640 480 500 510 321 239 0.1\n",
    );
    assert!(
        sentence(root.path(), &none).contains("cameras.txt: camera 3: camera: expected a pinhole")
    );
}

#[test]
fn what_transforms_leave_in_place_is_a_note_and_a_frames_own_angle_counts() {
    let root = tempfile::tempdir().unwrap();
    let path = root.path().join("transforms.json");
    put(
        &path,
        r#"{"fl_x": 100, "w": 8, "h": 6, "is_fisheye": true, "k1": 0.1,
            "applied_transform": [[0, 1, 0, 0], [1, 0, 0, 0], [0, 0, -1, 0]], "frames": [
            {"file_path": "1.jpg", "transform_matrix": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]]},
            {"file_path": "2.jpg", "camera_angle_x": 1.5707963267948966,
             "transform_matrix": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]]}]}"#,
    );
    let read = read(&path);
    assert!(
        read.notes[0].contains("applied_transform is left in place"),
        "{:?}",
        read.notes
    );
    let cameras: Vec<Camera> = read.scene.views().iter().map(|view| view.camera).collect();
    assert_eq!(cameras[0].focal(), DVec2::splat(100.0));
    assert!((cameras[1].focal() - 4.0).abs().max_element() < 1e-12);
    let radial = [0.1, 0.0, 0.0, 0.0];
    assert_eq!(cameras[1].distortion(), Distortion::Fisheye { radial });
}
