//! What of the maps counts, and how points are written.

use super::*;
use crate::support::write;
use mvs_datasets::scene::Pose;
use std::path::PathBuf;

/// Moves the cameras of a scene's cams by `offset`.
fn move_cams(scene: &SyntheticScene, folder: &Path, offset: DVec3) {
    for view in scene.scene().views() {
        let rotation = view.pose.rotation();
        let translation = view.pose.translation() - rotation * offset;
        let moved = View {
            pose: Pose::new(rotation, translation).unwrap(),
            ..view.clone()
        };
        let name = mvsnet::file_name(view.id, "_cam.txt");
        let path = folder.join("cams").join(name);
        mvsnet::write_view(&path, &moved, mvsnet::PixelCentre::Half).unwrap();
    }
}

/// As missing ones are: the views do not count for what they are listed as.
#[test]
fn maps_without_any_depth_are_told_of() {
    let scene = scene();
    let folder = tempfile::tempdir().unwrap();
    let mut job = write_scene(&scene, None, folder.path());
    let heard = |job: &FuseJob| {
        let (outcome, warnings) = fuse_and_hear(job, true);
        outcome.unwrap();
        let empty = warnings
            .into_iter()
            .find(|warning| warning.code == "empty-depth");
        empty.map(|warning| warning.message)
    };
    assert_eq!(heard(&job), None);
    let views = scene.scene().views();
    let nothing = Raster::filled(160, 120, 0.0).unwrap();
    let path = folder
        .path()
        .join("depths")
        .join(mvsnet::file_name(views[1].id, ".pfm"));
    files::write_atomically(&path, |out| pfm::write_gray(out, &nothing)).unwrap();
    for mode in FuseMode::ALL {
        job.fuse.mode = mode;
        let said = heard(&job).unwrap();
        let wanted = format!(
            "1 of {} depth maps hold no depth, the first is {}",
            views.len(),
            path.display()
        );
        assert_eq!(said, wanted, "{mode:?}");
    }
}

#[test]
fn coordinates_are_floats_where_that_is_exact_enough_and_doubles_far_away() {
    let scene = scene();
    let folder = tempfile::tempdir().unwrap();
    let mut job = write_scene(&scene, None, folder.path());
    let out = job.out.clone();
    let mut cloud = |coordinates| {
        job.coordinates = coordinates;
        fuse(&job, true).unwrap();
        let type_ = header(&job.out).contains("property double x");
        (files::read_cloud(&job.out).unwrap(), type_)
    };
    let (exact, is_double) = cloud(Coordinates::Double);
    assert!(is_double);
    let (near, is_double) = cloud(Coordinates::Auto);
    assert!(!is_double);
    assert_eq!(near.colors(), exact.colors());
    let depth = scene.scene().views()[0].depth_range.unwrap().min();
    // What COLMAP reads.
    let types = ["double", "float", "uchar"];
    let properties = header(&out);
    let properties = properties
        .lines()
        .filter_map(|line| line.strip_prefix("property "));
    assert!(properties.clone().count() > 6);
    assert!(
        properties
            .clone()
            .all(|property| types.iter().any(|type_| property.starts_with(type_)))
    );
    let off = |found: &PointCloud, expected: &[DVec3]| {
        let both = found.positions().iter().zip(expected);
        both.map(|(found, expected)| (*found - *expected).abs().max_element())
            .fold(0.0, f64::max)
    };
    let moved = off(&near, exact.positions());
    assert!(moved > 0.0 && moved < 1e-6 * depth, "{moved:e}");

    let offset = DVec3::new(5e5, -4e6, 100.0);
    move_cams(&scene, folder.path(), offset);
    let (far, is_double) = cloud(Coordinates::Auto);
    assert!(is_double);
    let expected: Vec<DVec3> = exact.positions().iter().map(|at| *at + offset).collect();
    let moved = off(&far, &expected);
    assert!(moved < 1e-5 * depth, "{moved:e}");
    let (coarse, is_double) = cloud(Coordinates::Float);
    let moved = off(&coarse, far.positions());
    assert!(!is_double && moved > 0.01, "{moved:e}");
    let said = &fuse_and_hear(&job, true).1[0];
    assert_eq!(said.code, "coarse-coordinates");
    assert!(
        said.message.contains("up to 4.8e-1 apart"),
        "{}",
        said.message
    );
}

/// Neither a background that is left out nor what ranges or other views say makes a scene near.
#[test]
fn coordinates_are_for_the_nearest_usual_depths() {
    let scene = scene();
    let folder = tempfile::tempdir().unwrap();
    let job = write_scene(&scene, None, folder.path());
    let is_double = || {
        fuse(&job, true).unwrap();
        header(&job.out).contains("property double x")
    };
    for view in scene.scene().views() {
        let background = |at, depth| if at % 10 < 7 { 1e10 } else { depth };
        change_map(&job.depths, view.id, background);
    }
    assert!(!is_double());
    move_cams(&scene, folder.path(), DVec3::new(0.0, 1e3, 0.0));
    assert!(is_double());
    change_map(&job.depths, scene.scene().views()[0].id, |_, _| 1e9);
    assert!(is_double());
}

/// Of more than 255 views numbers of views are floats.
#[test]
fn many_views_are_counted() {
    let scene = scene();
    let folder = tempfile::tempdir().unwrap();
    let mut job = write_scene(&scene, None, folder.path());
    let views = scene.scene().views();
    let mut pairs = "300\n".to_owned();
    for id in 0..300 {
        let of = &views[id as usize % views.len()];
        for (part, suffix) in [("cams", "_cam.txt"), ("depths", ".pfm")] {
            let name = |id| folder.path().join(part).join(mvsnet::file_name(id, suffix));
            if id >= views.len() as u32 {
                std::fs::copy(name(of.id), name(id)).unwrap();
            }
        }
        let others = (0..300).filter(|other| *other != id);
        let others: Vec<String> = others.map(|other| format!("{other} 1")).collect();
        pairs += &format!("{id}\n299 {}\n", others.join(" "));
    }
    write(&folder.path().join("cams/pair.txt"), pairs);
    job.fuse = FuseOptions::of(FuseMode::Geo);
    job.fuse.max_sources = 0;
    job.properties = Properties::Full;
    fuse(&job, true).unwrap();
    let header = header(&job.out);
    let types = ["property float views", "property float violations"];
    assert!(types.iter().all(|line| header.contains(line)), "{header}");
    let cloud = files::read_cloud(&job.out).unwrap();
    // Each place is seen 25 times.
    let counts = cloud.view_counts().unwrap();
    assert!(counts.iter().all(|&count| count >= 25) && counts.iter().any(|&count| count > 255));
}

/// Masked pixels and depths beyond the range are filled in from no other view.
#[test]
fn merrells_rules_fill_in_what_is_wanted_alone() {
    let scene = scene();
    let folder = tempfile::tempdir().unwrap();
    let mut job = write_scene(&scene, Some(&DepthNoise::default()), folder.path());
    job.masks = Some(folder.path().join("masks"));
    job.filtered_depths = Some(folder.path().join("filtered"));
    let wanted = |column: u32| column >= 40;
    for view in scene.scene().views() {
        let pixels = (0..160 * 120).map(|at| [if wanted(at % 160) { 255 } else { 0 }; 3]);
        let mask = ColorImage::from_values(160, 120, pixels.collect()).unwrap();
        let path = folder
            .path()
            .join("masks")
            .join(mvsnet::file_name(view.id, ".png"));
        files::write_atomically(&path, |out| image::write_png(out, &mask)).unwrap();
    }
    let range = scene.scene().views()[0].depth_range.unwrap();
    let middle = 0.5 * (range.min() + range.max());
    job.fuse.min_depth = middle;
    for visibility in [Visibility::MerrellConfidence, Visibility::MerrellStability] {
        job.fuse.visibility = visibility;
        let outcome = fuse(&job, true).unwrap();
        assert_eq!(outcome.counts.accounted(), outcome.counts.pixels);
        assert!(
            outcome.counts.filled > 0 && outcome.counts.fused > 500,
            "{outcome:?}"
        );
        for view in scene.scene().views() {
            let path = folder
                .path()
                .join("filtered")
                .join(mvsnet::file_name(view.id, ".pfm"));
            let (found, _) = files::read_depth(&path).unwrap();
            for (at, &depth) in (0u32..).zip(found.values()) {
                // The mean that follows may lie a little nearer than what was selected.
                let is_wanted = wanted(at % 160) && f64::from(depth) >= 0.98 * middle;
                assert!(depth == 0.0 || is_wanted, "{visibility:?} {at} {depth}");
            }
        }
    }
}

/// Infinite confidences are none, whatever asks for them, and nothing is lost from the counts.
#[test]
fn infinite_confidence_is_none() {
    let scene = scene();
    let folder = tempfile::tempdir().unwrap();
    let mut job = write_scene(&scene, Some(&DepthNoise::default()), folder.path());
    for view in scene.scene().views() {
        change_map(&job.confidence[0], view.id, |at, value| match at % 3 {
            0 => f32::INFINITY,
            _ => value,
        });
    }
    job.fuse.min_confidence = 0.3;
    let procedures = [
        FuseOptions::of(FuseMode::Geo),
        FuseOptions::default(),
        FuseOptions {
            visibility: Visibility::MerrellConfidence,
            ..FuseOptions::default()
        },
        FuseOptions {
            visibility: Visibility::MerrellConfidence,
            sampling: Sampling::Plain,
            ..FuseOptions::default()
        },
    ];
    for options in procedures {
        job.fuse = options;
        let outcome = fuse(&job, true).unwrap();
        assert_eq!(outcome.counts.accounted(), outcome.counts.pixels);
        let cloud = files::read_cloud(&job.out).unwrap();
        let confidences = cloud.confidences().unwrap();
        assert!(confidences.iter().all(|confidence| confidence.is_finite()));
        assert!(cloud.len() > 5000, "{:?} {}", job.fuse.mode, cloud.len());
    }
    job.fuse.min_confidence = f64::INFINITY;
    let message = fuse(&job, true).unwrap_err().to_string();
    assert!(
        message.contains("min_confidence: expected a number"),
        "{message}"
    );
}

/// Normals that are given need not be of length 1, nor face the camera, nor be there.
#[test]
fn given_normals_become_unit_ones_that_face_the_camera_or_none() {
    let scene = scene();
    let folder = tempfile::tempdir().unwrap();
    let mut job = write_workspace(&scene, folder.path());
    let write_normals = |normal: [f32; 3]| {
        for view in scene.scene().views() {
            let name = format!("photo_{}.png.geometric.bin", 90 - view.id);
            let normals = Raster::filled(80, 60, normal).unwrap();
            let path = folder.path().join("stereo/normal_maps").join(name);
            files::write_atomically(&path, |out| dense::write_normals(out, &normals)).unwrap();
        }
    };
    let mut normals = |mode, angle, normal| {
        write_normals(normal);
        job.fuse = FuseOptions::of(mode);
        job.fuse.max_normal_angle = angle;
        let (outcome, warnings) = fuse_and_hear(&job, true);
        let codes: Vec<String> = warnings.into_iter().map(|warning| warning.code).collect();
        outcome.map(|_| (files::read_cloud(&job.out).unwrap(), codes))
    };
    for mode in [FuseMode::Hkust, FuseMode::Cluster] {
        let (expected, _) = normals(mode, 180.0, [0.0, 0.0, -1.0]).unwrap();
        for odd in [[0.0, 0.0, -5.0], [0.0, 0.0, 3.0]] {
            let (found, _) = normals(mode, 180.0, odd).unwrap();
            assert_eq!(found, expected, "{mode:?} {odd:?}");
        }
    }
    let (found, codes) = normals(FuseMode::Hkust, 10.0, [f32::NAN, 0.0, -1.0]).unwrap();
    assert!(
        found
            .normals()
            .unwrap()
            .iter()
            .all(|normal| normal.length() == 0.0)
    );
    assert_eq!(codes, ["bad-normal"; 11], "by map");
    // What `cluster` compares is unknown: as before no two pixels are one surface.
    assert!(normals(FuseMode::Cluster, 10.0, [f32::NAN, 0.0, -1.0]).is_err());
    let one = folder
        .path()
        .join("stereo/normal_maps/photo_88.png.geometric.bin");
    std::fs::remove_file(one).unwrap();
    job.fuse = FuseOptions::default();
    let (outcome, mut warnings) = fuse_and_hear(&job, true);
    let said = warnings.pop().unwrap();
    assert!(outcome.is_ok());
    assert_eq!(said.code, "missing-normals");
    assert!(
        said.message.contains("1 of 11 views have no normal map"),
        "{}",
        said.message
    );
}

/// Of several maps of confidence any one may be the one of the depth maps' size.
#[test]
fn the_order_of_confidences_does_not_matter() {
    let scene = scene();
    let folder = tempfile::tempdir().unwrap();
    let mut job = write_scene(&scene, Some(&DepthNoise::default()), folder.path());
    let small = folder.path().join("small");
    for view in scene.scene().views() {
        let values = (0..40 * 30).map(|at| if at % 40 < 20 { 0.1 } else { 1.0 });
        let map = Raster::from_values(40, 30, values.collect()).unwrap();
        let path = small.join(mvsnet::file_name(view.id, ".pfm"));
        files::write_atomically(&path, |out| pfm::write_gray(out, &map)).unwrap();
    }
    job.confidence.push(small.clone());
    fuse(&job, true).unwrap();
    let expected = std::fs::read(&job.out).unwrap();
    job.confidence.reverse();
    fuse(&job, true).unwrap();
    assert!(std::fs::read(&job.out).unwrap() == expected);
    // Infinity is none in any of them, as NaN.
    let first = scene.scene().views()[0].id;
    let name = mvsnet::file_name(first, ".pfm");
    let mut unconfident = Vec::new();
    for (place, value) in [(0, f32::INFINITY), (1, f32::INFINITY), (0, f32::NAN)] {
        let path = job.confidence[place].join(&name);
        let before = std::fs::read(&path).unwrap();
        change_map(&job.confidence[place], first, |_, _| value);
        unconfident.push(fuse(&job, true).unwrap().counts.unconfident);
        write(&path, before);
    }
    let none = unconfident[2];
    assert!(
        none > 160 * 120 / 2 && unconfident == [none; 3],
        "{unconfident:?}"
    );
    job.confidence = vec![small.clone(), small];
    let message = fuse(&job, true).unwrap_err().to_string();
    assert!(
        message.contains("small/00000000.pfm: expected the size"),
        "{message}"
    );
}

/// What stands in the way of the filtered maps is said before the work, and nothing of the result before goes.
#[test]
fn filtered_depths_take_no_file_for_their_folder_and_leave_no_map_of_the_run_before() {
    let scene = scene();
    let folder = tempfile::tempdir().unwrap();
    let mut job = write_scene(&scene, None, folder.path());
    fuse(&job, false).unwrap();
    let run_file = folder.path().join("cloud.run.toml");
    write(&folder.path().join("file"), "mine");
    for (name, said) in [
        ("file", "found a file"),
        ("cloud.ply", "found a file of the result"),
        ("cloud.json", "found a file of the result"),
    ] {
        job.filtered_depths = Some(folder.path().join(name));
        let message = fuse(&job, true).unwrap_err().to_string();
        assert!(message.contains(said), "{message}");
        assert!(run_file.exists());
    }
    job.filtered_depths = Some(folder.path().join("filtered"));
    fuse(&job, true).unwrap();
    let maps = || -> Vec<PathBuf> {
        let entries = std::fs::read_dir(folder.path().join("filtered")).unwrap();
        let mut maps: Vec<PathBuf> = entries.map(|entry| entry.unwrap().path()).collect();
        maps.sort();
        maps
    };
    assert_eq!(maps().len(), 12);
    let mine = folder.path().join("filtered/00000099.pfm");
    write(&mine, "not of a run");
    let last = mvsnet::file_name(scene.scene().views()[11].id, ".pfm");
    std::fs::remove_file(job.depths.join(&last)).unwrap();
    fuse(&job, true).unwrap();
    let left = maps();
    assert!(left.len() == 12 && left.contains(&mine), "{left:?}");
    assert!(!left.iter().any(|path| path.ends_with(&last)), "{left:?}");
}

/// No source needs to agree where none is asked for, in no pass.
#[test]
fn no_source_may_be_asked_for() {
    let scene = scene();
    let folder = tempfile::tempdir().unwrap();
    let mut job = write_scene(&scene, None, folder.path());
    for mode in [FuseMode::Hkust, FuseMode::Geo] {
        job.fuse = FuseOptions::of(mode);
        job.fuse.min_sources = 0;
        let counts = fuse(&job, true).unwrap().counts;
        assert_eq!(
            (counts.inconsistent, counts.fused + counts.contradicted),
            (0, counts.pixels - counts.empty),
            "{mode:?}"
        );
    }
}
