//! The region in which points are judged: Open3D's `SelectionPolygonVolume`.

use crate::error::{Error, Result};
use glam::{DVec2, DVec3};
use rayon::prelude::*;

/// Points handled by one task.
const BLOCK: usize = 1 << 14;

/// A prism: a polygon over two axes, swept along the third between two bounds.
#[derive(Debug, Clone, PartialEq)]
pub struct Prism {
    axis: usize,
    u: usize,
    v: usize,
    min: f64,
    max: f64,
    edges: Vec<[DVec2; 2]>,
}

impl Prism {
    /// The prism along `axis` (0, 1 or 2) with `min ≤ x_axis ≤ max`, both included, and a
    /// `polygon` over the two other axes in ascending order, at least three vertices, all finite.
    pub fn new(axis: usize, (min, max): (f64, f64), polygon: &[DVec2]) -> Result<Self> {
        let (u, v) = match axis {
            0 => (1, 2),
            1 => (0, 2),
            2 => (0, 1),
            _ => {
                let problem = format!("expected an axis 0, 1 or 2, found {axis}");
                return Err(Error::invalid("crop", problem));
            }
        };
        if min.is_nan() || max.is_nan() || min > max {
            let problem = format!("expected bounds min ≤ max, found {min} and {max}");
            return Err(Error::invalid("crop", problem));
        }
        if polygon.len() < 3 || polygon.iter().any(|vertex| !vertex.is_finite()) {
            let found = polygon.len();
            let problem = format!("expected at least 3 finite polygon vertices, found {found}");
            return Err(Error::invalid("crop", problem));
        }
        let following = polygon.iter().cycle().skip(1);
        let edges = polygon.iter().zip(following).map(|(&i, &j)| [i, j]);
        Ok(Self {
            axis,
            u,
            v,
            min,
            max,
            edges: edges.collect(),
        })
    }

    /// Whether a point is inside. The bounds on the axis are inside. On the polygon's own edges the
    /// answer is Open3D's: an edge i→j is crossed where `v_i < p_v ≤ v_j` or `v_j < p_v ≤ v_i`, and
    /// a point is inside where an odd number of crossings lies strictly left of `p_u`.
    #[inline]
    pub fn contains(&self, point: DVec3) -> bool {
        let w = point[self.axis];
        if !(self.min <= w && w <= self.max) {
            return false;
        }
        let (pu, pv) = (point[self.u], point[self.v]);
        let crossed_left = |&&[i, j]: &&[DVec2; 2]| {
            let crossed = (i.y < pv && j.y >= pv) || (j.y < pv && i.y >= pv);
            crossed && i.x + (pv - i.y) / (j.y - i.y) * (j.x - i.x) < pu
        };
        self.edges.iter().filter(crossed_left).count() % 2 == 1
    }

    /// The indices of the points inside, ascending.
    pub fn select(&self, points: &[DVec3]) -> Vec<usize> {
        let blocks: Vec<Vec<usize>> = points
            .par_chunks(BLOCK)
            .enumerate()
            .map(|(block, chunk)| {
                let first = block * BLOCK;
                let inside = |&offset: &usize| self.contains(chunk[offset]);
                (0..chunk.len())
                    .filter(inside)
                    .map(|offset| first + offset)
                    .collect()
            })
            .collect();
        blocks.concat()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn notched() -> Vec<DVec2> {
        let corners = [(0.0, 0.0), (4.0, 0.0), (4.0, 4.0), (2.0, 1.0), (0.0, 4.0)];
        corners.map(DVec2::from).to_vec()
    }

    #[test]
    fn the_notch_is_outside() {
        let prism = Prism::new(2, (-1.0, 1.0), &notched()).unwrap();
        let inside = |x, y, z| prism.contains(DVec3::new(x, y, z));
        assert!(inside(2.0, 0.5, 0.0) && inside(0.5, 2.0, 0.0) && inside(3.5, 2.0, 0.0));
        assert!(!inside(2.0, 2.0, 0.0), "in the notch");
        assert!(
            inside(2.0, 0.5, 1.0) && !inside(2.0, 0.5, 1.0 + 1e-12),
            "bounds are inside"
        );
        assert!(
            !inside(f64::NAN, 0.5, 0.0)
                && !inside(2.0, f64::NAN, 0.0)
                && !inside(1.0, 0.5, f64::NAN)
        );
    }

    #[test]
    fn edges_belong_to_one_side_only() {
        let square = [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)].map(DVec2::from);
        let prism = Prism::new(2, (0.0, 0.0), &square).unwrap();
        let inside = |x, y| prism.contains(DVec3::new(x, y, 0.0));
        assert!(
            !inside(0.0, 0.5) && inside(1.0, 0.5),
            "left edge out, right edge in"
        );
        assert!(
            !inside(0.5, 0.0) && inside(0.5, 1.0),
            "lower edge out, upper edge in"
        );
    }

    #[test]
    fn each_axis_pairs_the_two_others_in_ascending_order() {
        let square = [(10.0, 20.0), (11.0, 20.0), (11.0, 21.0), (10.0, 21.0)].map(DVec2::from);
        for (axis, inner) in [[0.0, 10.5, 20.5], [10.5, 0.0, 20.5], [10.5, 20.5, 0.0]]
            .into_iter()
            .enumerate()
        {
            let prism = Prism::new(axis, (0.0, 0.0), &square).unwrap();
            assert!(prism.contains(DVec3::from(inner)), "axis {axis}");
        }
    }

    #[test]
    fn selection_is_in_input_order_at_any_size() {
        let prism = Prism::new(2, (0.0, 0.0), &notched()).unwrap();
        let points: Vec<DVec3> = (0..50_000)
            .map(|i| DVec3::new(f64::from(i % 97) / 20.0, f64::from(i % 89) / 20.0, 0.0))
            .collect();
        let expected: Vec<usize> = (0..points.len())
            .filter(|&index| prism.contains(points[index]))
            .collect();
        assert_eq!(prism.select(&points), expected);
        assert!(!expected.is_empty() && expected.len() < points.len());
    }

    #[test]
    fn bad_prisms_are_refused() {
        let polygon = notched();
        assert!(Prism::new(3, (0.0, 1.0), &polygon).is_err());
        assert!(Prism::new(0, (1.0, 0.0), &polygon).is_err());
        assert!(Prism::new(0, (f64::NAN, 0.0), &polygon).is_err());
        assert!(Prism::new(0, (0.0, 1.0), &polygon[..2]).is_err());
        assert!(Prism::new(0, (0.0, 1.0), &[DVec2::NAN; 3]).is_err());
    }
}
