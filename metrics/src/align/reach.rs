//! Which of a few fixed points is near a place, asked very often.

use crate::distance::squared_distance;
use glam::DVec3;

/// Cells along an axis at most.
const MOST_CELLS: f64 = 32.0;
/// Covers the rounding of a distance and of its comparison.
const SLACK: f64 = 1.0 + 1e-9;

/// A grid whose cells list every point that may be within a distance of a place in the cell.
#[derive(Debug)]
pub(super) struct Reach {
    start: DVec3,
    cells_per_unit: f64,
    cells: [usize; 3],
    /// Per cell where its points start, and the end of the last.
    starts: Vec<u32>,
    points: Vec<DVec3>,
}

impl Reach {
    /// A grid for the finite `points`, at least one, and a distance above 0.
    pub(super) fn new(points: &[DVec3], distance: f64) -> Self {
        let reach = distance * SLACK;
        let nowhere = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        let wider = |(min, max): (DVec3, DVec3), &p: &DVec3| (min.min(p), max.max(p));
        let (min, max) = points.iter().fold(nowhere, wider);
        let (start, end) = (min - reach, max + reach);
        let edge = (2.0 * reach).max((end - start).max_element() / MOST_CELLS);
        let mut grid = Self {
            start,
            cells_per_unit: edge.recip(),
            cells: [1; 3],
            starts: Vec::new(),
            points: Vec::new(),
        };
        grid.cells = grid.cell(end).map(|last| last.max(0.0) as usize + 1);
        let mut lists = vec![Vec::new(); grid.cells.iter().product()];
        for &point in points {
            let (low, high) = (grid.cell(point - reach), grid.cell(point + reach));
            let range =
                |axis: usize| low[axis] as usize..=(high[axis] as usize).min(grid.cells[axis] - 1);
            for x in range(0) {
                for y in range(1) {
                    for z in range(2) {
                        lists[grid.number([x, y, z])].push(point);
                    }
                }
            }
        }
        grid.starts.push(0);
        for list in lists {
            grid.points.extend(list);
            grid.starts.push(grid.points.len() as u32);
        }
        grid
    }

    /// How many cells a place lies past the start; a cast takes it down to the number of its cell. Each
    /// is monotonic in its coordinate: what lies between two places lies between their cells.
    #[inline]
    fn cell(&self, place: DVec3) -> [f64; 3] {
        ((place - self.start) * self.cells_per_unit).to_array()
    }

    fn number(&self, [x, y, z]: [usize; 3]) -> usize {
        (x * self.cells[1] + y) * self.cells[2] + z
    }

    /// The squared distance to the nearest point if that is below the distance; if not, some squared
    /// distance that is not below, or infinity.
    pub(super) fn nearest_square(&self, place: DVec3) -> f64 {
        let cell = self.cell(place);
        let inside = |axis: usize| (0.0..self.cells[axis] as f64).contains(&cell[axis]);
        if !(inside(0) && inside(1) && inside(2)) {
            return f64::INFINITY;
        }
        let number = self.number(cell.map(|along| along as usize));
        let (first, end) = (
            self.starts[number] as usize,
            self.starts[number + 1] as usize,
        );
        let squares = self.points[first..end]
            .iter()
            .map(|&p| squared_distance(place, p));
        squares.fold(
            f64::INFINITY,
            |least, square| if square < least { square } else { least },
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::align::tests::scattered;

    #[test]
    fn squares_are_those_of_trying_every_point() {
        for (scale, offset) in [
            (1.0, DVec3::ZERO),
            (50.0, DVec3::new(5e5, 4e6, 1e2)),
            (1e-3, DVec3::ONE),
        ] {
            let placed = |seed, n| {
                scattered(seed, n)
                    .iter()
                    .map(|p| *p * scale + offset)
                    .collect::<Vec<_>>()
            };
            let (points, places) = (placed(60, 200), placed(61, 3000));
            for distance in [0.02, 0.2, 3.0].map(|d: f64| d * scale) {
                let grid = Reach::new(&points, distance);
                let bound = distance * distance;
                for &place in &places {
                    let squares = points.iter().map(|&p| squared_distance(place, p));
                    let expected = squares.fold(f64::INFINITY, f64::min);
                    let found = grid.nearest_square(place);
                    assert_eq!(found < bound, expected < bound);
                    assert!(found == expected || expected >= bound, "{place}");
                }
            }
        }
    }

    #[test]
    fn far_and_impossible_places_have_nothing_near() {
        let grid = Reach::new(&[DVec3::ZERO], 0.5);
        for place in [
            DVec3::splat(1e300),
            DVec3::NAN,
            DVec3::NEG_INFINITY,
            DVec3::X,
        ] {
            let near = grid.nearest_square(place) < 0.25;
            assert!(!near, "{place}");
        }
        assert_eq!(grid.nearest_square(DVec3::X * 0.25), 0.0625);
    }
}
