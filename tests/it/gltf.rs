//! glTF as people export it: embedded and external images, factors, vertex colours, masks, nodes.
//! The files are written here, byte by byte.

use crate::support::{mvs_eval, stderr, text};
use glam::{DVec2, DVec3};
use mvs_datasets::format::image;
use mvs_datasets::layout::files::write_atomically;
use mvs_datasets::layout::mesh::{LoadedMesh, ReadOptions, read_meshes, read_meshes_with};
use mvs_datasets::scene::{Camera, ColorImage, Pose, Raster, View};
use mvs_eval::render::{RenderOptions, Renderer, Rendering};
use serde_json::{Value, json};
use std::io::Write;
use std::path::Path;

/// A glTF that grows: its JSON, and the bytes of its one buffer.
struct Builder {
    json: Value,
    bytes: Vec<u8>,
}

impl Builder {
    fn new() -> Self {
        let json = json!({
            "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": []}], "nodes": [],
            "meshes": [], "materials": [], "accessors": [], "bufferViews": [], "textures": [],
            "images": [], "buffers": [{}],
        });
        let bytes = Vec::new();
        Self { json, bytes }
    }

    /// Adds to a list and returns the number.
    fn add(&mut self, list: &str, item: Value) -> usize {
        let list = self.json[list].as_array_mut().unwrap();
        list.push(item);
        list.len() - 1
    }

    fn view(&mut self, bytes: &[u8]) -> usize {
        self.bytes.resize(self.bytes.len().next_multiple_of(4), 0);
        let offset = self.bytes.len();
        self.bytes.extend(bytes);
        let view = json!({"buffer": 0, "byteOffset": offset, "byteLength": bytes.len()});
        self.add("bufferViews", view)
    }

    fn accessor(&mut self, bytes: &[u8], kind: (u32, &str), count: usize) -> usize {
        let view = self.view(bytes);
        let (component, shape) = kind;
        let normalized = component != 5126 && shape.starts_with("VEC");
        self.add(
            "accessors",
            json!({"bufferView": view, "componentType": component, "type": shape, "count": count,
                "normalized": normalized}),
        )
    }

    fn floats(&mut self, values: &[f32], shape: &str, count: usize) -> usize {
        let bytes: Vec<u8> = values.iter().flat_map(|v| v.to_le_bytes()).collect();
        self.accessor(&bytes, (5126, shape), count)
    }

    /// A square in the plane z = 0 around the origin with edge 1, facing −z, whose texture stands
    /// upright to a camera that looks along +z with y down; in a node at `at`.
    fn square(&mut self, at: [f64; 3], material: usize, color: Option<[u8; 4]>) {
        self.square_of(at, material, color.map(|color| [color; 4]));
    }

    /// The same with a colour of each corner: top left, top right, bottom right, bottom left.
    fn square_of(&mut self, at: [f64; 3], material: usize, colors: Option<[[u8; 4]; 4]>) {
        let (h, u) = (0.5f32, 1.0f32);
        let corners = [-h, -h, 0.0, h, -h, 0.0, h, h, 0.0, -h, h, 0.0];
        let positions = self.floats(&corners, "VEC3", 4);
        let coords = self.floats(&[0.0, 0.0, u, 0.0, u, u, 0.0, u], "VEC2", 4);
        let indices = self.accessor(&[0, 3, 2, 0, 2, 1], (5121, "SCALAR"), 6);
        let mut attributes = json!({"POSITION": positions, "TEXCOORD_0": coords});
        if let Some(colors) = colors {
            let colors = self.accessor(colors.as_flattened(), (5121, "VEC4"), 4);
            attributes["COLOR_0"] = json!(colors);
        }
        let primitive = json!({"attributes": attributes, "indices": indices, "material": material});
        let mesh = self.add("meshes", json!({"primitives": [primitive]}));
        let node = self.add("nodes", json!({"mesh": mesh, "translation": at}));
        self.json["scenes"][0]["nodes"]
            .as_array_mut()
            .unwrap()
            .push(json!(node));
    }

    /// A material; its texture is an image inside the file or one beside it.
    fn material(&mut self, factor: [f64; 4], texture: Option<Value>, more: Value) -> usize {
        let mut surface = json!({"baseColorFactor": factor});
        if let Some(image) = texture {
            let image = self.add("images", image);
            let texture = self.add("textures", json!({"source": image}));
            surface["baseColorTexture"] = json!({"index": texture});
        }
        let mut material = json!({"pbrMetallicRoughness": surface});
        for (key, value) in more.as_object().unwrap() {
            material[key] = value.clone();
        }
        self.add("materials", material)
    }

    fn embedded(&mut self, image: &[u8]) -> Value {
        let view = self.view(image);
        json!({"bufferView": view, "mimeType": "image/png"})
    }

    fn put_glb(mut self, path: &Path) {
        self.json["buffers"][0] = json!({"byteLength": self.bytes.len()});
        let mut file = b"glTF\x02\0\0\0\0\0\0\0".to_vec();
        let text = self.json.to_string();
        for (kind, content, fill) in [(b"JSON", text.as_bytes(), b' '), (b"BIN\0", &self.bytes, 0)]
        {
            let padded = content.len().next_multiple_of(4);
            file.extend(u32::try_from(padded).unwrap().to_le_bytes());
            file.extend(kind);
            file.extend(content);
            file.resize(file.len() + padded - content.len(), fill);
        }
        put(path, &file);
    }

    fn put_gltf(mut self, path: &Path, buffer: &str) {
        self.json["buffers"][0] = json!({"byteLength": self.bytes.len(), "uri": buffer});
        let name = buffer.replace("%20", " ");
        put(&path.with_file_name(name), &self.bytes);
        put(path, self.json.to_string().as_bytes());
    }
}

fn put(path: &Path, bytes: &[u8]) {
    write_atomically(path, |out| out.write_all(bytes)).unwrap();
}

fn png(image: &ColorImage) -> Vec<u8> {
    let mut bytes = Vec::new();
    image::write_png(&mut bytes, image).unwrap();
    bytes
}

/// Left half and right half.
fn halves(left: [u8; 3], right: [u8; 3]) -> ColorImage {
    let values = (0..64u32).map(|i| if i % 8 < 4 { left } else { right });
    Raster::from_values(8, 8, values.collect()).unwrap()
}

fn read(path: &Path) -> LoadedMesh {
    read_meshes(&[path.to_path_buf()]).unwrap()
}

/// The square around (x, 0) at depth 2 covers columns 20 + 10 x ± 5.
fn look(loaded: &LoadedMesh) -> Rendering {
    let view = View {
        id: 0,
        name: String::new(),
        camera: Camera::new(40, 12, DVec2::splat(20.0), DVec2::new(20.0, 6.0)).unwrap(),
        pose: Pose::IDENTITY,
        depth_range: None,
    };
    let options = RenderOptions {
        samples: 1,
        ..RenderOptions::default()
    };
    Renderer::new(&loaded.mesh)
        .unwrap()
        .render(&view, &options)
        .unwrap()
}

const WHITE: [f64; 4] = [1.0; 4];

#[test]
fn every_square_shows_its_own_material_from_inside_and_beside_the_file() {
    let folder = tempfile::tempdir().unwrap();
    put(
        &folder.path().join("a tex.png"),
        &png(&halves([10, 200, 30], [1, 2, 3])),
    );
    for name in ["m.glb", "m.gltf"] {
        let mut builder = Builder::new();
        let inside = builder.embedded(&png(&halves([255, 0, 0], [0, 0, 255])));
        let inside = builder.material(WHITE, Some(inside), json!({}));
        let beside = json!({"uri": "a%20tex.png"});
        let beside = builder.material(WHITE, Some(beside), json!({}));
        // Half the light is sRGB 188.
        let plain = builder.material([1.0, 0.5, 0.0, 1.0], None, json!({}));
        let colored = builder.material([0.5, 1.0, 1.0, 1.0], None, json!({}));
        for (x, material) in [(-1.5, inside), (-0.5, beside), (0.5, plain)] {
            builder.square([x, 0.0, 2.0], material, None);
        }
        builder.square([1.5, 0.0, 2.0], colored, Some([255, 255, 0, 255]));
        let path = folder.path().join(name);
        match name {
            "m.glb" => builder.put_glb(&path),
            _ => builder.put_gltf(&path, "my%20buffer.bin"),
        }
        let loaded = read(&path);
        assert_eq!(loaded.notes, [] as [&str; 0]);
        let rendering = look(&loaded);
        let colors = [2, 7, 12, 17, 25, 35].map(|column| rendering.color.get(column, 6));
        let expected = [
            [255, 0, 0],
            [0, 0, 255],
            [10, 200, 30],
            [1, 2, 3],
            [255, 188, 0],
            [188, 255, 0],
        ];
        assert_eq!(colors, expected, "{name}");
        assert_eq!(rendering.depth.get(20, 6), 2.0);
    }
}

#[test]
fn factors_and_vertex_colours_multiply_textures_in_linear_light() {
    let folder = tempfile::tempdir().unwrap();
    let mut builder = Builder::new();
    let white = png(&halves([255; 3], [255; 3]));
    let (first, second) = (builder.embedded(&white), builder.embedded(&white));
    let scaled = builder.material([0.5, 1.0, 0.0, 1.0], Some(first), json!({}));
    let tinted = builder.material(WHITE, Some(second), json!({}));
    builder.square([-1.5, 0.0, 2.0], scaled, None);
    builder.square([-0.5, 0.0, 2.0], tinted, Some([128, 255, 0, 255]));
    let path = folder.path().join("m.glb");
    builder.put_glb(&path);
    let rendering = look(&read(&path));
    assert_eq!(rendering.color.get(5, 6), [188, 255, 0]);
    // COLOR_0 is linear: 128 / 255 of the light is sRGB 188.
    assert_eq!(rendering.color.get(15, 6), [188, 255, 0]);
}

#[test]
fn a_factor_counts_beside_vertex_colours_where_its_texture_is_missing_or_broken() {
    let folder = tempfile::tempdir().unwrap();
    let mut builder = Builder::new();
    let images = [json!({"uri": "gone.png"}), builder.embedded(b"no image")];
    for (image, x) in images.into_iter().zip([-1.5, -0.5]) {
        let material = builder.material([0.5, 1.0, 0.0, 1.0], Some(image), json!({}));
        builder.square([x, 0.0, 2.0], material, Some([255, 128, 255, 255]));
    }
    let path = folder.path().join("m.glb");
    builder.put_glb(&path);
    let loaded = read_meshes(std::slice::from_ref(&path)).unwrap();
    assert_eq!(loaded.notes.len(), 2, "{:?}", loaded.notes);
    let rendering = look(&loaded);
    for x in [5, 15] {
        assert_eq!(rendering.color.get(x, 6), [188, 188, 0], "at {x}");
    }
}

#[test]
fn vertex_colours_without_a_texture_are_mixed_in_linear_light_too() {
    let folder = tempfile::tempdir().unwrap();
    let mut builder = Builder::new();
    // The light of sRGB 128, so that the corners' colours are exact.
    let green = ((128.0 / 255.0 + 0.055) / 1.055f64).powf(2.4);
    let plain = builder.material([1.0, green, 1.0, 1.0], None, json!({}));
    let (black, white) = ([0, 0, 0, 255], [255; 4]);
    let ramp = [black, white, white, black];
    builder.square_of([0.0, 0.0, 2.0], plain, Some(ramp));
    let path = folder.path().join("m.glb");
    builder.put_glb(&path);
    let rendering = look(&read(&path));
    let srgb = |light: f64| (255.0 * (1.055 * light.powf(1.0 / 2.4) - 0.055)).round() as u8;
    for column in 0..10 {
        let light = (f64::from(column) + 0.5) / 10.0;
        let expected = [light, green * light, light].map(srgb);
        let found = rendering.color.get(15 + column, 6);
        assert_eq!(found, expected, "at {light}");
    }
}

#[test]
fn masks_cut_and_both_sides_are_seen_only_where_the_file_says_so() {
    let folder = tempfile::tempdir().unwrap();
    let rgba: Vec<u8> = (0..8u8)
        .flat_map(|c| [9, 9, 9, if c < 4 { 0 } else { 255 }])
        .collect();
    let picture = rgba_png(&rgba, 8, 1);
    let mut builder = Builder::new();
    let mut material = |more| {
        let image = builder.embedded(&picture);
        builder.material(WHITE, Some(image), more)
    };
    let masked = material(json!({"alphaMode": "MASK"}));
    let opaque = material(json!({}));
    let blended = material(json!({"alphaMode": "BLEND"}));
    let two_sided = material(json!({"doubleSided": true}));
    for (x, material) in [
        (-1.5, masked),
        (-0.5, opaque),
        (0.5, blended),
        (1.5, two_sided),
    ] {
        builder.square([x, 0.0, 2.0], material, None);
    }
    // The last two are turned around.
    for node in [2, 3] {
        builder.json["nodes"][node]["rotation"] = json!([0.0, 1.0, 0.0, 0.0]);
    }
    let path = folder.path().join("m.glb");
    builder.put_glb(&path);
    let loaded = read(&path);
    assert!(
        loaded.notes.iter().any(|note| note.contains("BLEND")),
        "{:?}",
        loaded.notes
    );
    let rendering = look(&loaded);
    let seen = [2, 7, 12, 25, 35].map(|column| rendering.depth.get(column, 6) > 0.0);
    assert_eq!(seen, [false, true, true, false, true]);
}

#[test]
fn opacity_of_vertices_that_a_mask_would_heed_is_told_of() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("m.glb");
    let notes = |mode: &str, opacity: u8| {
        let mut builder = Builder::new();
        let material = builder.material(WHITE, None, json!({"alphaMode": mode}));
        builder.square([0.0, 0.0, 2.0], material, Some([9, 9, 9, opacity]));
        builder.put_glb(&path);
        read(&path).notes
    };
    let masked = notes("MASK", 254);
    assert_eq!(masked.len(), 1, "{masked:?}");
    assert!(masked[0].contains("opacity of vertices"), "{masked:?}");
    assert_eq!(notes("MASK", 255), [] as [&str; 0]);
    assert_eq!(notes("OPAQUE", 0), [] as [&str; 0]);
}

/// A PNG with alpha, stored without compression.
fn rgba_png(rgba: &[u8], width: u32, height: u32) -> Vec<u8> {
    let mut raw = Vec::new();
    for row in rgba.chunks(width as usize * 4) {
        raw.push(0);
        raw.extend(row);
    }
    let length = u16::try_from(raw.len()).unwrap();
    let mut stream = vec![0x78, 0x01, 0x01];
    stream.extend(length.to_le_bytes());
    stream.extend((!length).to_le_bytes());
    stream.extend(&raw);
    let (mut a, mut b) = (1u32, 0u32);
    for &byte in &raw {
        a = (a + u32::from(byte)) % 65521;
        b = (b + a) % 65521;
    }
    stream.extend((b << 16 | a).to_be_bytes());
    let mut header = [width.to_be_bytes(), height.to_be_bytes()].concat();
    header.extend([8, 6, 0, 0, 0]);
    let mut file = b"\x89PNG\r\n\x1a\n".to_vec();
    for (kind, content) in [
        (b"IHDR", &header),
        (b"IDAT", &stream),
        (b"IEND", &Vec::new()),
    ] {
        file.extend(u32::try_from(content.len()).unwrap().to_be_bytes());
        let chunk = [&kind[..], content].concat();
        file.extend(&chunk);
        let crc = !chunk.iter().fold(!0u32, |crc, &byte| {
            (0..8).fold(crc ^ u32::from(byte), |crc, _| {
                (crc >> 1) ^ (0xedb8_8320 & (0u32.wrapping_sub(crc & 1)))
            })
        });
        file.extend(crc.to_be_bytes());
    }
    file
}

#[test]
fn a_place_far_away_keeps_its_digits() {
    let folder = tempfile::tempdir().unwrap();
    let mut builder = Builder::new();
    let plain = builder.material(WHITE, None, json!({}));
    builder.square([451_000.125, 5_100_000.062_5, 12.5], plain, None);
    let path = folder.path().join("m.glb");
    builder.put_glb(&path);
    let bounds = read(&path).mesh.bounds();
    let center = DVec3::new(451_000.125, 5_100_000.062_5, 12.5);
    assert!((bounds.center() - center).length() < 1e-9, "{bounds:?}");
}

#[test]
fn what_is_missing_or_not_supported_gets_one_sentence() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("m.gltf");
    let square = |change: &dyn Fn(&mut Builder)| {
        let mut builder = Builder::new();
        let gone = builder.material(WHITE, Some(json!({"uri": "gone.png"})), json!({}));
        builder.square([0.0, 0.0, 2.0], gone, None);
        change(&mut builder);
        builder.put_gltf(&path, "b.bin");
    };
    square(&|_| {});
    let notes = read(&path).notes;
    assert!(
        notes.len() == 1 && notes[0].contains("gone.png"),
        "{notes:?}"
    );
    let complaint = || {
        read_meshes(std::slice::from_ref(&path))
            .unwrap_err()
            .to_string()
    };
    square(&|b| b.json["extensionsRequired"] = json!(["KHR_draco_mesh_compression"]));
    assert!(
        complaint().contains("KHR_draco_mesh_compression"),
        "{}",
        complaint()
    );
    square(&|b| b.json["accessors"][0]["sparse"] = json!({"count": 1}));
    assert!(complaint().contains("sparse accessor"), "{}", complaint());
    square(&|_| {});
    std::fs::remove_file(folder.path().join("b.bin")).unwrap();
    assert!(complaint().contains("b.bin"), "{}", complaint());
    put(&path, b"{}");
    assert!(complaint().contains("asset"), "{}", complaint());
}

#[test]
fn textures_beyond_the_bound_are_refused_before_they_are_decoded() {
    let folder = tempfile::tempdir().unwrap();
    let mut builder = Builder::new();
    let large = ColorImage::filled(1024, 1024, [7; 3]).unwrap();
    for x in [-0.5, 0.5] {
        let image = builder.embedded(&png(&large));
        let material = builder.material(WHITE, Some(image), json!({}));
        builder.square([x, 0.0, 2.0], material, None);
    }
    let path = folder.path().join("m.glb");
    builder.put_glb(&path);
    let read = |mebibytes: u64, threads| {
        let options = ReadOptions {
            texture_bytes: mebibytes << 20,
            threads,
        };
        read_meshes_with(std::slice::from_ref(&path), &options)
    };
    let error = read(5, 1).unwrap_err().to_string();
    for part in ["at most 5 MiB", "2 textures of 6 MiB", "--texture-memory"] {
        assert!(error.contains(part), "{error}");
    }
    let (one, many) = (read(6, 1).unwrap(), read(6, 3).unwrap());
    assert_eq!(one.mesh, many.mesh);
    let output = mvs_eval(&["inspect", text(&path), "--format", "table"]);
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(
        said.contains("4 of 4 triangles show a texture"),
        "{said}{}",
        stderr(&output)
    );
}

/// A triangle of which a texture coordinate is no number has its material's factor, the one beside it its texture.
#[test]
fn texture_coordinates_that_are_no_numbers_show_no_texture() {
    let folder = tempfile::tempdir().unwrap();
    let mut builder = Builder::new();
    let image = builder.embedded(&png(&halves([9, 8, 7], [9, 8, 7])));
    let material = builder.material([1.0, 0.0, 0.0, 1.0], Some(image), json!({}));
    builder.square([0.0, 0.0, 2.0], material, None);
    let coords = [0.0f32, 0.0, 1.0, 0.0, 1.0, 1.0, 0.0, 1.0].map(f32::to_le_bytes);
    let coords = coords.as_flattened();
    let mut windows = builder.bytes.windows(coords.len());
    let start = windows.position(|window| window == coords).unwrap();
    // The second corner's, of the upper right triangle.
    builder.bytes[start + 8..][..4].copy_from_slice(&f32::NAN.to_le_bytes());
    let path = folder.path().join("m.glb");
    builder.put_glb(&path);
    let loaded = read(&path);
    let said = &loaded.notes[0];
    assert!(
        said.contains("1 triangles have texture coordinates that are no finite"),
        "{said}"
    );
    let rendering = look(&loaded);
    let [upper, lower] = [(23, 3), (17, 8)].map(|(column, row)| rendering.color.get(column, row));
    assert_eq!((upper, lower), ([255, 0, 0], [9, 0, 0]));
}
