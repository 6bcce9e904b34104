//! Photographs of different sizes in one scene.

use super::*;
use mvs_datasets::format::image::write_jpeg;
use mvs_eval::generate::resized;

/// Cams and photographs of the synthetic scene, those of views with an odd id at twice the size.
fn mixed(folder: &Path) -> Scene {
    let truth = synthetic();
    let is_large = |id: u32| id % 2 == 1;
    let doubled = |view: &View| match is_large(view.id) {
        true => View {
            camera: view.camera.resized(256, 192).unwrap(),
            ..view.clone()
        },
        false => view.clone(),
    };
    let scene = Scene::new(truth.scene().views().iter().map(doubled).collect()).unwrap();
    for view in scene.views() {
        let cam = mvsnet::file_name(view.id, "_cam.txt");
        mvsnet::write_view(&folder.join("cams").join(cam), view, PixelCentre::Half).unwrap();
        let name = mvsnet::file_name(view.id, ".jpg");
        let photograph = files::read_image(&inputs().join("photos").join(&name)).unwrap();
        let size = (view.camera.width(), view.camera.height());
        let photograph = resized(&photograph, size).unwrap();
        files::write_atomically(&folder.join("images").join(name), |out| {
            write_jpeg(out, &photograph, JpegOptions::default())
        })
        .unwrap();
    }
    scene
}

/// A cam has no image size: each view's is its own photograph's.
#[test]
fn cams_are_for_photographs_of_their_own_size() {
    let folder = tempfile::tempdir().unwrap();
    let scene = mixed(folder.path());
    let output = generate(folder.path(), &["--cameras", "cams", "--photos", "images"]);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    let said = stderr(&output);
    assert!(said.contains("128x96, 256x192"), "{said}");
    assert!(!said.contains("camera-size"), "{said}");
    let made = scene_of(&folder.path().join("dataset"));
    let renderer_mesh = synthetic();
    let renderer = Renderer::new(renderer_mesh.mesh()).unwrap();
    for view in scene.views() {
        let (depth, _) = files::read_depth(&made.depth(view.id)).unwrap();
        let truth = renderer.render(view, &RenderOptions::default()).unwrap();
        assert_eq!(depth.size(), truth.depth.size(), "view {}", view.id);
        let error = |(a, b): (&f32, &f32)| (a - b).abs() / b.max(1.0);
        let values = depth.values().iter().zip(truth.depth.values());
        // The mesh went through a file of text.
        let wrong = values.filter(|&pair| error(pair) > 1e-5).count();
        assert!(
            wrong * 1000 < depth.values().len(),
            "view {}: {wrong}",
            view.id
        );
    }
    // What is known of the cams is not only the first view's.
    let output = mvs_eval(&["inspect", text(folder.path())]);
    let said = String::from_utf8(output.stdout).unwrap();
    assert!(said.contains("different sizes: 128x96, 256x192"), "{said}");
}

/// A size that is asked for is that of the cams it goes with; the others are scaled to it.
#[test]
fn an_image_size_is_assumed_of_the_cams_that_it_goes_with_only() {
    let folder = tempfile::tempdir().unwrap();
    mixed(folder.path());
    let path = |name: &str| folder.path().join(name);
    let output = mvs_eval(&[
        "render",
        "--mesh",
        text(&inputs().join("mesh.obj")),
        "--cameras",
        text(&path("cams")),
        "--size",
        "128x96",
        "--samples",
        "1",
        "--out",
        text(&path("out")),
    ]);
    let said = stderr(&output);
    assert_eq!(output.status.code(), Some(0), "{said}");
    assert!(
        said.contains("3 of 6 views") && said.contains("view 1's for 256x192"),
        "{said}"
    );
    let made = mvsnet::read_scene(&path("out"), &mvsnet::CamsOptions::default()).unwrap();
    for (made, truth) in made.views().iter().zip(synthetic().scene().views()) {
        let difference = (made.camera.center() - truth.camera.center()).length();
        assert!(difference < 1e-9, "view {}: {difference}", made.id);
        let difference = (made.camera.focal() - truth.camera.focal()).length();
        assert!(difference < 1e-9, "view {}: {difference}", made.id);
    }
}

/// Where the camera files have sizes, photographs of others are named, whichever view's they are.
#[test]
fn a_photograph_of_another_size_than_its_camera_is_named() {
    let folder = tempfile::tempdir().unwrap();
    mixed(folder.path());
    let cameras = folder.path().join("transforms.json");
    exports::write_transforms(&cameras, synthetic().scene(), "").unwrap();
    let arguments = ["--cameras", "transforms.json", "--photos", "images"];
    let output = generate(folder.path(), &arguments);
    let said = stderr(&output);
    assert_eq!(output.status.code(), Some(0), "{said}");
    assert!(said.contains("3 of 6 photographs"), "{said}");
    assert!(said.contains("view 1's, from 256x192 to 128x96"), "{said}");
}
