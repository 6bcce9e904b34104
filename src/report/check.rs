//! Recomputes what a published table derives: F-scores from precision and recall, averages from
//! scenes. A number is a slip when no unrounded values that print as the table's could give it.

use mvs_datasets::FormatError;
use std::collections::BTreeMap;
use std::io::Read;

/// A printed number: what it says and by how much rounding may have moved it.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Printed {
    value: f64,
    half_unit: f64,
}

/// A printed number that does not follow from the others.
#[derive(Debug, Clone, PartialEq)]
pub struct Slip {
    /// The method.
    pub method: String,
    /// The metric: `precision`, `recall` or `F-score`.
    pub metric: String,
    /// The scene, or the average's column.
    pub column: String,
    /// What is printed, in the table's own scale.
    pub printed: f64,
    /// What follows from the table's other numbers.
    pub expected: f64,
}

impl std::fmt::Display for Slip {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let source = if self.metric == F_SCORE && !is_average(&self.column) {
            "its precision and recall give"
        } else {
            "its scenes average"
        };
        write!(
            f,
            "{}, {}, {}: printed {}, {source} {:.4}",
            self.method, self.metric, self.column, self.printed, self.expected
        )
    }
}

/// What was checked and what was found.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Checked {
    /// Numbers that do not follow, in the table's order.
    pub slips: Vec<Slip>,
    /// F-scores that were recomputed.
    pub f_scores: usize,
    /// Averages that were recomputed.
    pub averages: usize,
    /// Derived numbers that could not be recomputed, because what they derive from is not there.
    pub unchecked: usize,
}

const F_SCORE: &str = "F-score";

type Rows = BTreeMap<(usize, String), BTreeMap<String, Vec<Option<Printed>>>>;

/// Checks a table in the papers' form, as CSV: columns `method` and `metric`, then one per scene,
/// then if present `Average`. Columns before `method` are passed over, lines that begin with `#`
/// too. Empty cells and dashes are missing. Fractions and percents are told apart by whether any
/// number is above 1.
pub fn check(source: impl Read) -> Result<Checked, FormatError> {
    let mut reader = csv::ReaderBuilder::new()
        .comment(Some(b'#'))
        .from_reader(source);
    let broken = |error: csv::Error| FormatError::new("table", error.to_string());
    let header = reader.headers().map_err(broken)?.clone();
    let place = |name: &str| {
        let found = header
            .iter()
            .position(|column| column.eq_ignore_ascii_case(name));
        found.ok_or_else(|| {
            FormatError::new("header", format!("expected a column {name}, found none"))
        })
    };
    let (method, metric) = (place("method")?, place("metric")?);
    let first = method.max(metric) + 1;
    let columns: Vec<&str> = header.iter().skip(first).collect();
    let mut order: Vec<String> = Vec::new();
    let mut rows = Rows::new();
    for row in reader.records() {
        let row = row.map_err(broken)?;
        let line = row.position().map_or(0, csv::Position::line);
        let name = row.get(method).unwrap_or_default().to_owned();
        let number = order
            .iter()
            .position(|known| *known == name)
            .unwrap_or_else(|| {
                order.push(name.clone());
                order.len() - 1
            });
        let values: Vec<Option<Printed>> = row
            .iter()
            .skip(first)
            .map(parsed)
            .collect::<Result<_, String>>()
            .map_err(|problem| FormatError::new(format!("line {line}"), problem))?;
        let metric = metric_of(row.get(metric).unwrap_or_default(), line)?;
        let of_method = rows.entry((number, name)).or_default();
        if of_method.insert(metric.clone(), values).is_some() {
            let problem =
                format!("expected one row per method and metric, found a second {metric}");
            return Err(FormatError::new(format!("line {line}"), problem));
        }
    }
    Ok(checked(&columns, &rows))
}

fn is_average(column: &str) -> bool {
    ["average", "mean", "avg"]
        .iter()
        .any(|name| column.eq_ignore_ascii_case(name))
}

fn metric_of(name: &str, line: u64) -> Result<String, FormatError> {
    let known = match name
        .to_ascii_lowercase()
        .replace(['-', '_', ' '], "")
        .as_str()
    {
        "precision" | "p" => "precision",
        "recall" | "r" => "recall",
        "fscore" | "f" | "f1" => F_SCORE,
        _ => {
            let problem = format!("expected the metric precision, recall or F-score, found {name}");
            return Err(FormatError::new(format!("line {line}"), problem));
        }
    };
    Ok(known.to_owned())
}

/// A cell; `None` when it is empty or a dash.
fn parsed(cell: &str) -> Result<Option<Printed>, String> {
    let text = cell.trim().trim_end_matches('%').trim_end();
    if ["", "-", "–", "—"].contains(&text) {
        return Ok(None);
    }
    let value: f64 = text
        .parse()
        .map_err(|_| format!("expected a number, found {cell}"))?;
    if !value.is_finite() || value < 0.0 {
        return Err(format!("expected a number from 0 up, found {cell}"));
    }
    let decimals = text.split_once('.').map_or(0, |(_, digits)| digits.len());
    let half_unit = 0.5 * 0.1f64.powi(i32::try_from(decimals).unwrap_or(i32::MAX));
    Ok(Some(Printed { value, half_unit }))
}

fn checked(columns: &[&str], rows: &Rows) -> Checked {
    let mut result = Checked::default();
    for ((_, method), metrics) in rows {
        let mut note = |metric: &str, column: &str, printed: Printed, range: Option<(f64, f64)>| {
            let Some((low, high)) = range else {
                result.unchecked += 1;
                return;
            };
            if is_average(column) {
                result.averages += 1;
            } else {
                result.f_scores += 1;
            }
            // A hair for the decimal numbers' own binary rounding.
            let slack = printed.half_unit * (1.0 + 1e-9);
            if printed.value + slack < low || printed.value - slack > high {
                result.slips.push(Slip {
                    method: method.clone(),
                    metric: metric.to_owned(),
                    column: column.to_owned(),
                    printed: printed.value,
                    expected: 0.5 * (low + high),
                });
            }
        };
        for (metric, values) in metrics {
            for (index, (column, printed)) in columns.iter().zip(values).enumerate() {
                let Some(printed) = *printed else { continue };
                if is_average(column) {
                    note(metric, column, printed, mean_range(columns, values));
                } else if metric == F_SCORE {
                    let at = |name: &str| *metrics.get(name)?.get(index)?;
                    note(
                        metric,
                        column,
                        printed,
                        f_range(at("precision"), at("recall")),
                    );
                }
            }
        }
    }
    result
}

/// The averages that the scenes' unrounded values could have; `None` when a scene is missing.
fn mean_range(columns: &[&str], values: &[Option<Printed>]) -> Option<(f64, f64)> {
    let scenes = columns
        .iter()
        .zip(values)
        .filter(|(column, _)| !is_average(column));
    let scenes: Vec<Printed> = scenes.map(|(_, value)| *value).collect::<Option<_>>()?;
    let count = scenes.len() as f64;
    let sum: f64 = scenes.iter().map(|scene| scene.value).sum();
    let half: f64 = scenes.iter().map(|scene| scene.half_unit).sum();
    (count > 0.0).then(|| ((sum - half) / count, (sum + half) / count))
}

/// The F-scores that unrounded precision and recall could have: F rises with both.
fn f_range(precision: Option<Printed>, recall: Option<Printed>) -> Option<(f64, f64)> {
    let (p, r) = (precision?, recall?);
    let harmonic = |p: f64, r: f64| {
        if p + r > 0.0 {
            2.0 * p * r / (p + r)
        } else {
            0.0
        }
    };
    let low = harmonic(
        (p.value - p.half_unit).max(0.0),
        (r.value - r.half_unit).max(0.0),
    );
    Some((low, harmonic(p.value + p.half_unit, r.value + r.half_unit)))
}

#[cfg(test)]
mod tests {
    use super::*;

    const PAPER: &str = include_str!("../../datasets/manifests/blendedmvs-paper.csv");

    #[test]
    fn the_papers_f_averages_follow_from_its_f_scores() {
        let checked = check(PAPER.as_bytes()).unwrap();
        assert_eq!(checked.slips, []);
        assert_eq!((checked.averages, checked.f_scores), (4, 0));
        assert_eq!(
            checked.unchecked,
            28 + 1,
            "F without P and R, recall without scenes"
        );
    }

    /// Seven recalls whose mean is the paper's .6269 (their true values are not transcribed).
    #[test]
    fn the_papers_slip_is_found() {
        let table = "method,metric,A,B,C,D,E,F,G,Average\n\
                     DTU,recall,0.627,0.627,0.627,0.627,0.627,0.627,0.626,0.623\n";
        let checked = check(table.as_bytes()).unwrap();
        assert_eq!(checked.slips.len(), 1);
        let sentence = checked.slips[0].to_string();
        assert_eq!(
            sentence,
            "DTU, recall, Average: printed 0.623, its scenes average 0.6269"
        );
        let right = table.replace("0.623\n", "0.627\n");
        assert_eq!(check(right.as_bytes()).unwrap().slips, []);
    }

    #[test]
    fn an_f_score_that_cannot_be_is_found_and_rounding_is_not_blamed() {
        let table = |f: &str| {
            format!(
                "protocol,method,metric,Barn,Average\nx,m,precision,44.2,44.2\nx,m,recall,55.6,–\nx,m,F-score,{f},\n"
            )
        };
        // 2 · 44.2 · 55.6 / 99.8 = 49.249; with 44.25 and 55.65 it is 49.300.
        for fine in ["49.2", "49.3", "49"] {
            let checked = check(table(fine).as_bytes()).unwrap();
            assert_eq!((checked.slips.len(), checked.f_scores), (0, 1), "{fine}");
        }
        for wrong in ["49.4", "49.1", "50", "0.492"] {
            let slips = check(table(wrong).as_bytes()).unwrap().slips;
            assert_eq!(slips.len(), 1, "{wrong}");
            assert!((slips[0].expected - 49.249).abs() < 1e-3);
        }
    }

    #[test]
    fn what_is_no_table_is_refused() {
        let fails = |text: &str| check(text.as_bytes()).unwrap_err().to_string();
        assert!(fails("a,b\n1,2\n").contains("header: expected a column method"));
        let bad = "method,metric,A\nm,recall,x\n";
        assert_eq!(fails(bad), "line 2: expected a number, found x");
        assert!(fails("method,metric,A\nm,speed,1\n").contains("found speed"));
        assert!(fails("method,metric,A\nm,R,1\nm,recall,1\n").contains("line 3"));
    }
}
