use super::*;

const REAL: &str = r#"{"camera_model": "OPENCV", "fl_x": 500.0, "fl_y": 510, "cx": 321.5,
    "cy": 239.5, "w": 640, "h": 480.0, "k1": -0.1, "p2": 0.001, "aabb_scale": 16,
    "frames": [
    {"file_path": "./images/a.jpg", "transform_matrix": [[1, 0, 0, 5], [0, 1, 0, 6], [0, 0, 1, 7], [0, 0, 0, 1]]},
    {"file_path": "images/b.jpg", "fl_x": 600.0, "w": 320, "h": 240, "transform_matrix": [[1, 0, 0, 5], [0, 1, 0, 6], [0, 0, 1, 7]]}]}"#;

#[test]
fn a_frame_s_own_values_win() {
    let (frames, notes) = read(REAL).unwrap();
    assert!(notes.is_empty());
    assert_eq!(
        (frames[0].size, frames[0].focal),
        (Some((640, 480)), Some([500.0, 510.0]))
    );
    assert_eq!(
        (frames[1].size, frames[1].focal),
        (Some((320, 240)), Some([600.0, 510.0]))
    );
    assert_eq!(
        frames[0].world_from_gl_cam.w_axis.to_array(),
        [5.0, 6.0, 7.0, 1.0]
    );
    assert_eq!(frames[0].world_from_gl_cam, frames[1].world_from_gl_cam);
    let lens = Distortion::RadialTangential {
        radial: [-0.1, 0.0, 0.0, 0.0, 0.0, 0.0],
        tangential: [0.0, 0.001],
    };
    assert_eq!(
        (frames[0].distortion, frames[0].center),
        (lens, Some([321.5, 239.5]))
    );
    let fisheye = read(&REAL.replace("\"OPENCV\"", "\"OPENCV_FISHEYE\"")).unwrap();
    let radial = [-0.1, 0.0, 0.0, 0.0];
    assert_eq!(fisheye.0[0].distortion, Distortion::Fisheye { radial });
}

/// As instant-ngp writes it, which names no camera model.
#[test]
fn is_fisheye_is_a_fisheye_where_no_camera_model_is_named() {
    let ngp = |shared: &str, own: &str| {
        let json = REAL.replacen("\"camera_model\": \"OPENCV\"", shared, 1);
        let json = json.replacen("\"fl_x\": 600.0", own, 1);
        read(&json).map(|(frames, _)| [frames[0].distortion, frames[1].distortion])
    };
    let radial = [-0.1, 0.0, 0.0, 0.0];
    let fisheye = Distortion::Fisheye { radial };
    let plain = ngp("\"is_fisheye\": false", "\"fl_x\": 600.0").unwrap();
    assert!(
        plain
            .iter()
            .all(|lens| matches!(lens, Distortion::RadialTangential { .. }))
    );
    assert_eq!(
        ngp("\"is_fisheye\": true", "\"fl_x\": 600.0").unwrap(),
        [fisheye; 2]
    );
    // A frame's own word wins.
    let own = ngp("\"is_fisheye\": true", "\"camera_model\": \"OPENCV\"").unwrap();
    assert_eq!(own, [fisheye, plain[1]]);
    let both = "\"is_fisheye\": true, \"camera_model\": \"PINHOLE\"";
    let error = ngp(both, "\"p1\": 0.0").unwrap_err().to_string();
    assert!(error.contains("found true and `PINHOLE`"), "{error}");
}

/// As nerfstudio reads it: before single coefficients, of a frame before the file's.
#[test]
fn distortion_params_are_k1_to_k4_p1_p2() {
    let lenses = |shared: &str, own: &str| {
        let json = REAL.replacen("\"aabb_scale\": 16", shared, 1);
        let json = json.replacen("\"fl_x\": 600.0", own, 1);
        read(&json).map(|(frames, _)| [frames[0].distortion, frames[1].distortion])
    };
    let list = "\"distortion_params\": [0.1, 0.02, 0.003, 0, 0.001, 0.002]";
    let of_list = Distortion::RadialTangential {
        radial: [0.1, 0.02, 0.003, 0.0, 0.0, 0.0],
        tangential: [0.001, 0.002],
    };
    let single = |k1| Distortion::RadialTangential {
        radial: [k1, 0.0, 0.0, 0.0, 0.0, 0.0],
        tangential: [0.0, 0.001],
    };
    assert_eq!(lenses(list, "\"cx\": 160").unwrap(), [of_list; 2]);
    assert_eq!(
        lenses("\"aabb\": 1", list).unwrap(),
        [single(-0.1), of_list]
    );
    // A frame's own coefficients are more to the point than the file's list.
    assert_eq!(lenses(list, "\"k1\": 0.3").unwrap(), [of_list, single(0.3)]);
    let fisheye =
        list.replace(", 0, 0.001, 0.002", ", 0.4, 0, 0") + ", \"camera_model\": \"OPENCV_FISHEYE\"";
    let radial = [0.1, 0.02, 0.003, 0.4];
    let expected = [single(-0.1), Distortion::Fisheye { radial }];
    assert_eq!(lenses("\"aabb\": 1", &fisheye).unwrap(), expected);
    let rational = "\"camera_model\": \"FULL_OPENCV\", \"k4\": 0.5, \"k6\": 0.25";
    let expected = Distortion::RadialTangential {
        radial: [-0.1, 0.0, 0.0, 0.5, 0.0, 0.25],
        tangential: [0.0, 0.001],
    };
    assert_eq!(lenses("\"aabb\": 1", rational).unwrap()[1], expected);
}

#[test]
fn lenses_that_are_not_read_are_refused() {
    for (own, expected) in [
        ("\"distortion_params\": [0.1, 0.2]", "found 2 numbers"),
        (
            "\"distortion_params\": [0, 0, 0, 0.5, 0, 0]",
            "expected no k4, k5 and k6 in a camera that is no fisheye and not FULL_OPENCV, found 0.5",
        ),
        ("\"k5\": 0.1", "not FULL_OPENCV, found 0.1"),
        (
            "\"camera_model\": \"OPENCV_FISHEYE\", \"k6\": 0.1",
            "found 0.1",
        ),
        (
            "\"lens\": \"fisheye\"",
            "found lens \"fisheye\", which is not read",
        ),
        ("\"ftheta_p0\": 0.0", "found ftheta_p0 0.0"),
        ("\"is_latlong\": true", "found is_latlong true"),
        ("\"latlong\": 1", "found latlong 1"),
        ("\"equirectangular\": true", "found equirectangular true"),
    ] {
        let json = REAL
            .replacen("\"fl_x\": 600.0", own, 1)
            .replace(", \"p2\": 0.001", "");
        let error = read(&json).unwrap_err().to_string();
        assert!(
            error.contains("frame 1 (images/b.jpg)") && error.contains(expected),
            "{error}"
        );
    }
    for own in [
        "\"is_latlong\": false",
        "\"lens\": \"PINHOLE\"",
        "\"lens\": null",
        "\"k5\": 0",
        "\"distortion_params\": []",
    ] {
        assert!(
            read(&REAL.replacen("\"fl_x\": 600.0", own, 1)).is_ok(),
            "{own}"
        );
    }
}

#[test]
fn a_focal_length_along_y_alone_is_refused() {
    let own = "\"camera_angle_x\": 0.5, \"fl_y\": 600.0";
    let error = read(&REAL.replacen("\"fl_x\": 600.0", own, 1)).unwrap_err();
    assert!(error.to_string().contains("found fl_y alone"), "{error}");
}

#[test]
fn a_frame_s_own_angle_of_view_wins_over_the_files_focal_length() {
    let own = REAL.replacen("\"fl_x\": 600.0", "\"camera_angle_x\": 0.5", 1);
    let (frames, _) = read(&own).unwrap();
    assert_eq!(
        (frames[0].focal, frames[0].angles),
        (Some([500.0, 510.0]), [None; 2])
    );
    assert_eq!(
        (frames[1].focal, frames[1].angles),
        (None, [Some(0.5), None])
    );
    // A focal length of its own is still more exact than an angle of the file.
    let shared = REAL.replacen("\"aabb_scale\": 16", "\"camera_angle_x\": 0.5", 1);
    assert_eq!(read(&shared).unwrap().0[1].focal, Some([600.0, 510.0]));
}

#[test]
fn what_was_applied_to_the_poses_is_named() {
    let applied = "\"applied_transform\": [[0, 1, 0, 0], [1, 0, 0, 0], [0, 0, -1, 0]]";
    let (_, notes) = read(&REAL.replacen("\"aabb_scale\": 16", applied, 1)).unwrap();
    assert!(
        notes[0].contains("the file's applied_transform is left in place"),
        "{notes:?}"
    );
}

#[test]
fn broken_files_get_one_sentence() {
    for (from, to, expected) in [
        ("\"frames\"", "\"views\"", "missing field `frames`"),
        (
            "\"OPENCV\"",
            "\"EQUIRECTANGULAR\"",
            "frame 0 (./images/a.jpg): expected the camera model OPENCV",
        ),
        ("\"p2\": 0.001", "\"k4\": 0.5", "expected no k4"),
        (
            "[[1, 0, 0, 5], [0, 1, 0, 6], [0, 0, 1, 7]]}",
            "[[1, 0, 0, 5]]}",
            "frame 1 (images/b.jpg): expected 3 or 4 rows in transform_matrix, found 1",
        ),
        (
            "\"cx\": 321.5,",
            "",
            "frame 0 (./images/a.jpg): expected cx and cy, or neither, found only cy",
        ),
        (
            "\"w\": 320, ",
            "\"w\": 320.5, ",
            "expected w and h in whole pixels, found 320.5 and 240",
        ),
        (
            "\"w\": 640, \"h\": 480.0,",
            "\"w\": 640,",
            "expected w and h, or neither, found only w",
        ),
        (
            "\"w\": 640",
            "\"w\": -1",
            "expected w and h in whole pixels, found -1 and 480",
        ),
    ] {
        let error = read(&REAL.replacen(from, to, 1)).unwrap_err().to_string();
        assert!(error.contains(expected) && !error.contains('\n'), "{error}");
    }
    assert!(read("").is_err() && read(&REAL[..REAL.len() / 2]).is_err());
    let none = read(r#"{"frames": []}"#).unwrap_err().to_string();
    assert!(none.contains("expected at least one frame"), "{none}");
}
