//! Where the job reads and writes: sizes, repeats, what is missing, what is kept.

use super::*;
use crate::support::{text, turned_jpeg, write};
use mvs_eval::progress::Progress;
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::atomic::{AtomicU64, Ordering};

/// What the job warns of, by code.
fn codes(job: &FuseJob) -> (mvs_eval::Result<FuseOutcome>, Vec<String>) {
    let (outcome, warnings) = fuse_and_hear(job, true);
    let codes = warnings.into_iter().map(|warning| warning.code);
    (outcome, codes.collect())
}

fn refused(job: &FuseJob, parts: &[&str]) {
    let error = fuse(job, false).unwrap_err().to_string();
    assert!(parts.iter().all(|part| error.contains(part)), "{error}");
}

fn write_image(folder: &Path, id: u32, (width, height): (u32, u32)) {
    let grey = ColorImage::filled(width, height, [90, 100, 110]).unwrap();
    let path = folder.join("images").join(mvsnet::file_name(id, ".png"));
    files::write_atomically(&path, |out| image::write_png(out, &grey)).unwrap();
}

/// Cams for the depth maps beside images of twice their size, or of another shape in one view, give
/// the very points that cams with images of the maps' size give.
#[test]
fn cams_are_for_the_size_that_their_principal_point_goes_with() {
    let scene = scene();
    let folder = tempfile::tempdir().unwrap();
    let mut job = write_scene(&scene, None, folder.path());
    let (outcome, warned) = codes(&job);
    let points = outcome.unwrap().points;
    assert!(warned.is_empty(), "{warned:?}");
    let expected = files::read_cloud(&job.out).unwrap();
    for view in scene.scene().views() {
        write_image(folder.path(), view.id, (320, 240));
    }
    write_image(folder.path(), scene.scene().views()[2].id, (240, 320));
    let (outcome, warned) = codes(&job);
    assert_eq!(outcome.unwrap().points, points);
    assert_eq!(warned, ["camera-size"]);
    let found = files::read_cloud(&job.out).unwrap();
    assert_eq!(found.positions(), expected.positions());
    // The size can be said: cameras of twice the pixels see half as wide, off the surface.
    job.camera_size = Some("320x240".parse().unwrap());
    let outcome = codes(&job).0;
    assert!(outcome.is_err() || outcome.unwrap().points < points);
}

#[test]
fn cams_with_integer_pixel_centres_are_suspected() {
    let scene = scene();
    let folder = tempfile::tempdir().unwrap();
    let mut job = write_scene(&scene, None, folder.path());
    for view in scene.scene().views() {
        let cam = folder
            .path()
            .join("cams")
            .join(mvsnet::file_name(view.id, "_cam.txt"));
        mvsnet::write_view(&cam, view, mvsnet::PixelCentre::Integer).unwrap();
    }
    assert_eq!(codes(&job).1, ["pixel-centre"]);
    job.pixel_center = mvsnet::PixelCentre::Integer;
    let (outcome, warned) = codes(&job);
    assert!(outcome.is_ok() && warned.is_empty(), "{warned:?}");
    let cloud = files::read_cloud(&job.out).unwrap();
    let median = median_distance(&scene, cloud.positions());
    assert!(median < 2e-4, "exact under either convention: {median:e}");
}

#[test]
fn a_source_that_is_listed_twice_counts_once() {
    let scene = scene();
    let folder = tempfile::tempdir().unwrap();
    let job = write_scene(&scene, None, folder.path());
    // Each view has one source, and needs two.
    let pairs = |times: usize| {
        let views = scene.scene().views();
        let mut text = format!("{}\n", views.len());
        for (index, view) in views.iter().enumerate() {
            let source = views[(index + 1) % views.len()].id;
            let listed = format!(" {source} 9").repeat(times);
            text.push_str(&format!("{}\n{times}{listed}\n", view.id));
        }
        files::write_atomically(&folder.path().join("cams/pair.txt"), |out| {
            out.write_all(text.as_bytes())
        })
        .unwrap();
        let (outcome, warned) = codes(&job);
        (outcome.is_err(), warned)
    };
    assert_eq!(pairs(1), (true, vec!["few-sources".to_owned()]));
    let both = vec!["few-sources".to_owned(), "repeated-source".to_owned()];
    assert_eq!(pairs(3), (true, both));
}

/// As in MVSNet's data sets: they are read, and an input like any.
#[test]
fn pairs_beside_the_folder_of_cams_count() {
    let scene = scene();
    let folder = tempfile::tempdir().unwrap();
    let mut job = write_scene(&scene, None, folder.path());
    let usual = codes(&job).0.unwrap().points;
    let above = folder.path().join("pair.txt");
    std::fs::rename(folder.path().join("cams/pair.txt"), &above).unwrap();
    let text = std::fs::read_to_string(&above).unwrap();
    let run_file = folder.path().join("cloud.run.toml");
    for given in ["", "cams"] {
        write(&above, &text);
        job.scene = folder.path().join(given);
        let (outcome, warned) = codes(&job);
        assert_eq!(
            (outcome.unwrap().points, warned),
            (usual, Vec::new()),
            "{given}"
        );
        let changed = || Run::read(&run_file).unwrap().changed_inputs(&run_file);
        assert_eq!(changed(), [""; 0]);
        write(&above, format!("{text}\n"));
        assert_eq!(changed().len(), 1, "{given}");
    }
}

#[test]
fn files_beside_the_result_are_kept_too() {
    let scene = scene();
    let folder = tempfile::tempdir().unwrap();
    let mut job = write_scene(&scene, None, folder.path());
    job.out = folder.path().join("notes.json");
    refused(&job, &["notes.json", "other than"]);
    job.out = folder.path().join("notes.ply");
    for beside in ["notes.json", "notes.run.toml"] {
        let path = folder.path().join(beside);
        write(&path, "mine");
        refused(&job, &[beside, "--force"]);
        assert_eq!(std::fs::read_to_string(&path).unwrap(), "mine");
        std::fs::remove_file(&path).unwrap();
    }
    fuse(&job, false).unwrap();
    // A list of who sees which point goes with one cloud only.
    let list = folder.path().join("notes.ply.vis");
    job.vis = true;
    fuse(&job, true).unwrap();
    assert!(list.is_file());
    job.vis = false;
    std::fs::remove_file(&job.out).unwrap();
    for beside in ["notes.json", "notes.run.toml"] {
        std::fs::remove_file(folder.path().join(beside)).unwrap();
    }
    refused(&job, &["notes.ply.vis", "--force"]);
    fuse(&job, true).unwrap();
    assert!(!list.exists());
    let run_file = folder.path().join("notes.run.toml");
    let replayed = Run::read(&run_file).unwrap();
    assert!(
        replayed.changed_inputs(&run_file).is_empty(),
        "the result lies in the scene's folder and is none of its inputs"
    );
}

#[test]
fn filtered_depths_come_whole_or_not_at_all() {
    let scene = scene();
    let folder = tempfile::tempdir().unwrap();
    let mut job = write_scene(&scene, Some(&DepthNoise::default()), folder.path());
    job.filtered_depths = Some(job.depths.clone());
    refused(&job, &["depths", "that is not read"]);
    let filtered = folder.path().join("filtered");
    job.filtered_depths = Some(filtered.clone());
    job.fuse.min_confidence = 2.0;
    refused(&job, &["no pixel of 12 depth maps passed"]);
    assert!(!filtered.exists() && !job.out.exists());
    job.fuse.min_confidence = 0.5;
    fuse(&job, false).unwrap();
    assert_eq!(std::fs::read_dir(&filtered).unwrap().count(), 12);
    let left = std::fs::read_dir(folder.path()).unwrap();
    let hidden = left.filter(|entry| {
        let name = entry.as_ref().unwrap().file_name();
        name.to_string_lossy().starts_with('.')
    });
    assert_eq!(hidden.count(), 0, "no scratch folder stays");
}

/// Stops the work once it has gone some steps.
struct Stopping(AtomicU64);

impl Progress for Stopping {
    fn begin(&self, _stage: &str, _total: u64) {}

    fn advance(&self, steps: u64) {
        self.0.fetch_add(steps, Ordering::Relaxed);
    }

    fn cancelled(&self) -> bool {
        self.0.load(Ordering::Relaxed) > 2
    }
}

/// What lies in a folder, with the bytes of files.
fn content(folder: &Path) -> BTreeMap<PathBuf, Option<Vec<u8>>> {
    let entries = std::fs::read_dir(folder).unwrap();
    let paths = entries.map(|entry| entry.unwrap().path());
    paths
        .map(|path| (path.clone(), std::fs::read(path).ok()))
        .collect()
}

#[test]
fn an_interrupted_fusion_keeps_nothing_and_leaves_the_result_before_it() {
    let scene = scene();
    let folder = tempfile::tempdir().unwrap();
    let mut job = write_scene(&scene, Some(&DepthNoise::default()), folder.path());
    job.vis = true;
    fuse(&job, false).unwrap();
    let before = content(folder.path());
    for mode in [FuseMode::Hkust, FuseMode::Geo, FuseMode::Cluster] {
        job.fuse = FuseOptions::of(mode);
        let context = Context {
            progress: &Stopping(AtomicU64::new(0)),
            warnings: &Warnings::default(),
            force: true,
        };
        let error = run(&job, &context).unwrap_err();
        assert!(matches!(error, mvs_eval::Error::Interrupted), "{error}");
        assert!(content(folder.path()) == before, "{mode:?}");
    }
}

#[test]
fn what_a_killed_run_left_beside_the_cloud_goes() {
    let scene = scene();
    let folder = tempfile::tempdir().unwrap();
    let job = write_scene(&scene, None, folder.path());
    let put = |name: &str| write(&folder.path().join(name), b"half a cloud");
    let left =
        ["cloud.ply-Ab12cd", "cloud.json-xYz123"].map(|name| format!(".mvs-eval-{name}.part"));
    left.iter().for_each(|name| put(name));
    put(".mvs-eval-others.ply-Ab12cd.part");
    fuse(&job, false).unwrap();
    let there = |name: &str| folder.path().join(name).exists();
    assert!(!left.iter().any(|name| there(name)));
    assert!(there(".mvs-eval-others.ply-Ab12cd.part") && there("cloud.ply"));
}

/// As `generate` and `blend` do: the pixels count as they are stored.
#[test]
fn photographs_that_exif_says_to_turn_are_counted() {
    let scene = scene();
    let folder = tempfile::tempdir().unwrap();
    let job = write_scene(&scene, None, folder.path());
    let grey = ColorImage::filled(160, 120, [90, 100, 110]).unwrap();
    std::fs::remove_dir_all(folder.path().join("images")).unwrap();
    for (index, view) in scene.scene().views().iter().enumerate() {
        let name = mvsnet::file_name(view.id, ".jpg");
        let orientation = if index < 2 { 6 } else { 1 };
        let jpeg = turned_jpeg(&grey, orientation);
        write(&folder.path().join("images").join(name), jpeg);
    }
    let warnings = Warnings::default();
    let context = Context {
        progress: &Silent,
        warnings: &warnings,
        force: false,
    };
    run(&job, &context).unwrap();
    let said = warnings.sorted();
    let [warning] = said.as_slice() else {
        panic!("{said:?}");
    };
    assert_eq!(warning.code, "exif-orientation");
    let first = mvsnet::file_name(scene.scene().views()[0].id, ".jpg (orientation 6)");
    assert!(
        warning.message.starts_with("2 photographs"),
        "{}",
        warning.message
    );
    assert!(warning.message.contains(&first), "{}", warning.message);
}

#[test]
fn what_is_missing_is_said() {
    let scene = scene();
    let folder = tempfile::tempdir().unwrap();
    let mut job = write_scene(&scene, None, folder.path());
    let first = scene.scene().views()[0].id;
    let path = |place: &str, suffix| {
        folder
            .path()
            .join(place)
            .join(mvsnet::file_name(first, suffix))
    };
    std::fs::remove_file(path("images", ".png")).unwrap();
    // A range from 0 is none; it matters only where depths are to be kept inside ranges.
    let cam = std::fs::read_to_string(path("cams", "_cam.txt")).unwrap();
    let (rest, _) = cam.trim_end().rsplit_once('\n').unwrap();
    write(&path("cams", "_cam.txt"), format!("{rest}\n0 0.01 128 3\n"));
    let (outcome, warned) = codes(&job);
    let all = outcome.unwrap().points;
    assert_eq!(warned, ["missing-image"]);
    assert!(files::read_cloud(&job.out).unwrap().colors().is_none());
    job.fuse.view_range = true;
    let (outcome, warned) = codes(&job);
    assert!(outcome.unwrap().points <= all);
    assert_eq!(warned, ["missing-image", "no-depth-range"]);
    (job.depths, job.out) = (Default::default(), folder.path().join("other.ply"));
    refused(&job, &["--depths"]);
}

/// What `asks_for` denies changes no byte, and what it affirms some.
#[test]
fn options_that_a_mode_does_not_ask_for_are_refused_and_change_nothing() {
    let scene = scene();
    let folder = tempfile::tempdir().unwrap();
    let mut job = write_scene(&scene, Some(&DepthNoise::default()), folder.path());
    // With the views that see through a point, which `max_depth_error` tells.
    job.properties = Properties::Full;
    type Change = (&'static str, fn(&mut FuseOptions));
    let changes: [Change; 5] = [
        ("visibility", |options| {
            options.visibility = Visibility::None;
        }),
        ("sampling", |options| {
            options.sampling = match options.sampling {
                Sampling::Plain => Sampling::Valid,
                Sampling::Valid => Sampling::Plain,
            };
        }),
        ("max_pixel_error", |options| options.max_pixel_error = 0.3),
        ("max_depth_error", |options| options.max_depth_error = 1e-3),
        ("min_sources", |options| options.min_sources = 6),
    ];
    // Points without the header, which states every option.
    let points = |job: &FuseJob| {
        fuse(job, true).unwrap();
        let bytes = std::fs::read(&job.out).unwrap();
        let end = bytes.windows(11).position(|part| part == b"end_header\n");
        bytes[end.unwrap()..].to_vec()
    };
    for mode in FuseMode::ALL {
        job.fuse = FuseOptions::of(mode);
        let usual = points(&job);
        for (option, change) in changes {
            let mut job = job.clone();
            change(&mut job.fuse);
            let asked = mode.asks_for(option);
            assert_eq!(points(&job) != usual, asked, "{mode:?} {option}");
            let refused = check_used(&job, &[option]).map_err(|error| error.to_string());
            assert_eq!(refused.is_ok(), asked, "{mode:?} {option} {refused:?}");
        }
    }
    job.fuse = FuseOptions::default();
    assert!(check_used(&job, &["min_confidence"]).is_ok());
    job.confidence.clear();
    let error = check_used(&job, &["min_confidence"])
        .unwrap_err()
        .to_string();
    assert!(
        error.starts_with("--min-confidence: needs --confidence"),
        "{error}"
    );
}

#[test]
fn depths_in_other_units_and_missing_pairs_are_said() {
    let scene = scene();
    let folder = tempfile::tempdir().unwrap();
    let job = write_scene(&scene, None, folder.path());
    for view in scene.scene().views() {
        change_map(&job.depths, view.id, |_, depth| 1000.0 * depth);
    }
    let (outcome, warned) = codes(&job);
    assert!(outcome.is_err() || outcome.unwrap().points < 1000);
    assert_eq!(warned, ["depth-units"]);
    std::fs::remove_file(folder.path().join("cams/pair.txt")).unwrap();
    let (outcome, warned) = codes(&job);
    assert!(outcome.is_err());
    assert!(warned.contains(&"no-pairs".to_owned()), "{warned:?}");
}

/// However much is fused.
#[test]
fn ranges_in_other_units_are_said() {
    let scene = scene();
    let folder = tempfile::tempdir().unwrap();
    let mut job = write_scene(&scene, None, folder.path());
    let usual = codes(&job).0.unwrap().points;
    for view in scene.scene().views() {
        let range = view.depth_range.unwrap();
        let far = DepthRange::new(1000.0 * range.min(), 1000.0 * range.max()).unwrap();
        let view = View {
            depth_range: Some(far),
            ..view.clone()
        };
        let name = mvsnet::file_name(view.id, "_cam.txt");
        let path = folder.path().join("cams").join(name);
        mvsnet::write_view(&path, &view, mvsnet::PixelCentre::Half).unwrap();
    }
    for mode in [FuseMode::Hkust, FuseMode::Geo, FuseMode::Cluster] {
        job.fuse = FuseOptions::of(mode);
        let (outcome, warned) = codes(&job);
        let least = if mode == FuseMode::Cluster {
            0
        } else {
            usual / 4
        };
        assert!(outcome.unwrap().points > least, "{mode:?}");
        assert_eq!(warned, ["depth-units"], "{mode:?}");
    }
}

/// Rows cut off at the bottom look like scaled ones: only who made them knows.
#[test]
fn depth_maps_of_another_shape_than_their_cams_are_said() {
    let scene = scene();
    let folder = tempfile::tempdir().unwrap();
    let mut job = write_scene(&scene, None, folder.path());
    for view in scene.scene().views() {
        let path = job.depths.join(mvsnet::file_name(view.id, ".pfm"));
        let whole = files::read_raster(&path).unwrap();
        let rows = whole.values()[..160 * 112].to_vec();
        let cut = Raster::from_values(160, 112, rows).unwrap();
        files::write_atomically(&path, |out| pfm::write_gray(out, &cut)).unwrap();
    }
    let (_, warned) = codes(&job);
    assert_eq!(warned, ["depth-shape"]);
    job.camera_size = Some("160x112".parse().unwrap());
    let (outcome, warned) = codes(&job);
    assert!(warned.is_empty() && outcome.is_ok(), "{warned:?}");
    let cloud = files::read_cloud(&job.out).unwrap();
    assert!(median_distance(&scene, cloud.positions()) < 1e-4);
}

#[test]
fn options_of_workspaces_do_not_go_with_cams_and_a_failing_run_keeps_the_result_before_it() {
    let scene = scene();
    let folder = tempfile::tempdir().unwrap();
    let mut job = write_scene(&scene, None, folder.path());
    job.stereo = StereoPass::Photometric;
    refused(&job, &["--stereo", "workspace"]);
    job.stereo = StereoPass::Geometric;
    fuse(&job, false).unwrap();
    let files = ["cloud.ply", "cloud.json", "cloud.run.toml"];
    let contents = || files.map(|name| std::fs::read(folder.path().join(name)).unwrap());
    let before = contents();
    job.fuse.bounds = Some([[1e6; 3], [1e6 + 1.0; 3]]);
    assert!(fuse(&job, true).is_err());
    assert_eq!(contents(), before);
}

#[test]
fn no_result_takes_the_place_of_an_input_or_of_what_is_no_file() {
    let scene = scene();
    let folder = tempfile::tempdir().unwrap();
    let mut job = write_scene(&scene, None, folder.path());
    let refused = |job: &FuseJob, parts: &[&str]| {
        let error = fuse(job, true).unwrap_err().to_string();
        assert!(parts.iter().all(|part| error.contains(part)), "{error}");
    };
    let map = std::fs::read_dir(&job.depths)
        .unwrap()
        .next()
        .unwrap()
        .unwrap()
        .path();
    let cam = std::fs::read_dir(job.scene.join("cams"))
        .unwrap()
        .next()
        .unwrap()
        .unwrap()
        .path();
    for input in [&map, &cam] {
        let before = std::fs::read(input).unwrap();
        job.out.clone_from(input);
        refused(&job, &[text(input), "found an input"]);
        assert_eq!(std::fs::read(input).unwrap(), before);
    }
    // A crop beside the cloud has the name that the report would have.
    let crop = folder.path().join("barn.json");
    let corners =
        r#""class_name":"SelectionPolygonVolume","orthogonal_axis":"Z","axis_min":-9,"axis_max":9"#;
    let polygon = "[[-9,-9,0],[9,-9,0],[9,9,0],[-9,9,0]]";
    let content = format!(
        r#"{{{corners},"bounding_polygon":{polygon},"version_major":1,"version_minor":0}}"#
    );
    write(&crop, &content);
    job.crop = Some(crop.clone());
    job.out = folder.path().join("barn.ply");
    refused(&job, &["barn.json", "found an input"]);
    assert_eq!(std::fs::read_to_string(&crop).unwrap(), content);
    job.out = folder.path().join("cloud.ply");
    fuse(&job, true).unwrap();
    #[cfg(unix)]
    {
        let socket = folder.path().join("socket.ply");
        let _listener = std::os::unix::net::UnixListener::bind(&socket).unwrap();
        job.out = socket;
        refused(&job, &["socket.ply", "expected a regular file"]);
    }
}
