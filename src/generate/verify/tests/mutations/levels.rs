//! How much is a fault, in views that are wrong by a little and in sets of few.

use super::*;
use crate::generate::verify::single;

/// What was measured on the real scene and on rough ones (difference, in pixels, of all): one view's principal
/// point off by half a pixel, a depth map moved by one, a depth map a thousandth too deep, of few digits; a
/// view that stands twelve times as far away as all others, one of estimated depth, the worst on fine terrain.
#[test]
fn faults_and_advice_lie_where_they_were_measured() {
    let measured = [
        ((3.6e-4, 0.61, 3.4e-6), Some(Severity::Fault)),
        ((2.0e-4, 0.34, 3.4e-6), Some(Severity::Fault)),
        ((1.0e-3, 1.70, 3.4e-6), Some(Severity::Fault)),
        ((1.2e-4, 0.19, 3.4e-6), Some(Severity::Advice)),
        ((1.0e-3, 0.29, 1.2e-4), None),
        ((1.7e-5, 0.02, 2.2e-6), None),
        ((9.4e-4, 0.47, 5.2e-4), None),
        ((8.0e-4, 0.11, 5.3e-4), None),
        // All exact but for the rounding of their numbers.
        ((9.0e-6, 0.01, 3.0e-8), None),
        // None agrees with any other.
        ((3.0e-3, 1.00, 2.0e-3), None),
    ];
    for ((difference, moved, level), expected) in measured {
        let found = single::worse(difference, moved, level).map(|(severity, _)| severity);
        assert_eq!(found, expected, "{difference} {moved} {level}");
    }
}

/// Below a thousandth, which was all that one view could be judged by.
#[test]
fn one_camera_that_is_a_little_off_is_advice() {
    let spoilt = Spoilt::new();
    turn(&spoilt, 4, 0.15);
    let found = spoilt.verify().findings;
    assert_eq!(found.len(), 1, "{found:?}");
    assert_eq!(found[0].code, "view-does-not-fit");
    assert_eq!(found[0].place, "view 4");
    assert_eq!(found[0].severity, Severity::Advice, "{}", found[0].message);
}

/// In few views one that is wrong spoils most pairs: it is named, and no convention of all views.
#[test]
fn of_few_views_the_wrong_one_is_named() {
    let spoil: [fn(&Spoilt); 3] = [
        |s| edit_depths(s, 6..7, |v| v.value * 1.006),
        |s| {
            edit_cam(s, 6, |cam| {
                cam.intrinsic.z_axis += DVec3::new(1.5, 1.5, 0.0);
            });
        },
        |s| turn(s, 6, 0.5),
    ];
    for (nth, spoil) in spoil.iter().enumerate() {
        for ids in [&[5, 6, 7][..], &[4, 5, 6, 7]] {
            let spoilt = Spoilt::new();
            keep(&spoilt, ids);
            let sound = spoilt.verify();
            assert!(!sound.failed(), "{:?}", sound.findings);
            spoil(&spoilt);
            let found = spoilt.verify().findings;
            let places: Vec<&str> = found.iter().map(|finding| &finding.place[..]).collect();
            assert_eq!(places, ["view 6"], "{nth} of {ids:?}: {found:?}");
        }
    }
}

#[test]
fn a_convention_of_few_views_is_still_one() {
    let spoilt = Spoilt::new();
    keep(&spoilt, &[5, 6, 7]);
    for id in 5..8 {
        edit_cam(&spoilt, id, |cam| {
            cam.intrinsic.z_axis -= DVec3::new(0.5, 0.5, 0.0);
        });
    }
    let verification = spoilt.verify();
    assert!(
        verification.found("half-pixel"),
        "{:?}",
        verification.findings
    );
    assert!(!verification.found("view-does-not-fit"));
}

/// The file that cannot be read is the place, and what was not checked is said.
#[test]
fn one_broken_text_is_named_and_ends_what_can_be_said() {
    for name in [CAM_1, PAIR, "scene.json"] {
        let spoilt = Spoilt::new();
        write(&spoilt.path(name), b"nothing of the kind");
        let found = spoilt.verify().findings;
        let unreadable = found.iter().find(|f| f.code == "unreadable").unwrap();
        assert_eq!(unreadable.place, name);
        assert!(
            unreadable.message.contains("were not checked"),
            "{}",
            unreadable.message
        );
    }
}

/// Colours that are coded more coarsely in the image than in the masked one are no other image.
#[test]
fn halved_chroma_is_no_other_image() {
    let spoilt = Spoilt::new();
    let colored: fn(&mut [[u8; 3]]) = |pixels| {
        for (index, pixel) in pixels.iter_mut().enumerate().filter(|(_, p)| p[1] > 60) {
            let red = if index % 2 == 0 { 60 } else { -60 };
            pixel[0] = pixel[0].saturating_add_signed(red as i8);
            pixel[1] = pixel[1].saturating_add_signed((-red / 2) as i8);
        }
    };
    let folder = spoilt.blended();
    let mut image = files::read_image(&folder.image(3)).unwrap();
    colored(image.values_mut());
    let (depth, _) = folder.read_depth(3).unwrap();
    let write = |path: &Path, image: &ColorImage, subsample_chroma: bool| {
        let options = JpegOptions {
            subsample_chroma,
            ..JpegOptions::default()
        };
        BlendedFolder::write_jpeg(path, image, options).unwrap();
    };
    write(&folder.image(3), &image, true);
    let pixels = image.values_mut().iter_mut().zip(depth.values());
    pixels
        .filter(|(_, z)| **z == 0.0)
        .for_each(|(pixel, _)| *pixel = [0; 3]);
    write(&folder.masked_image(3), &image, false);
    let verification = spoilt.verify();
    assert!(
        !verification.found("masked-differs"),
        "{:?}",
        verification.findings
    );
}
