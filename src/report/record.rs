//! Records: one row per method, scene and threshold, as `results.csv` holds them.

use super::check;
use super::lines::{Lines, check_separator, whole};
use mvs_datasets::FormatError;
use serde::{Deserialize, Serialize};
use std::io::{Read, Write};

/// The version of the columns of `results.csv`; its default is this program's.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Schema(u32);

impl Default for Schema {
    fn default() -> Self {
        Self(1)
    }
}

/// The columns of `results.csv`: the fields of [`Record`].
const COLUMNS: [&str; 43] = [
    "schema",
    "protocol",
    "profile",
    "method",
    "group",
    "split",
    "scene",
    "threshold",
    "unit",
    "precision",
    "recall",
    "fscore",
    "acc_mean",
    "acc_median",
    "comp_mean",
    "comp_median",
    "overall",
    "f_ci_lo",
    "f_ci_hi",
    "n_rec_in",
    "n_rec_crop",
    "n_rec_eval",
    "n_truth_in",
    "n_truth_crop",
    "n_truth_eval",
    "align",
    "align_scale",
    "traj_inliers",
    "traj_rmse",
    "icp_fitness",
    "icp_rmse",
    "icp_iterations",
    "mesh_sampling",
    "seed",
    "status",
    "seconds",
    "peak_mib",
    "tool_version",
    "rec_sha256",
    "truth_sha256",
    "crop_sha256",
    "log_sha256",
    "trans_sha256",
];

/// One scored reconstruction at one threshold. The fields are the columns of `results.csv` in
/// order; an empty text or `None` is an empty cell: not known, or not part of the protocol.
///
/// Fractions run from 0 to 1. Distances are in `unit`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Record {
    /// Version of the columns.
    pub schema: Schema,
    /// The procedure that turned distances into scores: `tnt`, `plain`; records from elsewhere name others.
    pub protocol: String,
    /// The named variant of the protocol: `official`, `strict`; of plain scores of thinned clouds `voxel`
    /// and the voxels' edge.
    pub profile: String,
    /// The judged system.
    pub method: String,
    /// What the methods are grouped by, such as the training set. `score` leaves it empty: it is for
    /// tables that are put together by hand.
    pub group: String,
    /// The part of the benchmark: `training`, `intermediate`; empty where the scene is not known.
    pub split: String,
    /// The scene.
    pub scene: String,
    /// The distance threshold τ, in `unit`.
    pub threshold: Option<f64>,
    /// The unit of all distances: `m`, `mm`, `world`.
    pub unit: String,
    /// Fraction of the reconstruction within the threshold of the truth.
    pub precision: Option<f64>,
    /// Fraction of the truth within the threshold of the reconstruction.
    pub recall: Option<f64>,
    /// Harmonic mean of precision and recall.
    pub fscore: Option<f64>,
    /// Mean distance from reconstruction to truth.
    pub acc_mean: Option<f64>,
    /// Median distance from reconstruction to truth.
    pub acc_median: Option<f64>,
    /// Mean distance from truth to reconstruction.
    pub comp_mean: Option<f64>,
    /// Median distance from truth to reconstruction.
    pub comp_median: Option<f64>,
    /// Mean of `acc_mean` and `comp_mean`.
    pub overall: Option<f64>,
    /// Lower end of the F-score's confidence interval.
    pub f_ci_lo: Option<f64>,
    /// Upper end of the F-score's confidence interval.
    pub f_ci_hi: Option<f64>,
    /// Points of the reconstruction as read.
    pub n_rec_in: Option<u64>,
    /// Points of the reconstruction inside the crop volume.
    pub n_rec_crop: Option<u64>,
    /// Points of the reconstruction that were judged.
    pub n_rec_eval: Option<u64>,
    /// Points of the truth as read.
    pub n_truth_in: Option<u64>,
    /// Points of the truth inside the crop volume.
    pub n_truth_crop: Option<u64>,
    /// Points of the truth that were judged.
    pub n_truth_eval: Option<u64>,
    /// How the reconstruction was aligned: `none`, `transform`, `trajectory`.
    pub align: String,
    /// The alignment's scale.
    pub align_scale: Option<f64>,
    /// Registered cameras near their own reference.
    pub traj_inliers: Option<u64>,
    /// Root mean square residual of the cameras that agree by the profile's own rule: those same ones
    /// in `strict`; in `official` all poses with any reference nearby.
    pub traj_rmse: Option<f64>,
    /// Fraction of points matched by the last ICP stage.
    pub icp_fitness: Option<f64>,
    /// Root mean square distance of those.
    pub icp_rmse: Option<f64>,
    /// ICP iterations, all stages together.
    pub icp_iterations: Option<u64>,
    /// How a mesh was turned into points; empty when it was a cloud.
    pub mesh_sampling: String,
    /// Seed of everything random.
    pub seed: Option<u64>,
    /// `ok`, or what is wrong.
    pub status: String,
    /// Wall-clock time of the scoring. `score` leaves it empty: the same inputs give the same bytes.
    pub seconds: Option<f64>,
    /// Peak memory of the scoring; empty as well.
    pub peak_mib: Option<f64>,
    /// Version of this program.
    pub tool_version: String,
    /// SHA-256 of the reconstruction's file.
    pub rec_sha256: String,
    /// SHA-256 of the truth's file.
    pub truth_sha256: String,
    /// SHA-256 of the crop volume's file.
    pub crop_sha256: String,
    /// SHA-256 of the trajectory's file.
    pub log_sha256: String,
    /// SHA-256 of the transform's file.
    pub trans_sha256: String,
}

impl Record {
    /// By what rows are sorted: comparable rows stand together, thresholds ascend.
    fn order(&self, other: &Self) -> std::cmp::Ordering {
        let texts = |record: &Self| {
            [
                record.protocol.clone(),
                record.profile.clone(),
                record.group.clone(),
                record.split.clone(),
                record.method.clone(),
                record.scene.clone(),
            ]
        };
        let threshold = |record: &Self| record.threshold.unwrap_or(f64::NEG_INFINITY);
        texts(self)
            .cmp(&texts(other))
            .then(threshold(self).total_cmp(&threshold(other)))
    }

    /// The first value that cannot be, if any.
    fn problem(&self) -> Option<String> {
        let (Schema(known), Schema(found)) = (Schema::default(), self.schema);
        if found != known {
            return Some(format!("schema: expected {known}, found {found}"));
        }
        let possible = |threshold: f64| threshold > 0.0 && threshold.is_finite();
        if let Some(threshold) = self.threshold.filter(|&value| !possible(value)) {
            return Some(format!(
                "threshold: expected a distance above 0, found {threshold}"
            ));
        }
        let fractions = [
            ("precision", self.precision),
            ("recall", self.recall),
            ("fscore", self.fscore),
            ("f_ci_lo", self.f_ci_lo),
            ("f_ci_hi", self.f_ci_hi),
        ];
        let out_of_range = |value: f64| !(0.0..=1.0).contains(&value);
        let outside = fractions.into_iter().find_map(|(name, value)| {
            let value = value.filter(|&value| out_of_range(value))?;
            Some(format!("{name}: expected 0 to 1, found {value}"))
        });
        outside
            .or_else(|| self.wrong_distance())
            .or_else(|| self.wrong_interval())
    }

    /// The first distance that cannot be, if any.
    fn wrong_distance(&self) -> Option<String> {
        let distances = [
            ("acc_mean", self.acc_mean),
            ("acc_median", self.acc_median),
            ("comp_mean", self.comp_mean),
            ("comp_median", self.comp_median),
            ("overall", self.overall),
        ];
        distances.into_iter().find_map(|(name, value)| {
            let value = value.filter(|value| !(value.is_finite() && *value >= 0.0))?;
            Some(format!(
                "{name}: expected a distance from 0 up, found {value}"
            ))
        })
    }

    /// What is wrong with the F-score's interval, if anything. F itself may lie outside, as resampling is
    /// not centred on it.
    fn wrong_interval(&self) -> Option<String> {
        match (self.f_ci_lo, self.f_ci_hi) {
            (Some(low), Some(high)) if low > high => Some(format!(
                "f_ci_hi: expected at least f_ci_lo, {low}, found {high}"
            )),
            (Some(_), None) | (None, Some(_)) => {
                Some("f_ci_lo, f_ci_hi: expected both or neither, found one".to_owned())
            }
            _ => None,
        }
    }
}

/// Writes `results.csv`: a header and the records, sorted; numbers as the shortest text that reads
/// back to the same value.
///
/// # Errors
/// What writing to `out` brings.
pub fn write(out: &mut impl Write, records: &[Record]) -> std::io::Result<()> {
    let mut sorted: Vec<&Record> = records.iter().collect();
    sorted.sort_by(|a, b| a.order(b));
    let mut writer = csv::WriterBuilder::new()
        .has_headers(false)
        .from_writer(out);
    writer.write_record(COLUMNS)?;
    for record in sorted {
        writer.serialize(record).map_err(std::io::Error::other)?;
    }
    writer.flush()
}

/// Reads `results.csv`. The columns must be those of this version, in order; every fraction lies
/// between 0 and 1, every distance from 0 up, every threshold above 0, and F follows from precision and recall as far as
/// their digits go.
///
/// # Errors
/// A source that cannot be read, other columns than these, and, by line, what is no row of them or breaks these
/// rules.
pub fn read(source: impl Read) -> Result<Vec<Record>, FormatError> {
    let bytes = &whole(source)?;
    let lines = Lines {
        bytes,
        comment: None,
    };
    let mut reader = csv::ReaderBuilder::new()
        .trim(csv::Trim::All)
        .from_reader(bytes.as_slice());
    let found = reader.headers().map_err(lines.broken())?.clone();
    check_header(&found)?;
    let mut records = Vec::new();
    for row in reader.records() {
        let row = row.map_err(lines.broken())?;
        let record = row.deserialize(Some(&found));
        let record: Record = record.map_err(|error| in_cell(&row, lines.of(&row), &error))?;
        if let Some(problem) = record.problem().or_else(|| wrong_f_score(&row)) {
            return Err(FormatError::new(
                format!("line {}", lines.of(&row)),
                problem,
            ));
        }
        records.push(record);
    }
    Ok(records)
}

/// Says so where the F-score is none that precision and recall, by the digits they are given with, have.
fn wrong_f_score(row: &csv::StringRecord) -> Option<String> {
    let cell = |name: &str| {
        let column = COLUMNS.iter().position(|column| *column == name)?;
        row.get(column)
    };
    let f_score = cell("fscore")?;
    let expected = check::f_slip(cell("precision")?, cell("recall")?, f_score)?;
    Some(format!(
        "fscore: expected {expected:.4}, which precision and recall give, found {f_score}; mend it, or \
         leave precision and recall empty where F is something else"
    ))
}

/// What is wrong with the cell that the error is of.
fn in_cell(row: &csv::StringRecord, line: usize, error: &csv::Error) -> FormatError {
    let place = format!("line {line}");
    let csv::ErrorKind::Deserialize { err, .. } = error.kind() else {
        return FormatError::new(place, error.to_string());
    };
    let field = err.field().and_then(|field| usize::try_from(field).ok());
    let cell = field.and_then(|field| Some((COLUMNS.get(field)?, row.get(field)?)));
    let expected = match err.kind() {
        csv::DeserializeErrorKind::ParseInt(_) => "a whole number from 0 up, digits alone",
        csv::DeserializeErrorKind::ParseFloat(_) => "a number such as 0.25",
        _ => "",
    };
    let problem = match cell {
        Some((column, cell)) if !expected.is_empty() => {
            format!("{column}: expected {expected}, found {cell}")
        }
        Some((column, _)) => format!("{column}: {}", err.kind()),
        None => err.kind().to_string(),
    };
    FormatError::new(place, problem)
}

fn check_header(found: &csv::StringRecord) -> Result<(), FormatError> {
    check_separator(found)?;
    for (index, name) in COLUMNS.into_iter().enumerate() {
        let cell = found.get(index).unwrap_or("nothing");
        if cell != name {
            let place = format!("header, column {}", index + 1);
            return Err(FormatError::new(
                place,
                format!("expected {name}, found {cell}"),
            ));
        }
    }
    match found.get(COLUMNS.len()) {
        Some(extra) => Err(FormatError::new(
            "header",
            format!(
                "expected {} columns, found one more: {extra}",
                COLUMNS.len()
            ),
        )),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn record(method: &str, scene: &str, threshold: f64) -> Record {
        Record {
            protocol: "tnt".into(),
            method: method.into(),
            scene: scene.into(),
            threshold: Some(threshold),
            precision: Some(1.0 / 3.0),
            recall: Some(0.1 + 0.2),
            n_rec_in: Some(u64::MAX),
            status: "ok, \"quoted\"".into(),
            ..Record::default()
        }
    }

    fn written(records: &[Record]) -> String {
        let mut bytes = Vec::new();
        write(&mut bytes, records).unwrap();
        String::from_utf8(bytes).unwrap()
    }

    #[test]
    fn columns_are_the_fields_in_order() {
        let mut writer = csv::Writer::from_writer(Vec::new());
        writer.serialize(Record::default()).unwrap();
        let text = String::from_utf8(writer.into_inner().unwrap()).unwrap();
        assert_eq!(text.lines().next().unwrap(), COLUMNS.join(","));
        assert_eq!(written(&[]).trim_end(), COLUMNS.join(","));
    }

    #[test]
    fn what_is_written_reads_back_sorted() {
        let (a, b) = (
            record("alpha", "Barn", 0.01),
            record("alpha", "Barn", 0.002),
        );
        let c = record("alpha", "Apse", 0.5);
        let text = written(&[a.clone(), b.clone(), c.clone()]);
        assert_eq!(read(text.as_bytes()).unwrap(), [c, b, a]);
        let row = "1,tnt,,alpha,,,Apse,0.5,,0.3333333333333333,0.30000000000000004,,,,,,,,,\
                   18446744073709551615,,,,,,,,,,,,,,,\"ok, \"\"quoted\"\"\",,,,,,,,";
        assert_eq!(text.lines().nth(1), Some(row));
    }

    #[test]
    fn an_f_score_that_does_not_follow_is_refused_and_rounding_is_not_blamed() {
        let full = record("a", "Barn", 0.01);
        let table = |p: &str, r: &str, f: &str| {
            let text = written(std::slice::from_ref(&full));
            text.replace(
                ",0.3333333333333333,0.30000000000000004,,",
                &format!(",{p},{r},{f},"),
            )
        };
        for (p, r, f) in [
            ("0.442", "0.556", "0.492"),
            ("0.442", "0.556", "0.493"),
            ("0.3333333333333333", "0.1", "0.15384615384615383"),
            ("0.3333333333333333", "0.1", "0.15384615384615388"),
            ("", "0.1", "0.9"),
            ("0", "0", "0"),
        ] {
            assert!(read(table(p, r, f).as_bytes()).is_ok(), "{p} {r} {f}");
        }
        for (p, r, f) in [
            ("0.442", "0.556", "0.494"),
            ("0.442", "0.556", "0.6"),
            ("0.3333333333333333", "0.1000000000", "0.1538461999"),
        ] {
            let problem = read(table(p, r, f).as_bytes()).map(|_| "was read");
            let problem = problem.unwrap_err().to_string();
            assert!(
                problem.starts_with("line 2: fscore: expected 0."),
                "{problem}"
            );
            assert!(problem.contains(&format!("found {f};")), "{problem}");
        }
    }

    #[test]
    fn bad_tables_are_refused_with_place_and_numbers() {
        let good = written(&[record("a", "b", 0.5)]);
        let fails = |text: &str| read(text.as_bytes()).unwrap_err().to_string();
        let high = good.replace("0.3333333333333333", "1.5");
        assert_eq!(
            fails(&high),
            "line 2: precision: expected 0 to 1, found 1.5"
        );
        let newer = good.replace("\n1,", "\n2,");
        assert_eq!(fails(&newer), "line 2: schema: expected 1, found 2");
        for threshold in ["nan", "inf", "-1", "0"] {
            let bad = good.replace(",0.5,", &format!(",{threshold},"));
            let found = fails(&bad);
            assert!(
                found.starts_with("line 2: threshold: expected a distance above 0, found "),
                "{found}"
            );
        }
        for distance in ["-1", "nan", "inf"] {
            let row = Record {
                acc_mean: Some(0.0),
                overall: Some(0.25),
                ..record("a", "b", 0.5)
            };
            let text = written(&[row]);
            assert!(read(text.as_bytes()).is_ok());
            for (column, cell) in [("acc_mean", ",0.0,"), ("overall", ",0.25,")] {
                let found = fails(&text.replace(cell, &format!(",{distance},")));
                let said = format!("line 2: {column}: expected a distance from 0 up, found ");
                assert!(found.starts_with(&said), "{found}");
            }
        }
        let renamed = good.replace("recall", "completeness");
        assert_eq!(
            fails(&renamed),
            "header, column 11: expected recall, found completeness"
        );
        let word = good.replace("0.3333333333333333", "third");
        let said = "line 2: precision: expected a number such as 0.25, found third";
        assert_eq!(fails(&word), said);
        for count in ["\"1,000\"", "-3", "1.5"] {
            let bad = good.replace("18446744073709551615", count);
            let said = "line 2: n_rec_in: expected a whole number from 0 up, digits alone, found ";
            assert_eq!(fails(&bad), format!("{said}{}", count.trim_matches('"')));
        }
        for (separator, said) in [(";", "found ';'"), ("\t", "found '\\t'")] {
            let found = fails(&good.replace(',', separator));
            assert!(
                found.starts_with("header: expected cells separated by commas, "),
                "{found}"
            );
            assert!(found.contains(said), "{found}");
        }
        let with_interval = |low: &str, high: &str| {
            let row = Record {
                f_ci_lo: Some(0.25),
                f_ci_hi: Some(0.5),
                ..record("a", "b", 0.5)
            };
            written(&[row]).replace(",0.25,0.5,", &format!(",{low},{high},"))
        };
        assert!(read(with_interval("0.5", "0.5").as_bytes()).is_ok());
        assert_eq!(
            fails(&with_interval("0.5", "0.25")),
            "line 2: f_ci_hi: expected at least f_ci_lo, 0.5, found 0.25"
        );
        let one = "line 2: f_ci_lo, f_ci_hi: expected both or neither, found one";
        assert_eq!(fails(&with_interval("0.5", "")), one);
        let short = format!("{good}1,tnt\n");
        assert_eq!(fails(&short), "line 3: expected 43 cells, found 2");
        assert!(fails("").contains("expected schema, found nothing"));
    }

    #[test]
    fn lines_are_counted_as_editors_do() {
        let rows = [record("a", "b", 0.5), record("c", "d", 0.5)];
        let good = written(&rows).replace("quoted", "of\ntwo");
        let bad = good.replace(",c,", ",c,x,").replace("\n1,", "\n\n1,");
        // The header, an empty line, a row of two lines, an empty line.
        for ends in ["\n", "\r\n"] {
            let error = read(bad.replace('\n', ends).as_bytes()).unwrap_err();
            assert_eq!(error.to_string(), "line 6: expected 43 cells, found 44");
            let bad = good.replace("\n1,", "\n\n1,");
            let at = bad.rfind("0.333").unwrap();
            let bad = format!("{}third{}", &bad[..at], &bad[at + 18..]).replace('\n', ends);
            let error = read(bad.as_bytes()).unwrap_err().to_string();
            assert!(error.starts_with("line 6: precision: "), "{error}");
        }
        // Far down too.
        let many: Vec<Record> = (1..=300).map(|i| record("a", "b", f64::from(i))).collect();
        let many = written(&many).replace("quoted", "of\ntwo");
        let bad = many.replace(",300.0,,", ",300.0,,x");
        assert_ne!(bad, many);
        let error = read(bad.as_bytes()).unwrap_err().to_string();
        assert!(error.starts_with("line 600: precision: "), "{error}");
        let broken: Vec<u8> = [good.as_bytes(), b"1,\xff\n"].concat();
        let error = read(broken.as_slice()).unwrap_err().to_string();
        assert_eq!(error, "line 6: expected 43 cells, found 2");
    }
}
