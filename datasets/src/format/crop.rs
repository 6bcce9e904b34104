//! Open3D's `SelectionPolygonVolume` as JSON.

use crate::error::FormatError;
use crate::scene::{Axis, CropVolume};
use glam::DVec3;
use std::io::Write;

const CLASS_NAME: &str = "SelectionPolygonVolume";

#[derive(serde::Deserialize)]
struct WireVolume {
    class_name: Option<String>,
    version_major: Option<i64>,
    version_minor: Option<i64>,
    orthogonal_axis: Option<String>,
    axis_min: f64,
    axis_max: f64,
    bounding_polygon: Vec<[f64; 3]>,
}

/// Reads a polygon volume. Where Open3D turns a bad file into an empty crop, this is an error.
///
/// # Errors
/// No JSON with these fields, another class name or version, no or an unknown axis, fewer than three corners, crossed
/// bounds.
pub fn read(json: &str) -> Result<CropVolume, FormatError> {
    let wire: WireVolume = serde_json::from_str(json).map_err(no_json)?;
    if wire.class_name.as_deref() != Some(CLASS_NAME) {
        return Err(unexpected("class_name", CLASS_NAME, wire.class_name));
    }
    let version = (
        wire.version_major.unwrap_or(1),
        wire.version_minor.unwrap_or(0),
    );
    if version != (1, 0) {
        let found = Some(format!("{}.{}", version.0, version.1));
        return Err(unexpected("version_major, version_minor", "1.0", found));
    }
    let axis = match wire.orthogonal_axis.as_deref() {
        Some("X" | "x") => Axis::X,
        Some("Y" | "y") => Axis::Y,
        Some("Z" | "z") => Axis::Z,
        _ => {
            return Err(unexpected(
                "orthogonal_axis",
                "X, Y or Z",
                wire.orthogonal_axis,
            ));
        }
    };
    let corners: Vec<DVec3> = wire.bounding_polygon.iter().map(|&p| p.into()).collect();
    CropVolume::new(axis, wire.axis_min, wire.axis_max, &corners)
        .map_err(FormatError::at("bounding_polygon, axis_min, axis_max"))
}

fn no_json(error: serde_json::Error) -> FormatError {
    let (line, column) = (error.line(), error.column());
    let said = error.to_string();
    let problem = said.split(" at line ").next().unwrap_or_default();
    FormatError::new(
        format!("line {line} column {column}"),
        format!("expected the JSON of a {CLASS_NAME}, found another text ({problem})"),
    )
}

fn unexpected(field: &str, expected: &str, found: Option<String>) -> FormatError {
    let found = found.map_or("nothing".into(), |text| {
        format!("`{}`", super::text::shown(&text))
    });
    FormatError::new(field, format!("expected {expected}, found {found}"))
}

/// Writes a polygon volume that Open3D reads; the corners' coordinate on the axis is 0.
///
/// # Errors
/// What writing to `out` brings.
pub fn write(out: &mut impl Write, volume: &CropVolume) -> std::io::Result<()> {
    let axis = volume.axis();
    let (u, v) = axis.others();
    let corners: Vec<[f64; 3]> = volume
        .polygon()
        .iter()
        .map(|corner| {
            let mut point = [0.0; 3];
            (point[u], point[v]) = (corner.x, corner.y);
            point
        })
        .collect();
    let (axis_min, axis_max) = volume.range();
    let axis_name = ["X", "Y", "Z"][axis.index()];
    let wire = serde_json::json!({
        "class_name": CLASS_NAME,
        "version_major": 1,
        "version_minor": 0,
        "orthogonal_axis": axis_name,
        "axis_min": axis_min,
        "axis_max": axis_max,
        "bounding_polygon": corners,
    });
    serde_json::to_writer_pretty(&mut *out, &wire)?;
    writeln!(out)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const REAL: &str = r#"{ "axis_max": 4.0, "axis_min": -1.65,
        "bounding_polygon": [[-1.75, 0.2, 0.0], [-1.1, 1.55, 0.0], [0.3, 1.9, 0.0]],
        "class_name": "SelectionPolygonVolume", "orthogonal_axis": "Z",
        "version_major": 1, "version_minor": 0 }"#;

    #[test]
    fn a_real_file_reads_to_its_numbers() {
        let volume = read(REAL).unwrap();
        assert_eq!((volume.axis(), volume.range()), (Axis::Z, (-1.65, 4.0)));
        assert_eq!(volume.polygon()[1].to_array(), [-1.1, 1.55]);
        assert_eq!(
            read(&REAL.replace("\"Z\"", "\"y\"")).unwrap().axis(),
            Axis::Y
        );
    }

    #[test]
    fn where_open3d_crops_everything_away_this_says_why() {
        for (from, to, expected) in [
            (
                "SelectionPolygonVolume",
                "PinholeCamera",
                "class_name: expected SelectionPolygonVolume, found `PinholeCamera`",
            ),
            (
                "\"class_name\"",
                "\"name\"",
                "class_name: expected SelectionPolygonVolume, found nothing",
            ),
            (
                "\"version_major\": 1",
                "\"version_major\": 2",
                "expected 1.0, found `2.0`",
            ),
            (
                "\"Z\"",
                "\"up\"",
                "orthogonal_axis: expected X, Y or Z, found `up`",
            ),
            (
                "\"orthogonal_axis\"",
                "\"axis\"",
                "orthogonal_axis: expected X, Y or Z, found nothing",
            ),
            ("-1.65", "41.65", "expected finite axis_min ≤ axis_max"),
            (", [0.3, 1.9, 0.0]", "", "at least 3 vertices, found 2"),
            ("\"axis_max\": 4.0,", "", "missing field `axis_max`"),
            ("0.2, 0.0]", "0.2]", "line 2 column"),
            ("4.0", "1e999", "number out of range"),
            ("{", "", "line 1 column"),
        ] {
            let error = read(&REAL.replacen(from, to, 1)).unwrap_err().to_string();
            assert!(error.contains(expected), "{error}");
        }
        assert!(
            read("")
                .unwrap_err()
                .to_string()
                .contains("EOF while parsing")
        );
        assert!(read(&"[".repeat(100_000)).is_err());
    }

    proptest! {
        #[test]
        fn every_volume_reads_back(
            axis in prop_oneof![Just(Axis::X), Just(Axis::Y), Just(Axis::Z)],
            (min, extent) in (-1e9..1e9, 0.0..1e9),
            corners in proptest::collection::vec(proptest::array::uniform3(-1e9..1e9), 3..12),
        ) {
            let corners: Vec<DVec3> = corners.into_iter().map(DVec3::from).collect();
            let volume = CropVolume::new(axis, min, min + extent, &corners).unwrap();
            let mut json = Vec::new();
            write(&mut json, &volume).unwrap();
            prop_assert_eq!(read(std::str::from_utf8(&json).unwrap()).unwrap(), volume);
        }
    }
}
