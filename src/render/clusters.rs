//! The mesh as the fast paths hold it: clusters of neighbouring triangles below an 8-wide tree.
//!
//! A cluster keeps its vertices as f32 offsets from its own centre, so that what the fast paths
//! compute from them is off by a known, tiny amount; what lies closer than that to a decision is
//! decided by the exact test on the mesh itself.

use super::lanes::LANES;
use super::tree::{self, Bounds, Item, Node, number};
use glam::DVec3;
use mvs_datasets::scene::Mesh;

/// Most triangles of a cluster.
pub(crate) const MOST_TRIANGLES: usize = 64;
/// Most vertices of a cluster.
pub(crate) const MOST_VERTICES: usize = 3 * MOST_TRIANGLES;
/// Vertices that are stored side by side, axis by axis.
pub(crate) type Pack = [[f32; LANES]; 3];
/// Children of a node.
pub(crate) const WIDTH: usize = 8;

/// What a node's child is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Child {
    /// Nothing.
    None,
    /// Another node, by number.
    Node(u32),
    /// A cluster, by number.
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

/// Where a cluster stands in the columns of [`Clusters`].
#[derive(Debug, Clone, Copy)]
pub(crate) struct Cluster {
    /// What its vertices are counted from, itself counted from the mesh's centre.
    pub(crate) center: DVec3,
    /// The largest coordinate of its vertices, in absolute value.
    pub(crate) radius: f32,
    first_pack: u32,
    first_triangle: u32,
    packs: u8,
    triangles: u8,
}

/// A cluster's vertices and triangles.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Content<'c> {
    /// Offsets of the vertices from the cluster's centre; the last pack is filled up with copies.
    pub(crate) packs: &'c [Pack],
    /// Vertices of each triangle, counted in the cluster.
    pub(crate) corners: &'c [[u8; 3]],
    /// Each triangle's number in the mesh.
    pub(crate) triangles: &'c [u32],
}

/// All clusters of a mesh and the tree over them, whose root is node 0.
#[derive(Debug, Default)]
pub(crate) struct Clusters {
    pub(crate) nodes: Vec<Wide>,
    pub(crate) clusters: Vec<Cluster>,
    packs: Vec<Pack>,
    corners: Vec<[u8; 3]>,
    triangles: Vec<u32>,
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

    /// The vertices and triangles of a cluster.
    pub(crate) fn content(&self, cluster: &Cluster) -> Content<'_> {
        let triangles = cluster.first_triangle as usize..;
        let count = usize::from(cluster.triangles);
        Content {
            packs: &self.packs[cluster.first_pack as usize..][..usize::from(cluster.packs)],
            corners: &self.corners[triangles.clone()][..count],
            triangles: &self.triangles[triangles][..count],
        }
    }

    /// Bytes held.
    pub(crate) fn bytes(&self) -> usize {
        self.nodes.len() * size_of::<Wide>()
            + self.clusters.len() * size_of::<Cluster>()
            + self.packs.len() * size_of::<Pack>()
            + 3 * self.corners.len()
            + 4 * self.triangles.len()
    }

    /// Makes the wide nodes, from the root down, and the clusters as they are met.
    fn fill(&mut self, mesh: &Mesh, center: DVec3, items: &[Item], tree: &[Node]) {
        let mut local = vec![(u32::MAX, 0u8); mesh.vertices().len()];
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
                    self.add_cluster(mesh, center, own, (&node.bounds, &mut local));
                    Child::Cluster(number(self.clusters.len() - 1))
                };
                self.nodes[wide as usize].put(slot, &node.bounds, child);
            }
        }
        self.packs.shrink_to_fit();
        self.corners.shrink_to_fit();
        self.triangles.shrink_to_fit();
    }

    /// `local` holds, per vertex of the mesh, the last cluster that uses it and its place there.
    fn add_cluster(
        &mut self,
        mesh: &Mesh,
        center: DVec3,
        items: &[Item],
        (bounds, local): (&Bounds, &mut [(u32, u8)]),
    ) {
        let own = number(self.clusters.len());
        let middle = [0, 1, 2].map(|axis| 0.5 * f64::from(bounds.low[axis] + bounds.high[axis]));
        let middle = DVec3::from(middle);
        let first_pack = self.packs.len();
        let first_triangle = number(self.triangles.len());
        let mut vertices = 0;
        let mut radius = 0.0f32;
        for item in items {
            let corners = mesh.triangles()[item.id as usize].map(|vertex| {
                let place = &mut local[vertex as usize];
                if place.0 != own {
                    #[allow(clippy::cast_possible_truncation, reason = "at most 192 vertices")]
                    let next = vertices as u8;
                    *place = (own, next);
                    let offset = mesh.vertices()[vertex as usize] - center - middle;
                    let offset = offset.as_vec3();
                    radius = radius.max(offset.abs().max_element());
                    self.put_vertex(vertices % LANES, offset.to_array());
                    vertices += 1;
                }
                place.1
            });
            self.corners.push(corners);
            self.triangles.push(item.id);
        }
        #[allow(clippy::cast_possible_truncation, reason = "at most 24 and 64")]
        self.clusters.push(Cluster {
            center: middle,
            radius,
            first_pack: number(first_pack),
            first_triangle,
            packs: (self.packs.len() - first_pack) as u8,
            triangles: items.len() as u8,
        });
    }

    /// Adds a vertex to the last pack, filling the rest of it; to a new one for lane 0.
    fn put_vertex(&mut self, lane: usize, offset: [f32; 3]) {
        if lane == 0 {
            self.packs.push([[0.0; LANES]; 3]);
        }
        if let Some(pack) = self.packs.last_mut() {
            for (column, value) in pack.iter_mut().zip(offset) {
                column[lane..].fill(value);
            }
        }
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
