//! Time against error, one panel per stage, as SVG.

use super::rows::Row;
use std::fmt::Write;

const PANEL: (f64, f64) = (440.0, 320.0);
const MARGIN: (f64, f64) = (56.0, 44.0);
const STYLE: &str = "text{font:12px system-ui,sans-serif;fill:#1d2733}.h{font-weight:600;font-size:14px}\
.s{fill:#5d6b7a;font-size:11px}.p{fill:#ffffff}.a{stroke:#5d6b7a;fill:none}.d{fill:#9aa7b4}\
.f{fill:#0369a1}.l{stroke:#0369a1;fill:none;stroke-dasharray:4 3}\
@media(prefers-color-scheme:dark){text{fill:#e8edf2}.p{fill:#14181d}.s{fill:#9aa7b4}.f{fill:#38bdf8}\
.l{stroke:#38bdf8}}";

/// The picture: across, time relative to the exact setting (logarithmic); up, |difference|
/// (logarithmic, with what is below a thousandth of the largest on the floor). Settings on the
/// Pareto front are filled and joined. `None` without rows.
pub(super) fn svg(rows: &[Row]) -> Option<String> {
    let mut stages: Vec<&str> = rows.iter().map(|row| row.stage).collect();
    stages.dedup();
    let columns = stages.len().min(2);
    let (width, height) = (
        PANEL.0 * columns as f64,
        PANEL.1 * stages.len().div_ceil(2) as f64,
    );
    let mut text = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\" role=\"img\" \
         aria-label=\"Error against time, by stage\">\n<style>{STYLE}</style>\n\
         <rect class=\"p\" width=\"{width}\" height=\"{height}\"/>\n"
    );
    for (index, stage) in stages.iter().enumerate() {
        let of_stage: Vec<&Row> = rows.iter().filter(|row| row.stage == *stage).collect();
        let (x, y) = (PANEL.0 * (index % 2) as f64, PANEL.1 * (index / 2) as f64);
        let _ = writeln!(text, "<g transform=\"translate({x} {y})\">");
        panel(&mut text, stage, &of_stage)?;
        text.push_str("</g>\n");
    }
    text.push_str("</svg>\n");
    (!stages.is_empty()).then_some(text)
}

/// Where a panel's dots lie, and what its axes say.
struct Axes {
    times: Vec<f64>,
    fastest: f64,
    slowest: f64,
    largest: f64,
}

impl Axes {
    fn of(rows: &[&Row], exact: &Row) -> Self {
        let times: Vec<f64> = rows.iter().map(|row| row.seconds / exact.seconds).collect();
        let differences = rows.iter().map(|row| row.difference.abs());
        Self {
            fastest: times.iter().copied().fold(1.0, f64::min),
            slowest: times.iter().copied().fold(1.0, f64::max),
            largest: differences.fold(0.0, f64::max),
            times,
        }
    }

    fn places(&self, rows: &[&Row]) -> Vec<(f64, f64)> {
        let (left, right) = ((0.8 * self.fastest).ln(), (1.25 * self.slowest).ln());
        let (across, up) = (PANEL.0 - MARGIN.0 - 20.0, PANEL.1 - 2.0 * MARGIN.1);
        let x = |time: f64| MARGIN.0 + across * (time.ln() - left) / (right - left);
        let y = |error: f64| {
            let share = if self.largest > 0.0 {
                1.0 + (error / self.largest).log10() / 3.0
            } else {
                0.0
            };
            PANEL.1 - MARGIN.1 - up * share.clamp(0.0, 1.0)
        };
        let rows = rows.iter().zip(&self.times);
        rows.map(|(row, &time)| (x(time), y(row.difference.abs())))
            .collect()
    }
}

fn panel(text: &mut String, stage: &str, rows: &[&Row]) -> Option<()> {
    let exact = rows.iter().find(|row| row.exact)?;
    let axes = Axes::of(rows, exact);
    let places = axes.places(rows);
    frame(text, (stage, exact.measure), &axes);
    dots(text, rows, &places);
    let mut front: Vec<(f64, f64)> = places
        .iter()
        .zip(rows)
        .filter(|(_, row)| row.front)
        .map(|(&at, _)| at)
        .collect();
    front.sort_by(|a, b| a.0.total_cmp(&b.0));
    let path: Vec<String> = front
        .iter()
        .map(|(x, y)| format!("{x:.1} {y:.1}"))
        .collect();
    let _ = writeln!(text, "<path class=\"l\" d=\"M{}\"/>", path.join("L"));
    Some(())
}

fn frame(text: &mut String, (stage, measure): (&str, &str), axes: &Axes) {
    let Axes {
        fastest,
        slowest,
        largest,
        ..
    } = axes;
    let (bottom, top) = (PANEL.1 - MARGIN.1, MARGIN.1);
    let _ = writeln!(
        text,
        "<text class=\"h\" x=\"{}\" y=\"24\">{stage}</text>\n\
         <path class=\"a\" d=\"M{} {top}V{bottom}H{}\"/>\n\
         <text class=\"s\" x=\"{}\" y=\"{}\" text-anchor=\"end\">time / exact: {fastest:.2} … {slowest:.2}</text>\n\
         <text class=\"s\" x=\"6\" y=\"{top}\">{largest:.1e}</text>\n\
         <text class=\"s\" x=\"6\" y=\"{bottom}\">≤{:.0e}</text>\n\
         <text class=\"s\" x=\"{}\" y=\"24\" text-anchor=\"end\">|Δ{measure}|</text>",
        MARGIN.0,
        MARGIN.0,
        PANEL.0 - 20.0,
        PANEL.0 - 20.0,
        PANEL.1 - 14.0,
        largest / 1000.0,
        PANEL.0 - 20.0,
    );
}

/// A dot per row, and names beside those that matter, where there is room.
fn dots(text: &mut String, rows: &[&Row], places: &[(f64, f64)]) {
    for (row, (x, y)) in rows.iter().zip(places) {
        let class = if row.front { "f" } else { "d" };
        let _ = writeln!(
            text,
            "<circle class=\"{class}\" cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"4.5\"><title>{}: {}</title></circle>",
            row.knob, row.setting
        );
    }
    let mut taken: Vec<Area> = places.iter().map(|&at| Area::around(at)).collect();
    for (row, &at) in rows.iter().zip(places) {
        if !(row.front || row.default) {
            continue;
        }
        let name = format!("{} {}", row.knob, row.setting);
        let Some(area) = Area::beside(at, &name, &taken) else {
            continue;
        };
        let _ = writeln!(
            text,
            "<text class=\"s\" x=\"{:.1}\" y=\"{:.1}\">{name}</text>",
            area.left,
            area.bottom - 3.0
        );
        taken.push(area);
    }
}

/// A rectangle of the panel.
#[derive(Debug, Clone, Copy)]
struct Area {
    left: f64,
    right: f64,
    top: f64,
    bottom: f64,
}

impl Area {
    /// That of a dot.
    fn around((x, y): (f64, f64)) -> Self {
        Self {
            left: x - 5.0,
            right: x + 5.0,
            top: y - 5.0,
            bottom: y + 5.0,
        }
    }

    /// The nearest place for a name beside a dot that covers nothing; none if there is none.
    fn beside((x, y): (f64, f64), name: &str, taken: &[Self]) -> Option<Self> {
        const HEIGHT: f64 = 13.0;
        #[allow(clippy::cast_precision_loss, reason = "a name's length")]
        let width = 5.9 * name.chars().count() as f64;
        let lifts = (0..6).flat_map(|step| [-1.0, 1.0].map(|sign| sign * HEIGHT * f64::from(step)));
        let places = lifts.flat_map(|lift| [x + 8.0, x - 8.0 - width].map(|left| (left, y + lift)));
        let areas = places.map(|(left, middle)| Self {
            left,
            right: left + width,
            top: middle - HEIGHT / 2.0,
            bottom: middle + HEIGHT / 2.0,
        });
        let inside = |area: &Self| {
            area.left > 4.0
                && area.right < PANEL.0 - 4.0
                && area.top > 30.0
                && area.bottom < PANEL.1 - 26.0
        };
        areas
            .filter(inside)
            .find(|area| !taken.iter().any(|other| area.overlaps(other)))
    }

    fn overlaps(&self, other: &Self) -> bool {
        self.left < other.right
            && other.left < self.right
            && self.top < other.bottom
            && other.top < self.bottom
    }
}

#[cfg(test)]
mod tests {
    use super::super::rows::tests::some;
    use super::*;

    #[test]
    fn every_row_has_its_place_and_the_front_is_filled() {
        let text = svg(&some()).unwrap();
        assert_eq!(text.matches("<circle class=\"f\"").count(), 2);
        assert_eq!(text.matches("<circle class=\"d\"").count(), 2);
        assert!(!text.contains("NaN") && !text.contains("inf"), "{text}");
        assert!(svg(&[]).is_none());
    }

    #[test]
    fn names_cover_neither_dots_nor_names() {
        let dots = [(100.0, 100.0), (104.0, 102.0), (108.0, 99.0), (90.0, 101.0)];
        let mut taken: Vec<Area> = dots.iter().map(|&at| Area::around(at)).collect();
        for &at in &dots {
            let area = Area::beside(at, "samples 16", &taken).unwrap();
            assert!(!taken.iter().any(|other| area.overlaps(other)));
            taken.push(area);
        }
        assert!(Area::beside((100.0, 100.0), &"long ".repeat(40), &taken).is_none());
    }
}
