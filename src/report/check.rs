//! Recomputes what a published table derives: F-scores from precision and recall, averages from
//! scenes. A number is a slip when no unrounded values that print as the table's could give it.

use super::lines::{Lines, check_separator, whole};
use super::table::SUSPECT;
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

/// Columns that derive from ranks, not from the row.
const RANKS: [&str; 5] = ["rank", "mean rank", "average rank", "avg rank", "avg. rank"];

/// Rows of one method: metric → its values by column.
type Metrics = BTreeMap<String, Vec<Cell>>;

/// A table in a file: the cells before its methods, and its methods in order.
type Board = (Vec<String>, Vec<(String, Metrics)>);

/// A cell of a row.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Cell {
    /// Nothing: where the board's whole column is so, it is a column of another board.
    Blank,
    /// A dash, or a blank in a column that the board has.
    Missing,
    Printed(Printed),
}

impl Cell {
    fn printed(self) -> Option<Printed> {
        match self {
            Self::Printed(printed) => Some(printed),
            Self::Blank | Self::Missing => None,
        }
    }
}

/// Checks a table in the papers' or the site's form, as CSV: columns `method` and `metric` in any
/// order, then one per scene and if present one whose name begins with `Average`, `Mean` or `Avg`.
/// Columns before `method` tell
/// tables apart that share a file; columns of ranks and lines that begin with `#` are passed
/// over. Empty cells and dashes are missing, a † after a number too is. A number keeps its scale, so
/// that fractions and percents are checked alike. A table of which nothing can be recomputed is refused.
///
/// # Errors
/// A source that cannot be read or is no CSV with these columns, a metric that is not known, a cell that is no number
/// from 0 up, two rows of one method and metric in a table, and nothing to recompute.
pub fn check(source: impl Read) -> Result<Checked, FormatError> {
    let (bytes, comment) = (&whole(source)?, Some(b'#'));
    let lines = Lines { bytes, comment };
    let mut reader = csv::ReaderBuilder::new()
        .comment(comment)
        .from_reader(bytes.as_slice());
    let mut header = reader.headers().map_err(lines.broken())?.clone();
    check_separator(&header)?;
    header.trim();
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
    let is_rank = |name: &str| RANKS.iter().any(|rank| name.eq_ignore_ascii_case(rank));
    let is_early = |name: &&str| is_average(name) && !is_rank(name);
    if let Some(early) = header.iter().take(first).find(is_early) {
        let problem =
            format!("expected averages behind method and metric, found {early} before them");
        return Err(FormatError::new("header", problem));
    }
    let is_value = |&column: &usize| !is_rank(&header[column]);
    let values: Vec<usize> = (first..header.len()).filter(is_value).collect();
    let columns: Vec<&str> = values.iter().map(|&column| &header[column]).collect();
    let mut boards: Vec<Board> = Vec::new();
    for row in reader.records() {
        let row = row.map_err(lines.broken())?;
        let at = |problem| FormatError::new(format!("line {}", lines.of(&row)), problem);
        let before = (0..method).filter(|&column| column != metric);
        let named = before.filter_map(|column| row.get(column));
        // Empty ones tell tables apart too.
        let board: Vec<String> = named.map(str::to_owned).collect();
        let cells = values
            .iter()
            .map(|&column| parsed(row.get(column).unwrap_or_default()));
        let cells = cells.collect::<Result<Vec<_>, String>>().map_err(at)?;
        let metric = metric_of(&row[metric]).map_err(at)?;
        let of_board = entry(&mut boards, board);
        let of_method = entry(of_board, row[method].to_owned());
        if of_method.insert(metric.clone(), cells).is_some() {
            let problem =
                format!("expected one row per method and metric, found a second {metric}");
            return Err(at(problem));
        }
    }
    if boards.is_empty() {
        let problem = "expected a row per method and metric, found none";
        return Err(FormatError::new("table", problem));
    }
    boards.iter_mut().for_each(fill);
    let checked = checked(&columns, &boards);
    if checked.f_scores + checked.averages == 0 {
        let problem = format!(
            "expected F-scores beside precision and recall, or a column `Average`, `Mean` or `Avg` beside \
             whole rows, found nothing to recompute in the columns {}",
            columns.join(", ")
        );
        return Err(FormatError::new("table", problem));
    }
    Ok(checked)
}

/// What belongs to `key`, new at the end where it is not there yet.
fn entry<K: PartialEq, T: Default>(list: &mut Vec<(K, T)>, key: K) -> &mut T {
    let place = list.iter().position(|(known, _)| *known == key);
    let place = place.unwrap_or_else(|| {
        list.push((key, T::default()));
        list.len() - 1
    });
    &mut list[place].1
}

/// Blanks are missing where the board has the column.
fn fill((_, methods): &mut Board) {
    let mut rows: Vec<&mut Vec<Cell>> = methods
        .iter_mut()
        .flat_map(|(_, metrics)| metrics.values_mut())
        .collect();
    let columns = rows.first().map_or(0, |row| row.len());
    for column in 0..columns {
        if rows.iter().any(|row| row[column] != Cell::Blank) {
            for row in &mut rows {
                if row[column] == Cell::Blank {
                    row[column] = Cell::Missing;
                }
            }
        }
    }
}

/// Whether the column's first word is `average`, `mean` or `avg`: `Avg.`, `Mean F`.
pub(super) fn is_average(column: &str) -> bool {
    let mut words = column.split(|character: char| !character.is_alphanumeric());
    words.find(|word| !word.is_empty()).is_some_and(|first| {
        let mut names = ["average", "mean", "avg"].iter();
        names.any(|name| first.eq_ignore_ascii_case(name))
    })
}

fn metric_of(name: &str) -> Result<String, String> {
    let plain = name.to_ascii_lowercase().replace(['-', '_', ' '], "");
    let known = match plain.as_str() {
        "precision" | "p" => "precision",
        "recall" | "r" => "recall",
        "fscore" | "f" | "f1" => F_SCORE,
        "accuracy" | "completeness" | "overall" => plain.as_str(),
        _ => {
            return Err(format!(
                "expected the metric precision, recall, F-score, accuracy, completeness or overall, \
                 found {name}"
            ));
        }
    };
    Ok(known.to_owned())
}

fn parsed(cell: &str) -> Result<Cell, String> {
    let text = cell.trim().trim_end_matches('%').trim_end();
    if text.is_empty() {
        return Ok(Cell::Blank);
    }
    // A value that does not count is as good as none.
    if ["-", "–", "—"].contains(&text) || text.ends_with(SUSPECT) {
        return Ok(Cell::Missing);
    }
    let value: f64 = text
        .parse()
        .map_err(|_| format!("expected a number, found {cell}"))?;
    if !value.is_finite() || value < 0.0 {
        return Err(format!("expected a number from 0 up, found {cell}"));
    }
    let (mantissa, exponent) = text.split_once(['e', 'E']).unwrap_or((text, "0"));
    let decimals = mantissa
        .split_once('.')
        .map_or(0, |(_, digits)| digits.len());
    let exponent = exponent.parse::<i32>().unwrap_or(0);
    let places = i32::try_from(decimals)
        .unwrap_or(i32::MAX)
        .saturating_sub(exponent);
    let half_unit = 0.5 * 0.1f64.powi(places);
    Ok(Cell::Printed(Printed { value, half_unit }))
}

fn checked(columns: &[&str], boards: &[Board]) -> Checked {
    let mut result = Checked::default();
    for (board, methods) in boards {
        let named: Vec<&str> = board
            .iter()
            .map(String::as_str)
            .filter(|cell| !cell.is_empty())
            .collect();
        for (method, metrics) in methods {
            let method = match boards.len() {
                1 => method.clone(),
                _ => format!("{method} ({})", named.join(" ")),
            };
            check_method(&mut result, &method, columns, metrics);
        }
    }
    result
}

fn check_method(result: &mut Checked, method: &str, columns: &[&str], metrics: &Metrics) {
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
                method: method.to_owned(),
                metric: metric.to_owned(),
                column: column.to_owned(),
                printed: printed.value,
                expected: 0.5 * (low + high),
            });
        }
    };
    for (metric, values) in metrics {
        for (index, (column, cell)) in columns.iter().zip(values).enumerate() {
            let Some(printed) = cell.printed() else {
                continue;
            };
            if is_average(column) {
                note(metric, column, printed, mean_range(columns, values));
            } else if metric == F_SCORE {
                let at = |name: &str| metrics.get(name)?.get(index)?.printed();
                let range = f_range(at("precision"), at("recall"));
                note(metric, column, printed, range);
            }
        }
    }
}

/// Where these cells' F-score is none that their precision and recall have, whatever their unrounded
/// values are: the F-score in the middle of what they have. `None` where a cell holds no number.
pub(super) fn f_slip(precision: &str, recall: &str, f_score: &str) -> Option<f64> {
    let number = |cell: &str| parsed(cell).ok().and_then(Cell::printed);
    let (low, high) = f_range(number(precision), number(recall))?;
    let printed = number(f_score)?;
    // A hair for the rounding of what was computed from counts.
    let slack = printed.half_unit + 1e-12;
    let follows = printed.value + slack >= low && printed.value - slack <= high;
    (!follows).then_some(0.5 * (low + high))
}

/// The averages that the scenes' unrounded values could have; `None` when a scene is missing.
fn mean_range(columns: &[&str], values: &[Cell]) -> Option<(f64, f64)> {
    let scenes = columns.iter().zip(values);
    let scenes = scenes.filter(|(column, cell)| !is_average(column) && **cell != Cell::Blank);
    let scenes: Vec<Printed> = scenes
        .map(|(_, cell)| cell.printed())
        .collect::<Option<_>>()?;
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
    fn several_boards_of_one_file_are_told_apart_and_ranks_are_no_scenes() {
        let table = |mean: &str| {
            format!(
                "profile,metric,method,rank,mean rank,mean,Barn,Truck,Apse\n\
                 official,F-score,a,1,1.00,50.00,40.00,60.00,\n\
                 official,accuracy,a,1,1.00,0.2000,0.1000,0.3000,\n\
                 official,F-score,b,–,–,–,41.00†,–,\n\
                 strict,F-score,a,1,1.00,{mean},,,70.00\n"
            )
        };
        let right = check(table("70.00").as_bytes()).unwrap();
        assert_eq!(right.slips, []);
        assert_eq!((right.averages, right.unchecked), (3, 3), "F without P, R");
        let wrong = check(table("50.00").as_bytes()).unwrap().slips;
        let said: Vec<String> = wrong.iter().map(ToString::to_string).collect();
        let slip = "a (strict), F-score, mean: printed 50, its scenes average 70.0000";
        assert_eq!(said, [slip]);
    }

    #[test]
    fn an_average_before_the_method_is_not_passed_over() {
        let table = "Average,method,metric,A,B\n0.9,m,recall,0.5,0.6\n";
        let said = check(table.as_bytes()).unwrap_err().to_string();
        assert!(said.contains("found Average before them"), "{said}");
    }

    #[test]
    fn averages_of_ranks_are_no_averages_of_scenes() {
        for rank in ["Average rank", "Avg. rank", "Mean Rank", "rank"] {
            let table = format!("method,metric,A,B,Average,{rank}\nm,recall,0.5,0.6,0.55,1.5\n");
            let checked = check(table.as_bytes()).unwrap();
            assert_eq!((checked.slips.len(), checked.averages), (0, 1), "{rank}");
        }
    }

    #[test]
    fn a_number_with_an_exponent_is_as_precise_as_its_digits() {
        let table = |mean: &str| format!("method,metric,A,B,Average\nm,recall,0.50,0.60,{mean}\n");
        for (mean, slips) in [("5.5e-1", 0), ("5e-1", 0), ("5.8e-1", 1), ("580e-3", 1)] {
            let found = check(table(mean).as_bytes()).unwrap().slips;
            assert_eq!(found.len(), slips, "{mean}");
        }
    }

    #[test]
    fn averages_by_any_name_are_checked_and_nothing_to_check_is_said() {
        let table = |name: &str| format!("method,metric,A,B,{name}\nm,recall,0.5,0.6,0.7\n");
        for name in ["Average", "mean", "Avg.", "Mean F", "AVG (2)"] {
            let found = check(table(name).as_bytes()).unwrap();
            assert_eq!((found.averages, found.slips.len()), (1, 1), "{name}");
        }
        for table in [
            table("Meanwhile"),
            table("C"),
            "method,metric,A,Mean\nm,recall,–,0.5\n".into(),
        ] {
            let problem = check(table.as_bytes()).unwrap_err().to_string();
            assert!(
                problem.contains("found nothing to recompute in the columns A"),
                "{problem}"
            );
        }
    }

    #[test]
    fn blanks_around_names_of_columns_are_none_of_them() {
        let table = "method , metric,\tBarn , Truck, Average \nm,recall,.5,.6,.7\n";
        let slips = check(table.as_bytes()).unwrap().slips;
        assert_eq!((slips.len(), slips[0].column.as_str()), (1, "Average"));
    }

    #[test]
    fn what_is_no_table_is_refused() {
        let fails = |text: &str| check(text.as_bytes()).unwrap_err().to_string();
        assert!(fails("a,b\n1,2\n").contains("header: expected a column method"));
        for separator in [";", "\t"] {
            let found = fails(&PAPER.replace(',', separator));
            let said = format!("header: expected cells separated by commas, found {separator:?}");
            assert!(found.starts_with(&said.replace('"', "'")), "{found}");
        }
        let bad = "method,metric,A\nm,recall,x\n";
        assert_eq!(fails(bad), "line 2: expected a number, found x");
        assert!(fails("method,metric,A\nm,speed,1\n").contains("found speed"));
        assert!(fails("method,metric,A\nm,R,1\nm,recall,1\n").contains("line 3"));
        let commented = "# of 2026\r\nmethod,metric,A\r\nm,R,1\r\n# twice\r\n\r\nm,recall,1\r\n";
        assert!(
            fails(commented).starts_with("line 6: expected one row"),
            "{}",
            fails(commented)
        );
    }
}
