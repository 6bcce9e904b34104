//! `mvs-eval augment` on files.

use crate::support::{mvs_eval, stderr, text, turned_jpeg, write};
use mvs_datasets::format::{image, pfm};
use mvs_datasets::layout::files;
use mvs_datasets::scene::{ColorImage, Raster};
use mvs_eval::generate::augment;
use std::fs;
use std::path::Path;

fn picture() -> ColorImage {
    let level = |index: u32| [(index * 7 % 256) as u8, (index * 3 % 256) as u8, 90];
    Raster::from_values(40, 30, (0..1200).map(level).collect()).unwrap()
}

fn augmented(images: &Path, seed: &str, out: &Path) -> std::process::Output {
    mvs_eval(&[
        "augment",
        "--images",
        text(images),
        "--seed",
        seed,
        "--out",
        text(out),
    ])
}

#[test]
fn images_are_changed_as_drawn_and_the_draw_is_written_beside_them() {
    let folder = tempfile::tempdir().unwrap();
    let scene = folder.path().join("scene");
    let images = scene.join("blended_images");
    for name in [
        "00000003.png",
        "00000012.png",
        "00000012_masked.png",
        "statue.png",
    ] {
        files::write_atomically(&images.join(name), |out| image::write_png(out, &picture()))
            .unwrap();
    }
    files::write_atomically(&images.join("00000004.jpg"), |out| {
        image::write_jpeg(out, &picture(), image::JpegOptions::default())
    })
    .unwrap();
    let out = folder.path().join("out");
    let output = augmented(&scene, "7", &out);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    assert!(!stderr(&output).contains("warning"), "{}", stderr(&output));
    let drawn: serde_json::Value =
        serde_json::from_str(&fs::read_to_string(out.join("augment.json")).unwrap()).unwrap();
    assert_eq!(
        (&drawn["seed"], drawn["images"].as_array().unwrap().len()),
        (&7.into(), 5)
    );
    for entry in drawn["images"].as_array().unwrap() {
        let name = entry["file"].as_str().unwrap();
        // The file says enough to make the image again.
        let steps: [augment::Step; 3] = serde_json::from_value(entry["steps"].clone()).unwrap();
        let found = files::read_image(&out.join(name)).unwrap();
        if name.ends_with(".png") {
            assert_eq!(found, augment::apply(&picture(), &steps).unwrap(), "{name}");
        }
        let digits = name.split(['.', '_']).next().unwrap();
        if let Ok(view) = digits.parse::<u32>() {
            assert_eq!(
                (entry["view"].as_u64(), steps),
                (Some(view.into()), augment::draw(7, view))
            );
        }
    }
    let read = |folder: &Path, name: &str| fs::read(folder.join(name)).unwrap();
    assert_eq!(
        read(&out, "00000012.png"),
        read(&out, "00000012_masked.png")
    );
    let (again, other) = (folder.path().join("again"), folder.path().join("other"));
    augmented(&images, "7", &again);
    augmented(&images, "8", &other);
    for name in ["00000003.png", "00000004.jpg", "statue.png"] {
        assert_eq!(read(&out, name), read(&again, name), "{name}");
        assert_ne!(read(&out, name), read(&other, name), "{name}");
    }
    // Kept without --force; a folder without images is named.
    assert_eq!(augmented(&scene, "8", &out).status.code(), Some(2));
    let output = augmented(folder.path(), "7", &folder.path().join("new"));
    assert_eq!(output.status.code(), Some(2));
    assert!(
        stderr(&output).contains("expected images"),
        "{}",
        stderr(&output)
    );
}

/// As `generate` does: the pixels count as they are stored.
#[test]
fn images_that_exif_says_to_turn_are_counted() {
    let folder = tempfile::tempdir().unwrap();
    for (name, orientation) in [("a.jpg", 1), ("b.jpg", 8), ("c.jpg", 3)] {
        let jpeg = turned_jpeg(&picture(), orientation);
        write(&folder.path().join("images").join(name), jpeg);
    }
    let out = folder.path().join("out");
    let output = augmented(&folder.path().join("images"), "7", &out);
    let said = stderr(&output);
    assert_eq!(output.status.code(), Some(0), "{said}");
    assert!(
        said.contains("warning [exif-orientation]: 2 photographs")
            && said.contains("b.jpg (orientation 8)"),
        "{said}"
    );
    assert_eq!(
        files::read_image(&out.join("b.jpg")).unwrap().size(),
        (40, 30)
    );
}

#[test]
fn images_of_other_formats_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let images = folder.path().join("images");
    files::write_atomically(&images.join("00000000.png"), |out| {
        image::write_png(out, &picture())
    })
    .unwrap();
    write(&images.join("notes.txt"), "mine");
    let output = augmented(&images, "1", &folder.path().join("plain"));
    assert!(!stderr(&output).contains("left out"), "{}", stderr(&output));
    for name in ["00000001.BMP", "00000002.tif"] {
        write(&images.join(name), "an image");
    }
    let output = augmented(&images, "1", &folder.path().join("out"));
    let said = stderr(&output);
    assert_eq!(output.status.code(), Some(0), "{said}");
    assert!(
        said.contains("2 images are left out, the first is 00000001.BMP"),
        "{said}"
    );
}

/// What a masked image shows is what its whole one shows; its background stays what readers take for it.
#[test]
fn a_masked_image_is_changed_as_its_whole_one() {
    let folder = tempfile::tempdir().unwrap();
    let images = folder.path().join("blended_images");
    let is_surface = |index: usize| index % 40 > 12;
    let cut = |image: &ColorImage| {
        let pixels = image.values().iter().enumerate();
        let pixels = pixels.map(|(index, &pixel)| if is_surface(index) { pixel } else { [0; 3] });
        Raster::from_values(40, 30, pixels.collect()).unwrap()
    };
    let put = |name: &str, image: &ColorImage| {
        files::write_atomically(&images.join(name), |out| match name.ends_with(".png") {
            true => image::write_png(out, image),
            false => image::write_jpeg(out, image, image::JpegOptions::default()),
        })
        .unwrap();
    };
    for number in 0..6 {
        put(&format!("0000000{number}.png"), &picture());
        put(&format!("0000000{number}_masked.png"), &cut(&picture()));
    }
    put("00000007.jpg", &picture());
    put("00000007_masked.jpg", &cut(&picture()));
    let out = folder.path().join("out");
    let output = augmented(&images, "3", &out);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    let read = |name: String| files::read_image(&out.join(name)).unwrap();
    for number in 0..6 {
        let whole = read(format!("0000000{number}.png"));
        assert_ne!(whole, picture(), "{number}");
        assert_eq!(
            read(format!("0000000{number}_masked.png")),
            cut(&whole),
            "{number}"
        );
    }
    assert!(
        !stderr(&output).contains("unfinished"),
        "{}",
        stderr(&output)
    );
    // As `generate` leaves a scene that it was stopped in.
    write(&folder.path().join("run.partial.toml"), "");
    let output = augmented(folder.path(), "3", &folder.path().join("of unfinished"));
    assert_eq!(output.status.code(), Some(0));
    assert!(
        stderr(&output).contains("warning [unfinished]"),
        "{}",
        stderr(&output)
    );
    let given = files::read_image(&images.join("00000007_masked.jpg")).unwrap();
    let is_background = |pixel: &[u8; 3]| pixel.iter().all(|&level| level <= 10);
    let pixels = read("00000007_masked.jpg".into());
    let mut both = given.values().iter().zip(pixels.values());
    assert!(both.all(|(given, found)| !is_background(given) || is_background(found)));
    assert!(
        pixels
            .values()
            .iter()
            .filter(|pixel| !is_background(pixel))
            .count()
            > 500
    );
    // Without it, it is changed by itself, and its background stays all the same.
    let alone = folder.path().join("alone");
    std::fs::create_dir(&alone).unwrap();
    std::fs::copy(
        images.join("00000003_masked.png"),
        alone.join("00000003_masked.png"),
    )
    .unwrap();
    let output = augmented(&alone, "3", &folder.path().join("of alone"));
    assert_eq!(output.status.code(), Some(0));
    assert!(
        stderr(&output).contains("[masked-alone]: 1 masked"),
        "{}",
        stderr(&output)
    );
    let found = files::read_image(&folder.path().join("of alone/00000003_masked.png")).unwrap();
    let steps = augment::draw(3, 3);
    assert_eq!(
        found,
        cut(&augment::apply(&cut(&picture()), &steps).unwrap())
    );
    put("00000009.png", &Raster::filled(8, 8, [90; 3]).unwrap());
    put("00000009_masked.png", &picture());
    let refused = augmented(&images, "3", &folder.path().join("again"));
    assert_eq!(refused.status.code(), Some(2));
    assert!(
        stderr(&refused).contains("00000009_masked.png"),
        "{}",
        stderr(&refused)
    );
}

#[cfg(target_os = "linux")]
#[test]
fn an_image_whose_name_is_no_utf_8_is_named_before_any_is_changed() {
    use std::ffi::OsStr;
    use std::os::unix::ffi::OsStrExt;
    let folder = tempfile::tempdir().unwrap();
    let (images, out) = (folder.path().join("images"), folder.path().join("out"));
    for name in [&b"00000000.png"[..], b"a\xff.png"] {
        files::write_atomically(&images.join(OsStr::from_bytes(name)), |out| {
            image::write_png(out, &picture())
        })
        .unwrap();
    }
    let refused = augmented(&images, "1", &out);
    assert_eq!(refused.status.code(), Some(2), "{}", stderr(&refused));
    let said = "a\u{fffd}.png: expected a file name in UTF-8";
    assert!(stderr(&refused).contains(said), "{}", stderr(&refused));
    assert!(!out.exists());
}

/// Dark surface is surface too: the depth map says where it is. What macOS keeps beside files in archives is none.
#[test]
fn a_scene_s_masks_are_those_of_its_depth_maps() {
    let folder = tempfile::tempdir().unwrap();
    let scene = folder.path().join("scene");
    let shown = |at: u32| at % 40 < 30;
    let whole: Vec<[u8; 3]> = (0..1200)
        .map(|at| [if at % 3 == 0 { 4 } else { 120 }; 3])
        .collect();
    let masked = (0..)
        .zip(&whole)
        .map(|(at, pixel)| if shown(at) { *pixel } else { [0; 3] });
    let images = [
        ("00000002.png", whole.clone()),
        ("00000002_masked.png", masked.collect()),
    ];
    for (name, values) in images {
        let image = Raster::from_values(40, 30, values).unwrap();
        let path = scene.join("blended_images").join(name);
        files::write_atomically(&path, |out| image::write_png(out, &image)).unwrap();
    }
    let depth = Raster::from_values(
        40,
        30,
        (0..1200).map(|at| f32::from(u8::from(shown(at)))).collect(),
    );
    let path = scene.join("rendered_depth_maps/00000002.pfm");
    files::write_atomically(&path, |out| pfm::write_gray(out, &depth.unwrap())).unwrap();
    write(&scene.join("blended_images/._00000002.png"), [0, 5, 22, 7]);
    let out = folder.path().join("out");
    let output = augmented(&scene, "7", &out);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    let read = |name: &str| files::read_image(&out.join(name)).unwrap();
    let (whole, masked) = (read("00000002.png"), read("00000002_masked.png"));
    // However the folder is given.
    let inside = assert_cmd::Command::new(assert_cmd::cargo::cargo_bin!("mvs-eval"))
        .current_dir(scene.join("blended_images"))
        .args(["augment", "--images", ".", "--seed", "7", "--out"])
        .arg(folder.path().join("inside"))
        .output()
        .unwrap();
    assert_eq!(inside.status.code(), Some(0), "{}", stderr(&inside));
    let path = folder.path().join("inside/00000002_masked.png");
    assert_eq!(files::read_image(&path).unwrap(), masked);
    assert!(whole.values().iter().any(|pixel| *pixel != [120; 3]));
    for (at, (whole, masked)) in (0..).zip(whole.values().iter().zip(masked.values())) {
        let expected = if shown(at) { *whole } else { [0; 3] };
        assert_eq!(*masked, expected, "pixel {at}");
    }
    assert!(
        (0..)
            .zip(whole.values())
            .any(|(at, pixel)| at % 3 == 0 && pixel[0] > 0),
        "the draw tells"
    );
    // Of other pixels it says nothing about these.
    let small = Raster::from_values(20, 15, vec![1.0; 300]).unwrap();
    let path = scene.join("rendered_depth_maps/00000002.pfm");
    files::write_atomically(&path, |out| pfm::write_gray(out, &small)).unwrap();
    let output = augmented(&scene, "7", &folder.path().join("other"));
    assert_eq!(output.status.code(), Some(2));
    let said = "00000002.pfm: expected 40x30 pixels as 00000002_masked.png has, found 20x15";
    assert!(stderr(&output).contains(said), "{}", stderr(&output));
}
