//! Files are written here as JSON and bytes.

use super::*;
use glam::DVec3;

/// A square of two triangles, positions then texture coordinates then indices in one buffer.
fn buffer() -> Vec<u8> {
    let corners = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0f32]];
    let mut bytes = Vec::new();
    for [x, y] in corners {
        bytes.extend([x, y, 0.0].into_iter().flat_map(f32::to_le_bytes));
    }
    for [u, v] in corners {
        bytes.extend([u, v].into_iter().flat_map(f32::to_le_bytes));
    }
    bytes.extend([0u16, 1, 2, 0, 2, 3].into_iter().flat_map(u16::to_le_bytes));
    bytes
}

const SQUARE: &str = r#"{"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}],
    "nodes": [{"mesh": 0}],
    "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "TEXCOORD_0": 1}, "indices": 2,
        "material": 0}]}],
    "materials": [{"pbrMetallicRoughness": {"baseColorFactor": [1, 0.5, 0, 1]}}],
    "accessors": [
        {"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3"},
        {"bufferView": 1, "componentType": 5126, "count": 4, "type": "VEC2"},
        {"bufferView": 2, "componentType": 5123, "count": 6, "type": "SCALAR"}],
    "bufferViews": [{"buffer": 0, "byteLength": 48}, {"buffer": 0, "byteOffset": 48, "byteLength": 32},
        {"buffer": 0, "byteOffset": 80, "byteLength": 12}],
    "buffers": [{"byteLength": 92}]}"#;

fn glb(json: &str, binary: &[u8]) -> Vec<u8> {
    let mut bytes = b"glTF\x02\0\0\0\0\0\0\0".to_vec();
    for (kind, content, fill) in [(b"JSON", json.as_bytes(), b' '), (b"BIN\0", binary, 0)] {
        let padded = content.len().next_multiple_of(4);
        bytes.extend(u32::try_from(padded).unwrap().to_le_bytes());
        bytes.extend(kind);
        bytes.extend(content);
        bytes.resize(bytes.len() + padded - content.len(), fill);
    }
    bytes
}

fn read(json: &str) -> Result<GltfFile, FormatError> {
    read_gltf(&glb(json, &buffer()), &|_| Err("no files here".into()))
}

#[test]
fn a_square_is_two_triangles_with_an_srgb_color() {
    let file = read(SQUARE).unwrap();
    assert_eq!(file.vertices[2], DVec3::new(1.0, 1.0, 0.0));
    assert_eq!(file.triangles, [[0, 1, 2], [0, 2, 3]]);
    // Half the light is sRGB 188.
    assert_eq!(file.materials[0].color, [255, 188, 0]);
    assert!(file.notes.is_empty() && file.vertex_colors.is_none());
}

#[test]
fn nodes_place_what_they_hold_in_f64_and_mirrors_turn_triangles() {
    let nodes = r#""nodes": [{"children": [1], "translation": [451000.125, 5100000.0625, 0]},
        {"mesh": 0, "scale": [-1, 2, 1], "rotation": [0, 0, 0.7071067811865476, 0.7071067811865476]}],"#;
    let file = read(&SQUARE.replace(r#""nodes": [{"mesh": 0}],"#, nodes)).unwrap();
    // (1, 0) is mirrored to (-1, 0), then turned by 90° to (0, -1).
    let expected = DVec3::new(451_000.125, 5_099_999.062_5, 0.0);
    assert!(
        (file.vertices[1] - expected).length() < 1e-9,
        "{}",
        file.vertices[1]
    );
    assert_eq!(file.triangles[0], [0, 2, 1]);
    let [a, b, c] = file.triangles[0].map(|vertex| file.vertices[vertex as usize]);
    assert!((b - a).cross(c - a).z > 0.0, "the front stays in front");
}

/// As gltfpack writes them: whole numbers that a node scales, or fractions of the largest.
#[test]
fn quantized_positions_are_read() {
    let mut bytes = Vec::new();
    for corner in [[0i16, 0, 0], [32767, 0, 0], [-32768, 100, 0], [0, 300, 0]] {
        bytes.extend(corner.into_iter().flat_map(i16::to_le_bytes));
        bytes.extend([0; 2]);
    }
    for corner in [[0i8, 0], [127, 0], [-128, 64], [0, 127]] {
        bytes.extend(corner.map(i8::cast_unsigned));
        bytes.extend([0; 2]);
    }
    bytes.extend(&buffer()[80..]);
    let of = |normalized: bool| {
        let json = SQUARE
            .replace(r#""asset""#, r#""extensionsRequired": ["KHR_mesh_quantization"], "asset""#)
            .replace(
                r#"{"bufferView": 0, "componentType": 5126,"#,
                &format!(r#"{{"bufferView": 0, "componentType": 5122, "normalized": {normalized},"#),
            )
            .replace(
                r#"{"bufferView": 1, "componentType": 5126,"#,
                r#"{"bufferView": 1, "componentType": 5120, "normalized": true,"#,
            )
            .replace(r#""byteLength": 48}, {"buffer": 0, "byteOffset": 48, "byteLength": 32}"#,
                r#""byteLength": 32, "byteStride": 8}, {"buffer": 0, "byteOffset": 32, "byteLength": 16, "byteStride": 4}"#)
            .replace(r#""byteOffset": 80"#, r#""byteOffset": 48"#)
            .replace(r#""byteLength": 92"#, r#""byteLength": 60"#);
        read_gltf(&glb(&json, &bytes), &|_| Err("no files here".into())).unwrap()
    };
    let file = of(false);
    assert_eq!(file.vertices[2], DVec3::new(-32768.0, 100.0, 0.0));
    assert_eq!(file.triangles, [[0, 1, 2], [0, 2, 3]]);
    assert_eq!(of(true).vertices[1], DVec3::X);
    assert_eq!(of(true).vertices[2], DVec3::new(-1.0, 100.0 / 32767.0, 0.0));
}

#[test]
fn textures_lie_with_v_down_and_their_transform() {
    let textured = SQUARE.replace(
        r#""baseColorFactor": [1, 0.5, 0, 1]"#,
        r#""baseColorTexture": {"index": 0, "extensions": {"KHR_texture_transform":
            {"offset": [0.25, 0.5], "scale": [0.5, 0.5], "rotation": 1.5707963267948966}}}"#,
    );
    let textured = textured.replace(
        r#""buffers""#,
        r#""textures": [{"source": 0}], "images": [{"uri": "a%20b.png"}], "buffers""#,
    );
    let file = read(&textured).unwrap();
    assert_eq!(file.images[&0], GltfImage::File("a b.png".into()));
    // (1, 0) scaled to (0.5, 0), turned counter-clockwise as seen with v down to (0, -0.5).
    let coord = file.texture_coords[0][1];
    assert!((coord - Vec2::new(0.25, 1.0)).length() < 1e-6, "{coord}");
    let inline = textured.replace("a%20b.png", "data:image/png;base64,aGFsbG8=");
    assert_eq!(
        read(&inline).unwrap().images[&0],
        GltfImage::Bytes(b"hallo".to_vec())
    );
}

#[test]
fn strips_and_fans_are_cut_into_triangles_of_one_side() {
    assert_eq!(
        triangles(&[0, 1, 2, 3], Some(5), false),
        [[0, 1, 2], [2, 1, 3]]
    );
    assert_eq!(
        triangles(&[0, 1, 2, 3], Some(6), false),
        [[0, 1, 2], [0, 2, 3]]
    );
    assert_eq!(triangles(&[0, 1, 2, 3], None, true), [[0, 2, 1]]);
}

#[test]
fn what_cannot_be_read_gets_one_sentence() {
    let swap = |from: &str, to: &str| {
        assert!(SQUARE.contains(from), "{from}");
        let error = read(&SQUARE.replacen(from, to, 1)).unwrap_err().to_string();
        assert!(!error.contains('\n'), "{error}");
        error
    };
    for (from, to, expected) in [
        (
            r#"{"asset""#,
            r#"{"extensionsRequired": ["KHR_draco_mesh_compression"], "asset""#,
            "Draco",
        ),
        (
            r#""2.0""#,
            r#""1.0""#,
            "expected glTF 2.0, found version 1.0",
        ),
        (
            r#""type": "VEC3""#,
            r#""type": "VEC3", "sparse": {}"#,
            "sparse",
        ),
        (
            r#""count": 4, "type": "VEC3""#,
            r#""count": 5, "type": "VEC3""#,
            "found 48 bytes",
        ),
        (
            r#""count": 4, "type": "VEC2""#,
            r#""count": 3, "type": "VEC2""#,
            "",
        ),
        (
            r#""byteLength": 48"#,
            r#""byteLength": 480"#,
            "expected 480 bytes",
        ),
        (
            r#""nodes": [{"mesh": 0}]"#,
            r#""nodes": [{"mesh": 0, "children": [0]}]"#,
            "two places",
        ),
        (r#""mesh": 0}"#, r#""mesh": 7}"#, "expected mesh 7"),
        (
            r#""indices": 2"#,
            r#""indices": 0"#,
            "expected vertex indices (unsigned scalars), found \"VEC3\"",
        ),
        (
            r#""count": 4, "type": "VEC3""#,
            r#""count": 3, "type": "VEC3""#,
            "expected vertex indices below 3",
        ),
        (
            r#""bufferView": 0"#,
            r#""normalized": false"#,
            "expected a buffer view, found none",
        ),
        (r#""POSITION": 0, "#, "", "expected POSITION"),
        (r#""indices": 2"#, r#""mode": 0"#, "expected triangles"),
        (
            r#"{"byteLength": 92}"#,
            r#"{"uri": "gone.bin"}"#,
            "no files here",
        ),
        (r#""asset""#, r#""asset"#, "expected a glTF"),
    ] {
        if expected.is_empty() {
            continue; // Texture coordinates that no texture needs are not read.
        }
        let error = swap(from, to);
        assert!(error.contains(expected), "{error}");
    }
    let whole = glb(SQUARE, &buffer());
    let none = |_: &str| Err(String::new());
    for length in [0, 3, 7, 19, 300, whole.len() - 1] {
        assert!(read_gltf(&whole[..length], &none).is_err(), "{length}");
    }
    // What comes after the stated length is no chunk.
    let mut stated = whole.clone();
    stated[8..12].copy_from_slice(&(whole.len() as u32).to_le_bytes());
    stated.extend([0; 5]);
    assert_eq!(read_gltf(&stated, &none).unwrap().triangles.len(), 2);
}

#[test]
fn what_is_passed_over_is_said() {
    let notes = |from: &str, to: &str| {
        assert!(SQUARE.contains(from), "{from}");
        let file = read(&SQUARE.replacen(from, to, 1)).unwrap();
        (file.triangles.len(), file.notes)
    };
    let (triangles, said) = notes(r#""count": 6"#, r#""count": 5"#);
    assert!(
        triangles == 1 && said[0].contains("no multiple of three"),
        "{said:?}"
    );
    let (triangles, said) = notes(r#""scene": 0"#, r#""scene": 1"#);
    assert!(
        triangles == 2 && said[0].contains("all its nodes are shown"),
        "{said:?}"
    );
    let material = r#""materials": [{"#;
    let shining = |factor: &str| {
        let more = format!(r#"{material}"name": "lamp", "emissiveFactor": {factor}, "#);
        notes(material, &more).1
    };
    let said = shining("[0, 0.5, 0]");
    assert!(
        said.len() == 1 && said[0].contains("emissiveTexture") && said[0].contains("\"lamp\""),
        "{said:?}"
    );
    assert!(shining("[0, 0, 0]").is_empty());
    let unnamed = format!(r#"{material}"emissiveFactor": [1, 1, 1], "#);
    let (_, said) = notes(material, &unnamed);
    assert!(
        said[0].ends_with("the first is material 0, without a name"),
        "{said:?}"
    );
}

/// A skinned mesh moves with its joints, whatever the transform of its node; bent by them it lies where its vertices do.
#[test]
fn skinned_meshes_stand_where_their_joints_are() {
    let read_with = |nodes: &str, skin: &str| {
        let nodes = format!(r#""nodes": [{nodes}], "skins": [{skin}]"#);
        let square = SQUARE.replacen(r#""nodes": [{"mesh": 0}]"#, &nodes, 1);
        let bind = r#"{"bufferView": 3, "componentType": 5126, "count": 2, "type": "MAT4"}, {"bufferView": 0"#;
        let square = square
            .replacen(r#"[{"nodes": [0]}]"#, r#"[{"nodes": [0, 1]}]"#, 1)
            .replacen(r#"{"bufferView": 0"#, bind, 1)
            .replacen(r#""POSITION": 0, "TEXCOORD_0": 1}, "indices": 2"#, r#""POSITION": 1, "TEXCOORD_0": 2}, "indices": 3"#, 1)
            .replacen(r#""byteOffset": 80, "byteLength": 12}"#, r#""byteOffset": 80, "byteLength": 12}, {"buffer": 0, "byteOffset": 92, "byteLength": 128}"#, 1)
            .replacen(r#""byteLength": 92"#, r#""byteLength": 220"#, 1);
        let mut bytes = buffer();
        for scale in [8.0, 4.0] {
            let bind = glam::Mat4::from_scale(glam::Vec3::splat(scale));
            bytes.extend(bind.to_cols_array().into_iter().flat_map(f32::to_le_bytes));
        }
        read_gltf(&glb(&square, &bytes), &|_| Err("no files here".into()))
    };
    let node = r#"{"mesh": 0, "skin": 0, "scale": [0.1, 0.1, -0.1]}"#;
    let corner = |nodes: &str, skin: &str| {
        let file = read_with(nodes, skin).unwrap();
        (file.vertices[2], file.triangles[0], file.notes.len())
    };
    let with =
        |root: &str, joint: &str| format!("{node}, {{{root}, \"children\": [2]}}, {{{joint}}}");
    let turned = r#""scale": [0.25, 0.25, 0.25], "translation": [5, 0, 0]"#;
    let both = r#"{"joints": [1, 2], "inverseBindMatrices": 0}"#;
    // Twice as large, and moved: 0.25 · 8 = 0.25 · 2 · 4.
    let alike = with(turned, r#""scale": [2, 2, 2]"#);
    assert_eq!(
        corner(&alike, both),
        (DVec3::new(7.0, 2.0, 0.0), [0, 1, 2], 0)
    );
    let plain = (DVec3::new(1.0, 1.0, 0.0), [0, 1, 2], 1);
    let bent = with(turned, r#""scale": [2, 2, 2], "translation": [0, 1, 0]"#);
    assert_eq!(corner(&bent, both), plain);
    assert_eq!(corner(&alike, r#"{"joints": [9]}"#), plain, "no such joint");
    assert_eq!(corner(&alike, ""), plain, "no such skin");
    let one = r#"{"joints": [1]}"#;
    assert_eq!(corner(&alike, one).0, DVec3::new(5.25, 0.25, 0.0));
    let many = r#"{"joints": [1, 2, 1], "inverseBindMatrices": 0}"#;
    let error = read_with(&alike, many).unwrap_err().to_string();
    assert!(error.contains("of 3 joints, found 2"), "{error}");
}

/// Ten vertices and corners each.
#[test]
fn instances_are_bounded_unless_the_file_itself_is_as_large() {
    let three = SQUARE.replace(
        r#"[{"mesh": 0}]"#,
        r#"[{"mesh": 0}, {"mesh": 0}, {"mesh": 0}]"#,
    );
    let three = three.replace(r#""nodes": [0]}"#, r#""nodes": [0, 1, 2]}"#);
    assert_eq!(read(&three).unwrap().triangles.len(), 6);
    let check = |json: &str, most: usize| {
        let root: Root = serde_json::from_str(json).unwrap();
        check_instances(&root, &placed_nodes(&root).unwrap(), most)
    };
    assert!(check(&three, 30).is_ok() && check(SQUARE, 1).is_ok());
    let error = check(&three, 29).unwrap_err().to_string();
    assert!(
        error.contains("at most 29") && error.contains("found 30 where the file has 10"),
        "{error}"
    );
    // Primitives that share what they are made of are instances too.
    let primitive = SQUARE.find("\"primitives\": [").unwrap() + "\"primitives\": [".len();
    let end = primitive + SQUARE[primitive..].find("}]").unwrap() + 1;
    let shared = format!("{}, {}", &SQUARE[primitive..end], &SQUARE[primitive..end]);
    let shared = format!("{}{shared}{}", &SQUARE[..primitive], &SQUARE[end..]);
    assert_eq!(read(&shared).unwrap().triangles.len(), 4);
    assert!(check(&shared, 20).is_ok() && check(&shared, 19).is_err());
}
