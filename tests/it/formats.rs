//! Files that other programs wrote, and files that nobody should write: every one is read to the
//! right values or answered with one sentence.

use crate::support::real_data;
use glam::{DMat4, DVec2, DVec3};
use mvs_datasets::FormatError;
use mvs_datasets::format::colmap::dense;
use mvs_datasets::format::{
    cam, colmap, crop, gltf, image, log, obj, pair, pfm, ply, transform, transforms,
};
use mvs_datasets::layout::mvsnet::{self, CamsOptions, PixelCentre};
use mvs_datasets::layout::{files, tnt};
use mvs_datasets::scene::{PointCloud, Raster, SourceScore};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};
use std::path::{Path, PathBuf};

/// All files under `folder` with this ending, in name order.
fn files_with(folder: &Path, ending: &str) -> Vec<PathBuf> {
    let mut found = Vec::new();
    let mut folders = vec![folder.to_path_buf()];
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else if path.to_str().is_some_and(|name| name.ends_with(ending)) {
                found.push(path);
            }
        }
    }
    found.sort();
    found
}

/// One sentence: no line break, no panic message, a place and what was expected.
fn is_one_sentence(error: &FormatError) -> bool {
    let said = error.to_string();
    !said.contains('\n') && said.contains("expected") && said.contains("found") && said.len() < 400
}

/// What a PLY should read to, found by looking into it with other tools.
struct Known {
    path: &'static str,
    /// Count, first and last position; or a part of the sentence.
    cloud: Result<(usize, [f64; 3], [f64; 3]), &'static str>,
    /// Number of triangles and the first one; or a part of the sentence.
    mesh: Result<(usize, [u32; 3]), &'static str>,
}

const fn known(
    path: &'static str,
    (count, first, last): (usize, [f64; 3], [f64; 3]),
    mesh: Result<(usize, [u32; 3]), &'static str>,
) -> Known {
    Known {
        path,
        cloud: Ok((count, first, last)),
        mesh,
    }
}

const fn broken(path: &'static str, problem: &'static str) -> Known {
    Known {
        path,
        cloud: Err(problem),
        mesh: Err(problem),
    }
}

const NO_FACES: Result<(usize, [u32; 3]), &str> = Err("and no faces");
const CUBE: (usize, [f64; 3], [f64; 3]) = (8, [0.0; 3], [1.0, 1.0, 0.0]);
const TRIANGLE: (usize, [f64; 3], [f64; 3]) = (3, [-1.0, 0.0, 0.0], [1.0, 0.0, 0.0]);

#[rustfmt::skip]
fn known_files() -> Vec<Known> {
    vec![
        known("formats/assimp/PLY/Wuson.ply", (11184, [0.163313, 0.540615, -0.268688], [-0.338613, 1.069065, -1.146774]), Ok((3732, [0, 1, 2]))),
        known("formats/assimp/PLY/cube.ply", CUBE, Ok((12, [0, 1, 2]))),
        known("formats/assimp/PLY/cube_binary.ply", CUBE, Ok((12, [0, 1, 2]))),
        known("formats/assimp/PLY/cube_binary_header_with_RN_newline.ply", CUBE, Ok((12, [0, 1, 2]))),
        known("formats/assimp/PLY/cube_binary_starts_with_nl.ply", (8, [5.967534065246582, 0.0, 0.0], [6.967534065246582, 1.0, 0.0]), Ok((12, [0, 1, 2]))),
        known("formats/assimp/PLY/cube_uv.ply", (24, [1.0, 1.0, -1.0], [-1.0, 1.0, 1.0]), Ok((12, [0, 1, 2]))),
        known("formats/assimp/PLY/float-color.ply", (3, [0.0; 3], [200.0, 200.0, 0.0]), Ok((1, [0, 1, 2]))),
        broken("formats/assimp/PLY/issue623.ply", "vertex 0 (line 14): expected the values of 7 properties, found 6 numbers"),
        known("formats/assimp/PLY/points.ply", (4, [0.0; 3], [0.0, 1.0, 1.0]), NO_FACES),
        known("formats/pdal/ply/issue_2421.ply", (1, [1.23457, 12345.6789, 1234567890.12345], [1.23457, 12345.6789, 1234567890.12345]), NO_FACES),
        known("formats/pdal/ply/mesh.ply", (4, [1.0, 1.0, 0.0], [2.0, 2.0, 2.0]), Ok((2, [0, 1, 2]))),
        known("formats/pdal/ply/mesh_fixed.ply", (4, [1.0, 1.0, 0.0], [2.0, 2.0, 2.0]), Ok((2, [0, 1, 2]))),
        Known { path: "formats/pdal/ply/no_vertex.ply", cloud: Err("expected an element `vertex`, found none"), mesh: NO_FACES },
        known("formats/pdal/ply/simple_binary.ply", TRIANGLE, NO_FACES),
        known("formats/pdal/ply/simple_text.ply", TRIANGLE, NO_FACES),
        Known { path: "formats/pdal/ply/sized_dims.ply", cloud: Err("expected properties x, y and z, found x, y, j, i"), mesh: NO_FACES },
        known("formats/pdal/ply/text_extradim.ply", (1, [-2.64944, -13.0955, 0.00640115], [-2.64944, -13.0955, 0.00640115]), NO_FACES),
        Known { path: "formats/pdal/ply/unsized_dims.ply", cloud: Err("expected properties x, y and z, found y, x, i, j"), mesh: NO_FACES },
        known("meshes/trimesh/cube_blender_uv.ply", (24, [0.5, 0.5, 0.5], [0.5, 0.5, -0.5]), Ok((12, [0, 1, 2]))),
        known("meshes/trimesh/cube_blender_uv_meshlab.ply", (24, [0.5, 0.5, 0.5], [0.5, 0.5, -0.5]), Ok((12, [0, 1, 2]))),
        known("meshes/trimesh/fuze.ply", (502, [0.0020469999872148037, -0.002870999975129962, 0.004031000193208456], [-0.023590000346302986, -0.024429000914096832, 0.11301399767398834]), Ok((1000, [0, 5, 1]))),
        known("meshes/trimesh/reference.ply", (845, [-52.825599670410156, -49.53089904785156, -68.13030242919922], [19.269899368286133, 59.28139877319336, -16.813199996948242]), Ok((1610, [0, 1, 2]))),
    ]
}

#[test]
fn every_foreign_ply_reads_right_or_says_why_not() {
    let Some(data) = real_data("") else { return };
    let known = known_files();
    let mut paths = files_with(&data.join("formats"), ".ply");
    paths.extend(files_with(&data.join("meshes"), ".ply"));
    let listed: Vec<PathBuf> = known.iter().map(|file| data.join(file.path)).collect();
    assert_eq!(paths, listed, "every PLY has an entry in the table");
    for file in &known {
        let bytes = std::fs::read(data.join(file.path)).unwrap();
        match (ply::read_cloud(&bytes), file.cloud) {
            (Ok(cloud), Ok((count, first, last))) => {
                let positions = cloud.positions();
                assert_eq!(positions.len(), count, "{}", file.path);
                assert_eq!(positions[0], DVec3::from(first), "{}", file.path);
                assert_eq!(positions[count - 1], DVec3::from(last), "{}", file.path);
            }
            (Err(error), Err(expected)) => {
                assert!(
                    error.to_string().contains(expected),
                    "{}: {error}",
                    file.path
                );
                assert!(is_one_sentence(&error), "{}: {error}", file.path);
            }
            (found, _) => panic!("{}: {found:?}", file.path),
        }
        match (ply::read_mesh(&bytes), file.mesh) {
            (Ok(read), Ok((count, first))) => {
                assert_eq!(read.mesh.triangles().len(), count, "{}", file.path);
                assert_eq!(read.mesh.triangles()[0], first, "{}", file.path);
            }
            (Err(error), Err(expected)) => {
                assert!(
                    error.to_string().contains(expected),
                    "{}: {error}",
                    file.path
                );
                assert!(is_one_sentence(&error), "{}: {error}", file.path);
            }
            (found, _) => panic!("{}: {found:?}", file.path),
        }
    }
}

#[test]
fn foreign_columns_keep_their_meaning() {
    let Some(data) = real_data("") else { return };
    let cloud = |path: &str| files::read_cloud(&data.join(path)).unwrap();
    let points = cloud("formats/assimp/PLY/points.ply");
    assert_eq!(points.colors().unwrap()[1], [255, 0, 255]);
    assert_eq!(points.normals().unwrap()[3].to_array(), [1.0, 1.0, 0.0]);
    let colors = cloud("formats/assimp/PLY/float-color.ply");
    assert_eq!(colors.colors().unwrap(), [[0, 0, 255]; 3]);
    let extra = cloud("formats/pdal/ply/text_extradim.ply");
    assert_eq!(extra.colors().unwrap(), [[63, 200, 64]]);
    let mesh = |path: &str| ply::read_mesh(&std::fs::read(data.join(path)).unwrap()).unwrap();
    let fuze = mesh("meshes/trimesh/fuze.ply");
    assert_eq!(fuze.texture_files, ["fuze uv.jpg"]);
    let corner = fuze.mesh.texture_coords().unwrap()[0][0].to_array();
    assert_eq!(corner, [0.629012, 0.417026]);
    for path in ["cube_blender_uv.ply", "cube_blender_uv_meshlab.ply"] {
        let cube = mesh(&format!("meshes/trimesh/{path}")).mesh;
        assert_eq!(
            cube.texture_coords().unwrap()[0][0].to_array(),
            [0.625, 0.5],
            "{path}"
        );
    }
    let (rec, truth) = (
        "pair_saharov/rec/saharov_rec.ply",
        "pair_saharov/saharov.ply",
    );
    assert_eq!((cloud(rec).len(), cloud(truth).len()), (150_000, 206_602));
}

#[test]
fn the_toolbox_s_trajectories_read_right() {
    let Some(data) = real_data("") else { return };
    let folder = data.join("formats/tnt_toolbox/test_data");
    let poses = tnt::read_trajectory(&folder.join("test.log")).unwrap();
    assert_eq!((poses.len(), poses[150].metadata), (151, [150, 150, 0]));
    assert_eq!(poses[0].world_from_cam.row(0).w, 2.377286677636);
    assert_eq!(poses[1].world_from_cam.row(1).x, 0.135383075708);
    assert!(poses.iter().all(|pose| !pose.is_unregistered()));
    for (name, images, video_frames, last) in [
        ("mapping.txt", 151, 6015, (150, 6001)),
        ("Ignatius_mapping.txt", 263, 7845, (262, 7845)),
    ] {
        let text = files::read_text(&folder.join(name)).unwrap();
        let mapping = log::read_mapping(&text).unwrap();
        assert_eq!(
            (mapping.frames.len(), mapping.video_frames),
            (images, video_frames)
        );
        assert_eq!(
            (mapping.frames[0], mapping.frames[images - 1]),
            ((0, 1), last)
        );
    }
    for path in [
        "formats/cameras/cameras.out",
        "formats/cameras/open3d_example.json",
    ] {
        let text = files::read_text(&data.join(path)).unwrap();
        for error in [
            log::read(&text).unwrap_err(),
            crop::read(&text).unwrap_err(),
        ] {
            assert!(is_one_sentence(&error), "{path}: {error}");
        }
    }
}

#[test]
fn a_real_scoring_pair_opens_under_its_own_name_only() {
    let Some(folder) = real_data("pair_saharov") else {
        return;
    };
    let error = tnt::TntFolder::open(&folder, None).unwrap_err().to_string();
    assert!(error.contains("holds the files of `saharov`"), "{error}");
    let scene = tnt::TntFolder::open(&folder, Some("saharov")).unwrap();
    assert_eq!(scene.read_trajectory().unwrap().len(), 32);
    assert_eq!(
        scene.read_crop().unwrap().polygon()[0],
        DVec2::new(-1.75, 0.2)
    );
    assert!((scene.read_transform().unwrap().scale() - 5.0).abs() < 1e-6);
    assert_eq!(scene.read_mapping().unwrap(), None);
}

#[test]
fn a_real_camera_folder_reads_right() {
    let Some(folder) = real_data("scene_saharov") else {
        return;
    };
    let options = CamsOptions {
        pixel_centre: PixelCentre::Integer,
        size: None,
    };
    let scene = mvsnet::read_scene(&folder, &options).unwrap();
    let view = &scene.views()[0];
    assert_eq!(scene.views().len(), 32);
    assert_eq!((view.camera.width(), view.camera.height()), (1092, 728));
    assert_eq!(view.camera.center(), DVec2::new(546.0, 364.0));
    assert_eq!(view.pose.translation().z, 1.08569144);
    assert_eq!(view.depth_range.unwrap().max(), 2.2282686);
    let best = SourceScore {
        id: 31,
        score: 273.3005,
    };
    assert_eq!(
        (scene.sources_of(0).len(), scene.sources_of(0)[0]),
        (10, best)
    );
    let photo = files::read_image(&folder.join("images/00000000.jpg")).unwrap();
    assert_eq!(photo.size(), (1092, 728));
    let depths = mvsnet::read_scene(&folder.join("mvs_depth"), &options).unwrap();
    let (depth, rejected) = files::read_depth(&folder.join("mvs_depth/00000000.pfm")).unwrap();
    let camera = depths.views()[0].camera;
    assert_eq!((camera.width(), camera.height()), depth.size());
    assert_eq!((depth.size(), rejected.total()), ((273, 182), 0));
    assert!(depth.valid_count() > 10_000);
}

/// A reader as a function that only says whether it took the bytes.
type Reader = fn(&[u8]) -> Result<(), FormatError>;

fn text(bytes: &[u8]) -> Result<&str, FormatError> {
    std::str::from_utf8(bytes).map_err(|_| FormatError::new("byte 0", "expected text, found none"))
}

fn read_gltf(bytes: &[u8]) -> Result<(), FormatError> {
    let refuse = |_: &str| Err("expected no other file, found one".to_owned());
    gltf::read_gltf(bytes, &refuse).map(drop)
}

/// A triangle with texture coordinates, its buffer inside.
fn triangle_gltf() -> String {
    // Positions (0 0 0) (1 0 0) (0 1 0) and their first two numbers as texture coordinates.
    let data = "AAAAAAAAAAAAAAAAAACAPwAAAAAAAAAAAAAAAAAAgD8AAAAA";
    format!(
        r#"{{"asset":{{"version":"2.0"}},"scenes":[{{"nodes":[0]}}],"nodes":[{{"children":[1],"scale":[1,2,1]}},{{"mesh":0,"translation":[1,2,3]}}],"meshes":[{{"primitives":[{{"attributes":{{"POSITION":0,"TEXCOORD_0":1}},"material":0,"mode":5}}]}}],"materials":[{{"alphaMode":"MASK","pbrMetallicRoughness":{{"baseColorTexture":{{"index":0}}}}}}],"textures":[{{"source":0}}],"images":[{{"uri":"a.png"}}],"accessors":[{{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3"}},{{"bufferView":1,"componentType":5126,"count":3,"type":"VEC2"}}],"bufferViews":[{{"buffer":0,"byteLength":36}},{{"buffer":0,"byteLength":36,"byteStride":12}}],"buffers":[{{"byteLength":36,"uri":"data:application/octet-stream;base64,{data}"}}]}}"#
    )
}

fn glb(json: &str) -> Vec<u8> {
    let mut bytes = b"glTF\x02\0\0\0\0\0\0\0".to_vec();
    bytes.extend(u32::try_from(json.len()).unwrap().to_le_bytes());
    bytes.extend(b"JSON");
    bytes.extend(json.as_bytes());
    bytes
}

/// A small valid file of every format, and its reader.
/// COLMAP's dense array of 3x2 pixels.
fn dense_array(channels: usize) -> Vec<u8> {
    let mut bytes = format!("3&2&{channels}&").into_bytes();
    bytes.extend((0..6 * channels).flat_map(|value| (value as f32 + 0.5).to_le_bytes()));
    bytes
}

fn samples() -> Vec<(&'static str, Vec<u8>, Reader)> {
    let cloud = PointCloud::new(vec![DVec3::ONE, DVec3::new(1.5, -2.0, 1e6), DVec3::ZERO])
        .with_colors(vec![[1, 2, 3]; 3])
        .unwrap();
    let picture = Raster::from_values(9, 7, (0..63).map(|i| [i, 2 * i, 3 * i]).collect()).unwrap();
    let floats = Raster::from_values(3, 2, vec![1.0, 2.0, 3.0, f32::NAN, 0.0, 6.0]).unwrap();
    let mesh = "ply\nformat ascii 1.0\ncomment TextureFile a.jpg\nelement vertex 3\nproperty float x\nproperty float y\nproperty double z\nproperty float s\nproperty float t\nelement face 1\nproperty list uchar int vertex_indices\nproperty list uchar float texcoord\nproperty int texnumber\nend_header\n0 0 0 0 0\n1 0 0 0 0\n1 1 0 0 1\n3 0 1 2 6 0 0 1 0 1 1 0\n";
    let camera = "extrinsic\n1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n\nintrinsic\n70 0 32\n0 71 24\n0 0 1\n\n0.5 0.1 192 20\n";
    let volume = r#"{"class_name":"SelectionPolygonVolume","version_major":1,"version_minor":0,"orthogonal_axis":"Y","axis_min":-1.5,"axis_max":4,"bounding_polygon":[[0,0,0],[1,0,0],[1,0,1]]}"#;
    let pose = "0 0 0\n1 0 0 5\n0 1 0 0\n0 0 1 0\n0 0 0 1\n";
    let nerf = r#"{"w":64,"h":48,"fl_x":70,"cx":32,"cy":24,"k1":0.1,"frames":[{"file_path":"a.jpg","transform_matrix":[[1,0,0,5],[0,1,0,0],[0,0,1,0],[0,0,0,1]]}]}"#;
    let images = "1 1 0 0 0 0 0 0 1 a.jpg\n1.5 2.5 3\n2 1 0 0 0 0 0 0 1 b.jpg\n\n";
    let mut points = 1u64.to_le_bytes().to_vec();
    points.extend([&[7; 35][..], &[0; 8], &1u64.to_le_bytes(), &[0; 8]].concat());
    let options = ply::PlyOptions::default();
    let ascii = ply::PlyOptions {
        ascii: true,
        ..ply::PlyOptions::default()
    };
    let made = |write: &dyn Fn(&mut Vec<u8>) -> std::io::Result<()>| {
        let mut bytes = Vec::new();
        write(&mut bytes).unwrap();
        bytes
    };
    vec![
        (
            "binary cloud",
            made(&|out| ply::write_cloud(out, &cloud, &[], &options)),
            |b| ply::read_cloud(b).map(drop),
        ),
        (
            "text cloud",
            made(&|out| ply::write_cloud(out, &cloud, &[], &ascii)),
            |b| ply::read_cloud(b).map(drop),
        ),
        ("mesh", mesh.into(), |b| ply::read_mesh(b).map(drop)),
        ("obj", b"mtllib m.mtl\nv 0 0 0\nv 1 0 0 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 1\nusemtl a\nf 1/1 2/1 3/1 4/1\nf -1 -2 -3\n".to_vec(), |b| {
            obj::read_obj(b).map(drop)
        }),
        ("dense map", dense_array(1), |b| {
            dense::read_size(b)?;
            dense::read_gray(b).map(drop)
        }),
        ("dense normals", dense_array(3), |b| {
            dense::read_normals(b).map(drop)
        }),
        ("gltf", triangle_gltf().into(), read_gltf),
        ("glb", glb(&triangle_gltf()), read_gltf),
        ("summary", mesh.into(), |b| ply::read_summary(b).map(drop)),
        ("pfm", made(&|out| pfm::write_gray(out, &floats)), |b| {
            pfm::read(b).map(drop)
        }),
        ("png", made(&|out| image::write_png(out, &picture)), |b| {
            image::read_color(b).map(drop)
        }),
        (
            "jpeg",
            made(&|out| image::write_jpeg(out, &picture, image::JpegOptions::default())),
            |b| image::read_gray(b).map(drop),
        ),
        ("cam", camera.into(), |b| cam::read(text(b)?).map(drop)),
        ("pair", "2\n0\n1 1 2.5\n1\n1 0 2.5\n".into(), |b| {
            pair::read(text(b)?).map(drop)
        }),
        ("log", pose.repeat(2).into(), |b| {
            log::read(text(b)?).map(drop)
        }),
        ("mapping", "2\n90\n0 1\n1 30\n".into(), |b| {
            log::read_mapping(text(b)?).map(drop)
        }),
        (
            "transform",
            made(&|out| transform::write(out, &DMat4::IDENTITY)),
            |b| transform::read(text(b)?).map(drop),
        ),
        ("crop", volume.into(), |b| crop::read(text(b)?).map(drop)),
        ("transforms", nerf.into(), |b| {
            transforms::read(text(b)?).map(drop)
        }),
        (
            "colmap cameras",
            "1 PINHOLE 640 480 500 510 320 240\n".into(),
            |b| colmap::read_cameras_text(text(b)?).map(drop),
        ),
        ("colmap images", images.into(), |b| {
            colmap::read_images_text(text(b)?).map(drop)
        }),
        ("colmap points", points, |b| {
            colmap::read_points_binary(b).map(drop)
        }),
        (
            "colmap frames",
            "7 1 1 0 0 0 7 0 0 2 CAMERA 2 6 IMU 1 1\n".into(),
            |b| colmap::read_frames_text(text(b)?).map(drop),
        ),
    ]
}

/// The sample with a few things done to it that disks, editors and enemies do.
fn mutated(sample: &[u8], rng: &mut ChaCha8Rng) -> Vec<u8> {
    let mut bytes = sample.to_vec();
    for _ in 0..=rng.next_u32() % 3 {
        let below = |rng: &mut ChaCha8Rng, bound: usize| rng.next_u32() as usize % bound.max(1);
        let at = below(rng, bytes.len());
        match rng.next_u32() % 7 {
            0 => bytes.truncate(at),
            1 if !bytes.is_empty() => bytes[at] ^= 1 << (rng.next_u32() % 8),
            2 if !bytes.is_empty() => bytes[at] = rng.next_u32() as u8,
            3 => drop(bytes.splice(at..at, *b"4000000000")),
            4 => drop(bytes.splice(at..at, *b" -1 nan ")),
            5 => drop(bytes.drain(at..(at + 9).min(bytes.len()))),
            _ => {
                let piece: Vec<u8> = bytes[at..(at + 40).min(bytes.len())].to_vec();
                let to = below(rng, bytes.len());
                bytes.splice(to..to, piece);
            }
        }
    }
    bytes
}

#[test]
#[ignore = "run by no_mutant_makes_a_reader_panic_or_take_much_memory, under a limit"]
fn child_that_reads_mutants() {
    for (name, sample, read) in samples() {
        read(&sample).unwrap_or_else(|error| panic!("{name}: {error}"));
        let mut refused = 0;
        let mut rng = ChaCha8Rng::seed_from_u64(7);
        for _ in 0..4000 {
            if let Err(error) = read(&mutated(&sample, &mut rng)) {
                assert!(is_one_sentence(&error), "{name}: {error}");
                refused += 1;
            }
        }
        assert!(
            refused > 400,
            "{name}: {refused} mutants refused: too tame to show anything"
        );
    }
}

#[test]
#[ignore = "run by the_memory_limit_would_be_noticed, under a limit"]
fn child_that_takes_much_memory() {
    let much = Vec::<u8>::with_capacity(1 << 30);
    assert_eq!(std::hint::black_box(much).len(), 0);
}

/// Runs one ignored test of this binary with at most 512 MiB of address space.
#[cfg(target_os = "linux")]
fn passes_within_limit(child: &str) -> bool {
    let command = "ulimit -v 524288 && exec \"$0\" --exact --ignored --test-threads=1 \"$1\"";
    let output = std::process::Command::new("sh")
        .args(["-c", command])
        .arg(std::env::current_exe().unwrap())
        .arg(format!("formats::{child}"))
        .env("RUST_BACKTRACE", "0")
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&output.stdout);
    if !output.status.success() {
        eprintln!("{said}{}", String::from_utf8_lossy(&output.stderr));
    }
    output.status.success() && said.contains("1 passed")
}

#[cfg(target_os = "linux")]
#[test]
fn no_mutant_makes_a_reader_panic_or_take_much_memory() {
    assert!(passes_within_limit("child_that_reads_mutants"));
}

#[cfg(target_os = "linux")]
#[test]
fn the_memory_limit_would_be_noticed() {
    assert!(!passes_within_limit("child_that_takes_much_memory"));
}
