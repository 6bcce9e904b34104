//! Whole files: what is written reads back, in every form; what is broken is said.

use super::*;
use glam::{DVec3, Vec2, Vec3};
use proptest::prelude::*;

fn bytes_of(write: impl FnOnce(&mut Vec<u8>) -> std::io::Result<()>) -> Vec<u8> {
    let mut bytes = Vec::new();
    write(&mut bytes).unwrap();
    bytes
}

fn position() -> impl Strategy<Value = DVec3> {
    // Values that a float holds too.
    proptest::array::uniform3(proptest::num::f32::NORMAL | proptest::num::f32::ZERO)
        .prop_map(|v| DVec3::from_array(v.map(f64::from)))
}

prop_compose! {
    fn any_cloud()(
        positions in proptest::collection::vec(position(), 0..20),
        columns in proptest::array::uniform4(any::<bool>()),
        seed in any::<u8>(),
    ) -> PointCloud {
        let count = positions.len();
        let byte = |index: usize| seed.wrapping_mul(31).wrapping_add(index as u8);
        let mut cloud = PointCloud::new(positions);
        if columns[0] {
            let normals = (0..count).map(|index| Vec3::new(0.1, -0.5, f32::from(byte(index))));
            cloud = cloud.with_normals(normals.collect()).unwrap();
        }
        if columns[1] {
            let colors = (0..count).map(|index| [byte(index), seed, 255]);
            cloud = cloud.with_colors(colors.collect()).unwrap();
        }
        if columns[2] {
            let counts = (0..count).map(|index| u32::from(byte(index)) << 20);
            cloud = cloud.with_view_counts(counts.collect()).unwrap();
        }
        if columns[3] {
            let confidences = (0..count).map(|index| f32::from(byte(index)) / 7.0);
            cloud = cloud.with_confidences(confidences.collect()).unwrap();
        }
        cloud
    }
}

proptest! {
    #[test]
    fn every_cloud_reads_back(cloud in any_cloud(), double: bool, ascii: bool) {
        let options = PlyOptions { double, ascii, comments: vec!["by\na test".into()] };
        let bytes = bytes_of(|out| write_cloud(out, &cloud, &[], &options));
        prop_assert_eq!(read_cloud(&bytes).unwrap(), cloud);
    }

    #[test]
    fn every_prefix_of_a_file_is_an_error_or_a_cloud(cloud in any_cloud(), ascii: bool, cut in any::<prop::sample::Index>()) {
        let options = PlyOptions { ascii, ..PlyOptions::default() };
        let bytes = bytes_of(|out| write_cloud(out, &cloud, &[], &options));
        let cut = cut.index(bytes.len());
        if let Ok(read) = read_cloud(&bytes[..cut]) {
            prop_assert_eq!(read.len(), cloud.len());
            // Without points all that is missing is the header's last line break.
            prop_assert!(ascii || cloud.is_empty());
        }
    }
}

fn textured() -> Mesh {
    let vertices = vec![
        DVec3::ZERO,
        DVec3::X,
        DVec3::ONE,
        DVec3::new(0.1, 1e6 + 0.1, 0.0),
    ];
    let corner = |shift: f32| [Vec2::ZERO, Vec2::new(shift, 0.25), Vec2::new(1.0, shift)];
    Mesh::new(vertices, vec![[0, 1, 2], [0, 2, 3]])
        .unwrap()
        .with_texture_coords(vec![corner(0.5), corner(0.75)])
        .unwrap()
        .with_vertex_colors(vec![[1, 2, 3], [4, 5, 6], [7, 8, 9], [250, 251, 252]])
        .unwrap()
}

#[test]
fn meshes_read_back_with_their_textures() {
    let material = |name: &str| Material {
        name: name.into(),
        ..Material::default()
    };
    let mesh = textured()
        .with_materials(
            vec![material("a b.jpg"), material("c.png")],
            Some(vec![1, 0]),
        )
        .unwrap();
    for ascii in [false, true] {
        let options = PlyOptions {
            double: true,
            ascii,
            comments: vec!["TextureFile a b.jpg".into(), "TextureFile c.png".into()],
        };
        let bytes = bytes_of(|out| write_mesh(out, &mesh, &options));
        let read = read_mesh(&bytes).unwrap();
        assert_eq!(read.texture_files, ["a b.jpg", "c.png"]);
        assert_eq!(read.mesh, mesh);
        assert_eq!(
            read_summary(&bytes).unwrap(),
            PlySummary {
                vertices: 4,
                faces: 2
            }
        );
    }
}

#[test]
fn scalars_follow_the_columns_and_are_checked() {
    let cloud = PointCloud::new(vec![DVec3::ONE, DVec3::ZERO]);
    let ascii = PlyOptions {
        ascii: true,
        ..PlyOptions::default()
    };
    let column = |name, values| [ScalarColumn { name, values }];
    let bytes =
        bytes_of(|out| write_cloud(out, &cloud, &column("error", &[0.5, f32::NAN]), &ascii));
    let text = String::from_utf8(bytes).unwrap();
    assert!(
        text.contains("property float z\nproperty float error\nend_header\n1 1 1 0.5\n0 0 0 NaN\n"),
        "{text}"
    );
    for (name, values, expected) in [
        ("error", &[0.5][..], "has 1 values for 2 points"),
        ("an error", &[0.5, 0.5], "letters, digits and underscores"),
        ("", &[0.5, 0.5], "letters, digits and underscores"),
        ("x", &[0.5, 0.5], "is there twice"),
    ] {
        let refused = write_cloud(&mut Vec::new(), &cloud, &column(name, values), &ascii);
        assert!(refused.unwrap_err().to_string().contains(expected));
    }
}

fn ascii(header: &str, body: &str) -> Vec<u8> {
    format!("ply\nformat ascii 1.0\n{header}\nend_header\n{body}").into_bytes()
}

const XYZ: &str = "property float x\nproperty float y\nproperty float z";

#[test]
fn special_numbers_become_positions() {
    let bytes = ascii(
        &format!("element vertex 3\n{XYZ}"),
        "nan 1 .5\n-Inf 2 inf\n0.1 4000000.125 3",
    );
    let positions = read_cloud(&bytes).unwrap().into_positions();
    assert!(positions[0].x.is_nan() && positions[0].y == 1.0 && positions[0].z == 0.5);
    assert_eq!(
        positions[1],
        DVec3::new(f64::NEG_INFINITY, 2.0, f64::INFINITY)
    );
    assert_eq!(positions[2], DVec3::new(0.1, 4_000_000.125, 3.0));
}

#[test]
fn positions_alone_are_those_of_the_cloud_whatever_its_colors() {
    let header =
        format!("element vertex 2\n{XYZ}\nproperty int red\nproperty int green\nproperty int blue");
    let bytes = ascii(&header, "1 2 3 0 0 0\n4 5 6 300 0 0\n");
    let error = read_cloud(&bytes).unwrap_err().to_string();
    assert!(error.contains("found 300"), "{error}");
    let positions = [DVec3::new(1.0, 2.0, 3.0), DVec3::new(4.0, 5.0, 6.0)];
    assert_eq!(read_positions(&bytes).unwrap(), positions);
    let more = [&bytes[..], b"7 8 9 0 0 0\n"].concat();
    assert!(read_positions(&more).is_err());
}

#[test]
fn other_elements_and_lists_are_passed_over() {
    let header = format!(
        "element camera 1\nproperty list uchar float k\nproperty int id\nelement vertex 2\nproperty list uchar int who\nproperty uchar flag\n{XYZ}\nproperty double quality"
    );
    let bytes = ascii(&header, "2 9 9 7\n1 5 1 1 2 3 0.5\n0 1 4 5 6 0.5\n");
    let cloud = read_cloud(&bytes).unwrap();
    assert_eq!(
        cloud.positions(),
        [DVec3::new(1.0, 2.0, 3.0), DVec3::new(4.0, 5.0, 6.0)]
    );
}

#[test]
fn colors_are_bytes_or_fractions() {
    let read = |kind: &str, row: &str| {
        let rgb = ["red", "green", "blue"]
            .map(|name| format!("property {kind} {name}"))
            .join("\n");
        read_cloud(&ascii(
            &format!("element vertex 1\n{XYZ}\n{rgb}"),
            &format!("0 0 0 {row}"),
        ))
    };
    for (kind, row, color) in [
        ("uchar", "1 2 255", [1, 2, 255]),
        ("float", "0 0.5 1", [0, 128, 255]),
        ("char", "-1 -128 127", [255, 128, 127]),
        // Of other types the largest value says what white is.
        ("float", "0 0.5 200", [0, 1, 200]),
        ("ushort", "0 65535 257", [0, 255, 1]),
        ("ushort", "0 255 3", [0, 255, 3]),
    ] {
        assert_eq!(
            read(kind, row).unwrap().colors(),
            Some(&[color][..]),
            "{kind} {row}"
        );
    }
    for (kind, row, expected) in [
        ("float", "0 0.5 256", "0 to 255, found 256"),
        ("float", "0 0.5 -1000", "0 to 1, found -1000"),
        ("float", "0 0.5 1.02", "0 to 1, found 1.02"),
        ("float", "-0.4 0 200", "0 to 255, found -0.4"),
        ("uint", "0 65536 2", "0 to 65535, found 65536"),
        ("int", "0 300 2", "0 to 255, found 300"),
    ] {
        let error = read(kind, row).unwrap_err().to_string();
        let expected = format!("vertex 0: expected color values from {expected}");
        assert!(error.contains(&expected), "{error}");
    }
    let unknown = read("float", "1 nan 0").unwrap();
    assert_eq!(unknown.colors(), Some(&[[255, 0, 0]][..]));
}

/// What comes after the last element would be nobody's points.
#[test]
fn a_file_that_goes_on_is_refused() {
    let header = format!("element vertex 2\n{XYZ}");
    let text = |rows: &str| read_cloud(&ascii(&header, rows));
    assert_eq!(text("0 0 0\n7 1 0\n\n").unwrap().len(), 2);
    let error = text("0 0 0\n7 1 0\n8 0 0\n").unwrap_err().to_string();
    assert!(error.contains("line 10: expected the end"), "{error}");
    assert!(error.contains("found 6 more bytes"), "{error}");
    let cloud = PointCloud::new(vec![DVec3::ONE; 2]);
    let mut bytes = bytes_of(|out| write_cloud(out, &cloud, &[], &PlyOptions::default()));
    bytes.extend([b'\n', 0, 0x1a]);
    assert_eq!(read_cloud(&bytes).unwrap().len(), 2, "padded");
    bytes.extend([1; 12]);
    let error = read_cloud(&bytes).unwrap_err().to_string();
    assert!(error.contains("found 15 more bytes"), "{error}");
    let triangle =
        format!("element vertex 3\n{XYZ}\nelement face 1\nproperty list uchar int vertex_index");
    let mesh = ascii(&triangle, "0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n3 0 2 1\n");
    assert!(
        read_mesh(&mesh)
            .unwrap_err()
            .to_string()
            .contains("line 14")
    );
    assert_eq!(
        read_cloud(&mesh).unwrap().len(),
        3,
        "faces are not looked at"
    );
}

/// A fourth number would be taken for nobody's.
#[test]
fn numbers_that_the_header_does_not_name_are_refused() {
    let read = |rows: &str| read_cloud(&ascii(&format!("element vertex 2\n{XYZ}"), rows));
    assert!(read("0 0 0\n7 1 0 ").is_ok());
    for rows in ["0 0 0\n7 1 0 5", "0 0 0\n7 nan 0 5"] {
        let error = read(rows).unwrap_err().to_string();
        let expected = "vertex 1 (line 9): expected 3 numbers as the header says, found 4";
        assert!(error.contains(expected), "{error}");
    }
}

/// An arrow head, whose fan from the first corner would spill out, before the vertices and behind them; with
/// texture coordinates per corner and a number.
#[test]
fn concave_faces_are_filled() {
    let faces = "element face 2\nproperty list uchar int vertex_indices\nproperty list uchar float texcoord\nproperty int texnumber";
    let vertices = format!("element vertex 4\n{XYZ}");
    let face_rows = "4 0 1 2 3 8 0 0 0.25 0 0.5 0 0.75 0 0\n3 0 1 2 6 0 0 0.25 0 0.5 0 1\n";
    let vertex_rows = "1 0 0\n0.5 0.1 0\n0.5 1 0\n0 0 0\n";
    let comments = "comment TextureFile a.png\ncomment TextureFile b.png";
    for (header, rows) in [
        (
            format!("{comments}\n{vertices}\n{faces}"),
            format!("{vertex_rows}{face_rows}"),
        ),
        (
            format!("{comments}\n{faces}\n{vertices}"),
            format!("{face_rows}{vertex_rows}"),
        ),
    ] {
        let mesh = read_mesh(&ascii(&header, &rows)).unwrap().mesh;
        let area: f64 = (0..2)
            .map(|index| {
                let [a, b, c] = mesh.corners(index);
                0.5 * (b - a).cross(c - a).z
            })
            .sum();
        assert!((area - 0.275).abs() < 1e-12, "{area}");
        let coords = mesh.texture_coords().unwrap();
        for (triangle, coords) in mesh.triangles().iter().zip(coords) {
            let expected = triangle.map(|vertex| Vec2::new(0.25 * vertex as f32, 0.0));
            assert_eq!(*coords, expected);
        }
        assert_eq!(mesh.triangles()[2], [0, 1, 2]);
        assert_eq!(mesh.triangle_materials(), Some(&[0, 0, 1][..]));
    }
}

#[test]
fn convex_faces_are_cut_into_fans() {
    let vertices = format!("element vertex 5\n{XYZ}\nproperty float s\nproperty float t");
    let rows = "0 0 0 0 0\n1 0 0 1 0\n1 1 0 1 1\n0 1 0 0 1\n-0.5 0.5 0 0 2\n";
    let header = format!("{vertices}\nelement face 3\nproperty list uchar int vertex_index");
    let mesh = read_mesh(&ascii(
        &header,
        &format!("{rows}5 0 1 2 3 4\n2 0 1\n3 4 3 2\n"),
    ))
    .unwrap()
    .mesh;
    assert_eq!(
        mesh.triangles(),
        [[0, 1, 4], [1, 2, 4], [2, 3, 4], [4, 3, 2]]
    );
    let coords = mesh.texture_coords().unwrap()[3];
    assert_eq!(
        coords,
        [
            Vec2::new(0.0, 2.0),
            Vec2::new(0.0, 1.0),
            Vec2::new(1.0, 1.0)
        ]
    );
    assert_eq!(mesh.triangle_materials(), None);
}

#[test]
fn faces_may_come_before_vertices() {
    let element = "element face 2\nproperty list uchar int vertex_indices\nproperty list uchar float texcoord";
    let header = format!("{element}\nelement vertex 4\n{XYZ}");
    let rows = "3 0 1 2 6 0 0 1 0 1 1\n3 2 1 3 0\n0 0 0\n1 0 0\n1 1 0\n2 1 0\n";
    let mesh = read_mesh(&ascii(&header, rows)).unwrap().mesh;
    assert_eq!(mesh.triangles(), [[0, 1, 2], [2, 1, 3]]);
    assert_eq!(mesh.vertices()[3], DVec3::new(2.0, 1.0, 0.0));
    assert_eq!(mesh.texture_coords().unwrap()[0][1], Vec2::new(1.0, 0.0));
    let beyond = rows.replace("2 1 3", "2 1 4");
    let error = read_mesh(&ascii(&header, &beyond)).unwrap_err().to_string();
    assert!(
        error.contains("face 1: expected vertex indices below 4"),
        "{error}"
    );
}

#[test]
fn broken_meshes_get_one_sentence() {
    let with = |faces: &str, rows: &str| {
        let header = format!("element vertex 3\n{XYZ}\n{faces}");
        let bytes = ascii(&header, &format!("0 0 0\n1 0 0\n1 1 0\n{rows}"));
        read_mesh(&bytes).unwrap_err().to_string()
    };
    let list = "property list uchar int vertex_indices";
    for (faces, rows, expected) in [
        ("", "", "found 3 vertices and no faces: a cloud is no mesh"),
        (
            "element tristrips 1\nproperty list int int vertex_indices",
            "4 0 1 2 -1",
            "no faces but 1 of `tristrips`, which are not read",
        ),
        (
            &format!("element face 0\n{list}")[..],
            "",
            "found 3 vertices and no faces",
        ),
        (
            &format!("element face 1\n{list}"),
            "2 0 1",
            "found 3 vertices and no faces of three corners or more among 1",
        ),
        (
            &format!("element face 1\n{list}"),
            "3 0 1 3",
            "face 0: expected vertex indices below 3, found 3",
        ),
        (
            &format!("element face 1\n{list}"),
            "3 0 1 -1",
            "expected vertex indices below 3, found -1",
        ),
        (
            &format!("element face 1\n{list}"),
            "3 0 1 0.5",
            "expected vertex indices below 3, found 0.5",
        ),
        (
            &format!("element face 1\n{list}"),
            "3 0 1 nan",
            "expected vertex indices below 3, found NaN",
        ),
        (
            &format!("element face 1\n{list}\nproperty list uchar float texcoord"),
            "3 0 1 2 4 0 0 0 0",
            "expected 6 or no texture coordinates, found 4",
        ),
        (
            "element face 1\nproperty int a",
            "3",
            "expected a list property vertex_indices or vertex_index",
        ),
        (
            &format!("element face 2\n{list}"),
            "3 0 1 2\n",
            "face 1: expected 2 of them",
        ),
    ] {
        let error = with(faces, rows);
        assert!(error.contains(expected), "{error}");
    }
    let header = format!("element vertex 3\n{XYZ}\nelement face 1\n{list}");
    let error = read_mesh(&ascii(&header, "0 0 0\n1 nan 0\n1 1 0\n3 0 1 2"))
        .unwrap_err()
        .to_string();
    assert!(error.contains("expected finite vertices"), "{error}");
}

#[test]
fn broken_clouds_get_one_sentence() {
    for (header, body, expected) in [
        (
            "element point 1\nproperty float x",
            "1",
            "header: expected an element `vertex`, found none",
        ),
        (
            "element vertex 1\nproperty float x\nproperty int i",
            "1 2",
            "element vertex: expected properties x, y and z, found x, i",
        ),
        (
            "element vertex 4",
            "",
            "expected properties x, y and z, found none",
        ),
        (
            &format!("element vertex 4000000000\n{XYZ}"),
            "1 2 3\n",
            "element vertex: expected 4000000000 of at least 6 bytes each as the header says, found 6 bytes, enough for 1",
        ),
        (
            &format!("element vertex 2\n{XYZ}"),
            "1 2 3\n4 5\n\n\n",
            "vertex 1 (line 9): expected the values of 3 properties, found 2 numbers",
        ),
    ] {
        let error = read_cloud(&ascii(header, body)).unwrap_err().to_string();
        assert!(error.contains(expected), "{error}");
    }
    let mut bytes =
        format!("ply\nformat binary_little_endian 1.0\nelement vertex 3\n{XYZ}\nend_header\n")
            .into_bytes();
    bytes.extend([0; 30]);
    let error = read_cloud(&bytes).unwrap_err().to_string();
    assert!(
        error.contains(
            "expected 3 of at least 12 bytes each as the header says, found 30 bytes, enough for 2"
        ),
        "{error}"
    );
}

#[test]
fn no_vertices_are_an_empty_cloud() {
    assert!(
        read_cloud(&ascii(&format!("element vertex 0\n{XYZ}"), ""))
            .unwrap()
            .is_empty()
    );
}

/// A triangle whose texture coordinates are no finite numbers has its vertices', and if those are not either no texture.
#[test]
fn texture_coordinates_that_are_no_numbers() {
    let file = |own: &str, of_vertices: [&str; 3]| {
        let vertex = "element vertex 3\nproperty float x\nproperty float y\nproperty float z\nproperty float s\nproperty float t";
        let faces = "element face 2\nproperty list uchar int vertex_indices\nproperty list uchar float texcoord";
        let [a, b, c] = of_vertices;
        let rows =
            format!("0 0 0 {a}\n1 0 0 {b}\n0 1 0 {c}\n3 0 1 2 6 {own}\n3 0 1 2 6 0 0 1 0 1 1\n");
        let head = "ply\nformat ascii 1.0\ncomment TextureFile t.png";
        read_mesh(format!("{head}\n{vertex}\n{faces}\nend_header\n{rows}").as_bytes()).unwrap()
    };
    let finite = ["0.25 0.5", "0.5 0.5", "0.5 0.75"];
    for odd in ["nan 0 1 0 1 1", "0 0 1 inf 1 1", "0 0 1 0 -inf nan"] {
        let found = file(odd, finite);
        let coords = found.mesh.texture_coords().unwrap();
        assert_eq!(coords[0][0], Vec2::new(0.25, 0.5));
        assert_eq!(found.untextured, 0);
        let found = file(odd, ["0.25 0.5", "inf 0", "0.5 0.75"]);
        assert_eq!(found.untextured, 1);
        assert_eq!(found.mesh.triangle_materials(), Some(&[1, 0][..]));
    }
    assert_eq!(file("0 0 1 0 1 1", finite).untextured, 0);
}
