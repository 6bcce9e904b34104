//! What is said of files that are shown otherwise than they ask to be.

use crate::layout::files::write_atomically;
use crate::layout::mesh::read_meshes;
use glam::Vec2;
use image::ImageEncoder;
use std::io::Write;
use std::path::Path;

fn put(folder: &Path, name: &str, text: &str) {
    write_atomically(&folder.join(name), |out| out.write_all(text.as_bytes())).unwrap();
}

/// The notes on a mesh file, one of which must have all `parts`, or none where there are no parts.
fn said(folder: &Path, name: &str, parts: &[&str]) {
    let notes = read_meshes(&[folder.join(name)]).unwrap().notes;
    let has_all = |note: &String| parts.iter().all(|part| note.contains(part));
    assert_eq!(notes.iter().any(has_all), !parts.is_empty(), "{notes:?}");
}

fn put_image(folder: &Path) {
    let image = crate::scene::ColorImage::filled(2, 2, [9, 9, 9]).unwrap();
    write_atomically(&folder.join("t.png"), |out| {
        crate::format::image::write_png(out, &image)
    })
    .unwrap();
}

#[test]
fn options_of_textures_that_are_not_followed() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    put_image(folder);
    let vertices = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\n";
    let obj = format!("mtllib \"m.mtl\"\n{vertices}usemtl a\nf 1/1 2/2 3/3\n");
    put(folder, "m.obj", &obj);
    for (maps, parts) in [
        (
            "map_Kd -clamp on t.png",
            &["material \"a\"", "-clamp on"][..],
        ),
        ("map_Kd -clamp off t.png", &[]),
        (
            "map_Kd \"t.png\"\nmap_d -s 2 2 t.png",
            &["map_d of material \"a\"", "map_Kd"],
        ),
        ("map_Kd -s 2 2 t.png\nmap_d -s 2 2 t.png", &[]),
        ("map_d -s 2 2 t.png", &[]),
        ("map_Kd -mm 0 1 t.png", &[]),
        ("map_Kd -mm 0.1 1 t.png", &["material \"a\"", "-mm"]),
        ("d 1\nmap_Kd t.png", &[]),
        ("d 0\nmap_Kd t.png", &["m.mtl", "d below 1"]),
    ] {
        put(folder, "m.mtl", &format!("newmtl a\n{maps}\n"));
        said(folder, "m.obj", parts);
    }
}

/// The opacity that a mask of two pixels gives a material: red of 200 and opaque, green of 100 and opaque or not.
#[test]
fn masks_are_cut_by_the_channel_that_says_something() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let vertices = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\n";
    let obj = format!("mtllib m.mtl\n{vertices}usemtl a\nf 1/1 2/2 3/3\n");
    put(folder, "m.obj", &obj);
    let cut = |alpha: u8, maps: &str| {
        let pixels = [200, 0, 0, 255, 0, 100, 0, alpha];
        write_atomically(&folder.join("a.png"), |out| {
            image::codecs::png::PngEncoder::new(out)
                .write_image(&pixels, 2, 1, image::ExtendedColorType::Rgba8)
                .map_err(std::io::Error::other)
        })
        .unwrap();
        put(folder, "m.mtl", &format!("newmtl a\n{maps}\n"));
        let loaded = read_meshes(&[folder.join("m.obj")]).unwrap();
        let cutout = loaded.mesh.material_of(0).cutout.as_ref();
        (
            cutout.map(|cutout| cutout.opacity.values().to_vec()),
            loaded.notes,
        )
    };
    put_image(folder);
    let gray = crate::format::image::read_gray;
    for (alpha, maps, expected) in [
        (9, "map_d a.png", Some(vec![255, 9])),
        (255, "map_d -imfchan m a.png", Some(vec![255, 255])),
        (9, "map_d -imfchan r a.png", Some(vec![200, 0])),
        (9, "map_d -imfchan g a.png", Some(vec![0, 100])),
        (9, "map_Kd a.png\nmap_d a.png", Some(vec![255, 9])),
        // A picture whose opacity is its own: dark parts of it stay.
        (255, "map_Kd a.png\nmap_d a.png", Some(vec![255, 255])),
        (255, "map_Kd t.png\nmap_d t.png", None),
    ] {
        assert_eq!(cut(alpha, maps), (expected, vec![]), "{alpha} {maps}");
    }
    for (alpha, maps) in [(255, "map_d a.png"), (9, "map_d -imfchan l a.png")] {
        let found = cut(alpha, maps);
        let gray = gray(&std::fs::read(folder.join("a.png")).unwrap()).unwrap();
        assert_eq!(found, (Some(gray.values().to_vec()), vec![]), "{maps}");
    }
    let (opacity, notes) = cut(9, "map_d -imfchan m t.png");
    assert!(
        opacity.is_none() && notes[0].contains("-imfchan m"),
        "{notes:?}"
    );
}

#[test]
fn maps_of_faces_without_texture_coordinates() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    put_image(folder);
    let vertices = "v 0 0 0\nv 1 0 0\nv 0 1 0\n";
    let obj = format!("mtllib \"m.mtl\"\n{vertices}usemtl a\nf 1 2 3\n");
    put(folder, "m.obj", &obj);
    let expected = ["faces of material \"a\" lack texture coordinates"];
    for (maps, parts) in [
        ("map_Kd t.png", &expected[..]),
        ("map_d t.png", &expected),
        ("Kd 1 0 0", &[]),
    ] {
        put(folder, "m.mtl", &format!("newmtl a\n{maps}\n"));
        said(folder, "m.obj", parts);
    }
}

#[test]
fn textures_and_colors_of_a_ply_that_do_not_show() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    put_image(folder);
    let ply = |comment: &str, of_vertices: &str, of_faces: &str, (vertex, face): (&str, &str)| {
        let header = format!(
            "ply\nformat ascii 1.0\n{comment}element vertex 3\nproperty float x\nproperty float y\nproperty float z\n\
             {of_vertices}element face 1\nproperty list uchar int vertex_index\n{of_faces}end_header\n"
        );
        let rows = ["0 0 0", "1 0 0", "0 1 0"]
            .map(|at| format!("{at}{vertex}\n"))
            .concat();
        put(folder, "m.ply", &format!("{header}{rows}3 0 1 2{face}\n"));
    };
    ply("comment texturefile t.png\n", "", "", ("", ""));
    said(folder, "m.ply", &["m.ply", "no texture coordinates"]);
    let coords = "property float texture_s\nproperty float texture_t\n";
    ply("comment texturefile t.png\n", coords, "", (" 0.5 0.5", ""));
    said(folder, "m.ply", &[]);
    let mesh = read_meshes(&[folder.join("m.ply")]).unwrap().mesh;
    assert!(mesh.material_of(0).texture.is_some() && mesh.texture_coords().is_some());
    let colors = "property uchar red\nproperty uchar green\nproperty uchar blue\n";
    ply("", "", colors, ("", " 255 0 0"));
    said(folder, "m.ply", &["faces have colors"]);
    for colors in [
        colors,
        "property uchar r\nproperty uchar g\nproperty uchar b\n",
    ] {
        ply("", colors, "", (" 255 0 0", ""));
        said(folder, "m.ply", &[]);
        let mesh = read_meshes(&[folder.join("m.ply")]).unwrap().mesh;
        assert_eq!(mesh.vertex_colors(), Some(&[[255, 0, 0]; 3][..]));
    }
}

#[test]
fn strips_beside_the_faces_of_a_ply() {
    let folder = tempfile::tempdir().unwrap();
    let ply = |count: usize, rows: &str| {
        let text = format!(
            "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n\
             element face 1\nproperty list uchar int vertex_index\nelement tristrips {count}\n\
             property list int int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n{rows}"
        );
        put(folder.path(), "m.ply", &text);
    };
    ply(1, "3 0 2 1\n");
    said(folder.path(), "m.ply", &["1 triangle strips", "left out"]);
    ply(0, "");
    said(folder.path(), "m.ply", &[]);
}

#[test]
fn a_number_of_no_texture_of_a_ply() {
    let folder = tempfile::tempdir().unwrap();
    put_image(folder.path());
    let text = "ply\nformat ascii 1.0\ncomment TextureFile t.png\nelement vertex 3\nproperty float x\n\
                property float y\nproperty float z\nproperty float s\nproperty float t\nelement face 1\n\
                property list uchar int vertex_index\nproperty int texnumber\nend_header\n\
                0 0 0 0 0\n1 0 0 1 0\n0 1 0 0 1\n3 0 1 2 7\n";
    put(folder.path(), "m.ply", text);
    let error = read_meshes(&[folder.path().join("m.ply")]).unwrap_err();
    let said = "expected a texnumber below 1, the number of its comments TextureFile, found 7";
    assert!(error.to_string().ends_with(said), "{error}");
}

/// Two triangles of a textured PLY: the second has no texture coordinates of its own, or the number of no texture.
#[test]
fn triangles_of_a_ply_without_a_texture_show_their_vertices() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    put_image(folder);
    let coords = "property float s\nproperty float t\n";
    for (of_vertices, second, is_textured) in [
        ("", "0 0", false),
        ("", "6 0 0 1 0 1 1 -1", false),
        (coords, "0 0", true),
        (coords, "0 -1", false),
    ] {
        let of_vertex = if of_vertices.is_empty() {
            ""
        } else {
            " 0.5 0.25"
        };
        let rows = ["0 0 0", "1 0 0", "0 1 0", "1 1 0"].map(|at| format!("{at}{of_vertex}\n"));
        let text = format!(
            "ply\nformat ascii 1.0\ncomment TextureFile t.png\nelement vertex 4\nproperty float x\nproperty float y\n\
             property float z\n{of_vertices}element face 2\nproperty list uchar int vertex_index\n\
             property list uchar float texcoord\nproperty int texnumber\nend_header\n{}\
             3 0 1 2 6 0 0 1 0 1 1 0\n3 1 3 2 {second}\n",
            rows.concat()
        );
        put(folder, "m.ply", &text);
        let parts: &[&str] = if is_textured {
            &[]
        } else {
            &["1 triangles have no texture"]
        };
        said(folder, "m.ply", parts);
        let mesh = read_meshes(&[folder.join("m.ply")]).unwrap().mesh;
        assert!(mesh.material_of(0).texture.is_some());
        assert_eq!(
            mesh.material_of(1).texture.is_some(),
            is_textured,
            "{second}"
        );
        let finite = mesh.texture_coords().unwrap().iter().flatten();
        assert!(finite.into_iter().all(|coord| coord.is_finite()));
        if is_textured {
            assert_eq!(mesh.texture_coords().unwrap()[1], [Vec2::new(0.5, 0.25); 3]);
        }
    }
}
