//! What the columns of the element `vertex` mean.

use super::body::Body;
use super::header::Header;
use super::table::Table;
use crate::error::FormatError;
use crate::scene::PointCloud;
use glam::{DVec3, Vec2, Vec3};
use ply_rs_bw::ply::ScalarType;

/// Takes the table of the vertices, and what lies before it.
pub(super) fn take<'a>(header: &Header, body: &mut Body<'a>) -> Result<Table<'a>, FormatError> {
    for element in &header.elements {
        if element.name == "vertex" {
            return body.take_table(element);
        }
        body.skip(element)?;
    }
    Err(FormatError::new(
        "header",
        "expected an element `vertex`, found none",
    ))
}

/// The positions; every file must have them.
pub(super) fn positions(table: &Table<'_>) -> Result<Vec<DVec3>, FormatError> {
    let Some(columns) = table.find(["x", "y", "z"]) else {
        let problem = format!(
            "expected properties x, y and z, found {}",
            match &table.names()[..] {
                [] => "none".into(),
                names => names.join(", "),
            }
        );
        return Err(FormatError::new("element vertex", problem));
    };
    Ok(table.map(columns, |_, position| DVec3::from_array(position)))
}

/// 8-bit colours, if there are any.
pub(super) fn colors(table: &Table<'_>) -> Result<Option<Vec<[u8; 3]>>, FormatError> {
    let names = [
        ["red", "green", "blue"],
        ["diffuse_red", "diffuse_green", "diffuse_blue"],
        ["r", "g", "b"],
    ];
    let Some(columns) = names.into_iter().find_map(|names| table.find(names)) else {
        return Ok(None);
    };
    let white = white_of(table, columns);
    let signed = !(columns.into_iter())
        .any(|column| matches!(table.scalar(column), ScalarType::Float | ScalarType::Double));
    let mut first_bad = None;
    let colors = table.map(columns, |row, channels| {
        let mut color = [0; 3];
        for (byte, value) in color.iter_mut().zip(channels) {
            match channel(value, (white, signed)) {
                Some(found) => *byte = found,
                None => first_bad = first_bad.or(Some((row, value))),
            }
        }
        color
    });
    match first_bad {
        None => Ok(Some(colors)),
        Some((row, value)) => {
            let problem = format!("expected color values from 0 to {white}, found {value}");
            Err(FormatError::new(format!("vertex {row}"), problem))
        }
    }
}

/// What stands for white: 255, or what the type and the largest value say, 1 of fractions and 65535 of
/// 16 bits.
fn white_of(table: &Table<'_>, columns: [usize; 3]) -> f64 {
    let is = |types: [ScalarType; 2]| {
        (columns.into_iter()).all(|column| types.contains(table.scalar(column)))
    };
    if is([ScalarType::UChar, ScalarType::Char]) {
        return 255.0;
    }
    let mut most = 0.0f64;
    table.map(columns, |_, channels| {
        most = channels.into_iter().fold(most, f64::max);
    });
    if is([ScalarType::Float, ScalarType::Double]) && most <= 2.0 {
        // What is a little above 1 is no fraction of 255 either: it is refused.
        1.0
    } else if is([ScalarType::UShort, ScalarType::UInt]) && most > 255.0 {
        65535.0
    } else {
        255.0
    }
}

/// How far fractions may lie beyond black and white.
const SLACK: f64 = 0.01;

/// A colour value as 8 bits. `signed` bytes below 0 are bytes above 127; what is not known, NaN, is black.
fn channel(value: f64, (white, signed): (f64, bool)) -> Option<u8> {
    let scaled = match white {
        _ if value.is_nan() => 0.0,
        1.0 if (-SLACK..=1.0 + SLACK).contains(&value) => 255.0 * value.clamp(0.0, 1.0),
        _ if signed && (-128.0..0.0).contains(&value) => value + 256.0,
        _ if (0.0..=white).contains(&value) => value * (255.0 / white),
        _ => return None,
    };
    Some(scaled.round() as u8)
}

/// Texture coordinates per vertex, if there are any.
pub(super) fn texture_coords(table: &Table<'_>) -> Option<Vec<Vec2>> {
    let names = [
        ["s", "t"],
        ["u", "v"],
        ["texture_u", "texture_v"],
        ["texture_s", "texture_t"],
    ];
    let columns = names.into_iter().find_map(|names| table.find(names))?;
    Some(table.map(columns, |_, [u, v]| Vec2::new(u as f32, v as f32)))
}

/// Positions and every column that a cloud can hold.
pub(super) fn cloud(table: &Table<'_>) -> Result<PointCloud, FormatError> {
    let mut cloud = PointCloud::new(positions(table)?);
    let wrong = || FormatError::at("element vertex");
    if let Some(columns) = table.find(["nx", "ny", "nz"]) {
        let normals = table.map(columns, |_, normal| {
            Vec3::from_array(normal.map(|v| v as f32))
        });
        cloud = cloud.with_normals(normals).map_err(wrong())?;
    }
    if let Some(colors) = colors(table)? {
        cloud = cloud.with_colors(colors).map_err(wrong())?;
    }
    if let Some(columns) = table.find(["views"]) {
        let counts = table.map(columns, |_, [count]| count as u32); // saturates
        cloud = cloud.with_view_counts(counts).map_err(wrong())?;
    }
    if let Some(columns) = table.find(["confidence"]) {
        let confidences = table.map(columns, |_, [confidence]| confidence as f32);
        cloud = cloud.with_confidences(confidences).map_err(wrong())?;
    }
    Ok(cloud)
}
