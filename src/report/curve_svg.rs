//! Precision, recall and F-score over distance as one SVG, the same bytes for the same numbers.

use crate::error::{Error, Result};
use std::fmt::Write;

/// The most points drawn of a curve; more are thinned evenly.
const MOST_POINTS: usize = 260;
/// The size of the picture and the rectangle of the plot in it.
pub(super) const SIZE: (f64, f64) = (720.0, 440.0);
pub(super) const PLOT: (f64, f64, f64, f64) = (64.0, 56.0, 540.0, 320.0);

/// What is drawn. The three slices have one value per distance; distances ascend from about 0.
#[derive(Debug, Clone, Copy)]
pub struct Curves<'a> {
    /// One line above the plot.
    pub title: &'a str,
    /// The threshold, marked by a line; the plot reaches to the last distance, 5 τ as a rule.
    pub tau: f64,
    /// Precision and recall at the threshold as they were scored, 0 to 1. The curves' bins may count points
    /// that lie exactly at the threshold, which scores do not.
    pub at_tau: (f64, f64),
    /// The unit of distances; may be empty.
    pub unit: &'a str,
    /// Distances in `unit`.
    pub distances: &'a [f64],
    /// Fraction of the reconstruction nearer than the distance, 0 to 1.
    pub precision: &'a [f64],
    /// Fraction of the truth nearer than the distance, 0 to 1.
    pub recall: &'a [f64],
}

/// What stands where, in the picture's units: shared by the SVG and the PNG.
pub(super) struct Plot {
    /// Horizontal lines: y and the label at its left.
    pub(super) rows: Vec<(f64, String)>,
    /// Vertical lines: x, the label below it, and whether it marks the threshold.
    pub(super) columns: Vec<(f64, String, bool)>,
    /// The text below the plot.
    pub(super) caption: String,
    /// Where the curves' dots are along x.
    pub(super) at_tau: f64,
    /// F-score, precision and recall.
    pub(super) lines: [Line; 3],
}

/// One curve.
pub(super) struct Line {
    pub(super) class: &'static str,
    pub(super) name: &'static str,
    pub(super) points: Vec<(f64, f64)>,
    pub(super) y_at_tau: f64,
    /// The value at the threshold.
    pub(super) percent: String,
}

/// Lays the plot out. Fails as [`svg`] does.
pub(super) fn plot(curves: &Curves) -> Result<Plot> {
    check(curves)?;
    let pairs = curves.precision.iter().zip(curves.recall);
    let f_score: Vec<f64> = pairs.map(|(&p, &r)| harmonic(p, r)).collect();
    let end = curves.distances[curves.distances.len() - 1];
    let (precision, recall) = curves.at_tau;
    let line = |class, name, values: &[f64], at_tau: f64| Line {
        class,
        name,
        points: polyline(curves.distances, values, end),
        y_at_tau: y_of(at_tau),
        percent: format!("{:.2}%", 100.0 * at_tau),
    };
    let fifths = (0..=5).map(|fifth| f64::from(fifth) / 5.0);
    let unit = match curves.unit {
        "" => String::new(),
        unit => format!(" {unit}"),
    };
    Ok(Plot {
        rows: fifths
            .map(|f| (y_of(f), format!("{:.0}%", 100.0 * f)))
            .collect(),
        columns: columns(curves.tau, end),
        caption: format!("distance to the other cloud, τ = {}{unit}", curves.tau),
        at_tau: x_of(curves.tau.min(end), end),
        lines: [
            line("f", "F-score", &f_score, harmonic(precision, recall)),
            line("p", "precision", curves.precision, precision),
            line("r", "recall", curves.recall, recall),
        ],
    })
}

/// A line per multiple of the threshold.
fn columns(tau: f64, end: f64) -> Vec<(f64, String, bool)> {
    let inside = |multiple: &u32| f64::from(*multiple) * tau <= end * 1.005;
    let column = |multiple: u32| {
        let label = match multiple {
            0 => "0".to_owned(),
            1 => "τ".to_owned(),
            _ => format!("{multiple}τ"),
        };
        let x = x_of((f64::from(multiple) * tau).min(end), end);
        (x, label, multiple == 1)
    };
    (0..=20).take_while(inside).map(column).collect()
}

/// The picture. It follows the reader's light or dark colour scheme.
///
/// # Errors
/// Slices that differ in length or hold fewer than two values, distances that are not finite, do not ascend or end at
/// 0 or below, fractions that are not from 0 to 1, and a threshold that is not finite and above 0.
pub fn svg(curves: &Curves) -> Result<String> {
    let plot = plot(curves)?;
    let mut text = head(curves.title);
    axes(&mut text, &plot);
    for line in plot.lines.iter().rev() {
        let (class, path) = (line.class, path_of(&line.points));
        put(
            &mut text,
            format_args!("<path class=\"line {class}\" d=\"{path}\"/>"),
        );
    }
    labels(&mut text, &plot);
    text.push_str("</svg>\n");
    Ok(text)
}

fn check(curves: &Curves) -> Result<()> {
    let count = curves.distances.len();
    let lengths = [curves.precision.len(), curves.recall.len()];
    if count < 2 || lengths != [count; 2] {
        let problem = format!(
            "expected as many precisions and recalls as distances and at least 2, found {}, {} and {count}",
            lengths[0], lengths[1]
        );
        return Err(Error::invalid("curves", problem));
    }
    let (precision, recall) = curves.at_tau;
    let fractions = curves.precision.iter().chain(curves.recall);
    let mut fractions = fractions.chain([&precision, &recall]);
    let ascending = curves.distances.windows(2).all(|pair| pair[0] < pair[1]);
    let finite = curves.distances.iter().all(|distance| distance.is_finite());
    let positive = curves.distances[count - 1] > 0.0 && curves.tau > 0.0 && curves.tau.is_finite();
    if !(ascending && finite && positive && fractions.all(|f| (0.0..=1.0).contains(f))) {
        let problem = "expected ascending distances, a threshold above 0 and fractions from 0 to 1";
        return Err(Error::invalid("curves", problem));
    }
    Ok(())
}

fn harmonic(precision: f64, recall: f64) -> f64 {
    if precision + recall > 0.0 {
        2.0 * precision * recall / (precision + recall)
    } else {
        0.0
    }
}

/// Appends a line. Writing to a `String` cannot fail.
fn put(text: &mut String, line: std::fmt::Arguments) {
    let _ = text.write_fmt(line);
    text.push('\n');
}

fn head(title: &str) -> String {
    let (width, height) = SIZE;
    let title = escaped(title);
    format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\" role=\"img\" \
         aria-label=\"{title}\">\n<style>\n{STYLE}</style>\n\
         <rect class=\"page\" width=\"{width}\" height=\"{height}\" rx=\"8\"/>\n\
         <text class=\"title\" x=\"{}\" y=\"32\">{title}</text>\n",
        PLOT.0
    )
}

const STYLE: &str = "\
svg { --page: #ffffff; --ink: #1d2733; --soft: #5d6b7a; --grid: #e3e8ed; --f: #1b1f24; --p: #c2410c; --r: #0369a1; }
@media (prefers-color-scheme: dark) {
svg { --page: #14181d; --ink: #e8edf2; --soft: #9aa7b4; --grid: #2a323b; --f: #f5f7fa; --p: #fb923c; --r: #38bdf8; } }
text { font: 13px system-ui, sans-serif; fill: var(--soft); font-variant-numeric: tabular-nums; }
.title { font-size: 16px; font-weight: 600; fill: var(--ink); }
.page { fill: var(--page); }
.grid { stroke: var(--grid); stroke-width: 1; fill: none; }
.tau { stroke: var(--soft); stroke-width: 1.25; stroke-dasharray: 4 4; }
.line { fill: none; stroke-width: 2.25; stroke-linejoin: round; stroke-linecap: round; }
.f { stroke: var(--f); } .p { stroke: var(--p); } .r { stroke: var(--r); } .line.r { stroke-dasharray: 7 4; }
.dot { stroke: var(--page); stroke-width: 1.5; }
.dot.f { fill: var(--f); } .dot.p { fill: var(--p); } .dot.r { fill: var(--r); }
text.f { fill: var(--f); font-weight: 600; stroke: none; } text.p { fill: var(--p); stroke: none; } text.r { fill: var(--r); stroke: none; }
.end { text-anchor: end; } .middle { text-anchor: middle; }
";

fn x_of(distance: f64, end: f64) -> f64 {
    PLOT.0 + PLOT.2 * distance / end
}

fn y_of(fraction: f64) -> f64 {
    PLOT.1 + PLOT.3 * (1.0 - fraction)
}

fn axes(text: &mut String, plot: &Plot) {
    let (left, top, width, height) = PLOT;
    let (right, bottom) = (left + width, top + height);
    for (y, label) in &plot.rows {
        put(
            text,
            format_args!("<path class=\"grid\" d=\"M{left} {y:.1}H{right}\"/>"),
        );
        let (x, y) = (left - 8.0, y + 4.5);
        put(
            text,
            format_args!("<text class=\"end\" x=\"{x}\" y=\"{y:.1}\">{label}</text>"),
        );
    }
    for (x, label, is_tau) in &plot.columns {
        let class = if *is_tau { "tau" } else { "grid" };
        put(
            text,
            format_args!("<path class=\"{class}\" d=\"M{x:.1} {top}V{bottom}\"/>"),
        );
        let y = bottom + 20.0;
        put(
            text,
            format_args!("<text class=\"middle\" x=\"{x:.1}\" y=\"{y}\">{label}</text>"),
        );
    }
    let (x, y, caption) = (left + width / 2.0, bottom + 46.0, escaped(&plot.caption));
    put(
        text,
        format_args!("<text class=\"middle\" x=\"{x}\" y=\"{y}\">{caption}</text>"),
    );
}

/// At most [`MOST_POINTS`] points of a curve and its last, in the picture's units.
fn polyline(distances: &[f64], values: &[f64], end: f64) -> Vec<(f64, f64)> {
    let step = distances.len().div_ceil(MOST_POINTS);
    let last = distances.len() - 1;
    let indices = (0..last).step_by(step).chain([last]);
    indices
        .map(|index| (x_of(distances[index].max(0.0), end), y_of(values[index])))
        .collect()
}

fn path_of(points: &[(f64, f64)]) -> String {
    let mut path = String::new();
    for (index, (x, y)) in points.iter().enumerate() {
        let command = if index == 0 { 'M' } else { 'L' };
        let _ = write!(path, "{command}{x:.1} {y:.1}");
    }
    path
}

/// Values at the threshold: a dot on each curve and the numbers at the right, spread apart.
fn labels(text: &mut String, plot: &Plot) {
    for line in plot.lines.iter().rev() {
        let (class, x, y) = (line.class, plot.at_tau, line.y_at_tau);
        put(
            text,
            format_args!("<circle class=\"dot {class}\" cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"4.5\"/>"),
        );
    }
    let right = PLOT.0 + PLOT.2 + 14.0;
    put(
        text,
        format_args!("<text x=\"{right}\" y=\"{:.1}\">at τ</text>", PLOT.1 + 8.0),
    );
    for (row, line) in (0u32..).zip(&plot.lines) {
        let (class, name, percent) = (line.class, line.name, &line.percent);
        let y = PLOT.1 + 32.0 + 40.0 * f64::from(row);
        put(
            text,
            format_args!("<text class=\"{class}\" x=\"{right}\" y=\"{y:.1}\">{name}</text>"),
        );
        let y = y + 17.0;
        put(
            text,
            format_args!("<text class=\"{class}\" x=\"{right}\" y=\"{y:.1}\">{percent}</text>"),
        );
    }
}

/// Text that XML leaves alone.
pub(super) fn escaped(text: &str) -> String {
    let mut safe = String::with_capacity(text.len());
    for character in text.chars() {
        match character {
            '&' => safe.push_str("&amp;"),
            '<' => safe.push_str("&lt;"),
            '>' => safe.push_str("&gt;"),
            '"' => safe.push_str("&quot;"),
            '\'' => safe.push_str("&#39;"),
            control if control.is_control() => safe.push(' '),
            other => safe.push(other),
        }
    }
    safe
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample() -> (Vec<f64>, Vec<f64>, Vec<f64>) {
        let distances: Vec<f64> = (1..500).map(|i| f64::from(i) * 1e-4).collect();
        let rising = |scale: f64| distances.iter().map(|d| 1.0 - (-d / scale).exp()).collect();
        let (precision, recall) = (rising(0.004), rising(0.012));
        (distances, precision, recall)
    }

    fn drawn() -> String {
        drawn_with((1.0 - (-2.5f64).exp(), 1.0 - (-1.0 / 1.2f64).exp()))
    }

    fn drawn_with(at_tau: (f64, f64)) -> String {
        let (distances, precision, recall) = sample();
        let curves = Curves {
            title: "Barn <method & \"co\">",
            tau: 0.01,
            at_tau,
            unit: "m",
            distances: &distances,
            precision: &precision,
            recall: &recall,
        };
        svg(&curves).unwrap()
    }

    /// Where points lie exactly at the threshold, a curve's bin there may count them, scores never do.
    #[test]
    fn numbers_at_tau_are_the_scores_where_the_curves_say_otherwise() {
        let text = drawn_with((0.25, 0.75));
        for value in ["25.00%", "75.00%", "37.50%"] {
            assert!(text.contains(&format!(">{value}<")), "{value}");
        }
        let y = format!("cy=\"{:.1}\"", y_of(0.25));
        assert!(text.contains(&y));
    }

    #[test]
    fn numbers_at_tau_are_the_curves_own() {
        let text = drawn();
        let (p, r) = (1.0 - (-2.5f64).exp(), 1.0 - (-1.0 / 1.2f64).exp());
        for value in [p, r, 2.0 * p * r / (p + r)] {
            assert!(
                text.contains(&format!(">{:.2}%<", 100.0 * value)),
                "{value}"
            );
        }
        assert_eq!(text.matches("class=\"tau\"").count(), 1);
        assert!(text.contains("Barn &lt;method &amp; &quot;co&quot;&gt;"));
    }

    #[test]
    fn curves_start_and_end_where_the_numbers_do() {
        let text = drawn();
        let line = text.lines().find(|line| line.contains("line p")).unwrap();
        let first = format!(
            "M{:.1} {:.1}L",
            x_of(1e-4, 0.0499),
            y_of(1.0 - (-0.025f64).exp())
        );
        let last = format!("{:.1} {:.1}\"/>", 604.0, y_of(1.0 - (-12.475f64).exp()));
        assert!(line.contains(&first) && line.ends_with(&last), "{line}");
        assert!(line.matches('L').count() <= MOST_POINTS);
    }

    #[test]
    fn what_is_no_curve_is_refused() {
        let fails = |distances: &[f64], precision: &[f64], recall: &[f64]| {
            let curves = Curves {
                title: "",
                tau: 1.0,
                at_tau: (0.5, 0.5),
                unit: "",
                distances,
                precision,
                recall,
            };
            svg(&curves).unwrap_err().to_string()
        };
        assert!(fails(&[1.0], &[0.5], &[0.5]).contains("found 1, 1 and 1"));
        assert!(fails(&[1.0, 2.0], &[0.5], &[0.5, 0.6]).contains("found 1, 2 and 2"));
        assert!(fails(&[1.0, 1.0], &[0.5, 0.5], &[0.5, 0.6]).contains("ascending"));
        assert!(fails(&[1.0, 2.0], &[0.5, f64::NAN], &[0.5, 0.6]).contains("fractions"));
    }
}
