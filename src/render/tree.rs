//! A binary tree over triangles' boxes, built fast: split along the longest axis where the
//! surface-area heuristic (Wald 2007) is cheapest among the borders of 16 bins.

/// Borders between this many bins are tried.
const BINS: usize = 16;

/// An axis-aligned box in f32, rounded outwards.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Bounds {
    pub(crate) low: [f32; 3],
    pub(crate) high: [f32; 3],
}

impl Bounds {
    /// The box that holds nothing.
    pub(crate) const EMPTY: Self = Self {
        low: [f32::INFINITY; 3],
        high: [f32::NEG_INFINITY; 3],
    };

    /// The smallest f32 box around points.
    pub(crate) fn around(points: &[[f64; 3]]) -> Self {
        let mut bounds = Self::EMPTY;
        for point in points {
            let low = point.map(|value| rounded(value, f32::next_down, |near| near > value));
            let high = point.map(|value| rounded(value, f32::next_up, |near| near < value));
            bounds.include(&Self { low, high });
        }
        bounds
    }

    fn include(&mut self, other: &Self) {
        for axis in 0..3 {
            self.low[axis] = lesser(self.low[axis], other.low[axis]);
            self.high[axis] = greater(self.high[axis], other.high[axis]);
        }
    }

    /// Half the surface; 0 when empty.
    pub(crate) fn half_area(&self) -> f32 {
        let [x, y, z] = [0, 1, 2].map(|axis| greater(self.high[axis] - self.low[axis], 0.0));
        x * y + y * z + z * x
    }

    fn center(&self, axis: usize) -> f32 {
        0.5 * (self.low[axis] + self.high[axis])
    }
}

/// The nearest f32, or its neighbour where it lies on the wrong side.
fn rounded(value: f64, neighbour: impl Fn(f32) -> f32, wrong: impl Fn(f64) -> bool) -> f32 {
    #[allow(clippy::cast_possible_truncation, reason = "rounded to the right side")]
    let near = value as f32;
    if wrong(f64::from(near)) {
        neighbour(near)
    } else {
        near
    }
}

/// The smaller number, without the care for NaN that costs `f32::min` its speed.
fn lesser(a: f32, b: f32) -> f32 {
    if b < a { b } else { a }
}

fn greater(a: f32, b: f32) -> f32 {
    if b > a { b } else { a }
}

/// Something with a box and a number.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Item {
    pub(crate) bounds: Bounds,
    pub(crate) id: u32,
}

/// A node of the tree.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Node {
    pub(crate) bounds: Bounds,
    /// The first of two neighbouring children, or of a leaf's items.
    pub(crate) first: u32,
    /// Items of a leaf; 0 for an inner node.
    pub(crate) count: u32,
}

/// Centres' box, boxes' union and number of the items of one bin or one side of a split.
#[derive(Clone, Copy)]
struct Side {
    bounds: Bounds,
    centers: Bounds,
    count: usize,
}

impl Side {
    const EMPTY: Self = Self {
        bounds: Bounds::EMPTY,
        centers: Bounds::EMPTY,
        count: 0,
    };

    fn add(&mut self, item: &Item) {
        let center = [0, 1, 2].map(|axis| item.bounds.center(axis));
        self.bounds.include(&item.bounds);
        self.centers.include(&Bounds {
            low: center,
            high: center,
        });
        self.count += 1;
    }

    fn join(mut self, other: &Self) -> Self {
        self.bounds.include(&other.bounds);
        self.centers.include(&other.centers);
        self.count += other.count;
        self
    }

    /// The heuristic's cost, in units of the parent's.
    fn cost(&self) -> f32 {
        self.bounds.half_area() * self.count as f32
    }
}

/// Reorders `items` and returns the nodes over them, the root first. Leaves hold at most
/// `leaf_size` items side by side.
pub(crate) fn build(items: &mut [Item], leaf_size: usize) -> Vec<Node> {
    let mut root = Side::EMPTY;
    items.iter().for_each(|item| root.add(item));
    let mut nodes = vec![leaf(&root, 0)];
    let mut unsplit = vec![(0, root)];
    while let Some((index, side)) = unsplit.pop() {
        if side.count <= leaf_size {
            continue;
        }
        let first = nodes[index].first as usize;
        let (left, right) = split(&mut items[first..first + side.count], &side);
        let children = nodes.len();
        nodes.push(leaf(&left, first));
        nodes.push(leaf(&right, first + left.count));
        nodes[index].first = number(children);
        nodes[index].count = 0;
        unsplit.extend([(children, left), (children + 1, right)]);
    }
    nodes
}

fn leaf(side: &Side, first: usize) -> Node {
    Node {
        bounds: side.bounds,
        first: number(first),
        count: number(side.count),
    }
}

/// Counts of triangles fit into u32, as indices of vertices do.
pub(crate) fn number(count: usize) -> u32 {
    u32::try_from(count).unwrap_or(u32::MAX)
}

/// Splits items at the cheapest border, or in halves where their centres coincide.
fn split(items: &mut [Item], side: &Side) -> (Side, Side) {
    let spread = [0, 1, 2].map(|axis| side.centers.high[axis] - side.centers.low[axis]);
    let axis = (0..3)
        .max_by(|&a, &b| spread[a].total_cmp(&spread[b]))
        .unwrap_or(0);
    let scale = BINS as f32 / spread[axis];
    if !(spread[axis] > 0.0 && scale.is_finite()) {
        return halves(items);
    }
    let low = side.centers.low[axis];
    let bin_of = |item: &Item| {
        #[allow(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "between 0 and BINS"
        )]
        let bin = ((item.bounds.center(axis) - low) * scale) as usize;
        bin.min(BINS - 1)
    };
    let mut bins = [Side::EMPTY; BINS];
    for item in items.iter() {
        bins[bin_of(item)].add(item);
    }
    let (last, left, right) = cheapest(&bins);
    if left.count == 0 || right.count == 0 {
        return halves(items);
    }
    let mut count = 0;
    for index in 0..items.len() {
        if bin_of(&items[index]) <= last {
            items.swap(count, index);
            count += 1;
        }
    }
    (left, right)
}

/// The last bin of the left side, and both sides.
fn cheapest(bins: &[Side; BINS]) -> (usize, Side, Side) {
    let mut rights = [Side::EMPTY; BINS];
    for bin in (0..BINS - 1).rev() {
        rights[bin] = rights[bin + 1].join(&bins[bin + 1]);
    }
    let mut left = Side::EMPTY;
    let mut best = (f32::INFINITY, 0, Side::EMPTY, Side::EMPTY);
    for bin in 0..BINS - 1 {
        left = left.join(&bins[bin]);
        let cost = left.cost() + rights[bin].cost();
        if cost < best.0 && left.count > 0 && rights[bin].count > 0 {
            best = (cost, bin, left, rights[bin]);
        }
    }
    (best.1, best.2, best.3)
}

fn halves(items: &[Item]) -> (Side, Side) {
    let (front, back) = items.split_at(items.len() / 2);
    [front, back]
        .map(|half| {
            let mut side = Side::EMPTY;
            half.iter().for_each(|item| side.add(item));
            side
        })
        .into()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn items(count: u32) -> Vec<Item> {
        let item = |id: u32| {
            let t = f64::from(id);
            let low = [
                (t * 0.7).sin() * 9.0,
                (t * 1.3).cos() * 5.0,
                (t * 0.31).sin(),
            ];
            let bounds = Bounds::around(&[low, low.map(|v| v + 0.1)]);
            Item { bounds, id }
        };
        (0..count).map(item).collect()
    }

    fn contains(outer: &Bounds, inner: &Bounds) -> bool {
        let mut union = *outer;
        union.include(inner);
        union == *outer
    }

    fn check(items: &[Item], nodes: &[Node], leaf_size: u32) -> Result<(), String> {
        let mut seen = vec![0; items.len()];
        for node in nodes {
            if node.count == 0 {
                let children = &nodes[node.first as usize..][..2];
                if !children
                    .iter()
                    .all(|child| contains(&node.bounds, &child.bounds))
                {
                    return Err("a child reaches out".into());
                }
                continue;
            }
            for item in &items[node.first as usize..][..node.count as usize] {
                seen[item.id as usize] += 1;
                if !contains(&node.bounds, &item.bounds) || node.count > leaf_size {
                    return Err(format!("item {} stands wrong", item.id));
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
        for (count, leaf_size) in [(1, 4), (5, 4), (1000, 4), (1000, 64)] {
            let mut items = items(count);
            let nodes = build(&mut items, leaf_size);
            check(&items, &nodes, number(leaf_size)).unwrap();
        }
    }

    #[test]
    fn the_check_above_notices_a_spoilt_tree() {
        let mut items = items(500);
        let mut nodes = build(&mut items, 4);
        nodes[7].bounds.high[0] -= 0.05;
        assert!(check(&items, &nodes, 4).is_err());
    }

    #[test]
    fn coinciding_items_are_halved() {
        let mut same = vec![items(1)[0]; 100];
        let nodes = build(&mut same, 4);
        assert!(nodes.iter().all(|node| node.count <= 4));
        assert_eq!(nodes.iter().map(|node| node.count).sum::<u32>(), 100);
    }

    #[test]
    fn boxes_round_outwards() {
        let bounds = Bounds::around(&[[0.1, 1e10 + 1.0, -0.1]]);
        for (axis, value) in [0.1, 1e10 + 1.0, -0.1].into_iter().enumerate() {
            assert!(f64::from(bounds.low[axis]) < value && value < f64::from(bounds.high[axis]));
        }
    }
}
