//! Single rays through the tree of clusters.

use super::Visible;
use super::cluster::{Cluster, MOST_VERTICES};
use super::clusters::{Child, Clusters, WIDTH, Wide};
use super::lanes::LANES;
use super::triangle::{Crossing, Ray};
use glam::DVec3;

/// Rounding of coordinates, relative to the largest of them, that boxes are enlarged by.
const ROUNDING: f64 = 1e-13;

/// A ray from a point counted from the mesh's centre.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Probe {
    origin: DVec3,
    inverse: DVec3,
    ray: Ray,
}

impl Probe {
    pub(crate) fn new(origin: DVec3, direction: DVec3) -> Self {
        Self {
            origin,
            inverse: direction.recip(),
            ray: Ray::new(origin, direction),
        }
    }

    /// The exact test that decides.
    pub(crate) fn ray(&self) -> &Ray {
        &self.ray
    }

    /// The nearest of the crossings that `cross` finds, the lower number of two equally near, no
    /// farther than `limit`. `radius` is the largest coordinate of the mesh.
    pub(crate) fn nearest(
        &self,
        clusters: &Clusters,
        (radius, limit): (f64, f64),
        cross: impl Fn(usize) -> Option<Crossing>,
    ) -> Option<Visible> {
        let margin = ROUNDING * (radius + self.origin.length());
        let mut limit = limit;
        let mut best: Option<Visible> = None;
        let mut waiting = vec![(Child::Node(0), 0.0)];
        let mut candidates = Vec::new();
        while let Some((child, near)) = waiting.pop() {
            if near > limit {
                continue;
            }
            match child {
                Child::None => {}
                Child::Node(index) => {
                    let first = waiting.len();
                    self.enter(
                        &clusters.nodes[index as usize],
                        (margin, limit),
                        &mut waiting,
                    );
                    waiting[first..].sort_by(|a, b| b.1.total_cmp(&a.1));
                }
                Child::Cluster(index) => {
                    self.candidates(&clusters.cluster(index), margin, &mut candidates);
                    for &triangle in &candidates {
                        let triangle = triangle as usize;
                        if let Some(crossing) = cross(triangle) {
                            let found = Visible { triangle, crossing };
                            best = Some(best.map_or(found, |best| best.nearer(found)));
                        }
                    }
                    limit = best.map_or(limit, |best| best.crossing.distance);
                }
            }
        }
        best
    }

    /// Adds the children whose boxes the ray meets before the limit.
    fn enter(&self, node: &Wide, (margin, limit): (f64, f64), waiting: &mut Vec<(Child, f64)>) {
        let mut near = [0.0f64; WIDTH];
        let mut far = [limit; WIDTH];
        for axis in 0..3 {
            for i in 0..WIDTH {
                let low = f64::from(node.low[axis][i]) - margin - self.origin[axis];
                let high = f64::from(node.high[axis][i]) + margin - self.origin[axis];
                let (low, high) = (low * self.inverse[axis], high * self.inverse[axis]);
                near[i] = near[i].max(low.min(high));
                far[i] = far[i].min(low.max(high));
            }
        }
        for (i, &child) in node.children.iter().enumerate() {
            if child != Child::None && near[i] <= far[i] * (1.0 + 1e-12) {
                waiting.push((child, near[i]));
            }
        }
    }

    /// Triangles of a cluster that the ray's line may meet: those that its projection along the
    /// ray does not clearly leave aside.
    fn candidates(&self, cluster: &Cluster<'_>, margin: f64, found: &mut Vec<u32>) {
        let (axes, shear) = self.ray.shearing();
        let base = cluster.center - self.origin;
        let (mut x, mut y) = ([0.0f64; MOST_VERTICES], [0.0f64; MOST_VERTICES]);
        for (index, pack) in cluster.packs.iter().enumerate() {
            let [ox, oy, oz] = axes.map(|axis| &pack[axis * LANES..][..LANES]);
            let (x, y) = (
                &mut x[index * LANES..][..LANES],
                &mut y[index * LANES..][..LANES],
            );
            for i in 0..LANES {
                let along = base[axes[2]] + f64::from(oz[i]);
                x[i] = base[axes[0]] + f64::from(ox[i]) - shear[0] * along;
                y[i] = base[axes[1]] + f64::from(oy[i]) - shear[1] * along;
            }
        }
        // Offsets are rounded to f32; a sheared coordinate feels two of them.
        let error = 2.0 * (1.2e-7 * f64::from(cluster.radius) + margin);
        found.clear();
        for ([a, b, c], triangle) in cluster.triangles() {
            let cross = |p: usize, q: usize| x[p] * y[q] - y[p] * x[q];
            let reach = [a, b, c]
                .iter()
                .fold(0.0, |sum, &p| sum + x[p].abs() + y[p].abs());
            let slack = 2.0 * error * (reach + error);
            let sides = [cross(c, b), cross(a, c), cross(b, a)];
            let above = sides.iter().all(|&side| side >= -slack);
            let below = sides.iter().all(|&side| side <= slack);
            if above || below {
                found.push(triangle);
            }
        }
    }
}
