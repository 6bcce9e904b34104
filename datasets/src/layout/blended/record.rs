//! `scene.json`: the conventions of a generated scene and what its views hold.

use crate::error::{Error, FormatError, Result};
use crate::layout::files;
use crate::layout::mvsnet::PixelCentre;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::io::Write;
use std::path::Path;

/// What `scene.json` says.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SceneFile {
    /// Version of this file's layout: 1.
    pub version: u32,
    /// The folder's name, 24 hexadecimal digits.
    pub id: String,
    /// The scene's name.
    pub name: String,
    /// Where the intrinsics in `cams/` put the centre of the top-left pixel.
    pub pixel_centre: PixelCentre,
    /// Conventions in words, by topic.
    pub conventions: BTreeMap<String, String>,
    /// The options that the scene was made with, all of them.
    pub options: serde_json::Value,
    /// A hash over everything that the scene's content follows from.
    pub plan: String,
    /// The views, by ascending id.
    pub views: Vec<ViewRecord>,
    /// Views that were given but left out, and why.
    pub left_out: Vec<LeftOut>,
    /// What the user should know: (code, sentence), sorted.
    pub warnings: Vec<(String, String)>,
}

/// What is known of one finished view.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ViewRecord {
    /// The view's id.
    pub id: u32,
    /// Its photograph's name; empty when unknown.
    pub name: String,
    /// A hash over everything that the view's content follows from.
    pub plan: String,
    /// Width and height in pixels.
    pub size: (u32, u32),
    /// Smallest and largest rendered depth, world units.
    pub depth: (f32, f32),
    /// The depth range in the view's `cam.txt`, world units.
    pub range: (f64, f64),
    /// Pixels with rendered surface.
    pub surface: usize,
    /// Of those, the ones that readers keep: depth in (min + Δ, min + 126·Δ].
    pub kept_by_readers: usize,
    /// Pixels that show the back of a triangle, which is no surface unless asked for.
    #[serde(default)]
    pub back_faces: usize,
    /// How like the photograph is to the rendering, -1 to 1: the mean over tiles of the correlation of their
    /// brightness; none where the rendering shows too little texture, and in scenes made before it was kept.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub likeness: Option<f64>,
    /// How the masked image was encoded, where the asked way left its background too bright.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub masked_jpeg: Option<Encoding>,
    /// BLAKE3 of each of the view's files, by path in the scene folder.
    pub files: BTreeMap<String, String>,
    /// What the user should know of this view: (code, sentence).
    pub warnings: Vec<(String, String)>,
}

/// How a JPEG was encoded.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Encoding {
    /// 1 to 100.
    pub quality: u8,
    /// Chroma at full resolution (4:4:4) instead of half (4:2:0).
    pub full_chroma: bool,
}

/// A view that is not in the scene.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct LeftOut {
    /// The view's id.
    pub id: u32,
    /// Why, in a sentence.
    pub reason: String,
}

/// Reads a `scene.json`; `None` where there is none.
///
/// # Errors
/// As [`read_json`].
pub fn read(path: &Path) -> Result<Option<SceneFile>> {
    read_json(path)
}

/// Reads a JSON file; `None` where there is none.
///
/// # Errors
/// A file that is there and that [`files::read_text`] refuses, and text that is not the JSON of a `T`.
pub fn read_json<T: serde::de::DeserializeOwned>(path: &Path) -> Result<Option<T>> {
    if !path.exists() {
        return Ok(None);
    }
    let text = files::read_text(path)?;
    let value = serde_json::from_str(&text).map_err(|error| {
        let place = format!("line {}", error.line());
        Error::in_file(path)(FormatError::new(place, error.to_string()))
    })?;
    Ok(Some(value))
}

/// Writes a value as indented JSON with a final line break.
///
/// # Errors
/// A value that JSON cannot hold, and what [`files::write_atomically`] brings.
pub fn write_json(path: &Path, value: &impl Serialize) -> Result<()> {
    files::write_atomically(path, |out| {
        serde_json::to_writer_pretty(&mut *out, value)?;
        writeln!(out)
    })
}
