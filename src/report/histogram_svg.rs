//! How far points are from the other cloud, as bars, in one SVG.

use super::curve_svg::escaped;
use crate::error::{Error, Result};
use std::fmt::Write;

/// Bars per threshold and thresholds shown; one more bar holds everything beyond.
const BARS_PER_TAU: usize = 10;
const TAUS: usize = 4;

/// The share of `distances` in each tenth of `tau` up to 4 τ, and beyond. It follows the reader's
/// light or dark colour scheme.
///
/// # Errors
/// No distances, and a `tau` that is not finite and above 0.
pub fn svg(title: &str, distances: &[f64], tau: f64, unit: &str) -> Result<String> {
    if distances.is_empty() || !(tau > 0.0 && tau.is_finite()) {
        let problem = format!(
            "expected distances and a threshold above 0, found {} and {tau}",
            distances.len()
        );
        return Err(Error::invalid("histogram", problem));
    }
    let shares = shares(distances, tau);
    let tallest = shares.iter().copied().fold(f64::MIN_POSITIVE, f64::max);
    let (left, top, width, height) = (64.0, 56.0, 632.0, 200.0);
    let bar = width / shares.len() as f64;
    let title = escaped(title);
    let mut text = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 720 320\" role=\"img\" \
         aria-label=\"{title}\">\n<style>\n{STYLE}</style>\n\
         <rect class=\"page\" width=\"720\" height=\"320\" rx=\"8\"/>\n\
         <text class=\"title\" x=\"{left}\" y=\"32\">{title}</text>\n\
         <text class=\"end\" x=\"{}\" y=\"{}\">{:.1}%</text>\n",
        left - 8.0,
        top + 5.0,
        100.0 * tallest
    );
    for (index, share) in shares.iter().enumerate() {
        let class = if index < BARS_PER_TAU { "in" } else { "out" };
        let tall = height * share / tallest;
        let (x, y) = (left + bar * index as f64 + 1.0, top + height - tall);
        let _ = writeln!(
            text,
            "<rect class=\"{class}\" x=\"{x:.1}\" y=\"{y:.1}\" width=\"{:.1}\" height=\"{tall:.1}\"/>",
            bar - 2.0
        );
    }
    let bottom = top + height;
    let _ = writeln!(
        text,
        "<path class=\"axis\" d=\"M{left} {bottom}h{width}\"/>"
    );
    for multiple in 0..=TAUS {
        let x = left + bar * (BARS_PER_TAU * multiple) as f64;
        let label = match multiple {
            0 => "0".to_owned(),
            1 => "τ".to_owned(),
            more => format!("{more}τ"),
        };
        let _ = writeln!(
            text,
            "<text class=\"middle\" x=\"{x:.1}\" y=\"{}\">{label}</text>",
            bottom + 20.0
        );
    }
    let unit = if unit.is_empty() {
        String::new()
    } else {
        format!(" {}", escaped(unit))
    };
    let _ = writeln!(
        text,
        "<text class=\"middle\" x=\"{}\" y=\"{}\">distance to the other cloud, τ = {tau}{unit}; last bar: beyond {TAUS}τ</text>\n</svg>",
        left + width / 2.0,
        bottom + 46.0
    );
    Ok(text)
}

const STYLE: &str = "\
svg { --page: #ffffff; --ink: #1d2733; --soft: #5d6b7a; --in: #0369a1; --out: #c2410c; }
@media (prefers-color-scheme: dark) { svg { --page: #14181d; --ink: #e8edf2; --soft: #9aa7b4; --in: #38bdf8; --out: #fb923c; } }
text { font: 13px system-ui, sans-serif; fill: var(--soft); font-variant-numeric: tabular-nums; }
.title { font-size: 16px; font-weight: 600; fill: var(--ink); }
.page { fill: var(--page); } .in { fill: var(--in); } .out { fill: var(--out); }
.axis { stroke: var(--soft); fill: none; } .middle { text-anchor: middle; } .end { text-anchor: end; }
";

fn shares(distances: &[f64], tau: f64) -> Vec<f64> {
    let bars = BARS_PER_TAU * TAUS + 1;
    let mut counts = vec![0usize; bars];
    for &distance in distances {
        #[allow(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "the cast saturates; the last bar takes what is beyond, NaN too"
        )]
        let bar = if distance.is_nan() {
            bars
        } else {
            (distance / tau * BARS_PER_TAU as f64).max(0.0) as usize
        };
        counts[bar.min(bars - 1)] += 1;
    }
    counts
        .iter()
        .map(|&count| count as f64 / distances.len() as f64)
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_distance_is_in_one_bar() {
        let shares = shares(&[0.0, 0.05, 0.1001, 0.95, 1.0, 3.99, 4.0, 1e9], 1.0);
        let expected = [
            (0, 0.25),
            (1, 0.125),
            (9, 0.125),
            (10, 0.125),
            (39, 0.125),
            (40, 0.25),
        ];
        for (bar, share) in expected {
            assert_eq!(shares[bar], share, "bar {bar}");
        }
        assert_eq!(shares.iter().sum::<f64>(), 1.0);
    }

    #[test]
    fn a_histogram_of_nothing_is_refused() {
        assert!(svg("", &[], 1.0, "").is_err() && svg("", &[1.0], 0.0, "").is_err());
        let text = svg("a < b", &[0.5, 1.5], 1.0, "m").unwrap();
        assert!(text.contains("a &lt; b") && text.matches("class=\"in\"").count() == 10);
    }
}
