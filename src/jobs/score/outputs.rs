//! The files beside `score.json`, under the official toolbox's names.

use super::document::ScoreDocument;
use super::row;
use crate::error::Result;
use crate::jobs::OutDir;
use crate::parallel;
use crate::report::curve_svg::{self, Curves};
use crate::report::{colormap, curve_png, record};
use crate::score::{Evaluation, Side};
use glam::DVec3;
use mvs_datasets::format::image;
use mvs_datasets::format::ply::stream::{Scalar, StreamWriter};
use mvs_metrics::{Curve, Score, Tolerance};
use std::io::Write;

/// How far past τ the toolbox plots, in τ; it is written into its files.
const STRETCH: f64 = 5.0;
/// The distance that gets the last colour, in τ.
const COLOR_STRETCH: f64 = 3.0;
/// Points of a cloud that one thread makes into rows at a time.
const ROWS: usize = 4096;
/// So many times of which are written at a time at most.
const AT_ONCE: usize = 16;

/// Writes every file but `run.toml`.
pub(super) fn write_all(
    out: &OutDir,
    evaluation: &Evaluation,
    document: &ScoreDocument,
) -> Result<()> {
    let (scene, tolerance) = (&document.scene, Tolerance::new(document.tolerance)?);
    let curves = evaluation.curves(tolerance);
    write_curves(out, scene, &curves, &evaluation.score(tolerance))?;
    write_plot(out, document, &curves)?;
    let clouds = [
        ("precision", &evaluation.reconstruction),
        ("recall", &evaluation.truth),
    ];
    let write = |(name, side): (&str, &Side)| {
        write_errors(out, &format!("{scene}.{name}.ply"), side, tolerance)
    };
    let [precision, recall] = clouds;
    let (precision, recall) = parallel::both(|| write(precision), || write(recall));
    precision.and(recall)?;
    out.write("scores.csv", |file| {
        record::write(file, &row::records(document))
    })?;
    out.write_json("score.json", document)
}

/// Writes the judged points of a side, coloured by `hot_r` of min(d, 3τ)/3τ as the toolbox does, with
/// the distance d itself as a scalar `error` in world units.
fn write_errors(out: &OutDir, name: &str, side: &Side, tolerance: Tolerance) -> Result<()> {
    let reach = COLOR_STRETCH * tolerance.get();
    let double = ["x", "y", "z"].map(|name| (name, Scalar::Double));
    let uchar = ["red", "green", "blue"].map(|name| (name, Scalar::Uchar));
    let properties = [&double[..], &uchar, &[("error", Scalar::Float)]].concat();
    out.write(name, |file| {
        let mut writer = StreamWriter::new(file, &properties, &[])?;
        let row: usize = properties.iter().map(|(_, scalar)| scalar.size()).sum();
        let mut points = side.points.iter();
        let some = ROWS * AT_ONCE.min(parallel::threads());
        for distances in side.distances.chunks(some) {
            let points: Vec<DVec3> = points.by_ref().take(distances.len()).collect();
            let mut rows = vec![0; row * distances.len()];
            parallel::for_each_chunk(&mut rows, row * ROWS, |nth, rows| {
                let first = nth * ROWS;
                let mut rows = &mut *rows;
                for (point, &distance) in points[first..].iter().zip(&distances[first..]) {
                    let mut put = |bytes: &[u8]| {
                        if let Some(room) = rows.split_off_mut(..bytes.len()) {
                            room.copy_from_slice(bytes);
                        }
                    };
                    point
                        .to_array()
                        .iter()
                        .for_each(|along| put(&along.to_le_bytes()));
                    put(&colormap::hot_r(distance.min(reach) / reach));
                    put(&(distance as f32).to_le_bytes());
                }
            });
            writer.write(&rows)?;
        }
        writer.complete().map(|_| ())
    })
}

/// Writes the cumulative curves (`<Scene>.precision.txt`, `<Scene>.recall.txt`) and precision,
/// recall, F-score, τ and stretch (`<Scene>.prf_tau_plotstr.txt`) as the toolbox does: a number per
/// line in C's `%.18e`.
fn write_curves(
    out: &OutDir,
    scene: &str,
    (precision, recall): &(Curve, Curve),
    score: &Score,
) -> Result<()> {
    for (name, curve) in [("precision", precision), ("recall", recall)] {
        write_numbers(out, &format!("{scene}.{name}.txt"), &curve.fractions())?;
    }
    let summary = [
        score.precision(),
        score.recall(),
        score.f_score(),
        score.tolerance().get(),
        STRETCH,
    ];
    write_numbers(out, &format!("{scene}.prf_tau_plotstr.txt"), &summary)
}

/// Draws the curves as `PR_<Scene>_@d_th_0_<τ in tenths of a millimetre>.png`, the toolbox's name,
/// and `.svg`.
fn write_plot(
    out: &OutDir,
    document: &ScoreDocument,
    (precision, recall): &(Curve, Curve),
) -> Result<()> {
    let title = format!(
        "Precision and recall: {}, {:.2} % F-score",
        document.scene,
        100.0 * document.f_score
    );
    let curves = Curves {
        title: &title,
        tau: document.tolerance,
        at_tau: (document.precision, document.recall),
        unit: row::unit_of(document.protocol, &document.scene),
        distances: &precision.edges()[1..],
        precision: &precision.fractions(),
        recall: &recall.fractions(),
    };
    let tenths = (document.tolerance * 1e4) as u64;
    let name = format!("PR_{}_@d_th_0_{tenths:04}", document.scene);
    let (svg, png) = (curve_svg::svg(&curves)?, curve_png::image(&curves)?);
    out.write(format!("{name}.svg"), |file| file.write_all(svg.as_bytes()))?;
    out.write(format!("{name}.png"), |file| image::write_png(file, &png))
}

fn write_numbers(out: &OutDir, name: &str, numbers: &[f64]) -> Result<()> {
    out.write(name, |file| {
        for &number in numbers {
            writeln!(file, "{}", c_scientific(number))?;
        }
        Ok(())
    })
}

/// A finite number as C's `%.18e` prints it: a sign and at least two digits in the exponent.
fn c_scientific(number: f64) -> String {
    let text = format!("{number:.18e}");
    match text.split_once('e') {
        Some((mantissa, exponent)) => match exponent.strip_prefix('-') {
            Some(digits) => format!("{mantissa}e-{digits:0>2}"),
            None => format!("{mantissa}e+{exponent:0>2}"),
        },
        None => text,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_look_as_numpy_saves_them() {
        // As Python's '%.18e' % number prints them.
        for (number, text) in [
            (0.0, "0.000000000000000000e+00"),
            (1.0, "1.000000000000000000e+00"),
            (0.005, "5.000000000000000104e-03"),
            (1.5e-120, "1.500000000000000054e-120"),
            (123_456.789, "1.234567890000000043e+05"),
        ] {
            assert_eq!(c_scientific(number), text);
        }
    }
}
