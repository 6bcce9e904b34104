//! MTL: the materials of OBJ files. Only what shows is read: `Kd`, `map_Kd` and `map_d`.

use super::image::Channel;
use super::obj::{fields, lines, plain, rest_of_line};
use crate::error::FormatError;
use glam::Vec2;

/// A material as its file states it.
#[derive(Debug, Clone, PartialEq)]
pub struct MtlMaterial {
    /// After `newmtl`; empty when unnamed.
    pub name: String,
    /// `Kd` as 8-bit sRGB, if stated as three numbers.
    pub color: Option<[u8; 3]>,
    /// `map_Kd`, if stated.
    pub texture: Option<MtlTexture>,
    /// `map_d`, if stated: an image whose opacity says where there is surface. A mesh has one set of coordinates, so
    /// that where `texture` has other options those count.
    pub mask: Option<MtlTexture>,
    /// Whether it is transparent: `d` below 1.
    pub transparent: bool,
}

/// A texture image and how it lies on the surface: `image = coordinate · scale + offset`.
#[derive(Debug, Clone, PartialEq)]
pub struct MtlTexture {
    /// The image's path as written.
    pub file: String,
    /// Option `-s`; 1 by default.
    pub scale: Vec2,
    /// Option `-o`; 0 by default.
    pub offset: Vec2,
    /// Option `-clamp on`: beyond its border the image is not repeated.
    pub clamped: bool,
    /// Option `-imfchan`: the one channel that counts; `None` where it is not given or names none of these.
    pub channel: Option<Channel>,
    /// Option `-mm`: what is added to its values, and then multiplied with them; 0 and 1 by default.
    pub levels: [f32; 2],
}

/// Reads all materials in order. Statements before the first `newmtl` and unknown ones are skipped.
///
/// # Errors
/// UTF-16, zero bytes in the first 1024, and a `Kd` that is neither one nor three finite numbers, `spectral` nor
/// `xyz`.
pub fn read_mtl(bytes: &[u8]) -> Result<Vec<MtlMaterial>, FormatError> {
    let mut materials: Vec<MtlMaterial> = Vec::new();
    for (number, line) in lines(&plain(bytes)?) {
        let keyword = fields(&line)
            .next()
            .unwrap_or_default()
            .to_ascii_lowercase();
        if keyword == b"newmtl" {
            materials.push(MtlMaterial {
                name: rest_of_line(&line),
                color: None,
                texture: None,
                mask: None,
                transparent: false,
            });
        }
        let Some(material) = materials.last_mut() else {
            continue;
        };
        match keyword.as_slice() {
            b"kd" => material.color = read_color(&line, number)?,
            b"map_kd" => material.texture = read_texture(&rest_of_line(&line)),
            b"d" => material.transparent = last_number(&line).is_some_and(|opacity| opacity < 1.0),
            b"map_d" => material.mask = read_texture(&rest_of_line(&line)),
            _ => {}
        }
    }
    Ok(materials)
}

/// `Kd r g b`, `Kd grey`; `None` for spectral files and CIE coordinates.
fn read_color(line: &[u8], number: usize) -> Result<Option<[u8; 3]>, FormatError> {
    let words: Vec<String> = fields(line)
        .skip(1)
        .map(|word| String::from_utf8_lossy(word).into_owned())
        .collect();
    if words
        .first()
        .is_some_and(|word| word == "spectral" || word == "xyz")
    {
        return Ok(None);
    }
    // What comes after three numbers is passed over.
    let words_of_color = words.iter().take_while(|word| !word.starts_with('#'));
    let finite = |word: &String| word.parse().ok().filter(|value: &f64| value.is_finite());
    let values = words_of_color.take(3).map(finite);
    let values: Option<Vec<f64>> = values.collect();
    let [r, g, b] = match values.as_deref() {
        Some(&[grey]) => [grey; 3],
        Some(&[r, g, b]) => [r, g, b],
        _ => {
            let problem = format!(
                "expected `Kd` and three numbers, found {:?}",
                words.join(" ")
            );
            return Err(FormatError::new(format!("line {number}"), problem));
        }
    };
    Ok(Some([r, g, b].map(super::obj::byte_of_fraction)))
}

/// The options and the file name, which may hold spaces, after `map_Kd`.
fn read_texture(text: &str) -> Option<MtlTexture> {
    let mut texture = MtlTexture {
        file: String::new(),
        scale: Vec2::ONE,
        offset: Vec2::ZERO,
        clamped: false,
        channel: None,
        levels: [0.0, 1.0],
    };
    let mut rest = text.trim();
    while let Some(option) = rest.strip_prefix('-') {
        let (name, after) = option.split_once(char::is_whitespace)?;
        let name = name.to_ascii_lowercase();
        let most = match name.as_str() {
            "o" | "s" | "t" => 3,
            "mm" => 2,
            "blendu" | "blendv" | "boost" | "cc" | "clamp" | "texres" | "bm" | "imfchan"
            | "type" | "colorspace" => 1,
            _ => break,
        };
        let value = after.split_whitespace().next().unwrap_or_default();
        match name.as_str() {
            "clamp" => texture.clamped = value.eq_ignore_ascii_case("on"),
            "imfchan" => texture.channel = channel_of(value),
            _ => {}
        }
        let (values, after) = arguments(after, most);
        if name == "mm" {
            for (level, value) in texture.levels.iter_mut().zip(&values) {
                *level = *value;
            }
        }
        let target = match name.as_str() {
            "s" => Some(&mut texture.scale),
            "o" => Some(&mut texture.offset),
            _ => None,
        };
        if let Some(target) = target {
            target.x = values.first().copied().unwrap_or(target.x);
            target.y = values.get(1).copied().unwrap_or(target.y);
        }
        rest = after;
    }
    texture.file = rest.to_owned();
    (!rest.is_empty()).then_some(texture)
}

/// The last number of a line such as `d 0.5` or `d -halo 0.5`.
fn last_number(line: &[u8]) -> Option<f64> {
    let words = fields(line)
        .skip(1)
        .filter_map(|word| str::from_utf8(word).ok());
    words.filter_map(|word| word.parse().ok()).last()
}

/// The channel that `-imfchan` names.
fn channel_of(value: &str) -> Option<Channel> {
    match value.to_ascii_lowercase().as_str() {
        "r" => Some(Channel::Red),
        "g" => Some(Channel::Green),
        "b" => Some(Channel::Blue),
        "m" => Some(Channel::Alpha),
        "l" => Some(Channel::Luminance),
        _ => None,
    }
}

/// Up to `most` arguments at the front of `text`, and what follows them. Options with one argument
/// take any word; the others take numbers, of which there may be fewer.
fn arguments(text: &str, most: usize) -> (Vec<f32>, &str) {
    let mut values = Vec::new();
    let mut rest = text.trim_start();
    for _ in 0..most {
        let (word, after) = rest.split_once(char::is_whitespace).unwrap_or((rest, ""));
        match word.parse::<f32>() {
            Ok(value) if value.is_finite() && !after.is_empty() => values.push(value),
            _ if most == 1 && !after.is_empty() => {}
            _ => break,
        }
        rest = after.trim_start();
    }
    (values, rest)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn only(text: &str) -> MtlMaterial {
        read_mtl(text.as_bytes()).unwrap().remove(0)
    }

    #[test]
    fn names_colours_and_textures_are_read() {
        let text =
            "# x\nKd 9 9 9\nnewmtl  two words \n\tKd 1 0.5 0\nmap_Kd a.png\n newmtl\nKd .2\n";
        let materials = read_mtl(text.as_bytes()).unwrap();
        assert_eq!(
            (materials[0].name.as_str(), materials[0].color),
            ("two words", Some([255, 128, 0]))
        );
        assert_eq!(materials[0].texture.as_ref().unwrap().file, "a.png");
        let masked = only("newmtl m\nmap_d leaf mask.png");
        assert_eq!(masked.mask.unwrap().file, "leaf mask.png");
        for (word, channel) in [
            ("l", Some(Channel::Luminance)),
            ("M", Some(Channel::Alpha)),
            ("r", Some(Channel::Red)),
            ("g", Some(Channel::Green)),
            ("b", Some(Channel::Blue)),
            ("z", None),
        ] {
            let masked = only(&format!("newmtl m\nmap_d -imfchan {word} a.png"));
            let mask = masked.mask.unwrap();
            assert_eq!((mask.file.as_str(), mask.channel), ("a.png", channel));
        }
        assert_eq!(
            (materials[1].name.as_str(), materials[1].color),
            ("", Some([51; 3]))
        );
    }

    #[test]
    fn options_stand_before_names_with_spaces() {
        let cases = [
            (
                "map_Kd texture 01.png",
                "texture 01.png",
                Vec2::ONE,
                Vec2::ZERO,
            ),
            (
                "map_kd -s 2 3 1 -o 0.5 0 0 my file.png",
                "my file.png",
                Vec2::new(2.0, 3.0),
                Vec2::new(0.5, 0.0),
            ),
            (
                "map_Kd -o 0.1 diffuse.jpg",
                "diffuse.jpg",
                Vec2::ONE,
                Vec2::new(0.1, 0.0),
            ),
            (
                "map_Kd -colorspace sRGB -o 0.1 2.jpg",
                "2.jpg",
                Vec2::ONE,
                Vec2::new(0.1, 0.0),
            ),
            (
                "map_Kd -blendu on -type sphere -mm 0 1 d.jpg",
                "d.jpg",
                Vec2::ONE,
                Vec2::ZERO,
            ),
            (
                "map_Kd -clamp on\t-texres 512 .\\in put.jpg",
                ".\\in put.jpg",
                Vec2::ONE,
                Vec2::ZERO,
            ),
            (
                "map_Kd -Clamp off -S 2 nan.jpg",
                "nan.jpg",
                Vec2::new(2.0, 1.0),
                Vec2::ZERO,
            ),
            (
                "map_Kd -o nan 1 d.jpg",
                "nan 1 d.jpg",
                Vec2::ONE,
                Vec2::ZERO,
            ),
            (
                "map_Kd -odd name.jpg",
                "-odd name.jpg",
                Vec2::ONE,
                Vec2::ZERO,
            ),
            ("map_Kd -s 1 1 7", "7", Vec2::ONE, Vec2::ZERO),
        ];
        for (line, file, scale, offset) in cases {
            let texture = only(&format!("newmtl m\n{line}")).texture.unwrap();
            let file = file.to_owned();
            assert_eq!(
                texture,
                MtlTexture {
                    file,
                    scale,
                    offset,
                    clamped: line.contains("-clamp on"),
                    channel: None,
                    levels: [0.0, 1.0],
                },
                "{line}"
            );
        }
        assert_eq!(only("newmtl m\nmap_Kd -s 1 1").texture.unwrap().file, "1");
        assert_eq!(only("newmtl m\nmap_Kd").texture, None);
    }

    #[test]
    fn opacity_and_levels_are_read() {
        for (line, transparent) in [
            ("d 0", true),
            ("d -halo 0.5", true),
            ("d 1.000", false),
            ("d", false),
            ("Tr 1", false),
        ] {
            let material = only(&format!("newmtl m\n{line}"));
            assert_eq!(material.transparent, transparent, "{line}");
        }
        let levels = |line: &str| only(&format!("newmtl m\n{line}")).texture.unwrap().levels;
        assert_eq!(levels("map_Kd -mm 0.25 2 a.png"), [0.25, 2.0]);
        assert_eq!(levels("map_Kd -mm 0.25 a.png"), [0.25, 1.0]);
        assert_eq!(levels("map_Kd a.png"), [0.0, 1.0]);
    }

    #[test]
    fn a_colour_that_is_none_is_named() {
        let error = read_mtl(b"newmtl m\n\nKd red").unwrap_err().to_string();
        assert!(error.contains("line 3") && error.contains("red"), "{error}");
        let error = read_mtl(b"newmtl m\nKd 0.9 oops 0.1 0.2").unwrap_err();
        assert!(error.to_string().contains("oops"), "{error}");
        let error = read_mtl(b"newmtl m\nKd nan 0 1").unwrap_err();
        assert!(error.to_string().contains("nan 0 1"), "{error}");
        assert!(only("newmtl m\nKd 0.9 0.1 0.2 more").color.is_some());
        assert!(only("newmtl m\nKd 0.9 # grey").color.is_some());
        assert_eq!(only("newmtl m\nKd spectral file.rfl").color, None);
    }
}
