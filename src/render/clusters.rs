//! The mesh as the fast paths hold it: clusters of neighbouring triangles below an 8-wide tree.
//!
//! A cluster keeps its vertices as f32 offsets from its own centre, so that what the fast paths
//! compute from them is off by a known, tiny amount; what lies closer than that to a decision is
//! decided by the exact test on the mesh itself.

use super::cluster::{Cluster, Draft, MOST_TRIANGLES};
use super::tree::{self, Bounds, Item, Node, number};
use crate::ahead::prefetch;
use glam::DVec3;
use mvs_datasets::scene::Mesh;

/// Children of a node.
pub(crate) const WIDTH: usize = 8;

/// Words of a cache line.
const LINE: usize = 16;

/// What a node's child is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Child {
    /// Nothing.
    None,
    /// Another node, by number.
    Node(u32),
    /// A cluster, by its first word.
    Cluster(u32),
}

/// Eight boxes side by side, and what is in them.
#[derive(Debug, Clone)]
pub(crate) struct Wide {
    /// Low ends per axis, counted from the mesh's centre.
    pub(crate) low: [[f32; WIDTH]; 3],
    /// High ends per axis; below `low` where there is no child.
    pub(crate) high: [[f32; WIDTH]; 3],
    pub(crate) children: [Child; WIDTH],
}

/// All clusters of a mesh and the tree over them, whose root is node 0.
#[derive(Debug, Default)]
pub(crate) struct Clusters {
    pub(crate) nodes: Vec<Wide>,
    /// One cluster after the other.
    words: Vec<f32>,
}

impl Clusters {
    /// Clusters of a mesh whose vertices are counted from `center`.
    pub(crate) fn new(mesh: &Mesh, center: DVec3) -> Self {
        let mut items: Vec<Item> = (0..mesh.triangles().len())
            .map(|triangle| {
                let corners = mesh
                    .corners(triangle)
                    .map(|corner| (corner - center).to_array());
                let bounds = Bounds::around(&corners);
                Item {
                    bounds,
                    id: number(triangle),
                }
            })
            .collect();
        let tree = tree::build(&mut items, MOST_TRIANGLES);
        let mut built = Self::default();
        built.fill(mesh, center, &items, &tree);
        built
    }

    /// The cluster that a child stands for.
    #[inline(always)]
    pub(crate) fn cluster(&self, index: u32) -> Cluster<'_> {
        Cluster::read(&self.words[index as usize..])
    }

    /// Has the first `lines` cache lines of a child fetched ahead of its turn.
    #[inline(always)]
    pub(crate) fn fetch(&self, child: Child, lines: usize) {
        match child {
            Child::None => {}
            Child::Cluster(index) => {
                for line in 0..lines {
                    prefetch(&self.words, index as usize + LINE * line);
                }
            }
            Child::Node(index) => {
                if let Some(node) = self.nodes.get(index as usize) {
                    let rows = node.low.iter().chain(&node.high).step_by(2);
                    rows.for_each(|row| prefetch(row, 0));
                    prefetch(&node.children, 0);
                }
            }
        }
    }

    /// Bytes held.
    pub(crate) fn bytes(&self) -> usize {
        self.nodes.len() * size_of::<Wide>() + 4 * self.words.len()
    }

    /// Makes the wide nodes, from the root down, and the clusters as they are met.
    fn fill(&mut self, mesh: &Mesh, center: DVec3, items: &[Item], tree: &[Node]) {
        let mut local = vec![(u32::MAX, 0u8); mesh.vertices().len()];
        let mut draft = Draft::default();
        let mut waiting = vec![(0u32, 0u32)];
        self.nodes.push(Wide::EMPTY);
        while let Some((wide, root)) = waiting.pop() {
            for (slot, index) in opened(tree, root).into_iter().enumerate() {
                let node = &tree[index as usize];
                let child = if node.count == 0 {
                    self.nodes.push(Wide::EMPTY);
                    let next = number(self.nodes.len() - 1);
                    waiting.push((next, index));
                    Child::Node(next)
                } else {
                    let own = &items[node.first as usize..][..node.count as usize];
                    let with = (&node.bounds, &mut draft, &mut local[..]);
                    Child::Cluster(self.add_cluster(mesh, center, own, with))
                };
                self.nodes[wide as usize].put(slot, &node.bounds, child);
            }
        }
        self.words.shrink_to_fit();
    }

    /// Adds a cluster of some triangles and returns its number. `local` holds, per vertex of the
    /// mesh, the last cluster that uses it and its place there.
    fn add_cluster(
        &mut self,
        mesh: &Mesh,
        center: DVec3,
        items: &[Item],
        (bounds, draft, local): (&Bounds, &mut Draft, &mut [(u32, u8)]),
    ) -> u32 {
        let own = number(self.words.len());
        let middle = [0, 1, 2].map(|axis| 0.5 * f64::from(bounds.low[axis] + bounds.high[axis]));
        let middle = DVec3::from(middle);
        for item in items {
            let corners = mesh.triangles()[item.id as usize].map(|vertex| {
                let place = &mut local[vertex as usize];
                if place.0 != own {
                    let offset = mesh.vertices()[vertex as usize] - center - middle;
                    *place = (own, draft.add_vertex(offset.as_vec3().to_array()));
                }
                place.1
            });
            draft.add_triangle(corners, item.id);
        }
        draft.write(middle, &mut self.words);
        own
    }
}

impl Wide {
    const EMPTY: Self = Self {
        low: [[f32::INFINITY; WIDTH]; 3],
        high: [[f32::NEG_INFINITY; WIDTH]; 3],
        children: [Child::None; WIDTH],
    };

    fn put(&mut self, slot: usize, bounds: &Bounds, child: Child) {
        for axis in 0..3 {
            self.low[axis][slot] = bounds.low[axis];
            self.high[axis][slot] = bounds.high[axis];
        }
        self.children[slot] = child;
    }
}

/// Up to eight nodes below `root` that together hold all its items: the largest inner one is
/// replaced by its children until there are eight. A root that is a leaf stands for itself.
fn opened(tree: &[Node], root: u32) -> Vec<u32> {
    let mut open = vec![root];
    while open.len() < WIDTH {
        let area = |&slot: &usize| tree[open[slot] as usize].bounds.half_area();
        let largest = (0..open.len())
            .filter(|&slot| tree[open[slot] as usize].count == 0)
            .max_by(|a, b| area(a).total_cmp(&area(b)));
        let Some(slot) = largest else {
            break;
        };
        let first = tree[open[slot] as usize].first;
        open[slot] = first;
        open.push(first + 1);
    }
    open
}
