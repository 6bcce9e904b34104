use super::*;
use glam::Vec2;

const TRIANGLE: &str = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\n";

fn read(text: &str) -> ObjFile {
    read_obj(text.as_bytes()).unwrap()
}

fn complaint(text: &str) -> String {
    read_obj(format!("{TRIANGLE}{text}").as_bytes())
        .unwrap_err()
        .to_string()
}

#[test]
fn indices_count_from_both_ends() {
    let file = read(&format!(
        "{TRIANGLE}f 1/1 2/2 3/3\nf -3/-3/1 -2/-2/1 -1/-1/1"
    ));
    assert_eq!(file.triangles, [[0, 1, 2]; 2]);
    assert_eq!(file.texture_coords, [[Vec2::ZERO, Vec2::X, Vec2::Y]; 2]);
    assert_eq!(
        file.materials,
        [MaterialUse {
            name: String::new(),
            textured: true
        }]
    );
}

#[test]
fn wrong_indices_say_what_is_there() {
    let error = complaint("f 1 2 4");
    assert!(
        error.contains("line 7") && error.contains("1 to 3") && error.contains("\"4\""),
        "{error}"
    );
    for wrong in [
        "f 0 1 2",
        "f 1 2 -4",
        "f 1/4 2/1 3/1",
        "f 1.5 2 3",
        "f a b c",
        "f 1 2 99999999999999999999",
    ] {
        assert!(
            complaint(wrong).starts_with("line 7: expected the index"),
            "{wrong}"
        );
    }
    assert!(
        read_obj(b"f 1 2 3")
            .unwrap_err()
            .to_string()
            .contains("none are defined")
    );
}

#[test]
fn materials_follow_their_faces() {
    let file = read(&format!(
        "mtllib a b.mtl\n{TRIANGLE}f 1 2 3\nusemtl  red \ng x\nf 1/1 2/2 3/3\nf 1 2 3\n\
         usemtl blue\no y\nf 1/1 2/2 3/3\nusemtl red\nf 3/1 2/2 1/3"
    ));
    let used: Vec<(&str, bool)> = file
        .materials
        .iter()
        .map(|m| (m.name.as_str(), m.textured))
        .collect();
    assert_eq!(
        used,
        [("", false), ("red", true), ("red", false), ("blue", true)]
    );
    assert_eq!(file.triangle_materials, [0, 1, 2, 3, 1]);
    assert_eq!(file.libraries, ["a b.mtl"]);
}

#[test]
fn vertices_may_have_weights_and_colours() {
    let file = read("v 1 2 3 0.5\nv 1 2 3 1 0.5 0\nv 1 2 3\n");
    assert_eq!(
        file.vertex_colors.unwrap(),
        [None, Some([255, 128, 0]), None]
    );
    assert_eq!(
        read("v 1 2 3 255 128 0").vertex_colors.unwrap(),
        [Some([255, 128, 0])]
    );
    // By rounding a little above white.
    assert_eq!(
        read("v 1 2 3 0.5 0.5 1.000001").vertex_colors.unwrap(),
        [Some([128, 128, 255])]
    );
    // Seven numbers end in an opacity.
    assert_eq!(
        read("v 1 2 3 1 0 0 1\nv 1 2 3 0 0.5 1 0")
            .vertex_colors
            .unwrap(),
        [Some([255, 0, 0]), Some([0, 128, 255])]
    );
    assert_eq!(read(TRIANGLE).vertex_colors, None);
}

#[test]
fn carriage_returns_alone_end_lines() {
    let text = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nusemtl a\nf 1 2 3\n";
    let expected = read(text);
    assert_eq!(expected.triangles, [[0, 1, 2]]);
    assert_eq!(read(&text.replace('\n', "\r")), expected);
    assert_eq!(read(&text.replace('\n', "\r\n")), expected);
    let broken = text.replace('\n', "\r").replace("1 0 0", "1 x 0");
    let error = read_obj(broken.as_bytes()).unwrap_err().to_string();
    assert!(error.contains("line 2"), "{error}");
}

#[test]
fn text_may_be_untidy() {
    let file = read("\u{feff}v 0 0 0 # origin\r\n\tv +1. .5e0 -0\r\nv 0 \\\r\n1 0\r\nf 1 2\\\n 3");
    assert_eq!(
        file.vertices,
        [DVec3::ZERO, DVec3::new(1.0, 0.5, -0.0), DVec3::Y]
    );
    assert_eq!(file.triangles.len(), 1);
}

#[test]
fn numbers_are_finite() {
    for wrong in [
        "v nan 0 0",
        "v 0 inf 0",
        "v 0 0 1.#IND",
        "v 1 2",
        "vt",
        "vt x",
    ] {
        assert!(complaint(wrong).starts_with("line 7: expected"), "{wrong}");
    }
}

#[test]
fn utf16_is_named() {
    let utf16: Vec<u8> = "v 0 0 0"
        .encode_utf16()
        .flat_map(u16::to_be_bytes)
        .collect();
    assert!(read_obj(&utf16).unwrap_err().to_string().contains("UTF-8"));
    assert!(
        read_obj(b"\xff\xfev\0")
            .unwrap_err()
            .to_string()
            .contains("UTF-16")
    );
}

#[test]
fn faces_without_area_of_corners_are_counted() {
    assert_eq!(
        read(&format!("{TRIANGLE}f 1\nf 1 2\nf 1 2 3")).skipped_faces,
        2
    );
}

/// Every kind of line, long enough for many pieces.
fn everything() -> String {
    let mut text = String::from("\u{feff}mtllib a.mtl\nv 0 0 0\nf 1/7 1/x 1/9\n");
    for number in 0..300 {
        let [x, y] = [number % 7, number % 11];
        match number % 5 {
            0 => text += &format!("v {x} {y} \\\n 0.5 \\\n\n"),
            1 => text += &format!("v {x} {y} 1 # not a backslash \\\nv 0 0 \\\\\n \n1\n"),
            2 => text += &format!("# v 1 \\\n\tv {x} {y} 2 0.{x} 0.5 1\r\n"),
            _ => text += &format!("v {x} {y} {number} 1\nvt 0.{x} {y}\n"),
        }
        match number % 9 {
            0 => text += &format!("usemtl m{}\nmtllib b{number}.mtl \\\nc.mtl\n", number % 4),
            1 | 2 if number > 8 => text += "f -1 -2 -3 -4\nf 1 2\n",
            3 if number > 8 => text += &format!("f 1/1 {number}/2/1 -1/-1\nf 1/1 2/1 3\n"),
            4 if number > 8 => text += "f 1/1 1/-1 3/2 4/1 1/2\n",
            _ => text += "usemtl\n",
        }
    }
    text
}

#[test]
fn pieces_and_threads_change_nothing() {
    let text = everything();
    let text = plain(text.as_bytes()).unwrap();
    let whole = read_in_pieces(&text, usize::MAX, 1).unwrap();
    assert!(whole.triangles.len() > 250 && whole.materials.len() > 5);
    assert!(whole.lost_coords > 0 && whole.skipped_faces > 9 && whole.libraries.len() > 30);
    for (size, threads) in [(1, 1), (1, 8), (17, 2), (100, 3), (1000, 8), (4000, 1)] {
        let pieces = text::pieces(&text, size).count();
        assert!(size > 100 || pieces > 90, "{pieces} pieces of {size} bytes");
        let read = read_in_pieces(&text, size, threads).unwrap();
        assert!(read == whole, "pieces of {size} bytes, {threads} threads");
    }
}

#[test]
fn the_first_error_is_found_at_any_number_of_threads() {
    let good = everything();
    let lines: Vec<&str> = good.lines().collect();
    let place = lines.len() / 2
        - (0..)
            .find(|back| lines[lines.len() / 2 - back].starts_with("f "))
            .unwrap();
    for wrong in [
        "f 1 2 9999",
        "f 1 2 -1000",
        "v 1 2",
        "vt x",
        "f 1/9999 2/1 3/1",
    ] {
        let mut lines = lines.clone();
        lines[place] = wrong;
        lines.push("v later errors do not count");
        let text = lines.join("\n");
        let text = plain(text.as_bytes()).unwrap();
        let whole = read_in_pieces(&text, usize::MAX, 1)
            .unwrap_err()
            .to_string();
        assert!(
            whole.starts_with(&format!("line {}: ", place + 1)),
            "{whole}"
        );
        for (size, threads) in [(1, 8), (50, 1), (300, 2), (2000, 3)] {
            let error = read_in_pieces(&text, size, threads).unwrap_err();
            assert_eq!(error.to_string(), whole, "{size} {threads}");
        }
    }
}

#[test]
fn pieces_are_cut_where_lines_end_for_sure() {
    let text = b"v 1 \\\n2 3\n# a \\\nv\n \nx\\\\\n\nv\nend";
    let pieces: Vec<&[u8]> = text::pieces(text, 1).collect();
    let expected: [&[u8]; 4] = [b"v 1 \\\n2 3\n", b"# a \\\nv\n", b" \nx\\\\\n\nv\n", b"end"];
    assert_eq!(pieces, expected);
    assert_eq!(text::pieces(text, 1000).count(), 1);
    assert_eq!(text::pieces(b"", 10).count(), 0);
}

/// A space before a line's end leaves it to the reader of all lines.
#[test]
fn plain_lines_are_read_as_all_lines_are() {
    let mut text = String::from("mtllib a.mtl\nusemtl a\n");
    for i in 0..200u32 {
        let at = [i.wrapping_mul(2_654_435_761), i * i, i].map(|n| f64::from(n % 100_000));
        text += &format!(
            "v {:.7} -{} {:.3}\n",
            at[0] / 97.0,
            at[1],
            at[2] / 7.0 - 10.0
        );
        text += &format!("vt {:.6} {}\n", at[0] / 1e5, at[2] / 256.0);
        if i >= 4 {
            text += &match i % 5 {
                0 => format!("f {}/{} {}/{i} {i}/{i}\n", i - 3, i - 2, i - 1),
                1 => format!(
                    "f {i}/{i}/1 {}/{}/2 {}/1/3 {}/2/9\n",
                    i - 1,
                    i - 1,
                    i - 2,
                    i - 3
                ),
                2 => format!("f {i} {} {}\nusemtl b{}\n", i - 1, i - 2, i % 3),
                3 => format!("f -1/-1 -2/-2 -3/-1\r\nf {i}/1 1/1\n"),
                _ => format!("f {i}//1 {}//2 {}//3 # three\n", i - 1, i - 3),
            };
        }
    }
    let plain = read_obj(text.as_bytes()).unwrap();
    let spaced = text.replace('\n', " \n");
    assert_eq!(read_obj(spaced.as_bytes()).unwrap(), plain);
    assert!(plain.triangles.len() > 200 && plain.skipped_faces == 39);
    for broken in ["v 1 2\n", "f 1/1 2/2 900/1\n", "vt x 0\n"] {
        let error = |text: &str| read_obj(format!("{text}{broken}").as_bytes()).unwrap_err();
        assert_eq!(error(&text).to_string(), error(&spaced).to_string());
    }
}
