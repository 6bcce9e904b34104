//! A scene spoilt in one way for each finding that there is.

use super::*;
use glam::{DMat4, DVec2, DVec3};
use mvs_datasets::format::pfm;
use mvs_datasets::scene::Raster;
use std::collections::BTreeSet;

/// What is spoilt, how, and the code that must be found.
type Mutation = (&'static str, fn(&Spoilt), &'static str);

/// What cams say, by letter.
const CAMS: [Mutation; 6] = [
    (
        "trailing space",
        |s| edit_line(s, CAM_1, 11, |l| format!("{l} ")),
        "depth-line",
    ),
    (
        "three numbers",
        |s| edit_line(s, CAM_1, 11, cut_last),
        "depth-line",
    ),
    (
        "interval",
        |s| edit_line(s, CAM_1, 11, |l| l.replace(" 128.0 ", " 64.0 ")),
        "depth-interval",
    ),
    (
        "hypotheses",
        |s| edit_line(s, CAM_1, 11, |_| "2 0.05 20 3".into()),
        "depth-interval-dialect",
    ),
    (
        "negative depth",
        |s| edit_line(s, CAM_1, 11, |_| "-1 0.01 128 0.28".into()),
        "depth-range",
    ),
    (
        "keyword",
        |s| edit_line(s, CAM_1, 0, |_| "extrinsics".into()),
        "cam-keywords",
    ),
];

/// What `pair.txt` says, by letter.
const PAIRS: [Mutation; 15] = [
    (
        "blank line",
        |s| s.edit(PAIR, |t| format!("{t}\n")),
        "pair-blanks",
    ),
    (
        "double space",
        |s| edit_line(s, PAIR, 2, |l| l.replacen(' ', "  ", 1)),
        "pair-blanks",
    ),
    (
        "count",
        |s| edit_line(s, PAIR, 0, |_| "13".into()),
        "pair-count",
    ),
    ("source count", |s| sources(s, "0"), "source-count"),
    (
        "eleven sources",
        |s| {
            sources(
                s,
                "11 1 19 2 18 3 17 4 16 5 15 6 14 7 13 8 12 9 11 10 10 11 9",
            );
        },
        "source-count",
    ),
    ("itself", |s| sources(s, "2 0 5 1 4"), "source-is-itself"),
    ("zero score", |s| sources(s, "2 1 5 2 0"), "score-zero"),
    ("rising", |s| sources(s, "2 1 5 2 6"), "score-order"),
    (
        "another score back",
        |s| sources(s, "2 1 5000 13 1"),
        "score-asymmetric",
    ),
    ("broken line", |s| sources(s, "3 1 5 2 6"), "pair-line"),
    (
        "a reference again",
        |s| edit_line(s, PAIR, 3, |_| "0".into()),
        "pair-twice",
    ),
    (
        "no reference",
        |s| s.edit(PAIR, drop_last_reference),
        "source-is-no-reference",
    ),
    (
        "no entry",
        |s| s.edit(PAIR, drop_last_reference),
        "view-without-pairs",
    ),
    ("no pairs", |s| remove(s, PAIR), "missing-pairs"),
    ("no camera", |s| remove(s, CAM_2), "pair-without-camera"),
];

/// Files that are missing or too many.
const FILES: [Mutation; 9] = [
    (
        "foreign cam",
        |s| write(&s.path("cams/notes.txt"), b""),
        "foreign-file",
    ),
    (
        "foreign depth",
        |s| write(&s.path("rendered_depth_maps/00000000_prob.pfm"), b""),
        "foreign-file",
    ),
    (
        "no image",
        |s| remove(s, "blended_images/00000002.jpg"),
        "missing-image",
    ),
    (
        "no masked image",
        |s| remove(s, "blended_images/00000002_masked.jpg"),
        "missing-masked-image",
    ),
    (
        "no depth",
        |s| remove(s, "rendered_depth_maps/00000002.pfm"),
        "missing-depth",
    ),
    ("depth alone", |s| remove(s, CAM_2), "depth-without-camera"),
    (
        "a colour map for depth",
        |s| write(&s.blended().depth(4), b"PF\n4 3\n1.0\n"),
        "pfm-header",
    ),
    (
        "an interrupted run",
        |s| write(&s.path("run.partial.toml"), b""),
        "unfinished",
    ),
    (
        "no depth maps",
        |s| std::fs::remove_dir_all(s.path("rendered_depth_maps")).unwrap(),
        "missing-folder",
    ),
];

/// Conventions that all views share.
const CONVENTIONS: [Mutation; 9] = [
    (
        "pixel centres at whole numbers",
        |s| s.edit_cams(|cam| cam.intrinsic.z_axis -= DVec3::new(0.5, 0.5, 0.0)),
        "half-pixel",
    ),
    // Text may round the last row.
    (
        "camera to world",
        |s| s.edit_cams(|cam| cam.extrinsic = cam.extrinsic.inverse()),
        "swapped-pose",
    ),
    (
        "OpenGL axes",
        |s| s.edit_cams(|cam| cam.extrinsic = flip() * cam.extrinsic),
        "opengl-axes",
    ),
    (
        "OpenGL, camera to world",
        |s| s.edit_cams(|cam| cam.extrinsic = (flip() * cam.extrinsic).inverse()),
        "swapped-opengl-pose",
    ),
    (
        "half size",
        |s| s.edit_cams(|cam| scale(cam, 0.5)),
        "scaled-intrinsics",
    ),
    (
        "low resolution",
        |s| s.edit_cams(|cam| scale(cam, 0.375)),
        "scaled-intrinsics",
    ),
    (
        "twice the size",
        |s| s.edit_cams(|cam| scale(cam, 2.0)),
        "scaled-intrinsics",
    ),
    (
        "range",
        |s| edit_depths(s, 0..14, |v| v.value * v.ray),
        "range-depth",
    ),
    (
        "depth that is none",
        |s| edit_depths(s, 0..14, |v| v.value.min(1e-3)),
        "no-agreement",
    ),
];

/// Depths and images of single views, and pairs.
const CONTENT: [Mutation; 21] = [
    ("not a number", |s| raw_depth(s, f32::NAN), "bad-depths"),
    ("negative", |s| raw_depth(s, -1.0), "bad-depths"),
    (
        "empty depth",
        |s| edit_depths(s, 1..2, |_| 0.0),
        "empty-depth",
    ),
    (
        "far depth",
        |s| edit_depths(s, 2..3, |v| v.value * 1e6),
        "no-depth-in-range",
    ),
    ("narrow range", narrow_range, "depth-outside-range"),
    ("a view of another size", another_size, "size-mismatch"),
    (
        "a picture that is none",
        |s| write(&s.blended().image(3), b"GIF89a"),
        "unreadable",
    ),
    ("a spotted background", spotted, "bright-background"),
    (
        "the image for the masked one",
        |s| {
            std::fs::copy(s.blended().image(3), s.blended().masked_image(3))
                .map(drop)
                .unwrap();
        },
        "missing-mask",
    ),
    ("black for the masked image", black_mask, "wrong-mask"),
    ("images of other views", other_images, "images-do-not-match"),
    (
        "images of the next view",
        |s| move_images(s, 1),
        "images-do-not-match",
    ),
    (
        "images upside down",
        |s| edit_images(s, 0..14, |pixels| pixels.reverse()),
        "images-do-not-match",
    ),
    (
        "one view's image in the place of another's",
        |s| {
            for of in [BlendedFolder::image, BlendedFolder::masked_image] {
                let image = |id: u32| of(&s.blended(), id);
                std::fs::copy(image(9), image(4)).map(drop).unwrap();
            }
        },
        "image-does-not-match",
    ),
    (
        "the masked image of another image",
        |s| {
            let image = |id: u32| s.blended().image(id);
            std::fs::copy(image(9), image(4)).map(drop).unwrap();
        },
        "masked-differs",
    ),
    ("lists of other views", shuffled, "shuffled-pairs"),
    (
        "a pair that shares nothing",
        |s| edit_depths(s, 5..6, |v| v.value * 1.5),
        "pair-without-overlap",
    ),
    (
        "one pose inverted",
        |s| edit_cam(s, 4, |cam| cam.extrinsic = cam.extrinsic.inverse()),
        "view-does-not-fit",
    ),
    (
        "one depth half a per cent deeper",
        |s| edit_depths(s, 4..5, |v| v.value * 1.005),
        "view-does-not-fit",
    ),
    (
        "one camera of another size",
        |s| edit_cam(s, 4, |cam| scale(cam, 0.6)),
        "view-does-not-fit",
    ),
    (
        "all depths rough",
        |s| edit_depths(s, 0..14, |v| v.value * (1.0 + 0.004 * (v.id % 2) as f32)),
        "depths-disagree",
    ),
];

/// The advice that readers cut images is tested by itself.
const ELSEWHERE: [&str; 1] = ["aspect"];

fn assert_all_fire(mutations: &[Mutation], check: fn(&Spoilt) -> Vec<Finding>) {
    for (what, spoil, code) in mutations {
        let spoilt = Spoilt::new();
        spoil(&spoilt);
        let codes: Vec<String> = check(&spoilt).into_iter().map(|f| f.code).collect();
        assert!(codes.iter().any(|found| found == code), "{what}: {codes:?}");
    }
}

fn by_letter(spoilt: &Spoilt) -> Vec<Finding> {
    rules::check(&spoilt.blended()).unwrap()
}

#[test]
fn what_is_wrong_by_letter_is_found() {
    for mutations in [&CAMS[..], &PAIRS, &FILES] {
        assert_all_fire(mutations, by_letter);
    }
    assert_eq!(by_letter(&Spoilt::new()), []);
}

#[test]
fn other_conventions_are_found_and_named() {
    assert_all_fire(&CONVENTIONS, |spoilt| spoilt.verify().findings);
}

#[test]
fn what_single_views_and_pairs_have_wrong_is_found() {
    assert_all_fire(&CONTENT, |spoilt| spoilt.verify().findings);
}

/// The view is named, no other one is, and what to do where that is known.
#[test]
fn a_single_view_s_fault_is_its_own() {
    let of_one = CONTENT.iter().filter(|m| m.2 == "view-does-not-fit");
    let advice = ["camera-to-world: invert them", "is wrong", "is wrong"];
    assert_eq!(of_one.clone().count(), 3);
    for ((what, spoil, code), advice) in of_one.zip(advice) {
        let spoilt = Spoilt::new();
        spoil(&spoilt);
        let found = spoilt.verify().findings;
        let found: Vec<&Finding> = found.iter().filter(|f| f.code == *code).collect();
        assert_eq!(found.len(), 1, "{what}: {found:?}");
        assert_eq!(found[0].place, "view 4", "{what}");
        assert_eq!(found[0].severity, Severity::Fault);
        assert!(
            found[0].message.contains(advice),
            "{what}: {}",
            found[0].message
        );
    }
}

/// The view whose image is another's is named, and no other one.
#[test]
fn a_single_view_s_image_is_its_own_fault() {
    let both = ["image-does-not-match", "masked-differs"];
    for (what, spoil, code) in CONTENT.iter().filter(|m| both.contains(&m.2)) {
        let spoilt = Spoilt::new();
        spoil(&spoilt);
        let found = spoilt.verify().findings;
        let faults = found.iter().filter(|f| f.severity == Severity::Fault);
        assert!(faults.clone().any(|f| f.code == *code), "{what}: {found:?}");
        for fault in faults {
            assert!(fault.place.contains('4'), "{what}: {fault:?}");
        }
    }
}

/// Light that differs by image is no fault.
#[test]
fn images_that_are_brighter_or_darker_match() {
    let spoilt = Spoilt::new();
    let darker: fn(&mut [[u8; 3]]) = |pixels| {
        for value in pixels.as_flattened_mut() {
            *value /= 2;
        }
    };
    let bent: fn(&mut [[u8; 3]]) = |pixels| {
        for value in pixels.as_flattened_mut() {
            *value = (255.0 * (f64::from(*value) / 255.0).powf(1.6)) as u8;
        }
    };
    edit_images(&spoilt, 0..4, darker);
    edit_images(&spoilt, 4..8, bent);
    let found = spoilt.verify().findings;
    assert!(found.iter().all(|f| !f.code.contains("match")), "{found:?}");
    assert!(
        found.iter().all(|f| f.severity == Severity::Advice),
        "{found:?}"
    );
}

/// Cameras so close together that any of them will do are no reason to call a list shuffled.
#[test]
fn any_list_does_for_a_compact_array_of_cameras() {
    let spoilt = Spoilt::new();
    // All cameras where the first one is, a hair's breadth apart, and the same depth.
    let first = cam::read(&std::fs::read_to_string(spoilt.blended().cam(0)).unwrap()).unwrap();
    let depth = std::fs::read(spoilt.blended().depth(0)).unwrap();
    for id in 0..14 {
        edit_cam(&spoilt, id, |cam| {
            cam.extrinsic = first.extrinsic;
            cam.extrinsic.w_axis.x += 1e-6 * f64::from(id);
            cam.intrinsic = first.intrinsic;
        });
        write(&spoilt.blended().depth(id), &depth);
    }
    shuffled(&spoilt);
    let verification = spoilt.verify();
    assert!(
        !verification.found("shuffled-pairs"),
        "{:#?}",
        verification.findings
    );
}

/// Every code in the sources fires in one of the tables.
#[test]
fn every_code_has_its_mutation() {
    let sources = [
        include_str!("../geometry.rs"),
        include_str!("../images.rs"),
        include_str!("../listed.rs"),
        include_str!("../mod.rs"),
        include_str!("../pictures.rs"),
        include_str!("../reading.rs"),
        include_str!("../rules.rs"),
        include_str!("../single.rs"),
    ];
    let tables = [&CAMS[..], &PAIRS, &FILES, &CONVENTIONS, &CONTENT];
    let mut tested: BTreeSet<&str> = tables.iter().copied().flatten().map(|m| m.2).collect();
    tested.extend(ELSEWHERE);
    let mut codes = BTreeSet::new();
    for source in sources {
        let parts: Vec<&str> = source.split('"').collect();
        for pair in parts.windows(2).step_by(2) {
            let (before, text) = (pair[0].trim_end(), pair[1]);
            let is_name = text.bytes().all(|b| b.is_ascii_lowercase() || b == b'-');
            let given = before.ends_with("fault(") || before.ends_with("advice(");
            if is_name && !text.is_empty() && (given || text.contains('-')) {
                codes.insert(text);
            }
        }
    }
    // A name of serde's, and the reading that is right.
    codes.remove("kebab-case");
    codes.remove("as-is");
    assert!(codes.len() > 30, "{codes:?}");
    let untested: Vec<_> = codes.difference(&tested).collect();
    assert!(untested.is_empty(), "without a mutation: {untested:?}");
    let unknown: Vec<_> = tested.difference(&codes).collect();
    assert!(unknown.is_empty(), "found nowhere: {unknown:?}");
}

const CAM_1: &str = "cams/00000001_cam.txt";
const CAM_2: &str = "cams/00000002_cam.txt";
const PAIR: &str = "cams/pair.txt";

fn edit_line(spoilt: &Spoilt, name: &str, index: usize, edit: fn(&str) -> String) {
    spoilt.edit(name, |text| {
        let mut lines: Vec<String> = text.lines().map(str::to_owned).collect();
        lines[index] = edit(&lines[index]);
        lines.join("\n") + "\n"
    });
}

/// The first view's sources become `line`.
fn sources(spoilt: &Spoilt, line: &str) {
    spoilt.edit(PAIR, |text| {
        let mut lines: Vec<&str> = text.lines().collect();
        lines[2] = line;
        lines.join("\n") + "\n"
    });
}

fn cut_last(line: &str) -> String {
    line.rsplit_once(' ').unwrap().0.to_owned()
}

fn drop_last_reference(text: &str) -> String {
    let lines: Vec<&str> = text.lines().collect();
    let kept = &lines[1..lines.len() - 2];
    format!("{}\n{}\n", kept.len() / 2, kept.join("\n"))
}

fn remove(spoilt: &Spoilt, name: &str) {
    std::fs::remove_file(spoilt.path(name)).unwrap();
}

fn flip() -> DMat4 {
    DMat4::from_scale(DVec3::new(1.0, -1.0, -1.0))
}

fn scale(cam: &mut CamFile, scale: f64) {
    cam.intrinsic.x_axis.x *= scale;
    cam.intrinsic.y_axis.y *= scale;
    cam.intrinsic.z_axis.x *= scale;
    cam.intrinsic.z_axis.y *= scale;
}

fn edit_cam(spoilt: &Spoilt, id: u32, edit: impl Fn(&mut CamFile)) {
    let path = spoilt.blended().cam(id);
    let mut cam = cam::read(&std::fs::read_to_string(&path).unwrap()).unwrap();
    edit(&mut cam);
    files::write_atomically(&path, |out| cam::write(out, &cam)).unwrap();
}

/// A depth, the length of its pixel's ray at depth 1, and its view.
struct Value {
    id: u32,
    value: f32,
    ray: f32,
}

fn edit_depths(spoilt: &Spoilt, ids: std::ops::Range<u32>, edit: fn(Value) -> f32) {
    let scene = spoilt.blended().read_scene(None).unwrap();
    for id in ids {
        let view = &scene.views()[scene.index_of(id).unwrap()];
        let (depth, _) = spoilt.blended().read_depth(id).unwrap();
        let (width, height) = depth.size();
        let value = |i: u32| {
            let pixel = DVec2::new(f64::from(i % width) + 0.5, f64::from(i / width) + 0.5);
            edit(Value {
                id,
                value: depth.get(i % width, i / width),
                ray: view.camera.ray(pixel).length() as f32,
            })
        };
        let values = (0..width * height).map(value).collect();
        let edited = DepthMap::from_values(width, height, values).unwrap().0;
        spoilt.blended().write_depth(id, &edited).unwrap();
    }
}

/// A depth map with one value that no depth has.
fn raw_depth(spoilt: &Spoilt, value: f32) {
    let (depth, _) = spoilt.blended().read_depth(6).unwrap();
    let mut values = depth.values().to_vec();
    values[77] = value;
    let raster = Raster::from_values(128, 96, values).unwrap();
    let path = spoilt.blended().depth(6);
    files::write_atomically(&path, |out| pfm::write_gray(out, &raster)).unwrap();
}

/// Two fifths of the range off at either end.
fn narrow_range(spoilt: &Spoilt) {
    edit_cam(spoilt, 1, |cam| {
        let (min, max) = cam.depth_range().unwrap();
        let (min, max) = (0.6 * min + 0.4 * max, 0.4 * min + 0.6 * max);
        cam.tail = vec![min, (max - min) / 128.0, 128.0, max];
    });
}

/// One view's files, of one size, which the others have not.
fn another_size(spoilt: &Spoilt) {
    let folder = spoilt.blended();
    let image = ColorImage::filled(64, 48, [90; 3]).unwrap();
    for path in [folder.image(3), folder.masked_image(3)] {
        BlendedFolder::write_jpeg(&path, &image, JpegOptions::default()).unwrap();
    }
    let depth = DepthMap::from_values(64, 48, vec![2.0; 64 * 48]).unwrap().0;
    folder.write_depth(3, &depth).unwrap();
}

/// A tenth of the background is bright.
fn spotted(spoilt: &Spoilt) {
    let folder = spoilt.blended();
    let (depth, _) = folder.read_depth(3).unwrap();
    let mut image = files::read_image(&folder.masked_image(3)).unwrap();
    let outside = depth.values().iter().filter(|&&z| z == 0.0).count();
    let pixels = image.values_mut().iter_mut().zip(depth.values());
    let background = pixels.filter(|(_, z)| **z == 0.0).take(outside / 10);
    background.for_each(|(pixel, _)| *pixel = [200; 3]);
    BlendedFolder::write_jpeg(&folder.masked_image(3), &image, JpegOptions::default()).unwrap();
}

fn black_mask(spoilt: &Spoilt) {
    let black = ColorImage::filled(128, 96, [0; 3]).unwrap();
    let path = spoilt.blended().masked_image(3);
    BlendedFolder::write_jpeg(&path, &black, JpegOptions::default()).unwrap();
}

/// Images five views on.
fn other_images(spoilt: &Spoilt) {
    move_images(spoilt, 5);
}

fn move_images(spoilt: &Spoilt, by: usize) {
    let image = |id: u32| spoilt.blended().image(id);
    let all: Vec<Vec<u8>> = (0..14)
        .map(|id| std::fs::read(image(id)).unwrap())
        .collect();
    for id in 0..14 {
        write(&image(id), &all[(id as usize + by) % 14]);
    }
}

/// Edits the pixels of the images and the masked images of these views.
fn edit_images(spoilt: &Spoilt, ids: std::ops::Range<u32>, edit: fn(&mut [[u8; 3]])) {
    for id in ids {
        for path in [
            spoilt.blended().image(id),
            spoilt.blended().masked_image(id),
        ] {
            let mut image = files::read_image(&path).unwrap();
            edit(image.values_mut());
            BlendedFolder::write_jpeg(&path, &image, JpegOptions::default()).unwrap();
        }
    }
}

/// Each view has the sources of the one seven views on.
fn shuffled(spoilt: &Spoilt) {
    spoilt.edit(PAIR, |text| {
        let mut lines: Vec<String> = text.lines().map(str::to_owned).collect();
        let rows: Vec<String> = lines.iter().skip(2).step_by(2).cloned().collect();
        for (index, line) in lines.iter_mut().skip(2).step_by(2).enumerate() {
            line.clone_from(&rows[(index + 7) % rows.len()]);
        }
        lines.join("\n") + "\n"
    });
}
