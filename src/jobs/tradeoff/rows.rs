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
    /// CPU time of one run in seconds, all threads; wall-clock time where the system does not tell.
    pub seconds: f64,
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
    /// Whether no setting of the stage is as near and faster, or as fast and nearer.
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

/// The rows of a stage. `measured[0]` is the exact setting; `default` says which are the default.
pub(super) fn rows(
    (stage, measure): (&'static str, &'static str),
    measured: Vec<Measured>,
    default: impl Fn(&str, &str) -> bool,
) -> Vec<Row> {
    let exact = measured.first().map_or(0.0, |first| first.value);
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
            peak_mib: one.cost.peak_mib,
            measure,
            value: one.value,
            difference: one.value - exact,
            half_width: one.half_width,
            front: false,
        })
        .collect();
    mark_front(&mut rows);
    rows
}

/// Marks the rows that no other row beats in one of time and |difference| without losing in the
/// other.
fn mark_front(rows: &mut [Row]) {
    let points: Vec<(f64, f64)> = rows
        .iter()
        .map(|row| (row.seconds, row.difference.abs()))
        .collect();
    for (row, &(time, error)) in rows.iter_mut().zip(&points) {
        let beats = |&(t, e): &(f64, f64)| t <= time && e <= error && (t < time || e < error);
        row.front = !points.iter().any(beats);
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
    let speed = if speed >= 1.0 {
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
        "speedup",
        "peak_mib",
        "measure",
        "value",
        "difference",
        "half_width",
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
            speedup.to_string(),
            text(row.peak_mib),
            row.measure.to_owned(),
            row.value.to_string(),
            row.difference.to_string(),
            text(row.half_width),
            yes(row.front),
        ])?;
    }
    writer.flush()
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    pub(in super::super) fn some() -> Vec<Row> {
        let one = |knob, setting: &str, seconds, value, half_width| Measured {
            knob,
            setting: setting.into(),
            cost: Cost {
                seconds,
                peak_mib: None,
            },
            value,
            half_width,
        };
        let measured = vec![
            one("exact", "all", 2.0, 0.9, None),
            one("queries", "1/2", 1.0, 0.9007, Some(0.0004)),
            one("queries", "1/4", 1.5, 0.91, Some(0.001)),
            one("search", "bounded", 1.8, 0.9, None),
        ];
        rows(("score", "F"), measured, |knob, _| knob == "search")
    }

    #[test]
    fn the_front_holds_what_nothing_beats() {
        let front: Vec<bool> = some().iter().map(|row| row.front).collect();
        assert_eq!(
            front,
            [false, true, false, true],
            "bounded is exact and faster than all"
        );
    }

    #[test]
    fn a_sentence_per_knob() {
        assert_eq!(
            sentences(&some()),
            [
                "score, queries: 1/2: 2.0× faster, ΔF = +0.0007 ± 0.0004; 1/4: 1.3× faster, ΔF = \
                 +0.0100 ± 0.0010.",
                "score, search: bounded (default): 1.1× faster, the same F."
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
            second.starts_with("score,queries,1/2,,,1,2,,F,0.9007,0.000"),
            "{second}"
        );
        assert!(second.ends_with(",0.0004,yes"), "{second}");
    }
}
