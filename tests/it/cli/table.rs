//! What tables say.

use super::*;

#[test]
fn points_in_a_crop_are_counted_where_one_is_given() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let (cloud, crop) = (path("cloud.ply"), path("crop.json"));
    write(&cloud, points_as_ply(&["0 0 0", "1 0 0", "9 0 0"]));
    let prism = r#"{"class_name": "SelectionPolygonVolume", "orthogonal_axis": "Z", "axis_min": -1,
        "axis_max": 1, "bounding_polygon": [[-1, -1, 0], [2, -1, 0], [2, 1, 0], [-1, 1, 0]]}"#;
    write(&crop, prism);
    let table = |more: &[&str], out: &str| {
        let (cloud, out) = (text(&cloud), path(out));
        let clouds = ["score", "--truth", cloud, "--reconstruction", cloud];
        let rest = ["--tau", "0.1", "--format", "table", "--out", text(&out)];
        let output = mvs_eval(&[&clouds[..], &rest, more].concat());
        assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
        String::from_utf8(output.stdout).unwrap()
    };
    let plain = table(&[], "plain");
    assert!(plain.contains("3 read, 3 judged"), "{plain}");
    let cropped = table(&["--crop", text(&crop)], "cropped");
    assert!(
        cropped.contains("3 read, 2 in the crop, 2 judged"),
        "{cropped}"
    );
}
