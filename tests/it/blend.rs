//! `mvs-eval blend` on files: what is surface, names, renderings of nothing.

use crate::support::{mvs_eval, stderr, text, write};
use mvs_datasets::format::image::{self, JpegOptions};
use mvs_datasets::layout::files;
use mvs_datasets::scene::ColorImage;
use std::path::Path;

/// 64 x 48 pixels, a bright disc on black, or nothing.
fn rendering(shown: bool) -> ColorImage {
    let pixels = (0..64 * 48i32).map(|at| {
        let (x, y) = (at % 64 - 32, at / 64 - 24);
        match shown && x * x + y * y < 150 {
            true => [250, 120, 40],
            false => [0; 3],
        }
    });
    ColorImage::from_values(64, 48, pixels.collect()).unwrap()
}

fn put_png(path: &Path, image: &ColorImage) {
    files::write_atomically(path, |out| image::write_png(out, image)).unwrap();
}

fn put_jpeg(path: &Path, image: &ColorImage) {
    let options = JpegOptions::default();
    files::write_atomically(path, |out| image::write_jpeg(out, image, options)).unwrap();
}

fn blend(folder: &Path) -> std::process::Output {
    let path = |name: &str| text(&folder.join(name)).to_owned();
    let (rendered, photos, out) = (path("rendered"), path("photos"), path("out"));
    let arguments = [
        "blend",
        "--rendered",
        &rendered,
        "--photos",
        &photos,
        "--out",
        &out,
    ];
    mvs_eval(&[&arguments[..], &["--format", "json", "--force"]].concat())
}

#[test]
fn what_a_jpeg_makes_of_black_is_no_surface() {
    let folder = tempfile::tempdir().unwrap();
    let disc = rendering(true);
    let expected = disc
        .values()
        .iter()
        .filter(|pixel| **pixel != [0; 3])
        .count();
    put_png(&folder.path().join("rendered/exact.png"), &disc);
    put_jpeg(&folder.path().join("rendered/lossy.jpg"), &disc);
    for name in ["exact", "lossy"] {
        put_png(&folder.path().join(format!("photos/{name}.png")), &disc);
    }
    let output = blend(folder.path());
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    let found: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let surface = |at: usize| found["images"][at]["surface"].as_u64().unwrap() as usize;
    assert_eq!(surface(0), expected);
    // But for the rim, where colour is shared by neighbours.
    let lossy = files::read_image(&folder.path().join("rendered/lossy.jpg")).unwrap();
    let above = |black: u8| {
        let shown = lossy
            .values()
            .iter()
            .filter(|pixel| pixel.iter().any(|&level| level > black));
        shown.count()
    };
    assert_eq!(surface(1), above(10));
    assert!(
        above(10) < expected * 13 / 10 && above(0) > expected * 15 / 10,
        "{} {}",
        above(10),
        above(0)
    );
    let masked = files::read_image(&folder.path().join("out/lossy_masked.jpg")).unwrap();
    assert!(masked.get(0, 0).iter().all(|&level| level <= 10));
}

#[test]
fn renderings_of_nothing_are_told_of_and_two_for_one_name_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let put = |name: &str, image: &ColorImage| {
        for place in ["rendered", "photos"] {
            put_png(&folder.path().join(place).join(name), image);
        }
    };
    put("a.png", &rendering(false));
    let output = blend(folder.path());
    assert_eq!(output.status.code(), Some(2));
    assert!(
        stderr(&output).contains("found 1 that are black"),
        "{}",
        stderr(&output)
    );
    put("b.png", &rendering(true));
    let output = blend(folder.path());
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    let said = "1 of 2 renderings are black";
    assert!(stderr(&output).contains(said), "{}", stderr(&output));
    put("b_masked.png", &rendering(true));
    let output = blend(folder.path());
    assert_eq!(output.status.code(), Some(2));
    let said = "both become b_masked.jpg";
    assert!(stderr(&output).contains(said), "{}", stderr(&output));
}

/// The names of views.json win over those of the renderings' files, with another ending, and with or without
/// their folders.
#[test]
fn photographs_are_those_of_the_images_that_were_rendered() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let flat = |level: u8| ColorImage::filled(64, 48, [level; 3]).unwrap();
    for id in ["00000000", "00000001"] {
        put_png(&path(&format!("rendered/{id}.png")), &rendering(true));
    }
    let names = r#"{"00000000": "left.jpg", "00000001": "00000000.jpg"}"#;
    write(&path("rendered/views.json"), names);
    put_png(&path("photos/left.png"), &flat(90));
    put_png(&path("photos/00000000.png"), &flat(150));
    put_png(&path("photos/00000001.png"), &flat(210));
    let differences = || {
        let output = blend(folder.path());
        assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
        let found: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
        [0, 1].map(|at| found["images"][at]["difference_before"].as_f64().unwrap())
    };
    // Against (250, 120, 40): of 90 and of 150.
    let expected = [(160.0 + 30.0 + 50.0) / 3.0, (100.0 + 30.0 + 110.0) / 3.0];
    assert_eq!(differences(), expected);
    let names = r#"{"00000000": "a/left.jpg", "00000001": "b/left.jpg"}"#;
    write(&path("rendered/views.json"), names);
    let output = blend(folder.path());
    assert_eq!(output.status.code(), Some(2));
    let said = stderr(&output);
    assert!(
        said.contains("photograph of the name `a/left.jpg`"),
        "{said}"
    );
    put_png(&path("photos/a/left.png"), &flat(150));
    put_png(&path("photos/b/left.png"), &flat(90));
    assert_eq!(differences(), [expected[1], expected[0]]);
}

#[test]
fn hidden_files_are_no_images() {
    let folder = tempfile::tempdir().unwrap();
    for place in ["rendered", "photos"] {
        put_png(&folder.path().join(place).join("a.png"), &rendering(true));
        write(&folder.path().join(place).join("._a.png"), [0, 5, 22, 7]);
    }
    let output = blend(folder.path());
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    let found: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(found["images"].as_array().unwrap().len(), 1);
}
