use crate::error::{Error, Result};
use std::ops::Range;

/// A rectangle of pixel values, row-major from the top-left pixel. Never empty.
#[derive(Debug, Clone, PartialEq)]
pub struct Raster<T> {
    width: u32,
    height: u32,
    values: Vec<T>,
}

/// An 8-bit sRGB image.
pub type ColorImage = Raster<[u8; 3]>;
/// Which pixels count.
pub type Mask = Raster<bool>;
/// Unit normals in the camera frame (OpenCV axes), facing the camera; zero means none.
pub type NormalMap = Raster<[f32; 3]>;

/// Columns and rows of a raster, from the top left.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Window {
    /// Columns.
    pub columns: Range<u32>,
    /// Rows.
    pub rows: Range<u32>,
}

impl Window {
    /// All of a raster of this width and height.
    pub fn whole((width, height): (u32, u32)) -> Self {
        Self {
            columns: 0..width,
            rows: 0..height,
        }
    }

    /// Width and height in pixels.
    pub fn size(&self) -> (u32, u32) {
        let length = |range: &Range<u32>| range.end.saturating_sub(range.start);
        (length(&self.columns), length(&self.rows))
    }

    /// Whether it holds a pixel, and only pixels of a raster of this width and height.
    pub fn is_within(&self, (width, height): (u32, u32)) -> bool {
        !self.columns.is_empty()
            && !self.rows.is_empty()
            && self.columns.end <= width
            && self.rows.end <= height
    }
}

impl<T> Raster<T> {
    /// A raster from its values, `width * height` of them, row-major from the top-left pixel.
    ///
    /// # Errors
    /// No pixels, and another count of values.
    pub fn from_values(width: u32, height: u32, values: Vec<T>) -> Result<Self> {
        let expected = width as usize * height as usize;
        if expected == 0 || values.len() != expected {
            let found = values.len();
            let problem = format!(
                "expected {width} x {height} = {expected} values and at least one, found {found}"
            );
            return Err(Error::invalid("raster", problem));
        }
        Ok(Self {
            width,
            height,
            values,
        })
    }

    /// Width in pixels, ≥ 1.
    pub fn width(&self) -> u32 {
        self.width
    }

    /// Height in pixels, ≥ 1.
    pub fn height(&self) -> u32 {
        self.height
    }

    /// (width, height) in pixels.
    pub fn size(&self) -> (u32, u32) {
        (self.width, self.height)
    }

    /// All values, row-major from the top-left pixel.
    pub fn values(&self) -> &[T] {
        &self.values
    }

    /// All values, to be changed in place.
    pub fn values_mut(&mut self) -> &mut [T] {
        &mut self.values
    }

    /// The values without their shape.
    pub fn into_values(self) -> Vec<T> {
        self.values
    }

    /// The rows from the top.
    pub fn rows(&self) -> std::slice::ChunksExact<'_, T> {
        self.values.chunks_exact(self.width as usize)
    }

    /// A raster of the same size with every value mapped.
    pub fn map<U>(&self, f: impl FnMut(&T) -> U) -> Raster<U> {
        let values = self.values.iter().map(f).collect();
        Raster {
            width: self.width,
            height: self.height,
            values,
        }
    }

    /// Index of pixel (`column`, `row`) in [`Raster::values`].
    fn index(&self, column: u32, row: u32) -> usize {
        debug_assert!(column < self.width && row < self.height);
        row as usize * self.width as usize + column as usize
    }
}

impl<T: Copy> Raster<T> {
    /// A raster of one value. Sizes are ≥ 1.
    ///
    /// # Errors
    /// A width or a height of 0.
    pub fn filled(width: u32, height: u32, value: T) -> Result<Self> {
        Self::from_values(width, height, vec![value; width as usize * height as usize])
    }

    /// What lies in `window`, which is not empty and lies within the raster.
    ///
    /// # Errors
    /// A window that is empty or reaches beyond the raster.
    pub fn cut(&self, window: &Window) -> Result<Self> {
        if !window.is_within(self.size()) {
            let problem = format!(
                "expected one of {}x{} pixels, found {window:?}",
                self.width, self.height
            );
            return Err(Error::invalid("window", problem));
        }
        let (width, height) = window.size();
        let mut values = Vec::with_capacity(width as usize * height as usize);
        for row in window.rows.clone() {
            let first = self.index(window.columns.start, row);
            values.extend_from_slice(&self.values[first..first + width as usize]);
        }
        Self::from_values(width, height, values)
    }

    /// The value of pixel (`column`, `row`), both inside the raster.
    pub fn get(&self, column: u32, row: u32) -> T {
        self.values[self.index(column, row)]
    }

    /// Changes the value of pixel (`column`, `row`), both inside the raster.
    pub fn set(&mut self, column: u32, row: u32, value: T) {
        let index = self.index(column, row);
        self.values[index] = value;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_row_major_from_the_top_left() {
        let raster = Raster::from_values(3, 2, vec![0, 1, 2, 3, 4, 5]).unwrap();
        assert_eq!((raster.get(2, 0), raster.get(0, 1)), (2, 3));
        assert_eq!(raster.rows().nth(1), Some(&[3, 4, 5][..]));
        assert_eq!(raster.map(|v| v * 2).into_values(), [0, 2, 4, 6, 8, 10]);
    }

    #[test]
    fn a_window_is_cut_out_and_none_beyond_the_raster_or_without_pixels() {
        let raster = Raster::from_values(4, 3, (0..12).collect()).unwrap();
        let window = |columns, rows| Window { columns, rows };
        let cut = raster.cut(&window(1..3, 1..3)).unwrap();
        assert_eq!((cut.size(), cut.values()), ((2, 2), &[5, 6, 9, 10][..]));
        assert_eq!(raster.cut(&Window::whole((4, 3))).unwrap(), raster);
        for odd in [
            window(1..5, 0..3),
            window(0..4, 2..4),
            window(2..2, 0..3),
            window(0..4, 3..3),
        ] {
            let error = raster.cut(&odd).unwrap_err().to_string();
            assert!(error.contains("expected one of 4x3 pixels"), "{error}");
        }
    }

    #[test]
    fn shape_and_count_must_agree() {
        let error = Raster::from_values(3, 2, vec![0; 5])
            .unwrap_err()
            .to_string();
        assert!(
            error.contains("3 x 2 = 6") && error.contains("found 5"),
            "{error}"
        );
        assert!(Raster::<u8>::from_values(0, 2, vec![]).is_err());
    }
}
