//! Every finding fires on a scene that was spoilt in that one way, and on no sound one.

use super::*;
use crate::generate::{Extra, GenerateOptions, PairOptions, Photographs, Source, generate};
use crate::progress::Silent;
use crate::render::{RenderOptions, Rendering};
use crate::warning::Warnings;
use mvs_datasets::format::cam::{self, CamFile};
use mvs_datasets::format::image::JpegOptions;
use mvs_datasets::layout::files;
use mvs_datasets::scene::{ColorImage, DepthMap, View};
use mvs_datasets::synthetic::{SyntheticOptions, SyntheticScene};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;
use tempfile::TempDir;

struct Lit<'a>(&'a SyntheticScene);

impl Photographs for Lit<'_> {
    fn photograph(&self, view: &View, rendering: &Rendering) -> Result<ColorImage> {
        let index = self.0.scene().index_of(view.id).unwrap();
        Ok(self.0.photograph(index, &rendering.color))
    }

    fn digest(&self, _view: &View) -> Result<String> {
        Ok(String::new())
    }
}

/// A sound scene, made once.
fn sound() -> &'static Path {
    static SOUND: OnceLock<TempDir> = OnceLock::new();
    let folder = SOUND.get_or_init(|| {
        let folder = tempfile::tempdir().unwrap();
        let options = SyntheticOptions {
            views: 14,
            width: 128,
            height: 96,
            ..SyntheticOptions::default()
        };
        let scene = SyntheticScene::new(options).unwrap();
        let draft = GenerateOptions {
            render: RenderOptions {
                samples: 1,
                ..RenderOptions::default()
            },
            pairs: PairOptions {
                points: 200,
                sources: 4,
                ..PairOptions::default()
            },
            extras: [Extra::Masks].into(),
            ..GenerateOptions::default()
        };
        let source = Source {
            name: "sound",
            id: "0123456789abcdef01234567",
            mesh: scene.mesh(),
            views: scene.scene().views(),
            photographs: &Lit(&scene),
            notes: &[],
            sources: None,
        };
        let target = BlendedFolder::new(folder.path());
        generate(&source, &target, &draft, &Silent, &Warnings::default()).unwrap();
        folder
    });
    folder.path()
}

/// A copy of the sound scene to spoil.
struct Spoilt {
    folder: TempDir,
}

impl Spoilt {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        for inside in ["cams", "blended_images", "rendered_depth_maps"] {
            std::fs::create_dir(folder.path().join(inside)).unwrap();
            for entry in std::fs::read_dir(sound().join(inside)).unwrap() {
                let path = entry.unwrap().path();
                let name = path.file_name().unwrap();
                std::fs::copy(&path, folder.path().join(inside).join(name)).unwrap();
            }
        }
        Self { folder }
    }

    fn blended(&self) -> BlendedFolder {
        BlendedFolder::new(self.folder.path())
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn verify(&self) -> Verification {
        verify(&self.blended(), &VerifyOptions::default(), &Silent).unwrap()
    }

    /// The codes of faults found.
    fn faults(&self) -> Vec<String> {
        let found = self.verify().findings;
        let faults = found.into_iter().filter(|f| f.severity == Severity::Fault);
        let mut codes: Vec<String> = faults.map(|finding| finding.code).collect();
        codes.dedup();
        codes
    }

    fn edit(&self, name: &str, edit: impl Fn(&str) -> String) {
        let text = std::fs::read_to_string(self.path(name)).unwrap();
        write(&self.path(name), edit(&text).as_bytes());
    }

    fn edit_cams(&self, edit: impl Fn(&mut CamFile)) {
        for id in 0..14 {
            let path = self.blended().cam(id);
            let mut cam = cam::read(&std::fs::read_to_string(&path).unwrap()).unwrap();
            edit(&mut cam);
            files::write_atomically(&path, |out| cam::write(out, &cam)).unwrap();
        }
    }
}

fn write(path: &Path, bytes: &[u8]) {
    files::write_atomically(path, |out| out.write_all(bytes)).unwrap();
}

mod mutations;

#[test]
fn a_sound_scene_has_no_findings() {
    let spoilt = Spoilt::new();
    let verification = spoilt.verify();
    assert_eq!(verification.findings, []);
    assert_eq!(verification.views, 14);
    assert!(verification.pairs.len() >= 28);
    assert!(verification.median_difference.unwrap() < 1e-4);
    assert!(verification.median_color_difference.unwrap() < 25.0);
}

#[test]
fn half_a_pixel_is_found_either_way() {
    for (offset, words) in [(-0.5, "add 0.5"), (0.5, "subtract 0.5")] {
        let spoilt = Spoilt::new();
        spoilt.edit_cams(|cam| cam.intrinsic.z_axis += glam::DVec3::new(offset, offset, 0.0));
        let verification = spoilt.verify();
        let finding = verification
            .findings
            .iter()
            .find(|f| f.code == "half-pixel")
            .unwrap();
        assert!(finding.message.contains(words), "{}", finding.message);
    }
}

#[test]
fn missing_masks_and_foreign_masks_are_found() {
    let spoilt = Spoilt::new();
    let image = |suffix: &str| spoilt.path(&format!("blended_images/00000003{suffix}"));
    std::fs::copy(image(".jpg"), image("_masked.jpg")).unwrap();
    assert_eq!(spoilt.faults(), ["missing-mask"]);
    let (width, height) = (128, 96);
    let black = ColorImage::filled(width, height, [0; 3]).unwrap();
    BlendedFolder::write_jpeg(&image("_masked.jpg"), &black, JpegOptions::default()).unwrap();
    assert_eq!(spoilt.faults(), ["wrong-mask"]);
}

#[test]
fn depths_are_checked_view_by_view() {
    let spoilt = Spoilt::new();
    let folder = spoilt.blended();
    let (width, height) = (128, 96);
    let filled = |value: f32| {
        DepthMap::from_values(width, height, vec![value; (width * height) as usize])
            .unwrap()
            .0
    };
    folder.write_depth(1, &filled(0.0)).unwrap();
    folder.write_depth(2, &filled(1e6)).unwrap();
    let small = DepthMap::from_values(4, 3, vec![1.0; 12]).unwrap().0;
    folder.write_depth(3, &small).unwrap();
    write(&folder.depth(4), b"PF\n4 3\n1.0\n");
    let verification = spoilt.verify();
    for code in [
        "empty-depth",
        "no-depth-in-range",
        "size-mismatch",
        "pfm-header",
        "unreadable",
    ] {
        assert!(
            verification.found(code),
            "{code}: {:#?}",
            verification.findings
        );
    }
    assert!(verification.failed());
}

/// A change so small that nothing else shows it, and an extra that is gone.
#[test]
fn files_that_are_not_those_made_are_named() {
    let spoilt = Spoilt::new();
    std::fs::copy(sound().join("scene.json"), spoilt.path("scene.json")).unwrap();
    let named = || {
        let found = spoilt.verify().findings.into_iter();
        let found = found.map(|finding| (finding.code, finding.place, finding.message));
        found.collect::<Vec<_>>()
    };
    // The masks, which were not copied.
    let gone = named();
    assert_eq!(gone.len(), 1, "{gone:?}");
    let (code, place, message) = &gone[0];
    assert_eq!(
        (code.as_str(), place.as_str()),
        ("not-as-written", "masks/00000000.png")
    );
    assert!(
        message.contains("of 14 of 70 (this is the first) found none"),
        "{message}"
    );
    std::fs::create_dir(spoilt.path("masks")).unwrap();
    for id in 0..14 {
        let mask = format!("masks/{id:08}.png");
        std::fs::copy(sound().join(&mask), spoilt.path(&mask)).unwrap();
    }
    assert_eq!(named(), []);
    let depth = spoilt.blended().depth(7);
    let mut bytes = std::fs::read(&depth).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    write(&depth, &bytes);
    let other = named();
    assert_eq!(other.len(), 1, "{other:?}");
    assert!(other[0].1.ends_with("00000007.pfm"), "{other:?}");
    assert!(
        other[0]
            .2
            .contains("of 1 of 70 (this is the first) found other bytes"),
        "{other:?}"
    );
    spoilt.edit("scene.json", |text| text[..text.len() / 2].to_owned());
    let options = VerifyOptions {
        pixel_centre: Some(PixelCentre::Half),
        ..VerifyOptions::default()
    };
    let cut = verify(&spoilt.blended(), &options, &Silent).unwrap();
    assert!(cut.found("unreadable"), "{:?}", cut.findings);
}

#[test]
fn a_folder_without_its_parts_is_one_finding_each() {
    let empty = tempfile::tempdir().unwrap();
    let folder = BlendedFolder::new(empty.path());
    let found = verify(&folder, &VerifyOptions::default(), &Silent).unwrap();
    let missing = found.findings.iter().filter(|f| f.code == "missing-folder");
    assert_eq!(missing.count(), 3);
}

#[test]
fn images_that_readers_cut_to_four_thirds_are_named() {
    let spoilt = Spoilt::new();
    let folder = spoilt.blended();
    let cut = |image: ColorImage| {
        ColorImage::from_values(128, 90, image.values()[..128 * 90].to_vec()).unwrap()
    };
    for id in 0..14 {
        for path in [folder.image(id), folder.masked_image(id)] {
            let image = cut(files::read_image(&path).unwrap());
            BlendedFolder::write_jpeg(&path, &image, JpegOptions::default()).unwrap();
        }
        let (depth, _) = folder.read_depth(id).unwrap();
        let values = depth.values()[..128 * 90].to_vec();
        let depth = DepthMap::from_values(128, 90, values).unwrap().0;
        folder.write_depth(id, &depth).unwrap();
    }
    let verification = spoilt.verify();
    assert!(verification.found("aspect"));
    assert!(!verification.failed(), "{:#?}", verification.findings);
}
