//! Measurements as rows: what is on the front, what a sentence says, how it lies in a CSV.

use super::clock::Cost;
use std::fmt::Write as _;
use std::io::Write;

/// One setting of one knob.
#[derive(Debug, Clone, PartialEq)]
pub struct Row {
    /// `score`, `fuse`, `render` or `blend`.
    pub stage: &'static str,
    /// What is turned.
    pub knob: String,
    /// To what.
    pub setting: String,
    /// Whether this is the setting that the stage's others are held against.
    pub exact: bool,
    /// Whether this is the default.
    pub default: bool,
    /// CPU time of one run in seconds, all threads, the median over stretches of runs; wall-clock time where
    /// the system does not tell.
    pub seconds: f64,
    /// The same of the fastest and the slowest stretch.
    pub range: (f64, f64),
    /// Largest resident memory of the process in MiB, inputs included.
    pub peak_mib: Option<f64>,
    /// What `value` is: `F`, or `RMSE` in 8-bit grey levels.
    pub measure: &'static str,
    /// The result at this setting.
    pub value: f64,
    /// `value` less the exact setting's.
    pub difference: f64,
    /// Half of the 95 % confidence interval of `difference`, where the setting draws a sample.
    pub half_width: Option<f64>,
    /// How far `value` is from what is right, with `half_width` on top: 1 where fused clouds are scored by F,
    /// the exact setting's value elsewhere.
    pub error: f64,
    /// Whether no setting of the stage has an error as small and is faster beyond the spread of times, or is as
    /// fast with a smaller error.
    pub front: bool,
}

/// What a setting gives, before it is held against the others.
pub(super) struct Measured {
    pub(super) knob: &'static str,
    pub(super) setting: String,
    pub(super) cost: Cost,
    pub(super) value: f64,
    pub(super) half_width: Option<f64>,
}

/// The rows of a stage. `measured[0]` is the exact setting, whose value is the right one where no other is;
/// `default` says which are the default.
pub(super) fn rows(
    (stage, measure): (&'static str, &'static str),
    right: Option<f64>,
    measured: Vec<Measured>,
    default: impl Fn(&str, &str) -> bool,
) -> Vec<Row> {
    let exact = measured.first().map_or(0.0, |first| first.value);
    let right = right.unwrap_or(exact);
    let mut rows: Vec<Row> = measured
        .into_iter()
        .enumerate()
        .map(|(index, one)| Row {
            stage,
            exact: index == 0,
            default: default(one.knob, &one.setting),
            knob: one.knob.to_owned(),
            setting: one.setting,
            seconds: one.cost.seconds,
            range: one.cost.range,
            peak_mib: one.cost.peak_mib,
            measure,
            value: one.value,
            difference: one.value - exact,
            half_width: one.half_width,
            error: (one.value - right).abs() + one.half_width.unwrap_or(0.0),
            front: false,
        })
        .collect();
    mark_front(&mut rows);
    rows
}

/// Marks the rows that no other row beats. Times within each other's spread are no difference.
fn mark_front(rows: &mut [Row]) {
    let beats = |other: &Row, row: &Row| {
        let is_sooner = other.range.1 < row.range.0;
        let is_nearer = other.error < row.error;
        (is_sooner && other.error <= row.error) || (is_nearer && other.seconds <= row.seconds)
    };
    let front: Vec<bool> = rows
        .iter()
        .map(|row| !rows.iter().any(|other| beats(other, row)))
        .collect();
    for (row, front) in rows.iter_mut().zip(front) {
        row.front = front;
    }
}

/// A sentence per knob, in the order of the rows.
pub fn sentences(rows: &[Row]) -> Vec<String> {
    let mut sentences: Vec<String> = Vec::new();
    let mut last = ("", "");
    for row in rows.iter().filter(|row| !row.exact) {
        let exact = rows
            .iter()
            .find(|other| other.stage == row.stage && other.exact);
        let Some(exact) = exact else { continue };
        let key = (row.stage, row.knob.as_str());
        if key == last
            && let Some(sentence) = sentences.last_mut()
        {
            let _ = write!(sentence, "; {}", clause(row, exact));
        } else {
            sentences.push(format!(
                "{}, {}: {}",
                row.stage,
                row.knob,
                clause(row, exact)
            ));
        }
        last = key;
    }
    sentences.iter_mut().for_each(|sentence| sentence.push('.'));
    sentences
}

fn clause(row: &Row, exact: &Row) -> String {
    let speed = exact.seconds / row.seconds;
    let as_fast = row.range.0 <= exact.range.1 && exact.range.0 <= row.range.1;
    let speed = if as_fast {
        "as fast".to_owned()
    } else if speed >= 1.0 {
        format!("{speed:.1}× faster")
    } else {
        format!("{:.1}× slower", 1.0 / speed)
    };
    let width = row
        .half_width
        .map(|width| format!(" ± {width:.4}"))
        .unwrap_or_default();
    let difference = if row.difference.total_cmp(&0.0).is_eq() && row.half_width.is_none() {
        format!("the same {}", row.measure)
    } else {
        format!("Δ{} = {:+.4}{width}", row.measure, row.difference)
    };
    let default = if row.default { " (default)" } else { "" };
    format!("{}{default}: {speed}, {difference}", row.setting)
}

/// Writes the rows as CSV with full precision.
pub(super) fn write_csv(out: &mut impl Write, rows: &[Row]) -> std::io::Result<()> {
    let mut writer = csv::Writer::from_writer(out);
    writer.write_record([
        "stage",
        "knob",
        "setting",
        "exact",
        "default",
        "seconds",
        "fastest",
        "slowest",
        "speedup",
        "peak_mib",
        "measure",
        "value",
        "difference",
        "half_width",
        "error",
        "front",
    ])?;
    for row in rows {
        let exact = rows
            .iter()
            .find(|other| other.stage == row.stage && other.exact);
        let speedup = exact.map_or(1.0, |exact| exact.seconds / row.seconds);
        let text = |value: Option<f64>| value.map(|value| value.to_string()).unwrap_or_default();
        let yes = |value: bool| if value { "yes" } else { "" }.to_owned();
        writer.write_record([
            row.stage.to_owned(),
            row.knob.clone(),
            row.setting.clone(),
            yes(row.exact),
            yes(row.default),
            row.seconds.to_string(),
            row.range.0.to_string(),
            row.range.1.to_string(),
            speedup.to_string(),
            text(row.peak_mib),
            row.measure.to_owned(),
            row.value.to_string(),
            row.difference.to_string(),
            text(row.half_width),
            row.error.to_string(),
            yes(row.front),
        ])?;
    }
    writer.flush()
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    fn one(knob: &'static str, setting: &str, seconds: f64, value: f64) -> Measured {
        Measured {
            knob,
            setting: setting.into(),
            cost: Cost {
                seconds,
                range: (0.95 * seconds, 1.02 * seconds),
                peak_mib: None,
            },
            value,
            half_width: None,
        }
    }

    fn drawn(setting: &str, seconds: f64, value: f64, width: f64) -> Measured {
        Measured {
            half_width: Some(width),
            ..one("queries", setting, seconds, value)
        }
    }

    pub(in super::super) fn some() -> Vec<Row> {
        let measured = vec![
            one("exact", "all", 2.0, 0.9),
            drawn("1/2", 1.0, 0.9007, 0.0004),
            drawn("1/4", 1.5, 0.91, 0.001),
            one("search", "bounded", 1.8, 0.9),
            one("search", "no end", 1.9, 0.9),
        ];
        rows(("score", "F"), None, measured, |knob, _| knob == "search")
    }

    fn on_front(rows: &[Row]) -> Vec<&str> {
        let front = rows.iter().filter(|row| row.front);
        front.map(|row| row.setting.as_str()).collect()
    }

    /// Nearly as fast is as fast: which of two comes first is noise.
    #[test]
    fn the_front_holds_what_nothing_beats() {
        assert_eq!(on_front(&some()), ["1/2", "bounded", "no end"]);
    }

    /// A draw that happens to come near the exact value is only as near as its interval says.
    #[test]
    fn luck_is_not_on_the_front() {
        let measured = vec![
            one("exact", "all", 2.0, 0.9),
            drawn("1/2", 1.0, 0.9002, 0.0003),
            drawn("1/64", 1.0, 0.9, 0.002),
        ];
        let rows = rows(("score", "F"), None, measured, |_, _| false);
        assert_eq!(on_front(&rows), ["all", "1/2"]);
        assert!((rows[1].error - 0.0005).abs() < 1e-12);
    }

    /// Of clouds that are scored against a truth the better one is better, not the one like the exact setting's.
    #[test]
    fn more_is_better_where_the_right_value_is_known() {
        let measured = vec![
            one("exact", "all", 2.0, 0.95),
            one("mode", "geo", 1.0, 0.98),
            one("mode", "gipuma", 1.5, 0.951),
        ];
        let rows = rows(("fuse", "F"), Some(1.0), measured, |_, _| false);
        assert_eq!(on_front(&rows), ["geo"]);
    }

    #[test]
    fn a_sentence_per_knob() {
        assert_eq!(
            sentences(&some()),
            [
                "score, queries: 1/2: 2.0× faster, ΔF = +0.0007 ± 0.0004; 1/4: 1.3× faster, ΔF = \
                 +0.0100 ± 0.0010.",
                "score, search: bounded (default): 1.1× faster, the same F; no end (default): as fast, \
                 the same F."
            ]
        );
    }

    #[test]
    fn rows_in_csv() {
        let mut bytes = Vec::new();
        write_csv(&mut bytes, &some()).unwrap();
        let text = String::from_utf8(bytes).unwrap();
        let second = text.lines().nth(2).unwrap();
        assert!(
            second.starts_with("score,queries,1/2,,,1,0.95,1.02,2,,F,0.9007,0.000"),
            "{second}"
        );
        assert!(second.ends_with(",yes"), "{second}");
    }
}
