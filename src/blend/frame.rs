//! How a row or column of pixels is laid into the frame that is transformed.

/// What lies beyond an image's borders.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Edge {
    /// The image again.
    Circular,
    /// Its mirror image, border pixels repeated.
    Reflected,
}

impl Edge {
    /// The axis of `length` pixels as a frame for the transform.
    pub(super) fn axis(self, length: usize, d0: f64) -> Axis {
        match self {
            Self::Circular => Axis::circular(length, d0),
            Self::Reflected => Axis::reflected(length, d0),
        }
    }

    /// The pixel shown at `index` when pixel 0 is shown at `offset`, on an axis of `length` pixels.
    pub(super) fn source(self, index: usize, offset: usize, length: usize) -> usize {
        let periods = offset.next_multiple_of(2 * length);
        let index = index + periods - offset;
        match self {
            Self::Circular => index % length,
            Self::Reflected => mirrored(index, length),
        }
    }
}

/// One axis of the frame: where each of its samples comes from, and the filter's D0 there.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Axis {
    /// Index of the image's first pixel in the frame.
    pub(super) offset: usize,
    /// Index of the pixel that each sample of the frame shows.
    pub(super) source: Vec<usize>,
    /// D0 in squared bins of the frame, such that the filter is as wide in pixels as `d0` makes it
    /// on the image itself.
    pub(super) d0: f64,
}

impl Axis {
    /// The image as it is: the filter wraps around.
    pub(super) fn circular(length: usize, d0: f64) -> Self {
        Self {
            offset: 0,
            source: (0..length).collect(),
            d0,
        }
    }

    /// The image with its mirror image on both sides, border pixels repeated. The margin is as wide
    /// as the filter reaches, or the frame is the whole period of the mirrored image.
    pub(super) fn reflected(length: usize, d0: f64) -> Self {
        let margin = (REACH * sigma(length, d0)).ceil();
        #[allow(
            clippy::cast_precision_loss,
            reason = "pixel counts are far below 2^53"
        )]
        let fits = 2.0 * margin < length as f64;
        #[allow(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "a finite margin ≥ 0 below the length"
        )]
        let (offset, padded) = if fits {
            let margin = margin as usize;
            (margin, smooth_length(length + 2 * margin))
        } else {
            (0, 2 * length)
        };
        let start = 2 * length - offset;
        #[allow(
            clippy::cast_precision_loss,
            reason = "pixel counts are far below 2^53"
        )]
        let scale = padded as f64 / length as f64;
        Self {
            offset,
            source: (0..padded).map(|i| mirrored(start + i, length)).collect(),
            d0: d0 * scale * scale,
        }
    }

    /// Number of samples of the frame.
    pub(super) fn length(&self) -> usize {
        self.source.len()
    }
}

/// How many standard deviations the filter reaches: what lies beyond weighs less than 1e-11.
const REACH: f64 = 7.0;

/// The filter's standard deviation in pixels on an axis of `length` pixels: length / (2π·√D0).
pub(super) fn sigma(length: usize, d0: f64) -> f64 {
    #[allow(
        clippy::cast_precision_loss,
        reason = "pixel counts are far below 2^53"
    )]
    let length = length as f64;
    length / (std::f64::consts::TAU * d0.sqrt())
}

/// Index of the pixel at `index` of the endless mirrored image.
fn mirrored(index: usize, length: usize) -> usize {
    let index = index % (2 * length);
    if index < length {
        index
    } else {
        2 * length - 1 - index
    }
}

/// The smallest even number ≥ `length` whose prime factors are 2, 3 and 5: quick to transform.
fn smooth_length(length: usize) -> usize {
    let smooth = |&candidate: &usize| {
        let mut rest = candidate;
        for prime in [2, 3, 5] {
            while rest.is_multiple_of(prime) {
                rest /= prime;
            }
        }
        rest == 1
    };
    (length.next_multiple_of(2)..)
        .step_by(2)
        .find(smooth)
        .unwrap_or(length)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn mirrored_pixels_repeat_the_border() {
        let axis = Axis::reflected(4, 1.0);
        assert_eq!(axis.source, [0, 1, 2, 3, 3, 2, 1, 0]);
        assert!((axis.d0 - 4.0).abs() < 1e-12);
        let wide = Axis::reflected(1536, 5000.0);
        assert_eq!((wide.offset, wide.length()), (25, 1600));
        assert_eq!(wide.source[23..28], [1, 0, 0, 1, 2]);
        assert_eq!(wide.source[25 + 1535..25 + 1538], [1535, 1535, 1534]);
    }

    #[test]
    fn the_filter_stays_as_wide_in_pixels() {
        for length in [7usize, 101, 1536, 2048] {
            for d0 in [0.5, 50.0, 5000.0] {
                let axis = Axis::reflected(length, d0);
                let (on_image, in_frame) = (sigma(length, d0), sigma(axis.length(), axis.d0));
                assert!((on_image - in_frame).abs() < 1e-9 * on_image);
            }
        }
        assert!((sigma(2048, 5000.0) - 2048.0 / 444.29).abs() < 1e-4);
    }
}
