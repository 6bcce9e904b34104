//! Generating a scene: what is written, that it is the truth, and that it can be interrupted.

use glam::{DVec2, DVec3};
use mvs_datasets::layout::blended::{self, BlendedFolder};
use mvs_datasets::scene::{ColorImage, DepthMap, Mesh, Pose, View};
use mvs_datasets::synthetic::{SyntheticOptions, SyntheticScene};
use mvs_eval::error::Result;
use mvs_eval::generate::{
    Extra, GenerateOptions, PairOptions, Part, Photographs, RangeRule, Source, Target, generate,
    generate_sets, scene_id,
};
use mvs_eval::parallel;
use mvs_eval::progress::Silent;
use mvs_eval::render::{RenderOptions, Renderer, Rendering};
use mvs_eval::warning::Warnings;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};

/// A scene to generate, with exact source views and without notes.
fn source_of<'a>(
    (name, id): (&'a str, &'a str),
    (mesh, views): (&'a Mesh, &'a [View]),
    photographs: &'a dyn Photographs,
) -> Source<'a> {
    Source {
        name,
        id,
        mesh,
        views,
        photographs,
        notes: &[],
        sources: None,
    }
}

/// A synthetic scene that lights its renderings, and counts how often it is asked to.
struct Lit {
    scene: SyntheticScene,
    asked: AtomicUsize,
}

impl Lit {
    fn new() -> Self {
        Self::of_views(6)
    }

    fn of_views(views: u32) -> Self {
        let options = SyntheticOptions {
            views,
            width: 128,
            height: 96,
            ..SyntheticOptions::default()
        };
        Self {
            scene: SyntheticScene::new(options).unwrap(),
            asked: AtomicUsize::new(0),
        }
    }

    fn generate(&self, folder: &Path, options: &GenerateOptions) -> Warnings {
        let warnings = Warnings::default();
        let id = scene_id("synthetic");
        let surface = (self.scene.mesh(), self.scene.scene().views());
        let source = source_of(("synthetic", &id), surface, self);
        let folder = BlendedFolder::new(folder);
        generate(&source, &folder, options, &Silent, &warnings).unwrap();
        warnings
    }
}

impl Lit {
    /// The fraction of a view's pixels that show the mesh.
    fn scene_coverage(&self, view: &View) -> f64 {
        let renderer = Renderer::new(self.scene.mesh()).unwrap();
        let depth = renderer.render(view, &draft().render).unwrap().depth;
        depth.valid_count() as f64 / depth.values().len() as f64
    }
}

impl Photographs for Lit {
    fn photograph(&self, view: &View, rendering: &Rendering) -> Result<ColorImage> {
        self.asked.fetch_add(1, Ordering::Relaxed);
        let index = self.scene.scene().index_of(view.id).unwrap();
        Ok(self.scene.photograph(index, &rendering.color))
    }

    fn digest(&self, _view: &View) -> Result<String> {
        Ok("synthetic".to_owned())
    }
}

/// The default but for draft renderings and few points, so that tests are quick.
fn draft() -> GenerateOptions {
    GenerateOptions {
        render: RenderOptions {
            samples: 1,
            ..RenderOptions::default()
        },
        pairs: PairOptions {
            points: 200,
            ..PairOptions::default()
        },
        ..GenerateOptions::default()
    }
}

fn all_extras() -> GenerateOptions {
    GenerateOptions {
        extras: [
            Extra::InputImages,
            Extra::RenderedImages,
            Extra::Masks,
            Extra::Normals,
            Extra::Covisibility,
        ]
        .into(),
        ..draft()
    }
}

/// Every file under `root` with its bytes.
fn files(root: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut found = BTreeMap::new();
    let mut folders = vec![root.to_path_buf()];
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else {
                let name = path.strip_prefix(root).unwrap().to_path_buf();
                found.insert(name, std::fs::read(&path).unwrap());
            }
        }
    }
    found
}

#[test]
fn a_scene_holds_the_files_that_readers_want_and_nothing_among_them() {
    let folder = tempfile::tempdir().unwrap();
    Lit::new().generate(folder.path(), &all_extras());
    let names = |inside: &str| blended::names_in(&folder.path().join(inside)).unwrap();
    assert_eq!(names("cams").len(), 7);
    assert_eq!(names("rendered_depth_maps").len(), 6);
    assert_eq!(
        names("blended_images")[..2],
        ["00000000.jpg", "00000000_masked.jpg"]
    );
    assert_eq!(names("blended_images").len(), 12);
    for extra in [
        "input_images",
        "rendered_images",
        "masks",
        "normals",
        "views",
    ] {
        assert_eq!(names(extra).len(), 6, "{extra}");
    }
    assert!(folder.path().join("covisibility.npy").is_file());
}

#[test]
fn what_is_read_back_is_the_exact_truth() {
    let folder = tempfile::tempdir().unwrap();
    let lit = Lit::new();
    lit.generate(folder.path(), &all_extras());
    let read = BlendedFolder::new(folder.path());
    let scene = read.read_scene(None).unwrap();
    let truth = lit.scene.scene();
    assert_eq!(scene.views().len(), 6);
    for (index, (view, expected)) in scene.views().iter().zip(truth.views()).enumerate() {
        assert_eq!((view.id, view.camera), (expected.id, expected.camera));
        assert_eq!(view.pose, expected.pose);
        assert!(!scene.sources_of(index).is_empty());
        let (depth, rejected) = read.read_depth(view.id).unwrap();
        assert_eq!(rejected.total(), 0);
        let exact = lit.scene.depth(index);
        let close = share_that(&depth, &exact, |a, b| (a / b - 1.0).abs() < 2e-3);
        assert!(close > 0.99, "view {index}: {close}");
        let image = read.read_image(view.id).unwrap();
        assert_eq!(image.size(), depth.size());
    }
}

/// The fraction of pixels that agree on whether there is surface, and where there is, on `test`.
fn share_that(a: &DepthMap, b: &DepthMap, test: impl Fn(f32, f32) -> bool) -> f64 {
    let pairs = a.values().iter().zip(b.values());
    let agree = pairs.filter(|&(&a, &b)| if a * b == 0.0 { a == b } else { test(a, b) });
    agree.count() as f64 / a.values().len() as f64
}

#[test]
fn the_masked_image_is_dark_outside_the_mask() {
    let folder = tempfile::tempdir().unwrap();
    Lit::new().generate(folder.path(), &draft());
    let read = BlendedFolder::new(folder.path());
    for id in 0..6 {
        let masked = mvs_datasets::layout::files::read_image(&read.masked_image(id)).unwrap();
        let (depth, _) = read.read_depth(id).unwrap();
        let outside = masked.values().iter().zip(depth.values());
        let outside = outside.filter(|(_, depth)| **depth == 0.0);
        let worst = outside.flat_map(|(pixel, _)| *pixel).max().unwrap_or(0);
        assert!(worst <= 10, "view {id}: {worst}");
    }
}

#[test]
fn threads_do_not_change_a_byte_and_nothing_is_done_twice() {
    let (one, four) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let lit = Lit::new();
    let run = |threads, folder: &Path| {
        parallel::with_threads(threads, || lit.generate(folder, &all_extras())).unwrap();
    };
    run(1, one.path());
    run(4, four.path());
    assert_eq!(files(one.path()), files(four.path()));
    assert_eq!(lit.asked.load(Ordering::Relaxed), 12);
    run(2, one.path());
    assert_eq!(
        lit.asked.load(Ordering::Relaxed),
        12,
        "finished views were made again"
    );
}

#[test]
fn damaged_missing_and_outdated_views_are_made_again() {
    let (whole, mended) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let lit = Lit::new();
    lit.generate(whole.path(), &all_extras());
    lit.generate(mended.path(), &all_extras());
    let asked = || lit.asked.swap(0, Ordering::Relaxed);
    asked();
    let file = |name: &str| mended.path().join(name);
    std::fs::remove_file(file("masks/00000001.png")).unwrap();
    std::fs::copy(file("cams/00000003_cam.txt"), file("cams/00000002_cam.txt")).unwrap();
    std::fs::copy(file("views/00000003.json"), file("views/00000004.json")).unwrap();
    std::fs::copy(file("scene.json"), file("cams/.mvs-eval-abc.part")).unwrap();
    std::fs::copy(file("masks/00000003.png"), file("masks/00000077.png")).unwrap();
    std::fs::copy(file("masks/00000003.png"), file("masks/mine.png")).unwrap();
    lit.generate(mended.path(), &all_extras());
    assert_eq!(asked(), 3);
    // What somebody else put there stays.
    std::fs::remove_file(file("masks/mine.png")).unwrap();
    assert_eq!(files(whole.path()), files(mended.path()));
    let widened = GenerateOptions {
        range: RangeRule::Widened,
        ..all_extras()
    };
    lit.generate(mended.path(), &widened);
    assert_eq!(asked(), 6, "other options, other views");
}

#[test]
fn a_view_that_sees_nothing_is_left_out_and_named() {
    let folder = tempfile::tempdir().unwrap();
    let lit = Lit::new();
    let mut views = lit.scene.scene().views().to_vec();
    let away = views[2].pose.center_in_world() * 3.0;
    views[2].pose =
        mvs_datasets::scene::Pose::looking_at(away, away * 2.0, glam::DVec3::new(0.1, 0.2, 1.0))
            .unwrap();
    let id = scene_id("n");
    let source = source_of(("n", &id), (lit.scene.mesh(), &views), &lit);
    let warnings = Warnings::default();
    let options = draft();
    let read = BlendedFolder::new(folder.path());
    let record = generate(&source, &read, &options, &Silent, &warnings).unwrap();
    assert_eq!(record.left_out[0].id, 2);
    assert!(warnings.sorted()[0].message.contains("view 2"));
    let scene = read.read_scene(None).unwrap();
    assert_eq!(scene.index_of(2), None);
}

/// A set so small that a view which sees the mesh's edge only has no pixel centre on it.
#[test]
fn views_too_far_apart_to_be_sources_are_told_so() {
    let folder = tempfile::tempdir().unwrap();
    let lit = Lit::of_views(4); // a quarter of a turn apart
    let source = source_of(
        ("far", "0123456789abcdef01234567"),
        (lit.scene.mesh(), lit.scene.scene().views()),
        &lit,
    );
    let target = BlendedFolder::new(folder.path());
    let made = generate(&source, &target, &draft(), &Silent, &Warnings::default());
    let said = made.unwrap_err().to_string();
    assert!(
        said.contains("found none among 4: some see it, but under angles"),
        "{said}"
    );
}

#[test]
fn a_view_without_surface_in_one_of_the_sets_is_left_out_of_all() {
    let folder = tempfile::tempdir().unwrap();
    let lit = Lit::new();
    let mut views = lit.scene.scene().views().to_vec();
    // Look past the scene, so that surface shows in a corner of the frame alone.
    let center = views[2].pose.center_in_world();
    let full = |view: &View| lit.scene_coverage(view);
    let mut turned = 0.0;
    while full(&views[2]) > 0.01 {
        turned += 0.02;
        let ahead = views[2].pose.direction_to_world(glam::DVec3::Z);
        let aside = views[2].pose.direction_to_world(glam::DVec3::X);
        views[2].pose = Pose::looking_at(
            center,
            center + ahead + 0.02 * aside,
            DVec3::new(0.1, 0.2, 1.0),
        )
        .unwrap();
        assert!(turned < 10.0);
    }
    assert!(full(&views[2]) > 0.0);
    let id = scene_id("n");
    let source = source_of(("n", &id), (lit.scene.mesh(), &views), &Plain);
    let target = |name: &str, size| Target {
        folder: BlendedFolder::new(folder.path().join(name)),
        size: Some(size),
    };
    let targets = [target("high", (128, 96)), target("low", (8, 6))];
    let warnings = Warnings::default();
    let options = draft();
    let work = (&targets[..], Part::All);
    let sets = generate_sets(&source, work, &options, &mut |_| {}, &Silent, &warnings).unwrap();
    for set in sets {
        let scene = set.scene.unwrap();
        assert_eq!(scene.left_out.len(), 1, "{:?}", scene.left_out);
        assert_eq!(scene.left_out[0].id, 2);
        let reason = &scene.left_out[0].reason;
        assert!(reason.contains("one of the sets"), "{reason}");
    }
}

/// Grey photographs of the cameras' sizes.
struct Plain;

impl Photographs for Plain {
    fn photograph(&self, view: &View, _rendering: &Rendering) -> Result<ColorImage> {
        Ok(ColorImage::filled(
            view.camera.width(),
            view.camera.height(),
            [120; 3],
        )?)
    }

    fn digest(&self, _view: &View) -> Result<String> {
        Ok(String::new())
    }
}

/// A photograph that is exchanged after it was read: what was written is of the first one.
#[test]
fn a_photograph_exchanged_during_the_run_is_used_next_time() {
    struct Exchanged(AtomicUsize);
    impl Photographs for Exchanged {
        fn photograph(&self, view: &View, rendering: &Rendering) -> Result<ColorImage> {
            let image = Plain.photograph(view, rendering);
            if view.id == 3 {
                self.0.fetch_add(1, Ordering::SeqCst);
            }
            image
        }

        fn digest(&self, view: &View) -> Result<String> {
            match view.id {
                3 => Ok(self.0.load(Ordering::SeqCst).min(1).to_string()),
                _ => Ok(String::new()),
            }
        }
    }
    let folder = tempfile::tempdir().unwrap();
    let lit = Lit::new();
    let photographs = Exchanged(AtomicUsize::new(0));
    let id = scene_id("n");
    let source = source_of(
        ("n", &id),
        (lit.scene.mesh(), lit.scene.scene().views()),
        &photographs,
    );
    let read = BlendedFolder::new(folder.path());
    for expected in [1, 2, 2] {
        generate(&source, &read, &draft(), &Silent, &Warnings::default()).unwrap();
        assert_eq!(photographs.0.load(Ordering::SeqCst), expected);
    }
}

/// Faces wound the other way, and images of no readers' shape, are in `scene.json` and said.
#[test]
fn what_readers_and_users_stumble_over_is_a_warning() {
    let folder = tempfile::tempdir().unwrap();
    let lit = Lit::new();
    let mesh = lit.scene.mesh();
    let mut views = lit.scene.scene().views().to_vec();
    views[1].camera = views[1].camera.resized(96, 72).unwrap();
    views[2].camera = views[2].camera.cropped(0, 0, 128, 80).unwrap();
    // Two faces of three are wound the other way.
    let wound = |(index, [a, b, c]): (usize, [u32; 3])| match index % 3 {
        0 => [a, b, c],
        _ => [a, c, b],
    };
    let triangles = mesh.triangles().iter().copied().enumerate().map(wound);
    let turned = Mesh::new(mesh.vertices().to_vec(), triangles.collect()).unwrap();
    let id = scene_id("n");
    let source = source_of(("n", &id), (&turned, &views), &Plain);
    let read = BlendedFolder::new(folder.path());
    let warnings = Warnings::default();
    let record = generate(&source, &read, &draft(), &Silent, &warnings).unwrap();
    let of_scene: Vec<&str> = record
        .warnings
        .iter()
        .map(|(code, _)| code.as_str())
        .collect();
    let said = warnings.sorted();
    for code in ["aspect", "mixed-sizes", "back-faces"] {
        assert!(of_scene.contains(&code), "{code}: {of_scene:?}");
        assert!(said.iter().any(|warning| warning.code == code), "{code}");
    }
    assert!(record.views.iter().any(|view| view.back_faces > 0));
    assert!(said.iter().any(|w| w.message.contains("128x80, 128x96")));
    // All of them: there is no surface, and it is said why.
    let turned = mesh
        .triangles()
        .iter()
        .map(|&[a, b, c]| [a, c, b])
        .collect();
    let turned = Mesh::new(mesh.vertices().to_vec(), turned).unwrap();
    let source = source_of(("n", &id), (&turned, &views), &Plain);
    let elsewhere = BlendedFolder::new(folder.path().join("turned"));
    let error = generate(&source, &elsewhere, &draft(), &Silent, &warnings).unwrap_err();
    let error = error.to_string();
    assert!(
        error.contains("6 of them see only the backs of triangles")
            && error.contains("--back-faces"),
        "{error}"
    );
}

#[test]
fn a_size_is_reached_by_scaling_and_cutting_and_depth_is_rendered_there() {
    let folder = tempfile::tempdir().unwrap();
    let lit = Lit::new();
    let options = GenerateOptions {
        size: Some((120, 120)),
        ..draft()
    };
    // The synthetic photographs have the rendering's size, so this goes through an adapter.
    struct Full<'a>(&'a Lit);
    impl Photographs for Full<'_> {
        fn photograph(&self, view: &View, _rendering: &Rendering) -> Result<ColorImage> {
            let (width, height) = (view.camera.width(), view.camera.height());
            Ok(ColorImage::filled(width, height, [120; 3])?)
        }
        fn digest(&self, view: &View) -> Result<String> {
            self.0.digest(view)
        }
    }
    let photographs = Full(&lit);
    let id = scene_id("n");
    let source = source_of(
        ("n", &id),
        (lit.scene.mesh(), lit.scene.scene().views()),
        &photographs,
    );
    let read = BlendedFolder::new(folder.path());
    generate(&source, &read, &options, &Silent, &Warnings::default()).unwrap();
    let scene = read.read_scene(None).unwrap();
    let (small, full) = (&scene.views()[0], &lit.scene.scene().views()[0]);
    assert_eq!((small.camera.width(), small.camera.height()), (120, 120));
    // Scale 1.25 to 160 x 120, then 20 pixels off at either side.
    assert!((small.camera.focal() - 1.25 * full.camera.focal()).length() < 1e-9);
    let center = 1.25 * full.camera.center() - DVec2::new(20.0, 0.0);
    assert!((small.camera.center() - center).length() < 1e-9);
    assert_eq!(read.read_depth(0).unwrap().0.size(), (120, 120));
}
