//! A scene spoilt in one way for each finding that there is.

mod edits;
mod letters;
mod levels;

use super::*;
use edits::*;
use glam::{DMat4, DVec2, DVec3};
use letters::{CAMS, FILES, PAIRS};
use mvs_datasets::format::{image, pair, pfm};
use mvs_datasets::scene::{Raster, SourceScore};
use std::collections::BTreeSet;

/// What is spoilt, how, and the code that must be found.
type Mutation = (&'static str, fn(&Spoilt), &'static str);

/// Conventions that all views share.
const CONVENTIONS: [Mutation; 10] = [
    (
        "pixel centres at whole numbers",
        |s| s.edit_cams(|cam| cam.intrinsic.z_axis -= DVec3::new(0.5, 0.5, 0.0)),
        "half-pixel",
    ),
    (
        "a crop that starts one pixel off",
        |s| s.edit_cams(|cam| cam.intrinsic.z_axis += DVec3::new(1.0, 1.0, 0.0)),
        "moved-principal-point",
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
const CONTENT: [Mutation; 32] = [
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
    (
        "one camera moved along the table",
        along_the_table,
        "image-beside",
    ),
    (
        "a masked image with a black square",
        |s| painted(s, [0; 3]),
        "masked-differs",
    ),
    (
        "a masked image with a white square",
        |s| painted(s, [255; 3]),
        "masked-differs",
    ),
    (
        "images to the right of the depths",
        moved_images,
        "mask-moved",
    ),
    (
        "a black image",
        |s| edit_images(s, 3..4, |pixels| pixels.fill([0; 3])),
        "flat-image",
    ),
    ("an image of one channel", gray_image, "image-channels"),
    ("an image of another format", gray_image, "image-is-png"),
    (
        "an image on its head by its note",
        turned_by_note,
        "image-orientation",
    ),
    ("a view again", view_again, "view-twice"),
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
        "one half of one depth map too far away",
        |s| edit_depths(s, 4..5, |v| v.value * if v.column > 64 { 1.1 } else { 1.0 }),
        "depths-contradict",
    ),
    (
        "the left halves of all too far away",
        |s| {
            edit_depths(s, 0..14, |v| {
                v.value * if v.column < 64 { 1.05 } else { 1.0 }
            });
        },
        "depths-contradict",
    ),
    (
        "all depths rough",
        |s| edit_depths(s, 0..14, |v| v.value * (1.0 + 0.004 * (v.id % 2) as f32)),
        "depths-disagree",
    ),
];

/// The advice that readers cut images, and what scene.json says, are tested by themselves.
const ELSEWHERE: [&str; 2] = ["aspect", "not-as-written"];

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

/// The view is named and no other one, though its partners' points contradict it; or the scene, where all are wrong.
#[test]
fn depths_that_are_wrong_on_a_part_are_their_view_s_fault() {
    let of_parts = CONTENT.iter().filter(|m| m.2 == "depths-contradict");
    for ((what, spoil, code), place) in of_parts.zip(["view 4", "all views"]) {
        let spoilt = Spoilt::new();
        spoil(&spoilt);
        let found = spoilt.verify().findings;
        let found: Vec<&Finding> = found.iter().filter(|f| f.code == *code).collect();
        assert_eq!(found.len(), 1, "{what}: {found:?}");
        assert_eq!(
            (found[0].severity, &found[0].place[..]),
            (Severity::Fault, place)
        );
    }
}

/// A camera that is moved along the flat table: depths still agree.
#[test]
fn a_camera_moved_along_a_surface_is_named_with_the_way_back() {
    let spoilt = Spoilt::new();
    along_the_table(&spoilt);
    let found = spoilt.verify();
    let codes: Vec<(&str, &str)> = (found.findings.iter())
        .map(|finding| (&finding.code[..], &finding.place[..]))
        .collect();
    assert_eq!(codes, [("image-beside", "view 5")]);
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
        include_str!("../as_written.rs"),
        include_str!("../contradictions.rs"),
        include_str!("../encoded.rs"),
        include_str!("../geometry.rs"),
        include_str!("../images.rs"),
        include_str!("../listed.rs"),
        include_str!("../mod.rs"),
        include_str!("../pair_rules.rs"),
        include_str!("../pictures.rs"),
        include_str!("../reading.rs"),
        include_str!("../rules.rs"),
        include_str!("../shifts.rs"),
        include_str!("../single.rs"),
        include_str!("../twice.rs"),
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
