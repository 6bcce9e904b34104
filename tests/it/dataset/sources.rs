//! Source views, and what masks call visible in them.

use super::*;

/// A COLMAP model of the synthetic scene with points, of which each view saw every third that the
/// surface does not hide from it.
fn model_with_points(folder: &Path) {
    let truth = synthetic();
    exports::write_colmap(folder, truth.scene()).unwrap();
    let renderer = Renderer::new(truth.mesh()).unwrap();
    let vertices = truth.mesh().vertices();
    let chosen: Vec<usize> = (0..vertices.len())
        .step_by(vertices.len() / 600 + 1)
        .collect();
    let mut seen = vec![String::new(); truth.scene().views().len()];
    let mut points = String::new();
    for (id, &vertex) in (1..).zip(&chosen) {
        let at = vertices[vertex];
        points += &format!("{id} {} {} {} 9 9 9 0.5 1 0\n", at.x, at.y, at.z);
        for (index, view) in truth.scene().views().iter().enumerate() {
            let center = view.pose.center_in_world();
            let hidden = renderer
                .first_hit(center, at - center, (0.0, 0.999))
                .is_some();
            if let Some(pixel) = view.camera.project(view.pose.to_cam(at))
                && (id + index) % 3 == 0
                && !hidden
                && pixel.cmpge(DVec2::ZERO).all()
                && pixel.cmplt(DVec2::new(128.0, 96.0)).all()
            {
                seen[index] += &format!("{} {} {id} ", pixel.x, pixel.y);
            }
        }
    }
    write(&folder.join("points3D.txt"), &points);
    let images = files::read_text(&folder.join("images.txt")).unwrap();
    let images = images
        .lines()
        .filter(|line| !line.starts_with('#') && !line.is_empty());
    let images: String = images
        .zip(seen)
        .map(|(image, seen)| format!("{image}\n{seen}\n"))
        .collect();
    write(&folder.join("images.txt"), &images);
}

#[test]
fn source_views_come_from_the_mesh_or_from_a_sparse_model() {
    let folder = tempfile::tempdir().unwrap();
    let model = folder.path().join("model");
    model_with_points(&model);
    let alone = folder.path().join("pair.txt");
    let output = mvs_eval(&["pairs", "--cameras", text(&model), "--out", text(&alone)]);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    let with = |more: &[&str]| {
        let cameras = ["--cameras", text(&model), "--force"];
        succeed(folder.path(), &[&cameras[..], more].concat());
        let scene = scene_of(&folder.path().join("dataset"));
        (
            files::read_text(&scene.pairs()).unwrap(),
            std::fs::read(scene.covisibility()).ok(),
        )
    };
    let (exact, table) = with(&["--pairs", "exact", "--extras", "covisibility"]);
    let (colmap, same) = with(&["--pairs", "colmap", "--extras", "covisibility"]);
    assert_eq!(colmap, files::read_text(&alone).unwrap());
    assert_ne!(exact, colmap);
    assert!(table.is_some() && table == same, "the table is the mesh's");
    // What is no longer asked for goes.
    assert_eq!(with(&["--pairs", "colmap"]), (colmap, None));
    // A view that sees the surface and no point of the model.
    let whole = files::read_text(&model.join("images.txt")).unwrap();
    let (first, rest) = whole.split_once('\n').unwrap();
    let (_, rest) = rest.split_once('\n').unwrap();
    write(&model.join("images.txt"), format!("{first}\n\n{rest}"));
    let again = ["--cameras", text(&model), "--force", "--pairs", "colmap"];
    let output = generate(folder.path(), &again);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    let said = stderr(&output);
    assert!(
        said.contains("points of the COLMAP model give it no source view"),
        "{said}"
    );
    write(&model.join("images.txt"), &whole);
    // Cams beside the model are taken as the cameras, numbered otherwise.
    let both = folder.path().join("both");
    for (name, bytes) in files_in(&model) {
        write(&both.join("sparse").join(name), bytes);
    }
    for (name, bytes) in files_in(&inputs().join("cams")) {
        write(&both.join("cams").join(name), bytes);
    }
    let more = [
        "--cameras",
        text(&both),
        "--pairs",
        "colmap",
        "--out",
        "mixed",
    ];
    let output = generate(folder.path(), &more);
    assert_eq!(output.status.code(), Some(2));
    let said = stderr(&output);
    assert!(
        said.contains("of a COLMAP model") && said.contains("Cams"),
        "{said}"
    );
    // Without points there is nothing to choose by.
    exports::write_colmap(&model, synthetic().scene()).unwrap();
    let more = [
        "--cameras",
        text(&model),
        "--pairs",
        "colmap",
        "--out",
        "other",
    ];
    let output = generate(folder.path(), &more);
    assert_eq!(output.status.code(), Some(2));
    assert!(stderr(&output).contains("points3D"), "{}", stderr(&output));
}

/// Of the pixels that the occlusion masks of a scene on disk call visible: how many there are, and
/// how many of them, carried into the source by depth and cams, lie on the source's first surface to
/// 1e-4 of their depth.
fn reprojected(scene: &BlendedFolder, mesh: &Mesh) -> (usize, usize) {
    let renderer = Renderer::new(mesh).unwrap();
    let cams = scene.read_scene(None).unwrap();
    let (mut visible, mut agree) = (0, 0);
    for (index, view) in cams.views().iter().enumerate() {
        let (depth, _) = scene.read_depth(view.id).unwrap();
        for source in cams.sources_of(index) {
            let bytes = std::fs::read(scene.occlusion(view.id, source.id)).unwrap();
            let mask = image::read_gray(&bytes).unwrap();
            let source = &cams.views()[cams.index_of(source.id).unwrap()];
            for (i, _) in (0u32..).zip(mask.values()).filter(|(_, seen)| **seen > 200) {
                let (column, row) = (i % depth.width(), i / depth.width());
                let pixel = DVec2::new(f64::from(column) + 0.5, f64::from(row) + 0.5);
                let z = f64::from(depth.get(column, row));
                let in_source = source
                    .pose
                    .to_cam(view.pose.to_world(z * view.camera.ray(pixel)));
                let at = source.camera.project(in_source).unwrap();
                let direction = source.pose.direction_to_world(source.camera.ray(at));
                let eye = source.pose.center_in_world();
                let hit = renderer.first_hit(eye, direction, (0.0, f64::INFINITY));
                visible += 1;
                let there = hit.map_or(f64::INFINITY, |hit| hit.distance);
                agree += usize::from((in_source.z / there - 1.0).abs() <= 1e-4);
            }
        }
    }
    (visible, agree)
}

#[test]
fn what_a_mask_calls_visible_lies_on_the_source_s_surface() {
    let folder = tempfile::tempdir().unwrap();
    succeed(folder.path(), &["--extras", "occlusion"]);
    let scene = scene_of(&folder.path().join("dataset"));
    let (visible, agree) = reprojected(&scene, synthetic().mesh());
    assert!(visible > 20_000, "{visible}");
    assert!(
        agree as f64 >= 0.999 * visible as f64,
        "{agree} of {visible}"
    );
}

#[test]
fn what_a_mask_calls_visible_on_a_real_scene_lies_on_the_source_s_surface() {
    let Some(data) = real_data("scene_saharov") else {
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let part = |name: &str| text(&data.join(name)).to_owned();
    let (mesh, cams, photos) = (part("model"), part("cams"), part("images"));
    let given = ["--mesh", &mesh, "--cameras", &cams, "--photos", &photos];
    let more = [
        "--pixel-center",
        "integer",
        "--size",
        "400x300",
        "--extras",
        "occlusion",
    ];
    succeed(folder.path(), &[&given[..], &more].concat());
    let scene = scene_of(&folder.path().join("dataset"));
    let mesh = mvs_datasets::layout::mesh::read_meshes(&[data.join("model")])
        .unwrap()
        .mesh;
    let (visible, agree) = reprojected(&scene, &mesh);
    assert!(visible > 1_000_000, "{visible}");
    assert!(
        agree as f64 >= 0.999 * visible as f64,
        "{agree} of {visible}"
    );
    let verified = mvs_eval(&["verify", text(scene.path())]);
    assert_eq!(verified.status.code(), Some(0), "{}", stderr(&verified));
}
