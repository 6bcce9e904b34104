//! The only user of the FFT: Gaussian low-pass of real planes, circular, at any size.

use crate::error::{Error, Result};
use realfft::{ComplexToReal, FftError, RealFftPlanner, RealToComplex};
use rustfft::num_complex::Complex;
use rustfft::{Fft, FftPlanner};
use std::sync::Arc;

/// Frequencies whose gain lies below this are not computed: half a grey level times it is far
/// below what the samples' own precision can show.
const NEGLIGIBLE_GAIN: f64 = 1e-8;

/// How many columns of the spectrum are brought together for the transforms along columns.
const COLUMN_BLOCK: usize = 16;

/// A low-pass of real planes of one size, with gain exp(−u² / (2·d0_x)) · exp(−v² / (2·d0_y)) at
/// the integer FFT bin (u, v). Plans are made once and shared by all threads.
pub(super) struct LowPass {
    width: usize,
    height: usize,
    /// Gain per column of the half spectrum that is kept, the inverse's normalisation included.
    column_gains: Vec<f32>,
    /// Gain per row of the spectrum.
    row_gains: Vec<f32>,
    forward_rows: Arc<dyn RealToComplex<f32>>,
    inverse_rows: Arc<dyn ComplexToReal<f32>>,
    forward_columns: Arc<dyn Fft<f32>>,
    inverse_columns: Arc<dyn Fft<f32>>,
}

impl std::fmt::Debug for LowPass {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "LowPass({} x {})", self.width, self.height)
    }
}

/// exp(−bin² / (2·d0)).
pub(super) fn gain(bin: usize, d0: f64) -> f64 {
    #[allow(clippy::cast_precision_loss, reason = "bins are far below 2^53")]
    let bin = bin as f64;
    libm::exp(-bin * bin / (2.0 * d0))
}

impl LowPass {
    /// A low-pass for planes of `size` (width, height), both ≥ 1, with `d0` along (x, y) in squared
    /// bins of these planes, both above 0.
    pub(super) fn new(size: (usize, usize), d0: (f64, f64)) -> Self {
        let (width, height) = size;
        let mut real = RealFftPlanner::<f32>::new();
        let mut complex = FftPlanner::<f32>::new();
        #[allow(
            clippy::cast_precision_loss,
            reason = "pixel counts are far below 2^53"
        )]
        let normalisation = 1.0 / (width as f64 * height as f64);
        let column_gains = (0..=width / 2)
            .map(|u| gain(u, d0.0))
            .take_while(|&gain| gain >= NEGLIGIBLE_GAIN)
            .map(|gain| (gain * normalisation) as f32)
            .collect();
        let row_gains = (0..height)
            .map(|v| gain(v.min(height - v), d0.1) as f32)
            .collect();
        Self {
            width,
            height,
            column_gains,
            row_gains,
            forward_rows: real.plan_fft_forward(width),
            inverse_rows: real.plan_fft_inverse(width),
            forward_columns: complex.plan_fft_forward(height),
            inverse_columns: complex.plan_fft_inverse(height),
        }
    }

    /// Filters `plane`, row-major and of this filter's size, in place.
    pub(super) fn apply(&self, plane: &mut [f32]) -> Result<()> {
        if plane.len() != self.width * self.height {
            let problem = format!(
                "expected a plane of {} x {} values, found {}",
                self.width,
                self.height,
                plane.len()
            );
            return Err(Error::invalid("low-pass filter", problem));
        }
        let mut spectrum = self.transform_rows(plane)?;
        self.filter_columns(&mut spectrum);
        self.restore_rows(&mut spectrum, plane)
    }

    /// The kept columns of the rows' spectra, row-major.
    fn transform_rows(&self, plane: &mut [f32]) -> Result<Vec<Complex<f32>>> {
        let band = self.column_gains.len();
        let mut spectrum = vec![Complex::default(); band * self.height];
        let mut bins = self.forward_rows.make_output_vec();
        let mut scratch = self.forward_rows.make_scratch_vec();
        for (row, kept) in plane
            .chunks_exact_mut(self.width)
            .zip(spectrum.chunks_exact_mut(band))
        {
            self.forward_rows
                .process_with_scratch(row, &mut bins, &mut scratch)
                .map_err(fft_error)?;
            kept.copy_from_slice(&bins[..band]);
        }
        Ok(spectrum)
    }

    /// Transforms columns, multiplies with the gains and transforms back.
    fn filter_columns(&self, spectrum: &mut [Complex<f32>]) {
        let (band, height) = (self.column_gains.len(), self.height);
        let mut block = vec![Complex::default(); COLUMN_BLOCK * height];
        let scratch_length = self
            .forward_columns
            .get_inplace_scratch_len()
            .max(self.inverse_columns.get_inplace_scratch_len());
        let mut scratch = vec![Complex::default(); scratch_length];
        for start in (0..band).step_by(COLUMN_BLOCK) {
            let columns = COLUMN_BLOCK.min(band - start);
            let block = &mut block[..columns * height];
            for (row, values) in spectrum.chunks_exact(band).enumerate() {
                for (column, &value) in values[start..start + columns].iter().enumerate() {
                    block[column * height + row] = value;
                }
            }
            self.forward_columns
                .process_with_scratch(block, &mut scratch);
            for (column, &gain) in block
                .chunks_exact_mut(height)
                .zip(&self.column_gains[start..])
            {
                for (value, &row_gain) in column.iter_mut().zip(&self.row_gains) {
                    *value *= gain * row_gain;
                }
            }
            self.inverse_columns
                .process_with_scratch(block, &mut scratch);
            for (row, values) in spectrum.chunks_exact_mut(band).enumerate() {
                for (column, value) in values[start..start + columns].iter_mut().enumerate() {
                    *value = block[column * height + row];
                }
            }
        }
    }

    /// Transforms the kept columns back to rows of the plane.
    fn restore_rows(&self, spectrum: &mut [Complex<f32>], plane: &mut [f32]) -> Result<()> {
        let band = self.column_gains.len();
        let mut bins = self.inverse_rows.make_input_vec();
        let mut scratch = self.inverse_rows.make_scratch_vec();
        for (row, kept) in plane
            .chunks_exact_mut(self.width)
            .zip(spectrum.chunks_exact(band))
        {
            bins[..band].copy_from_slice(kept);
            bins[band..].fill(Complex::default());
            make_real(&mut bins, self.width);
            self.inverse_rows
                .process_with_scratch(&mut bins, row, &mut scratch)
                .map_err(fft_error)?;
        }
        Ok(())
    }
}

/// Clears the imaginary parts that are zero for a real signal but for rounding.
fn make_real(bins: &mut [Complex<f32>], width: usize) {
    bins[0].im = 0.0;
    if width.is_multiple_of(2) {
        bins[width / 2].im = 0.0;
    }
}

fn fft_error(error: FftError) -> Error {
    Error::invalid("low-pass filter", error.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;

    /// The slow twin: the circular convolution with the kernel that the definition's sum gives.
    fn by_definition(plane: &[f32], size: (usize, usize), d0: (f64, f64)) -> Vec<f64> {
        let (width, height) = size;
        let kernel = |length: usize, d0: f64| -> Vec<f64> {
            let value = |x: usize| -> f64 {
                (0..length)
                    .map(|u| {
                        let angle = TAU * (u * x) as f64 / length as f64;
                        gain(u.min(length - u), d0) * libm::cos(angle) / length as f64
                    })
                    .sum()
            };
            (0..length).map(value).collect()
        };
        let (kx, ky) = (kernel(width, d0.0), kernel(height, d0.1));
        let value = |row: usize, column: usize| -> f64 {
            let mut sum = 0.0;
            for r in 0..height {
                for c in 0..width {
                    let weight = ky[(row + height - r) % height] * kx[(column + width - c) % width];
                    sum += weight * f64::from(plane[r * width + c]);
                }
            }
            sum
        };
        (0..width * height)
            .map(|i| value(i / width, i % width))
            .collect()
    }

    fn noise(count: usize) -> Vec<f32> {
        let mut state = 12345u32;
        let mut next = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 8) as f32 / 65536.0 - 128.0
        };
        (0..count).map(|_| next()).collect()
    }

    #[test]
    fn equals_the_definition_at_odd_prime_and_tiny_sizes() {
        let sizes = [
            (1, 1),
            (1, 7),
            (2, 3),
            (13, 11),
            (16, 12),
            (31, 6),
            (37, 41),
        ];
        for size in sizes {
            for d0 in [(0.3, 0.3), (9.0, 4.0), (5000.0, 5000.0)] {
                let plane = noise(size.0 * size.1);
                let expected = by_definition(&plane, size, d0);
                let mut found = plane.clone();
                LowPass::new(size, d0).apply(&mut found).unwrap();
                for (f, e) in found.iter().zip(&expected) {
                    assert!((f64::from(*f) - e).abs() < 1e-4, "{size:?} {d0:?}: {f} {e}");
                }
            }
        }
    }

    #[test]
    fn an_impulse_spreads_as_the_closed_form_says() {
        let (width, height) = (640usize, 480usize);
        let mut plane = vec![0.0; width * height];
        plane[240 * width + 320] = 1000.0;
        LowPass::new((width, height), (5000.0, 5000.0))
            .apply(&mut plane)
            .unwrap();
        let moment = |of: fn(f64, f64) -> f64| -> f64 {
            plane
                .iter()
                .enumerate()
                .map(|(i, &v)| {
                    let x = (i % width) as f64 - 320.0;
                    let y = (i / width) as f64 - 240.0;
                    f64::from(v) * of(x, y)
                })
                .sum()
        };
        let total = moment(|_, _| 1.0);
        let sigma_x = (moment(|x, _| x * x) / total).sqrt();
        let sigma_y = (moment(|_, y| y * y) / total).sqrt();
        assert!((total - 1000.0).abs() < 1e-2, "{total}");
        let expected = width as f64 / (TAU * 5000f64.sqrt());
        assert!((expected - width as f64 / 444.29).abs() < 1e-4);
        assert!((sigma_x - expected).abs() < 0.02, "{sigma_x} {expected}");
        assert!((sigma_y - expected * 0.75).abs() < 0.02, "{sigma_y}");
    }

    #[test]
    fn a_plane_of_another_size_is_refused() {
        let filter = LowPass::new((4, 3), (1.0, 1.0));
        let error = filter.apply(&mut [0.0; 11]).unwrap_err().to_string();
        assert!(error.contains("4 x 3") && error.contains("11"), "{error}");
    }
}
