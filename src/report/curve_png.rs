//! The plot of [`curve_svg`] as pixels, the same bytes for the same numbers.

use super::canvas;
use super::curve_svg::{self, Curves, PLOT, SIZE};
use super::font;
use crate::error::Result;
use mvs_datasets::scene::{ColorImage, Raster};

/// Pixels per unit of the SVG.
const ZOOM: f64 = 2.0;
/// Pixels per dot of the font: labels, and the title.
const DOT: u32 = 2;
const TITLE_DOT: u32 = 3;
/// Colours, 8-bit sRGB: those of the SVG's light scheme.
const PAGE: [u8; 3] = [255, 255, 255];
const INK: [u8; 3] = [29, 39, 51];
const SOFT: [u8; 3] = [93, 107, 122];
const GRID: [u8; 3] = [227, 232, 237];
/// Of F-score, precision and recall.
const LINES: [[u8; 3]; 3] = [[27, 31, 36], [194, 65, 12], [3, 105, 161]];

/// Where a text's given corner is along x.
#[derive(Clone, Copy)]
enum Anchor {
    Start,
    Middle,
    End,
}

/// The picture, 1440 × 880 pixels.
///
/// # Errors
/// As [`curve_svg::svg`].
pub fn image(curves: &Curves) -> Result<ColorImage> {
    let plot = curve_svg::plot(curves)?;
    let pixels = |length: f64| {
        #[allow(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "a constant size"
        )]
        let pixels = (ZOOM * length) as u32;
        pixels
    };
    let mut picture = Raster::filled(pixels(SIZE.0), pixels(SIZE.1), PAGE)?;
    let title_at = (PLOT.0, 20.0);
    text(
        &mut picture,
        curves.title,
        title_at,
        (Anchor::Start, TITLE_DOT, INK),
    );
    axes(&mut picture, &plot);
    for (values, ink) in plot.lines.iter().zip(LINES).rev() {
        let points: Vec<(f64, f64)> = values.points.iter().map(|&at| zoomed(at)).collect();
        canvas::line(&mut picture, &points, ZOOM * 2.25, ink);
    }
    labels(&mut picture, &plot);
    Ok(picture)
}

fn zoomed((x, y): (f64, f64)) -> (f64, f64) {
    (ZOOM * x, ZOOM * y)
}

fn axes(picture: &mut ColorImage, plot: &curve_svg::Plot) {
    let (left, top, width, height) = PLOT;
    let (right, bottom) = (left + width, top + height);
    for (y, label) in &plot.rows {
        let ends = [zoomed((left, *y)), zoomed((right, *y))];
        canvas::line(picture, &ends, ZOOM, GRID);
        text(
            picture,
            label,
            (left - 8.0, y - 3.5),
            (Anchor::End, DOT, SOFT),
        );
    }
    for (x, label, is_tau) in &plot.columns {
        let ends = [zoomed((*x, top)), zoomed((*x, bottom))];
        if *is_tau {
            canvas::dashes(picture, ends, ZOOM * 4.0, (ZOOM * 1.25, SOFT));
        } else {
            canvas::line(picture, &ends, ZOOM, GRID);
        }
        text(
            picture,
            label,
            (*x, bottom + 10.0),
            (Anchor::Middle, DOT, SOFT),
        );
    }
    let middle = (left + width / 2.0, bottom + 36.0);
    text(picture, &plot.caption, middle, (Anchor::Middle, DOT, SOFT));
}

/// A dot on each curve at the threshold, and the numbers there.
fn labels(picture: &mut ColorImage, plot: &curve_svg::Plot) {
    for (line, ink) in plot.lines.iter().zip(LINES).rev() {
        let centre = zoomed((plot.at_tau, line.y_at_tau));
        canvas::disc(picture, centre, ZOOM * 5.5, PAGE);
        canvas::disc(picture, centre, ZOOM * 4.5, ink);
    }
    let right = PLOT.0 + PLOT.2 + 14.0;
    text(picture, "at τ", (right, PLOT.1), (Anchor::Start, DOT, SOFT));
    for (row, (line, ink)) in (0u32..).zip(plot.lines.iter().zip(LINES)) {
        let y = PLOT.1 + 24.0 + 40.0 * f64::from(row);
        text(picture, line.name, (right, y), (Anchor::Start, DOT, ink));
        text(
            picture,
            &line.percent,
            (right, y + 15.0),
            (Anchor::Start, DOT, ink),
        );
    }
}

/// Writes a text whose top is at `y` of the SVG's units.
fn text(
    picture: &mut ColorImage,
    text: &str,
    (x, y): (f64, f64),
    (anchor, dot, ink): (Anchor, u32, [u8; 3]),
) {
    let width = f64::from(font::width(text, dot));
    let left = match anchor {
        Anchor::Start => ZOOM * x,
        Anchor::Middle => ZOOM * x - 0.5 * width,
        Anchor::End => ZOOM * x - width,
    };
    #[allow(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "places in a picture; a negative one becomes 0"
    )]
    let at = (left.floor() as u32, (ZOOM * y).floor() as u32);
    font::write(picture, text, at, dot, ink);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn curves_run_where_the_numbers_say_and_the_threshold_is_marked() {
        let distances: Vec<f64> = (1..500).map(|i| f64::from(i) * 1e-4).collect();
        let precision = vec![0.75; 499];
        let recall: Vec<f64> = distances.iter().map(|d| d / 0.05).collect();
        let curves = Curves {
            title: "Barn",
            tau: 0.01,
            at_tau: (0.75, 0.2),
            unit: "m",
            distances: &distances,
            precision: &precision,
            recall: &recall,
        };
        let picture = image(&curves).unwrap();
        assert_eq!(picture.size(), (1440, 880));
        // Units of the SVG to pixels: the plot is 540 × 320 at (64, 56).
        let at = |distance: f64, fraction: f64| {
            let x = 2.0 * (64.0 + 540.0 * distance / 0.0499);
            let y = 2.0 * (56.0 + 320.0 * (1.0 - fraction));
            picture.get(x as u32, y as u32)
        };
        assert_eq!(at(0.03, 0.75), LINES[1]);
        assert_eq!(at(0.025, 0.5), LINES[2]);
        assert_eq!(at(0.035, 0.9), PAGE);
        assert_eq!(at(0.01, 0.75), LINES[1], "the dot at the threshold");
        let dashed = (0..100)
            .map(|i| at(0.01, f64::from(i) / 100.0))
            .filter(|&p| p == SOFT);
        assert!((20..70).contains(&dashed.count()));
        assert_eq!(image(&curves).unwrap(), picture);
    }
}
