//! Meshes in the variants that people have: tiles, materials, textures, odd files.

use crate::support::real_data;
use glam::{DMat3, DVec2, DVec3};
use mvs_datasets::layout::files::write_atomically;
use mvs_datasets::layout::mesh::{LoadedMesh, ReadOptions, read_meshes, read_meshes_with};
use mvs_datasets::scene::{Camera, ColorImage, Mesh, Pose, View};
use mvs_eval::render::{BackFaces, RenderOptions, Renderer};
use std::io::Write;
use std::path::{Path, PathBuf};

fn put(folder: &Path, name: &str, text: &str) {
    write_atomically(&folder.join(name), |out| out.write_all(text.as_bytes())).unwrap();
}

fn put_texture(folder: &Path, name: &str, color: [u8; 3]) {
    let image = ColorImage::filled(2, 2, color).unwrap();
    write_atomically(&folder.join(name), |out| {
        mvs_datasets::format::image::write_png(out, &image)
    })
    .unwrap();
}

fn read(paths: &[&Path]) -> LoadedMesh {
    let paths: Vec<PathBuf> = paths.iter().map(|path| path.to_path_buf()).collect();
    read_meshes(&paths).unwrap()
}

/// The squares of a 4 x 2 board, one material each, in two tile files: rows of `colors`.
fn put_board(folder: &Path, colors: &[[[u8; 3]; 4]; 2]) {
    for (row, colors) in colors.iter().enumerate() {
        let (top, bottom) = (row as f64 - 1.0, row as f64);
        let mut obj = format!("mtllib tile_{row}.mtl\nvt 0.5 0.5\n");
        let mut mtl = String::new();
        for (column, color) in colors.iter().enumerate() {
            let left = column as f64 - 2.0;
            for (x, y) in [
                (left, top),
                (left + 1.0, top),
                (left + 1.0, bottom),
                (left, bottom),
            ] {
                obj += &format!("v {x} {y} 2\n");
            }
            // Same material names in both tiles, textures of their own; columns 2 and 3 are plain.
            obj += &format!("usemtl m{column}\nf -4/1 -1/1 -2/1 -3/1\n");
            let [r, g, b] = color.map(|level| f64::from(level) / 255.0);
            mtl += &format!("newmtl m{column}\nKd {r} {g} {b}\n");
            if column < 2 {
                put_texture(folder, &format!("tile {row} {column}.png"), *color);
                mtl += &format!("Kd 0 0 0\nmap_Kd -s 1 1 tile {row} {column}.png\n");
            }
        }
        put(folder, &format!("tile_{row}.obj"), &obj);
        put(folder, &format!("tile_{row}.mtl"), &mtl);
    }
}

/// The colours of the board's squares as a camera sees them.
fn look_at_board(folder: &Path) -> [[[u8; 3]; 4]; 2] {
    let loaded = read(&[folder]);
    assert_eq!(loaded.notes, [] as [&str; 0]);
    let view = View {
        id: 0,
        name: String::new(),
        camera: Camera::new(40, 20, DVec2::splat(20.0), DVec2::new(20.0, 10.0)).unwrap(),
        pose: Pose::IDENTITY,
        depth_range: None,
    };
    let renderer = Renderer::new(&loaded.mesh).unwrap();
    let color = renderer
        .render(&view, &RenderOptions::default())
        .unwrap()
        .color;
    [5, 15].map(|row| [5, 15, 25, 35].map(|column| color.get(column, row)))
}

#[test]
fn every_face_of_every_tile_shows_its_own_texture() {
    let colors = [
        [[255, 0, 0], [0, 255, 0], [0, 0, 255], [255, 255, 0]],
        [[0, 255, 255], [255, 0, 255], [10, 20, 30], [200, 100, 50]],
    ];
    let folder = tempfile::tempdir().unwrap();
    put_board(folder.path(), &colors);
    assert_eq!(look_at_board(folder.path()), colors);
    // The check notices swapped materials, within a tile and between tiles.
    let swapped = folder.path().join("tile_0.mtl");
    let text = std::fs::read_to_string(&swapped).unwrap();
    let exchanged = text
        .replace("m0", "mx")
        .replace("m1", "m0")
        .replace("mx", "m1");
    put(folder.path(), "tile_0.mtl", &exchanged);
    assert_ne!(look_at_board(folder.path()), colors);
    put(
        folder.path(),
        "tile_0.mtl",
        &text.replace("tile 0 0", "tile 1 0"),
    );
    assert_ne!(look_at_board(folder.path()), colors);
}

#[test]
fn missing_pieces_are_noted_and_show_the_materials_color() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path();
    let triangle = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\n";
    put(path, "m.mtl", "newmtl a\nKd 0 1 0\nmap_Kd gone.png\n");
    put(
        path,
        "m.obj",
        &format!("mtllib m.mtl\n{triangle}usemtl a\nf 1/1 2/1 3/1\nusemtl b\nf 1 2 3\nf 1 2\n"),
    );
    let loaded = read(&[&path.join("m.obj")]);
    assert_eq!(loaded.mesh.material_of(0).color, [0, 255, 0]);
    assert_eq!(loaded.mesh.material_of(1).color, [200; 3]);
    for part in ["gone.png", "\"b\"", "1 faces with fewer"] {
        assert_eq!(
            loaded
                .notes
                .iter()
                .filter(|note| note.contains(part))
                .count(),
            1,
            "{part}"
        );
    }
    put(path, "gone.png", "no image");
    let notes = read(&[&path.join("m.obj")]).notes;
    assert!(
        notes
            .iter()
            .any(|note| note.contains("gone.png") && note.contains("expected")),
        "{notes:?}"
    );
}

#[test]
fn a_face_without_coordinates_does_not_borrow_its_neighbours_texture() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path();
    put_texture(path, "t.png", [9, 9, 9]);
    put(path, "m.mtl", "newmtl a\nKd 1 0 0\nmap_Kd t.png\n");
    let faces = "usemtl a\nf 1/1 2/1 3/1\nf 1 2 3\nf 1/1 2 3\n";
    put(
        path,
        "m.obj",
        &format!("mtllib m.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\n{faces}"),
    );
    let mesh = read(&[&path.join("m.obj")]).mesh;
    let textured = [0, 1, 2].map(|t| mesh.material_of(t).texture.is_some());
    assert_eq!(textured, [true, false, false]);
    assert_eq!(mesh.material_of(1).color, [255, 0, 0]);
}

#[test]
fn colored_and_plain_files_join() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path();
    put(
        path,
        "a.obj",
        "mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl a\nf 1 2 3",
    );
    put(path, "a.mtl", "newmtl a\nKd 0 0 1");
    put(
        path,
        "b.obj",
        "v 0 0 0 1 0 0\nv 1 0 0 1 0 0\nv 0 1 0 1 0 0\nf 1 2 3",
    );
    let mesh = read(&[path]).mesh;
    assert_eq!(mesh.triangles(), [[0, 1, 2], [3, 4, 5]]);
    let colors = mesh.vertex_colors().unwrap();
    assert_eq!((colors[0], colors[3]), ([0, 0, 255], [255, 0, 0]));
    let other_way = read(&[&path.join("b.obj"), &path.join("a.obj")]).mesh;
    assert_eq!(other_way.vertex_colors().unwrap()[5], [0, 0, 255]);
}

/// The colours at the corners of each triangle, which is all of one colour.
fn colors_of(mesh: &Mesh) -> Vec<[u8; 3]> {
    let colors = mesh.vertex_colors().unwrap();
    let of = |triangle: &[u32; 3]| {
        let [a, b, c] = triangle.map(|vertex| colors[vertex as usize]);
        assert!(a == b && b == c, "{triangle:?}: {a:?} {b:?} {c:?}");
        a
    };
    mesh.triangles().iter().map(of).collect()
}

/// Two materials that share vertices, beside another file with colours, and in one file with colours.
#[test]
fn materials_keep_their_colors_beside_vertices_that_have_some() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path();
    put(path, "a.mtl", "newmtl r\nKd 1 0 0\nnewmtl b\nKd 0 0 1");
    let vertices = "mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n";
    let faces = "usemtl r\nf 1 2 3\nusemtl b\nf 1 3 4\n";
    put(path, "a.obj", &format!("{vertices}{faces}"));
    let green = "v 0 0 5 0 1 0\nv 1 0 5 0 1 0\nv 1 1 5 0 1 0\n";
    put(path, "b.obj", &format!("{green}f 1 2 3"));
    let all = format!("{vertices}{green}{faces}f 5 6 7\nf -1 -2 -3\n");
    put(path, "both.obj", &all);
    let [r, g, b] = [[255, 0, 0], [0, 255, 0], [0, 0, 255]];
    let files = |names: &[&str]| {
        let paths: Vec<PathBuf> = names.iter().map(|name| path.join(name)).collect();
        let paths: Vec<&Path> = paths.iter().map(PathBuf::as_path).collect();
        read(&paths).mesh
    };
    assert_eq!(colors_of(&files(&["a.obj", "b.obj"])), [r, b, g]);
    assert_eq!(colors_of(&files(&["b.obj", "a.obj"])), [g, r, b]);
    let both = files(&["both.obj"]);
    assert_eq!(colors_of(&both), [r, b, g]); // the two sides of the green face are one
    assert_eq!(
        both.corners(1),
        [DVec3::ZERO, DVec3::new(1.0, 1.0, 0.0), DVec3::Y]
    );
    assert_eq!(
        files(&["a.obj"]).vertices().len(),
        4,
        "nothing is split without need"
    );
}

#[test]
fn threads_read_tiles_to_the_same_mesh_and_the_same_error() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path();
    let colors = [[[10, 20, 30]; 4], [[200, 100, 0]; 4]];
    put_board(path, &colors);
    for tile in 2..9 {
        let text = std::fs::read_to_string(path.join("tile_0.obj")).unwrap();
        put(
            path,
            &format!("tile_{tile}.obj"),
            &text.replace(" 2\n", &format!(" {tile}\n")),
        );
    }
    put(
        path,
        "tile_a.ply",
        "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\nproperty uchar red\nproperty uchar green\nproperty uchar blue\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 9 1 2 3\n1 0 9 4 5 6\n0 1 9 7 8 9\n3 0 1 2\n",
    );
    let read = |threads: usize| {
        let options = ReadOptions {
            threads,
            ..ReadOptions::default()
        };
        read_meshes_with(&[path.to_path_buf()], &options)
    };
    let alone = read(1).unwrap();
    assert_eq!(alone.mesh.triangles().len(), 9 * 8 + 1);
    assert_eq!(alone.mesh.vertices()[16 * 9 - 1], DVec3::new(1.0, 0.0, 8.0));
    assert_eq!(alone.mesh.vertex_colors().unwrap().last(), Some(&[7, 8, 9]));
    for threads in [0, 2, 8] {
        let together = read(threads).unwrap();
        assert!(together.mesh == alone.mesh, "{threads} threads");
        assert_eq!(
            (&together.notes, &together.files),
            (&alone.notes, &alone.files)
        );
    }
    put(path, "tile_3.obj", "v 0 0 0\nv 1 x 0\n");
    put(path, "tile_2.obj", "v 0 0 0\n\nf 1 2 3\n");
    for threads in [0, 1, 2, 8] {
        let error = read(threads).unwrap_err().to_string();
        assert!(
            error.contains("tile_2.obj") && error.contains("line 3"),
            "{threads} threads: {error}"
        );
    }
}

/// Every face once more, the other way round, with vertices of its own or not: what is seen is what is seen
/// of the mesh without, from in front and from behind.
#[test]
fn a_mesh_with_every_face_both_ways_round_is_one_with_two_sides() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let at = |x: u32, y: u32| (0.31 * f64::from(x) - 1.5, 0.29 * f64::from(y) - 1.4);
    let (mut vertices, mut front, mut back) = (String::new(), String::new(), String::new());
    for (y, x) in (0..11).flat_map(|y| (0..11).map(move |x| (y, x))) {
        let (px, py) = at(x, y);
        vertices += &format!("v {px} {py} {}\n", 3.0 + 0.3 * px * py + 0.2 * px);
        if x < 10 && y < 10 {
            let a = 11 * y + x + 1;
            let (b, c, d) = (a + 1, a + 11, a + 12);
            front += &format!("f {a} {c} {b}\nf {b} {c} {d}\n");
            back += &format!("f {b} {c} {a}\nf {d} {c} {b}\n");
        }
    }
    let own: String = back
        .replace("f ", "")
        .split_inclusive([' ', '\n'])
        .map(|word| {
            let end = &word[word.len() - 1..];
            format!("{}{end}", word.trim_end().parse::<u32>().unwrap() + 121)
        })
        .collect();
    let own: String = own.lines().map(|line| format!("f {line}\n")).collect();
    put(folder.path(), "one.obj", &format!("{vertices}{front}"));
    put(
        folder.path(),
        "two.obj",
        &format!("{vertices}{front}{back}"),
    );
    put(
        folder.path(),
        "apart.obj",
        &format!("{vertices}{vertices}{front}{own}"),
    );
    let seen = |name: &str, pose: Pose, back_faces: BackFaces| {
        let loaded = read(&[&path(name)]);
        let camera = Camera::new(120, 90, DVec2::splat(90.0), DVec2::new(60.0, 45.0)).unwrap();
        let view = View {
            id: 0,
            name: String::new(),
            camera,
            pose,
            depth_range: None,
        };
        let options = RenderOptions {
            samples: 1,
            back_faces,
            ..RenderOptions::default()
        };
        let rendering = Renderer::new(&loaded.mesh).unwrap().render(&view, &options);
        (rendering.unwrap().depth, loaded.notes.join("; "))
    };
    // From behind: turned about the vertical axis, at the other side.
    let turned = DMat3::from_diagonal(DVec3::new(-1.0, 1.0, -1.0));
    let behind = Pose::new(turned, DVec3::new(0.0, 0.0, 6.5)).unwrap();
    for pose in [Pose::IDENTITY, behind] {
        let (truth, notes) = seen("one.obj", pose, BackFaces::Valid);
        assert!(truth.valid_count() > 5000 && notes.is_empty(), "{notes}");
        for name in ["two.obj", "apart.obj"] {
            let (depth, notes) = seen(name, pose, BackFaces::Invalid);
            assert!(
                notes.starts_with("200 faces are there both ways round"),
                "{notes}"
            );
            assert!(depth == truth, "{name}");
        }
    }
}

#[test]
fn what_is_no_mesh_gets_one_sentence() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path();
    let complaint = |path: PathBuf| read_meshes(&[path]).unwrap_err().to_string();
    assert!(complaint(path.to_path_buf()).contains("found none"));
    assert!(complaint(path.join("m.stl")).contains(".obj, .ply, .gltf or .glb"));
    assert!(complaint(path.join("m.obj")).contains("No such file"));
    put(path, "points.obj", "v 0 0 0\nv 1 1 1\n");
    assert!(complaint(path.join("points.obj")).contains("2 vertices and no faces"));
    assert!(
        read_meshes(&[])
            .unwrap_err()
            .to_string()
            .contains("at least one mesh")
    );
}

/// What every OBJ below `formats` and `meshes` is read as, or the sentence that refuses it. Counts
/// and areas were compared with trimesh, which agrees except where it fans concave polygons and bent
/// ones or misreads negative indices, and which keeps faces that are there both ways round. Bent quads
/// (spot) have the area of the halves beside their shorter diagonals, worked out in numpy.
#[test]
fn every_obj_at_hand_is_read_or_gets_one_sentence() {
    let (Some(formats), Some(meshes)) = (real_data("formats"), real_data("meshes")) else {
        return;
    };
    let mut found = Vec::new();
    for root in [formats, meshes] {
        let mut folders = vec![root.clone()];
        while let Some(folder) = folders.pop() {
            for entry in std::fs::read_dir(folder).unwrap() {
                let path = entry.unwrap().path();
                if path.is_dir() {
                    folders.push(path);
                } else if path.extension().is_some_and(|extension| extension == "obj") {
                    let name = path.strip_prefix(&root).unwrap().display().to_string();
                    found.push(format!("{name}: {}", outcome(&path, &root)));
                }
            }
        }
    }
    found.sort();
    insta::assert_snapshot!(found.join("\n"));
}

fn outcome(path: &Path, root: &Path) -> String {
    let clean = |text: String| text.replace(&format!("{}/", root.display()), "");
    match read_meshes(&[path.to_path_buf()]) {
        Err(error) => clean(format!("refused: {error}")),
        Ok(LoadedMesh { mesh, notes, .. }) => {
            let textures = mesh
                .materials()
                .iter()
                .filter(|m| m.texture.is_some())
                .count();
            let area: f64 = (0..mesh.triangles().len())
                .map(|t| mesh.corners(t))
                .map(|[a, b, c]: [DVec3; 3]| 0.5 * (b - a).cross(c - a).length())
                .sum();
            let counts = format!(
                "{} vertices, {} triangles, {} materials, {textures} textures, area {area:.6e}",
                mesh.vertices().len(),
                mesh.triangles().len(),
                mesh.materials().len(),
            );
            clean([vec![counts], notes].concat().join("\n    "))
        }
    }
}
