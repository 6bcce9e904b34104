//! Polygons cut into triangles.

use glam::{DVec2, DVec3};
use std::cmp::Ordering;

/// Corners up to which a concave polygon is cut properly; beyond, it becomes a fan.
const MOST_CORNERS: usize = 1 << 14;

/// Looks at corners after which what is left of a polygon becomes a fan: a second or so.
const MOST_LOOKS: usize = 1 << 30;

/// Triangles, as indices into `corners`, that fill a polygon without crossing its outline: of a convex one with
/// four corners the halves beside its shorter diagonal (as tinyobjloader has it), of one with more a fan, else
/// ears cut off one by one (Meisters, "Polygons have ears", 1975). Outlines that cross themselves come out as a
/// fan of what is left.
///
/// The same polygon is cut the same whichever corner is listed first and whichever way round, so that the two
/// sides of a face are cut alike. Each triangle begins at the first listed of its corners, and so does the list.
pub(crate) fn triangulate(corners: &[DVec3]) -> Vec<[usize; 3]> {
    if corners.len() == 3 {
        return vec![[0, 1, 2]];
    }
    let (start, way) = beginning(corners);
    let order: Vec<usize> = walk(corners.len(), start, way).collect();
    let outline: Vec<DVec3> = order.iter().map(|&corner| corners[corner]).collect();
    let mut triangles = cut(&outline);
    for triangle in &mut triangles {
        let [a, b, c] = triangle.map(|corner| order[corner]);
        *triangle = match way {
            Way::Forward => [a, b, c],
            Way::Backward => [a, c, b],
        };
        let least = (0..3).min_by_key(|&corner| triangle[corner]);
        triangle.rotate_left(least.unwrap_or_default());
    }
    triangles.sort_unstable();
    triangles
}

/// In which order corners are gone through.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Way {
    Forward,
    Backward,
}

/// All of `count` corners from `start` on.
fn walk(count: usize, start: usize, way: Way) -> impl Iterator<Item = usize> {
    (0..count).map(move |step| match way {
        Way::Forward => (start + step) % count,
        Way::Backward => (start + count - step) % count,
    })
}

/// Where a polygon begins, however it is listed: at its least position, towards the lesser neighbour. What is
/// alike in all that is to become a fan, which is the same either way.
fn beginning(corners: &[DVec3]) -> (usize, Way) {
    let compare = |a: DVec3, b: DVec3| {
        let [a, b] = [a, b].map(|at| (at + 0.0).to_array()); // -0 is 0
        let mut axes = a.iter().zip(&b).map(|(a, b)| a.total_cmp(b));
        axes.find(|order| order.is_ne()).unwrap_or(Ordering::Equal)
    };
    let count = corners.len();
    let least = (0..count).min_by(|&a, &b| compare(corners[a], corners[b]));
    let least = least.unwrap_or_default();
    if count > MOST_CORNERS {
        return (least, Way::Forward);
    }
    let starts = (0..count).filter(|&start| compare(corners[start], corners[least]).is_eq());
    let both = starts.flat_map(|start| [(start, Way::Forward), (start, Way::Backward)]);
    let first = both.min_by(|&(a, way_a), &(b, way_b)| {
        let pairs = walk(count, a, way_a).zip(walk(count, b, way_b));
        let mut orders = pairs.map(|(a, b)| compare(corners[a], corners[b]));
        orders
            .find(|order| order.is_ne())
            .unwrap_or(Ordering::Equal)
    });
    first.unwrap_or((0, Way::Forward))
}

/// The triangles of a polygon that begins where it is to begin.
fn cut(corners: &[DVec3]) -> Vec<[usize; 3]> {
    let flat = flattened(corners);
    let mut left: Vec<usize> = (0..corners.len()).collect();
    if let &[a, b, c, d] = corners
        && is_convex(&flat, &left)
        && b.distance_squared(d) < a.distance_squared(c)
    {
        return vec![[0, 1, 3], [1, 2, 3]];
    }
    let mut triangles = Vec::with_capacity(corners.len().saturating_sub(2));
    if corners.len() <= MOST_CORNERS {
        let mut looks = 0;
        while left.len() > 3 && looks < MOST_LOOKS && !is_convex(&flat, &left) {
            let is_ear = |&tip: &usize| {
                let turns = turn(&flat, around(&left, tip)) > 0.0;
                looks += if turns { left.len() } else { 1 };
                turns && is_empty(&flat, &left, tip)
            };
            let Some(tip) = (0..left.len()).find(is_ear) else {
                break;
            };
            triangles.push(around(&left, tip));
            left.remove(tip);
        }
    }
    triangles.extend((2..left.len()).map(|i| [left[0], left[i - 1], left[i]]));
    triangles
}

/// The corners in the plane of the polygon's mean normal (Newell), counter-clockwise.
fn flattened(corners: &[DVec3]) -> Vec<DVec2> {
    let next = corners.iter().cycle().skip(1);
    let normal: DVec3 = corners
        .iter()
        .zip(next)
        .map(|(a, b)| (*a - corners[0]).cross(*b - corners[0]))
        .sum();
    let Some(normal) = normal.try_normalize() else {
        return vec![DVec2::ZERO; corners.len()];
    };
    let (u, v) = normal.any_orthonormal_pair();
    let flat =
        |corner: &DVec3| DVec2::new((*corner - corners[0]).dot(u), (*corner - corners[0]).dot(v));
    corners.iter().map(flat).collect()
}

/// The corner at `tip` between its neighbours.
fn around(left: &[usize], tip: usize) -> [usize; 3] {
    let count = left.len();
    [
        left[(tip + count - 1) % count],
        left[tip],
        left[(tip + 1) % count],
    ]
}

/// Twice the signed area of a triangle; positive when counter-clockwise.
fn turn(flat: &[DVec2], [a, b, c]: [usize; 3]) -> f64 {
    (flat[b] - flat[a]).perp_dot(flat[c] - flat[a])
}

fn is_convex(flat: &[DVec2], left: &[usize]) -> bool {
    (0..left.len()).all(|tip| turn(flat, around(left, tip)) >= 0.0)
        && (2..left.len()).all(|i| turn(flat, [left[0], left[i - 1], left[i]]) >= 0.0)
}

/// Whether the triangle at `tip` holds no other corner.
fn is_empty(flat: &[DVec2], left: &[usize], tip: usize) -> bool {
    let [a, b, c] = around(left, tip);
    let inside = |other: usize| {
        let distinct = [a, b, c].iter().all(|&own| flat[own] != flat[other]);
        distinct
            && turn(flat, [a, b, other]) >= 0.0
            && turn(flat, [b, c, other]) >= 0.0
            && turn(flat, [c, a, other]) >= 0.0
    };
    !left.iter().any(|&other| inside(other))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn area(corners: &[DVec3], triangles: &[[usize; 3]]) -> f64 {
        triangles
            .iter()
            .map(|t| {
                let [a, b, c] = t.map(|i| corners[i]);
                0.5 * (b - a).cross(c - a).length()
            })
            .sum()
    }

    fn lifted(outline: &[(f64, f64)]) -> Vec<DVec3> {
        outline
            .iter()
            .map(|&(x, y)| DVec3::new(x, 2.0 * y, 3.0 * y + 1e6))
            .collect()
    }

    #[test]
    fn convex_polygons_become_fans() {
        let square = lifted(&[(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)]);
        assert_eq!(triangulate(&square), [[0, 1, 2], [0, 2, 3]]);
        let house = lifted(&[(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.5, 2.0), (0.0, 1.0)]);
        assert_eq!(triangulate(&house), [[0, 1, 2], [0, 2, 3], [0, 3, 4]]);
    }

    /// Both halves of a kite beside its shorter diagonal, from any corner and either way round.
    #[test]
    fn four_corners_are_cut_along_the_shorter_diagonal() {
        let kite = lifted(&[(0.0, 0.0), (3.0, -1.0), (9.0, 0.0), (3.0, 1.0)]);
        for start in 0..4 {
            let mut listed = kite.clone();
            listed.rotate_left(start);
            let across = match start % 2 {
                0 => [[0, 1, 3], [1, 2, 3]],
                _ => [[0, 1, 2], [0, 2, 3]],
            };
            assert_eq!(triangulate(&listed), across, "from {start}");
            listed[1..].reverse();
            assert_eq!(triangulate(&listed), across, "from {start}, backward");
        }
    }

    /// Triangles by the places of their corners, from the least one on, and their winding with respect to +Z.
    fn places(corners: &[DVec3]) -> Vec<(Vec<[u64; 3]>, bool)> {
        let triangles = triangulate(corners);
        let place = |corner: usize| corners[corner].to_array().map(f64::to_bits);
        let mut all: Vec<(Vec<[u64; 3]>, bool)> = (triangles.iter())
            .map(|&[a, b, c]| {
                let [p, q, r] = [a, b, c].map(|corner| corners[corner]);
                let mut three: Vec<[u64; 3]> = [a, b, c].map(place).to_vec();
                three.sort_unstable();
                (three, (q - p).cross(r - p).z > 0.0)
            })
            .collect();
        all.sort_unstable();
        all
    }

    /// A bent quad, a pentagon, an arrow head, and a square with a slit to a hole in it.
    #[test]
    fn a_polygon_is_cut_the_same_from_any_corner_and_either_way_round() {
        let bent = [
            [0.0, 0.0, 0.0],
            [1.0, 0.1, 0.5],
            [1.2, 1.0, 0.0],
            [0.1, 0.9, 0.7],
        ];
        let pentagon = [[1.0, 0.0], [2.0, 0.0], [2.5, 1.0], [1.5, 2.0], [0.5, 1.0]];
        let arrow = [[0.0, 0.0], [2.0, -1.0], [1.0, 0.0], [2.0, 1.0]];
        let slit = [
            [0.0, 0.0],
            [4.0, 0.0],
            [4.0, 4.0],
            [0.0, 4.0],
            [0.0, 0.0],
            [1.0, 1.0],
            [1.0, 3.0],
            [3.0, 3.0],
            [3.0, 1.0],
            [1.0, 1.0],
        ];
        let flat = |outline: &[[f64; 2]]| {
            let lift = |&[x, y]: &[f64; 2]| DVec3::new(x, y, 0.1 * x + 0.237 * y);
            outline.iter().map(lift).collect::<Vec<DVec3>>()
        };
        let outlines = [
            bent.map(DVec3::from_array).to_vec(),
            flat(&pentagon),
            flat(&arrow),
            flat(&slit),
        ];
        for outline in outlines {
            let expected = places(&outline);
            assert_eq!(expected.len(), outline.len() - 2);
            let turned: Vec<(Vec<[u64; 3]>, bool)> =
                expected.iter().map(|(at, up)| (at.clone(), !up)).collect();
            for start in 0..outline.len() {
                let mut listed = outline.clone();
                listed.rotate_left(start);
                assert_eq!(places(&listed), expected, "from {start}");
                listed.reverse();
                assert_eq!(places(&listed), turned, "from {start}, backward");
            }
        }
    }

    #[test]
    fn concave_polygons_keep_their_area() {
        // An arrow head whose fan from the first corner would spill out, and a comb.
        let arrow = [(0.0, 0.0), (2.0, -1.0), (1.0, 0.0), (2.0, 1.0)];
        let comb = [
            (0.0, 0.0),
            (5.0, 0.0),
            (5.0, 3.0),
            (4.0, 1.0),
            (3.0, 3.0),
            (2.0, 1.0),
            (1.0, 3.0),
        ];
        for (outline, flat_area) in [(&arrow[..], 1.0), (&comb[..], 9.5)] {
            for turn in 0..outline.len() {
                let mut outline = outline.to_vec();
                outline.rotate_left(turn);
                let corners = lifted(&outline);
                let triangles = triangulate(&corners);
                assert_eq!(triangles.len(), outline.len() - 2);
                let expected = flat_area * 13.0f64.sqrt();
                assert!(
                    (area(&corners, &triangles) - expected).abs() < 1e-6,
                    "{outline:?}"
                );
            }
        }
    }

    #[test]
    fn an_outline_of_thousands_of_corners_keeps_its_area() {
        let count = 4000;
        let corner = |index: usize| {
            let angle = std::f64::consts::TAU * index as f64 / count as f64;
            let radius = 0.75 + 0.25 * (5.0 * angle).cos();
            DVec3::new(radius * angle.cos(), radius * angle.sin(), 0.0)
        };
        let corners: Vec<DVec3> = (0..count).map(corner).collect();
        let next = corners.iter().cycle().skip(1);
        let twice: f64 = corners.iter().zip(next).map(|(a, b)| a.cross(*b).z).sum();
        let found = area(&corners, &triangulate(&corners));
        assert!((found - 0.5 * twice).abs() < 1e-9, "{found}");
    }

    #[test]
    fn nonsense_outlines_still_end() {
        let crossed = lifted(&[(0.0, 0.0), (1.0, 1.0), (1.0, 0.0), (0.0, 1.0), (2.0, 5.0)]);
        assert_eq!(triangulate(&crossed).len(), 3);
        assert_eq!(triangulate(&[DVec3::ONE; 6]).len(), 4);
        let winding: Vec<DVec3> = (0..5000).map(|i| crossed[i % 5]).collect();
        assert_eq!(triangulate(&winding).len(), 4998);
        let many: Vec<DVec3> = (0..50_000).map(|i| crossed[i % 5]).collect();
        assert_eq!(triangulate(&many).len(), 49_998);
    }
}
