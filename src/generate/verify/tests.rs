//! Every finding fires on a scene that was spoilt in that one way, and on no sound one.

use super::*;
use crate::generate::{Extra, GenerateOptions, PairOptions, Photographs, Source, generate};
use crate::progress::Silent;
use crate::render::{RenderOptions, Rendering};
use crate::warning::Warnings;
use glam::{DMat4, DVec2};
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
fn swapped_poses_are_found() {
    let flip = DMat4::from_scale(glam::DVec3::new(1.0, -1.0, -1.0));
    let swap = Spoilt::new();
    swap.edit_cams(|cam| cam.extrinsic = cam.extrinsic.inverse());
    // Text may round the last row.
    assert!(
        swap.faults().contains(&"swapped-pose".to_owned()),
        "{:?}",
        swap.faults()
    );
    let gl = Spoilt::new();
    gl.edit_cams(|cam| cam.extrinsic = flip * cam.extrinsic);
    assert!(
        gl.faults().contains(&"opengl-axes".to_owned()),
        "{:?}",
        gl.faults()
    );
    let both = Spoilt::new();
    both.edit_cams(|cam| cam.extrinsic = (flip * cam.extrinsic).inverse());
    assert!(
        both.faults().contains(&"swapped-opengl-pose".to_owned()),
        "{:?}",
        both.faults()
    );
}

#[test]
fn scaled_intrinsics_are_found() {
    for scale in [0.5, 0.375, 2.0] {
        let spoilt = Spoilt::new();
        spoilt.edit_cams(|cam| {
            cam.intrinsic.x_axis.x *= scale;
            cam.intrinsic.y_axis.y *= scale;
            cam.intrinsic.z_axis.x *= scale;
            cam.intrinsic.z_axis.y *= scale;
        });
        let faults = spoilt.faults();
        assert!(
            faults.contains(&"scaled-intrinsics".to_owned()),
            "{scale}: {faults:?}"
        );
    }
}

#[test]
fn range_instead_of_z_is_found() {
    let spoilt = Spoilt::new();
    let scene = spoilt.blended().read_scene(None).unwrap();
    for view in scene.views() {
        let (depth, _) = spoilt.blended().read_depth(view.id).unwrap();
        let (width, height) = depth.size();
        let value = |i: u32| {
            let pixel = DVec2::new(f64::from(i % width) + 0.5, f64::from(i / width) + 0.5);
            depth.get(i % width, i / width) * view.camera.ray(pixel).length() as f32
        };
        let values = (0..width * height).map(value).collect();
        let range = DepthMap::from_values(width, height, values).unwrap().0;
        spoilt.blended().write_depth(view.id, &range).unwrap();
    }
    assert!(
        spoilt.faults().contains(&"range-depth".to_owned()),
        "{:?}",
        spoilt.faults()
    );
}

#[test]
fn shuffled_pairs_are_found() {
    let spoilt = Spoilt::new();
    spoilt.edit("cams/pair.txt", |text| {
        let mut lines: Vec<String> = text.lines().map(str::to_owned).collect();
        let rows: Vec<String> = lines.iter().skip(2).step_by(2).cloned().collect();
        for (index, line) in lines.iter_mut().skip(2).step_by(2).enumerate() {
            *line = rows[(index + 7) % rows.len()].clone();
        }
        lines.join("\n") + "\n"
    });
    assert!(
        spoilt.faults().contains(&"shuffled-pairs".to_owned()),
        "{:?}",
        spoilt.faults()
    );
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
fn images_of_other_views_are_found() {
    let spoilt = Spoilt::new();
    let images = |id: u32| {
        (
            spoilt.blended().image(id),
            spoilt.blended().masked_image(id),
        )
    };
    let all: Vec<Vec<u8>> = (0..14)
        .map(|id| std::fs::read(images(id).0).unwrap())
        .collect();
    for id in 0..14 {
        write(&images(id).0, &all[(id as usize + 5) % 14]);
    }
    assert!(
        spoilt.faults().contains(&"images-do-not-match".to_owned()),
        "{:?}",
        spoilt.faults()
    );
}

/// One spoilt file, and the code that must be found.
type Mutation = (&'static str, fn(&Spoilt), &'static str);

#[test]
fn each_rule_of_the_readers_fires() {
    let mutations: [Mutation; 23] = [
        (
            "trailing space",
            |s| edit_line(s, "cams/00000001_cam.txt", 11, |l| format!("{l} ")),
            "depth-line",
        ),
        (
            "three numbers",
            |s| edit_line(s, "cams/00000001_cam.txt", 11, cut_last),
            "depth-line",
        ),
        (
            "interval",
            |s| {
                edit_line(s, "cams/00000001_cam.txt", 11, |l| {
                    l.replace(" 128.0 ", " 64.0 ")
                });
            },
            "depth-interval",
        ),
        (
            "negative depth",
            |s| {
                edit_line(s, "cams/00000001_cam.txt", 11, |_| {
                    "-1 0.01 128 0.28".into()
                });
            },
            "depth-range",
        ),
        (
            "keyword",
            |s| edit_line(s, "cams/00000001_cam.txt", 0, |_| "extrinsics".into()),
            "cam-keywords",
        ),
        (
            "blank line",
            |s| s.edit("cams/pair.txt", |t| format!("{t}\n")),
            "pair-blanks",
        ),
        (
            "double space",
            |s| edit_line(s, "cams/pair.txt", 2, |l| l.replacen(' ', "  ", 1)),
            "pair-blanks",
        ),
        (
            "count",
            |s| edit_line(s, "cams/pair.txt", 0, |_| "13".into()),
            "pair-count",
        ),
        (
            "source count",
            |s| edit_line(s, "cams/pair.txt", 2, |_| "0".into()),
            "source-count",
        ),
        (
            "eleven sources",
            |s| {
                edit_line(s, "cams/pair.txt", 2, |_| {
                    let sources = (1..12).map(|id| format!(" {id} {}", 20 - id));
                    format!("11{}", sources.collect::<String>())
                });
            },
            "source-count",
        ),
        (
            "itself",
            |s| edit_line(s, "cams/pair.txt", 2, |_| "2 0 5 1 4".into()),
            "source-is-itself",
        ),
        (
            "zero score",
            |s| edit_line(s, "cams/pair.txt", 2, |_| "2 1 5 2 0".into()),
            "score-zero",
        ),
        (
            "rising",
            |s| edit_line(s, "cams/pair.txt", 2, |_| "2 1 5 2 6".into()),
            "score-order",
        ),
        (
            "broken line",
            |s| edit_line(s, "cams/pair.txt", 2, |_| "3 1 5 2 6".into()),
            "pair-line",
        ),
        (
            "no reference",
            |s| s.edit("cams/pair.txt", drop_last_reference),
            "source-is-no-reference",
        ),
        (
            "no entry",
            |s| s.edit("cams/pair.txt", drop_last_reference),
            "view-without-pairs",
        ),
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
        ("no pairs", |s| remove(s, "cams/pair.txt"), "missing-pairs"),
        (
            "no camera",
            |s| remove(s, "cams/00000002_cam.txt"),
            "pair-without-camera",
        ),
    ];
    for (what, spoil, code) in mutations {
        let spoilt = Spoilt::new();
        spoil(&spoilt);
        let found = rules::check(&spoilt.blended()).unwrap();
        let codes: Vec<&str> = found.iter().map(|finding| finding.code.as_str()).collect();
        assert!(codes.contains(&code), "{what}: {codes:?}");
    }
    assert_eq!(rules::check(&Spoilt::new().blended()).unwrap(), []);
}

fn edit_line(spoilt: &Spoilt, name: &str, index: usize, edit: fn(&str) -> String) {
    spoilt.edit(name, |text| {
        let mut lines: Vec<String> = text.lines().map(str::to_owned).collect();
        lines[index] = edit(&lines[index]);
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
