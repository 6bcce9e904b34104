//! Photographs found, missing, named twice and stored turned.

use super::*;
use glam::DVec2;
use mvs_datasets::scene::{Camera, Pose};
use std::io::Write;

fn view(id: u32, name: &str) -> View {
    View {
        id,
        name: name.to_owned(),
        camera: Camera::new(4, 3, DVec2::ONE, DVec2::ONE).unwrap(),
        pose: Pose::IDENTITY,
        depth_range: None,
    }
}

fn touch(path: &Path) {
    files::write_atomically(path, |_| Ok(())).unwrap();
}

#[test]
fn photographs_are_found_by_name_then_by_id_and_missing_ones_named() {
    let folder = tempfile::tempdir().unwrap();
    let views = [view(0, "a/left.jpg"), view(1, "right.tif"), view(12, "")];
    for name in ["a/left.jpg", "right.PNG", "00000012.jpeg"] {
        touch(&folder.path().join(name));
    }
    let photos = PhotoFolder::open(folder.path(), &views).unwrap();
    assert_eq!(photos.paths[&1], folder.path().join("right.PNG"));
    assert_eq!(photos.paths[&12], folder.path().join("00000012.jpeg"));
    let more = [views[0].clone(), view(3, "x.jpg"), view(4, "")];
    let error = PhotoFolder::open(folder.path(), &more)
        .unwrap_err()
        .to_string();
    assert!(
        error.contains("2 of 3 views") && error.contains("x.jpg"),
        "{error}"
    );
    assert!(!error.contains("convert"), "{error}");
    touch(&folder.path().join("x.tif"));
    let error = PhotoFolder::open(folder.path(), &more).unwrap_err();
    let error = error.to_string();
    assert!(error.contains("x.tif is no JPEG or PNG"), "{error}");
}

#[test]
fn a_point_in_a_name_without_an_ending_is_part_of_it() {
    let folder = tempfile::tempdir().unwrap();
    let names = [
        "cam.0001.jpg",
        "cam.0002.png",
        "b.v1/frame.7.jpg",
        "d.jpg",
        "d.tif.jpg",
    ];
    for name in names {
        touch(&folder.path().join(name));
    }
    let views = ["cam.0001", "cam.0002", "b.v1/frame.7", "d.tif"];
    let views: Vec<View> = (0..).zip(views).map(|(id, name)| view(id, name)).collect();
    let photos = PhotoFolder::open(folder.path(), &views).unwrap();
    let found = names[..4].iter().map(|name| folder.path().join(name));
    assert!(photos.files().eq(found), "{:?}", photos.paths);
}

#[test]
fn names_that_begin_with_the_photographs_folder_are_found_in_it() {
    let root = tempfile::tempdir().unwrap();
    let folder = root.path().join("images");
    let names = ["cam0/0001.png", "cam1/0001.JPG", "0002.png"];
    for name in names {
        touch(&folder.join(name));
    }
    let expected = names.map(|name| folder.join(name));
    for views in [
        [
            "images/cam0/0001.png",
            "images/cam1/0001.png",
            "images/0002",
        ],
        [
            "data/images/cam0/0001",
            "images\\cam1\\0001.JPG",
            "./images/0002.png",
        ],
    ] {
        let views: Vec<View> = (0..).zip(views).map(|(id, name)| view(id, name)).collect();
        let photos = PhotoFolder::open(&folder, &views).unwrap();
        assert!(photos.files().eq(&expected), "{:?}", photos.paths);
        // From the folder above as well.
        if views[0].name.starts_with("images") {
            let photos = PhotoFolder::open(root.path(), &views).unwrap();
            assert!(photos.files().eq(&expected), "{:?}", photos.paths);
        }
    }
}

#[test]
fn a_photograph_beside_the_one_taken_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let views = [view(0, ""), view(1, ""), view(2, "c.png")];
    for name in [
        "00000000.jpg",
        "00000000.png",
        "00000001.PNG",
        "c.png",
        "c.jpg",
    ] {
        touch(&folder.path().join(name));
    }
    // c.png is asked for by its whole name.
    let photos = PhotoFolder::open(folder.path(), &views).unwrap();
    let warnings = photos.warnings();
    assert_eq!(warnings.len(), 1);
    assert_eq!(warnings[0].code, "photograph-doubtful");
    let said = &warnings[0].message;
    assert!(
        said.starts_with("1 views") && said.contains("00000000.png is not"),
        "{said}"
    );
}

#[test]
fn no_photograph_is_taken_for_two_views() {
    let folder = tempfile::tempdir().unwrap();
    let refused = |views: &[View], parts: &[&str]| {
        let error = PhotoFolder::open(folder.path(), views).unwrap_err();
        let error = error.to_string();
        assert!(parts.iter().all(|part| error.contains(part)), "{error}");
    };
    touch(&folder.path().join("00000000.jpg"));
    let twins = [view(0, "00000000.jpg"), view(1, "camA/00000000.jpg")];
    let both = ["view 0 (00000000.jpg)", "view 1 (camA/00000000.jpg)"];
    refused(&twins, &both);
    refused(
        &[view(3, "00000000.jpg"), view(5, "00000000.jpg")],
        &["view 3", "view 5"],
    );
    // With the folder left out in all names, each has its own.
    let one = [view(1, "images/00000000.jpg")];
    assert!(PhotoFolder::open(folder.path(), &one).is_ok());
    // Where folders mean something, the photograph of another one is not taken.
    touch(&folder.path().join("camB/00000000.jpg"));
    let rig = [view(0, "camA/00000000.jpg"), view(1, "camB/00000000.jpg")];
    refused(&rig, &["1 of 2 views", "camA/00000000.jpg"]);
    touch(&folder.path().join("camA/00000000.png"));
    let photos = PhotoFolder::open(folder.path(), &rig).unwrap();
    let expected = ["camA/00000000.png", "camB/00000000.jpg"];
    let expected = expected.map(|name| folder.path().join(name));
    assert!(photos.files().eq(&expected));
}

/// Where a view's photograph has its name, one with an id for a name may be anything.
#[test]
fn ids_are_names_only_where_no_photograph_has_its_view_s_name() {
    let folder = tempfile::tempdir().unwrap();
    let views = [view(0, "f1.jpg"), view(1, "f2.jpg"), view(2, "")];
    for name in ["00000000.jpg", "00000001.jpg", "00000002.jpg"] {
        touch(&folder.path().join(name));
    }
    let photos = PhotoFolder::open(folder.path(), &views).unwrap();
    assert_eq!(photos.paths[&0], folder.path().join("00000000.jpg"));
    touch(&folder.path().join("f2.png"));
    let error = PhotoFolder::open(folder.path(), &views).unwrap_err();
    let said = error.to_string();
    assert!(
        said.contains("1 of 3 views") && said.contains("f1.jpg or that"),
        "{said}"
    );
    touch(&folder.path().join("f1.jpg"));
    let photos = PhotoFolder::open(folder.path(), &views).unwrap();
    let expected = ["f1.jpg", "f2.png", "00000002.jpg"].map(|name| folder.path().join(name));
    assert!(photos.files().eq(&expected), "{:?}", photos.paths);
}

#[test]
fn names_with_backslashes_and_endings_in_mixed_letters_are_found() {
    let folder = tempfile::tempdir().unwrap();
    let views = [
        view(0, "left\\a.jpg"),
        view(1, "right\\a.tif"),
        view(2, "c.jpg"),
    ];
    let names = ["left/a.jpg", "right/a.Png", "c.Jpg"];
    for name in names {
        touch(&folder.path().join(name));
    }
    let photos = PhotoFolder::open(folder.path(), &views).unwrap();
    let expected = names.map(|name| folder.path().join(name));
    assert!(photos.files().eq(&expected), "{:?}", photos.paths);
}

#[test]
fn folders_mean_something_where_photographs_lie_in_them_with_another_ending() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["camA/a.png", "camB/b.png", "a.png"] {
        touch(&folder.path().join(name));
    }
    let rig = [
        view(0, "camA/a.jpg"),
        view(1, "camB/a.jpg"),
        view(2, "camB/b.jpg"),
    ];
    let error = PhotoFolder::open(folder.path(), &rig)
        .unwrap_err()
        .to_string();
    assert!(error.contains("1 of 3 views"), "{error}");
    assert!(
        error.contains("camB/a.jpg or that with another ending"),
        "{error}"
    );
}

/// A JPEG whose EXIF says this orientation.
fn turned(orientation: u8) -> Vec<u8> {
    let mut jpeg = Vec::new();
    let picture = ColorImage::filled(4, 3, [90; 3]).unwrap();
    image::write_jpeg(&mut jpeg, &picture, image::JpegOptions::default()).unwrap();
    let mut exif = b"\xff\xe1\x00\x22Exif\0\0II*\0\x08\0\0\0\x01\0".to_vec();
    exif.extend(b"\x12\x01\x03\0\x01\0\0\0"); // orientation, one u16
    exif.extend([orientation, 0, 0, 0, 0, 0, 0, 0]);
    jpeg.splice(2..2, exif);
    jpeg
}

#[test]
fn photographs_that_are_stored_turned_are_counted() {
    let folder = tempfile::tempdir().unwrap();
    let views = [view(0, ""), view(1, ""), view(2, "")];
    let put = |id: u32, orientation| {
        let path = folder.path().join(format!("{id:08}.jpg"));
        files::write_atomically(&path, |out| out.write_all(&turned(orientation))).unwrap();
    };
    for id in 0..3 {
        put(id, 1);
    }
    let photos = PhotoFolder::open(folder.path(), &views).unwrap();
    assert_eq!(photos.warnings(), []);
    for orientation in 2..=8 {
        put(1, orientation);
        assert_eq!(photos.orientation(&views[1]), Some(orientation));
    }
    put(2, 3);
    let said = &photos.warnings()[0].message;
    assert!(said.starts_with("2 photographs"), "{said}");
    assert!(said.contains("00000001.jpg (orientation 8)"), "{said}");
    assert_eq!(photos.orientation(&views[0]), None);
}

#[cfg(unix)]
#[test]
fn what_cannot_be_looked_at_is_not_called_missing() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("00000000.jpg");
    std::os::unix::fs::symlink(&path, &path).unwrap(); // to itself
    let error = PhotoFolder::open(folder.path(), &[view(0, "")]).unwrap_err();
    let error = error.to_string();
    assert!(
        error.contains("cannot look at") && !error.contains("found none"),
        "{error}"
    );
}
