//! A bounding volume hierarchy: a binary tree of boxes, split where the surface-area heuristic
//! (Wald, "On fast Construction of SAH-based Bounding Volume Hierarchies", 2007) is cheapest.

use glam::DVec3;
use mvs_datasets::scene::Aabb;

/// Leaves hold at most this many items, unless all of them have the same centre.
const LEAF_SIZE: usize = 4;
/// Candidate planes per axis, plus one.
const BINS: usize = 16;

/// A tree over the boxes of numbered items.
#[derive(Debug)]
pub(crate) struct Bvh {
    nodes: Vec<Node>,
    /// Item numbers, those of one leaf side by side.
    order: Vec<u32>,
}

#[derive(Debug, Clone, Copy)]
struct Node {
    bounds: Aabb,
    /// The first of two neighbouring children, or of the leaf's items in `order`.
    first: usize,
    /// Items of a leaf; 0 for an inner node.
    count: usize,
}

impl Bvh {
    /// A tree over items 0, 1, … with these boxes.
    pub(crate) fn new(boxes: &[Aabb]) -> Self {
        let centers: Vec<DVec3> = boxes.iter().map(Aabb::center).collect();
        let mut order: Vec<u32> = (0..).take(boxes.len()).collect();
        let mut nodes = vec![leaf(boxes, &order, 0..boxes.len())];
        let mut unsplit = vec![0];
        while let Some(index) = unsplit.pop() {
            let Node { first, count, .. } = nodes[index];
            if count <= LEAF_SIZE {
                continue;
            }
            let items = &mut order[first..first + count];
            let Some(left) = split(boxes, &centers, items) else {
                continue;
            };
            let children = nodes.len();
            nodes.push(leaf(boxes, &order, first..first + left));
            nodes.push(leaf(boxes, &order, first + left..first + count));
            nodes[index].first = children;
            nodes[index].count = 0;
            unsplit.extend([children, children + 1]);
        }
        Self { nodes, order }
    }

    /// Calls `visit` with the items of every leaf whose box the ray meets before the distance that
    /// `visit` returned last (`limit` at first), nearest boxes first.
    ///
    /// Boxes are taken as larger by `margin` on each side, which has to cover the rounding of the
    /// ray and of what `visit` computes.
    pub(crate) fn walk(
        &self,
        origin: DVec3,
        direction: DVec3,
        margin: f64,
        mut limit: f64,
        mut visit: impl FnMut(&[u32], f64) -> f64,
    ) {
        let inverse = direction.recip();
        let entry = |node: usize, limit: f64| {
            entry_distance(&self.nodes[node].bounds, origin, inverse, margin, limit)
        };
        let mut waiting: Vec<(usize, f64)> = Vec::with_capacity(64);
        waiting.extend(entry(0, limit).map(|near| (0, near)));
        while let Some((index, near)) = waiting.pop() {
            if near > limit {
                continue;
            }
            let node = &self.nodes[index];
            if node.count > 0 {
                limit = visit(&self.order[node.first..node.first + node.count], limit);
                continue;
            }
            let mut children = [node.first, node.first + 1]
                .map(|child| entry(child, limit).map(|near| (child, near)));
            children.sort_by(|a, b| {
                let near = |child: &Option<(usize, f64)>| child.map_or(f64::INFINITY, |c| c.1);
                near(b).total_cmp(&near(a))
            });
            waiting.extend(children.into_iter().flatten());
        }
    }
}

fn leaf(boxes: &[Aabb], order: &[u32], range: std::ops::Range<usize>) -> Node {
    let bounds = order[range.clone()]
        .iter()
        .fold(Aabb::EMPTY, |sum, &item| sum.union(boxes[item as usize]));
    Node {
        bounds,
        first: range.start,
        count: range.len(),
    }
}

/// Where the ray enters the box, at least 0, if it does so before `limit`.
fn entry_distance(
    bounds: &Aabb,
    origin: DVec3,
    inverse: DVec3,
    margin: f64,
    limit: f64,
) -> Option<f64> {
    let (mut near, mut far) = (0.0f64, limit);
    for axis in 0..3 {
        let low = (bounds.min[axis] - margin - origin[axis]) * inverse[axis];
        let high = (bounds.max[axis] + margin - origin[axis]) * inverse[axis];
        near = near.max(low.min(high));
        far = far.min(low.max(high));
    }
    (near <= far * (1.0 + 1e-12)).then_some(near)
}

/// Reorders `items` into two sides and returns the size of the first; `None` when their centres
/// coincide.
fn split(boxes: &[Aabb], centers: &[DVec3], items: &mut [u32]) -> Option<usize> {
    let spread = Aabb::around(items.iter().map(|&item| centers[item as usize]));
    let mut best: Option<(f64, usize, usize)> = None;
    for axis in 0..3 {
        if spread.size()[axis] > 0.0 {
            let (cost, bin) = cheapest_plane(boxes, centers, items, (&spread, axis));
            if best.is_none_or(|(least, ..)| cost < least) {
                best = Some((cost, axis, bin));
            }
        }
    }
    let (_, axis, bin) = best?;
    let mut left = 0;
    for index in 0..items.len() {
        if bin_of(centers[items[index] as usize], &spread, axis) <= bin {
            items.swap(left, index);
            left += 1;
        }
    }
    Some(left)
}

fn bin_of(center: DVec3, spread: &Aabb, axis: usize) -> usize {
    let fraction = (center[axis] - spread.min[axis]) / (spread.max[axis] - spread.min[axis]);
    #[allow(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "between 0 and BINS"
    )]
    let bin = (fraction * BINS as f64) as usize;
    bin.min(BINS - 1)
}

/// The cost and the last bin of the first side of the cheapest split along one axis. The first and
/// the last bin are never empty, so neither side is.
fn cheapest_plane(
    boxes: &[Aabb],
    centers: &[DVec3],
    items: &[u32],
    (spread, axis): (&Aabb, usize),
) -> (f64, usize) {
    let mut bins = [(Aabb::EMPTY, 0usize); BINS];
    for &item in items {
        let bin = &mut bins[bin_of(centers[item as usize], spread, axis)];
        bin.0 = bin.0.union(boxes[item as usize]);
        bin.1 += 1;
    }
    let mut costs_right = [0.0; BINS];
    let (mut sum, mut count) = (Aabb::EMPTY, 0);
    for bin in (1..BINS).rev() {
        sum = sum.union(bins[bin].0);
        count += bins[bin].1;
        costs_right[bin - 1] = half_area(&sum) * count as f64;
    }
    let mut best = (f64::INFINITY, 0);
    (sum, count) = (Aabb::EMPTY, 0);
    for bin in 0..BINS - 1 {
        sum = sum.union(bins[bin].0);
        count += bins[bin].1;
        let cost = half_area(&sum) * count as f64 + costs_right[bin];
        if cost < best.0 {
            best = (cost, bin);
        }
    }
    best
}

fn half_area(bounds: &Aabb) -> f64 {
    let size = bounds.size();
    size.x * size.y + size.y * size.z + size.z * size.x
}

#[cfg(test)]
mod tests {
    use super::*;

    fn boxes(count: u32) -> Vec<Aabb> {
        (0..count)
            .map(|i| {
                let t = f64::from(i);
                let min = DVec3::new((t * 0.7).sin(), (t * 1.3).cos(), (t * 0.31).sin()) * 10.0;
                Aabb {
                    min,
                    max: min + DVec3::splat(0.1 + 0.5 * (t * 2.1).sin().abs()),
                }
            })
            .collect()
    }

    /// Every item stands in exactly one leaf and inside all boxes above it.
    fn check(bvh: &Bvh, boxes: &[Aabb]) -> Result<(), String> {
        let mut seen = vec![0; boxes.len()];
        let mut waiting = vec![(0, Vec::new())];
        while let Some((index, mut above)) = waiting.pop() {
            let node = &bvh.nodes[index];
            above.push(node.bounds);
            if node.count == 0 {
                waiting.extend([(node.first, above.clone()), (node.first + 1, above)]);
                continue;
            }
            for &item in &bvh.order[node.first..node.first + node.count] {
                seen[item as usize] += 1;
                let inside = |outer: &Aabb| outer.union(boxes[item as usize]) == *outer;
                if !above.iter().all(inside) {
                    return Err(format!("item {item} reaches out of a box"));
                }
            }
        }
        if seen.iter().all(|&times| times == 1) {
            Ok(())
        } else {
            Err("lost items".into())
        }
    }

    #[test]
    fn every_item_stands_once_inside_its_boxes() {
        for count in [1, 2, 5, 1000] {
            let boxes = boxes(count);
            check(&Bvh::new(&boxes), &boxes).unwrap();
        }
    }

    #[test]
    fn the_check_above_notices_a_spoilt_tree() {
        let boxes = boxes(100);
        let mut bvh = Bvh::new(&boxes);
        let last = bvh.nodes.len() - 1;
        bvh.nodes[last].bounds.max.x -= 0.05;
        assert!(check(&bvh, &boxes).is_err());
    }

    #[test]
    fn items_with_one_centre_share_a_leaf() {
        let same = vec![
            Aabb {
                min: DVec3::ZERO,
                max: DVec3::ONE
            };
            50
        ];
        let bvh = Bvh::new(&same);
        assert_eq!((bvh.nodes.len(), bvh.nodes[0].count), (1, 50));
    }

    #[test]
    fn a_walk_meets_all_items_that_the_ray_meets() {
        let boxes = boxes(500);
        let bvh = Bvh::new(&boxes);
        for i in 0..200 {
            let t = f64::from(i);
            let origin = DVec3::new((t * 0.9).cos(), (t * 0.4).sin(), t.sin()) * 30.0;
            let direction = DVec3::new((t * 3.3).sin(), (t * 2.2).cos(), t.cos()) * 9.0 - origin;
            let mut met = Vec::new();
            bvh.walk(origin, direction, 0.0, f64::INFINITY, |items, limit| {
                met.extend_from_slice(items);
                limit
            });
            let inverse = direction.recip();
            for (item, bounds) in boxes.iter().enumerate() {
                if entry_distance(bounds, origin, inverse, 0.0, f64::INFINITY).is_some() {
                    assert!(
                        met.contains(&u32::try_from(item).unwrap()),
                        "ray {i} item {item}"
                    );
                }
            }
        }
    }
}
