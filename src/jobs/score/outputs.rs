//! The files beside `score.json`, under the official toolbox's names.

use super::super::OutDir;
use crate::error::Result;
use crate::score::Evaluation;
use mvs_metrics::{Curve, Tolerance};
use std::io::Write;

/// How far past τ the toolbox plots, in τ; it is written into its files.
const STRETCH: f64 = 5.0;

/// Writes the cumulative curves (`<Scene>.precision.txt`, `<Scene>.recall.txt`) and precision,
/// recall, F-score, τ and stretch (`<Scene>.prf_tau_plotstr.txt`) as the toolbox does: a number per
/// line in C's `%.18e`.
pub(super) fn write_curves(
    out: &OutDir,
    scene: &str,
    evaluation: &Evaluation,
    tolerance: Tolerance,
) -> Result<()> {
    let (precision, recall) = evaluation.curves(tolerance);
    write_numbers(
        out,
        &format!("{scene}.precision.txt"),
        &fractions(&precision),
    )?;
    write_numbers(out, &format!("{scene}.recall.txt"), &fractions(&recall))?;
    let score = evaluation.score(tolerance);
    let summary = [
        score.precision(),
        score.recall(),
        score.f_score(),
        tolerance.get(),
        STRETCH,
    ];
    write_numbers(out, &format!("{scene}.prf_tau_plotstr.txt"), &summary)
}

fn fractions(curve: &Curve) -> Vec<f64> {
    curve.fractions()
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
