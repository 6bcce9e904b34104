use super::*;
use glam::DVec3;

const CAMERAS: &str = "# Camera list\n5 OPENCV 640 480 500 510 321 239 -0.1 0.02 0.001 -0.002\n";
const IMAGES: &str = "# Image list\n9 0.607167523915 0.793498944799 0.041144394775 0.00376314819639 0.0966 -1.712 1.0857 5 sub/ab.jpg\n403.5 105.25 3 1.5 2.5 -1\n";
const POINTS: &str = "3 -0.18 0.288 -1.577 128 127 126 0.5 9 0\n";

// What pycolmap 4.2.1 writes for the text above.
const CAMERAS_BIN: &str = "010000000000000005000000040000008002000000000000e0010000000000000000000000407f400000000000e07f4000000000001074400000000000e06d409a9999999999b9bf7b14ae47e17a943ffca9f1d24d62503ffca9f1d24d6260bf";
const IMAGES_BIN: &str = "01000000000000000900000029104d96ea6de33f944f2ae65764e93f53d6f1cbe010a53feb33dfcde4d36e3f5f29cb10c7bab83f3108ac1c5a64fbbf744694f6065ff13f050000007375622f61622e6a706700020000000000000000000000003879400000000000505a400300000000000000000000000000f83f0000000000000440ffffffffffffffff";
const POINTS_BIN: &str = "010000000000000003000000000000000ad7a3703d0ac7bf3bdf4f8d976ed23f08ac1c5a643bf9bf807f7e000000000000e03f01000000000000000900000000000000";

// A model of three frames, each of two cameras, as pycolmap 4.2.1 writes it.
const FRAMES: &str = "# Frame list\n2 1 1 0 0 0 2 0 0 2 CAMERA 1 8 CAMERA 2 9\n5 1 1 0 0 0 5 0 0 2 CAMERA 1 4 CAMERA 2 3\n7 1 1 0 0 0 7 0 0 2 CAMERA 1 1 CAMERA 2 6\n";
const FRAMES_BIN: &str = "03000000000000000200000001000000000000000000f03f0000000000000000000000000000000000000000000000000000000000000040000000000000000000000000000000000200000000000000010000000800000000000000000000000200000009000000000000000500000001000000000000000000f03f0000000000000000000000000000000000000000000000000000000000001440000000000000000000000000000000000200000000000000010000000400000000000000000000000200000003000000000000000700000001000000000000000000f03f0000000000000000000000000000000000000000000000000000000000001c4000000000000000000000000000000000020000000000000001000000010000000000000000000000020000000600000000000000";

fn bytes(hex: &str) -> Vec<u8> {
    let byte = |at: usize| u8::from_str_radix(&hex[at..at + 2], 16).unwrap();
    (0..hex.len()).step_by(2).map(byte).collect()
}

#[test]
fn text_and_colmap_s_own_binary_say_the_same() {
    let cameras = read_cameras_text(CAMERAS).unwrap();
    assert_eq!(
        (cameras[0].id, cameras[0].model, cameras[0].params[7]),
        (5, "OPENCV", -0.002)
    );
    assert_eq!(read_cameras_binary(&bytes(CAMERAS_BIN)).unwrap(), cameras);
    let images = read_images_text(IMAGES).unwrap();
    assert_eq!(
        (images[0].id, images[0].camera, &images[0].points[..]),
        (9, 5, &[3][..])
    );
    assert_eq!(
        (images[0].name.as_str(), images[0].translation.y),
        ("sub/ab.jpg", -1.712)
    );
    let binary = read_images_binary(&bytes(IMAGES_BIN)).unwrap();
    let quaternions = images[0].rotation.iter().zip(binary[0].rotation);
    assert!(
        quaternions.into_iter().all(|(a, b)| (a - b).abs() < 1e-12),
        "COLMAP normalises"
    );
    let rounded = ColmapImage {
        rotation: images[0].rotation,
        ..binary[0].clone()
    };
    assert_eq!(rounded, images[0]);
    let points = read_points_text(POINTS).unwrap();
    assert_eq!((points[0].id, points[0].color), (3, [128, 127, 126]));
    assert_eq!(read_points_binary(&bytes(POINTS_BIN)).unwrap(), points);
}

#[test]
fn frames_order_images_by_sensor_within_one_as_pycolmap_s_reg_image_ids() {
    assert_eq!(read_frames_text(FRAMES).unwrap(), [8, 9, 4, 3, 1, 6]);
    assert_eq!(
        read_frames_binary(&bytes(FRAMES_BIN)).unwrap(),
        [8, 9, 4, 3, 1, 6]
    );
    // pycolmap 4.2.1 reads this as 1, 6, 8, 9, 4, 3.
    let turned = "7 1 1 0 0 0 7 0 0 2 CAMERA 2 6 CAMERA 1 1\n2 1 1 0 0 0 2 0 0 2 CAMERA 1 8 CAMERA 2 9\n\
                  5 1 1 0 0 0 5 0 0 2 CAMERA 2 3 CAMERA 1 4\n";
    assert_eq!(read_frames_text(turned).unwrap(), [1, 6, 8, 9, 4, 3]);
    let said = |error: crate::error::FormatError, part: &str| {
        assert!(error.to_string().contains(part), "{error}");
    };
    let cut = &bytes(FRAMES_BIN)[..200];
    said(read_frames_binary(cut).unwrap_err(), "cut short");
    let short = "7 1 1 0 0 0 7 0 0 2 CAMERA 2 6 CAMERA 1";
    said(read_frames_text(short).unwrap_err(), "an image id");
    let negative = "7 1 1 0 0 0 7 0 0 1 CAMERA 2 -6";
    said(read_frames_text(negative).unwrap_err(), "`-6`");
}

#[test]
fn every_lens_projects_as_colmap_does() {
    // pycolmap 4.2.1: Camera.img_from_cam((0.6, -0.8, 2)).
    let known: [(&str, &[f64], [f64; 2]); 11] = [
        ("SIMPLE_PINHOLE", &[500., 320., 240.], [470.0, 40.0]),
        ("PINHOLE", &[500., 510., 321., 239.], [471.0, 35.0]),
        ("SIMPLE_RADIAL", &[500., 320., 240., -0.1], [466.25, 45.0]),
        ("RADIAL", &[500., 320., 240., -0.1, 0.02], [466.4375, 44.75]),
        (
            "OPENCV",
            &[500., 510., 321., 239., -0.1, 0.02, 0.001, -0.002],
            [466.88750000000005, 40.380499999999984],
        ),
        (
            "OPENCV_FISHEYE",
            &[500., 510., 321., 239., -0.1, 0.02, -0.003, 0.0004],
            [457.2287145495185, 53.728948212654814],
        ),
        (
            "FULL_OPENCV",
            &[
                500., 510., 321., 239., -0.1, 0.02, 0.001, -0.002, 0.03, 0.04, 0.05, 0.06,
            ],
            [464.9261171032357, 43.04798073959938],
        ),
        (
            "SIMPLE_RADIAL_FISHEYE",
            &[500., 320., 240., -0.1],
            [456.1041853493528, 58.527752867529586],
        ),
        (
            "RADIAL_FISHEYE",
            &[500., 320., 240., -0.1, 0.02],
            [456.23274105982813, 58.356345253562466],
        ),
        (
            "SIMPLE_FISHEYE",
            &[500., 320., 240.],
            [459.0942827002418, 54.540956399677555],
        ),
        (
            "FISHEYE",
            &[500., 510., 321., 239.],
            [460.0942827002418, 49.83177552767111],
        ),
    ];
    let point = DVec3::new(0.6, -0.8, 2.0);
    for (model, params, [x, y]) in known {
        let camera = ColmapCamera {
            id: 1,
            model,
            width: 640,
            height: 480,
            params: params.to_vec(),
        };
        let camera = camera.to_camera().unwrap();
        let pixel = camera.project(point).unwrap();
        assert!(
            (pixel - glam::DVec2::new(x, y)).length() < 1e-10,
            "{model}: {pixel}"
        );
        assert!(
            (camera.ray(pixel) * 2.0 - point).length() < 1e-12,
            "{model}"
        );
    }
}

#[test]
fn lenses_of_another_kind_are_named() {
    let text = "1 DIVISION 640 480 500 500 320 240 0.9\n";
    let error = read_cameras_text(text).unwrap()[0]
        .to_camera()
        .unwrap_err()
        .to_string();
    assert!(
        error.contains("found DIVISION with 5 parameters: undistort"),
        "{error}"
    );
    let mut image = read_images_text(IMAGES).unwrap().remove(0);
    assert!(image.to_pose().is_ok());
    image.rotation = [0.0; 4];
    assert!(
        image
            .to_pose()
            .unwrap_err()
            .to_string()
            .contains("expected a rotation")
    );
}

#[test]
fn images_without_features_keep_their_pairs_of_lines() {
    let text = "# comment\n1 1 0 0 0 0 0 0 1 a.jpg\n\n2 1 0 0 0 0 0 1 1 b c.jpg\n1 2 3";
    let images = read_images_text(text).unwrap();
    assert_eq!((images[0].points.len(), images[1].points[0]), (0, 3));
    assert_eq!(images[1].name, "b c.jpg");
    let blanks = "1 1 0 0 0 0 0 0 1 a  b\tc.jpg \n\n";
    assert_eq!(read_images_text(blanks).unwrap()[0].name, "a  b\tc.jpg");
}

#[test]
fn broken_text_is_said_with_its_line() {
    for (text, expected) in [
        (
            "1 OPENCV 640 480 500",
            "line 1: expected 8 parameters of the model OPENCV, found the line's end",
        ),
        (
            "1 PINHOLE 640 480 1 2 3 4 5",
            "line 1: expected only 4 parameters of the model PINHOLE, found `5` too",
        ),
        (
            "#\n1 LENS 640 480 1",
            "line 2: expected a camera model that COLMAP has, found `LENS`",
        ),
        ("1 PINHOLE 640 480 1 2 nan 4", "found `nan`"),
        (
            "1 PINHOLE -640 480 1 2 3 4",
            "expected an image width, found `-640`",
        ),
    ] {
        let error = read_cameras_text(text).unwrap_err().to_string();
        assert!(error.contains(expected), "{error}");
    }
    for (text, expected) in [
        (
            "1 1 0 0 0 0 0 0 1\n\n",
            "line 1: expected an image name, found the line's end",
        ),
        ("1 1 0 0 x", "expected a quaternion QW QX QY QZ, found `x`"),
        (
            "1 1 0 0 0 0 0 0 1 a.jpg\n1 2",
            "line 2: expected POINT3D_ID of a feature",
        ),
        (
            "1 1 0 0 0 0 0 0 1 a.jpg\n\n2 1 0 0 0 0 0 0 1 b.jpg",
            "line 4: expected a second line with what image 2 (b.jpg) saw",
        ),
        (
            "# Image list\n# Number of images: 2, mean observations per image: 1\n\
             1 1 0 0 0 0 0 0 1 a.jpg\n1 2 3\n",
            "images: expected 2 images, as its head says, found 1",
        ),
    ] {
        let error = read_images_text(text).unwrap_err().to_string();
        assert!(error.contains(expected), "{error}");
    }
    assert!(read_points_text("1 2 3 4 256 0 0").is_err());
    let points = |stated: usize| {
        let head = format!("# 3D point list\n# Number of points: {stated}, mean track length: 2\n");
        read_points_text(&format!("{head}1 2 3 4 25 0 0\n7 2 3 4 25 0 0\n"))
    };
    assert_eq!(points(2).unwrap().len(), 2);
    let error = points(3).unwrap_err().to_string();
    assert!(
        error.contains("expected 3 points, as its head says, found 2"),
        "{error}"
    );
}

#[test]
fn every_cut_of_a_binary_file_is_an_error() {
    for (hex, read) in [
        (
            CAMERAS_BIN,
            (|b| read_cameras_binary(b).map(drop)) as fn(&[u8]) -> Result<(), crate::FormatError>,
        ),
        (IMAGES_BIN, |b| read_images_binary(b).map(drop)),
        (POINTS_BIN, |b| read_points_binary(b).map(drop)),
    ] {
        let whole = bytes(hex);
        for length in 0..whole.len() {
            let error = read(&whole[..length]).unwrap_err().to_string();
            assert!(
                error.contains("byte ") && error.contains("found"),
                "{error}"
            );
        }
        let mut more = whole.clone();
        more.push(0);
        assert!(
            read(&more)
                .unwrap_err()
                .to_string()
                .contains("found 1 more bytes")
        );
        let mut many = whole;
        many[..8].copy_from_slice(&u64::MAX.to_le_bytes());
        assert!(
            read(&many)
                .unwrap_err()
                .to_string()
                .contains("as the count says")
        );
    }
}
