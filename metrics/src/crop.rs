//! The region in which points are judged: Open3D's `SelectionPolygonVolume`.

use crate::error::{Error, Result};
use glam::{DVec2, DVec3};
use rayon::prelude::*;

/// Slabs into which the polygon is cut.
const SLABS: f64 = 256.0;
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
    slabs: Slabs,
}

/// An edge i→j of a polygon.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Edge {
    i: DVec2,
    j: DVec2,
    /// The edge's own range along the first axis, with room for rounding: beyond it there is nothing to
    /// compute.
    low: f64,
    high: f64,
}

/// Covers the rounding of a point on an edge, relative to its ends.
const ROUNDING: f64 = 1e-12;
/// How far a box lies from an edge that is clear of it, relative to their coordinates.
const CLEAR: f64 = 1e-9;

impl Edge {
    fn new(i: DVec2, j: DVec2) -> Self {
        let room = if (j - i).is_finite() {
            ROUNDING * (i.x.abs() + j.x.abs())
        } else {
            f64::INFINITY
        };
        let (low, high) = (i.x.min(j.x) - room, i.x.max(j.x) + room);
        Self { i, j, low, high }
    }

    /// Whether it is crossed strictly left of a place.
    #[inline]
    fn is_crossed_left_of(&self, pu: f64, pv: f64) -> bool {
        let (i, j) = (self.i, self.j);
        let crossed = (i.y < pv && j.y >= pv) || (j.y < pv && i.y >= pv);
        if !crossed || pu <= self.low || pu > self.high {
            return crossed && pu > self.high;
        }
        i.x + (pv - i.y) / (j.y - i.y) * (j.x - i.x) < pu
    }

    /// Whether it is clear that it stays outside of a box.
    fn keeps_out_of(&self, (low, high): (DVec2, DVec2)) -> bool {
        let (i, j) = (self.i, self.j);
        if i.y.max(j.y) < low.y || high.y < i.y.min(j.y) || self.high < low.x || high.x < self.low {
            return true;
        }
        let along = j - i;
        let length = along.abs().element_sum();
        let side = |corner: DVec2| {
            let reach = (i.abs() + j.abs() + corner.abs()).element_sum();
            let area = along.perp_dot(corner - i);
            // Well above all rounding, here and where a single point is looked at.
            let sure = area.is_finite() && area.abs() > CLEAR * length * reach;
            if sure { area.signum() } else { 0.0 }
        };
        let others = [high, DVec2::new(low.x, high.y), DVec2::new(high.x, low.y)];
        side(low) != 0.0 && others.into_iter().all(|corner| side(corner) == side(low))
    }
}

/// The polygon's edges, listed for each of equal slabs along its second axis that they may cross.
#[derive(Debug, Clone, PartialEq)]
struct Slabs {
    start: f64,
    slabs_per_unit: f64,
    /// Where the edges of a slab start, and the end of the last.
    starts: Vec<u32>,
    edges: Vec<Edge>,
}

impl Slabs {
    fn new(edges: &[Edge]) -> Self {
        let along = || edges.iter().map(|edge| edge.i.y);
        let start = along().fold(f64::INFINITY, f64::min);
        let end = along().fold(f64::NEG_INFINITY, f64::max);
        let slabs_per_unit = SLABS / (end - start);
        let mut slabs = Self {
            start,
            slabs_per_unit: if slabs_per_unit.is_finite() {
                slabs_per_unit
            } else {
                0.0
            },
            starts: vec![0],
            edges: Vec::new(),
        };
        for slab in 0..=SLABS as usize {
            let crosses = |edge: &&Edge| {
                let (i, j) = (slabs.slab_of(edge.i.y), slabs.slab_of(edge.j.y));
                i.min(j) <= slab && slab <= i.max(j)
            };
            let listed: Vec<_> = edges.iter().filter(crosses).copied().collect();
            slabs.edges.extend(listed);
            slabs.starts.push(slabs.edges.len() as u32);
        }
        slabs
    }

    /// Monotonic: what lies between two places lies between their slabs. NaN and what is before the
    /// first slab are taken to it, NaN by the cast.
    #[inline]
    fn slab_of(&self, along: f64) -> usize {
        let slab = (along - self.start) * self.slabs_per_unit;
        slab.clamp(0.0, SLABS) as usize
    }

    /// The edges that may be crossed at a place, in the polygon's order.
    #[inline]
    fn at(&self, along: f64) -> &[Edge] {
        self.between(along, along)
    }

    /// The edges that may be crossed from one place to a later one.
    #[inline]
    fn between(&self, from: f64, to: f64) -> &[Edge] {
        let (first, last) = (self.slab_of(from), self.slab_of(to));
        &self.edges[self.starts[first] as usize..self.starts[last + 1] as usize]
    }
}

impl Prism {
    /// The prism along `axis` (0, 1 or 2) with `min ≤ x_axis ≤ max`, both included, and a
    /// `polygon` over the two other axes in ascending order, at least three vertices, all finite.
    ///
    /// # Errors
    /// Another axis, bounds that are NaN or crossed, fewer than three vertices, and vertices that are not finite.
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
        if let Some(at) = polygon.iter().position(|vertex| !vertex.is_finite()) {
            let problem = format!(
                "expected finite polygon vertices, found {} as vertex {at}",
                polygon[at]
            );
            return Err(Error::invalid("crop", problem));
        }
        if polygon.len() < 3 {
            let found = polygon.len();
            let problem = format!("expected at least 3 polygon vertices, found {found}");
            return Err(Error::invalid("crop", problem));
        }
        let following = polygon.iter().cycle().skip(1);
        let edges = polygon
            .iter()
            .zip(following)
            .map(|(&i, &j)| Edge::new(i, j));
        Ok(Self {
            axis,
            u,
            v,
            min,
            max,
            slabs: Slabs::new(&edges.collect::<Vec<_>>()),
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
        let crossed_left = |inside, edge: &Edge| inside ^ edge.is_crossed_left_of(pu, pv);
        self.slabs.at(pv).iter().fold(false, crossed_left)
    }

    /// Whether all points of a box, its surface included, are inside, or none is; `None` where that is
    /// not clear without a look at the points.
    pub fn holds(&self, (min, max): (DVec3, DVec3)) -> Option<bool> {
        if !(min.is_finite() && max.is_finite()) {
            return None;
        }
        if max[self.axis] < self.min || self.max < min[self.axis] {
            return Some(false);
        }
        if min[self.axis] < self.min || self.max < max[self.axis] {
            return None;
        }
        let flat = |corner: DVec3| DVec2::new(corner[self.u], corner[self.v]);
        let (low, high) = (flat(min), flat(max));
        let clear = |edge: &Edge| edge.keeps_out_of((low, high));
        let edges = self.slabs.between(low.y, high.y);
        edges.iter().all(clear).then(|| self.contains(min))
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

    /// Points on vertices, on their height, between and beyond, against a loop over all edges.
    #[test]
    fn slabs_change_nothing() {
        let star = |k: u32| {
            let angle = f64::from(k) * 0.371;
            (3.0 + 2.0 * f64::from(k * 7 % 5)) * DVec2::from_angle(angle)
        };
        let star: Vec<DVec2> = (0..40).map(star).collect();
        let far = [(0.0, -1e308), (1e308, 1e308), (-1e308, 1e308)].map(DVec2::from);
        let flat = [(0.0, 1.0), (2.0, 1.0), (3.0, 1.0)].map(DVec2::from);
        for polygon in [&star[..], &notched(), &far, &flat] {
            let prism = Prism::new(2, (0.0, 0.0), polygon).unwrap();
            let along = |k: usize| polygon.iter().map(move |v| v[k]);
            let (mut us, mut vs): (Vec<f64>, Vec<f64>) = (along(0).collect(), along(1).collect());
            for k in 0..400 {
                us.push(f64::from(k) * 0.063 - 12.0);
                vs.push(f64::from(k) * 0.071 - 13.0);
            }
            let mut inside = 0;
            for &u in &us {
                for &v in &vs {
                    let edges = (0..polygon.len()).map(|k| {
                        let (i, j) = (polygon[k], polygon[(k + 1) % polygon.len()]);
                        let crossed = (i.y < v && j.y >= v) || (j.y < v && i.y >= v);
                        crossed && i.x + (v - i.y) / (j.y - i.y) * (j.x - i.x) < u
                    });
                    let expected = edges.filter(|&left| left).count() % 2 == 1;
                    assert_eq!(prism.contains(DVec3::new(u, v, 0.0)), expected, "{u} {v}");
                    inside += usize::from(expected);
                }
            }
            assert!(inside > 0 || polygon == flat);
        }
    }

    /// Boxes of all sizes in, out of and across polygons: what is said of a box holds for points on a
    /// fine grid in it, its corners included.
    #[test]
    fn a_box_is_inside_with_all_its_points() {
        let star = |k: u32| {
            let angle = f64::from(k) * 0.371;
            (3.0 + 2.0 * f64::from(k * 7 % 5)) * DVec2::from_angle(angle)
        };
        let star: Vec<DVec2> = (0..17).map(star).collect();
        let far = [(0.0, -1e308), (1e308, 1e308), (-1e308, 1e308)].map(DVec2::from);
        let square = [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)].map(DVec2::from);
        for polygon in [&star[..], &notched(), &far, &square] {
            let prism = Prism::new(1, (-1.0, 1.0), polygon).unwrap();
            let mut answers = [0; 3];
            let mut random = crate::align::tests::scattered(60, 4000).into_iter();
            while let (Some(at), Some(by)) = (random.next(), random.next()) {
                let min = at * DVec3::new(9.0, 1.1, 9.0);
                let max = min + by.abs() * by.x.abs().powi(3) * DVec3::new(6.0, 0.5, 6.0);
                let steps =
                    |k: usize| [0.0, 0.25, 0.5, 0.75, 1.0].map(|t| min[k] + t * (max[k] - min[k]));
                let answer = prism.holds((min, max));
                answers[answer.map_or(2, usize::from)] += 1;
                for x in steps(0) {
                    for y in steps(1) {
                        for z in steps(2) {
                            let inside = prism.contains(DVec3::new(x, y, z));
                            assert!(answer.is_none_or(|answer| answer == inside));
                        }
                    }
                }
            }
            assert!(answers[0] > 20 && answers[2] > 20, "{answers:?}");
            assert!(answers[1] > 2 || polygon == far, "{answers:?}");
        }
        // All of its edges in one line, at the end of the number range: there is only one slab.
        let flat = [(0.0, 1e308), (1.0, 1e308), (3.0, 1e308)].map(DVec2::from);
        let prism = Prism::new(2, (-1.0, 1.0), &flat).unwrap();
        let (min, max) = (DVec3::new(0.0, -1e308, 0.0), DVec3::new(1.0, 0.0, 0.0));
        assert_eq!(prism.holds((min, max)), Some(false));
        let prism = Prism::new(2, (-1.0, 1.0), &square).unwrap();
        let holds = |min: [f64; 3], max: [f64; 3]| prism.holds((min.into(), max.into()));
        assert_eq!(holds([0.1, 0.1, -1.0], [0.9, 0.9, 1.0]), Some(true));
        assert_eq!(holds([0.1, 0.1, -1.0], [0.9, 0.9, 1.5]), None);
        assert_eq!(holds([0.0, 0.1, 0.0], [0.9, 0.9, 0.0]), None);
        assert_eq!(holds([0.1, 0.1, 0.0], [0.9, f64::INFINITY, 0.0]), None);
        assert_eq!(holds([0.1, 0.1, 1.1], [0.9, 0.9, 1.5]), Some(false));
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
        let mut holed = polygon.clone();
        holed[1].y = f64::NAN;
        let error = Prism::new(0, (0.0, 1.0), &holed).unwrap_err();
        assert!(error.to_string().contains("NaN] as vertex 1"), "{error}");
    }
}
