//! Rays from one point, up to 64 that point alike, taken through the tree together.
//!
//! They are seen as samples of a pinhole that looks along their mean, at places that are no whole numbers,
//! so that projecting clusters and its error bounds are those of [`super::lens`]. f32 finds triangles that a
//! ray may meet; whoever asks decides by the exact test.

#![allow(
    clippy::needless_range_loop,
    reason = "columns are walked side by side, and closures would leave the instruction set"
)]

use super::cluster::Cluster;
use super::clusters::{Child, Clusters, Wide};
use super::lanes::{ALL, LANES, Lanes, SetBits, Task, dispatch};
use super::lens::{Grid, Lens, Projected, SAMPLE_ERROR};
use super::meets::Group;
use super::scan::{Gaze, Look, Waiting};
use super::tile::SIZE;
use crate::ahead::prefetch;
use glam::{DMat3, DVec2, DVec3};
use mvs_datasets::scene::Mesh;

/// Rays of a packet: a bit of a word each.
pub(super) const RAYS: usize = 64;
/// The least cosine of the angle between a ray and the packet's mean.
const LEAST_COSINE: f64 = 0.5;
/// The largest sample that a ray may be.
const LAST: f64 = (SIZE - 2) as f64;
/// The finest that samples may be, per unit at depth 1: f32 places tell these apart.
const FINEST: f64 = 1e5;
/// Relative rounding of a limit, which is compared with a box's depth in f32.
const LIMIT_ROUNDING: f64 = 1e-5;

/// Rays from one point, as far as the tree is concerned.
pub(super) struct Packet {
    lens: Lens,
    gaze: Gaze,
    /// Where the rays are, in samples, and the samples below that.
    x: [f32; RAYS],
    y: [f32; RAYS],
    columns: [f32; RAYS],
    rows: [f32; RAYS],
    /// Depth per unit of the ray's distance.
    depths: [f64; RAYS],
    /// Depths from which on a ray need not look; below 0 for rays that have ended.
    limits: [f32; RAYS],
    alive: u64,
}

impl Packet {
    /// Rays along `directions`, at most [`RAYS`], from `origin`, counted from the mesh's centre, up to a
    /// distance of `limit`. Directions that do not point like most of them are not [`Self::has`].
    pub(super) fn new(origin: DVec3, directions: &[DVec3], limit: f64) -> Self {
        let unit = |direction: &DVec3| direction.try_normalize().unwrap_or(DVec3::ZERO);
        let sum: DVec3 = directions.iter().map(unit).sum();
        let ahead = sum.try_normalize().unwrap_or(DVec3::Z);
        let (right, down) = ahead.any_orthonormal_pair();
        let rotation = DMat3::from_cols(right, down, ahead).transpose();
        let mut alive = 0;
        let mut depths = [0.0; RAYS];
        let mut at = [DVec2::ZERO; RAYS];
        let (mut low, mut high) = (DVec2::INFINITY, DVec2::NEG_INFINITY);
        for (ray, direction) in directions.iter().enumerate().take(RAYS) {
            if unit(direction).dot(ahead) >= LEAST_COSINE {
                let turned = rotation * *direction;
                depths[ray] = turned.z;
                at[ray] = turned.truncate() / turned.z;
                (low, high) = (low.min(at[ray]), high.max(at[ray]));
                alive |= 1 << ray;
            }
        }
        let focal = (DVec2::splat(LAST) / (high - low)).min(DVec2::splat(FINEST));
        let grid = Grid {
            focal,
            shift: -low * focal,
        };
        let stand = (rotation, -(rotation * origin));
        let mut packet = Self {
            lens: Lens::new(stand, &grid),
            gaze: Gaze::new(stand, (&grid, 0.0), (SIZE, SIZE)),
            x: [0.0; RAYS],
            y: [0.0; RAYS],
            columns: [0.0; RAYS],
            rows: [0.0; RAYS],
            depths,
            limits: [-1.0; RAYS],
            alive,
        };
        for ray in bits(alive) {
            let place = (at[ray] * grid.focal + grid.shift).as_vec2();
            [packet.x[ray], packet.y[ray]] = place.to_array();
            [packet.columns[ray], packet.rows[ray]] = place.to_array().map(below);
            packet.set_limit(ray, limit);
        }
        packet
    }

    /// Whether a ray is one of the packet's.
    pub(super) fn has(&self, ray: usize) -> bool {
        self.alive >> ray & 1 == 1
    }

    fn set_limit(&mut self, ray: usize, distance: f64) {
        #[allow(clippy::cast_possible_truncation, reason = "allowed for in the factor")]
        let limit = (distance * self.depths[ray] * (1.0 + LIMIT_ROUNDING)) as f32;
        self.limits[ray] = limit;
    }

    /// Calls `meet(ray, triangle)` for what a ray may meet, roughly from near to far. It answers with the
    /// distance beyond which the ray need not look from now on, if that has changed; one below 0 ends it.
    pub(super) fn trace(
        &mut self,
        clusters: &Clusters,
        (mesh, room): (&Mesh, &mut Room),
        mut meet: impl FnMut(usize, u32) -> Option<f64>,
    ) {
        let mut alive = self.alive;
        let Room {
            scratch,
            found,
            children,
            waiting,
        } = room;
        waiting.push((Waiting::ROOT, alive));
        while let Some((next, rays)) = waiting.pop() {
            let rays = self.within(next.depth, rays & alive);
            if rays == 0 {
                continue;
            }
            match next.child {
                Child::None => {}
                Child::Node(index) => {
                    let first = waiting.len();
                    children.clear();
                    dispatch(Enter {
                        packet: self,
                        node: &clusters.nodes[index as usize],
                        rays,
                        children,
                        waiting,
                    });
                    waiting[first..].sort_unstable_by(|(a, _), (b, _)| b.depth.total_cmp(&a.depth));
                }
                Child::Cluster(index) => {
                    found.clear();
                    let cluster = clusters.cluster(index);
                    dispatch(Find {
                        packet: self,
                        cluster: &cluster,
                        rays,
                        scratch,
                        found,
                    });
                    fetch(mesh, found);
                    for &Candidate { ray, triangle } in &*found {
                        let ray = usize::from(ray);
                        if alive >> ray & 1 == 0 {
                            continue;
                        }
                        if let Some(limit) = meet(ray, triangle) {
                            self.set_limit(ray, limit);
                            alive &= !(u64::from(limit < 0.0) << ray);
                        }
                    }
                }
            }
        }
    }

    /// Those of `rays` that look as far as `depth`.
    fn within(&self, depth: f32, rays: u64) -> u64 {
        let near = |ray: &usize| self.limits[*ray] >= depth;
        bits(rays).filter(near).fold(0, |all, ray| all | 1 << ray)
    }
}

/// What packets are traced with, one after the other.
pub(super) struct Room {
    scratch: Projected,
    found: Vec<Candidate>,
    children: Vec<Waiting>,
    waiting: Vec<(Waiting, u64)>,
}

impl Room {
    pub(super) fn new() -> Self {
        Self {
            scratch: Projected::new(0.0, (SIZE, SIZE)),
            found: Vec::new(),
            children: Vec::new(),
            waiting: Vec::new(),
        }
    }
}

/// The whole number not above a number of at least about 0.
fn below(value: f32) -> f32 {
    #[allow(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "less than 64; what rounding put below 0 becomes 0"
    )]
    let whole = value as u32;
    whole as f32
}

/// Asks for the corners of triangles ahead of the exact test.
fn fetch(mesh: &Mesh, found: &[Candidate]) {
    for candidate in found {
        prefetch(mesh.triangles(), candidate.triangle as usize);
    }
    for candidate in found {
        for vertex in mesh.triangles()[candidate.triangle as usize] {
            prefetch(mesh.vertices(), vertex as usize);
        }
    }
}

/// A triangle that a ray may meet.
#[derive(Debug, Clone, Copy)]
pub(super) struct Candidate {
    ray: u8,
    triangle: u32,
}

/// The numbers of the bits that are set.
#[inline(always)]
fn bits(mut bits: u64) -> impl Iterator<Item = usize> {
    std::iter::from_fn(move || {
        let next = bits.trailing_zeros() as usize;
        bits &= bits.wrapping_sub(1);
        (next < RAYS).then_some(next % RAYS)
    })
}

#[inline(always)]
fn eight(column: &[f32; RAYS], chunk: usize) -> [f32; LANES] {
    let mut values = [0.0; LANES];
    values.copy_from_slice(&column[chunk * LANES % RAYS..][..LANES]);
    values
}

/// Adds the node's children that some of the rays may meet.
struct Enter<'e> {
    packet: &'e Packet,
    node: &'e Wide,
    rays: u64,
    children: &'e mut Vec<Waiting>,
    waiting: &'e mut Vec<(Waiting, u64)>,
}

impl Task for Enter<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self, l: L) {
        let packet = self.packet;
        Look(&packet.gaze, self.node, self.children).run(l);
        for child in &*self.children {
            // The samples of what reaches behind the camera are not known.
            if child.nearness == f32::INFINITY {
                self.waiting.push((*child, self.rays));
                continue;
            }
            let [left, right] = [child.from, child.to].map(|spot| spot.column as f32);
            let [top, bottom] = [child.from, child.to].map(|spot| spot.row as f32);
            let places = (&packet.columns, &packet.rows);
            let rays = inside(l, places, [left, right, top, bottom], self.rays);
            if rays != 0 {
                self.waiting.push((*child, rays));
            }
        }
    }
}

/// Those of `rays` whose places lie in a box: left, right, top, bottom.
#[inline(always)]
fn inside<L: Lanes>(
    l: L,
    (columns, rows): (&[f32; RAYS], &[f32; RAYS]),
    sides: [f32; 4],
    rays: u64,
) -> u64 {
    let [left, right, top, bottom] = sides.map(|side| l.splat(side));
    let mut within = 0;
    for chunk in 0..RAYS / LANES {
        if rays >> (chunk * LANES) & u64::from(ALL) == 0 {
            continue;
        }
        let x = l.load(&eight(columns, chunk));
        let y = l.load(&eight(rows, chunk));
        let beside = l.or(l.below(x, left), l.below(right, x));
        let above = l.or(l.below(y, top), l.below(bottom, y));
        within |= u64::from(!l.bits(l.or(beside, above)) & ALL) << (chunk * LANES);
    }
    within & rays
}

/// Finds the triangles of a cluster that some of the rays may meet: all of them where the cluster comes too
/// close to be projected.
struct Find<'f> {
    packet: &'f Packet,
    cluster: &'f Cluster<'f>,
    rays: u64,
    scratch: &'f mut Projected,
    found: &'f mut Vec<Candidate>,
}

impl Task for Find<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self, l: L) {
        let Self {
            packet,
            cluster,
            rays,
            scratch,
            found,
        } = self;
        if !packet.lens.project(l, cluster, scratch) {
            for (_, triangle) in cluster.triangles() {
                let all = bits(rays).map(|ray| Candidate {
                    ray: ray as u8,
                    triangle,
                });
                found.extend(all);
            }
            return;
        }
        let error = scratch.error + SAMPLE_ERROR;
        let [left, right, top, bottom] = scratch.extent;
        let sides = [left - error, right + error, top - error, bottom + error];
        let rays = inside(l, (&packet.x, &packet.y), sides, rays);
        if rays == 0 {
            return;
        }
        for group in 0..cluster.groups() {
            let eight = cluster.eight(group);
            let xs = l.gather(&scratch.x, scratch.few, &eight.places);
            let ys = l.gather(&scratch.y, scratch.few, &eight.places);
            let group = Group::new(l, xs, ys, error);
            let used = ALL >> (LANES - eight.used);
            for ray in bits(rays) {
                let met = group.may_meet(l, packet.x[ray], packet.y[ray]);
                for lane in SetBits(met & used) {
                    found.push(Candidate {
                        ray: ray as u8,
                        triangle: eight.number(lane),
                    });
                }
            }
        }
    }
}
