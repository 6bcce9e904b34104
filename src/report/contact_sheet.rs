//! A grid of small pictures with names above and beside them.

use super::colormap;
use super::font;
use crate::error::{Error, Result};
use mvs_datasets::scene::{ColorImage, DepthMap, Raster};

/// Pixels between pictures, and of the strip that holds the columns' names.
const GAP: u32 = 8;
const STRIP: u32 = 24;
/// Pixels per dot of the font.
const DOT: u32 = 2;
/// Colours of the sheet and of its texts, 8-bit sRGB.
const PAPER: [u8; 3] = [24, 27, 31];
const INK: [u8; 3] = [226, 231, 236];
/// No sheet is larger than this many pixels.
const MOST_PIXELS: u64 = 200_000_000;

/// One row of a sheet.
#[derive(Debug, Clone)]
pub struct SheetRow<'a> {
    /// The row's name, shown above its first picture's column; may be empty.
    pub label: String,
    /// One picture per column; `None` leaves the place empty.
    pub images: Vec<Option<&'a ColorImage>>,
}

/// Draws rows of pictures, each at most `cell_width` pixels wide, under the names of their columns.
/// Larger pictures are averaged down, smaller ones stay as they are.
///
/// # Errors
/// No row, no column or no pixel of width, a row that has not one entry per column, no picture at all, and a sheet of
/// more than 2 · 10⁸ pixels.
pub fn draw(columns: &[&str], rows: &[SheetRow], cell_width: u32) -> Result<ColorImage> {
    check(columns, rows, cell_width)?;
    let shrunk: Vec<Vec<Option<ColorImage>>> = rows
        .iter()
        .map(|row| {
            row.images
                .iter()
                .map(|image| image.map(|i| fitted(i, cell_width)))
                .collect()
        })
        .collect();
    let largest = |size: &dyn Fn(&ColorImage) -> u32| {
        let all = shrunk.iter().flatten().flatten();
        all.map(size).max().unwrap_or(0)
    };
    let cell = (largest(&ColorImage::width), largest(&ColorImage::height));
    let count = (columns.len() as u64, rows.len() as u64);
    let width = u64::from(GAP) + count.0 * u64::from(cell.0 + GAP);
    let height = u64::from(STRIP) + count.1 * u64::from(cell.1 + STRIP);
    let too_large = || {
        let problem = format!("expected at most {MOST_PIXELS} pixels, found {width} x {height}");
        Error::invalid("contact sheet", problem)
    };
    if cell.0 == 0 || width.saturating_mul(height) > MOST_PIXELS {
        return Err(too_large());
    }
    let size = (u32::try_from(width), u32::try_from(height));
    let (Ok(width), Ok(height)) = size else {
        return Err(too_large());
    };
    let mut sheet = Raster::filled(width, height, PAPER)?;
    for (column, name) in (0u32..).zip(columns) {
        font::write(
            &mut sheet,
            name,
            (GAP + column * (cell.0 + GAP), 5),
            DOT,
            INK,
        );
    }
    for (row, images) in (0u32..).zip(&shrunk) {
        let top = STRIP + row * (cell.1 + STRIP);
        for (column, image) in (0u32..).zip(images) {
            if let Some(image) = image {
                paste(&mut sheet, image, (GAP + column * (cell.0 + GAP), top));
            }
        }
        let label = &rows[row as usize].label;
        font::write(&mut sheet, label, (GAP, top + cell.1 + 5), DOT, INK);
    }
    Ok(sheet)
}

fn check(columns: &[&str], rows: &[SheetRow], cell_width: u32) -> Result<()> {
    let problem = if columns.is_empty() || rows.is_empty() || cell_width == 0 {
        "expected at least one row, one column and one pixel".to_owned()
    } else if let Some(row) = rows.iter().find(|row| row.images.len() != columns.len()) {
        let (expected, found) = (columns.len(), row.images.len());
        format!(
            "expected {expected} pictures in row \"{}\", found {found}",
            row.label
        )
    } else if rows
        .iter()
        .all(|row| row.images.iter().all(Option::is_none))
    {
        "expected at least one picture, found none".to_owned()
    } else {
        return Ok(());
    };
    Err(Error::invalid("contact sheet", problem))
}

fn paste(sheet: &mut ColorImage, image: &ColorImage, (left, top): (u32, u32)) {
    for row in 0..image.height() {
        for column in 0..image.width() {
            sheet.set(left + column, top + row, image.get(column, row));
        }
    }
}

/// The picture averaged down to at most `width` pixels across.
fn fitted(image: &ColorImage, width: u32) -> ColorImage {
    if image.width() <= width {
        return image.clone();
    }
    let height = u64::from(image.height()) * u64::from(width) / u64::from(image.width());
    let height = u32::try_from(height).unwrap_or(image.height()).max(1);
    let span = |index: u32, count: u32, size: u32| {
        let edge = |index: u32| (u64::from(index) * u64::from(size) / u64::from(count)) as usize;
        edge(index)..edge(index + 1).max(edge(index) + 1)
    };
    let mut values = Vec::with_capacity(width as usize * height as usize);
    for row in 0..height {
        for column in 0..width {
            let rows = span(row, height, image.height());
            let columns = span(column, width, image.width());
            values.push(average(image, rows, columns));
        }
    }
    // The size matches by construction; the picture as it is would be the harmless answer.
    Raster::from_values(width, height, values).unwrap_or_else(|_| image.clone())
}

fn average(
    image: &ColorImage,
    rows: std::ops::Range<usize>,
    columns: std::ops::Range<usize>,
) -> [u8; 3] {
    let count = (rows.len() * columns.len()) as u64;
    let mut sums = [0u64; 3];
    for row in rows {
        let start = row * image.width() as usize;
        for pixel in &image.values()[start + columns.start..start + columns.end] {
            for (sum, &value) in sums.iter_mut().zip(pixel) {
                *sum += u64::from(value);
            }
        }
    }
    sums.map(|sum| u8::try_from((sum + count / 2) / count).unwrap_or(u8::MAX))
}

/// A depth map in colours: near light, far dark, black where there is no depth. The colours span
/// the 1st to the 99th percentile of this map's depths.
pub fn depth_image(depth: &DepthMap) -> ColorImage {
    let mut valid: Vec<f32> = depth
        .values()
        .iter()
        .copied()
        .filter(|&d| d > 0.0)
        .collect();
    valid.sort_by(f32::total_cmp);
    let at = |percent: usize| {
        let index = valid.len().saturating_sub(1) * percent / 100;
        valid.get(index).map_or(1.0, |&depth| f64::from(depth))
    };
    let (near, far) = (at(1), at(99));
    depth.raster().map(|&depth| {
        if depth > 0.0 {
            let span = (far - near).max(f64::MIN_POSITIVE);
            colormap::depth(1.0 - ((f64::from(depth) - near) / span).clamp(0.0, 1.0))
        } else {
            [0; 3]
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn flat(width: u32, height: u32, color: [u8; 3]) -> ColorImage {
        Raster::filled(width, height, color).unwrap()
    }

    #[test]
    fn pictures_stand_in_their_places_under_their_names() {
        let (red, blue) = (flat(40, 30, [200, 0, 0]), flat(80, 60, [0, 0, 200]));
        let row = |label: &str, images| SheetRow {
            label: label.into(),
            images,
        };
        let rows = [
            row("view 0", vec![Some(&red), Some(&blue)]),
            row("view 1", vec![None, Some(&red)]),
        ];
        let sheet = draw(&["input", "depth"], &rows, 40).unwrap();
        assert_eq!(sheet.size(), (8 + 2 * 48, 24 + 2 * (30 + 24)));
        assert_eq!(sheet.get(8, 24), [200, 0, 0]);
        assert_eq!(sheet.get(8 + 48, 24), [0, 0, 200]);
        assert_eq!(sheet.get(8 + 39, 24 + 54), PAPER, "no picture");
        assert_eq!(sheet.get(8 + 48 + 39, 24 + 54 + 29), [200, 0, 0]);
        let inked = |rows: std::ops::Range<u32>| {
            let pixels = rows.flat_map(|row| (0..104).map(move |column| (column, row)));
            pixels
                .filter(|&(column, row)| sheet.get(column, row) == INK)
                .count()
        };
        assert!(inked(0..24) > 100 && inked(54..78) > 100);
    }

    #[test]
    fn shrinking_averages() {
        let mut image = flat(4, 2, [0; 3]);
        image.set(0, 0, [200; 3]);
        image.set(3, 1, [100; 3]);
        let small = fitted(&image, 2);
        assert_eq!(small.size(), (2, 1));
        assert_eq!(small.values(), [[50; 3], [25; 3]]);
    }

    #[test]
    fn near_is_light_far_is_dark_and_nothing_is_black() {
        let values = (0..200)
            .map(|i| if i == 0 { 0.0 } else { 1.0 + i as f32 })
            .collect();
        let (depth, _) = DepthMap::from_values(200, 1, values).unwrap();
        let image = depth_image(&depth);
        assert_eq!(image.get(0, 0), [0; 3]);
        assert_eq!(image.get(1, 0), colormap::depth(1.0));
        assert_eq!(image.get(199, 0), colormap::depth(0.0));
        let (nothing, _) = DepthMap::from_values(2, 1, vec![0.0; 2]).unwrap();
        assert_eq!(depth_image(&nothing).values(), [[0; 3]; 2]);
    }

    #[test]
    fn uneven_rows_and_empty_sheets_are_refused() {
        let red = flat(4, 3, [200, 0, 0]);
        let row = |images| SheetRow {
            label: "a".into(),
            images,
        };
        let fails = |rows: &[SheetRow]| draw(&["x", "y"], rows, 10).unwrap_err().to_string();
        assert!(fails(&[]).contains("at least one row"));
        assert!(
            fails(&[row(vec![Some(&red)])]).contains("expected 2 pictures in row \"a\", found 1")
        );
        assert!(fails(&[row(vec![None, None])]).contains("found none"));
    }
}
