//! Time against error, one panel per stage, as SVG.

use super::rows::Row;
use std::fmt::Write;

const PANEL: (f64, f64) = (440.0, 320.0);
const MARGIN: (f64, f64) = (56.0, 44.0);
const STYLE: &str = "text{font:12px system-ui,sans-serif;fill:#1d2733}.h{font-weight:600;font-size:14px}\
.s{fill:#5d6b7a;font-size:11px}.p{fill:#ffffff}.a{stroke:#5d6b7a;fill:none}.d{fill:#9aa7b4}\
.f{fill:#0369a1}.l{stroke:#0369a1;fill:none;stroke-dasharray:4 3}.t{stroke:#c8d0d8;fill:none}\
@media(prefers-color-scheme:dark){text{fill:#e8edf2}.p{fill:#14181d}.s{fill:#9aa7b4}.f{fill:#38bdf8}\
.l{stroke:#38bdf8}.t{stroke:#3a444f}}";

/// The picture: across, time relative to the exact setting (logarithmic); up, the error
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
        let errors = rows.iter().map(|row| row.error);
        Self {
            fastest: times.iter().copied().fold(1.0, f64::min),
            slowest: times.iter().copied().fold(1.0, f64::max),
            largest: errors.fold(0.0, f64::max),
            times,
        }
    }

    /// Where a time is, across.
    fn x(&self, time: f64) -> f64 {
        let (left, right) = (
            libm::log(0.8 * self.fastest),
            libm::log(1.25 * self.slowest),
        );
        let across = PANEL.0 - MARGIN.0 - 20.0;
        MARGIN.0 + across * (libm::log(time) - left) / (right - left)
    }

    /// Where an error is, up.
    fn y(&self, error: f64) -> f64 {
        let share = match self.largest > 0.0 {
            true => 1.0 + libm::log10(error / self.largest) / 3.0,
            false => 0.0,
        };
        PANEL.1 - MARGIN.1 - (PANEL.1 - 2.0 * MARGIN.1) * share.clamp(0.0, 1.0)
    }

    fn places(&self, rows: &[&Row]) -> Vec<(f64, f64)> {
        let rows = rows.iter().zip(&self.times);
        rows.map(|(row, &time)| (self.x(time), self.y(row.error)))
            .collect()
    }
}

/// The numbers 1, 2 and 5 times a power of ten, or the powers alone, within a range above 0.
fn ticks((low, high): (f64, f64), factors: &[f64]) -> Vec<f64> {
    #[allow(clippy::cast_possible_truncation, reason = "between -324 and 309")]
    let decade = |value: f64| libm::log10(value).floor() as i32;
    let decades = decade(low)..=decade(high);
    let all = decades.flat_map(|decade| {
        factors
            .iter()
            .map(move |factor| format!("{factor}e{decade}"))
    });
    let all = all.filter_map(|text| text.parse().ok());
    all.filter(|tick| (low..=high).contains(tick)).collect()
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
    let (left, right) = (MARGIN.0, PANEL.0 - 20.0);
    let (bottom, top) = (PANEL.1 - MARGIN.1, MARGIN.1);
    let up = match stage {
        "fuse" => format!("1 − {measure}"),
        "score" => format!("|Δ{measure}| with its ±"),
        _ => measure.to_owned(),
    };
    let _ = writeln!(
        text,
        "<text class=\"h\" x=\"{left}\" y=\"24\">{stage}</text>\n\
         <text class=\"s\" x=\"{right}\" y=\"24\" text-anchor=\"end\">{up} against time, logarithmic</text>\n\
         <text class=\"s\" x=\"{right}\" y=\"{}\" text-anchor=\"end\">CPU time, exact = 1</text>",
        PANEL.1 - 10.0,
    );
    let many = axes.slowest > 10.0 * axes.fastest;
    let factors: &[f64] = match many {
        true => &[1.0, 3.0],
        false => &[1.0, 1.5, 2.0, 3.0, 5.0, 7.0],
    };
    for time in ticks((0.8 * axes.fastest, 1.25 * axes.slowest), factors) {
        let _ = writeln!(
            text,
            "<path class=\"t\" d=\"M{0:.1} {top}V{bottom}\"/><text class=\"s\" x=\"{0:.1}\" y=\"{1}\" \
             text-anchor=\"middle\">{time}</text>",
            axes.x(time),
            bottom + 15.0,
        );
    }
    let floor = axes.largest / 1000.0;
    let errors = match axes.largest > 0.0 {
        true => ticks((2.0 * floor, axes.largest), &[1.0]),
        false => Vec::new(),
    };
    for error in errors {
        let _ = writeln!(
            text,
            "<path class=\"t\" d=\"M{left} {0:.1}H{right}\"/><text class=\"s\" x=\"{1}\" y=\"{2:.1}\" \
             text-anchor=\"end\">{error}</text>",
            axes.y(error),
            left - 6.0,
            axes.y(error) + 4.0,
        );
    }
    let _ = writeln!(
        text,
        "<path class=\"a\" d=\"M{left} {top}V{bottom}H{right}\"/>\n\
         <text class=\"s\" x=\"{}\" y=\"{}\" text-anchor=\"end\">≤{floor:.0e}</text>",
        left - 6.0,
        bottom + 4.0,
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
        if let Some(((x, y), (end, height))) = area.leader(at) {
            let _ = writeln!(
                text,
                "<path class=\"t\" d=\"M{x:.1} {y:.1}L{end:.1} {height:.1}\"/>"
            );
        }
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
            area.left > MARGIN.0 + 2.0
                && area.right < PANEL.0 - 4.0
                && area.top > 30.0
                && area.bottom < PANEL.1 - 26.0
        };
        areas
            .filter(inside)
            .find(|area| !taken.iter().any(|other| area.overlaps(other)))
    }

    /// From a dot to a name that does not stand right beside it.
    fn leader(&self, (x, y): (f64, f64)) -> Option<((f64, f64), (f64, f64))> {
        let middle = 0.5 * (self.top + self.bottom);
        let end = if self.left > x { self.left } else { self.right };
        ((middle - y).abs() > 1.0).then_some(((x, y), (end, middle)))
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
        assert_eq!(text.matches("<circle class=\"f\"").count(), 3);
        assert_eq!(text.matches("<circle class=\"d\"").count(), 2);
        assert!(!text.contains("NaN") && !text.contains("inf"), "{text}");
        assert!(svg(&[]).is_none());
    }

    #[test]
    fn ticks_are_round_and_inside() {
        assert_eq!(
            ticks((0.04, 2.5), &[1.0, 2.0, 5.0]),
            [0.05, 0.1, 0.2, 0.5, 1.0, 2.0]
        );
        assert_eq!(ticks((3e-5, 0.02), &[1.0]), [1e-4, 1e-3, 1e-2]);
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
